//! Trees with sacs on the side of vessels, at divisions and at the end of vessels, some cropped by the image border.

use super::ClosedEnd;
use super::draft::{Cap, Draft, Frame};
use crate::geometry::{Plane, Point, Vector};
use crate::implicit::Implicit;
use crate::phantom::solid::{Body, Piece, Solid, plane_section};
use crate::phantom::{Phantom, Primitive, Random, Shape, Tip, TreeOptions, random_tree};

/// Trials to place a sac apart from the other vessels.
const TRIALS: usize = 40;

/// Least gap between a sac and other vessels, mm.
const GAP: f64 = 1.5;

/// A ball on a vessel.
struct Sac {
    center: Point,
    radius: f64,
    reason: &'static str,
}

/// The straight pieces of a tree.
fn pieces(tree: &Phantom) -> Vec<(Point, Point, f64)> {
    let piece = |p: &Primitive| match p.shape {
        Shape::Capsule { a, b, radii } => Some((a, b, radii[0].max(radii[1]))),
        _ => None,
    };
    tree.truth.primitives.iter().filter_map(piece).collect()
}

fn distance(p: &Point, a: &Point, b: &Point) -> f64 {
    let axis = b - a;
    let t = ((p - a).dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
    (p - a - axis * t).norm()
}

/// Whether a sac keeps away from all pieces but those that touch `own`, from all tips but `tip`, and from other sacs.
fn is_clear(tree: &Phantom, sacs: &[Sac], sac: &Sac, own: (Point, Point), tip: Option<usize>) -> bool {
    let joined = |a: &Point, b: &Point| [a, b].iter().any(|p| (**p - own.0).norm() < 1e-9 || (**p - own.1).norm() < 1e-9);
    pieces(tree).iter().all(|(a, b, r)| joined(a, b) || distance(&sac.center, a, b) > sac.radius + r + GAP)
        && tree.tips.iter().enumerate().all(|(n, t)| {
            tip == Some(n) || distance(&sac.center, &t.from, &t.to) > sac.radius + t.radii[0] + GAP
        })
        && sacs.iter().all(|s| (s.center - sac.center).norm() > s.radius + sac.radius + GAP)
}

/// A sac on the side of a vessel.
fn on_side(random: &mut Random, tree: &Phantom, sacs: &[Sac]) -> Option<(Sac, f64)> {
    let all = pieces(tree);
    (0..TRIALS).find_map(|_| {
        let (a, b, r) = all[random.below(all.len())];
        let at = a + (b - a) * random.uniform(0.2, 0.8);
        let side = (b - a).cross(&random.direction()).try_normalize(1e-3)?;
        let radius = r * random.uniform(1.1, 2.4);
        let center = at + side * (r + radius * random.uniform(0.35, 0.8));
        let sac = Sac { center, radius, reason: "a sac on the side of a vessel" };
        is_clear(tree, sacs, &sac, (a, b), None).then_some((sac, r))
    })
}

/// A sac at the end of a vessel; gives the tip that it takes.
fn at_end(random: &mut Random, tree: &Phantom, sacs: &[Sac]) -> Option<(Sac, f64, usize)> {
    (0..TRIALS).find_map(|_| {
        let n = 1 + random.below(tree.tips.len() - 1);
        let tip: &Tip = &tree.tips[n];
        let r = tip.radii[1];
        let radius = r * random.uniform(1.6, 2.6);
        let center = tip.to + (tip.to - tip.from).normalize() * (0.8 * radius);
        let sac = Sac { center, radius, reason: "a sac at the end of a vessel" };
        is_clear(tree, sacs, &sac, (tip.from, tip.to), Some(n)).then_some((sac, r, n))
    })
}

/// Lets the image end within a sac where nothing else reaches as far; gives the closed place.
fn crop(random: &mut Random, tree: &Phantom, sacs: &[Sac], low: &mut Vector, high: &mut Vector) -> Option<Plane> {
    let mut faces = Vec::new();
    for (n, sac) in sacs.iter().enumerate() {
        for (a, sign) in [0, 1, 2].into_iter().flat_map(|a| [(a, -1.0), (a, 1.0)]) {
            let at = sign * sac.center[a] + sac.radius * random.uniform(-0.2, 0.75);
            let vessels = pieces(tree).iter().map(|(p, q, r)| (sign * p[a]).max(sign * q[a]) + r).fold(f64::NEG_INFINITY, f64::max);
            let others = sacs.iter().enumerate().filter(|(m, _)| *m != n).map(|(_, s)| sign * s.center[a] + s.radius);
            if others.fold(vessels, f64::max) + GAP < at {
                faces.push((a, sign, at, sac.center));
            }
        }
    }
    if faces.is_empty() {
        return None;
    }
    let (a, sign, at, center) = faces[random.below(faces.len())];
    let mut origin = center;
    origin[a] = sign * at;
    if sign > 0.0 { high[a] = at } else { low[a] = -at }
    Plane::new(origin, Vector::ith(a, sign))
}

/// A tree with round tips; with `more`, sacs are added.
pub(super) fn draft(random: &mut Random, more: bool) -> Option<Draft> {
    let options = TreeOptions { min_radius: 1.7, depth: 1 + random.below(2), sac_probability: 0.5, ..TreeOptions::default() };
    let mut tree = random_tree(random.bits(), &options);
    let root = tree.tips.first()?.radii[1];
    let spacing = [root * random.uniform(0.14, 0.2); 3];
    let is_ball = |p: &&Primitive| matches!(p.shape, Shape::Sphere { .. });
    let ball = |p: &Primitive| match p.shape {
        Shape::Sphere { center, radius } => Some(Sac { center, radius, reason: "a sac at a division" }),
        _ => None,
    };
    let mut sacs: Vec<Sac> = tree.truth.primitives.iter().filter(is_ball).filter_map(ball).collect();
    let mut taken = Vec::new();
    if more {
        for _ in 0..1 + random.below(3) {
            if let Some((sac, r)) = on_side(random, &tree, &sacs) {
                let shape = Shape::Sphere { center: sac.center, radius: sac.radius };
                tree.truth.primitives.push(Primitive { shape, blend: 0.3 * r });
                sacs.push(sac);
            }
        }
        if tree.tips.len() > 2 && random.below(2) == 0
            && let Some((sac, r, n)) = at_end(random, &tree, &sacs)
        {
            let shape = Shape::Sphere { center: sac.center, radius: sac.radius };
            tree.truth.primitives.push(Primitive { shape, blend: 0.3 * r });
            sacs.push(sac);
            taken.push(n);
        }
        if sacs.is_empty() {
            return None;
        }
    }
    let bounds = tree.truth.bounds();
    let margin = Vector::repeat(4.0 * spacing[0]);
    let (mut low, mut high) = (bounds.min.coords - margin, bounds.max.coords + margin);
    // The root leaves through the lower z face where the tree was made so.
    let window = tree.window[2][0];
    if let Some(z) = window {
        low.z = z;
    }
    let cropped = if more { crop(random, &tree, &sacs, &mut low, &mut high) } else { None };
    // `high` moves to a voxel face; where a sac is cut there, `low` moves with it.
    let snapped = Frame::new(low, high, spacing);
    if let Some(face) = cropped {
        let a = face.normal.iamax();
        if face.normal[a] > 0.0 && !(a == 2 && window.is_some()) {
            low[a] -= snapped.high[a] - high[a];
            low[a] += spacing[a] * 1e-9;
        }
    }
    let frame = Frame::new(low, high, spacing);
    let mut caps = Vec::new();
    for (n, tip) in tree.tips.iter().enumerate().filter(|(n, _)| !taken.contains(n)) {
        let axis = (tip.to - tip.from).normalize();
        caps.push(match window {
            Some(z) if n == 0 => {
                let t = (z - tip.from.z) / (tip.to.z - tip.from.z);
                let radius = tip.radii[0] + t * (tip.radii[1] - tip.radii[0]);
                Cap::border(tip.from + (tip.to - tip.from) * t, -Vector::z(), axis, radius, "root")?
            }
            _ => Cap::round(tip.to, axis, tip.radii[1], if n == 0 { "root" } else { "tip" })?,
        });
    }
    let mut draft = Draft {
        description: format!("a tree, sacs: {}{}", sacs.len(), if cropped.is_some() { ", one cropped by the image border" } else { "" }),
        solid: Solid { pieces: vec![Piece::new(vec![Body::Blended(tree.truth.clone())], Vec::new())] },
        frame,
        caps,
        closed: sacs.iter().map(|s| ClosedEnd { at: s.center, area: None, reason: s.reason }).collect(),
        turns: true,
        beside: false,
    };
    if let Some(face) = cropped {
        let a = face.normal.iamax();
        let mut inside = face;
        inside.origin[a] = if face.normal[a] > 0.0 { frame.high[a] - 1e-6 } else { frame.low[a] + 1e-6 };
        let reach = sacs.iter().map(|s| s.radius).fold(0.0, f64::max) * 1.2;
        if let Some(found) = plane_section(|p| draft.holds(p), &inside, [reach, reach / 3.0, reach / 100.0]) {
            draft.closed.push(ClosedEnd { at: found.centroid, area: Some(found.area), reason: "a sac cropped by the image border" });
        }
    }
    Some(draft)
}
