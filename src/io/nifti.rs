//! NIfTI-1 and NIfTI-2 single files, plain or gzipped, either byte order.
//!
//! Sources: nifti1.h and nifti2.h. The header is read here and not by a crate, because NIfTI-2 has to be read too and
//! sizes have to be checked before memory is taken. NIfTI's world is RAS: x and y are negated to give LPS.

use std::io::{BufRead, BufReader};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion};

use super::Error;
use super::image::{Image, LengthUnit, Values, count, grid, open};
use super::scalars::{ByteOrder, Encoding, Layout, ScalarType, read_values};
use crate::geometry::Vector;
use crate::mask::{Grid, with_values, Scalar};

const AGAIN: &str = "the file is cut short or no NIfTI file: copy or export it again";

/// Relative difference of voxel sizes that rounding explains.
const SAME: f64 = 0.01;

/// Cosine of the angle between axes from which they differ: two degrees.
const COSINE: f64 = 0.999_39;

fn numbers(v: [f64; 3]) -> String {
    v.map(|x| crate::report::rounded(x)).join(" x ")
}

/// Reads a `.nii` or `.nii.gz` file with three axes of scalars (further axes must have one sample).
///
/// The sform places the voxels where its code is set and its axes are square to each other, else the qform,
/// else the spacing alone. `scl_slope` and `scl_inter` are applied.
///
/// # Errors
/// See [`super::image::read`].
pub fn read(path: &Path) -> Result<Image, Error> {
    let (mut file, len) = open(path)?;
    let zipped = file.fill_buf().map_err(|e| Error::read(path, e))?.starts_with(&[0x1f, 0x8b]);
    if zipped {
        // Deflate expands at most 1032-fold: what the compressed file can hold at most.
        read_stream(path, BufReader::with_capacity(1 << 16, MultiGzDecoder::new(file)), len.saturating_mul(1032), true)
    } else {
        read_stream(path, file, len, false)
    }
}

fn read_stream(path: &Path, mut source: impl BufRead, len: u64, zipped: bool) -> Result<Image, Error> {
    let broken = |e: std::io::Error| match (zipped, e.kind()) {
        (_, std::io::ErrorKind::UnexpectedEof) => Error::malformed(path, "the file ends within its header", AGAIN),
        (true, _) => Error::malformed(path, format!("the compressed file is damaged ({e})"), AGAIN),
        (false, _) => Error::read(path, e),
    };
    let mut bytes = vec![0; 348];
    source.read_exact(&mut bytes).map_err(broken)?;
    let size = [bytes[0], bytes[1], bytes[2], bytes[3]];
    let (order, two) = match (i32::from_le_bytes(size), i32::from_be_bytes(size)) {
        (348, _) => (ByteOrder::Little, false),
        (_, 348) => (ByteOrder::Big, false),
        (540, _) => (ByteOrder::Little, true),
        (_, 540) => (ByteOrder::Big, true),
        _ => return Err(Error::malformed(path, "the file does not begin with a NIfTI header", AGAIN)),
    };
    if two {
        bytes.resize(540, 0);
        source.read_exact(&mut bytes[348..]).map_err(broken)?;
    }
    let raw = Raw { bytes, order };
    let header = if two { Header::version_2(&raw) } else { Header::version_1(&raw) };
    header.into_image(path, source, len, raw.bytes.len() as u64, order)
}

/// Numbers at fixed places of the header.
struct Raw {
    bytes: Vec<u8>,
    order: ByteOrder,
}

impl Raw {
    fn at<const N: usize>(&self, offset: usize) -> [u8; N] {
        let mut b = [0; N];
        b.copy_from_slice(&self.bytes[offset..offset + N]);
        if self.order == ByteOrder::Big {
            b.reverse();
        }
        b
    }
    fn i16(&self, offset: usize) -> i16 {
        i16::from_le_bytes(self.at(offset))
    }
    fn i32(&self, offset: usize) -> i32 {
        i32::from_le_bytes(self.at(offset))
    }
    fn i64(&self, offset: usize) -> i64 {
        i64::from_le_bytes(self.at(offset))
    }
    fn f32(&self, offset: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.at(offset)))
    }
    fn f64(&self, offset: usize) -> f64 {
        f64::from_le_bytes(self.at(offset))
    }
}

struct Header {
    dim: [i64; 8],
    datatype: i16,
    pixdim: [f64; 8],
    vox_offset: f64,
    slope: f64,
    intercept: f64,
    units: i32,
    qform_code: i32,
    sform_code: i32,
    quaternion: [f64; 3],
    qoffset: [f64; 3],
    srow: [[f64; 4]; 3],
}

impl Header {
    fn version_1(raw: &Raw) -> Header {
        Header {
            dim: std::array::from_fn(|i| i64::from(raw.i16(40 + 2 * i))),
            datatype: raw.i16(70),
            pixdim: std::array::from_fn(|i| raw.f32(76 + 4 * i)),
            vox_offset: raw.f32(108),
            slope: raw.f32(112),
            intercept: raw.f32(116),
            units: i32::from(raw.bytes[123]),
            qform_code: i32::from(raw.i16(252)),
            sform_code: i32::from(raw.i16(254)),
            quaternion: std::array::from_fn(|i| raw.f32(256 + 4 * i)),
            qoffset: std::array::from_fn(|i| raw.f32(268 + 4 * i)),
            srow: std::array::from_fn(|r| std::array::from_fn(|c| raw.f32(280 + 16 * r + 4 * c))),
        }
    }

    fn version_2(raw: &Raw) -> Header {
        Header {
            dim: std::array::from_fn(|i| raw.i64(16 + 8 * i)),
            datatype: raw.i16(12),
            pixdim: std::array::from_fn(|i| raw.f64(104 + 8 * i)),
            vox_offset: raw.i64(168) as f64,
            slope: raw.f64(176),
            intercept: raw.f64(184),
            units: raw.i32(500),
            qform_code: raw.i32(344),
            sform_code: raw.i32(348),
            quaternion: std::array::from_fn(|i| raw.f64(352 + 8 * i)),
            qoffset: std::array::from_fn(|i| raw.f64(376 + 8 * i)),
            srow: std::array::from_fn(|r| std::array::from_fn(|c| raw.f64(400 + 32 * r + 8 * c))),
        }
    }

    fn into_image(self, path: &Path, source: impl BufRead, len: u64, header_len: u64, order: ByteOrder) -> Result<Image, Error> {
        let axes = self.dim[0];
        let sizes = self.dim.get(1..=usize::try_from(axes).unwrap_or(8)).ok_or_else(|| {
            Error::malformed(path, format!("the header announces {axes} axes"), AGAIN)
        })?;
        let three = sizes.len() >= 3 && sizes[3..].iter().all(|&s| s <= 1);
        if !three {
            return Err(Error::unsupported(path, format!("an image with sizes {sizes:?}"), "save one scalar volume with three axes"));
        }
        let dims = [0, 1, 2].map(|i| usize::try_from(sizes[i]).unwrap_or(0));
        let scalar = match self.datatype {
            2 => ScalarType::U8,
            4 => ScalarType::I16,
            8 => ScalarType::I32,
            16 => ScalarType::F32,
            64 => ScalarType::F64,
            256 => ScalarType::I8,
            512 => ScalarType::U16,
            768 => ScalarType::U32,
            1024 => ScalarType::I64,
            1280 => ScalarType::U64,
            t => return Err(Error::unsupported(path, format!("voxel type code {t}"), "save integers or floats of 8 to 64 bits")),
        };
        if !(self.vox_offset >= 0.0 && self.vox_offset < 1e15) {
            return Err(Error::malformed(path, format!("the voxels are said to begin at byte {}", self.vox_offset), AGAIN));
        }
        let skip = (self.vox_offset as u64).saturating_sub(header_len);
        let layout = Layout { scalar, order, encoding: Encoding::Raw, skip, count: count(path, dims)? };
        let (grid, unit, doubts) = self.place(path, dims)?;
        let values = read_values(path, source, len.saturating_sub(header_len), &layout)?;
        Ok(Image { doubts, ..Image::new(grid, self.scale(values), unit) })
    }

    /// The grid in LPS mm by sform, qform or spacing alone, and what they leave in doubt.
    fn place(&self, path: &Path, dims: [usize; 3]) -> Result<(Grid, Option<LengthUnit>, Vec<String>), Error> {
        let unit = match self.units & 7 {
            1 => Some(LengthUnit::Metre),
            2 => Some(LengthUnit::Millimetre),
            3 => Some(LengthUnit::Micrometre),
            _ => None,
        };
        let lps = Vector::new(-1.0, -1.0, 1.0);
        let build = |spacing: [f64; 3], columns: [Vector; 3], origin: Vector| {
            grid(path, dims, spacing, origin.component_mul(&lps).into(), columns.map(|c| c.component_mul(&lps)), unit)
        };
        let pixdim = [1, 2, 3].map(|i| self.pixdim[i].abs());
        let stated = pixdim.iter().all(|p| p.is_finite() && *p > 0.0);
        let mut doubts = Vec::new();
        let by_qform = || build(pixdim, self.quaternion_axes(), Vector::from(self.qoffset));
        let result = if self.sform_code > 0 {
            let columns = [0, 1, 2].map(|c| Vector::new(self.srow[0][c], self.srow[1][c], self.srow[2][c]));
            let lengths = columns.map(|c| c.norm());
            let origin = Vector::new(self.srow[0][3], self.srow[1][3], self.srow[2][3]);
            let same = |a: [f64; 3], b: [f64; 3]| (0..3).all(|i| (a[i] - b[i]).abs() <= SAME * a[i].max(b[i]));
            let directions = [0, 1, 2].map(|i| columns[i] / lengths[i]);
            let square = build(lengths, directions, origin).is_ok();
            let mut spacing = lengths;
            // The qform goes by pixdim: where it takes the place of an sform that is no grid there is nothing to compare.
            if stated && !same(lengths, pixdim) && (square || self.qform_code <= 0) {
                let (ours, theirs) = (numbers(lengths), numbers(pixdim));
                if same(lengths, [1.0; 3]) {
                    spacing = pixdim;
                    doubts.push(format!("the sform has directions and no voxel size: {theirs} of the header's pixdim are taken with them"));
                } else if pixdim == [1.0; 3] && self.qform_code <= 0 {
                    doubts.push(format!("the header's pixdim are 1 x 1 x 1 and its sform's voxels {ours}: the sform is taken"));
                } else {
                    let what = format!("the sform has voxels of {ours} and the header's pixdim are {theirs}: which holds is not plain");
                    return Err(Error::malformed(path, what, "write the image again with the right voxel size in both, for example with 3D Slicer or SimpleITK"));
                }
            }
            let by_sform = build(spacing, directions, origin);
            match (by_sform, by_qform()) {
                (Ok(s), Ok(q)) if self.qform_code > 0 => {
                    let turned = (0..3).any(|i| s.axes.column(i).normalize().dot(&q.axes.column(i).normalize()) < COSINE);
                    if turned || (s.origin - q.origin).norm() > s.voxel_diagonal() {
                        doubts.push("sform and qform place the image differently: the sform is taken; sizes are the same".into());
                    }
                    Ok(s)
                }
                (Err(_), Ok(q)) if self.qform_code > 0 => {
                    doubts.push("the sform's axes are not square to each other: the qform is taken".into());
                    Ok(q)
                }
                (by_sform, _) => by_sform,
            }
        } else if self.qform_code > 0 {
            by_qform()
        } else {
            build(pixdim, [Vector::x(), Vector::y(), Vector::z()], Vector::zeros())
        };
        result.map(|g| (g, unit, doubts))
    }

    fn quaternion_axes(&self) -> [Vector; 3] {
        let [b, c, d] = self.quaternion;
        let a2 = 1.0 - (b * b + c * c + d * d);
        // A half turn whose rounding leaves nothing for the real part.
        let q = if a2 < 1e-7 { Quaternion::new(0.0, b, c, d) } else { Quaternion::new(a2.sqrt(), b, c, d) };
        let r: Matrix3<f64> = UnitQuaternion::from_quaternion(q).to_rotation_matrix().into_inner();
        let qfac = if self.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        [r.column(0).into_owned(), r.column(1).into_owned(), r.column(2) * qfac]
    }

    /// Applies the header's slope and intercept where they say anything.
    fn scale(&self, values: Values) -> Values {
        let (slope, intercept) = (self.slope, self.intercept);
        let says = slope.is_finite() && slope != 0.0 && intercept.is_finite() && (slope, intercept) != (1.0, 0.0);
        if !says {
            return values;
        }
        Values::F64(with_values!(values, v => v.into_iter().map(|x| slope * x.to_f64() + intercept).collect()))
    }
}
