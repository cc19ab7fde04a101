//! STL: ASCII with one solid a patch (snappyHexMesh's form), or binary.
//!
//! ASCII keeps every digit, so that shared vertices stay shared; binary rounds to 32-bit floats.

use std::fmt::Write as _;
use std::io::{self, Write};

use super::text;
use crate::mesh::{Patch, TriMesh, WALL};

/// Writes all patches, one solid each, in the order of their ids; millimetres.
///
/// # Errors
/// What the writer returns.
pub fn write(w: &mut dyn Write, mesh: &TriMesh) -> io::Result<()> {
    if mesh.patches.is_empty() {
        return write_patch(w, mesh, &Patch::wall());
    }
    mesh.patches.iter().try_for_each(|p| write_patch(w, mesh, p))
}

/// Writes the triangles of one patch as one solid.
///
/// # Errors
/// What the writer returns.
pub fn write_patch(w: &mut dyn Write, mesh: &TriMesh, patch: &Patch) -> io::Result<()> {
    let of = |t: usize| mesh.patch.get(t).copied().unwrap_or(WALL);
    let ids: Vec<usize> = (0..mesh.triangles.len()).filter(|&t| of(t) == patch.id).collect();
    writeln!(w, "solid {}", patch.name)?;
    text::items(w, ids.len(), |i, s| {
        let n = mesh.area_vector2(ids[i]);
        let n = if n.norm() > 0.0 { n / n.norm() } else { n };
        let _ = writeln!(s, "facet normal {:e} {:e} {:e}\nouter loop", n.x, n.y, n.z);
        for p in mesh.corners(ids[i]) {
            s.push_str("vertex ");
            text::point(s, &p, 1.0);
            s.push('\n');
        }
        s.push_str("endloop\nendfacet\n");
    })?;
    writeln!(w, "endsolid {}", patch.name)
}

/// Writes binary STL: all triangles, patches forgotten, coordinates rounded to 32 bits.
///
/// # Errors
/// What the writer returns.
pub fn write_binary(w: &mut dyn Write, mesh: &TriMesh) -> io::Result<()> {
    let vector = |v: [f64; 3]| stl_io::Vector::new(v.map(|x| x as f32));
    let triangles = (0..mesh.triangles.len()).map(|t| {
        let n = mesh.area_vector2(t);
        let n = if n.norm() > 0.0 { n / n.norm() } else { n };
        stl_io::Triangle { normal: vector(n.into()), vertices: mesh.corners(t).map(|p| vector(p.coords.into())) }
    });
    stl_io::write_stl(&mut Box::new(w), triangles)
}
