//! Small standing waves between two vertical walls (Lamb 1932, sections 228 and 348).
//!
//! In a tank of length L with water of depth H, mode n has k = n pi / L, w^2 = g k tanh(kH), and the velocity
//!
//! v = q(t) (-cosh(ky) sin(kx), sinh(ky) cos(kx)) / sinh(kH)
//!
//! with q the vertical velocity at the crest. Walls slip freely, so that viscosity acts through the bulk alone and every
//! amplitude decays as exp(-2 nu k^2 t). A body force g_x along the tank (a tank that is shaken) drives odd modes:
//!
//! dq/dt = -w^2 eta - 4 nu k^2 q - (4 / (L k)) tanh(kH) g_x,   d eta/dt = q.
//!
//! Compared is q, found by projecting the particles' velocities on the mode, and from its series period (twice the time between
//! zeros) and damping (slope of the logarithm of its extremes).

use super::{ErrorMeasure, Exact, Quantity, Scale};
use crate::case::CaseFile;
use crate::output::quantities::Scene;
use crate::particles::Vector;
use crate::scheme::Params;

pub struct StandingWave {
    /// Left end of the tank and its floor, in m.
    origin: [f64; 2],
    depth: f64,
    wave_number: f64,
    /// Angular frequency without damping, in 1/s.
    frequency: f64,
    damping: f64,
    /// q at the start in m/s.
    speed: f64,
}

impl StandingWave {
    pub fn new<const D: usize>(case: &CaseFile, amplitude: f64, mode: u32, params: &Params<D>) -> Self {
        let block = &case.fluid.blocks[0];
        let up = D - 1;
        let (length, depth) = (block.max[0] - block.min[0], block.max[up] - block.min[up]);
        let wave_number = f64::from(mode) * std::f64::consts::PI / length;
        let gravity = params.gravity.norm();
        let frequency = (gravity * wave_number * (wave_number * depth).tanh()).sqrt();
        Self {
            origin: [block.min[0], block.min[up]],
            depth,
            wave_number,
            frequency,
            damping: 2.0 * params.kinematic_viscosity * wave_number.powi(2),
            speed: amplitude * frequency,
        }
    }

    fn mode<const D: usize>(&self, r: &Vector<D>) -> Vector<D> {
        let (x, y) =
            (self.wave_number * (r[0] - self.origin[0]), self.wave_number * (r[D - 1] - self.origin[1]));
        let crest = (self.wave_number * self.depth).sinh();
        let mut v = Vector::zeros();
        v[0] = -y.cosh() * x.sin() / crest;
        v[D - 1] = y.sinh() * x.cos() / crest;
        v
    }

    /// q at `time`, from a flat surface that moves at `speed`.
    fn exact(&self, time: f64) -> f64 {
        let damped = (self.frequency.powi(2) - self.damping.powi(2)).sqrt();
        let phase = damped * time;
        self.speed * (-self.damping * time).exp() * (phase.cos() - self.damping / damped * phase.sin())
    }
}

impl<const D: usize> Exact<D> for StandingWave {
    fn initial_velocity(&self, r: &Vector<D>) -> Vector<D> {
        self.speed * self.mode(r)
    }

    fn quantities(&self) -> Vec<Quantity> {
        let scale = Scale::Fixed(self.speed, "the initial crest speed");
        vec![Quantity { column: "crest_speed_m_per_s", scale }]
    }

    fn compare(&self, scene: &Scene<'_, D>, time: f64) -> Vec<(f64, f64)> {
        let (mut projected, mut norm) = (0.0, 0.0);
        for a in scene.particles.fluid() {
            let mode = self.mode(&scene.particles.position[a]);
            projected += scene.particles.velocity[a].dot(&mode);
            norm += mode.norm_squared();
        }
        vec![(projected / norm, self.exact(time))]
    }

    fn of_series(&self, time: &[f64], series: &[Vec<(f64, f64)>]) -> Vec<ErrorMeasure> {
        let of =
            |side: fn(&(f64, f64)) -> f64| oscillation(time, &series[0].iter().map(side).collect::<Vec<_>>());
        let (Some(found), Some(exact)) = (of(|pair| pair.0), of(|pair| pair.1)) else { return vec![] };
        let measure = |name: &str, found: f64, exact: f64| {
            let error = ((found - exact) / exact).abs();
            ErrorMeasure { name: name.to_owned(), rms: error, max: error, of: "the exact value".to_owned() }
        };
        vec![measure("period", found.0, exact.0), measure("damping", found.1, exact.1)]
    }
}

/// Period in s and rate of decay in 1/s of a damped oscillation; `None` before its third zero.
fn oscillation(time: &[f64], value: &[f64]) -> Option<(f64, f64)> {
    let mut zeros = vec![];
    let mut extremes: Vec<(f64, f64)> = vec![];
    let mut highest = (0.0, 0.0);
    for k in 1..value.len() {
        let (before, now) = (value[k - 1], value[k]);
        if now.abs() > highest.1 {
            highest = (time[k], now.abs());
        }
        if before * now < 0.0 {
            // The first stretch starts in the middle: its extreme is no extreme.
            if !zeros.is_empty() {
                extremes.push((highest.0, highest.1.ln()));
            }
            highest = (0.0, 0.0);
            zeros.push(time[k - 1] + (time[k] - time[k - 1]) * before / (before - now));
        }
    }
    if zeros.len() < 3 {
        return None;
    }
    let period = 2.0 * (zeros[zeros.len() - 1] - zeros[0]) / (zeros.len() - 1) as f64;
    let count = extremes.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| extremes.iter().map(f).sum::<f64>() / count;
    let (t, l) = (mean(|e| e.0), mean(|e| e.1));
    let (up, down) = extremes
        .iter()
        .fold((0.0, 0.0), |(up, down), e| (up + (e.0 - t) * (e.1 - l), down + (e.0 - t).powi(2)));
    Some((period, -up / down))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn period_and_damping_are_read_off_a_series() {
        let time: Vec<f64> = (0..4000).map(|k| 0.002 * f64::from(k)).collect();
        let value: Vec<f64> = time.iter().map(|t| 3.0 * (-0.2 * t).exp() * (5.0 * t).cos()).collect();
        let (period, damping) = oscillation(&time, &value).unwrap();
        assert!((period - std::f64::consts::TAU / 5.0).abs() < 1e-5, "{period}");
        assert!((damping - 0.2).abs() < 1e-4, "{damping}");
        assert!(oscillation(&time[..100], &value[..100]).is_none());
    }
}
