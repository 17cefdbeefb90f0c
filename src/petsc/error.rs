//! PETSc's return codes as [`Result`], with PETSc's own first message and nothing printed.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr;

use mpi::ffi::MPI_Comm;

use super::ffi;
use crate::{Error, Result};

thread_local! {
    /// What PETSc said where the newest error began; PETSc runs on one thread only.
    static FIRST_MESSAGE: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Turns a PETSc return code into a `Result`.
pub(super) fn check(code: ffi::PetscErrorCode) -> Result<()> {
    if code == 0 {
        return Ok(());
    }
    let said = FIRST_MESSAGE.take().unwrap_or_else(|| generic_message(code));
    Err(Error::Petsc(format!("{said} (code {code})")))
}

/// Replaces PETSc's printing error handler by one that records.
pub(super) fn install_handler() -> Result<()> {
    // SAFETY: `record` has the signature PETSc asks for, never unwinds, and uses no context.
    check(unsafe { ffi::PetscPushErrorHandler(Some(record), ptr::null_mut()) })
}

/// Called by PETSc once per stack level of an error; the first level knows what happened.
unsafe extern "C" fn record(
    _comm: MPI_Comm,
    _line: c_int,
    function: *const c_char,
    _file: *const c_char,
    code: ffi::PetscErrorCode,
    kind: ffi::PetscErrorType,
    message: *const c_char,
    _context: *mut c_void,
) -> ffi::PetscErrorCode {
    if kind == ffi::PETSC_ERROR_INITIAL {
        // SAFETY: PETSc passes null or C strings that live through this call.
        let (message, function) = unsafe { (text(message), text(function)) };
        let message = one_line(&message);
        let message = if message.is_empty() { generic_message(code) } else { message };
        // An error during thread teardown has nobody to tell.
        let _ = FIRST_MESSAGE.try_with(|first| first.replace(Some(format!("{message} [{function}]"))));
    }
    code
}

/// PETSc's standing text for a code.
fn generic_message(code: ffi::PetscErrorCode) -> String {
    let mut said = ptr::null();
    // SAFETY: the first pointer is a valid place for the answer, the second may be null.
    unsafe { ffi::PetscErrorMessage(code, &raw mut said, ptr::null_mut()) };
    // SAFETY: the answer is null or a static string of PETSc.
    let said = unsafe { text(said) };
    if said.is_empty() { "unknown error".into() } else { said }
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Owned text of a C string; empty for null.
///
/// # Safety
/// `string` is null or points to a C string that lives through the call.
pub(super) unsafe fn text(string: *const c_char) -> String {
    if string.is_null() {
        return String::new();
    }
    // SAFETY: not null, and the caller vouches for the rest.
    unsafe { CStr::from_ptr(string) }.to_string_lossy().into_owned()
}

/// A C string for PETSc; a zero byte inside is the user's mistake.
pub(super) fn c_string(text: &str) -> Result<CString> {
    CString::new(text)
        .map_err(|_| Error::Input(format!("{text:?} holds a zero byte, which PETSc cannot take")))
}
