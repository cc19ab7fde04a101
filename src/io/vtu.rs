//! VTK UnstructuredGrid (.vtu): tetrahedra (type 10) and prisms (type 13).

use std::io::{self, Write};

use super::vtk_xml::{Array, Extra, Piece, Section, Values, connectivity, millimetres, points_array};
use super::vtp::own_points;
use crate::geometry::Point;
use crate::mesh::VolumeMesh;

/// Writes a volume mesh, tetrahedra first; `skewness` is one value a cell
/// ([`VolumeQuality::per_cell`](crate::quality::VolumeQuality)) and becomes the cell array `EquiVolumeSkewness`;
/// `CellEntityIds` is 0 for every cell, as in VMTK. Field data are numbers: `MetresPerUnit` and `CoordinatesLPS`.
///
/// # Errors
/// What the writer returns.
pub fn write(w: &mut dyn Write, mesh: &VolumeMesh, skewness: &[f64], extra: &Extra) -> io::Result<()> {
    let mut all = Extra { point: extra.point.clone(), ..Extra::default() };
    all.cell.push(Array::scalars("EquiVolumeSkewness", Values::F64(skewness.to_vec())));
    all.cell.push(Array::scalars("CellEntityIds", Values::I32(vec![0; mesh.cell_count()])));
    all.cell.extend(extra.cell.iter().cloned());
    all.field = millimetres();
    all.field.extend(extra.field.iter().cloned());
    write_cells(w, mesh, 1.0, false, &all)
}

/// Writes the boundary of a volume mesh as an UnstructuredGrid of triangles and quadrilaterals, with its own points
/// only, for readers that know no PolyData (meshio, and so FEniCS). The point array `VolumePointId` leads back to the
/// volume mesh; `PatchId` is the patch of each face. Field data: units as [`write`], and for each patch an array of its
/// name with its id and the dimension 2, as meshio has it of Gmsh's files.
///
/// # Errors
/// What the writer returns.
pub fn write_boundary(w: &mut dyn Write, mesh: &VolumeMesh) -> io::Result<()> {
    let (ids, cells) = own_points(mesh.points.len(), mesh.boundary.iter().map(|b| b.ids()));
    let points: Vec<Point> = ids.iter().map(|&v| mesh.points[v as usize]).collect();
    let patch: Vec<i32> = mesh.boundary.iter().map(|b| b.patch as i32).collect();
    let mut field = millimetres();
    field.extend(mesh.patches.iter().map(|p| Array { name: p.name.clone(), components: 2, values: Values::I32(vec![p.id as i32, 2]) }));
    let extra = Extra {
        point: vec![Array::scalars("VolumePointId", Values::I64(ids.iter().map(|&v| i64::from(v)).collect()))],
        cell: vec![Array::scalars("PatchId", Values::I32(patch))],
        field,
        text: vec![],
    };
    let types = cells.iter().map(|c| if c.len() == 3 { 5 } else { 9 }).collect();
    write_grid(w, &points, 1.0, connectivity(cells.iter().map(Vec::as_slice)), types, &extra)
}

/// Writes a volume mesh with its boundary in the same file as VMTK does: `CellEntityIds` is 0 for the cells inside,
/// the patch id (wall 1, openings from 2) for boundary triangles and quadrilaterals, which follow the cells.
///
/// # Errors
/// What the writer returns.
pub fn write_vmtk(w: &mut dyn Write, mesh: &VolumeMesh) -> io::Result<()> {
    let mut ids = vec![0; mesh.cell_count()];
    ids.extend(mesh.boundary.iter().map(|b| b.patch as i32));
    let extra = Extra { cell: vec![Array::scalars("CellEntityIds", Values::I32(ids))], ..Extra::default() };
    write_cells(w, mesh, 1.0, true, &extra)
}

pub(super) fn write_cells(w: &mut dyn Write, mesh: &VolumeMesh, scale: f64, boundary: bool, extra: &Extra) -> io::Result<()> {
    let surface = if boundary { &mesh.boundary[..] } else { &[] };
    let cells = mesh.tets.iter().map(|t| &t[..]).chain(mesh.prisms.iter().map(|p| &p[..]));
    let [ids, offsets] = connectivity(cells.chain(surface.iter().map(|b| b.ids())));
    let mut types = vec![10; mesh.tets.len()];
    types.resize(mesh.cell_count(), 13);
    types.extend(surface.iter().map(|b| if b.ids().len() == 3 { 5 } else { 9 }));
    write_grid(w, &mesh.points, scale, [ids, offsets], types, extra)
}

fn write_grid(
    w: &mut dyn Write,
    points: &[Point],
    scale: f64,
    [ids, offsets]: [Array; 2],
    types: Vec<u8>,
    extra: &Extra,
) -> io::Result<()> {
    let n = types.len();
    let types = Array::scalars("types", Values::U8(types));
    let xyz = points_array(points, scale);
    Piece {
        kind: "UnstructuredGrid",
        counts: vec![("NumberOfPoints", points.len()), ("NumberOfCells", n)],
        field: &extra.field,
        text: &extra.text,
        sections: vec![
            (Section::PointData, extra.point.iter().collect()),
            (Section::CellData, extra.cell.iter().collect()),
            (Section::Points, vec![&xyz]),
            (Section::Topology("Cells"), vec![&ids, &offsets, &types]),
        ],
    }
    .write(w)
}
