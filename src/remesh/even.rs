//! Neighbours of even size: the last touch after angle repair.
//!
//! Edges whose two triangles differ much in area, for the size that is wished there, get a corner moved where that
//! evens them out. A move is kept only where the sum over the ring falls and no triangle rises above the target
//! skewness, so what repair reached stays. A fixed number of sweeps, on the patches with many such edges only: moves
//! cost the mean skewness.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_4;

use super::angle_repair::Badness;
use super::repair_moves::{ring_radius, tangent_basis};
use super::shape::worst_cosine;
use super::surface::{Kind, Surface};
use crate::geometry::{Point, Vector};
use crate::mesh::halfedge::HalfEdgeMesh;

/// Ratio of areas from which an edge counts.
const FROM: f64 = 1.5;
/// Ratio of areas from which the vertices at an edge are moved.
const MOVE: f64 = 1.66;
/// Part of a patch's edges that may be uneven.
const TOLERATED: f64 = 0.008;
/// Sweeps over the uneven edges.
const SWEEPS: usize = 8;

/// Evens out areas; returns the moves made.
pub(crate) fn even_out(s: &mut Surface, badness: Badness) -> usize {
    let limit = MOVE.ln();
    let mut moves = 0;
    for _ in 0..SWEEPS {
        // Edges and uneven edges of each patch. Those outside the region that may change do not count.
        let mut patches: BTreeMap<u32, (usize, Vec<u32>)> = BTreeMap::new();
        for h in s.mesh.edges() {
            let patch = s.mesh.patch(h / 3);
            if patch != s.mesh.patch(s.mesh.twin(h) / 3) || s.is_locked(h) {
                continue;
            }
            let (edges, uneven) = patches.entry(patch).or_default();
            *edges += 1;
            if unevenness(s, h, None) >= limit {
                uneven.push(h);
            }
        }
        let many = patches.into_values().filter(|(edges, uneven)| uneven.len() as f64 > TOLERATED * *edges as f64);
        let mut vertices: Vec<u32> = many
            .flat_map(|(_, uneven)| uneven)
            .flat_map(|h| [s.mesh.origin(h), s.mesh.target(h), s.mesh.apex(h), s.mesh.apex(s.mesh.twin(h))])
            .collect();
        vertices.sort_unstable();
        vertices.dedup();
        let before = moves;
        for v in vertices {
            moves += usize::from(matches!(s.kind[v as usize], Kind::Surface(_)) && shift(s, v, badness));
        }
        if moves == before {
            break;
        }
    }
    moves
}

/// A vertex taken to be elsewhere.
type Moved<'a> = Option<(u32, &'a Point)>;

/// |ln| of the ratio of the areas at the edge of `h`, each over the area wished there.
fn unevenness(s: &Surface, h: u32, moved: Moved) -> f64 {
    let area = |t: u32| {
        let v = s.mesh.triangle(t);
        let [a, b, c] = v.map(|v| match moved {
            Some((w, p)) if w == v => p,
            _ => s.point(v),
        });
        (b - a).cross(&(c - a)).norm()
    };
    let (a, b) = (area(h / 3), area(s.mesh.twin(h) / 3));
    if a > 0.0 && b > 0.0 { (a / b).ln().abs() } else { f64::INFINITY }
}

/// What the edges at and round `v` cost.
fn cost(s: &Surface, v: u32, moved: Moved) -> f64 {
    let from = FROM.ln();
    let mut sum = 0.0;
    for e in s.mesh.outgoing(v) {
        for h in [e, HalfEdgeMesh::next(e)] {
            if s.mesh.patch(h / 3) == s.mesh.patch(s.mesh.twin(h) / 3) {
                let over = (unevenness(s, h, moved) - from).max(0.0);
                sum += over * over;
            }
        }
    }
    sum
}

/// Looks round `v` for a place where its ring is more even.
fn shift(s: &mut Surface, v: u32, badness: Badness) -> bool {
    let before = cost(s, v, None);
    if before <= 0.0 {
        return false;
    }
    let Some((x, y)) = tangent_basis(&s.carrier_normal(v)) else { return false };
    let (origin, mean) = (*s.point(v), ring_radius(s, v));
    let worst = s.mesh.outgoing(v).map(|h| badness.of(s.shape_of(h / 3))).max().unwrap_or(0);
    for radius in [0.12, 0.05, 0.02] {
        let mut best: Option<(f64, Point, Vector)> = None;
        for i in 0..8 {
            let (sin, cos) = (f64::from(i) * FRAC_PI_4).sin_cos();
            let p = origin + (x * cos + y * sin) * (radius * mean);
            let bar = best.as_ref().map_or(0.97 * before, |b| b.0);
            if cost(s, v, Some((v, &p))) >= bar {
                continue;
            }
            let Some((p, n)) = s.project(v, &p, 0.5 * mean) else { continue };
            let after = cost(s, v, Some((v, &p)));
            if after < bar && stands(s, v, &p, &n, badness, worst) {
                best = Some((after, p, n));
            }
        }
        if let Some((_, p, n)) = best {
            s.set(v, p, n);
            return true;
        }
    }
    false
}

/// Whether the ring of `v`, moved to `p`, holds no worse triangle than `worst` and none turned over.
fn stands(s: &Surface, v: u32, p: &Point, n: &Vector, badness: Badness, worst: u32) -> bool {
    s.mesh.outgoing(v).all(|h| {
        let (c, d) = (s.mesh.target(h), s.mesh.apex(h));
        let normals = [n, &s.normal[c as usize], &s.normal[d as usize]];
        let upright = s.uprightness(s.mesh.patch(h / 3), [p, s.point(c), s.point(d)], normals);
        Surface::stands(s.uprightness_of(h / 3), upright) && badness.of(worst_cosine(p, s.point(c), s.point(d))) <= worst
    })
}
