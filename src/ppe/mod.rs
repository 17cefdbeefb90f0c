//! The pressure Poisson equation (PPE), div((1/rho) grad p) = source.
//!
//! [`matrix`] assembles plain rows from particles, [`source`] fills the right-hand side, and whatever implements
//! [`PressureSolve`] solves; with the feature `petsc` that is [`solve::PressureSolver`].
//! [`recorder`] keeps systems as they were before their solution, [`saved`] reads them from their files.

pub mod matrix;
pub mod recorder;
pub mod saved;
#[cfg(feature = "petsc")]
pub mod solve;
pub mod source;

use crate::Result;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Number of a row or a column: PETSc's own integer, of 64 bits where PETSc was built so.
#[cfg(feature = "petsc")]
pub type Index = crate::petsc::Index;
/// Number of a row or a column.
#[cfg(not(feature = "petsc"))]
pub type Index = i32;

/// A sparse matrix of one rank: its rows, with global column numbers (CSR).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rows {
    /// Start of each row in `column` and `value`; length rows + 1.
    pub start: Vec<Index>,
    /// Global column numbers, ascending within a row.
    pub column: Vec<Index>,
    /// Matrix entries, SI units.
    pub value: Vec<f64>,
}

/// One pressure system of one rank: `full * pressure = rhs`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PressureSystem {
    /// Global number of this rank's first row (0 on one rank).
    pub first_row: usize,
    /// Amat: the operator -L of Eq. (3) (or of Shao & Lo), positive diagonal, in general nonsymmetric.
    pub full: Rows,
    /// Symmetric positive (semi)definite part of `full`; filled only on demand.
    pub symmetric: Rows,
    /// Sparse Pmat: the symmetric operator cut at a short radius; filled only on demand.
    pub sparse: Rows,
    /// The uncorrected operator of Shao & Lo, for comparisons; filled only on demand.
    pub uncorrected: Rows,
    /// Right-hand side in 1/s2.
    pub rhs: Vec<f64>,
    /// Right-hand side that belongs to `uncorrected`, in 1/s2; filled only on demand.
    pub uncorrected_rhs: Vec<f64>,
    /// In: first guess (the last pressure). Out: pressure in Pa.
    pub pressure: Vec<f64>,
    /// Connected sets of unknowns that no free surface touches (pure Neumann, constant null vectors), each as its
    /// local row numbers. Empty in nearly all scenes.
    pub floating: Vec<Vec<u32>>,
}

/// Which matrices beside `full` a solver asks for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Needs {
    /// [`PressureSystem::symmetric`].
    pub symmetric: bool,
    /// [`PressureSystem::sparse`].
    pub sparse: bool,
    /// [`PressureSystem::uncorrected`] and its right-hand side.
    pub uncorrected: bool,
}

/// What one solve did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SolveRecord {
    /// Number of unknowns on all ranks.
    pub unknowns: usize,
    /// Stored entries of Amat on all ranks.
    pub nonzeros: usize,
    /// Iterations on Amat.
    pub iterations: usize,
    /// Iterations of the inner solver, where there is one.
    pub inner_iterations: usize,
    /// True relative residual |b - A x| / |b|.
    pub residual: f64,
    /// PETSc's name of why the iteration ended.
    pub reason: String,
    /// Time for matrices and preconditioner in s.
    pub setup_s: f64,
    /// Time of the iteration in s.
    pub solve_s: f64,
    /// Which fallback solved the system, and why, if the chosen solver did not.
    pub fallback: Option<String>,
}

/// Solves pressure systems.
pub trait PressureSolve {
    /// Which matrices the assembler must fill.
    fn needs(&self) -> Needs;

    /// Tries the solver out on a first system, before anything is written: wrong or unused options are errors.
    fn check(&mut self, sample: &PressureSystem) -> Result<()>;

    /// Solves `system` in place, or fails with one sentence; never returns an unconverged pressure.
    fn solve(&mut self, system: &mut PressureSystem) -> Result<SolveRecord>;

    /// Solves the last system once more, with another right-hand side: `pressure` is the first guess and the solution.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    fn solve_again(
        &mut self,
        system: &PressureSystem,
        rhs: &[f64],
        pressure: &mut Vec<f64>,
    ) -> Result<SolveRecord> {
        let mut other =
            PressureSystem { rhs: rhs.to_vec(), pressure: std::mem::take(pressure), ..system.clone() };
        let record = self.solve(&mut other);
        *pressure = other.pressure;
        record
    }

    /// One or two lines on what is in force.
    fn describe(&self) -> String;

    /// Writes a system into `folder` in a format that other programs read; returns the file.
    fn save(&self, system: &PressureSystem, folder: &Path, name: &str) -> Result<PathBuf>;
}

impl Rows {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// True if there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn range(&self, k: usize) -> Range<usize> {
        self.start[k] as usize..self.start[k + 1] as usize
    }

    /// Columns of row `k`, ascending.
    pub fn columns(&self, k: usize) -> &[Index] {
        &self.column[self.range(k)]
    }

    /// (column, value) of row `k`.
    pub fn row(&self, k: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let values = &self.value[self.range(k)];
        self.columns(k).iter().zip(values).map(|(&c, &v)| (c as usize, v))
    }

    /// Entry (k, column), zero if it is not stored.
    pub fn get(&self, k: usize, column: usize) -> f64 {
        self.row(k).find(|(c, _)| *c == column).map_or(0.0, |(_, v)| v)
    }

    /// y = A x on one rank.
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
        (0..self.len()).map(|k| self.row(k).map(|(c, v)| v * x[c]).sum()).collect()
    }

    /// Transpose of a square matrix of one rank; its rows come out sorted by column.
    pub fn transpose(&self) -> Self {
        let n = self.len();
        let mut start: Vec<Index> = vec![0; n + 1];
        for &c in &self.column {
            start[c as usize + 1] += 1;
        }
        for k in 0..n {
            start[k + 1] += start[k];
        }
        let mut next = start.clone();
        let mut column = vec![0; self.column.len()];
        let mut value = vec![0.0; self.value.len()];
        for k in 0..n {
            for (c, v) in self.row(k) {
                let at = next[c] as usize;
                (column[at], value[at]) = (k as Index, v);
                next[c] += 1;
            }
        }
        Self { start, column, value }
    }
}
