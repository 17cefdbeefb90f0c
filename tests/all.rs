//! All integration tests as one program: what they share is compiled once, not once a file. `cargo nextest run exact::` runs
//! those of a file.

mod common;

mod bodies;
mod cli;
mod exact;
mod faults;
mod fuzz;
mod lab;
mod mpi;
mod operators;
mod output;
mod petsc;
mod pictures;
mod ppe;
mod report;
mod run;
mod solvers;
mod study;
mod wcsph;
