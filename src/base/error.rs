//! The one error type of the library.

use std::fmt;
use std::path::{Path, PathBuf};

/// Result with the library's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Any failure of the library. Each variant names the place, what was found and what to do about it.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// An unusable file or folder of the user.
    Input {
        /// The offending file or folder.
        path: PathBuf,
        /// Finding, and expectation.
        what: String,
        /// Remedy for the user.
        fix: String,
    },
    /// An option or configuration value outside of its domain.
    Config {
        /// Name of the option, as typed.
        option: String,
        /// Finding, and expectation.
        what: String,
    },
    /// The operating system refused a file operation.
    Io {
        /// The file or folder in question.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A missing OpenCL device, or one that lacks a capability.
    Device {
        /// The stage or call that failed.
        stage: String,
        /// The driver's message, or the limit that was met.
        what: String,
        /// Remedy: something to install, select or lower.
        fix: String,
    },
    /// Numbers that are no longer usable (all parameters non-finite, say).
    Numerics {
        /// The stage or file in which it was noticed.
        stage: String,
        /// Finding.
        what: String,
    },
    /// The user asked to stop (Ctrl-C); the state was saved.
    Interrupted,
}

impl Error {
    /// An [`Error::Input`] about `path`.
    pub fn input(path: impl AsRef<Path>, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self::Input {
            path: path.as_ref().to_path_buf(),
            what: what.into(),
            fix: fix.into(),
        }
    }

    /// An [`Error::Config`] about `option`.
    pub fn config(option: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Config {
            option: option.into(),
            what: what.into(),
        }
    }

    /// An [`Error::Config`] about `option` unless `good`.
    ///
    /// # Errors
    /// That one.
    pub fn unless(good: bool, option: &str, what: &str) -> Result<()> {
        match good {
            true => Ok(()),
            false => Err(Self::config(option, what)),
        }
    }

    /// An [`Error::Io`] about `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io {
            path: path.as_ref().to_path_buf(),
            source,
        }
    }

    /// An [`Error::Numerics`] noticed in `stage`.
    pub fn numerics(stage: impl Into<String>, what: impl fmt::Display) -> Self {
        Self::Numerics {
            stage: stage.into(),
            what: what.to_string(),
        }
    }

    /// An [`Error::Device`] raised in `stage`.
    pub fn device(
        stage: impl Into<String>,
        what: impl Into<String>,
        fix: impl Into<String>,
    ) -> Self {
        Self::Device {
            stage: stage.into(),
            what: what.into(),
            fix: fix.into(),
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input { path, what, fix } => write!(f, "{}: {what}; {fix}", path.display()),
            Self::Config { option, what } => write!(f, "{option}: {what}"),
            Self::Io { path, source } => write!(
                f,
                "{}: {source}; check that the path is right, may be used, and has room",
                path.display()
            ),
            Self::Device { stage, what, fix } => write!(f, "{stage}: {what}; {fix}"),
            Self::Numerics { stage, what } => write!(f, "{stage}: {what}"),
            Self::Interrupted => write!(f, "interrupted; the state was saved"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { source, .. } => Some(source),
            _ => None,
        }
    }
}
