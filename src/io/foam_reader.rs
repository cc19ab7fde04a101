//! Reader of OpenFOAM's `constant/polyMesh` in ASCII.

use std::fs;
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
    let load = |name: &str| -> Result<Vec<String>, Error> {
        let path = folder.join(name);
        let text = fs::read_to_string(&path).map_err(|e| Error::read(&path, e))?;
        words(&text).map_err(|what| Error::malformed(&path, what, "write the mesh in ASCII: foamFormatConvert"))
    };
    let wrong = |name: &str, what: String| Error::malformed(&folder.join(name), what, "check the case with checkMesh");
    let points = points(&load("points")?).map_err(|e| wrong("points", e))?;
    let (offsets, vertices) = faces(&load("faces")?, points.len()).map_err(|e| wrong("faces", e))?;
    let owner = labels(&load("owner")?).map_err(|e| wrong("owner", e))?;
    let mut neighbour = labels(&load("neighbour")?).map_err(|e| wrong("neighbour", e))?;
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
    let patches = patches(&load("boundary")?, neighbour.len(), owner.len()).map_err(|e| wrong("boundary", e))?;
    Ok(PolyMesh { points, cells, offsets, vertices, owner, neighbour, patches })
}

/// Words and brackets after the head of the file.
fn words(text: &str) -> Result<Vec<String>, String> {
    let head = text.find("FoamFile").and_then(|i| text[i..].find('}').map(|j| (i, i + j + 1)));
    let (from, to) = head.ok_or("no FoamFile head")?;
    if text[from..to].contains("binary") {
        return Err("binary format, which is not read".into());
    }
    let (mut out, mut word) = (vec![], String::new());
    let mut rest = text[to..].chars().peekable();
    while let Some(c) = rest.next() {
        if c == '/' && rest.peek() == Some(&'/') {
            for c in rest.by_ref() {
                if c == '\n' {
                    break;
                }
            }
            continue;
        }
        if c == '/' && rest.peek() == Some(&'*') {
            let mut last = ' ';
            for c in rest.by_ref() {
                if last == '*' && c == '/' {
                    break;
                }
                last = c;
            }
            continue;
        }
        let mark = matches!(c, '(' | ')' | '{' | '}' | ';');
        if (c.is_whitespace() || mark) && !word.is_empty() {
            out.push(std::mem::take(&mut word));
        }
        if mark {
            out.push(c.to_string());
        } else if !c.is_whitespace() {
            word.push(c);
        }
    }
    if !word.is_empty() {
        out.push(word);
    }
    Ok(out)
}

/// The words between the outer brackets and the number before them.
fn list(words: &[String]) -> Result<(usize, &[String]), String> {
    let [n, open, body @ .., close] = words else { return Err("an empty file".into()) };
    let n = n.parse().map_err(|_| format!("`{n}` where the number of items should be"))?;
    if open != "(" || close != ")" {
        return Err("the list is not closed: the file is cut off".into());
    }
    if n > body.len() { Err(format!("{n} items announced, the file is too short")) } else { Ok((n, body)) }
}

fn points(words: &[String]) -> Result<Vec<Point>, String> {
    let (n, body) = list(words)?;
    let points: Vec<Point> = body
        .chunks(5)
        .enumerate()
        .map(|(i, c)| match c {
            [o, x, y, z, e] if o == "(" && e == ")" => {
                let number = |s: &String| s.parse::<f64>().map_err(|_| format!("point {i}: `{s}` is no number"));
                Ok(Point::new(number(x)?, number(y)?, number(z)?))
            }
            _ => Err(format!("point {i} is not (x y z)")),
        })
        .collect::<Result<_, String>>()?;
    if points.len() == n { Ok(points) } else { Err(format!("{} points, {n} announced", points.len())) }
}

fn faces(words: &[String], points: usize) -> Result<(Vec<usize>, Vec<u32>), String> {
    let (n, body) = list(words)?;
    let (mut offsets, mut vertices) = (vec![0], vec![]);
    let mut at = 0;
    while at < body.len() {
        let f = offsets.len() - 1;
        let size: usize = body[at].parse().map_err(|_| format!("face {f}: `{}` where the number of corners should be", body[at]))?;
        let end = at.checked_add(size).and_then(|e| e.checked_add(3)).filter(|&e| e <= body.len() && size >= 3);
        let Some(end) = end else { return Err(format!("face {f} has {size} corners or is cut off")) };
        for w in &body[at + 2..end - 1] {
            let v: u32 = w.parse().map_err(|_| format!("face {f}: `{w}` is no point"))?;
            if v as usize >= points {
                return Err(format!("face {f} names point {v}, but there are {points}"));
            }
            vertices.push(v);
        }
        offsets.push(vertices.len());
        at = end;
    }
    if offsets.len() == n + 1 { Ok((offsets, vertices)) } else { Err(format!("{} faces, {n} announced", offsets.len() - 1)) }
}

fn labels(words: &[String]) -> Result<Vec<u32>, String> {
    let (n, body) = list(words)?;
    let labels: Vec<u32> = body
        .iter()
        .map(|w| if w == "-1" { Ok(u32::MAX) } else { w.parse().map_err(|_| format!("`{w}` is no cell")) })
        .collect::<Result<_, String>>()?;
    if labels.len() == n { Ok(labels) } else { Err(format!("{} labels, {n} announced", labels.len())) }
}

fn patches(words: &[String], inner: usize, faces: usize) -> Result<Vec<PatchRange>, String> {
    let (_, body) = list(words)?;
    let mut patches: Vec<PatchRange> = vec![];
    let mut at = 0;
    while at < body.len() {
        let name = body[at].clone();
        let end = body[at..].iter().position(|w| w == "}").map(|i| at + i).ok_or(format!("patch {name} is not closed"))?;
        let entry = |key: &str| body[at..end].iter().position(|w| w == key).and_then(|i| body.get(at + i + 1));
        let number = |key: &str| entry(key).and_then(|w| w.parse::<usize>().ok()).ok_or(format!("patch {name}: no {key}"));
        let (start, count) = (number("startFace")?, number("nFaces")?);
        let expected = patches.last().map_or(inner, |p| p.start + p.count);
        if count > 0 && (start != expected || count > faces - expected.min(faces)) {
            return Err(format!("patch {name} starts at face {start}, {expected} expected"));
        }
        let kind = if entry("type").is_some_and(|t| t == "wall") { PatchKind::Wall } else { kind_of(&name) };
        patches.push(PatchRange { patch: Patch { id: patches.len() as u32 + 1, name, kind }, start: expected, count });
        at = end + 1;
    }
    let covered = patches.last().map_or(inner, |p| p.start + p.count);
    if covered == faces { Ok(patches) } else { Err(format!("patches end at face {covered} of {faces}")) }
}
