//! Reader of VTK's XML meshes: PolyData (.vtp) and UnstructuredGrid (.vtu), as VTK, ParaView and meshio write them.

use super::cells::{self, Cells};
use super::mesh::{AnyMesh, fan, strip};
use super::surface_reader::kind_of;
use super::vtk_xml_reader::{File, attribute};
use crate::geometry::Point;
use crate::mesh::{Patch, TriMesh, WALL};

impl File<'_> {
    fn points(&self) -> Result<Vec<Point>, String> {
        let n = self.count("NumberOfPoints")?;
        let (mut points, mut xyz, mut at) = (Vec::with_capacity(n), [0.0; 3], 0);
        self.each("Points", None, |x| {
            xyz[at] = x;
            at = (at + 1) % 3;
            if at == 0 {
                points.push(Point::from(xyz));
            }
            Ok(())
        })?;
        if points.len() != n || at != 0 {
            return Err(format!("{} coordinates for {n} points", 3 * points.len() + at));
        }
        Ok(points)
    }

    /// Connectivity and offsets of `n` cells; the offsets rise and end within the connectivity.
    fn cells(&self, section: &str, n: usize, points: usize) -> Result<(Vec<u32>, Vec<u32>), String> {
        if n == 0 {
            return Ok((vec![], vec![]));
        }
        let ids = self.ids(section, "connectivity", points)?;
        let offsets = self.ids(section, "offsets", ids.len() + 1)?;
        // VTK 2.2 files count from a leading zero.
        let offsets = if offsets.len() == n + 1 && offsets[0] == 0 { offsets[1..].to_vec() } else { offsets };
        if offsets.len() != n {
            return Err(format!("{} offsets for {n} cells", offsets.len()));
        }
        if let Some(k) = (1..n).find(|&k| offsets[k] < offsets[k - 1]) {
            return Err(format!("offset {} of {section} is out of order", offsets[k]));
        }
        Ok((ids, offsets))
    }
}

/// The cells one after the other.
fn each_cell<'a>(ids: &'a [u32], offsets: &'a [u32]) -> impl Iterator<Item = &'a [u32]> {
    let start = std::iter::once(0).chain(offsets.iter().copied());
    start.zip(offsets).map(|(a, &b)| &ids[a as usize..b as usize])
}

/// Reads a surface; `PatchId`, `CellEntityIds` or `ModelFaceID` become patches.
pub(super) fn poly_data(bytes: &[u8]) -> Result<TriMesh, String> {
    let file = File::parse(bytes)?;
    let points = file.points()?;
    let count = file.count("NumberOfPolys")?;
    let (connectivity, offsets) = file.cells("Polys", count, points.len())?;
    let strips = file.count("NumberOfStrips")?;
    let (strip_ids, strip_offsets) = file.cells("Strips", strips, points.len())?;
    let skipped = file.count("NumberOfVerts")? + file.count("NumberOfLines")?;
    let mut ids = None;
    for name in ["PatchId", "CellEntityIds", "ModelFaceID"] {
        ids = ids.or(file.array("CellData", Some(name))?.filter(|v| v.len() == skipped + count + strips));
    }
    let mut mesh = TriMesh { points, ..TriMesh::default() };
    for (k, p) in each_cell(&connectivity, &offsets).enumerate() {
        fan(p, mesh.points.len(), &mut mesh.triangles)?;
        let id = ids.as_ref().map_or(WALL, |v| v[skipped + k].max(0.0) as u32);
        mesh.patch.resize(mesh.triangles.len(), id);
    }
    // Strips come after the polygons.
    for (k, p) in each_cell(&strip_ids, &strip_offsets).enumerate() {
        strip(p, mesh.points.len(), &mut mesh.triangles)?;
        let id = ids.as_ref().map_or(WALL, |v| v[skipped + count + k].max(0.0) as u32);
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
    let Some(tag) = tag.filter(|t| attribute(t.text, "format") == Some("ascii")) else { return numbered_names(file) };
    let rest = &file.bytes[tag.end..];
    let text = String::from_utf8_lossy(&rest[..rest.iter().position(|&b| b == b'<').unwrap_or(rest.len())]).into_owned();
    let codes: Vec<u8> = text.split_whitespace().filter_map(|w| w.parse().ok()).collect();
    let split = codes.split(|&c| c == 0).map(|s| String::from_utf8_lossy(s).into_owned());
    split.filter_map(|s| s.split_once(' ').and_then(|(i, n)| Some((i.parse().ok()?, n.to_string())))).collect()
}

/// Names as field data in numbers: an array of a patch's name holds its id and the dimension 2.
fn numbered_names(file: &File) -> Vec<(u32, String)> {
    let field = file.tags.iter().skip_while(|t| t.name != "FieldData").skip(1);
    let pairs = field.take_while(|t| t.name == "DataArray" || t.text.starts_with("/DataArray"));
    pairs
        .filter(|t| t.name == "DataArray")
        .filter_map(|tag| {
            let mut numbers = vec![];
            file.values(tag, |x| {
                numbers.push(x);
                if numbers.len() > 2 { Err("too long".into()) } else { Ok(()) }
            })
            .ok()?;
            let id = numbers.first().filter(|id| numbers.len() == 2 && numbers[1] == 2.0 && **id >= 0.0)?;
            Some((*id as u32, attribute(tag.text, "Name")?.to_string()))
        })
        .collect()
}

/// Reads a volume mesh, or a surface where there are only triangles and other polygons; boundary faces among the cells
/// and their `CellEntityIds` become patches.
pub(super) fn unstructured(bytes: &[u8]) -> Result<AnyMesh, String> {
    let file = File::parse(bytes)?;
    let points = file.points()?;
    let n = file.count("NumberOfCells")?;
    let (ids, offsets) = file.cells("Cells", n, points.len())?;
    let types = file.ids("Cells", "types", 256)?;
    if types.len() != n {
        return Err(format!("{} types for {n} cells", types.len()));
    }
    let mut entity = None;
    for name in ["CellEntityIds", "ModelFaceID", "PatchId"] {
        entity = entity.or(file.array("CellData", Some(name))?.filter(|v| v.len() == n));
    }
    let mut out = Cells { points, names: names(&file), ..Cells::default() };
    for (k, (cell, &kind)) in each_cell(&ids, &offsets).zip(&types).enumerate() {
        let patch = entity.as_ref().map_or(WALL, |e| e[k].max(0.0) as u32);
        match (kind, cell) {
            (10, &[a, b, c, d]) => out.tets.push([a, b, c, d]),
            (13, &[a, b, c, d, e, f]) => out.prisms.push([a, b, c, d, e, f]),
            // A voxel's third and fourth corner are those of a hexahedron swapped.
            (11, &[a, b, c, d, e, f, g, h]) => out.others.push(vec![a, b, d, c, e, f, h, g]),
            (12 | 14, _) if cell.len() == if kind == 12 { 8 } else { 5 } => out.others.push(cell.to_vec()),
            (5 | 7 | 9, polygon) => out.faces.push((polygon.to_vec(), patch)),
            (8, &[a, b, c, d]) => out.faces.push((vec![a, b, d, c], patch)),
            (1..=4, _) => {}
            (other, _) => {
                return Err(format!(
                    "cells of VTK type {other} with {} points; {}",
                    cell.len(),
                    "tetrahedra (10), voxels (11), hexahedra (12), prisms (13) and pyramids (14) are read"
                ));
            }
        }
    }
    drop((ids, offsets, types));
    cells::assemble(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_are_read_behind_polygons_with_their_patches() {
        let array = |name: &str, kind: &str, values: &str| format!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\">{values}</DataArray>");
        let text = format!(
            "<?xml version=\"1.0\"?><VTKFile type=\"PolyData\" version=\"0.1\" byte_order=\"LittleEndian\"><PolyData><Piece NumberOfPoints=\"5\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"1\" NumberOfPolys=\"1\"><CellData>{}</CellData><Points>{}</Points><Polys>{}{}</Polys><Strips>{}{}</Strips></Piece></PolyData></VTKFile>",
            array("PatchId", "Int32", "1 3"),
            "<DataArray type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 0 1 0 1 1 0 0 2 0</DataArray>",
            array("connectivity", "Int64", "0 1 2"),
            array("offsets", "Int64", "3"),
            array("connectivity", "Int64", "1 3 2 4"),
            array("offsets", "Int64", "4"),
        );
        let mesh = poly_data(text.as_bytes()).expect("a surface");
        assert_eq!(mesh.triangles, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(mesh.patch, [1, 3, 3]);
    }
}
