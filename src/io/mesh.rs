//! Reads any mesh that `check` measures: STL, PLY, VTP, VTU, OpenFOAM cases and FLUENT's .msh.

use std::fs;
use std::path::Path;

use super::Error;
use super::{foam_reader, msh_reader, surface_reader, vtk_reader};
use crate::mesh::faces::PolyMesh;
use crate::mesh::{TriMesh, VolumeMesh};

/// A mesh as found in a file, in the file's own unit.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyMesh {
    /// Triangles; polygons are cut into triangles.
    Surface(TriMesh),
    /// Tetrahedra and prisms.
    Volume(VolumeMesh),
    /// Cells of any kind, given by their faces; in metres from OpenFOAM and FLUENT.
    Polyhedral(PolyMesh),
}

/// The endings that [`read`] knows.
pub const KNOWN: &str = ".stl, .ply, .vtp, .vtu, .msh (FLUENT ASCII, Gmsh 2.2 and 4.1 ASCII) and OpenFOAM case folders";

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
    if !["stl", "ply", "vtp", "vtu", "msh"].contains(&ending.as_str()) {
        return Err(Error::UnknownFormat { path: path.into(), known: KNOWN });
    }
    let bytes = fs::read(path).map_err(|e| Error::read(path, e))?;
    let wrong = |what: String| Error::malformed(path, what, "write the file again, or convert it to VTP or VTU");
    match ending.as_str() {
        "stl" => surface_reader::stl(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "ply" => surface_reader::ply(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "vtp" => vtk_reader::poly_data(&bytes).map(AnyMesh::Surface).map_err(wrong),
        "vtu" => vtk_reader::unstructured(&bytes).map_err(wrong),
        _ => msh_reader::read(&bytes).map_err(wrong),
    }
}

/// Finishes a volume mesh read without a boundary: every outer face becomes wall.
pub(super) fn with_boundary(mut mesh: VolumeMesh) -> Result<AnyMesh, String> {
    let outer = mesh.outer_faces().map_err(|e| e.to_string())?;
    mesh.patches = vec![crate::mesh::Patch::wall()];
    mesh.boundary = outer.into_iter().map(|vertices| crate::mesh::BoundaryFace { vertices, patch: crate::mesh::WALL }).collect();
    Ok(AnyMesh::Volume(mesh))
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
