//! Gmsh 4.1 ASCII (.msh) with physical groups: one surface entity a patch, one volume entity `fluid`; millimetres.

use std::io::{self, Write};

use super::text;
use crate::geometry::Aabb;
use crate::mesh::{Patch, VolumeMesh};

/// Tag of the volume's physical group.
const FLUID: u32 = 1;

/// Writes the mesh; physical surfaces carry the patches' ids and names, the physical volume is `fluid` (1).
///
/// # Errors
/// What the writer returns.
pub fn write(w: &mut dyn Write, mesh: &VolumeMesh) -> io::Result<()> {
    let wall = [Patch::wall()];
    let patches: &[Patch] = if mesh.patches.is_empty() { &wall } else { &mesh.patches };
    writeln!(w, "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n{}", patches.len() + 1)?;
    for p in patches {
        writeln!(w, "2 {} \"{}\"", p.id, p.name)?;
    }
    let b = Aabb::of(&mesh.points);
    let bounds = format!("{} {} {} {} {} {}", b.min.x, b.min.y, b.min.z, b.max.x, b.max.y, b.max.z);
    writeln!(w, "3 {FLUID} \"fluid\"\n$EndPhysicalNames\n$Entities\n0 0 {} 1", patches.len())?;
    for p in patches {
        writeln!(w, "{} {bounds} 1 {} 0", p.id, p.id)?;
    }
    write!(w, "{FLUID} {bounds} 1 {FLUID} {}", patches.len())?;
    for p in patches {
        write!(w, " {}", p.id)?;
    }
    let n = mesh.points.len();
    writeln!(w, "\n$EndEntities\n$Nodes\n1 {n} 1 {n}\n3 {FLUID} 0 {n}")?;
    text::items(w, n, |i, s| {
        text::integer(s, i as u64 + 1);
        s.push('\n');
    })?;
    text::items(w, n, |i, s| {
        text::point(s, &mesh.points[i], 1.0);
        s.push('\n');
    })?;
    // One block for each patch and each kind of element.
    let mut blocks: Vec<(u32, u32, u32, Vec<&[u32]>)> = vec![];
    for p in patches {
        for (corners, kind) in [(3, 2), (4, 3)] {
            let of = mesh.boundary.iter().filter(|f| f.patch == p.id).map(|f| f.ids()).filter(|f| f.len() == corners);
            blocks.push((2, p.id, kind, of.collect()));
        }
    }
    // Gmsh's prism has its first triangle facing the second: VTK's the other way round.
    let prisms: Vec<[u32; 6]> = mesh.prisms.iter().map(|&[a, b, c, d, e, f]| [a, c, b, d, f, e]).collect();
    blocks.push((3, FLUID, 4, mesh.tets.iter().map(|t| &t[..]).collect()));
    blocks.push((3, FLUID, 6, prisms.iter().map(|p| &p[..]).collect()));
    blocks.retain(|b| !b.3.is_empty());
    let total: usize = blocks.iter().map(|b| b.3.len()).sum();
    writeln!(w, "$EndNodes\n$Elements\n{} {total} 1 {total}", blocks.len())?;
    let mut tag = 1;
    for (dim, entity, kind, cells) in &blocks {
        writeln!(w, "{dim} {entity} {kind} {}", cells.len())?;
        text::items(w, cells.len(), |i, s| {
            text::integer(s, (tag + i) as u64);
            for &v in cells[i] {
                s.push(' ');
                text::integer(s, u64::from(v) + 1);
            }
            s.push('\n');
        })?;
        tag += cells.len();
    }
    writeln!(w, "$EndElements")
}
