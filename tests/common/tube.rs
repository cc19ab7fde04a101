//! A structured tube of tetrahedra or of prisms and tetrahedra with exact patches.

use lumenmesh::geometry::Point;
use lumenmesh::mesh::{BoundaryFace, Patch, PatchKind, VolumeMesh};

/// A tube along z, millimetres: `rings` rings, ring k of 6 k vertices, `layers` slices of wedges; without `prisms`
/// each wedge is cut into three tetrahedra by the order of the vertex ids, which makes neighbours conform.
pub fn tube(radius: f64, length: f64, rings: usize, layers: usize, prisms: bool) -> VolumeMesh {
    // Disc: centre, then ring k with 6 k vertices.
    let mut disc = vec![[0.0, 0.0]];
    let mut start = vec![0usize];
    for k in 1..=rings {
        start.push(disc.len());
        for i in 0..6 * k {
            let a = std::f64::consts::TAU * i as f64 / (6 * k) as f64;
            let r = radius * k as f64 / rings as f64;
            disc.push([r * a.cos(), r * a.sin()]);
        }
    }
    let at = |k: usize, i: usize| if k == 0 { 0 } else { start[k] + i % (6 * k) };
    let mut triangles: Vec<[usize; 3]> = vec![];
    for k in 1..=rings {
        for s in 0..6 {
            for j in 0..k {
                triangles.push([at(k - 1, s * (k - 1) + j), at(k, s * k + j), at(k, s * k + j + 1)]);
                if j + 1 < k {
                    triangles.push([at(k - 1, s * (k - 1) + j), at(k, s * k + j + 1), at(k - 1, s * (k - 1) + j + 1)]);
                }
            }
        }
    }
    let n = disc.len();
    let mut m = VolumeMesh::default();
    for l in 0..=layers {
        let z = length * l as f64 / layers as f64;
        m.points.extend(disc.iter().map(|p| Point::new(p[0], p[1], z)));
    }
    for l in 0..layers {
        for t in &triangles {
            // Bottom counter-clockwise seen from above; VTK's wedge wants its normal away from the top.
            let b = t.map(|v| (v + l * n) as u32);
            let u = t.map(|v| (v + (l + 1) * n) as u32);
            if prisms {
                m.prisms.push([b[0], b[2], b[1], u[0], u[2], u[1]]);
                continue;
            }
            // Sorted by id the wedge's diagonals leave the smaller vertex on both sides of every face.
            let mut o = [0, 1, 2];
            o.sort_by_key(|&i| b[i]);
            let (p, q) = (o.map(|i| b[i]), o.map(|i| u[i]));
            for t in [[p[0], p[1], p[2], q[2]], [p[0], p[1], q[2], q[1]], [p[0], q[1], q[2], q[0]]] {
                let c = t.map(|v| m.points[v as usize]);
                let positive = (c[1] - c[0]).cross(&(c[2] - c[0])).dot(&(c[3] - c[0])) > 0.0;
                m.tets.push(if positive { t } else { [t[1], t[0], t[2], t[3]] });
            }
        }
    }
    let patch = |id, name: &str, kind| Patch { id, name: name.into(), kind };
    m.patches = vec![Patch::wall(), patch(2, "inlet", PatchKind::Inlet), patch(3, "outlet_1", PatchKind::Outlet)];
    let outer = m.outer_faces().expect("the tube conforms");
    m.boundary = outer
        .into_iter()
        .map(|vertices| {
            let all = |z: f64| vertices.iter().all(|&v| (m.points[v as usize].z - z).abs() < 1e-9 * length);
            BoundaryFace { vertices, patch: if all(0.0) { 2 } else if all(length) { 3 } else { 1 } }
        })
        .collect();
    m
}
