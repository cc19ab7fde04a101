//! Output folders appear whole or not at all: written aside, then renamed.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use std::sync::{Mutex, MutexGuard, PoisonError};

use super::exit::{Failure, USAGE};

/// Folders being written; held while one is put in its place.
static OPEN: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn open_folders() -> MutexGuard<'static, Vec<PathBuf>> {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes what is half-written. While the result lives, no folder is put in its place.
pub fn remove_unfinished() -> impl Drop {
    let mut open = open_folders();
    for folder in open.drain(..) {
        // A thread that still writes may put a file into a folder that is being emptied.
        for _ in 0..5 {
            if fs::remove_dir_all(&folder).is_ok() || !folder.exists() {
                break;
            }
        }
    }
    open
}

/// A folder being written beside its final place; dropped without [`Staging::publish`] it vanishes.
pub struct Staging {
    aside: PathBuf,
    target: PathBuf,
    published: bool,
}

/// The error of a system call on `path`, with the remedy.
pub fn failure(path: &Path, action: &str, e: &io::Error) -> Failure {
    use crate::io::{reason, writing};
    Failure::new(USAGE, anyhow::anyhow!("{}: cannot {action}: {}; {}", path.display(), reason(e), writing(e)))
}

/// A time of a solver's run in the OpenFOAM case of earlier results.
fn solved(target: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(target.join("openfoam")).ok()?;
    let mut times: Vec<PathBuf> = entries.filter_map(|e| e.ok().map(|e| e.path())).collect();
    times.sort();
    let time = |p: &Path| p.file_name().and_then(|n| n.to_str()).and_then(|n| n.parse::<f64>().ok());
    times.into_iter().find(|p| p.is_dir() && time(p).is_some_and(|t| t > 0.0))
}

impl Staging {
    /// Starts a folder that will be `target`. An existing `target` must be empty or hold earlier results.
    pub fn new(target: &Path) -> Result<Staging, Failure> {
        if target.exists() {
            let ours = target.join("report.json").is_file() || target.join("truth.json").is_file();
            let entries = fs::read_dir(target).map_err(|e| failure(target, "use this as output folder", &e))?.count();
            if let Some(kept) = solved(target) {
                return Err(Failure::usage(format!(
                    "{}: holds a solver's results, which would be lost with the mesh they were made on; nothing was written: choose another folder with -o, or clear them with {}",
                    kept.display(),
                    target.join("openfoam/Allclean").display()
                )));
            }
            if entries > 0 && !ours {
                return Err(Failure::usage(format!(
                    "{}: is not empty and holds no earlier results; nothing was written: choose another folder with -o",
                    target.display()
                )));
            }
        }
        let name = target.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_else(|| "out".into());
        let parent = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(parent).map_err(|e| failure(parent, "create the folder", &e))?;
        let aside = parent.join(format!(".{name}.partial-{}", std::process::id()));
        remove_abandoned(parent, &format!(".{name}.partial-"));
        open_folders().push(aside.clone());
        fs::create_dir_all(&aside).map_err(|e| failure(&aside, "create the folder", &e))?;
        Ok(Staging { aside, target: target.into(), published: false })
    }

    /// The folder to write into.
    pub fn path(&self) -> &Path {
        &self.aside
    }

    /// Puts the folder in its place; earlier results there go only once the new ones are whole.
    pub fn publish(mut self) -> Result<(), Failure> {
        let mut open = open_folders();
        open.retain(|f| *f != self.aside);
        let old = self.aside.with_extension("old");
        let had_old = self.target.exists();
        if had_old {
            if let Err(e) = fs::rename(&self.target, &old) {
                drop(open);
                return Err(failure(&self.target, "move earlier results aside", &e));
            }
        }
        if let Err(e) = fs::rename(&self.aside, &self.target) {
            if had_old {
                let _ = fs::rename(&old, &self.target);
            }
            drop(open);
            return Err(failure(&self.target, "put the results in place", &e));
        }
        self.published = true;
        drop(open);
        if had_old {
            let _ = fs::remove_dir_all(&old);
        }
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.published {
            open_folders().retain(|f| *f != self.aside);
            let _ = fs::remove_dir_all(&self.aside);
        }
    }
}

/// Removes what processes that were killed left half-written in `parent`.
fn remove_abandoned(parent: &Path, prefix: &str) {
    if !Path::new("/proc/self").exists() {
        return;
    }
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let id = name.to_str().and_then(|n| n.strip_prefix(prefix)).and_then(|id| id.parse::<u32>().ok());
        if id.is_some_and(|id| !Path::new(&format!("/proc/{id}")).exists()) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// Writes a text file, naming it in the error.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(|e| failure(parent, "create the folder", &e))?;
    }
    fs::write(path, bytes).map_err(|e| failure(path, "write", &e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_appear_only_when_published_and_replace_earlier_ones() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let target = dir.path().join("out");
        let staging = Staging::new(&target).expect("new");
        write(&staging.path().join("report.json"), b"1").expect("write");
        assert!(!target.exists());
        staging.publish().expect("publish");
        let second = Staging::new(&target).expect("again");
        write(&second.path().join("report.json"), b"2").expect("write");
        assert_eq!(fs::read(target.join("report.json")).expect("old kept"), b"1");
        second.publish().expect("publish");
        assert_eq!(fs::read(target.join("report.json")).expect("new"), b"2");
        assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 1, "nothing is left aside");
    }

    #[test]
    fn what_a_solver_made_is_not_replaced() {
        let dir = tempfile::tempdir().expect("folder");
        let target = dir.path().join("out");
        fs::create_dir_all(target.join("openfoam/295")).expect("folders");
        fs::write(target.join("report.json"), "{}").expect("write");
        let e = Staging::new(&target).err().map(|e| e.message()).unwrap_or_default();
        assert!(e.contains("openfoam/295") && e.contains("Allclean"), "{e}");
        fs::rename(target.join("openfoam/295"), target.join("openfoam/0")).expect("rename");
        assert!(Staging::new(&target).is_ok(), "initial fields are no results");
    }

    #[test]
    fn a_failed_run_leaves_nothing_and_a_foreign_folder_is_not_touched() {
        let dir = tempfile::tempdir().expect("temporary folder");
        drop(Staging::new(&dir.path().join("out")).expect("new"));
        assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 0);
        fs::write(dir.path().join("thesis.tex"), "x").expect("write");
        assert!(Staging::new(dir.path()).is_err());
    }
}
