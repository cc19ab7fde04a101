//! Reader of VTK's XML files: ASCII, inline base64 and appended (raw or base64), plain or zlib, as ParaView writes.

use std::io::Read;

use super::mesh::{AnyMesh, fan, with_boundary};
use super::surface_reader::kind_of;
use crate::geometry::Point;
use crate::mesh::{Patch, TriMesh, VolumeMesh, WALL};

/// One tag: name, attributes, and where its content starts.
struct Tag<'a> {
    name: &'a str,
    text: &'a str,
    end: usize,
}

fn attribute<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let mut rest = text;
    loop {
        let at = rest.find(name)?;
        let after = rest[at + name.len()..].trim_start();
        let before = rest[..at].chars().last().is_some_and(char::is_whitespace);
        if before && let Some(v) = after.strip_prefix('=') {
            let v = v.trim_start();
            let quote = v.chars().next().filter(|c| *c == '"' || *c == '\'')?;
            return v[1..].split(quote).next();
        }
        rest = &rest[at + name.len()..];
    }
}

struct File<'a> {
    bytes: &'a [u8],
    tags: Vec<Tag<'a>>,
    wide: bool,
    compressed: bool,
    /// The appended bytes, already decoded from base64 where `None`.
    appended: Option<(&'a [u8], bool)>,
}

impl<'a> File<'a> {
    fn parse(bytes: &'a [u8]) -> Result<File<'a>, String> {
        // The XML ends where raw data starts.
        let mark = b"<AppendedData";
        let xml_end = bytes.windows(mark.len()).position(|w| w == mark);
        let xml = std::str::from_utf8(&bytes[..xml_end.unwrap_or(bytes.len())]).map_err(|_| "the XML is not UTF-8")?;
        let mut tags = vec![];
        let mut at = 0;
        while let Some(open) = xml[at..].find('<') {
            let start = at + open + 1;
            if xml[start..].starts_with("!--") {
                at = xml[start..].find("-->").map(|i| start + i + 3).ok_or("a comment without end")?;
                continue;
            }
            let close = xml[start..].find('>').ok_or("a tag without end")?;
            let text = &xml[start..start + close];
            let name = text.split(|c: char| c.is_whitespace() || c == '/').next().unwrap_or_default();
            tags.push(Tag { name, text, end: start + close + 1 });
            at = start + close + 1;
        }
        let root = tags.iter().find(|t| t.name == "VTKFile").ok_or("no VTKFile element: not a VTK XML file")?;
        if attribute(root.text, "byte_order") == Some("BigEndian") {
            return Err("big-endian data".into());
        }
        let compressor = attribute(root.text, "compressor").filter(|c| !c.is_empty());
        if compressor.is_some_and(|c| c != "vtkZLibDataCompressor") {
            return Err(format!("compressor {}", compressor.unwrap_or_default()));
        }
        let wide = attribute(root.text, "header_type") == Some("UInt64");
        let mut appended = None;
        if let Some(e) = xml_end {
            let rest = &bytes[e..];
            let close = rest.iter().position(|&b| b == b'>').ok_or("AppendedData is cut off")?;
            let raw = rest[..close].windows(3).any(|w| w == b"raw");
            let from = rest[close..].iter().position(|&b| b == b'_').ok_or("no _ before the appended data")?;
            appended = Some((&rest[close + from + 1..], raw));
        }
        Ok(File { bytes, tags, wide, compressed: compressor.is_some(), appended })
    }

    fn count(&self, name: &str) -> Result<usize, String> {
        let pieces: Vec<&Tag> = self.tags.iter().filter(|t| t.name == "Piece").collect();
        let [piece] = pieces[..] else { return Err(format!("{} pieces; exactly one is read", pieces.len())) };
        let n = attribute(piece.text, name).unwrap_or("0").trim().parse().map_err(|_| format!("{name} is no number"))?;
        // Even compressed, a point or cell costs more than a thousandth of a byte.
        if n / 1024 > self.bytes.len() { Err(format!("{name} = {n} cannot be in {} bytes", self.bytes.len())) } else { Ok(n) }
    }

    /// The array `name` (any, where `None`) inside `section`.
    fn array(&self, section: &str, name: Option<&str>) -> Result<Option<Vec<f64>>, String> {
        let Some(from) = self.tags.iter().position(|t| t.name == section) else { return Ok(None) };
        let tag = self.tags[from + 1..]
            .iter()
            .take_while(|t| t.name != "" || t.text.trim_start_matches('/') != section)
            .find(|t| t.name == "DataArray" && name.is_none_or(|n| attribute(t.text, "Name") == Some(n)));
        tag.map(|t| self.values(t).map_err(|e| format!("array {} of {section}: {e}", attribute(t.text, "Name").unwrap_or("")))).transpose()
    }

    fn values(&self, tag: &Tag) -> Result<Vec<f64>, String> {
        let kind = attribute(tag.text, "type").ok_or("no type")?;
        let inline = || {
            let rest = &self.bytes[tag.end..];
            &rest[..rest.iter().position(|&b| b == b'<').unwrap_or(rest.len())]
        };
        let bytes = match attribute(tag.text, "format").unwrap_or("ascii") {
            "ascii" => {
                let text = std::str::from_utf8(inline()).map_err(|_| "not text")?;
                return text.split_whitespace().map(|w| w.parse().map_err(|_| format!("`{w}` is no number"))).collect();
            }
            "binary" => {
                let text: Vec<u8> = inline().iter().copied().filter(|b| !b.is_ascii_whitespace()).collect();
                self.block(&text, false)?
            }
            "appended" => {
                let (data, raw) = self.appended.ok_or("no appended data")?;
                let offset: usize = attribute(tag.text, "offset").and_then(|o| o.parse().ok()).ok_or("no offset")?;
                self.block(data.get(offset..).ok_or("its offset lies beyond the file's end")?, raw)?
            }
            other => return Err(format!("format {other}")),
        };
        fn each<const N: usize>(b: &[u8], f: impl Fn([u8; N]) -> f64) -> Vec<f64> {
            b.chunks_exact(N).map(|c| f(std::array::from_fn(|i| c[i]))).collect()
        }
        Ok(match kind {
            "Float64" => each(&bytes, f64::from_le_bytes),
            "Float32" => each(&bytes, |b| f64::from(f32::from_le_bytes(b))),
            "Int64" => each(&bytes, |b| i64::from_le_bytes(b) as f64),
            "UInt64" => each(&bytes, |b| u64::from_le_bytes(b) as f64),
            "Int32" => each(&bytes, |b| f64::from(i32::from_le_bytes(b))),
            "UInt32" => each(&bytes, |b| f64::from(u32::from_le_bytes(b))),
            "Int16" => each(&bytes, |b| f64::from(i16::from_le_bytes(b))),
            "UInt16" => each(&bytes, |b| f64::from(u16::from_le_bytes(b))),
            "Int8" => each(&bytes, |b: [u8; 1]| f64::from(b[0] as i8)),
            "UInt8" => each(&bytes, |b: [u8; 1]| f64::from(b[0])),
            other => return Err(format!("type {other}")),
        })
    }

    /// One block of data with its header.
    fn block(&self, data: &[u8], raw: bool) -> Result<Vec<u8>, String> {
        let word = if self.wide { 8 } else { 4 };
        let cut = "the data is cut off";
        let number = |b: &[u8], i: usize| -> Result<usize, String> {
            let b = b.get(i * word..(i + 1) * word).ok_or(cut)?;
            Ok(b.iter().rev().fold(0u64, |n, &x| n << 8 | u64::from(x)) as usize)
        };
        // Base64 holds the header and the data as separate runs where compressed, together where not.
        let decode = |from: usize, n: usize| -> Result<Vec<u8>, String> {
            if raw {
                return Ok(data.get(from..from.checked_add(n).ok_or(cut)?).ok_or(cut)?.to_vec());
            }
            let chars = n.div_ceil(3).checked_mul(4).ok_or(cut)?;
            let mut out = base64(data.get(from..from.checked_add(chars).ok_or(cut)?).ok_or(cut)?)?;
            out.truncate(n);
            if out.len() == n { Ok(out) } else { Err(cut.into()) }
        };
        let length = |n: usize| if raw { n } else { n.div_ceil(3) * 4 };
        if !self.compressed {
            let n = number(&decode(0, word)?, 0)?;
            let all = decode(0, n.checked_add(word).ok_or(cut)?)?;
            return Ok(all[word..].to_vec());
        }
        let blocks = number(&decode(0, word)?, 0)?;
        if blocks > data.len() {
            return Err(cut.into());
        }
        let head = decode(0, word * (3 + blocks))?;
        let sizes: Vec<usize> = (0..blocks).map(|i| number(&head, 3 + i)).collect::<Result<_, _>>()?;
        let total = sizes.iter().try_fold(0usize, |a, &b| a.checked_add(b)).ok_or(cut)?;
        let packed = decode(length(head.len()), total)?;
        let limit = number(&head, 1)?.max(number(&head, 2)?);
        let (mut out, mut at) = (vec![], 0);
        for n in sizes {
            let before = out.len();
            // One byte more than allowed tells a block that lies about its size.
            flate2::read::ZlibDecoder::new(&packed[at..at + n])
                .take(limit as u64 + 1)
                .read_to_end(&mut out)
                .map_err(|e| format!("zlib: {e}"))?;
            if out.len() - before > limit {
                return Err("a compressed block is larger than it says".into());
            }
            at += n;
        }
        Ok(out)
    }

    fn points(&self) -> Result<Vec<Point>, String> {
        let n = self.count("NumberOfPoints")?;
        let xyz = self.array("Points", None)?.unwrap_or_default();
        if xyz.len() != 3 * n {
            return Err(format!("{} coordinates for {n} points", xyz.len()));
        }
        Ok(xyz.chunks_exact(3).map(|c| Point::new(c[0], c[1], c[2])).collect())
    }

    fn cells(&self, section: &str, n: usize, points: usize) -> Result<Vec<Vec<u32>>, String> {
        if n == 0 {
            return Ok(vec![]);
        }
        let ids = self.array(section, Some("connectivity"))?.ok_or(format!("{section} has no connectivity"))?;
        let offsets = self.array(section, Some("offsets"))?.ok_or(format!("{section} has no offsets"))?;
        if offsets.len() != n {
            return Err(format!("{} offsets for {n} cells", offsets.len()));
        }
        if let Some(v) = ids.iter().find(|&&v| !(v >= 0.0 && v < points as f64)) {
            return Err(format!("{section} names point {v}, but there are {points}"));
        }
        let mut from = 0;
        offsets
            .iter()
            .map(|&o| {
                let to = o as usize;
                let cell = ids.get(from..to).ok_or(format!("offset {o} of {section} is out of order"))?;
                from = to;
                Ok(cell.iter().map(|&v| v as u32).collect())
            })
            .collect()
    }
}

fn base64(text: &[u8]) -> Result<Vec<u8>, String> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => Some(c - b'A'),
        b'a'..=b'z' => Some(c - b'a' + 26),
        b'0'..=b'9' => Some(c - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    for group in text.chunks(4) {
        let digits = group.iter().take_while(|&&c| c != b'=').count();
        let mut n = 0u32;
        for &c in &group[..digits] {
            n = n << 6 | u32::from(value(c).ok_or("not base64")?);
        }
        n <<= 6 * (4 - digits);
        out.extend_from_slice(&n.to_be_bytes()[1..digits.max(1)]);
    }
    Ok(out)
}

/// Reads a surface; `PatchId`, `CellEntityIds` or `ModelFaceID` become patches.
pub(super) fn poly_data(bytes: &[u8]) -> Result<TriMesh, String> {
    let file = File::parse(bytes)?;
    let points = file.points()?;
    if file.count("NumberOfStrips")? > 0 {
        return Err("triangle strips".into());
    }
    let polygons = file.cells("Polys", file.count("NumberOfPolys")?, points.len())?;
    let skipped = file.count("NumberOfVerts")? + file.count("NumberOfLines")?;
    let mut ids = None;
    for name in ["PatchId", "CellEntityIds", "ModelFaceID"] {
        ids = ids.or(file.array("CellData", Some(name))?.filter(|v| v.len() == skipped + polygons.len()));
    }
    let mut mesh = TriMesh { points, ..TriMesh::default() };
    for (k, p) in polygons.iter().enumerate() {
        fan(p, mesh.points.len(), &mut mesh.triangles)?;
        let id = ids.as_ref().map_or(WALL, |v| v[skipped + k].max(0.0) as u32);
        mesh.patch.resize(mesh.triangles.len(), id);
    }
    let mut used = mesh.patch.clone();
    used.sort_unstable();
    used.dedup();
    let names = names(&file);
    for id in used {
        let name = names.iter().find(|n| n.0 == id).map(|n| n.1.clone());
        let name = name.unwrap_or_else(|| if id == WALL { "wall".into() } else { format!("patch_{id}") });
        mesh.patches.push(Patch { id, kind: kind_of(&name), name });
    }
    Ok(mesh)
}

/// The field data `PatchNames` that our own files carry.
fn names(file: &File) -> Vec<(u32, String)> {
    let tag = file.tags.iter().find(|t| t.name == "Array" && attribute(t.text, "Name") == Some("PatchNames"));
    let Some(tag) = tag.filter(|t| attribute(t.text, "format") == Some("ascii")) else { return vec![] };
    let rest = &file.bytes[tag.end..];
    let text = String::from_utf8_lossy(&rest[..rest.iter().position(|&b| b == b'<').unwrap_or(rest.len())]).into_owned();
    let codes: Vec<u8> = text.split_whitespace().filter_map(|w| w.parse().ok()).collect();
    let split = codes.split(|&c| c == 0).map(|s| String::from_utf8_lossy(s).into_owned());
    split.filter_map(|s| s.split_once(' ').and_then(|(i, n)| Some((i.parse().ok()?, n.to_string())))).collect()
}

/// Reads a volume mesh, or a surface where there are only triangles and other polygons.
pub(super) fn unstructured(bytes: &[u8]) -> Result<AnyMesh, String> {
    let file = File::parse(bytes)?;
    let points = file.points()?;
    let n = file.count("NumberOfCells")?;
    let cells = file.cells("Cells", n, points.len())?;
    let types = file.array("Cells", Some("types"))?.unwrap_or_default();
    if types.len() != n {
        return Err(format!("{} types for {n} cells", types.len()));
    }
    let (mut volume, mut surface) = (VolumeMesh::default(), vec![]);
    for (cell, &kind) in cells.iter().zip(&types) {
        match (kind as u32, &cell[..]) {
            (10, &[a, b, c, d]) => volume.tets.push([a, b, c, d]),
            (13, &[a, b, c, d, e, f]) => volume.prisms.push([a, b, c, d, e, f]),
            (5 | 7 | 9, polygon) => fan(polygon, points.len(), &mut surface)?,
            (1..=4, _) => {}
            (other, _) => return Err(format!("cells of VTK type {other} with {} points; tetrahedra (10) and prisms (13) are read", cell.len())),
        }
    }
    if volume.cell_count() == 0 {
        return Ok(AnyMesh::Surface(TriMesh::new(points, surface)));
    }
    volume.points = points;
    with_boundary(volume)
}
