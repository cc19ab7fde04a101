//! Closing the open ends of a surface with flat lids.

use serde::Serialize;

use super::TriMesh;
use crate::geometry::{Point, Vector};

/// A hole that was closed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Hole {
    /// Middle of its rim, mm.
    pub center: Point,
    /// Unit normal of the plane through its rim, out of the body.
    pub normal: Vector,
    /// Mean distance of the rim from its middle, mm.
    pub radius: f64,
    /// Edges of the rim.
    pub edges: usize,
}

/// Why a hole cannot be closed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HoleError {
    /// Open edges that form no loop.
    #[error("the surface is torn at ({x:.4}, {y:.4}, {z:.4}) mm: the open edges there form no simple loop; repair the surface or give the mask that it came from", x = at[0], y = at[1], z = at[2])]
    Torn {
        /// Position of a point with several open edges.
        at: [f64; 3],
    },
    /// The rim is far from flat.
    #[error("the hole of {edges} edges round ({x:.4}, {y:.4}, {z:.4}) mm is no flat end (its rim leaves its plane by {bend:.2} radii): close it, or give the mask that the surface came from", x = at[0], y = at[1], z = at[2])]
    Bent {
        /// Edges of the rim.
        edges: usize,
        /// Middle of the rim.
        at: [f64; 3],
        /// Largest distance of the rim from its plane, in mean radii.
        bend: f64,
    },
}

/// A rim may leave its plane by this part of its mean radius.
const FLAT: f64 = 0.4;

/// Closes every hole of an otherwise sound surface by a fan round the middle of its rim.
///
/// Vessels cut open at their ends are closed this way. Holes in the order of their first vertex.
///
/// # Errors
/// [`HoleError`] with the place where open edges form no loop, or a rim is too far from flat to be a vessel's end.
pub fn close(mesh: &TriMesh) -> Result<(TriMesh, Vec<Hole>), HoleError> {
    let mut directed: Vec<[u32; 2]> = mesh.triangles.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]).collect();
    directed.sort_unstable();
    let open: Vec<[u32; 2]> = directed.iter().copied().filter(|[a, b]| directed.binary_search(&[*b, *a]).is_err()).collect();
    let mut out = mesh.clone();
    let mut holes = Vec::new();
    let mut used = vec![false; open.len()];
    for first in 0..open.len() {
        if used[first] {
            continue;
        }
        let mut rim: Vec<u32> = Vec::new();
        let mut at = first;
        while !used[at] {
            used[at] = true;
            rim.push(open[at][0]);
            let end = open[at][1];
            at = open.partition_point(|e| e[0] < end);
            let torn = || HoleError::Torn { at: mesh.points[end as usize].into() };
            if open.get(at).is_none_or(|e| e[0] != end) || open.get(at + 1).is_some_and(|e| e[0] == end) {
                return Err(torn());
            }
            if used[at] && open[at][0] != rim[0] {
                return Err(torn());
            }
        }
        let hole = measure(mesh, &rim)?;
        let center = out.points.len() as u32;
        out.points.push(hole.center);
        for i in 0..rim.len() {
            // Against the direction of the triangles that have the edge.
            out.triangles.push([rim[(i + 1) % rim.len()], rim[i], center]);
            out.patch.push(super::WALL);
        }
        holes.push(hole);
    }
    Ok((out, holes))
}

fn measure(mesh: &TriMesh, rim: &[u32]) -> Result<Hole, HoleError> {
    let n = rim.len();
    let p = |i: usize| mesh.points[rim[i % n] as usize];
    // Middle by length, so that a finely divided part of the rim does not pull it.
    let (mut middle, mut length) = (Vector::zeros(), 0.0);
    for i in 0..n {
        let l = (p(i + 1) - p(i)).norm();
        middle += nalgebra::center(&p(i), &p(i + 1)).coords * l;
        length += l;
    }
    let center = if length > 0.0 { Point::from(middle / length) } else { p(0) };
    // The rim runs along the kept triangles: seen from outside it turns clockwise.
    let normal: Vector = (0..n).map(|i| (p(i + 1) - center).cross(&(p(i) - center))).sum();
    let radius = (0..n).map(|i| (p(i) - center).norm()).sum::<f64>() / n as f64;
    let bent = |bend: f64| HoleError::Bent { edges: n, at: center.into(), bend };
    let Some(normal) = normal.try_normalize(0.0) else { return Err(bent(f64::NAN)) };
    let bend = (0..n).map(|i| normal.dot(&(p(i) - center)).abs()).fold(0.0, f64::max) / radius;
    if bend > FLAT { Err(bent(bend)) } else { Ok(Hole { center, normal, radius, edges: n }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::sphere;
    use crate::mesh::topology;

    fn cut(keep: impl Fn(&Point) -> bool) -> TriMesh {
        let mut mesh = sphere(Point::origin(), 5.0, 24);
        let kept: Vec<bool> = (0..mesh.triangles.len()).map(|t| mesh.corners(t).iter().all(&keep)).collect();
        let mut it = kept.iter();
        mesh.triangles.retain(|_| *it.next().unwrap());
        mesh.patch.truncate(mesh.triangles.len());
        mesh
    }

    #[test]
    fn a_vessel_open_at_both_ends_gets_two_lids_that_look_outwards() {
        let open = cut(|p| p.z.abs() < 4.0);
        let (closed, holes) = close(&open).unwrap();
        assert!(topology::check(&closed).is_closed_manifold());
        assert_eq!(holes.len(), 2);
        for h in &holes {
            assert!(h.normal.z.abs() > 0.99 && h.normal.z * h.center.z > 0.0, "{h:?}");
        }
    }

    #[test]
    fn a_hole_that_is_no_end_is_refused_with_its_place() {
        let shell = cut(|p| p.x > 0.0 || p.y.abs() > 1.5);
        match close(&shell) {
            Err(HoleError::Bent { at, .. }) => assert!(at[0] < 0.0),
            other => panic!("{other:?}"),
        }
    }
}
