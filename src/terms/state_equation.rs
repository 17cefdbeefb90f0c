//! The stiff equation of state of a weakly compressible liquid (Tait; Cole 1948; Monaghan 1994):
//!
//! p = B ((rho / rho_0)^7 - 1),   B = c_0^2 rho_0 / 7
//!
//! c_0 is an artificial speed of sound: ten times the greatest speed of the flow keeps the density within about 1 % of
//! rho_0 and time steps ten, not a hundred, times shorter than the flow itself asks for (half of it: 4 %; twice:
//! 0.25 %, and twice the steps). The pressure tells the density and the other way round, so that a particle needs only
//! one of them.

/// Exponent of the equation of state.
const EXPONENT: i32 = 7;

/// Equation of state of one liquid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tait {
    /// rho_0 in kg/m3.
    density: f64,
    /// B in Pa.
    stiffness: f64,
}

impl Tait {
    /// Liquid of a reference density in kg/m3 with a speed of sound in m/s.
    pub fn new(density: f64, sound_speed: f64) -> Self {
        Self { density, stiffness: sound_speed * sound_speed * density / f64::from(EXPONENT) }
    }

    /// Pressure in Pa at a density in kg/m3.
    #[inline]
    pub fn pressure(&self, density: f64) -> f64 {
        self.stiffness * ((density / self.density).powi(EXPONENT) - 1.0)
    }

    /// Density in kg/m3 at a pressure in Pa; no tension goes beyond -B, where the density is zero.
    #[inline]
    pub fn density(&self, pressure: f64) -> f64 {
        let base = (1.0 + pressure / self.stiffness).max(0.0);
        self.density * base.powf(1.0 / f64::from(EXPONENT))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn density_inverts_pressure() {
        let water = Tait::new(1000.0, 40.0);
        for density in [900.0, 990.0, 1000.0, 1001.0, 1100.0] {
            let back = water.density(water.pressure(density));
            assert!((back - density).abs() < 1e-9, "{back} for {density}");
        }
        assert_eq!(water.pressure(1000.0), 0.0);
        assert_eq!(water.density(-1e12), 0.0);
    }

    #[test]
    fn the_slope_at_rest_is_the_square_of_the_speed_of_sound() {
        let water = Tait::new(1000.0, 40.0);
        let slope = (water.pressure(1000.1) - water.pressure(999.9)) / 0.2;
        assert!((slope / 1600.0 - 1.0).abs() < 1e-6, "{slope}");
    }
}
