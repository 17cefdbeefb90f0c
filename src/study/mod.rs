//! A study: one case with many schemes, spacings, time steps, tolerances, solvers or any key varied, and what accuracy costs.
//!
//! Every run is a program of its own, this one with the arguments of the run: a run that fails takes nothing else with it
//! and starts with a fresh PETSc. Runs are kept in `DIR/runs/`; one that is there already is not repeated,
//! and one that was interrupted goes on, so that a study started again with the same arguments continues.
//!
//! **Errors** are those of each run's summary.json, from exact solutions and measured data, and besides (`finest_*`) the rms
//! differences of its tables from those of the finest run of the same method. The order of a run is
//! log(e1 / e2) / log(s1 / s2), with s the spacing or the time step and 1 the next coarser run of its curve. Pareto-best is a run
//! that no other beats in both run time and error.

pub mod axes;
mod outcome;
mod table;

use std::path::{Path, PathBuf};

use crate::child::Child;
use crate::cli::{self, StudyArgs};
use crate::{Error, Result};
pub use axes::list;
use axes::{Outline, Point};
use outcome::Outcome;

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
    for (k, point) in study.points.iter().enumerate() {
        let what = format!("run {} of {}: {}, {}", k + 1, study.points.len(), point.curve(), point.note());
        outcomes.push(match &point.start {
            None => {
                log::info!("{what}: done before");
                Outcome::of(point, None)
            }
            Some(start) => {
                log::info!("{what}");
                Outcome::of(point, Some(child.run(&start.tokens())?))
            }
        });
        study.write_table(&outcomes, None)?;
    }
    outcome::compare_with_finest(&mut outcomes)?;
    let measure = study.measure(&outcomes)?;
    study.write_table(&outcomes, Some(&measure))?;
    table::write_picture(&study.folder.join("study.png"), &study.name, &outcomes, &measure)?;
    study.say(&table::text(&outcomes, &measure))?;
    study.say(&format!("files          {}\n", study.folder.display()))?;
    if outcomes.iter().all(|outcome| outcome.failure.is_some()) {
        return Err(Error::Run("no run of the study reached its end: see the causes above".into()));
    }
    Ok(())
}

/// What is to be done.
struct Study<'a> {
    args: &'a StudyArgs,
    outline: Outline,
    name: String,
    folder: PathBuf,
    until: f64,
    points: Vec<Point>,
}

impl<'a> Study<'a> {
    /// Everything that can be wrong is found here, before the first file is written.
    fn plan(args: &'a StudyArgs) -> Result<Self> {
        let outline = Outline::of(args)?;
        let case = outline.case_file(args)?;
        let name = outline.name.clone().unwrap_or(case.name);
        let folder = args.out.clone().unwrap_or_else(|| Path::new("out").join(format!("{name}-study")));
        let points = outline.points(args, &folder)?;
        Ok(Self { args, outline, name, folder, until: case.time.until, points })
    }

    fn sentence(&self) -> String {
        let done = self.points.iter().filter(|point| point.start.is_none()).count();
        let done = if done == 0 { String::new() } else { format!(", {done} of them done before") };
        let (count, until) = (self.points.len(), self.until);
        let about = &self.outline.description;
        let about = if about.is_empty() { String::new() } else { format!("{about}\n") };
        format!(
            "{about}study of {}: {count} runs until {until} s in {}{done}\n",
            self.name,
            self.folder.display()
        )
    }

    fn say(&self, text: &str) -> Result<()> {
        if self.args.common.quiet { Ok(()) } else { cli::print(text) }
    }

    fn write_table(&self, outcomes: &[Outcome], measure: Option<&str>) -> Result<()> {
        table::write_csv(&self.folder, outcomes, measure)
    }

    /// The measure that was asked for, by its name or what its name begins with; otherwise the first.
    fn measure(&self, outcomes: &[Outcome]) -> Result<String> {
        let known = outcome::measures(outcomes);
        let asked = self.args.measure.as_ref();
        let named = |wanted: &String| {
            known
                .iter()
                .find(|name| *name == wanted)
                .or_else(|| known.iter().find(|name| name.starts_with(&format!("{wanted}_"))))
        };
        let found = match asked {
            Some(wanted) => named(wanted),
            // A study file names a measure that needs data, perhaps: without them the first will do.
            None => self.outline.measure.as_ref().and_then(named).or(known.first()),
        };
        match (found, asked) {
            (Some(name), _) => Ok(name.clone()),
            (None, Some(wanted)) if !known.is_empty() => Err(Error::Input(format!(
                "--measure {wanted}: these runs have {}: choose one of them, the runs are kept",
                known.join(", ")
            ))),
            (None, _) => Ok("error".into()),
        }
    }
}
