//! What a run leaves behind: its folder, particle files, tables, checkpoints, and the line on the terminal.
//!
//! Nothing here knows SPH: callers hand over names, numbers and times in seconds. Every file but the
//! growing tables goes through [`write_atomic`], so that it appears whole or not at all.

pub mod checkpoint;
pub mod comparison;
pub mod folder;
pub mod observers;
pub mod probes;
pub mod progress;
pub mod quantities;
pub mod table;
pub mod vtk;

pub use folder::{RunFolder, write_atomic};
pub use progress::{Progress, Status};
pub use table::{Cell, Table};
pub use vtk::{Field, FieldData, Pvd, write_vtp};
