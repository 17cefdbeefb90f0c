//! Distributed sparse matrices and their null spaces.

use std::ffi::c_void;
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
    /// PETSc's own call for this inserts row by row; here it borrows lists that it frees with the matrix.
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
        let mut matrix = Self { raw: ptr::null_mut(), session: Rc::clone(session) };
        if session.size() == 1 {
            let mut lists = Lists { start: start.to_vec(), column: column.to_vec(), value: value.to_vec() };
            let (start, column, value) = lists.pointers();
            // SAFETY: the lists were checked above and are left to the matrix below; to destroy one reads none of them.
            check(unsafe {
                ffi::MatCreateSeqAIJWithArrays(
                    session.comm(),
                    local,
                    local,
                    start,
                    column,
                    value,
                    &raw mut matrix.raw,
                )
            })?;
            // SAFETY: a live matrix, which borrows them.
            unsafe { leave(lists, matrix.raw) }?;
        } else {
            let first = session.before(local);
            let [mut own_lists, mut others_lists] = split(first..first + local, start, column, value);
            let (own, others) = (own_lists.pointers(), others_lists.pointers());
            // SAFETY: both halves are sound since the lists are, and are left to the matrix below, which renumbers the columns of
            // others in place.
            check(unsafe {
                ffi::MatCreateMPIAIJWithSplitArrays(
                    session.comm(),
                    local,
                    local,
                    global,
                    global,
                    own.0,
                    own.1,
                    own.2,
                    others.0,
                    others.1,
                    others.2,
                    &raw mut matrix.raw,
                )
            })?;
            let (mut block, mut rest) = (ptr::null_mut(), ptr::null_mut());
            // SAFETY: the two blocks of a live matrix, each of which borrows its lists. Other objects, as the solver of a block, may hold
            // a block longer than the matrix.
            unsafe {
                check(ffi::MatMPIAIJGetSeqAIJ(matrix.raw, &raw mut block, &raw mut rest, ptr::null_mut()))?;
                leave(own_lists, block)?;
                leave(others_lists, rest)?;
            }
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

/// Compressed rows as PETSc borrows them.
#[derive(Default)]
struct Lists {
    start: Vec<Index>,
    column: Vec<Index>,
    value: Vec<f64>,
}

impl Lists {
    fn pointers(&mut self) -> (*mut Index, *mut Index, *mut f64) {
        (self.start.as_mut_ptr(), self.column.as_mut_ptr(), self.value.as_mut_ptr())
    }

    fn append(&mut self, column: impl Iterator<Item = Index>, value: &[f64]) {
        self.column.extend(column);
        self.value.extend_from_slice(value);
    }
}

/// Leaves `lists` to PETSc, which frees them when the last of its objects lets go of the `matrix` that borrows them.
///
/// # Safety
/// `matrix` is a live matrix of one rank.
unsafe fn leave(lists: Lists, matrix: ffi::Mat) -> Result<()> {
    let mut container = ptr::null_mut();
    // SAFETY: a new container of this rank alone.
    check(unsafe { ffi::PetscContainerCreate(mpi::ffi::RSMPI_COMM_SELF, &raw mut container) })?;
    // The vectors' contents, which the matrix borrows, stay where they are.
    let lists = Box::into_raw(Box::new(lists));
    // SAFETY: live objects; the container passes `lists` to `free`, once, and the matrix takes its own reference of it.
    unsafe {
        check(ffi::PetscContainerSetPointer(container, lists.cast()))?;
        check(ffi::PetscContainerSetUserDestroy(container, Some(free)))?;
        check(ffi::PetscObjectCompose(matrix.cast(), c"lists".as_ptr(), container.cast()))?;
        check(ffi::PetscContainerDestroy(&raw mut container))
    }
}

/// Frees what [`leave`] left to PETSc.
unsafe extern "C" fn free(lists: *mut c_void) -> ffi::PetscErrorCode {
    // SAFETY: the pointer came from `Box::into_raw` of this type, and PETSc calls this once.
    drop(unsafe { Box::from_raw(lists.cast::<Lists>()) });
    0
}

/// Rows cut into the columns of this rank, numbered from its first one, and those of others.
fn split(mine: Range<Index>, start: &[Index], column: &[Index], value: &[f64]) -> [Lists; 2] {
    let room = column.len();
    let (columns, values) = (Vec::with_capacity(room), Vec::with_capacity(room));
    let mut own = Lists { start: vec![0], column: columns, value: values };
    let mut others = Lists { start: vec![0], ..Lists::default() };
    for row in start.windows(2) {
        let row = row[0] as usize..row[1] as usize;
        let (column, value) = (&column[row.clone()], &value[row]);
        // Ascending: those of other ranks lie before and behind.
        let [from, to] = [mine.start, mine.end].map(|end| column.partition_point(|c| *c < end));
        own.append(column[from..to].iter().map(|c| c - mine.start), &value[from..to]);
        for side in [0..from, to..column.len()] {
            others.append(column[side.clone()].iter().copied(), &value[side]);
        }
        own.start.push(own.column.len() as Index);
        others.start.push(others.column.len() as Index);
    }
    [own, others]
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
