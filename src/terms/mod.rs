//! Terms that several schemes share.

pub mod artificial_viscosity;
pub mod collision;
pub mod density_diffusion;
pub mod implicit_viscosity;
pub mod shifting;
pub mod state_equation;
pub mod surface;
pub mod viscosity;
