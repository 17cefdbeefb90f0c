//! The end of a run: the table on the terminal and the same figures as JSON.

use std::fmt;
use std::path::Path;

use serde_json::{Value, json};

use crate::case::{Arrival, CaseFile, SchemeKind};
use crate::exact::ErrorMeasure;
use crate::halo::Sharing;
use crate::invariants::Invariants;
use crate::memory;
use crate::output::comparison::{ArrivalTime, Comparison, SeriesError};
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
    /// What the flow should have kept.
    pub invariants: Invariants<D>,
    /// Errors against references.
    pub comparison: Comparison,
    /// Errors against the exact solution.
    pub errors: Vec<ErrorMeasure>,
    /// The pressure solver in force.
    pub solver: &'a str,
    /// Wall-clock time of the time loop in s, over all parts of a resumed run.
    pub wall_s: f64,
    /// How ranks shared the liquid, if there were several.
    pub sharing: Option<Sharing>,
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
        let series = self.comparison.series.iter().map(series_json);
        let arrivals = self.comparison.arrivals.iter().map(|a| {
            json!({
                "quantity": a.arrival.quantity, "level": a.arrival.level, "time_s": a.time,
                "expected_time_s": a.expected, "source": a.arrival.source,
            })
        });
        let missing = self.comparison.missing.iter().map(|(name, _)| name);
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
            "ended": self.failure.as_deref().unwrap_or(crate::run::AT_THE_END),
            "time_s": self.time,
            "steps": self.step,
            "wall_s": self.wall_s,
            "stages_s": stages,
            "memory_mb": memory::peak_mb(),
            "ranks": self.sharing,
            "particles": {
                "fluid": self.particles.fluid().len(), "wall": self.particles.walls().len(),
                "dummy": self.particles.dummies().len(), "left": t.left, "through_walls": t.through_walls,
            },
            "solver": solver,
            "compressibility": compressibility,
            "energy": {
                "initial_j": self.invariants.energy.initial, "largest_rise_of_initial": self.rise(),
                "work_done_j": self.invariants.energy.input,
            },
            "invariants": {
                "volume_change_percent": 100.0 * self.invariants.volume,
                "largest_density_error_percent": 100.0 * self.invariants.density,
                "divergence_percent": 100.0 * self.invariants.divergence,
                "momentum_percent": 100.0 * self.invariants.momentum,
            },
            "pressure_roughness": self.invariants.roughness,
            "clipped_pressures": t.clipped,
            "collisions": t.collisions,
            "retried_steps": t.retries,
            "errors": self.errors,
            "references": series.collect::<Vec<_>>(),
            "references_not_given": missing.collect::<Vec<_>>(),
            "arrivals": arrivals.collect::<Vec<_>>(),
        })
    }

    fn mean_iterations(&self) -> f64 {
        self.totals.iterations as f64 / self.step.max(1) as f64
    }

    fn rise(&self) -> f64 {
        self.invariants.energy.largest_rise / self.invariants.energy.initial.abs()
    }

    fn used(&self) -> String {
        let scheme = &self.case.scheme;
        let projects = scheme.kind.solves();
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
        let i = &self.invariants;
        line(
            "strayed",
            format!(
                "volume {:+.2} %, density up to {:.1} %, divergence {:.2} % of speed over spacing, pressure rough by {:.2} %",
                100.0 * i.volume,
                100.0 * i.density,
                100.0 * i.divergence,
                100.0 * i.roughness
            ),
        )?;
        if t.clipped + t.collisions > 0 {
            line("splash", format!("{} pressures clipped, {} collisions", t.clipped, t.collisions))?;
        }
        if t.retries > 0 {
            line("retries", format!("{} steps done again, half as long", t.retries))?;
        }
        let stages =
            self.scheme.stages().iter().map(|(name, spent)| format!("{name} {:.2}", spent.as_secs_f64()));
        line("stages, s", stages.collect::<Vec<_>>().join(", "))?;
        if let Some(sharing) = self.sharing {
            line(
                "ranks",
                format!(
                    "{}, the busiest with {:.2} times the mean work, the fullest with {:.2} times the mean liquid; {:.2} ghosts a particle, {} particles handed over, cut {} times; {} calls beside PETSc's, {:.3} MB sent, {:.2} s of waiting a rank",
                    sharing.ranks,
                    sharing.imbalance,
                    sharing.fullest,
                    sharing.ghosts_per_particle,
                    sharing.handed_over,
                    sharing.cuts,
                    sharing.calls,
                    1e-6 * sharing.sent_bytes,
                    sharing.waited_s
                ),
            )?;
        }
        if let Some(memory) = memory::peak_mb() {
            line("memory", format!("{memory:.0} MB at most"))?;
        }
        for e in &self.errors {
            line(
                "error",
                format!("{}: rms {:.3} %, largest {:.3} % of {}", e.name, 100.0 * e.rms, 100.0 * e.max, e.of),
            )?;
        }
        for (name, value) in reference_lines(&self.comparison) {
            line(name, value)?;
        }
        for arrival in &self.comparison.arrivals {
            line("arrival", arrival_sentence(arrival))?;
        }
        line("files", self.folder.display().to_string())
    }
}

/// One window of one reference for scripts; sizes in SI units, differences over `size`.
fn series_json(s: &SeriesError) -> Value {
    let mut value = json!({
        "name": s.name, "from_s": s.window.0, "until_s": s.window.1, "values": s.count,
        "normalised_by": s.normalised_by, "size": s.size, "rms": s.rms, "largest": s.largest,
        "best_shift_s": s.best_shift.0, "rms_after_shift": s.best_shift.1,
    });
    if let Some(peak) = s.peak {
        value["peak"] = json!({
            "value": peak.run.1, "time_s": peak.run.0,
            "reference_value": peak.reference.1, "reference_time_s": peak.reference.0,
        });
    }
    if let Some(noise) = s.noise {
        value["noise"] = json!({ "value": noise.run, "reference_value": noise.reference });
    }
    value
}

/// What the references say: a table with a row for each window, what it is normalised by, and what was not given.
fn reference_lines(comparison: &Comparison) -> Vec<(&'static str, String)> {
    let Comparison { series, missing, .. } = comparison;
    let mut lines = vec![];
    let (compared, out_of_reach): (Vec<_>, Vec<_>) = series.iter().partition(|s| s.count > 0);
    if !compared.is_empty() {
        let width = compared.iter().map(|s| s.name.len()).max().unwrap_or(0);
        let head = format!(
            "{:width$} {:>13} {:>7} {:>7} {:>8} {:>7} {:>18} {:>18} {:>15}",
            "",
            "window, s",
            "rms %",
            "max %",
            "shift ms",
            "rms %",
            "peak at s",
            "measured",
            "noise, measured"
        );
        lines.push(("references", head.trim_end().to_owned()));
        for s in compared {
            let percent = |share: f64| format!("{:.2}", 100.0 * share);
            let peak = |(time, value): (f64, f64)| format!("{} at {time:.3}", short(value));
            let noise = s.noise.map(|n| format!("{}, {}", short(n.run), short(n.reference)));
            let row = format!(
                "{:width$} {:>13} {:>7} {:>7} {:>8.1} {:>7} {:>18} {:>18} {:>15}",
                s.name,
                format!("{:.2}-{:.2}", s.window.0, s.window.1),
                percent(s.rms),
                percent(s.largest),
                1e3 * s.best_shift.0,
                percent(s.best_shift.1),
                s.peak.map(|p| peak(p.run)).unwrap_or_default(),
                s.peak.map(|p| peak(p.reference)).unwrap_or_default(),
                noise.unwrap_or_default(),
            );
            lines.push(("", row.trim_end().to_owned()));
        }
    }
    let mut sizes: Vec<(&str, Vec<String>)> = vec![];
    for s in series.iter().filter(|s| s.count > 0) {
        let size = format!("{} {}", s.name, short(s.size));
        match sizes.iter_mut().find(|(by, _)| *by == s.normalised_by) {
            Some((_, all)) if !all.contains(&size) => all.push(size),
            Some(_) => {}
            None => sizes.push((&s.normalised_by, vec![size])),
        }
    }
    lines.extend(sizes.iter().map(|(by, all)| ("normalised by", format!("{by}: {}", all.join(", ")))));
    if !out_of_reach.is_empty() {
        let names = unique(out_of_reach.iter().map(|s| s.name.as_str()));
        lines.push(("references", format!("{names}: none of the values of a window within the run")));
    }
    if !missing.is_empty() {
        let names = unique(missing.iter().map(|(name, _)| name.as_str()));
        let file = missing.iter().find_map(|(_, file)| file.as_deref()).unwrap_or("NAME=FILE");
        lines.push(("references", format!("not given: {names} (--reference {file})")));
    }
    lines
}

fn unique<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let mut all: Vec<_> = names.collect();
    all.dedup();
    all.join(", ")
}

/// Four digits or a little more.
fn short(value: f64) -> String {
    match value.abs() {
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.4}"),
    }
}

fn arrival_sentence(found: &ArrivalTime) -> String {
    let Arrival { quantity, level, source, .. } = &found.arrival;
    let time = found.time.map_or("not within the run".to_owned(), |t| format!("{t:.4} s"));
    let expected = match found.expected {
        Some(expected) => format!("expected {expected} s"),
        None => "its reference was not given".to_owned(),
    };
    format!("{quantity} at {level}: {time}, {expected} ({source})")
}
