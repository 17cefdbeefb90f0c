//! The solver laboratory: many sets of PETSc options on the same pressure systems.
//!
//! The systems are those of a real run at chosen instants, saved with their first guesses, or files of an earlier one. Each set
//! is tried in a program of its own ([`try_set`]), in which the pressure solver of a run does exactly what it would do
//! there, without its fallbacks: a set that diverges, breaks or takes too long is a row like any other.
//!
//! **Measures.** Times are those of one solve, set-up with all its matrices included since the matrix changes with every step;
//! the fastest of several. The residual is |b - A p| / |b|, computed afresh. The pressure error is |p - p_direct| / |p_direct|
//! in the Euclidean norm, with p_direct by MUMPS, or where that runs out of time by an iteration to 1e-12. The divergence left is
//! dt rms(b - A p): the operator is the divergence of the correction, so what the equation misses is what the
//! corrected velocity keeps of it. Memory is the largest of the program beyond PETSc's start.
//!
//! **Choice.** Pareto-best is a set that no other beats in both time and pressure error. The set to choose is the fastest that
//! reaches the tolerance of a run, 1e-5, on every system of Eq. (3).

mod row;
pub mod sets;
mod table;
#[cfg(feature = "petsc")]
mod trial;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::case::build;
use crate::case::{CaseFile, SchemeKind};
use crate::child::{Child, Ended};
use crate::cli::{self, RunArgs, SolversArgs, TrialArgs};
use crate::{Error, Result, run};
use row::Row;
use sets::OptionSet;
use table::{Entry, Tried};

/// The built-in option sets, one a line.
pub const CATALOGUE: &str = include_str!("catalogue.txt");
/// What pressures are measured against, best first.
const TRUTHS: [&str; 2] = [
    "-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps",
    "-ksp_type gmres -pc_type hypre -ksp_rtol 1e-12 -ksp_gmres_restart 100",
];
/// Residual that a run asks for.
const RELATIVE: f64 = 1e-5;
/// Instants of a scene under gravity, in units of sqrt(H / |g|) with the height H of the liquid: a column that is 2 H long or
/// shorter reaches what stands in its way at about 2, and splashes at 3.
const INSTANTS: [(&str, f64); 3] = [("calm", 0.05), ("impact", 2.0), ("splash", 3.0)];

/// Solves the systems with every set, and reports.
///
/// # Errors
/// [`Error::Input`] before anything is written; [`Error::Interrupted`], with the rows so far kept; [`Error::Run`] where no
/// set solves all systems.
pub fn solvers(args: &SolversArgs) -> Result<()> {
    if !cfg!(feature = "petsc") {
        return Err(needs_petsc());
    }
    let sets = option_sets(args)?;
    let source = Source::of(args)?;
    let child = Child::with_signals();
    let systems = source.systems(args, &child)?;
    let lab = Lab { args, source, systems, child };
    lab.say(&format!(
        "{} option sets on {} systems in {}\n",
        sets.len(),
        lab.systems.len(),
        lab.folder().display()
    ))?;
    let direct = lab.keep_truths(&sets)?;
    let mut tried = Vec::new();
    for (k, set) in sets.into_iter().enumerate() {
        log::info!("set {}: {}", k + 1, set.line);
        let rows = match set.line == TRUTHS[0] {
            true => direct.clone(),
            false => lab.try_set(&set, false)?,
        };
        tried.push(Tried::new(set, rows, &lab.systems));
        table::write_csv(&lab.folder().join("solvers.csv"), &tried)?;
    }
    table::sort(&mut tried);
    table::write_csv(&lab.folder().join("solvers.csv"), &tried)?;
    table::write_picture(&lab.folder().join("solvers.png"), &lab.source.name, &tried)?;
    lab.say(&table::text(&tried))?;
    let chosen = table::chosen(&tried, RELATIVE);
    table::write_choice(&lab.folder().join("solvers.json"), &lab.source.name, chosen, &tried)?;
    lab.say(&format!("files          {}\n", lab.folder().display()))?;
    match chosen {
        Some(chosen) => lab.say(&lab.advice(chosen, &tried)),
        None => Err(Error::Run(format!("no option set reaches a residual of {RELATIVE:e} on every system"))),
    }
}

/// Tries one option set, for [`solvers`].
///
/// # Errors
/// [`Error::Input`] for options that do not work and for files that cannot be read.
#[cfg(feature = "petsc")]
pub fn try_set(args: &TrialArgs) -> Result<()> {
    trial::run(args)
}

/// Without PETSc there is nothing to try.
///
/// # Errors
/// [`Error::Input`] always.
#[cfg(not(feature = "petsc"))]
pub fn try_set(_: &TrialArgs) -> Result<()> {
    Err(needs_petsc())
}

/// What a build without PETSc says.
fn needs_petsc() -> Error {
    Error::Input("this build leaves PETSc out, and `solvers` tries its solvers: build with the feature petsc (the default)".into())
}

/// The sets asked for: those typed, those of a file, or the catalogue.
fn option_sets(args: &SolversArgs) -> Result<Vec<OptionSet>> {
    let mut sets = Vec::new();
    if let Some(path) = &args.sets {
        let text = fs::read_to_string(path).map_err(|error| Error::unreadable(path, &error))?;
        sets.extend(OptionSet::parse_all(&text)?);
    }
    sets.extend(args.tries.iter().map(|line| OptionSet::parse(line)).collect::<Result<Vec<_>>>()?);
    if !args.common.petsc.is_empty() {
        sets.push(OptionSet::parse(&args.common.petsc.join(" "))?);
    }
    if sets.is_empty() && args.sets.is_none() {
        sets = OptionSet::parse_all(CATALOGUE)?;
    }
    let mut unique: Vec<OptionSet> = Vec::new();
    sets.into_iter().for_each(|set| {
        if !unique.contains(&set) {
            unique.push(set)
        }
    });
    match unique.is_empty() {
        true => Err(Error::Input("--sets: the file holds no option set: write one a line".into())),
        false => Ok(unique),
    }
}

/// Where the systems come from.
struct Source {
    /// For titles, and for the line to paste.
    name: String,
    folder: PathBuf,
    /// The run that is to be done for them; none: the files are there.
    run: Option<RunArgs>,
    files: Vec<PathBuf>,
}

/// A saved system.
struct System {
    file: PathBuf,
    /// What it is called in tables.
    name: String,
    /// Flow time and time step in s, where the run tells.
    time_and_step: Option<(f64, f64)>,
}

impl Source {
    /// Everything that can be wrong is found here, before the first file is written.
    fn of(args: &SolversArgs) -> Result<Self> {
        let named = args.common.case.as_deref().unwrap_or_default();
        let is_saved = Path::new(named).is_dir() || named.ends_with(".petsc") || !args.systems.is_empty();
        if is_saved {
            let all = [PathBuf::from(named)].into_iter().chain(args.systems.iter().cloned());
            let files = all.map(|path| saved_files(&path)).collect::<Result<Vec<_>>>()?.concat();
            let default = || Path::new("out").join("solvers");
            let folder = args.out.clone().unwrap_or_else(default);
            return Ok(Self { name: "saved systems".into(), folder, run: None, files });
        }
        let mut run = args.run();
        // Options typed after the case are one more set, not the solver of the run.
        run.common.petsc.clear();
        let case = run.load_case()?;
        if !matches!(case.scheme.kind, SchemeKind::IsphDf | SchemeKind::IsphDi) {
            return Err(Error::Input(format!(
                "the scheme {} solves no pressure system: choose --scheme isph_df",
                case.scheme.kind.name()
            )));
        }
        let instants = instants(args, &case)?;
        let last = instants.iter().copied().fold(0.0, f64::max);
        run.common.until = Some(last.max(1e-9));
        run.common.set.push(("output.particles".into(), "0".into()));
        run.save_systems = instants;
        let case = run.load_case()?;
        let folder =
            args.out.clone().unwrap_or_else(|| Path::new("out").join(format!("{}-solvers", case.name)));
        let name = args.common.case.clone().unwrap_or_else(|| case.name.clone());
        let run = run::left_to_do(run, &case, &folder.join("run"), args.force)?;
        let files = vec![];
        Ok(match run {
            Some(run) => Self { name, folder, run: Some(run), files },
            None => Self { name, run: None, files: saved_files(&folder.join("run/systems"))?, folder },
        })
    }

    /// Does the run, if need be, and finds what it saved.
    fn systems(&self, args: &SolversArgs, child: &Child) -> Result<Vec<System>> {
        let mut files = self.files.clone();
        if let Some(run) = &self.run {
            log::info!("a run until {} s for the pressure systems", run.common.until.unwrap_or_default());
            let ended = child.run(&run.tokens())?;
            if !ended.success() {
                log::warn!("the run ended early: the systems it saved are tried");
            }
            files = saved_files(&self.folder.join("run/systems"))?;
        }
        fs::create_dir_all(&self.folder).map_err(|error| Error::io(&self.folder, error))?;
        let is_default = args.at.is_empty() && files.len() == INSTANTS.len();
        let named = |(k, file): (usize, PathBuf)| {
            let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let own_run = file.starts_with(self.folder.join("run"));
            let name = if is_default && own_run { INSTANTS[k].0.to_owned() } else { stem };
            System { time_and_step: time_and_step(&file), name, file }
        };
        Ok(files.into_iter().enumerate().map(named).collect())
    }
}

/// The instants to look at in s, ascending.
fn instants(args: &SolversArgs, case: &CaseFile) -> Result<Vec<f64>> {
    if let Some(late) = args.at.iter().find(|time| **time > case.time.until) {
        return Err(Error::Input(format!(
            "--at names {late:?} s, after the end at {:?} s: leave it out or raise --until",
            case.time.until
        )));
    }
    let mut times = args.at.clone();
    if times.is_empty() {
        let unit = match case.dimension {
            2 => time_unit::<2>(case),
            _ => time_unit::<3>(case),
        };
        // Without gravity: shares of the whole.
        let unit = unit.min(case.time.until / INSTANTS[2].1);
        times.extend(INSTANTS.map(|(_, at)| at * unit));
    }
    times.sort_by(f64::total_cmp);
    times.dedup();
    Ok(times)
}

/// sqrt(H / |g|) in s; infinite without gravity.
fn time_unit<const D: usize>(case: &CaseFile) -> f64 {
    let scene = build::scene::<D>(case);
    let particles = &scene.particles;
    let height = particles.fluid().map(|a| particles.position[a][D - 1]);
    let (low, high) =
        height.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    ((high - low).max(0.0) / scene.params.gravity.norm()).sqrt()
}

/// The file itself, or all of a folder in the order of their times; a failed system comes last.
fn saved_files(path: &Path) -> Result<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = fs::read_dir(path).map_err(|error| Error::unreadable(path, &error))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|end| end == "petsc"))
        .collect();
    let time = |path: &PathBuf| path.file_stem()?.to_str()?.strip_prefix('t')?.parse::<f64>().ok();
    files.sort_by(|a, b| {
        let [a_time, b_time] = [a, b].map(|path| time(path).unwrap_or(f64::INFINITY));
        a_time.total_cmp(&b_time).then_with(|| a.cmp(b))
    });
    match files.is_empty() {
        true => Err(Error::Input(format!(
            "{} holds no saved systems (.petsc): run a case with --save-systems",
            path.display()
        ))),
        false => Ok(files),
    }
}

/// Flow time and step in s of a system that a run saved, by the row of the run's solver.csv.
fn time_and_step(file: &Path) -> Option<(f64, f64)> {
    let time = file.file_stem()?.to_str()?.strip_prefix('t')?;
    let mut table = csv::Reader::from_path(file.parent()?.parent()?.join("solver.csv")).ok()?;
    let head = table.headers().ok()?.clone();
    let column = |name: &str| head.iter().position(|known| known == name);
    let (times, steps) = (column("time_s")?, column("dt_s")?);
    let number = |row: &csv::StringRecord, k: usize| row.get(k)?.parse::<f64>().ok();
    table.records().flatten().find_map(|row| {
        let at = number(&row, times)?;
        (format!("{at:.6}") == time).then_some((at, number(&row, steps)?))
    })
}

/// Everything a trial needs.
struct Lab<'a> {
    args: &'a SolversArgs,
    source: Source,
    systems: Vec<System>,
    child: Child,
}

impl Lab<'_> {
    fn folder(&self) -> &Path {
        &self.source.folder
    }

    fn truth(&self) -> PathBuf {
        self.folder().join("truth")
    }

    fn say(&self, text: &str) -> Result<()> {
        if self.args.common.quiet { Ok(()) } else { cli::print(text) }
    }

    /// Solves every system as exactly as it goes, in the forms that the sets ask for; returns how the direct solver did.
    fn keep_truths(&self, sets: &[OptionSet]) -> Result<Vec<Row>> {
        let truth = self.truth();
        if truth.exists() {
            fs::remove_dir_all(&truth).map_err(|error| Error::io(&truth, error))?;
        }
        fs::create_dir_all(&truth).map_err(|error| Error::io(&truth, error))?;
        let mut direct = vec![];
        for uncorrected in [false, true] {
            if !sets.iter().any(|set| set.uncorrected == uncorrected) {
                continue;
            }
            for line in TRUTHS {
                // The other form of the equation is there to compare with: an iteration to 1e-12 is direct enough.
                let serves = line != TRUTHS[0] || !uncorrected;
                if serves && self.systems.iter().any(|system| !self.has_truth(system, uncorrected)) {
                    log::info!("pressures to measure by: {line}");
                    let set = OptionSet { uncorrected, ..OptionSet::parse(line)? };
                    let rows = self.try_set(&set, true)?;
                    if line == TRUTHS[0] {
                        direct = rows;
                    }
                }
            }
        }
        Ok(direct)
    }

    fn has_truth(&self, system: &System, uncorrected: bool) -> bool {
        let stem = system.file.file_stem().unwrap_or_default().to_string_lossy();
        self.truth().join(row::truth_name(&stem, uncorrected)).exists()
    }

    /// Tries a set on all systems, for the truth on those that still lack one: a row for each, also where there is no solution.
    fn try_set(&self, set: &OptionSet, is_truth: bool) -> Result<Vec<Row>> {
        let wanted = |system: &&System| !is_truth || !self.has_truth(system, set.uncorrected);
        let files: Vec<PathBuf> =
            self.systems.iter().filter(wanted).map(|system| system.file.clone()).collect();
        let rows_file = self.folder().join("rows.jsonl");
        let remove = || if rows_file.exists() { fs::remove_file(&rows_file) } else { Ok(()) };
        remove().map_err(|error| Error::io(&rows_file, error))?;
        let trial = TrialArgs {
            systems: files.clone(),
            rows: rows_file.clone(),
            truth: self.truth(),
            is_truth,
            uncorrected: set.uncorrected,
            petsc: set.petsc.clone(),
        };
        let limit = self.args.limit;
        let ended = self.child.run_within(&trial.tokens(), Duration::from_secs_f64(limit))?;
        let text = fs::read_to_string(&rows_file).unwrap_or_default();
        // A program that was stopped may have left half a line.
        let mut rows: Vec<Row> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        remove().map_err(|error| Error::io(&rows_file, error))?;
        let cause = match ended {
            Ended::OutOfTime => format!("stopped after {limit:?} s"),
            Ended::Itself(status, said) => {
                let said = said
                    .lines()
                    .filter_map(|line| line.strip_prefix("error: "))
                    .collect::<Vec<_>>()
                    .join("; ");
                if said.is_empty() { status.to_string() } else { said }
            }
        };
        for file in &files[rows.len().min(files.len())..] {
            let system = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            rows.push(Row { system, failure: Some(cause.clone()), ..Row::default() });
        }
        Ok(rows)
    }

    /// The last lines: what to type.
    fn advice(&self, chosen: &Tried, tried: &[Tried]) -> String {
        let mut text = String::new();
        let as_shipped = tried.iter().find(|other| {
            other.set.petsc.join(" ") == "-ksp_type gmres -pc_type hypre -ppe_tuned no" && other.solved()
        });
        if let Some(other) = as_shipped {
            let ratio = other.total_s() / chosen.total_s();
            text += &format!("               {ratio:.1} times as fast as hypre with PETSc's own defaults\n");
        }
        let case = if self.systems.iter().all(|s| s.file.starts_with(self.folder().join("run"))) {
            &self.source.name
        } else {
            "CASE"
        };
        format!("fastest        sphpetsc {case} {}", chosen.set.typed()).trim_end().to_owned() + "\n" + &text
    }
}

/// What the table needs to know of a system.
impl System {
    fn entry(&self, row: Row) -> Entry {
        let (time, step) = self.time_and_step.unzip();
        let divergence = row.defect.zip(step).map(|(defect, step)| defect * step);
        Entry { system: self.name.clone(), time, divergence, row }
    }
}
