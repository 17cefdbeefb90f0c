//! A study: one case with several schemes and spacings, and what accuracy costs with each.
//!
//! Every run is a program of its own, this one with the arguments of the run: a run that fails takes nothing else with it
//! and starts with a fresh PETSc. Runs are kept in `DIR/runs/SCHEME-SPACING`; one that is there already is not repeated,
//! and one that was interrupted goes on, so that a study started again with the same arguments continues.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;

use clap::ValueEnum;
use serde_json::Value;

use crate::case::SchemeKind;
use crate::child::Child;
use crate::cli::{self, RunArgs, StudyArgs};
use crate::output::comparison::References;
use crate::output::picture::curves::{Curve, Mark, loglog_plot};
use crate::output::{Cell, write_atomic};
use crate::{Error, Result, run};

/// Spacings of a study that names none, in spacings of its case: halving twice shows an order, and the finest run takes as
/// long as the case alone.
const SPACINGS: [f64; 3] = [4.0, 2.0, 1.0];
/// Stands in tables where there is no number.
const NONE: &str = "none";

/// Does the runs of a study that are not done yet, and reports all.
///
/// # Errors
/// [`Error::Input`] before anything is written, [`Error::Interrupted`] after the present run has saved its state, and
/// [`Error::Run`] if no run reached its end.
pub fn study(args: &StudyArgs) -> Result<()> {
    let study = Study::plan(args)?;
    study.say(&study.sentence())?;
    let child = Child::with_signals();
    let mut outcomes = Vec::new();
    for (k, planned) in study.runs.iter().enumerate() {
        let what = format!("run {} of {}: {}", k + 1, study.runs.len(), planned.label());
        outcomes.push(match &planned.start {
            None => {
                log::info!("{what}: done before");
                Outcome::of(planned, None)
            }
            Some(start) => {
                log::info!("{what}");
                Outcome::of(planned, Some(child.run(&start.tokens())?))
            }
        });
        study.write_table(&outcomes)?;
    }
    let measure = study.measure(&outcomes)?;
    study.write_picture(&outcomes, &measure)?;
    study.say(&table(&outcomes, &measure))?;
    study.say(&format!("files          {}\n", study.folder.display()))?;
    if outcomes.iter().all(|outcome| outcome.failure.is_some()) {
        return Err(Error::Run("no run of the study reached its end: see the causes above".into()));
    }
    Ok(())
}

/// The built-in studies.
pub fn list() -> String {
    String::new()
}

/// What is to be done.
struct Study<'a> {
    args: &'a StudyArgs,
    name: String,
    folder: PathBuf,
    until: f64,
    runs: Vec<Planned>,
}

/// One run of a study.
struct Planned {
    scheme: String,
    spacing: f64,
    folder: PathBuf,
    /// Arguments of the program that does it; none: it is done.
    start: Option<RunArgs>,
}

impl<'a> Study<'a> {
    /// Everything that can be wrong is found here, before the first file is written.
    fn plan(args: &'a StudyArgs) -> Result<Self> {
        let common = args.run();
        let case = common.load_case()?;
        let folder =
            args.out.clone().unwrap_or_else(|| Path::new("out").join(format!("{}-study", case.name)));
        let mut schemes = args.schemes.clone();
        if schemes.is_empty() {
            schemes.push(case.scheme.kind);
        }
        let mut spacings = args.spacings.clone();
        if spacings.is_empty() {
            spacings = SPACINGS.map(|share| share * case.spacing).into();
        }
        // The coarsest first: it is the fastest to show that something is wrong.
        spacings.sort_by(|a, b| b.total_cmp(a));
        spacings.dedup();
        let mut runs: Vec<Planned> = Vec::new();
        for kind in schemes {
            for &spacing in &spacings {
                let mut run = common.clone();
                (run.method.scheme, run.method.spacing) = (Some(kind), Some(spacing));
                let planned = Planned::prove(run, (kind, spacing), &folder, args.force)?;
                if !runs.iter().any(|other| other.folder == planned.folder) {
                    runs.push(planned);
                }
            }
        }
        Ok(Self { args, name: case.name, folder, until: case.time.until, runs })
    }

    fn sentence(&self) -> String {
        let done = self.runs.iter().filter(|run| run.start.is_none()).count();
        let done = if done == 0 { String::new() } else { format!(", {done} of them done before") };
        let until = self.until;
        format!(
            "study of {}: {} runs until {until} s in {}{done}\n",
            self.name,
            self.runs.len(),
            self.folder.display()
        )
    }

    fn say(&self, text: &str) -> Result<()> {
        if self.args.common.quiet { Ok(()) } else { cli::print(text) }
    }

    /// The measure that was asked for, by its name or what its name begins with; otherwise the first.
    fn measure(&self, outcomes: &[Outcome]) -> Result<String> {
        let known = measures(outcomes);
        let found = match &self.args.measure {
            None => known.first(),
            Some(wanted) => known
                .iter()
                .find(|name| *name == wanted)
                .or_else(|| known.iter().find(|name| name.starts_with(&format!("{wanted}_")))),
        };
        match (found, &self.args.measure) {
            (Some(name), _) => Ok(name.clone()),
            (None, Some(wanted)) if !known.is_empty() => Err(Error::Input(format!(
                "--measure {wanted}: these runs have {}: choose one of them, the runs are kept",
                known.join(", ")
            ))),
            (None, _) => Ok("error".into()),
        }
    }

    /// study.csv: a row a run, a column and an observed order for each error measure.
    fn write_table(&self, outcomes: &[Outcome]) -> Result<()> {
        let measures = measures(outcomes);
        let mut text = String::from("scheme,spacing_m,particles,steps,wall_s");
        for name in &measures {
            let cell = |name: &str| Cell::Word(name).to_string();
            text += &format!(",{},{}", cell(name), cell(&format!("{name}_order")));
        }
        text += ",run,failure\n";
        for (k, outcome) in outcomes.iter().enumerate() {
            let number = |value: Option<f64>| value.map_or(Cell::Word(NONE), Cell::Number).to_string();
            let count = |key: &[&str]| outcome.count(key).map_or(NONE.to_owned(), |count| count.to_string());
            let mut cells = vec![
                outcome.scheme.clone(),
                number(Some(outcome.spacing)),
                count(&["particles", "fluid"]),
                count(&["steps"]),
                number(outcome.wall_s()),
            ];
            for name in &measures {
                cells.extend([number(outcome.error(name)), number(order(outcomes, k, name))]);
            }
            let run = outcome.folder.strip_prefix(&self.folder).unwrap_or(&outcome.folder);
            cells.push(Cell::Word(&run.to_string_lossy()).to_string());
            // A row is a line.
            let failure = outcome.failure.as_deref().unwrap_or(NONE).replace('\n', " ");
            cells.push(Cell::Word(&failure).to_string());
            text += &(cells.join(",") + "\n");
        }
        write_atomic(&self.folder.join("study.csv"), |file| file.write_all(text.as_bytes()))
    }

    /// study.png: error over run time, a line a scheme.
    fn write_picture(&self, outcomes: &[Outcome], measure: &str) -> Result<()> {
        let mut curves: Vec<Curve> = Vec::new();
        for (k, outcome) in outcomes.iter().enumerate() {
            let label = outcome.scheme.to_uppercase();
            if curves.last().is_none_or(|curve| curve.label != label) {
                curves.push(Curve { label, marks: Vec::new(), joined: true });
            }
            let spacing = outcome.spacing;
            let note = match (order(outcomes, k, measure), &outcome.failure) {
                (_, Some(_)) => format!("{spacing} m, failed"),
                (Some(order), _) => format!("{spacing} m, order {order:.1}"),
                (None, _) => format!("{spacing} m"),
            };
            let (Some(curve), Some(x)) = (curves.last_mut(), outcome.wall_s()) else { continue };
            let y = outcome.error(measure);
            if y.is_some() || outcome.failure.is_some() {
                curve.marks.push(Mark { x, y, note });
            }
        }
        let title = format!("{}: {} over run time", self.name, measure.replace('_', " "));
        let path = self.folder.join("study.png");
        loglog_plot(&path, &title, "run time, s", &measure.replace('_', " "), &curves)
    }
}

impl Planned {
    /// Proves a run and finds out what is left to do of it.
    fn prove(args: RunArgs, of: (SchemeKind, f64), study: &Path, force: bool) -> Result<Self> {
        let (kind, spacing) = of;
        let case = args.load_case()?;
        if kind == SchemeKind::PatchTest {
            return Err(Error::Input(
                "a study compares flows, and patch_test has none: run it by itself, it refines on its own"
                    .into(),
            ));
        }
        if (case.scheme.kind, case.spacing) != of {
            return Err(Error::Input(
                "--set names a spacing or a scheme, which a study varies: use --spacings and --schemes"
                    .into(),
            ));
        }
        References::read(&case, &args.reference_files(&case)?)?;
        let scheme = kind.to_possible_value().map(|kind| kind.get_name().to_owned()).unwrap_or_default();
        let folder = study.join("runs").join(format!("{scheme}-{spacing:?}"));
        let start = run::left_to_do(args, &case, &folder, force)?;
        Ok(Self { scheme, spacing, folder, start })
    }

    fn label(&self) -> String {
        format!("{}, spacing {} m", self.scheme, self.spacing)
    }
}

/// How a run ended.
struct Outcome {
    scheme: String,
    spacing: f64,
    folder: PathBuf,
    summary: Value,
    /// Error measures by name, in the order of the summary.
    errors: Vec<(String, f64)>,
    failure: Option<String>,
}

impl Outcome {
    /// Reads what a run left; `ended` is the end of its program, if that ran just now.
    fn of(planned: &Planned, ended: Option<ExitStatus>) -> Self {
        let summary = run::summary(&planned.folder);
        let told = summary["ended"].as_str();
        let failure = match ended {
            Some(status) if !status.success() && told == Some(run::AT_THE_END) => Some(status.to_string()),
            Some(status) if !status.success() => Some(told.map_or(status.to_string(), str::to_owned)),
            _ => None,
        };
        // What a failed run came to is no error of a result.
        let errors = if failure.is_none() { errors(&summary) } else { Vec::new() };
        let Planned { scheme, spacing, folder, .. } = planned;
        Self { scheme: scheme.clone(), spacing: *spacing, folder: folder.clone(), summary, errors, failure }
    }

    fn error(&self, name: &str) -> Option<f64> {
        self.errors.iter().find(|(known, _)| known == name).map(|(_, value)| *value)
    }

    /// Wall-clock time of the run in s.
    fn wall_s(&self) -> Option<f64> {
        self.summary["wall_s"].as_f64()
    }

    fn count(&self, keys: &[&str]) -> Option<u64> {
        keys.iter().fold(&self.summary, |value, key| &value[key]).as_u64()
    }
}

/// Every error measure of a summary: differences from exact solutions (`NAME_rms`, `NAME_max`) and from measured series
/// (`NAME_rms`, `NAME_largest`), relative errors of arrival times, and the largest rise of the energy, which
/// every run has.
fn errors(summary: &Value) -> Vec<(String, f64)> {
    let list = |key: &str| summary[key].as_array().map(Vec::as_slice).unwrap_or_default();
    let mut found = Vec::new();
    let mut add = |name: String, value: Option<f64>| {
        found.extend(value.filter(|value| value.is_finite()).map(|value| (name, value)));
    };
    for (key, measures) in [
        ("errors", [("rms", "rms"), ("max", "max")]),
        ("references", [("rms", "rms"), ("largest", "largest")]),
    ] {
        for entry in list(key) {
            let is_same = |other: &&Value| other["name"] == entry["name"];
            let several = list(key).iter().filter(is_same).count() > 1;
            let mut name = entry["name"].as_str().unwrap_or(key).to_owned();
            if several {
                // One reference over several windows of time.
                name += &format!("_{}-{}s", entry["from_s"], entry["until_s"]);
            }
            for (field, end) in measures {
                add(format!("{name}_{end}"), entry[field].as_f64());
            }
        }
    }
    for entry in list("arrivals") {
        let late = |time: f64, expected: f64| (time - expected).abs() / expected;
        let error = entry["time_s"].as_f64().zip(entry["expected_time_s"].as_f64());
        let quantity = entry["quantity"].as_str().unwrap_or("quantity");
        add(format!("{quantity}_arrival"), error.map(|(time, expected)| late(time, expected)));
    }
    add("energy_rise".into(), summary["energy"]["largest_rise_of_initial"].as_f64());
    found
}

/// Names of all measures, in the order of their first appearance: a run too coarse for one does not hide it.
fn measures(outcomes: &[Outcome]) -> Vec<String> {
    // The longest list gives the order.
    let fullest = outcomes.iter().rev().max_by_key(|outcome| outcome.errors.len());
    let all = fullest.into_iter().chain(outcomes).flat_map(|outcome| &outcome.errors);
    let mut names: Vec<String> = Vec::new();
    for (name, _) in all {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    names
}

/// Observed order of a run: log(e1 / e2) / log(dx1 / dx2) with the next coarser run of its scheme.
fn order(outcomes: &[Outcome], k: usize, measure: &str) -> Option<f64> {
    let (coarse, fine) = (outcomes.get(k.checked_sub(1)?)?, &outcomes[k]);
    let (e1, e2) = (coarse.error(measure)?, fine.error(measure)?);
    let order = (e1 / e2).ln() / (coarse.spacing / fine.spacing).ln();
    Some(order).filter(|order| order.is_finite() && coarse.scheme == fine.scheme)
}

/// The table on the terminal.
fn table(outcomes: &[Outcome], measure: &str) -> String {
    let heads = ["scheme", "spacing, m", "particles", "steps", "run time, s", measure, "order"];
    let mut rows = vec![heads.map(str::to_owned)];
    for (k, outcome) in outcomes.iter().enumerate() {
        let text = |value: Option<String>| value.unwrap_or_else(|| "-".into());
        rows.push([
            outcome.scheme.clone(),
            outcome.spacing.to_string(),
            text(outcome.count(&["particles", "fluid"]).map(|n| n.to_string())),
            text(outcome.count(&["steps"]).map(|n| n.to_string())),
            text(outcome.wall_s().map(|s| format!("{s:.1}"))),
            text(outcome.error(measure).map(|e| format!("{e:.3e}"))),
            text(order(outcomes, k, measure).map(|order| format!("{order:.2}"))),
        ]);
    }
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; 7] = std::array::from_fn(width);
    let mut text = String::new();
    for (k, row) in rows.iter().enumerate() {
        let cells = row.iter().zip(widths).enumerate();
        // Words to the left, numbers to the right.
        let cell = |(column, (cell, width)): (usize, (&String, usize))| match column {
            0 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        };
        text += &cells.map(cell).collect::<Vec<_>>().join("  ");
        let failure = k.checked_sub(1).and_then(|k| outcomes[k].failure.as_ref());
        text += &failure.map(|why| format!("  failed: {}", why.replace('\n', " "))).unwrap_or_default();
        text += "\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn outcome(scheme: &str, spacing: f64, errors: &[(&str, f64)]) -> Outcome {
        Outcome {
            scheme: scheme.into(),
            spacing,
            folder: PathBuf::new(),
            summary: Value::Null,
            errors: errors.iter().map(|(name, value)| ((*name).into(), *value)).collect(),
            failure: None,
        }
    }

    #[test]
    fn every_measure_of_a_summary_is_found_by_name() {
        let summary = json!({
            "errors": [{"name": "height", "rms": 0.1, "max": 0.3}, {"name": "pressure", "rms": 0.2, "max": null}],
            "references": [{"name": "mm", "rms": 0.4, "largest": 0.5, "values": 3}],
            "arrivals": [{"quantity": "front", "time_s": 0.3, "expected_time_s": 0.4}, {"time_s": null}],
            "energy": {"largest_rise_of_initial": 0.002},
        });
        let found = errors(&summary);
        let names: Vec<_> = found.iter().map(|(name, _)| name.as_str()).collect();
        let wanted = [
            "height_rms",
            "height_max",
            "pressure_rms",
            "mm_rms",
            "mm_largest",
            "front_arrival",
            "energy_rise",
        ];
        assert_eq!(names, wanted);
        assert!((found[5].1 - 0.25).abs() < 1e-12);
        assert!(errors(&Value::Null).is_empty());
    }

    #[test]
    fn orders_compare_neighbours_of_one_scheme() {
        let runs = [
            outcome("a", 0.4, &[("e", 0.16)]),
            outcome("a", 0.2, &[("e", 0.04)]),
            outcome("a", 0.1, &[("f", 1.0)]),
            outcome("b", 0.05, &[("f", 0.5)]),
        ];
        assert_eq!(order(&runs, 0, "e"), None);
        assert!((order(&runs, 1, "e").unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(order(&runs, 2, "e"), None);
        assert_eq!(order(&runs, 3, "f"), None, "of another scheme");
        assert_eq!(measures(&runs), ["e", "f"].map(String::from));
    }
}
