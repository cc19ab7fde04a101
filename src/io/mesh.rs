//! Reads any mesh that `check` measures: STL, PLY, OBJ, VTP, VTU, legacy VTK PolyData, OpenFOAM cases and FLUENT's .msh.

use std::fs;
use std::path::Path;

use serde::Serialize;

use super::Error;
use super::{foam_reader, msh_reader, surface_reader, vtk_legacy, vtk_reader};
use crate::geometry::Aabb;
use crate::mesh::faces::PolyMesh;
use crate::mesh::{Patch, TriMesh, VolumeMesh};

/// A mesh as found in a file, in the file's own unit.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyMesh {
    /// Triangles; polygons are cut into triangles.
    Surface(TriMesh),
    /// Tetrahedra and prisms.
    Volume(VolumeMesh),
    /// Cells of any kind, given by their faces: from OpenFOAM and FLUENT in metres, or with hexahedra or pyramids.
    Polyhedral(PolyMesh),
}

/// A patch of a mesh that was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PatchCount {
    /// Name in the file, or made from its number.
    pub name: String,
    /// Faces; triangles after polygons were cut.
    pub faces: usize,
}

impl AnyMesh {
    /// Diagonal of the box round all points, in the file's unit.
    pub fn size(&self) -> f64 {
        let points = match self {
            AnyMesh::Surface(m) => &m.points,
            AnyMesh::Volume(m) => &m.points,
            AnyMesh::Polyhedral(m) => &m.points,
        };
        if points.is_empty() { 0.0 } else { Aabb::of(points).diagonal() }
    }

    /// The patches in their order.
    pub fn patches(&self) -> Vec<PatchCount> {
        let count = |p: &Patch, ids: &mut dyn Iterator<Item = u32>| PatchCount { name: p.name.clone(), faces: ids.filter(|&i| i == p.id).count() };
        match self {
            AnyMesh::Surface(m) => m.patches.iter().map(|p| count(p, &mut m.patch.iter().copied())).collect(),
            AnyMesh::Volume(m) => m.patches.iter().map(|p| count(p, &mut m.boundary.iter().map(|b| b.patch))).collect(),
            AnyMesh::Polyhedral(m) => m.patches.iter().map(|p| PatchCount { name: p.patch.name.clone(), faces: p.count }).collect(),
        }
    }
}

/// The endings that [`read`] knows.
pub const KNOWN: &str = ".stl, .ply, .obj, .vtp, .vtk (PolyData), .vtu, .msh (FLUENT ASCII, Gmsh 2.2 and 4.1 ASCII) and OpenFOAM case folders";

/// Reads a mesh; the kind follows from the name, and from the content where that is not enough.
///
/// Coordinates stay as they are in the file. Sizes are checked against the file's length before memory is taken.
///
/// # Errors
/// A file that cannot be read, breaks its format's rules, or holds what is not read here.
pub fn read(path: &Path) -> Result<AnyMesh, Error> {
    if path.is_dir() {
        return foam_reader::read(path).map(AnyMesh::Polyhedral);
    }
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
    if ending == "foam" {
        return foam_reader::read(path.parent().unwrap_or(Path::new("."))).map(AnyMesh::Polyhedral);
    }
    if !["stl", "ply", "obj", "vtp", "vtk", "vtu", "msh"].contains(&ending.as_str()) {
        return Err(Error::UnknownFormat { path: path.into(), known: KNOWN });
    }
    let bytes = fs::read(path).map_err(|e| Error::read(path, e))?;
    let wrong = |what: String| Error::malformed(path, what, "write the file again, or convert it to VTP or VTU");
    match ending.as_str() {
        "stl" => surface_reader::stl(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "ply" => surface_reader::ply(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "obj" => surface_reader::obj(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "vtk" => vtk_legacy::poly_data(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "vtp" => vtk_reader::poly_data(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "vtu" => vtk_reader::unstructured(&bytes).map_err(wrong),
        _ => msh_reader::read(&bytes).map_err(wrong),
    }
}

/// Whether a mesh that [`read`] accepts is in metres, as OpenFOAM and FLUENT have it; all others are taken as millimetres.
pub fn is_in_metres(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
    let first = || {
        let mut byte = [0];
        let read = fs::File::open(path).and_then(|mut f| std::io::Read::read(&mut f, &mut byte));
        read.is_ok_and(|n| n == 1 && byte[0] == b'(')
    };
    path.is_dir() || ending == "foam" || (ending == "msh" && first())
}

/// Triangles of a polygon as a fan; corners are checked against the number of points.
pub(super) fn fan(polygon: &[u32], points: usize, out: &mut Vec<[u32; 3]>) -> Result<(), String> {
    if polygon.len() < 3 {
        return Err(format!("a polygon with {} corners", polygon.len()));
    }
    if let Some(v) = polygon.iter().find(|&&v| v as usize >= points) {
        return Err(format!("a polygon names point {v}, but there are {points}"));
    }
    out.extend((1..polygon.len() - 1).map(|i| [polygon[0], polygon[i], polygon[i + 1]]));
    Ok(())
}

/// Triangles of a strip, each with the next corner; every second runs the other way round.
pub(super) fn strip(corners: &[u32], points: usize, out: &mut Vec<[u32; 3]>) -> Result<(), String> {
    if corners.len() < 3 {
        return Err(format!("a strip with {} corners", corners.len()));
    }
    if let Some(v) = corners.iter().find(|&&v| v as usize >= points) {
        return Err(format!("a strip names point {v}, but there are {points}"));
    }
    out.extend(corners.windows(3).enumerate().map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] }));
    Ok(())
}
