//! PLY, binary little endian: vertices in double precision, faces with `patch` and `equi_angle_skewness`.

use std::io::{self, Write};

use crate::mesh::{TriMesh, WALL};
use crate::quality::equi_angle_skewness;

/// Writes a surface, millimetres.
///
/// # Errors
/// What the writer returns.
pub fn write(w: &mut dyn Write, mesh: &TriMesh) -> io::Result<()> {
    writeln!(w, "ply\nformat binary_little_endian 1.0\ncomment millimetres, LPS")?;
    for p in &mesh.patches {
        writeln!(w, "comment patch {} {}", p.id, p.name)?;
    }
    writeln!(w, "element vertex {}", mesh.points.len())?;
    writeln!(w, "property double x\nproperty double y\nproperty double z\nelement face {}", mesh.triangles.len())?;
    writeln!(w, "property list uchar int vertex_indices\nproperty int patch\nproperty double equi_angle_skewness\nend_header")?;
    for block in mesh.points.chunks(1 << 14) {
        let bytes: Vec<u8> = block.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f64::to_le_bytes).collect();
        w.write_all(&bytes)?;
    }
    let mut bytes = Vec::with_capacity(25 * mesh.triangles.len());
    for (t, v) in mesh.triangles.iter().enumerate() {
        bytes.push(3);
        v.iter().for_each(|i| bytes.extend_from_slice(&(*i as i32).to_le_bytes()));
        bytes.extend_from_slice(&(mesh.patch.get(t).copied().unwrap_or(WALL) as i32).to_le_bytes());
        bytes.extend_from_slice(&equi_angle_skewness(mesh.corners(t)).to_le_bytes());
    }
    w.write_all(&bytes)
}
