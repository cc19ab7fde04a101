//! Lids on the holes of a surface that do not cross its wall more than they must.

use serde::Serialize;

use super::polygon;
use crate::geometry::{Plane, Point, Vector};

/// A rim as measured.
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
    /// Largest distance of the rim from its plane, in mean radii.
    pub bend: f64,
}

/// Measures a rim given in the direction of the triangles that have it; `None` where it encloses no area.
pub fn measure(rim: &[Point]) -> Option<Hole> {
    let n = rim.len();
    let p = |i: usize| rim[i % n];
    // Middle by length, so that a finely divided part of the rim does not pull it.
    let (mut middle, mut length) = (Vector::zeros(), 0.0);
    for i in 0..n {
        let l = (p(i + 1) - p(i)).norm();
        middle += nalgebra::center(&p(i), &p(i + 1)).coords * l;
        length += l;
    }
    let center = if length > 0.0 { Point::from(middle / length) } else { return None };
    // Seen from outside a rim turns clockwise.
    let twice: Vector = (0..n).map(|i| (p(i + 1) - center).cross(&(p(i) - center))).sum();
    // A slit has no plane.
    if twice.norm() < 1e-6 * length * length {
        return None;
    }
    let normal = twice.normalize();
    let radius = (0..n).map(|i| (p(i) - center).norm()).sum::<f64>() / n as f64;
    let bend = (0..n).map(|i| normal.dot(&(p(i) - center)).abs()).fold(0.0, f64::max) / radius;
    Some(Hole { center, normal, radius, edges: n, bend })
}

/// Largest rim for which the smallest lid is looked for; the work grows with the cube.
const SMALLEST_UP_TO: usize = 160;

/// Triangles, as indices into `rim`, that close a rim given in the direction of the triangles that have it; they run against it.
///
/// The smallest area that triangles between the rim's points can have (G. Barequet, M. Sharir, "Filling gaps in the boundary of a
/// polyhedron", Computer Aided Geometric Design 12(2), 1995) for rims of up to 160 edges; longer rims are triangulated in their plane, or,
/// where they are not simple there, halved at their two nearest opposite points until they are short enough.
pub fn lid(rim: &[Point]) -> Vec<[usize; 3]> {
    let n = rim.len();
    if n < 3 {
        return Vec::new();
    }
    if n > SMALLEST_UP_TO {
        if let Some(flat) = measure(rim).filter(|h| h.bend < 0.2).and_then(|h| flat_lid(rim, &h.normal)) {
            return flat;
        }
        // The shortest chord between points that are far apart along the rim.
        let chords = (0..n).flat_map(|i| (i + n / 4..(i + n - n / 4).min(n)).map(move |j| (i, j)));
        let Some((i, j)) = chords.min_by(|a, b| (rim[a.0] - rim[a.1]).norm().total_cmp(&(rim[b.0] - rim[b.1]).norm())) else { return Vec::new() };
        let near: Vec<usize> = (i..=j).collect();
        let far: Vec<usize> = (j..n).chain(0..=i).collect();
        let part = |ids: &[usize]| {
            let points: Vec<Point> = ids.iter().map(|&v| rim[v]).collect();
            lid(&points).into_iter().map(|t| t.map(|v| ids[v])).collect::<Vec<_>>()
        };
        return [part(&near), part(&far)].concat();
    }
    smallest(rim)
}

/// Triangles in the rim's plane; `None` where the rim is not simple there.
pub fn flat_lid(rim: &[Point], normal: &Vector) -> Option<Vec<[usize; 3]>> {
    let plane = Plane::new(*rim.first()?, *normal)?;
    let (u, v) = plane.basis();
    let n = rim.len();
    let flat: Vec<[f64; 2]> = (0..n).rev().map(|i| rim[i] - plane.origin).map(|d| [d.dot(&u), d.dot(&v)]).collect();
    Some(polygon::triangulate(&flat)?.into_iter().map(|t| t.map(|i| n - 1 - i)).collect())
}

fn smallest(rim: &[Point]) -> Vec<[usize; 3]> {
    let n = rim.len();
    let area = |i: usize, j: usize, k: usize| (rim[j] - rim[i]).cross(&(rim[k] - rim[i])).norm();
    let mut best = vec![0.0f64; n * n];
    let mut split = vec![0usize; n * n];
    for span in 2..n {
        for i in 0..n - span {
            let k = i + span;
            let candidates = (i + 1..k).map(|j| (best[i * n + j] + best[j * n + k] + area(i, j, k), j));
            let (least, at) = candidates.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, i + 1));
            best[i * n + k] = least;
            split[i * n + k] = at;
        }
    }
    let mut out = Vec::with_capacity(n - 2);
    let mut left = vec![(0, n - 1)];
    while let Some((i, k)) = left.pop() {
        if k - i > 1 {
            let j = split[i * n + k];
            out.push([k, j, i]);
            left.extend([(i, j), (j, k)]);
        }
    }
    out
}

/// Puts a lid on the rim of some vertices of a mesh.
pub(super) fn close(mesh: &mut super::TriMesh, rim: &[u32]) {
    let points: Vec<Point> = rim.iter().map(|&v| mesh.points[v as usize]).collect();
    for t in lid(&points) {
        mesh.triangles.push(t.map(|i| rim[i]));
        mesh.patch.push(super::WALL);
    }
}


#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lid_runs_against_its_rim_and_has_the_smallest_area() {
        // An L, bent out of its plane at one corner.
        let rim: Vec<Point> =
            [[0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [1.0, 3.0, 0.0], [1.0, 1.0, 0.0], [3.0, 1.0, 0.3], [3.0, 0.0, 0.0]].map(Point::from).to_vec();
        let lid = lid(&rim);
        assert_eq!(lid.len(), 4);
        let edges: std::collections::BTreeSet<[usize; 2]> = lid.iter().flat_map(|t| (0..3).map(|i| [t[i], t[(i + 1) % 3]])).collect();
        for i in 0..6 {
            assert!(edges.contains(&[(i + 1) % 6, i]), "edge {i}");
        }
        let area: f64 = lid.iter().map(|&[a, b, c]| 0.5 * (rim[b] - rim[a]).cross(&(rim[c] - rim[a])).norm()).sum();
        assert!((area - 5.0).abs() < 0.2, "{area}");
        assert!(measure(&rim).expect("a plane").normal.z > 0.9);
    }

    #[test]
    fn a_long_rim_is_closed_too() {
        let n = 700;
        let rim: Vec<Point> = (0..n).map(|i| -std::f64::consts::TAU * f64::from(i) / f64::from(n)).map(|a| Point::new(a.cos(), a.sin(), 0.3 * (2.0 * a).cos())).collect();
        assert_eq!(lid(&rim).len(), n as usize - 2);
    }
}
