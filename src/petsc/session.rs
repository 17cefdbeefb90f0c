//! MPI and PETSc, started once and stopped in reverse.

use std::cell::RefCell;
use std::ffi::{CString, c_char, c_int};
use std::ptr;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};

use mpi::Threading;
use mpi::collective::{CommunicatorCollectives, SystemOperation};
use mpi::environment::Universe;
use mpi::ffi::MPI_Comm;
use mpi::raw::AsRaw;
use mpi::topology::{Communicator, SimpleCommunicator};

use super::error::{c_string, check, install_handler};
use super::options::Options;
use super::{Index, ffi};
use crate::{Error, Result};

/// MPI and PETSc at work. Handles hold an `Rc` of it, so it ends after the last of them.
pub struct Session {
    options: Options,
    world: SimpleCommunicator,
    /// PETSc keeps pointers to the command line until it ends.
    _arguments: Arguments,
    /// Where this session started MPI itself. Dropped last: MPI ends after PETSc.
    _universe: Option<Universe>,
}

/// A command line in the form C's `main` has it.
struct Arguments {
    _strings: Vec<CString>,
    pointers: Vec<*mut c_char>,
}

/// PETSc does not start twice.
static STARTED: AtomicBool = AtomicBool::new(false);

impl Session {
    /// Starts MPI, unless the program has, then PETSc with the user's own PETSc tokens (`-ksp_type cg ...`).
    ///
    /// # Errors
    /// [`Error::Input`] when PETSc rejects the tokens (for instance a missing `-options_file`),
    /// [`Error::Run`] when there was a session before in this process.
    pub fn start(petsc_args: &[String]) -> Result<Rc<Self>> {
        // Only this thread calls MPI, while rayon's threads compute: funneled.
        let universe = mpi::initialize_with_threading(Threading::Funneled).map(|(universe, _)| universe);
        if STARTED.swap(true, Ordering::Relaxed) {
            return Err(Error::Run("PETSc ran in this process already; start one Session only".into()));
        }
        let mut arguments = Arguments::new(petsc_args)?;
        install_handler()?;
        let mut count = (arguments.pointers.len() - 1) as c_int;
        let mut values = arguments.pointers.as_mut_ptr();
        // SAFETY: count and values describe a null-terminated list of C strings that `Session` keeps.
        check(unsafe { ffi::PetscInitialize(&raw mut count, &raw mut values, ptr::null(), ptr::null()) })
            .map_err(|e| Error::Input(format!("PETSc does not accept its options: {e}")))?;
        // SAFETY: PETSc runs; both calls only fill the lists of known solver types.
        check(unsafe { ffi::KSPInitializePackage() }).and(check(unsafe { ffi::PCInitializePackage() }))?;
        let options = Options::snapshot()?;
        STAGES.set(Some(vec![]));
        Ok(Rc::new(Self {
            options,
            world: SimpleCommunicator::world(),
            _arguments: arguments,
            _universe: universe,
        }))
    }

    /// PETSc's options database.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// This process's number, from 0.
    pub fn rank(&self) -> usize {
        self.world.rank() as usize
    }

    /// Number of processes.
    pub fn size(&self) -> usize {
        self.world.size() as usize
    }

    /// PETSc's version, for the record of a run.
    pub fn petsc_version() -> String {
        format!("{}.{}.{}", ffi::PETSC_VERSION_MAJOR, ffi::PETSC_VERSION_MINOR, ffi::PETSC_VERSION_SUBMINOR)
    }

    /// Whether it is so on any rank.
    pub fn any(&self, local: bool) -> bool {
        let mut any = local;
        self.world.all_reduce_into(&local, &mut any, SystemOperation::logical_or());
        any
    }

    /// The sum of `local` over the ranks before this one.
    pub(super) fn before(&self, local: Index) -> Index {
        let mut upto = 0;
        self.world.scan_into(&local, &mut upto, SystemOperation::sum());
        upto - local
    }

    /// The communicator of all ranks as PETSc takes it (rsmpi and PETSc share one MPI).
    pub(super) fn comm(&self) -> MPI_Comm {
        self.world.as_raw()
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        STAGES.set(None);
        // SAFETY: PETSc runs and no handle is left, since each holds an `Rc` of this session.
        // An error here has nobody to handle it.
        unsafe { ffi::PetscFinalize() };
    }
}

impl Arguments {
    fn new(petsc_args: &[String]) -> Result<Self> {
        // Signals are the program's: PETSc's handler would also break pipes (`| head`).
        // Options that nothing used are reported by `Options::unused`, not at the end of a run.
        let ours = ["sphpetsc", "-no_signal_handler", "-options_left", "no"].map(String::from);
        let strings: Vec<CString> =
            ours.iter().chain(petsc_args).map(|a| c_string(a)).collect::<Result<_>>()?;
        let pointers = strings.iter().map(|s| s.as_ptr().cast_mut()).chain([ptr::null_mut()]).collect();
        Ok(Self { _strings: strings, pointers })
    }
}

thread_local! {
    /// The stages registered so far, by name, while PETSc runs on this thread.
    static STAGES: RefCell<Option<Vec<(&'static str, ffi::PetscLogStage)>>> = const { RefCell::new(None) };
}

/// Runs `work` as a named stage of the run in the table of `-log_view`; where PETSc does not run, just runs it.
pub fn stage<T>(name: &'static str, work: impl FnOnce() -> T) -> T {
    let Some(id) = stage_id(name) else { return work() };
    // SAFETY: PETSc runs, since the stage is known. A stage that cannot be booked is no reason to stop.
    let pushed = check(unsafe { ffi::PetscLogStagePush(id) }).is_ok();
    let outcome = work();
    if pushed {
        // SAFETY: closes the push above; sessions end between stages.
        check(unsafe { ffi::PetscLogStagePop() }).ok();
    }
    outcome
}

fn stage_id(name: &'static str) -> Option<ffi::PetscLogStage> {
    STAGES.with_borrow_mut(|stages| {
        let stages = stages.as_mut()?;
        if let Some((_, id)) = stages.iter().find(|(known, _)| *known == name) {
            return Some(*id);
        }
        let (text, mut id) = (c_string(name).ok()?, 0);
        // SAFETY: PETSc runs; the name is a C string, which it copies.
        check(unsafe { ffi::PetscLogStageRegister(text.as_ptr(), &raw mut id) }).ok()?;
        stages.push((name, id));
        Some(id)
    })
}
