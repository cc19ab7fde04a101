//! Layers at the rims of openings: no flatter than solvers take.
//!
//! A prism at a rim has a face on the wall and one on the cap, so that its inner faces are few; OpenFOAM's cell
//! determinant falls there with the fourth power of height over edge, and fails long before it does elsewhere.

use super::{LayerOptions, Wall};
use crate::mesh::TriMesh;

/// Least height of the first layer at a rim, as a part of the longest edge round the vertex: a determinant of 0.0025.
const LEAST_FIRST: f64 = 0.06;

/// Change of thickness along the wall, as everywhere.
const GRADIENT: f64 = 0.25;

/// Thickness raised at the rims, and from there inwards until it meets what was wished. Gives the largest height of the
/// first layer that came of it where it is more than a hundredth above `t`'s own.
pub(super) fn raise(wall: &Wall, s: &TriMesh, t: &mut [f64], steps: &[f64], o: &LayerOptions) -> Option<f64> {
    let mut longest = vec![0.0f64; s.points.len()];
    let edges = || wall.triangles.iter().flat_map(|&tri| (0..3).map(move |i| (s.triangles[tri][i], s.triangles[tri][(i + 1) % 3])));
    let length = |(a, b): (u32, u32)| (s.points[a as usize] - s.points[b as usize]).norm();
    for (a, b) in edges() {
        let l = length((a, b));
        longest[a as usize] = longest[a as usize].max(l);
        longest[b as usize] = longest[b as usize].max(l);
    }
    let floor = |v: usize| LEAST_FIRST * longest[v] / steps[1];
    let low: Vec<usize> = (0..t.len()).filter(|&v| wall.rim[v].is_some() && floor(v) > 1.01 * t[v]).collect();
    if low.is_empty() {
        return None;
    }
    // The part of the radius that all layers may take stays the bound.
    let room = wall.limited(s, &wall.wished(s, &LayerOptions { first_height: None, ..o.clone() }));
    let before = t.to_vec();
    for v in low {
        t[v] = t[v].max(floor(v).min(room[v]));
    }
    loop {
        let mut changed = false;
        for (a, b) in edges() {
            let fall = GRADIENT * length((a, b));
            for (from, to) in [(a as usize, b as usize), (b as usize, a as usize)] {
                let wanted = (t[from] - fall).min(room[to]);
                if wanted > t[to] * (1.0 + 1e-9) && t[from] > before[from] {
                    (t[to], changed) = (wanted, true);
                }
            }
        }
        if !changed {
            break;
        }
    }
    let raised = (0..t.len()).filter(|&v| t[v] > 1.01 * before[v] && t[v].is_finite());
    raised.map(|v| t[v] * steps[1]).reduce(f64::max)
}

#[cfg(test)]
mod tests {
    use super::super::{LayerOptions, grow, steps};
    use crate::geometry::Point;
    use crate::mesh::{Patch, PatchKind, TriMesh, WALL};

    /// A tube along z, 28 edges round, caps as fans.
    fn tube(radius: f64, rings: usize) -> TriMesh {
        let n = 28;
        let edge = std::f64::consts::TAU * radius / n as f64;
        let mut m = TriMesh { patches: vec![Patch::wall()], ..TriMesh::default() };
        for k in 0..=rings {
            for i in 0..n {
                let a = std::f64::consts::TAU * (i as f64 + 0.5 * (k % 2) as f64) / n as f64;
                m.points.push(Point::new(radius * a.cos(), radius * a.sin(), 0.87 * edge * k as f64));
            }
        }
        let mut put = |t: [usize; 3], patch| {
            m.triangles.push(t.map(|v| v as u32));
            m.patch.push(patch);
        };
        for k in 0..rings {
            for i in 0..n {
                let (a, b) = (k * n + i, k * n + (i + 1) % n);
                let (c, d) = (a + n, b + n);
                if k % 2 == 0 {
                    put([a, b, c], WALL);
                    put([b, d, c], WALL);
                } else {
                    put([a, b, d], WALL);
                    put([a, d, c], WALL);
                }
            }
        }
        let (bottom, top) = ((rings + 1) * n, (rings + 1) * n + 1);
        for i in 0..n {
            let j = (i + 1) % n;
            put([bottom, j, i], 2);
            put([top, rings * n + i, rings * n + j], 3);
        }
        m.points.push(Point::origin());
        m.points.push(Point::new(0.0, 0.0, 0.87 * edge * rings as f64));
        m.patches.push(Patch { id: 2, name: "inlet".into(), kind: PatchKind::Inlet });
        m.patches.push(Patch { id: 3, name: "outlet_1".into(), kind: PatchKind::Outlet });
        m
    }

    #[test]
    fn the_first_layer_is_raised_at_the_rims_only_and_said() {
        let s = tube(2.0, 20);
        // The caps' fans are no good triangles; nothing here depends on them.
        let o = LayerOptions { count: 5, first_height: Some(0.01), max_inner_skewness: 1.0, ..LayerOptions::default() };
        let (layers, summary) = grow(&s, &o, &[], &|| false).expect("layers");
        let first = steps(&o)[1];
        assert!(summary.rim_height_ratio > 0.05, "{summary:?}");
        assert!(summary.warnings.iter().any(|w| w.contains("rims")), "{:?}", summary.warnings);
        // In the middle it is as asked for.
        let middle = 10 * 28;
        assert!((layers.thickness[middle] * first - 0.01).abs() < 1e-9, "{}", layers.thickness[middle] * first);
        let thick = LayerOptions { first_height: Some(0.05), ..o };
        let (_, summary) = grow(&s, &thick, &[], &|| false).expect("layers");
        assert!(summary.warnings.is_empty(), "{:?}", summary.warnings);
    }
}
