//! A round drop of inviscid liquid stretched by v = (-s x, s y), without gravity (Monaghan 1994, section 5.1).
//!
//! It stays an ellipse with half axes a (along x) and b, and v = (-s(t) x, s(t) y). With
//! p = p_0 (1 - x^2/a^2 - y^2/b^2) the Euler equations give
//!
//! p_0 = rho s^2 a^2 b^2 / (a^2 + b^2),   ds/dt = s^2 (a^2 - b^2) / (a^2 + b^2),   da/dt = -s a,   db/dt = s b.
//!
//! Compared are both axes, from the second moments of the particles (2 sqrt(mean x^2) for an ellipse), and the pressure
//! at the centre (kernel mean over the liquid around it).

use super::ode::Trajectory;
use super::{Exact, Quantity, Scale};
use crate::case::CaseFile;
use crate::output::quantities::Scene;
use crate::particles::Vector;

pub struct StretchingDrop {
    centre: [f64; 2],
    rate: f64,
    density: f64,
    radius: f64,
    /// (a, b, s).
    solution: Trajectory<3>,
}

/// Steps of the fourth-order integration: its error is far below 1e-9.
const STEPS: usize = 4000;

impl StretchingDrop {
    pub fn new(case: &CaseFile, rate: f64, density: f64, until: f64) -> Self {
        let block = &case.fluid.blocks[0];
        let centre = [0, 1].map(|d| 0.5 * (block.min[d] + block.max[d]));
        let radius = 0.5 * (block.max[0] - block.min[0]);
        let solution = Trajectory::new([radius, radius, rate], until, STEPS, derivative);
        Self { centre, rate, density, radius, solution }
    }
}

fn derivative(_: f64, [a, b, s]: [f64; 3]) -> [f64; 3] {
    [-s * a, s * b, s * s * (a * a - b * b) / (a * a + b * b)]
}

impl<const D: usize> Exact<D> for StretchingDrop {
    fn initial_velocity(&self, r: &Vector<D>) -> Vector<D> {
        let mut v = Vector::zeros();
        v[0] = -self.rate * (r[0] - self.centre[0]);
        v[1] = self.rate * (r[1] - self.centre[1]);
        v
    }

    fn initial_pressure(&self, r: &Vector<D>) -> f64 {
        let square: f64 = (0..2).map(|d| (r[d] - self.centre[d]).powi(2)).sum();
        0.5 * self.density * self.rate * self.rate * (self.radius * self.radius - square).max(0.0)
    }

    fn quantities(&self) -> Vec<Quantity> {
        vec![
            Quantity { column: "short_axis_m", scale: Scale::Exact },
            Quantity { column: "long_axis_m", scale: Scale::Exact },
            Quantity { column: "centre_pressure_pa", scale: Scale::Exact },
        ]
    }

    fn compare(&self, scene: &Scene<'_, D>, time: f64) -> Vec<(f64, f64)> {
        let [a, b, s] = self.solution.at(time);
        let particles = scene.particles;
        let count = particles.fluid().len() as f64;
        let mean: Vector<D> = particles.fluid().map(|k| particles.position[k]).sum::<Vector<D>>() / count;
        let half_axis = |d: usize| {
            let square = particles.fluid().map(|k| (particles.position[k][d] - mean[d]).powi(2)).sum::<f64>();
            2.0 * (square / count).sqrt()
        };
        let pressure = self.density * s * s * a * a * b * b / (a * a + b * b);
        vec![(half_axis(0), a), (half_axis(1), b), (scene.mean_pressure_around(&mean), pressure)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_stays_and_the_table_of_monaghan_is_met() {
        let solution = Trajectory::new([1.0, 1.0, 100.0], 0.0076, STEPS, derivative);
        let [a, b, _] = solution.at(0.0076);
        assert!((a * b - 1.0).abs() < 1e-6, "{a} {b}");
        // Monaghan (1994), table I: b = 1.95 at 0.0076 s.
        assert!((b - 1.95).abs() < 0.01, "{b}");
    }
}
