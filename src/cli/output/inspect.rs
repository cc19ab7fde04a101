//! What a folder holds, held against its manifest; and its removal, file by file, where all of it is ours.

use std::collections::BTreeMap;
use std::fs::{self, Metadata};
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use super::disk;
use super::manifest::{self, Manifest};

/// What tells whether a file was touched: the system sets the last two, no program can set them back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp([i64; 6]);

impl Stamp {
    fn of(m: &Metadata) -> Stamp {
        Stamp([m.ino() as i64, m.size() as i64, m.mtime(), m.mtime_nsec(), m.ctime(), m.ctime_nsec()])
    }
}

/// The files and folders of a result folder of ours.
#[derive(Debug, Default)]
pub struct Seen {
    files: BTreeMap<String, Stamp>,
    folders: Vec<String>,
}

/// Something in a folder that must not be lost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Alien {
    /// Path from the folder.
    pub path: String,
    /// Why it is not ours to remove.
    pub why: &'static str,
}

/// What is at a path.
#[derive(Debug)]
pub enum State {
    /// Nothing.
    Absent,
    /// A folder without anything in it.
    Empty,
    /// All is in the manifest and unchanged.
    Ours(Seen),
    /// There is no manifest, or none that can be used, for the reason given.
    Unknown(Option<String>),
    /// These are not in the manifest or were changed.
    Foreign(Vec<Alien>),
}

/// Looks at a folder. Files that are still as in `known` are not read again.
pub fn inspect(dir: &Path, known: Option<&Seen>) -> io::Result<State> {
    match fs::symlink_metadata(dir) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(State::Absent),
        Err(e) => return Err(e),
        Ok(m) if !m.is_dir() => return Err(ErrorKind::NotADirectory.into()),
        Ok(m) if m.permissions().readonly() => {
            return Ok(State::Foreign(vec![Alien { path: "./".into(), why: "write-protected" }]));
        }
        Ok(_) => {}
    }
    if fs::read_dir(dir)?.next().is_none() {
        return Ok(State::Empty);
    }
    let manifest = match Manifest::read(dir) {
        Ok(Some(manifest)) => manifest,
        Ok(None) => return Ok(State::Unknown(None)),
        Err(what) => return Ok(State::Unknown(Some(what))),
    };
    let mut walk =
        Walk { entries: manifest.by_path(), manifest: &manifest, known, seen: Seen::default(), aliens: vec![] };
    walk.folder(dir, "")?;
    if walk.aliens.is_empty() { Ok(State::Ours(walk.seen)) } else { Ok(State::Foreign(walk.aliens)) }
}

struct Walk<'a> {
    entries: BTreeMap<&'a str, Vec<&'a manifest::Entry>>,
    manifest: &'a Manifest,
    known: Option<&'a Seen>,
    seen: Seen,
    aliens: Vec<Alien>,
}

impl Walk<'_> {
    fn alien(&mut self, path: String, why: &'static str) {
        self.aliens.push(Alien { path, why });
    }

    fn folder(&mut self, dir: &Path, prefix: &str) -> io::Result<()> {
        let mut entries = fs::read_dir(dir)?.collect::<io::Result<Vec<_>>>()?;
        entries.sort_by_key(fs::DirEntry::file_name);
        for entry in entries {
            let name = entry.file_name();
            let path = format!("{prefix}{}", name.to_string_lossy());
            let meta = match fs::symlink_metadata(entry.path()) {
                Ok(meta) => meta,
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                Err(e) => return Err(e),
            };
            let kind = meta.file_type();
            if kind.is_symlink() {
                self.alien(path, "a link");
            } else if kind.is_dir() {
                if name.to_str().is_none() || !(path == manifest::FOLDER || self.manifest.folders.contains(&path)) {
                    self.alien(format!("{path}/"), "not written by lumenmesh");
                } else if meta.permissions().readonly() {
                    self.alien(format!("{path}/"), "write-protected");
                } else {
                    match self.folder(&entry.path(), &format!("{path}/")) {
                        Err(e) if e.kind() == ErrorKind::PermissionDenied => {
                            self.alien(format!("{path}/"), "cannot be looked at")
                        }
                        other => other?,
                    }
                    self.seen.folders.push(path);
                }
            } else if !kind.is_file() {
                self.alien(path, "neither file nor folder");
            } else if meta.permissions().readonly() {
                self.alien(path, "write-protected");
            } else if name.to_str().is_some() && path == manifest::FILE {
                self.seen.files.insert(path, Stamp::of(&meta));
            } else {
                self.file(&entry.path(), path, &meta, name.to_str().is_some());
            }
        }
        Ok(())
    }

    fn file(&mut self, file: &Path, path: String, meta: &Metadata, named: bool) {
        let stamp = Stamp::of(meta);
        let Some(entries) = self.entries.get(path.as_str()).filter(|_| named) else {
            return self.alien(path, "not written by lumenmesh");
        };
        let unread = self.known.is_some_and(|k| k.files.get(&path) == Some(&stamp));
        // A file of another length need not be read; one that cannot be read is not known to be ours.
        let ours = unread
            || entries.iter().any(|e| e.size == meta.size())
                && manifest::hash(file)
                    .is_ok_and(|(size, hash)| entries.iter().any(|e| e.size == size && e.sha256 == hash));
        if ours {
            self.seen.files.insert(path, stamp);
        } else {
            self.alien(path, "changed");
        }
    }
}

/// Removes a folder of ours, the manifest last; `false`, and nothing is touched, where it holds anything else. What
/// comes into the folder meanwhile stays, and is an error.
pub fn remove(dir: &Path, known: Option<&Seen>) -> io::Result<bool> {
    let seen = match inspect(dir, known)? {
        State::Absent => return Ok(true),
        State::Empty => Seen::default(),
        State::Ours(seen) => seen,
        State::Unknown(_) | State::Foreign(_) => return Ok(false),
    };
    for path in seen.files.keys().filter(|p| *p != manifest::FILE) {
        disk::remove_file(&dir.join(path))?;
    }
    // Inner folders stand before the outer ones.
    for path in seen.folders.iter().filter(|p| *p != manifest::FOLDER) {
        disk::remove_dir(&dir.join(path))?;
    }
    if seen.folders.iter().any(|p| p == manifest::FOLDER) {
        // Nothing else may be there: the manifest is what proves the rest.
        if fs::read_dir(dir)?.count() > 1 {
            return Err(ErrorKind::DirectoryNotEmpty.into());
        }
        disk::remove_file(&dir.join(manifest::FILE))?;
        disk::remove_dir(&dir.join(manifest::FOLDER))?;
    }
    disk::remove_dir(dir)?;
    Ok(true)
}

/// The aliens of a folder in words, a few by name.
pub fn in_words(aliens: &[Alien]) -> String {
    const NAMED: usize = 6;
    let mut text = aliens.iter().take(NAMED).map(|a| format!("{} ({})", a.path, a.why)).collect::<Vec<_>>().join(", ");
    if aliens.len() > NAMED {
        text.push_str(&format!(" and {} more", aliens.len() - NAMED));
    }
    text
}
