//! This program, started again with other arguments: a run of a study, a trial of the laboratory.
//!
//! What happens in a program of its own takes nothing else with it when it fails, and starts with a fresh PETSc.

use std::ffi::OsString;
use std::io::Read as _;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::{Error, Result};

/// How long a program with a time limit sleeps before it is looked at again.
const PATIENCE: Duration = Duration::from_millis(5);

/// The program that runs at present, and the signal that ends it.
#[derive(Debug, Default, Clone)]
pub struct Child {
    stop: Arc<AtomicBool>,
    /// Number of the process; 0 between runs.
    process: Arc<AtomicU32>,
}

/// How a program with a time limit ended.
#[derive(Debug)]
pub enum Ended {
    /// By itself, with what it said on standard error.
    Itself(ExitStatus, String),
    /// Stopped after its time.
    OutOfTime,
}

impl Child {
    /// From now on a signal to this program ends the other one, which saves its state.
    ///
    /// Ctrl-C on a terminal reaches the other by itself; a second request to stop does no harm.
    pub fn with_signals() -> Self {
        let child = Self::default();
        let told = child.clone();
        // A second handler in one process is a test harness's business; the first one serves.
        let _ = ctrlc::set_handler(move || {
            told.stop.store(true, Ordering::SeqCst);
            told.pass_on();
        });
        child
    }

    /// Hands a request to stop to the process, if there are both.
    fn pass_on(&self) {
        let process = self.process.load(Ordering::SeqCst);
        if process != 0 && self.stop.load(Ordering::SeqCst) {
            interrupt(process);
        }
    }

    /// Runs the program to its end. Its end table would tear ours apart; its progress and its errors are for the user.
    ///
    /// # Errors
    /// [`Error::Interrupted`] by a signal to either, and an empty [`Error::Input`] where it was given wrong input, of
    /// which it has told.
    pub fn run(&self, tokens: &[OsString]) -> Result<ExitStatus> {
        let ended = self.watch(tokens, Stdio::inherit(), |process| process.wait())?;
        match ended.code() {
            Some(130) => Err(interrupted()),
            // It has said what is wrong: an empty message prints nothing.
            Some(2) => Err(Error::Input(String::new())),
            _ if self.stop.load(Ordering::SeqCst) && !ended.success() => Err(interrupted()),
            _ => Ok(ended),
        }
    }

    /// Runs the program for some time at most, and unheard.
    ///
    /// # Errors
    /// [`Error::Interrupted`] by a signal.
    pub fn run_within(&self, tokens: &[OsString], limit: Duration) -> Result<Ended> {
        let began = Instant::now();
        let ended = self.watch(tokens, Stdio::piped(), |process| {
            let stderr = process.stderr.take();
            // A full pipe would stop the program: it is emptied while it runs.
            let listener = thread::spawn(move || {
                let mut said = vec![];
                // What was read until the pipe broke is what there is to tell.
                let _ = stderr.map(|mut stderr| stderr.read_to_end(&mut said));
                String::from_utf8_lossy(&said).into_owned()
            });
            loop {
                if let Some(status) = process.try_wait()? {
                    return Ok(Ended::Itself(status, listener.join().unwrap_or_default()));
                }
                if began.elapsed() > limit || self.stop.load(Ordering::SeqCst) {
                    process.kill()?;
                    process.wait()?;
                    return Ok(Ended::OutOfTime);
                }
                thread::sleep(PATIENCE);
            }
        })?;
        if self.stop.load(Ordering::SeqCst) { Err(interrupted()) } else { Ok(ended) }
    }

    fn watch<T>(
        &self,
        tokens: &[OsString],
        stderr: Stdio,
        wait: impl FnOnce(&mut std::process::Child) -> std::io::Result<T>,
    ) -> Result<T> {
        if self.stop.load(Ordering::SeqCst) {
            return Err(interrupted());
        }
        let failed = |error| Error::io("the program of a run", error);
        let mut process = std::env::current_exe()
            .and_then(|program| {
                let mut command = Command::new(program);
                command.args(tokens).stdin(Stdio::null()).stdout(Stdio::null()).stderr(stderr).spawn()
            })
            .map_err(failed)?;
        self.process.store(process.id(), Ordering::SeqCst);
        self.pass_on();
        let ended = wait(&mut process).map_err(failed);
        self.process.store(0, Ordering::SeqCst);
        ended
    }
}

fn interrupted() -> Error {
    Error::Interrupted("interrupted: the same command goes on from here".into())
}

#[cfg(unix)]
fn interrupt(process: u32) {
    use nix::sys::signal::{Signal, kill};
    if let Ok(process) = process.try_into() {
        // Fails only if the process has ended just now.
        let _ = kill(nix::unistd::Pid::from_raw(process), Signal::SIGINT);
    }
}

/// Elsewhere a console tells all its programs.
#[cfg(not(unix))]
fn interrupt(_: u32) {}
