//! What each patch of a surface lies on: the implicit wall or a plane.

use crate::geometry::{Plane, Point, Vector};
use crate::implicit::Implicit;
use crate::mesh::PatchId;

/// Newton steps before a projection falls back to bracketing.
const NEWTON_STEPS: usize = 12;
/// Residual distance of a projection, in resolutions of the implicit (about half a voxel).
const TOLERANCE: f64 = 1e-9;

/// The carrier of every patch. Patches not named lie on the wall's implicit.
#[derive(Clone)]
pub struct Supports<'a> {
    wall: &'a dyn Implicit,
    planes: Vec<(PatchId, Plane)>,
}

impl<'a> Supports<'a> {
    /// Everything lies on `wall`.
    pub fn new(wall: &'a dyn Implicit) -> Supports<'a> {
        Supports { wall, planes: Vec::new() }
    }

    /// Patch `id` lies in `plane`.
    #[must_use]
    pub fn with_plane(mut self, id: PatchId, plane: Plane) -> Supports<'a> {
        self.planes.retain(|p| p.0 != id);
        self.planes.push((id, plane));
        self.planes.sort_by_key(|p| p.0);
        self
    }

    /// The wall's implicit.
    pub fn wall(&self) -> &'a dyn Implicit {
        self.wall
    }

    /// The plane of patch `id`; `None` where it lies on the wall.
    #[inline]
    pub fn plane(&self, id: PatchId) -> Option<&Plane> {
        if self.planes.is_empty() {
            return None;
        }
        self.planes.binary_search_by_key(&id, |p| p.0).ok().map(|i| &self.planes[i].1)
    }

    /// Value and gradient of the carrier of patch `id`.
    pub fn value_gradient(&self, id: PatchId, p: &Point) -> (f64, Vector) {
        match self.plane(id) {
            Some(plane) => (plane.signed_distance(p), plane.normal),
            None => self.wall.value_gradient(p),
        }
    }

    /// Nearest-ish point of the carrier of `id` and the unit normal there.
    /// `None` where no point of it lies within `reach` of `p`.
    pub fn project(&self, id: PatchId, p: &Point, reach: f64) -> Option<(Point, Vector)> {
        match self.plane(id) {
            Some(plane) => Some((plane.project(p), plane.normal)),
            None => project_on(self.wall, p, reach),
        }
    }

    /// One Newton step towards the wall: the point, the unit gradient where it started and the step's length.
    /// `None` where the gradient vanishes or the step would exceed `reach`.
    #[inline]
    pub(crate) fn wall_step(&self, p: &Point, reach: f64) -> Option<(Point, Vector, f64)> {
        let (f, g) = self.wall.value_gradient(p);
        let gg = g.norm_squared();
        let step = f / gg.sqrt();
        if gg <= 0.0 || step.is_nan() || step.abs() > reach {
            return None;
        }
        Some((p - g * (f / gg), g / gg.sqrt(), step.abs()))
    }

    /// Point of the curve in which the carriers of `a` and `b` meet, found by minimum-norm Newton steps from `p`.
    /// A plane is met to rounding. The second value is the wall's unit normal there, where one of them is the wall.
    pub fn project_curve(&self, a: PatchId, b: PatchId, p: &Point, reach: f64) -> Option<(Point, Option<Vector>)> {
        let tolerance = TOLERANCE * self.wall.resolution();
        let mut x = *p;
        let mut best: Option<(f64, Point, Option<Vector>)> = None;
        for _ in 0..2 * NEWTON_STEPS {
            let (fa, ga) = self.value_gradient(a, &x);
            let (fb, gb) = self.value_gradient(b, &x);
            let (aa, bb, ab) = (ga.norm_squared(), gb.norm_squared(), ga.dot(&gb));
            let det = aa * bb - ab * ab;
            if !(det > 1e-8 * aa * bb) {
                break;
            }
            let wall_normal = match (self.plane(a), self.plane(b)) {
                (None, _) => Some(ga / aa.sqrt()),
                (_, None) => Some(gb / bb.sqrt()),
                _ => None,
            };
            let residual = (fa.abs() / aa.sqrt()).max(fb.abs() / bb.sqrt());
            if best.as_ref().is_none_or(|k| residual < k.0) {
                best = Some((residual, x, wall_normal));
            }
            if residual <= tolerance {
                break;
            }
            let mut step = ga * ((fb * ab - fa * bb) / det) + gb * ((fa * ab - fb * aa) / det);
            let n = step.norm();
            if n > 0.5 * reach {
                step *= 0.5 * reach / n;
            }
            x += step;
            if (x - p).norm() > reach {
                break;
            }
        }
        let (residual, mut x, normal) = best?;
        if residual > 1e3 * tolerance {
            return None;
        }
        for id in [a, b] {
            if let Some(plane) = self.plane(id) {
                x = plane.project(&x);
            }
        }
        Some((x, normal))
    }

    /// Point of the wall on the line in which the planes of two caps meet, near `p`; in both planes to rounding.
    /// `None` where the planes are parallel, one of the two lies on the wall, or there is no such point within `reach`.
    pub fn project_corner(&self, a: PatchId, b: PatchId, p: &Point, reach: f64) -> Option<Point> {
        let along = self.plane(a)?.normal.cross(&self.plane(b)?.normal).try_normalize(1e-6)?;
        let (start, _) = self.project_curve(a, b, p, reach)?;
        let tolerance = TOLERANCE * self.wall.resolution();
        let mut t = 0.0;
        for _ in 0..2 * NEWTON_STEPS {
            let (f, g) = self.wall.value_gradient(&(start + along * t));
            if f.abs() <= tolerance * g.norm() {
                return Some(start + along * t);
            }
            t -= f / g.dot(&along);
            if !(t.abs() <= reach) {
                return None;
            }
        }
        None
    }

    /// Distance of `p` from the carrier of `id`, to first order.
    pub fn distance(&self, id: PatchId, p: &Point) -> f64 {
        let (f, g) = self.value_gradient(id, p);
        f.abs() / g.norm()
    }
}

fn project_on(f: &dyn Implicit, p: &Point, reach: f64) -> Option<(Point, Vector)> {
    let tolerance = TOLERANCE * f.resolution();
    let mut x = *p;
    let mut last = f64::INFINITY;
    for _ in 0..NEWTON_STEPS {
        let (v, g) = f.value_gradient(&x);
        let n = g.norm();
        let step = v / n;
        if n <= 0.0 || !step.is_finite() {
            break;
        }
        if step.abs() <= tolerance {
            return Some((x, g / n));
        }
        if step.abs() >= 0.9 * last {
            break;
        }
        last = step.abs();
        x -= g * (step.clamp(-0.5 * reach, 0.5 * reach) / n);
        if (x - p).norm() > reach {
            break;
        }
    }
    bracket(f, p, reach, tolerance)
}

/// Walks along the gradient at `p` until the sign changes, then closes in (Illinois).
fn bracket(f: &dyn Implicit, p: &Point, reach: f64, tolerance: f64) -> Option<(Point, Vector)> {
    let (v0, g) = f.value_gradient(p);
    let direction = g.try_normalize(0.0)? * -v0.signum();
    if !direction.x.is_finite() {
        return None;
    }
    let step = (0.25 * f.resolution()).min(0.25 * reach);
    let (mut a, mut fa, mut b, mut fb) = (0.0, v0, 0.0, v0);
    while fb * v0 > 0.0 {
        (a, fa) = (b, fb);
        b += step;
        if b > reach {
            return None;
        }
        fb = f.value(&(p + direction * b));
    }
    for _ in 0..60 {
        if (b - a).abs() <= 0.5 * tolerance || fb == 0.0 {
            break;
        }
        let t = b - fb * (b - a) / (fb - fa);
        let ft = f.value(&(p + direction * t));
        if ft * fb < 0.0 {
            (a, fa) = (b, fb);
        } else {
            fa *= 0.5;
        }
        (b, fb) = (t, ft);
    }
    let x = p + direction * b;
    let n = f.gradient(&x).try_normalize(0.0)?;
    Some((x, n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::remesh::testing::Capsules;

    #[test]
    fn a_rim_point_lies_on_both_and_in_the_plane_to_rounding() {
        let f = Capsules::tube(2.0, 10.0);
        let plane = Plane::new(Point::new(0.3, 0.1, 1.0), Vector::new(0.3, -0.2, 1.0)).unwrap();
        let s = Supports::new(&f).with_plane(2, plane);
        let (p, n) = s.project_curve(1, 2, &Point::new(1.7, 0.4, 1.2), 1.0).unwrap();
        assert!(f.value(&p).abs() < 1e-9 && plane.signed_distance(&p).abs() < 1e-14);
        assert!((n.unwrap() - f.gradient(&p).normalize()).norm() < 1e-6);
        assert!(s.project_curve(1, 2, &Point::new(1.7, 0.4, 4.0), 1.0).is_none());
    }

    #[test]
    fn projection_reaches_the_wall_or_says_no() {
        let f = Capsules::tube(2.0, 10.0);
        let s = Supports::new(&f);
        let (p, n) = s.project(1, &Point::new(1.5, 0.5, 0.0), 1.0).unwrap();
        assert!(f.value(&p).abs() < 1e-9);
        assert!((n - Vector::new(p.x, p.y, 0.0).normalize()).norm() < 1e-9);
        assert!(s.project(1, &Point::new(9.0, 0.0, 0.0), 1.0).is_none());
    }
}
