//! VTK UnstructuredGrid (.vtu): tetrahedra (type 10) and prisms (type 13).

use std::io::{self, Write};

use super::vtk_xml::{Array, Extra, Piece, Section, Values, connectivity, points_array};
use crate::mesh::VolumeMesh;

/// Writes a volume mesh, tetrahedra first; `skewness` is one value a cell
/// ([`VolumeQuality::per_cell`](crate::quality::VolumeQuality)) and becomes the cell array `EquiVolumeSkewness`;
/// `CellEntityIds` is 0 for every cell, as in VMTK.
///
/// # Errors
/// What the writer returns.
pub fn write(w: &mut dyn Write, mesh: &VolumeMesh, skewness: &[f64], extra: &Extra) -> io::Result<()> {
    let mut all = Extra { point: extra.point.clone(), ..Extra::default() };
    all.cell.push(Array::scalars("EquiVolumeSkewness", Values::F64(skewness.to_vec())));
    all.cell.push(Array::scalars("CellEntityIds", Values::I32(vec![0; mesh.cell_count()])));
    all.cell.extend(extra.cell.iter().cloned());
    all.text = vec![("Units".into(), vec!["mm".into()]), ("CoordinateSystem".into(), vec!["LPS".into()])];
    all.text.extend(extra.text.iter().cloned());
    write_cells(w, mesh, 1.0, false, &all)
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
    let n = types.len();
    let types = Array::scalars("types", Values::U8(types));
    let xyz = points_array(&mesh.points, scale);
    Piece {
        kind: "UnstructuredGrid",
        counts: vec![("NumberOfPoints", mesh.points.len()), ("NumberOfCells", n)],
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
