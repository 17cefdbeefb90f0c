use super::Kernel;
use std::f64::consts::PI;

/// w(q) = (3 - q)^5 - 6 (2 - q)^5 + 15 (1 - q)^5, each bracket cut at zero; sigma_2 = 7 / (478 pi),
/// sigma_3 = 1 / (120 pi) (Morris et al. 1997, who print 3 / (359 pi) for 3D; the integral gives 1 / (120 pi)).
///
/// ```
/// use sphpetsc::kernel::{Kernel, Quintic};
/// assert!((Quintic::sigma(2) - 0.004_661_441_847_880).abs() < 1e-15);
/// assert!((Quintic::sigma(3) - 0.002_652_582_384_865).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Quintic;

impl Kernel for Quintic {
    const SUPPORT: f64 = 3.0;

    fn sigma(dimension: usize) -> f64 {
        if dimension == 2 { 7.0 / (478.0 * PI) } else { 1.0 / (120.0 * PI) }
    }

    #[inline]
    fn shape(q: f64) -> f64 {
        let bracket = |a: f64| (a - q).max(0.0).powi(5);
        bracket(3.0) - 6.0 * bracket(2.0) + 15.0 * bracket(1.0)
    }

    #[inline]
    fn slope_over_q(q: f64) -> f64 {
        if q < 1.0 {
            // -5 [(3-q)^4 - 6 (2-q)^4 + 15 (1-q)^4] / q, expanded: the constant term cancels.
            return -120.0 + q * q * (120.0 - 50.0 * q);
        }
        let bracket = |a: f64| (a - q).max(0.0).powi(4);
        -5.0 * (bracket(3.0) - 6.0 * bracket(2.0)) / q
    }
}
