//! Trunks that split at once behind their end, at the image border or within the image.

use super::draft::{Cap, Draft, Frame};
use crate::geometry::{Plane, Point, Vector};
use crate::phantom::Random;
use crate::phantom::solid::{Body, Cut, Piece, Solid};

/// How the trunk ends.
#[derive(Clone, Copy, PartialEq)]
enum Trunk {
    Border,
    OneSlice,
    Flat,
    Round,
}

/// How the daughters end.
#[derive(Clone, Copy, PartialEq)]
enum Outlets {
    Flat,
    Round,
    Border,
}

/// An axis that ends at a place, and its radius.
struct Tip {
    from: Point,
    direction: Vector,
    radius: f64,
}

/// A unit vector at `angle` (rad) to `axis`, towards `azimuth` round it.
pub(super) fn leaning(axis: &Vector, angle: f64, azimuth: f64) -> Vector {
    let basis = Plane { origin: Point::origin(), normal: *axis }.basis();
    axis * angle.cos() + (basis.0 * azimuth.cos() + basis.1 * azimuth.sin()) * angle.sin()
}

/// A trunk of two, three daughters, or a ring, within two radii of its end.
pub(super) fn draft(random: &mut Random) -> Option<Draft> {
    let trunk = [Trunk::Border, Trunk::Border, Trunk::Border, Trunk::OneSlice, Trunk::Flat, Trunk::Round][random.below(6)];
    let outlets = [Outlets::Flat, Outlets::Round, Outlets::Border][random.below(3)];
    let r = random.uniform(0.8, 8.0);
    let edge = r / random.uniform(5.0, 9.0);
    let spacing = [edge, edge, edge * [1.0, 1.0, 1.5, 2.0][random.below(4)]];
    let coarse = spacing[2];
    let inward = leaning(&Vector::z(), random.uniform(0.0, 0.35), random.uniform(0.0, std::f64::consts::TAU));
    let depth = if trunk == Trunk::Round { random.uniform(0.75, 2.0) } else { random.uniform(0.0, 2.0) };
    let split = Point::origin() + inward * (depth * r);

    // What takes the trunk's end off takes off all that lies beyond it.
    let (mut cuts, mut low) = (Vec::new(), 0.0);
    let mut first = Cap::border(Point::origin(), -Vector::z(), -inward, r, "trunk")?;
    match trunk {
        Trunk::Border => {}
        Trunk::OneSlice => {
            first.on_border = false;
            low = -coarse;
        }
        Trunk::Flat => {
            let normal = leaning(&-inward, random.uniform(0.0, 0.45), random.uniform(0.0, std::f64::consts::TAU));
            first = Cap::flat(Point::origin(), normal, -inward, r, "trunk")?;
            low = -2.0 * r - 3.0 * coarse;
        }
        Trunk::Round => {
            first = Cap::round(Point::origin(), -inward, r, "trunk")?;
            low = -2.0 * r - 3.0 * coarse;
        }
    }
    if matches!(trunk, Trunk::OneSlice | Trunk::Flat) {
        cuts.push(Cut { plane: first.plane, reach: f64::INFINITY });
    }
    let back = if trunk == Trunk::Round { 0.0 } else { 4.0 * r };
    let mut bodies = vec![Body::tube(split, Point::origin() - inward * back, r)];

    let azimuth = random.uniform(0.0, std::f64::consts::TAU);
    let mut tips = Vec::new();
    let what = match random.below(3) {
        0 => {
            let ratio = random.uniform(0.6, 1.0);
            let large = r / (1.0f64 + ratio * ratio * ratio).cbrt();
            for (n, radius) in [large, ratio * large].into_iter().enumerate() {
                let direction = leaning(&inward, random.uniform(0.35, 0.75), azimuth + std::f64::consts::PI * n as f64);
                tips.push(Tip { from: split, direction, radius });
            }
            "two daughters"
        }
        1 => {
            for n in 0..3 {
                let turn = azimuth + std::f64::consts::TAU / 3.0 * n as f64 + random.uniform(-0.2, 0.2);
                let direction = leaning(&inward, random.uniform(0.5, 0.8), turn);
                tips.push(Tip { from: split, direction, radius: r * random.uniform(0.55, 0.75) });
            }
            "three daughters"
        }
        _ => {
            let join = ring(random, &mut bodies, [r, coarse], &split, &inward, azimuth);
            tips.push(Tip { from: join, direction: inward, radius: r * random.uniform(0.8, 1.0) });
            "a ring"
        }
    };
    let mut caps = vec![first];
    let mut pieces = Vec::new();
    let top = tips.iter().map(|t| t.from.z).fold(0.0, f64::max) + random.uniform(6.0, 9.0) * r;
    let top = low + ((top - low) / coarse).ceil() * coarse;
    let mut high = f64::NEG_INFINITY;
    let mut wide = Vector::zeros();
    for tip in tips {
        let mut own = cuts.clone();
        let mut end = tip.from + tip.direction * (random.uniform(7.0, 10.0) * r);
        let cap = match outlets {
            Outlets::Border => {
                end = tip.from + tip.direction * ((top - tip.from.z) / tip.direction.z);
                Cap::border(end, Vector::z(), tip.direction, tip.radius, "daughter")?
            }
            Outlets::Flat => {
                let normal = leaning(&tip.direction, random.uniform(0.0, 0.45), random.uniform(0.0, std::f64::consts::TAU));
                let cap = Cap::flat(end, normal, tip.direction, tip.radius, "daughter")?;
                own.push(Cut { plane: cap.plane, reach: f64::INFINITY });
                cap
            }
            Outlets::Round => Cap::round(end, tip.direction, tip.radius, "daughter")?,
        };
        let behind = if outlets == Outlets::Round { 0.0 } else { 4.0 * tip.radius };
        pieces.push(Piece::new(vec![Body::tube(tip.from, end + tip.direction * behind, tip.radius)], own));
        high = f64::max(high, end.z + 2.0 * tip.radius);
        wide = wide.sup(&end.coords.abs());
        caps.push(cap);
    }
    pieces.insert(0, Piece::new(bodies, cuts));
    let high = if outlets == Outlets::Border { top } else { high + 3.0 * coarse };
    let wide = wide.map(|x| x.max(3.0 * r)) + Vector::repeat(2.0 * r + 3.0 * coarse);
    Some(Draft {
        description: format!("a trunk with {what} {depth:.2} radii behind its end"),
        solid: Solid { pieces },
        frame: Frame::new(Vector::new(-wide.x, -wide.y, low), Vector::new(wide.x, wide.y, high), spacing),
        caps,
        closed: Vec::new(),
        turns: true,
        beside: false,
    })
}

/// Two vessels that part at `split` and meet again; gives where.
fn ring(random: &mut Random, bodies: &mut Vec<Body>, [r, coarse]: [f64; 2], split: &Point, inward: &Vector, azimuth: f64) -> Point {
    let radius = r * random.uniform(0.6, 0.8);
    let side = leaning(inward, std::f64::consts::FRAC_PI_2, azimuth) * (radius + (radius * random.uniform(0.4, 1.2)).max(1.5 * coarse));
    let length = 2.0 * r;
    let join = split + inward * (3.0 * length);
    for half in [side, -side] {
        let (a, b) = (split + inward * length + half, split + inward * (2.0 * length) + half);
        bodies.extend([Body::tube(*split, a, radius), Body::tube(a, b, radius), Body::tube(b, join, radius)]);
    }
    join
}
