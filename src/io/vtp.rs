//! VTK PolyData (.vtp): surfaces with patches, boundaries of volume meshes, centerlines.

use std::io::{self, Write};

use rayon::prelude::*;

pub use super::vtk_xml::{Array, Extra, Values};
use super::vtk_xml::{Piece, Section, connectivity, points_array};
use crate::centerline::Centerlines;
use crate::geometry::Point;
use crate::mesh::{Patch, TriMesh, VolumeMesh};
use crate::quality::equi_angle_skewness;

/// Writes polygons or lines.
pub(super) fn write_cells(
    w: &mut dyn Write,
    points: &[Point],
    scale: f64,
    lines: bool,
    cells: &[Vec<u32>],
    extra: &Extra,
) -> io::Result<()> {
    let topology = connectivity(cells.iter().map(Vec::as_slice));
    write_connected(w, points, scale, lines, cells.len(), topology, extra)
}

fn write_connected(
    w: &mut dyn Write,
    points: &[Point],
    scale: f64,
    lines: bool,
    n: usize,
    topology: [Array; 2],
    extra: &Extra,
) -> io::Result<()> {
    let xyz = points_array(points, scale);
    Piece {
        kind: "PolyData",
        counts: vec![
            ("NumberOfPoints", points.len()),
            ("NumberOfVerts", 0),
            ("NumberOfLines", if lines { n } else { 0 }),
            ("NumberOfStrips", 0),
            ("NumberOfPolys", if lines { 0 } else { n }),
        ],
        field: &extra.field,
        text: &extra.text,
        sections: vec![
            (Section::PointData, extra.point.iter().collect()),
            (Section::CellData, extra.cell.iter().collect()),
            (Section::Points, vec![&xyz]),
            (Section::Topology(if lines { "Lines" } else { "Polys" }), topology.iter().collect()),
        ],
    }
    .write(w)
}

/// Field data that every surface carries.
fn labels(patches: &[Patch]) -> Vec<(String, Vec<String>)> {
    let id = |p: &Patch| format!("{} {}", p.id, p.name);
    vec![
        ("PatchNames".into(), patches.iter().map(id).collect()),
        ("Units".into(), vec!["mm".into()]),
        ("CoordinateSystem".into(), vec!["LPS".into()]),
    ]
}

/// Writes a surface with the cell arrays `PatchId` and `EquiAngleSkewness`, the field data `PatchNames` ("id name"
/// each), `Units` and `CoordinateSystem`, and whatever `extra` adds.
///
/// # Errors
/// What the writer returns.
pub fn write_surface(w: &mut dyn Write, mesh: &TriMesh, extra: &Extra) -> io::Result<()> {
    let s: Vec<f64> = (0..mesh.triangles.len()).into_par_iter().map(|t| equi_angle_skewness(mesh.corners(t))).collect();
    let mut all = Extra { point: extra.point.clone(), text: labels(&mesh.patches), ..Extra::default() };
    all.field.extend(extra.field.iter().cloned());
    all.cell.push(Array::scalars("PatchId", Values::I32(mesh.patch.iter().map(|&p| p as i32).collect())));
    all.cell.push(Array::scalars("EquiAngleSkewness", Values::F64(s)));
    all.cell.extend(extra.cell.iter().cloned());
    all.text.extend(extra.text.iter().cloned());
    let topology = connectivity(mesh.triangles.iter().map(<[u32; 3]>::as_slice));
    write_connected(w, &mesh.points, 1.0, false, mesh.triangles.len(), topology, &all)
}

/// Writes the boundary of a volume mesh, triangles and quadrilaterals, with its own points only; the point array
/// `VolumePointId` leads back to the volume mesh; cell arrays `PatchId` and `CellEntityIds` (the same, VMTK's name).
///
/// # Errors
/// What the writer returns.
pub fn write_boundary(w: &mut dyn Write, mesh: &VolumeMesh) -> io::Result<()> {
    let (ids, cells) = own_points(mesh.points.len(), mesh.boundary.iter().map(|b| b.ids()));
    let points: Vec<Point> = ids.iter().map(|&v| mesh.points[v as usize]).collect();
    let patch: Vec<i32> = mesh.boundary.iter().map(|b| b.patch as i32).collect();
    let extra = Extra {
        point: vec![Array::scalars("VolumePointId", Values::I64(ids.iter().map(|&v| i64::from(v)).collect()))],
        cell: vec![
            Array::scalars("PatchId", Values::I32(patch.clone())),
            Array::scalars("CellEntityIds", Values::I32(patch)),
        ],
        field: vec![],
        text: labels(&mesh.patches),
    };
    write_cells(w, &points, 1.0, false, &cells, &extra)
}

/// The points that `cells` use, in rising order, and the cells in terms of these.
pub(super) fn own_points<'a>(n: usize, cells: impl Iterator<Item = &'a [u32]> + Clone) -> (Vec<u32>, Vec<Vec<u32>>) {
    let mut new = vec![u32::MAX; n];
    cells.clone().flatten().for_each(|&v| new[v as usize] = 0);
    let ids: Vec<u32> = (0..n as u32).filter(|&v| new[v as usize] == 0).collect();
    for (k, &v) in ids.iter().enumerate() {
        new[v as usize] = k as u32;
    }
    (ids, cells.map(|c| c.iter().map(|&v| new[v as usize]).collect()).collect())
}

/// Writes centerlines, one polyline a branch, under VMTK's names: point arrays `MaximumInscribedSphereRadius` and
/// `Abscissas` (arc length from the branch's start), `Tangents`; cell arrays `GroupIds`, `BranchId`, `CenterlineIds`,
/// `TractIds`, `Blanking`.
///
/// # Errors
/// What the writer returns.
pub fn write_centerlines(w: &mut dyn Write, lines: &Centerlines) -> io::Result<()> {
    let samples: Vec<_> = lines.branches.iter().flat_map(|b| &b.samples).collect();
    let points: Vec<Point> = samples.iter().map(|s| s.point).collect();
    let mut next = 0;
    let cells: Vec<Vec<u32>> = lines
        .branches
        .iter()
        .map(|b| {
            let from = next;
            next += b.samples.len() as u32;
            (from..next).collect()
        })
        .collect();
    let ids: Vec<i32> = (0..cells.len() as i32).collect();
    let int = |name: &str, v: Vec<i32>| Array::scalars(name, Values::I32(v));
    let extra = Extra {
        point: vec![
            Array::scalars("MaximumInscribedSphereRadius", Values::F64(samples.iter().map(|s| s.radius).collect())),
            Array::scalars("Abscissas", Values::F64(samples.iter().map(|s| s.arc_length).collect())),
            Array::vectors("Tangents", samples.iter().flat_map(|s| [s.tangent.x, s.tangent.y, s.tangent.z]).collect()),
        ],
        cell: vec![
            int("GroupIds", ids.clone()),
            int("BranchId", ids.clone()),
            int("CenterlineIds", ids),
            int("TractIds", vec![0; cells.len()]),
            int("Blanking", vec![0; cells.len()]),
            int("ComponentId", lines.branches.iter().map(|b| b.component as i32).collect()),
        ],
        field: vec![],
        text: vec![("Units".into(), vec!["mm".into()]), ("CoordinateSystem".into(), vec!["LPS".into()])],
    };
    write_cells(w, &points, 1.0, true, &cells, &extra)
}
