//! Reader of the two formats called .msh: FLUENT's ASCII mesh and Gmsh 2.2 and 4.1 ASCII.

use super::mesh::{AnyMesh, with_boundary};
use super::surface_reader::kind_of;
use crate::geometry::Point;
use crate::mesh::faces::{PatchRange, PolyMesh};
use crate::mesh::{Patch, PatchKind, TriMesh, VolumeMesh};

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
        return Err(format!("Gmsh format {version}; 2.2 and 4.1 are read"));
    }
    let new = version == 4.1;
    let mut nodes: Vec<(u64, Point)> = vec![];
    let mut w = section("Nodes").ok_or("no $Nodes")?;
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
                return Err("parametric nodes".into());
            }
            let n = w.count()?;
            let tags: Vec<u64> = (0..n).map(|_| w.number()).collect::<Result<_, _>>()?;
            for t in tags {
                nodes.push((t, point(&mut w)?));
            }
        }
    } else {
        for _ in 0..w.count()? {
            nodes.push((w.number()?, point(&mut w)?));
        }
    }
    nodes.sort_by_key(|n| n.0);
    let find = |tag: u64| nodes.binary_search_by_key(&tag, |n| n.0).map(|i| i as u32).map_err(|_| format!("no node {tag}"));
    let (mut volume, mut triangles) = (VolumeMesh::default(), vec![]);
    let mut element = |w: &mut Words, kind: u32| -> Result<(), String> {
        let n = match kind {
            15 => 1,
            1 => 2,
            2 => 3,
            3 | 4 => 4,
            6 => 6,
            other => return Err(format!("elements of Gmsh type {other}; tetrahedra (4) and prisms (6) are read")),
        };
        let v: Vec<u32> = (0..n).map(|_| w.number().and_then(find)).collect::<Result<_, _>>()?;
        match (kind, &v[..]) {
            (2, &[a, b, c]) => triangles.push([a, b, c]),
            (3, &[a, b, c, d]) => triangles.extend([[a, b, c], [a, c, d]]),
            (4, &[a, b, c, d]) => volume.tets.push([a, b, c, d]),
            // Gmsh's first triangle faces the second, VTK's looks away.
            (6, &[a, b, c, d, e, f]) => volume.prisms.push([a, c, b, d, f, e]),
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
            w.number::<i64>()?;
            w.number::<i64>()?;
            let kind = w.number()?;
            for _ in 0..w.count()? {
                w.number::<u64>()?;
                element(&mut w, kind)?;
            }
        }
    } else {
        for _ in 0..w.count()? {
            w.number::<u64>()?;
            let kind = w.number()?;
            for _ in 0..w.count()? {
                w.number::<i64>()?;
            }
            element(&mut w, kind)?;
        }
    }
    let points = nodes.iter().map(|n| n.1).collect();
    if volume.cell_count() == 0 {
        return Ok(AnyMesh::Surface(TriMesh::new(points, triangles)));
    }
    volume.points = points;
    with_boundary(volume)
}

/// A zone of faces: id, type, and per face its vertices and cells c0, c1.
struct Zone {
    id: u64,
    kind: u64,
    faces: Vec<(Vec<u32>, u32, u32)>,
}

fn fluent(text: &str) -> Result<PolyMesh, String> {
    let mut points = vec![];
    let (mut cells, mut zones, mut names) = (0usize, Vec::<Zone>::new(), Vec::<(u64, String)>::new());
    for (index, words, body) in sections(text)? {
        let hex = |k: usize| words.get(k).and_then(|w| u64::from_str_radix(w, 16).ok()).ok_or(format!("section {index}: a bad head"));
        match index {
            10 if hex(0)? > 0 => {
                let xyz: Vec<f64> = body
                    .split_whitespace()
                    .map(|w| w.parse().map_err(|_| format!("node coordinate `{w}`")))
                    .collect::<Result<_, _>>()?;
                if hex(1)? as usize != points.len() + 1 || xyz.len() % 3 != 0 {
                    return Err("nodes are not numbered one after the other in three coordinates".into());
                }
                points.extend(xyz.chunks_exact(3).map(|c| Point::new(c[0], c[1], c[2])));
            }
            12 => cells = cells.max(hex(2)? as usize),
            13 if hex(0)? > 0 => {
                let (size, mut faces) = (hex(4)? as usize, vec![]);
                let mut w = body.split_whitespace().map(|w| u32::from_str_radix(w, 16).map_err(|_| format!("face entry `{w}`")));
                while let Some(first) = w.next() {
                    let first = first?;
                    let mut next = || w.next().unwrap_or(Err("a face is cut off".into()));
                    let mixed = size == 0 || size == 5;
                    let n = if mixed { first as usize } else { size };
                    let mut v = if mixed { vec![] } else { vec![first] };
                    while v.len() < n {
                        v.push(next()?);
                    }
                    if n < 3 {
                        return Err(format!("a face with {n} corners"));
                    }
                    faces.push((v, next()?, next()?));
                }
                zones.push(Zone { id: hex(0)?, kind: hex(3)?, faces });
            }
            39 | 45 => {
                if let (Some(id), Some(name)) = (words.first().and_then(|w| w.parse().ok()), words.get(2)) {
                    names.push((id, name.clone()));
                }
            }
            _ => {}
        }
    }
    assemble(points, cells, zones, &names)
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

fn assemble(points: Vec<Point>, cells: usize, zones: Vec<Zone>, names: &[(u64, String)]) -> Result<PolyMesh, String> {
    let mut mesh = PolyMesh { points, cells, offsets: vec![0], ..PolyMesh::default() };
    let total: usize = zones.iter().map(|z| z.faces.len()).sum();
    if cells > 2 * total {
        return Err(format!("{cells} cells announced for {total} faces"));
    }
    // Listed normals point into c0; ours leave the owner, the lower cell.
    let (mut inner, mut outer) = (vec![], vec![]);
    for z in &zones {
        let mut of = vec![];
        for (v, c0, c1) in &z.faces {
            if v.iter().any(|&n| n == 0 || n as usize > mesh.points.len()) || [c0, c1].iter().any(|&&c| c as usize > cells) {
                return Err(format!("zone {}: a node or cell number is out of range", z.id));
            }
            let ids = |flip: bool| -> Vec<u32> {
                let v = v.iter().map(|n| n - 1);
                if flip { v.rev().collect() } else { v.collect() }
            };
            match (*c0, *c1) {
                (0, 0) => return Err(format!("zone {}: a face without cells", z.id)),
                (a, 0) => of.push((a - 1, ids(true))),
                (0, b) => of.push((b - 1, ids(false))),
                (a, b) => inner.push((a.min(b) - 1, a.max(b) - 1, ids(a < b))),
            }
        }
        if !of.is_empty() {
            outer.push((z, of));
        }
    }
    inner.sort();
    for (o, n, v) in &inner {
        mesh.owner.push(*o);
        mesh.neighbour.push(*n);
        mesh.vertices.extend_from_slice(v);
        mesh.offsets.push(mesh.vertices.len());
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
        for (o, v) in of {
            mesh.owner.push(*o);
            mesh.vertices.extend_from_slice(v);
            mesh.offsets.push(mesh.vertices.len());
        }
        mesh.patches.push(PatchRange { patch: Patch { id: k as u32 + 1, name, kind }, start, count: of.len() });
    }
    Ok(mesh)
}
