//! Every solver gives the same pressure on real systems of the dam break: a calm one and one at the impact.
//!
//! The reference is the direct solution by MUMPS. PETSc's options belong to a process, so each option set is tried in a
//! process of its own: the test writes both systems to a file and starts its ignored twin with the options.
#![cfg(feature = "petsc")]

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::rc::Rc;

use sphpetsc::Result;
use sphpetsc::case::{build, builtin, read};
use sphpetsc::output::checkpoint::{Reader, Writer};
use sphpetsc::petsc::Session;
use sphpetsc::ppe::solve::PressureSolver;
use sphpetsc::ppe::{Needs, PressureSolve, PressureSystem, Rows, SolveRecord};
use sphpetsc::scheme::isph::Isph;
use sphpetsc::simulation::{Simulation, StepControl};

const OPTION_SETS: [&str; 7] = [
    "-ksp_type cg -pc_type hypre",
    "-ksp_type cg -pc_type gamg",
    "-ksp_type cg -pc_type icc",
    "-ksp_type cg -pc_type jacobi",
    "-ksp_type bcgs -pc_type ilu",
    "-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type mumps",
    "-ksp_type gmres -pc_type hypre",
];

/// Solves as usual and keeps a copy of the last system, with all the matrices any solver might ask for.
struct Recorder {
    inner: PressureSolver,
    last: Rc<RefCell<PressureSystem>>,
}

impl PressureSolve for Recorder {
    fn needs(&self) -> Needs {
        Needs { symmetric: true, sparse: true, uncorrected: false }
    }
    fn check(&mut self, sample: &PressureSystem) -> Result<()> {
        self.inner.check(sample)
    }
    fn solve(&mut self, system: &mut PressureSystem) -> Result<SolveRecord> {
        self.last.replace(system.clone());
        self.inner.solve(system)
    }
    fn describe(&self) -> String {
        self.inner.describe()
    }
    fn save(&self, system: &PressureSystem, folder: &Path, name: &str) -> Result<PathBuf> {
        self.inner.save(system, folder, name)
    }
}

/// Pressure systems of the dam break at 0.1 s and just after the front has hit the wall.
fn systems() -> Vec<PressureSystem> {
    let text = builtin::find("dam_break_2d").unwrap();
    let case = read::read(text, "dam_break_2d", &[("spacing".into(), "0.01".into())]).unwrap();
    let scene = build::scene::<2>(&case);
    let inner = PressureSolver::new(Session::start(&[]).unwrap(), scene.particles.fluid().len()).unwrap();
    let last = Rc::new(RefCell::new(PressureSystem::default()));
    let solver = Recorder { inner, last: last.clone() };
    let scheme = Isph::new(scene.params.clone(), build::isph(&case), &scene.particles, Box::new(solver));
    let control = StepControl { fixed: None, largest: f64::INFINITY };
    let (gravity, support) = (scene.params.gravity, scene.params.support());
    let mut simulation =
        Simulation::new(scene.particles, Box::new(scheme), control, scene.enclosure, gravity, support);
    simulation.start().unwrap();
    let mut until = |time: f64| {
        while simulation.time < time {
            simulation.advance().unwrap();
        }
        last.borrow().clone()
    };
    vec![until(0.1), until(0.34)]
}

fn write_rows(writer: &mut Writer, name: &str, rows: &Rows) {
    let unsigned = |values: &[i32]| -> Vec<u32> { values.iter().map(|v| *v as u32).collect() };
    writer
        .u32(&format!("{name}.start"), &unsigned(&rows.start))
        .u32(&format!("{name}.column"), &unsigned(&rows.column))
        .f64(&format!("{name}.value"), &rows.value);
}

fn read_rows(reader: &Reader, name: &str) -> Rows {
    let signed = |part: &str| -> Vec<i32> {
        reader.u32(&format!("{name}.{part}")).unwrap().iter().map(|v| *v as i32).collect()
    };
    Rows {
        start: signed("start"),
        column: signed("column"),
        value: reader.f64(&format!("{name}.value")).unwrap().to_vec(),
    }
}

/// Stores the pressures of a solution, one file a system.
fn solve_file(file: &Path, options: &str) -> Vec<f64> {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "solve_one", "--ignored", "--nocapture"])
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
    let reader = Reader::load(Path::new(&std::env::var("SPHPETSC_TEST_SYSTEM").unwrap())).unwrap();
    let mut system = PressureSystem {
        full: read_rows(&reader, "full"),
        symmetric: read_rows(&reader, "symmetric"),
        sparse: read_rows(&reader, "sparse"),
        rhs: reader.f64("rhs").unwrap().to_vec(),
        pressure: reader.f64("guess").unwrap().to_vec(),
        ..PressureSystem::default()
    };
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
    for system in systems() {
        assert!(system.floating.is_empty());
        let mut writer = Writer::new();
        write_rows(&mut writer, "full", &system.full);
        write_rows(&mut writer, "symmetric", &system.symmetric);
        write_rows(&mut writer, "sparse", &system.sparse);
        writer.f64("rhs", &system.rhs).f64("guess", &system.pressure);
        let file = writer.save(folder.path(), 0).unwrap();
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
