use super::tube::cast;
use super::*;
use crate::geometry::Plane;
use crate::centerline::{Branch, EndKind, Sample};
use crate::mesh::PatchKind;
use crate::openings::FoundBy;
use nalgebra::Matrix3;

/// An elliptic tube along z with an end at |z| = 12.
struct Ellipse;

impl Implicit for Ellipse {
    fn value(&self, p: &Point) -> f64 {
        let q = (p.x / 3.0).hypot(p.y / 2.0);
        (2.4 * (q - 1.0)).max(p.z.abs() - 12.0)
    }
    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let h = 1e-6;
        let d = |e: Vector| (self.value(&(p + e * h)) - self.value(&(p - e * h))) / (2.0 * h);
        (self.value(p), Vector::new(d(Vector::x()), d(Vector::y()), d(Vector::z())))
    }
    fn bounds(&self) -> Aabb {
        Aabb { min: Point::new(-3.0, -2.0, -12.0), max: Point::new(3.0, 2.0, 12.0) }
    }
    fn resolution(&self) -> f64 {
        0.25
    }
}

fn setup() -> (Mask, Opening) {
    let grid = Grid::new([20, 16, 60], [0.5; 3], Point::new(-4.8, -3.8, -14.8), Matrix3::identity()).unwrap();
    let data = (0..grid.len())
        .map(|n| {
            let [i, j, k] = grid.voxel(n).map(|c| c as f64);
            u8::from(Ellipse.value(&grid.to_world(Vector::new(i, j, k))) < 0.0)
        })
        .collect();
    let opening = Opening {
        id: 2,
        name: "inlet".into(),
        kind: PatchKind::Inlet,
        plane: Plane { origin: Point::new(0.3, -0.2, 10.0), normal: Vector::z() },
        radius: 2.0,
        support: super::super::Support { axis: Vector::z(), square_area: 12.6, expected_area: None, along_face: false },
        found_by: FoundBy::BluntEnd,
        confidence: 1.0,
        component: 0,
    };
    (Mask::new(grid, data), opening)
}

fn extension(transition: Option<f64>, direction: Option<Vector>) -> Extension {
    Extension { opening: "inlet".into(), length: 20.0, transition, direction }
}

/// Area and shape (longest by shortest ray) at a height.
fn area(f: &Extended<&Ellipse>, center: Point) -> (f64, f64) {
    let rays: Vec<f64> = (0..720)
        .map(|n| {
            let (s, c) = (std::f64::consts::TAU * f64::from(n) / 720.0).sin_cos();
            cast(f, &center, &Vector::new(c, s, 0.0), 9.0).unwrap()
        })
        .collect();
    let (low, high) = rays.iter().fold((f64::INFINITY, 0.0f64), |(l, h), &r| (l.min(r), h.max(r)));
    (rays.iter().map(|r| 0.5 * r * r).sum::<f64>() * std::f64::consts::TAU / 720.0, high / low)
}

#[test]
fn an_extension_keeps_the_area_and_ends_in_a_circle() {
    let (mask, opening) = setup();
    let (f, moved) = Extended::new(&Ellipse, &mask, &[opening], &[extension(Some(8.0), None)]).unwrap();
    assert!((moved[0].plane.origin - Point::new(0.0, 0.0, 30.0)).norm() < 1e-3);
    let exact = std::f64::consts::PI * 6.0;
    for z in [8.0, 9.2, 9.8, 10.0, 10.5, 12.5, 15.0, 20.0, 29.0] {
        let (a, shape) = area(&f, Point::new(0.0, 0.0, z));
        assert!((a / exact - 1.0).abs() < 0.005, "area {a} at {z}");
        if z > 18.0 {
            assert!(shape < 1.001, "{shape}");
        }
    }
    assert!(f.value(&Point::new(0.0, 0.0, 35.0)) > 0.0);
    assert!((f.tubes()[0].volume() / (exact * 20.0) - 1.0).abs() < 0.005);
}

#[test]
fn the_gradient_is_the_derivative_of_the_value() {
    let (mask, opening) = setup();
    let slanted = Some(Vector::new(0.3, 0.1, 1.0));
    let (f, _) = Extended::new(&Ellipse, &mask, &[opening], &[extension(Some(8.0), slanted)]).unwrap();
    for p in [[2.1, 0.5, 9.4], [2.6, 0.9, 11.0], [3.4, -1.0, 14.0], [1.9, 2.4, 16.0], [7.9, 3.4, 31.5], [7.2, 2.6, 32.2]] {
        let p = Point::from(p);
        let (_, g) = f.value_gradient(&p);
        let h = 1e-5;
        let d = |e: Vector| (f.value(&(p + e * h)) - f.value(&(p - e * h))) / (2.0 * h);
        let n = Vector::new(d(Vector::x()), d(Vector::y()), d(Vector::z()));
        assert!((g - n).norm() < 2e-3, "{p}: {g} {n}");
    }
}

#[test]
fn what_lies_beyond_the_opening_is_taken_off() {
    let (mask, mut opening) = setup();
    // Cut far from the end and lead aside: the old tube beyond the plane must be gone.
    opening.plane.origin = Point::new(0.0, 0.0, 2.0);
    let aside = Some(Vector::new(1.2, 0.0, 1.0));
    let (f, _) = Extended::new(&Ellipse, &mask, &[opening], &[extension(None, aside)]).unwrap();
    assert!(f.value(&Point::new(0.0, 0.0, 9.0)) > 0.0);
    assert!(f.value(&Point::new(8.4, 0.0, 9.0)) < 0.0);
    assert!(f.value(&Point::new(0.0, 0.0, -3.0)) < 0.0);
}

#[test]
fn an_extension_into_the_vessel_is_refused() {
    let (mask, opening) = setup();
    let back = Some(Vector::new(1.0, 0.0, 0.2));
    let e = Extended::new(&Ellipse, &mask, &[opening.clone()], &[extension(None, back)]);
    assert!(matches!(e.err(), Some(ExtendError::Direction { .. })));
    let other = Extension { opening: "outlet_9".into(), ..extension(None, None) };
    assert!(matches!(Extended::new(&Ellipse, &mask, &[opening], &[other]).err(), Some(ExtendError::Unknown { .. })));
}

/// The elliptic tube and a vessel of radius 2 mm across its way, whose wall begins at z = 22.
struct Crossed;

impl Implicit for Crossed {
    fn value(&self, p: &Point) -> f64 {
        Ellipse.value(p).min(p.y.hypot(p.z - 24.0) - 2.0)
    }
    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let across = p.y.hypot(p.z - 24.0) - 2.0;
        let own = Ellipse.value_gradient(p);
        if own.0 < across { own } else { (across, Vector::new(0.0, p.y, p.z - 24.0).normalize()) }
    }
    fn bounds(&self) -> Aabb {
        Ellipse.bounds().union(&Aabb { min: Point::new(-9.0, -2.0, 22.0), max: Point::new(9.0, 2.0, 26.0) })
    }
    fn resolution(&self) -> f64 {
        0.25
    }
}

#[test]
fn an_extension_ends_before_the_vessel_in_its_way_or_is_refused() {
    let (mask, opening) = setup();
    let openings = [opening];
    let e = extension(None, None);
    assert!(matches!(Extended::new(&Crossed, &mask, &openings, &[e.clone()]).err(), Some(ExtendError::Collides { .. })));
    let (clear, shortened) = clear(&Crossed, &mask, &openings, &[e.clone()]).unwrap();
    assert!((6.0..11.0).contains(&clear[0].length), "{}", clear[0].length);
    assert!(shortened.len() == 1 && shortened[0].0 == 0 && (12.0..13.6).contains(&shortened[0].1), "{shortened:?}");
    assert!(Extended::new(&Crossed, &mask, &openings, &clear).is_ok());
    // What would be left is hardly an extension.
    let long = Extension { length: 60.0, ..e.clone() };
    assert!(matches!(super::clear(&Crossed, &mask, &openings, &[long]).err(), Some(ExtendError::Collides { .. })));
    let (same, none) = super::clear(&Ellipse, &mask, &openings, &[e.clone()]).unwrap();
    assert!(same == [e] && none.is_empty());
}

#[test]
fn the_wall_of_an_extension_has_no_step_at_the_old_opening() {
    let (mask, opening) = setup();
    let (f, _) = Extended::new(&Ellipse, &mask, &[opening], &[extension(Some(8.0), None)]).unwrap();
    for n in 0..24 {
        let (s, c) = (std::f64::consts::TAU * f64::from(n) / 24.0).sin_cos();
        let d = Vector::new(c, s, 0.0);
        let rays: Vec<f64> = (0..60).map(|k| cast(&f, &Point::new(0.0, 0.0, 8.5 + 0.05 * f64::from(k)), &d, 9.0).unwrap()).collect();
        // A tenth of a voxel over a tenth of a voxel's height would be a step of 45 degrees.
        assert!(rays.windows(2).all(|w| (w[1] - w[0]).abs() < 0.01), "{rays:?}");
    }
}

#[test]
fn the_axis_runs_on_to_the_new_end() {
    let (mask, opening) = setup();
    let samples = (0..=48).map(|i| {
        let z = -12.0 + 0.5 * f64::from(i);
        Sample { point: Point::new(0.0, 0.0, z), radius: 2.0, tangent: Vector::z(), arc_length: z + 12.0 }
    });
    let branch = Branch { samples: samples.collect(), nodes: [0, 1], ends: [EndKind::Free; 2], component: 0 };
    let lines = Centerlines { branches: vec![branch], nodes: vec![Point::new(0.0, 0.0, -12.0), Point::new(0.0, 0.0, 12.0)] };
    let (f, _) = Extended::new(&Ellipse, &mask, &[opening], &[extension(Some(8.0), None)]).unwrap();
    let long = f.centerlines(&lines);
    assert!((long.length() - 42.0).abs() < 0.01, "{}", long.length());
    assert!((long.nodes[1].z - 30.0).abs() < 1e-6);
    let last = long.branches[0].samples[long.branches[0].samples.len() - 1];
    assert!((last.radius - 6.0f64.sqrt()).abs() < 0.01, "a circle of the same area: {}", last.radius);
}

/// A trough: a ring's sector of 260 degrees, 1.2 mm wide, its middle 4 mm from an axis that lies in no lumen.
struct Trough;

impl Implicit for Trough {
    fn value(&self, p: &Point) -> f64 {
        let half = 130f64.to_radians();
        let angle = p.y.atan2(p.x);
        let flat = if angle.abs() <= half {
            (p.x.hypot(p.y) - 4.0).abs()
        } else {
            (p.x - 4.0 * half.cos()).hypot(p.y.abs() - 4.0 * half.sin())
        };
        (flat - 1.2).max(p.z.abs() - 12.0)
    }
    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let h = 1e-6;
        let d = |e: Vector| (self.value(&(p + e * h)) - self.value(&(p - e * h))) / (2.0 * h);
        (self.value(p), Vector::new(d(Vector::x()), d(Vector::y()), d(Vector::z())))
    }
    fn bounds(&self) -> Aabb {
        Aabb { min: Point::new(-5.2, -5.2, -12.0), max: Point::new(5.2, 5.2, 12.0) }
    }
    fn resolution(&self) -> f64 {
        0.25
    }
}

#[test]
fn a_section_that_is_no_outline_round_its_middle_is_carried_on_as_it_is() {
    let grid = Grid::new([28, 28, 60], [0.5; 3], Point::new(-6.8, -6.8, -14.8), Matrix3::identity()).unwrap();
    let voxels = (0..grid.len()).map(|n| u8::from(Trough.value(&grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)))) < 0.0));
    let mask = Mask::new(grid.clone(), voxels.collect());
    let (_, mut opening) = setup();
    opening.plane.origin = Point::new(4.0, 0.0, 10.0);
    opening.radius = 1.2;
    let leaning = Vector::new(0.2, 0.0, 1.0);
    let (f, moved) = Extended::new(&Trough, &mask, &[opening], &[extension(Some(4.0), Some(leaning))]).unwrap();
    assert!(f.tubes()[0].is_carried());
    let count = |z: f64, shift: f64| {
        (-80..80).flat_map(|i| (-80..80).map(move |j| [0.1 * f64::from(i), 0.1 * f64::from(j)])).filter(|q| f.value(&Point::new(q[0] + shift, q[1], z)) < 0.0).count()
    };
    let own = count(9.0, 0.0);
    for z in [9.8, 10.0, 10.5, 15.0, 29.0] {
        let shift = f.tubes()[0].origin_of(&Point::new(0.0, 0.0, z), z - 10.0).0.x;
        assert!((count(z, -shift) as f64 / own as f64 - 1.0).abs() < 0.002, "{} of {own} at {z}", count(z, -shift));
    }
    assert!((moved[0].plane.origin.z - 30.0).abs() < 1e-9);
    let (surface, _) = crate::polygonize::polygonize(&f, &mask, &Default::default()).unwrap();
    let topology = crate::mesh::topology::check(&surface);
    assert!(topology.is_closed_manifold() && topology.components == 1 && topology.euler == 2, "{topology:?}");
    // The gradient is that of the value.
    for p in [Point::new(4.9, 0.3, 9.9), Point::new(6.0, 0.8, 12.0), Point::new(0.6, 4.1, 10.2), Point::new(8.5, 0.5, 31.0)] {
        let (v, g) = f.value_gradient(&p);
        for e in [Vector::x(), Vector::y(), Vector::z()] {
            let d = (f.value(&(p + e * 1e-5)) - f.value(&(p - e * 1e-5))) / 2e-5;
            assert!(v.is_finite() && (d - g.dot(&e)).abs() < 1e-3, "{p:?} {d} {g:?}");
        }
    }
}
