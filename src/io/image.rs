//! Pictures in any of the formats that are read here.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use nalgebra::Matrix3;

use super::scalars::{Layout, read_values};
use super::{Error, dicom, metaimage, nifti, nrrd, vti};
pub use crate::mask::{Image, LengthUnit, Values};
use crate::geometry::{Point, Vector};
use crate::mask::Grid;

/// Endings of the formats that [`read`] knows.
pub const FORMATS: &str = ".nrrd, .nhdr, .mha, .mhd, .nii, .nii.gz, .vti";

/// Reads a three-dimensional scalar picture; the ending of the name tells the format (see [`FORMATS`]).
///
/// Spacing, origin and direction are honoured; the grid is in LPS millimetres whatever the file uses.
///
/// # Errors
/// [`Error`] with the file, what is wrong and what to do. Sizes in headers are checked before memory is taken.
pub fn read(path: impl AsRef<Path>) -> Result<Image, Error> {
    let path = path.as_ref();
    if let Some(refusal) = dicom::refusal(path) {
        return Err(refusal);
    }
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let is = |endings: &[&str]| endings.iter().any(|e| name.ends_with(e));
    if is(&[".nrrd", ".nhdr"]) {
        nrrd::read(path)
    } else if is(&[".mha", ".mhd"]) {
        metaimage::read(path)
    } else if is(&[".nii", ".nii.gz"]) {
        nifti::read(path)
    } else if is(&[".vti"]) {
        vti::read(path)
    } else {
        Err(Error::UnknownFormat { path: path.into(), known: FORMATS })
    }
}

/// Opens `path` and tells its length.
pub(super) fn open(path: &Path) -> Result<(BufReader<File>, u64), Error> {
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let meta = file.metadata().map_err(|e| Error::read(path, e))?;
    if meta.is_dir() {
        return Err(Error::malformed(path, "this is a folder", "give the image file itself"));
    }
    Ok((BufReader::with_capacity(1 << 16, file), meta.len()))
}

/// The grid of a header: `columns` are the directions of the axes, `spacing` the steps along them.
pub(super) fn grid(
    path: &Path,
    dims: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    columns: [Vector; 3],
    unit: Option<LengthUnit>,
) -> Result<Grid, Error> {
    let mm = unit.unwrap_or_default().millimetres();
    let direction = Matrix3::from_columns(&columns);
    Grid::new(dims, spacing.map(|s| s * mm), Point::from(Vector::from(origin) * mm), direction)
        .map_err(|source| Error::Grid { path: path.into(), source })
}

/// Number of voxels, checked.
pub(super) fn count(path: &Path, dims: [usize; 3]) -> Result<usize, Error> {
    let n = dims.iter().try_fold(1usize, |a, &n| a.checked_mul(n)).filter(|&n| n > 0 && n <= isize::MAX as usize / 16);
    n.ok_or_else(|| Error::Grid { path: path.into(), source: crate::mask::GridError::Dimensions(dims) })
}

/// Reads the voxels of a header from a data file of their own. `offset` counts bytes from the start; `None`: the voxels end the file.
pub(super) fn read_beside(header: &Path, name: &str, offset: Option<u64>, lines: u64, layout: &Layout) -> Result<Values, Error> {
    use std::io::{BufRead, Seek, SeekFrom};
    let path: PathBuf = header.parent().unwrap_or(Path::new("")).join(name);
    let (mut file, len) = open(&path).map_err(|e| match e {
        Error::Read { source, .. } => Error::DataFile { path: header.into(), data: name.into(), source },
        other => other,
    })?;
    let mut at = 0;
    for _ in 0..lines {
        let n = file.skip_until(b'\n').map_err(|e| Error::read(&path, e))?;
        if n == 0 {
            break;
        }
        at += n as u64;
    }
    let at = match offset {
        Some(o) => at.saturating_add(o),
        None => len.saturating_sub((layout.count as u64).saturating_mul(layout.scalar.size() as u64)),
    };
    file.seek(SeekFrom::Start(at.min(len))).map_err(|e| Error::read(&path, e))?;
    read_values(&path, file, len.saturating_sub(at), layout)
}

#[cfg(test)]
#[path = "image_tests.rs"]
mod tests;
