//! Exchanges that move no vertex: edge removal (3-2, 4-4, n-(2n−4)) and the 2-3 flip. Each is proposed, not made.

use super::complex::{Complex, Exchange, faces};
use super::quality::shape_above;

/// Longest ring of an edge that is removed.
const LONGEST_RING: usize = 10;

/// Removes edge ab if the best triangulation of its ring (by dynamic programming, after Klincsek) has a better worst
/// score than the tetrahedra that are there now, and than `floor`.
pub(super) fn remove_edge(c: &Complex, a: u32, b: u32, floor: f64) -> Option<Exchange> {
    let (star, ring) = c.ring(a, b, LONGEST_RING)?;
    let old = c.worst(&star).max(floor);
    let n = ring.len();
    let mut best = [[f64::INFINITY; LONGEST_RING]; LONGEST_RING];
    let mut middle = [[0usize; LONGEST_RING]; LONGEST_RING];
    let p = |v: u32| c.points[v as usize];
    let (pa, pb) = (p(a), p(b));
    for gap in 2..n {
        for i in 0..n - gap {
            let j = i + gap;
            let mut top = f64::NEG_INFINITY;
            for k in i + 1..j {
                let bound = best[i][k].min(best[k][j]);
                if bound <= old.max(top) {
                    continue;
                }
                let (x, y, z) = (p(ring[i]), p(ring[k]), p(ring[j]));
                let mut q = bound.min(shape_above(&[x, y, z, pb], old.max(top)));
                if q > old.max(top) {
                    q = q.min(shape_above(&[x, z, y, pa], old.max(top)));
                }
                if q > top {
                    top = q;
                    middle[i][j] = k;
                }
            }
            best[i][j] = top;
        }
    }
    if best[0][n - 1] <= old {
        return None;
    }
    let mut new = Vec::with_capacity(2 * n - 4);
    let mut todo = vec![(0, n - 1)];
    while let Some((i, j)) = todo.pop() {
        if j - i < 2 {
            continue;
        }
        let k = middle[i][j];
        new.push([ring[i], ring[k], ring[j], b]);
        new.push([ring[i], ring[j], ring[k], a]);
        todo.push((i, k));
        todo.push((k, j));
    }
    accept(c, star, new, old)
}

/// Two tetrahedra at a face become three at an edge, where that is better.
pub(super) fn flip_23(c: &Complex, t: u32, face: usize, floor: f64) -> Option<Exchange> {
    let corners = c.tets[t as usize];
    let f = faces(corners)[face];
    let a = corners[face];
    if c.is_surface(f) {
        return None;
    }
    let o = c.across(t, f)?;
    let b = *c.tets[o as usize].iter().find(|v| !f.contains(v))?;
    let old = c.worst(&[t, o]).max(floor);
    let [x, y, z] = f;
    let new = [[a, b, x, y], [a, b, y, z], [a, b, z, x]];
    if new.iter().any(|&t| shape_above(&c.corners(t), old) <= old) {
        return None;
    }
    accept(c, vec![t, o], new.into(), old)
}

/// An exchange where every new score is above `old` (the quality is, but two faces on the surface count too).
fn accept(c: &Complex, old_tets: Vec<u32>, new: Vec<[u32; 4]>, old: f64) -> Option<Exchange> {
    new.iter().all(|&t| c.score(t) > old.max(0.0)).then_some(Exchange { old: old_tets, new, apex: None })
}
