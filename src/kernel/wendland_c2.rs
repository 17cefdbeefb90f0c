use super::Kernel;
use std::f64::consts::PI;

/// w(q) = (1 - q/2)^4 (2 q + 1), sigma_2 = 7 / (4 pi), sigma_3 = 21 / (16 pi) (Wendland 1995).
///
/// ```
/// use sphpetsc::kernel::{Kernel, WendlandC2};
/// assert!((WendlandC2::sigma(2) - 0.557_042_300_821_634).abs() < 1e-15);
/// assert!((WendlandC2::sigma(3) - 0.417_781_725_616_225).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy)]
pub struct WendlandC2;

impl Kernel for WendlandC2 {
    const SUPPORT: f64 = 2.0;

    fn sigma(dimension: usize) -> f64 {
        if dimension == 2 { 7.0 / (4.0 * PI) } else { 21.0 / (16.0 * PI) }
    }

    #[inline]
    fn shape(q: f64) -> f64 {
        let s = (1.0 - 0.5 * q).max(0.0);
        s.powi(4) * (2.0 * q + 1.0)
    }

    #[inline]
    fn slope_over_q(q: f64) -> f64 {
        -5.0 * (1.0 - 0.5 * q).max(0.0).powi(3)
    }
}
