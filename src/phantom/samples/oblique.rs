//! Tubes and divisions cut at a slant, at coarse and fine voxels.

use std::f64::consts::TAU;

use super::draft::{Cap, Draft, Frame};
use super::splits::leaning;
use crate::geometry::{Point, Vector};
use crate::phantom::Random;
use crate::phantom::solid::{Body, Cut, Piece, Solid};

pub(super) fn draft(random: &mut Random) -> Option<Draft> {
    let edge = [0.5, 0.25, 0.125][random.below(3)];
    let spacing = [edge; 3];
    let r = 2.0;
    let axis = random.direction();
    let forks = random.below(2) == 0;
    let (start, end) = (Point::origin(), Point::origin() + axis * (random.uniform(3.5, 6.0) * r));
    let mut ends = vec![(end, start, r, 0.0)];
    if forks {
        let azimuth = random.uniform(0.0, TAU);
        for (n, radius) in [random.uniform(1.3, 1.8), random.uniform(1.0, 1.6)].into_iter().enumerate() {
            let direction = leaning(&axis, random.uniform(0.4, 0.7), azimuth + 0.5 * TAU * n as f64);
            let tilt = random.uniform(15.0, 45.0f64);
            ends.push((end, end + direction * (random.uniform(4.0, 6.0) * r), radius, tilt));
        }
    } else {
        ends.push((start, end, r, random.uniform(15.0, 45.0)));
    }
    let (mut pieces, mut caps) = (Vec::new(), Vec::new());
    for (from, to, radius, tilt) in ends {
        let outward = (to - from).normalize();
        let normal = leaning(&outward, tilt.to_radians(), random.uniform(0.0, TAU));
        let cap = Cap::flat(to, normal, outward, radius, if tilt == 0.0 { "square" } else { "oblique" })?;
        let cut = Cut { plane: cap.plane, reach: f64::INFINITY };
        // Halves that meet: each end's cut takes off its own end only.
        let middle = if forks { from } else { from + (to - from) * 0.45 };
        pieces.push(Piece::new(vec![Body::tube(middle, to + outward * (3.0 * radius), radius)], vec![cut]));
        caps.push(cap);
    }
    let all = caps.iter().map(|c| c.plane.origin.coords);
    let (low, high) = all.fold((Vector::repeat(f64::INFINITY), Vector::repeat(f64::NEG_INFINITY)), |(l, h), p| (l.inf(&p), h.sup(&p)));
    let margin = Vector::repeat(2.2 * r + 3.0 * edge);
    Some(Draft {
        description: format!("{} with ends cut at a slant, voxels of {edge} mm", if forks { "a division" } else { "a tube" }),
        solid: Solid { pieces },
        frame: Frame::new(low - margin, high + margin, spacing),
        caps,
        closed: Vec::new(),
        turns: true,
        beside: false,
    })
}
