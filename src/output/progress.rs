//! The line that says how far a run is: redrawn on a terminal, repeated every few seconds on a pipe.
//!
//! It goes to standard error, which leaves standard output to the results.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Time between two lines on a pipe.
const LINE_INTERVAL: Duration = Duration::from_secs(5);
/// Speeds are averages over about this many seconds, so that the ETA follows the flow but does not jump.
const MEMORY: f64 = 10.0;

/// Where a run is after a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Flow time in s.
    pub time: f64,
    /// Number of the step.
    pub step: u64,
    /// Time step in s.
    pub dt: f64,
    /// Iterations of the last pressure solve; none for a scheme without one.
    pub iterations: Option<usize>,
    /// Number of particles.
    pub particles: usize,
}

/// Shows a [`Status`] after each step, to whom it may concern.
#[derive(Debug)]
pub struct Progress {
    until: f64,
    display: Display,
    speed: Speed,
}

#[derive(Debug)]
enum Display {
    Quiet,
    Terminal(ProgressBar),
    Pipe { shown: Instant },
}

impl Progress {
    /// Progress towards the flow time `until` in s.
    pub fn new(until: f64, quiet: bool) -> Self {
        let display = if quiet {
            Display::Quiet
        } else if std::io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            Display::Terminal(
                bar.with_style(ProgressStyle::with_template("{wide_msg}").expect("a valid template")),
            )
        } else {
            Display::Pipe { shown: Instant::now() }
        };
        Self { until, display, speed: Speed::default() }
    }

    /// Reports a finished step.
    pub fn update(&mut self, status: &Status) {
        if matches!(self.display, Display::Quiet) {
            return;
        }
        self.speed.update(Instant::now(), status);
        match &mut self.display {
            Display::Terminal(bar) => bar.set_message(line(status, self.until, &self.speed)),
            Display::Pipe { shown } if shown.elapsed() > LINE_INTERVAL => {
                *shown = Instant::now();
                eprintln!("{}", line(status, self.until, &self.speed));
            }
            Display::Pipe { .. } | Display::Quiet => {}
        }
    }

    /// Removes the line from a terminal, where the results follow.
    pub fn finish(&self) {
        if let Display::Terminal(bar) = &self.display {
            bar.finish_and_clear();
        }
    }
}

/// Running averages of how fast a run goes.
#[derive(Debug, Default)]
struct Speed {
    last: Option<(Instant, f64, u64)>,
    /// Wall seconds a step.
    per_step: Option<f64>,
    /// Wall seconds a second of flow.
    per_flow_second: Option<f64>,
}

impl Speed {
    fn update(&mut self, now: Instant, status: &Status) {
        if let Some((then, time, step)) = self.last {
            let elapsed = now.duration_since(then).as_secs_f64();
            average(&mut self.per_step, elapsed, status.step.saturating_sub(step) as f64);
            average(&mut self.per_flow_second, elapsed, status.time - time);
        }
        self.last = Some((now, status.time, status.step));
    }
}

/// Moves an average of `elapsed / progress` towards its newest value, as far as `elapsed` justifies.
fn average(mean: &mut Option<f64>, elapsed: f64, progress: f64) {
    if progress > 0.0 {
        let newest = elapsed / progress;
        let weight = 1.0 - (-elapsed / MEMORY).exp();
        *mean = Some(mean.map_or(newest, |mean| mean + weight * (newest - mean)));
    }
}

fn line(status: &Status, until: f64, speed: &Speed) -> String {
    let Status { time, step, dt, iterations, particles } = status;
    let mut line = format!("t = {time:.4} of {until} s  step {step}  dt = {dt:.2e} s");
    if let Some(iterations) = iterations {
        line += &format!("  {iterations} iterations");
    }
    line += &format!("  {particles} particles");
    if let Some(seconds) = speed.per_step {
        line += &format!("  {seconds:.3} s/step");
    }
    if let Some(seconds) = speed.per_flow_second {
        line += &format!("  ETA {}", clock(seconds * (until - time).max(0.0)));
    }
    line
}

/// Hours, minutes and seconds, as `1:02:03`.
fn clock(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    format!("{}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATUS: Status = Status { time: 0.25, step: 100, dt: 5e-4, iterations: Some(12), particles: 3200 };

    #[test]
    fn the_line_says_it_all() {
        let start = Instant::now();
        let mut speed = Speed::default();
        for step in 0..=10 {
            let status = Status { time: 0.2 + 0.005 * step as f64, step: 90 + step, ..STATUS };
            speed.update(start + Duration::from_secs(2 * step), &status);
        }
        let expected = "t = 0.2500 of 1.25 s  step 100  dt = 5.00e-4 s  12 iterations  3200 particles  \
                        2.000 s/step  ETA 0:06:40";
        assert_eq!(line(&STATUS, 1.25, &speed), expected);
    }

    #[test]
    fn a_scheme_without_solver_shows_no_iterations() {
        let line = line(&Status { iterations: None, ..STATUS }, 1.0, &Speed::default());
        assert_eq!(line, "t = 0.2500 of 1 s  step 100  dt = 5.00e-4 s  3200 particles");
    }

    #[test]
    fn averages_forget() {
        let mut mean = None;
        average(&mut mean, 1.0, 1.0);
        average(&mut mean, 100.0, 10.0);
        assert!((mean.unwrap() - 10.0).abs() < 1e-3);
        average(&mut mean, 1.0, 0.0);
        assert!((mean.unwrap() - 10.0).abs() < 1e-3);
    }

    #[test]
    fn quiet_and_finish_do_not_panic() {
        for quiet in [true, false] {
            let mut progress = Progress::new(1.0, quiet);
            progress.update(&STATUS);
            progress.finish();
        }
    }
}
