//! One step of the front: the best triangle on an edge, from front vertices nearby or a new vertex on the surface.

use std::f64::consts::{PI, TAU};

use crate::geometry::{Point, Vector};
use crate::implicit::Implicit;
use crate::remesh::SizeField;

use super::state::Front;

type P2 = [f64; 2];

/// How lenient an attempt is.
struct Level {
    /// Smallest score of a triangle.
    score: f64,
    /// Reach for front vertices, edge lengths.
    reach: f64,
    /// Smallest cosine between the triangle's and its corners' normals.
    cosine: f64,
    /// Room that a new vertex needs round it, edge lengths.
    room: f64,
}

const LEVELS: [Level; 4] = [
    Level { score: 0.45, reach: 0.95, cosine: 0.5, room: 0.6 },
    Level { score: 0.25, reach: 1.4, cosine: 0.4, room: 0.5 },
    Level { score: 0.08, reach: 1.9, cosine: 0.25, room: 0.4 },
    Level { score: 0.005, reach: 2.6, cosine: 0.1, room: 0.35 },
];

/// Number of levels of leniency.
pub(super) const LAST_LEVEL: u8 = LEVELS.len() as u8 - 1;

struct Near {
    node: u32,
    a: u32,
    b: u32,
    pa: P2,
    pb: P2,
}

/// Room for the edges near the current one.
#[derive(Default)]
pub(super) struct Scratch {
    ids: Vec<u32>,
    near: Vec<Near>,
}

pub(super) struct Surface<'a> {
    pub implicit: &'a dyn Implicit,
    pub size: &'a dyn SizeField,
}

impl Surface<'_> {
    /// The surface point reached from `p` along the gradient, and the unit normal there.
    pub fn project(&self, p: &Point, reach: f64, tolerance: f64) -> Option<(Point, Vector)> {
        let mut q = *p;
        for _ in 0..12 {
            let (f, g) = self.implicit.value_gradient(&q);
            let g2 = g.norm_squared();
            if !(g2 > 1e-300 && f.is_finite()) {
                return None;
            }
            let mut step = -f / g2 * g;
            let length = step.norm();
            if length > 0.5 * reach {
                step *= 0.5 * reach / length;
            }
            q += step;
            if (q - p).norm() > reach {
                return None;
            }
            if length <= tolerance {
                return Some((q, g / g2.sqrt()));
            }
        }
        None
    }
}

/// The edge's tangent plane; distances from its middle are kept when points of the surface are laid into it.
struct Frame {
    origin: Point,
    u: Vector,
    w: Vector,
    n: Vector,
}

impl Frame {
    fn lay(&self, p: &Point) -> P2 {
        let d = p - self.origin;
        let (x, y) = (d.dot(&self.u), d.dot(&self.w));
        let t = x.hypot(y);
        let s = if t > 0.3 * d.norm() { d.norm() / t } else { 1.0 };
        [x * s, y * s]
    }

    fn lift(&self, p: P2) -> Point {
        self.origin + self.u * p[0] + self.w * p[1]
    }
}

fn sub(a: P2, b: P2) -> P2 {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: P2, b: P2) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn distance(a: P2, b: P2) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Counter-clockwise angle from one direction to another, 0 to 2π.
fn turn(from: P2, to: P2) -> f64 {
    let a = cross(from, to).atan2(from[0] * to[0] + from[1] * to[1]);
    if a < 0.0 { a + TAU } else { a }
}

fn orient(a: P2, b: P2, c: P2) -> f64 {
    cross(sub(b, a), sub(c, a))
}

fn segments_cross(a: P2, b: P2, c: P2, d: P2) -> bool {
    orient(a, b, c) * orient(a, b, d) <= 0.0 && orient(c, d, a) * orient(c, d, b) <= 0.0
}

fn distance_to_segment(p: P2, a: P2, b: P2) -> f64 {
    let (d, e) = (sub(b, a), sub(p, a));
    let l = d[0] * d[0] + d[1] * d[1];
    let t = if l > 0.0 { ((d[0] * e[0] + d[1] * e[1]) / l).clamp(0.0, 1.0) } else { 0.0 };
    distance(p, [a[0] + t * d[0], a[1] + t * d[1]])
}

/// Smallest angle of a triangle in units of 60°.
pub(super) fn shape(a: &Point, b: &Point, c: &Point) -> f64 {
    let l = [(c - b).norm(), (a - c).norm(), (b - a).norm()];
    let k = if l[0] <= l[1] && l[0] <= l[2] { 0 } else if l[1] <= l[2] { 1 } else { 2 };
    let (x, y, z) = (l[(k + 1) % 3], l[(k + 2) % 3], l[k]);
    let d = 2.0 * x * y;
    if d > 0.0 { ((x * x + y * y - z * z) / d).clamp(-1.0, 1.0).acos() / (PI / 3.0) } else { 0.0 }
}

/// 1 for corners with room for a triangle, falling to 0 with the corner.
fn room_left(angle: f64) -> f64 {
    (angle / 0.75).clamp(0.0, 1.0)
}

struct Candidate {
    score: f64,
    node: Option<u32>,
    vertex: u32,
    p: P2,
}

/// Tries to put a triangle on front edge `i`; false where nothing is good enough for the edge's level.
pub(super) fn attempt(front: &mut Front, surface: &Surface, i: u32, scratch: &mut Scratch) -> bool {
    let lenient = front.node(i).level.min(LAST_LEVEL);
    let level = &LEVELS[lenient as usize];
    let (a, b) = front.ends(i);
    let (j, before) = (front.next(i), front.prev(i));
    let (pa, pb) = (front.points[a as usize], front.points[b as usize]);
    let edge = pb - pa;
    let length = edge.norm();
    let u = edge / length;
    let n = front.normals[a as usize] + front.normals[b as usize];
    let n = n - u * n.dot(&u);
    if !(length > 0.0 && n.norm() > 1e-6) {
        return false;
    }
    let n = n.normalize();
    let frame = Frame { origin: nalgebra::center(&pa, &pb), u, w: n.cross(&u), n };
    let (qa, qb): (P2, P2) = ([-0.5 * length, 0.0], [0.5 * length, 0.0]);
    let mut h = 0.5 * (front.sizes[a as usize] + front.sizes[b as usize]);
    let lay_vertex = |front: &Front, v: u32| frame.lay(&front.points[v as usize]);
    let (va, vb) = (front.node(before).vertex, front.node(front.next(j)).vertex);
    let corner_a = turn([1.0, 0.0], sub(lay_vertex(front, va), qa));
    let corner_b = turn(sub(lay_vertex(front, vb), qb), [-1.0, 0.0]);

    // Where a new vertex would be best: the corners divided into angles near 60°.
    let share = |corner: f64| (corner / (corner / (PI / 3.0)).round().max(1.0)).clamp(0.8, 1.35);
    let (ta, tb) = (share(corner_a), share(corner_b));
    let ideal = |h: f64| {
        [0.5 * (qa[0] + h * ta.cos() + qb[0] - h * tb.cos()), 0.5 * h * (ta.sin() + tb.sin())]
    };
    let mut apex = ideal(h);
    let apex_size = surface.size.size(&frame.lift(apex));
    let wished = (0.5 * (h + apex_size)).clamp(0.6 * length, 1.8 * length);
    if (wished / h - 1.0).abs() > 0.01 {
        h = wished;
        apex = ideal(h);
    }

    collect(front, &frame, &frame.lift([0.5 * apex[0], 0.5 * apex[1]]), (0.7 + level.reach) * h.max(length), h, scratch);
    let near = &scratch.near;

    let local = Local { front, near, i, a, b, qa, qb, corner_a, corner_b, va, vb, h, level };
    let mut candidates: Vec<Candidate> = Vec::with_capacity(8);
    for e in near {
        let is_neighbour = e.node == before || e.node == front.next(j);
        if e.node == i || e.node == j || e.a == a || e.a == b {
            continue;
        }
        if !is_neighbour && distance(e.pa, apex) > level.reach * h {
            continue;
        }
        if let Some(score) = local.score_existing(e.node, e.a, e.pa) {
            candidates.push(Candidate { score, node: Some(e.node), vertex: e.a, p: e.pa });
        }
    }
    if let Some((p, normal)) = place(surface, &frame, apex, h) {
        let q = frame.lay(&p);
        if let Some(score) = local.score_new(&p, &normal, q) {
            candidates.push(Candidate { score, node: None, vertex: 0, p: q });
        }
        candidates.sort_by(|x, y| y.score.total_cmp(&x.score));
        if let Some(c) = candidates.iter().find(|c| local.is_free(c)) {
            match c.node {
                Some(k) => front.connect(i, k),
                None => {
                    let v = front.add_vertex(p, normal, apex_size);
                    front.grow(i, v);
                }
            }
            return true;
        }
        return false;
    }
    candidates.sort_by(|x, y| y.score.total_cmp(&x.score));
    let Some(k) = candidates.iter().find(|c| local.is_free(c)).and_then(|c| c.node) else { return false };
    front.connect(i, k);
    true
}

/// A new vertex on the surface at the planned distance from the edge's middle.
fn place(surface: &Surface, frame: &Frame, apex: P2, h: f64) -> Option<(Point, Vector)> {
    let target = apex[0].hypot(apex[1]);
    let (mut p, mut normal) = surface.project(&frame.lift(apex), 0.8 * h, 1e-4 * h)?;
    let d = (p - frame.origin).norm();
    // The tangent plane leaves a curved surface: what was planned flat comes out too near.
    if d > 0.0 && (target / d - 1.0).abs() > 0.02 {
        let further = frame.origin + (p - frame.origin) * (target / d).clamp(0.6, 1.6);
        (p, normal) = surface.project(&further, 0.8 * h, 1e-4 * h)?;
    }
    (normal.dot(&frame.n) > 0.2).then_some((p, normal))
}

/// Lays the front edges of this sheet near `center` into the frame.
fn collect(front: &Front, frame: &Frame, center: &Point, radius: f64, h: f64, scratch: &mut Scratch) {
    front.near(center, radius, h, &mut scratch.ids);
    scratch.near.clear();
    for &node in &scratch.ids {
        let (a, b) = front.ends(node);
        let (na, nb) = (front.normals[a as usize].dot(&frame.n), front.normals[b as usize].dot(&frame.n));
        if na.max(nb) <= 0.0 {
            continue;
        }
        let (p, q) = (front.points[a as usize], front.points[b as usize]);
        let m = nalgebra::center(&p, &q);
        let reach = radius + 0.5 * (q - p).norm();
        let d = m - frame.origin;
        if (m - center).norm_squared() > reach * reach || d.dot(&frame.n).abs() > 0.85 * d.norm() + 1e-9 * h {
            continue;
        }
        scratch.near.push(Near { node, a, b, pa: frame.lay(&p), pb: frame.lay(&q) });
    }
}

struct Local<'a> {
    front: &'a Front,
    near: &'a [Near],
    i: u32,
    a: u32,
    b: u32,
    qa: P2,
    qb: P2,
    corner_a: f64,
    corner_b: f64,
    va: u32,
    vb: u32,
    h: f64,
    level: &'a Level,
}

impl Local<'_> {
    /// Shape and size of triangle (a, b, c), 0 to 1; `None` where it turns away from the surface.
    fn triangle(&self, c: &Point, normal: &Vector) -> Option<f64> {
        let f = self.front;
        let (a, b) = (&f.points[self.a as usize], &f.points[self.b as usize]);
        let n = (b - a).cross(&(c - a));
        let limit = self.level.cosine * n.norm();
        let faces = |m: &Vector| n.dot(m) > limit;
        if !(faces(normal) && faces(&f.normals[self.a as usize]) && faces(&f.normals[self.b as usize])) {
            return None;
        }
        let longest = (c - a).norm().max((c - b).norm()) / self.h;
        let length = if longest > 1.4 { (1.4 / longest).powi(2) } else { 1.0 };
        Some(shape(a, b, c) * length)
    }

    fn score_existing(&self, k: u32, c: u32, q: P2) -> Option<f64> {
        let f = self.front;
        let j = f.next(self.i);
        let (is_before, is_after) = (k == f.prev(self.i), k == f.next(j));
        let mut score = self.triangle(&f.points[c as usize], &f.normals[c as usize])?;
        if !is_before {
            let used = turn([1.0, 0.0], sub(q, self.qa));
            if c == self.va || f.has_edge(self.a, c) || used >= self.corner_a {
                return None;
            }
            score *= room_left(self.corner_a - used);
        }
        if !is_after {
            let used = turn(sub(q, self.qb), [-1.0, 0.0]);
            if c == self.vb || f.has_edge(self.b, c) || used >= self.corner_b {
                return None;
            }
            score *= room_left(self.corner_b - used);
        }
        if !(is_before && is_after) {
            // The triangle must lie in the unmeshed sector of node k.
            let out = self.lay_of(f.node(f.next(k)).vertex)?;
            let back = self.lay_of(f.node(f.prev(k)).vertex)?;
            let open = turn(sub(out, q), sub(back, q));
            let to_a = if is_before { 0.0 } else { turn(sub(out, q), sub(self.qa, q)) };
            let to_b = if is_after { open } else { turn(sub(out, q), sub(self.qb, q)) };
            if !(to_a < to_b && to_b <= open) {
                return None;
            }
            if !is_before {
                score *= room_left(to_a);
            }
            if !is_after {
                score *= room_left(open - to_b);
            }
        }
        (score >= self.level.score).then_some(score)
    }

    /// Laid position of a front vertex next to a near one.
    fn lay_of(&self, v: u32) -> Option<P2> {
        self.near.iter().find_map(|e| if e.a == v { Some(e.pa) } else if e.b == v { Some(e.pb) } else { None })
    }

    fn score_new(&self, p: &Point, normal: &Vector, q: P2) -> Option<f64> {
        let mut score = self.triangle(p, normal)?;
        let used = [turn([1.0, 0.0], sub(q, self.qa)), turn(sub(q, self.qb), [-1.0, 0.0])];
        for (used, corner) in used.into_iter().zip([self.corner_a, self.corner_b]) {
            if used >= corner {
                return None;
            }
            score *= room_left(corner - used);
        }
        for e in self.near {
            if e.a != self.a && e.a != self.b {
                let d = distance(e.pa, q) / self.h;
                if d < self.level.room {
                    return None;
                }
                score *= (d / 0.8).min(1.0).powi(2);
            }
            if e.node != self.i && [e.a, e.b].iter().all(|v| *v != self.a && *v != self.b) {
                let d = distance_to_segment(q, e.pa, e.pb) / self.h;
                score *= (d / 0.55).min(1.0);
            }
        }
        (score >= self.level.score).then_some(score)
    }

    /// Whether the two new edges cross no front edge and the triangle holds no front vertex.
    fn is_free(&self, c: &Candidate) -> bool {
        let f = self.front;
        let existing = c.node.map(|_| c.vertex);
        let new_a = existing.is_none() || c.node != Some(f.prev(self.i));
        let new_b = existing.is_none() || c.node != Some(f.next(f.next(self.i)));
        for e in self.near {
            if e.node == self.i {
                continue;
            }
            let touches = |v: u32| e.a == v || e.b == v;
            let at_c = existing.is_some_and(touches);
            if new_a && !at_c && !touches(self.a) && segments_cross(self.qa, c.p, e.pa, e.pb) {
                return false;
            }
            if new_b && !at_c && !touches(self.b) && segments_cross(self.qb, c.p, e.pa, e.pb) {
                return false;
            }
            for (v, q) in [(e.a, e.pa), (e.b, e.pb)] {
                let corner = v == self.a || v == self.b || existing == Some(v);
                let inside = |v: P2| {
                    orient(self.qa, self.qb, v) >= 0.0 && orient(self.qb, c.p, v) >= 0.0 && orient(c.p, self.qa, v) >= 0.0
                };
                if !corner && inside(q) {
                    return false;
                }
            }
        }
        true
    }
}
