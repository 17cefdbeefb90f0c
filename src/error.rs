//! The one public error type: what went wrong, where, and what to do, in one sentence each.

use std::process::ExitCode;

/// Everything that ends a run early, grouped by what the caller should do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The user's input is wrong: nothing was computed and nothing written (exit code 2).
    #[error("{0}")]
    Input(String),
    /// The run itself failed; its state was saved where that was possible (exit code 1).
    #[error("{0}")]
    Run(String),
    /// A file or folder could not be read or written during a run (exit code 1).
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: String,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// PETSc or hypre returned an error code (exit code 1).
    #[error("PETSc: {0}")]
    Petsc(String),
    /// Ctrl-C or a termination signal; the state was saved (exit code 130).
    #[error("{0}")]
    Interrupted(String),
}

/// Result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Wraps an operating-system error with the path it concerns.
    pub fn io(path: impl AsRef<std::path::Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().display().to_string(), source }
    }

    /// A file of a case or a run that is damaged or cannot be read.
    pub fn unreadable(path: impl AsRef<std::path::Path>, why: &dyn std::fmt::Display) -> Self {
        let why = why.to_string().replace('\n', " ");
        Self::Input(format!(
            "{}: cannot be read ({why}): restore the file or run the case again",
            path.as_ref().display()
        ))
    }

    /// The program's exit code for this error.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(match self {
            Self::Input(_) => 2,
            Self::Run(_) | Self::Io { .. } | Self::Petsc(_) => 1,
            Self::Interrupted(_) => 130,
        })
    }
}
