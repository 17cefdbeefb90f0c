//! The pressure Poisson equation: plain rows ([`matrix`]), its source ([`source`]), its solution.

/// A sparse matrix of one rank: all its rows, with global column numbers, in compressed rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rows {
    /// Start of each row in `column` and `value`; length rows + 1.
    pub start: Vec<i32>,
    /// Global column numbers, ascending within a row.
    pub column: Vec<i32>,
    /// Matrix entries, SI units.
    pub value: Vec<f64>,
}

/// One pressure system of one rank: `full * pressure = rhs`.
#[derive(Debug, Clone, Default)]
pub struct PressureSystem {
    /// Global number of this rank's first row (0 on one rank).
    pub first_row: usize,
    /// Amat: the operator -L of Eq. (3) (or Shao-Lo), positive diagonal, in general nonsymmetric.
    pub full: Rows,
    /// The symmetric positive (semi)definite part of `full`; filled only when `need_symmetric` was asked for.
    pub symmetric: Rows,
    /// Sparse Pmat: the symmetric operator cut at a short radius; filled only when asked for.
    pub sparse: Rows,
    /// Right-hand side.
    pub rhs: Vec<f64>,
    /// In: initial guess (the last pressure). Out: pressure in Pa.
    pub pressure: Vec<f64>,
    /// Connected sets of unknowns that no free surface touches (pure Neumann): constant null vectors,
    /// each as the list of its local row numbers. Empty in nearly all scenes.
    pub floating: Vec<Vec<u32>>,
}
