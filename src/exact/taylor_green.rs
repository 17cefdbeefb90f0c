//! Decaying vortices of Taylor & Green (1937) in a periodic square of side L:
//!
//! v = U exp(-2 nu k^2 t) (-cos kx sin ky, sin kx cos ky),   k = 2 pi / L
//!
//! an exact solution of the Navier-Stokes equations. Compared are the amplitude of this mode in the particles' velocities,
//! sum v . m / sum m . m with m the mode for U = 1, and the velocity itself (root mean square over all particles).

use super::{Exact, Quantity, Scale};
use crate::output::quantities::Scene;
use crate::particles::Vector;
use crate::scheme::Params;

pub struct TaylorGreen {
    speed: f64,
    density: f64,
    wave_number: f64,
    decay_rate: f64,
}

impl TaylorGreen {
    pub fn new<const D: usize>(speed: f64, params: &Params<D>) -> Self {
        let side = params.periodic.and_then(|domain| domain.period[0]).unwrap_or(1.0);
        let wave_number = std::f64::consts::TAU / side;
        Self {
            speed,
            density: params.density,
            wave_number,
            decay_rate: 2.0 * params.kinematic_viscosity * wave_number.powi(2),
        }
    }

    fn mode<const D: usize>(&self, r: &Vector<D>) -> Vector<D> {
        let (x, y) = (self.wave_number * r[0], self.wave_number * r[1]);
        let mut v = Vector::zeros();
        (v[0], v[1]) = (-x.cos() * y.sin(), x.sin() * y.cos());
        v
    }
}

impl<const D: usize> Exact<D> for TaylorGreen {
    fn initial_velocity(&self, r: &Vector<D>) -> Vector<D> {
        self.speed * self.mode(r)
    }

    fn initial_pressure(&self, r: &Vector<D>) -> f64 {
        let phase = |x: f64| (2.0 * self.wave_number * x).cos();
        -0.25 * self.density * self.speed * self.speed * (phase(r[0]) + phase(r[1]))
    }

    fn quantities(&self) -> Vec<Quantity> {
        vec![
            Quantity { column: "amplitude_m_per_s", scale: Scale::Exact },
            Quantity {
                column: "velocity_error_m_per_s",
                scale: Scale::Fixed(self.speed, "the initial speed"),
            },
        ]
    }

    fn compare(&self, scene: &Scene<'_, D>, time: f64) -> Vec<(f64, f64)> {
        let amplitude = self.speed * (-self.decay_rate * time).exp();
        let (mut projected, mut norm, mut square) = (0.0, 0.0, 0.0);
        for a in scene.particles.fluid() {
            let (v, mode) = (scene.particles.velocity[a], self.mode(&scene.particles.position[a]));
            projected += v.dot(&mode);
            norm += mode.norm_squared();
            square += (v - amplitude * mode).norm_squared();
        }
        let count = scene.particles.fluid().len() as f64;
        vec![(projected / norm, amplitude), ((square / count).sqrt(), 0.0)]
    }
}
