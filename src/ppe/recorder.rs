//! Keeps each pressure system as it was before its solution, with every matrix that any solver may ask for.

use std::path::{Path, PathBuf};

use super::{Needs, PressureSolve, PressureSystem, SolveRecord};
use crate::Result;

/// Solves as the solver within does, and saves the last system as it was given: its first guess is the pressure of the
/// step before.
pub struct Recorder {
    inner: Box<dyn PressureSolve>,
    last: PressureSystem,
}

impl Recorder {
    /// Around a solver.
    pub fn new(inner: Box<dyn PressureSolve>) -> Self {
        Self { inner, last: PressureSystem::default() }
    }
}

impl PressureSolve for Recorder {
    fn needs(&self) -> Needs {
        Needs { symmetric: true, sparse: true, uncorrected: true }
    }

    fn check(&mut self, sample: &PressureSystem) -> Result<()> {
        self.inner.check(sample)
    }

    fn solve(&mut self, system: &mut PressureSystem) -> Result<SolveRecord> {
        self.last.clone_from(system);
        self.inner.solve(system)
    }

    fn solve_again(
        &mut self,
        system: &PressureSystem,
        rhs: &[f64],
        pressure: &mut Vec<f64>,
    ) -> Result<SolveRecord> {
        self.inner.solve_again(system, rhs, pressure)
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }

    fn save(&self, _: &PressureSystem, folder: &Path, name: &str) -> Result<PathBuf> {
        self.inner.save(&self.last, folder, name)
    }
}
