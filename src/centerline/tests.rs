use super::*;
use crate::mask::Grid;
use nalgebra::Matrix3;

/// A mask of the points where `f` is negative.
fn mask(dims: [usize; 3], spacing: [f64; 3], f: impl Fn(&Point) -> f64) -> Mask {
    let grid = Grid::new(dims, spacing, Point::new(3.0, -2.0, 1.0), Matrix3::identity()).unwrap();
    let data = (0..grid.len())
        .map(|n| {
            let [i, j, k] = grid.voxel(n).map(|c| c as f64);
            u8::from(f(&Point::from(grid.to_world(Vector::new(i, j, k)) - Vector::new(3.0, -2.0, 1.0))) < 0.0)
        })
        .collect();
    Mask::new(grid, data)
}

fn capsule(p: &Point, a: Point, b: Point, r: f64) -> f64 {
    let ab = b - a;
    let h = ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
    (p - a - ab * h).norm() - r
}

const SHIFT: Vector = Vector::new(3.0, -2.0, 1.0);

fn tube_errors(radius: f64, spacing: [f64; 3]) -> (f64, f64) {
    let (a, b) = (Point::new(7.3, 7.1, 6.4), Point::new(21.2, 19.7, 25.9));
    let dims = [28.0, 27.0, 33.0];
    let n = [0, 1, 2].map(|c| (dims[c] / spacing[c]) as usize);
    let m = mask(n, spacing, |p| capsule(p, a, b, radius));
    let (lines, summary) = trace(&m, &CenterlineOptions::default()).unwrap();
    assert_eq!((summary.branches, summary.free_ends, summary.loops), (1, 2, 0));
    let d = (b - a).normalize();
    let mut worst = (0.0f64, 0.0f64);
    for s in &lines.branches[0].samples {
        let w = s.point - SHIFT - a;
        let t = w.dot(&d);
        if t > 0.0 && t < (b - a).norm() {
            worst.0 = worst.0.max((w - d * t).norm());
            worst.1 = worst.1.max((s.radius / radius - 1.0).abs());
        }
    }
    assert!((lines.length() - (b - a).norm() - 2.0 * radius).abs() < 1.5);
    worst
}

#[test]
fn a_tilted_tube_of_eight_voxels_is_followed_within_a_third_of_a_voxel_and_three_percent() {
    let (off, radius) = tube_errors(4.0, [1.0; 3]);
    assert!(off < 0.3 && radius < 0.03, "{off} {radius}");
}

#[test]
fn a_tilted_tube_of_four_voxels_is_followed_within_a_third_of_a_voxel_and_six_percent() {
    let (off, radius) = tube_errors(2.0, [1.0; 3]);
    assert!(off < 0.3 && radius < 0.06, "{off} {radius}");
}

#[test]
fn an_anisotropic_tube_is_followed() {
    let (off, radius) = tube_errors(4.0, [0.8, 1.0, 2.0]);
    assert!(off < 0.3 && radius < 0.05, "{off} {radius}");
}

#[test]
fn a_thin_tube_of_two_voxels_keeps_its_length() {
    let (off, _) = tube_errors(1.0, [1.0; 3]);
    assert!(off < 0.5, "{off}");
}

#[test]
fn a_flat_end_has_one_tip() {
    let m = mask([70, 44, 44], [1.0; 3], |p| {
        let r = ((p.y - 21.3).powi(2) + (p.z - 21.6).powi(2)).sqrt() - 15.0;
        r.max(4.5 - p.x).max(p.x - 64.5)
    });
    let (lines, summary) = trace(&m, &CenterlineOptions::default()).unwrap();
    assert_eq!((summary.branches, summary.free_ends), (1, 2));
    for s in &lines.branches[0].samples {
        let off = ((s.point.y + 2.0 - 21.3).powi(2) + (s.point.z - 1.0 - 21.6).powi(2)).sqrt();
        assert!(off < 0.5, "{off} at {}", s.point);
        assert!((s.radius - 15.0).abs() < 0.5, "{}", s.radius);
    }
    assert!((lines.length() - 60.0).abs() < 1.5, "{}", lines.length());
}

#[test]
fn a_bifurcation_has_three_branches_and_one_group() {
    let o = Point::new(20.0, 12.0, 20.0);
    let m = mask([42, 26, 46], [1.0; 3], |p| {
        [(Point::new(20.2, 12.1, 5.0), 4.0), (Point::new(33.0, 12.6, 36.0), 3.0), (Point::new(8.0, 12.4, 38.0), 2.5)]
            .iter()
            .map(|(e, r)| capsule(p, o, *e, *r))
            .fold(f64::INFINITY, f64::min)
    });
    let (lines, summary) = trace(&m, &CenterlineOptions::default()).unwrap();
    assert_eq!((summary.branches, summary.free_ends, summary.junctions, summary.loops), (3, 3, 1, 0));
    assert_eq!(lines.groups().iter().flatten().count(), 1);
    let node = lines.nodes[lines.degrees().iter().position(|&d| d == 3).unwrap()] - SHIFT;
    assert!((node - o).norm() < 3.0, "{node}");
}

#[test]
fn a_ring_with_a_side_branch_keeps_its_loop() {
    let ring = |p: &Point| {
        let w = p - Point::new(20.3, 20.1, 8.2);
        (w.xy().norm() - 12.0).hypot(w.z) - 3.0
    };
    let m = mask([50, 42, 18], [1.0; 3], ring);
    let (lines, summary) = trace(&m, &CenterlineOptions::default()).unwrap();
    assert_eq!((summary.branches, summary.free_ends, summary.loops), (1, 0, 1));
    assert!((lines.length() - std::f64::consts::TAU * 12.0).abs() < 1.5, "{}", lines.length());
    let m = mask([50, 42, 18], [1.0; 3], |p| {
        ring(p).min(capsule(p, Point::new(32.0, 20.0, 8.0), Point::new(44.0, 20.0, 8.0), 2.5))
    });
    let (_, summary) = trace(&m, &CenterlineOptions::default()).unwrap();
    assert_eq!((summary.branches, summary.free_ends, summary.loops), (2, 1, 1));
}

#[test]
fn noise_bumps_are_no_branches() {
    let m = mask([60, 30, 30], [1.0; 3], |p| {
        let tube = capsule(p, Point::new(10.0, 15.0, 15.0), Point::new(50.0, 15.0, 15.0), 6.0);
        let bump = (p - Point::new(30.0, 21.5, 15.0)).norm() - 2.0;
        tube.min(bump)
    });
    let (_, summary) = trace(&m, &CenterlineOptions::default()).unwrap();
    assert_eq!(summary.branches, 1);
}

#[test]
fn an_empty_mask_is_refused() {
    let m = mask([5, 5, 5], [1.0; 3], |_| 1.0);
    assert_eq!(trace(&m, &CenterlineOptions::default()).unwrap_err(), Error::Empty);
}

#[test]
fn the_implicit_centres_a_thin_tube_exactly() {
    struct Tube;
    impl crate::implicit::Implicit for Tube {
        fn value(&self, p: &Point) -> f64 {
            let w = p - SHIFT;
            (w.y - 8.13).hypot(w.z - 8.37) - 2.0
        }
        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            let w = p - SHIFT;
            (self.value(p), Vector::new(0.0, w.y - 8.13, w.z - 8.37).normalize())
        }
        fn bounds(&self) -> crate::geometry::Aabb {
            crate::geometry::Aabb::EMPTY
        }
        fn resolution(&self) -> f64 {
            0.5
        }
    }
    let m = mask([40, 16, 16], [1.0; 3], |p| capsule(p, Point::new(5.0, 8.13, 8.37), Point::new(34.0, 8.13, 8.37), 2.0));
    let (mut lines, _) = trace(&m, &CenterlineOptions::default()).unwrap();
    refine(&mut lines, &Tube);
    let b = &lines.branches[0];
    for s in b.samples.iter().filter(|s| s.arc_length > 4.0 && s.arc_length < b.length() - 4.0) {
        let w = s.point - SHIFT;
        assert!((w.y - 8.13).hypot(w.z - 8.37) < 0.02, "{w}");
        assert!((s.radius - 2.0).abs() < 0.01, "{}", s.radius);
    }
}
