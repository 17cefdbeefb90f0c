//! A stand-in for a pressure solver that keeps the system it is given and solves nothing.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use sphpetsc::Result;
use sphpetsc::ppe::{Needs, PressureSolve, PressureSystem, SolveRecord};
use sphpetsc::terms::implicit_viscosity::{VelocitySolve, VelocitySystem};

/// Asks for matrices and leaves the last system where others find it.
pub struct Catcher {
    /// Matrices to ask for.
    pub needs: Needs,
    /// The last system.
    pub system: Rc<RefCell<PressureSystem>>,
}

impl PressureSolve for Catcher {
    fn needs(&self) -> Needs {
        self.needs
    }

    fn check(&mut self, _: &PressureSystem) -> Result<()> {
        Ok(())
    }

    fn solve(&mut self, system: &mut PressureSystem) -> Result<SolveRecord> {
        self.system.borrow_mut().clone_from(system);
        Ok(SolveRecord::default())
    }

    fn describe(&self) -> String {
        "none".into()
    }

    fn save(&self, _: &PressureSystem, folder: &Path, _: &str) -> Result<PathBuf> {
        Ok(folder.to_owned())
    }
}

/// Solves no velocities: water needs none.
pub struct Inviscid;

impl VelocitySolve for Inviscid {
    fn solve(&mut self, _: &mut VelocitySystem) -> Result<()> {
        Ok(())
    }
}
