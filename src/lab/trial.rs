//! One option set on pressure systems, in a program of its own: what it costs and how good its pressure is.

use std::io::Write as _;
use std::path::Path;
use std::rc::Rc;

use super::row::{Row, truth_name};
use crate::cli::TrialArgs;
use crate::memory;
use crate::output::write_atomic;
use crate::parallel::Ranks;
use crate::petsc::Session;
use crate::ppe::solve::PressureSolver;
use crate::ppe::{PressureSystem, matrix, saved};
use crate::{Error, Result};

/// Most solves of one system, and the times in s after which none is added to three, and none at all.
const PASSES: usize = 20;
const ENOUGH: f64 = 0.3;
const LONG: f64 = 2.0;

/// Tries the options of `args` on each system and appends a row for each to its file.
///
/// # Errors
/// [`Error::Input`] for options that do not work and for files that cannot be read.
pub fn run(args: &TrialArgs) -> Result<()> {
    let session = Session::start(&args.petsc)?;
    let at_start = memory::resident_mb();
    for path in &args.systems {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut row = Row { system: name, ..Row::default() };
        let system = system(path, args.uncorrected)?;
        row.unknowns = system.rhs.len();
        row.nonzeros = system.full.value.len();
        memory::reset_peak();
        match solve(&session, &system, &mut row) {
            Ok(pressure) => judge(args, &system, &pressure, &mut row)?,
            Err(Error::Input(wrong)) => return Err(Error::Input(wrong)),
            Err(failure) => row.failure = Some(failure.to_string().replace('\n', " ")),
        }
        row.memory_mb = memory::peak_mb().zip(at_start).map(|(peak, start)| peak - start);
        let line = serde_json::to_string(&row).map_err(|error| Error::Run(error.to_string()))?;
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(&args.rows);
        let written =
            file.as_mut().map_err(|error| std::mem::replace(error, std::io::ErrorKind::Other.into()));
        written.and_then(|file| writeln!(file, "{line}")).map_err(|error| Error::io(&args.rows, error))?;
    }
    Ok(())
}

/// A system as it is to be solved.
fn system(path: &Path, uncorrected: bool) -> Result<PressureSystem> {
    let mut system = saved::read(path)?;
    if uncorrected {
        if system.uncorrected.is_empty() {
            return Err(Error::Input(format!(
                "{} holds no uncorrected operator: leave scheme.laplacian out",
                path.display()
            )));
        }
        system.full = std::mem::take(&mut system.uncorrected);
        system.rhs = std::mem::take(&mut system.uncorrected_rhs);
    }
    if system.symmetric.is_empty() {
        // Of another program: the nearest symmetric matrix with the same row sums.
        system.symmetric = matrix::symmetric_mean(&system.full, 0, &Ranks::default());
    }
    Ok(system)
}

/// Short solves are repeated, and the fastest counts: a single one measures the machine's mood too.
fn solve(session: &Rc<Session>, system: &PressureSystem, row: &mut Row) -> Result<Vec<f64>> {
    let mut solver = PressureSolver::new(session.clone(), system.rhs.len())?;
    let (mut pressure, mut spent) = (vec![], 0.0);
    for pass in 0..PASSES {
        let trial = solver.trial(system)?;
        let record = trial.record;
        let total = record.setup_s + record.solve_s;
        if pass == 0 || total < row.total_s() {
            (row.setup_s, row.solve_s) = (record.setup_s, record.solve_s);
        }
        row.converged = trial.accepted;
        (row.reason, row.iterations) = (record.reason, record.iterations);
        (row.inner_iterations, row.complexity) = (record.inner_iterations, trial.complexity);
        pressure = trial.pressure;
        spent += total;
        if spent > LONG || (pass >= 2 && spent > ENOUGH) {
            break;
        }
    }
    Ok(pressure)
}

/// Measures a pressure, or keeps it as the one to measure others by.
fn judge(args: &TrialArgs, system: &PressureSystem, pressure: &[f64], row: &mut Row) -> Result<()> {
    let made = system.full.multiply(pressure);
    let missing: f64 = system.rhs.iter().zip(&made).map(|(b, made)| (b - made).powi(2)).sum();
    let whole: f64 = system.rhs.iter().map(|b| b * b).sum();
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    row.residual = finite((missing / whole).sqrt());
    row.defect = finite((missing / system.rhs.len() as f64).sqrt());
    let file = args.truth.join(truth_name(&row.system, args.uncorrected));
    if args.is_truth && row.converged {
        let bytes: Vec<u8> = pressure.iter().flat_map(|p| p.to_le_bytes()).collect();
        write_atomic(&file, |to| to.write_all(&bytes))?;
    }
    if let Ok(bytes) = std::fs::read(&file) {
        let (words, _) = bytes.as_chunks::<8>();
        let truth = || words.iter().map(|word| f64::from_le_bytes(*word));
        let square = |sum: f64, value: f64| sum + value * value;
        let differences = pressure.iter().zip(truth()).map(|(p, truth)| p - truth);
        let error = (differences.fold(0.0, square) / truth().fold(0.0, square)).sqrt();
        row.pressure_error = finite(error);
    }
    Ok(())
}
