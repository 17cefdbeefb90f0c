//! Ranks in a build without MPI: this process alone.

use super::Ranks;
use crate::{Error, Result};

/// What runs as long as ranks may talk to each other.
#[derive(Debug, Default)]
pub struct Running;

impl Running {
    /// The one rank.
    pub fn ranks(&self) -> Ranks {
        Ranks::default()
    }
}

/// Nobody waits for this rank.
pub fn abort() {}

/// Several ranks are not to be had.
///
/// # Errors
/// [`Error::Input`] for more than one.
pub fn launch(count: usize, _: usize) -> Result<()> {
    match count {
        1 => Ok(()),
        _ => Err(Error::Input(format!(
            "--ranks {count}: this build leaves MPI out: leave --ranks out or build with the feature mpi"
        ))),
    }
}

/// Nothing to start.
pub fn start() -> Running {
    Running
}

pub(super) fn sums(_: &[f64]) -> Vec<f64> {
    unreachable!("one rank has nobody to add to")
}

pub(super) fn max(_: f64) -> f64 {
    unreachable!("one rank has nobody to compare with")
}

pub(super) fn counts(_: &[Vec<f64>]) -> Vec<usize> {
    unreachable!("one rank has nobody to talk to")
}

pub(super) fn exchange(_: Vec<Vec<f64>>, _: &[usize]) -> Vec<Vec<f64>> {
    unreachable!("one rank has nobody to talk to")
}
