//! The hash of what is run: results with the same hash are the results of this very case.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::exit::{self, Failure};
use super::output::manifest::hex;
use crate::config::{self, Case};
use crate::pipeline::Stage;

/// Hash of the resolved case, the content of its files, the stage to stop after and this version.
pub fn of(case: &Case, stage: Stage) -> Result<String, Failure> {
    let mut case = case.with_absolute_paths();
    let mut hash = Sha256::new();
    hash.update(env!("CARGO_PKG_VERSION"));
    hash.update(config::to_yaml(&case)?);
    hash.update(format!("{stage:?}"));
    for file in case.files_mut() {
        content(file, &mut hash).map_err(|e| Failure::new(exit::INPUT, crate::io::Error::read(file, e)))?;
        if let Some(voxels) = detached(file) {
            // A file that is missing is told of by the reader.
            let _ = content(&voxels, &mut hash);
        }
    }
    Ok(hex(&hash.finalize()))
}

fn content(file: &Path, hash: &mut Sha256) -> io::Result<()> {
    let mut own = Sha256::new();
    io::copy(&mut File::open(file)?, &mut own)?;
    hash.update(own.finalize());
    Ok(())
}

/// The file with the voxels that a detached header (NRRD, MetaImage) names.
fn detached(header: &Path) -> Option<PathBuf> {
    let mut head = vec![];
    File::open(header).ok()?.take(1 << 16).read_to_end(&mut head).ok()?;
    let text = String::from_utf8_lossy(&head);
    let value = text.lines().find_map(|line| {
        let (key, value) = line.split_once([':', '='])?;
        let key = key.trim().to_lowercase().replace(' ', "");
        matches!(key.as_str(), "datafile" | "elementdatafile").then(|| value.trim())
    })?;
    let file = header.parent()?.join(value);
    fs::metadata(&file).is_ok_and(|m| m.is_file()).then_some(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_voxels_behind_the_same_header_are_another_case() {
        let dir = tempfile::tempdir().expect("folder");
        let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).expect("write");
        write("a.nhdr", "NRRD0004\ntype: uint8\ndata file: a.raw\n");
        write("a.mhd", "NDims = 3\nElementDataFile = a.raw\n");
        for header in ["a.nhdr", "a.mhd"] {
            let mark = || of(&Case::for_mask(dir.path().join(header)), Stage::Exports).expect("a hash");
            write("a.raw", "1");
            let first = mark();
            assert_eq!(first, mark(), "{header}");
            write("a.raw", "2");
            assert_ne!(first, mark(), "{header}");
        }
        let case = Case::for_mask(dir.path().join("a.nhdr"));
        assert_ne!(of(&case, Stage::Exports).expect("a hash"), of(&case, Stage::Surface).expect("a hash"));
    }
}
