//! sphpetsc
#![deny(unsafe_code)]
pub mod boundary;
pub mod case;
pub mod cli;
pub mod error;
pub mod geometry;
pub mod kernel;
pub mod neighbors;
pub mod operators;
pub mod output;
pub mod parallel;
pub mod particles;
pub mod patch_test;
#[cfg(feature = "petsc")]
pub mod petsc;
pub mod ppe;
pub mod report;
pub mod run;
pub mod scheme;
pub mod simulation;
pub mod terms;
pub use error::{Error, Result};
