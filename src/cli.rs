//! The command line: who owns which token, and what the program is asked to do.
//!
//! A token with one dash and more than one letter belongs to PETSc's options database, together with its value; all
//! others are ours and go to clap.

use std::ffi::{OsStr, OsString};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use clap::error::ErrorKind as ClapKind;
use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::case::{CaseFile, Profile, Reference, SchemeKind, builtin, read};
use crate::{Error, Result};

const USAGE: &str = "sphpetsc [CASE] [--own-options] [-petsc_options]
       sphpetsc cases [show NAME]
       sphpetsc check [CASE] [--own-options]
       sphpetsc solvers [CASE] [--own-options] [-petsc_options]
       sphpetsc study [CASE] [--own-options] [-petsc_options]
       sphpetsc report DIR";

const PETSC_HELP: &str = "PETSc options:
  A token with one dash and more than one letter goes to PETSc with its value, anywhere after CASE:
      sphpetsc dam_break_2d -ksp_type cg -pc_type hypre -ksp_rtol 1e-6
  -ksp_monitor, -ksp_view, -log_view, -options_file FILE and -help work as in any PETSc program.

Exit codes: 0 done, 1 the run failed, 2 wrong input (nothing written), 130 interrupted.";

/// What the program is asked to do.
#[derive(Debug)]
pub enum Command {
    /// Run a case.
    Run(Box<RunArgs>),
    /// Validate a case and run nothing.
    Check(Box<RunArgs>),
    /// Try many solvers on the pressure systems of a case.
    Solvers(Box<SolversArgs>),
    /// Try one solver, for [`Command::Solvers`].
    Trial(TrialArgs),
    /// Run a case with several schemes, spacings, solvers, ...
    Study(Box<StudyArgs>),
    /// Write the page of a run or a study.
    Report(ReportArgs),
    /// List the built-in cases.
    Cases,
    /// Print the TOML of a built-in case.
    ShowCase(String),
    /// Print this text: help or version.
    Text(String),
}

#[derive(Debug, Parser)]
#[command(name = "sphpetsc", version, about, override_usage = USAGE, after_help = PETSC_HELP)]
#[command(args_conflicts_with_subcommands = true, disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    task: Option<Task>,
    #[command(flatten)]
    run: RunArgs,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// List the built-in cases, or show one as TOML to copy and edit
    Cases {
        #[command(subcommand)]
        show: Option<Show>,
    },
    /// Validate a case and print what a run would take; run nothing
    Check(Box<RunArgs>),
    /// Solve pressure systems of a case with many sets of PETSc options: a table, a picture, and the set to choose
    Solvers(Box<SolversArgs>),
    /// One option set of `solvers`
    #[command(hide = true)]
    Trial(TrialArgs),
    /// Run a case with several schemes, spacings, time steps, solvers: errors over run times, as a table and a picture
    Study(Box<StudyArgs>),
    /// Write one self-contained HTML page of a run, a study or a solver laboratory, DIR/report.html
    Report(ReportArgs),
}

#[derive(Debug, Subcommand)]
enum Show {
    /// Print the TOML of a built-in case
    Show {
        /// Name of a built-in case
        name: String,
    },
}

/// Which case, and what all that is done with a case has in common, as typed.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct CaseArgs {
    /// Built-in case or case file (.toml); comes first [default: dam_break_2d]
    pub case: Option<String>,

    /// Settings that the case describes under [variant.NAME]; other options come after them
    #[arg(long, value_name = "NAME", help_heading = "Case")]
    pub variant: Option<String>,
    /// Flow time to reach in s
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true, help_heading = "Case")]
    pub until: Option<f64>,
    /// Seed of all that is random
    #[arg(long, value_name = "N", value_parser = seed, allow_negative_numbers = true, help_heading = "Case")]
    pub seed: Option<u64>,
    /// Any key of the case file, e.g. fluid.block.0.max=[0.2,0.4]; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = assignment, help_heading = "Case")]
    pub set: Vec<(String, String)>,
    /// Measured data that errors are measured against, for the case's reference NAME or for all that share a file; repeatable
    #[arg(long = "reference", value_name = "[NAME=]FILE", value_parser = reference, help_heading = "Case")]
    pub references: Vec<ReferenceFile>,

    /// Threads of each rank [default: all cores, over the ranks of a machine]
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true, help_heading = "Program")]
    pub threads: Option<usize>,
    /// Print errors only
    #[arg(short, long, conflicts_with = "verbose", help_heading = "Program")]
    pub quiet: bool,
    /// Print more
    #[arg(short, long, help_heading = "Program")]
    pub verbose: bool,

    /// Tokens of PETSc's options database.
    #[arg(skip)]
    pub petsc: Vec<String>,
}

/// Method and resolution of one run, as typed.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct MethodArgs {
    /// Numerical method
    #[arg(long, value_enum, help_heading = "Case")]
    pub scheme: Option<SchemeKind>,
    /// Particle spacing in m
    #[arg(long, value_name = "M", value_parser = metres, allow_negative_numbers = true, help_heading = "Case")]
    pub spacing: Option<f64>,
}

/// Everything that shapes a run, as typed.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct RunArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CaseArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub method: MethodArgs,

    /// Output folder [default: out/NAME, then out/NAME-2, ...]
    #[arg(long, short, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// Empty the folder of --out first
    #[arg(long, requires = "out", conflicts_with = "resume", help_heading = "Output")]
    pub force: bool,
    /// Go on from the newest checkpoint of DIR [default: of the case's newest run]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub resume: Option<Option<PathBuf>>,
    /// Extra instants of particle files in s
    #[arg(long, value_name = "S,S", value_delimiter = ',', help_heading = "Output")]
    #[arg(value_parser = seconds, allow_negative_numbers = true)]
    pub snapshots: Vec<f64>,
    /// Instants in s whose pressure systems are saved in PETSc's binary format
    #[arg(long, value_name = "S,S", value_delimiter = ',', help_heading = "Output")]
    #[arg(value_parser = seconds, allow_negative_numbers = true)]
    pub save_systems: Vec<f64>,

    /// Ranks: starts itself under mpiexec
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true, help_heading = "Program")]
    pub ranks: Option<usize>,
}

/// What a study is made of, as typed.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct StudyArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CaseArgs,

    /// Numerical methods [default: the case's own]
    #[arg(long, value_name = "NAME,NAME", value_enum, value_delimiter = ',', help_heading = "Study")]
    pub schemes: Vec<SchemeKind>,
    /// Particle spacings in m [default: 4, 2 and 1 times the case's own, or its own where something else is varied]
    #[arg(long, value_name = "M,M", value_delimiter = ',', help_heading = "Study")]
    #[arg(value_parser = metres, allow_negative_numbers = true)]
    pub spacings: Vec<f64>,
    /// Fixed time steps in s
    #[arg(long, value_name = "S,S", value_delimiter = ',', help_heading = "Study")]
    #[arg(value_parser = positive, allow_negative_numbers = true)]
    pub steps: Vec<f64>,
    /// Tolerances of the pressure equation (-ksp_rtol)
    #[arg(long, value_name = "X,X", value_delimiter = ',', help_heading = "Study")]
    #[arg(value_parser = positive, allow_negative_numbers = true)]
    pub tolerances: Vec<f64>,
    /// A set of PETSc options in quotes, e.g. "-ksp_type cg -pc_type icc"; repeatable
    #[arg(long = "solver", value_name = "OPTIONS", allow_hyphen_values = true, help_heading = "Study")]
    pub solvers: Vec<String>,
    /// Values of any key of the case file, e.g. scheme.shifting=0,2; repeatable
    #[arg(long, value_name = "KEY=V,V", value_parser = assignment, help_heading = "Study")]
    pub vary: Vec<(String, String)>,
    /// Error measure on the terminal and in the picture [default: the first that the runs have]
    #[arg(long, value_name = "NAME", help_heading = "Study")]
    pub measure: Option<String>,
    /// List the built-in studies, which go in the place of CASE
    #[arg(long, help_heading = "Study")]
    pub list: bool,

    /// Folder of the study; started again, it goes on there [default: out/NAME-study]
    #[arg(long, short, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// Run again what other arguments left in that folder
    #[arg(long, help_heading = "Output")]
    pub force: bool,
}

/// What the solver laboratory is to try, as typed.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct SolversArgs {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CaseArgs,
    /// Saved systems in the place of CASE: files (.petsc) or folders of them
    pub systems: Vec<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub method: MethodArgs,

    /// Instants in s whose pressure systems are solved [default: calm, impact and splash, by the depth of the liquid]
    #[arg(long, value_name = "S,S", value_delimiter = ',', help_heading = "Laboratory")]
    #[arg(value_parser = seconds, allow_negative_numbers = true)]
    pub at: Vec<f64>,
    /// A set of PETSc options in quotes instead of the catalogue, e.g. "-ksp_type cg -pc_type icc"; repeatable
    #[arg(long = "try", value_name = "OPTIONS", allow_hyphen_values = true, help_heading = "Laboratory")]
    pub tries: Vec<String>,
    /// File of option sets instead of the catalogue, one a line; # begins a comment
    #[arg(long, value_name = "FILE", help_heading = "Laboratory")]
    pub sets: Option<PathBuf>,
    /// Time in s after which an option set is stopped
    #[arg(long, value_name = "S", default_value = "60", value_parser = positive, help_heading = "Laboratory")]
    #[arg(allow_negative_numbers = true)]
    pub limit: f64,
    /// Print the built-in catalogue of option sets
    #[arg(long, help_heading = "Laboratory")]
    pub list: bool,

    /// Folder of the laboratory [default: out/NAME-solvers]
    #[arg(long, short, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// Run the case again where other arguments left one in that folder
    #[arg(long, help_heading = "Output")]
    pub force: bool,
}

/// One option set of the laboratory, tried in a program of its own.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct TrialArgs {
    /// Files of pressure systems
    pub systems: Vec<PathBuf>,
    /// File that takes a row a system
    #[arg(long)]
    pub rows: PathBuf,
    /// Folder of the pressures that errors are measured against
    #[arg(long)]
    pub truth: PathBuf,
    /// These pressures go there
    #[arg(long)]
    pub is_truth: bool,
    /// Solve the equation without the correction of Eq. (3)
    #[arg(long)]
    pub uncorrected: bool,

    /// Tokens of PETSc's options database.
    #[arg(skip)]
    pub petsc: Vec<String>,
}

/// Whose page is wanted.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct ReportArgs {
    /// Folder of a run, a study or a solver laboratory
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

/// The data file of a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceFile {
    /// Which reference of the case; none: its only one, or all where all name one data file.
    pub name: Option<String>,
    /// A CSV file with the columns that the reference names.
    pub file: PathBuf,
}

/// Reads the command line; `args` begins with the program's name.
///
/// # Errors
/// [`Error::Input`] in one sentence.
pub fn parse(args: impl IntoIterator<Item = impl Into<OsString>>) -> Result<Command> {
    let (own, petsc) = split(args.into_iter().map(Into::into));
    let mut cli = match Cli::try_parse_from(own) {
        Ok(cli) => cli,
        Err(answer) if matches!(answer.kind(), ClapKind::DisplayHelp | ClapKind::DisplayVersion) => {
            return Ok(Command::Text(answer.to_string()));
        }
        Err(error) => return Err(Error::Input(one_sentence(&error))),
    };
    if let Some(option) = petsc.first() {
        let idle = match cli.task {
            Some(Task::Cases { .. }) => Some("cases"),
            Some(Task::Report(_)) => Some("report"),
            _ => None,
        };
        if let Some(task) = idle {
            return Err(Error::Input(format!(
                "{option} is a PETSc option, and `{task}` solves nothing: leave it out"
            )));
        }
        if !cfg!(feature = "petsc") {
            return Err(Error::Input(format!(
                "{option} is a PETSc option, and this build has no PETSc: leave it out or build with the feature petsc"
            )));
        }
    }
    match &mut cli.task {
        Some(Task::Study(study)) => {
            study.common.petsc = petsc;
            study.run().prove()?;
        }
        Some(Task::Solvers(solvers)) => {
            solvers.common.petsc = petsc;
            solvers.run().prove()?;
        }
        Some(Task::Trial(trial)) => trial.petsc = petsc,
        Some(Task::Check(run)) => run.prove_with(petsc)?,
        _ => cli.run.prove_with(petsc)?,
    }
    Ok(match cli.task {
        None => Command::Run(Box::new(cli.run)),
        Some(Task::Check(run)) => Command::Check(run),
        Some(Task::Study(study)) => Command::Study(study),
        Some(Task::Solvers(solvers)) => Command::Solvers(solvers),
        Some(Task::Trial(trial)) => Command::Trial(trial),
        Some(Task::Report(report)) => Command::Report(report),
        Some(Task::Cases { show: None }) => Command::Cases,
        Some(Task::Cases { show: Some(Show::Show { name }) }) => Command::ShowCase(name),
    })
}

/// Writes to standard output; a reader that has seen enough (`| head`) is no error.
///
/// # Errors
/// [`Error::Io`] for all other failures.
pub fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::io("standard output", error)),
        _ => Ok(()),
    }
}

/// The table that `sphpetsc cases` prints.
pub fn case_list() -> String {
    let width = builtin::names().map(str::len).max().unwrap_or(0);
    builtin::list().map(|(name, description)| format!("{name:width$}  {description}\n")).collect()
}

/// The TOML of a built-in case.
///
/// # Errors
/// [`Error::Input`] for an unknown name.
pub fn case_text(name: &str) -> Result<&'static str> {
    builtin::find(name).ok_or_else(|| unknown_case(name))
}

impl RunArgs {
    /// Reads and proves the case with all that was typed about it.
    ///
    /// # Errors
    /// [`Error::Input`] with one line for each problem.
    pub fn load_case(&self) -> Result<CaseFile> {
        let (text, origin) = self.case_source()?;
        let case = read::read_variant(&text, &origin, self.common.variant.as_deref(), &self.overrides())?;
        self.reference_files(&case)?;
        match self.save_systems.iter().find(|&&time| time > case.time.until) {
            None => Ok(case),
            Some(time) => Err(Error::Input(format!(
                "--save-systems names {time:?} s, after the end at {:?} s: leave it out or raise --until",
                case.time.until
            ))),
        }
    }

    /// The references of `case` that were given data, with their files.
    ///
    /// # Errors
    /// [`Error::Input`] for a reference that the case does not have and for a missing file.
    pub fn reference_files<'a>(&'a self, case: &'a CaseFile) -> Result<Vec<(&'a Reference, &'a Path)>> {
        let files = self.data_files(case)?.into_iter();
        let reference = |name: &str| case.references.iter().find(|reference| reference.name == name);
        Ok(files.filter_map(|(name, file)| Some((reference(name)?, file))).collect())
    }

    /// The profile of `case` with its data file, if it was given.
    ///
    /// # Errors
    /// As [`reference_files`](Self::reference_files).
    pub fn profile_file<'a>(&'a self, case: &'a CaseFile) -> Result<Option<(&'a Profile, &'a Path)>> {
        let files = self.data_files(case)?;
        let file_of = |profile: &Profile| files.iter().rev().find(|(name, _)| *name == profile.name);
        Ok(case.profile.as_ref().and_then(|profile| Some((profile, file_of(profile)?.1))))
    }

    /// Names of references and profile that were given data, with their files.
    fn data_files<'a>(&'a self, case: &'a CaseFile) -> Result<Vec<(&'a str, &'a Path)>> {
        let references = case.references.iter().map(|reference| (&reference.name, &reference.file));
        let profile = case.profile.iter().map(|profile| (&profile.name, &profile.file));
        let all: Vec<_> = references.chain(profile).collect();
        let names: Vec<_> = all.iter().map(|(name, _)| name.as_str()).collect();
        let known =
            if names.is_empty() { "has none".to_owned() } else { format!("has {}", names.join(", ")) };
        let share_a_file = names.len() == 1
            || all.first().is_some_and(|(_, file)| file.is_some())
                && all.iter().all(|(_, file)| *file == all[0].1);
        let mut resolved = Vec::new();
        for ReferenceFile { name, file } in &self.common.references {
            let serves = |known: &&str| match name {
                Some(name) => *known == name,
                None => share_a_file,
            };
            let served: Vec<_> = names.iter().copied().filter(serves).collect();
            let problem = match (served.is_empty(), file.is_file()) {
                (true, _) => format!("write NAME=FILE with the name of a reference; the case {known}"),
                (_, false) => "there is no such file: correct its path".to_owned(),
                _ => {
                    resolved.extend(served.into_iter().map(|name| (name, file.as_path())));
                    continue;
                }
            };
            let typed =
                name.as_ref().map(|name| format!("{name}=")).unwrap_or_default() + &file.to_string_lossy();
            return Err(Error::Input(format!("--reference {typed}: {problem}")));
        }
        Ok(resolved)
    }

    fn prove_with(&mut self, petsc: Vec<String>) -> Result<()> {
        self.common.petsc = petsc;
        self.prove()
    }

    /// What needs more than one token to judge.
    fn prove(&self) -> Result<()> {
        if !cfg!(feature = "petsc") && !self.save_systems.is_empty() {
            let advice = "leave it out or build with the feature petsc";
            return Err(Error::Input(format!(
                "--save-systems needs PETSc, which this build does not have: {advice}"
            )));
        }
        // `-ksp_monitor my.toml` would run the default case and let PETSc write over my.toml.
        let is_case = |token: &String| builtin::find(token).is_some() || token.ends_with(".toml");
        match self.common.petsc.windows(2).find(|pair| is_case(&pair[1])) {
            Some([option, case]) if self.common.case.is_none() => Err(Error::Input(format!(
                "{case} stands where the value of {option} belongs: put the case first, sphpetsc {case} {option} ..."
            ))),
            _ => Ok(()),
        }
    }

    /// Text and name of the case; a run that is resumed by its folder brings its own.
    fn case_source(&self) -> Result<(String, String)> {
        let name = match (&self.common.case, &self.resume) {
            (Some(name), _) => name.clone(),
            (None, Some(Some(folder))) => folder.join("run.toml").to_string_lossy().into_owned(),
            (None, _) => builtin::DEFAULT.to_owned(),
        };
        if let Some(text) = builtin::find(&name) {
            return Ok((text.to_owned(), format!("built-in case {name}")));
        }
        if !name.ends_with(".toml") && !Path::new(&name).is_file() {
            return Err(unknown_case(&name));
        }
        match std::fs::read_to_string(&name) {
            Ok(text) => Ok((text, name)),
            Err(error) => {
                Err(Error::Input(format!("{name}: cannot be read ({error}): check its path and contents")))
            }
        }
    }

    /// Options that stand for keys of the case file, then `--set` in the order typed.
    fn overrides(&self) -> Vec<(String, String)> {
        let scheme = self.method.scheme.and_then(|kind| kind.to_possible_value());
        let snapshots = (!self.snapshots.is_empty()).then_some(&self.snapshots);
        let named = [
            ("scheme.kind", scheme.map(|kind| kind.get_name().to_owned())),
            ("spacing", self.method.spacing.map(|value| format!("{value:?}"))),
            ("time.until", self.common.until.map(|value| format!("{value:?}"))),
            ("seed", self.common.seed.map(|value| value.to_string())),
            ("output.snapshots", snapshots.map(|values| format!("{values:?}"))),
        ];
        let named = named.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?)));
        named.chain(self.common.set.iter().cloned()).collect()
    }
}

impl StudyArgs {
    /// What all runs of the study have in common.
    pub fn run(&self) -> RunArgs {
        RunArgs { common: self.common.clone(), ..RunArgs::default() }
    }
}

impl SolversArgs {
    /// The run whose systems are solved.
    pub fn run(&self) -> RunArgs {
        let (common, method) = (self.common.clone(), self.method.clone());
        RunArgs { common, method, ..RunArgs::default() }
    }
}

impl CaseArgs {
    /// How much the log prints.
    pub fn log_level(&self) -> log::LevelFilter {
        match (self.quiet, self.verbose) {
            (true, _) => log::LevelFilter::Error,
            (_, true) => log::LevelFilter::Debug,
            _ => log::LevelFilter::Info,
        }
    }
}

impl TrialArgs {
    /// The arguments of a program that does this trial: what [`parse`] turns back into `self`.
    pub fn tokens(&self) -> Vec<OsString> {
        let mut tokens = vec!["trial".into()];
        tokens.extend(self.systems.iter().map(Into::into));
        tokens.extend([
            "--rows".into(),
            self.rows.clone().into(),
            "--truth".into(),
            self.truth.clone().into(),
        ]);
        let flags = [("--is-truth", self.is_truth), ("--uncorrected", self.uncorrected)];
        tokens.extend(flags.iter().filter(|(_, on)| *on).map(|(name, _)| OsString::from(name)));
        tokens.extend(self.petsc.iter().map(Into::into));
        tokens
    }
}

impl RunArgs {
    /// The arguments of a program that does this run: what [`parse`] turns back into `self`.
    pub fn tokens(&self) -> Vec<OsString> {
        let mut tokens: Vec<OsString> = self.common.case.iter().map(Into::into).collect();
        let mut add = |name: &str, value: &dyn AsRef<OsStr>| {
            tokens.extend([OsString::from(name), value.as_ref().to_owned()]);
        };
        if let Some(name) = &self.common.variant {
            add("--variant", name);
        }
        for (key, value) in self.overrides() {
            add("--set", &format!("{key}={value}"));
        }
        if let Some(folder) = &self.out {
            add("--out", folder);
        }
        for ReferenceFile { name, file } in &self.common.references {
            let mut typed = name.as_ref().map(|name| OsString::from(format!("{name}="))).unwrap_or_default();
            typed.push(file);
            add("--reference", &typed);
        }
        if let Some(threads) = self.common.threads {
            add("--threads", &threads.to_string());
        }
        for time in &self.save_systems {
            add("--save-systems", &format!("{time:?}"));
        }
        match &self.resume {
            Some(Some(folder)) => add("--resume", folder),
            Some(None) => tokens.push("--resume".into()),
            None => {}
        }
        let flags =
            [("--force", self.force), ("--quiet", self.common.quiet), ("--verbose", self.common.verbose)];
        tokens.extend(flags.iter().filter(|(_, on)| *on).map(|(name, _)| OsString::from(name)));
        tokens.extend(self.common.petsc.iter().map(Into::into));
        tokens
    }
}

/// Options of ours whose values are sets of PETSc's options.
const TAKES_OPTIONS: [&str; 2] = ["--try", "--solver"];

/// Separates our tokens from PETSc's and the values that follow those.
fn split(args: impl Iterator<Item = OsString>) -> (Vec<OsString>, Vec<String>) {
    let (mut own, mut petsc) = (Vec::new(), Vec::new());
    let mut args = args.peekable();
    while let Some(token) = args.next() {
        if token == "--" {
            own.push(token);
            own.extend(args.by_ref());
        } else if TAKES_OPTIONS.iter().any(|name| token == *name) {
            // What follows is a set of options, not an option.
            own.push(token);
            own.extend(args.next());
        } else if is_petsc_option(&token) {
            petsc.push(token.to_string_lossy().into_owned());
            petsc.extend(args.next_if(is_value).map(|value| value.to_string_lossy().into_owned()));
        } else {
            own.push(token);
        }
    }
    (own, petsc)
}

fn is_petsc_option(token: &OsString) -> bool {
    let token = token.to_string_lossy();
    let mut letters = token.chars();
    token.len() > 2 && letters.next() == Some('-') && letters.next().is_some_and(char::is_alphabetic)
}

/// All that is no option: negative numbers are values.
fn is_value(token: &OsString) -> bool {
    let token = token.to_string_lossy();
    !token.strip_prefix('-').is_some_and(|rest| rest.starts_with(|c: char| c == '-' || c.is_alphabetic()))
}

/// Clap's answer without its layout.
fn one_sentence(error: &clap::Error) -> String {
    let text = error.to_string();
    let lines = text.lines().map(str::trim).take_while(|line| !line.starts_with("Usage:"));
    let lines: Vec<_> = lines.filter(|line| !line.is_empty() && !line.starts_with("For more")).collect();
    // A second CASE stands where clap looks for a subcommand.
    let sentence = lines.join("; ").replace(":; ", ": ").replace("the subcommand ", "");
    format!("{}: see sphpetsc --help", sentence.trim_start_matches("error: "))
}

fn unknown_case(name: &str) -> Error {
    let near = read::nearest(name, builtin::names())
        .map(|near| format!("did you mean {near}? "))
        .unwrap_or_default();
    Error::Input(format!(
        "there is no case {name:?}: {near}`sphpetsc cases` lists the built-in ones, and the name of a file ends in .toml"
    ))
}

fn number(text: &str, fits: impl Fn(f64) -> bool, wanted: &str) -> std::result::Result<f64, String> {
    let number = text.parse().ok().filter(|value: &f64| value.is_finite() && fits(*value));
    number.ok_or_else(|| format!("give a finite number {wanted}"))
}

fn positive(text: &str) -> std::result::Result<f64, String> {
    number(text, |value| value > 0.0, "> 0")
}

fn metres(text: &str) -> std::result::Result<f64, String> {
    number(text, |value| value > 0.0, "> 0 in m")
}

fn seconds(text: &str) -> std::result::Result<f64, String> {
    number(text, |value| value >= 0.0, ">= 0 in s")
}

fn seed(text: &str) -> std::result::Result<u64, String> {
    // TOML's integers have a sign.
    let number = text.parse::<i64>().ok().and_then(|value| value.try_into().ok());
    number.ok_or_else(|| format!("give a whole number from 0 to {}", i64::MAX))
}

fn threads(text: &str) -> std::result::Result<usize, String> {
    text.parse().ok().filter(|&value| value > 0).ok_or_else(|| "give a whole number > 0".to_owned())
}

fn assignment(text: &str) -> std::result::Result<(String, String), String> {
    match text.split_once('=') {
        Some((key, value)) => Ok((key.trim().to_owned(), value.to_owned())),
        None => Err("write KEY=VALUE, like fluid.density=1025".to_owned()),
    }
}

pub(crate) fn reference(text: &str) -> std::result::Result<ReferenceFile, String> {
    let (name, file) = match text.split_once('=') {
        Some((name, file)) => (Some(name.to_owned()), file),
        None => (None, text),
    };
    if file.is_empty() {
        Err("write FILE or NAME=FILE".to_owned())
    } else {
        Ok(ReferenceFile { name, file: file.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens(line: &str) -> (Vec<OsString>, Vec<String>) {
        split(line.split(' ').map(OsString::from))
    }

    #[test]
    fn one_dash_and_several_letters_are_petsc_tokens() {
        let (own, petsc) = tokens(
            "case -ksp_type cg --until 1 -log_view --set a=-1 -ksp_rtol 1e-6 -x_shift -2 -q -ksp_view -o dir",
        );
        assert_eq!(own.join(&OsString::from(" ")), "case --until 1 --set a=-1 -q -o dir");
        assert_eq!(petsc.join(" "), "-ksp_type cg -log_view -ksp_rtol 1e-6 -x_shift -2 -ksp_view");
    }

    #[test]
    fn options_become_keys_of_the_case() {
        let line = "sphpetsc still_water_2d --spacing 0.02 --until 2 --seed 7 --snapshots 0.5,1 --set name=x";
        let Ok(Command::Run(run)) = parse(line.split(' ')) else { panic!("a run was asked for") };
        let case = run.load_case().unwrap();
        assert_eq!((case.spacing, case.time.until, case.seed, case.name.as_str()), (0.02, 2.0, 7, "x"));
        assert_eq!(case.output.snapshots, [0.5, 1.0]);
    }

    #[test]
    fn a_reference_is_found_by_name_or_as_the_only_one() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
        let resolve = |typed: &str| {
            let run = RunArgs {
                common: CaseArgs { references: vec![reference(typed).unwrap()], ..CaseArgs::default() },
                ..RunArgs::default()
            };
            run.load_case().map(|case| run.reference_files(&case).unwrap()[0].0.name.clone())
        };
        assert_eq!(resolve(file).unwrap(), "martin_moyce");
        assert_eq!(resolve(&format!("martin_moyce={file}")).unwrap(), "martin_moyce");
        assert!(
            resolve(&format!("other={file}")).unwrap_err().to_string().contains("the case has martin_moyce")
        );
        assert!(resolve("missing.csv").unwrap_err().to_string().contains("no such file"));
    }

    #[test]
    fn resume_takes_a_folder_or_none() {
        for (line, wanted) in [("sphpetsc --resume", None), ("sphpetsc --resume out/x", Some("out/x".into()))]
        {
            let Ok(Command::Run(run)) = parse(line.split(' ')) else { panic!("a run was asked for") };
            assert_eq!(run.resume, Some(wanted));
        }
    }
}
