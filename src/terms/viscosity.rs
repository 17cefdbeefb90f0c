//! Laminar viscosity nu laplacian(v), in one of two forms:
//!
//! - *Two-point* (Morris et al. 1997; Shao & Lo 2003): nu sum_b 2 V F_ab v_ab. Exact for quadratic velocities up to a
//!   factor that the support's second moment gives, sum -V F r^2 / D, by which it is divided.
//! - *Central* (Monaghan & Gingold 1983; Monaghan 2005): nu sum_b 2 (D + 2) V F_ab (v_ab . r_ab) r_ab / r_ab^2. It leaves
//!   the stress on a free surface zero, and so damps waves at their right rate, where the two-point form sets
//!   the normal derivative of v to zero and damps at half that rate (Colagrossi et al. 2011). It also keeps
//!   angular momentum. On a regular lattice it depends on the direction (shear along an axis of the 2D lattice meets 1.5
//!   times the viscosity at h = 1.2 dx), which disorder averages out. Divided by the lattice's factor.
//!
//! Scenes with a free surface take the central form, those without the two-point form.
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

/// Velocity differences that the liquid at fluid particle `a` rubs against: (difference, r_ab, V F_ab) of each neighbour.
fn pairs<'a, const D: usize>(
    surroundings: &Surroundings<'a, D>,
    particles: &'a Particles<D>,
    a: usize,
    slip: Slip,
) -> impl Iterator<Item = (Vector<D>, Vector<D>, f64)> + 'a {
    let (v_a, solids) = (particles.velocity[a], particles.solids());
    surroundings.active(a).map(move |(b, r_ab, vf)| {
        let v_ab = v_a - particles.velocity[b];
        let b = particles.original(b);
        let difference = if b < solids { wall_difference(particles, b, &r_ab, v_ab, slip) } else { v_ab };
        (difference, r_ab, vf)
    })
}

/// Two-point form at fluid particle `a`, in 1/(m s); `moment` is sum -V F r^2 / D of its support.
pub fn two_point<const D: usize>(
    surroundings: &Surroundings<'_, D>,
    particles: &Particles<D>,
    a: usize,
    slip: Slip,
    moment: f64,
) -> Vector<D> {
    let pair = |(difference, _, vf): (Vector<D>, Vector<D>, f64)| 2.0 * vf * difference;
    pairs(surroundings, particles, a, slip).map(pair).sum::<Vector<D>>() / moment
}

/// Central form at fluid particle `a`, in 1/(m s); `moment` is sum -V F r^2 / D on the lattice.
pub fn central<const D: usize>(
    surroundings: &Surroundings<'_, D>,
    particles: &Particles<D>,
    a: usize,
    slip: Slip,
    moment: f64,
) -> Vector<D> {
    let along = |difference: Vector<D>, r_ab: Vector<D>| difference.dot(&r_ab) / r_ab.norm_squared() * r_ab;
    let pair = |(difference, r_ab, vf): (Vector<D>, Vector<D>, f64)| vf * along(difference, r_ab);
    2.0 * (D + 2) as f64 / moment * pairs(surroundings, particles, a, slip).map(pair).sum::<Vector<D>>()
}
