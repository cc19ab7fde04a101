//! Single files that a person named: written aside, then put in their place.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::{disk, failure, next_free};
use crate::cli::exit::Failure;

/// What happens to a file that is there already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    /// It stays, and the new one is refused; the way out is named.
    Refuse(&'static str),
    /// It is moved to the next free of `FILE.1`, `FILE.2`, ….
    Keep,
    /// It is replaced.
    Replace,
}

/// The error of a file that is there already, with the way out.
pub fn exists(file: &Path, way: &str) -> Failure {
    Failure::usage(format!("{}: exists; it is kept: choose another place with -o, or {way}", file.display()))
}

/// Writes a file whole or not at all; gives where an earlier one was kept.
pub fn place(file: &Path, bytes: &[u8], existing: Existing) -> Result<Option<PathBuf>, Failure> {
    let failed = |e| failure(file, "write", &e);
    // A link stays a link.
    let target = file.canonicalize().unwrap_or_else(|_| file.into());
    if let Ok(meta) = fs::metadata(&target)
        && !meta.is_file()
    {
        if meta.is_dir() {
            return Err(Failure::usage(format!("{}: is a folder: give the name of a file", file.display())));
        }
        // A device or pipe is written to.
        return fs::write(&target, bytes).map_err(failed).map(|()| None);
    }
    if let (Existing::Refuse(way), Ok(_)) = (existing, fs::symlink_metadata(&target)) {
        return Err(exists(file, way));
    }
    if fs::metadata(&target).is_ok_and(|m| m.permissions().readonly()) && existing == Existing::Replace {
        return Err(Failure::usage(format!(
            "{}: is write-protected; it is kept: choose another place",
            file.display()
        )));
    }
    let parent = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    disk::create_dir_all(parent).map_err(|e| failure(parent, "create the folder", &e))?;
    let name = target.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let aside = parent.join(format!(".{name}.lumenmesh-{}", std::process::id()));
    let put = || {
        disk::write(&aside, bytes)?;
        if let Ok(meta) = fs::metadata(&target) {
            fs::set_permissions(&aside, meta.permissions())?;
        }
        match existing {
            Existing::Refuse(_) => disk::rename_new(&aside, &target).map(|()| None),
            Existing::Replace => disk::rename(&aside, &target).map(|()| None),
            Existing::Keep => {
                let kept = match fs::symlink_metadata(&target) {
                    Ok(_) => Some(next_free(&target, |to| disk::rename_new(&target, to))?),
                    Err(_) => None,
                };
                disk::rename_new(&aside, &target).map(|()| kept)
            }
        }
    };
    put().map_err(|e| {
        let _ = disk::remove_file(&aside);
        match existing {
            Existing::Refuse(way) if e.kind() == ErrorKind::AlreadyExists => exists(file, way),
            _ => failed(e),
        }
    })
}

/// A folder of this process among the system's temporary files, gone with the value.
pub struct Scratch(PathBuf);

impl Scratch {
    /// Makes a folder that nobody else has.
    pub fn new(name: &str) -> Result<Scratch, Failure> {
        let first = std::env::temp_dir().join(format!("{name}-{}", std::process::id()));
        let made = next_free(&first, disk::create_dir);
        made.map(Scratch).map_err(|e| failure(&first, "create a temporary folder", &e))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = disk::remove_dir_all(&self.0);
    }
}
