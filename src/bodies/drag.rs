//! Viscous force of liquid that sticks to bodies: the reaction to what [`crate::terms::viscosity`] does to the liquid,
//!
//! F = sum_ab c_ab P_ab (v_a - u_b),   c_ab = -m times the rate of the pair, in kg/s                 (1)
//!
//! over all pairs of liquid a and solid b of the body, P being the identity or the projection on the line between them. A force along that
//! line acts anywhere on it; others act on the face before b.
//!
//! It falls with the velocity that the body takes up over the step, by dF = -R dv with R the sum of c P over the body's modes, never
//! negative: with it a light body in very viscous liquid is as stable as a heavy one.

use super::coupling::{generalised, mode};
use super::{Bodies, restrict};
use crate::form::point;
use crate::neighbors::Neighbors;
use crate::parallel::Ranks;
use crate::particles::{Particles, Vector};
use crate::terms::viscosity::along;

/// Viscous force on a body along its axes in N and torque about them in N m, at the velocity that it has.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Drag {
    force: [f64; 6],
    /// R, in kg/s and the like.
    resistance: [[f64; 6]; 6],
}

impl Drag {
    /// Force and torque once the body was accelerated by q, along and about all axes, for `dt` s.
    pub fn after(&self, q: &[f64; 6], dt: f64) -> [f64; 6] {
        let lost = |row: &[f64; 6]| dt * row.iter().zip(q).map(|(r, q)| r * q).sum::<f64>();
        std::array::from_fn(|k| self.force[k] - lost(&self.resistance[k]))
    }

    /// Minus the derivative of component k by the acceleration m, over a step of `dt` s.
    pub fn resistance(&self, k: usize, m: usize, dt: f64) -> f64 {
        dt * self.resistance[k][m]
    }
}

/// What viscosity does to a particle of the liquid at a solid one: dv/dt = `rate` P (v - u).
#[derive(Debug, Clone, Copy)]
pub struct Grip<const D: usize> {
    /// The solid particle, of velocity u.
    pub solid: usize,
    /// The body that it belongs to.
    pub body: usize,
    /// v of the liquid in m/s.
    pub velocity: Vector<D>,
    /// In 1/s, negative.
    pub rate: f64,
    /// P projects on this unit vector; without one it is the identity.
    pub line: Option<Vector<D>>,
}

impl<const D: usize> Bodies<D> {
    /// Pairs (a, b, F_ab) of liquid a and solids b of bodies, in whose place ghosts may stand, each behind the number of the body.
    pub fn beside_liquid(
        &self,
        particles: &Particles<D>,
        neighbors: &Neighbors<D>,
    ) -> impl Iterator<Item = (usize, (usize, usize, f64))> {
        let beside_solids = particles.fluid().filter(|a| neighbors.has_solids(*a));
        beside_solids.flat_map(move |a| {
            let solids = neighbors.row(a).split().1.iter();
            solids.filter_map(move |(b, _, f)| Some((self.of(particles.original(b))?, (a, b, f))))
        })
    }

    /// Eq. (1) on each body from the `grips` of this rank's liquid on solids of bodies. All ranks ask together. `mass` is that of a
    /// particle in kg.
    pub fn drag(
        &self,
        particles: &Particles<D>,
        mass: f64,
        ranks: &Ranks,
        grips: impl Iterator<Item = Grip<D>>,
    ) -> Vec<Drag> {
        let mut drags = vec![Drag::default(); self.list.len()];
        for Grip { solid, body, velocity, rate, line } in grips {
            let b = particles.original(solid);
            let at = match line {
                Some(_) => particles.position[b],
                None => particles.position[b] + particles.depth[b] * particles.normal[b],
            };
            let arm = point(&at) - self.list[body].state.position;
            let force = |v: &Vector<D>| generalised(&point(&(-mass * rate * along(line.as_ref(), v))), &arm);
            let add = |sums: &mut [f64; 6], force: [f64; 6]| {
                sums.iter_mut().zip(force).for_each(|(sum, force)| *sum += force);
            };
            let Drag { force: sums, resistance } = &mut drags[body];
            add(sums, force(&(velocity - particles.velocity[b])));
            // R is symmetric: its rows are its columns.
            (0..6).for_each(|k| add(&mut resistance[k], force(&restrict(&mode(k, &arm)))));
        }
        let numbers = |drag: &Drag| drag.force.into_iter().chain(drag.resistance.into_iter().flatten());
        let sums = ranks.sums(&drags.iter().flat_map(numbers).collect::<Vec<_>>());
        for (drag, sums) in drags.iter_mut().zip(sums.chunks_exact(42)) {
            let places = drag.force.iter_mut().chain(drag.resistance.as_flattened_mut());
            places.zip(sums).for_each(|(place, sum)| *place = *sum);
        }
        drags
    }

    /// Viscous force and torque on body `b` at accelerations q of the `unknowns` after `dt` s.
    pub(super) fn drag_on(&self, b: usize, unknowns: &[(usize, usize)], q: &[f64], dt: f64) -> [f64; 6] {
        let mut own = [0.0; 6];
        for (&(body, k), q) in unknowns.iter().zip(q) {
            own[k] = if body == b { *q } else { own[k] };
        }
        self.drags.get(b).map_or([0.0; 6], |drag| drag.after(&own, dt))
    }
}
