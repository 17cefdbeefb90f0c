//! Incompressible SPH by projection (Cummins & Rudman 1999; Jian et al. 2016).
//!
//! One step from t^n to t^(n+1), with one neighbour search, at the drifted positions r*:
//!
//! 1. drift      r* = r^n + dt v^n
//! 2. predict    v* = v^n + dt (g + nu laplacian v^n); where steps are too long for that, nu laplacian v^(n+1) comes after 4:
//!    [`crate::terms::implicit_viscosity`]
//! 3. pressure   div((1/rho) grad p) = div v* / dt + ...          Eq. (3) of Jian et al. and [`crate::ppe::source`]
//! 4. correct    v^(n+1) = v* - (dt / rho) grad p,   r^(n+1) = r* + (dt / 2) (v^(n+1) - v^n)
//! 5. shift      r^(n+1) += dr                                     [`crate::terms::shifting`]
//!
//! so that positions follow the trapezoidal rule r^(n+1) = r^n + (dt / 2) (v^n + v^(n+1)).
//!
//! The pressure gradient is the first-order exact difference form where the support allows it: symmetric pair forces
//! would be conservative, but leave currents thirty to a hundred times stronger in still water. Where the
//! support is too one-sided the symmetric form takes over.

use super::{
    ACCELERATION_NUMBER, Afloat, Fields, Params, Scheme, Stages, StepReport, VISCOUS_NUMBER, drift, fastest,
    sort,
};
use crate::bodies::Bodies;
use crate::bodies::coupling::Flow;
use crate::bodies::drag::Grip;
use crate::boundary::{DummyWalls, kinematic};
use crate::case::{LaplacianKind, Slip};
use crate::halo::{Halo, Kinds};
use crate::kernel::LatticeSums;
use crate::neighbors::{Layout, Neighbors};
use crate::operators::{Moments, Surroundings};
use crate::parallel::Ranks;
use crate::particles::{Particles, ReorderScratch, Vector};
use crate::ppe::matrix::{Assembler, Inputs, Link};
use crate::ppe::source::Source;
use crate::ppe::{PressureSolve, SolveRecord};
use crate::terms::collision::Collisions;
use crate::terms::implicit_viscosity::{self, VelocitySolve};
use crate::terms::shifting::Shifting;
use crate::terms::surface;
use crate::terms::viscosity::Form;
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::Path;

/// What ISPH needs to know beyond what all schemes share; SI units.
#[derive(Debug, Clone)]
pub struct Method {
    /// Laplacian of the pressure equation.
    pub laplacian: LaplacianKind,
    /// Right-hand side of the pressure equation.
    pub source: Source,
    /// How a surface particle is told.
    pub surface: surface::Criterion,
    /// A of the shifting; 0 leaves it out.
    pub shifting: f64,
    /// Sets negative pressures to zero.
    pub clip_negative_pressure: bool,
    /// Collisions of close pairs, if any.
    pub collisions: Option<Collisions>,
    /// Courant number of the adaptive step.
    pub courant: f64,
}

/// Longest step in s that waves on the surface allow; without gravity there are none.
pub fn longest_step<const D: usize>(params: &Params<D>) -> f64 {
    GRAVITY_WAVE_NUMBER * (params.smoothing_length() / params.gravity.norm()).sqrt()
}

impl Method {
    /// Largest stable time step in s at a largest speed in m/s and a largest acceleration in m/s2.
    pub fn dt_limit<const D: usize>(&self, params: &Params<D>, speed: f64, acceleration: f64) -> f64 {
        let h = params.smoothing_length();
        let limits = [
            self.courant * params.spacing / speed,
            ACCELERATION_NUMBER * (h / acceleration).sqrt(),
            longest_step(params),
        ];
        // A limit that is not there divides by zero: infinite.
        let limit = limits.into_iter().fold(f64::INFINITY, f64::min);
        let explicit = explicit_viscosity_limit(params);
        if explicit * IMPLICIT_GAIN < limit { limit } else { limit.min(explicit) }
    }
}

/// Viscosity is taken from the end of the step where that makes the step longer by more than this. One implicit solve costs as much
/// as a step or two, and short explicit steps are the more accurate ones: not for a little is it worth it. With 10 or 40 the step is never
/// less than that share of what the flow asks for either.
const IMPLICIT_GAIN: f64 = 20.0;

/// Longest step in s at which explicit viscosity is stable; infinite without viscosity.
fn explicit_viscosity_limit<const D: usize>(params: &Params<D>) -> f64 {
    VISCOUS_NUMBER * params.smoothing_length().powi(2) / params.kinematic_viscosity
}

/// Who is near whom at the drifted positions.
struct Support<const D: usize> {
    neighbors: Neighbors<D>,
    active: Vec<bool>,
    volume: f64,
}

impl<const D: usize> Support<D> {
    fn around<'a>(&'a self, particles: &'a Particles<D>) -> Surroundings<'a, D> {
        let Self { neighbors, active, volume } = self;
        Surroundings { position: &particles.position, neighbors, active, volume: *volume }
    }
}

/// The projection scheme.
pub struct Isph<const D: usize> {
    params: Params<D>,
    method: Method,
    ranks: Ranks,
    halo: Halo<D>,
    walls: DummyWalls<D>,
    lattice: LatticeSums,
    solver: Box<dyn PressureSolve>,
    velocity_solver: Box<dyn VelocitySolve>,
    velocities: implicit_viscosity::Assembler,
    support: Support<D>,
    moments: Vec<Moments<D>>,
    surface: Vec<f64>,
    crowding: Vec<f64>,
    source: Vec<f64>,
    predicted: Vec<Vector<D>>,
    change: Vec<(Vector<D>, Vector<D>)>,
    assembler: Assembler,
    pairs: Vec<(u32, u32)>,
    /// What walls receive in collisions over a step: impulses in N s, at its end forces in N.
    wall_force: Vec<Vector<D>>,
    reorder: ReorderScratch<D>,
    afloat: Afloat<D>,
    /// For each free axis of a body: the right-hand side for a unit of its acceleration, and what pressure that makes.
    answers: Vec<(Vec<f64>, Vec<f64>)>,
    /// False in a scene without air, see [`surface`].
    has_surface: bool,
    /// Largest acceleration of the last step in m/s2.
    acceleration: f64,
    steps: u64,
    stages: Stages,
}

/// Gravity-wave limit of the step: dt <= 0.1 sqrt(h / |g|), about a hundredth of the period of the shortest waves that
/// a surface of particles can carry. At 0.25 a tank with disorder of 0.05 spacings stirs itself up within 4 s (kinetic
/// energy 4e-6 of the potential and growing); at 0.1 and 0.05 it stays below 1e-6 for 6 s.
const GRAVITY_WAVE_NUMBER: f64 = 0.1;

impl<const D: usize> Isph<D> {
    /// Scheme for `particles`, with solvers for its pressures and for velocities of very viscous liquid.
    pub fn new(
        params: Params<D>,
        method: Method,
        particles: &Particles<D>,
        (solver, velocity_solver): (Box<dyn PressureSolve>, Box<dyn VelocitySolve>),
    ) -> Self {
        let lattice = params.lattice_sums();
        let volume = params.volume();
        let mut support = Support { neighbors: Neighbors::default(), active: vec![], volume };
        Self {
            walls: super::dummy_walls(&params, particles, &lattice, &mut support.neighbors),
            ranks: params.ranks,
            halo: super::halo(&params),
            lattice,
            solver,
            velocity_solver,
            velocities: implicit_viscosity::Assembler::default(),
            support,
            moments: vec![],
            surface: vec![],
            crowding: vec![],
            source: vec![],
            predicted: vec![],
            change: vec![],
            assembler: Assembler::default(),
            pairs: vec![],
            wall_force: vec![],
            reorder: ReorderScratch::default(),
            afloat: Afloat::new(params.bodies.clone()),
            answers: vec![],
            has_surface: true,
            acceleration: 0.0,
            steps: 0,
            stages: Stages::default(),
            params,
            method,
        }
    }

    /// Neighbours, wet walls, and the moments of every support.
    fn survey(&mut self, particles: &mut Particles<D>) {
        self.afloat.survey(&self.params, particles, &self.lattice, &mut self.walls);
        self.halo.renew(particles);
        let (walls, support) = (&self.walls, &mut self.support);
        let (kernel, h) = (self.params.kernel, self.params.smoothing_length());
        let halo = &self.halo;
        let threshold = |a| if halo.holds(a) { walls.threshold(particles, a) } else { f64::INFINITY };
        support.neighbors.search(kernel, h, &particles.position, &Layout::of(particles), threshold);
        walls.mark_active(particles, &support.neighbors, halo, &mut support.active);
        let surroundings = self.support.around(particles);
        let (count, owned) = (particles.len(), particles.owned());
        self.moments.resize(count, Moments::default());
        self.surface.resize(count, 0.0);
        self.crowding.resize(count, 0.0);
        let (lattice, first_fluid, dummies) = (&self.lattice, particles.solids(), particles.dummies());
        let criterion = self.has_surface.then_some(self.method.surface);
        let afloat = &self.afloat;
        (&mut self.moments[..owned], &mut self.surface[..owned], &mut self.crowding[..owned])
            .into_par_iter()
            .enumerate()
            .with_min_len(256)
            .for_each(|(a, (moments, weight, crowding))| {
                if dummies.contains(&a) || (a < first_fluid && !surroundings.active[a]) {
                    (*weight, *crowding) = (0.0, 1.0);
                    return;
                }
                *moments = surroundings.moments(a);
                let filled = afloat.fill(&surroundings, particles, lattice, a).unwrap_or(*moments);
                *crowding = (filled.kernel_sum + lattice.own_share) / lattice.kernel_sum;
                let is_liquid = |b: usize| particles.original(b) >= first_fluid;
                let liquid = surroundings.active(a).filter(|(b, ..)| is_liquid(*b));
                *weight = match criterion {
                    None => 0.0,
                    Some(_) if is_liquid(a) && liquid.take(surface::FEW).count() < surface::FEW => 1.0,
                    Some(criterion) => criterion.weight(&filled, *crowding),
                };
            });
        self.halo.refresh(Kinds::All, particles.originals(), &mut self.surface);
    }

    /// v* of liquid and walls, but for viscosity beyond the explicit limit, which is for [`resist`](Self::resist).
    fn predict(&mut self, particles: &Particles<D>, dt: f64) {
        let Params { gravity, kinematic_viscosity: nu, slip, .. } = self.params;
        let (moments, form) = (&self.moments, self.viscous_form());
        let surroundings = self.support.around(particles);
        let (solids, owned) = (particles.solids(), particles.owned());
        let is_explicit = nu > 0.0 && !self.is_stiff(dt);
        self.predicted.resize(particles.len(), Vector::zeros());
        self.predicted[..owned].par_iter_mut().enumerate().with_min_len(512).for_each(|(a, v)| {
            *v = particles.velocity[a] + dt * gravity;
            if is_explicit && a >= solids {
                *v += dt * nu * form.laplacian(&surroundings, particles, &moments[a], a, slip);
            }
        });
        self.halo.refresh(Kinds::Liquid, particles.originals(), &mut self.predicted);
    }

    /// Whether viscosity is too large for explicit steps of `dt` s.
    fn is_stiff(&self, dt: f64) -> bool {
        dt > explicit_viscosity_limit(&self.params)
    }

    fn viscous_form(&self) -> Form {
        match self.has_surface {
            true => Form::Central { moment: self.lattice.laplacian },
            false => Form::TwoPoint,
        }
    }

    /// Viscosity from the end of the step, see [`implicit_viscosity`].
    fn resist(&mut self, particles: &mut Particles<D>, dt: f64) -> Result<()> {
        let (nu, slip, form) = (self.params.kinematic_viscosity, self.params.slip, self.viscous_form());
        self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.velocity);
        let surroundings = self.support.around(particles);
        self.velocities.assemble(particles, &surroundings, &self.moments, form, slip, &self.halo, dt * nu);
        self.velocity_solver.solve(&mut self.velocities.system)?;
        let fluid = particles.fluid();
        let mut largest = 0.0_f64;
        let changed = particles.velocity[fluid].iter_mut().zip(&self.change);
        for ((v, (change, new)), solved) in changed.zip(self.velocities.velocities()) {
            *v = solved;
            largest = largest.max((solved - new + change).norm_squared());
        }
        self.acceleration = self.ranks.max(largest.sqrt() / dt);
        Ok(())
    }

    /// Lets bodies feel what viscosity does to the liquid at the velocities of the last step.
    fn drag(&mut self, particles: &Particles<D>) {
        let Params { kinematic_viscosity: nu, slip, .. } = self.params;
        if nu == 0.0 || slip != Slip::None || self.afloat.bodies.is_empty() {
            return;
        }
        let (form, moments, volume) = (self.viscous_form(), &self.moments, self.params.volume());
        let (Support { neighbors, active, .. }, bodies) = (&self.support, &self.afloat.bodies);
        let wet = bodies.beside_liquid(particles, neighbors).filter(|(_, (_, b, _))| active[*b]);
        let grips = wet.map(|(body, (a, b, f))| {
            let r_ab = particles.position[a] - particles.position[b];
            let pair = form.pair(particles, slip, form.factor(&moments[a]), (b, &r_ab, volume * f));
            let (velocity, rate) = (particles.velocity[a], nu * pair.coefficient);
            Grip { solid: b, body, velocity, rate, line: pair.line }
        });
        self.afloat.bodies.drags = bodies.drag(particles, self.params.mass(), &self.ranks, grips);
    }

    /// The source of every pressure row.
    fn find_source(&mut self, particles: &Particles<D>, dt: f64) {
        let (wanted, spacing) = (self.method.source, self.params.spacing);
        let surroundings = self.support.around(particles);
        let (solids, owned) = (particles.solids(), particles.owned());
        let (predicted, moments) = (&self.predicted, &self.moments);
        let (surface, crowding) = (&self.surface, &self.crowding);
        self.source.resize(owned, 0.0);
        self.source.par_iter_mut().enumerate().with_min_len(256).for_each(|(a, source)| {
            let divergence =
                kinematic::divergence(&surroundings, particles, a, predicted, &moments[a], spacing);
            let divergence = (1.0 - surface[a]) * divergence;
            let near_surface = surface[a] > 0.5 || surroundings.active(a).any(|(b, ..)| surface[b] > 0.5);
            let of_row = if a < solids { Source::of_wall } else { Source::of };
            *source = of_row(wanted, divergence, crowding[a] - 1.0, near_surface, dt);
        });
    }

    fn assemble(&mut self, particles: &Particles<D>) {
        let inputs = Inputs {
            particles,
            surroundings: self.support.around(particles),
            moments: &self.moments,
            surface: &self.surface,
            source: &self.source,
            walls: &self.walls,
            lattice: &self.lattice,
            density: self.params.density,
            spacing: self.params.spacing,
            laplacian: self.method.laplacian,
            bodies: (self.afloat.bodies.strong && self.afloat.bodies.can_move())
                .then_some(&self.afloat.bodies),
        };
        self.assembler.assemble(&inputs, &self.halo, self.solver.needs());
    }

    fn clips(&self) -> bool {
        self.method.clip_negative_pressure && self.has_surface
    }

    /// Pressures back to the particles; returns how many were clipped. In a scene without a surface nothing sets the level of the
    /// pressure: its sign means nothing, and it stays as it is.
    fn take_pressure(&mut self, particles: &mut Particles<D>) -> usize {
        let mut clipped = 0;
        if self.clips() {
            for p in &mut self.assembler.system.pressure {
                if *p < 0.0 {
                    (*p, clipped) = (0.0, clipped + 1);
                }
            }
        }
        self.assembler.scatter(particles);
        self.halo.share(Kinds::All, particles, |particles| &mut particles.pressure);
        self.walls.extend_pressure(particles, &self.halo, &self.support.active);
        clipped
    }

    /// v = v* - (dt / rho) grad p and the matching half step of the positions.
    fn correct(&mut self, particles: &mut Particles<D>, dt: f64) {
        let first = particles.solids();
        let factor = dt / self.params.density;
        let surroundings = self.support.around(particles);
        let (moments, predicted, pressure) = (&self.moments, &self.predicted, &particles.pressure);
        let (surface, lattice, spacing) = (&self.surface, &self.lattice, self.params.spacing);
        self.change.resize(particles.owned() - first, (Vector::zeros(), Vector::zeros()));
        self.change.par_iter_mut().enumerate().with_min_len(256).for_each(|(k, (change, new))| {
            let a = first + k;
            let gradient = match moments[a].correction() {
                Some(b) => {
                    let inner = b * surroundings.difference_gradient(a, pressure);
                    let thickness = surface::thickness(&moments[a], lattice, spacing);
                    surface::gradient(inner, &moments[a], surface[a], pressure[a], thickness)
                }
                None => surroundings.symmetric_gradient(a, pressure),
            };
            *new = predicted[a] - factor * gradient;
            *change = *new - particles.velocity[a];
        });
        let changed = particles.velocity[first..].par_iter_mut().zip(&self.change).with_min_len(1024);
        let squares = changed.map(|(v, (change, new))| {
            *v = *new;
            change.norm_squared()
        });
        let largest = squares.reduce(|| 0.0, f64::max);
        self.acceleration = self.ranks.max(largest.sqrt() / dt);
    }

    /// Bodies at the drifted positions, and the accelerations that the pressure starts from.
    fn depart(&mut self, particles: &mut Particles<D>, dt: f64) {
        let strong = self.afloat.bodies.strong;
        self.afloat.depart(&self.params, particles, &mut self.walls, (dt, 0.5 * dt), strong);
    }

    /// Motion of bodies, and with strong coupling the pressure that goes with it, [`crate::bodies::coupling`].
    fn couple(
        &mut self,
        particles: &mut Particles<D>,
        dt: f64,
        mut record: SolveRecord,
    ) -> Result<SolveRecord> {
        let clip = self.clips();
        let Self { afloat, assembler, solver, answers, .. } = self;
        if afloat.bodies.is_empty() {
            return Ok(record);
        }
        let strong = afloat.bodies.strong;
        if strong {
            let unknowns: Vec<(usize, usize)> = afloat.bodies.unknowns().collect();
            answers.resize_with(unknowns.len(), Default::default);
            for (unknown, (rhs, answer)) in unknowns.into_iter().zip(answers.iter_mut()) {
                let density = self.params.density;
                let bodies = &afloat.bodies;
                let of = |link: &Link| match bodies.movable(link.solid as usize) == Some(unknown.0) {
                    true => -density * bodies.mode_at(unknown, &link.at).dot(&link.moment),
                    false => 0.0,
                };
                assembler.right_hand_side(of, rhs);
                answer.clear();
                answer.resize(rhs.len(), 0.0);
                if self.ranks.any(rhs.iter().any(|value| *value != 0.0)) {
                    let one = solver.solve_again(&assembler.system, rhs, answer)?;
                    record.iterations += one.iterations;
                    record.inner_iterations += one.inner_iterations;
                    record.setup_s += one.setup_s;
                    record.solve_s += one.solve_s;
                }
            }
        }
        assembler.scatter(particles);
        let responses: Vec<Vec<f64>> = answers.iter_mut().map(|(_, answer)| std::mem::take(answer)).collect();
        let flow = Flow {
            particles,
            active: &self.support.active,
            halo: &self.halo,
            gravity: self.params.gravity,
            density: self.params.density,
            accelerations: &afloat.accelerations,
            pressure: true,
            repulsion: &[],
            clip,
            response: strong.then_some((&responses[..], &assembler.row_of[..])),
        };
        let q = afloat.bodies.advance(&flow, dt);
        for ((response, q), (_, answer)) in responses.into_iter().zip(&q).zip(answers.iter_mut()) {
            assembler.system.pressure.iter_mut().zip(&response).for_each(|(p, per_unit)| *p += q * per_unit);
            *answer = response;
        }
        if strong {
            afloat.accelerate(&self.params, particles, false, &mut self.walls);
        }
        Ok(record)
    }

    fn collide(&mut self, particles: &mut Particles<D>) -> usize {
        match self.method.collisions {
            Some(collisions) => {
                self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.velocity);
                let Self { support, afloat, pairs, wall_force, .. } = self;
                collisions.apply(particles, &support.neighbors, &mut afloat.bodies, pairs, wall_force)
            }
            None => 0,
        }
    }

    fn hold(&mut self, particles: &mut Particles<D>, dt: f64) -> usize {
        let Self { support, afloat, params, wall_force, .. } = self;
        let hold = |c: Collisions| {
            c.hold(particles, &support.neighbors, &mut afloat.bodies, params.spacing, wall_force)
        };
        let rebounds = self.method.collisions.map_or(0, hold);
        wall_force.iter_mut().for_each(|impulse| *impulse /= dt);
        afloat.bodies.sum_hits(&self.ranks);
        rebounds
    }

    /// r^(n+1) = r* + (dt / 2) (v^(n+1) - v^n), after collisions have had their say in v^(n+1).
    fn finish_positions(&mut self, particles: &mut Particles<D>, dt: f64) {
        let first = particles.solids();
        let fluid = (&mut particles.position[first..], &particles.velocity[first..], &self.change);
        fluid.into_par_iter().with_min_len(1024).for_each(|(r, v, (change, new))| {
            // v^n = new - change; collisions may have moved v away from new.
            *r += 0.5 * dt * (v - new + change);
        });
        self.halo.place(particles);
        self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.velocity);
    }

    fn shift(&mut self, particles: &mut Particles<D>, dt: f64) {
        self.halo.refresh(Kinds::All, particles.originals(), &mut self.moments);
        let Params { spacing, gravity, .. } = self.params;
        let h = self.params.smoothing_length();
        let shifting = Shifting::new(self.method.shifting, h, spacing, gravity.norm(), dt);
        let (moments, surface) = (&self.moments, &self.surface);
        shifting.compute(&self.support.around(particles), particles, moments, surface, &mut self.change);
        Shifting::apply(particles, &self.change);
    }
}

impl<const D: usize> Scheme<D> for Isph<D> {
    fn step(&mut self, particles: &mut Particles<D>, dt: f64) -> Result<StepReport> {
        let mut watch = std::mem::take(&mut self.stages);
        let mut report = StepReport::default();
        watch.time("neighbours", || {
            drift(particles, dt);
            self.depart(particles, dt);
            // Every step: rows of the matrix then come in order by themselves, and need not be sorted.
            let (neighbors, support) = (&mut self.support.neighbors, self.params.support());
            sort(particles, neighbors, support, &mut self.reorder);
            self.survey(particles);
        });
        if self.method.collisions.is_some() {
            self.wall_force.clear();
            self.wall_force.resize(particles.walls().len(), Vector::zeros());
        }
        watch.time("predict", || {
            self.drag(particles);
            self.predict(particles, dt);
        });
        watch.time("assemble", || {
            self.find_source(particles, dt);
            self.assemble(particles);
        });
        let solved = watch.time("solve", || self.solver.solve(&mut self.assembler.system));
        // Where PETSc works all ranks wait for each other: what each did goes by its rows.
        let rows = (self.assembler.particle_of.len() * self.params.ranks.count()) as f64;
        let share = solved.as_ref().map_or(1.0, |record| rows / record.unknowns.max(1) as f64);
        watch.was_shared(share);
        let solved = watch.time("bodies", || solved.and_then(|record| self.couple(particles, dt, record)));
        watch.was_shared(share);
        watch.time("correct", || {
            if solved.is_ok() {
                report.clipped = self.take_pressure(particles);
                self.correct(particles, dt);
                self.afloat.arrive(particles, dt);
            }
        });
        let solved = solved.and_then(|record| {
            if self.is_stiff(dt) {
                let resisted = watch.time("viscosity", || self.resist(particles, dt));
                watch.was_shared(share);
                resisted?;
            }
            Ok(record)
        });
        watch.time("correct", || {
            if solved.is_ok() {
                report.collisions = self.collide(particles);
                self.finish_positions(particles, dt);
            }
        });
        if solved.is_ok() && self.method.shifting > 0.0 {
            watch.time("shift", || self.shift(particles, dt));
        }
        watch.time("correct", || report.collisions += self.hold(particles, dt));
        self.halo.book(watch.take_work());
        self.stages = watch;
        report.solve = Some(solved?);
        self.steps += 1;
        Ok(report)
    }

    fn start(&mut self, particles: &mut Particles<D>) -> Result<()> {
        // Any short step gives the pressure of a state whose velocity is free of divergence; where nothing moves or falls, any at all.
        let limit = self.max_dt(particles);
        let dt = if limit.is_finite() { 0.1 * limit } else { 1.0 };
        // The divergence that the pressure answers to shows only as the liquid moves.
        drift(particles, dt);
        self.depart(particles, dt);
        self.survey(particles);
        self.has_surface = self.ranks.max(self.surface.iter().copied().fold(0.0, f64::max)) > 0.0;
        self.predict(particles, dt);
        self.find_source(particles, dt);
        self.assemble(particles);
        self.solver.check(&self.assembler.system)?;
        self.solver.solve(&mut self.assembler.system)?;
        self.take_pressure(particles);
        drift(particles, -dt);
        self.afloat.bodies.turn_back();
        self.afloat.bodies.place(particles, true);
        Ok(())
    }

    fn state(&self) -> Vec<f64> {
        vec![self.acceleration, self.steps as f64, f64::from(u8::from(self.has_surface))]
    }

    fn set_state(&mut self, state: &[f64]) -> Option<()> {
        let &[acceleration, steps, has_surface] = state else { return None };
        (self.acceleration, self.steps, self.has_surface) = (acceleration, steps as u64, has_surface == 1.0);
        Some(())
    }

    fn params(&self) -> &Params<D> {
        &self.params
    }

    fn halo(&self) -> &Halo<D> {
        &self.halo
    }

    fn halo_mut(&mut self) -> &mut Halo<D> {
        &mut self.halo
    }

    fn set_gravity(&mut self, gravity: Vector<D>) {
        self.params.gravity = gravity;
        self.walls.set_hydrostatic_gradient(self.params.density * gravity);
    }

    fn max_dt(&self, particles: &Particles<D>) -> f64 {
        self.method.dt_limit(
            &self.params,
            self.ranks.max(fastest(particles, self.bodies())),
            self.acceleration,
        )
    }

    fn fields(&self) -> Fields<'_, D> {
        Fields {
            crowding: &self.crowding,
            surface: &self.surface,
            active: &self.support.active,
            walls_carry_pressure: true,
            wall_force: &self.wall_force,
        }
    }

    fn save_system(&self, folder: &Path, name: &str) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|error| Error::io(folder, error))?;
        self.solver.save(&self.assembler.system, folder, name).map(|_| ())
    }

    fn stages(&self) -> &Stages {
        &self.stages
    }

    fn bodies(&self) -> &Bodies<D> {
        &self.afloat.bodies
    }

    fn bodies_mut(&mut self) -> &mut Bodies<D> {
        self.afloat.surveyed.clear();
        &mut self.afloat.bodies
    }
}
