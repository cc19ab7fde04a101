//! Output folders appear whole or not at all: written aside, then renamed.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::exit::{Failure, USAGE};

/// A folder being written beside its final place; dropped without [`Staging::publish`] it vanishes.
pub struct Staging {
    aside: PathBuf,
    target: PathBuf,
    published: bool,
}

fn failure(path: &Path, action: &str, e: &io::Error) -> Failure {
    let remedy = match e.kind() {
        io::ErrorKind::StorageFull => "free some space or choose another folder with -o",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => "choose a folder that you may write to with -o",
        _ => "choose another folder with -o",
    };
    Failure::new(USAGE, anyhow::anyhow!("{}: cannot {action}: {e}; {remedy}", path.display()))
}

impl Staging {
    /// Starts a folder that will be `target`. An existing `target` must be empty or hold earlier results.
    pub fn new(target: &Path) -> Result<Staging, Failure> {
        if target.exists() {
            let ours = target.join("report.json").is_file() || target.join("truth.json").is_file();
            let entries = fs::read_dir(target).map_err(|e| failure(target, "use this as output folder", &e))?.count();
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
        fs::create_dir_all(&aside).map_err(|e| failure(&aside, "create the folder", &e))?;
        Ok(Staging { aside, target: target.into(), published: false })
    }

    /// The folder to write into.
    pub fn path(&self) -> &Path {
        &self.aside
    }

    /// Puts the folder in its place; earlier results there go only once the new ones are whole.
    pub fn publish(mut self) -> Result<(), Failure> {
        let old = self.aside.with_extension("old");
        let had_old = self.target.exists();
        if had_old {
            fs::rename(&self.target, &old).map_err(|e| failure(&self.target, "move earlier results aside", &e))?;
        }
        if let Err(e) = fs::rename(&self.aside, &self.target) {
            if had_old {
                let _ = fs::rename(&old, &self.target);
            }
            return Err(failure(&self.target, "put the results in place", &e));
        }
        self.published = true;
        if had_old {
            let _ = fs::remove_dir_all(&old);
        }
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.published {
            let _ = fs::remove_dir_all(&self.aside);
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
    fn a_failed_run_leaves_nothing_and_a_foreign_folder_is_not_touched() {
        let dir = tempfile::tempdir().expect("temporary folder");
        drop(Staging::new(&dir.path().join("out")).expect("new"));
        assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 0);
        fs::write(dir.path().join("thesis.tex"), "x").expect("write");
        assert!(Staging::new(dir.path()).is_err());
    }
}
