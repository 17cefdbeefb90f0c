//! PETSc's options database: our defaults, the user's choices, and what nothing used.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{c_char, c_int};
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::ptr;

use super::error::{c_string, check, text};
use super::ffi;
use crate::{Error, Result};

/// Options that PETSc reads while it starts, when it ends, or wherever it likes: never reported as unused.
const READ_ELSEWHERE: &[&str] = &[
    "citations",
    "checkfunctionlist",
    "checkstack",
    "debug",
    "debugger",
    "display",
    "error_output",
    "fp_trap",
    "get_total_flops",
    "h",
    "help",
    "history",
    "info",
    "log",
    "malloc",
    "memory",
    "mpi",
    "no_signal_handler",
    "not_shared_tmp",
    "nox",
    "objects",
    "on_error",
    "options",
    "petsc",
    "python",
    "saws",
    "shared_tmp",
    "skip_petscrc",
    "start_in_debugger",
    "stop_for_debugger",
    "tmp",
    "use_gpu_aware_mpi",
    "version",
    "viewfromoptions",
];

/// The process-wide options database, as the fence lets the crate use it.
pub struct Options {
    /// What the user gave: names in lower case without the dash, with their values.
    given: RefCell<BTreeMap<String, String>>,
}

impl Options {
    /// Reads what the command line, `PETSC_OPTIONS`, `-options_file` and `.petscrc` brought.
    /// What PETSc itself used while it started is no longer of interest.
    pub(super) fn snapshot() -> Result<Self> {
        let (mut count, mut names, mut values) = (0, ptr::null_mut(), ptr::null_mut());
        let mut given = BTreeMap::new();
        // SAFETY: PETSc runs; it lends `count` names and values (a value may be null) until the restore.
        unsafe {
            check(ffi::PetscOptionsLeftGet(
                ptr::null_mut(),
                &raw mut count,
                &raw mut names,
                &raw mut values,
            ))?;
            for k in 0..count as usize {
                given.insert(text(*names.add(k)).to_lowercase(), text(*values.add(k)));
            }
            check(ffi::PetscOptionsLeftRestore(
                ptr::null_mut(),
                &raw mut count,
                &raw mut names,
                &raw mut values,
            ))?;
        }
        Ok(Self { given: RefCell::new(given) })
    }

    /// The value the user gave to an option (without its dash); empty for a mere flag.
    pub fn given(&self, name: &str) -> Option<String> {
        self.given.borrow().get(name).cloned()
    }

    /// Every option the user gave, with its value.
    pub fn all_given(&self) -> Vec<(String, String)> {
        self.given.borrow().iter().map(|(name, value)| (name.clone(), value.clone())).collect()
    }

    /// Sets an option unless the user gave it.
    pub fn set_default(&self, name: &str, value: &str) -> Result<()> {
        if self.given.borrow().contains_key(&name.to_lowercase()) { Ok(()) } else { self.set(name, value) }
    }

    /// Gives the user's option another name, for a solver with another prefix.
    pub fn rename(&self, from: &str, to: &str) -> Result<()> {
        let Some(value) = self.given.borrow_mut().remove(from) else { return Ok(()) };
        self.clear(from)?;
        self.set(to, &value)?;
        self.given.borrow_mut().insert(to.into(), value);
        Ok(())
    }

    /// A yes/no option, marked as used.
    pub fn bool(&self, name: &str) -> Result<Option<bool>> {
        let dashed = c_string(&format!("-{name}"))?;
        let (mut value, mut found) = (ffi::PETSC_FALSE, ffi::PETSC_FALSE);
        // SAFETY: null means the global database without prefix; the name is a C string.
        check(unsafe {
            ffi::PetscOptionsGetBool(
                ptr::null_mut(),
                ptr::null(),
                dashed.as_ptr(),
                &raw mut value,
                &raw mut found,
            )
        })
        .map_err(as_input)?;
        Ok((found != ffi::PETSC_FALSE).then_some(value != ffi::PETSC_FALSE))
    }

    /// A number, marked as used.
    pub fn real(&self, name: &str) -> Result<Option<f64>> {
        let dashed = c_string(&format!("-{name}"))?;
        let (mut value, mut found) = (0.0, ffi::PETSC_FALSE);
        // SAFETY: null means the global database without prefix; the name is a C string.
        check(unsafe {
            ffi::PetscOptionsGetReal(
                ptr::null_mut(),
                ptr::null(),
                dashed.as_ptr(),
                &raw mut value,
                &raw mut found,
            )
        })
        .map_err(as_input)?;
        Ok((found != ffi::PETSC_FALSE).then_some(value))
    }

    /// The user's options that nothing has read so far and that nothing will read later.
    pub fn unused(&self) -> Result<Vec<String>> {
        let given = self.given.borrow();
        let mut unused = Vec::new();
        for name in given.keys().filter(|name| !read_elsewhere(name)) {
            // The one call of PETSc's that takes an option without its dash.
            let bare = c_string(name)?;
            let mut used = ffi::PETSC_FALSE;
            // SAFETY: null means the global database; the name is a C string.
            check(unsafe { ffi::PetscOptionsUsed(ptr::null_mut(), bare.as_ptr(), &raw mut used) })?;
            if used == ffi::PETSC_FALSE {
                unused.push(name.clone());
            }
        }
        Ok(unused)
    }

    /// Rejects Krylov methods and preconditioners that this PETSc does not have, whatever their prefix.
    /// PETSc itself would print an error and go on with its default.
    pub fn check_types(&self) -> Result<()> {
        let (krylov, preconditioners) = (Self::krylov_types()?, Self::preconditioner_types()?);
        for (name, value) in self.given.borrow().iter() {
            let (kind, valid) = match name {
                n if n.ends_with("ksp_type") => ("Krylov method", &krylov),
                n if n.ends_with("pc_type") => ("preconditioner", &preconditioners),
                _ => continue,
            };
            if !valid.contains(value) {
                let hint = nearest(value, valid.iter().map(String::as_str))
                    .map_or(String::new(), |near| format!(" (did you mean {near}?)"));
                return Err(Error::Input(format!(
                    "-{name}: this PETSc has no {kind} '{value}'{hint}; valid are {}",
                    valid.join(", ")
                )));
            }
        }
        Ok(())
    }

    /// The Krylov methods of this PETSc, sorted.
    pub fn krylov_types() -> Result<Vec<String>> {
        // SAFETY: a live list, filled when the session started.
        unsafe { registered(ffi::KSPList) }
    }

    /// The preconditioners of this PETSc, sorted.
    pub fn preconditioner_types() -> Result<Vec<String>> {
        // SAFETY: a live list, filled when the session started.
        unsafe { registered(ffi::PCList) }
    }

    /// The names of all options that PETSc offers while `work` sets solvers up: what `-help` would
    /// list, caught before it is printed. `work` gets a prefix that is new to PETSc (which lists the
    /// options of a prefix once) and finds the user's choices of types under it.
    /// Names come without prefix and dash. Only rank 0 hears PETSc's help.
    pub fn offered(&self, work: impl FnOnce(&str) -> Result<()>) -> Result<BTreeSet<String>> {
        const PREFIX: &str = "probe_";
        let types: Vec<_> =
            self.all_given().into_iter().filter(|(name, _)| name.ends_with("_type")).collect();
        for (name, value) in &types {
            self.set(&format!("{PREFIX}{name}"), value)?;
        }
        let mut wants_help = ffi::PETSC_FALSE;
        // SAFETY: null means the global database.
        check(unsafe { ffi::PetscOptionsHasHelp(ptr::null_mut(), &raw mut wants_help) })?;
        self.set("help", "")?;
        let listing = captured(|| work(PREFIX));
        if wants_help == ffi::PETSC_FALSE {
            self.clear("help")?;
        }
        for (name, _) in &types {
            self.clear(&format!("{PREFIX}{name}"))?;
        }
        Ok(option_names(&listing?, PREFIX))
    }

    /// Takes back what [`set_default`](Self::set_default) set; the user's own stays.
    pub fn unset_default(&self, name: &str) -> Result<()> {
        if self.given.borrow().contains_key(&name.to_lowercase()) { Ok(()) } else { self.clear(name) }
    }

    fn set(&self, name: &str, value: &str) -> Result<()> {
        let (name, value) = (c_string(&format!("-{name}"))?, c_string(value)?);
        // SAFETY: null means the global database; PETSc copies the C strings.
        check(unsafe { ffi::PetscOptionsSetValue(ptr::null_mut(), name.as_ptr(), value.as_ptr()) })
    }

    fn clear(&self, name: &str) -> Result<()> {
        let name = c_string(&format!("-{name}"))?;
        // SAFETY: null means the global database; the name is a C string.
        check(unsafe { ffi::PetscOptionsClearValue(ptr::null_mut(), name.as_ptr()) })
    }
}

/// The candidate most like `name`, if any is like it at all.
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::normalized_damerau_levenshtein(name, candidate), candidate))
        .filter(|(likeness, _)| *likeness >= 0.5)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// What PETSc rejects in an option is the user's to mend.
fn as_input(error: Error) -> Error {
    match error {
        Error::Petsc(said) => Error::Input(format!("a PETSc option is wrong: {said}")),
        other => other,
    }
}

fn read_elsewhere(name: &str) -> bool {
    READ_ELSEWHERE
        .iter()
        .any(|known| name.strip_prefix(known).is_some_and(|rest| rest.is_empty() || rest.starts_with('_')))
}

/// The names in one of PETSc's lists of implementations.
///
/// # Safety
/// `list` is a live list of PETSc.
unsafe fn registered(list: ffi::PetscFunctionList) -> Result<Vec<String>> {
    let (mut names, mut count) = (ptr::null_mut::<*const c_char>(), 0);
    // SAFETY: PETSc writes an array of `count` names that it owns; the array is ours to free, as PetscFree does.
    let mut found: Vec<String> = unsafe {
        check(ffi::PetscFunctionListGet(list, &raw mut names, &raw mut count))?;
        let found =
            (0..count as usize).map(|k| text(*names.add(k))).filter(|name| !name.is_empty()).collect();
        if let Some(free) = ffi::PetscTrFree {
            check(free(names.cast(), 0, c"registered".as_ptr(), c"options.rs".as_ptr()))?;
        }
        found
    };
    found.sort();
    Ok(found)
}

/// What reaches standard output during `work`, and that on no screen. PETSc writes help partly to `PETSC_STDOUT`, partly to
/// C's `stdout`, so the file descriptor itself is turned aside for the while.
pub fn captured(work: impl FnOnce() -> Result<()>) -> Result<String> {
    const STDOUT: c_int = 1;
    let lost = |e: io::Error| Error::io("temporary file", e);
    io::stdout().flush().map_err(lost)?;
    // SAFETY: C library calls on descriptors that are checked for failure and each closed once: `saved`
    // by its owner, the stream by the C library, `file` (a duplicate) by its owner.
    let (outcome, mut file) = unsafe {
        ffi::fflush(ptr::null_mut());
        let stream = ffi::tmpfile();
        if stream.is_null() {
            return Err(lost(io::Error::last_os_error()));
        }
        let file = owned(ffi::dup(ffi::fileno(stream))).map(File::from).map_err(lost)?;
        let saved = owned(ffi::dup(STDOUT)).map_err(lost)?;
        ffi::dup2(file.as_raw_fd(), STDOUT);
        let outcome = work();
        ffi::fflush(ptr::null_mut());
        ffi::dup2(saved.as_raw_fd(), STDOUT);
        ffi::fclose(stream);
        (outcome, file)
    };
    let mut listing = String::new();
    file.rewind().and_then(|()| file.read_to_string(&mut listing)).map_err(lost)?;
    outcome.map(|()| listing)
}

/// # Safety
/// `descriptor` is -1 or open and owned by nobody else.
unsafe fn owned(descriptor: c_int) -> io::Result<OwnedFd> {
    if descriptor < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: open, and the caller vouches for the rest.
    Ok(unsafe { OwnedFd::from_raw_fd(descriptor) })
}

/// Option names in a listing of `-help`, one a line: `  -probe_ksp_rtol <now 1e-05 ...>: ...`.
fn option_names(listing: &str, prefix: &str) -> BTreeSet<String> {
    listing
        .lines()
        .filter_map(|line| line.trim_start().strip_prefix('-'))
        .map(|line| line.split([' ', ':', '<', ',']).next().unwrap_or_default())
        .filter(|name| name.starts_with(|c: char| c.is_ascii_alphabetic()))
        .map(|name| name.strip_prefix(prefix).unwrap_or(name).to_lowercase())
        .flat_map(|name| [without_level(&name), name])
        .collect()
}

/// `mg_levels_2_ksp_type` as it applies to all levels: `mg_levels_ksp_type`.
fn without_level(name: &str) -> String {
    let is_level = |part: &&str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    name.split('_').filter(|part| !is_level(part)).collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use super::{nearest, option_names, read_elsewhere};

    #[test]
    fn names_are_read_from_petscs_help() {
        let listing = "----------\nKrylov Method (KSP) options:\n  -probe_ksp_rtol <now 1e-05 : formerly 1e-05>: Relative (KSPSetTolerances)\n  -probe_mg_levels_2_pc_type <sor>: Type\n";
        let names = option_names(listing, "probe_");
        assert_eq!(
            names.into_iter().collect::<Vec<_>>(),
            ["ksp_rtol", "mg_levels_2_pc_type", "mg_levels_pc_type"]
        );
    }

    #[test]
    fn families_read_elsewhere_are_known() {
        assert!(read_elsewhere("log_view") && read_elsewhere("help") && read_elsewhere("options_left"));
        assert!(!read_elsewhere("ksp_rtoll") && !read_elsewhere("helper"));
    }

    #[test]
    fn the_nearest_name_is_near() {
        assert_eq!(nearest("ksp_rtoll", ["ksp_atol", "ksp_rtol", "pc_type"]), Some("ksp_rtol"));
        assert_eq!(nearest("xyzzy", ["ksp_rtol"]), None);
    }
}
