//! `.lumenmesh/manifest.json`: every file of a result folder with size and hash, written last.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::disk;

/// Folder of what lumenmesh keeps for itself in a result folder.
pub const FOLDER: &str = ".lumenmesh";
/// The manifest, seen from the result folder.
pub const FILE: &str = ".lumenmesh/manifest.json";
/// Version of the manifest's keys.
const FORMAT: u32 = 1;

/// What made a folder.
#[derive(Debug, Clone, Copy)]
pub struct Origin<'a> {
    /// The subcommand.
    pub command: &'a str,
    /// Hash of the case and its input files.
    pub case: Option<&'a str>,
}

/// The files of a result folder, as they were written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    format: u32,
    program: String,
    version: String,
    /// The subcommand that made the folder.
    pub command: String,
    /// Hash of the resolved case, its input files and this version: results with the same hash are these results.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub case: Option<String>,
    /// All folders, from the result folder on.
    pub folders: Vec<String>,
    /// All files but the manifest.
    pub files: Vec<Entry>,
}

/// A file of the manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Path from the result folder, with `/`.
    pub path: String,
    /// Bytes.
    pub size: u64,
    /// SHA-256 of the content.
    pub sha256: String,
}

impl Manifest {
    /// A manifest without files.
    pub fn empty(origin: Origin) -> Manifest {
        Manifest {
            format: FORMAT,
            program: env!("CARGO_PKG_NAME").into(),
            version: env!("CARGO_PKG_VERSION").into(),
            command: origin.command.into(),
            case: origin.case.map(str::to_string),
            folders: vec![],
            files: vec![],
        }
    }

    /// The manifest of all that lies in `dir` but [`FOLDER`], once the disk has it.
    pub fn of(dir: &Path, origin: Origin) -> io::Result<Manifest> {
        let mut manifest = Manifest::empty(origin);
        let mut open = vec![(dir.to_path_buf(), String::new())];
        while let Some((folder, prefix)) = open.pop() {
            for entry in fs::read_dir(&folder)? {
                let entry = entry?;
                let name = entry.file_name().into_string().map_err(|_| io::Error::other("a name is not UTF-8"))?;
                let path = format!("{prefix}{name}");
                if path == FOLDER {
                    continue;
                }
                if entry.file_type()?.is_dir() {
                    open.push((entry.path(), format!("{path}/")));
                    manifest.folders.push(path);
                } else {
                    disk::sync(&entry.path())?;
                    let (size, sha256) = hash(&entry.path())?;
                    manifest.files.push(Entry { path, size, sha256 });
                }
            }
        }
        manifest.folders.sort();
        manifest.files.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(manifest)
    }

    /// Writes the manifest into `dir`.
    pub fn write(&self, dir: &Path) -> io::Result<()> {
        let folder = dir.join(FOLDER);
        match disk::create_dir(&folder) {
            Err(e) if e.kind() != io::ErrorKind::AlreadyExists => return Err(e),
            _ => {}
        }
        // Whole or not at all, where one is replaced.
        let part = folder.join("manifest.part");
        disk::write(&part, format!("{}\n", serde_json::to_string_pretty(self)?).as_bytes())?;
        disk::rename(&part, &dir.join(FILE))
    }

    /// The manifest in `dir`: `None` where there is none, an error where it cannot be used.
    pub fn read(dir: &Path) -> Result<Option<Manifest>, String> {
        let text = match fs::read(dir.join(FILE)) {
            Ok(text) => text,
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => return Ok(None),
            Err(e) => return Err(crate::io::reason(&e)),
        };
        let manifest: Manifest = serde_json::from_slice(&text).map_err(|e| e.to_string())?;
        match manifest.format {
            FORMAT => Ok(Some(manifest)),
            n => Err(format!("it has format {n}, this version knows {FORMAT}")),
        }
    }

    /// The entries by path; a path may have several, all of them ours.
    pub fn by_path(&self) -> BTreeMap<&str, Vec<&Entry>> {
        let mut all: BTreeMap<&str, Vec<&Entry>> = BTreeMap::new();
        for e in &self.files {
            all.entry(&e.path).or_default().push(e);
        }
        all
    }
}

/// Size and SHA-256 of a file.
pub fn hash(path: &Path) -> io::Result<(u64, String)> {
    let mut hash = Sha256::new();
    let size = io::copy(&mut File::open(path)?, &mut hash)?;
    Ok((size, hex(&hash.finalize())))
}

/// SHA-256 of bytes.
pub fn hash_of(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Bytes in hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}
