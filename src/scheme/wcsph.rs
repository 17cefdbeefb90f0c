//! Weakly compressible SPH (Monaghan 1994), as the plain scheme and as the one a user would choose.
//!
//! The liquid is a barotropic gas with an artificial speed of sound c_0, [`crate::terms::state_equation`]:
//!
//! p_a = B ((rho_a / rho_0)^7 - 1)                                                                (1)
//! drho_a/dt = sum_b m v_ab . grad W                                                              (2)
//! dv_a/dt = g - sum_b m (p_a / rho_a^2 + p_b / rho_b^2 + Pi_ab) grad W                           (3)
//!
//! with the artificial viscosity Pi of [`crate::terms::artificial_viscosity`]. Forces of a pair are opposite and equal, and
//! (2) and (3) are each other's adjoint: together they keep momentum, and energy but for the viscosity.
//!
//! All sums over liquid take each pair once, for both ([`crate::pair_sums`]). Only shifting, the slopes of Antuono et al. and the start want whole
//! rows, a second search.
//!
//! The laminar viscosity, of the form that [`crate::terms::viscosity`] gives the scene, adds to (3). Ghosts beyond periodic sides
//! ([`crate::halo`]) count like any other particle.
//!
//! **Without a surface** nothing tells the level of the pressure, but (3) depends on it: on a disordered lattice the sum of
//! (p_a + p_b) grad W is off by 2 p_a sum V grad W, whatever the spacing, and negative pressures open voids (tensile instability).
//! In such a scene `wcsph` takes the differences alone,
//!
//! dv_a/dt = g - sum_b m (p_b / rho_b^2 - p_a / rho_a^2 + Pi_ab) grad W                           (4)
//!
//! as Sun et al. (2018, Comput. Methods Appl. Mech. Eng. 331, 25-49) do where the pressure is negative; to switch by its sign, as
//! they do beside a surface, leaves the same error behind positive pressures (`taylor_green` at L/50: amplitude 4.4 % off either
//! way, by (4) 0.3 %). (4) gives up exact momentum and the order that pressure keeps among particles: shift. With a surface it
//! does harm (the 2D dam break gains 44 % of its energy), and (3) stays.
//!
//! The pressure *is* the density: the state of a particle stays position, velocity and pressure.
//!
//! | | `wcsph_monaghan` (Jian et al. 2016: "equal footing") | `wcsph` |
//! |---|---|---|
//! | walls | [`crate::boundary::repulsion`] within a spacing | [`crate::boundary::extrapolation`] in all layers, repulsion within 0.85 spacings |
//! | h / dx | 1.2, in 3D 1.5 | 2 in 2D, 1.2 in 3D |
//! | viscosity | alpha in full | of alpha what the laminar viscosity lacks |
//! | forces without a surface | (3) | (4) |
//! | shape of the support | ignored | (6) in 2D with a surface |
//! | density diffusion | none | [`crate::terms::density_diffusion`] |
//! | acoustic damper | none | (5) |
//! | walls' share of (2) and of viscosity | none | as the liquid's; no viscosity where it slips |
//! | smoothed velocities | in 3D, (7) | on request |
//! | shifting | none | on request, [`crate::terms::shifting`] |
//! | stepping | predictor and corrector | position Verlet |
//!
//! **Shape of the support.** Neither (2) nor (3) is exact for linear fields: on a strained lattice and beside a surface both err by what
//! M = -sum V r (x) grad W lacks of the identity, whatever the spacing: pure strain passes for compression, and the pressures that
//! answer set the liquid ringing; waves feel it as damping. In 2D, where there is a surface, `wcsph` corrects both by
//!
//! S = det(M)^(1/D) M^-1:   drho_a/dt = sum_b m v_ab . S_a grad W,   dv_a/dt = g - sum_b m (S_a p_a / rho_a^2 + S_b p_b / rho_b^2 + Pi_ab) grad W   (6)
//!
//! with S = 1 beside solids and, gradually, in supports as poor as spray's ([`Moments::shape_correction`]). The two stay each other's adjoint (Bonet &
//! Lok 1999, Comput. Methods Appl. Mech. Eng. 180, 97-115, with M^-1 for S), so momentum and energy are kept as before. M^-1 itself would take
//! from a cluster of few particles the only word that it has of its density, how full its support is: in the splash of the 2D dam break ten and
//! more particles collapsed to a third of a spacing. det S = 1 leaves that in. Beside walls, whose pressures are not part of the adjoint, films under tension
//! gained energy with S. A step takes a quarter longer. Without and with (6):
//!
//! | | without | with |
//! |---|---|---|
//! | `standing_wave` at 0.05 m: period, damping off by | 0.8, 38 % | 0.3, 27 % |
//! | the same at 0.04 m | 1.0, 17 % | 0.3, 11 % |
//! | `stretching_drop`, its variant `regular`, at R/25: centre pressure, rms | 9 % | 1.8 % |
//! | 2D dam break at 0.01 m, six runs to 1.5 s with slightly other steps: largest energy rises | 0.2 to 7.8 % | 0.3 to 10.5 %, five of them below 0.5 % |
//!
//! In 3D, on rows as narrow as there, (6) does harm: in the dam break on a box at 0.0366 m the flood meets the front of the box at 0.425 to 0.430 instead of
//! 0.418 s (measured 0.393).
//!
//! **Smoothing length.** With h / dx = 1.2 and 1.5 in place of 2 the damping of `standing_wave` at 0.05 m is several times too strong and twice as far
//! off; a row grows with (h / dx)^D, the step with h. In 3D, where rows would be 4.6 times as long, h / dx stays 1.2 unless a case asks for more.
//!
//! **Viscosity.** alpha is there to calm particles. A laminar viscosity of the central form is an alpha of 2 (D + 2) nu / (c_0 h):
//! `wcsph` adds only what that lacks of alpha. Water as such lacks nearly all of it (1e-6 m2/s), the viscous exact cases
//! nothing or little. Added in full, alpha = 0.02 would be 3 % of the viscosity of `taylor_green` at L/50.
//!
//! The repulsion behind the wall pressure is a guard: in 4 s of the 2D dam break at a spacing of 0.01 m the pressure alone
//! lets 8 to 22 of 800 particles creep through a wall, where negative pressures thin the liquid out; with it none.
//! Shifting is off unless asked for: water at rest stays calm without it, and in the dam break it delays the front (0.328
//! instead of 0.312 s) and throws particles over the rim.
//!
//! **Acoustic damper.** A drop or column set free breathes: sound that nothing in (1)-(3) damps, on waves as long as the
//! liquid, while the viscosities act on short ones. `wcsph` gives the liquid a bulk viscosity (Sun, Pilloton, Antuono &
//! Colagrossi 2023, J. Comput. Phys. 483, 112056), which an incompressible flow does not feel:
//!
//! p_a + chi h c_0 drho_a/dt  in place of  p_a  in (3),   with drho/dt of (2)                     (5)
//!
//! It works on sound of wavelength l within some (l / h) / (20 chi) periods. `stretching_drop` at R/25 has its centre pressure off
//! by 3.0 and 1.8 % rms at chi = 0.5 and 1 (largest 7.1 and 4.2 %); its axes and the 2D dam break do not feel it.
//!
//! **Smoothed velocities** (XSPH; Monaghan 1989, J. Comput. Phys. 82, 1-15). Particles may move not with v but with
//!
//! dr_a/dt = v_a + eps sum_b m / rho_ab (v_b - v_a) W,   rho_ab = (rho_a + rho_b) / 2                (7)
//!
//! over the liquid: neighbours do not run through each other, and nothing is dissipated. Less artificial viscosity then serves, and floods are
//! in time. The plain scheme takes eps = 0.25 in 3D, with alpha = 0.03, h / dx = 1.5, a Courant number of 0.375 and the sound of Monaghan (1994), sqrt(200 g H):
//! the flood of the 3D dam break at 0.0275 m meets the box at 0.421 s (measured 0.393) and stays calm behind it. Without, at alpha = 0.1, h / dx = 1.2 and 20
//! sqrt(g H), it comes at 0.448 s.
//!
//! - eps: 0.1 brings it at 0.425 s, 0.5, that of Monaghan (1994), at 0.419 s; but continuity (2) does not know where (7) moves particles, and with 0.5 single
//!   ones meet from 1.2 to 2 s on, with pressures of 1 to 3 MPa, and fly off at 20 m/s, at half the Courant number as well. With the smoothed velocities in
//!   (2) too the 2D front is 11 ms later.
//! - h / dx = 1.2: with eps = 0.5 particles clump after the impact, the density is off by 58 % and at 0.0183 m steps shrink to a fifth. A repulsion of
//!   particles under tension (Monaghan 2000, J. Comput. Phys. 159, 290-311) ended that run at 0.7 s, out of control.
//! - Steps: with eps = 0.5 and h / dx = 1.2 the run gains 120 % of its energy in 1 s at a Courant number of 0.5, 0.8 % at 0.3; the 2D dam break at
//!   0.01 m 8.6 and 0.5 %, without (7) 0.5 % at either.
//!
//! **Position Verlet** (Parshikov et al. 2000). With one neighbour search, at the middle,
//!
//! 1. r' = r^n + dt/2 v^n,        rho' = rho^n + dt/2 D(r', v^n)
//! 2. v^(n+1) = v^n + dt a(r', rho', v^n)
//! 3. rho^(n+1) = rho' + dt/2 D(r', v^(n+1)),    r^(n+1) = r' + dt/2 v^(n+1)
//!
//! which is reversible in time but for the viscous terms; D is (2), to which step 3 adds the diffusion over dt.
//!
//! **Predictor and corrector** (Monaghan 1994). a and D, both evaluated at r', carry v and rho from n to the middle,
//! and evaluated there again from n to n+1. A scheme with levels n-1 and n+1 would save the second evaluation, but not
//! state that checkpoints and leaving particles must carry along.

use super::{
    ACCELERATION_NUMBER, Afloat, Compressibility, Fields, Params, Scheme, Stages, StepReport, VISCOUS_NUMBER,
    drift, fastest, sort,
};
use crate::Result;
use crate::bodies::Bodies;
use crate::bodies::coupling::Flow;
use crate::bodies::drag::Grip;
use crate::boundary::DummyWalls;
use crate::boundary::extrapolation::Extrapolation;
use crate::boundary::repulsion::Repulsion;
use crate::case::{DiffusionKind, Slip, Stepping};
use crate::halo::{Halo, Kinds};
use crate::kernel::LatticeSums;
use crate::neighbors::{Layout, Neighbors, Row};
use crate::operators::{Moments, Surroundings};
use crate::pair_sums::{PairSums, Window};
use crate::parallel::Ranks;
use crate::particles::{Matrix, Particles, ReorderScratch, Vector};
use crate::simd::{LANES, Lanes, dot};
use crate::terms::artificial_viscosity::ArtificialViscosity;
use crate::terms::density_diffusion::DensityDiffusion;
use crate::terms::shifting::Shifting;
use crate::terms::state_equation::Tait;
use crate::terms::surface;
use crate::terms::viscosity;
use rayon::prelude::*;
use std::ops::{Add, AddAssign};
use std::path::Path;

/// What WCSPH needs to know beyond what all schemes share; SI units.
#[derive(Debug, Clone)]
pub struct Method {
    /// Artificial speed of sound c_0 in m/s.
    pub sound_speed: f64,
    /// Coefficient alpha of the artificial viscosity.
    pub artificial_viscosity: f64,
    /// epsilon of (7); 0 leaves it out.
    pub velocity_smoothing: f64,
    /// Walls carry a pressure extrapolated from the liquid.
    pub wall_pressure: bool,
    /// The force of the first layer of walls on liquid that comes too close.
    pub repulsion: Repulsion,
    /// Form of the density diffusion.
    pub density_diffusion: DiffusionKind,
    /// Coefficient delta of the density diffusion.
    pub density_diffusion_coefficient: f64,
    /// chi of the acoustic damper; 0 leaves it out.
    pub acoustic_damper: f64,
    /// Without a surface pressure differences alone push, Eq. (4).
    pub differences_in_closed_liquid: bool,
    /// In a scene with a surface (2) and (3) are corrected for the shape of the support, Eq. (6).
    pub corrected: bool,
    /// A of the shifting; 0 leaves it out.
    pub shifting: f64,
    /// How a step is composed.
    pub stepping: Stepping,
    /// Courant number of the adaptive step.
    pub courant: f64,
}

impl Method {
    /// Largest stable time step in s at a largest speed in m/s and a largest acceleration in m/s2.
    pub fn dt_limit<const D: usize>(&self, params: &Params<D>, speed: f64, acceleration: f64) -> f64 {
        let h = params.smoothing_length();
        // What the artificial viscosity amounts to in smooth flow (Monaghan 2005).
        let artificial = self.artificial_viscosity * self.sound_speed * h / 8.0;
        let limits = [
            self.courant * params.spacing / (self.sound_speed + speed),
            ACCELERATION_NUMBER * (h / acceleration).sqrt(),
            VISCOUS_NUMBER * h * h / (params.kinematic_viscosity + artificial),
        ];
        // A limit that is not there divides by zero: infinite.
        limits.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// One line on what is in force.
    pub fn describe(&self) -> String {
        let stepping = match self.stepping {
            Stepping::Symplectic => "position Verlet",
            Stepping::PredictorCorrector => "predictor and corrector",
        };
        format!("explicit, {stepping}, speed of sound {:.2} m/s", self.sound_speed)
    }
}

/// Steps between reorderings of the fluid: often enough to keep neighbours within a few cache lines, rarely enough to
/// cost nothing.
const SORT_EVERY: u64 = 20;

/// What changes a fluid particle.
#[derive(Debug, Clone, Copy)]
struct Rates<const D: usize> {
    /// dv/dt in m/s2.
    acceleration: Vector<D>,
    /// drho/dt by Eq. (2), in kg/(m3 s).
    continuity: f64,
    /// drho/dt by diffusion, in kg/(m3 s).
    diffusion: f64,
    /// Position divergence over V, in 1/m^D: how much of the support is filled.
    filling: f64,
    /// Largest force of a wall by repulsion over the distance from it, in 1/s2.
    stiffness: f64,
}

impl<const D: usize> Default for Rates<D> {
    fn default() -> Self {
        Self { acceleration: Vector::zeros(), continuity: 0.0, diffusion: 0.0, filling: 0.0, stiffness: 0.0 }
    }
}

/// The weakly compressible scheme.
pub struct Wcsph<const D: usize> {
    params: Params<D>,
    method: Method,
    state_equation: Tait,
    ranks: Ranks,
    halo: Halo<D>,
    walls: DummyWalls<D>,
    /// Pairs of liquid once, and those of liquid and solids in the rows of both.
    neighbors: Neighbors<D>,
    /// All neighbours of liquid, where sums want them one by one.
    rows: Neighbors<D>,
    /// Liquid and wet walls.
    wet: Vec<bool>,
    /// Those that carry a pressure.
    active: Vec<bool>,
    density: Vec<f64>,
    /// p / rho^2 in m5/(kg s2).
    push: Vec<f64>,
    records: Vec<Record>,
    continuity_sums: PairSums<f64>,
    /// Of matrices, where Eq. (6) is in force.
    matrix_sums: PairSums<Lines<D>>,
    rate_sums: PairSums<Share>,
    /// Of Eq. (7).
    smoothing_sums: PairSums<Vector<D>>,
    /// All but solids without liquid neighbours.
    beside_liquid: Vec<bool>,
    rates: Vec<Rates<D>>,
    /// Velocities and densities at the beginning of the step.
    before: Vec<(Vector<D>, f64)>,
    surface: Vec<f64>,
    crowding: Vec<f64>,
    moments: Vec<Moments<D>>,
    /// S of Eq. (6); not kept up where nothing is corrected.
    shape: Vec<Matrix<D>>,
    /// Pressure gradients in Pa/m.
    slope: Vec<Vector<D>>,
    moves: Vec<(Vector<D>, Vector<D>)>,
    wall_force: Vec<Vector<D>>,
    reorder: ReorderScratch<D>,
    afloat: Afloat<D>,
    lattice: LatticeSums,
    /// sum -V F r^2 / D on the lattice.
    lattice_laplacian: f64,
    /// False in a scene without air, see [`surface`].
    has_surface: bool,
    /// Largest acceleration of the last step in m/s2.
    acceleration: f64,
    largest_variation: f64,
    /// What repulsive walls hold of this rank's liquid, in J.
    wall_potential: f64,
    steps: u64,
    stages: Stages,
}

impl<const D: usize> Wcsph<D> {
    /// Scheme for `particles`.
    pub fn new(params: Params<D>, method: Method, particles: &Particles<D>) -> Self {
        let mut neighbors = Neighbors::default();
        let lattice = params.lattice_sums();
        let walls = super::dummy_walls(&params, particles, &lattice, &mut neighbors);
        Self {
            state_equation: Tait::new(params.density, method.sound_speed),
            ranks: params.ranks,
            halo: super::halo(&params),
            walls,
            neighbors,
            rows: Neighbors::default(),
            wet: vec![],
            active: vec![],
            density: vec![],
            push: vec![],
            records: vec![],
            continuity_sums: PairSums::new(0.0),
            matrix_sums: PairSums::new(Lines([Lanes::splat(0.0); D])),
            rate_sums: PairSums::new(Share::default()),
            smoothing_sums: PairSums::new(Vector::zeros()),
            beside_liquid: vec![],
            rates: vec![],
            before: vec![],
            surface: vec![],
            crowding: vec![],
            moments: vec![],
            shape: vec![],
            slope: vec![],
            moves: vec![],
            wall_force: vec![],
            reorder: ReorderScratch::default(),
            afloat: Afloat::new(params.bodies.clone()),
            lattice,
            lattice_laplacian: lattice.laplacian,
            has_surface: true,
            acceleration: 0.0,
            largest_variation: 0.0,
            wall_potential: 0.0,
            steps: 0,
            stages: Stages::default(),
            params,
            method,
        }
    }

    /// Neighbours of liquid and of solids near it.
    fn survey(&mut self, particles: &mut Particles<D>) {
        self.afloat.survey(&self.params, particles, &self.lattice, &mut self.walls);
        self.halo.renew(particles);
        // Any liquid at all gives a solid its row. Dummies of repulsive walls do nothing, and no liquid comes near those
        // a support behind the face.
        let (walls, solids, support) = (particles.walls().end, particles.solids(), self.params.support());
        let is_near = |a: usize| self.method.wall_pressure && particles.depth[a] < support;
        let halo = &self.halo;
        let threshold = |a| match a {
            a if !halo.holds(a) => f64::INFINITY,
            a if a >= solids => f64::NEG_INFINITY,
            a if a < walls || is_near(a) => f64::MIN_POSITIVE,
            _ => f64::INFINITY,
        };
        let (kernel, h) = (self.params.kernel, self.params.smoothing_length());
        let layout = Layout::of(particles)
            .with_solids_blind_to_solids()
            .with_liquid_once()
            .with_liquid_kernel(self.method.velocity_smoothing > 0.0);
        self.neighbors.search(kernel, h, &particles.position, &layout, threshold);
        self.beside_liquid.clear();
        self.beside_liquid.resize(solids, false);
        self.neighbors.with_neighbors(solids).for_each(|w| self.beside_liquid[w] = true);
        self.halo.borrowed().for_each(|w| self.beside_liquid[w] = true);
        self.beside_liquid.resize(particles.len(), true);
    }

    /// Which walls are wet, and the moments of the liquid's supports, which do not count dry ones.
    fn mark_wet(&mut self, particles: &Particles<D>) {
        self.walls.mark_active(particles, &self.neighbors, &self.halo, &mut self.wet);
        self.active.clone_from(&self.wet);
        if !self.method.wall_pressure {
            self.active[..particles.solids()].fill(false);
            self.active[particles.solid_ghosts()].fill(false);
        }
        if self.wants_moments() {
            self.measure(particles);
        }
    }

    /// Full rows of the liquid.
    fn find_rows(&mut self, particles: &Particles<D>) {
        let first = particles.solids();
        let liquid = |a| if a < first { f64::INFINITY } else { f64::NEG_INFINITY };
        let (kernel, h) = (self.params.kernel, self.params.smoothing_length());
        let layout = Layout::of(particles).with_solids_blind_to_solids();
        self.rows.search(kernel, h, &particles.position, &layout, liquid);
    }

    fn around<'a>(&'a self, particles: &'a Particles<D>) -> Surroundings<'a, D> {
        let (neighbors, active) = (&self.rows, &self.active);
        Surroundings { position: &particles.position, neighbors, active, volume: self.params.volume() }
    }

    /// The densities that the pressures tell, by Eq. (1).
    fn densities(&mut self, particles: &Particles<D>) {
        let (count, first, state_equation) = (particles.len(), particles.solids(), self.state_equation);
        self.density.resize(count, self.params.density);
        self.push.resize(count, 0.0);
        self.rates.resize(particles.owned() - first, Rates::default());
        self.surface.resize(count, 0.0);
        self.crowding.resize(count, 1.0);
        let fluid = self.density[first..].par_iter_mut().zip(&particles.pressure[first..]).with_min_len(1024);
        fluid.for_each(|(density, pressure)| *density = state_equation.density(*pressure));
    }

    /// Pressures of liquid, by Eq. (1), and of walls.
    fn pressures(&mut self, particles: &mut Particles<D>) {
        self.halo.refresh(Kinds::Liquid, particles.originals(), &mut self.density);
        self.liquid_pressures(particles);
        if self.method.wall_pressure {
            self.wall_pressures(particles);
        }
    }

    fn liquid_pressures(&mut self, particles: &mut Particles<D>) {
        let (first, state_equation) = (particles.solids(), self.state_equation);
        let fluid = (&mut particles.pressure[first..], &mut self.push[first..], &self.density[first..]);
        fluid.into_par_iter().with_min_len(1024).for_each(|(p, push, rho)| {
            *p = state_equation.pressure(*rho);
            *push = *p / (rho * rho);
        });
        if self.method.acoustic_damper > 0.0 {
            let damper =
                self.method.acoustic_damper * self.params.smoothing_length() * self.method.sound_speed;
            let fluid = (&mut self.push[particles.fluid()], &self.density[particles.fluid()], &self.rates);
            fluid.into_par_iter().with_min_len(1024).for_each(|(push, rho, rates)| {
                *push += damper * rates.continuity / (rho * rho);
            });
            self.halo.refresh(Kinds::Liquid, particles.originals(), &mut self.push);
        }
    }

    fn wall_pressures(&mut self, particles: &mut Particles<D>) {
        let (solids, state_equation) = (particles.solids(), self.state_equation);
        let (neighbors, position, gravity) = (&self.neighbors, &particles.position, &self.params.gravity);
        let (accelerations, beside_liquid) = (&self.afloat.accelerations, &self.beside_liquid);
        let (density, push) = (&self.density, &self.push);
        let walls = particles.pressure[..solids].par_iter_mut().enumerate().with_min_len(512);
        walls.for_each(|(w, p)| {
            *p = 0.0;
            if beside_liquid[w] {
                let (r_w, mut sums) = (position[w], Extrapolation::default());
                for (f, weight, _) in neighbors.row(w).iter() {
                    let pressure = push[f] * density[f].powi(2);
                    sums.add(weight, pressure, density[f], &(r_w - position[f]));
                }
                *p = match accelerations.get(w) {
                    Some(a_w) => sums.pressure(&(gravity - a_w)),
                    None => sums.pressure(gravity),
                };
            }
        });
        self.halo.share(Kinds::Solids, particles, |particles| &mut particles.pressure);
        let of_pressure = |p: f64| p / state_equation.density(p).powi(2);
        for walls in [0..solids, particles.solid_ghosts()] {
            let (push, pressure) = (&mut self.push[walls.clone()], &particles.pressure[walls.clone()]);
            let walls = (push, pressure, &beside_liquid[walls]).into_par_iter().with_min_len(512);
            walls.for_each(|(push, p, is_beside)| *push = if *is_beside { of_pressure(*p) } else { 0.0 });
        }
    }

    /// What pair sums need of the liquid and of solids beside it, as it stands now.
    fn pack(&mut self, particles: &Particles<D>) {
        let Self { records, beside_liquid, density, push, .. } = self;
        records.resize(particles.len(), Record::default());
        let (position, velocity) = (&particles.position, &particles.velocity);
        records.par_iter_mut().enumerate().with_min_len(1024).for_each(|(a, record)| {
            if beside_liquid[a] {
                *record = Record::new(&position[a], density[a], &velocity[a], push[a]);
            }
        });
    }

    /// drho/dt by Eq. (2) alone, of what was packed last, and rho += dt drho/dt.
    fn continuity(&mut self, particles: &Particles<D>, dt: f64) {
        let is_corrected = self.is_corrected();
        let (fluid, mass, wall_pressure) = (particles.fluid(), self.params.mass(), self.method.wall_pressure);
        let first = fluid.start;
        let Self { neighbors, records, continuity_sums, matrix_sums, shape, density, rates, .. } = self;
        let near = Near { neighbors, records };
        let of_liquid: &(dyn Fn(usize) -> f64 + Sync) = if is_corrected {
            // sum_b v_ab . S grad W is the trace of S sum_b grad W (x) v_ab.
            let sums = matrix_sums.collect(neighbors, |a, window| {
                near.add_matrices(a, |pair| pair.v, window);
            });
            &|k| (shape[first + k] * sums[k].matrix()).trace()
        } else {
            let sums = continuity_sums.collect(neighbors, |a, window| {
                let mut own = Lanes::splat(0.0);
                for (index, pair, f) in near.liquid(a) {
                    let share = f * dot(&pair.v, &pair.r);
                    own += share;
                    index.iter().zip(share.to_array()).for_each(|(b, share)| window.add(*b as usize, share));
                }
                window.add(a, own.reduce_add());
            });
            &|k| sums[k]
        };
        (&mut density[fluid], rates).into_par_iter().enumerate().with_min_len(256).for_each(
            |(k, (density, rates))| {
                rates.continuity = of_liquid(k);
                if wall_pressure {
                    let of_pairs = near.solids(first + k).map(|(_, pair, f)| f * dot(&pair.v, &pair.r));
                    rates.continuity +=
                        of_pairs.fold(Lanes::splat(0.0), |sum, share| sum + share).reduce_add();
                }
                rates.continuity *= mass;
                *density += dt * rates.continuity;
            },
        );
    }

    /// dv/dt and drho/dt of the liquid, and its surface.
    fn rates(&mut self, particles: &Particles<D>) {
        let pressure = &particles.pressure;
        let difference = |a: usize, index: &[u32; LANES]| {
            Lanes::new(index.map(|b| pressure[b as usize])) - Lanes::splat(pressure[a])
        };
        match self.method.density_diffusion {
            DiffusionKind::None => self.sum_rates(particles, |_, _, _, _| Lanes::splat(0.0)),
            DiffusionKind::MolteniColagrossi => {
                self.sum_rates(particles, |_, a, index, _| difference(a, index));
            }
            DiffusionKind::Fourtakas => {
                let gravity = std::array::from_fn(|d| Lanes::splat(0.5 * self.params.gravity[d]));
                self.sum_rates(particles, |scheme, a, index, pair| {
                    let density = pair.density + Lanes::splat(scheme.density[a]);
                    difference(a, index) + density * dot(&gravity, &pair.r)
                });
            }
            DiffusionKind::Antuono => {
                self.slopes(particles);
                self.sum_rates(particles, |scheme, a, index, pair| {
                    let slope = |d: usize| {
                        let others = index.map(|b| 0.5 * scheme.slope[b as usize][d]);
                        Lanes::new(others) + Lanes::splat(0.5 * scheme.slope[a][d])
                    };
                    difference(a, index) + dot(&std::array::from_fn(slope), &pair.r)
                });
            }
        }
    }

    /// `excess(self, a, numbers, pairs)` is the pressure difference in Pa that diffusion smooths out, of a block of pairs.
    fn sum_rates(
        &mut self,
        particles: &Particles<D>,
        excess: impl Fn(&Self, usize, &[u32; LANES], &Block<D>) -> Lanes + Sync,
    ) {
        self.pack(particles);
        let (mut rates, mut surface) = (std::mem::take(&mut self.rates), std::mem::take(&mut self.surface));
        let mut rate_sums = std::mem::replace(&mut self.rate_sums, PairSums::new(Share::default()));
        let (first, walls) = (particles.solids(), particles.walls().end);
        let pairs = self.pairs();
        let form = (self.is_corrected(), self.takes_differences());
        let sums = rate_sums.collect(&self.neighbors, |a, window| match form {
            (true, _) => pairs.add_liquid::<D, CORRECTED>(self, a, &excess, window),
            (false, true) => pairs.add_liquid::<D, DIFFERENCES>(self, a, &excess, window),
            (false, false) => pairs.add_liquid::<D, SUMS>(self, a, &excess, window),
        });
        (&mut rates, &mut surface[particles.fluid()], sums)
            .into_par_iter()
            .enumerate()
            .with_min_len(256)
            .for_each(|(k, (rates, surface, sums))| {
                let a = first + k;
                *rates = pairs.rates(sums, self.params.gravity);
                if self.method.wall_pressure {
                    pairs.add_walls(self, particles, a, rates);
                }
                let (r_a, solid) = (particles.position[a], self.neighbors.row(a).split().1);
                for (b, _, f) in solid.iter() {
                    let r_ab = r_a - particles.position[b];
                    rates.filling -= if self.wet[b] { f * r_ab.norm_squared() } else { 0.0 };
                    let original = particles.original(b);
                    if original < walls {
                        let push = self.method.repulsion.of(&r_ab, particles.flat_normal(original));
                        let work = push.dot(&r_ab);
                        if work > 0.0 {
                            rates.stiffness = rates.stiffness.max(push.norm_squared() / work);
                        }
                        rates.acceleration += push;
                    }
                }
                *surface = surface::weight_at::<D>(self.params.volume() * rates.filling);
            });
        (self.rates, self.surface, self.rate_sums) = (rates, surface, rate_sums);
    }

    /// Whether Eq. (4) takes the place of (3): no surface tells the pressure's level.
    fn takes_differences(&self) -> bool {
        !self.has_surface && self.method.differences_in_closed_liquid
    }

    fn pairs(&self) -> Pairs {
        let Method { sound_speed, artificial_viscosity, density_diffusion_coefficient, .. } = self.method;
        let h = self.params.smoothing_length();
        // Of the two forms in [`viscosity`] the one for this scene; the lattice's factor is the same.
        let laminar = self.params.kinematic_viscosity / self.lattice_laplacian;
        Pairs {
            mass: self.params.mass(),
            volume: self.params.volume(),
            laminar: if self.has_surface { 0.0 } else { 2.0 * laminar / self.params.density },
            viscosity: ArtificialViscosity::new(artificial_viscosity, sound_speed, h)
                .with_laminar(if self.has_surface { 2.0 * (D + 2) as f64 * laminar } else { 0.0 }),
            diffusion: DensityDiffusion::new(density_diffusion_coefficient, h, sound_speed),
            slip: self.params.slip,
        }
    }

    fn near(&self) -> Near<'_, D> {
        Near { neighbors: &self.neighbors, records: &self.records }
    }

    fn is_corrected(&self) -> bool {
        self.method.corrected && self.has_surface
    }

    fn wants_moments(&self) -> bool {
        self.method.shifting > 0.0 || self.method.density_diffusion == DiffusionKind::Antuono
    }

    /// Rows and corrections that the step needs, where it takes place.
    fn assess(&mut self, particles: &Particles<D>) {
        if self.wants_moments() {
            self.find_rows(particles);
        }
        self.pack(particles);
        if self.is_corrected() {
            self.shape(particles);
        }
    }

    /// S of Eq. (6), the identity beside solids.
    fn shape(&mut self, particles: &Particles<D>) {
        let (first, volume) = (particles.solids(), self.params.volume());
        let Self { neighbors, records, matrix_sums, shape, .. } = self;
        let near = Near { neighbors, records };
        let sums = matrix_sums.collect(neighbors, |a, window| {
            near.add_matrices(a, |pair| pair.r, window);
        });
        shape.resize(particles.len(), Matrix::identity());
        let fluid = (&mut shape[particles.fluid()], sums).into_par_iter().enumerate().with_min_len(256);
        fluid.for_each(|(k, (shape, sum))| {
            *shape = match neighbors.has_solids(first + k) {
                true => Matrix::identity(),
                false => Moments { matrix: -volume * sum.matrix(), ..Moments::default() }.shape_correction(),
            };
        });
        self.halo.refresh(Kinds::Liquid, particles.originals(), shape);
    }

    /// Moments of the support of all liquid.
    fn measure(&mut self, particles: &Particles<D>) {
        let (mut moments, first) = (std::mem::take(&mut self.moments), particles.solids());
        moments.resize(particles.len(), Moments::default());
        let surroundings = self.around(particles);
        let fluid = moments[particles.fluid()].par_iter_mut().enumerate().with_min_len(256);
        fluid.for_each(|(k, moments)| *moments = surroundings.moments(first + k));
        self.moments = moments;
    }

    /// Exact pressure gradients; where the support is too one-sided for one, the hydrostatic gradient.
    fn slopes(&mut self, particles: &Particles<D>) {
        let (mut slope, first) = (std::mem::take(&mut self.slope), particles.solids());
        slope.resize(particles.len(), Vector::zeros());
        let hydrostatic = self.params.density * self.params.gravity;
        let (surroundings, moments) = (self.around(particles), &self.moments);
        slope[particles.fluid()].par_iter_mut().enumerate().with_min_len(256).for_each(|(k, slope)| {
            let a = first + k;
            *slope = match moments[a].correction() {
                Some(b) => b * surroundings.difference_gradient(a, &particles.pressure),
                None => hydrostatic,
            };
        });
        self.halo.refresh(Kinds::Liquid, particles.originals(), &mut slope);
        self.slope = slope;
    }

    /// v += dt dv/dt.
    fn kick(&mut self, particles: &mut Particles<D>, dt: f64) {
        let first = particles.solids();
        let fluid = particles.velocity[first..].par_iter_mut().zip(&self.rates).with_min_len(1024);
        fluid.for_each(|(v, rates)| *v += dt * rates.acceleration);
        self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.velocity);
    }

    fn diffuse(&mut self, particles: &Particles<D>, dt: f64) {
        let fluid = self.density[particles.solids()..].par_iter_mut().zip(&self.rates).with_min_len(1024);
        fluid.for_each(|(density, rates)| *density += dt * rates.diffusion);
    }

    /// Velocities and densities `dt` after the beginning of the step.
    fn advance(&mut self, particles: &mut Particles<D>, dt: f64) {
        let first = particles.solids();
        let fluid = (&mut particles.velocity[first..], &mut self.density[first..], &self.before, &self.rates);
        fluid.into_par_iter().with_min_len(1024).for_each(|(v, density, before, rates)| {
            *v = before.0 + dt * rates.acceleration;
            *density = before.1 + dt * (rates.continuity + rates.diffusion);
        });
        self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.velocity);
    }

    /// Position Verlet; see the module.
    fn symplectic(&mut self, particles: &mut Particles<D>, dt: f64, watch: &mut Stages) {
        watch.time("continuity", || self.continuity(particles, 0.5 * dt));
        watch.time("pressure", || {
            // Not before: here ranks wait for each other anyway.
            self.mark_wet(particles);
            self.pressures(particles);
        });
        watch.time("rates", || self.rates(particles));
        self.kick(particles, dt);
        self.move_bodies(particles, dt);
        watch.time("continuity", || {
            self.pack(particles);
            self.continuity(particles, 0.5 * dt);
        });
        self.diffuse(particles, dt);
    }

    /// Predictor and corrector; see the module.
    fn predict_and_correct(&mut self, particles: &mut Particles<D>, dt: f64, watch: &mut Stages) {
        let fluid = particles.fluid();
        self.before.clear();
        let now = particles.velocity[fluid.clone()].iter().zip(&self.density[fluid]);
        self.before.extend(now.map(|(v, density)| (*v, *density)));
        watch.time("pressure", || self.mark_wet(particles));
        for reach in [0.5 * dt, dt] {
            if self.method.acoustic_damper > 0.0 {
                watch.time("continuity", || {
                    self.pack(particles);
                    self.continuity(particles, 0.0);
                });
            }
            watch.time("pressure", || self.pressures(particles));
            watch.time("rates", || self.rates(particles));
            self.advance(particles, reach);
        }
        self.move_bodies(particles, dt);
    }

    /// New velocities of bodies, from the forces in the middle of the step.
    fn move_bodies(&mut self, particles: &mut Particles<D>, dt: f64) {
        if self.afloat.bodies.is_empty() {
            return;
        }
        self.push_walls(particles);
        self.drag(particles);
        let flow = Flow {
            particles,
            active: &self.active,
            halo: &self.halo,
            gravity: self.params.gravity,
            density: self.params.density,
            accelerations: &self.afloat.accelerations,
            pressure: self.method.wall_pressure,
            repulsion: &self.wall_force,
            clip: false,
            response: None,
        };
        self.afloat.bodies.advance(&flow, dt);
        self.afloat.bodies.place(particles, true);
    }

    /// Lets bodies feel what viscosity did to the liquid in the last [`rates`](Self::rates).
    fn drag(&mut self, particles: &Particles<D>) {
        if self.params.slip != Slip::None || !self.method.wall_pressure {
            return;
        }
        let terms = self.pairs();
        let Self { neighbors, records, density, afloat: Afloat { bodies, .. }, .. } = &*self;
        let grips = bodies.beside_liquid(particles, neighbors).flat_map(|(body, (a, b, f))| {
            let [v_a, v_b] = [a, b].map(|a| records[a].velocity());
            terms.grips(particles, (body, a, b), f, (v_a, v_a - v_b), density[a])
        });
        self.afloat.bodies.drags = bodies.drag(particles, self.params.mass(), &self.ranks, grips);
    }

    fn shift(&mut self, particles: &mut Particles<D>, dt: f64) {
        self.halo.refresh(Kinds::Liquid, particles.originals(), &mut self.surface);
        self.halo.refresh(Kinds::Liquid, particles.originals(), &mut self.moments);
        let Params { spacing, gravity, .. } = self.params;
        let h = self.params.smoothing_length();
        let shifting = Shifting::new(self.method.shifting, h, spacing, gravity.norm(), dt);
        let mut moves = std::mem::take(&mut self.moves);
        shifting.compute(&self.around(particles), particles, &self.moments, &self.surface, &mut moves);
        Shifting::apply(particles, &moves);
        self.halo.place(particles);
        self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.velocity);
        self.moves = moves;
    }

    /// Liquid moves on with the smoothed velocity, Eq. (7).
    fn smooth(&mut self, particles: &mut Particles<D>, dt: f64) {
        self.halo.refresh(Kinds::Liquid, particles.originals(), &mut self.density);
        let share = 2.0 * self.method.velocity_smoothing * self.params.mass() * dt;
        let Self { neighbors, density, smoothing_sums, .. } = self;
        let velocity = &particles.velocity;
        let sums = smoothing_sums.collect(neighbors, |a, window| {
            let mut own = Vector::zeros();
            for (b, w, _) in neighbors.row(a).split().0.iter() {
                let pull = w / (density[a] + density[b]) * (velocity[b] - velocity[a]);
                own += pull;
                window.add(b, -pull);
            }
            window.add(a, own);
        });
        let fluid = particles.fluid();
        let each = particles.position[fluid].par_iter_mut().zip(sums).with_min_len(1024);
        each.for_each(|(r, sum)| *r += share * sum);
        self.halo.place(particles);
    }

    /// The pressures that belong to the final densities, and what the step found out.
    fn conclude(&mut self, particles: &mut Particles<D>) {
        let (first, state_equation) = (particles.solids(), self.state_equation);
        let (h, rest) = (self.params.smoothing_length(), self.params.density);
        let fluid = (&mut particles.pressure[first..], &mut self.crowding[first..], &self.density[first..]);
        let fluid = fluid.into_par_iter().zip(&self.rates).with_min_len(1024);
        let each = fluid.map(|((p, crowding, density), rates)| {
            *p = state_equation.pressure(*density);
            *crowding = density / rest;
            // Near a wall forces change over the distance from it, not over h.
            let near_wall = h * rates.stiffness;
            ((*crowding - 1.0).abs(), rates.acceleration.norm_squared().max(near_wall * near_wall))
        });
        let (variation, mut acceleration) = each.reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)));
        self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.pressure);
        // A light body answers to the push of one particle with a multiple of that particle's acceleration.
        if !self.afloat.bodies.is_empty() {
            let Afloat { bodies, accelerations, .. } = &mut self.afloat;
            bodies.accelerations(particles, false, accelerations);
            let solids = accelerations.iter().map(|a| a.norm_squared());
            acceleration = solids.fold(acceleration, f64::max);
        }
        self.acceleration = self.ranks.max(acceleration.sqrt());
        self.largest_variation = self.ranks.max(variation).max(self.largest_variation);
        self.wall_potential = self.potential_at_walls(particles);
    }

    /// Energy in J of this rank's liquid near repulsive walls. One after the other: sums must not depend on the threads.
    fn potential_at_walls(&self, particles: &Particles<D>) -> f64 {
        let (walls, position, repulsion) =
            (particles.walls().end, &particles.position, self.method.repulsion);
        let of_pair = |a: usize, b: usize| match particles.original(b) {
            w if w < walls => repulsion.potential(&(position[a] - position[b]), particles.flat_normal(w)),
            _ => 0.0,
        };
        let of = |a: usize| {
            let solid = self.neighbors.row(a).split().1;
            solid.iter().map(|(b, ..)| of_pair(a, b)).sum::<f64>()
        };
        // Most liquid has none: their rows need not be looked at.
        let beside_solids = particles.fluid().filter(|a| self.neighbors.has_solids(*a));
        self.params.mass() * beside_solids.map(of).sum::<f64>()
    }

    /// Bodies in the middle of the step. Dummies feel prescribed accelerations only: from the last step's, a body lighter than the
    /// liquid within a spacing of it would get a force of the wrong sign and more of it, whatever the step.
    fn depart(&mut self, particles: &mut Particles<D>, dt: f64) {
        self.afloat.depart(&self.params, particles, &mut self.walls, (dt, 0.0), true);
    }

    /// The reaction to repulsive walls.
    fn push_walls(&mut self, particles: &Particles<D>) {
        let (mass, repulsion) = (self.params.mass(), self.method.repulsion);
        let (neighbors, position) = (&self.neighbors, &particles.position);
        self.wall_force.resize(particles.walls().len(), Vector::zeros());
        self.wall_force.par_iter_mut().enumerate().with_min_len(512).for_each(|(w, force)| {
            let liquid = neighbors.row(w).index.iter().map(|&f| f as usize);
            let push = |f: usize| repulsion.of(&(position[f] - position[w]), particles.flat_normal(w));
            *force = -mass * liquid.map(push).sum::<Vector<D>>();
        });
    }
}

/// What pair sums need of a particle, in one line of the cache.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
struct Record {
    /// r, in 2D filled up with a zero, and rho.
    place: Lanes,
    /// v likewise, and p / rho^2.
    motion: Lanes,
}

impl Record {
    fn new<const D: usize>(r: &Vector<D>, density: f64, v: &Vector<D>, push: f64) -> Self {
        let with = |vector: &Vector<D>, last: f64| {
            let mut lanes = [0.0; LANES];
            lanes[..D].copy_from_slice(vector.as_slice());
            lanes[LANES - 1] = last;
            Lanes::new(lanes)
        };
        Self { place: with(r, density), motion: with(v, push) }
    }

    fn velocity<const D: usize>(&self) -> Vector<D> {
        Vector::from_column_slice(&self.motion.to_array()[..D])
    }
}

/// A particle `a` and its neighbours `b` of a block.
struct Block<const D: usize> {
    /// r_ab in m.
    r: [Lanes; D],
    /// v_ab in m/s.
    v: [Lanes; D],
    /// rho_b.
    density: Lanes,
    /// p_b / rho_b^2.
    push: Lanes,
}

impl<const D: usize> Block<D> {
    #[inline]
    fn new(records: &[Record], a: usize, index: &[u32; LANES]) -> Self {
        let (own, others) = (&records[a], index.map(|b| &records[b as usize]));
        let [place, motion] = [others.map(|b| b.place), others.map(|b| b.motion)].map(Lanes::transpose);
        let (r, v) = (own.place.to_array(), own.motion.to_array());
        Self {
            r: std::array::from_fn(|d| Lanes::splat(r[d]) - place[d]),
            v: std::array::from_fn(|d| Lanes::splat(v[d]) - motion[d]),
            density: place[LANES - 1],
            push: motion[LANES - 1],
        }
    }
}

/// Pairs by blocks, as (b, what sums need of them, F_ab); the last block of a row is filled up with pairs of F = 0.
#[derive(Clone, Copy)]
struct Near<'a, const D: usize> {
    neighbors: &'a Neighbors<D>,
    records: &'a [Record],
}

impl<'a, const D: usize> Near<'a, D> {
    /// Of liquid in the row of `a`: each pair once.
    #[inline]
    fn liquid(self, a: usize) -> impl Iterator<Item = ([u32; LANES], Block<D>, Lanes)> + 'a {
        self.blocks(a, self.neighbors.row(a).split().0)
    }

    /// Of solids around `a`.
    #[inline]
    fn solids(self, a: usize) -> impl Iterator<Item = ([u32; LANES], Block<D>, Lanes)> + 'a {
        self.blocks(a, self.neighbors.row(a).split().1)
    }

    #[inline]
    fn blocks(self, a: usize, row: Row<'a>) -> impl Iterator<Item = ([u32; LANES], Block<D>, Lanes)> + 'a {
        row.blocks().map(move |(index, f)| (index, Block::new(self.records, a, &index), f))
    }

    /// Adds F r_ab (x) q_ab of the pairs of liquid in the row of `a` to both.
    #[inline]
    fn add_matrices(self, a: usize, q: impl Fn(&Block<D>) -> [Lanes; D], window: &mut Window<Lines<D>>) {
        let mut own = [[Lanes::splat(0.0); LANES]; D];
        for (index, pair, f) in self.liquid(a) {
            let q = q(&pair);
            let mut shares = [[Lanes::splat(0.0); LANES]; D];
            for d in 0..D {
                let r = f * pair.r[d];
                for e in 0..D {
                    shares[d][e] = r * q[e];
                    own[d][e] += shares[d][e];
                }
                shares[d] = Lanes::transpose(shares[d]);
            }
            for (k, b) in index.into_iter().enumerate() {
                window.add(b as usize, Lines(std::array::from_fn(|d| shares[d][k])));
            }
        }
        let sum =
            |lanes: [Lanes; LANES]| Lanes::transpose(lanes).into_iter().fold(Lanes::splat(0.0), Lanes::add);
        window.add(a, Lines(own.map(sum)));
    }
}

/// The rows of a matrix, filled up with zeros.
#[derive(Debug, Clone, Copy)]
struct Lines<const D: usize>([Lanes; D]);

impl<const D: usize> Lines<D> {
    fn matrix(&self) -> Matrix<D> {
        Matrix::from_fn(|d, e| self.0[d].to_array()[e])
    }
}

impl<const D: usize> AddAssign for Lines<D> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        for d in 0..D {
            self.0[d] += other.0[d];
        }
    }
}

/// What pairs give to a particle.
#[derive(Debug, Clone, Copy, Default)]
struct Share {
    /// dv/dt over the mass of a particle, in 2D filled up with a zero, and the sum for the diffusion.
    motion: Lanes,
    /// drho/dt by (2) over that mass, and the filling.
    density: [f64; 2],
}

impl AddAssign for Share {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.motion += other.motion;
        self.density[0] += other.density[0];
        self.density[1] += other.density[1];
    }
}

/// Shares by quantity: of the pairs of a block, or what a row adds up to, each lane every fourth pair.
#[derive(Clone, Copy)]
struct Shares<const D: usize> {
    force: [Lanes; D],
    diffusion: Lanes,
    continuity: Lanes,
    filling: Lanes,
}

impl<const D: usize> Default for Shares<D> {
    fn default() -> Self {
        let zero = Lanes::splat(0.0);
        Self { force: [zero; D], diffusion: zero, continuity: zero, filling: zero }
    }
}

impl<const D: usize> Shares<D> {
    #[inline]
    fn add(&mut self, other: &Self) {
        self.force.iter_mut().zip(other.force).for_each(|(sum, share)| *sum += share);
        self.diffusion += other.diffusion;
        self.continuity += other.continuity;
        self.filling += other.filling;
    }

    /// By pair.
    #[inline]
    fn each(&self) -> [Share; LANES] {
        let mut motion = [Lanes::splat(0.0); LANES];
        motion[..D].copy_from_slice(&self.force);
        motion[LANES - 1] = self.diffusion;
        let motion = Lanes::transpose(motion);
        let [continuity, filling] = [self.continuity, self.filling].map(Lanes::to_array);
        std::array::from_fn(|k| Share { motion: motion[k], density: [continuity[k], filling[k]] })
    }

    fn sum(&self) -> Share {
        let [mut sum, others @ ..] = self.each();
        others.into_iter().for_each(|share| sum += share);
        sum
    }
}

/// How pressures push: Eqs. (3), (4) and (6).
const SUMS: u8 = 0;
const DIFFERENCES: u8 = 1;
const CORRECTED: u8 = 2;

/// The constants of pair sums.
struct Pairs {
    mass: f64,
    volume: f64,
    /// 2 nu V / m of the two-point form over the lattice's factor.
    laminar: f64,
    /// The artificial viscosity, and the laminar one of the central form.
    viscosity: ArtificialViscosity,
    diffusion: DensityDiffusion,
    slip: Slip,
}

impl Pairs {
    /// What the shares of all liquid amount to, beside the `gravity`.
    fn rates<const D: usize>(&self, shares: &Share, gravity: Vector<D>) -> Rates<D> {
        let (motion, [continuity, filling]) = (shares.motion.to_array(), shares.density);
        Rates {
            acceleration: gravity + self.mass * Vector::from_fn(|d, _| motion[d]),
            continuity: self.mass * continuity,
            diffusion: self.diffusion.of(self.volume * motion[LANES - 1]),
            filling,
            stiffness: 0.0,
        }
    }

    /// Eq. (2) and (3), (4) or (6) of the pairs of liquid in the row of `a`, to both.
    #[inline]
    fn add_liquid<const D: usize, const FORM: u8>(
        &self,
        scheme: &Wcsph<D>,
        a: usize,
        excess: &impl Fn(&Wcsph<D>, usize, &[u32; LANES], &Block<D>) -> Lanes,
        window: &mut Window<Share>,
    ) {
        let (push_a, density_a) = (Lanes::splat(scheme.push[a]), Lanes::splat(scheme.density[a]));
        let stress_a = if FORM == CORRECTED { scheme.push[a] * scheme.shape[a] } else { Matrix::zeros() };
        let mut own = Shares::<D>::default();
        for (index, pair, f) in scheme.near().liquid(a) {
            let (approach, square) = (dot(&pair.v, &pair.r), dot(&pair.r, &pair.r));
            let viscous = self.viscosity.of(approach, square, 0.5 * (density_a + pair.density));
            let central = match FORM {
                SUMS => push_a + pair.push + viscous,
                DIFFERENCES => pair.push - push_a + viscous,
                _ => viscous,
            };
            let diffusion = f * excess(scheme, a, &index, &pair);
            let mut to_a =
                Shares { diffusion, continuity: f * approach, filling: -f * square, ..Shares::default() };
            for d in 0..D {
                let mut push = central * pair.r[d];
                if FORM == CORRECTED {
                    // (push_a S_a + push_b S_b) r, the part (6) has for the pressures of (3).
                    for e in 0..D {
                        let others = Lanes::new(index.map(|b| scheme.shape[b as usize][(d, e)]));
                        let stress = Lanes::splat(stress_a[(d, e)]) + pair.push * others;
                        push = stress.mul_add(pair.r[e], push);
                    }
                }
                to_a.force[d] = f * (self.laminar * pair.v[d] - push);
            }
            own.add(&to_a);
            let mut to_b = Shares { force: to_a.force.map(|f| -f), diffusion: -diffusion, ..to_a };
            if FORM == DIFFERENCES {
                // The pressures push both the same way.
                let pushes = 2.0 * (push_a - pair.push) * f;
                to_b.force.iter_mut().zip(pair.r).for_each(|(force, r)| *force += pushes * r);
            }
            for (b, share) in index.into_iter().zip(to_b.each()) {
                window.add(b as usize, share);
            }
        }
        window.add(a, own.sum());
    }

    /// What viscosity does to liquid `a` at solid `b` of `body`, as [`add_walls`](Self::add_walls) has it: along the line between them, and in the
    /// direction of v_ab.
    fn grips<const D: usize>(
        &self,
        particles: &Particles<D>,
        (body, a, b): (usize, usize, usize),
        f: f64,
        (velocity, v_ab): (Vector<D>, Vector<D>),
        density_a: f64,
    ) -> [Grip<D>; 2] {
        let r_ab = particles.position[a] - particles.position[b];
        let wall = viscosity::wall_factor(particles, particles.original(b), &r_ab, self.slip);
        let square = r_ab.norm_squared();
        let along = square * self.viscosity.rate(v_ab.dot(&r_ab) < 0.0, square, density_a);
        let grip =
            |rate: f64, line| Grip { solid: b, body, velocity, rate: self.mass * f * wall * rate, line };
        [grip(along, Some(r_ab / square.sqrt())), grip(self.laminar, None)]
    }

    /// Eqs. (2) and (3) over walls that carry a pressure; where liquid slips, they exert no viscous force.
    #[inline]
    fn add_walls<const D: usize>(
        &self,
        scheme: &Wcsph<D>,
        particles: &Particles<D>,
        a: usize,
        rates: &mut Rates<D>,
    ) {
        let (r_a, density_a) = (particles.position[a], scheme.density[a]);
        let push_a = if scheme.takes_differences() { -scheme.push[a] } else { scheme.push[a] };
        let tension = scheme.has_surface && push_a < 0.0;
        let mut force = [Lanes::splat(0.0); D];
        let mut continuity = Lanes::splat(0.0);
        for (index, pair, f) in scheme.near().solids(a) {
            let original = index.map(|b| particles.original(b as usize));
            let of_wall = |k: usize| {
                let r_ab = r_a - particles.position[index[k] as usize];
                viscosity::wall_factor(particles, original[k], &r_ab, self.slip)
            };
            let wall = Lanes::new(std::array::from_fn(of_wall));
            // Walls of bodies have no pressure where liquid is under tension, so it does not pull the body. Nor may the body pull it:
            // the two would run away, the liquid drawn to the body and the body driven by its repulsion.
            let is_pulled = |w: usize| tension && scheme.afloat.bodies.free(w).is_some();
            let own = Lanes::new(original.map(|w| if is_pulled(w) { 0.0 } else { push_a }));
            let (approach, square) = (dot(&pair.v, &pair.r), dot(&pair.r, &pair.r));
            let viscous = self.viscosity.of(wall * approach, square, Lanes::splat(density_a));
            let push = own + pair.push + viscous;
            for (force, (v, r)) in force.iter_mut().zip(pair.v.into_iter().zip(pair.r)) {
                *force += f * (self.laminar * wall * v - push * r);
            }
            continuity += f * approach;
        }
        rates.acceleration += self.mass * Vector::from_fn(|d, _| force[d].reduce_add());
        rates.continuity += self.mass * continuity.reduce_add();
    }
}

/// Hydrostatic pressure, in Pa, of each piece of liquid under its own top: a particle carries the weight of the column
/// of particles on it, and half a spacing on top of the highest. Where columns of different height meet, the flow
/// starts with that difference, as when a gate is drawn at once. A column that ends below a solid has no top of its own: its
/// particles take the highest level that those beside them have. Ghosts keep theirs. `roofed` tells the particles of such columns, one
/// entry a particle. Returns whether anything changed.
fn hydrostatic<const D: usize>(
    particles: &mut Particles<D>,
    neighbors: &Neighbors<D>,
    params: &Params<D>,
    roofed: &mut [bool],
) -> bool {
    let weight = params.density * params.gravity;
    let Some(down) = weight.try_normalize(0.0) else { return false };
    let spacing = params.spacing;
    // Levels closer than this are one: rounding must not raise them without end.
    let close = 1e-6 * spacing * weight.norm();
    let mut order: Vec<usize> = particles.fluid().collect();
    let position = &particles.position;
    let mut changed = false;
    order.sort_by(|&a, &b| down.dot(&position[a]).total_cmp(&down.dot(&position[b])));
    for a in order {
        let (liquid, solid) = neighbors.row(a).split();
        let away = |b: usize| {
            let below = (position[a] - position[b]).dot(&down);
            (below, (position[a] - position[b] - below * down).norm())
        };
        // The one particle on top, disordered by less than half a spacing; a solid may be off the lattice by that.
        let is_on_top = |b: usize, width: f64| {
            let (below, aside) = away(b);
            below > 0.5 * spacing && below < 1.5 * spacing && aside < width * spacing
        };
        let level =
            |b: usize| particles.pressure[particles.original(b)] + weight.dot(&(position[a] - position[b]));
        let tops = || liquid.iter().map(|(b, ..)| b).filter(|&b| is_on_top(b, 0.5));
        let mut pressure = tops().map(level).fold(0.5 * spacing * weight.norm(), f64::max);
        let roof = match tops().next() {
            Some(_) => tops().any(|b| roofed[particles.original(b)]),
            None => solid.iter().any(|(b, ..)| is_on_top(b, 0.75)),
        };
        if roof {
            let beside = liquid.iter().map(|(b, ..)| b);
            let touching = beside.filter(|&b| (position[a] - position[b]).norm() < 1.5 * spacing);
            pressure = touching.map(level).fold(pressure, f64::max);
        }
        let before = (particles.pressure[a], roofed[a]);
        if (pressure - before.0).abs() > close || roof != before.1 {
            (particles.pressure[a], roofed[a], changed) = (pressure, roof, true);
        }
    }
    changed
}

impl<const D: usize> Scheme<D> for Wcsph<D> {
    fn step(&mut self, particles: &mut Particles<D>, dt: f64) -> Result<StepReport> {
        let mut watch = std::mem::take(&mut self.stages);
        watch.time("neighbours", || {
            match self.steps.is_multiple_of(SORT_EVERY) {
                true => sort(particles, &mut self.neighbors, self.params.support(), &mut self.reorder),
                false => particles.drop_ghosts(),
            }
            drift(particles, 0.5 * dt);
            self.depart(particles, dt);
            self.survey(particles);
            self.densities(particles);
            self.assess(particles);
        });
        match self.method.stepping {
            Stepping::Symplectic => self.symplectic(particles, dt, &mut watch),
            Stepping::PredictorCorrector => self.predict_and_correct(particles, dt, &mut watch),
        }
        self.push_walls(particles);
        if self.method.shifting > 0.0 {
            watch.time("shift", || self.shift(particles, dt));
        }
        if self.method.velocity_smoothing > 0.0 {
            watch.time("shift", || self.smooth(particles, dt));
        }
        drift(particles, 0.5 * dt);
        self.afloat.arrive(particles, dt);
        self.conclude(particles);
        self.halo.book(watch.take_work());
        self.stages = watch;
        self.steps += 1;
        Ok(StepReport::default())
    }

    fn start(&mut self, particles: &mut Particles<D>) -> Result<()> {
        self.survey(particles);
        // Columns may lean over to other ranks and back.
        if self.params.gravity.norm() > 0.0 {
            let fluid = particles.fluid();
            particles.pressure[fluid].fill(0.0);
        }
        let mut roofed = vec![false; particles.len()];
        self.find_rows(particles);
        let rows = std::mem::take(&mut self.rows);
        while self.ranks.any(hydrostatic(particles, &rows, &self.params, &mut roofed)) {
            self.halo.share(Kinds::Liquid, particles, |particles| &mut particles.pressure);
            self.halo.refresh(Kinds::Liquid, particles.originals(), &mut roofed);
        }
        drop(rows);
        self.densities(particles);
        self.assess(particles);
        self.mark_wet(particles);
        self.pressures(particles);
        self.rates(particles);
        self.has_surface = self.ranks.max(self.surface.iter().copied().fold(0.0, f64::max)) > 0.0;
        self.push_walls(particles);
        self.conclude(particles);
        Ok(())
    }

    fn state(&self) -> Vec<f64> {
        let has_surface = f64::from(u8::from(self.has_surface));
        vec![self.acceleration, self.largest_variation, self.steps as f64, has_surface]
    }

    fn set_state(&mut self, state: &[f64]) -> Option<()> {
        let &[acceleration, largest_variation, steps, has_surface] = state else { return None };
        (self.acceleration, self.largest_variation) = (acceleration, largest_variation);
        (self.steps, self.has_surface) = (steps as u64, has_surface == 1.0);
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
            active: &self.active,
            walls_carry_pressure: self.method.wall_pressure,
            wall_force: &self.wall_force,
        }
    }

    fn save_system(&self, _: &Path, _: &str) -> Result<()> {
        Ok(())
    }

    fn compressibility(&self) -> Option<Compressibility> {
        let Self { largest_variation, wall_potential, .. } = *self;
        Some(Compressibility { sound_speed: self.method.sound_speed, largest_variation, wall_potential })
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
