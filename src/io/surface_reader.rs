//! Readers of STL (ASCII in upper or lower case, binary), PLY and OBJ.

use crate::geometry::Point;
use crate::mesh::{Patch, PatchKind, TriMesh, WALL};

/// The role that a patch's name tells.
pub(super) fn kind_of(name: &str) -> PatchKind {
    let name = name.to_lowercase();
    match () {
        () if name.contains("inlet") || name.contains("inflow") => PatchKind::Inlet,
        () if name.contains("outlet") || name.contains("outflow") => PatchKind::Outlet,
        () => PatchKind::Wall,
    }
}

/// Joins equal corners, by value, in the order of their first appearance.
fn join(corners: Vec<Point>, patch: Vec<u32>, patches: Vec<Patch>) -> TriMesh {
    let triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    TriMesh { points: corners, triangles, patch, patches }.welded()
}

/// Reads STL; solids of ASCII files become patches.
pub(super) fn stl(bytes: &[u8]) -> Result<TriMesh, String> {
    // Some binary files begin with "solid": the length decides.
    if let Some(n) = bytes.get(80..84) {
        let n = u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize;
        if n.checked_mul(50).and_then(|n| n.checked_add(84)) == Some(bytes.len()) {
            let float = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            let corners = bytes[84..]
                .chunks_exact(50)
                .flat_map(|t| t[12..48].chunks_exact(12).map(|v| Point::new(float(v), float(&v[4..]), float(&v[8..]))).collect::<Vec<_>>())
                .collect();
            return Ok(join(corners, vec![WALL; n], vec![Patch::wall()]));
        }
    }
    let text = std::str::from_utf8(bytes).map_err(|_| "neither ASCII STL nor binary STL of the right length: the file is cut off or damaged".to_string())?;
    let begins = |line: &str| line.split_whitespace().next().is_some_and(|w| w.eq_ignore_ascii_case("solid"));
    if !text.lines().find(|l| !l.trim().is_empty()).is_some_and(begins) {
        return Err("neither ASCII STL (no `solid`) nor binary STL of the right length: the file is cut off or damaged".into());
    }
    let (mut corners, mut patch, mut patches) = (vec![], vec![], Vec::<Patch>::new());
    let mut open = false;
    for (k, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let keyword = words.next().map(str::to_ascii_lowercase);
        match keyword.as_deref() {
            Some("solid") => {
                let name: String = words.collect::<Vec<_>>().join("_");
                let name = if name.is_empty() { format!("solid_{}", patches.len() + 1) } else { name };
                patches.push(Patch { id: patches.len() as u32 + 1, kind: kind_of(&name), name });
                open = true;
            }
            Some("vertex") => {
                let c: Vec<f64> = words.map_while(|w| w.parse().ok()).collect();
                let [x, y, z] = c[..] else { return Err(format!("line {}: a vertex needs three numbers", k + 1)) };
                corners.push(Point::new(x, y, z));
            }
            Some("endfacet") => {
                patch.push(patches.len() as u32);
                if corners.len() != 3 * patch.len() {
                    return Err(format!("line {}: a facet needs three vertices", k + 1));
                }
            }
            Some("endsolid") => open = false,
            Some("facet" | "outer" | "endloop") | None => {}
            Some(word) => return Err(format!("line {}: `{word}` has no place in STL", k + 1)),
        }
    }
    if open || corners.len() != 3 * patch.len() {
        return Err("the last solid is not ended: the file is cut off".into());
    }
    Ok(join(corners, patch, patches))
}

/// Reads OBJ: vertices and faces; groups and objects with faces become patches. Lines that continue on the next are joined.
pub(super) fn obj(bytes: &[u8]) -> Result<TriMesh, String> {
    let text = String::from_utf8_lossy(bytes).replace("\\\r\n", " ").replace("\\\n", " ");
    let mut mesh = TriMesh::default();
    let mut group = String::from("wall");
    let mut names: Vec<String> = vec![];
    for (k, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let wrong = |what: &str| format!("line {}: {what}", k + 1);
        match words.next() {
            Some("v") => {
                let c: Vec<f64> = words.map_while(|w| w.parse().ok()).collect();
                let [x, y, z, ..] = c[..] else { return Err(wrong("a vertex needs three numbers")) };
                mesh.points.push(Point::new(x, y, z));
            }
            Some("f") => {
                let mut polygon = vec![];
                for w in words {
                    let index = w.split('/').next().and_then(|i| i.parse::<i64>().ok()).ok_or_else(|| wrong(&format!("`{w}` names no vertex")))?;
                    // From 1, or backwards from the last.
                    let at = if index > 0 { index - 1 } else { mesh.points.len() as i64 + index };
                    polygon.push(u32::try_from(at).map_err(|_| wrong(&format!("`{w}` names no vertex")))?);
                }
                // Faces may stand before their vertices: checked at the end.
                super::mesh::fan(&polygon, usize::MAX, &mut mesh.triangles).map_err(|e| wrong(&e))?;
                let id = names.iter().position(|n| *n == group).unwrap_or_else(|| {
                    names.push(group.clone());
                    names.len() - 1
                });
                mesh.patch.resize(mesh.triangles.len(), id as u32 + 1);
            }
            Some("g" | "o") => {
                let name = words.collect::<Vec<_>>().join("_");
                group = if name.is_empty() { "wall".into() } else { name };
            }
            // Normals, texture, materials, lines and points say nothing about the shape.
            _ => {}
        }
    }
    if let Some(v) = mesh.triangles.iter().flatten().find(|v| **v as usize >= mesh.points.len()) {
        return Err(format!("a face names vertex {}, but there are {}", u64::from(*v) + 1, mesh.points.len()));
    }
    if mesh.triangles.is_empty() {
        return Err("no faces (`f`)".into());
    }
    mesh.patches = names.into_iter().enumerate().map(|(i, name)| Patch { id: i as u32 + 1, kind: kind_of(&name), name }).collect();
    Ok(mesh)
}

/// Reads PLY: ASCII and little-endian binary; vertices x y z first, then faces.
pub(super) fn ply(bytes: &[u8]) -> Result<TriMesh, String> {
    let end = bytes.windows(10).position(|w| w == b"end_header").ok_or("no `end_header`")?;
    let head = std::str::from_utf8(&bytes[..end]).map_err(|_| "the header is not text")?;
    let body = bytes[end..].iter().position(|&b| b == b'\n').map_or(&[][..], |i| &bytes[end + i + 1..]);
    let mut binary = false;
    // Name, count, properties (list count type or nothing, type, name) of each element.
    type Element<'a> = (&'a str, usize, Vec<(Option<&'a str>, &'a str, &'a str)>);
    let mut elements: Vec<Element> = vec![];
    for line in head.lines() {
        let w: Vec<&str> = line.split_whitespace().collect();
        match w[..] {
            ["format", "ascii", ..] => binary = false,
            ["format", "binary_little_endian", ..] => binary = true,
            ["format", other, ..] => return Err(format!("format {other} is not read")),
            ["element", name, n] => {
                let n: usize = n.parse().map_err(|_| format!("`{n}` elements"))?;
                if n > bytes.len() {
                    return Err(format!("{n} {name} elements cannot be in {} bytes", bytes.len()));
                }
                elements.push((name, n, vec![]));
            }
            ["property", "list", a, b, name] => elements.last_mut().ok_or("a property before its element")?.2.push((Some(a), b, name)),
            ["property", t, name] => elements.last_mut().ok_or("a property before its element")?.2.push((None, t, name)),
            _ => {}
        }
    }
    let mut source = Numbers { body, binary };
    let mut mesh = TriMesh::default();
    for (name, n, properties) in &elements {
        for _ in 0..*n {
            let (mut xyz, mut polygon, mut patch) = ([0.0; 3], vec![], WALL);
            for (list, kind, property) in properties {
                let count = match list {
                    Some(t) => source.next(t)? as usize,
                    None => 1,
                };
                for _ in 0..count {
                    let value = source.next(kind)?;
                    match (*name, *property) {
                        ("vertex", "x") => xyz[0] = value,
                        ("vertex", "y") => xyz[1] = value,
                        ("vertex", "z") => xyz[2] = value,
                        ("face", "vertex_indices" | "vertex_index") => {
                            if !(0.0..4294967295.0).contains(&value) {
                                return Err(format!("face {} names point {value}", mesh.triangles.len()));
                            }
                            polygon.push(value as u32);
                        }
                        ("face", "patch") => patch = value.max(0.0) as u32,
                        _ => {}
                    }
                }
            }
            match *name {
                "vertex" => mesh.points.push(Point::from(xyz)),
                "face" => super::mesh::fan(&polygon, mesh.points.len(), &mut mesh.triangles)?,
                _ => {}
            }
            mesh.patch.resize(mesh.triangles.len(), patch);
        }
    }
    let mut ids = mesh.patch.clone();
    ids.sort_unstable();
    ids.dedup();
    for id in ids {
        let comment = head.lines().find_map(|l| l.strip_prefix(&format!("comment patch {id} ")));
        let name = comment.map_or_else(|| if id == WALL { "wall".into() } else { format!("patch_{id}") }, |n| n.trim().to_string());
        mesh.patches.push(Patch { id, kind: kind_of(&name), name });
    }
    Ok(mesh)
}

/// Numbers of a PLY body.
struct Numbers<'a> {
    body: &'a [u8],
    binary: bool,
}

impl Numbers<'_> {
    fn next(&mut self, kind: &str) -> Result<f64, String> {
        let cut = || "the file ends too early".to_string();
        if !self.binary {
            let start = self.body.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(cut)?;
            let rest = &self.body[start..];
            let len = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            self.body = &rest[len..];
            let word = String::from_utf8_lossy(&rest[..len]);
            return word.parse().map_err(|_| format!("`{word}` is no number"));
        }
        let size = match kind {
            "char" | "uchar" | "int8" | "uint8" => 1,
            "short" | "ushort" | "int16" | "uint16" => 2,
            "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
            "double" | "float64" => 8,
            other => return Err(format!("property type {other}")),
        };
        let (b, rest) = self.body.split_at_checked(size).ok_or_else(cut)?;
        self.body = rest;
        Ok(match kind {
            "char" | "int8" => f64::from(b[0] as i8),
            "uchar" | "uint8" => f64::from(b[0]),
            "short" | "int16" => f64::from(i16::from_le_bytes([b[0], b[1]])),
            "ushort" | "uint16" => f64::from(u16::from_le_bytes([b[0], b[1]])),
            "int" | "int32" => f64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            "uint" | "uint32" => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            "float" | "float32" => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            _ => f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upper_case_stl_is_read() {
        let text = "SOLID INLET A\n FACET NORMAL 0 0 1\n  OUTER LOOP\n   VERTEX 0 0 0\n   VERTEX 1 0 0\n   VERTEX 0 1E+0 0\n  ENDLOOP\n ENDFACET\nENDSOLID INLET A\n";
        let mesh = stl(text.as_bytes()).expect("a surface");
        assert_eq!((mesh.triangles.len(), mesh.points[2].y), (1, 1.0));
        assert_eq!((mesh.patches[0].name.as_str(), mesh.patches[0].kind), ("INLET_A", PatchKind::Inlet));
    }

    #[test]
    fn obj_has_polygons_groups_and_ids_from_either_end() {
        let text = "o vessel\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0 1.0\nvt 0 0\nf 1/1/1 2/1/1 \\\n 3/1/1 4/1/1\ng outlet left\nf -4//2 -1//2 2\n";
        let mesh = obj(text.as_bytes()).expect("a surface");
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 1]]);
        assert_eq!(mesh.patch, [1, 1, 2]);
        assert_eq!((mesh.patches[1].name.as_str(), mesh.patches[1].kind), ("outlet_left", PatchKind::Outlet));
        assert!(obj(b"v 0 0 0\nf 1 2 3\n").expect_err("no such vertex").contains("vertex 2"));
        assert!(obj(b"v 0 0\n").expect_err("too short").contains("line 1"));
    }
}
