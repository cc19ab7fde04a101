//! Shapes for tests.

use std::collections::BTreeMap;

use super::TriMesh;
use crate::geometry::{Point, Vector};

/// A sphere from an octahedron whose edges are cut `n` times; 8 n² triangles, vertices on the sphere.
pub fn sphere(center: Point, radius: f64, n: u32) -> TriMesh {
    let mut ids: BTreeMap<[i32; 3], u32> = BTreeMap::new();
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    let n = n as i32;
    for s in 0..8 {
        let sign = [0, 1, 2].map(|a| if s >> a & 1 == 0 { 1 } else { -1 });
        let mut vertex = |i: i32, j: i32| {
            let k = [i * sign[0], j * sign[1], (n - i - j) * sign[2]];
            *ids.entry(k).or_insert_with(|| {
                let v = Vector::new(f64::from(k[0]), f64::from(k[1]), f64::from(k[2]));
                points.push(center + v.normalize() * radius);
                points.len() as u32 - 1
            })
        };
        for i in 0..n {
            for j in 0..n - i {
                let mut put = |mut t: [u32; 3]| {
                    if sign.iter().product::<i32>() < 0 {
                        t.swap(1, 2);
                    }
                    triangles.push(t);
                };
                put([vertex(i, j), vertex(i + 1, j), vertex(i, j + 1)]);
                if i + j < n - 1 {
                    put([vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)]);
                }
            }
        }
    }
    TriMesh::new(points, triangles)
}

/// A repeatable vector in the cube of side 1 round the origin.
pub fn grid_noise(i: u32) -> Vector {
    let h = |k: u32| {
        let mut x = i.wrapping_mul(0x9E37_79B9) ^ k.wrapping_mul(0x85EB_CA6B);
        x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
        x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
        f64::from(x ^ (x >> 16)) / f64::from(u32::MAX) - 0.5
    };
    Vector::new(h(1), h(2), h(3))
}
