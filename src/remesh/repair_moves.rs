//! The local operations of angle repair, each kept only where the triangles it touches get better together.

use super::angle_repair::{Badness, Summary};
use super::shape::worst_cosine;
use super::surface::{Kind, Surface};
use crate::geometry::{Point, Vector};

/// What an operation has to keep to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    pub badness: Badness,
    /// New edges are at most this many wished lengths long.
    pub longest: f64,
    /// Edges shorter than this many wished lengths are not split into.
    pub shortest: f64,
}

/// Bad triangles of a patch, worst first.
type Score = Vec<u32>;

fn sorted(mut s: Score) -> Score {
    s.retain(|&b| b > 0);
    s.sort_unstable_by(|a, b| b.cmp(a));
    s
}

/// Tries to make triangle `t` and what lies round it better. The triangles that were touched, where something helped.
pub(crate) fn improve(s: &mut Surface, t: u32, limits: Limits, summary: &mut Summary) -> Option<Vec<u32>> {
    let mut edges = [3 * t, 3 * t + 1, 3 * t + 2];
    let length = |s: &Surface, h: u32| (s.point(s.mesh.origin(h)) - s.point(s.mesh.target(h))).norm_squared();
    edges.sort_by(|&a, &b| length(s, b).total_cmp(&length(s, a)).then(a.cmp(&b)));
    for h in edges {
        if let Some(touched) = flip(s, h, limits) {
            summary.flips += 1;
            return Some(touched);
        }
    }
    for h in [edges[2], edges[1], edges[0]] {
        if let Some(touched) = collapse(s, h, limits) {
            summary.collapses += 1;
            return Some(touched);
        }
    }
    for v in s.mesh.triangle(t) {
        if let Some(touched) = relocate(s, v, limits) {
            summary.moves += 1;
            return Some(touched);
        }
    }
    for h in edges {
        if let Some(touched) = split(s, h, limits) {
            summary.splits += 1;
            return Some(touched);
        }
    }
    for v in s.mesh.triangle(t) {
        if let Some(touched) = remove_vertex(s, v, limits) {
            summary.retriangulations += 1;
            return Some(touched);
        }
    }
    None
}

fn star(s: &Surface, v: u32) -> Vec<u32> {
    s.mesh.outgoing(v).map(|h| h / 3).collect()
}

fn score(s: &Surface, triangles: &[u32], b: Badness) -> Score {
    sorted(triangles.iter().map(|&t| b.of(s.shape_of(t))).collect())
}

/// A flip, and where it alone does not help a flip with the corners moved afterwards is left to later rounds.
fn flip(s: &mut Surface, h: u32, limits: Limits) -> Option<Vec<u32>> {
    if s.mesh.is_feature(h) || s.is_locked(h) {
        return None;
    }
    let g = s.mesh.twin(h);
    let [a, b, c, d] = [s.mesh.origin(h), s.mesh.target(h), s.mesh.apex(h), s.mesh.apex(g)];
    let (t0, t1) = (h / 3, g / 3);
    let before = score(s, &[t0, t1], limits.badness);
    let [pa, pb, pc, pd] = [a, b, c, d].map(|v| s.point(v));
    let after = sorted(vec![
        limits.badness.of(worst_cosine(pc, pa, pd)),
        limits.badness.of(worst_cosine(pd, pb, pc)),
    ]);
    if after >= before || super::isotropic::flip_shapes(s, h).is_none() || !s.mesh.can_flip(h) {
        return None;
    }
    s.mesh.flip(h);
    Some(vec![t0, t1])
}

/// Draws an edge together: onto either end or onto the middle.
fn collapse(s: &mut Surface, h: u32, limits: Limits) -> Option<Vec<u32>> {
    let (a, b) = (s.mesh.origin(h), s.mesh.target(h));
    let (ka, kb) = (s.kind[a as usize].rank(), s.kind[b as usize].rank());
    let mut before_set = star(s, a);
    for t in star(s, b) {
        if !before_set.contains(&t) {
            before_set.push(t);
        }
    }
    let before = score(s, &before_set, limits.badness);
    let mut candidates: Vec<(u32, Point, Vector)> = Vec::with_capacity(3);
    if ka <= kb && s.may_collapse(h) {
        candidates.push((h, *s.point(b), s.normal[b as usize]));
    }
    let g = s.mesh.twin(h);
    if kb <= ka && s.may_collapse(g) {
        candidates.push((g, *s.point(a), s.normal[a as usize]));
    }
    if ka == kb && ka <= 1 && !candidates.is_empty() && s.kind[b as usize] == s.kind[a as usize] {
        if let Some((p, n, _)) = s.place_on_edge(h, 0.5).filter(|_| s.kind[b as usize].moves()) {
            candidates.push((candidates[0].0, p, n));
        }
    }
    let mut best: Option<(Score, u32, Point, Vector)> = None;
    for (e, p, n) in candidates {
        if let Some(after) = collapsed(s, e, &p, &n, limits) {
            if after < before && best.as_ref().is_none_or(|k| after < k.0) {
                best = Some((after, e, p, n));
            }
        }
    }
    let (_, e, p, n) = best?;
    let keep = s.mesh.target(e);
    let moved = p != *s.point(keep);
    s.collapse(e);
    if moved {
        s.set(keep, p, n);
    }
    Some(star(s, keep))
}

/// Score of the ring left by drawing `e` together at `p`; `None` where that breaks a guard.
fn collapsed(s: &Surface, e: u32, p: &Point, n: &Vector, limits: Limits) -> Option<Score> {
    let gone = [e / 3, s.mesh.twin(e) / 3];
    let size = s.field.size(p);
    let longest = (limits.longest * size).powi(2);
    let mut list = Vec::with_capacity(12);
    for (v, other) in [(s.mesh.origin(e), s.mesh.target(e)), (s.mesh.target(e), s.mesh.origin(e))] {
        for h in s.mesh.outgoing(v) {
            if s.mesh.target(h) != other && (s.point(s.mesh.target(h)) - p).norm_squared() > longest.max(reach2(s, v)) {
                return None;
            }
            if !gone.contains(&(h / 3)) {
                list.push(limits.badness.of(moved_triangle(s, h, p, n)?));
            }
        }
    }
    Some(sorted(list))
}

/// Worst cosine round the vertex left by drawing `e` together at `p`; `None` where a triangle would turn over.
pub(crate) fn collapsed_shape(s: &Surface, e: u32, p: &Point, n: &Vector) -> Option<f64> {
    let gone = [e / 3, s.mesh.twin(e) / 3];
    let mut worst = 0.0f64;
    for v in [s.mesh.origin(e), s.mesh.target(e)] {
        for h in s.mesh.outgoing(v).filter(|h| !gone.contains(&(h / 3))) {
            worst = worst.max(moved_triangle(s, h, p, n)?);
        }
    }
    Some(worst)
}

fn reach2(s: &Surface, v: u32) -> f64 {
    s.mesh.outgoing(v).map(|h| (s.point(s.mesh.target(h)) - s.point(v)).norm_squared()).fold(0.0, f64::max)
}

/// Worst cosine of the triangle of `h` with its origin at `p`; `None` where it would turn over.
fn moved_triangle(s: &Surface, h: u32, p: &Point, n: &Vector) -> Option<f64> {
    let t = h / 3;
    let (c, d) = (s.mesh.target(h), s.mesh.apex(h));
    let normals = [n, &s.normal[c as usize], &s.normal[d as usize]];
    let after = s.uprightness(s.mesh.patch(t), [p, s.point(c), s.point(d)], normals);
    Surface::stands(s.uprightness_of(t), after).then(|| worst_cosine(p, s.point(c), s.point(d)))
}

/// Splits an edge near its middle and lets the new vertex look for its best place.
fn split(s: &mut Surface, h: u32, limits: Limits) -> Option<Vec<u32>> {
    if s.is_locked(h) {
        return None;
    }
    let g = s.mesh.twin(h);
    let [a, b, c, d] = [s.mesh.origin(h), s.mesh.target(h), s.mesh.apex(h), s.mesh.apex(g)];
    let (pa, pb) = (*s.point(a), *s.point(b));
    if (pb - pa).norm() < 2.0 * limits.shortest * 0.5 * (s.size[a as usize] + s.size[b as usize]) {
        return None;
    }
    let before = score(s, &[h / 3, g / 3], limits.badness);
    let mut best: Option<(Score, Point, Vector, Kind)> = None;
    // Middle, and the feet of the apexes.
    let e = (pb - pa) / (pb - pa).norm_squared();
    let feet = [0.5, (s.point(c) - pa).dot(&e), (s.point(d) - pa).dot(&e)];
    for t in feet.into_iter().filter(|t| (0.2..=0.8).contains(t)) {
        let Some((p, n, kind)) = s.place_on_edge(h, t) else { continue };
        let mut list = Vec::with_capacity(4);
        let mut stands = true;
        for (t, [x, y, z]) in [(h / 3, [a, b, c]), (g / 3, [b, a, d])] {
            let old = s.uprightness_of(t);
            for (q, r) in [(x, z), (z, y)] {
                let (from, to) = if q == x { (q, r) } else { (r, q) };
                // Triangles x p z and p y z.
                let (corner, normals) = if q == x {
                    ([s.point(from), &p, s.point(to)], [&s.normal[from as usize], &n, &s.normal[to as usize]])
                } else {
                    ([&p, s.point(from), s.point(to)], [&n, &s.normal[from as usize], &s.normal[to as usize]])
                };
                stands &= Surface::stands(old, s.uprightness(s.mesh.patch(t), corner, normals));
                list.push(limits.badness.of(worst_cosine(corner[0], corner[1], corner[2])));
            }
        }
        let after = sorted(list);
        if stands && after < before && best.as_ref().is_none_or(|k| after < k.0) {
            best = Some((after, p, n, kind));
        }
    }
    let (_, p, n, kind) = best?;
    let v = s.split(h, (p, n, kind));
    Some(star(s, v))
}

/// Looks round a vertex for a place where its ring is better.
fn relocate(s: &mut Surface, v: u32, limits: Limits) -> Option<Vec<u32>> {
    let kind = s.kind[v as usize];
    if !kind.moves() {
        return None;
    }
    let ring = star(s, v);
    let before = score(s, &ring, limits.badness);
    let origin = *s.point(v);
    let mean = ring_radius(s, v);
    let directions: Vec<Vector> = match kind {
        Kind::Curve(..) => {
            let t = s.rim_direction(v)?;
            vec![t, -t]
        }
        _ => {
            let (x, y) = tangent_basis(&s.carrier_normal(v))?;
            (0..8)
                .map(|i| {
                    let (sin, cos) = (f64::from(i) * std::f64::consts::FRAC_PI_4).sin_cos();
                    x * cos + y * sin
                })
                .collect()
        }
    };
    let mut best: Option<(Score, Point, Vector)> = None;
    for radius in [0.3, 0.15, 0.06, 0.02] {
        for d in &directions {
            let p = origin + d * (radius * mean);
            // On the tangent plane first: most places fail there already.
            let bar = best.as_ref().map_or(&before, |k| &k.0);
            if trial(s, v, &p, &s.normal[v as usize], limits, false).is_none_or(|x| x >= *bar) {
                continue;
            }
            let Some((p, n)) = s.project(v, &p, 0.5 * mean) else { continue };
            match trial(s, v, &p, &n, limits, true) {
                Some(after) if after < *bar => best = Some((after, p, n)),
                _ => {}
            }
        }
        if best.is_some() {
            break;
        }
    }
    let (_, p, n) = best?;
    s.set(v, p, n);
    Some(ring)
}

fn trial(s: &Surface, v: u32, p: &Point, n: &Vector, limits: Limits, guarded: bool) -> Option<Score> {
    let mut list = Vec::with_capacity(8);
    for h in s.mesh.outgoing(v) {
        let cosine = if guarded {
            moved_triangle(s, h, p, n)?
        } else {
            worst_cosine(p, s.point(s.mesh.target(h)), s.point(s.mesh.apex(h)))
        };
        list.push(limits.badness.of(cosine));
    }
    Some(sorted(list))
}

pub(crate) fn ring_radius(s: &Surface, v: u32) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for h in s.mesh.outgoing(v) {
        sum += (s.point(s.mesh.target(h)) - s.point(v)).norm();
        n += 1.0;
    }
    sum / n
}

/// Two unit vectors across `n`.
pub(crate) fn tangent_basis(n: &Vector) -> Option<(Vector, Vector)> {
    crate::geometry::Plane::new(Point::origin(), *n).map(|p| p.basis())
}

/// Takes a vertex out and triangulates the hole anew with the best smallest angle (dynamic programming over the
/// polygon of its ring), carried out as flips and one collapse.
fn remove_vertex(s: &mut Surface, v: u32, limits: Limits) -> Option<Vec<u32>> {
    if !matches!(s.kind[v as usize], Kind::Surface(_)) {
        return None;
    }
    // Collapsing v onto a neighbour is a fan; better triangulations follow by flips in the same trial.
    let ring = star(s, v);
    let before = score(s, &ring, limits.badness);
    let spokes: Vec<u32> = s.mesh.outgoing(v).collect();
    let corners: Vec<u32> = spokes.iter().map(|&h| s.mesh.target(h)).collect();
    let n = corners.len();
    if !(4..=10).contains(&n) {
        return None;
    }
    let patch = s.mesh.patch(ring[0]);
    let old = ring.iter().map(|&t| s.uprightness_of(t)).fold(1.0, f64::min);
    // best[i][j]: score and apex of the polygon corners i..=j.
    let mut best: Vec<Vec<Option<(Score, usize)>>> = vec![vec![None; n]; n];
    for (i, row) in best.iter_mut().enumerate().take(n - 1) {
        row[i + 1] = Some((Vec::new(), usize::MAX));
    }
    for span in 2..n {
        for i in 0..n - span {
            let j = i + span;
            for k in i + 1..j {
                let (Some(left), Some(right)) = (&best[i][k], &best[k][j]) else { continue };
                let at = [i, k, j].map(|x| corners[x]);
                let [a, b, c] = at.map(|x| s.point(x));
                if !Surface::stands(old, s.uprightness(patch, [a, b, c], at.map(|x| &s.normal[x as usize]))) {
                    continue;
                }
                let mut list = left.0.clone();
                list.extend(&right.0);
                list.push(limits.badness.of(worst_cosine(a, b, c)));
                let list = sorted(list);
                if best[i][j].as_ref().is_none_or(|x| list < x.0) {
                    best[i][j] = Some((list, k));
                }
            }
        }
    }
    let (after, _) = best[0][n - 1].as_ref()?;
    if *after >= before {
        return None;
    }
    let mut wanted = Vec::new();
    let mut stack = vec![(0, n - 1)];
    while let Some((i, j)) = stack.pop() {
        if j - i < 2 {
            continue;
        }
        let k = best[i][j].as_ref()?.1;
        for (x, y) in [(i, k), (k, j)] {
            if y - x >= 2 {
                wanted.push((corners[x], corners[y]));
            }
        }
        stack.extend([(i, k), (k, j)]);
    }
    if wanted.iter().any(|&(x, y)| s.mesh.find(x, y).is_some()) || corners.iter().any(|&c| s.mesh.valence(c) <= 3) {
        return None;
    }
    realise(s, v, &corners, &wanted)
}

/// Flips spokes of `v` until three are left, each flip making one wanted diagonal, then draws `v` away.
fn realise(s: &mut Surface, v: u32, corners: &[u32], wanted: &[(u32, u32)]) -> Option<Vec<u32>> {
    let is_wanted = |x: u32, y: u32| wanted.iter().any(|&w| w == (x, y) || w == (y, x));
    while s.mesh.valence(v) > 3 {
        // Ears first: a spoke whose neighbours on the ring want to be joined.
        let spoke = s.mesh.outgoing(v).find(|&h| {
            let (c, d) = (s.mesh.apex(h), s.mesh.apex(s.mesh.twin(h)));
            is_wanted(c, d) && s.mesh.find(c, d).is_none()
        })?;
        s.mesh.flip(spoke);
    }
    // Three spokes are left, inside one triangle: any neighbour may take the vertex.
    let h = s.mesh.outgoing(v).next()?;
    s.collapse(h);
    let mut touched: Vec<u32> = corners.iter().flat_map(|&c| star(s, c)).collect();
    touched.sort_unstable();
    touched.dedup();
    Some(touched)
}
