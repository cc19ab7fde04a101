//! VTK's XML image files (`.vti`): text, inline base64 and appended data, plain or zlib-compressed.
//!
//! Source: the VTK file formats guide. The file's coordinates are taken as LPS millimetres. Read here and not through a
//! crate because of appended raw data, the `Direction` attribute, and sizes that are checked before memory is taken.

use std::io::{Cursor, Read};
use std::path::Path;

use flate2::read::ZlibDecoder;

use super::Error;
use super::image::{Image, Values, count, grid, open};
use super::scalars::{ByteOrder, Encoding, Layout, ScalarType, read_values};
use crate::geometry::Vector;

const AGAIN: &str = "write the image again, for example with VTK or ParaView";

/// Reads a `.vti` file with one piece: the active or first scalar array of its points, else of its cells.
///
/// # Errors
/// See [`super::image::read`].
pub fn read(path: &Path) -> Result<Image, Error> {
    let (mut file, len) = open(path)?;
    let mut bytes = Vec::with_capacity(usize::try_from(len).unwrap_or(0));
    file.read_to_end(&mut bytes).map_err(|e| Error::read(path, e))?;
    Document { path, bytes: &bytes }.image()
}

struct Document<'a> {
    path: &'a Path,
    bytes: &'a [u8],
}

/// An opening tag: its name, its attributes as text, and where its content begins.
struct Tag<'a> {
    name: &'a str,
    attributes: &'a str,
    end: usize,
}

impl Tag<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        let mut rest = self.attributes;
        while let Some((name, after)) = rest.split_once('=') {
            let after = after.trim_start();
            let quote = after.chars().next().filter(|q| matches!(q, '"' | '\''))?;
            let (value, next) = after[1..].split_once(quote)?;
            if name.trim() == key {
                return Some(value);
            }
            rest = next;
        }
        None
    }

    fn numbers<T: std::str::FromStr, const N: usize>(&self, key: &str) -> Option<[T; N]> {
        let all: Option<Vec<T>> = self.get(key)?.split_whitespace().map(|w| w.parse().ok()).collect();
        all?.try_into().ok()
    }
}

impl<'a> Document<'a> {
    /// The next opening tag from `at` on.
    fn tag(&self, mut at: usize) -> Option<Tag<'a>> {
        loop {
            at += self.bytes.get(at..)?.iter().position(|&b| b == b'<')?;
            let end = at + self.bytes[at..].iter().position(|&b| b == b'>')?;
            let text = std::str::from_utf8(&self.bytes[at + 1..end]).ok()?;
            if !text.starts_with(['/', '?', '!']) {
                let text = text.trim_end_matches('/');
                let (name, attributes) = text.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((text, ""));
                return Some(Tag { name, attributes, end: end + 1 });
            }
            at = end + 1;
        }
    }

    fn bad(&self, what: &str) -> Error {
        Error::malformed(self.path, what, AGAIN)
    }

    fn image(&self) -> Result<Image, Error> {
        let root = self.tag(0).filter(|t| t.name == "VTKFile").ok_or_else(|| self.bad("the file does not begin with <VTKFile>"))?;
        if root.get("type") != Some("ImageData") {
            return Err(self.bad("the file holds no ImageData"));
        }
        let order = if root.get("byte_order") == Some("BigEndian") { ByteOrder::Big } else { ByteOrder::Little };
        let wide = root.get("header_type") == Some("UInt64");
        let compressed = match root.get("compressor") {
            None => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => return Err(Error::unsupported(self.path, format!("compressor {other}"), "write the file with zlib compression or none")),
        };
        let image = self.tag(root.end).filter(|t| t.name == "ImageData").ok_or_else(|| self.bad("<ImageData> is missing"))?;
        let extent: [i64; 6] = image.numbers("WholeExtent").ok_or_else(|| self.bad("WholeExtent does not hold six whole numbers"))?;
        let (array, on_cells, appended) = self.arrays(image.end, extent)?;
        let scalar = match array.get("type").unwrap_or("") {
            "UInt8" => ScalarType::U8,
            "Int8" => ScalarType::I8,
            "UInt16" => ScalarType::U16,
            "Int16" => ScalarType::I16,
            "UInt32" => ScalarType::U32,
            "Int32" => ScalarType::I32,
            "UInt64" => ScalarType::U64,
            "Int64" => ScalarType::I64,
            "Float32" => ScalarType::F32,
            "Float64" => ScalarType::F64,
            other => return Err(Error::unsupported(self.path, format!("voxel type \"{other}\""), "save integers or floats of 8 to 64 bits")),
        };

        let dims = [0, 1, 2].map(|a| {
            let points = extent[2 * a + 1].saturating_sub(extent[2 * a]).saturating_add(1);
            usize::try_from(points - i64::from(on_cells)).unwrap_or(0)
        });
        let numbers = |key: &str, default: [f64; 3]| match image.get(key) {
            Some(_) => image.numbers(key).ok_or_else(|| self.bad(&format!("{key} does not hold three numbers"))),
            None => Ok(default),
        };
        let (spacing, origin) = (numbers("Spacing", [1.0; 3])?, numbers("Origin", [0.0; 3])?);
        let rows: [f64; 9] = match image.get("Direction") {
            Some(_) => image.numbers("Direction").ok_or_else(|| self.bad("Direction does not hold nine numbers"))?,
            None => [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        };
        let columns = [0, 1, 2].map(|c| Vector::new(rows[c], rows[3 + c], rows[6 + c]));
        // The extent may begin away from 0, and the middle of a cell is half a step on.
        let half = if on_cells { 0.5 } else { 0.0 };
        let first = (0..3).fold(Vector::from(origin), |o, a| o + columns[a] * spacing[a] * (extent[2 * a] as f64 + half));
        let grid = grid(self.path, dims, spacing, first.into(), columns, None)?;
        let layout = Layout { scalar, order, encoding: Encoding::Raw, skip: 0, count: count(self.path, dims)? };
        let mut read = Image::new(grid, self.values(&array, appended, layout, wide, compressed)?, None);
        if image.get("Spacing").is_none() {
            read.doubts.push("the header has no voxel size: 1 x 1 x 1 mm is taken".into());
        }
        Ok(read)
    }

    /// The scalar array to read, whether it lies on cells, and where appended data begin.
    fn arrays(&self, mut at: usize, extent: [i64; 6]) -> Result<(Tag<'a>, bool, Option<(usize, bool)>), Error> {
        let mut found: Option<(Tag<'a>, bool)> = None;
        let (mut on_cells, mut active, mut appended) = (None, None, None);
        while let Some(tag) = self.tag(at) {
            at = tag.end;
            match tag.name {
                "Piece" if tag.numbers("Extent") != Some(extent) => {
                    return Err(Error::unsupported(self.path, "an image in several pieces", "write it as one piece"));
                }
                "PointData" | "CellData" => {
                    on_cells = Some(tag.name == "CellData");
                    active = tag.get("Scalars").map(str::to_owned);
                }
                "DataArray" if tag.get("NumberOfComponents").is_none_or(|n| n.trim() == "1") => {
                    let Some(cells) = on_cells else { continue };
                    let is_active = active.as_deref().is_some_and(|a| tag.get("Name") == Some(a));
                    // The active array of the points, then any of the points, then of the cells.
                    let better = match &found {
                        None => true,
                        Some((_, cells_before)) => (is_active && *cells_before == cells) || (*cells_before && !cells),
                    };
                    if better {
                        found = Some((tag, cells));
                    }
                }
                "AppendedData" => {
                    let raw = tag.get("encoding") != Some("base64");
                    let mark = self.bytes[at..].iter().position(|&b| b == b'_').ok_or_else(|| self.bad("the appended data lack their \"_\""))?;
                    appended = Some((at + mark + 1, raw));
                    break;
                }
                _ => {}
            }
        }
        let (array, cells) = found.ok_or_else(|| self.bad("the image has no array with one value a voxel"))?;
        Ok((array, cells, appended))
    }

    fn values(&self, array: &Tag, appended: Option<(usize, bool)>, mut layout: Layout, wide: bool, compressed: bool) -> Result<Values, Error> {
        let after = &self.bytes[array.end..];
        let inline = &after[..after.iter().position(|&b| b == b'<').unwrap_or(after.len())];
        let raw;
        let stored = match array.get("format") {
            Some("ascii") => {
                layout.encoding = Encoding::Text;
                return read_values(self.path, Cursor::new(inline), inline.len() as u64, &layout);
            }
            Some("binary") => {
                raw = false;
                inline
            }
            Some("appended") => {
                let (start, is_raw) = appended.ok_or_else(|| self.bad("the appended data are missing"))?;
                let offset: usize = array.get("offset").and_then(|o| o.parse().ok()).ok_or_else(|| self.bad("an array's offset is wrong"))?;
                raw = is_raw;
                start.checked_add(offset).and_then(|s| self.bytes.get(s..)).ok_or_else(|| self.bad("an array's offset lies behind the file's end"))?
            }
            _ => return Err(self.bad("an array's format is neither ascii, binary nor appended")),
        };
        let mut stream: Box<dyn Read + '_> = if raw { Box::new(stored) } else { Box::new(Base64 { source: stored, group: [0; 3], left: 0 }) };
        let cut = |_| Error::malformed(self.path, "the voxel data end early", AGAIN);
        let mut number = || -> Result<u64, Error> {
            let mut b = [0; 8];
            let b = &mut b[..if wide { 8 } else { 4 }];
            stream.read_exact(b).map_err(cut)?;
            if layout.order == ByteOrder::Little {
                b.reverse();
            }
            Ok(b.iter().fold(0, |n, &x| n << 8 | u64::from(x)))
        };
        let blocks = number()?;
        if !compressed {
            let left = (stored.len() as u64).min(blocks);
            return read_values(self.path, std::io::BufReader::new(stream), left, &layout);
        }
        let (_, _) = (number()?, number()?);
        if blocks > stored.len() as u64 {
            return Err(self.bad("there are more compressed blocks than the file can hold"));
        }
        let sizes: Vec<u64> = (0..blocks).map(|_| number()).collect::<Result<_, _>>()?;
        let needed = (layout.count as u64).saturating_mul(layout.scalar.size() as u64);
        let mut voxels = Vec::new();
        for size in sizes {
            let room = needed.saturating_sub(voxels.len() as u64);
            let mut block = (&mut stream).take(size);
            ZlibDecoder::new(&mut block).take(room).read_to_end(&mut voxels).map_err(|e| self.bad(&format!("the compressed voxels are damaged ({e})")))?;
            std::io::copy(&mut block, &mut std::io::sink()).map_err(cut)?;
        }
        let stored = voxels.len() as u64;
        read_values(self.path, Cursor::new(voxels), stored, &layout)
    }
}

/// Base64 in groups of four, each of which may be padded: VTK puts several padded parts behind each other.
struct Base64<'a> {
    source: &'a [u8],
    group: [u8; 3],
    /// Bytes of the group that were not given out yet; they stand at its end.
    left: usize,
}

impl Read for Base64<'_> {
    fn read(&mut self, buf: &mut [u8]) -> std::io::Result<usize> {
        let mut n = 0;
        while n < buf.len() {
            if self.left == 0 && !self.next_group()? {
                break;
            }
            buf[n] = self.group[3 - self.left];
            self.left -= 1;
            n += 1;
        }
        Ok(n)
    }
}

impl Base64<'_> {
    fn next_group(&mut self) -> std::io::Result<bool> {
        let (mut bits, mut digits, mut padding) = (0u32, 0, 0);
        while digits < 4 {
            let Some((&c, rest)) = self.source.split_first() else { break };
            let value = match c {
                b'A'..=b'Z' => c - b'A',
                b'a'..=b'z' => c - b'a' + 26,
                b'0'..=b'9' => c - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                b'=' => {
                    padding += 1;
                    0
                }
                c if c.is_ascii_whitespace() => {
                    self.source = rest;
                    continue;
                }
                // What follows the encoded data: the next tag.
                _ => break,
            };
            self.source = rest;
            bits = bits << 6 | u32::from(value);
            digits += 1;
        }
        match (digits, padding) {
            (0, _) => Ok(false),
            (4, 0..=2) => {
                let [_, a, b, c] = bits.to_be_bytes();
                self.left = 3 - padding;
                // The bytes stand at the end of the group.
                self.group = match padding {
                    0 => [a, b, c],
                    1 => [0, a, b],
                    _ => [0, 0, a],
                };
                Ok(true)
            }
            _ => Err(std::io::Error::new(std::io::ErrorKind::InvalidData, "the base64 text is damaged")),
        }
    }
}
