//! The end of a run: the table on the terminal and the same figures as JSON.

use std::fmt;
use std::path::Path;

use serde_json::{Value, json};

use crate::case::{Arrival, CaseFile, SchemeKind};
use crate::output::comparison::Comparison;
use crate::output::observers::Energy;
use crate::particles::Particles;
use crate::scheme::{Compressibility, Scheme};
use crate::simulation::Totals;

/// Everything the end table shows.
pub struct Report<'a, const D: usize> {
    /// The case that ran.
    pub case: &'a CaseFile,
    /// The scheme, for its stage times.
    pub scheme: &'a dyn Scheme<D>,
    /// Particles at the end.
    pub particles: &'a Particles<D>,
    /// Flow time reached, in s.
    pub time: f64,
    /// Steps done.
    pub step: u64,
    /// Counts over the run.
    pub totals: Totals,
    /// Energies of the run.
    pub energy: Energy,
    /// Errors against references.
    pub comparison: Comparison,
    /// The pressure solver in force.
    pub solver: &'a str,
    /// Wall-clock time of the time loop in s.
    pub wall_s: f64,
    /// Where the files are.
    pub folder: &'a Path,
    /// Why the run ended early, if it did.
    pub failure: Option<String>,
}

impl<const D: usize> Report<'_, D> {
    /// The report for scripts.
    pub fn json(&self) -> Value {
        let t = &self.totals;
        let stages: serde_json::Map<String, Value> = self
            .scheme
            .stages()
            .iter()
            .map(|(name, spent)| (name.into(), spent.as_secs_f64().into()))
            .collect();
        let series = self.comparison.series.iter().map(|s| {
            json!({
                "name": s.name, "values": s.count, "rms_of_mean": s.rms, "largest_of_mean": s.largest,
                "best_shift_s": s.best_shift.0, "rms_of_mean_after_shift": s.best_shift.1,
            })
        });
        let arrivals = self.comparison.arrivals.iter().map(|a| {
            json!({
                "quantity": a.expected.quantity, "level": a.expected.level, "time_s": a.time,
                "expected_time_s": a.expected.expected_time, "source": a.expected.source,
            })
        });
        let compressibility = self.scheme.compressibility();
        let mut solver = json!({ "in_force": self.solver });
        if compressibility.is_none() {
            solver["mean_iterations"] = self.mean_iterations().into();
            solver["most_iterations"] = t.most_iterations.into();
            solver["fallbacks"] = t.fallbacks.into();
        }
        let compressibility = compressibility.map(|c| {
            json!({ "sound_speed_m_per_s": c.sound_speed, "largest_density_variation": c.largest_variation })
        });
        json!({
            "case": self.case.name,
            "version": env!("CARGO_PKG_VERSION"),
            "ended": self.failure.as_deref().unwrap_or("at the end"),
            "time_s": self.time,
            "steps": self.step,
            "wall_s": self.wall_s,
            "stages_s": stages,
            "memory_mb": peak_memory_mb(),
            "particles": {
                "fluid": self.particles.fluid().len(), "wall": self.particles.walls().len(),
                "dummy": self.particles.dummies().len(), "left": t.left, "through_walls": t.through_walls,
            },
            "solver": solver,
            "compressibility": compressibility,
            "energy": {
                "initial_j": self.energy.initial, "largest_rise_of_initial": self.rise(),
            },
            "clipped_pressures": t.clipped,
            "collisions": t.collisions,
            "references": series.collect::<Vec<_>>(),
            "arrivals": arrivals.collect::<Vec<_>>(),
        })
    }

    fn mean_iterations(&self) -> f64 {
        self.totals.iterations as f64 / self.step.max(1) as f64
    }

    fn rise(&self) -> f64 {
        self.energy.largest_rise / self.energy.initial.abs()
    }

    fn used(&self) -> String {
        let scheme = &self.case.scheme;
        let projects = scheme.kind == SchemeKind::IsphDf;
        let all = [
            ("viscosity", self.case.fluid.kinematic_viscosity > 0.0),
            ("shifting", scheme.shifting > 0.0 && scheme.kind != SchemeKind::WcsphMonaghan),
            ("pressure clip", scheme.clip_negative_pressure && projects),
            ("collisions", scheme.collision_distance > 0.0 && projects),
            ("gauges", !self.case.probes.is_empty()),
        ];
        let used: Vec<_> = all.iter().filter(|(_, on)| *on).map(|(name, _)| *name).collect();
        format!("{D}D, {}", used.join(", "))
    }
}

impl<const D: usize> fmt::Display for Report<'_, D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut line = |name: &str, value: String| writeln!(f, "{name:<14} {value}");
        let t = &self.totals;
        let how = self.failure.as_deref().map_or("done".to_owned(), |why| format!("stopped: {why}"));
        line("case", format!("{}, {how}", self.case.name))?;
        line("used", self.used())?;
        line("solver", self.solver.replace('\n', "\n               "))?;
        line("flow", format!("{:.4} s in {} steps, {:.1} s wall clock", self.time, self.step, self.wall_s))?;
        line(
            "particles",
            format!(
                "{} fluid at the end, {} left over open sides, {} through walls",
                self.particles.fluid().len(),
                t.left,
                t.through_walls
            ),
        )?;
        match self.scheme.compressibility() {
            Some(Compressibility { largest_variation, .. }) => {
                line("density", format!("within {:.2} % of the reference", 100.0 * largest_variation))?;
            }
            None => line(
                "iterations",
                format!(
                    "{:.1} mean, {} most, {} fallbacks",
                    self.mean_iterations(),
                    t.most_iterations,
                    t.fallbacks
                ),
            )?,
        }
        line("energy", format!("largest rise {:.4} % of the initial", 100.0 * self.rise()))?;
        if t.clipped + t.collisions > 0 {
            line("splash", format!("{} pressures clipped, {} collisions", t.clipped, t.collisions))?;
        }
        let stages =
            self.scheme.stages().iter().map(|(name, spent)| format!("{name} {:.2}", spent.as_secs_f64()));
        line("stages, s", stages.collect::<Vec<_>>().join(", "))?;
        if let Some(memory) = peak_memory_mb() {
            line("memory", format!("{memory:.0} MB at most"))?;
        }
        for s in &self.comparison.series {
            if s.count == 0 {
                line("reference", format!("{}: none of its values within the run", s.name))?;
                continue;
            }
            line(
                "reference",
                format!(
                    "{}: rms {:.2} % of the mean, largest {:.2} %, with a shift of {:.4} s rms {:.2} % ({} values)",
                    s.name,
                    100.0 * s.rms,
                    100.0 * s.largest,
                    s.best_shift.0,
                    100.0 * s.best_shift.1,
                    s.count
                ),
            )?;
        }
        for a in &self.comparison.arrivals {
            let time = a.time.map_or("not within the run".to_owned(), |t| format!("{t:.4} s"));
            let Arrival { quantity, level, expected_time, source } = &a.expected;
            line("arrival", format!("{quantity} at {level}: {time}, expected {expected_time} s ({source})"))?;
        }
        line("files", self.folder.display().to_string())
    }
}

/// Largest resident memory of this process in MB, where the system tells.
fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<f64>().ok()? / 1024.0)
}
