//! The free surface: which particles lie on it, and the condition p = 0 half a spacing above them.
//!
//! **Detection** (Lee et al. 2008). In a full support the position divergence div r is D. On the lattice the top
//! row has 1.26 in 2D and 2.08 in 3D, the second row 1.90 and 2.94. Below [`threshold`] a particle counts as
//! surface; up to 0.2 above it the weight s fades smoothly to zero (Skillen et al. 2013), so that a row of the
//! pressure matrix does not jump when a particle surfaces.
//!
//! **Condition.** A surface particle stands for water up to half a spacing above its centre. p = 0 holds there, and
//! not at its centre, where it would be a bias of 0.5 dx / H. In its row of Eq. (3) of Jian et al. (2016) the
//! gradient along the outward normal is therefore not the discrete one but dp/dn = -p_a / (dx / 2). With
//! S_a = -|S_a| n the correction term of Eq. (3) becomes
//!
//! -(2 / rho) grad p . S_a = -(2 / rho) (2 / dx) |S_a| p_a                                          (1)
//!
//! a term on the diagonal, which keeps the matrix symmetric and positive, and makes every piece of water with
//! a surface (spray included) a solvable system of its own. Hydrostatic pressure under a flat surface is an
//! exact solution.
//!
//! **Source.** On a surface row the source is the divergence *along* the surface. It keeps the rows of a calm surface from
//! sliding into each other and into walls. The part across the surface is left out (weighted by s): the gradient at a
//! surface particle is one-sided, so a pressure that answers to the particle's own motion up or down pushes it the
//! wrong way, and alternating vertical motion of the top row grows by 8.7 % a step (spectral radius of the discrete
//! projection on a lattice, wavelength 2 dx; with the part along the surface alone it is 1).

use crate::kernel::LatticeSums;
use crate::operators::Moments;
use crate::particles::Vector;

/// Position divergence below which a particle lies on the surface: between the lattice's first and second row.
pub const fn threshold<const D: usize>() -> f64 {
    if D == 2 { 1.5 } else { 2.4 }
}

/// Width of the smooth transition above [`threshold`]; the second lattice row stays clear of it.
const TRANSITION: f64 = 0.2;

/// In a film or a thread S vanishes by symmetry though both sides are open. So the term (1) is at least this share of
/// what the missing neighbours would contribute as air at p = 0 half way to them, which at a flat surface is just (1):
/// there the floor is never reached, and a film keeps a reference pressure.
const FLOOR: f64 = 0.3;

/// Surface weight s in [0, 1]: 1 on the surface, 0 inside.
pub fn weight<const D: usize>(moments: &Moments<D>) -> f64 {
    weight_at::<D>(moments.position_divergence())
}

/// Surface weight of a particle by its position divergence alone.
pub fn weight_at<const D: usize>(position_divergence: f64) -> f64 {
    let x = (position_divergence - threshold::<D>()) / TRANSITION;
    0.5 * (1.0 + (std::f64::consts::PI * x.clamp(0.0, 1.0)).cos())
}

/// Outward unit normal of a surface particle; zero where its support has no preferred side.
pub fn normal<const D: usize>(moments: &Moments<D>) -> Vector<D> {
    (-moments.defect).try_normalize(0.0).unwrap_or_else(Vector::zeros)
}

/// Diagonal term of Eq. (1) times rho / 2 and the weight, in 1/m2.
pub fn diagonal<const D: usize>(
    moments: &Moments<D>,
    weight: f64,
    lattice: &LatticeSums,
    spacing: f64,
) -> f64 {
    let one_sided = 2.0 / spacing * moments.defect.norm();
    let missing = (lattice.stiffness - moments.stiffness).max(LEAST_MISSING * lattice.stiffness);
    weight * one_sided.max(FLOOR * 2.0 * lattice.missing_distance * missing)
}

/// Particles pressed together can make up for missing neighbours in the stiffness; this share of the lattice's
/// always counts as missing at a surface particle, so that no clump floats without a reference pressure.
const LEAST_MISSING: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Matrix;

    #[test]
    fn the_weight_fades_from_the_first_row_to_the_second() {
        let of = |divergence: f64| {
            weight::<2>(&Moments { matrix: Matrix::identity() * (0.5 * divergence), ..Moments::default() })
        };
        assert_eq!((of(1.26), of(1.90)), (1.0, 0.0));
        assert!((of(1.6) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_film_keeps_a_reference_pressure() {
        let film = Moments::<2> { defect: Vector::zeros(), stiffness: 0.4, ..Moments::default() };
        let lattice = LatticeSums {
            kernel_sum: 1.0,
            own_share: 0.4,
            stiffness: 1.0,
            missing_distance: 1.0,
            near_share: 1.0,
        };
        assert!(diagonal(&film, 1.0, &lattice, 0.01) > 0.3);
        assert_eq!(diagonal(&film, 0.0, &lattice, 0.01), 0.0);
    }
}
