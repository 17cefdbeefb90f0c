//! The program as a user starts it, for all tests that do.
#![allow(dead_code)]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use sphpetsc::output::checkpoint::{self, Reader};

/// The program in a folder with the words of a line as its arguments.
pub fn command(folder: impl AsRef<Path>, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sphpetsc"));
    command.current_dir(folder).args(line.split_whitespace());
    // Ranks of tests have little to save when one of them fails, which Open MPI's launcher waits for, twice.
    command.env("OMPI_MCA_odls_base_sigkill_timeout", "1");
    // Tests that run side by side share the cores.
    command.env("OMPI_MCA_mpi_yield_when_idle", "1");
    command
}

/// Runs it to its end, whatever that is.
pub fn run(folder: impl AsRef<Path>, line: &str) -> Output {
    command(folder, line).output().unwrap()
}

/// Standard output.
pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs it to a good end and returns what was printed.
pub fn done(folder: impl AsRef<Path>, line: &str) -> String {
    let output = run(folder, line);
    assert_eq!(output.status.code(), Some(0), "{line}: {}", stderr(&output));
    stdout(&output)
}

/// Expects this exit code and one error sentence, which is returned.
pub fn sentence(output: &Output, code: i32) -> String {
    let stderr = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    for text in [&stderr, &stdout(output)] {
        assert!(!text.contains("PETSC ERROR") && !text.contains("panicked"), "{text}");
    }
    let errors: Vec<_> = stderr.lines().filter_map(|line| line.strip_prefix("error: ")).collect();
    assert_eq!(errors.len(), 1, "{stderr}");
    errors[0].to_owned()
}

/// Runs it in an empty folder and expects a refusal before anything is written.
pub fn refused(line: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let sentence = sentence(&run(&folder, line), 2);
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0, "{line} wrote something");
    sentence
}

/// Whether a program is there; tests that need one that is missing say so and pass.
pub fn is_installed(program: &str) -> bool {
    let is_there = Command::new(program).arg("--version").output().is_ok();
    if !is_there {
        eprintln!("skipped: no {program}");
    }
    is_there
}

/// summary.json of a run.
pub fn summary(run: &Path) -> Value {
    serde_json::from_slice(&fs::read(run.join("summary.json")).unwrap()).unwrap()
}

/// The newest state of a run.
pub fn newest_state(folder: &Path) -> Reader {
    let newest = checkpoint::latest(&folder.join("checkpoint")).unwrap().expect("a checkpoint");
    Reader::load(&newest).unwrap()
}

/// Everything in a state, bit by bit.
pub fn bits(state: &Reader) -> BTreeMap<String, Vec<u64>> {
    let section = |name: &str| match state.f64(name) {
        Ok(numbers) => numbers.iter().map(|x| x.to_bits()).collect(),
        Err(_) => state.u64(name).unwrap().to_vec(),
    };
    state.names().map(|name| (name.to_owned(), section(name))).collect()
}
