//! What can be wrong with a file.

use std::path::{Path, PathBuf};

use crate::mask::GridError;

/// Why a file cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The name says nothing about the format.
    #[error("{}: the file's name does not tell its format; known are {known}: rename or convert the file", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// The endings that are read here.
        known: &'static str,
    },
    /// The content breaks the format's rules.
    #[error("{}: {what}; {remedy}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// The content is sound, and more than is read here.
    #[error("{}: {what} is not supported; {remedy}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not read.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// The header's numbers make no grid.
    #[error("{}: {source}", path.display())]
    Grid {
        /// The file.
        path: PathBuf,
        /// What is wrong with the numbers.
        source: GridError,
    },
}

impl Error {
    /// A file that breaks its format's rules.
    pub(crate) fn malformed(path: &Path, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Malformed { path: path.into(), what: what.into(), remedy: remedy.into() }
    }

    /// A file with something that is not read here.
    pub(crate) fn unsupported(path: &Path, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Unsupported { path: path.into(), what: what.into(), remedy: remedy.into() }
    }

    /// A failure of the system while reading.
    pub(crate) fn read(path: &Path, source: std::io::Error) -> Error {
        Error::Read { path: path.into(), source }
    }

    /// A failure of the system while writing.
    pub(crate) fn write(path: &Path, source: std::io::Error) -> Error {
        Error::Write { path: path.into(), source }
    }
}
