//! Flat caps: connected pieces of surface that are plane, with a sharp edge all round.

use super::super::topology::DisjointSets;
use super::super::{TriMesh, holes, rims};
use super::INWARDS;
use crate::geometry::{Point, Vector};

/// A cap and its rim, in the direction of the wall's triangles.
pub(super) struct Cap {
    pub triangles: Vec<usize>,
    pub rim: Vec<u32>,
}

/// Cosine of the angle between triangles from which on their edge is sharp, 25 degrees.
const SHARP: f64 = 0.906;
/// Mean angle between cap and wall along the rim, degrees. Facets on the flank of a surface that follows voxels have 45 to 55.
const EDGE: f64 = 60.0;
/// Length of the sum of area vectors over the area: 1 where all triangles look one way.
const FLAT: f64 = 0.95;
/// Points leave the plane by this part of the radius of a circle of the cap's area: caps on saw-toothed rims do.
const PLANE: f64 = 0.2;
/// Fewest edges of a rim, and most corners of more than 60 degrees: a facet of a coarse tube has three or four.
const EDGES: usize = 6;
const CORNERS: usize = 2;
/// Largest part of the surface.
const PART: f64 = 0.4;

/// The caps of a surface whose triangles agree.
pub(super) fn find(mesh: &TriMesh) -> Vec<Cap> {
    let n = mesh.triangles.len();
    let normals: Vec<Option<Vector>> = (0..n).map(|t| mesh.area_vector2(t).try_normalize(0.0)).collect();
    let key = |c: usize| {
        let (a, b) = (mesh.triangles[c / 3][c % 3], mesh.triangles[c / 3][(c + 1) % 3]);
        [a.min(b), a.max(b)]
    };
    let mut corners: Vec<usize> = (0..3 * n).collect();
    corners.sort_by_key(|&c| (key(c), c));
    let mut sets = DisjointSets::new(n);
    let mut opposite = vec![usize::MAX; 3 * n];
    for edge in corners.chunk_by(|&a, &b| key(a) == key(b)) {
        let [a, b] = *edge else { continue };
        (opposite[a], opposite[b]) = (b, a);
        if let (Some(s), Some(t)) = (normals[a / 3], normals[b / 3])
            && s.dot(&t) > SHARP
        {
            sets.join((a / 3) as u32, (b / 3) as u32);
        }
    }
    let mut members: std::collections::BTreeMap<u32, Vec<usize>> = Default::default();
    (0..n).for_each(|t| members.entry(sets.root(t as u32)).or_default().push(t));
    let total = mesh.area();
    members.into_values().filter_map(|own| cap(mesh, &normals, &opposite, own, total)).collect()
}

fn cap(mesh: &TriMesh, normals: &[Option<Vector>], opposite: &[usize], own: Vec<usize>, total: f64) -> Option<Cap> {
    let (sum, area) = own.iter().map(|&t| 0.5 * mesh.area_vector2(t)).fold((Vector::zeros(), 0.0), |(s, a), v| (s + v, a + v.norm()));
    if own.len() + 2 < EDGES || area > PART * total || sum.norm() < FLAT * area {
        return None;
    }
    let normal = sum.try_normalize(0.0)?;
    let part: Vec<[u32; 3]> = own.iter().map(|&t| mesh.triangles[t]).collect();
    let [edge_loop] = &rims::loops_of(&part)[..] else { return None };
    let rim: Vec<u32> = edge_loop.iter().rev().copied().collect();
    let points: Vec<Point> = rim.iter().map(|&v| mesh.points[v as usize]).collect();
    let hole = holes::measure(&points)?;
    if rim.len() < EDGES || hole.normal.dot(&normal) < 0.95 {
        return None;
    }
    let off = own.iter().flat_map(|&t| mesh.corners(t)).map(|p| hole.normal.dot(&(p - hole.center)).abs()).fold(0.0, f64::max);
    if off > PLANE * (area / std::f64::consts::PI).sqrt() {
        return None;
    }
    let m = points.len();
    let turns = (0..m).filter(|&i| (points[(i + 1) % m] - points[i]).angle(&(points[i] - points[(i + m - 1) % m])) > 60f64.to_radians()).count();
    // Teeth turn sharply too, but in their cap's plane hardly.
    if turns > CORNERS && hole.bend < 0.02 {
        return None;
    }
    let inside: std::collections::BTreeSet<usize> = own.iter().copied().collect();
    let (mut angle, mut inwards, mut length) = (0.0, 0.0, 0.0);
    for c in own.iter().flat_map(|&t| 3 * t..3 * t + 3) {
        let o = opposite[c];
        if o == usize::MAX || inside.contains(&(o / 3)) {
            // An open edge: a cap is closed to the wall all round.
            if o == usize::MAX {
                return None;
            }
            continue;
        }
        let [a, b, third] = [0, 1, 2].map(|i| mesh.points[mesh.triangles[o / 3][(o % 3 + i) % 3] as usize]);
        let (Some(other), Some(along)) = (normals[o / 3], (b - a).try_normalize(0.0)) else { continue };
        let across = third - a;
        let Some(way) = (across - along * along.dot(&across)).try_normalize(0.0) else { continue };
        let l = (b - a).norm();
        angle += l * other.angle(&normal).to_degrees();
        inwards -= l * way.dot(&normal);
        length += l;
    }
    (length > 0.0 && angle >= EDGE * length && inwards >= INWARDS * length).then_some(Cap { triangles: own, rim })
}
