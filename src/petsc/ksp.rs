//! Krylov solvers with their preconditioners.

use std::ptr;
use std::rc::Rc;

use super::error::{c_string, check, text};
use super::mat::{Matrix, stored};
use super::session::Session;
use super::vec::Vector;
use super::{Index, ffi};
use crate::Result;

/// When a solve stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerances {
    /// Residual relative to the right-hand side.
    pub relative: f64,
    /// Residual as such, in the unit of the right-hand side.
    pub absolute: f64,
    /// Growth of the residual that counts as divergence.
    pub divergence: f64,
    /// Most iterations.
    pub iterations: usize,
}

/// How a solve ended. Converged is what the solver claims, by the norm it watches.
#[derive(Debug, Clone, PartialEq)]
pub struct SolveReport {
    /// Iterations of this solve.
    pub iterations: usize,
    /// PETSc's name for the reason, such as `CONVERGED_RTOL` or `DIVERGED_ITS`.
    pub reason: String,
    /// Whether the reason is one of convergence.
    pub converged: bool,
}

/// A linear solver: Krylov method and preconditioner.
///
/// Order of use: [`new`](Self::new), our defaults, [`set_from_options`](Self::set_from_options) (the
/// user's options win), then [`set_operators`](Self::set_operators) and [`solve`](Self::solve) at each step.
pub struct Ksp {
    raw: ffi::KSP,
    session: Rc<Session>,
}

impl Ksp {
    /// A solver that reads options starting with `prefix` (empty: `-ksp_type` and so on).
    pub fn new(session: &Rc<Session>, prefix: &str) -> Result<Self> {
        let prefix = c_string(prefix)?;
        let mut ksp = Self { raw: ptr::null_mut(), session: Rc::clone(session) };
        // SAFETY: a new object is written to `raw`; `Drop` destroys it also when the second call fails.
        unsafe {
            check(ffi::KSPCreate(session.comm(), &raw mut ksp.raw))?;
            check(ffi::KSPSetOptionsPrefix(ksp.raw, prefix.as_ptr()))?;
        }
        Ok(ksp)
    }

    /// Chooses Krylov method and preconditioner by PETSc's names.
    pub fn set_types(&mut self, ksp: &str, pc: &str) -> Result<()> {
        let (ksp, pc) = (c_string(ksp)?, c_string(pc)?);
        // SAFETY: live objects; the names are C strings that PETSc copies.
        unsafe {
            check(ffi::KSPSetType(self.raw, ksp.as_ptr()))?;
            check(ffi::PCSetType(self.pc()?, pc.as_ptr()))
        }
    }

    /// The names of Krylov method and preconditioner in force; empty where none is set yet.
    pub fn types(&self) -> Result<(String, String)> {
        let (mut ksp, mut pc) = (ptr::null(), ptr::null());
        // SAFETY: live objects; the names are null or live as long as the object, and are copied here.
        unsafe {
            check(ffi::KSPGetType(self.raw, &raw mut ksp))?;
            check(ffi::PCGetType(self.pc()?, &raw mut pc))?;
            Ok((text(ksp), text(pc)))
        }
    }

    /// Sets when to stop.
    pub fn set_tolerances(&mut self, t: Tolerances) -> Result<()> {
        let iterations = t.iterations.min(Index::MAX as usize) as ffi::PetscInt;
        // SAFETY: `raw` is a live solver.
        check(unsafe { ffi::KSPSetTolerances(self.raw, t.relative, t.absolute, t.divergence, iterations) })
    }

    /// When it stops, the user's options included after [`set_from_options`](Self::set_from_options).
    pub fn tolerances(&self) -> Result<Tolerances> {
        let (mut relative, mut absolute, mut divergence, mut iterations) = (0.0, 0.0, 0.0, 0);
        // SAFETY: `raw` is a live solver and the four places are valid.
        check(unsafe {
            ffi::KSPGetTolerances(
                self.raw,
                &raw mut relative,
                &raw mut absolute,
                &raw mut divergence,
                &raw mut iterations,
            )
        })?;
        Ok(Tolerances { relative, absolute, divergence, iterations: iterations.max(0) as usize })
    }

    /// Preconditions from the right, so that the watched norm is that of the true residual.
    /// Only for methods that can (`gmres`, `bcgs` and their kin); others fail at set-up.
    pub fn set_right_preconditioning(&mut self) -> Result<()> {
        // SAFETY: `raw` is a live solver.
        unsafe {
            check(ffi::KSPSetPCSide(self.raw, ffi::PC_RIGHT))?;
            check(ffi::KSPSetNormType(self.raw, ffi::KSP_NORM_UNPRECONDITIONED))
        }
    }

    /// Directions kept before GMRES restarts; ignored by other methods.
    pub fn set_restart(&mut self, directions: usize) -> Result<()> {
        // SAFETY: `raw` is a live solver.
        check(unsafe { ffi::KSPGMRESSetRestart(self.raw, directions as ffi::PetscInt) })
    }

    /// Whether the solution vector holds a first guess (else it starts from zero).
    pub fn set_guess_nonzero(&mut self, nonzero: bool) -> Result<()> {
        // SAFETY: `raw` is a live solver.
        check(unsafe { ffi::KSPSetInitialGuessNonzero(self.raw, nonzero.into()) })
    }

    /// Lets go of the matrices, which are freed if nothing else holds them.
    pub fn release_operators(&mut self) -> Result<()> {
        // SAFETY: `raw` is a live solver; it takes null for no matrix, until it is given others.
        check(unsafe { ffi::KSPSetOperators(self.raw, ptr::null_mut(), ptr::null_mut()) })
    }

    /// Makes `inner` this solver's preconditioner.
    pub fn set_inner(&mut self, inner: &Self) -> Result<()> {
        let pc = self.pc()?;
        // SAFETY: live objects; the preconditioner takes its own reference of `inner`.
        unsafe {
            check(ffi::PCSetType(pc, c"ksp".as_ptr()))?;
            check(ffi::PCKSPSetKSP(pc, inner.raw))
        }
    }

    /// Lets the options database override what was set so far.
    pub fn set_from_options(&mut self) -> Result<()> {
        // SAFETY: `raw` is a live solver.
        check(unsafe { ffi::KSPSetFromOptions(self.raw) })
    }

    /// The matrix to solve and the one to build the preconditioner from; both are kept.
    pub fn set_operators(&mut self, matrix: &Matrix, preconditioner: &Matrix) -> Result<()> {
        // SAFETY: live objects; the solver takes its own references.
        check(unsafe { ffi::KSPSetOperators(self.raw, matrix.raw(), preconditioner.raw()) })
    }

    /// Builds the preconditioner.
    pub fn set_up(&mut self) -> Result<()> {
        // SAFETY: `raw` is a live solver.
        check(unsafe { ffi::KSPSetUp(self.raw) })
    }

    /// Solves for `x`. An `Ok` is no convergence: read the report.
    pub fn solve(&mut self, b: &Vector, x: &mut Vector) -> Result<SolveReport> {
        let (mut code, mut name, mut iterations) = (0, ptr::null(), 0);
        // SAFETY: live objects, b and x distinct; the name is a static string of PETSc.
        unsafe {
            check(ffi::KSPSolve(self.raw, b.raw(), x.raw()))?;
            check(ffi::KSPGetConvergedReason(self.raw, &raw mut code))?;
            check(ffi::KSPGetConvergedReasonString(self.raw, &raw mut name))?;
            check(ffi::KSPGetIterationNumber(self.raw, &raw mut iterations))?;
            Ok(SolveReport { iterations: iterations as usize, reason: text(name), converged: code > 0 })
        }
    }

    /// Iterations of all solves so far, for a solver that is another one's preconditioner.
    pub fn total_iterations(&self) -> Result<usize> {
        let mut total = 0;
        // SAFETY: `raw` is a live solver.
        check(unsafe { ffi::KSPGetTotalIterations(self.raw, &raw mut total) })?;
        Ok(total as usize)
    }

    /// Entries of all levels of a multigrid of PETSc's, or of the factors, over those of the matrix that the
    /// preconditioner was made from; none for other preconditioners. After a set-up only.
    pub fn complexity(&self) -> Result<Option<f64>> {
        let pc = self.pc()?;
        let kind = self.types()?.1;
        if ["gamg", "ml", "mg"].contains(&kind.as_str()) {
            let (mut grids, mut operators) = (0.0, 0.0);
            // SAFETY: a live multigrid that is set up, and two valid places.
            check(unsafe { ffi::PCMGGetGridComplexity(pc, &raw mut grids, &raw mut operators) })?;
            return Ok(Some(operators).filter(|value| *value > 0.0));
        }
        if ["lu", "cholesky", "ilu", "icc"].contains(&kind.as_str()) {
            let (mut factors, mut matrix, mut made_from) =
                (ptr::null_mut(), ptr::null_mut(), ptr::null_mut());
            // SAFETY: live objects; the matrices are lent by the preconditioner, which lives on.
            return unsafe {
                check(ffi::PCFactorGetMatrix(pc, &raw mut factors))?;
                check(ffi::PCGetOperators(pc, &raw mut matrix, &raw mut made_from))?;
                let (factors, made_from) = (stored(factors)?, stored(made_from)?);
                Ok(Some(factors / made_from).filter(|value| value.is_finite() && *value > 0.0))
            };
        }
        Ok(None)
    }

    /// The session this solver belongs to.
    pub fn session(&self) -> &Rc<Session> {
        &self.session
    }

    fn pc(&self) -> Result<ffi::PC> {
        let mut pc = ptr::null_mut();
        // SAFETY: `raw` is a live solver, which owns the answer.
        check(unsafe { ffi::KSPGetPC(self.raw, &raw mut pc) })?;
        Ok(pc)
    }
}

impl Drop for Ksp {
    fn drop(&mut self) {
        // SAFETY: this handle's reference, released once; null is allowed.
        unsafe { ffi::KSPDestroy(&raw mut self.raw) };
    }
}
