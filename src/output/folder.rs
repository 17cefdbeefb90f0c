//! The folder of one run, and the way files get into it.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Everything a run writes at the top of its folder; `--force` deletes these and nothing else.
const CONTENTS: &[&str] = &[
    "run.toml",
    "summary.json",
    "report.html",
    "particles.pvd",
    "particles",
    "bodies.pvd",
    "bodies",
    "history.csv",
    "exact.csv",
    "profiles.csv",
    "probes.csv",
    "forces.csv",
    "bodies.csv",
    "solver.csv",
    "comparison.csv",
    "pictures",
    "checkpoint",
    "systems",
];

/// An existing, writable folder that belongs to one run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Creates `parent/name`, or the first free one of `name-2`, `name-3`, ...
    ///
    /// Creating is the test for being free: of two runs that start together, each gets its own.
    pub fn create_numbered(parent: &Path, name: &str) -> Result<Self> {
        fs::create_dir_all(parent).map_err(|error| cannot_create(parent, &error))?;
        let mut path = parent.join(name);
        let mut number = 1;
        loop {
            match fs::create_dir(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                    number += 1;
                    path = parent.join(format!("{name}-{number}"));
                }
                Err(error) => return Err(cannot_create(&path, &error)),
            }
        }
    }

    /// Takes exactly `path`, which must be absent or empty; `force` empties an earlier run's folder first.
    ///
    /// A folder that holds anything a run does not write is never emptied.
    pub fn create_at(path: &Path, force: bool) -> Result<Self> {
        fs::create_dir_all(path).map_err(|error| cannot_create(path, &error))?;
        let entries = list(path).map_err(|error| cannot_create(path, &error))?;
        if !entries.is_empty() {
            if !force {
                return Err(Error::Input(format!(
                    "{} is not empty: add --force to replace the run in it, or choose another --out",
                    path.display()
                )));
            }
            empty(path, &entries)?;
        }
        Self::open(path)
    }

    /// Takes an existing folder, to resume the run in it: but for files that a killed run did not finish, as it is.
    pub fn resume(path: &Path) -> Result<Self> {
        let folder = Self::open(path)?;
        let below = |path: &Path| list(path).unwrap_or_default();
        let of_subfolders = below(path).into_iter().filter(|entry| is_ours(entry) && entry.is_dir());
        let inside: Vec<_> = of_subfolders.flat_map(|entry| below(&entry)).chain(below(path)).collect();
        for unfinished in inside.iter().filter(|entry| is_temporary(entry)) {
            fs::remove_file(unfinished).map_err(|error| Error::io(unfinished, error))?;
        }
        Ok(folder)
    }

    /// Takes an existing folder as it is.
    fn open(path: &Path) -> Result<Self> {
        // Permission bits do not tell (read-only mounts, full quotas): try.
        let probe = path.join(temporary_name("write-test"));
        File::create(&probe).and_then(|_| fs::remove_file(&probe)).map_err(|error| {
            Error::Input(format!("cannot write to {}: {error}; choose another --out", path.display()))
        })?;
        Ok(Self { path: path.to_owned() })
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file or subfolder in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }
}

/// Makes a subfolder of a run's folder, which must be there: one that vanished is not to be replaced unnoticed.
pub fn make_subfolder(path: &Path) -> Result<()> {
    match fs::create_dir(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(Error::io(path, error)),
        _ => Ok(()),
    }
}

/// Writes a file under a temporary name beside it and renames it when it is complete and on disk.
pub fn write_atomic(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = path.with_file_name(temporary_name(&name));
    let complete = || {
        let mut writer = BufWriter::new(File::create(&temporary)?);
        write(&mut writer)?;
        writer.flush()?;
        writer.get_ref().sync_all()?;
        fs::rename(&temporary, path)
    };
    complete().map_err(|error| {
        // The first error is the one to report.
        let _ = fs::remove_file(&temporary);
        Error::io(path, error)
    })
}

/// Hidden from listings and globs, and different for each process.
fn temporary_name(name: &str) -> String {
    format!(".{name}.{}.tmp", std::process::id())
}

fn list(path: &Path) -> io::Result<Vec<PathBuf>> {
    fs::read_dir(path)?.map(|entry| Ok(entry?.path())).collect()
}

fn empty(path: &Path, entries: &[PathBuf]) -> Result<()> {
    let refused = |why: String| {
        Error::Input(format!("--force does not empty {}: {why}; choose another --out", path.display()))
    };
    if !path.join("run.toml").is_file() {
        return Err(refused("it has no run.toml, so no run wrote it".into()));
    }
    if let Some(foreign) = entries.iter().find(|entry| !is_ours(entry)) {
        return Err(refused(format!("{} is not from a run", foreign.display())));
    }
    // run.toml goes last: interrupted here, the rest still counts as a run's folder.
    let (marker, others): (Vec<_>, Vec<_>) = entries.iter().partition(|entry| entry.ends_with("run.toml"));
    for entry in others.into_iter().chain(marker) {
        let is_folder = fs::symlink_metadata(entry).is_ok_and(|metadata| metadata.is_dir());
        let removed = if is_folder { fs::remove_dir_all(entry) } else { fs::remove_file(entry) };
        removed.map_err(|error| refused(format!("{}: {error}", entry.display())))?;
    }
    Ok(())
}

fn is_ours(entry: &Path) -> bool {
    let name = entry.file_name().unwrap_or_default().to_string_lossy();
    CONTENTS.contains(&&*name) || is_temporary(entry)
}

/// Whether it has a [`temporary_name`].
fn is_temporary(entry: &Path) -> bool {
    let name = entry.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with('.') && name.ends_with(".tmp")
}

fn cannot_create(path: &Path, error: &io::Error) -> Error {
    Error::Input(format!("cannot create the folder {}: {error}; choose another --out", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input_error(result: Result<RunFolder>) -> String {
        match result {
            Err(Error::Input(message)) => message,
            other => panic!("expected an input error, got {other:?}"),
        }
    }

    #[test]
    fn numbers_follow_each_other() {
        let root = tempfile::tempdir().unwrap();
        let out = root.path().join("out");
        for expected in ["case", "case-2", "case-3"] {
            let folder = RunFolder::create_numbered(&out, "case").unwrap();
            assert_eq!(folder.path(), out.join(expected));
        }
    }

    #[test]
    fn runs_that_start_together_do_not_share() {
        let root = tempfile::tempdir().unwrap();
        let mut paths: Vec<_> = std::thread::scope(|scope| {
            let create = || RunFolder::create_numbered(root.path(), "case").unwrap().path;
            let threads: Vec<_> = (0..16).map(|_| scope.spawn(create)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        paths.sort();
        paths.dedup();
        assert_eq!(paths.len(), 16);
    }

    #[test]
    fn force_replaces_a_run_and_only_a_run() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("a/b");
        RunFolder::create_at(&path, false).unwrap();
        RunFolder::create_at(&path, false).unwrap();

        fs::create_dir(path.join("particles")).unwrap();
        fs::write(path.join("particles/0.vtp"), "x").unwrap();
        assert!(input_error(RunFolder::create_at(&path, false)).contains("--force"));
        assert!(input_error(RunFolder::create_at(&path, true)).contains("no run.toml"));

        fs::write(path.join("run.toml"), "").unwrap();
        fs::write(path.join("thesis.tex"), "").unwrap();
        assert!(input_error(RunFolder::create_at(&path, true)).contains("thesis.tex"));
        assert!(path.join("particles/0.vtp").exists());

        fs::remove_file(path.join("thesis.tex")).unwrap();
        RunFolder::create_at(&path, true).unwrap();
        assert!(list(&path).unwrap().is_empty());
    }

    #[test]
    fn an_impossible_place_is_an_input_error() {
        let root = tempfile::tempdir().unwrap();
        let file = root.path().join("file");
        fs::write(&file, "").unwrap();
        assert!(input_error(RunFolder::create_at(&file.join("run"), false)).contains("cannot create"));
        assert!(input_error(RunFolder::create_numbered(&file, "case")).contains("cannot create"));
        assert!(input_error(RunFolder::create_at(&file, true)).contains("cannot create"));
        assert!(input_error(RunFolder::open(&root.path().join("absent"))).contains("cannot write"));
    }

    #[test]
    fn a_failed_write_leaves_the_old_file() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("summary.json");
        write_atomic(&path, |file| file.write_all(b"old")).unwrap();
        let failed = write_atomic(&path, |file| {
            file.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(list(root.path()).unwrap().len(), 1);
    }
}
