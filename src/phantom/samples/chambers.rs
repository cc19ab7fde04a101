//! Heart chambers: an ellipsoid with wide valves on short stubs that are cut flat.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Rotation3};

use super::draft::{Cap, Draft, Frame};
use super::splits::leaning;
use crate::geometry::{Plane, Point, Vector};
use crate::phantom::Random;
use crate::phantom::solid::{Body, Cut, Piece, Solid};

/// Trials to place a valve beside the others.
const TRIALS: usize = 60;

/// Where the ray from the middle along `d` leaves the ellipsoid, and the outward normal there.
fn leaves(axes: &Matrix3<f64>, semi: &Vector, d: &Vector) -> (f64, Vector) {
    let local = axes.transpose() * d;
    let t = 1.0 / local.component_div(semi).norm();
    (t, (axes * local.component_div(&semi.component_mul(semi))).normalize())
}

/// Two to six valves; in every third chamber one of them is a wide cut through the ellipsoid itself.
pub(super) fn draft(random: &mut Random) -> Option<Draft> {
    let longest = random.uniform(15.0, 28.0);
    let semi = Vector::new(longest, longest * random.uniform(0.6, 1.0), longest * random.uniform(0.55, 0.95));
    let axes = Rotation3::from_euler_angles(random.uniform(0.0, TAU), random.uniform(-1.5, 1.5), random.uniform(0.0, TAU)).into_inner();
    let edge = random.uniform(0.6, 1.2);
    let spacing = [edge, edge, edge * [1.0, 1.0, 1.3, 1.8][random.below(4)]];
    let coarse = spacing[2];
    let center = Point::origin();
    let count = 2 + random.below(5);
    let mut caps: Vec<Cap> = Vec::new();
    let mut chamber = Piece::new(vec![Body::Ellipsoid { center, axes, semi }], Vec::new());
    let mut stubs = Vec::new();
    // Directions taken and the half angle that each takes, rad.
    let mut taken: Vec<(Vector, f64)> = Vec::new();
    if random.below(3) == 0 {
        let direction = random.direction();
        let (t, _) = leaves(&axes, &semi, &direction);
        let share = random.uniform(0.45, 0.85);
        let cap = Cap::flat(center + direction * (t * share), direction, direction, longest, "a cut through the chamber")?;
        chamber.cuts.push(Cut { plane: cap.plane, reach: f64::INFINITY });
        // The measured face lies round the ellipsoid's section, not round the ray.
        caps.push(Cap { reach: 1.5 * longest, ..cap.measured() });
        // The section of a ball at that share of its radius.
        taken.push((direction, share.acos() + 0.1));
    }
    while caps.len() < count {
        let found = (0..TRIALS).find_map(|_| {
            let direction = random.direction();
            let (t, normal) = leaves(&axes, &semi, &direction);
            let radius = random.uniform(0.2, 0.45) * semi.min();
            let half = (radius / t).atan();
            let free = radius > 3.0 * coarse && taken.iter().all(|(d, h)| d.angle(&direction) > h + half + 3.0 * coarse / t);
            free.then_some((direction, t, normal, radius, half))
        });
        let Some((direction, t, normal, radius, half)) = found else { break };
        taken.push((direction, half));
        let axis = (direction + normal).normalize();
        let base = center + direction * t;
        let squash = random.uniform(0.75, 1.0);
        let radii = [radius, radius * squash];
        // How far the ellipsoid bulges through the middle of a flush face.
        let sag = radius * radius / (2.0 * semi.min());
        let length = sag + 2.0 * coarse + 2.0 * radius * random.uniform(0.0, 0.8);
        let at = base + axis * length;
        let plane_normal = leaning(&axis, random.uniform(0.0, 0.4), random.uniform(0.0, TAU));
        let cap = Cap::flat(at, plane_normal, axis, radius, "valve")?;
        let u = Plane { origin: at, normal: axis }.basis().0;
        let body = Body::Prism { from: base - axis * (0.5 * t), to: at + axis * (2.0 * radius), u, radii };
        stubs.push(Piece::new(vec![body], vec![Cut { plane: cap.plane, reach: f64::INFINITY }]));
        caps.push(Cap { diameters: Some(length / (2.0 * radius)), ..cap.measured() });
    }
    if caps.len() < 2 {
        return None;
    }
    let margin = 3.0 * coarse;
    let mut wide = (axes.component_mul(&axes) * semi.component_mul(&semi)).map(f64::sqrt);
    for cap in caps.iter().filter(|c| c.diameters.is_some()) {
        wide = wide.sup(&(cap.plane.origin.coords.abs() + Vector::repeat(0.4 * cap.reach)));
    }
    let wide = wide + Vector::repeat(margin);
    let mut pieces = vec![chamber];
    pieces.append(&mut stubs);
    Some(Draft {
        description: format!("a chamber with {} wide ends cut flat", caps.len()),
        solid: Solid { pieces },
        frame: Frame::new(-wide, wide, spacing),
        caps,
        closed: Vec::new(),
        turns: true,
        beside: false,
    })
}
