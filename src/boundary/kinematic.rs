//! The divergence of the velocity beside walls: liquid and wall share the normal velocity at the face, and nothing else.
//!
//! A solid particle lies half a spacing and more behind the face, where a velocity that is linear in space goes on beyond the
//! wall's: v_n = v_wall_n - A_nn depth. And liquid slides along a wall, so that the wall's tangential velocity is no value of
//! the liquid's. Taken at its word a solid particle says that v_n vanishes where it lies, as if the tank were a spacing
//! longer (the period of a standing wave grows by half of dx / L), and tells every liquid particle the whole speed of the flood as a
//! difference, which only a perfect lattice sums to zero. So, with n the normal of a flat wall along axis i,
//!
//! - in the row of liquid a, solid b says (v_b - v_a)_i (1 + depth_b / distance_a), both measured to the face (as Morris et al.
//!   1997), and counts in the i,i entries alone, of the differences and of the moments that they are divided by;
//! - in the row of wall w each axis has its own slope, sum_f V F (v_f - v°) r_wf / sum_f V F (r_f - r°) r_wf over liquid f: across
//!   the wall v° and r° are those of the face, along it the means of the liquid around.
//!
//! Both are exact for velocities that are linear in space and obey the wall. At edges, at corners and on turned bodies a solid
//! particle is taken at its word.

use crate::operators::{Moments, Surroundings};
use crate::particles::{Matrix, Particles, Vector, axis_of};

/// Least share of the full support that the moments of a wall's row may amount to along an axis; a lattice has 0.27 across and 0.35
/// along a flat wall. With less, a slope is not to be had from the few neighbours: it is taken to be as much smaller.
const LEAST_MOMENT: f64 = 0.1;

/// Distance to a face in spacings that liquid is taken to keep at least: half that of the lattice. Nearer, and behind the face, the
/// slope v / distance would grow without bound.
const NEAREST: f64 = 0.25;

/// tr M / D div v in 1/s at liquid or wall particle `a`, for velocities in m/s of all particles and `spacing` in m: of a quadratic
/// field the Laplacian of the row of `a` makes the share tr M / D, M being the moments over those neighbours that it links to, and
/// so must its right-hand side.
pub fn divergence<const D: usize>(
    surroundings: &Surroundings<'_, D>,
    particles: &Particles<D>,
    a: usize,
    velocity: &[Vector<D>],
    moments: &Moments<D>,
    spacing: f64,
) -> f64 {
    let axis = if a < particles.solids() { axis_of(&particles.normal[a]) } else { None };
    if let Some(axis) = axis {
        return at_wall(surroundings, particles, a, velocity, axis);
    }
    let beside = a >= particles.solids() && !surroundings.neighbors.row(a).split().1.index.is_empty();
    let divergence = match beside {
        true => beside_wall(surroundings, particles, a, velocity, spacing),
        false => surroundings.divergence(a, velocity, moments),
    };
    moments.position_divergence() / D as f64 * divergence
}

/// div v in the row of liquid `a`.
fn beside_wall<const D: usize>(
    surroundings: &Surroundings<'_, D>,
    particles: &Particles<D>,
    a: usize,
    velocity: &[Vector<D>],
    spacing: f64,
) -> f64 {
    let (mut slopes, mut matrix) = (Matrix::<D>::zeros(), Matrix::<D>::zeros());
    for (b, r_ab, vf) in surroundings.active(a) {
        let v_ba = velocity[b] - velocity[a];
        let b = particles.original(b);
        let flat = if b < particles.solids() { axis_of(&particles.normal[b]) } else { None };
        let Some(i) = flat else {
            slopes += (vf * v_ba) * r_ab.transpose();
            matrix -= (vf * r_ab) * r_ab.transpose();
            continue;
        };
        let depth = particles.depth[b];
        let distance = r_ab.dot(&particles.normal[b]) - depth;
        // Liquid that is not before the face sees the solid from another side.
        if distance > -0.5 * spacing {
            let factor = 1.0 + depth / distance.max(NEAREST * spacing);
            slopes[(i, i)] += vf * factor * v_ba[i] * r_ab[i];
            matrix[(i, i)] -= vf * r_ab[i] * r_ab[i];
        }
    }
    match (Moments { matrix, ..Moments::default() }).correction() {
        Some(inverse) => (slopes * inverse).trace(),
        None => slopes.trace(),
    }
}

/// tr M / D div v in the row of wall `w`, flat across `axis`.
fn at_wall<const D: usize>(
    surroundings: &Surroundings<'_, D>,
    particles: &Particles<D>,
    w: usize,
    velocity: &[Vector<D>],
    axis: usize,
) -> f64 {
    let liquid = || surroundings.active(w).filter(|(f, ..)| particles.original(*f) >= particles.solids());
    let (mut trace, mut sum, mut r_mean, mut v_mean) = (0.0, 0.0, Vector::<D>::zeros(), Vector::<D>::zeros());
    for (f, r_wf, vf) in liquid() {
        trace -= vf * r_wf.norm_squared();
        sum += vf;
        r_mean -= vf * r_wf;
        v_mean += vf * velocity[f];
    }
    let (mut r_from, mut v_from) = (r_mean / sum, v_mean / sum);
    r_from[axis] = particles.depth[w] * particles.normal[w][axis];
    v_from[axis] = velocity[w][axis];
    let (mut slope, mut moment) = (Vector::<D>::zeros(), Vector::<D>::zeros());
    for (f, r_wf, vf) in liquid() {
        slope += (vf * (velocity[f] - v_from)).component_mul(&r_wf);
        moment += (vf * (-r_wf - r_from)).component_mul(&r_wf);
    }
    trace / D as f64 * slope.zip_map(&moment, |slope, moment| slope / moment.max(LEAST_MOMENT)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::KernelKind;
    use crate::neighbors::{Layout, Neighbors};

    /// Liquid over a floor, both jittered lattices of spacing 1 with the face at y = 0; the velocity v of the liquid is linear in space.
    fn divergences(v: impl Fn(&Vector<2>) -> Vector<2>, wall: Vector<2>) -> Vec<(usize, f64, f64)> {
        let floor: Vec<_> = (0..12).map(|i| Vector::<2>::new(f64::from(i), -0.5)).collect();
        let below = (0..36).map(|k| Vector::<2>::new(f64::from(k % 12), -1.5 - f64::from(k / 12)));
        let solid: Vec<_> = floor.iter().copied().chain(below).collect();
        let depth = solid.iter().map(|r| -r.y).collect();
        let normal = vec![Vector::<2>::new(0.0, 1.0); solid.len()];
        let mut particles =
            Particles::from_solid(solid, (normal, vec![true; 12]), depth, (0..36).map(|k| k % 12).collect());
        let mut seed = 1_u32;
        let mut noise = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            0.2 * (f64::from(seed >> 8) / f64::from(1 << 24) - 0.5)
        };
        for k in 0..72 {
            let r = Vector::<2>::new(f64::from(k % 12) + noise(), 0.5 + f64::from(k / 12) + noise());
            particles.push_fluid(r, v(&r));
        }
        particles.velocity[..48].fill(wall);
        let mut neighbors = Neighbors::default();
        neighbors.search(KernelKind::WendlandC2, 1.2, &particles.position, &Layout::of(&particles), |_| {
            f64::NEG_INFINITY
        });
        let active = vec![true; particles.len()];
        let surroundings = Surroundings {
            position: &particles.position,
            neighbors: &neighbors,
            active: &active,
            volume: 1.0,
        };
        let inside = |a: &usize| {
            let r = particles.position[*a];
            r.x > 3.5 && r.x < 7.5 && r.y < 2.0 && (r.y > 0.0 || *a < 12)
        };
        (0..particles.len())
            .filter(inside)
            .map(|a| {
                let moments = surroundings.moments(a);
                let found = divergence(&surroundings, &particles, a, &particles.velocity, &moments, 1.0);
                (a, found, surroundings.divergence(a, &particles.velocity, &moments))
            })
            .collect()
    }

    #[test]
    fn liquid_that_obeys_the_wall_is_measured_exactly() {
        // Stretching along a floor that rises at 0.3.
        let rows = divergences(|r| Vector::<2>::new(2.0 * r.x, 0.3 - 2.0 * r.y), Vector::<2>::new(0.0, 0.3));
        assert!(rows.iter().any(|(a, ..)| *a < 12) && rows.iter().any(|(a, ..)| *a >= 48));
        for (a, found, _) in rows {
            assert!(found.abs() < 1e-12, "{a}: {found}");
        }
    }

    #[test]
    fn liquid_slides_along_a_wall_unnoticed() {
        let rows = divergences(|_| Vector::<2>::new(50.0, 0.0), Vector::zeros());
        for (a, found, _) in &rows {
            assert!(found.abs() < 1e-10, "{a}: {found}");
        }
        // At its word the wall would speak of a divergence.
        assert!(rows.iter().any(|(.., plain)| plain.abs() > 0.1));
    }

    #[test]
    fn liquid_that_meets_a_wall_is_compressed() {
        // In the rows of the wall and of the liquid beside it.
        for (a, found, _) in divergences(|_| Vector::<2>::new(0.0, -1.0), Vector::zeros()) {
            assert!(found < if a < 60 { -0.05 } else { 0.0 }, "{a}: {found}");
        }
    }
}
