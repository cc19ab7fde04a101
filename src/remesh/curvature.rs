//! Curvature of an implicit surface at the vertices of its polygonization.

use rayon::prelude::*;

use super::Error;
use super::repair_moves::tangent_basis;
use crate::geometry::Vector;
use crate::implicit::Implicit;
use crate::mesh::TriMesh;
use crate::mesh::halfedge::HalfEdgeMesh;

/// Largest absolute principal curvature at every vertex, 1/mm, smoothed over two rings.
///
/// The shape operator that maps edge vectors to differences of the implicit's unit gradients, in the sense of least
/// squares: one evaluation of the implicit a vertex, where second differences need six.
///
/// # Errors
/// [`Error::NotManifold`] for a mesh that is not closed.
pub fn largest_curvature(mesh: &TriMesh, f: &dyn Implicit) -> Result<Vec<f64>, Error> {
    let normal: Vec<Vector> = mesh
        .points
        .par_iter()
        .map(|p| f.gradient(p).try_normalize(0.0).unwrap_or_else(Vector::zeros))
        .collect();
    let m = HalfEdgeMesh::new(mesh)
        .map_err(|report| Error::NotManifold { at: report.first_fault(mesh), report })?;
    let mut kappa: Vec<f64> =
        (0..mesh.points.len() as u32).into_par_iter().map(|v| curvature_at(&m, &normal, v)).collect();
    for _ in 0..2 {
        kappa = (0..mesh.points.len() as u32)
            .into_par_iter()
            .map(|v| {
                let (mut sum, mut n) = (2.0 * kappa[v as usize], 2.0);
                for h in m.outgoing(v) {
                    sum += kappa[m.target(h) as usize];
                    n += 1.0;
                }
                sum / n
            })
            .collect();
    }
    Ok(kappa)
}

fn curvature_at(m: &HalfEdgeMesh, normal: &[Vector], v: u32) -> f64 {
    let n = normal[v as usize];
    let Some((x, y)) = tangent_basis(&n) else { return 0.0 };
    // Normal equations of S = [a b; b c] over the two rings' edge vectors (u, w) and normal differences (p, q).
    let (mut uu, mut uw, mut ww) = (0.0, 0.0, 0.0);
    let (mut up, mut mixed, mut wq) = (0.0, 0.0, 0.0);
    let mut add = |t: u32| {
        let d = m.points[t as usize] - m.points[v as usize];
        let e = normal[t as usize] - n;
        let (u, w, p, q) = (d.dot(&x), d.dot(&y), e.dot(&x), e.dot(&y));
        uu += u * u;
        uw += u * w;
        ww += w * w;
        up += u * p;
        mixed += w * p + u * q;
        wq += w * q;
    };
    for h in m.outgoing(v) {
        let t = m.target(h);
        add(t);
        m.outgoing(t).map(|g| m.target(g)).filter(|&t| t != v).for_each(&mut add);
    }
    let matrix = nalgebra::Matrix3::new(uu, uw, 0.0, uw, uu + ww, uw, 0.0, uw, ww);
    let ridge = 1e-9 * (uu + ww);
    let Some(s) = (matrix + nalgebra::Matrix3::identity() * ridge).cholesky() else { return 0.0 };
    let s = s.solve(&nalgebra::Vector3::new(up, mixed, wq));
    let (mean, half) = (0.5 * (s.x + s.z), 0.5 * (s.x - s.z));
    mean.abs() + half.hypot(s.y)
}
