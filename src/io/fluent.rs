//! FLUENT's ASCII mesh (.msh), metres.
//!
//! All numbers in the sections 10, 12 and 13 are hexadecimal and count from 1; the zone id in section 45 is decimal.
//! The right-hand normal of a face's listed nodes points into its first cell: fluentMeshToFoam and
//! fluent3DMeshToFoam take the opposite for negative volumes. Readers: FLUENT, and both converters of OpenFOAM.

use std::fmt::Write as _;
use std::io::{self, Write};

use super::text;
use crate::mesh::faces::{FaceList, FaceMesh};
use crate::mesh::{PatchKind, VolumeMesh};

/// Writes the mesh; inlets become velocity inlets, outlets pressure outlets. The cell zone is `fluid` (2), inner
/// faces are `interior-fluid` (3), patches follow from 4 on in the order of their ids. Patches without faces are
/// left out.
///
/// # Errors
/// What the writer returns.
pub fn write(w: &mut dyn Write, mesh: &VolumeMesh, faces: &FaceList<'_>) -> io::Result<()> {
    let (np, nc, nf, ni) = (mesh.points.len(), mesh.cell_count(), faces.owner.len(), faces.neighbour.len());
    write!(w, "(0 \"lumenmesh (metres)\")\n(0 \"Dimensions:\")\n(2 3)\n(0 \"Nodes:\")\n(10 (0 1 {np:x} 0 3))\n")?;
    write!(w, "(10 (1 1 {np:x} 1 3)(\n")?;
    text::items(w, np, |i, s| {
        text::point(s, &mesh.points[i], 1000.0);
        s.push('\n');
    })?;
    write!(w, "))\n(0 \"Cells:\")\n(12 (0 1 {nc:x} 0))\n")?;
    match (mesh.tets.is_empty(), mesh.prisms.is_empty()) {
        (_, true) => writeln!(w, "(12 (2 1 {nc:x} 1 2))")?,
        (true, false) => writeln!(w, "(12 (2 1 {nc:x} 1 6))")?,
        (false, false) => {
            write!(w, "(12 (2 1 {nc:x} 1 0)(\n")?;
            text::items(w, nc, |c, s| {
                s.push(if c < mesh.tets.len() { '2' } else { '6' });
                s.push(if c % 40 == 39 || c + 1 == nc { '\n' } else { ' ' });
            })?;
            writeln!(w, "))")?;
        }
    }
    write!(w, "(0 \"Faces:\")\n(13 (0 1 {nf:x} 0))\n")?;
    let mut zones = vec![("interior-fluid", "interior", 2, 0, ni)];
    for p in faces.patches.iter().filter(|p| p.count > 0) {
        let (name, code) = match p.patch.kind {
            PatchKind::Wall => ("wall", 3),
            PatchKind::Inlet => ("velocity-inlet", 0xa),
            PatchKind::Outlet => ("pressure-outlet", 5),
        };
        zones.push((&p.patch.name, name, code, p.start, p.count));
    }
    for (k, &(name, _, code, start, count)) in zones.iter().enumerate().filter(|z| z.1.4 > 0) {
        let size = faces.face(start).len();
        let mixed = faces.vertices[start..start + count].iter().any(|v| if v[2] == v[3] { size != 3 } else { size != 4 });
        let kind = if mixed { 0 } else { size };
        write!(w, "(0 \"zone {name}\")\n(13 ({:x} {:x} {:x} {code:x} {kind:x})(\n", k + 3, start + 1, start + count)?;
        text::items(w, count, |i, s| {
            let f = start + i;
            let v = faces.face(f);
            if mixed {
                let _ = write!(s, "{} ", v.len());
            }
            // The list's normals leave the owner; reversed they point into it.
            for &n in v.iter().rev() {
                text::hex(s, u64::from(n) + 1);
                s.push(' ');
            }
            text::hex(s, u64::from(faces.owner[f]) + 1);
            s.push(' ');
            text::hex(s, faces.neighbour.get(f).map_or(0, |&n| u64::from(n) + 1));
            s.push('\n');
        })?;
        writeln!(w, "))")?;
    }
    write!(w, "(0 \"Zone names: decimal ids\")\n(45 (2 fluid fluid)())\n")?;
    for (k, (name, kind, ..)) in zones.iter().enumerate().filter(|z| z.1.4 > 0) {
        writeln!(w, "(45 ({} {kind} {name})())", k + 3)?;
    }
    Ok(())
}
