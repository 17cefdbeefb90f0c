//! Schemes: what happens in one time step.

pub mod isph;
pub mod still;
pub mod wcsph;

use crate::Result;
use crate::bodies::{Bodies, Matrix3};
use crate::boundary::DummyWalls;
use crate::case::Slip;
use crate::form::Point;
use crate::halo::{Halo, PeriodicBox};
use crate::kernel::{CubicSpline, KernelKind, LatticeSums, Quintic, Smoothing, WendlandC2};
use crate::neighbors::{Layout, Neighbors};
use crate::operators::{Moments, Surroundings};
use crate::parallel::{self, Ranks};
use crate::particles::{Particles, ReorderScratch, Vector};
use crate::ppe::SolveRecord;
use crate::ppe::matrix::NEAR;
use rayon::prelude::*;
use std::path::Path;
use std::time::Duration;

/// What all schemes share: the liquid and its discretisation, SI units.
#[derive(Debug, Clone)]
pub struct Params<const D: usize> {
    /// Particle spacing dx in m.
    pub spacing: f64,
    /// Gravitational acceleration in m/s2.
    pub gravity: Vector<D>,
    /// Liquid density in kg/m3.
    pub density: f64,
    /// Kinematic viscosity in m2/s.
    pub kinematic_viscosity: f64,
    /// Tangential condition at walls.
    pub slip: Slip,
    /// Kernel.
    pub kernel: KernelKind,
    /// h / dx.
    pub smoothing_ratio: f64,
    /// Periodic sides, if any.
    pub periodic: Option<PeriodicBox<D>>,
    /// Ranks that share the particles.
    pub ranks: Ranks,
    /// Rigid bodies at the start.
    pub bodies: Bodies<D>,
}

impl<const D: usize> Params<D> {
    /// Smoothing length h in m.
    pub fn smoothing_length(&self) -> f64 {
        self.smoothing_ratio * self.spacing
    }

    /// Support radius in m.
    pub fn support(&self) -> f64 {
        self.kernel.support() * self.smoothing_length()
    }

    /// Volume of one particle in m^D.
    pub fn volume(&self) -> f64 {
        self.spacing.powi(D as i32)
    }

    /// Mass of one particle in kg (in 2D for 1 m of width).
    pub fn mass(&self) -> f64 {
        self.density * self.volume()
    }

    /// Sums over the regular lattice of this kernel and spacing.
    pub fn lattice_sums(&self) -> LatticeSums {
        let (h, support, near) = (self.smoothing_length(), self.support(), NEAR * self.spacing);
        match self.kernel {
            KernelKind::WendlandC2 => {
                LatticeSums::new(&Smoothing::<D, WendlandC2>::new(h), support, self.spacing, near)
            }
            KernelKind::CubicSpline => {
                LatticeSums::new(&Smoothing::<D, CubicSpline>::new(h), support, self.spacing, near)
            }
            KernelKind::Quintic => {
                LatticeSums::new(&Smoothing::<D, Quintic>::new(h), support, self.spacing, near)
            }
        }
    }
}

/// Acceleration limit of the step: dt <= 0.25 sqrt(h / |a|max) (Monaghan 1992).
const ACCELERATION_NUMBER: f64 = 0.25;
/// Viscous limit of the step: dt <= 0.04 h^2 / nu. Morris et al. (1997) have 0.125 for the two-point form, where the weights of a row
/// sum to 7 / h^2 and an explicit step is stable up to 2 / 14. The central form sums to 14 / h^2 along a direction, 21 along an axis of
/// the lattice (2D, Wendland; in 3D 12 and 17): 2 / 42, and less beside walls that hold the liquid. At 0.125 `wcsph` on a floor
/// without slip gains the energy of its fall within a hundred steps; at 0.02 the step is half as long as it needs to be.
const VISCOUS_NUMBER: f64 = 0.04;

/// r += dt v of the liquid and of ghosts; bodies place their solids themselves.
fn drift<const D: usize>(particles: &mut Particles<D>, dt: f64) {
    let first = particles.solids();
    let moving = particles.position[first..].par_iter_mut().zip(&particles.velocity[first..]);
    moving.with_min_len(1024).for_each(|(r, v)| *r += dt * v);
}

/// Largest speed in m/s of the liquid and of bodies.
fn fastest<const D: usize>(particles: &Particles<D>, bodies: &Bodies<D>) -> f64 {
    let first = if bodies.can_move() { 0 } else { particles.solids() };
    particles.fastest(first..particles.owned())
}

/// Puts the fluid into cell order, without ghosts: neighbours are then close in memory.
fn sort<const D: usize>(
    particles: &mut Particles<D>,
    neighbors: &mut Neighbors<D>,
    support: f64,
    scratch: &mut ReorderScratch<D>,
) {
    particles.drop_ghosts();
    let order = neighbors.cell_order(&particles.position, particles.solids(), support);
    particles.reorder_fluid(order, scratch);
}

/// Ghosts, and owners on all ranks.
fn halo<const D: usize>(params: &Params<D>) -> Halo<D> {
    let mut halo = Halo::new(params.periodic, params.support()).over(params.ranks);
    halo.let_solids_move(params.bodies.can_move());
    halo
}

/// The walls of `particles`, as dry as they are built. `neighbors` is a buffer.
fn dummy_walls<const D: usize>(
    params: &Params<D>,
    particles: &Particles<D>,
    lattice: &LatticeSums,
    neighbors: &mut Neighbors<D>,
) -> DummyWalls<D> {
    let mut solids = particles.clone();
    solids.retain_fluid(|_| false);
    Halo::new(params.periodic, params.support()).renew(&mut solids);
    let walls = particles.walls();
    let all_walls = |a| if walls.contains(&a) { f64::NEG_INFINITY } else { f64::INFINITY };
    let (h, layout) = (params.smoothing_length(), Layout::of(&solids));
    neighbors.search(params.kernel, h, &solids.position, &layout, all_walls);
    DummyWalls::new(particles, neighbors, lattice, params.volume(), params.density * params.gravity)
}

/// Share of the lattice's kernel sum below which liquid around a particle is no company: in 2D what one neighbour 1.6 spacings away
/// adds. Half and twice as much stand for 1.7 and 1.4 spacings.
const LONELY: f64 = 0.03;

/// What schemes keep for bodies: their walls among other solids.
#[derive(Debug, Default)]
struct Afloat<const D: usize> {
    bodies: Bodies<D>,
    solids: Neighbors<D>,
    accelerations: Vec<Vector<D>>,
    /// Where bodies were when their surroundings were last looked at.
    surveyed: Vec<(Point, Matrix3)>,
    /// Walls that were near them then.
    near: Vec<bool>,
    /// Walls that other solids covered then.
    covered: Vec<bool>,
}

impl<const D: usize> Afloat<D> {
    fn new(bodies: Bodies<D>) -> Self {
        Self { bodies, ..Self::default() }
    }

    /// Measures the walls around bodies that have moved since the last time, and finds what covers their faces.
    fn survey(
        &mut self,
        params: &Params<D>,
        particles: &mut Particles<D>,
        lattice: &LatticeSums,
        walls: &mut DummyWalls<D>,
    ) {
        if self.bodies.poses().eq(self.surveyed.iter().copied()) {
            return;
        }
        // Walls that a body has left are measured once more; at first, and in a resumed run, all are.
        self.near.resize(particles.walls().len(), true);
        if self.surveyed.is_empty() {
            self.near.fill(true);
        }
        self.surveyed.clear();
        self.surveyed.extend(self.bodies.poses());
        let (reach, solids) = (params.support(), particles.solids());
        let is_near = |a: usize| self.bodies.is_near(particles, a, reach);
        let changed: Vec<bool> = self
            .near
            .iter_mut()
            .enumerate()
            .map(|(a, near)| std::mem::replace(near, is_near(a)) || *near)
            .collect();
        let threshold = |a: usize| match changed.get(a) {
            Some(true) => f64::NEG_INFINITY,
            _ => f64::INFINITY,
        };
        let layout = Layout::without_ghosts(solids, solids);
        let (h, places) = (params.smoothing_length(), &particles.position[..solids]);
        self.solids.search(params.kernel, h, places, &layout, threshold);
        self.bodies.find_covered(particles, &self.solids, &changed, &mut self.covered);
        walls.measure(&self.solids, lattice, params.volume(), |a| changed[a], |a| self.covered[a]);
        self.bodies.find_open_faces(particles, &self.solids);
    }

    /// Moments of the support of particle `a` with the covered walls in it, if there are any. A drop on its own, caught under a body,
    /// keeps air around it: without, nothing but round-off would tell its pressure.
    fn fill(
        &self,
        surroundings: &Surroundings<'_, D>,
        particles: &Particles<D>,
        lattice: &LatticeSums,
        a: usize,
    ) -> Option<Moments<D>> {
        if self.covered.is_empty() {
            return None;
        }
        let covered = |b: &usize| self.covered.get(particles.original(*b)) == Some(&true);
        let (liquid, solid) = surroundings.neighbors.row(a).split();
        let lattice_sum = lattice.kernel_sum - lattice.own_share;
        let is_alone = surroundings.volume * liquid.kernel_sum() < LONELY * lattice_sum;
        let any = !is_alone && solid.iter().any(|(b, ..)| covered(&b));
        any.then(|| surroundings.moments_over(a, |b| surroundings.active[b] || covered(&b)))
    }

    /// Bodies in the middle of a step of `dt` s and `ahead` s on from there, and the accelerations that dummies feel: the last
    /// ones, or with `known` those that the pressure does not change.
    fn depart(
        &mut self,
        params: &Params<D>,
        particles: &mut Particles<D>,
        walls: &mut DummyWalls<D>,
        (dt, ahead): (f64, f64),
        known: bool,
    ) {
        if !self.bodies.is_empty() {
            self.bodies.foresee(dt);
            self.bodies.depart(dt, ahead);
            self.bodies.place(particles, false);
            self.accelerate(params, particles, known, walls);
        }
    }

    /// Bodies where a step of `dt` s takes them.
    fn arrive(&mut self, particles: &mut Particles<D>, dt: f64) {
        if !self.bodies.is_empty() {
            self.bodies.arrive(dt);
            self.bodies.place(particles, true);
        }
    }

    /// Lets dummies feel the accelerations of bodies, or with `known` those that the pressure does not change.
    fn accelerate(
        &mut self,
        params: &Params<D>,
        particles: &Particles<D>,
        known: bool,
        walls: &mut DummyWalls<D>,
    ) {
        self.bodies.accelerations(particles, known, &mut self.accelerations);
        walls.set_accelerations(params.density, |inertial| inertial.clone_from(&self.accelerations));
    }
}

/// A method that advances particles in time.
pub trait Scheme<const D: usize> {
    /// Advances `particles` by `dt` s. On an error the particles are left as they were at that moment.
    fn step(&mut self, particles: &mut Particles<D>, dt: f64) -> Result<StepReport>;

    /// Changes the body force per mass, in m/s2, that liquid and walls feel from the next step on.
    fn set_gravity(&mut self, gravity: Vector<D>);

    /// Largest stable time step in s for the present state.
    fn max_dt(&self, particles: &Particles<D>) -> f64;

    /// Prepares the first step: finds the pressure of the present state and checks that the solver can work.
    /// Positions and velocities stay as they are.
    fn start(&mut self, particles: &mut Particles<D>) -> Result<()>;

    /// What the next step depends on beside the particles.
    fn state(&self) -> Vec<f64>;

    /// Takes back a [`state`](Self::state); `None` if it is not one.
    fn set_state(&mut self, state: &[f64]) -> Option<()>;

    /// What it was built from.
    fn params(&self) -> &Params<D>;

    /// Ghosts, and who holds which particle.
    fn halo(&self) -> &Halo<D>;

    /// The same, to be told that the liquid is another.
    fn halo_mut(&mut self) -> &mut Halo<D>;

    /// What the last step knows about each particle beside its state.
    fn fields(&self) -> Fields<'_, D>;

    /// Writes the last pressure system, where there is one, into `folder` (made if need be) as `name`.
    fn save_system(&self, folder: &Path, name: &str) -> Result<()>;

    /// How compressible the liquid was, in schemes that let it be.
    fn compressibility(&self) -> Option<Compressibility> {
        None
    }

    /// Time spent by stage since the start.
    fn stages(&self) -> &Stages;

    /// Rigid bodies in the flow.
    fn bodies(&self) -> &Bodies<D>;

    /// Takes bodies in, or lets them be changed between steps.
    fn bodies_mut(&mut self) -> &mut Bodies<D>;
}

/// How compressible a weakly compressible liquid was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compressibility {
    /// Artificial speed of sound in m/s.
    pub sound_speed: f64,
    /// Largest |rho / rho_0 - 1| since the start.
    pub largest_variation: f64,
    /// Energy in J that walls hold by which this rank's liquid is repelled.
    pub wall_potential: f64,
}

/// Per-particle results of the last step, beside the state itself. Arrays have one entry a particle.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a, const D: usize> {
    /// Kernel sum over its value on the regular lattice, in compressible liquid rho / rho_0: 1 in undisturbed liquid.
    pub crowding: &'a [f64],
    /// Surface weight, 1 on the free surface and 0 inside.
    pub surface: &'a [f64],
    /// Liquid, and walls where they are wet.
    pub active: &'a [bool],
    /// Whether the pressures of wet walls mean anything; if not, gauges on walls read the forces on them.
    pub walls_carry_pressure: bool,
    /// Force in N with which liquid pushes each wall particle by repulsion or collisions, beside any pressure that walls carry; empty
    /// where there are neither.
    pub wall_force: &'a [Vector<D>],
}

impl<'a, const D: usize> Fields<'a, D> {
    /// No fields, beside walls whose pressures count.
    pub fn none() -> Self {
        Self { crowding: &[], surface: &[], active: &[], walls_carry_pressure: true, wall_force: &[] }
    }
}

/// What one step did.
#[derive(Debug, Clone, Default)]
pub struct StepReport {
    /// The pressure solve, in schemes that have one.
    pub solve: Option<SolveRecord>,
    /// Negative pressures set to zero.
    pub clipped: usize,
    /// Pairs that collided.
    pub collisions: usize,
}

/// Runs `work` as a stage of PETSc's own log, where there is one.
#[cfg(feature = "petsc")]
pub use crate::petsc::stage as logged;

/// Runs `work`: without PETSc there is no log to book it in.
#[cfg(not(feature = "petsc"))]
pub fn logged<T>(_: &'static str, work: impl FnOnce() -> T) -> T {
    work()
}

/// Wall-clock time by named stage.
#[derive(Debug, Clone, Default)]
pub struct Stages {
    spent: Vec<(&'static str, Duration)>,
    last: Duration,
    /// Work of this rank, in s, since it was taken out last.
    work: f64,
}

impl Stages {
    /// Runs `work` and books its time under `name`, with PETSc too where that runs.
    pub fn time<T>(&mut self, name: &'static str, work: impl FnOnce() -> T) -> T {
        let (start, waited) = (std::time::Instant::now(), parallel::traffic().waited);
        let result = logged(name, work);
        let spent = start.elapsed();
        self.last = spent;
        self.work += spent.saturating_sub(parallel::traffic().waited - waited).as_secs_f64();
        match self.spent.iter_mut().find(|(n, _)| *n == name) {
            Some((_, total)) => *total += spent,
            None => self.spent.push((name, spent)),
        }
        result
    }

    /// Tells that all ranks went through the last stage together, and that this one had `share` times the mean of its work.
    pub fn was_shared(&mut self, share: f64) {
        self.work += (share - 1.0) * self.last.as_secs_f64();
    }

    /// What this rank has worked since the last call, in s: the time of all stages, but for waiting outside PETSc.
    pub fn take_work(&mut self) -> f64 {
        std::mem::take(&mut self.work)
    }

    /// (stage, time) in order of first appearance.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, Duration)> + '_ {
        self.spent.iter().copied()
    }
}
