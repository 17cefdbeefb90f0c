use super::Kernel;
use std::f64::consts::PI;

/// w(q) = (2 - q)^3 / 4 - (1 - q)^3, each bracket cut at zero; sigma_2 = 10 / (7 pi), sigma_3 = 1 / pi
/// (Monaghan 1992).
///
/// ```
/// use sphpetsc::kernel::{CubicSpline, Kernel};
/// assert!((CubicSpline::sigma(2) - 0.454_728_408_833_987).abs() < 1e-15);
/// assert!((CubicSpline::sigma(3) - 0.318_309_886_183_791).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy)]
pub struct CubicSpline;

impl Kernel for CubicSpline {
    const SUPPORT: f64 = 2.0;

    fn sigma(dimension: usize) -> f64 {
        if dimension == 2 { 10.0 / (7.0 * PI) } else { 1.0 / PI }
    }

    #[inline]
    fn shape(q: f64) -> f64 {
        0.25 * (2.0 - q).max(0.0).powi(3) - (1.0 - q).max(0.0).powi(3)
    }

    #[inline]
    fn slope_over_q(q: f64) -> f64 {
        // Written out on each piece, because the 1/q of the two brackets cancels only there.
        if q < 1.0 { 2.25 * q - 3.0 } else { -0.75 * (2.0 - q).max(0.0).powi(2) / q }
    }
}
