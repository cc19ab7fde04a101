use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::*;
use crate::geometry::{Aabb, Vector};
use crate::mask::Grid;

/// Balls of one radius; the exact distance.
struct Balls {
    centers: Vec<Point>,
    radius: f64,
}

impl Implicit for Balls {
    fn value(&self, p: &Point) -> f64 {
        self.centers.iter().map(|c| (p - c).norm() - self.radius).fold(f64::INFINITY, f64::min)
    }
    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let c = self.centers.iter().min_by(|a, b| (p - *a).norm().total_cmp(&(p - *b).norm())).unwrap();
        ((p - c).norm() - self.radius, (p - c).normalize())
    }
    fn bounds(&self) -> Aabb {
        Aabb::of(&self.centers).inflated(self.radius)
    }
    fn resolution(&self) -> f64 {
        0.5
    }
}

fn digitise(f: &dyn Implicit, grid: Grid) -> Mask {
    let data = (0..grid.len())
        .map(|n| {
            let [i, j, k] = grid.voxel(n);
            u8::from(f.value(&grid.to_world(Vector::new(i as f64, j as f64, k as f64))) <= 0.0)
        })
        .collect();
    Mask::new(grid, data)
}

/// V − E + F, after checking that every edge is shared by exactly two triangles that run through it both ways.
fn euler(m: &TriMesh) -> i64 {
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for t in &m.triangles {
        for a in 0..3 {
            assert_ne!(t[a], t[(a + 1) % 3]);
            *edges.entry((t[a], t[(a + 1) % 3])).or_default() += 1;
        }
    }
    for (&(a, b), &n) in &edges {
        assert_eq!((n, edges.get(&(b, a))), (1, Some(&1)), "edge {a}-{b}");
    }
    m.points.len() as i64 - edges.len() as i64 / 2 + m.triangles.len() as i64
}

fn grid(spacing: [f64; 3], dims: [usize; 3], direction: Matrix3<f64>) -> Grid {
    Grid::new(dims, spacing, Point::new(-7.3, 4.1, 90.2), direction).unwrap()
}

#[test]
fn a_ball_comes_out_closed_oriented_and_on_the_surface_on_any_grid() {
    let turned = *nalgebra::Rotation3::from_euler_angles(0.3, -0.5, 1.1).matrix();
    let mirror = turned * Matrix3::from_diagonal(&Vector::new(1.0, 1.0, -1.0));
    for (direction, spacing) in [(Matrix3::identity(), [1.0; 3]), (turned, [0.5, 0.5, 1.5]), (mirror, [0.8, 1.0, 0.9])] {
        let g = grid(spacing, [24, 24, 20], direction);
        let c = g.to_world(Vector::new(11.8, 11.6, 9.7));
        let f = Balls { centers: vec![c], radius: 4.0 };
        let m = digitise(&f, g);
        let (s, summary) = polygonize(&f, &m, &PolygonizeOptions::default()).unwrap();
        assert_eq!(euler(&s), 2);
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 64.0;
        assert!(s.volume() < exact && s.volume() > 0.985 * exact, "{} {exact}", s.volume());
        let worst = s.points.iter().map(|p| f.value(p).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-3 * summary.cell, "{worst}");
        assert_eq!((summary.vertices, summary.triangles), (s.points.len(), s.triangles.len()));
    }
}

#[test]
fn every_component_is_found_and_bytes_do_not_depend_on_threads() {
    let g = grid([1.0; 3], [60, 20, 20], Matrix3::identity());
    let centers: Vec<Point> = [8.0, 21.0, 47.0].iter().map(|&x| g.to_world(Vector::new(x, 9.5, 9.5))).collect();
    let f = Balls { centers, radius: 5.0 };
    let m = digitise(&f, g);
    let run = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| polygonize(&f, &m, &PolygonizeOptions::default()).unwrap())
    };
    let (one, four) = (run(1), run(4));
    assert_eq!(euler(&one.0), 6);
    assert_eq!(one, four);
}

#[test]
fn the_surface_is_followed_beyond_the_mask_that_started_it() {
    // One voxel starts it; the ball is far larger.
    let g = grid([1.0; 3], [30, 30, 30], Matrix3::identity());
    let c = g.to_world(Vector::new(14.5, 14.5, 14.5));
    let f = Balls { centers: vec![c], radius: 9.0 };
    let mut m = digitise(&f, g.clone());
    m.data.iter_mut().for_each(|v| *v = 0);
    m.data[g.linear(23, 14, 14).unwrap()] = 1;
    let (s, _) = polygonize(&f, &m, &PolygonizeOptions::default()).unwrap();
    assert_eq!(euler(&s), 2);
    let (t, _) = polygonize_from(&f, &Lattice::along(&g, 0.5, 3.0), &[c + Vector::x() * 9.0], 0.0).unwrap();
    assert_eq!(s, t);
}

#[test]
fn the_offset_moves_the_wall_outwards_by_voxel_diagonals() {
    let g = grid([1.0; 3], [24, 24, 24], Matrix3::identity());
    let f = Balls { centers: vec![g.to_world(Vector::new(11.5, 11.5, 11.5))], radius: 6.0 };
    let m = digitise(&f, g);
    let (s, _) = polygonize(&f, &m, &PolygonizeOptions { cell: 0.7, offset: 0.1, ..Default::default() }).unwrap();
    for p in &s.points {
        approx::assert_abs_diff_eq!(f.value(p), 0.1 * 3f64.sqrt(), epsilon = 1e-3);
    }
}

#[test]
fn a_corner_exactly_on_the_surface_makes_no_zero_length_edge() {
    let g = Grid::new([16, 16, 16], [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
    let f = Balls { centers: vec![Point::new(8.0, 8.0, 8.0)], radius: 5.0 };
    let m = digitise(&f, g);
    let (s, _) = polygonize(&f, &m, &PolygonizeOptions { cell: 1.0, ..Default::default() }).unwrap();
    assert_eq!(euler(&s), 2);
    for t in 0..s.triangles.len() {
        let [a, b, c] = s.corners(t);
        assert!((a - b).norm().min((b - c).norm()).min((c - a).norm()) > 1e-4);
    }
}

#[test]
fn an_empty_mask_and_a_broken_function_are_named() {
    struct Broken;
    impl Implicit for Broken {
        fn value(&self, _: &Point) -> f64 {
            f64::NAN
        }
        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            (self.value(p), Vector::x())
        }
        fn bounds(&self) -> Aabb {
            Aabb { min: Point::origin(), max: Point::new(9.0, 9.0, 9.0) }
        }
        fn resolution(&self) -> f64 {
            0.5
        }
    }
    let g = grid([1.0; 3], [9, 9, 9], Matrix3::identity());
    let f = Balls { centers: vec![g.to_world(Vector::repeat(4.0))], radius: 2.0 };
    let m = digitise(&f, g.clone());
    let empty = Mask::new(g.clone(), vec![0; g.len()]);
    assert!(matches!(polygonize(&f, &empty, &PolygonizeOptions::default()), Err(PolygonizeError::NoSurface { .. })));
    assert!(matches!(polygonize(&Broken, &m, &PolygonizeOptions::default()), Err(PolygonizeError::NotFinite { .. })));
    let options = PolygonizeOptions { cell: f64::NAN, ..Default::default() };
    assert!(matches!(polygonize(&f, &m, &options), Err(PolygonizeError::Option { name: "cell", .. })));
}
