//! Ends of a surface: open rims and flat caps.
//!
//! A rim is an end where it is flat (no point leaves its plane by more than 0.4 of its mean radius), the wall leaves it inwards (by
//! 20 degrees and more on the mean) and it parts inside from outside. A flat cap is a piece of surface with a sharp edge all round
//! ([`caps`] has the rule); it is taken away, and its rim is an end like others. All other rims are holes in the wall and get lids;
//! bent ones whose lid would be more than a hundredth of the surface stay open.

mod caps;
mod extend;

use std::collections::BTreeMap;

use serde::Serialize;

use super::holes::{self, Hole};
use super::winding::WindingNumbers;
use super::{TriMesh, rims};
use crate::geometry::{Plane, Point, Vector};

/// An end of a vessel as its surface has it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceEnd {
    /// Middle of the area in the rim, in its plane, mm; where the largest circle in the rim has its middle if that is no good place.
    pub center: Point,
    /// Unit normal of the rim's plane, out of the vessel.
    pub normal: Vector,
    /// Area that the rim encloses in its plane, mm².
    pub area: f64,
    /// Radius of the largest circle round the centre in the rim, mm.
    pub radius: f64,
    /// Unit direction in which the wall runs out of the vessel at the rim.
    pub direction: Vector,
    /// Whether a flat cap closed it.
    pub capped: bool,
    /// The rim's points, in the direction of the wall's triangles, mm.
    #[serde(skip)]
    pub rim: Vec<Point>,
    /// Unit direction in which the wall runs out of the vessel at each of them, evened along the rim.
    #[serde(skip)]
    pub directions: Vec<Vector>,
}

impl SurfaceEnd {
    /// The rim's plane.
    pub fn plane(&self) -> Plane {
        Plane { origin: self.center, normal: self.normal }
    }
}

/// A surface with its ends known.
#[derive(Debug, Clone, PartialEq)]
pub struct Vessel {
    /// The surface without caps, holes in the wall closed; open at its ends and at `left_open`.
    pub open: TriMesh,
    /// The ends, in the order of their first vertex.
    pub ends: Vec<SurfaceEnd>,
    /// Holes in the wall that were closed.
    pub filled: Vec<Point>,
    /// Holes that stay open: too bent for an end, too large for a fault of the wall.
    pub left_open: Vec<Hole>,
    /// Vertices of each end's rim.
    rims: Vec<Vec<u32>>,
}

/// A rim may leave its plane by this part of its mean radius.
const FLAT: f64 = 0.4;
/// Sine of the angle at which the wall must leave a rim inwards, 20 degrees.
const INWARDS: f64 = 0.35;
/// A bent hole's lid is at most this part of the surface.
const SMALL: f64 = 0.01;

/// Finds the ends of a surface whose triangles agree ([`super::repair`]), and closes holes in its wall.
pub fn find(mesh: &TriMesh) -> Vessel {
    let caps = caps::find(mesh);
    let mut open = mesh.clone();
    let mut is_cap = vec![false; mesh.triangles.len()];
    caps.iter().flat_map(|c| &c.triangles).for_each(|&t| is_cap[t] = true);
    let kept = |t: &usize| !is_cap[*t];
    open.triangles = (0..is_cap.len()).filter(kept).map(|t| mesh.triangles[t]).collect();
    open.patch = (0..is_cap.len()).filter(kept).map(|t| mesh.patch[t]).collect();
    let capped: Vec<Vec<u32>> = caps.into_iter().map(|c| sorted(&c.rim)).collect();

    let found = rims::loops(&open);
    let mut shut = open.clone();
    found.iter().for_each(|rim| holes::close(&mut shut, rim));
    let inside = WindingNumbers::new(&shut);
    let total = open.area();
    let beside = beside(&open);
    let mut vessel = Vessel { open, ends: Vec::new(), filled: Vec::new(), left_open: Vec::new(), rims: Vec::new() };
    for rim in found {
        let points: Vec<Point> = rim.iter().map(|&v| mesh.points[v as usize]).collect();
        let hole = holes::measure(&points);
        let flat = hole.as_ref().filter(|h| h.bend <= FLAT);
        let from_cap = capped.contains(&sorted(&rim));
        if let Some(end) = flat.and_then(|h| end(&vessel.open, &rim, h, &beside, from_cap))
            && parts(&inside, &end)
        {
            vessel.ends.push(end);
            vessel.rims.push(rim);
            continue;
        }
        let lid = holes::lid(&points);
        let area: f64 = lid.iter().map(|&[a, b, c]| 0.5 * (points[b] - points[a]).cross(&(points[c] - points[a])).norm()).sum();
        match hole {
            Some(hole) if hole.bend > FLAT && area > SMALL * total => vessel.left_open.push(hole),
            hole => {
                vessel.filled.push(hole.map_or(points[0], |h| h.center));
                vessel.open.patch.resize(vessel.open.triangles.len() + lid.len(), super::WALL);
                vessel.open.triangles.extend(lid.into_iter().map(|t| t.map(|i| rim[i])));
            }
        }
    }
    vessel
}

fn sorted(ids: &[u32]) -> Vec<u32> {
    let mut all = ids.to_vec();
    all.sort_unstable();
    all
}

/// The third corner of a triangle along each directed edge.
fn beside(mesh: &TriMesh) -> BTreeMap<[u32; 2], u32> {
    mesh.triangles.iter().flat_map(|t| (0..3).map(|i| ([t[i], t[(i + 1) % 3]], t[(i + 2) % 3]))).collect()
}

/// The rim as an end; `None` where the wall does not leave it inwards, or it encloses nothing.
fn end(mesh: &TriMesh, rim: &[u32], hole: &Hole, beside: &BTreeMap<[u32; 2], u32>, capped: bool) -> Option<SurfaceEnd> {
    let p = |v: u32| mesh.points[v as usize];
    let (mut way, mut length) = (Vector::zeros(), 0.0);
    let mut walls = vec![Vector::zeros(); rim.len()];
    for i in 0..rim.len() {
        let (a, b) = (rim[i], rim[(i + 1) % rim.len()]);
        let edge = p(b) - p(a);
        let Some(along) = edge.try_normalize(0.0) else { continue };
        let Some(&c) = beside.get(&[a, b]) else { continue };
        let across = p(c) - p(a);
        let Some(inwards) = (across - along * along.dot(&across)).try_normalize(0.0) else { continue };
        way -= inwards * edge.norm();
        walls[i] = along.cross(&inwards) * edge.norm();
        length += edge.norm();
    }
    // A capped end was found by its sharp edge.
    if !capped && way.dot(&hole.normal) < INWARDS * length {
        return None;
    }
    let plane = Plane { origin: hole.center, normal: hole.normal };
    let (u, v) = plane.basis();
    let points: Vec<Point> = rim.iter().map(|&v| p(v)).collect();
    let flat: Vec<[f64; 2]> = points.iter().rev().map(|q| q - plane.origin).map(|d| [d.dot(&u), d.dot(&v)]).collect();
    let (area, centroid) = moments(&flat);
    if area <= 0.0 {
        return None;
    }
    let (at, radius) = middle(&flat, centroid);
    let center = plane.origin + u * at[0] + v * at[1];
    let direction = axis(&walls, &hole.normal);
    let directions = evened(&points, &walls, 0.3 * radius, &direction);
    Some(SurfaceEnd { center, normal: hole.normal, area, radius, direction, capped, rim: points, directions })
}

/// The direction along which the wall runs out of a rim: the one that its normals `walls` at the rim's edges are most square to. The
/// plane's normal where they tell none, as at wide funnels.
fn axis(walls: &[Vector], normal: &Vector) -> Vector {
    let sum: nalgebra::Matrix3<f64> = walls.iter().filter_map(|w| Some(w * w.try_normalize(0.0)?.transpose())).sum();
    let eigen = sum.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let axis = eigen.eigenvectors.column(order[0]).into_owned();
    let axis = if axis.dot(normal) < 0.0 { -axis } else { axis };
    if eigen.eigenvalues[order[0]] < 0.5 * eigen.eigenvalues[order[1]] && axis.dot(normal) >= INWARDS { axis } else { *normal }
}

/// Cosine of the largest angle between the wall's direction at a point of a rim and that of the whole rim, 45 degrees.
const TURN: f64 = 0.707;

/// The wall's direction at each point of a rim: `axis` turned into the wall, whose normals at the rim's edges are averaged over `width` mm
/// to either side; by 45 degrees at most.
fn evened(rim: &[Point], walls: &[Vector], width: f64, axis: &Vector) -> Vec<Vector> {
    let n = rim.len();
    let one = |i: usize| {
        // The two edges of the point, then on to either side.
        let mut sum = walls[i] + walls[(i + n - 1) % n];
        for side in [1, n - 1] {
            let (mut at, mut passed) = (i, 0.0);
            for _ in 1..n / 2 {
                let next = (at + side) % n;
                passed += (rim[next] - rim[at]).norm();
                if passed > width {
                    break;
                }
                sum += if side == 1 { walls[next] } else { walls[(next + n - 1) % n] };
                at = next;
            }
        }
        let Some(wall) = sum.try_normalize(0.0) else { return *axis };
        let Some(own) = (axis - wall * wall.dot(axis)).try_normalize(0.0) else { return *axis };
        let cosine = own.dot(axis);
        if cosine >= TURN {
            return own;
        }
        let across = (own - axis * cosine).try_normalize(0.0).unwrap_or_else(Vector::zeros);
        (axis + across).normalize()
    };
    (0..n).map(one).collect()
}

/// Whether an end's plane has inside behind it and outside before it.
fn parts(inside: &WindingNumbers, end: &SurfaceEnd) -> bool {
    let step = end.normal * (0.1 * end.radius);
    inside.contains(&(end.center - step)) && !inside.contains(&(end.center + step))
}

/// Area and centroid of a counter-clockwise polygon.
fn moments(polygon: &[[f64; 2]]) -> (f64, [f64; 2]) {
    let (mut area, mut x, mut y) = (0.0, 0.0, 0.0);
    for (i, a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let cross = 0.5 * (a[0] * b[1] - a[1] * b[0]);
        area += cross;
        x += cross * (a[0] + b[0]) / 3.0;
        y += cross * (a[1] + b[1]) / 3.0;
    }
    (area, [x / area, y / area])
}

/// Distance of a point from a polygon's outline, negative outside.
fn depth(polygon: &[[f64; 2]], p: [f64; 2]) -> f64 {
    let (mut nearest, mut inside) = (f64::INFINITY, false);
    for (i, a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (e, d) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
        let square = e[0] * e[0] + e[1] * e[1];
        let t = if square > 0.0 { ((d[0] * e[0] + d[1] * e[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
        nearest = nearest.min((d[0] - t * e[0]).hypot(d[1] - t * e[1]));
        if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    if inside { nearest } else { -nearest }
}

/// The centroid where it lies well inside the polygon, else the middle of the largest circle in it; and that circle's radius.
fn middle(polygon: &[[f64; 2]], centroid: [f64; 2]) -> ([f64; 2], f64) {
    let low = polygon.iter().fold([f64::INFINITY; 2], |m, p| [m[0].min(p[0]), m[1].min(p[1])]);
    let high = polygon.iter().fold([f64::NEG_INFINITY; 2], |m, p| [m[0].max(p[0]), m[1].max(p[1])]);
    let mut size = (high[0] - low[0]).max(high[1] - low[1]);
    let mut best = (depth(polygon, centroid), centroid);
    // A grid over all of it, then ever smaller ones round the best place.
    let mut center = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
    for _ in 0..5 {
        for n in 0..21 * 21 {
            let p = [center[0] + size * (f64::from(n % 21) / 20.0 - 0.5), center[1] + size * (f64::from(n / 21) / 20.0 - 0.5)];
            let d = depth(polygon, p);
            if d > best.0 {
                best = (d, p);
            }
        }
        center = best.1;
        size *= 0.2;
    }
    if depth(polygon, centroid) >= 0.5 * best.0 { (centroid, best.0) } else { (best.1, best.0) }
}

#[cfg(test)]
mod tests;
