//! What can be wrong with a file.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::mask::GridError;

/// Why a file cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be opened or read.
    #[error("{}: cannot be read: {}; {}", path.display(), reason(source), reading(source))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written: {}; {}", path.display(), reason(source), writing(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file that a header names for its voxels cannot be read.
    #[error("{}: the file with its voxels, {}, cannot be read: {}; put it where the header names it, or correct the header", path.display(), data.display(), reason(source))]
    DataFile {
        /// The header.
        path: PathBuf,
        /// The file that it names.
        data: PathBuf,
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

/// What the system says, without its number.
pub(crate) fn reason(e: &std::io::Error) -> String {
    let text = e.to_string();
    text.split(" (os error").next().unwrap_or_default().to_lowercase()
}

fn reading(e: &std::io::Error) -> &'static str {
    match e.kind() {
        ErrorKind::NotFound => "check the path (relative paths in a case file start at its folder)",
        ErrorKind::PermissionDenied => "allow yourself to read it",
        _ => "check the disk or network that holds it, or copy the file",
    }
}

/// What to do about a file that cannot be written.
pub(crate) fn writing(e: &std::io::Error) -> &'static str {
    match e.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space or choose another folder with -o; earlier results are as they were",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "choose a folder that you may write to with -o",
        _ => "choose another folder with -o",
    }
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
