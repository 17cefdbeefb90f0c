//! What a trial tells the laboratory: one line of JSON a system.

use serde::{Deserialize, Serialize};

/// What one option set did on one system. Measures are none where there is nothing to measure.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Row {
    /// Name of the system.
    pub system: String,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Stored entries of the operator.
    pub nonzeros: usize,
    /// Whether the true residual is within the tolerance of the set.
    pub converged: bool,
    /// PETSc's name of why the iteration ended.
    pub reason: String,
    /// Iterations on the full operator, and of the inner solver.
    pub iterations: usize,
    /// Iterations of the inner solver, where there is one.
    pub inner_iterations: usize,
    /// Time of matrices and preconditioner in s.
    pub setup_s: f64,
    /// Time of the iteration in s.
    pub solve_s: f64,
    /// Entries of all levels, or of the factors, over those of the matrix they were made from.
    pub complexity: Option<f64>,
    /// Memory that system, matrices and preconditioner take, in MB.
    pub memory_mb: Option<f64>,
    /// |b - A p| / |b|.
    pub residual: Option<f64>,
    /// Root mean square of b - A p in 1/s2: times the time step it is the divergence that the velocity keeps.
    pub defect: Option<f64>,
    /// |p - p_direct| / |p_direct|.
    pub pressure_error: Option<f64>,
    /// Why there is no solution.
    pub failure: Option<String>,
}

impl Row {
    /// Set-up and iteration in s.
    pub fn total_s(&self) -> f64 {
        self.setup_s + self.solve_s
    }
}

/// File of the true pressures of a system.
pub fn truth_name(system: &str, uncorrected: bool) -> String {
    format!("{system}{}.pressure", if uncorrected { "-uncorrected" } else { "" })
}
