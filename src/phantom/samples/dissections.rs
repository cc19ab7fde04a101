//! A flap of a few voxels parts the lumen in two, near one end, both, or along the whole vessel.

use std::f64::consts::TAU;

use nalgebra::Matrix3;

use super::draft::{Cap, Draft, Frame};
use super::splits::leaning;
use crate::geometry::{Plane, Point, Vector};
use crate::phantom::Random;
use crate::phantom::solid::{Body, Cut, Piece, Solid};

/// A straight vessel along `axis` from `low` to `high` mm, and the flap across `u` at `offset` mm.
struct Vessel {
    axis: Vector,
    u: Vector,
    r: f64,
    offset: f64,
    thickness: f64,
}

impl Vessel {
    fn at(&self, t: f64) -> Point {
        Point::origin() + self.axis * t
    }

    fn flap(&self, from: f64, to: f64) -> Piece {
        let axes = Matrix3::from_columns(&[self.u, self.axis.cross(&self.u), self.axis]);
        let center = self.at(0.5 * (from + to)) + self.u * self.offset;
        let half = Vector::new(0.5 * self.thickness, 2.0 * self.r, 0.5 * (to - from));
        Piece { carves: true, ..Piece::new(vec![Body::Block { center, axes, half }], Vec::new()) }
    }

    /// The two lumens, or the one, that a flat end shows.
    fn caps(&self, cap: &Cap, parted: bool) -> Vec<Cap> {
        if !parted {
            return vec![cap.clone()];
        }
        let side = |sign: f64| {
            // Halfway between the flap and the wall, in the plane of the end along the axis.
            let middle = 0.5 * (self.offset + sign * (0.5 * self.thickness + self.r));
            let p = cap.plane.origin + self.u * middle;
            let slide = cap.plane.signed_distance(&p) / cap.plane.normal.dot(&self.axis);
            let plane = Plane { origin: p - self.axis * slide, normal: cap.plane.normal };
            Cap { plane, reach: 3.0 * self.r, kind: "one lumen of two", ..cap.clone() }.measured()
        };
        vec![side(1.0), side(-1.0)]
    }
}

pub(super) fn draft(random: &mut Random) -> Option<Draft> {
    let r = random.uniform(2.0, 13.0);
    let edge = r / random.uniform(7.0, 12.0);
    let spacing = [edge, edge, edge * [1.0, 1.0, 1.4][random.below(3)]];
    let coarse = spacing[2];
    let axis = leaning(&Vector::z(), random.uniform(0.0, 0.25), random.uniform(0.0, TAU));
    let u = leaning(&axis, std::f64::consts::FRAC_PI_2, random.uniform(0.0, TAU));
    let thickness = random.uniform(1.6, 2.6) * coarse;
    let offset = random.uniform(-0.45, 0.45) * r;
    if r - offset.abs() - 0.5 * thickness < 4.0 * coarse {
        return None;
    }
    let vessel = Vessel { axis, u, r, offset, thickness };
    let length = random.uniform(9.0, 15.0) * r;
    // Which ends the flap reaches; where it does not, how far it stays away.
    let (reaches, what) = match random.below(4) {
        0 | 1 => ([false, false], "a flap in the middle"),
        2 => ([true, false], "a flap that reaches one end"),
        _ => ([true, true], "a flap along the whole vessel with two tears"),
    };
    let border = random.below(2) == 0;
    // A slanted end comes nearer to the flap than its middle.
    let least = if border { 0.2 } else { 0.6 };
    let gap = |random: &mut Random| random.uniform(least, 3.5) * r;
    let (first, last) = (gap(random), gap(random));
    let (from, to) = (if reaches[0] { -5.0 * r } else { first }, length + if reaches[1] { 5.0 * r } else { -last });
    let mut flaps = Vec::new();
    if reaches == [true, true] {
        let tear = random.uniform(1.0, 1.8) * r;
        let (t0, t1) = (length * random.uniform(0.2, 0.35), length * random.uniform(0.6, 0.75));
        flaps.extend([vessel.flap(from, t0), vessel.flap(t0 + tear, t1), vessel.flap(t1 + tear, to)]);
    } else {
        flaps.push(vessel.flap(from, to));
    }
    let top = if border { (length * axis.z / coarse).ceil() * coarse } else { length * axis.z };
    let (bottom, upper) = (vessel.at(0.0), vessel.at(top / axis.z));
    let (mut caps, mut cuts) = (Vec::new(), Vec::new());
    for (n, (at, outward)) in [(bottom, -axis), (upper, axis)].into_iter().enumerate() {
        let cap = if border {
            Cap::border(at, Vector::z() * if n == 0 { -1.0 } else { 1.0 }, outward, r, "aorta")?
        } else {
            let normal = leaning(&outward, random.uniform(0.0, 0.4), random.uniform(0.0, TAU));
            let cap = Cap::flat(at, normal, outward, r, "aorta")?;
            cuts.push(Cut { plane: cap.plane, reach: f64::INFINITY });
            cap
        };
        caps.extend(vessel.caps(&cap, reaches[n]));
    }
    let mut pieces = vec![Piece::new(vec![Body::tube(bottom - axis * (3.0 * r), upper + axis * (3.0 * r), r)], cuts)];
    pieces.extend(flaps);
    let wide = bottom.coords.abs().sup(&upper.coords.abs()) + Vector::repeat(1.5 * r + 3.0 * coarse);
    let (low, high) = if border { (0.0, top) } else { (-1.0 * r - 3.0 * coarse, top + r + 3.0 * coarse) };
    Some(Draft {
        description: format!("{what} of a vessel of radius {r:.2} mm"),
        solid: Solid { pieces },
        frame: Frame::new(Vector::new(-wide.x, -wide.y, low), Vector::new(wide.x, wide.y, high), spacing),
        caps,
        closed: Vec::new(),
        turns: true,
        beside: true,
    })
}
