//! Distributed sparse matrices and their null spaces.

use std::mem::MaybeUninit;
use std::ops::Range;
use std::ptr;
use std::rc::Rc;

use super::error::check;
use super::session::Session;
use super::vec::Vector;
use super::{DECIDE, Index, ffi};
use crate::{Error, Result};

/// A square sparse matrix; each rank owns consecutive rows.
pub struct Matrix {
    raw: ffi::Mat,
    session: Rc<Session>,
}

impl Matrix {
    /// Copies this rank's rows, given as compressed rows with global column numbers that ascend in each, in one go.
    ///
    /// PETSc's own call for this inserts row by row; here it borrows the lists as they are and duplicates that.
    ///
    /// # Errors
    /// [`Error::Run`] when the three lists do not describe rows of a square matrix.
    pub fn from_rows(
        session: &Rc<Session>,
        start: &[Index],
        column: &[Index],
        value: &[f64],
    ) -> Result<Self> {
        let (mut local, mut global) = (start.len().saturating_sub(1) as ffi::PetscInt, DECIDE);
        // SAFETY: both numbers outlive the call; it only adds up `local` over the ranks.
        check(unsafe { ffi::PetscSplitOwnership(session.comm(), &raw mut local, &raw mut global) })?;
        check_rows(start, column, value, global)?;
        let empty = || Self { raw: ptr::null_mut(), session: Rc::clone(session) };
        let mut matrix = empty();
        if session.size() == 1 {
            let mut borrowed = empty();
            let (i, j, v) = (start.as_ptr(), column.as_ptr(), value.as_ptr());
            // SAFETY: the lists were checked above; PETSc only reads them, as long as `borrowed` lives.
            unsafe {
                check(ffi::MatCreateSeqAIJWithArrays(
                    session.comm(),
                    local,
                    local,
                    i.cast_mut(),
                    j.cast_mut(),
                    v.cast_mut(),
                    &raw mut borrowed.raw,
                ))?;
                check(ffi::MatDuplicate(borrowed.raw, ffi::MAT_COPY_VALUES, &raw mut matrix.raw))?;
            }
            return Ok(matrix);
        }
        let first = session.before(local);
        let Split { mut own, mut others } = Split::new(first..first + local, start, column, value);
        let mut borrowed = empty();
        // SAFETY: both halves are sound since the lists are, and outlive `borrowed`, which renumbers the columns of
        // `others` in place: declared after them, it goes first.
        unsafe {
            check(ffi::MatCreateMPIAIJWithSplitArrays(
                session.comm(),
                local,
                local,
                global,
                global,
                own.0.as_mut_ptr(),
                own.1.as_mut_ptr(),
                own.2.as_mut_ptr(),
                others.0.as_mut_ptr(),
                others.1.as_mut_ptr(),
                others.2.as_mut_ptr(),
                &raw mut borrowed.raw,
            ))?;
            check(ffi::MatDuplicate(borrowed.raw, ffi::MAT_COPY_VALUES, &raw mut matrix.raw))?;
        }
        Ok(matrix)
    }

    /// Rows over all ranks.
    pub fn size(&self) -> Result<usize> {
        let (mut rows, mut columns) = (0, 0);
        // SAFETY: `raw` is a live matrix.
        check(unsafe { ffi::MatGetSize(self.raw, &raw mut rows, &raw mut columns) })?;
        Ok(rows as usize)
    }

    /// Stored entries over all ranks.
    pub fn nonzeros(&self) -> Result<usize> {
        // SAFETY: `raw` is a live matrix.
        Ok(unsafe { stored(self.raw) }? as usize)
    }

    /// `y = A x`.
    pub fn multiply(&self, x: &Vector, y: &mut Vector) -> Result<()> {
        // SAFETY: live objects; x and y are distinct because y is borrowed mutably.
        check(unsafe { ffi::MatMult(self.raw, x.raw(), y.raw()) })
    }

    /// `|b - A x|`, computed afresh.
    pub fn residual_norm(&self, x: &Vector, b: &Vector) -> Result<f64> {
        let mut r = Vector::zeros(&self.session, b.local_size())?;
        self.multiply(x, &mut r)?;
        r.scale_and_add(-1.0, b)?;
        r.norm()
    }

    /// The transposed matrix.
    pub fn transpose(&self) -> Result<Self> {
        let mut transpose = Self { raw: ptr::null_mut(), session: Rc::clone(&self.session) };
        // SAFETY: `raw` is a live matrix; a new one is written to `transpose`.
        check(unsafe { ffi::MatTranspose(self.raw, ffi::MAT_INITIAL_MATRIX, &raw mut transpose.raw) })?;
        Ok(transpose)
    }

    /// Frobenius norm.
    pub fn norm(&self) -> Result<f64> {
        let mut norm = 0.0;
        // SAFETY: `raw` is a live matrix.
        check(unsafe { ffi::MatNorm(self.raw, ffi::NORM_FROBENIUS, &raw mut norm) })?;
        Ok(norm)
    }

    /// Whether no entry differs from its mirror entry by more than `tolerance`.
    pub fn is_symmetric(&self, tolerance: f64) -> Result<bool> {
        let mut answer = ffi::PETSC_FALSE;
        // SAFETY: `raw` is a live matrix.
        check(unsafe { ffi::MatIsSymmetric(self.raw, tolerance, &raw mut answer) })?;
        Ok(answer != ffi::PETSC_FALSE)
    }

    /// Tells solvers the vectors that this matrix maps to zero.
    pub fn set_null_space(&mut self, space: &NullSpace) -> Result<()> {
        // SAFETY: live objects; the matrix takes its own reference.
        check(unsafe { ffi::MatSetNullSpace(self.raw, space.raw) })
    }

    /// Tells solvers the vectors that the transposed matrix maps to zero; a solvable right-hand side
    /// is orthogonal to them.
    pub fn set_transpose_null_space(&mut self, space: &NullSpace) -> Result<()> {
        // SAFETY: live objects; the matrix takes its own reference.
        check(unsafe { ffi::MatSetTransposeNullSpace(self.raw, space.raw) })
    }

    pub(super) fn raw(&self) -> ffi::Mat {
        self.raw
    }
}

impl Drop for Matrix {
    fn drop(&mut self) {
        // SAFETY: this handle's reference, released once; null is allowed.
        unsafe { ffi::MatDestroy(&raw mut self.raw) };
    }
}

/// Rows cut into the columns of this rank, numbered from its first one, and those of others: starts, columns, values.
struct Split {
    own: (Vec<Index>, Vec<Index>, Vec<f64>),
    others: (Vec<Index>, Vec<Index>, Vec<f64>),
}

impl Split {
    fn new(mine: Range<Index>, start: &[Index], column: &[Index], value: &[f64]) -> Self {
        let room = column.len();
        let mut own = (vec![0], Vec::with_capacity(room), Vec::with_capacity(room));
        let mut others = (vec![0], vec![], vec![]);
        for row in start.windows(2) {
            let row = row[0] as usize..row[1] as usize;
            let (column, value) = (&column[row.clone()], &value[row]);
            // Ascending: those of other ranks lie before and behind.
            let [from, to] = [mine.start, mine.end].map(|end| column.partition_point(|c| *c < end));
            own.1.extend(column[from..to].iter().map(|c| c - mine.start));
            own.2.extend_from_slice(&value[from..to]);
            for side in [0..from, to..column.len()] {
                others.1.extend_from_slice(&column[side.clone()]);
                others.2.extend_from_slice(&value[side]);
            }
            own.0.push(own.1.len() as Index);
            others.0.push(others.1.len() as Index);
        }
        Self { own, others }
    }
}

/// Stored entries of a matrix or of factors, over all ranks.
///
/// # Safety
/// `matrix` is a live matrix.
pub(super) unsafe fn stored(matrix: ffi::Mat) -> Result<f64> {
    let mut info = MaybeUninit::<ffi::MatInfo>::zeroed();
    // SAFETY: the caller vouches for the matrix; PETSc fills the plain numbers of `info`.
    let info = unsafe {
        check(ffi::MatGetInfo(matrix, ffi::MAT_GLOBAL_SUM, info.as_mut_ptr()))?;
        info.assume_init()
    };
    Ok(info.nz_used)
}

/// Everything PETSc would trust blindly.
fn check_rows(start: &[Index], column: &[Index], value: &[f64], global: Index) -> Result<()> {
    let entries = Index::try_from(column.len()).unwrap_or(-1);
    let is_sound = |row: &[Index]| {
        let row = &column[row[0] as usize..row[1] as usize];
        row.is_sorted() && row.first().is_none_or(|c| *c >= 0) && row.last().is_none_or(|c| *c < global)
    };
    let sound = start.first() == Some(&0)
        && start.last() == Some(&entries)
        && start.is_sorted()
        && value.len() == column.len()
        && start.windows(2).all(is_sound);
    sound.then_some(()).ok_or_else(|| {
        Error::Run(format!(
            "matrix rows are not sound: {} row starts, {} columns, {} values",
            start.len(),
            column.len(),
            value.len()
        ))
    })
}

/// An orthonormal set of vectors that a matrix (or its transpose) maps to zero.
pub struct NullSpace {
    raw: ffi::MatNullSpace,
    _session: Rc<Session>,
}

impl NullSpace {
    /// From vectors that are orthonormal already.
    pub fn new(session: &Rc<Session>, basis: &[Vector]) -> Result<Self> {
        let mut space = Self { raw: ptr::null_mut(), _session: Rc::clone(session) };
        let raw: Vec<ffi::Vec> = basis.iter().map(Vector::raw).collect();
        let count = raw.len() as ffi::PetscInt;
        // SAFETY: `raw` lists `count` live vectors, of which PETSc takes its own references.
        check(unsafe {
            ffi::MatNullSpaceCreate(session.comm(), ffi::PETSC_FALSE, count, raw.as_ptr(), &raw mut space.raw)
        })?;
        Ok(space)
    }

    /// Removes from `vector` its part in this space.
    pub fn remove(&self, vector: &mut Vector) -> Result<()> {
        // SAFETY: live objects.
        check(unsafe { ffi::MatNullSpaceRemove(self.raw, vector.raw()) })
    }
}

impl Drop for NullSpace {
    fn drop(&mut self) {
        // SAFETY: this handle's reference, released once; null is allowed.
        unsafe { ffi::MatNullSpaceDestroy(&raw mut self.raw) };
    }
}
