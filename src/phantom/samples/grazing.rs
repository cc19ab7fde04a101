//! Vessels that the image border, or a flat cut, grazes lengthwise.

use std::f64::consts::{PI, TAU};

use super::ClosedEnd;
use super::draft::{Cap, Draft, Frame};
use super::splits::leaning;
use crate::geometry::{Plane, Point, Vector};
use crate::phantom::solid::{Body, Cut, Piece, Solid, plane_section};
use crate::phantom::{Random, Shape};

/// Reach of the cut at an end, in radii: past the round piece that it takes off, not as far as the other leg.
const END_CUT: f64 = 2.7;

/// How an end is made.
#[derive(Clone, Copy, PartialEq)]
enum Finish {
    Border,
    Flat,
    Round,
}

/// A vessel and where its axis ends.
struct Course {
    what: &'static str,
    bodies: Vec<Body>,
    /// Ends of the axis with the direction out of the vessel.
    tips: [(Point, Vector); 2],
    /// A point of the axis nearest to the face.
    nearest: Point,
    /// How the ends are made; those at the border leave the image along `leaves`.
    finish: Finish,
    leaves: Vector,
    /// Reason why the side stays closed.
    reason: &'static str,
}

/// The face lies at x = 0; the vessel's axis comes as near to it as 1 to -0.2 radii.
pub(super) fn draft(random: &mut Random) -> Option<Draft> {
    let r = random.uniform(1.5, 9.0);
    let edge = r / random.uniform(4.5, 8.0);
    let spacing = [edge, edge, edge * [1.0, 1.0, 1.0, 1.5, 2.0][random.below(5)]];
    let coarse = spacing[2];
    let kind = random.below(4);
    // The part of the radius that lies beyond the face; an aorta cropped lengthwise loses a half or a third.
    let depth = if kind == 3 { [0.67, 1.0, 1.0, 1.2][random.below(4)] } else { random.uniform(0.0, 1.2) };
    let near = r * (1.0 - depth);
    let course = match kind {
        0 => straight(random, r, near),
        1 => bowed(random, r, near),
        2 => bend(random, r, near),
        _ => arch(random, r, near),
    };
    // A crop box lies within the image now and then: background goes on behind the flat side.
    let within = kind == 3 && random.below(2) == 0;
    let face = Plane { origin: Point::origin(), normal: -Vector::x() };
    let mut cuts = Vec::new();
    if within {
        cuts.push(Cut { plane: face, reach: f64::INFINITY });
    }
    let mut low = Vector::new(if within { -3.0 * coarse } else { 0.0 }, f64::INFINITY, f64::INFINITY);
    let mut high = Vector::repeat(f64::NEG_INFINITY);
    let reach = |b: &Body| match b {
        Body::Round(s) => [Vector::x(), Vector::y(), Vector::z()].map(|e| s.extent(&e)),
        _ => [[0.0; 2]; 3],
    };
    for body in &course.bodies {
        let e = reach(body);
        for a in 0..3 {
            low[a] = if a == 0 { low[a] } else { low[a].min(e[a][0] - 3.0 * coarse) };
            high[a] = f64::max(high[a], e[a][1] + 3.0 * coarse);
        }
    }
    let mut bodies = course.bodies.clone();
    let mut caps = Vec::new();
    for (at, outward) in course.tips {
        let mut own = Vec::new();
        let cap = match course.finish {
            Finish::Round => Cap::round(at, outward, r, course.what)?,
            Finish::Flat => {
                let normal = leaning(&outward, random.uniform(0.0, 0.35), random.uniform(0.0, TAU));
                let cap = Cap::flat(at, normal, outward, r, course.what)?.measured();
                own.push(Cut { plane: cap.plane, reach: END_CUT * r });
                cap
            }
            Finish::Border => Cap::border(at, course.leaves * outward.dot(&course.leaves).signum(), outward, r, course.what)?.measured(),
        };
        match course.finish {
            Finish::Round => {}
            Finish::Flat => bodies.push(Body::tube(at, at + outward * r, r)),
            Finish::Border => bodies.push(Body::tube(at, at + outward * (4.0 * r), r)),
        }
        cuts.extend(own);
        caps.push(cap);
    }
    let mut frame = Frame::new(low, high, spacing);
    if course.finish == Finish::Border {
        frame = bordered(frame, &mut caps, spacing);
    }
    let solid = Solid { pieces: vec![Piece::new(bodies, cuts)] };
    let mut draft = Draft {
        description: format!("{} of radius {r:.2} mm, {depth:.2} radii of it beyond a face", course.what),
        solid,
        frame,
        caps,
        closed: Vec::new(),
        turns: true,
        beside: false,
    };
    let side = Plane { origin: Point::new(1e-6, course.nearest.y, course.nearest.z), normal: -Vector::x() };
    let wide = (frame.high - frame.low).norm();
    if let Some(found) = plane_section(|p| draft.holds(p), &side, [wide, r, r / 40.0]) {
        draft.closed.push(ClosedEnd { at: found.centroid, area: Some(found.area), reason: course.reason });
    }
    Some(draft)
}

/// The frame that ends where the caps lie, and the caps at its faces.
fn bordered(frame: Frame, caps: &mut [Cap], spacing: [f64; 3]) -> Frame {
    let (mut low, mut high) = (frame.low, frame.high);
    for cap in caps.iter() {
        let a = cap.plane.normal.iamax();
        let x = cap.plane.origin[a];
        if cap.plane.normal[a] > 0.0 {
            high[a] = x;
        } else {
            low[a] = x;
        }
    }
    let frame = Frame::new(low, high, spacing);
    for cap in caps {
        let a = cap.plane.normal.iamax();
        let wall = if cap.plane.normal[a] > 0.0 { frame.high[a] } else { frame.low[a] };
        cap.plane.origin += cap.axis * ((wall - cap.plane.origin[a]) / cap.axis[a]);
    }
    frame
}

fn finish(random: &mut Random) -> Finish {
    [Finish::Border, Finish::Flat][random.below(2)]
}

/// Along z, nearly parallel to the face.
fn straight(random: &mut Random, r: f64, near: f64) -> Course {
    let axis = Vector::new(random.uniform(-0.04, 0.04), random.uniform(-0.15, 0.15), 1.0).normalize();
    let half = random.uniform(5.0, 8.0) * r;
    let middle = Point::new(near, 0.0, 0.0);
    let (a, b) = (middle - axis * half, middle + axis * half);
    Course {
        what: "a straight vessel along a face",
        bodies: vec![Body::tube(a, b, r)],
        tips: [(a, -axis), (b, axis)],
        nearest: middle,
        finish: finish(random),
        leaves: Vector::z(),
        reason: "grazes the border lengthwise",
    }
}

/// A bow that comes near to the face in its middle.
fn bowed(random: &mut Random, r: f64, near: f64) -> Course {
    const PIECES: usize = 24;
    let half = random.uniform(6.0, 9.0) * r;
    let away = random.uniform(1.7, 3.2) * r;
    let at = |n: usize| {
        let t = 2.0 * n as f64 / PIECES as f64 - 1.0;
        Point::new(near + away * t * t, 0.0, half * t)
    };
    let points: Vec<Point> = (0..=PIECES).map(at).collect();
    let slope = Vector::new(2.0 * away / half, 0.0, 1.0).normalize();
    Course {
        what: "a bowed vessel that grazes a face",
        bodies: points.windows(2).map(|p| Body::tube(p[0], p[1], r)).collect(),
        tips: [(points[0], Vector::new(slope.x, 0.0, -slope.z)), (points[PIECES], slope)],
        nearest: points[PIECES / 2],
        finish: [Finish::Border, Finish::Flat, Finish::Round][random.below(3)],
        leaves: Vector::z(),
        reason: "grazes the border lengthwise",
    }
}

/// A hairpin whose bend touches the face.
fn bend(random: &mut Random, r: f64, near: f64) -> Course {
    let major = random.uniform(1.7, 3.5) * r;
    let leg = random.uniform(2.5, 6.0) * r;
    let center = Point::new(near + major, 0.0, 0.0);
    let (u, v) = (Vector::z(), -Vector::x());
    let (a, b) = (center + u * major, center - u * major);
    let (a1, b1) = (a + Vector::x() * leg, b + Vector::x() * leg);
    Course {
        what: "a hairpin whose bend grazes a face",
        bodies: vec![
            Body::Round(Shape::TorusArc { center, u, v, major, angle: PI, radius: r }),
            Body::tube(a, a1, r),
            Body::tube(b, b1, r),
        ],
        tips: [(a1, Vector::x()), (b1, Vector::x())],
        nearest: Point::new(near, 0.0, 0.0),
        finish: [Finish::Border, Finish::Flat, Finish::Round][random.below(3)],
        leaves: Vector::x(),
        reason: "grazes the border lengthwise",
    }
}

/// An arch parallel to the face, cropped along its whole length.
fn arch(random: &mut Random, r: f64, near: f64) -> Course {
    let major = random.uniform(2.2, 4.0) * r;
    let center = Point::new(near, 0.0, 0.0);
    let (u, v) = (Vector::y(), Vector::z());
    let (a, b) = (center + u * major, center - u * major);
    let finish = finish(random);
    let long = random.uniform(2.0, 8.0) * r;
    let short = if finish == Finish::Border { long } else { random.uniform(1.5, 4.0) * r };
    let (a1, b1) = (a - v * long, b - v * short);
    Course {
        what: "an arch cropped lengthwise",
        bodies: vec![
            Body::Round(Shape::TorusArc { center, u, v, major, angle: PI, radius: r }),
            Body::tube(a, a1, r),
            Body::tube(b, b1, r),
        ],
        tips: [(a1, -v), (b1, -v)],
        nearest: center + v * major,
        finish,
        leaves: v,
        reason: "cropped lengthwise",
    }
}
