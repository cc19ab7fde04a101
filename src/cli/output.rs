//! Output folders appear whole or not at all: written in a working folder beside their place, then exchanged for what
//! is there. Only what lumenmesh wrote itself, and nobody changed since, is ever removed.

mod disk;
mod inspect;
pub mod manifest;
mod place;
#[cfg(test)]
mod tests;
mod work;

use std::fs;
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use self::inspect::{Alien, Seen, State};
use self::manifest::{Manifest, Origin};
use self::work::Work;
use super::exit::{Failure, USAGE};

pub use self::place::{Existing, Scratch, exists, place};
pub use self::work::{Lock, Taken};

/// Working folders of this process; held while results are put in their place.
static OPEN: Mutex<Vec<(PathBuf, Option<work::Id>)>> = Mutex::new(Vec::new());

fn open_folders() -> MutexGuard<'static, Vec<(PathBuf, Option<work::Id>)>> {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes what is half-written. While the result lives, no folder is put in its place.
pub fn remove_unfinished() -> impl Drop {
    let mut open = open_folders();
    for (folder, lock) in open.drain(..) {
        let new = folder.join("new");
        if lock.is_none() || work::id(&folder.join("lock")) != lock {
            continue;
        }
        // A thread that still writes may put a file into a folder that is being emptied.
        for _ in 0..5 {
            if fs::remove_dir_all(&new).is_ok() || !new.exists() {
                let _ = fs::remove_file(folder.join("lock"));
                let _ = fs::remove_dir(&folder);
                break;
            }
        }
    }
    open
}

/// The error of a system call on `path`, with the remedy.
pub fn failure(path: &Path, action: &str, e: &io::Error) -> Failure {
    use crate::io::{reason, writing};
    Failure::new(USAGE, anyhow::anyhow!("{}: cannot {action}: {}; {}", path.display(), reason(e), writing(e)))
}

/// What happens to earlier results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Earlier {
    /// They are replaced where all of them is ours and unchanged, else refused.
    Replace,
    /// They are moved aside.
    Keep,
    /// They are replaced where all of them is ours and unchanged, else moved aside.
    KeepChanged,
}

impl Earlier {
    /// What `--keep` asks for.
    pub fn from_flag(keep: bool) -> Earlier {
        if keep { Earlier::Keep } else { Earlier::Replace }
    }

    /// Whether results in this state are moved aside.
    fn kept(self, state: &State) -> bool {
        match state {
            State::Absent | State::Empty => false,
            State::Ours(_) => self == Earlier::Keep,
            State::Unknown(_) | State::Foreign(_) => self != Earlier::Replace,
        }
    }
}

/// A result folder being written beside its final place; dropped without [`Staging::publish`] it vanishes.
pub struct Staging {
    /// The place as the person gave it.
    shown: PathBuf,
    /// The place without links.
    target: PathBuf,
    earlier: Earlier,
    /// What stood there at the start.
    seen: Option<Seen>,
    work: Work,
    done: bool,
}

impl Staging {
    /// Starts a folder that will be `target`. What is there must be earlier results that nobody changed, an empty
    /// folder, or nothing; where earlier results are kept it may be anything.
    pub fn new(shown: &Path, earlier: Earlier) -> Result<Staging, Failure> {
        let target = resolve(shown)?;
        let work = Work::take(&target, shown)?;
        let mut staging = Staging { shown: shown.into(), target, earlier, seen: None, work, done: false };
        match inspect::inspect(&staging.target, None).map_err(|e| failure(shown, "use this as output folder", &e))? {
            state if earlier.kept(&state) => {}
            State::Unknown(why) => return Err(staging.no_manifest(why)),
            State::Foreign(aliens) => return Err(staging.foreign(&aliens)),
            State::Ours(seen) => staging.seen = Some(seen),
            State::Absent | State::Empty => {}
        }
        open_folders().push((staging.work.dir().into(), staging.work.lock_id()));
        staging.work.start()?;
        Ok(staging)
    }

    /// The folder to write into.
    pub fn path(&self) -> PathBuf {
        self.work.new_results()
    }

    /// Refuses to go on where one of the run's own inputs would go with the earlier results.
    pub fn guard(&self, inputs: impl Iterator<Item = PathBuf>) -> Result<(), Failure> {
        let inside = |f: &PathBuf| f.canonicalize().is_ok_and(|f| f.starts_with(&self.target));
        match inputs.into_iter().find(inside).filter(|_| self.earlier != Earlier::Keep) {
            None => Ok(()),
            Some(file) => Err(Failure::usage(format!(
                "{}: holds an input of this run, {}, and would be replaced; nothing was written: choose another folder with -o",
                self.shown.display(),
                file.display()
            ))),
        }
    }

    /// A folder beside the results, named the way the person named them.
    fn as_shown(&self, beside: &Path) -> PathBuf {
        let named = self.shown.with_file_name(beside.file_name().unwrap_or_default());
        if named.canonicalize().is_ok_and(|p| p == beside) { named } else { beside.into() }
    }

    fn no_manifest(&self, why: Option<String>) -> Failure {
        let why = match why {
            None => format!(
                "holds files but no {}, so that lumenmesh cannot tell what is its own (results of older versions have none)",
                manifest::FILE
            ),
            Some(why) => {
                format!("{} cannot be used ({why}), so that lumenmesh cannot tell what is its own", manifest::FILE)
            }
        };
        Failure::usage(format!(
            "{}: {why}; nothing was written: choose another folder with -o, or move this one aside with --keep",
            self.shown.display()
        ))
    }

    fn foreign(&self, aliens: &[Alien]) -> Failure {
        Failure::usage(format!(
            "{}: replacing these results would lose {}; nothing was written: choose another folder with -o, or move this one aside with --keep",
            self.shown.display(),
            inspect::in_words(aliens)
        ))
    }

    /// Puts the folder in its place; gives where earlier results were kept.
    pub fn publish(mut self, origin: Origin) -> Result<Option<PathBuf>, Failure> {
        let (new, target) = (self.work.new_results(), self.target.clone());
        self.work.finish()?;
        let written = Manifest::of(&new, origin).and_then(|m| m.write(&new));
        written.map_err(|e| failure(&new.join(manifest::FILE), "write", &e))?;
        let state = inspect::inspect(&target, self.seen.as_ref())
            .map_err(|e| failure(&self.shown, "look at earlier results", &e))?;
        if let Ok(meta) = fs::metadata(&target)
            && !meta.permissions().readonly()
        {
            // The folder keeps the permissions that a person gave it.
            fs::set_permissions(&new, meta.permissions()).map_err(|e| failure(&new, "set the permissions", &e))?;
        }
        let mut open = open_folders();
        let put = self.put(&state);
        open.retain(|f| f.0 != self.work.dir());
        self.done = true;
        drop(open);
        match put {
            Ok(Put::Alone(kept)) => {
                self.work.release();
                Ok(kept)
            }
            Ok(Put::Over(old)) => {
                let seen = if let State::Ours(seen) = &state { Some(seen) } else { None };
                work::dispose(&old, &target, &self.shown, seen)?;
                self.work.release();
                Ok(None)
            }
            Err(e) => Err(self.beside(e)),
        }
    }

    /// The step that makes the results visible.
    fn put(&self, state: &State) -> Result<Put, Failure> {
        let (new, target) = (self.work.new_results(), &self.target);
        let failed = |e: io::Error| failure(&self.shown, "put the results in place", &e);
        let aside = |e: io::Error| failure(&self.shown, "move earlier results aside", &e);
        match state {
            State::Absent => disk::rename_new(&new, target).map_err(failed).map(|()| Put::Alone(None)),
            // An empty folder gives way; one that is no longer empty does not.
            State::Empty => disk::rename(&new, target).map_err(failed).map(|()| Put::Alone(None)),
            state if self.earlier.kept(state) => {
                let kept = next_free(target, |to| disk::rename_new(target, to)).map_err(aside)?;
                disk::rename_new(&new, target).map_err(|e| {
                    let _ = disk::rename_new(&kept, target);
                    failed(e)
                })?;
                Ok(Put::Alone(Some(self.as_shown(&kept))))
            }
            State::Ours(_) => {
                if disk::exchange(&new, target).map_err(failed)? {
                    return Ok(Put::Over(new));
                }
                let old = self.work.old_results();
                disk::rename(target, &old).map_err(aside)?;
                disk::rename_new(&new, target).map_err(|e| {
                    let _ = disk::rename_new(&old, target);
                    failed(e)
                })?;
                Ok(Put::Over(old))
            }
            State::Unknown(why) => Err(self.no_manifest(why.clone())),
            State::Foreign(aliens) => Err(self.foreign(aliens)),
        }
    }

    /// The place was changed while the run went on: it stays, and the new results go beside it.
    fn beside(&mut self, e: Failure) -> Failure {
        let (new, first) = (self.work.new_results(), suffixed(&self.target, "new"));
        let put = match disk::rename_new(&new, &first) {
            Ok(()) => Ok(first),
            Err(_) => next_free(&first, |to| disk::rename_new(&new, to)),
        };
        let whole = e.message();
        let what = whole.split("; nothing was written").next().unwrap_or_default();
        match put {
            Ok(place) => {
                self.work.release();
                let place = self.as_shown(&place);
                Failure::new(
                    e.code(),
                    anyhow::anyhow!("{what}; it is left as it is, and the new results are in {}", place.display()),
                )
            }
            Err(_) => {
                self.work.discard();
                e
            }
        }
    }
}

/// How results came to their place.
enum Put {
    /// Nothing was removed; what was there was moved here.
    Alone(Option<PathBuf>),
    /// Earlier results are in this folder of the working folder now.
    Over(PathBuf),
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.done {
            open_folders().retain(|f| f.0 != self.work.dir());
            self.work.discard();
        }
    }
}

/// Tells where earlier results are now.
pub fn tell_kept(kept: Option<&Path>) {
    if let Some(path) = kept {
        eprintln!("note: what was there before is in {}", path.display());
    }
}

/// Makes a folder and its parents.
pub fn create_dir_all(path: &Path) -> Result<(), Failure> {
    disk::create_dir_all(path).map_err(|e| failure(path, "create the folder", &e))
}

/// Moves a file or folder to the first of `PATH.1`, `PATH.2`, … that is free.
pub fn move_aside(path: &Path) -> Result<PathBuf, Failure> {
    next_free(path, |to| disk::rename_new(path, to)).map_err(|e| failure(path, "move this aside", &e))
}

/// Writes `part` and puts it in the place of `path`.
pub fn replace_from(part: &Path, path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    disk::write(part, bytes).and_then(|()| disk::rename(part, path)).map_err(|e| failure(path, "write", &e))
}

/// Writes a file into a folder of ours, naming it in the error.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    if let Some(parent) = path.parent() {
        disk::create_dir_all(parent).map_err(|e| failure(parent, "create the folder", &e))?;
    }
    disk::write(path, bytes).map_err(|e| failure(path, "write", &e))
}

/// `PATH.SUFFIX`.
fn suffixed(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".");
    name.push(suffix);
    path.with_file_name(name)
}

/// Does `put` with the first of `PATH.1`, `PATH.2`, … that is free.
fn next_free(path: &Path, put: impl Fn(&Path) -> io::Result<()>) -> io::Result<PathBuf> {
    for n in 1..u32::MAX {
        let to = suffixed(path, &n.to_string());
        match put(&to) {
            Err(e) if matches!(e.kind(), ErrorKind::AlreadyExists | ErrorKind::DirectoryNotEmpty) => {}
            done => return done.map(|()| to),
        }
    }
    Err(ErrorKind::AlreadyExists.into())
}

/// The place of an output folder without links; its parents are made. Places that cannot be replaced as a whole are
/// refused before any work is done.
fn resolve(shown: &Path) -> Result<PathBuf, Failure> {
    let refused = |why: &str| {
        let inside = shown.join("results");
        Failure::usage(format!(
            "{}: {why}; nothing was written: give a folder of its own, such as -o {}",
            shown.display(),
            inside.display()
        ))
    };
    let target = match shown.canonicalize() {
        Ok(path) => path,
        Err(_) if fs::symlink_metadata(shown).is_ok() => return Err(refused("is a link that leads nowhere")),
        Err(_) => {
            let Some(name) = shown.file_name() else { return Err(refused("is no name for a folder")) };
            let parent = shown.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            disk::create_dir_all(parent).map_err(|e| failure(parent, "create the folder", &e))?;
            return Ok(parent.canonicalize().map_err(|e| failure(parent, "create the folder", &e))?.join(name));
        }
    };
    if !target.is_dir() {
        return Err(Failure::usage(format!(
            "{}: is a file; nothing was written: choose another folder with -o",
            shown.display()
        )));
    }
    let device = |p: &Path| fs::metadata(p).map(|m| m.dev());
    match target.parent() {
        None => return Err(refused("is the root of all folders")),
        Some(parent) => match (device(&target), device(parent)) {
            (Ok(a), Ok(b)) if a != b => return Err(refused("is a mount point, which cannot be replaced as a whole")),
            _ => {}
        },
    }
    if std::env::current_dir().and_then(|d| d.canonicalize()).is_ok_and(|d| d.starts_with(&target)) {
        return Err(refused("is the folder that you are in, or holds it"));
    }
    Ok(target)
}
