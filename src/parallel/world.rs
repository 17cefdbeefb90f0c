//! Ranks over MPI, by rsmpi.

use mpi::Threading;
use mpi::collective::SystemOperation;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives, Destination, Source};

use super::Ranks;
use crate::{Error, Result};
use std::process::Command;

/// Environment variables by which launchers of MPI programs tell a process about its peers: Open MPI, MPICH and Intel MPI, and what
/// speaks PMIx, such as Slurm.
const LAUNCHERS: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"];

/// What Open MPI needs on machines of every kind: to run as root in containers, on more ranks than cores, unbound, without ptrace
/// permissions, silent about what rank 0 has said already, and with time to save a state when it is interrupted. Threads are
/// rayon's, so BLAS gets one.
const ENVIRONMENT: [(&str, &str); 9] = [
    ("OMPI_ALLOW_RUN_AS_ROOT", "1"),
    ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1"),
    ("OMPI_MCA_rmaps_base_oversubscribe", "1"),
    ("OMPI_MCA_hwloc_base_binding_policy", "none"),
    ("OMPI_MCA_btl_vader_single_copy_mechanism", "none"),
    ("OMPI_MCA_orte_execute_quiet", "1"),
    ("OMPI_MCA_odls_base_sigkill_timeout", "10"),
    ("OMP_NUM_THREADS", "1"),
    ("OPENBLAS_NUM_THREADS", "1"),
];

/// Where ranks outnumber cores, one that waits leaves its core to others. Where each has its own, it is sooner back from a wait
/// that spins: two ranks on two cores take 3 % less.
const SHARES_CORES: (&str, &str) = ("OMPI_MCA_mpi_yield_when_idle", "1");

/// What runs as long as ranks may talk to each other; ends MPI when it goes.
pub struct Running {
    universe: Option<Universe>,
}

/// Starts MPI where a launcher started this process. Call it once, from the main thread.
pub fn start() -> Running {
    // Only the main thread calls MPI, while rayon's threads compute: funneled.
    let universe = is_launched().then(|| mpi::initialize_with_threading(Threading::Funneled)).flatten();
    Running { universe: universe.map(|(universe, _)| universe) }
}

impl Running {
    /// All ranks.
    pub fn ranks(&self) -> Ranks {
        let Some(universe) = &self.universe else { return Ranks::default() };
        let world = universe.world();
        let here = world.split_shared(world.rank()).size() as usize;
        Ranks { rank: world.rank() as usize, count: world.size() as usize, here }
    }
}

/// Ends all ranks after a defect of this one, for which they would wait in vain.
pub fn abort() {
    if mpi::environment::is_initialized() && !mpi::environment::is_finalized() {
        let world = SimpleCommunicator::world();
        if world.size() > 1 {
            world.abort(1);
        }
    }
}

/// Starts this program again on `count` ranks of so many `threads`, in place of this process. In a process that a launcher started
/// there is nothing to do.
///
/// # Errors
/// [`Error::Input`] where there is no mpiexec.
#[cfg(unix)]
pub fn launch(count: usize, threads: usize) -> Result<()> {
    use std::os::unix::process::CommandExt;
    if is_launched() {
        return Ok(());
    }
    let program = std::env::current_exe().map_err(|error| Error::io("this program", error))?;
    let mut command = Command::new("mpiexec");
    command.arg("-n").arg(count.to_string()).arg(program).args(std::env::args_os().skip(1));
    let shares_cores = (count * threads > super::cores()).then_some(SHARES_CORES);
    for (name, value) in ENVIRONMENT.into_iter().chain(shares_cores) {
        if std::env::var_os(name).is_none() {
            command.env(name, value);
        }
    }
    let error = command.exec();
    Err(Error::Input(format!(
        "--ranks {count}: mpiexec cannot be started ({error}): install MPI (Debian: openmpi-bin) or leave --ranks out"
    )))
}

fn is_launched() -> bool {
    LAUNCHERS.iter().any(|name| std::env::var_os(name).is_some())
}

pub(super) fn sums(local: &[f64]) -> Vec<f64> {
    let mut total = vec![0.0; local.len()];
    SimpleCommunicator::world().all_reduce_into(local, &mut total[..], SystemOperation::sum());
    total
}

pub(super) fn max(local: f64) -> f64 {
    let mut largest = local;
    SimpleCommunicator::world().all_reduce_into(&local, &mut largest, SystemOperation::max());
    largest
}

/// How many doubles come from each rank, given what goes to each.
pub(super) fn counts(parts: &[Vec<f64>]) -> Vec<usize> {
    let outgoing: Vec<i32> = parts.iter().map(|part| part.len() as i32).collect();
    let mut incoming = vec![0_i32; parts.len()];
    SimpleCommunicator::world().all_to_all_into(&outgoing[..], &mut incoming[..]);
    incoming.into_iter().map(|count| count as usize).collect()
}

/// Messages of `parts` to their ranks; returns those of `incoming` lengths from them. Most ranks have nothing to say to most others, so only who has does, and
/// nothing is copied on the way: a slab's ghosts are as much as caches hold.
pub(super) fn exchange(mut parts: Vec<Vec<f64>>, incoming: &[usize]) -> Vec<Vec<f64>> {
    let world = SimpleCommunicator::world();
    let own = world.rank() as usize;
    let mut received: Vec<Vec<f64>> = incoming.iter().map(|count| vec![0.0; *count]).collect();
    received[own] = std::mem::take(&mut parts[own]);
    let at = |q: usize| world.process_at_rank(q as i32);
    let count = 2 * parts.len();
    mpi::request::multiple_scope(count, |scope, requests| {
        for (q, part) in received.iter_mut().enumerate().filter(|(q, part)| *q != own && !part.is_empty()) {
            requests.add(at(q).immediate_receive_into(scope, &mut part[..]));
        }
        for (q, part) in parts.iter().enumerate().filter(|(_, part)| !part.is_empty()) {
            requests.add(at(q).immediate_send(scope, &part[..]));
        }
        requests.wait_all(&mut Vec::with_capacity(count));
    });
    received
}
