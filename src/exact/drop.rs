//! A round drop of inviscid liquid stretched by v = (-s x, s y), without gravity (Monaghan 1994, section 5.1).
//!
//! It stays an ellipse with half axes a (along x) and b, and v = (-s(t) x, s(t) y). With
//! p = p_0 (1 - x^2/a^2 - y^2/b^2) the Euler equations give
//!
//! p_0 = rho s^2 a^2 b^2 / (a^2 + b^2),   ds/dt = s^2 (a^2 - b^2) / (a^2 + b^2),   da/dt = -s a,   db/dt = s b.
//!
//! Compared are both axes, from the second moments of the particles (2 sqrt(mean x^2) for an ellipse), and the pressure
//! at the centre (kernel mean over the liquid around it).

use super::{Exact, Quantity, Scale};
use crate::case::CaseFile;
use crate::output::quantities::Scene;
use crate::particles::Vector;

pub struct StretchingDrop {
    centre: [f64; 2],
    rate: f64,
    density: f64,
    /// (a, b, s) at equal intervals of time.
    solution: Vec<[f64; 3]>,
    interval: f64,
}

/// Steps of the fourth-order integration: its error is far below 1e-9.
const STEPS: usize = 4000;

impl StretchingDrop {
    pub fn new(case: &CaseFile, rate: f64, density: f64, until: f64) -> Self {
        let block = &case.fluid.blocks[0];
        let centre = [0, 1].map(|d| 0.5 * (block.min[d] + block.max[d]));
        let radius = 0.5 * (block.max[0] - block.min[0]);
        // A step may end a little after the end of the run.
        let interval = 1.1 * until / STEPS as f64;
        let mut state = [radius, radius, rate];
        let mut solution = vec![state];
        for _ in 0..STEPS {
            state = runge_kutta(state, interval);
            solution.push(state);
        }
        Self { centre, rate, density, solution, interval }
    }

    /// (a, b, s) by linear interpolation.
    fn at(&self, time: f64) -> [f64; 3] {
        let place = (time / self.interval).min((STEPS - 1) as f64);
        let (k, part) = (place as usize, place.fract());
        std::array::from_fn(|i| (1.0 - part) * self.solution[k][i] + part * self.solution[k + 1][i])
    }
}

fn derivative([a, b, s]: [f64; 3]) -> [f64; 3] {
    [-s * a, s * b, s * s * (a * a - b * b) / (a * a + b * b)]
}

/// One step of the classical fourth-order method.
fn runge_kutta(y: [f64; 3], dt: f64) -> [f64; 3] {
    let moved = |k: [f64; 3], by: f64| std::array::from_fn(|i| y[i] + by * k[i]);
    let k1 = derivative(y);
    let k2 = derivative(moved(k1, 0.5 * dt));
    let k3 = derivative(moved(k2, 0.5 * dt));
    let k4 = derivative(moved(k3, dt));
    std::array::from_fn(|i| y[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]))
}

impl<const D: usize> Exact<D> for StretchingDrop {
    fn initial_velocity(&self, r: &Vector<D>) -> Vector<D> {
        let mut v = Vector::zeros();
        v[0] = -self.rate * (r[0] - self.centre[0]);
        v[1] = self.rate * (r[1] - self.centre[1]);
        v
    }

    fn quantities(&self) -> Vec<Quantity> {
        vec![
            Quantity { column: "short_axis_m", scale: Scale::Exact },
            Quantity { column: "long_axis_m", scale: Scale::Exact },
            Quantity { column: "centre_pressure_pa", scale: Scale::Exact },
        ]
    }

    fn compare(&self, scene: &Scene<'_, D>, time: f64) -> Vec<(f64, f64)> {
        let [a, b, s] = self.at(time);
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
        let mut state = [1.0, 1.0, 100.0];
        for _ in 0..STEPS {
            state = runge_kutta(state, 0.0076 / STEPS as f64);
        }
        let [a, b, _] = state;
        assert!((a * b - 1.0).abs() < 1e-10, "{a} {b}");
        // Monaghan (1994), table I: b = 1.95 at 0.0076 s.
        assert!((b - 1.95).abs() < 0.01, "{b}");
    }
}
