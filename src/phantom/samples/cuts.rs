//! Trees as people cut them: flat ends at a slant, short stubs, several vessels cut by one plane.

use super::draft::{Cap, Draft, Frame};
use crate::geometry::{Point, Vector};
use crate::phantom::Random;
use crate::phantom::Shape;
use crate::phantom::solid::{Body, Cut, Piece, Solid};

/// Lengths of stubs in diameters.
const STUBS: [f64; 5] = [0.6, 0.9, 1.3, 2.0, 3.5];

/// A bent course of axis points.
fn course(random: &mut Random, from: Point, direction: Vector, length: f64, step: f64, wiggle: f64) -> (Vec<Point>, Vector) {
    let n = ((length / step) as usize).max(3);
    let (mut points, mut d) = (vec![from], direction);
    for _ in 0..n {
        d = (d + Vector::from_fn(|_, _| wiggle * random.normal())).normalize();
        points.push(points[points.len() - 1] + d * (length / n as f64));
    }
    (points, d)
}

fn capsules(points: &[Point], radii: &[f64]) -> Vec<Body> {
    let pieces = points.windows(2).zip(radii.windows(2));
    pieces.map(|(p, r)| Body::Round(Shape::Capsule { a: p[0], b: p[1], radii: [r[0], r[1]] })).collect()
}

/// A unit vector square to `axis`.
fn across(random: &mut Random, axis: &Vector) -> Vector {
    loop {
        let v = axis.cross(&random.direction());
        if v.norm() > 0.1 {
            return v.normalize();
        }
    }
}

/// A flat end: in three of ten cases nearly square to the axis.
fn end(random: &mut Random, at: Point, axis: Vector, radius: f64, kind: &'static str, diameters: f64) -> Option<Cap> {
    let square = random.uniform(0.0, 1.0) < 0.3;
    let tilt: f64 = if square { random.uniform(0.0, 12.0) } else { random.uniform(12.0, 50.0) };
    let side = across(random, &axis);
    let normal = axis * tilt.to_radians().cos() + side * tilt.to_radians().sin();
    Some(Cap { diameters: Some(diameters), ..Cap::flat(at, normal, axis, radius, kind)? })
}

/// A cut by the cap's plane that leaves everything else alone.
fn cut(cap: &Cap, last: &Point, radius: f64) -> Cut {
    Cut { plane: cap.plane, reach: 5.0 * radius + (last - cap.plane.origin).norm() }
}

/// A parent vessel cut at both ends and one to three side branches. `thick` gives voxels of 1:1:3.
pub(super) fn draft(random: &mut Random, thick: bool) -> Option<Draft> {
    let isotropic: [[f64; 3]; 5] = [[0.5, 0.5, 0.5], [0.4, 0.4, 0.6], [0.35, 0.35, 0.9], [0.6, 0.6, 0.6], [0.3, 0.3, 0.9]];
    let spacing: [f64; 3] = if thick { [[0.3, 0.3, 0.9], [0.4, 0.4, 1.2], [0.5, 0.5, 1.5]][random.below(3)] } else { isotropic[random.below(5)] };
    let r0 = random.uniform(2.5, 4.5) * spacing[0].max(0.7 * spacing[2]) / 0.5 * 0.8;
    let start = random.direction();
    let (main, _) = course(random, Point::origin(), start, 14.0 * r0, 0.6 * r0, 0.08);
    let last = main.len() - 1;
    let radii: Vec<f64> = (0..=last).map(|n| r0 * (1.0 - 0.15 * n as f64 / last as f64)).collect();
    let (first, onward) = ((main[0] - main[1]).normalize(), (main[last] - main[last - 1]).normalize());
    let mut caps = vec![end(random, main[0], first, r0, "parent", 5.0)?, end(random, main[last], onward, radii[last], "parent", 5.0)?];
    let points: Vec<Point> = [main[0] + first * (3.0 * r0)].into_iter().chain(main.iter().copied()).chain([main[last] + onward * (3.0 * r0)]).collect();
    let long: Vec<f64> = [r0].into_iter().chain(radii.iter().copied()).chain([radii[last]]).collect();
    let cuts = caps.iter().map(|c| cut(c, &points[points.len() - 1], radii[last])).collect();
    let mut pieces = vec![Piece::new(capsules(&points, &long), cuts)];

    let count = 1 + random.below(3);
    let mut where_ = [0.3, 0.5, 0.7];
    for n in (1..3).rev() {
        where_.swap(n, random.below(n + 1));
    }
    let at: Vec<usize> = where_[..count].iter().map(|f| (main.len() as f64 * f) as usize).collect();
    let common = random.uniform(0.0, 1.0) < 0.4 && count >= 2;
    let side = across(random, &(main[last] - main[0]).normalize());
    let height = at.iter().map(|&n| main[n].coords.dot(&side)).fold(f64::NEG_INFINITY, f64::max) + r0 + 0.9 * r0 * STUBS[random.below(5)];
    for n in at {
        let r = r0 * random.uniform(0.35, 0.7);
        let diameters = STUBS[random.below(5)];
        let axis = (main[n + 1] - main[n]).normalize();
        let direction = if common {
            side + Vector::from_fn(|_, _| 0.25 * random.normal()) + axis * 0.4
        } else {
            across(random, &axis) + axis * random.uniform(-0.2, 0.7)
        };
        let (mut points, outward) = course(random, main[n], direction.normalize(), r0 + 2.0 * r * diameters, 0.6 * r, 0.06);
        let cap = if common {
            let (a, b) = crossing(&mut points, &side, height, r)?;
            let center = a + (b - a) * ((height - a.coords.dot(&side)) / (b - a).dot(&side));
            let diameters = ((center - main[n]).norm() - r0) / (2.0 * r);
            Cap { diameters: Some(diameters), ..Cap::flat(center, side, b - a, r, "side, common plane")? }
        } else {
            let cap = end(random, points[points.len() - 1], outward, r, "side", diameters)?;
            points.push(cap.plane.origin + outward * (3.0 * r));
            cap
        };
        pieces.push(Piece::new(capsules(&points, &vec![r; points.len()]), vec![cut(&cap, &points[points.len() - 1], r)]));
        caps.push(cap);
    }
    let all = caps.iter().map(|c| c.plane.origin).chain(main);
    let (low, high) = all.fold((Vector::repeat(f64::INFINITY), Vector::repeat(f64::NEG_INFINITY)), |(l, h), p| (l.inf(&p.coords), h.sup(&p.coords)));
    let margin = Vector::repeat(2.2 * r0);
    Some(Draft {
        description: "a vessel with side branches, its ends cut flat at a slant".into(),
        solid: Solid { pieces },
        frame: Frame::new(low - margin, high + margin, spacing),
        caps,
        closed: Vec::new(),
        turns: false,
        beside: false,
    })
}

/// Lets a course go on until it has crossed the plane well; the axis points on both sides of it.
fn crossing(points: &mut Vec<Point>, side: &Vector, height: f64, r: f64) -> Option<(Point, Point)> {
    let onward = (points[points.len() - 1] - points[points.len() - 2]).normalize();
    if onward.dot(side) < 0.3 {
        return None;
    }
    while points[points.len() - 1].coords.dot(side) < height + 2.0 * r {
        points.push(points[points.len() - 1] + onward * r);
    }
    let n = (1..points.len()).find(|&n| points[n].coords.dot(side) >= height)?;
    Some((points[n - 1], points[n])).filter(|(a, _)| a.coords.dot(side) < height)
}
