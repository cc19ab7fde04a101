//! From the cells and faces of a file to a mesh: patches from listed faces, other cells than tetrahedra and prisms as
//! polyhedra.

use std::collections::BTreeMap;

use super::mesh::{AnyMesh, fan};
use super::surface_reader::kind_of;
use crate::geometry::Point;
use crate::mesh::faces::{PRISM_FACES, PatchRange, PolyMesh, TET_FACES};
use crate::mesh::{BoundaryFace, Patch, PatchId, TriMesh, VolumeMesh, WALL};

/// What a file holds, in VTK's order of corners.
#[derive(Default)]
pub(super) struct Cells {
    pub points: Vec<Point>,
    pub tets: Vec<[u32; 4]>,
    pub prisms: Vec<[u32; 6]>,
    /// Hexahedra (8 corners) and pyramids (5).
    pub others: Vec<Vec<u32>>,
    /// Polygons with their patch ids.
    pub faces: Vec<(Vec<u32>, PatchId)>,
    /// Names of patch ids.
    pub names: Vec<(PatchId, String)>,
}

/// Faces of a hexahedron, normals out of it.
const HEX_FACES: [&[usize]; 6] = [&[0, 3, 2, 1], &[4, 5, 6, 7], &[0, 1, 5, 4], &[1, 2, 6, 5], &[2, 3, 7, 6], &[3, 0, 4, 7]];
/// Faces of a pyramid, normals out of it.
const PYRAMID_FACES: [&[usize]; 5] = [&[0, 3, 2, 1], &[0, 1, 4], &[1, 2, 4], &[2, 3, 4], &[3, 0, 4]];

fn patch(id: PatchId, names: &[(PatchId, String)]) -> Patch {
    let name = names.iter().find(|n| n.0 == id).map(|n| n.1.clone());
    let name = name.unwrap_or_else(|| if id == WALL { "wall".into() } else { format!("patch_{id}") });
    Patch { id, kind: kind_of(&name), name }
}

fn sorted(v: &[u32]) -> Vec<u32> {
    let mut v = v.to_vec();
    v.sort_unstable();
    v.dedup();
    v
}

/// The mesh: a surface where there are no cells, polyhedra where there are others than tetrahedra and prisms. Outer
/// faces that the file does not list are wall.
pub(super) fn assemble(cells: Cells) -> Result<AnyMesh, String> {
    if cells.tets.is_empty() && cells.prisms.is_empty() && cells.others.is_empty() {
        let mut mesh = TriMesh { points: cells.points, ..TriMesh::default() };
        for (polygon, id) in &cells.faces {
            fan(polygon, mesh.points.len(), &mut mesh.triangles)?;
            mesh.patch.resize(mesh.triangles.len(), *id);
        }
        let mut ids = mesh.patch.clone();
        ids.sort_unstable();
        ids.dedup();
        mesh.patches = ids.into_iter().map(|id| patch(id, &cells.names)).collect();
        return Ok(AnyMesh::Surface(mesh));
    }
    let mut listed: Vec<(Vec<u32>, PatchId)> = cells.faces.iter().map(|(v, id)| (sorted(v), *id)).collect();
    listed.sort();
    let find = |v: &[u32]| listed.binary_search_by(|l| l.0.cmp(&sorted(v))).map_or(WALL, |i| listed[i].1);
    if !cells.others.is_empty() {
        return polyhedra(&cells, find).map(AnyMesh::Polyhedral);
    }
    let mut mesh = VolumeMesh { points: cells.points, tets: cells.tets, prisms: cells.prisms, ..VolumeMesh::default() };
    let outer = mesh.outer_faces().map_err(|e| e.to_string())?;
    mesh.boundary = outer.into_iter().map(|vertices| BoundaryFace { vertices, patch: find(&vertices) }).collect();
    let mut ids: Vec<PatchId> = mesh.boundary.iter().map(|b| b.patch).collect();
    ids.sort_unstable();
    ids.dedup();
    mesh.patches = ids.into_iter().map(|id| patch(id, &cells.names)).collect();
    Ok(AnyMesh::Volume(mesh))
}

/// Cells of any of the kinds as a mesh of faces.
fn polyhedra(cells: &Cells, patch_of: impl Fn(&[u32]) -> PatchId) -> Result<PolyMesh, String> {
    let mut faces: BTreeMap<Vec<u32>, (u32, Option<u32>, Vec<u32>)> = BTreeMap::new();
    let mut count = 0u32;
    let mut add = |corners: &mut dyn Iterator<Item = Vec<u32>>| -> Result<(), String> {
        for v in corners {
            let slot = faces.entry(sorted(&v)).or_insert_with(|| (count, None, v));
            if slot.0 != count {
                match slot.1 {
                    None => slot.1 = Some(count),
                    Some(other) => return Err(format!("a face of cells {}, {other} and {count}: cells overlap", slot.0)),
                }
            }
        }
        count += 1;
        Ok(())
    };
    for t in &cells.tets {
        add(&mut TET_FACES.iter().map(|f| f.iter().map(|&i| t[i]).collect()))?;
    }
    for p in &cells.prisms {
        add(&mut PRISM_FACES.iter().map(|f| f[..if f[2] == f[3] { 3 } else { 4 }].iter().map(|&i| p[i]).collect()))?;
    }
    for c in &cells.others {
        let of: &[&[usize]] = if c.len() == 8 { &HEX_FACES } else { &PYRAMID_FACES };
        add(&mut of.iter().map(|f| f.iter().map(|&i| c[i]).collect()))?;
    }
    let mut inner: Vec<(u32, u32, Vec<u32>)> = vec![];
    let mut outer: Vec<(PatchId, u32, Vec<u32>)> = vec![];
    for (_, (owner, neighbour, v)) in faces {
        match neighbour {
            Some(n) => inner.push((owner, n, v)),
            None => outer.push((patch_of(&v), owner, v)),
        }
    }
    inner.sort();
    outer.sort();
    let mut mesh = PolyMesh { points: cells.points.clone(), cells: count as usize, offsets: vec![0], ..PolyMesh::default() };
    for (owner, v) in inner.iter().map(|f| (f.0, &f.2)).chain(outer.iter().map(|f| (f.1, &f.2))) {
        mesh.owner.push(owner);
        mesh.vertices.extend_from_slice(v);
        mesh.offsets.push(mesh.vertices.len());
    }
    mesh.neighbour = inner.iter().map(|f| f.1).collect();
    let mut start = inner.len();
    for group in outer.chunk_by(|a, b| a.0 == b.0) {
        mesh.patches.push(PatchRange { patch: patch(group[0].0, &cells.names), start, count: group.len() });
        start += group.len();
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quality;

    #[test]
    fn a_cube_and_a_pyramid_on_it_are_measured() {
        let mut points: Vec<Point> = (0..8).map(|i| Point::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect();
        points.push(Point::new(0.5, 0.5, 1.7));
        let cells = Cells {
            points,
            others: vec![vec![0, 1, 3, 2, 4, 5, 7, 6], vec![4, 5, 7, 6, 8]],
            faces: vec![(vec![0, 1, 3, 2], 2)],
            names: vec![(2, "inlet".into())],
            ..Cells::default()
        };
        let Ok(AnyMesh::Polyhedral(mesh)) = assemble(cells) else { panic!("polyhedra") };
        assert_eq!((mesh.cells, mesh.neighbour.len(), mesh.owner.len()), (2, 1, 10));
        let names: Vec<_> = mesh.patches.iter().map(|p| (p.patch.name.as_str(), p.count)).collect();
        assert_eq!(names, [("wall", 8), ("inlet", 1)]);
        let q = quality::polyhedral(&mesh, &Default::default());
        assert_eq!(q.nonpositive_cells, 0);
        assert!((q.openfoam.total_volume - 1.0 - 0.7 / 3.0).abs() < 1e-12, "{}", q.openfoam.total_volume);
    }
}
