//! Points, planes and boxes shared by every stage. Millimetres, LPS world coordinates.

use nalgebra::{Point3, Vector3};
use serde::Serialize;

/// A position in LPS world millimetres.
pub type Point = Point3<f64>;
/// A displacement or direction.
pub type Vector = Vector3<f64>;

/// An axis-aligned box; empty while `min > max`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Aabb {
    /// Smallest coordinates.
    pub min: Point,
    /// Largest coordinates.
    pub max: Point,
}

impl Aabb {
    /// The box that contains nothing.
    pub const EMPTY: Aabb = Aabb {
        min: Point::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        max: Point::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    /// The smallest box round `points`.
    pub fn of<'a>(points: impl IntoIterator<Item = &'a Point>) -> Aabb {
        let mut b = Aabb::EMPTY;
        for p in points {
            b.include(p);
        }
        b
    }

    /// Grows the box to contain `p`.
    pub fn include(&mut self, p: &Point) {
        self.min = self.min.inf(p);
        self.max = self.max.sup(p);
    }

    /// The box grown by `r` on every side.
    #[must_use]
    pub fn inflated(&self, r: f64) -> Aabb {
        let v = Vector::repeat(r);
        Aabb { min: self.min - v, max: self.max + v }
    }

    /// The smallest box round both.
    #[must_use]
    pub fn union(&self, o: &Aabb) -> Aabb {
        Aabb { min: self.min.inf(&o.min), max: self.max.sup(&o.max) }
    }

    /// Whether the two boxes share a point.
    pub fn intersects(&self, o: &Aabb) -> bool {
        (0..3).all(|i| self.min[i] <= o.max[i] && o.min[i] <= self.max[i])
    }

    /// Squared distance from `p` to the box, 0 inside.
    pub fn squared_distance(&self, p: &Point) -> f64 {
        (0..3).map(|i| (self.min[i] - p[i]).max(p[i] - self.max[i]).max(0.0).powi(2)).sum()
    }

    /// Middle of the box.
    pub fn center(&self) -> Point {
        nalgebra::center(&self.min, &self.max)
    }

    /// Length of the diagonal; 0 for an empty box.
    pub fn diagonal(&self) -> f64 {
        if self.min.x > self.max.x { 0.0 } else { (self.max - self.min).norm() }
    }
}

/// A plane through `origin` with unit `normal`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Plane {
    /// A point on the plane.
    pub origin: Point,
    /// Unit normal; out of the vessel where the plane cuts one.
    pub normal: Vector,
}

impl Plane {
    /// The plane through `origin` across `normal` (normalised here); `None` where the normal has no direction.
    pub fn new(origin: Point, normal: Vector) -> Option<Plane> {
        let n = normal.norm();
        (n.is_finite() && n > 0.0).then(|| Plane { origin, normal: normal / n })
    }

    /// Signed distance, positive on the normal's side.
    pub fn signed_distance(&self, p: &Point) -> f64 {
        self.normal.dot(&(p - self.origin))
    }

    /// The nearest point of the plane.
    pub fn project(&self, p: &Point) -> Point {
        p - self.normal * self.signed_distance(p)
    }

    /// Two unit vectors that span the plane; `(u, v, normal)` is right-handed. A pure function of the normal.
    pub fn basis(&self) -> (Vector, Vector) {
        let n = self.normal;
        let a = n.abs();
        let e = if a.x <= a.y && a.x <= a.z {
            Vector::x()
        } else if a.y <= a.z {
            Vector::y()
        } else {
            Vector::z()
        };
        let u = e.cross(&n).normalize();
        (u, n.cross(&u))
    }
}
