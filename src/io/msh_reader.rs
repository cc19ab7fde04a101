//! Reader of the two formats called .msh: FLUENT's ASCII mesh and Gmsh 2.2 and 4.1 ASCII.

use std::collections::BTreeMap;
use std::ops::Range;

use super::cells::{self, Cells};
use super::mesh::AnyMesh;
use super::surface_reader::kind_of;
use crate::geometry::Point;
use crate::mesh::faces::{PatchRange, PolyMesh};
use crate::mesh::{Patch, PatchKind, WALL};

/// Reads either; the first characters tell which.
pub(super) fn read(bytes: &[u8]) -> Result<AnyMesh, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "binary content; export the mesh as ASCII")?;
    match text.trim_start().chars().next() {
        Some('$') => gmsh(text),
        Some('(') => fluent(text).map(AnyMesh::Polyhedral),
        _ => Err("neither Gmsh ($MeshFormat) nor FLUENT ASCII".into()),
    }
}

/// The words of a Gmsh file.
struct Words<'a>(std::str::SplitWhitespace<'a>, usize);

impl Words<'_> {
    fn number<T: std::str::FromStr>(&mut self) -> Result<T, String> {
        let w = self.0.next().ok_or("the file ends too early")?;
        w.parse().map_err(|_| format!("`{w}` where a number should be"))
    }
    fn count(&mut self) -> Result<usize, String> {
        let n = self.number()?;
        if n > self.1 { Err(format!("{n} items cannot be in {} bytes", self.1)) } else { Ok(n) }
    }
}

fn gmsh(text: &str) -> Result<AnyMesh, String> {
    let section = |name: &str| {
        let start = text.find(&format!("${name}"))? + name.len() + 1;
        Some(Words(text[start..].split_once("$End").map_or("", |s| s.0).split_whitespace(), text.len()))
    };
    let version: f64 = section("MeshFormat").ok_or("no $MeshFormat")?.number()?;
    if ![2.2, 4.1].contains(&version) {
        return Err(format!("Gmsh format {version}; 2.2 and 4.1 are read: gmsh -save -format msh41"));
    }
    let new = version == 4.1;
    let mut out = Cells { names: physical_names(text), ..Cells::default() };
    let entities = match section("Entities") {
        Some(w) if new => surface_groups(w)?,
        _ => BTreeMap::new(),
    };
    let tags = nodes(section("Nodes").ok_or("no $Nodes")?, new, &mut out.points)?;
    let find = |tag: u64| tags.binary_search_by_key(&tag, |t| t.0).map(|i| tags[i].1).map_err(|_| format!("no node {tag}"));
    let mut element = |w: &mut Words, kind: u32, group: u32| -> Result<(), String> {
        let n = match kind {
            15 => 1,
            1 => 2,
            2 => 3,
            3 | 4 => 4,
            5 => 8,
            6 => 6,
            7 => 5,
            other => {
                return Err(format!(
                    "elements of Gmsh type {other}; tetrahedra (4), hexahedra (5), prisms (6) and pyramids (7) are read: save first-order elements"
                ));
            }
        };
        let mut v = [0; 8];
        for slot in &mut v[..n] {
            *slot = w.number().and_then(find)?;
        }
        match (kind, v) {
            (2 | 3, _) => out.faces.push((v[..n].to_vec(), group)),
            (4, [a, b, c, d, ..]) => out.tets.push([a, b, c, d]),
            (5 | 7, _) => out.others.push(v[..n].to_vec()),
            // Gmsh's first triangle faces the second, VTK's looks away.
            (6, [a, b, c, d, e, f, ..]) => out.prisms.push([a, c, b, d, f, e]),
            _ => {}
        }
        Ok(())
    };
    let mut w = section("Elements").ok_or("no $Elements")?;
    if new {
        let blocks = w.count()?;
        for _ in 0..3 {
            w.number::<u64>()?;
        }
        for _ in 0..blocks {
            let (dimension, entity): (u64, i64) = (w.number()?, w.number()?);
            let kind = w.number()?;
            let group = if dimension == 2 { entities.get(&entity).copied().unwrap_or(WALL) } else { WALL };
            for _ in 0..w.count()? {
                w.number::<u64>()?;
                element(&mut w, kind, group)?;
            }
        }
    } else {
        for _ in 0..w.count()? {
            w.number::<u64>()?;
            let kind = w.number()?;
            let mut group = WALL;
            for k in 0..w.count()? {
                let tag = w.number::<i64>()?;
                if k == 0 && tag > 0 {
                    group = tag as u32;
                }
            }
            element(&mut w, kind, group)?;
        }
    }
    drop(tags);
    cells::assemble(out)
}

/// Names of the physical surfaces.
fn physical_names(text: &str) -> Vec<(u32, String)> {
    let Some((_, rest)) = text.split_once("$PhysicalNames") else { return vec![] };
    let lines = rest.split("$End").next().unwrap_or_default().lines();
    lines
        .filter_map(|l| {
            let (head, name) = l.split_once('"')?;
            let mut head = head.split_whitespace();
            let surface = head.next() == Some("2");
            let tag = head.next()?.parse().ok()?;
            surface.then(|| (tag, name.trim_end().trim_end_matches('"').into()))
        })
        .collect()
}

/// First physical group of each surface entity of a 4.1 file.
fn surface_groups(mut w: Words) -> Result<BTreeMap<i64, u32>, String> {
    let counts = [w.count()?, w.count()?, w.count()?, w.count()?];
    let mut out = BTreeMap::new();
    for (dimension, n) in counts.into_iter().enumerate().take(3) {
        for _ in 0..n {
            let tag: i64 = w.number()?;
            for _ in 0..if dimension == 0 { 3 } else { 6 } {
                w.number::<f64>()?;
            }
            for k in 0..w.count()? {
                let group: i64 = w.number()?;
                if dimension == 2 && k == 0 {
                    out.insert(tag, group.unsigned_abs() as u32);
                }
            }
            if dimension > 0 {
                for _ in 0..w.count()? {
                    w.number::<i64>()?;
                }
            }
        }
    }
    Ok(out)
}

/// Reads the nodes; gives their tags with their numbers, by tag.
fn nodes(mut w: Words, new: bool, points: &mut Vec<Point>) -> Result<Vec<(u64, u32)>, String> {
    let mut tags: Vec<(u64, u32)> = vec![];
    let point = |w: &mut Words| -> Result<Point, String> { Ok(Point::new(w.number()?, w.number()?, w.number()?)) };
    if new {
        let blocks = w.count()?;
        for _ in 0..3 {
            w.number::<u64>()?;
        }
        for _ in 0..blocks {
            w.number::<i64>()?;
            w.number::<i64>()?;
            if w.number::<i64>()? != 0 {
                return Err("parametric nodes: save without them".into());
            }
            let n = w.count()?;
            let first = points.len() as u32;
            for k in 0..n as u32 {
                tags.push((w.number()?, first + k));
            }
            for _ in 0..n {
                points.push(point(&mut w)?);
            }
        }
    } else {
        for k in 0..w.count()? as u32 {
            tags.push((w.number()?, k));
            points.push(point(&mut w)?);
        }
    }
    tags.sort_unstable();
    Ok(tags)
}

/// A zone of faces: id, type, and where its faces lie in the list of all.
struct Zone {
    id: u64,
    kind: u64,
    faces: Range<usize>,
}

/// The faces of all zones as listed, corners from 1.
#[derive(Default)]
struct Listed {
    offsets: Vec<usize>,
    corners: Vec<u32>,
    cells: Vec<[u32; 2]>,
}

impl Listed {
    fn corners(&self, f: usize) -> &[u32] {
        &self.corners[self.offsets[f]..self.offsets[f + 1]]
    }
}

fn fluent(text: &str) -> Result<PolyMesh, String> {
    let mut points = vec![];
    let (mut cells, mut zones, mut names) = (0usize, Vec::<Zone>::new(), Vec::<(u64, String)>::new());
    let mut listed = Listed { offsets: vec![0], ..Listed::default() };
    for (index, words, body) in sections(text)? {
        let hex = |k: usize| words.get(k).and_then(|w| u64::from_str_radix(w, 16).ok()).ok_or(format!("section {index}: a bad head"));
        match index {
            10 if hex(0)? > 0 => {
                if hex(1)? as usize != points.len() + 1 {
                    return Err("nodes are not numbered one after the other".into());
                }
                let mut numbers = body.split_whitespace().map(|w| w.parse::<f64>().map_err(|_| format!("node coordinate `{w}`")));
                while let Some(x) = numbers.next() {
                    let mut rest = || numbers.next().unwrap_or(Err("a node is cut off".into()));
                    points.push(Point::new(x?, rest()?, rest()?));
                }
            }
            12 => cells = cells.max(hex(2)? as usize),
            13 if hex(0)? > 0 => {
                let (size, from) = (hex(4)? as usize, listed.cells.len());
                let mut w = body.split_whitespace().map(|w| u32::from_str_radix(w, 16).map_err(|_| format!("face entry `{w}`")));
                while let Some(first) = w.next() {
                    let first = first?;
                    let mut next = || w.next().unwrap_or(Err("a face is cut off".into()));
                    let mixed = size == 0 || size == 5;
                    let n = if mixed { first as usize } else { size };
                    if n < 3 {
                        return Err(format!("a face with {n} corners"));
                    }
                    if !mixed {
                        listed.corners.push(first);
                    }
                    for _ in usize::from(!mixed)..n {
                        listed.corners.push(next()?);
                    }
                    listed.offsets.push(listed.corners.len());
                    listed.cells.push([next()?, next()?]);
                }
                zones.push(Zone { id: hex(0)?, kind: hex(3)?, faces: from..listed.cells.len() });
            }
            39 | 45 => {
                if let (Some(id), Some(name)) = (words.first().and_then(|w| w.parse().ok()), words.get(2)) {
                    names.push((id, name.clone()));
                }
            }
            _ => {}
        }
    }
    assemble(points, cells, &zones, &listed, &names)
}

/// Index, words of the head, and body of each section.
fn sections(text: &str) -> Result<Vec<(u32, Vec<String>, &str)>, String> {
    let bytes = text.as_bytes();
    let (mut out, mut at) = (vec![], 0);
    while let Some(open) = text[at..].find('(') {
        let start = at + open;
        // The end of this section: brackets outside of quotes.
        let (mut depth, mut quoted, mut inner, mut end) = (0u32, false, vec![], None);
        for (i, &b) in bytes.iter().enumerate().skip(start) {
            match b {
                b'"' => quoted = !quoted,
                b'(' if !quoted => {
                    depth += 1;
                    if depth == 2 {
                        inner.push((i + 1, i + 1));
                    }
                }
                b')' if !quoted => {
                    if depth == 2 && let Some(l) = inner.last_mut() {
                        l.1 = i;
                    }
                    depth -= 1;
                    if depth == 0 {
                        end = Some(i);
                        break;
                    }
                }
                _ => {}
            }
        }
        let end = end.ok_or("a section is not closed: the file is cut off")?;
        let index = text[start + 1..end].split(|c: char| !c.is_ascii_digit()).next().unwrap_or_default();
        if let Ok(index) = index.parse() {
            let part = |k: usize| inner.get(k).map_or("", |&(a, b)| &text[a..b]);
            out.push((index, part(0).split_whitespace().map(str::to_string).collect(), part(1)));
        }
        at = end + 1;
    }
    Ok(out)
}

fn assemble(points: Vec<Point>, cells: usize, zones: &[Zone], listed: &Listed, names: &[(u64, String)]) -> Result<PolyMesh, String> {
    let total = listed.cells.len();
    if cells > 2 * total {
        return Err(format!("{cells} cells announced for {total} faces"));
    }
    // Listed normals point into c0; ours leave the owner, the lower cell.
    let (mut inner, mut outer) = (vec![], vec![]);
    for z in zones {
        let mut of: Vec<u32> = vec![];
        for f in z.faces.clone() {
            let [c0, c1] = listed.cells[f];
            if listed.corners(f).iter().any(|&n| n == 0 || n as usize > points.len()) || c0.max(c1) as usize > cells {
                return Err(format!("zone {}: a node or cell number is out of range", z.id));
            }
            match [c0, c1] {
                [0, 0] => return Err(format!("zone {}: a face without cells", z.id)),
                [_, 0] | [0, _] => of.push(f as u32),
                _ => inner.push(f as u32),
            }
        }
        if !of.is_empty() {
            outer.push((z, of));
        }
    }
    inner.sort_unstable_by_key(|&f| {
        let [a, b] = listed.cells[f as usize];
        (a.min(b), a.max(b), f)
    });
    let mut mesh = PolyMesh { points, cells, offsets: Vec::with_capacity(total + 1), ..PolyMesh::default() };
    mesh.offsets.push(0);
    mesh.vertices.reserve(listed.corners.len());
    mesh.owner.reserve(total);
    let mut put = |f: u32, flip: bool| {
        let v = listed.corners(f as usize).iter().map(|n| n - 1);
        if flip { mesh.vertices.extend(v.rev()) } else { mesh.vertices.extend(v) }
        mesh.offsets.push(mesh.vertices.len());
    };
    for &f in &inner {
        let [a, b] = listed.cells[f as usize];
        put(f, a < b);
        mesh.owner.push(a.min(b) - 1);
        mesh.neighbour.push(a.max(b) - 1);
    }
    for (k, (z, of)) in outer.iter().enumerate() {
        let name = names.iter().find(|n| n.0 == z.id).map_or_else(|| format!("zone_{}", z.id), |n| n.1.clone());
        let kind = match z.kind {
            3 => PatchKind::Wall,
            4 | 0xa | 0x14 => PatchKind::Inlet,
            5 | 0x24 => PatchKind::Outlet,
            _ => kind_of(&name),
        };
        let start = mesh.owner.len();
        for &f in of {
            let [a, b] = listed.cells[f as usize];
            put(f, b == 0);
            mesh.owner.push(a.max(b) - 1);
        }
        mesh.patches.push(PatchRange { patch: Patch { id: k as u32 + 1, name, kind }, start, count: of.len() });
    }
    Ok(mesh)
}
