use super::{Kernel, Smoothing};
use crate::particles::Vector;

/// What a full, regular support sums to on the cubic lattice particles start from.
///
/// These are the yardsticks for disordered supports: the lattice density of a kernel is not exactly 1 (1.018 for
/// [`WendlandC2`](super::WendlandC2) with h = 1.2 dx in 2D), so a density error is measured against it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatticeSums {
    /// sum V W with the particle itself.
    pub kernel_sum: f64,
    /// V W(0), the particle's own share.
    pub own_share: f64,
    /// sum of -V F in 1/m2: half the diagonal of the plain Laplacian.
    pub stiffness: f64,
    /// Mean distance, weighted by -F, of the lattice planes that a flat surface just above a plane cuts off, in
    /// spacings (slightly above 1): see [`surface`](crate::terms::surface).
    pub missing_distance: f64,
    /// sum of -V F r^2 / D: what the plain Laplacian makes of a quadratic field, 1 in the continuum (0.964 for
    /// [`WendlandC2`](super::WendlandC2) with h = 1.2 dx in 2D).
    pub laplacian: f64,
    /// Share of sum -V F r^2 that comes from neighbours nearer than the radius of the sparse preconditioner.
    pub near_share: f64,
    /// |sum V grad W| of a particle in the top row under a flat surface, in 1/m.
    pub surface_defect: f64,
}

impl LatticeSums {
    /// Sums over a lattice of `spacing` m for a kernel of `support` m; neighbours up to `near` m count as near.
    pub fn new<const D: usize, K: Kernel>(
        smoothing: &Smoothing<D, K>,
        support: f64,
        spacing: f64,
        near: f64,
    ) -> Self {
        let volume = spacing.powi(D as i32);
        let reach = (support / spacing).ceil() as i64;
        let side = 2 * reach + 1;
        let own_share = volume * smoothing.pair(0.0).0;
        let mut sums = Self {
            kernel_sum: own_share,
            own_share,
            stiffness: 0.0,
            missing_distance: 0.0,
            laplacian: 0.0,
            near_share: 0.0,
            surface_defect: 0.0,
        };
        let (mut cut_off, mut second_moment) = (0.0, 0.0);
        for n in 0..side.pow(D as u32) {
            let offset = Vector::<D>::from_fn(|d, _| (n / side.pow(d as u32) % side - reach) as f64);
            let r = offset.norm() * spacing;
            if r == 0.0 || r >= support {
                continue;
            }
            let (w, f) = smoothing.pair(r);
            let stiffness = -volume * f;
            sums.kernel_sum += volume * w;
            sums.stiffness += stiffness;
            second_moment += stiffness * r * r;
            if r < near {
                sums.near_share += stiffness * r * r;
            }
            if offset[0] > 0.0 {
                cut_off += stiffness;
                sums.missing_distance += stiffness * offset[0];
            }
        }
        sums.surface_defect = spacing * sums.missing_distance;
        sums.missing_distance /= cut_off;
        sums.near_share /= second_moment;
        sums.laplacian = second_moment / D as f64;
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::super::WendlandC2;
    use super::*;

    #[test]
    fn wendland_lattice_density_is_known() {
        let smoothing = Smoothing::<2, WendlandC2>::new(1.2);
        let sums = LatticeSums::new(&smoothing, 2.4, 1.0, 1.6);
        assert!((sums.kernel_sum - 1.018).abs() < 5e-4, "{sums:?}");
        assert!(sums.missing_distance > 1.0 && sums.missing_distance < 1.2, "{sums:?}");
        assert!(sums.near_share > 0.5 && sums.near_share < 1.0, "{sums:?}");
    }
}
