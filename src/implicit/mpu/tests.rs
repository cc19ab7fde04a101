//! Shapes with exact answers.

use super::*;

fn sphere(r: f64, pitch: f64) -> OrientedPoints {
    // Spiral of equal areas.
    let n = (4.0 * std::f64::consts::PI * r * r / (pitch * pitch)) as usize;
    let mut cloud = OrientedPoints::default();
    for i in 0..n {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
        let a = i as f64 * 2.399_963_229_728_653;
        let d = Vector::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z);
        cloud.points.push(Point::from(d * r));
        cloud.normals.push(d);
        cloud.pitch.push(pitch);
    }
    cloud
}

fn options(tolerance: f64, pitch: f64) -> MpuOptions {
    MpuOptions { support: 0.75, min_points: 15, tolerance, reference_pitch: pitch, leaf_pitches: 2.0, max_points: 4096 }
}

#[test]
fn a_plane_is_met_exactly_with_a_unit_gradient() {
    let n = Vector::new(0.3, -0.5, 0.8).normalize();
    let plane = crate::geometry::Plane::new(Point::new(1.0, 2.0, 3.0), n).unwrap();
    let (u, v) = plane.basis();
    let mut cloud = OrientedPoints::default();
    for i in -10..=10 {
        for j in -10..=10 {
            cloud.points.push(plane.origin + u * f64::from(i) + v * f64::from(j));
            cloud.normals.push(n);
            cloud.pitch.push(1.0);
        }
    }
    let (f, summary) = fit(&cloud, &options(0.1, 1.0)).unwrap();
    for (a, b, h) in [(0.3, 0.2, 0.0), (3.7, -6.1, 1.2), (-8.0, 2.5, -0.9)] {
        let p = plane.origin + u * a + v * b + n * h;
        let (value, gradient) = f.value_gradient(&p);
        approx::assert_relative_eq!(value, h, epsilon = 1e-9);
        approx::assert_relative_eq!(gradient, n, epsilon = 1e-8);
    }
    assert_eq!(summary.over_tolerance, 0);
}

#[test]
fn a_sphere_is_met_within_the_tolerance_and_better_with_a_smaller_one() {
    let cloud = sphere(8.0, 0.8);
    let worst = |tolerance| {
        let (f, summary) = fit(&cloud, &options(tolerance, 0.8)).unwrap();
        let probe = sphere(8.0, 0.53);
        let worst = probe.points.iter().map(|p| f.value(p).abs()).fold(0.0, f64::max);
        let turned = probe.points.iter().zip(&probe.normals).map(|(p, n)| f.gradient(p).angle(n).to_degrees()).fold(0.0, f64::max);
        (worst, turned, summary.leaves)
    };
    let (loose, _, few) = worst(0.5);
    let (tight, turned, many) = worst(0.01);
    assert!(loose < 0.5 && tight < 0.01, "{loose} {tight}");
    assert!(turned < 2.0, "{turned}");
    assert!(many > few, "{few} {many}");
}

#[test]
fn the_gradient_is_the_derivative_of_the_value() {
    let (f, _) = fit(&sphere(6.0, 1.0), &options(0.05, 1.0)).unwrap();
    for p in [Point::new(5.2, 2.1, 1.3), Point::new(-0.4, 5.5, -3.0), Point::new(0.1, 0.2, -6.4), Point::new(9.0, 2.0, 30.0)] {
        let g = f.gradient(&p);
        for a in 0..3 {
            let mut e = Vector::zeros();
            e[a] = 1e-5;
            let d = (f.value(&(p + e)) - f.value(&(p - e))) / 2e-5;
            approx::assert_relative_eq!(g[a], d, epsilon = 1e-4);
        }
    }
}

#[test]
fn a_thin_tube_gets_general_quadrics_and_is_negative_on_its_axis() {
    // Radius 0.9 pitches: every ball sees normals of all directions.
    let mut cloud = OrientedPoints::default();
    for k in 0..60 {
        for a in 0..8 {
            let t = std::f64::consts::TAU * (f64::from(a) + 0.5 * f64::from(k % 2)) / 8.0;
            let n = Vector::new(t.cos(), t.sin(), 0.0);
            cloud.points.push(Point::from(n * 0.9 + Vector::z() * (0.5 * f64::from(k))));
            cloud.normals.push(n);
            cloud.pitch.push(0.6);
        }
    }
    let (f, summary) = fit(&cloud, &options(0.2, 0.6)).unwrap();
    assert!(summary.general > 0, "{summary:?}");
    for k in 12..48 {
        let z = 0.5 * f64::from(k) + 0.1;
        assert!(f.value(&Point::new(0.0, 0.0, z)) < 0.0);
        for a in 0..12 {
            let t = std::f64::consts::TAU * f64::from(a) / 12.0;
            let (v, g) = f.value_gradient(&Point::new(0.9 * t.cos(), 0.9 * t.sin(), z));
            let v = v / g.norm();
            // The tolerance of 0.2 is Taubin's first-order distance at the points; between them it is a third more.
            assert!(v.abs() < 0.3, "{v} at {z}");
        }
    }
}

#[test]
fn scale_does_not_matter() {
    let cloud = sphere(8.0, 1.0);
    let mut metres = cloud.clone();
    metres.points.iter_mut().for_each(|p| *p *= 1e-3);
    metres.pitch.iter_mut().for_each(|p| *p *= 1e-3);
    let (f, s) = fit(&cloud, &options(0.05, 1.0)).unwrap();
    let (g, t) = fit(&metres, &options(0.05e-3, 1e-3)).unwrap();
    assert_eq!(s.leaves, t.leaves);
    let p = Point::new(5.0, 4.0, 4.5);
    approx::assert_relative_eq!(f.value(&p), 1e3 * g.value(&(p * 1e-3)), epsilon = 1e-9);
}

#[test]
fn too_few_points_and_bad_options_are_told() {
    let few = OrientedPoints { points: vec![Point::origin(); 3], normals: vec![Vector::x(); 3], pitch: vec![1.0; 3] };
    assert!(matches!(fit(&few, &options(0.1, 1.0)), Err(MpuError::TooFewPoints { found: 3, needed: 15 })));
    let mut broken = sphere(5.0, 1.0);
    broken.points[7].x = f64::NAN;
    assert_eq!(fit(&broken, &options(0.1, 1.0)).err(), Some(MpuError::NotFinite(7)));
    assert!(matches!(fit(&sphere(5.0, 1.0), &options(0.0, 1.0)), Err(MpuError::Option { .. })));
}
