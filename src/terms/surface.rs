//! The free surface: which particles lie on it, and the condition p = 0 half a spacing above them.
//!
//! **Detection** (Lee et al. 2008). In a full support the position divergence div r is D. On the lattice the top
//! row has 1.26 in 2D and 2.08 in 3D, the second row 1.90 and 2.94. Below [`threshold`] a particle counts as
//! surface; up to 0.2 above it the weight s fades smoothly to zero (Skillen et al. 2013), so that a row of the
//! pressure matrix does not jump when a particle surfaces.
//!
//! Read as D det(M)^(1/D) instead of the trace of the moments M that it is, div r tells the same rows apart, and takes a particle
//! between two walls less than a spacing apart for open, although what the walls overfill makes up for the air in the trace. Left closed,
//! such a particle has a row almost without neighbours: bodies that close in on it give it 7e7 Pa.
//!
//! A few particles caught among solids lie on the surface however tightly they are held. Closed, they would be linked with hardly anything
//! that sets the level of their pressure: in `debris` by ISPH_DI two to four of them between boxes, or driven into one, make the pressure equation
//! singular. In the corner of a tank a particle of the lattice has 7 neighbours of liquid in 2D and 16 in 3D.
//!
//! A scene in which no particle lies on the surface at the start has none: a closed vessel full of liquid, or a
//! periodic one. There the small voids of a disordered flow must not be taken for one.
//!
//! **Condition.** A surface particle stands for water up to delta, about half a spacing, above its centre. p = 0 holds there,
//! and not at its centre, where it would be a bias of 0.5 dx / H. In its row of Eq. (3) of Jian et al. (2016) the
//! gradient along the outward normal is therefore not the discrete one but dp/dn = -p_a / delta. With
//! S_a = -|S_a| n the correction term of Eq. (3) becomes
//!
//! -(2 / rho) grad p . S_a = -(2 / rho) |S_a| p_a / delta                                           (1)
//!
//! a term on the diagonal, which keeps the matrix symmetric and positive, and makes every piece of water with
//! a surface (spray included) a solvable system of its own. Hydrostatic pressure under a flat surface is an
//! exact solution.
//!
//! **Thickness.** Under a crest the layer is stretched, delta = (dx / 2) (1 + e), e being the strain along the normal, about k eta in a
//! wave. Left out, this slows waves down at first order: of the square of their frequency 0.82, 0.91, 0.95 is left at 16,
//! 32, 64 spacings a wavelength, on a lattice displaced as the wave has it. The strain shows in |S_a|, which on the lattice
//! changes as 1 - 0.67 e in 2D and 1 - 0.61 e in 3D while volume is kept, so that delta = (dx / 2) (|S| / |S_a|)^1.5 with |S| that of
//! the flat surface: 0.937, 0.984, 0.996 is left, of second order.
//!
//! **Gradient.** The same dp/dn = -p_a / delta replaces the normal part of the gradient that accelerates a surface
//! particle: the one-sided difference is the slope half a spacing and more below it, too small for waves. A linear
//! analysis of whole steps on a lattice (wavelength 16 dx) gives 0.87 of the square of the exact frequency, against
//! 0.77 with the difference alone; and every mode decays, where without it some grow at small time steps.
//!
//! **Source.** Surface rows carry none: with it they would say that the pressure is harmonic at the surface particle, which
//! is right for a divergence-free velocity, and a divergence measured one-sidedly does harm. In full it pushes alternating
//! vertical motion of the top row the wrong way (amplified by 8.7 % a step); its part along the surface alone stops the
//! stretching of wave crests (0.2 of a wave's energy lost per 1/w instead of 0.01, the more the smaller the step).

use crate::kernel::LatticeSums;
use crate::operators::Moments;
use crate::particles::Vector;

/// Position divergence below which a particle lies on the surface: between the lattice's first and second row.
pub const fn threshold<const D: usize>() -> f64 {
    if D == 2 { 1.5 } else { 2.4 }
}

/// Width of the smooth transition above [`threshold`]; the second lattice row stays clear of it.
const TRANSITION: f64 = 0.2;

/// Density over that of the lattice below which a particle lies on the surface (the "10 %" of Jian et al. 2016), and the width
/// of the transition above it: the lattice's second row has 0.97 in 2D.
const DENSITY: (f64, f64) = (0.9, 0.05);

/// A particle with fewer neighbours of liquid lies on the surface. With half as many three together would still be closed, with twice as
/// many the corners of a tank would be open.
pub const FEW: usize = 4;

/// How a surface particle is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Criterion {
    /// By its position divergence.
    PositionDivergence,
    /// By its density, as in ISPH_DI.
    Density,
}

impl Criterion {
    /// Surface weight s in [0, 1]: 1 on the surface, 0 inside. `crowding` is the density over that of the lattice.
    pub fn weight<const D: usize>(self, moments: &Moments<D>, crowding: f64) -> f64 {
        match self {
            Self::PositionDivergence => weight(moments),
            Self::Density => fade((crowding - DENSITY.0) / DENSITY.1),
        }
    }
}

/// From 1 at x <= 0 to 0 at x >= 1.
fn fade(x: f64) -> f64 {
    // Nearly all liquid lies beyond either end, where the cosine would be as good and cost more.
    match x {
        x if x <= 0.0 => 1.0,
        x if x >= 1.0 => 0.0,
        x => 0.5 * (1.0 + (std::f64::consts::PI * x).cos()),
    }
}

/// In a film or a thread S vanishes by symmetry though both sides are open. So the term (1) is at least this share of
/// what the missing neighbours would contribute as air at p = 0 half way to them, which at a flat surface is just (1):
/// there the floor is never reached, and a film keeps a reference pressure.
const FLOOR: f64 = 0.3;

/// Surface weight s in [0, 1]: 1 on the surface, 0 inside.
pub fn weight<const D: usize>(moments: &Moments<D>) -> f64 {
    weight_at::<D>(moments.filling())
}

/// Surface weight of a particle by its position divergence alone.
pub fn weight_at<const D: usize>(position_divergence: f64) -> f64 {
    fade((position_divergence - threshold::<D>()) / TRANSITION)
}

/// Outward unit normal of a surface particle; zero where its support has no preferred side.
pub fn normal<const D: usize>(moments: &Moments<D>) -> Vector<D> {
    (-moments.defect).try_normalize(0.0).unwrap_or_else(Vector::zeros)
}

/// Pressure gradient of a surface particle from the `inner` one-sided one, with dp/dn = -p / `thickness` as far as `weight`
/// says; all in Pa/m, the thickness in m.
pub fn gradient<const D: usize>(
    inner: Vector<D>,
    moments: &Moments<D>,
    weight: f64,
    pressure: f64,
    thickness: f64,
) -> Vector<D> {
    if weight == 0.0 {
        return inner;
    }
    let normal = normal(moments);
    inner + weight * (-pressure / thickness - inner.dot(&normal)) * normal
}

/// Power of |S| / |S_a| in the thickness: 1 / 0.67.
const STRETCH: f64 = 1.5;
/// Least and largest thickness over half a spacing: the strains of steep waves. Beyond, in spray and films, |S_a| tells of missing
/// neighbours, not of strain.
const THICKNESS: (f64, f64) = (0.8, 1.25);

/// Thickness delta in m of the water above a surface particle.
pub fn thickness<const D: usize>(moments: &Moments<D>, lattice: &LatticeSums, spacing: f64) -> f64 {
    let stretch = (lattice.surface_defect / moments.defect.norm()).powf(STRETCH);
    0.5 * spacing * stretch.clamp(THICKNESS.0, THICKNESS.1)
}

/// Diagonal term of Eq. (1) times rho / 2 and the weight, in 1/m2.
pub fn diagonal<const D: usize>(
    moments: &Moments<D>,
    weight: f64,
    lattice: &LatticeSums,
    spacing: f64,
) -> f64 {
    let one_sided = moments.defect.norm() / thickness(moments, lattice, spacing);
    let missing = (lattice.stiffness - moments.stiffness).max(LEAST_MISSING * lattice.stiffness);
    weight * one_sided.max(FLOOR * 2.0 * lattice.missing_distance * missing)
}

/// Particles pressed together can make up for missing neighbours in the stiffness; this share of the lattice's
/// always counts as missing at a surface particle, so that no clump floats without a reference pressure.
const LEAST_MISSING: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{Smoothing, WendlandC2};
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
    fn a_narrow_gap_is_open() {
        let gap = Moments { matrix: Matrix::<2>::new(1.7, 0.0, 0.0, 0.2), ..Moments::default() };
        assert!(gap.position_divergence() > 1.8 && weight(&gap) == 1.0);
    }

    #[test]
    fn hydrostatic_pressure_is_met_at_the_surface() {
        let below = Moments::<2> { defect: Vector::<2>::new(0.0, -3.0), ..Moments::default() };
        let inner = Vector::<2>::new(2.0, -5.0);
        let met = gradient(inner, &below, 1.0, 0.5 * 0.01 * 9810.0, 0.5 * 0.01);
        assert!((met - Vector::<2>::new(2.0, -9810.0)).norm() < 1e-9, "{met}");
        assert_eq!(gradient(inner, &below, 0.0, 7.0, 0.01), inner);
    }

    #[test]
    fn a_stretched_layer_is_thicker() {
        let smoothing = Smoothing::<2, WendlandC2>::new(1.2);
        let lattice = LatticeSums::new(&smoothing, 2.4, 1.0, 1.6);
        let of = |e: f64| {
            let mut moments = Moments::<2>::default();
            for (x, y) in (-3..=3).flat_map(|x| (-3..=0).map(move |y| (f64::from(x), f64::from(y)))) {
                let r_ab = -Vector::<2>::new((1.0 - e) * x, (1.0 + e) * y);
                if r_ab.norm() > 0.0 && r_ab.norm() < 2.4 {
                    moments.defect += smoothing.pair(r_ab.norm()).1 * r_ab;
                }
            }
            thickness(&moments, &lattice, 1.0)
        };
        assert!((of(0.0) - 0.5).abs() < 1e-12, "{}", of(0.0));
        for e in [-0.05, 0.02, 0.05] {
            assert!((of(e) / (0.5 * (1.0 + e)) - 1.0).abs() < 0.1 * e.abs(), "{e}: {}", of(e));
        }
    }

    #[test]
    fn a_film_keeps_a_reference_pressure() {
        let film = Moments::<2> { defect: Vector::zeros(), stiffness: 0.4, ..Moments::default() };
        let lattice = LatticeSums {
            kernel_sum: 1.0,
            own_share: 0.4,
            stiffness: 1.0,
            missing_distance: 1.0,
            laplacian: 1.0,
            near_share: 1.0,
            surface_defect: 1.0,
        };
        assert!(diagonal(&film, 1.0, &lattice, 0.01) > 0.3);
        assert_eq!(diagonal(&film, 0.0, &lattice, 0.01), 0.0);
    }
}
