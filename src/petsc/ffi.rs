//! The generated bindings. `MPI_Comm` is rsmpi's, so both libraries share one communicator.

#![allow(non_camel_case_types, non_snake_case, non_upper_case_globals, missing_docs, dead_code)]
#![allow(clippy::all)]

use mpi::ffi::MPI_Comm;

include!(concat!(env!("OUT_DIR"), "/petsc.rs"));
