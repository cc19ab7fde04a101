//! Analytic vessels: primitives joined by unions, smooth where they have a blend.
//!
//! The blend is the polynomial smooth minimum: min(a, b) − h² k / 4 with h = max(k − |a − b|, 0) / k.

use std::f64::consts::TAU;

use serde_json::{Map, Value, json};

use crate::geometry::{Aabb, Point, Vector};
use crate::implicit::Implicit;

/// Cosine of the largest angle between two pieces of one bent vessel, 16 degrees.
const PIECES_OF_ONE: f64 = 0.96;

/// A solid with a simple signed distance.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A ball.
    Sphere {
        /// Centre, mm.
        center: Point,
        /// Radius, mm.
        radius: f64,
    },
    /// A straight vessel without end.
    Cylinder {
        /// A point on the axis, mm.
        point: Point,
        /// Unit direction of the axis.
        direction: Vector,
        /// Radius, mm.
        radius: f64,
    },
    /// A straight vessel with round ends; the radius goes linearly from `radii[0]` at `a` to `radii[1]` at `b`.
    /// Its value is a distance where the radii are equal; its zero set is exact always.
    Capsule {
        /// First end of the axis, mm.
        a: Point,
        /// Last end of the axis, mm.
        b: Point,
        /// Radii at the ends, mm.
        radii: [f64; 2],
    },
    /// A vessel bent round a circle of radius `major` in the plane of the unit vectors `u` and `v`, with round ends.
    TorusArc {
        /// Centre of the bend, mm.
        center: Point,
        /// Unit vector from the centre to the arc's beginning.
        u: Vector,
        /// Unit vector square to `u`: where the arc goes.
        v: Vector,
        /// Radius of the bend, mm.
        major: f64,
        /// Angle of the arc, rad; 2π closes the ring.
        angle: f64,
        /// Radius of the vessel, mm.
        radius: f64,
    },
}

impl Shape {
    /// Value and gradient at a point.
    pub(super) fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let away = |d: Vector, r: f64| {
            let n = d.norm();
            (n - r, if n > 0.0 { d / n } else { Vector::x() })
        };
        match self {
            Shape::Sphere { center, radius } => away(p - center, *radius),
            Shape::Cylinder { point, direction, radius } => {
                let w = p - point;
                away(w - direction * w.dot(direction), *radius)
            }
            Shape::Capsule { a, b, radii: [r0, r1] } => {
                let axis = b - a;
                let t = (p - a).dot(&axis) / axis.norm_squared();
                let h = t.clamp(0.0, 1.0);
                let (d, mut g) = away(p - a - axis * h, r0 + h * (r1 - r0));
                if t == h {
                    g -= axis * ((r1 - r0) / axis.norm_squared());
                }
                (d, g)
            }
            Shape::TorusArc { center, u, v, major, angle, radius } => {
                let w = p - center;
                let (x, y) = (w.dot(u), w.dot(v));
                let mut turn = y.atan2(x);
                if turn < -1e-9 {
                    turn += TAU;
                }
                if turn <= *angle {
                    let flat = u * x + v * y;
                    let n = flat.norm();
                    let outward = if n > 0.0 { flat / n } else { *u };
                    away(w - outward * *major, *radius)
                } else {
                    let end = |s: f64| w - (u * s.cos() + v * s.sin()) * *major;
                    let (first, last) = (end(0.0), end(*angle));
                    away(if first.norm() <= last.norm() { first } else { last }, *radius)
                }
            }
        }
    }

    /// Smallest and largest coordinate along a unit direction.
    pub(super) fn extent(&self, e: &Vector) -> [f64; 2] {
        match self {
            Shape::Sphere { center, radius } => around(center.coords.dot(e), *radius),
            Shape::Cylinder { point, direction, radius } => {
                let across = e.dot(direction).abs() < 1e-12;
                if across { around(point.coords.dot(e), *radius) } else { [f64::NEG_INFINITY, f64::INFINITY] }
            }
            Shape::Capsule { a, b, radii } => {
                let ([a0, a1], [b0, b1]) = (around(a.coords.dot(e), radii[0]), around(b.coords.dot(e), radii[1]));
                [a0.min(b0), a1.max(b1)]
            }
            Shape::TorusArc { center, u, v, major, angle, radius } => {
                let (x, y) = (e.dot(u), e.dot(v));
                let mut low = x.min(x * angle.cos() + y * angle.sin());
                let mut high = x.max(x * angle.cos() + y * angle.sin());
                // The extremes of x cos t + y sin t lie at the direction of (x, y) and opposite to it.
                for half in [0.0, std::f64::consts::PI] {
                    let t = (y.atan2(x) + half).rem_euclid(TAU);
                    if t <= *angle {
                        low = low.min(x * t.cos() + y * t.sin());
                        high = high.max(x * t.cos() + y * t.sin());
                    }
                }
                let c = center.coords.dot(e);
                [c + major * low - radius, c + major * high + radius]
            }
        }
    }

    /// The place on the shape's axis nearest to `p` and whether it lies between the axis' ends; a ball has no axis.
    fn axis(&self, p: &Point) -> Option<(Axis, bool)> {
        match self {
            Shape::Sphere { .. } => None,
            Shape::Cylinder { point, direction, radius } => {
                Some((Axis { point: point + direction * (p - point).dot(direction), direction: *direction, radius: *radius }, true))
            }
            Shape::Capsule { a, b, radii } => {
                let axis = b - a;
                let t = (p - a).dot(&axis) / axis.norm_squared();
                let h = t.clamp(0.0, 1.0);
                Some((Axis { point: a + axis * h, direction: axis.normalize(), radius: radii[0] + h * (radii[1] - radii[0]) }, t == h))
            }
            Shape::TorusArc { center, u, v, major, angle, radius } => {
                let w = p - center;
                let turn = w.dot(v).atan2(w.dot(u)).rem_euclid(TAU);
                let nearest = if turn <= *angle {
                    turn
                } else if turn - angle < TAU - turn {
                    *angle
                } else {
                    0.0
                };
                let (s, c) = nearest.sin_cos();
                Some((Axis { point: center + (u * c + v * s) * *major, direction: v * c - u * s, radius: *radius }, turn <= *angle))
            }
        }
    }

    fn json(&self) -> Map<String, Value> {
        let point = |p: &Point| json!([p.x, p.y, p.z]);
        let vector = |v: &Vector| json!([v.x, v.y, v.z]);
        let value = match self {
            Shape::Sphere { center, radius } => json!({"type": "sphere", "c": point(center), "radius": radius}),
            Shape::Cylinder { point: p, direction, radius } => {
                json!({"type": "cylinder", "p": point(p), "dir": vector(direction), "radius": radius})
            }
            Shape::Capsule { a, b, radii } => {
                json!({"type": "capsule", "a": point(a), "b": point(b), "radius": radii[0], "radius2": radii[1]})
            }
            Shape::TorusArc { center, u, v, major, angle, radius } => {
                json!({"type": "torus_arc", "c": point(center), "u": vector(u), "v": vector(v), "R": major, "angle": angle, "radius": radius})
            }
        };
        value.as_object().cloned().unwrap_or_default()
    }
}

fn around(c: f64, r: f64) -> [f64; 2] {
    [c - r, c + r]
}

/// A place on the axis of a phantom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// The place, mm.
    pub point: Point,
    /// Unit direction of the axis, of either sign.
    pub direction: Vector,
    /// Radius of the vessel there, mm.
    pub radius: f64,
}

/// A shape and how it is joined to those before it.
#[derive(Debug, Clone, PartialEq)]
pub struct Primitive {
    /// The solid.
    pub shape: Shape,
    /// Width of the blend with what stands before it, mm; 0 joins sharply.
    pub blend: f64,
}

/// An analytic vessel: the exact wall of a phantom.
///
/// The value is negative inside; the zero set is exact. It is a distance for a single primitive of constant radius and,
/// outside, for sharp unions of those; elsewhere it is close to one near the wall.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The primitives, in the order in which they are joined.
    pub primitives: Vec<Primitive>,
}

impl Truth {
    /// The `prims` list that describes the vessel to other programs.
    pub fn json(&self) -> Value {
        let one = |p: &Primitive| {
            let mut map = p.shape.json();
            if p.blend > 0.0 {
                map.insert("k".into(), json!(p.blend));
            }
            Value::Object(map)
        };
        Value::Array(self.primitives.iter().map(one).collect())
    }

    /// The axis of the vessel that holds `p`, at its place nearest to `p`: `None` where `p` lies in a sac, in several
    /// vessels or their blend, where no single axis is the true one, beyond the end of an axis, and outside.
    pub fn axis(&self, p: &Point) -> Option<Axis> {
        let blend = self.primitives.iter().map(|p| p.blend).fold(0.0, f64::max);
        let near: Vec<&Shape> = self.primitives.iter().map(|p| &p.shape).filter(|s| s.value_gradient(p).0 <= blend).collect();
        let axes: Vec<(Axis, bool)> = near.iter().map(|s| s.axis(p)).collect::<Option<_>>()?;
        let away = |a: &Axis| (a.point - p).norm() / a.radius;
        let (best, _) = axes.iter().filter(|a| a.1).min_by(|a, b| away(&a.0).total_cmp(&away(&b.0)))?;
        // Pieces of one vessel go on in one direction; those of several do not.
        let one = axes.iter().all(|(a, _)| a.direction.dot(&best.direction).abs() > PIECES_OF_ONE);
        (one && away(best) <= 1.0).then_some(*best)
    }

    /// Smallest and largest coordinate along a unit direction; infinite for endless vessels. Blends bulge by at most
    /// a quarter of their width, which is included.
    pub fn extent(&self, e: &Vector) -> [f64; 2] {
        let bulge = self.primitives.iter().map(|p| p.blend / 4.0).fold(0.0, f64::max);
        let join = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        let [low, high] = self.primitives.iter().map(|p| p.shape.extent(e)).fold([f64::INFINITY, f64::NEG_INFINITY], join);
        [low - bulge, high + bulge]
    }
}

impl Implicit for Truth {
    fn value(&self, p: &Point) -> f64 {
        self.value_gradient(p).0
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let mut joined = (f64::INFINITY, Vector::x());
        for primitive in &self.primitives {
            let (d, g) = primitive.shape.value_gradient(p);
            let k = primitive.blend;
            let (low, high) = if d < joined.0 { ((d, g), joined) } else { (joined, (d, g)) };
            let h = if k > 0.0 { (k - (high.0 - low.0)).max(0.0) / k } else { 0.0 };
            joined = if h > 0.0 { (low.0 - h * h * k / 4.0, low.1 * (1.0 - h / 2.0) + high.1 * (h / 2.0)) } else { low };
        }
        joined
    }

    fn bounds(&self) -> Aabb {
        let e = [Vector::x(), Vector::y(), Vector::z()].map(|e| self.extent(&e));
        Aabb { min: Point::new(e[0][0], e[1][0], e[2][0]), max: Point::new(e[0][1], e[1][1], e[2][1]) }
    }

    fn resolution(&self) -> f64 {
        let radius = |s: &Shape| match s {
            Shape::Sphere { radius, .. } | Shape::Cylinder { radius, .. } | Shape::TorusArc { radius, .. } => *radius,
            Shape::Capsule { radii, .. } => radii[0].min(radii[1]),
        };
        0.1 * self.primitives.iter().map(|p| radius(&p.shape)).fold(f64::INFINITY, f64::min)
    }
}
