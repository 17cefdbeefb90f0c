//! Density diffusion: takes the noise out of the pressure of a weakly compressible liquid.
//!
//! drho_a/dt += 2 delta h c_0 sum_b V psi_ab (-F_ab)                                              (1)
//!
//! over liquid neighbours. The sum changes sign with the pair, so no mass is made. The forms differ in the density
//! difference psi_ab that is smoothed out; in a barotropic liquid drho = dp / c_0^2, and all of them are here
//!
//! psi_ab = (p_b - p_a - slope . r_ba) / c_0^2                                                    (2)
//!
//! | form | slope | source |
//! |---|---|---|
//! | Molteni & Colagrossi | 0: lifts and swells water at rest | Molteni & Colagrossi (2009), Comput. Phys. Commun. 180, 861-872 |
//! | Antuono | mean of the exact gradients at a and b | Antuono, Colagrossi & Marrone (2012), Comput. Phys. Commun. 183, 2570-2580 |
//! | Fourtakas | hydrostatic, rho g | Fourtakas et al. (2019), Comput. Fluids 190, 346-361 |
//!
//! Fourtakas et al. take the hydrostatic difference from the equation of state at rest; with pressures in (2) and the
//! pair's mean density it is exact to second order at any depth.

/// The constants of Eq. (1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityDiffusion {
    /// 2 delta h / c_0 in s.
    factor: f64,
}

impl DensityDiffusion {
    /// Diffusion of coefficient delta for a smoothing length in m and a speed of sound in m/s.
    pub fn new(delta: f64, smoothing_length: f64, sound_speed: f64) -> Self {
        Self { factor: 2.0 * delta * smoothing_length / sound_speed }
    }

    /// Eq. (1) in kg/(m3 s), from the sum over pairs of V F_ab in 1/m2 times the pressure excess c_0^2 psi_ab in Pa.
    #[inline]
    pub fn of(&self, sum: f64) -> f64 {
        -self.factor * sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn diffusion_flows_from_dense_to_thin() {
        let diffusion = DensityDiffusion::new(0.1, 0.012, 40.0);
        // F < 0: a denser neighbour raises the density; 2 * 0.1 * 0.012 / 40 * 5000 * 16
        assert!((diffusion.of(-5000.0 * 16.0) - 4.8).abs() < 1e-12);
    }
}
