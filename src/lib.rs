//! **sphpetsc** simulates floods hitting structures with smoothed particle hydrodynamics (SPH), after Jian, Liang, Shao,
//! Chen & Yang (2016), *Int. J. Offshore Polar Eng.* 26, 33-40, doi:10.17736/ijope.2016.ak08 ("Jian et al." below).
//!
//! It solves the equations of an incompressible liquid with a free surface in Lagrangian form,
//!
//! div v = 0,   Dv/Dt = -(1/rho) grad p + nu laplacian v + g,
//!
//! by projection: particles carry v, a pressure Poisson equation (PPE) with the corrected Laplacian of Eq. (3) of Jian
//! et al. makes v divergence-free, and PETSc with hypre solves it. The weakly compressible schemes that it is compared
//! with ([`scheme::wcsph`]) need no PETSc.
//!
//! # Notation
//!
//! | symbol | name in the code | meaning | unit |
//! |---|---|---|---|
//! | a, b | `a`, `b` | a particle and its neighbour | |
//! | dx | `spacing` | particle spacing | m |
//! | h | `smoothing_length` | smoothing length of the kernel W | m |
//! | F | `gradient` | (dW/dr)/r, so that grad W_ab = F r_ab | 1/m^(D+2) |
//! | V | `volume` | volume of every particle, dx^D | m^D |
//! | S | `defect` | sum V grad W, zero in a full support | 1/m |
//! | B | `correction` | makes the gradient exact for linear fields | |
//! | s | `surface` | surface weight, 1 on the free surface, 0 inside | |
//! | n / n_0 | `crowding` | kernel sum over its value on the regular lattice | |
//!
//! Everything is in SI units. In 2D masses, forces and energies are those of a slice 1 m wide.
//!
//! # Map
//!
//! From the bottom up; a module uses only those above it in this list.
//!
//! - [`error`]: what goes wrong, and the exit code of each kind; [`memory`]: what a process takes
//! - [`kernel`]: smoothing kernels and what they sum to on a lattice
//! - `petsc`: the only unsafe code, a thin fence around PETSc (feature `petsc`)
//! - [`particles`], [`form`], [`geometry`], [`parallel`], [`halo`], [`neighbors`], [`pair_sums`], [`simd`]: arrays, forms of bodies, scenes
//!   on a lattice, ranks, ghosts, who is near whom, pairs taken once, four pairs at a time
//! - [`operators`]: density, divergence, gradients, Laplacians; [`terms`]: viscosity, state equation, density diffusion, surface,
//!   shifting, collisions
//! - [`boundary`]: walls of dummy particles, wall pressure from the liquid, repulsive walls
//! - [`ppe`]: the pressure equation: matrix, source, solution
//! - [`motion`]: a tank that is moved; [`bodies`]: rigid bodies, their friction, and their coupling with the pressure
//! - [`scheme`]: one time step; [`simulation`]: the time loop
//! - [`output`]: particle files, tables, gauges, checkpoints, pictures; [`report`]: the end of a run
//! - [`exact`]: flows with a known solution
//! - [`case`]: case files; [`patch_test`]: the operators on known fields
//! - [`run`], [`cli`]: a run from the command line to its folder; [`child`]: this program started again
//! - [`study`]: many runs, their errors over their run times; [`lab`]: many solvers on the same pressure systems
//! - [`page`]: one HTML page of a run, a study or a laboratory

#![deny(unsafe_code)]

pub mod bodies;
pub mod boundary;
pub mod case;
pub mod child;
pub mod cli;
pub mod error;
pub mod exact;
pub mod form;
pub mod geometry;
pub mod halo;
pub mod invariants;
pub mod kernel;
pub mod lab;
pub mod memory;
pub mod motion;
pub mod neighbors;
pub mod operators;
pub mod output;
pub mod page;
pub mod pair_sums;
pub mod parallel;
pub mod particles;
pub mod patch_test;
#[cfg(feature = "petsc")]
pub mod petsc;
pub mod ppe;
pub mod report;
pub mod run;
pub mod scheme;
pub mod simd;
pub mod simulation;
pub mod study;
pub mod terms;

pub use error::{Error, Result};
