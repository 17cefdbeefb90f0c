//! What a run leaves behind: its folder, particle files, tables, checkpoints, and the line on the terminal.
//!
//! [`folder`], [`vtk`], [`table`], [`checkpoint`] and [`progress`] know no SPH: callers hand over names, numbers and times
//! in seconds. [`quantities`], [`probes`], [`forces`], [`bodies`], [`observers`], [`comparison`], [`restart`] and [`picture`] look at a
//! simulation with them.
//! Every file but the growing tables goes through [`write_atomic`], so that it appears whole or not at all.

pub mod aligned;
pub mod bodies;
pub mod checkpoint;
pub mod comparison;
pub mod exact_log;
pub mod folder;
pub mod forces;
pub mod observers;
pub mod pareto;
pub mod picture;
pub mod probes;
pub mod profiles;
pub mod progress;
pub mod quantities;
pub mod restart;
pub mod table;
pub mod vtk;

pub use folder::{RunFolder, make_subfolder, write_atomic};
pub use progress::{Progress, Status};
pub use table::{Cell, Table};
pub use vtk::{Field, FieldData, Pvd, write_vtp};
