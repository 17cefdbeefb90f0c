//! Every solver gives the same pressure on real systems of the dam break: a calm one and one at the impact.
//!
//! The reference is the direct solution by MUMPS. PETSc's options belong to a process, so each option set is tried in a
//! process of its own: the test writes both systems to a file and starts its ignored twin with the options.
#![cfg(feature = "petsc")]

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::Command;

use sphpetsc::Error;
use sphpetsc::case::{build, builtin, read};
use sphpetsc::petsc::Session;
use sphpetsc::ppe::solve::PressureSolver;
use sphpetsc::ppe::{Needs, PressureSolve, PressureSystem, SolveRecord, recorder::Recorder, saved};
use sphpetsc::scheme::isph::Isph;
use sphpetsc::simulation::{Simulation, StepControl};
use sphpetsc::terms::implicit_viscosity::VelocitySolver;

const OPTION_SETS: [&str; 7] = [
    "-ksp_type cg -pc_type hypre",
    "-ksp_type cg -pc_type gamg",
    "-ksp_type cg -pc_type icc",
    "-ksp_type cg -pc_type jacobi",
    "-ksp_type bcgs -pc_type ilu",
    "-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps",
    "-ksp_type gmres -pc_type hypre",
];

/// A solver that gives up on three solves in a row.
struct Reluctant {
    inner: PressureSolver,
    solves: Range<u32>,
    done: u32,
}

impl PressureSolve for Reluctant {
    fn needs(&self) -> Needs {
        self.inner.needs()
    }

    fn check(&mut self, sample: &PressureSystem) -> Result<(), Error> {
        self.inner.check(sample)
    }

    fn solve(&mut self, system: &mut PressureSystem) -> Result<SolveRecord, Error> {
        self.done += 1;
        match self.solves.contains(&self.done) {
            true => Err(Error::Petsc("not now".into())),
            false => self.inner.solve(system),
        }
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }

    fn save(&self, system: &PressureSystem, folder: &Path, name: &str) -> Result<PathBuf, Error> {
        self.inner.save(system, folder, name)
    }
}

/// The dam break at a spacing in m, started, with a solver around PETSc's.
fn dam_break(spacing: &str, wrap: impl FnOnce(PressureSolver) -> Box<dyn PressureSolve>) -> Simulation<2> {
    let text = builtin::find("dam_break_2d").unwrap();
    let case = read::read(text, "dam_break_2d", &[("spacing".into(), spacing.into())]).unwrap();
    let scene = build::scene::<2>(&case);
    let session = Session::start(&[]).unwrap();
    let inner = PressureSolver::new(session.clone(), scene.particles.fluid().len()).unwrap();
    let solvers = (wrap(inner), Box::new(VelocitySolver::new(session)) as _);
    let scheme = Isph::new(scene.params.clone(), build::isph(&case, &scene), &scene.particles, solvers);
    let control = StepControl { fixed: None, largest: f64::INFINITY };
    let (gravity, support) = (scene.params.gravity, scene.params.support());
    let mut simulation =
        Simulation::new(scene.particles, Box::new(scheme), control, scene.enclosure, gravity, support);
    simulation.start().unwrap();
    simulation
}

#[test]
fn a_step_that_fails_again_and_again_starts_from_where_it_began() {
    // The start solves once.
    let mut simulation = dam_break("0.02", |inner| Box::new(Reluctant { inner, solves: 42..45, done: 0 }));
    for _ in 0..40 {
        simulation.advance().unwrap();
    }
    let by_id = |simulation: &Simulation<2>| -> BTreeMap<u64, _> {
        let particles = &simulation.particles;
        particles.fluid().map(|a| (particles.id[a], particles.position[a])).collect()
    };
    let (before, long) = (by_id(&simulation), simulation.dt);
    simulation.advance().unwrap();
    assert_eq!(simulation.totals.retries, 3);
    assert!(simulation.dt < 0.2 * long, "{} after {long}", simulation.dt);
    let speeds = simulation.particles.velocity.iter().map(|v| v.norm());
    let reach = simulation.dt * speeds.fold(0.0, f64::max);
    let moved = by_id(&simulation).iter().map(|(id, r)| (r - before[id]).norm()).fold(0.0, f64::max);
    // What shifting adds is less than half of that.
    assert!(moved < 1.5 * reach, "{moved} m in a step of {reach} m");
}

/// Saves pressure systems of the dam break, at 0.1 s and just after the front has hit the wall.
fn save_systems(folder: &Path) -> Vec<PathBuf> {
    let mut simulation = dam_break("0.01", |inner| Box::new(Recorder::new(Box::new(inner))));
    let mut until = |time: f64| {
        while simulation.time < time {
            simulation.advance().unwrap();
        }
        simulation.scheme.save_system(folder, &format!("t{time}")).unwrap();
        folder.join(format!("t{time}.petsc"))
    };
    vec![until(0.1), until(0.34)]
}

/// Stores the pressures of a solution, one file a system.
fn solve_file(file: &Path, options: &str) -> Vec<f64> {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "solvers::solve_one", "--ignored", "--nocapture"])
        .env("SPHPETSC_TEST_SYSTEM", file)
        .env("SPHPETSC_TEST_OPTIONS", options)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().find_map(|line| line.strip_prefix("pressures "));
    let line = line.unwrap_or_else(|| panic!("{options}: {text}{}", String::from_utf8_lossy(&output.stderr)));
    line.split(' ').map(|word| word.parse().unwrap()).collect()
}

#[test]
#[ignore = "started by the other test, with options"]
fn solve_one() {
    let options = std::env::var("SPHPETSC_TEST_OPTIONS").unwrap_or_default() + " -ksp_rtol 1e-10";
    let file = std::env::var("SPHPETSC_TEST_SYSTEM").unwrap();
    let mut system = saved::read(Path::new(&file)).unwrap();
    let tokens: Vec<String> = options.split_whitespace().map(Into::into).collect();
    let mut solver = PressureSolver::new(Session::start(&tokens).unwrap(), system.rhs.len()).unwrap();
    let record = solver.solve(&mut system).unwrap();
    assert_eq!(record.fallback, None, "{record:?}");
    let words: Vec<String> = system.pressure.iter().map(|p| format!("{p:e}")).collect();
    println!("\npressures {}", words.join(" "));
}

#[test]
fn all_solvers_agree_on_calm_and_impact_systems() {
    let folder = tempfile::tempdir().unwrap();
    for file in save_systems(folder.path()) {
        let system = saved::read(&file).unwrap();
        assert!(system.floating.is_empty() && system.pressure.iter().any(|p| *p > 0.0));
        // The right-hand side of the other form differs where dummies press on walls.
        assert!(system.uncorrected.len() == system.full.len() && system.uncorrected_rhs != system.rhs);
        let truth = solve_file(&file, "-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps");
        let largest = truth.iter().fold(0.0_f64, |m, p| m.max(p.abs()));
        assert!(largest > 1000.0, "water of this depth presses with thousands of Pa");
        for options in OPTION_SETS {
            let found = solve_file(&file, options);
            let error = truth.iter().zip(&found).map(|(t, p)| (t - p).abs()).fold(0.0, f64::max);
            // A residual of 1e-10 bounds the error by 1e-10 times the condition number, here below 1e4.
            assert!(error <= 1e-6 * largest, "{options}: {:e} of the largest pressure", error / largest);
            println!("{options}: {:.1e} of the largest pressure", error / largest);
        }
    }
}
