//! The working folder `.NAME.lumenmesh` beside a result folder `NAME`: the lock that keeps two runs apart, and the
//! results while they are made.
//!
//! ```text
//! .NAME.lumenmesh/lock   locked by the run that writes; a lock of the system, so a dead run holds none
//! .NAME.lumenmesh/new    results that are being made; after the exchange the old ones, until they are removed
//! .NAME.lumenmesh/old    the old results, where the file system cannot exchange two folders
//! ```

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::{disk, failure, inspect, manifest, next_free};
use crate::cli::batch::WITH_PARENT;
use crate::cli::exit::Failure;

/// First word of a lock file.
const WORD: &str = "lumenmesh";

/// How long a run waits for another one in the same folder: a cohort that was killed and started again may meet its own
/// runs, which are about to end.
fn patience() -> Duration {
    Duration::from_secs(if std::env::var_os(WITH_PARENT).is_some() { 10 } else { 0 })
}

/// What came of taking a lock.
pub enum Taken {
    /// It is held now.
    Ours(Lock),
    /// The file went away meanwhile.
    Gone,
    /// Another process holds it.
    Busy(Failure),
}

/// A file that one process holds; the lock goes with the process.
pub struct Lock {
    path: PathBuf,
    file: File,
}

/// What tells a file from another one that has its name later.
pub type Id = (u64, u64);

/// The file's identity; `None` where there is none.
pub fn id(path: &Path) -> Option<Id> {
    fs::symlink_metadata(path).ok().map(|m| (m.dev(), m.ino()))
}

impl Lock {
    /// Takes the lock at `path`, in the name of `shown`.
    pub fn take(path: &Path, shown: &Path) -> Result<Taken, Failure> {
        let failed = |e: &io::Error| failure(path, "lock the output folder", e);
        let mut file = match OpenOptions::new().create(true).truncate(false).read(true).write(true).open(path) {
            Ok(file) => file,
            // The run that had the folder has just removed it.
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Taken::Gone),
            Err(e) => return Err(failed(&e)),
        };
        let locked = file.try_lock();
        let mut text = String::new();
        let _ = Read::by_ref(&mut file).take(64).read_to_string(&mut text);
        let word = text.split_whitespace().next();
        if word.is_some_and(|w| w != WORD) {
            return Err(Failure::usage(format!(
                "{}: is in the way and is not from lumenmesh; nothing was written: move it, or choose another folder with -o",
                path.display()
            )));
        }
        match locked {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let who = text.split_whitespace().nth(1).map_or(String::new(), |id| format!(" (process {id})"));
                return Ok(Taken::Busy(Failure::usage(format!(
                    "{}: another run{who} is writing there; nothing was written: wait until it is done, or choose another folder with -o",
                    shown.display()
                ))));
            }
            // Some network disks know no locks: what is there is checked again before anything is replaced.
            Err(TryLockError::Error(e)) if disk::unsupported(&e) => {}
            Err(TryLockError::Error(e)) => return Err(failed(&e)),
        }
        // A lock on a file that was removed meanwhile is worth nothing.
        if id(path).is_none() || id(path) != file.metadata().ok().map(|m| (m.dev(), m.ino())) {
            return Ok(Taken::Gone);
        }
        // The word is for people: on a full disk the lock holds without it.
        let _ = file
            .set_len(0)
            .and_then(|()| io::Seek::rewind(&mut file))
            .and_then(|()| writeln!(file, "{WORD} {}", std::process::id()));
        Ok(Taken::Ours(Lock { path: path.into(), file }))
    }
}

impl Lock {
    /// Whether the lock's place still has this lock: the folder may have been removed, and made anew by another run.
    fn stands(&self) -> bool {
        self.file.metadata().is_ok_and(|m| id(&self.path) == Some((m.dev(), m.ino())))
    }

    /// Removes the file, then lets go of it: who opens it later gets a new one.
    pub fn remove(self) -> io::Result<()> {
        if self.stands() { disk::remove_file(&self.path) } else { Ok(()) }
    }
}

/// A working folder that this process holds.
pub struct Work {
    dir: PathBuf,
    lock: Option<Lock>,
    /// A file among the results from their start to their end: it goes where somebody empties the folder.
    token: Option<Id>,
}

impl Work {
    /// Takes the working folder of `target` and clears what a dead run left there.
    pub fn take(target: &Path, shown: &Path) -> Result<Work, Failure> {
        let name = target.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let dir = target.with_file_name(format!(".{name}.lumenmesh"));
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(30) {
            match disk::create_dir(&dir) {
                Err(e) if e.kind() != ErrorKind::AlreadyExists => {
                    return Err(failure(&dir, "make a working folder beside the output folder", &e));
                }
                _ => {}
            }
            let lock = dir.join("lock");
            let strange = !fs::symlink_metadata(&dir).is_ok_and(|m| m.is_dir());
            if strange || !lock.exists() && fs::read_dir(&dir).is_ok_and(|mut d| d.next().is_some()) && !lock.exists() {
                return Err(Failure::usage(format!(
                    "{}: is in the way and is not from lumenmesh; nothing was written: move it, or choose another folder with -o",
                    dir.display()
                )));
            }
            match Lock::take(&lock, shown)? {
                Taken::Ours(lock) => {
                    let work = Work { dir, lock: Some(lock), token: None };
                    work.clear(target, shown)?;
                    return Ok(work);
                }
                Taken::Gone => {}
                Taken::Busy(_) if start.elapsed() < patience() => std::thread::sleep(Duration::from_millis(50)),
                Taken::Busy(e) => return Err(e),
            }
        }
        Err(failure(&dir, "lock the output folder", &ErrorKind::WouldBlock.into()))
    }

    /// Where results are made.
    pub fn new_results(&self) -> PathBuf {
        self.dir.join("new")
    }

    /// Makes the folder for new results.
    pub fn start(&mut self) -> Result<(), Failure> {
        let (new, token) = (self.new_results(), self.token_path());
        let own = new.join(manifest::FOLDER);
        let made = disk::create_dir(&new).and_then(|()| disk::create_dir(&own)).and_then(|()| disk::write(&token, b""));
        made.map_err(|e| failure(&new, "create the folder", &e))?;
        self.token = id(&token);
        Ok(())
    }

    fn token_path(&self) -> PathBuf {
        self.new_results().join(manifest::FOLDER).join("unfinished")
    }

    /// Fails where somebody removed the working folder, or emptied it, since the start.
    pub fn finish(&mut self) -> Result<(), Failure> {
        let token = self.token_path();
        if !self.stands() || self.token.is_none() || id(&token) != self.token {
            return Err(Failure::usage(format!(
                "{}: the working folder was removed or emptied while the run went on; nothing was put in place: run it again",
                self.dir.display()
            )));
        }
        disk::remove_file(&token).map_err(|e| failure(&token, "remove", &e))
    }

    /// Whether the folder is still the one that was taken.
    fn stands(&self) -> bool {
        self.lock.as_ref().is_some_and(Lock::stands)
    }

    /// The identity of the lock, for who must remove the folder without this value.
    pub fn lock_id(&self) -> Option<Id> {
        id(&self.dir.join("lock"))
    }

    /// Where old results wait where they cannot be exchanged in one step.
    pub fn old_results(&self) -> PathBuf {
        self.dir.join("old")
    }

    /// Puts right what a run that was killed left behind.
    fn clear(&self, target: &Path, shown: &Path) -> Result<(), Failure> {
        let (old, new) = (self.old_results(), self.new_results());
        if old.exists() {
            // With new results waiting the exchange was not done: the old ones are the only ones.
            match disk::rename_new(&old, target) {
                Ok(()) => eprintln!("note: {}: put back: a run that was killed had moved it aside", shown.display()),
                Err(e) if e.kind() == ErrorKind::AlreadyExists && new.exists() => {
                    let kept = next_free(target, |to| disk::rename_new(&old, to))
                        .map_err(|e| failure(&old, "put earlier results back", &e))?;
                    eprintln!("note: {}: results that a killed run had moved aside are in {}", shown.display(), kept.display());
                }
                Err(e) if e.kind() == ErrorKind::AlreadyExists => dispose(&old, target, shown, None)?,
                Err(e) => return Err(failure(&old, "put earlier results back", &e)),
            }
        }
        if new.exists() {
            // Without a manifest it is half-written; with one it may be what the new results were exchanged for.
            match manifest::Manifest::read(&new) {
                Ok(None) => {
                    disk::remove_dir_all(&new).map_err(|e| failure(&new, "remove what a killed run left", &e))?
                }
                _ => dispose(&new, target, shown, None)?,
            }
        }
        Ok(())
    }

    /// Removes the half-written results, the lock and the folder.
    pub fn discard(&mut self) {
        // Without any lock the folder is what this run went on to write after somebody had removed it.
        let alone = self.lock.is_some() && self.lock_id().is_none();
        if self.stands() || alone {
            let _ = disk::remove_dir_all(&self.new_results());
        }
        if alone {
            let _ = disk::remove_dir(&self.dir);
        }
        self.release();
    }

    /// Removes lock and folder. Where something is left in it the lock file stays: it tells whose folder it is.
    pub fn release(&mut self) {
        let only_the_lock = self.stands() && fs::read_dir(&self.dir).is_ok_and(|d| d.count() <= 1);
        if let Some(lock) = self.lock.take()
            && only_the_lock
        {
            let _ = lock.remove();
            let _ = disk::remove_dir(&self.dir);
        }
    }

    /// The folder itself.
    pub fn dir(&self) -> &Path {
        &self.dir
    }
}

impl Drop for Work {
    fn drop(&mut self) {
        self.release();
    }
}

/// Removes earlier results where all in them is ours and unchanged; else keeps them beside `target` and says where.
pub fn dispose(folder: &Path, target: &Path, shown: &Path, known: Option<&inspect::Seen>) -> Result<(), Failure> {
    let why = match inspect::remove(folder, known) {
        Ok(true) => return Ok(()),
        Ok(false) => "something was written into it".to_string(),
        Err(e) => format!("it cannot be removed: {}", crate::io::reason(&e)),
    };
    let kept = next_free(target, |to| disk::rename_new(folder, to))
        .map_err(|e| failure(folder, "move earlier results out of the working folder", &e))?;
    eprintln!("warning: {}: earlier results were kept as {}: {why}", shown.display(), kept.display());
    Ok(())
}
