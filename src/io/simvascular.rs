//! SimVascular's `mesh-complete` folder, centimetres: the volume, its exterior, and one file a face.

use std::fs::{File, create_dir_all};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use super::vtk_xml::{Array, Extra, Values};
use super::{vtp, vtu};
use crate::mesh::faces::{FaceList, FaceMesh};
use crate::mesh::{PatchKind, VolumeMesh};

/// Centimetres a millimetre.
const CM: f64 = 0.1;

/// Writes `mesh-complete.mesh.vtu`, `mesh-complete.exterior.vtp`, `walls_combined.vtp` and
/// `mesh-surfaces/<patch>.vtp` (walls as `wall_<name>`, unless the name starts so) into `folder`.
///
/// `GlobalNodeID` and `GlobalElementID` are Int32 and count from 1; on faces `GlobalElementID` is the cell behind
/// the face. `ModelFaceID` is the patch id, `ModelRegionID` is 1.
///
/// The solver's reader takes one kind of cells: split prisms first ([`prisms`](crate::mesh::split::prisms)).
///
/// # Errors
/// A mesh with prisms is refused; else what the system returns; files already written stay.
pub fn write(folder: &Path, mesh: &VolumeMesh, faces: &FaceList<'_>) -> io::Result<()> {
    if !mesh.prisms.is_empty() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "SimVascular takes tetrahedra only: split the prisms first"));
    }
    create_dir_all(folder.join("mesh-surfaces"))?;
    let create = |name: &str| File::create(folder.join(name)).map(BufWriter::new);
    let int = |name: &str, v: Vec<i32>| Array::scalars(name, Values::I32(v));
    let (np, nc) = (mesh.points.len() as i32, mesh.cell_count());
    let extra = Extra {
        point: vec![int("GlobalNodeID", (1..=np).collect())],
        cell: vec![int("GlobalElementID", (1..=nc as i32).collect()), int("ModelRegionID", vec![1; nc])],
        ..Extra::default()
    };
    let mut file = create("mesh-complete.mesh.vtu")?;
    vtu::write_cells(&mut file, mesh, CM, false, &extra)?;
    file.flush()?;
    let surface = |name: &str, keep: &dyn Fn(usize) -> bool| -> io::Result<()> {
        let mut list: Vec<(usize, i32)> = vec![];
        for (k, p) in faces.patches.iter().enumerate().filter(|&(k, _)| keep(k)) {
            list.extend((p.start..p.start + p.count).map(|f| (f, faces.patches[k].patch.id as i32)));
        }
        let (ids, cells) = vtp::own_points(mesh.points.len(), list.iter().map(|&(f, _)| faces.face(f)));
        let points: Vec<_> = ids.iter().map(|&v| mesh.points[v as usize]).collect();
        let extra = Extra {
            point: vec![int("GlobalNodeID", ids.iter().map(|&v| v as i32 + 1).collect())],
            cell: vec![
                int("GlobalElementID", list.iter().map(|&(f, _)| faces.owner[f] as i32 + 1).collect()),
                int("ModelFaceID", list.iter().map(|l| l.1).collect()),
                int("ModelRegionID", vec![1; list.len()]),
            ],
            ..Extra::default()
        };
        let mut file = create(name)?;
        vtp::write_cells(&mut file, &points, CM, false, &cells, &extra)?;
        // A full disk shows here; a buffer that is dropped says nothing.
        file.flush()
    };
    let wall = |k: usize| faces.patches[k].patch.kind == PatchKind::Wall;
    surface("mesh-complete.exterior.vtp", &|_| true)?;
    surface("walls_combined.vtp", &wall)?;
    for (k, p) in faces.patches.iter().enumerate().filter(|p| p.1.count > 0) {
        let name = &p.patch.name;
        let name = if wall(k) && !name.starts_with("wall") { format!("wall_{name}") } else { name.clone() };
        surface(&format!("mesh-surfaces/{name}.vtp"), &|j| j == k)?;
    }
    Ok(())
}
