//! Places that deserve a look before meshing: vessels of few voxels, and vessels that nearly touch.

use serde::Serialize;

use super::Centerlines;
use crate::geometry::{Point, Vector};
use crate::mask::Mask;

/// A stretch of vessel with few voxels across.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ThinPlace {
    /// Where it is narrowest, LPS mm.
    pub at: Point,
    /// Diameter there, mm.
    pub diameter: f64,
    /// The same in voxels, by the longest voxel edge.
    pub voxels: f64,
    /// Length of the stretch, mm.
    pub length: f64,
}

/// Stretches whose inscribed sphere is less than `limit` voxels (longest edges) across, narrowest first.
pub fn thin_places(lines: &Centerlines, mask: &Mask, limit: f64) -> Vec<ThinPlace> {
    let edge = mask.grid.spacing().into_iter().fold(0.0, f64::max);
    let mut out = Vec::new();
    for branch in &lines.branches {
        let s = &branch.samples;
        let thin = |n: usize| 2.0 * s[n].radius < limit * edge;
        let mut n = 0;
        while n < s.len() {
            let first = n;
            while n < s.len() && thin(n) {
                n += 1;
            }
            if let Some(least) = s[first..n].iter().min_by(|a, b| a.radius.total_cmp(&b.radius)) {
                let length = s[n - 1].arc_length - s[first].arc_length;
                out.push(ThinPlace { at: least.point, diameter: 2.0 * least.radius, voxels: 2.0 * least.radius / edge, length });
            }
            n += 1;
        }
    }
    out.sort_by(|a, b| a.diameter.total_cmp(&b.diameter));
    out
}

/// Two parts of the vessel with a single voxel of background between them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClosePlace {
    /// Middle of the gap, LPS mm.
    pub at: Point,
    /// Background voxels in the gap.
    pub voxels: usize,
    /// Distance between the two along the vessel, in radii; `None` where no branch that they share joins them.
    pub radii_apart: Option<f64>,
}

/// Where parts of the vessel that lie far from each other along it are one background voxel apart, widest gap first.
pub fn close_places(lines: &Centerlines, mask: &Mask) -> Vec<ClosePlace> {
    let spacing = mask.grid.spacing();
    let groups = lines.groups();
    let mut gaps: Vec<(Point, f64)> = Vec::new();
    for n in (0..mask.grid.len()).filter(|&n| mask.data[n] == 0) {
        let v = mask.grid.voxel(n).map(|c| c as i64);
        for axis in 0..3 {
            let side = |d: i64| {
                let mut w = v;
                w[axis] += d;
                mask.at(w[0], w[1], w[2]).then(|| mask.grid.to_world(Vector::new(w[0] as f64, w[1] as f64, w[2] as f64)))
            };
            let (Some(p), Some(q)) = (side(-1), side(1)) else { continue };
            let Some((apart, usual)) = apart(lines, &groups, &p, &q) else { continue };
            if apart > usual {
                gaps.push((nalgebra::center(&p, &q), apart));
                break;
            }
        }
    }
    // Neighbouring gap voxels are one place.
    let near = 3.0 * spacing.into_iter().fold(0.0, f64::max);
    let mut places: Vec<(Vec<Point>, f64)> = Vec::new();
    for (p, apart) in gaps {
        let mut own = (vec![p], apart);
        let mut kept = Vec::new();
        for place in places {
            if place.0.iter().any(|q| (q - p).norm() <= near) {
                own.0.extend(place.0);
                own.1 = own.1.min(place.1);
            } else {
                kept.push(place);
            }
        }
        kept.push(own);
        places = kept;
    }
    let mut out: Vec<ClosePlace> = places
        .into_iter()
        .map(|(points, apart)| {
            let middle = points.iter().fold(Vector::zeros(), |s, p| s + p.coords) / points.len() as f64;
            let nearest = points.iter().copied().min_by(|a, b| (a.coords - middle).norm().total_cmp(&(b.coords - middle).norm()));
            ClosePlace { at: nearest.unwrap_or(Point::from(middle)), voxels: points.len(), radii_apart: apart.is_finite().then_some(apart) }
        })
        .collect();
    out.sort_by(|a, b| b.voxels.cmp(&a.voxels));
    out
}

/// Distance of two points along the vessel in radii of the larger, infinite where no branch or node is shared; and how
/// far it may be between the two sides of a bend or of a sharp bifurcation.
fn apart(lines: &Centerlines, groups: &[Option<u32>], p: &Point, q: &Point) -> Option<(f64, f64)> {
    let nearest = |p: &Point| {
        let all = lines.branches.iter().enumerate().flat_map(|(b, branch)| branch.samples.iter().map(move |s| (b, s)));
        all.map(|(b, s)| ((s.point - p).norm() - s.radius, b, s)).min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let ((_, a, s), (_, b, t)) = (nearest(p)?, nearest(q)?);
    let radius = s.radius.max(t.radius);
    if a == b {
        return Some(((s.arc_length - t.arc_length).abs() / radius, 4.0));
    }
    let group = |node: u32| groups[node as usize].map_or(u64::from(node) + (1 << 32), u64::from);
    let (x, y) = (&lines.branches[a], &lines.branches[b]);
    let ways = (0..4).filter(|w| group(x.nodes[w / 2]) == group(y.nodes[w % 2])).map(|w| {
        let to = |branch: &super::Branch, end: usize, at: f64| if end == 0 { at } else { branch.length() - at };
        to(x, w / 2, s.arc_length) + to(y, w % 2, t.arc_length)
    });
    Some((ways.fold(f64::INFINITY, f64::min) / radius, 8.0))
}
