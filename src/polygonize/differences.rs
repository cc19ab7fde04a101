//! Where two polygonizations on one lattice differ, and what each difference does to the topology.

use std::collections::{BTreeMap, BTreeSet};

use crate::geometry::{Point, Vector};
use crate::mask::Grid;
use crate::mesh::TriMesh;

/// Vertices nearer than this, in smallest voxel spacings, are the same one: a root is found to a ten-thousandth of a cell.
const SAME: f64 = 0.01;

/// A place at which two surfaces differ.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Voxels round what differs, ascending by z, y, x.
    pub voxels: Vec<[i64; 3]>,
    /// By how much the second surface's Euler number is larger for what differs here. The sum over all places is the
    /// difference of the two surfaces' Euler numbers where common vertices bear the same triangles in both: a hint, to be held
    /// against the whole.
    pub euler: i64,
}

/// The places at which `a` and `b` differ, both polygonized on one lattice along the axes of `grid`; each holds what
/// differs and `grow` voxels round it, and those that touch are one.
pub fn differences(a: &TriMesh, b: &TriMesh, grid: &Grid, grow: i64) -> Vec<Difference> {
    let least = grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    let only = [unmatched(a, b, least), unmatched(b, a, least)];
    let voxel = |p: &Point| -> [i64; 3] { grid.to_index(p).map(|x| x.round() as i64).into() };
    let reach: Vec<[i64; 3]> = {
        let side = -grow..=grow;
        side.clone().flat_map(|z| side.clone().flat_map(move |y| (-grow..=grow).map(move |x| [z, y, x]))).collect()
    };
    // By z, y, x, as the voxels lie in the mask.
    let mut voxels: BTreeSet<[i64; 3]> = BTreeSet::new();
    for (mesh, only) in [a, b].into_iter().zip(&only) {
        for p in mesh.points.iter().zip(only).filter(|(_, only)| **only).map(|(p, _)| p) {
            let [x, y, z] = voxel(p);
            voxels.extend(reach.iter().map(|[k, j, i]| [z + k, y + j, x + i]));
        }
    }
    let mut place: BTreeMap<[i64; 3], usize> = BTreeMap::new();
    let mut found: Vec<Difference> = Vec::new();
    for &start in &voxels {
        if place.contains_key(&start) {
            continue;
        }
        let (mut own, mut todo) = (Vec::new(), vec![start]);
        place.insert(start, found.len());
        while let Some(v) = todo.pop() {
            own.push(v);
            for n in 0..27 {
                let w = [v[0] + n / 9 - 1, v[1] + n / 3 % 3 - 1, v[2] + n % 3 - 1];
                if voxels.contains(&w) && !place.contains_key(&w) {
                    place.insert(w, found.len());
                    todo.push(w);
                }
            }
        }
        own.sort_unstable();
        found.push(Difference { voxels: own.into_iter().map(|[z, y, x]| [x, y, z]).collect(), euler: 0 });
    }
    // Vertices less edges plus triangles of what only one of them has, twice, since each edge is met from both sides.
    let mut twice = vec![0i64; found.len()];
    for ((mesh, only), sign) in [a, b].into_iter().zip(&only).zip([-1, 1]) {
        let at = |v: u32| {
            let [x, y, z] = voxel(&mesh.points[v as usize]);
            place.get(&[z, y, x]).copied()
        };
        for v in (0..mesh.points.len() as u32).filter(|&v| only[v as usize]) {
            at(v).into_iter().for_each(|n| twice[n] += 2 * sign);
        }
        for t in &mesh.triangles {
            let Some(n) = t.iter().find(|&&v| only[v as usize]).and_then(|&v| at(v)) else { continue };
            let edges = (0..3).filter(|&i| only[t[i] as usize] || only[t[(i + 1) % 3] as usize]).count();
            twice[n] += sign * (2 - edges as i64);
        }
    }
    found.iter_mut().zip(twice).for_each(|(d, twice)| d.euler = twice / 2);
    found
}

/// Which vertices of `mesh` have none of `other` at their place.
fn unmatched(mesh: &TriMesh, other: &TriMesh, least: f64) -> Vec<bool> {
    let (pitch, near) = (0.25 * least, SAME * least);
    let key = |p: Vector| -> [i64; 3] { p.map(|x| (x / pitch).floor() as i64).into() };
    let mut table: Vec<([i64; 3], u32)> = other.points.iter().enumerate().map(|(v, p)| (key(p.coords), v as u32)).collect();
    table.sort_unstable();
    let at = |k: [i64; 3]| table[table.partition_point(|e| e.0 < k)..].iter().take_while(move |e| e.0 == k).map(|e| e.1);
    let holds = |p: &Point| {
        let (low, high) = (key(p.coords.add_scalar(-near)), key(p.coords.add_scalar(near)));
        (0..8).filter(|c| (0..3).all(|a| c >> a & 1 == 0 || low[a] != high[a])).any(|c| {
            let k = std::array::from_fn(|a| if c >> a & 1 == 0 { low[a] } else { high[a] });
            at(k).any(|v| (other.points[v as usize] - p).norm() <= near)
        })
    };
    mesh.points.iter().map(|p| !holds(p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implicit::Implicit;
    use crate::mesh::topology::check;
    use crate::polygonize::PolygonizeOptions;

    /// A ball of radius 6, with a tunnel along x at y = 2 where `tunnel`, and a dent at the other side where `dent`.
    struct Ball {
        tunnel: bool,
        dent: bool,
    }

    impl Implicit for Ball {
        fn value(&self, p: &Point) -> f64 {
            let mut f = p.coords.norm() - 6.0;
            if self.tunnel {
                f = f.max(1.0 - (p.y - 2.0).hypot(p.z));
            }
            if self.dent {
                f = f.max(2.0 - (p - Point::new(0.0, -6.0, 0.0)).norm());
            }
            f
        }

        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            let h = 1e-6;
            let d = |a: usize| {
                let e = Vector::ith(a, h);
                (self.value(&(p + e)) - self.value(&(p - e))) / (2.0 * h)
            };
            (self.value(p), Vector::new(d(0), d(1), d(2)))
        }

        fn bounds(&self) -> crate::geometry::Aabb {
            crate::geometry::Aabb::of(&[Point::new(-7.0, -7.0, -7.0), Point::new(7.0, 7.0, 7.0)])
        }

        fn resolution(&self) -> f64 {
            0.5
        }
    }

    fn surface(ball: &Ball) -> TriMesh {
        let grid = Grid::new([16; 3], [1.0; 3], Point::new(-7.5, -7.5, -7.5), nalgebra::Matrix3::identity()).expect("a grid");
        let inside = |n: usize| ball.value(&grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)))) < 0.0;
        let data = (0..grid.len()).map(|n| u8::from(inside(n))).collect();
        let seed = crate::mask::Mask::new(grid, data);
        crate::polygonize::polygonize(ball, &seed, &PolygonizeOptions::default()).expect("a surface").0
    }

    #[test]
    fn a_tunnel_counts_two_and_a_dent_nothing() {
        let grid = Grid::new([16; 3], [1.0; 3], Point::new(-7.5, -7.5, -7.5), nalgebra::Matrix3::identity()).expect("a grid");
        let (plain, both) = (surface(&Ball { tunnel: false, dent: false }), surface(&Ball { tunnel: true, dent: true }));
        assert_eq!((check(&plain).euler, check(&both).euler), (2, 0));
        let found = differences(&plain, &both, &grid, 1);
        let at = |y: f64| found.iter().find(|d| d.voxels.iter().any(|v| grid.to_world(Vector::from(v.map(|x| x as f64))).y * y > 5.0)).expect("a place").euler;
        assert_eq!(found.iter().map(|d| d.euler).sum::<i64>(), -2, "{found:?}");
        assert_eq!(at(-1.0), 0, "the dent");
        assert!(differences(&plain, &plain, &grid, 1).is_empty());
    }
}
