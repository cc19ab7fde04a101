//! Relaxation: vertices move along their carrier to where triangles of the wished size balance.

use rayon::prelude::*;

use super::surface::{Kind, Surface};
use crate::geometry::{Point, Vector};

/// How a vertex weighs the triangles round it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Balance {
    /// Part of the way to the balance point, 0 to 1.
    pub step: f64,
    /// 0: centroid of the ring, triangles weighed by area over wished area, which evens out sizes;
    /// 1: mean of the places that make each triangle of the ring equilateral, which evens out angles.
    pub shape: f64,
    /// Whether to bring vertices back onto the carrier. Steps in the tangent plane leave it by the square of the step
    /// only, so every second step may go without: evaluating the implicit is what costs.
    pub project: bool,
}

/// One Jacobi step on every vertex that may move; triangles that would turn over keep their vertices.
/// At most one evaluation of the implicit a vertex. Returns the longest move over the wished edge length.
pub(crate) fn relax(s: &mut Surface, ids: &[u32], balance: Balance) -> f64 {
    let moved: Vec<Option<(Point, Vector)>> = ids.par_iter().map(|&v| target(s, v, balance)).collect();
    apply(s, ids, moved)
}

/// Puts vertices at new places and takes back, with their neighbours' help, those that turn a triangle over.
pub(crate) fn apply(s: &mut Surface, ids: &[u32], moved: Vec<Option<(Point, Vector)>>) -> f64 {
    let mut old: Vec<Option<(Point, Vector)>> = vec![None; s.mesh.points.len()];
    let mut longest = 0.0f64;
    for (&v, place) in ids.iter().zip(&moved) {
        let Some((p, n)) = *place else { continue };
        let i = v as usize;
        longest = longest.max((p - s.mesh.points[i]).norm() / s.size[i]);
        old[i] = Some((s.mesh.points[i], s.normal[i]));
        s.mesh.points[i] = p;
        s.normal[i] = n;
    }
    loop {
        let bad: Vec<u32> = (0..s.mesh.triangle_ids() as u32)
            .into_par_iter()
            .filter(|&t| {
                s.mesh.has_triangle(t)
                    && s.mesh.triangle(t).iter().any(|&v| old[v as usize].is_some())
                    && turned(s, &old, t)
            })
            .collect();
        let mut any = false;
        for t in bad {
            for v in s.mesh.triangle(t) {
                if let Some((p, n)) = old[v as usize].take() {
                    s.mesh.points[v as usize] = p;
                    s.normal[v as usize] = n;
                    any = true;
                }
            }
        }
        if !any {
            break;
        }
    }
    let sizes: Vec<f64> = ids.par_iter().map(|&v| s.field.size(s.point(v))).collect();
    for (&v, h) in ids.iter().zip(sizes) {
        s.size[v as usize] = h;
    }
    longest
}

/// Whether triangle `t` leans too far and more than before the move.
fn turned(s: &Surface, old: &[Option<(Point, Vector)>], t: u32) -> bool {
    let after = s.uprightness_of(t);
    if Surface::stands(f64::INFINITY, after) {
        return false;
    }
    let at = s.mesh.triangle(t).map(|v| old[v as usize].unwrap_or((*s.point(v), s.normal[v as usize])));
    let [a, b, c] = &at;
    !Surface::stands(s.uprightness(s.mesh.patch(t), [&a.0, &b.0, &c.0], [&a.1, &b.1, &c.1]), after)
}

fn target(s: &Surface, v: u32, balance: Balance) -> Option<(Point, Vector)> {
    let p = *s.point(v);
    let h = s.size[v as usize];
    match s.kind[v as usize] {
        Kind::Surface(patch) => {
            let d = balance_point(s, v, balance)? - p;
            let n = s.carrier_normal(v);
            let mut d = (d - n * n.dot(&d)) * balance.step;
            let length = d.norm();
            if length > 0.5 * h {
                d *= 0.5 * h / length;
            }
            if let Some(plane) = s.supports.plane(patch) {
                return Some((plane.project(&(p + d)), Vector::zeros()));
            }
            if !balance.project {
                return Some((p + d, n));
            }
            let (q, n, step) = s.supports.wall_step(&(p + d), h)?;
            // A long Newton step needs another.
            if step > 0.1 * h {
                return s.supports.wall_step(&q, h).map(|(q, n, _)| (q, s.normal_after_move(v, n)));
            }
            Some((q, s.normal_after_move(v, n)))
        }
        Kind::Curve(..) if balance.project => {
            let [a, b] = s.feature_neighbours(v)?;
            let t = s.rim_direction(v)?;
            let (pa, pb) = (s.point(a), s.point(b));
            let (wa, wb) = (1.0 / (h + s.size[a as usize]), 1.0 / (h + s.size[b as usize]));
            // Equal edge lengths over wished lengths along the rim.
            let (la, lb) = ((pa - p).norm() * wa, (pb - p).norm() * wb);
            let along = (lb - la) / (wa + wb) * (pb - pa).dot(&t).signum();
            // Half the way: neighbours that go the whole way at once swing for ever.
            let d = t * (0.5 * along).clamp(-0.3 * h, 0.3 * h);
            s.project(v, &(p + d), h)
        }
        _ => None,
    }
}

fn balance_point(s: &Surface, v: u32, balance: Balance) -> Option<Point> {
    let p = s.point(v).coords;
    let n = s.carrier_normal(v);
    let (mut ring, mut weight) = (Vector::zeros(), 0.0);
    let (mut ideal, mut count) = (Vector::zeros(), 0.0);
    for e in s.mesh.outgoing(v) {
        let (b, c) = (s.mesh.target(e), s.mesh.apex(e));
        let (pb, pc) = (s.point(b).coords, s.point(c).coords);
        let h = (s.size[v as usize] + s.size[b as usize] + s.size[c as usize]) / 3.0;
        let w = (pb - p).cross(&(pc - p)).norm() / (h * h);
        ring += (p + pb + pc) * (w / 3.0);
        weight += w;
        // The equilateral triangle on b c, on this side of it.
        ideal += 0.5 * (pb + pc) + n.cross(&(pc - pb)) * 0.75f64.sqrt();
        count += 1.0;
    }
    let centroid = (weight > 0.0).then(|| ring / weight)?;
    let c = balance.shape;
    Some(Point::from(ideal / count * c + centroid * (1.0 - c)))
}
