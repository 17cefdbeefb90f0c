//! Small standing waves between two vertical walls (Lamb 1932, sections 228 and 348).
//!
//! In a tank of length L with water of depth H, mode n has k = n pi / L, w^2 = g k tanh(kH), and the velocity
//!
//! v = q(t) (-cosh(ky) sin(kx), sinh(ky) cos(kx)) / sinh(kH)
//!
//! with q the vertical velocity at the crest. Walls slip freely, so that viscosity acts through the bulk alone and every
//! amplitude decays as exp(-2 nu k^2 t). A body force g_x along the tank (a tank that is shaken: minus its acceleration) enters
//! the pressure condition at the surface, d phi/dt + g eta cos(kx) = g_x x, of whose right-hand side mode n takes the part
//! (2/L) int x cos(kx) dx = -4 / (L k^2) if n is odd, and none if it is even:
//!
//! dq/dt = -w^2 eta - 4 nu k^2 q - (4 / (L k)) tanh(kH) g_x,   d eta/dt = q.
//!
//! Compared is q, found by projecting the particles' velocities on the mode, which other modes do not disturb; and of a free wave, from
//! its series, period (twice the time between zeros) and damping (slope of the logarithm of its extremes).

use super::ode::Trajectory;
use super::{ErrorMeasure, Exact, Quantity, Scale};
use crate::case::CaseFile;
use crate::motion::Motion;
use crate::output::quantities::Scene;
use crate::particles::Vector;
use crate::scheme::Params;

pub struct StandingWave {
    /// Left end of the tank and its floor, in m.
    origin: [f64; 2],
    depth: f64,
    wave_number: f64,
    /// q at the start in m/s.
    speed: f64,
    /// (eta, q) in m and m/s.
    solution: Trajectory<2>,
    /// Whether the tank is shaken.
    is_driven: bool,
}

/// Steps of the integration in a period of the free wave: interpolation between them errs by less than 1e-6.
const STEPS_IN_A_PERIOD: f64 = 3000.0;

impl StandingWave {
    /// Mode `mode` with q = `amplitude` w at the start, driven by the motion of the tank, if it moves.
    pub fn new<const D: usize>(case: &CaseFile, amplitude: f64, mode: u32, params: &Params<D>) -> Self {
        let block = &case.fluid.blocks[0];
        let up = D - 1;
        let (length, depth) = (block.max[0] - block.min[0], block.max[up] - block.min[up]);
        let k = f64::from(mode) * std::f64::consts::PI / length;
        let square = params.gravity.norm() * k * (k * depth).tanh();
        let damping = 4.0 * params.kinematic_viscosity * k * k;
        let odd = f64::from(mode % 2);
        let share = odd * 4.0 / (length * k) * (k * depth).tanh();
        let motion = Motion::<D>::of(case);
        let push = |time| motion.as_ref().map_or(0.0, |motion| share * motion.acceleration(time)[0]);
        let speed = amplitude * square.sqrt();
        let until = case.time.until;
        let steps = (until * square.sqrt() / std::f64::consts::TAU * STEPS_IN_A_PERIOD).ceil().max(1.0);
        let rate = |time, [eta, q]: [f64; 2]| [q, push(time) - square * eta - damping * q];
        Self {
            origin: [block.min[0], block.min[up]],
            depth,
            wave_number: k,
            speed,
            solution: Trajectory::new([0.0, speed], until, steps as usize, rate),
            is_driven: motion.is_some(),
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
}

impl<const D: usize> Exact<D> for StandingWave {
    fn initial_velocity(&self, r: &Vector<D>) -> Vector<D> {
        self.speed * self.mode(r)
    }

    fn quantities(&self) -> Vec<Quantity> {
        let scale = match self.is_driven {
            true => Scale::Fixed(self.solution.largest(1), "the largest exact crest speed"),
            false => Scale::Fixed(self.speed, "the initial crest speed"),
        };
        vec![Quantity { column: "crest_speed_m_per_s", scale }]
    }

    fn compare(&self, scene: &Scene<'_, D>, time: f64) -> Vec<(f64, f64)> {
        let (mut projected, mut norm) = (0.0, 0.0);
        for a in scene.particles.fluid() {
            let mode = self.mode(&scene.particles.position[a]);
            projected += scene.particles.velocity[a].dot(&mode);
            norm += mode.norm_squared();
        }
        vec![(projected / norm, self.solution.at(time)[1])]
    }

    fn of_series(&self, time: &[f64], series: &[Vec<(f64, f64)>]) -> Vec<ErrorMeasure> {
        if self.is_driven {
            return vec![];
        }
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
    use crate::case::{build, builtin, read};

    /// The built-in case `name` with `sets`, and its wave.
    fn wave(name: &str, sets: &[(&str, &str)]) -> (StandingWave, Params<2>) {
        let sets: Vec<_> = sets.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        let case = read::read(builtin::find(name).unwrap(), name, &sets).unwrap();
        let params = build::scene::<2>(&case).params;
        (StandingWave::new(&case, if name == "sloshing" { 0.0 } else { 0.02 }, 1, &params), params)
    }

    #[test]
    fn a_free_wave_is_a_damped_oscillation() {
        let (wave, params) = wave("standing_wave", &[("spacing", "0.1")]);
        let k = wave.wave_number;
        let damping = 2.0 * params.kinematic_viscosity * k * k;
        let damped = (9.81 * k * (k * wave.depth).tanh() - damping * damping).sqrt();
        for time in [0.0, 0.7, 3.1, 7.9] {
            let (sin, cos) = (damped * time).sin_cos();
            let exact = wave.speed * (-damping * time).exp() * (cos - damping / damped * sin);
            assert!((wave.solution.at(time)[1] - exact).abs() < 2e-6 * wave.speed, "{time}");
        }
    }

    #[test]
    fn a_driven_wave_answers_slow_shaking_by_the_slope_of_the_surface() {
        // At rest in a steady acceleration the surface slopes by g_x / g, of which mode 1 has the share 4 L / pi^2.
        let rows = "[[0, 0, 0], [20, 0.1, 0]]";
        let sets =
            [("motion", &*format!("{{acceleration = {rows}}}")), ("time.until", "20"), ("spacing", "0.05")];
        let (wave, _) = wave("sloshing", &sets);
        let pi = std::f64::consts::PI;
        let slope = 0.05 / 9.81; // at 10 s
        let [eta, _] = wave.solution.at(10.0);
        assert!((eta - 4.0 / (pi * pi) * slope).abs() < 0.02 * eta, "{eta}");
    }

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
