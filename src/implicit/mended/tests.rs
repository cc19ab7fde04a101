//! What a mended function promises.

use super::*;
use crate::implicit::guard::GuardOptions;
use crate::mask::Mask;
use crate::mesh::topology::check;
use crate::polygonize::{PolygonizeOptions, polygonize};

/// Two tubes along x, 7 mm apart, each of radius 2.5 and thicker by `swelling` near x = 0.
struct Tubes {
    swelling: f64,
}

impl Tubes {
    fn mask(&self) -> Mask {
        let grid = Grid::new([31, 17, 11], [1.0; 3], Point::new(-15.0, -8.0, -5.0), Matrix3::identity()).expect("a grid");
        let inside = |n: usize| self.value(&grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)))) < 0.0;
        let data = (0..grid.len()).map(|n| u8::from(inside(n))).collect();
        Mask::new(grid, data)
    }
}

impl Implicit for Tubes {
    fn value(&self, p: &Point) -> f64 {
        let r = 2.5 + self.swelling * (-p.x * p.x / 4.0).exp();
        ((p.y.abs() - 3.5).hypot(p.z) - r).max(p.x.abs() - 12.0)
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let h = 1e-6;
        let d = |a: usize| (self.value(&(p + Vector::ith(a, h))) - self.value(&(p - Vector::ith(a, h)))) / (2.0 * h);
        (self.value(p), Vector::new(d(0), d(1), d(2)))
    }

    fn bounds(&self) -> Aabb {
        Aabb::of(&[Point::new(-13.0, -8.0, -5.0), Point::new(13.0, 8.0, 5.0)])
    }

    fn resolution(&self) -> f64 {
        0.5
    }
}

/// A function that lets two tubes meet which its mask holds apart, drawn towards the mask's band `steps` times.
fn drawn(steps: usize) -> (Mask, Mended<Tubes>) {
    let mask = Tubes { swelling: 0.0 }.mask();
    let boundary = MaskBoundary::new(&mask, &GuardOptions::default()).expect("a boundary");
    let bridge: Vec<[i64; 3]> = (0..9 * 5 * 7).map(|n| [11 + n % 9, 6 + n / 9 % 5, 2 + n / 45]).collect();
    let f = Mended::towards(Tubes { swelling: 1.3 }, &mask.grid, &boundary, &bridge, steps);
    (mask, f)
}

#[test]
fn tubes_that_met_come_apart_and_nothing_else_changes() {
    let (mask, before) = drawn(0);
    let parts = |f: &dyn Implicit| check(&polygonize(f, &mask, &PolygonizeOptions::default()).expect("a surface").0).components;
    assert_eq!(parts(&before), 1);
    let (_, after) = drawn(12);
    assert_eq!(parts(&after), 2);
    for p in [Point::new(0.0, 6.0, 1.0), Point::new(-9.0, 3.0, 2.0), Point::new(5.5, 0.0, 0.0)] {
        assert_eq!(after.value(&p), before.value(&p), "{p}");
    }
}

#[test]
fn gradients_and_values_on_a_lattice_are_those_of_the_value() {
    let (_, f) = drawn(6);
    let h = 1e-5;
    let mut felt = 0;
    for n in 0..200 {
        let p = Point::new(-1.0 + 0.01 * f64::from(n), 0.3 - 0.002 * f64::from(n), -0.8 + 0.008 * f64::from(n));
        let (c, g) = f.correction(&p).expect("a correction");
        let value = |q: Point| f.correction(&q).map_or(0.0, |c| c.0);
        let slope = Vector::from_fn(|a, _| (value(p + Vector::ith(a, h)) - value(p - Vector::ith(a, h))) / (2.0 * h));
        assert!((slope - g).norm() < 1e-6, "{p}: {slope} {g}");
        felt += usize::from(c.abs() > 0.05);
    }
    assert!(felt > 100, "{felt}");
    let lattice = Mended { inner: Flat, grid: f.grid, nodes: f.nodes, coefficients: f.coefficients, blocks: f.blocks, bounds: f.bounds };
    for origin in [-2.0, 40.0] {
        let (origin, steps) = (Point::new(origin, -2.0, -2.0), Matrix3::from_diagonal_element(0.4));
        let mut out = vec![0.0; 1000];
        assert!(lattice.values_on(&origin, &steps, [1, 2, 3], 10, &mut out));
        for (n, v) in out.iter().enumerate() {
            let c = [1 + n % 10, 2 + n / 10 % 10, 3 + n / 100].map(|c| c as f64);
            let p = origin + 0.4 * Vector::from(c);
            assert!((v - lattice.value(&p)).abs() < 1e-12, "{p}");
        }
        assert_eq!(out.iter().any(|v| *v != 1.0), origin.x < 0.0);
    }
}

/// 1 everywhere, on lattices too.
struct Flat;

impl Implicit for Flat {
    fn value(&self, _: &Point) -> f64 {
        1.0
    }

    fn value_gradient(&self, _: &Point) -> (f64, Vector) {
        (1.0, Vector::zeros())
    }

    fn bounds(&self) -> Aabb {
        Aabb::EMPTY
    }

    fn resolution(&self) -> f64 {
        0.5
    }

    fn values_on(&self, _: &Point, _: &Matrix3<f64>, _: [i32; 3], _: usize, out: &mut [f64]) -> bool {
        out.fill(1.0);
        true
    }
}
