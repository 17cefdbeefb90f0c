//! Particle shifting: small moves down the gradient of the particle concentration, which keep the spacing even.
//!
//! dr = -A h u dt grad C,   grad C = sum_b V grad W   (Skillen et al. 2013)
//!
//! over liquid and wet walls. (Were dry walls counted, they would push the water line away from every wall.)
//!
//! A move is capped at a tenth of a spacing. The speed u is the largest one relative to a neighbour, so that the result is the
//! same in every inertial frame, and at least 0.3 sqrt(g dx), the speed at which gravity moves particles past each
//! other: without this floor the rows of a calm surface drift into each other, since nothing else acts along the
//! surface (kinetic energy of a tank with disorder of 0.05 spacings, after 3 s: 6e-5 of the potential at a fifth
//! of the floor, 9e-7 with it, 1e-5 at three times it). On a regular lattice grad C is zero and the floor without
//! effect.
//!
//! At the surface and within a neighbour of it the part along the surface normal is dropped (Lind et al. 2012): there
//! grad C points out of the water, not away from crowding. The normal is that of the surface particles around, since
//! the second row's own defect is too small to have a direction. The velocity is carried along,
//! v(r + dr) = v(r) + dr . grad v, so that shifting does not smear momentum. Of a wall only the normal velocity counts in
//! grad v: liquid slides along it, and its tangential velocity is no value of the liquid's. Were it one, a fast particle
//! beside a wall would see its own speed as a gradient, v / dx, and gain a share |dr| / dx of it with each move
//! away from the wall: tips of films ran away to twice the speed of the flood behind them.

use crate::operators::{Moments, Surroundings};
use crate::particles::{Matrix, Particles, Vector};
use rayon::prelude::*;

/// Largest move in spacings.
const CAP: f64 = 0.1;
/// Floor of the speed u in units of sqrt(g dx).
const SPEED_FLOOR: f64 = 0.3;

/// Parameters of one step's shifting.
#[derive(Debug, Clone, Copy)]
pub struct Shifting {
    /// A h dt in m s.
    factor: f64,
    /// Smallest speed u in m/s.
    least_speed: f64,
    /// Largest move in m.
    cap: f64,
}

impl Shifting {
    /// Shifting with coefficient A; lengths in m, gravity in m/s2, dt in s.
    pub fn new(coefficient: f64, smoothing_length: f64, spacing: f64, gravity: f64, dt: f64) -> Self {
        Self {
            factor: coefficient * smoothing_length * dt,
            least_speed: SPEED_FLOOR * (gravity * spacing).sqrt(),
            cap: CAP * spacing,
        }
    }

    /// Moves and changes of velocity of all fluid particles, see [`of`](Self::of), into `moves`.
    pub fn compute<const D: usize>(
        &self,
        surroundings: &Surroundings<'_, D>,
        particles: &Particles<D>,
        moments: &[Moments<D>],
        surface: &[f64],
        moves: &mut Vec<(Vector<D>, Vector<D>)>,
    ) {
        let first = particles.solids();
        moves.resize(particles.owned() - first, (Vector::zeros(), Vector::zeros()));
        moves.par_iter_mut().enumerate().with_min_len(256).for_each(|(k, change)| {
            *change = self.of(surroundings, particles, moments, surface, first + k);
        });
    }

    /// Carries `moves` out.
    pub fn apply<const D: usize>(particles: &mut Particles<D>, moves: &[(Vector<D>, Vector<D>)]) {
        let first = particles.solids();
        for (k, (dr, dv)) in moves.iter().enumerate() {
            particles.position[first + k] += dr;
            particles.velocity[first + k] += dv;
        }
    }

    /// Move in m and change of velocity in m/s of fluid particle `a`; `moments` and the surface weights `surface` have
    /// one entry a particle.
    pub fn of<const D: usize>(
        &self,
        surroundings: &Surroundings<'_, D>,
        particles: &Particles<D>,
        moments: &[Moments<D>],
        surface: &[f64],
        a: usize,
    ) -> (Vector<D>, Vector<D>) {
        let (velocity, solids) = (&particles.velocity, particles.solids());
        let v_a = velocity[a];
        let mut fastest = 0.0_f64;
        let mut gradient = Matrix::<D>::zeros();
        let mut inward = surface[a] * moments[a].defect;
        for (b, r_ab, vf) in surroundings.active(a) {
            let mut v_ba = velocity[b] - v_a;
            fastest = fastest.max(v_ba.norm_squared());
            let original = particles.original(b);
            if original < solids {
                let normal = particles.normal[original];
                v_ba = v_ba.dot(&normal) * normal;
            }
            gradient += vf * v_ba * r_ab.transpose();
            inward += surface[b] * moments[b].defect;
        }
        let mut concentration = moments[a].defect;
        if let Some(normal) = inward.try_normalize(0.0) {
            concentration -= normal * normal.dot(&concentration);
        }
        let mut shift = -self.factor * fastest.sqrt().max(self.least_speed) * concentration;
        let length = shift.norm();
        if length > self.cap {
            shift *= self.cap / length;
        }
        let carried = match moments[a].correction() {
            Some(b) => gradient * (b * shift),
            None => Vector::zeros(),
        };
        (shift, carried)
    }
}
