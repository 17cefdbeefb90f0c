//! Distributed vectors.

use std::path::Path;
use std::rc::Rc;
use std::{ptr, slice};

use super::error::{c_string, check};
use super::mat::Matrix;
use super::session::Session;
use super::{DECIDE, ffi};
use crate::Result;

/// A vector spread over the ranks; each rank owns consecutive entries.
pub struct Vector {
    raw: ffi::Vec,
    local: usize,
    session: Rc<Session>,
}

impl Vector {
    /// A vector of zeros with `local` entries on this rank.
    pub fn zeros(session: &Rc<Session>, local: usize) -> Result<Self> {
        let mut vector = Self { raw: ptr::null_mut(), local, session: Rc::clone(session) };
        // SAFETY: a new object is written to `raw`; `Drop` destroys it also when a later call fails.
        unsafe {
            check(ffi::VecCreate(session.comm(), &raw mut vector.raw))?;
            check(ffi::VecSetSizes(vector.raw, local as ffi::PetscInt, DECIDE))?;
            check(ffi::VecSetType(vector.raw, c"standard".as_ptr()))?;
            check(ffi::VecSet(vector.raw, 0.0))?;
        }
        Ok(vector)
    }

    /// A vector whose entries on this rank are `values`.
    pub fn from_slice(session: &Rc<Session>, values: &[f64]) -> Result<Self> {
        let mut vector = Self::zeros(session, values.len())?;
        vector.write(values)?;
        Ok(vector)
    }

    /// A copy.
    pub fn duplicate(&self) -> Result<Self> {
        let copy = Self::zeros(&self.session, self.local)?;
        // SAFETY: two live vectors of one layout.
        check(unsafe { ffi::VecCopy(self.raw, copy.raw) })?;
        Ok(copy)
    }

    /// Overwrites this rank's entries (not collective).
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn write(&mut self, values: &[f64]) -> Result<()> {
        assert_eq!(values.len(), self.local, "vector and slice differ in length");
        let mut entries = ptr::null_mut();
        // SAFETY: PETSc lends `local` entries until the matching restore.
        unsafe {
            check(ffi::VecGetArray(self.raw, &raw mut entries))?;
            if self.local > 0 {
                ptr::copy_nonoverlapping(values.as_ptr(), entries, self.local);
            }
            check(ffi::VecRestoreArray(self.raw, &raw mut entries))
        }
    }

    /// Copies this rank's entries out (not collective).
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn read(&self, values: &mut [f64]) -> Result<()> {
        assert_eq!(values.len(), self.local, "vector and slice differ in length");
        let mut entries = ptr::null();
        // SAFETY: PETSc lends `local` entries until the matching restore; null only when there are none.
        unsafe {
            check(ffi::VecGetArrayRead(self.raw, &raw mut entries))?;
            if self.local > 0 {
                values.copy_from_slice(slice::from_raw_parts(entries, self.local));
            }
            check(ffi::VecRestoreArrayRead(self.raw, &raw mut entries))
        }
    }

    /// Number of entries on all ranks.
    pub fn size(&self) -> Result<usize> {
        let mut size = 0;
        // SAFETY: `raw` is a live vector.
        check(unsafe { ffi::VecGetSize(self.raw, &raw mut size) })?;
        Ok(size as usize)
    }

    /// Number of entries on this rank.
    pub fn local_size(&self) -> usize {
        self.local
    }

    /// Euclidean norm over all ranks.
    pub fn norm(&self) -> Result<f64> {
        let mut norm = 0.0;
        // SAFETY: `raw` is a live vector.
        check(unsafe { ffi::VecNorm(self.raw, ffi::NORM_2, &raw mut norm) })?;
        Ok(norm)
    }

    /// Sets every entry.
    pub fn fill(&mut self, value: f64) -> Result<()> {
        // SAFETY: `raw` is a live vector.
        check(unsafe { ffi::VecSet(self.raw, value) })
    }

    /// Multiplies every entry.
    pub fn scale(&mut self, factor: f64) -> Result<()> {
        // SAFETY: `raw` is a live vector.
        check(unsafe { ffi::VecScale(self.raw, factor) })
    }

    /// `self = other + factor * self`.
    pub fn scale_and_add(&mut self, factor: f64, other: &Self) -> Result<()> {
        // SAFETY: two live vectors, distinct because one is borrowed mutably.
        check(unsafe { ffi::VecAYPX(self.raw, factor, other.raw) })
    }

    pub(super) fn raw(&self) -> ffi::Vec {
        self.raw
    }
}

impl Drop for Vector {
    fn drop(&mut self) {
        // SAFETY: this handle's reference, released once; null is allowed.
        unsafe { ffi::VecDestroy(&raw mut self.raw) };
    }
}

/// An open file of PETSc's binary format, which PETSc's solver examples (`-f FILE`) and `PetscBinaryIO` read.
pub struct BinaryFile(ffi::PetscViewer);

impl BinaryFile {
    /// A new file, of all ranks together.
    pub fn create(session: &Session, path: &Path) -> Result<Self> {
        let name = c_string(&path.display().to_string())?;
        let mut file = Self(ptr::null_mut());
        // SAFETY: a new viewer is written to `file`; `Drop` destroys it also when a later call fails.
        unsafe {
            check(ffi::PetscViewerCreate(session.comm(), &raw mut file.0))?;
            check(ffi::PetscViewerSetType(file.0, c"binary".as_ptr()))?;
            check(ffi::PetscViewerBinarySetSkipInfo(file.0, ffi::PETSC_TRUE))?;
            check(ffi::PetscViewerFileSetMode(file.0, ffi::FILE_MODE_WRITE))?;
            check(ffi::PetscViewerFileSetName(file.0, name.as_ptr()))?;
        }
        Ok(file)
    }

    /// Appends a matrix.
    pub fn matrix(&self, matrix: &Matrix) -> Result<()> {
        // SAFETY: live objects on the same ranks.
        check(unsafe { ffi::MatView(matrix.raw(), self.0) })
    }

    /// Appends a vector.
    pub fn vector(&self, vector: &Vector) -> Result<()> {
        // SAFETY: live objects on the same ranks.
        check(unsafe { ffi::VecView(vector.raw, self.0) })
    }
}

impl Drop for BinaryFile {
    fn drop(&mut self) {
        // SAFETY: the only reference, released once; null is allowed. Closes the file.
        unsafe { ffi::PetscViewerDestroy(&raw mut self.0) };
    }
}
