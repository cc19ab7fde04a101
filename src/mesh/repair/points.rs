//! Points at one place made one.

use super::super::topology::DisjointSets;
use super::super::{TriMesh, rims};
use crate::geometry::Point;

/// Points on open edges this part of the surface's size apart are one.
pub(super) const TOLERANCE: f64 = 1e-5;

/// The mesh with equal points joined, and those on open edges no farther than `tolerance` apart; the places of points that went.
pub(super) fn joined(mesh: &TriMesh, tolerance: f64) -> (TriMesh, Vec<Point>) {
    let compact = self::used(mesh);
    let welded = compact.welded();
    let mut places: Vec<Point> = Vec::new();
    if welded.points.len() < compact.points.len() {
        // Which points went: those that come a second time.
        let mut seen = std::collections::BTreeSet::new();
        places.extend(compact.points.iter().filter(|p| !seen.insert([p.x, p.y, p.z].map(|c| (c + 0.0).to_bits()))));
    }
    let mut open: Vec<u32> = rims::open_edges(&welded.triangles).into_iter().flatten().collect();
    open.sort_unstable();
    open.dedup();
    let at = |v: u32| welded.points[v as usize];
    open.sort_by(|&a, &b| at(a).x.total_cmp(&at(b).x).then(a.cmp(&b)));
    let mut sets = DisjointSets::new(welded.points.len());
    let mut moved = Vec::new();
    for (i, &a) in open.iter().enumerate() {
        for &b in open[i + 1..].iter().take_while(|&&b| at(b).x - at(a).x <= tolerance) {
            if (at(b) - at(a)).norm() <= tolerance && sets.root(a) != sets.root(b) {
                sets.join(a, b);
                moved.push(at(a.max(b)));
            }
        }
    }
    places.extend(&moved);
    if moved.is_empty() {
        return (welded, places);
    }
    let mut out = welded;
    out.triangles.iter_mut().flatten().for_each(|v| *v = sets.root(*v));
    (self::used(&out), places)
}

/// The mesh without points that no triangle uses.
pub(super) fn used(mesh: &TriMesh) -> TriMesh {
    let mut number = vec![u32::MAX; mesh.points.len()];
    mesh.triangles.iter().flatten().for_each(|&v| number[v as usize] = 0);
    let mut points = Vec::new();
    for (n, p) in number.iter_mut().zip(&mesh.points).filter(|(n, _)| **n == 0) {
        *n = points.len() as u32;
        points.push(*p);
    }
    let triangles = mesh.triangles.iter().map(|t| t.map(|v| number[v as usize])).collect();
    TriMesh { points, triangles, patch: mesh.patch.clone(), patches: mesh.patches.clone() }
}
