//! DICOM is recognised, so that the way to a mask can be told.

use std::io::Read;
use std::path::Path;

use super::Error;

/// Files of a folder that are looked at.
const LOOKED_AT: usize = 40;

/// Bytes at the beginning that hold the kind of object.
const HEAD: u64 = 4096;

/// The refusal of a DICOM file, or of a folder that holds some; `None` for anything else.
pub(super) fn refusal(path: &Path) -> Option<Error> {
    let (what, head) = if path.is_dir() {
        let files = std::fs::read_dir(path).ok()?.flatten().map(|e| e.path()).filter(|p| p.is_file()).take(LOOKED_AT);
        ("a folder of DICOM files", files.filter_map(|p| head(&p)).next()?)
    } else {
        ("a DICOM file", head(path)?)
    };
    let holds = |uid: &str| head.windows(uid.len()).any(|w| w == uid.as_bytes());
    let way = if holds("1.2.840.10008.5.1.4.1.1.66.4") {
        "it is a segmentation: write it as NIfTI or NRRD with dcmqi (`segimage2itkimage --inputDICOM FILE --outputDirectory OUT -t nii`) or 3D Slicer (DICOM module, then Save as .seg.nrrd)"
    } else if holds("1.2.840.10008.5.1.4.1.1.481.3") {
        "it holds contours (RT Structure Set): load it in 3D Slicer with SlicerRT and save the segmentation as .seg.nrrd"
    } else {
        "it holds images: segment the vessel, for example in 3D Slicer, and save the mask as .nrrd; SimpleITK (`ImageSeriesReader`) and dcm2niix convert a series to .nrrd or .nii.gz, a segmentation by dcmqi"
    };
    Some(Error::unsupported(path, what, way))
}

/// The beginning of a DICOM file, which has `DICM` behind 128 bytes.
fn head(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    std::fs::File::open(path).ok()?.take(HEAD).read_to_end(&mut bytes).ok()?;
    (bytes.get(128..132) == Some(b"DICM")).then_some(bytes)
}
