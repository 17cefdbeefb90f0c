//! Laminar viscosity nu laplacian(v), in the two-point form of Shao & Lo (2003) and Morris et al. (1997).
//!
//! Walls either slip freely (no contribution) or hold the liquid: a no-slip wall particle b is given the velocity
//! that makes the profile from particle a through the wall's face linear, v_a - v_b = (1 + d_b / d_a) (v_a - v_wall)
//! with d the distances to the face (Morris et al. 1997). The factor is capped where a touches the face.

use crate::case::Slip;
use crate::operators::Surroundings;
use crate::particles::{Particles, Vector};

/// Largest factor of the no-slip extrapolation: d_a is never taken below d_b / 2 (Morris et al. use 0.5 as well).
const LARGEST_FACTOR: f64 = 3.0;

/// Velocity difference of a no-slip pair, from the distances to the face of the wall.
pub fn no_slip_difference<const D: usize>(v_aw: Vector<D>, distance_a: f64, distance_b: f64) -> Vector<D> {
    let factor = if distance_a > 0.0 { 1.0 + distance_b / distance_a } else { LARGEST_FACTOR };
    factor.min(LARGEST_FACTOR) * v_aw
}

/// Velocity difference in m/s that a pair of fluid particle a and solid particle `b` contributes: none where liquid
/// slips.
pub fn wall_difference<const D: usize>(
    particles: &Particles<D>,
    b: usize,
    r_ab: &Vector<D>,
    v_ab: Vector<D>,
    slip: Slip,
) -> Vector<D> {
    match slip {
        Slip::Free => Vector::zeros(),
        Slip::None => {
            let behind = particles.depth[b];
            no_slip_difference(v_ab, r_ab.dot(&particles.normal[b]) - behind, behind)
        }
    }
}

/// Laplacian of the velocity at fluid particle `a`, in 1/(m s).
pub fn laplacian<const D: usize>(
    surroundings: &Surroundings<'_, D>,
    particles: &Particles<D>,
    a: usize,
    slip: Slip,
) -> Vector<D> {
    let (v_a, solids) = (particles.velocity[a], particles.solids());
    let mut sum = Vector::zeros();
    for (b, r_ab, vf) in surroundings.active(a) {
        let v_ab = v_a - particles.velocity[b];
        let difference = if b < solids { wall_difference(particles, b, &r_ab, v_ab, slip) } else { v_ab };
        sum += 2.0 * vf * difference;
    }
    sum
}
