//! One run from a case file to its folder: builds the simulation, lets observers write, reports.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::case::build::{self, Scene};
use crate::case::{CaseFile, Profile, SchemeKind, read};
use crate::cli::{self, RunArgs};
use crate::exact;
use crate::halo::Sharing;
use crate::motion::Motion;
use crate::output::bodies::BodyLog;
use crate::output::comparison::References;
use crate::output::exact_log::ExactLog;
use crate::output::observers::{History, Meters, Probes, Readings, Snapshots, SolverLog, Systems};
use crate::output::picture::gallery::{self, Pictures};
use crate::output::profiles::{self, Profiles};
use crate::output::{Progress, RunFolder, Status, write_atomic};
use crate::output::{checkpoint, restart};
use crate::parallel::Ranks;
use crate::ppe::PressureSolve;
use crate::report::Report;
use crate::scheme::isph::Isph;
use crate::scheme::wcsph::Wcsph;
use crate::scheme::{Scheme, StepReport, logged};

use crate::simulation::{Observer, Simulation, StepControl};
use crate::terms::implicit_viscosity::VelocitySolve;
use crate::{Error, Result, patch_test};

/// Runs a case on `ranks`; all of them call this with the same arguments.
pub fn run(args: &RunArgs, case: &CaseFile, ranks: Ranks) -> Result<()> {
    start_threads(args.common.threads.or(ranks.threads()))?;
    match case.dimension {
        2 => run_in::<2>(args, case, ranks),
        _ => run_in::<3>(args, case, ranks),
    }
}

/// Validates a case and says what a run would take; writes nothing.
pub fn check(args: &RunArgs, case: &CaseFile) -> Result<()> {
    References::read(case, &args.reference_files(case)?)?;
    read_profile(args, case)?;
    cli::print(&match case.dimension {
        2 => derived::<2>(args, case)?,
        _ => derived::<3>(args, case)?,
    })
}

/// The main thread, which alone calls MPI and PETSc, is one of them: with one thread nothing changes threads at all.
fn start_threads(threads: Option<usize>) -> Result<()> {
    let Some(threads) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .use_current_thread()
        .build_global()
        .map_err(|error| Error::Input(format!("--threads {threads}: {error}: try fewer")))
}

fn run_in<const D: usize>(args: &RunArgs, case: &CaseFile, ranks: Ranks) -> Result<()> {
    match case.scheme.kind {
        SchemeKind::PatchTest if !ranks.is_first() => Ok(()),
        SchemeKind::PatchTest => run_patch_test::<D>(args, case),
        _ => Run::<D>::prepare(args, case, ranks)?.finish(),
    }
}

fn run_patch_test<const D: usize>(args: &RunArgs, case: &CaseFile) -> Result<()> {
    let report = patch_test::run::<D>(case);
    let folder = create_folder(args, case)?;
    write_run_file(&folder, args, case, Ranks::default())?;
    report.write(&folder)?;
    cli::print(&format!("{report}written to {}\n", folder.path().display()))
}

/// Everything a run holds.
struct Run<'a, const D: usize> {
    case: &'a CaseFile,
    ranks: Ranks,
    simulation: Simulation<D>,
    meters: Meters<D>,
    /// On the first rank.
    output: Option<Output<'a, D>>,
    folder: PathBuf,
    systems: Systems,
    stop: Arc<AtomicBool>,
    /// A checkpoint was asked for.
    wanted: Arc<AtomicBool>,
    next_checkpoint: f64,
    /// Whether the pressure of the first state could be found; if not, that is a failure of the run.
    started: Result<()>,
}

/// All that writes and prints.
struct Output<'a, const D: usize> {
    case: &'a CaseFile,
    folder: RunFolder,
    history: History,
    exact: Option<ExactLog<D>>,
    probes: Probes,
    profiles: Option<Profiles>,
    solver_log: SolverLog,
    snapshots: Snapshots<D>,
    bodies: Option<BodyLog>,
    pictures: Pictures<D>,
    progress: Progress,
    references: References<'a>,
    began: Instant,
    /// Wall-clock time in s of the parts of a resumed run that ended in order.
    earlier_s: f64,
    solver: String,
    quiet: bool,
}

impl<'a, const D: usize> Run<'a, D> {
    /// Everything that can be wrong is found here, before the first file is written.
    fn prepare(args: &'a RunArgs, case: &'a CaseFile, ranks: Ranks) -> Result<Self> {
        let mut scene = build::scene::<D>(case);
        scene.params.ranks = ranks;
        let read = || {
            let references = References::read(case, &args.reference_files(case)?)?;
            Ok((references, read_profile(args, case)?, resume_from(args, case)?))
        };
        let (references, measured, resumed) = ranks.agree(read())?;
        let (scheme, described) = ranks.agree(scheme(args, case, &scene))?;
        let Scene { particles, params, enclosure, snapped, .. } = &scene;
        let control =
            StepControl { fixed: case.time.step, largest: case.time.step_max.unwrap_or(case.time.until) };
        let mut simulation = Simulation::new(
            particles.clone(),
            scheme,
            control,
            enclosure.clone(),
            params.gravity,
            params.support(),
        );
        simulation.shake(Motion::of(case));
        let started = match simulation.start() {
            Err(wrong @ Error::Input(_)) => return Err(wrong),
            // A saved state brings its pressure along.
            _ if resumed.is_some() => Ok(()),
            outcome => outcome,
        };
        for sentence in snapped {
            log::info!("{sentence} (no multiple of the spacing)");
        }
        log::info!("{described}");
        let mut meters = Meters::new(case, &scene);
        let (opened, saved) = match resumed {
            None => (None, None),
            Some((path, state)) => {
                ranks
                    .agree(restart::restore(&mut simulation, &state).and_then(|()| meters.restore(&state)))?;
                log::info!("resumed at t = {:.6} s, step {}", simulation.time, simulation.step);
                (Some(path), Some(state))
            }
        };
        let since = saved.as_ref().map(|_| simulation.time);
        let open = || {
            let folder = match opened {
                Some(path) => RunFolder::resume(&path)?,
                None => create_folder(args, case)?,
            };
            write_run_file(&folder, args, case, ranks)?;
            Output::new(args, case, &scene, folder, (references, measured), since, described)
        };
        let output = ranks.agree(ranks.is_first().then(open).transpose())?;
        let path = output.as_ref().map_or(Path::new(""), |output| output.folder.path());
        let folder = PathBuf::from(ranks.same_text(path.to_string_lossy().into_owned()));
        let mut run = Self {
            systems: Systems::new(folder.join("systems"), &args.save_systems, since),
            stop: Arc::default(),
            wanted: Arc::default(),
            next_checkpoint: case.output.checkpoint * (simulation.time / case.output.checkpoint).floor()
                + case.output.checkpoint,
            started,
            case,
            ranks,
            output,
            folder,
            meters,
            simulation,
        };
        let stop = run.stop.clone();
        // A second handler in one process is a test harness's business; the first one serves.
        let _ = ctrlc::set_handler(move || stop.store(true, Ordering::Relaxed));
        #[cfg(unix)]
        if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGUSR1, run.wanted.clone()) {
            log::warn!("SIGUSR1 will not save a checkpoint: {error}");
        }
        if since.is_none() {
            let readings = run.meters.read(&run.simulation);
            run.show(|output, whole| output.first_rows(whole, &readings))?;
        }
        Ok(run)
    }

    /// Lets the output look at the whole scene.
    fn show(&mut self, look: impl FnOnce(&mut Output<'a, D>, &Simulation<D>) -> Result<()>) -> Result<()> {
        let output = self.output.as_mut();
        self.simulation.show(|whole| output.map_or(Ok(()), |output| look(output, whole)))
    }

    fn finish(mut self) -> Result<()> {
        let started = std::mem::replace(&mut self.started, Ok(()));
        let outcome = started.inspect_err(|_| self.keep_failed_system()).and_then(|()| self.time_loop());
        let closed = self.close(&outcome);
        outcome.and(closed)
    }

    /// Saves the last state and reports, however the time loop ended.
    fn close(mut self, outcome: &Result<()>) -> Result<()> {
        self.save()?;
        if matches!(outcome, Err(Error::Run(_) | Error::Petsc(_))) {
            self.save_failing_state()?;
        }
        let failure = outcome.as_ref().err().map(ToString::to_string);
        let sharing = self.simulation.scheme.halo().sharing();
        let reported = self.show(|output, whole| output.report(whole, sharing, failure));
        // What cannot be read now is this run's own.
        reported.map_err(|error| match error {
            Error::Input(what) => Error::Run(what),
            other => other,
        })
    }

    fn time_loop(&mut self) -> Result<()> {
        while self.simulation.time < self.case.time.until {
            let report = self.simulation.advance().inspect_err(|_| self.keep_failed_system())?;
            logged("output", || self.observe(&report))?;
            if self.case.output.checkpoint > 0.0 && self.simulation.time >= self.next_checkpoint {
                self.next_checkpoint += self.case.output.checkpoint;
                self.save()?;
            }
            // One look for both: all ranks must agree on it.
            let stops = self.stop.load(Ordering::Relaxed);
            let asked = self.ranks.max(match self.wanted.swap(false, Ordering::Relaxed) {
                _ if stops => 2.0,
                wanted => f64::from(u8::from(wanted)),
            });
            if asked == 1.0 {
                self.save()?;
                log::info!(
                    "checkpoint saved at t = {:.6} s, step {}",
                    self.simulation.time,
                    self.simulation.step
                );
            }
            if asked == 2.0 {
                return Err(Error::Interrupted(format!(
                    "interrupted at t = {:.6} s: the state is saved; go on with --resume {}",
                    self.simulation.time,
                    self.folder.display()
                )));
            }
        }
        self.show(|output, whole| {
            output.snapshots.write(whole)?;
            output.bodies.as_mut().map_or(Ok(()), |bodies| bodies.write(whole))
        })
    }

    /// Tables, files and pictures that are due after a step: all ranks read what rows tell, and only for what shows particles the
    /// scene is gathered.
    fn observe(&mut self, report: &StepReport) -> Result<()> {
        self.ranks.agree(self.systems.save_due(&self.simulation))?;
        let simulation = &self.simulation;
        let (rows, scene) = self.output.as_mut().map_or((false, false), |output| {
            (output.rows_are_due(simulation.time), output.is_due(simulation.time))
        });
        let counts = [simulation.particles.fluid().len(), usize::from(rows), usize::from(scene)];
        let counts = self.ranks.sums(&counts.map(|count| count as f64));
        let readings = (counts[1] > 0.0).then(|| self.meters.read(simulation));
        let noted = self.output.as_mut().map_or(Ok(()), |output| {
            output.note(simulation, report, counts[0] as usize)?;
            readings.map_or(Ok(()), |readings| output.add_rows(simulation, &readings))
        });
        self.ranks.agree(noted)?;
        match counts[2] > 0.0 {
            true => self.show(|output, whole| output.observe(whole, report)),
            false => Ok(()),
        }
    }

    /// A checkpoint, and before it the rows that belong to it.
    fn save(&mut self) -> Result<()> {
        let (output, meters) = (self.output.as_mut(), &self.meters);
        self.simulation.show(|whole| output.map_or(Ok(()), |output| output.save(whole, meters)))
    }

    /// The state in which the last step failed, as particles to look at.
    fn save_failing_state(&mut self) -> Result<()> {
        self.simulation.swap_states();
        let saved = self.show(|output, whole| output.snapshots.write_failed(&output.folder, whole));
        self.simulation.swap_states();
        saved
    }

    fn keep_failed_system(&self) {
        let saved = self.simulation.scheme.save_system(&self.folder.join("systems"), "failed");
        if let Err(error) = saved {
            log::warn!("the failing pressure system could not be saved: {error}");
        }
    }
}

impl<'a, const D: usize> Output<'a, D> {
    fn new(
        args: &RunArgs,
        case: &'a CaseFile,
        scene: &Scene<D>,
        folder: RunFolder,
        (references, measured): (References<'a>, Option<(&'a Profile, profiles::Measured)>),
        since: Option<f64>,
        solver: String,
    ) -> Result<Self> {
        let params = &scene.params;
        let history = History::new::<D>(&folder, case, since)?;
        let probes = Probes::new(&folder, case, since)?;
        let exact = exact::of_case(case, params)
            .map(|exact| ExactLog::new(&folder, exact, case.output.samples, since))
            .transpose()?;
        let profiles = measured
            .map(|(profile, points)| Profiles::new(&folder, profile, points, params.spacing, since))
            .transpose()?;
        Ok(Self {
            history,
            exact,
            profiles,
            probes,
            solver_log: SolverLog::new(&folder, since)?,
            snapshots: Snapshots::new(&folder, case, since)?,
            bodies: BodyLog::new(&folder, case, since)?,
            pictures: Pictures::new(&folder, case, since),
            progress: Progress::new(case.time.until, args.common.quiet),
            references,
            began: Instant::now(),
            earlier_s: since.map_or(0.0, |_| wall_time_in(&folder)),
            solver,
            quiet: args.common.quiet,
            case,
            folder,
        })
    }

    /// The initial state.
    fn first_rows(&mut self, simulation: &Simulation<D>, readings: &Readings<D>) -> Result<()> {
        self.history.sample(simulation.time, readings)?;
        if let Some(exact) = &mut self.exact {
            exact.sample(simulation)?;
        }
        self.probes.sample(simulation, readings)?;
        self.snapshots.write(simulation)?;
        if let Some(bodies) = &mut self.bodies {
            bodies.sample(simulation)?;
            bodies.write(simulation)?;
        }
        self.pictures.draw_due(simulation)
    }

    /// What a step leaves that needs no particles.
    fn note(&mut self, simulation: &Simulation<D>, report: &StepReport, particles: usize) -> Result<()> {
        self.progress.update(&Status {
            time: simulation.time,
            step: simulation.step,
            dt: simulation.dt,
            iterations: report.solve.as_ref().map(|solve| solve.iterations),
            particles,
        });
        self.solver_log.observe(simulation, report)
    }

    fn rows_are_due(&self, time: f64) -> bool {
        let of_bodies = self.bodies.as_ref().is_some_and(|bodies| bodies.is_due(time));
        self.history.is_due(time) || self.probes.is_due(time) || of_bodies
    }

    fn add_rows(&mut self, simulation: &Simulation<D>, readings: &Readings<D>) -> Result<()> {
        self.history.observe(simulation.time, readings)?;
        self.probes.observe(simulation, readings)?;
        self.bodies.as_mut().map_or(Ok(()), |bodies| bodies.observe(simulation))
    }

    /// Those that look at particles.
    fn observers(&mut self) -> impl Iterator<Item = &mut dyn Observer<D>> {
        let always: [&mut dyn Observer<D>; 2] = [&mut self.snapshots, &mut self.pictures];
        let exact = self.exact.as_mut().map(|exact| exact as &mut dyn Observer<D>);
        let profiles = self.profiles.as_mut().map(|profiles| profiles as &mut dyn Observer<D>);
        always.into_iter().chain(exact).chain(profiles)
    }

    fn is_due(&mut self, time: f64) -> bool {
        self.observers().any(|observer| observer.is_due(time))
    }

    fn observe(&mut self, simulation: &Simulation<D>, report: &StepReport) -> Result<()> {
        self.observers().try_for_each(|observer| observer.observe(simulation, report))
    }

    fn save(&mut self, simulation: &Simulation<D>, meters: &Meters<D>) -> Result<()> {
        self.history.flush()?;
        self.probes.flush()?;
        self.bodies.as_mut().map_or(Ok(()), BodyLog::flush)?;
        self.solver_log.flush()?;
        self.exact.as_mut().map_or(Ok(()), ExactLog::flush)?;
        self.profiles.as_mut().map_or(Ok(()), Profiles::flush)?;
        let mut writer = checkpoint::Writer::new();
        restart::save(simulation, &mut writer);
        meters.save(&mut writer);
        writer.u64("scene", &[scene_number(self.case)]);
        writer.save(&self.folder.join("checkpoint"), simulation.step).map(|_| ())
    }

    /// The end of a run: summary, last pictures, end table.
    fn report(
        &mut self,
        simulation: &Simulation<D>,
        sharing: Option<Sharing>,
        failure: Option<String>,
    ) -> Result<()> {
        self.progress.finish();
        let mut comparison = self.references.compare(self.folder.path())?;
        let mut errors = self.exact.as_mut().map_or(Ok(vec![]), ExactLog::errors)?;
        match (&mut self.profiles, &self.case.profile) {
            (Some(profiles), _) => errors.extend(profiles.errors()?),
            (None, Some(profile)) => comparison.missing.push((profile.name.clone(), profile.file.clone())),
            (None, None) => {}
        }
        let report = Report {
            case: self.case,
            scheme: simulation.scheme.as_ref(),
            particles: &simulation.particles,
            time: simulation.time,
            step: simulation.step,
            totals: simulation.totals,
            invariants: simulation.invariants,
            comparison,
            errors,
            solver: &self.solver,
            wall_s: self.earlier_s + self.began.elapsed().as_secs_f64(),
            sharing,
            folder: self.folder.path(),
            failure,
        };
        write_atomic(&self.folder.join("summary.json"), |file| {
            serde_json::to_writer_pretty(file, &report.json()).map_err(Into::into)
        })?;
        self.pictures.draw_last(simulation)?;
        gallery::write_curves(&self.folder, self.case, &self.references)?;
        if self.quiet { Ok(()) } else { cli::print(&report.to_string()) }
    }
}

/// The scheme of a case, and what is in force in it.
fn scheme<const D: usize>(
    args: &RunArgs,
    case: &CaseFile,
    scene: &Scene<D>,
) -> Result<(Box<dyn Scheme<D>>, String)> {
    let Scene { particles, params, .. } = scene;
    if is_explicit(args, case)? {
        let method = build::wcsph(case, scene);
        let described = method.describe();
        return Ok((Box::new(Wcsph::new(params.clone(), method, particles)), described));
    }
    let solvers = solvers(args, particles.fluid().len(), params.ranks)?;
    let described = solvers.0.describe();
    Ok((Box::new(Isph::new(params.clone(), build::isph(case, scene), particles, solvers)), described))
}

/// Whether the scheme solves no pressure system; options for one are then errors.
fn is_explicit(args: &RunArgs, case: &CaseFile) -> Result<bool> {
    let explicit = matches!(case.scheme.kind, SchemeKind::Wcsph | SchemeKind::WcsphMonaghan);
    let name = case.scheme.kind.name();
    match args.common.petsc.first() {
        Some(option) if explicit => Err(Error::Input(format!(
            "{option} is a PETSc option, and the scheme {name} solves no system: leave it out or choose --scheme isph_df"
        ))),
        _ if explicit && !args.save_systems.is_empty() => Err(Error::Input(format!(
            "--save-systems: the scheme {name} solves no system: leave it out or choose --scheme isph_df"
        ))),
        _ => Ok(explicit),
    }
}

/// What ISPH solves its systems with.
type Solvers = (Box<dyn PressureSolve>, Box<dyn VelocitySolve>);

#[cfg(feature = "petsc")]
fn solvers(args: &RunArgs, size: usize, ranks: Ranks) -> Result<Solvers> {
    use crate::ppe::{recorder::Recorder, solve::PressureSolver};
    use crate::terms::implicit_viscosity::VelocitySolver;

    let session = crate::petsc::Session::start(&args.common.petsc)?;
    if session.size() != ranks.count() {
        let count = session.size();
        let sentence =
            format!("{count} ranks were started in an unknown way: start them by mpiexec or --ranks {count}");
        // The first rank speaks for all: an empty message prints nothing.
        return Err(Error::Input(if session.rank() == 0 { sentence } else { String::new() }));
    }
    let velocities = Box::new(VelocitySolver::new(session.clone()));
    let solver = Box::new(PressureSolver::new(session, size)?);
    match args.save_systems.is_empty() {
        true => Ok((solver, velocities)),
        // A saved system is whole: every matrix, and the guess from before the solution.
        false => Ok((Box::new(Recorder::new(solver)), velocities)),
    }
}

#[cfg(not(feature = "petsc"))]
fn solvers(_: &RunArgs, _: usize, _: Ranks) -> Result<Solvers> {
    let advice = "choose --scheme wcsph or build with the feature petsc (the default)";
    Err(Error::Input(format!(
        "this build leaves PETSc out, and the schemes isph_df and isph_di need it: {advice}"
    )))
}

/// The measured surfaces of the case, if their file was given.
fn read_profile<'a>(
    args: &'a RunArgs,
    case: &'a CaseFile,
) -> Result<Option<(&'a Profile, profiles::Measured)>> {
    let given = args.profile_file(case)?;
    given.map(|(profile, file)| Ok((profile, profiles::read(profile, file)?))).transpose()
}

fn create_folder(args: &RunArgs, case: &CaseFile) -> Result<RunFolder> {
    match &args.out {
        Some(path) => RunFolder::create_at(path, args.force),
        None => RunFolder::create_numbered(Path::new("out"), &case.name),
    }
}

/// Folder and newest state of the run to go on with.
fn resume_from(args: &RunArgs, case: &CaseFile) -> Result<Option<(PathBuf, checkpoint::Reader)>> {
    let Some(folder) = &args.resume else { return Ok(None) };
    let path = match (folder, &args.out) {
        (Some(path), _) | (None, Some(path)) => path.clone(),
        (None, None) => newest_run(&case.name).ok_or_else(|| {
            Error::Input(format!("--resume: there is no out/{} yet: leave --resume out", case.name))
        })?,
    };
    let Some(state) = checkpoint::latest(&path.join("checkpoint"))? else {
        return Err(Error::Input(format!(
            "--resume: {} holds no checkpoint: start the run afresh",
            path.display()
        )));
    };
    let state = checkpoint::Reader::load(&state)?;
    if state.u64("scene")? != [scene_number(case)] {
        return Err(Error::Input(format!(
            "--resume: {} holds another case (dimension, spacing, tank, boxes or blocks differ): name the case it ran",
            path.display()
        )));
    }
    Ok(Some((path, state)))
}

/// What a summary says of a run that reached its end.
pub(crate) const AT_THE_END: &str = "at the end";

/// Arguments of the program that does a run or what is left of it; none if it is done.
pub(crate) fn left_to_do(
    args: RunArgs,
    case: &CaseFile,
    folder: &Path,
    force: bool,
) -> Result<Option<RunArgs>> {
    let threads = args.common.threads.unwrap_or_else(rayon::current_num_threads);
    let wanted = run_file(&args, case, threads, Ranks::default());
    let args = RunArgs { out: Some(folder.to_owned()), ..args };
    let begin_again = Ok(Some(RunArgs { force: true, ..args.clone() }));
    match std::fs::read_to_string(folder.join("run.toml")) {
        Err(_) => Ok(Some(args)),
        Ok(found) if found != wanted && force => begin_again,
        Ok(found) if found != wanted => Err(Error::Input(format!(
            "{} is a run with other arguments: choose another --out, or --force to run it again",
            folder.display()
        ))),
        Ok(_) if summary(folder)["ended"] == AT_THE_END => Ok(None),
        // `latest` fails for a folder that cannot be read: the run will say so.
        Ok(_) => match checkpoint::latest(&folder.join("checkpoint")) {
            Ok(None) => begin_again,
            _ => Ok(Some(RunArgs { resume: Some(Some(folder.to_owned())), ..args })),
        },
    }
}

/// summary.json of a run; null where there is none.
pub(crate) fn summary(folder: &Path) -> serde_json::Value {
    let text = std::fs::read(folder.join("summary.json")).unwrap_or_default();
    serde_json::from_slice(&text).unwrap_or_default()
}

/// What the summary of an earlier part of a run gives as its wall-clock time in s.
fn wall_time_in(folder: &RunFolder) -> f64 {
    summary(folder.path())["wall_s"].as_f64().unwrap_or(0.0)
}

/// A number for what the particles of a case are made from; what else differs is no obstacle to going on.
fn scene_number(case: &CaseFile) -> u64 {
    let scene = (case.dimension, case.spacing, &case.tank, &case.boxes, &case.fluid.blocks);
    let mut text = format!("{scene:?}");
    if !case.bodies.is_empty() {
        text += &format!("{:?}", case.bodies.iter().map(|body| &body.shape).collect::<Vec<_>>());
    }
    crc32fast::hash(text.as_bytes()).into()
}

/// out/NAME-n with the largest n, or out/NAME.
fn newest_run(name: &str) -> Option<PathBuf> {
    let number = |path: &Path| -> Option<u64> {
        let rest = path.file_name()?.to_str()?.strip_prefix(name)?;
        if rest.is_empty() { Some(1) } else { rest.strip_prefix('-')?.parse().ok() }
    };
    let runs = std::fs::read_dir("out").ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    runs.filter_map(|path| Some((number(&path)?, path))).max().map(|(_, path)| path)
}

fn write_run_file(folder: &RunFolder, args: &RunArgs, case: &CaseFile, ranks: Ranks) -> Result<()> {
    let text = run_file(args, case, rayon::current_num_threads(), ranks);
    write_atomic(&folder.join("run.toml"), |file| std::io::Write::write_all(file, text.as_bytes()))
}

/// The contents of run.toml for a run on this many threads of each rank.
pub(crate) fn run_file(args: &RunArgs, case: &CaseFile, threads: usize, ranks: Ranks) -> String {
    let header = "The case as run, with all defaults: feed it back to repeat the run.";
    let mut text = read::write(case, header);
    let references = args.common.references.iter().map(|reference| {
        let name = reference.name.as_ref().map(|name| format!("{name}=")).unwrap_or_default();
        toml::Value::from(name + &reference.file.to_string_lossy())
    });
    let count = |count: usize| i64::try_from(count).unwrap_or(i64::MAX).into();
    let machine = toml::Table::from_iter([
        ("version".to_owned(), env!("CARGO_PKG_VERSION").into()),
        ("petsc".to_owned(), petsc_version().into()),
        ("petsc_options".to_owned(), args.common.petsc.join(" ").into()),
        ("references".to_owned(), references.collect::<toml::value::Array>().into()),
        ("system".to_owned(), format!("{} {}", std::env::consts::OS, std::env::consts::ARCH).into()),
        ("ranks".to_owned(), count(ranks.count())),
        ("threads".to_owned(), count(threads)),
    ]);
    text += &format!("\n[run]\n{machine}");
    text
}

#[cfg(feature = "petsc")]
fn petsc_version() -> String {
    crate::petsc::Session::petsc_version()
}

#[cfg(not(feature = "petsc"))]
fn petsc_version() -> String {
    "none".into()
}

/// The pressure solver a run would use, where this build has any.
fn solver_in_force(args: &RunArgs, case: &CaseFile, size: usize) -> Result<Option<String>> {
    let solves = cfg!(feature = "petsc") && case.scheme.kind.solves();
    solves.then(|| solvers(args, size, Ranks::default()).map(|solvers| solvers.0.describe())).transpose()
}

/// What `check` prints: counts, lengths, limits, and what a run would take.
fn derived<const D: usize>(args: &RunArgs, case: &CaseFile) -> Result<String> {
    let scene = build::scene::<D>(case);
    let Scene { particles, params, snapped, .. } = &scene;
    let explicit = is_explicit(args, case)?.then(|| build::wcsph(case, &scene));
    let [fluid, walls, dummies] =
        [particles.fluid().len(), particles.walls().len(), particles.dummies().len()];
    // Measured on 2D and 3D scenes: rows of neighbours, matrices and state, a pair costing about 40 bytes twice.
    let pairs = (std::f64::consts::PI * (params.support() / params.spacing).powi(2)).powi(D as i32 - 1);
    let memory = (fluid + walls) as f64 * (300.0 + 80.0 * pairs.min(60.0)) / 1e6;
    let mut text = format!("case          {} ({}D), scheme {:?}\n", case.name, D, case.scheme.kind);
    let mut line = |name: &str, value: String| text += &format!("{name:<13} {value}\n");
    line("particles", format!("{fluid} fluid, {walls} wall, {dummies} dummy"));
    line(
        "lengths",
        format!(
            "spacing {} m, smoothing length {:.6} m, support {:.6} m",
            params.spacing,
            params.smoothing_length(),
            params.support()
        ),
    );
    let solver = match &explicit {
        Some(method) => Some(method.describe()),
        None => solver_in_force(args, case, fluid)?,
    };
    if let Some(solver) = solver {
        line("solver", solver.replace('\n', "\n              "));
    }
    let fall = particles.fluid().map(|a| particles.position[a][D - 1]).fold(0.0, f64::max);
    let speed = (2.0 * params.gravity.norm() * fall + particles.fastest_liquid().powi(2)).sqrt();
    let limit = match &explicit {
        Some(method) => method.dt_limit(params, speed, 0.0),
        None => build::isph(case, &scene).dt_limit(params, speed, 0.0),
    };
    let dt = case.time.step.unwrap_or(limit.min(case.time.step_max.unwrap_or(case.time.until)));
    let steps = (case.time.until / dt).ceil();
    line(
        "time step",
        format!("about {dt:.3e} s at {speed:.2} m/s, {steps:.0} steps to {} s", case.time.until),
    );
    line("memory", format!("about {memory:.0} MB"));
    // 3 microseconds a particle and step: the whole step of dam_break_2d on one core.
    let seconds = steps * (fluid + walls) as f64 * if D == 2 { 1.5e-6 } else { 6e-6 };
    line("run time", format!("roughly {seconds:.0} s on one core"));
    for sentence in snapped {
        line("snapped", sentence.clone());
    }
    Ok(text)
}
