//! NRRD: attached and detached headers, raw, gzip, bzip2, text and hex data; masks are written with gzip.
//!
//! Source: the NRRD format definition (teem). Worlds right/left-anterior-superior are turned to LPS as ITK does.

use std::collections::BTreeMap;
use std::io::{BufRead, Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::Error;
use super::image::{Image, LengthUnit, count, grid, open, read_beside};
use super::segments;
use super::scalars::{ByteOrder, Encoding, Layout, ScalarType, read_values};
use crate::geometry::Vector;
use crate::mask::Mask;

const HEADER_LIMIT: u64 = 1 << 20;

/// Reads a `.nrrd` or `.nhdr` file with three axes of scalars (axes of one sample are left out), and the segments and
/// layers of a `.seg.nrrd` file.
///
/// # Errors
/// See [`super::image::read`].
pub fn read(path: &Path) -> Result<Image, Error> {
    let (mut file, len) = open(path)?;
    let (fields, pairs, header_len) = header(path, &mut file)?;
    let segments = segments::named(&pairs);
    let header = Header::parse(path, &fields, !segments.is_empty())?;
    let values = match &header.data_file {
        None => {
            let mut at = header_len;
            for _ in 0..header.line_skip {
                let n = file.skip_until(b'\n').map_err(|e| Error::read(path, e))?;
                // The file may end long before the number of lines that its header announces.
                if n == 0 {
                    break;
                }
                at += n as u64;
            }
            let mut layout = header.layout;
            if header.from_end {
                let size = (layout.count as u64).saturating_mul(layout.scalar.size() as u64);
                layout.skip = len.saturating_sub(at).saturating_sub(size);
            }
            read_values(path, file, len.saturating_sub(at), &layout)?
        }
        Some(name) => read_beside(path, name, (!header.from_end).then_some(0), header.line_skip, &header.layout)?,
    };
    let grid = grid(path, header.dims, header.spacing, header.origin, header.columns, header.unit)?;
    let mut layers = segments::layers(values, header.layers, header.stride).into_iter();
    let first = layers.next().ok_or_else(|| Error::malformed(path, "the image has no layer", "export the image again"))?;
    let mut image = Image::new(grid, first, header.unit);
    image.layers = layers.collect();
    image.segments = segments;
    let lost = image.segments.iter().filter(|s| image.layer(s.layer).is_none());
    image.doubts = lost.map(|s| format!("the segment `{}` lies in layer {}, which the file lacks: it is left out", s.name, s.layer)).collect();
    if fields.get("spacedirections").or(fields.get("spacings")).is_none() {
        image.doubts.push("the header has no voxel size: 1 x 1 x 1 mm is taken".into());
    }
    Ok(image)
}

type Lines = BTreeMap<String, String>;

/// The `field: value` lines up to the blank line, keys in lower case without spaces; the `key:=value` lines as they stand;
/// and the length of the header.
fn header(path: &Path, file: &mut impl BufRead) -> Result<(Lines, Lines, u64), Error> {
    let (mut fields, mut pairs) = (Lines::new(), Lines::new());
    let mut length = 0;
    let mut source = file.take(HEADER_LIMIT);
    loop {
        let mut line = Vec::new();
        let n = source.read_until(b'\n', &mut line).map_err(|e| Error::read(path, e))?;
        let at_start = length == 0;
        length += n as u64;
        let line = String::from_utf8_lossy(&line);
        let line = line.trim_end();
        if at_start && !line.starts_with("NRRD0") {
            return Err(Error::malformed(path, "the file does not begin with \"NRRD0\"", "give a NRRD file"));
        }
        if n == 0 && length >= HEADER_LIMIT {
            return Err(Error::malformed(path, "the header does not end within 1 MiB", "give a NRRD file"));
        }
        if n == 0 || (line.is_empty() && !at_start) {
            return Ok((fields, pairs, length));
        }
        if line.starts_with('#') || at_start {
            continue;
        }
        // `key:=value` pairs are for programs of their own, such as Slicer's segments; `field: value` is the format's.
        if let Some((key, value)) = line.split_once(":=").filter(|(k, _)| !k.contains(':')) {
            pairs.insert(key.trim().to_owned(), value.to_owned());
        } else if let Some((key, value)) = line.split_once(':') {
            let key = key.to_lowercase().replace(' ', "");
            let value = value.trim().to_owned();
            if key == "datafile" && value.to_uppercase().starts_with("LIST") {
                return Err(Error::unsupported(path, "a list of data files", "save the image as one file"));
            }
            fields.insert(key, value);
        }
    }
}

struct Header {
    dims: [usize; 3],
    spacing: [f64; 3],
    origin: [f64; 3],
    columns: [Vector; 3],
    unit: Option<LengthUnit>,
    layout: Layout,
    line_skip: u64,
    from_end: bool,
    data_file: Option<String>,
    /// Layers of a segmentation, and the values that run faster than their axis.
    layers: usize,
    stride: usize,
}

impl Header {
    fn parse(path: &Path, fields: &Lines, segmented: bool) -> Result<Header, Error> {
        let get = |key: &str| fields.get(key).map(String::as_str);
        let bad = |key: &str, value: &str, want: &str| {
            Error::malformed(path, format!("header field \"{key}: {value}\" is wrong"), format!("it has to be {want}"))
        };
        let need = |key: &str| {
            get(key).ok_or_else(|| Error::malformed(path, format!("the header lacks the field \"{key}\""), "export the image again"))
        };
        let sizes_text = need("sizes")?;
        let sizes: Vec<usize> = words(sizes_text).ok_or_else(|| bad("sizes", sizes_text, "whole numbers"))?;
        let dimension = need("dimension")?;
        if dimension.parse() != Ok(sizes.len()) {
            return Err(bad("dimension", dimension, "the number of sizes"));
        }
        let vectors = get("spacedirections")
            .map(|t| vectors(t).filter(|v| v.len() == sizes.len()).ok_or_else(|| bad("space directions", t, "one vector or none for each axis")))
            .transpose()?;
        // Axes with one sample that are not in space (a single channel, a single time) are left out.
        let mut axes: Vec<usize> = (0..sizes.len()).collect();
        if axes.len() > 3 {
            let spatial = |a: usize| vectors.as_ref().is_none_or(|v| v[a].is_some());
            axes.retain(|&a| sizes[a] != 1 || (vectors.is_some() && spatial(a)));
        }
        // Segments that overlap lie in layers, which are an axis outside space.
        let outside = |a: &usize| vectors.as_ref().is_some_and(|v| v[*a].is_none());
        let layered = axes.iter().copied().find(|a| segmented && axes.len() == 4 && outside(a) && sizes[*a] > 0);
        axes.retain(|a| Some(*a) != layered);
        let layers = layered.map_or(1, |a| sizes[a]);
        let axes: [usize; 3] = axes.try_into().map_err(|_| {
            Error::unsupported(path, format!("an image with sizes {sizes:?}"), "save one scalar volume with three axes")
        })?;
        let dims = axes.map(|a| sizes[a]);
        let voxels = count(path, dims)?;
        let stride = layered.map_or(voxels, |a| sizes[..a].iter().product());
        let all = voxels.checked_mul(layers).filter(|&n| n <= isize::MAX as usize / 16);
        let all = all.ok_or_else(|| Error::malformed(path, "the header announces more voxels than any file holds", "export the image again"))?;

        let unit = space_unit(get("spaceunits"));
        let (spacing, columns) = match &vectors {
            Some(v) => {
                let mut columns = [Vector::zeros(); 3];
                for (c, &a) in columns.iter_mut().zip(&axes) {
                    *c = v[a].ok_or_else(|| {
                        Error::unsupported(path, format!("axis {a} of {} samples outside space", sizes[a]), "save one scalar volume with three axes")
                    })?;
                }
                let spacing = columns.map(|c| c.norm());
                (spacing, [0, 1, 2].map(|i| columns[i] / spacing[i]))
            }
            None => {
                let spacing = match get("spacings") {
                    Some(t) => {
                        let all: Vec<f64> = words(t).filter(|v: &Vec<f64>| v.len() == sizes.len()).ok_or_else(|| bad("spacings", t, "one number for each axis"))?;
                        axes.map(|a| all[a])
                    }
                    None => [1.0; 3],
                };
                (spacing, [Vector::x(), Vector::y(), Vector::z()])
            }
        };
        let origin = match get("spaceorigin") {
            Some(t) => vectors_of_origin(t).ok_or_else(|| bad("space origin", t, "a vector (x,y,z)"))?,
            None => [0.0; 3],
        };
        let flip = to_lps(get("space")).ok_or_else(|| bad("space", get("space").unwrap_or(""), "left-posterior-superior, right-anterior-superior or left-anterior-superior"))?;
        let columns = columns.map(|c| c.component_mul(&flip));
        let origin = [0, 1, 2].map(|i| origin[i] * flip[i]);

        let type_text = need("type")?;
        let scalar = scalar_type(type_text)
            .ok_or_else(|| Error::unsupported(path, format!("voxel type \"{type_text}\""), "save integers or floats of 8 to 64 bits"))?;
        let encoding_text = need("encoding")?;
        let encoding = match encoding_text.to_lowercase().as_str() {
            "raw" => Encoding::Raw,
            "gzip" | "gz" => Encoding::Gzip,
            "bzip2" | "bz2" => Encoding::Bzip2,
            "txt" | "text" | "ascii" => Encoding::Text,
            "hex" => Encoding::Hex,
            _ => return Err(Error::unsupported(path, format!("encoding \"{encoding_text}\""), "save with encoding gzip")),
        };
        let order = match get("endian") {
            Some(t) if t.eq_ignore_ascii_case("big") => ByteOrder::Big,
            Some(t) if t.eq_ignore_ascii_case("little") => ByteOrder::Little,
            Some(t) => return Err(bad("endian", t, "little or big")),
            None if scalar.size() > 1 && !matches!(encoding, Encoding::Text) => {
                return Err(Error::malformed(path, "the header lacks the field \"endian\"", "add \"endian: little\" or \"endian: big\""));
            }
            None => ByteOrder::Little,
        };
        let line_text = get("lineskip").unwrap_or("0");
        let line_skip = line_text.parse().map_err(|_| bad("line skip", line_text, "a whole number"))?;
        let skip_text = get("byteskip").unwrap_or("0");
        let skip: i64 = skip_text.parse().ok().filter(|&s| s >= -1).ok_or_else(|| bad("byte skip", skip_text, "a whole number or -1"))?;
        let from_end = skip == -1 && encoding == Encoding::Raw;
        let layout = Layout { scalar, order, encoding, skip: skip.max(0) as u64, count: all };
        Ok(Header { dims, spacing, origin, columns, unit, layout, line_skip, from_end, data_file: get("datafile").map(str::to_owned), layers, stride })
    }
}

fn words<T: std::str::FromStr>(text: &str) -> Option<Vec<T>> {
    text.split_whitespace().map(|w| w.parse().ok()).collect()
}

/// `(1,0,0) none (0,1,0)` as vectors of three.
fn vectors(text: &str) -> Option<Vec<Option<Vector>>> {
    let mut out = Vec::new();
    let mut rest = text.trim_start();
    while !rest.is_empty() {
        if let Some(r) = rest.strip_prefix("none") {
            out.push(None);
            rest = r.trim_start();
        } else {
            let (inside, r) = rest.strip_prefix('(')?.split_once(')')?;
            let numbers: Option<Vec<f64>> = inside.split(',').map(|w| w.trim().parse().ok()).collect();
            let numbers: [f64; 3] = numbers?.try_into().ok()?;
            out.push(Some(Vector::from(numbers)));
            rest = r.trim_start();
        }
    }
    Some(out)
}

fn vectors_of_origin(text: &str) -> Option<[f64; 3]> {
    match vectors(text)?.as_slice() {
        [Some(v)] => Some((*v).into()),
        _ => None,
    }
}

/// Signs that turn a space into LPS; a file without a named space is taken as it stands.
fn to_lps(space: Option<&str>) -> Option<Vector> {
    let Some(space) = space else { return Some(Vector::repeat(1.0)) };
    match space.to_lowercase().replace('_', "-").as_str() {
        "left-posterior-superior" | "lps" => Some(Vector::repeat(1.0)),
        "right-anterior-superior" | "ras" => Some(Vector::new(-1.0, -1.0, 1.0)),
        "left-anterior-superior" | "las" => Some(Vector::new(1.0, -1.0, 1.0)),
        "scanner-xyz" | "3d-right-handed" | "3d-left-handed" => Some(Vector::repeat(1.0)),
        _ => None,
    }
}

fn space_unit(text: Option<&str>) -> Option<LengthUnit> {
    let units: Vec<Option<LengthUnit>> = text?.split(['"', ' ']).filter(|w| !w.is_empty()).map(LengthUnit::from_symbol).collect();
    let first = *units.first()?;
    units.iter().all(|u| *u == first).then_some(first)?
}

fn scalar_type(name: &str) -> Option<ScalarType> {
    Some(match name.to_lowercase().as_str() {
        "signed char" | "int8" | "int8_t" => ScalarType::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => ScalarType::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => ScalarType::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => ScalarType::U16,
        "int" | "signed int" | "int32" | "int32_t" => ScalarType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => ScalarType::U32,
        "longlong" | "long long" | "long long int" | "signed long long" | "signed long long int" | "int64" | "int64_t" => ScalarType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => ScalarType::U64,
        "float" => ScalarType::F32,
        "double" => ScalarType::F64,
        _ => return None,
    })
}

/// Writes a mask as NRRD: attached header, unsigned char, gzip, LPS. The same mask gives the same bytes.
///
/// # Errors
/// [`Error::Write`] with what the system says.
pub fn write_mask(path: &Path, mask: &Mask) -> Result<(), Error> {
    let failed = |e| Error::write(path, e);
    let file = std::fs::File::create(path).map_err(failed)?;
    let mut out = std::io::BufWriter::new(file);
    let [nx, ny, nz] = mask.grid.dims;
    let vector = |v: [f64; 3]| format!("({},{},{})", v[0], v[1], v[2]);
    let [a, b, c] = [0, 1, 2].map(|i| vector(mask.grid.axes.column(i).into_owned().into()));
    let origin = vector(mask.grid.origin.into());
    write!(
        out,
        "NRRD0004\n# lumen 1, background 0\ntype: unsigned char\ndimension: 3\nspace: left-posterior-superior\nsizes: {nx} {ny} {nz}\nspace directions: {a} {b} {c}\nkinds: domain domain domain\nencoding: gzip\nspace origin: {origin}\n\n"
    )
    .map_err(failed)?;
    let mut gzip = GzEncoder::new(out, Compression::new(6));
    gzip.write_all(&mask.data).map_err(failed)?;
    gzip.finish().and_then(|mut o| o.flush()).map_err(failed)
}
