//! The built-in phantoms.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Rotation3};

use super::{Phantom, Primitive, Shape, Tip, TreeOptions, Truth, random_tree};
use crate::geometry::{Point, Vector};

/// Names without a variant's ending.
pub(super) const NAMES: [&str; 11] =
    ["aneurysm", "tube", "bend", "bifurcation", "stenosis", "helix", "kissing", "thin", "tree", "sphere", "torus"];

pub(super) fn build(name: &str) -> Option<Phantom> {
    Some(match name {
        "aneurysm" => aneurysm(),
        "tube" => tube(),
        "bend" => bend(),
        "bifurcation" => bifurcation(),
        "stenosis" => stenosis(),
        "helix" => helix(),
        "kissing" => kissing(),
        "thin" => thin(),
        "tree" => random_tree(1, &TreeOptions::default()),
        "sphere" => closed("a ball of radius 6 mm: no openings", vec![join(Shape::Sphere { center: Point::new(1.0, -2.0, 3.0), radius: 6.0 }, 0.0)]),
        "torus" => torus(),
        _ => return None,
    })
}

/// A rotation followed by a mirror.
pub(super) fn oblique_left_handed() -> Matrix3<f64> {
    Rotation3::from_euler_angles(0.4, -0.3, 0.7).into_inner() * Matrix3::from_diagonal(&Vector::new(1.0, 1.0, -1.0))
}

fn join(shape: Shape, blend: f64) -> Primitive {
    Primitive { shape, blend }
}

fn capsule(a: Point, b: Point, radii: [f64; 2]) -> Shape {
    Shape::Capsule { a, b, radii }
}

pub(super) fn closed(description: &str, primitives: Vec<Primitive>) -> Phantom {
    Phantom {
        name: String::new(),
        description: description.into(),
        truth: Truth { primitives },
        tips: Vec::new(),
        spacing: [0.5; 3],
        offset: [0.217; 3],
        direction: Matrix3::identity(),
        window: [[None; 2]; 3],
    }
}

fn with_tips(mut phantom: Phantom, tips: Vec<Tip>) -> Phantom {
    phantom.tips = tips;
    phantom
}

fn tip(from: Point, to: Point, radius: f64) -> Tip {
    Tip { from, to, radii: [radius; 2] }
}

/// A sac on the outside of a bend that a branch leaves; the inlet runs through the picture's lower z border.
fn aneurysm() -> Phantom {
    let (r, major) = (2.0, 11.0);
    let center = Point::new(major, 0.0, 0.0);
    let (u, v) = (-Vector::x(), Vector::z());
    let angle = 2.0 * PI / 3.0;
    let at = |t: f64| center + (u * t.cos() + v * t.sin()) * major;
    let along = |t: f64| v * t.cos() - u * t.sin();
    let outlet = at(angle) + along(angle) * 13.0;
    let apex = 0.42 * angle;
    let outward = u * apex.cos() + v * apex.sin();
    let sac = at(apex) + (outward + Vector::y() * 0.35).normalize() * 5.2;
    let root = at(0.78 * angle);
    let branch = root + (along(0.78 * angle) * 0.5 + Vector::new(-0.35, -1.0, 0.55)).normalize() * 14.0;
    let inlet = at(0.0) - v * 40.0;
    let mut phantom = closed(
        "a saccular aneurysm on a curved parent vessel with a side branch; the image border cuts the inlet",
        vec![
            join(Shape::TorusArc { center, u, v, major, angle, radius: r }, 0.0),
            join(capsule(at(0.0), inlet, [r, r]), 0.0),
            join(capsule(at(angle), outlet, [r, r]), 0.0),
            join(capsule(root, branch, [1.3, 1.3]), 0.8),
            join(Shape::Sphere { center: sac, radius: 4.0 }, 1.2),
        ],
    );
    phantom.window[2][0] = Some(-14.0);
    with_tips(phantom, vec![tip(at(0.0), inlet, r), tip(at(angle), outlet, r), tip(root + (branch - root) * 0.5, branch, 1.3)])
}

/// Cut by the picture's border at both ends.
fn tube() -> Phantom {
    let direction = Vector::new(0.55, 0.35, 0.76).normalize();
    let (point, r) = (Point::origin(), 2.5);
    let mut phantom = closed(
        "a straight tube of radius 2.5 mm, oblique to the grid, cut by the image border at both ends",
        vec![join(Shape::Cylinder { point, direction, radius: r }, 0.0)],
    );
    phantom.window = [[Some(-22.0), Some(22.0)], [Some(-17.0), Some(17.0)], [Some(-18.0), Some(18.0)]];
    with_tips(phantom, vec![tip(point, point + direction * 200.0, r), tip(point, point - direction * 200.0, r)])
}

/// Half a turn of radius `major` with straight legs of `leg` mm; ends within the picture.
fn hairpin(description: &str, major: f64, r: f64, leg: f64) -> Phantom {
    let u = Vector::new(1.0, 0.0, 0.25).normalize();
    let w = Vector::new(0.1, 1.0, 0.0);
    let v = (w - u * u.dot(&w)).normalize();
    let center = Point::origin();
    let (a, b) = (center + u * major, center - u * major);
    let (a1, b1) = (a - v * leg, b - v * leg);
    let phantom = closed(
        description,
        vec![
            join(Shape::TorusArc { center, u, v, major, angle: PI, radius: r }, 0.0),
            join(capsule(a, a1, [r, r]), 0.0),
            join(capsule(b, b1, [r, r]), 0.0),
        ],
    );
    with_tips(phantom, vec![tip(a, a1, r), tip(b, b1, r)])
}

fn bend() -> Phantom {
    hairpin("a tube of radius 2.2 mm bent by 180 degrees round 9 mm, with straight legs; both ends lie inside the image", 9.0, 2.2, 14.0)
}

fn kissing() -> Phantom {
    hairpin("a hairpin whose legs of radius 2.5 mm run 0.9 mm apart: neighbouring vessels that must stay apart", 2.95, 2.5, 18.0)
}

fn bifurcation() -> Phantom {
    let o = Point::origin();
    let (inlet, left, right) = (Point::new(0.0, 0.0, -20.0), Point::new(12.0, 3.0, 15.0), Point::new(-11.0, -4.0, 14.0));
    let phantom = closed(
        "a Y bifurcation from radius 2.4 mm to 1.9 and 1.6 mm; all ends lie inside the image",
        vec![
            join(capsule(inlet, o, [2.4, 2.4]), 0.0),
            join(capsule(o, left, [1.9, 1.9]), 0.8),
            join(capsule(o, right, [1.6, 1.6]), 0.8),
        ],
    );
    let half = |p: Point| o + (p - o) * 0.5;
    with_tips(phantom, vec![tip(half(inlet), inlet, 2.4), tip(half(left), left, 1.9), tip(half(right), right, 1.6)])
}

fn stenosis() -> Phantom {
    let axis = Vector::new(0.2, 0.3, 1.0).normalize();
    let at = |t: f64| Point::new(1.0, 2.0, 3.0) + axis * t;
    let piece = |a: f64, b: f64, radii, k| join(capsule(at(a), at(b), radii), k);
    let phantom = closed(
        "a straight tube of radius 2.5 mm that narrows to 1 mm (a stenosis of 84 % by area)",
        vec![
            piece(-18.0, -6.0, [2.5, 2.5], 0.0),
            piece(-6.0, 0.0, [2.5, 1.0], 0.5),
            piece(0.0, 6.0, [1.0, 2.5], 0.5),
            piece(6.0, 18.0, [2.5, 2.5], 0.5),
        ],
    );
    with_tips(phantom, vec![tip(at(-10.0), at(-18.0), 2.5), tip(at(10.0), at(18.0), 2.5)])
}

fn helix() -> Phantom {
    const PIECES: usize = 64;
    let (major, r, pitch) = (7.0, 1.6, 9.0);
    let at = |n: usize| {
        let turns = 2.0 * n as f64 / PIECES as f64;
        Point::new(major * (TAU * turns).cos(), major * (TAU * turns).sin(), pitch * turns)
    };
    let primitives = (0..PIECES).map(|n| join(capsule(at(n), at(n + 1), [r, r]), 0.0)).collect();
    let phantom = closed("two turns of a helix of radius 7 mm, pitch 9 mm, vessel radius 1.6 mm", primitives);
    with_tips(phantom, vec![tip(at(1), at(0), r), tip(at(PIECES - 1), at(PIECES), r)])
}

fn thin() -> Phantom {
    let (a, o, b, c) = (Point::new(-3.0, 2.0, -20.0), Point::origin(), Point::new(9.0, -2.0, 15.0), Point::new(-8.0, 5.0, 13.0));
    let phantom = closed(
        "a thin bifurcation: diameters from 2 mm down to 1 mm, two voxels",
        vec![join(capsule(a, o, [1.0, 0.9]), 0.0), join(capsule(o, b, [0.7, 0.5]), 0.3), join(capsule(o, c, [0.7, 0.5]), 0.3)],
    );
    let half = |p: Point, radii: [f64; 2]| Tip { from: o + (p - o) * 0.5, to: p, radii };
    with_tips(phantom, vec![half(a, [0.95, 1.0]), half(b, [0.6, 0.5]), half(c, [0.6, 0.5])])
}

fn torus() -> Phantom {
    let u = Vector::new(1.0, 0.2, 0.3).normalize();
    let v = u.cross(&Vector::new(0.1, -0.4, 1.0)).normalize();
    closed(
        "a closed ring of radius 8 mm, vessel radius 2.5 mm: one tunnel, no openings",
        vec![join(Shape::TorusArc { center: Point::new(-1.0, 2.0, 0.5), u, v, major: 8.0, angle: TAU, radius: 2.5 }, 0.0)],
    )
}
