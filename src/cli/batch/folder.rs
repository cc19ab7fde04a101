//! The folder of a cohort: its lock, and the files beside the folders of the cases. Cases' folders are guarded by their
//! own manifests; the cohort's manifest lists only what the cohort wrote itself.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::cli::exit::Failure;
use crate::cli::output::manifest::{self, Entry, Manifest, Origin};
use crate::cli::output::{self, Lock, Taken};

/// The pages of a cohort.
pub const PAGES: [&str; 2] = ["cohort.csv", "cohort.html"];
const COMMAND: &str = "batch";

/// A cohort's folder that this process holds.
pub struct Folder {
    root: PathBuf,
    ledger: Mutex<Manifest>,
    lock: Option<Lock>,
}

impl Folder {
    /// Takes the folder; it is made if there is none. Pages that were changed, or that a manifest does not know, are
    /// refused, or moved aside with `keep`.
    pub fn open(root: &Path, keep: bool) -> Result<Folder, Failure> {
        let own = root.join(manifest::FOLDER);
        output::create_dir_all(&own)?;
        let lock = loop {
            match Lock::take(&own.join("lock"), root)? {
                Taken::Ours(lock) => break Some(lock),
                Taken::Busy(e) => return Err(e),
                Taken::Gone => output::create_dir_all(&own)?,
            }
        };
        let refused = |why: String| {
            Failure::usage(format!("{}: {why}; nothing was written: choose another folder with -o", root.display()))
        };
        let ledger = match Manifest::read(root) {
            Ok(None) => Manifest::empty(Origin { command: COMMAND, case: None }),
            Ok(Some(m)) if m.command == COMMAND => m,
            Ok(Some(m)) => return Err(refused(format!("holds results of `lumenmesh {}`", m.command))),
            Err(why) => return Err(refused(format!("{} cannot be used ({why})", manifest::FILE))),
        };
        let folder = Folder { root: root.into(), ledger: Mutex::new(ledger), lock };
        for page in PAGES {
            if !folder.ours(&folder.ledger(), page) {
                if !keep {
                    return Err(Failure::usage(format!(
                        "{}: was changed or is not from lumenmesh; nothing was written: rename it, or move it aside with --keep",
                        root.join(page).display()
                    )));
                }
                folder.aside(page)?;
            }
        }
        Ok(folder)
    }

    fn ledger(&self) -> MutexGuard<'_, Manifest> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether nothing would be lost with this file.
    fn ours(&self, ledger: &Manifest, name: &str) -> bool {
        let path = self.root.join(name);
        let Ok(meta) = fs::symlink_metadata(&path) else { return true };
        let known =
            |size: u64, hash: &str| ledger.files.iter().any(|e| e.path == name && e.size == size && e.sha256 == hash);
        meta.is_file() && manifest::hash(&path).is_ok_and(|(size, hash)| known(size, &hash))
    }

    fn aside(&self, name: &str) -> Result<(), Failure> {
        let path = self.root.join(name);
        let kept = output::move_aside(&path)?;
        eprintln!("note: {}: was changed or is not from lumenmesh; it is in {} now", path.display(), kept.display());
        Ok(())
    }

    /// Writes a file of the cohort whole or not at all. What is there and not ours is moved aside.
    pub fn put(&self, name: &str, bytes: &[u8]) -> Result<(), Failure> {
        let mut ledger = self.ledger();
        if !self.ours(&ledger, name) {
            self.aside(name)?;
        }
        let entry = Entry { path: name.into(), size: bytes.len() as u64, sha256: manifest::hash_of(bytes) };
        // Known before it is there: a kill in between leaves no file that the next run would take for a person's.
        ledger.files.push(entry.clone());
        self.write(&ledger)?;
        output::replace_from(&self.root.join(manifest::FOLDER).join("part"), &self.root.join(name), bytes)?;
        ledger.files.retain(|e| e.path != name);
        ledger.files.push(entry);
        ledger.files.sort_by(|a, b| a.path.cmp(&b.path));
        self.write(&ledger)
    }

    /// Removes a file of the cohort where it is there and ours.
    pub fn remove(&self, name: &str) -> Result<(), Failure> {
        let mut ledger = self.ledger();
        let known = ledger.files.iter().any(|e| e.path == name);
        if !known || !self.ours(&ledger, name) {
            return Ok(());
        }
        let path = self.root.join(name);
        if path.exists() {
            fs::remove_file(&path).map_err(|e| output::failure(&path, "remove", &e))?;
        }
        ledger.files.retain(|e| e.path != name);
        self.write(&ledger)
    }

    fn write(&self, ledger: &Manifest) -> Result<(), Failure> {
        ledger.write(&self.root).map_err(|e| output::failure(&self.root.join(manifest::FILE), "write", &e))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if let Some(lock) = self.lock.take() {
            let _ = lock.remove();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(e: Option<Failure>) -> String {
        e.map(|e| e.message()).unwrap_or_default()
    }

    #[test]
    fn pages_that_a_person_changed_are_refused_or_moved_aside() {
        let dir = tempfile::tempdir().expect("folder");
        let csv = dir.path().join("cohort.csv");
        let folder = Folder::open(dir.path(), false).expect("new");
        assert!(message(Folder::open(dir.path(), false).err()).contains("another run"));
        folder.put("cohort.csv", b"1").expect("written");
        folder.put("cohort.csv", b"2").expect("replaced");
        drop(folder);
        assert_eq!(fs::read(&csv).expect("there"), b"2");
        drop(Folder::open(dir.path(), false).expect("unchanged"));
        fs::write(&csv, "my column").expect("write");
        assert!(message(Folder::open(dir.path(), false).err()).contains("--keep"));
        let folder = Folder::open(dir.path(), true).expect("kept");
        folder.put("cohort.csv", b"3").expect("written");
        assert_eq!(fs::read(dir.path().join("cohort.csv.1")).expect("kept"), b"my column");
        assert_eq!(fs::read(&csv).expect("new"), b"3");
    }

    #[test]
    fn a_log_of_a_person_is_neither_removed_nor_written_over() {
        let dir = tempfile::tempdir().expect("folder");
        let log = dir.path().join("a.log");
        fs::write(&log, "mine").expect("write");
        let folder = Folder::open(dir.path(), false).expect("new");
        folder.remove("a.log").expect("nothing to do");
        assert_eq!(fs::read(&log).expect("there"), b"mine");
        folder.put("a.log", b"theirs").expect("written");
        assert_eq!(fs::read(dir.path().join("a.log.1")).expect("kept"), b"mine");
        folder.remove("a.log").expect("ours");
        assert!(!log.exists());
    }

    #[test]
    fn results_of_a_run_are_no_cohort() {
        let dir = tempfile::tempdir().expect("folder");
        Manifest::empty(Origin { command: "run", case: None }).write(dir.path()).expect("write");
        assert!(message(Folder::open(dir.path(), true).err()).contains("lumenmesh run"));
    }
}
