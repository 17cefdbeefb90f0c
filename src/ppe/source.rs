//! Right-hand sides of the pressure equation.
//!
//! With d = div v*, c = n / n_0 - 1 the error of the density (n the kernel sum and n_0 its value on the regular lattice, both
//! at the drifted positions), div((1/rho) grad p) is one of
//!
//! - *blended*: d / dt - gamma c / (dt max(dt, tau)). ISPH_DF (Cummins & Rudman 1999) asks for div v = 0 after the correction. Alone
//!   it lets small volume errors pile up, so a share gamma of the density source is added, the relaxed
//!   condition of Asai et al. (2012). It takes an error back within 1 / gamma steps; gamma = 0 is plain ISPH_DF. With adaptive
//!   steps tau is a tenth of the longest of them, which only steps made short by a fault feel: as below, shortening them would
//!   else make it worse.
//! - *density-invariant*: -c / (max(dt, 2 tau / 5) max(dt, tau)). ISPH_DI (Shao & Lo 2003) asks for the density of the lattice, with tau = 0.
//!   There r* is r + dt v*; here it is r + dt v, which lacks the same g dt^2 for liquid and walls alike. With adaptive steps
//!   tau is the longest of them at the start: else a short step answers to an error with a velocity c dx / dt, which makes the
//!   next step shorter still, and the run ends within a few steps (2D dam break at 0.27 s). Below 2 tau / 5 velocities c dx / tau a
//!   step, which nothing takes back, would still add up to any amount: there they shrink with the step. With a tenth in place of
//!   two fifths 60 s of `sloshing` at 0.05 m gain 66 % of their energy (9 %), with a fiftieth the run fails at 29 s.
//! - *error-compensating* (Khayyer & Gotoh 2011): (1 + |c|) d / dt - |d| c / dt. The divergence source with an error
//!   correction that grows with the errors themselves and has no constant.
//!
//! On the surface and within a neighbour of it a kernel sum is small because it is cut off, not because the water
//! expands: there only crowding (c > 0) counts. Surface rows carry no divergence at all, see
//! [`surface`](crate::terms::surface).

/// What the corrected velocity is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Source {
    /// No divergence, and a share gamma of the density error taken back a step.
    Blended {
        /// Share per step.
        gamma: f64,
        /// Time tau in s; shorter steps take back less.
        tau: f64,
    },
    /// The density of the lattice.
    DensityInvariant {
        /// Shortest time tau in s within which an error is taken back.
        tau: f64,
    },
    /// No divergence, and errors taken back in proportion to themselves.
    ErrorCompensating,
}

impl Source {
    /// Source of one row in 1/s2, with the sign of div((1/rho) grad p): `divergence` d in 1/s, `crowding` c, counted
    /// only where positive if `near_surface`, and dt in s.
    pub fn of(self, divergence: f64, crowding: f64, near_surface: bool, dt: f64) -> f64 {
        let (d, c) = (divergence, if near_surface { crowding.max(0.0) } else { crowding });
        match self {
            Self::Blended { gamma, tau } => d / dt - gamma * c / (dt * tau.max(dt)),
            Self::DensityInvariant { tau } => -c / (dt.max(0.4 * tau) * dt.max(tau)),
            Self::ErrorCompensating => ((1.0 + c.abs()) * d - d.abs() * c) / dt,
        }
    }

    /// As [`of`](Self::of), in the row of a wall. It says how the pressure meets the wall, which for a source without a divergence is
    /// all: how crowded it is there, the rows of the liquid know (the front of the 2D dam break is 2 ms earlier otherwise).
    pub fn of_wall(self, divergence: f64, crowding: f64, near_surface: bool, dt: f64) -> f64 {
        match self {
            Self::DensityInvariant { .. } => 0.0,
            _ => self.of(divergence, crowding, near_surface, dt),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn compressed_liquid_is_pushed_apart_by_every_source() {
        let all = [
            Source::Blended { gamma: 0.1, tau: 0.0 },
            Source::DensityInvariant { tau: 0.0 },
            Source::ErrorCompensating,
        ];
        for source in all {
            // Approaching and crowded: a maximum of pressure, div grad p < 0.
            assert!(source.of(-1.0, 0.02, false, 0.01) < 0.0, "{source:?}");
            let thin = source.of(0.0, -0.02, true, 0.01);
            assert!(thin == 0.0, "{source:?}: a deficit near the surface is truncation");
        }
        assert!((Source::Blended { gamma: 0.5, tau: 0.0 }.of(3.0, 0.02, false, 0.1) - 29.0).abs() < 1e-12);
        assert!((Source::DensityInvariant { tau: 0.0 }.of(3.0, 0.02, false, 0.1) + 2.0).abs() < 1e-12);
        assert!((Source::ErrorCompensating.of(-3.0, 0.02, false, 0.1) - (-30.6 - 0.6)).abs() < 1e-12);
    }
}
