//! Where the function is zero on edges of the lattice: many edges at a time.

use crate::geometry::Point;

/// No vertex comes nearer to a corner than this part of its edge.
const CLEARANCE: f64 = 1e-3;
/// A root is found when the function is this part of a cell away from zero.
const ROOT: f64 = 5e-5;
/// Of a smooth function, a step from this part of a cell on leads to the root: inverse interpolation leaves well below a
/// hundredth of it.
const SURE: f64 = 3e-3;
/// Rounds of looking at most.
const ROUNDS: usize = 12;

/// An edge at whose ends the function has different signs, and between which shares of the way the root lies.
pub(super) struct Edge {
    ends: [Point; 2],
    /// The function at the ends.
    values: [f64; 2],
    between: [f64; 2],
    /// The function there, halved where an end stays for long.
    bounds: [f64; 2],
    /// Where to look next.
    at: f64,
    /// Which end moved last.
    moved: Option<usize>,
}

impl Edge {
    /// `beyond`: what is known (a number) of the values an edge's length before and behind it.
    pub fn new(ends: [Point; 2], values: [f64; 2], beyond: [f64; 2]) -> Edge {
        Edge { ends, values, between: [0.0, 1.0], bounds: values, at: guess(values, beyond), moved: None }
    }

    fn point(&self, at: f64) -> Point {
        self.ends[0] + (self.ends[1] - self.ends[0]) * at
    }

    /// The vertex to put on the edge.
    pub fn root(&self) -> Point {
        self.point(self.at.clamp(CLEARANCE, 1.0 - CLEARANCE))
    }

    /// Takes the value `f` at the place that was looked at and says where to look next: regula falsi, Illinois variant, after one
    /// step of inverse quadratic interpolation, which mostly suffices. Returns whether to look at all.
    ///
    /// Where the function is `smooth` the last step from near the root is not looked at again.
    fn take(&mut self, f: f64, cell: f64, smooth: bool) -> bool {
        if f.abs() <= ROOT * cell || !f.is_finite() {
            return false;
        }
        let first = self.moved.is_none();
        let t = self.at;
        let end = usize::from((f > 0.0) == (self.bounds[1] > 0.0));
        (self.between[end], self.bounds[end]) = (t, f);
        if self.moved == Some(end) {
            self.bounds[1 - end] *= 0.5;
        }
        self.moved = Some(end);
        let ([lo, hi], [flo, fhi]) = (self.between, self.bounds);
        let width = hi - lo;
        let mut s = lo + width * (flo / (flo - fhi));
        if first {
            let [x, y, z] = [(0.0, self.values[0]), (1.0, self.values[1]), (t, f)];
            let term = |p: (f64, f64), q: (f64, f64), r: (f64, f64)| p.0 * (q.1 * r.1) / ((p.1 - q.1) * (p.1 - r.1));
            s = term(x, y, z) + term(y, x, z) + term(z, x, y);
        }
        // A jump of the function leaves a sliver that falsi cannot shrink: bisect then.
        self.at = if s > lo && s < hi { s } else { lo + 0.5 * width };
        width >= 1e-6 && !(smooth && f.abs() < SURE * cell)
    }
}

/// Finds the roots on edges of a lattice with cells of edge `cell`; returns the number of values asked for.
pub(super) fn find(edges: &mut [Edge], cell: f64, smooth: bool, values: impl Fn(&[Point], &mut [f64])) -> usize {
    let mut left: Vec<usize> = (0..edges.len()).collect();
    let mut evaluations = 0;
    let (mut points, mut found) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        if left.is_empty() {
            break;
        }
        points.clear();
        points.extend(left.iter().map(|&n| edges[n].point(edges[n].at)));
        found.resize(points.len(), 0.0);
        values(&points, &mut found);
        evaluations += points.len();
        let mut value = found.iter();
        left.retain(|&n| value.next().is_some_and(|&f| edges[n].take(f, cell, smooth)));
    }
    evaluations
}

/// Where the function has its zero between 0 and 1: of the polynomial through its values there and what is known (a number)
/// of those at −1 and 2.
fn guess([fa, fb]: [f64; 2], [before, behind]: [f64; 2]) -> f64 {
    let scale = 1.0 / (fa - fb);
    let linear = fa * scale;
    let bends = match (before - 2.0 * fa + fb, fa - 2.0 * fb + behind) {
        (a, b) if a.is_finite() && b.is_finite() => [a, b],
        (a, _) if a.is_finite() => [a, a],
        (_, b) if b.is_finite() => [b, b],
        _ => return linear,
    };
    // fa + t (fb − fa) + t (t − 1)/2 · bend(t), bend linear between −1 and 2: a fixed point of the first two terms.
    let mut t = linear;
    for _ in 0..4 {
        let bend = (bends[0] * (2.0 - t) + bends[1] * (1.0 + t)) / 3.0;
        t = linear + 0.5 * t * (t - 1.0) * bend * scale;
    }
    if t > 0.0 && t < 1.0 { t } else { linear }
}
