//! Ordinary differential equations of known flows.

/// A solution at equal intervals of time, from 0.
pub struct Trajectory<const N: usize> {
    state: Vec<[f64; N]>,
    interval: f64,
}

impl<const N: usize> Trajectory<N> {
    /// Integrates dy/dt = `derivative(t, y)` from `start` until a little after `until` s in `steps` steps of the classical
    /// method of fourth order.
    pub fn new(
        start: [f64; N],
        until: f64,
        steps: usize,
        derivative: impl Fn(f64, [f64; N]) -> [f64; N],
    ) -> Self {
        // The last step of a run may end a little after the end of the run.
        let dt = 1.1 * until / steps as f64;
        let mut state = vec![start];
        for step in 0..steps {
            let (t, y) = (step as f64 * dt, state[step]);
            let moved = |k: [f64; N], by: f64| std::array::from_fn(|i| y[i] + by * k[i]);
            let k1 = derivative(t, y);
            let k2 = derivative(t + 0.5 * dt, moved(k1, 0.5 * dt));
            let k3 = derivative(t + 0.5 * dt, moved(k2, 0.5 * dt));
            let k4 = derivative(t + dt, moved(k3, dt));
            state
                .push(std::array::from_fn(|i| y[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])));
        }
        Self { state, interval: dt }
    }

    /// The state at `time` in s by linear interpolation.
    pub fn at(&self, time: f64) -> [f64; N] {
        // A run of no time at all stays at its start.
        let place = if self.interval > 0.0 { time / self.interval } else { 0.0 };
        let k = (place as usize).min(self.state.len() - 2);
        let part = (place - k as f64).min(1.0);
        std::array::from_fn(|i| (1.0 - part) * self.state[k][i] + part * self.state[k + 1][i])
    }

    /// Largest size of one component.
    pub fn largest(&self, component: usize) -> f64 {
        self.state.iter().map(|state| state[component].abs()).fold(0.0, f64::max)
    }
}
