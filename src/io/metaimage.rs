//! MetaImage: `.mha` with the voxels behind the header, `.mhd` with the voxels in a file of their own; raw, zlib, text.
//!
//! Source: the MetaIO documentation; as in ITK, each row of `TransformMatrix` is the direction of one image axis.

use std::io::{BufRead, Read};
use std::path::Path;

use super::Error;
use super::image::{Image, LengthUnit, count, grid, open, read_beside};
use super::scalars::{ByteOrder, Encoding, Layout, ScalarType, read_values};
use crate::geometry::Vector;

const HEADER_LIMIT: u64 = 1 << 20;

/// Reads a `.mha` or `.mhd` file with three axes of scalars (further axes must have one sample).
///
/// # Errors
/// See [`super::image::read`].
pub fn read(path: &Path) -> Result<Image, Error> {
    let (mut file, len) = open(path)?;
    let (fields, header_len) = header(path, &mut file)?;
    let header = Header { path, fields };
    let (dims, columns, spacing, origin) = header.geometry()?;
    let layout = header.layout(count(path, dims)?)?;
    let header_size = header.number("HeaderSize")?.unwrap_or(0i64);
    let values = match header.get(&["ElementDataFile"]).unwrap_or("LOCAL") {
        "LOCAL" | "Local" | "local" => read_values(path, file, len.saturating_sub(header_len), &layout)?,
        name if name.starts_with("LIST") || name.contains('%') => {
            return Err(Error::unsupported(path, "a list of data files", "save the image as one .mha file"));
        }
        name => read_beside(path, name, u64::try_from(header_size).ok(), 0, &layout)?,
    };
    let unit = header.get(&["DistanceUnits"]).and_then(LengthUnit::from_symbol);
    let grid = grid(path, dims, spacing, origin, columns, unit)?;
    let mut image = Image::new(grid, values, unit);
    if header.get(&["ElementSpacing", "ElementSize"]).is_none() {
        image.doubts.push("the header has no voxel size: 1 x 1 x 1 mm is taken".into());
    }
    Ok(image)
}

/// The `Key = value` lines up to `ElementDataFile`, which is the last, and their length.
fn header(path: &Path, file: &mut impl BufRead) -> Result<(Vec<(String, String)>, u64), Error> {
    let mut fields = Vec::new();
    let mut length = 0;
    let mut source = file.take(HEADER_LIMIT);
    loop {
        let mut line = Vec::new();
        let n = source.read_until(b'\n', &mut line).map_err(|e| Error::read(path, e))?;
        length += n as u64;
        let line = String::from_utf8_lossy(&line);
        let Some((key, value)) = line.split_once('=') else {
            if n > 0 && line.trim().is_empty() {
                continue;
            }
            return Err(Error::malformed(path, "the header does not end with \"ElementDataFile = ...\"", "give a MetaImage file"));
        };
        let (key, value) = (key.trim().to_owned(), value.trim().to_owned());
        let last = key == "ElementDataFile";
        fields.push((key, value));
        if last {
            return Ok((fields, length));
        }
    }
}

struct Header<'a> {
    path: &'a Path,
    fields: Vec<(String, String)>,
}

impl Header<'_> {
    /// Value of the first of these keys that the header has.
    fn get(&self, keys: &[&str]) -> Option<&str> {
        keys.iter().find_map(|k| self.fields.iter().find(|(key, _)| key == k)).map(|(_, v)| v.as_str())
    }

    fn bad(&self, key: &str, value: &str, want: &str) -> Error {
        Error::malformed(self.path, format!("header line \"{key} = {value}\" is wrong"), format!("it has to be {want}"))
    }

    fn number<T: std::str::FromStr>(&self, key: &str) -> Result<Option<T>, Error> {
        self.get(&[key]).map(|v| v.parse().map_err(|_| self.bad(key, v, "a number"))).transpose()
    }

    fn numbers<T: std::str::FromStr>(&self, keys: &[&str], n: usize) -> Result<Option<Vec<T>>, Error> {
        let Some(text) = self.get(keys) else { return Ok(None) };
        let all: Option<Vec<T>> = text.split_whitespace().map(|w| w.parse().ok()).collect();
        all.filter(|a| a.len() == n).map(Some).ok_or_else(|| self.bad(keys[0], text, &format!("{n} numbers")))
    }

    fn flag(&self, keys: &[&str]) -> bool {
        self.get(keys).is_some_and(|v| v.starts_with(['T', 't', '1']))
    }

    #[allow(clippy::type_complexity)]
    fn geometry(&self) -> Result<([usize; 3], [Vector; 3], [f64; 3], [f64; 3]), Error> {
        let n: usize = self.number("NDims")?.unwrap_or(3);
        let sizes: Vec<usize> = self.numbers(&["DimSize"], n)?.ok_or_else(|| {
            Error::malformed(self.path, "the header lacks \"DimSize\"", "export the image again")
        })?;
        if n < 3 || sizes[3..].iter().any(|&s| s != 1) {
            return Err(Error::unsupported(self.path, format!("an image with sizes {sizes:?}"), "save one scalar volume with three axes"));
        }
        let spacing = self.numbers(&["ElementSpacing", "ElementSize"], n)?.unwrap_or_else(|| vec![1.0; n]);
        let origin = self.numbers(&["Offset", "Position", "Origin"], n)?.unwrap_or_else(|| vec![0.0; n]);
        let matrix: Option<Vec<f64>> = self.numbers(&["TransformMatrix", "Rotation", "Orientation"], n * n)?;
        let columns = [0, 1, 2].map(|i| match &matrix {
            Some(m) => Vector::new(m[i * n], m[i * n + 1], m[i * n + 2]),
            None => Vector::ith(i, 1.0),
        });
        Ok(([0, 1, 2].map(|i| sizes[i]), columns, [0, 1, 2].map(|i| spacing[i]), [0, 1, 2].map(|i| origin[i])))
    }

    fn layout(&self, count: usize) -> Result<Layout, Error> {
        let name = self.get(&["ElementType"]).ok_or_else(|| {
            Error::malformed(self.path, "the header lacks \"ElementType\"", "export the image again")
        })?;
        let scalar = match name {
            "MET_CHAR" => ScalarType::I8,
            "MET_UCHAR" => ScalarType::U8,
            "MET_SHORT" => ScalarType::I16,
            "MET_USHORT" => ScalarType::U16,
            "MET_INT" | "MET_LONG" => ScalarType::I32,
            "MET_UINT" | "MET_ULONG" => ScalarType::U32,
            "MET_LONG_LONG" => ScalarType::I64,
            "MET_ULONG_LONG" => ScalarType::U64,
            "MET_FLOAT" => ScalarType::F32,
            "MET_DOUBLE" => ScalarType::F64,
            _ => return Err(Error::unsupported(self.path, format!("voxel type \"{name}\""), "save integers or floats of 8 to 64 bits")),
        };
        if let Some(channels) = self.number::<usize>("ElementNumberOfChannels")?.filter(|&c| c != 1) {
            return Err(Error::unsupported(self.path, format!("an image with {channels} values a voxel"), "save one scalar volume"));
        }
        let text = self.get(&["BinaryData"]).is_some_and(|v| v.starts_with(['F', 'f', '0']));
        let encoding = match (text, self.flag(&["CompressedData"])) {
            (true, _) => Encoding::Text,
            (false, true) => Encoding::Zlib,
            (false, false) => Encoding::Raw,
        };
        let order = if self.flag(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"]) { ByteOrder::Big } else { ByteOrder::Little };
        Ok(Layout { scalar, order, encoding, skip: 0, count })
    }
}
