//! Smoothing kernels W(r, h) in `D` = 2 or 3 dimensions.
//!
//! Everywhere q = r / h, the support radius is `SUPPORT * h`, and W(r, h) = sigma_D / h^D w(q). A kernel is
//! one type implementing [`Kernel`]; loops are generic over it and [`KernelKind`] chooses once a step.
//!
//! | kernel | support | source |
//! |---|---|---|
//! | [`WendlandC2`] | 2 h | Wendland (1995), Adv. Comput. Math. 4, 389-396 |
//! | [`CubicSpline`] | 2 h | Monaghan (1992), Annu. Rev. Astron. Astrophys. 30, 543-574 |
//! | [`Quintic`] | 3 h | Morris, Fox & Zhu (1997), J. Comput. Phys. 136, 214-226 |

mod cubic_spline;
mod lattice;
mod quintic;
mod wendland_c2;

pub use crate::case::KernelKind;
pub use cubic_spline::CubicSpline;
pub use lattice::LatticeSums;
pub use quintic::Quintic;
pub use wendland_c2::WendlandC2;

/// A radial smoothing kernel, described by its dimensionless shape w(q).
pub trait Kernel: Copy + Send + Sync {
    /// Support radius in units of h.
    const SUPPORT: f64;

    /// Normalisation sigma_D, so that the integral of W over space is 1; `dimension` is 2 or 3.
    fn sigma(dimension: usize) -> f64;

    /// Shape w(q), zero for q >= `SUPPORT`.
    fn shape(q: f64) -> f64;

    /// (dw/dq) / q, finite at q = 0: what a kernel gradient needs without dividing by r.
    fn slope_over_q(q: f64) -> f64;
}

/// A kernel's two pair factors at one smoothing length: W itself and F = (dW/dr)/r, so that grad_a W_ab = F r_ab.
#[derive(Debug, Clone, Copy)]
pub struct Smoothing<const D: usize, K: Kernel> {
    inverse_h: f64,
    w_factor: f64,
    f_factor: f64,
    kernel: std::marker::PhantomData<K>,
}

impl<const D: usize, K: Kernel> Smoothing<D, K> {
    /// Kernel at smoothing length `h` in m.
    pub fn new(h: f64) -> Self {
        let w_factor = K::sigma(D) / h.powi(D as i32);
        Self { inverse_h: 1.0 / h, w_factor, f_factor: w_factor / (h * h), kernel: std::marker::PhantomData }
    }

    /// W(r) in 1/m^D and F(r) = (dW/dr)/r in 1/m^(D+2).
    #[inline]
    pub fn pair(&self, r: f64) -> (f64, f64) {
        let q = r * self.inverse_h;
        (self.w_factor * K::shape(q), self.f_factor * K::slope_over_q(q))
    }
}

impl KernelKind {
    /// Support radius in units of h.
    pub fn support(self) -> f64 {
        match self {
            Self::WendlandC2 => WendlandC2::SUPPORT,
            Self::CubicSpline => CubicSpline::SUPPORT,
            Self::Quintic => Quintic::SUPPORT,
        }
    }

    /// W(r) in 1/m^D at smoothing length `h` in m, where single values are asked for.
    pub fn value<const D: usize>(self, r: f64, h: f64) -> f64 {
        match self {
            Self::WendlandC2 => Smoothing::<D, WendlandC2>::new(h).pair(r).0,
            Self::CubicSpline => Smoothing::<D, CubicSpline>::new(h).pair(r).0,
            Self::Quintic => Smoothing::<D, Quintic>::new(h).pair(r).0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integral of W over space by the midpoint rule in r.
    fn integral<const D: usize, K: Kernel>() -> f64 {
        let (h, n) = (0.7, 20_000);
        let smoothing = Smoothing::<D, K>::new(h);
        let dr = K::SUPPORT * h / n as f64;
        (0..n)
            .map(|k| {
                let r = (k as f64 + 0.5) * dr;
                let shell = if D == 2 { 2.0 * r } else { 4.0 * r * r } * std::f64::consts::PI;
                shell * smoothing.pair(r).0 * dr
            })
            .sum()
    }

    fn properties<K: Kernel>() {
        assert!((integral::<2, K>() - 1.0).abs() < 1e-7, "2D integral {}", integral::<2, K>());
        assert!((integral::<3, K>() - 1.0).abs() < 1e-7, "3D integral {}", integral::<3, K>());
        let step = 1e-6;
        for k in 1..200 {
            let q = K::SUPPORT * (k as f64 - 0.31) / 200.0;
            let difference = (K::shape(q + step) - K::shape(q - step)) / (2.0 * step);
            assert!((K::slope_over_q(q) * q - difference).abs() < 1e-7, "slope at q = {q}");
            assert!(K::shape(q) > 0.0 && K::slope_over_q(q) < 0.0);
        }
        assert_eq!((K::shape(K::SUPPORT), K::slope_over_q(K::SUPPORT)), (0.0, 0.0));
        assert_eq!(K::shape(K::SUPPORT * 1.5), 0.0);
    }

    #[test]
    fn every_kernel_is_normalised_smooth_and_compact() {
        properties::<WendlandC2>();
        properties::<CubicSpline>();
        properties::<Quintic>();
    }
}
