//! Terms that several schemes share.

pub mod collision;
pub mod shifting;
pub mod surface;
pub mod viscosity;
