//! The fence around PETSc: every `unsafe` of the crate is in this folder, behind safe handles.
//!
//! - [`Session`] starts MPI and PETSc and stops them in reverse; each handle keeps it alive, so
//!   `PetscFinalize` always comes last, in whatever order handles are dropped.
//! - [`Vector`], [`Matrix`], [`NullSpace`] and [`Ksp`] own one PETSc object each and destroy it once.
//!   PETSc counts references itself: a `Ksp` keeps its matrices when their handles are gone.
//! - Handles are neither `Send` nor `Sync`: threads fill plain rows, the starting thread calls PETSc.
//! - Every return code becomes a [`Result`](crate::Result) that carries PETSc's own first message;
//!   PETSc prints no error text itself and installs no signal handler.
//! - [`Options`] sets defaults that the user's own options override.
//!
//! This folder knows no SPH. Calls on several ranks are collective unless noted.

#![allow(unsafe_code)]

mod error;
mod ffi;
mod ksp;
mod mat;
mod options;
mod session;
mod vec;

pub use ksp::{Ksp, SolveReport, Tolerances};
pub use mat::{Matrix, NullSpace};
pub use options::{Options, captured, nearest};
pub use session::{Session, stage};
pub use vec::{BinaryFile, Vector};

/// Number of a row or a column, as wide as this PETSc was built with.
pub type Index = ffi::PetscInt;

/// `PETSC_DECIDE`, which bindgen takes for 32 bits wide.
const DECIDE: Index = ffi::PETSC_DECIDE as Index;

// `Rows` of the crate are made of `Index` and f64; PETSc takes them as they are.
const _: () = assert!(
    size_of::<ffi::PetscScalar>() == size_of::<f64>(),
    "this PETSc was built with another scalar; use one with real double scalars"
);
