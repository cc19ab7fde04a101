//! Reader of OpenFOAM's `constant/polyMesh` in ASCII, plain or gzip.

use std::fs;
use std::io::Read;
use std::path::Path;

use super::Error;
use super::surface_reader::kind_of;
use crate::geometry::Point;
use crate::mesh::faces::{PatchRange, PolyMesh};
use crate::mesh::{Patch, PatchKind};

/// Reads the mesh of a case folder (or of the polyMesh folder itself), as it stands: metres.
pub(super) fn read(folder: &Path) -> Result<PolyMesh, Error> {
    let inner = folder.join("constant").join("polyMesh");
    let folder = if inner.is_dir() { inner } else { folder.to_path_buf() };
    let points = parse(&folder, "points", points)?;
    let (offsets, vertices) = parse(&folder, "faces", |t| faces(t, points.len()))?;
    let owner = parse(&folder, "owner", labels)?;
    let mut neighbour = parse(&folder, "neighbour", labels)?;
    let wrong = |name: &str, what: String| Error::malformed(&folder.join(name), what, "check the case with checkMesh");
    if owner.len() + 1 != offsets.len() || neighbour.len() > owner.len() {
        return Err(wrong("owner", format!("{} owners and {} neighbours for {} faces", owner.len(), neighbour.len(), offsets.len() - 1)));
    }
    // Old files list every face, boundary faces as -1.
    while neighbour.last() == Some(&u32::MAX) {
        neighbour.pop();
    }
    let cells = owner.iter().chain(&neighbour).max().map_or(0, |&c| c as usize + 1);
    if cells > owner.len() + neighbour.len() {
        return Err(wrong("owner", format!("cell {} of {} faces", cells - 1, owner.len())));
    }
    let patches = parse(&folder, "boundary", |t| patches(t, neighbour.len(), owner.len()))?;
    Ok(PolyMesh { points, cells, offsets, vertices, owner, neighbour, patches })
}

/// Loads one file and hands its words, from behind the head, to `read`.
fn parse<T>(folder: &Path, name: &str, read: impl FnOnce(&mut Words) -> Result<T, String>) -> Result<T, Error> {
    let (plain, packed) = (folder.join(name), folder.join(format!("{name}.gz")));
    let mut text = String::new();
    let path = if !plain.is_file() && packed.is_file() {
        let file = fs::File::open(&packed).map_err(|e| Error::read(&packed, e))?;
        flate2::read::MultiGzDecoder::new(file).read_to_string(&mut text).map_err(|e| Error::read(&packed, e))?;
        packed
    } else {
        text = fs::read_to_string(&plain).map_err(|e| Error::read(&plain, e))?;
        plain
    };
    let remedy = "check the case with checkMesh; binary files are written as ASCII by foamFormatConvert";
    let wrong = |what| Error::malformed(&path, what, remedy);
    let head = text.find("FoamFile").and_then(|i| text[i..].find('}').map(|j| (i, i + j + 1)));
    let (from, to) = head.ok_or_else(|| wrong("no FoamFile head".into()))?;
    if text[from..to].contains("binary") {
        return Err(wrong("binary format, which is not read".into()));
    }
    let mut words = Words { text: &text, at: to };
    read(&mut words).map_err(|what| wrong(format!("line {}: {what}", 1 + text[..words.at.min(text.len())].matches('\n').count())))
}

/// Words and brackets one after the other, comments left out.
struct Words<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Words<'a> {
    fn next(&mut self) -> Option<&'a str> {
        let bytes = self.text.as_bytes();
        loop {
            let rest = &bytes[self.at.min(bytes.len())..];
            match rest {
                [] => return None,
                [b'/', b'/', ..] => self.at += rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len()),
                [b'/', b'*', ..] => self.at += rest.windows(2).position(|w| w == b"*/").map_or(rest.len(), |i| i + 2),
                [b'(' | b')' | b'{' | b'}' | b';', ..] => {
                    self.at += 1;
                    return Some(&self.text[self.at - 1..self.at]);
                }
                [b, ..] if b.is_ascii_whitespace() => self.at += 1,
                _ => {
                    let end = |b: u8| b.is_ascii_whitespace() || matches!(b, b'(' | b')' | b'{' | b'}' | b';');
                    let start = self.at;
                    self.at += rest.iter().position(|&b| end(b)).unwrap_or(rest.len());
                    return Some(&self.text[start..self.at]);
                }
            }
        }
    }

    fn word(&mut self) -> Result<&'a str, String> {
        self.next().ok_or_else(|| "the list is not closed: the file is cut off".into())
    }

    fn number<T: std::str::FromStr>(&mut self) -> Result<T, String> {
        let w = self.word()?;
        w.parse().map_err(|_| format!("`{w}` where a number should be"))
    }

    fn expect(&mut self, mark: &str) -> Result<(), String> {
        let w = self.word()?;
        if w == mark { Ok(()) } else { Err(format!("`{w}` where `{mark}` should be")) }
    }

    /// The number of items and the bracket before them.
    fn list(&mut self) -> Result<usize, String> {
        let n: usize = self.number()?;
        self.expect("(")?;
        // An item has a digit and a blank at least.
        if n > self.text.len() / 2 + 1 { Err(format!("{n} items announced, the file is too short")) } else { Ok(n) }
    }
}

fn points(w: &mut Words) -> Result<Vec<Point>, String> {
    let n = w.list()?;
    let mut points = Vec::with_capacity(n);
    for _ in 0..n {
        w.expect("(")?;
        points.push(Point::new(w.number()?, w.number()?, w.number()?));
        w.expect(")")?;
    }
    w.expect(")").map(|()| points)
}

fn faces(w: &mut Words, points: usize) -> Result<(Vec<usize>, Vec<u32>), String> {
    let n = w.list()?;
    let (mut offsets, mut vertices) = (Vec::with_capacity(n + 1), Vec::with_capacity(3 * n));
    offsets.push(0);
    for f in 0..n {
        let size: usize = w.number()?;
        if size < 3 {
            return Err(format!("face {f} has {size} corners"));
        }
        w.expect("(")?;
        for _ in 0..size {
            let v: u32 = w.number()?;
            if v as usize >= points {
                return Err(format!("face {f} names point {v}, but there are {points}"));
            }
            vertices.push(v);
        }
        w.expect(")")?;
        offsets.push(vertices.len());
    }
    w.expect(")").map(|()| (offsets, vertices))
}

fn labels(w: &mut Words) -> Result<Vec<u32>, String> {
    let n = w.list()?;
    let mut labels = Vec::with_capacity(n);
    for _ in 0..n {
        let word = w.word()?;
        labels.push(if word == "-1" { u32::MAX } else { word.parse().map_err(|_| format!("`{word}` is no cell"))? });
    }
    w.expect(")").map(|()| labels)
}

fn patches(w: &mut Words, inner: usize, faces: usize) -> Result<Vec<PatchRange>, String> {
    let n = w.list()?;
    let mut patches: Vec<PatchRange> = vec![];
    for _ in 0..n {
        let name = w.word()?;
        w.expect("{")?;
        let mut body = vec![];
        loop {
            match w.word()? {
                "}" => break,
                word => body.push(word),
            }
        }
        let entry = |key: &str| body.iter().position(|w| *w == key).and_then(|i| body.get(i + 1)).copied();
        let number = |key: &str| entry(key).and_then(|w| w.parse::<usize>().ok()).ok_or(format!("patch {name}: no {key}"));
        let (start, count) = (number("startFace")?, number("nFaces")?);
        let expected = patches.last().map_or(inner, |p| p.start + p.count);
        if count > 0 && (start != expected || count > faces - expected.min(faces)) {
            return Err(format!("patch {name} starts at face {start}, {expected} expected"));
        }
        let kind = if entry("type") == Some("wall") { PatchKind::Wall } else { kind_of(name) };
        patches.push(PatchRange { patch: Patch { id: patches.len() as u32 + 1, name: name.into(), kind }, start: expected, count });
    }
    w.expect(")")?;
    let covered = patches.last().map_or(inner, |p| p.start + p.count);
    if covered == faces { Ok(patches) } else { Err(format!("patches end at face {covered} of {faces}")) }
}
