//! What the guard promises, on functions that break every promise.

use nalgebra::Matrix3;

use super::*;
use crate::mesh::topology::check;
use crate::polygonize::{PolygonizeOptions, polygonize};

fn mask(dims: [usize; 3], lumen: impl Fn([i64; 3]) -> bool) -> Mask {
    let grid = Grid::new(dims, [0.5, 0.5, 0.5], Point::new(3.0, -2.0, 1.0), Matrix3::identity()).unwrap();
    let data = (0..grid.len()).map(|n| u8::from(lumen(grid.voxel(n).map(|c| c as i64)))).collect();
    Mask::new(grid, data)
}

/// The same value everywhere.
struct Constant(f64);

impl Implicit for Constant {
    fn value(&self, _: &Point) -> f64 {
        self.0
    }
    fn value_gradient(&self, _: &Point) -> (f64, Vector) {
        (self.0, Vector::zeros())
    }
    fn bounds(&self) -> Aabb {
        Aabb::EMPTY
    }
    fn resolution(&self) -> f64 {
        0.25
    }
}

fn guarded(f: f64, mask: &Mask) -> Guarded<Constant> {
    Guarded::new(Constant(f), MaskBoundary::new(mask, &GuardOptions::default()).unwrap())
}

#[test]
fn nothing_vanishes_and_nothing_bulges_whatever_the_function_says() {
    // A thick part with a branch one voxel wide.
    let m = mask([16, 12, 12], |[i, j, k]| {
        ((2..7).contains(&i) && (3..8).contains(&j) && (3..8).contains(&k)) || (j == 5 && k == 5 && (7..14).contains(&i))
    });
    for f in [-1e3, -0.1, 0.0, 0.1, 1e3, f64::NAN] {
        let g = guarded(f, &m);
        for n in 0..m.grid.len() {
            let v = m.grid.voxel(n).map(|c| c as i64);
            let p = m.grid.to_world(Vector::from(v.map(|c| c as f64)));
            let same = (-1..=1).all(|a| (-1..=1).all(|b| (-1..=1).all(|c| m.at(v[0] + a, v[1] + b, v[2] + c) == m.at(v[0], v[1], v[2]))));
            let thin = v[0] > 8;
            if same || thin {
                assert_eq!(g.value(&p) < 0.0, m.at(v[0], v[1], v[2]), "{f} at {v:?}");
            }
        }
        let (mesh, _) = polygonize(&g, &m, &PolygonizeOptions { cell: 0.4, ..Default::default() }).unwrap();
        let report = check(&mesh);
        assert!(report.is_closed_manifold());
        assert_eq!((report.components, report.euler), (1, 2), "{f}");
        let farthest = mesh.points.iter().map(|p| g.boundary().signed_distance(p).0.abs()).fold(0.0, f64::max);
        assert!(farthest <= g.boundary().widest_band() * 1.01, "{f} {farthest}");
    }
}

#[test]
fn vessels_one_voxel_apart_do_not_merge() {
    let m = mask([20, 13, 9], |[i, j, k]| (2..18).contains(&i) && (3..6).contains(&k) && ((2..6).contains(&j) || (7..11).contains(&j)));
    for f in [-10.0, 10.0] {
        let (mesh, _) = polygonize(&guarded(f, &m), &m, &PolygonizeOptions::default()).unwrap();
        let report = check(&mesh);
        assert_eq!((report.components, report.euler), (2, 4), "{f}");
    }
}

#[test]
fn a_function_within_the_band_is_left_alone() {
    let m = mask([24, 24, 24], |v| v.iter().map(|c| (*c as f64 - 11.3).powi(2)).sum::<f64>() < 64.0);
    struct Ball(Point);
    impl Implicit for Ball {
        fn value(&self, p: &Point) -> f64 {
            (p - self.0).norm() - 4.0
        }
        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            (self.value(p), (p - self.0).normalize())
        }
        fn bounds(&self) -> Aabb {
            Aabb::EMPTY
        }
        fn resolution(&self) -> f64 {
            0.25
        }
    }
    let center = m.grid.to_world(Vector::repeat(11.3));
    let g = Guarded::new(Ball(center), MaskBoundary::new(&m, &GuardOptions::default()).unwrap());
    let mut touched = 0;
    let n = 2000;
    for i in 0..n {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(n);
        let a = f64::from(i) * 2.399_963_229_728_653;
        let d = Vector::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z);
        touched += usize::from(g.intervenes(&(center + d * 4.0)));
    }
    assert_eq!(touched, 0, "the true wall lies within the band everywhere");
}

#[test]
fn no_sheet_stands_far_off_where_voxels_are_six_times_as_long_as_wide() {
    let grid = Grid::new([26, 26, 9], [0.5, 0.5, 3.0], Point::origin(), Matrix3::identity()).unwrap();
    let data = (0..grid.len())
        .map(|n| {
            let v = grid.voxel(n).map(|c| c as i64);
            u8::from((9..17).contains(&v[0]) && (9..17).contains(&v[1]) && (3..6).contains(&v[2]))
        })
        .collect();
    let m = Mask::new(grid, data);
    let g = guarded(-1e3, &m);
    for n in 0..m.grid.len() {
        let p = m.grid.to_world(Vector::from(m.grid.voxel(n).map(|c| c as f64)));
        let (d, _) = g.boundary().signed_distance(&p);
        assert!(g.value(&p) > 0.0 || d <= g.boundary().widest_band(), "{p} is {d} mm away");
    }
    let (mesh, _) = polygonize(&g, &m, &PolygonizeOptions { cell: 1.0, ..Default::default() }).unwrap();
    assert_eq!((check(&mesh).components, check(&mesh).euler), (1, 2));
}

#[test]
fn no_lumen_no_boundary() {
    assert!(MaskBoundary::new(&mask([3, 3, 3], |_| false), &GuardOptions::default()).is_none());
}

#[test]
fn the_narrowest_guard_leaves_the_masks_own_topology() {
    // A plate with a hole one voxel wide, a rod one voxel beside it, and stairs.
    let m = mask([18, 14, 12], |[i, j, k]| {
        let plate = (2..9).contains(&i) && (2..10).contains(&j) && (3..6).contains(&k) && !(i == 5 && j == 6);
        let rod = j == 6 && k == 7 && (2..15).contains(&i);
        let stairs = (11..16).contains(&i) && (2..5).contains(&j) && (2..=i - 8).contains(&k);
        plate || rod || stairs
    });
    let wanted = crate::mask::topology(&m);
    let guards: Vec<GuardOptions> = GuardOptions::default().narrower().collect();
    assert!(guards.windows(2).all(|g| g[1].band < g[0].band && g[1].share < g[0].share));
    let boundary = MaskBoundary::new(&m, guards.last().unwrap()).unwrap();
    for all in [-9.0, 9.0] {
        let (mesh, _) = polygonize(&Guarded::new(Constant(all), boundary.clone()), &m, &PolygonizeOptions { cell: 0.5, ..Default::default() }).unwrap();
        let report = check(&mesh);
        assert!(report.is_closed_manifold());
        assert_eq!((report.components, report.euler), (wanted.components, 2 * wanted.euler), "{all}");
    }
}
