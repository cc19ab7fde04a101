//! `constant/polyMesh` in ASCII: points, faces, owner, neighbour, boundary.

use std::fs::{File, create_dir_all};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use super::header;
use crate::io::text;
use crate::mesh::PatchKind;
use crate::mesh::faces::{FaceList, FaceMesh};

/// Writes `CASE/constant/polyMesh` in metres, upper-triangular; walls have type `wall` and the group `wall`, which
/// wallShearStress asks for.
///
/// # Errors
/// What the system returns; files already written stay.
pub fn write_poly_mesh(case: &Path, faces: &FaceList<'_>) -> io::Result<()> {
    let folder = case.join("constant").join("polyMesh");
    create_dir_all(&folder)?;
    let (np, nf, ni) = (faces.points.len(), faces.owner.len(), faces.neighbour.len());
    let note = format!("nPoints:{np}  nCells:{}  nFaces:{nf}  nInternalFaces:{ni}", faces.cells);
    let start = |name: &str, class: &str, note: &str, n: usize| -> io::Result<BufWriter<File>> {
        let mut w = BufWriter::new(File::create(folder.join(name))?);
        write!(w, "{}{n}\n(\n", header(class, "constant/polyMesh", name, note))?;
        Ok(w)
    };
    let finish = |mut w: BufWriter<File>| -> io::Result<()> {
        w.write_all(b")\n")?;
        w.flush()
    };
    let mut w = start("points", "vectorField", "", np)?;
    text::items(&mut w, np, |i, s| {
        s.push('(');
        text::point(s, &faces.points[i], 1000.0);
        s.push_str(")\n");
    })?;
    finish(w)?;
    let mut w = start("faces", "faceList", "", nf)?;
    text::items(&mut w, nf, |f, s| {
        let v = faces.face(f);
        s.push(if v.len() == 3 { '3' } else { '4' });
        for (i, &n) in v.iter().enumerate() {
            s.push(if i == 0 { '(' } else { ' ' });
            text::integer(s, n);
        }
        s.push_str(")\n");
    })?;
    finish(w)?;
    for (name, list) in [("owner", &faces.owner), ("neighbour", &faces.neighbour)] {
        let mut w = start(name, "labelList", &note, list.len())?;
        text::items(&mut w, list.len(), |f, s| {
            text::integer(s, list[f]);
            s.push('\n');
        })?;
        finish(w)?;
    }
    let mut w = start("boundary", "polyBoundaryMesh", "", faces.patches.len())?;
    for p in &faces.patches {
        let kind = match p.patch.kind {
            PatchKind::Wall => "        type            wall;\n        inGroups        1(wall);\n",
            PatchKind::Inlet | PatchKind::Outlet => "        type            patch;\n",
        };
        write!(
            w,
            "    {}\n    {{\n{kind}        nFaces          {};\n        startFace       {};\n    }}\n",
            p.patch.name, p.count, p.start
        )?;
    }
    finish(w)
}
