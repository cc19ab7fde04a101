//! Flat ends that are not round: a plane cuts a T or a fork where it is still one.

use std::f64::consts::TAU;

use super::draft::{Cap, Draft, Frame};
use super::splits::leaning;
use crate::geometry::{Point, Vector};
use crate::phantom::Random;
use crate::phantom::solid::{Body, Cut, Piece, Solid};

pub(super) fn draft(random: &mut Random) -> Option<Draft> {
    let r = random.uniform(1.5, 8.0);
    let edge = r / random.uniform(5.0, 9.0);
    let spacing = [edge, edge, edge * [1.0, 1.0, 1.5][random.below(3)]];
    let coarse = spacing[2];
    let axis = random.direction();
    let side = leaning(&axis, std::f64::consts::FRAC_PI_2, random.uniform(0.0, TAU));
    let length = random.uniform(6.0, 12.0) * r;
    let (start, end) = (Point::origin(), Point::origin() + axis * length);
    let mut bodies = vec![Body::tube(start - axis * (2.0 * r), end, r)];
    let (kind, height, wide) = if random.below(2) == 0 {
        let bar = r * random.uniform(0.7, 1.0);
        let half = random.uniform(1.0, 2.2) * r;
        bodies.push(Body::tube(end - side * half, end + side * half, bar));
        ("a T cut flat", random.uniform(-0.4, 0.4) * bar, half + bar)
    } else {
        let radius = r * random.uniform(0.65, 0.85);
        let angle = random.uniform(0.35, 0.7f64);
        for sign in [-1.0, 1.0] {
            let direction = axis * angle.cos() + side * (sign * angle.sin());
            bodies.push(Body::tube(end, end + direction * (4.0 * r), radius));
        }
        // Where the axes are apart by less than their sections are wide: one face.
        let height = random.uniform(0.4, 0.85) * radius / angle.sin();
        ("a fork cut flat", height, height * angle.tan() + 1.5 * radius)
    };
    let face = end + axis * height;
    let last = Cap { reach: 2.0 * wide, ..Cap::flat(face, axis, axis, r, kind)?.measured() };
    let normal = leaning(&-axis, random.uniform(0.0, 0.5), random.uniform(0.0, TAU));
    let first = Cap::flat(start, normal, -axis, r, "trunk")?;
    let cuts = [first.plane, last.plane].map(|plane| Cut { plane, reach: f64::INFINITY }).to_vec();
    let reach = Vector::repeat(wide.max(2.0 * r) + 3.0 * coarse);
    let (low, high) = (start.coords.inf(&face.coords) - reach, start.coords.sup(&face.coords) + reach);
    Some(Draft {
        description: format!("{kind}: one face, one end"),
        solid: Solid { pieces: vec![Piece::new(bodies, cuts)] },
        frame: Frame::new(low, high, spacing),
        caps: vec![first, last],
        closed: Vec::new(),
        turns: true,
        beside: false,
    })
}
