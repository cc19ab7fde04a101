//! Marching cubes of the binary mask: the reference that fidelity is measured against.

use std::sync::OnceLock;

use rayon::prelude::*;

use crate::geometry::{Point, Vector};
use crate::mask::Mask;
use crate::mesh::TriMesh;

/// The marching cubes surface of the mask at isovalue 0.5 (Lorensen and Cline 1987).
///
/// Its vertices are the midpoints between neighbouring voxel centres of different value, as in VTK and scikit-image.
/// Where a face of four voxel centres is ambiguous the two lumen voxels are kept apart. What lies outside the image is
/// background, so the surface is closed; it is oriented outwards and every edge has an even number of triangles:
/// two, save where lumen voxels meet at an edge only. Vertices and triangles come in lattice order.
pub fn marching_cubes(mask: &Mask) -> TriMesh {
    let Some((low, high)) = lumen_box(mask) else { return TriMesh::new(Vec::new(), Vec::new()) };
    let lattice = Lattice { mask, low: low.map(|v| v - 1), dims: [0, 1, 2].map(|a| (high[a] - low[a] + 3) as usize) };
    let layers: Vec<Vec<u32>> = (0..lattice.dims[2]).into_par_iter().map(|k| lattice.cut_edges(k)).collect();
    let mut first = vec![0u32];
    for l in &layers {
        first.push(first[first.len() - 1] + l.len() as u32);
    }
    let points: Vec<Point> = layers
        .par_iter()
        .enumerate()
        .flat_map_iter(|(k, l)| l.iter().map(move |&e| (k, e)))
        .map(|(k, e)| lattice.position(k, e))
        .collect();
    let flip = mask.grid.is_left_handed();
    let edges = 3 * lattice.dims[0] * lattice.dims[1];
    let triangles: Vec<[u32; 3]> = (0..lattice.dims[2] - 1)
        .into_par_iter()
        .map_init(
            || [vec![0u32; edges], vec![0u32; edges]],
            |ids, k| {
                for s in 0..2 {
                    for (n, &e) in layers[k + s].iter().enumerate() {
                        ids[s][e as usize] = first[k + s] + n as u32;
                    }
                }
                let mut out = Vec::new();
                if layers[k].is_empty() && layers[k + 1].is_empty() {
                    return out;
                }
                lattice.triangles(k, ids, |[a, b, c]| out.push(if flip { [a, c, b] } else { [a, b, c] }));
                out
            },
        )
        .flatten_iter()
        .collect();
    TriMesh::new(points, triangles)
}

/// First and last index of lumen along each axis.
fn lumen_box(mask: &Mask) -> Option<([i64; 3], [i64; 3])> {
    let [nx, ny, _] = mask.grid.dims;
    let empty = ([i64::MAX; 3], [i64::MIN; 3]);
    let (low, high) = mask
        .data
        .par_chunks(nx * ny)
        .enumerate()
        .map(|(k, slice)| {
            let (mut low, mut high) = empty;
            for (j, row) in slice.chunks(nx).enumerate() {
                let Some(i) = row.iter().position(|&v| v != 0) else { continue };
                let l = row.iter().rposition(|&v| v != 0).unwrap_or(i);
                for (a, (x, y)) in [(i, l), (j, j), (k, k)].into_iter().enumerate() {
                    low[a] = low[a].min(x as i64);
                    high[a] = high[a].max(y as i64);
                }
            }
            (low, high)
        })
        .reduce(|| empty, |a, b| ([0, 1, 2].map(|i| a.0[i].min(b.0[i])), [0, 1, 2].map(|i| a.1[i].max(b.1[i]))));
    (low[0] <= high[0]).then_some((low, high))
}

/// The voxel centres of the lumen's box and one layer round it.
struct Lattice<'a> {
    mask: &'a Mask,
    low: [i64; 3],
    dims: [usize; 3],
}

impl Lattice<'_> {
    fn rows(&self, k: usize) -> Vec<u8> {
        let [nx, ny, _] = self.dims;
        let mut out = vec![0; nx * ny];
        if k >= self.dims[2] {
            return out;
        }
        for j in 0..ny {
            // The first and last corner of a row are background by construction.
            if let Some(n) = self.mask.grid.linear(self.low[0] + 1, self.low[1] + j as i64, self.low[2] + k as i64) {
                let row = &self.mask.data[n..n + nx - 2];
                for (o, v) in out[j * nx + 1..].iter_mut().zip(row) {
                    *o = u8::from(*v != 0);
                }
            }
        }
        out
    }

    /// The lattice edges that start in layer `k` and are cut; key: 3 · corner + axis.
    fn cut_edges(&self, k: usize) -> Vec<u32> {
        let [nx, ny, _] = self.dims;
        let (here, above) = (self.rows(k), self.rows(k + 1));
        let mut out = Vec::new();
        for j in 0..ny {
            for i in 0..nx {
                let n = j * nx + i;
                let v = here[n];
                if i + 1 < nx && here[n + 1] != v {
                    out.push(3 * n as u32);
                }
                if j + 1 < ny && here[n + nx] != v {
                    out.push(3 * n as u32 + 1);
                }
                if above[n] != v {
                    out.push(3 * n as u32 + 2);
                }
            }
        }
        out
    }

    fn position(&self, k: usize, edge: u32) -> Point {
        let nx = self.dims[0];
        let (n, axis) = (edge as usize / 3, edge as usize % 3);
        let mut index = Vector::new((n % nx) as f64, (n / nx) as f64, k as f64) + Vector::from(self.low.map(|v| v as f64));
        index[axis] += 0.5;
        self.mask.grid.to_world(index)
    }

    fn triangles(&self, k: usize, ids: &[Vec<u32>; 2], mut put: impl FnMut([u32; 3])) {
        let [nx, ny, _] = self.dims;
        let layers = [self.rows(k), self.rows(k + 1)];
        let cases = cases();
        for j in 0..ny - 1 {
            for i in 0..nx - 1 {
                let n = j * nx + i;
                let corner = |c: usize| layers[c >> 2][n + (c & 1) + (c >> 1 & 1) * nx];
                let code = (0..8).fold(0, |s, c| s | usize::from(corner(c)) << c);
                for t in &cases[code] {
                    put(t.map(|e| {
                        let (c, axis) = EDGES[e as usize];
                        ids[c >> 2][3 * (n + (c & 1) + (c >> 1 & 1) * nx) + axis]
                    }));
                }
            }
        }
    }
}

/// Lower corner and axis of the twelve edges; corner bits are x, y, z.
const EDGES: [(usize, usize); 12] =
    [(0, 0), (2, 0), (4, 0), (6, 0), (0, 1), (1, 1), (4, 1), (5, 1), (0, 2), (1, 2), (2, 2), (3, 2)];

/// Corners of the six faces, counter-clockwise seen from outside the cube.
const FACES: [[usize; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

fn edge_between(a: usize, b: usize) -> usize {
    let (low, axis) = (a.min(b), (a ^ b).trailing_zeros() as usize);
    EDGES.iter().position(|&e| e == (low, axis)).unwrap_or(0)
}

fn on_common_face(a: u8, b: u8) -> bool {
    let ends = |e: u8| {
        let (c, axis) = EDGES[e as usize];
        [c, c | 1 << axis]
    };
    FACES.iter().any(|f| ends(a).iter().chain(&ends(b)).all(|c| f.contains(c)))
}

/// The 256 cases, derived from the rule for a face rather than written out: each run of lumen corners round a face is
/// cut off by one segment, the segments of the six faces chain to loops, each loop is triangulated.
fn cases() -> &'static Vec<Vec<[u8; 3]>> {
    static CASES: OnceLock<Vec<Vec<[u8; 3]>>> = OnceLock::new();
    CASES.get_or_init(|| (0..256).map(case).collect())
}

fn case(code: usize) -> Vec<[u8; 3]> {
    let lumen = |c: usize| code >> c & 1 == 1;
    let mut next = [None; 12];
    for f in FACES {
        for s in 0..4 {
            // A run of lumen corners starts at s.
            if !lumen(f[s]) || lumen(f[(s + 3) % 4]) {
                continue;
            }
            let mut e = s;
            while lumen(f[(e + 1) % 4]) {
                e += 1;
            }
            let enter = edge_between(f[(s + 3) % 4], f[s]);
            let leave = edge_between(f[e % 4], f[(e + 1) % 4]);
            next[enter] = Some(leave);
        }
    }
    let mut out = Vec::new();
    for start in 0..12 {
        let mut polygon = Vec::new();
        let mut at = start;
        while let Some(n) = next[at].take() {
            polygon.push(at as u8);
            at = n;
        }
        if polygon.len() >= 3 && !triangulate(&polygon, true, &mut out) {
            triangulate(&polygon, false, &mut out);
        }
    }
    out
}

/// Cuts ears; with `inside`, no diagonal lies in a face of the cube, where the next cube could use it too.
fn triangulate(polygon: &[u8], inside: bool, out: &mut Vec<[u8; 3]>) -> bool {
    let n = polygon.len();
    if n == 3 {
        out.push([polygon[0], polygon[1], polygon[2]]);
        return true;
    }
    for i in 0..n {
        let [a, b, c] = [0, 1, 2].map(|k| polygon[(i + k) % n]);
        if inside && on_common_face(a, c) {
            continue;
        }
        let rest: Vec<u8> = (0..n).filter(|&k| k != (i + 1) % n).map(|k| polygon[k]).collect();
        let mark = out.len();
        out.push([a, b, c]);
        if triangulate(&rest, inside, out) {
            return true;
        }
        out.truncate(mark);
    }
    false
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use nalgebra::Matrix3;

    use super::*;
    use crate::mask::Grid;

    fn mask(dims: [usize; 3], direction: Matrix3<f64>, f: impl Fn(i64, i64, i64) -> bool) -> Mask {
        let grid = Grid::new(dims, [0.5, 1.0, 2.0], Point::new(5.0, 6.0, 7.0), direction).unwrap();
        let data = (0..grid.len()).map(|n| {
            let v = grid.voxel(n).map(|x| x as i64);
            u8::from(f(v[0], v[1], v[2]))
        });
        let data = data.collect();
        Mask::new(grid, data)
    }

    fn directed_edges(m: &TriMesh) -> BTreeMap<(u32, u32), i32> {
        let mut e = BTreeMap::new();
        for t in &m.triangles {
            for k in 0..3 {
                *e.entry((t[k], t[(k + 1) % 3])).or_insert(0) += 1;
            }
        }
        e
    }

    #[test]
    fn one_voxel_is_an_octahedron_of_a_sixth_of_its_volume_in_either_handedness() {
        for d in [Matrix3::identity(), Matrix3::from_diagonal(&Vector::new(-1.0, 1.0, 1.0))] {
            let m = marching_cubes(&mask([1, 1, 1], d, |_, _, _| true));
            assert_eq!((m.points.len(), m.triangles.len()), (6, 8));
            assert!((m.volume() - 1.0 / 6.0).abs() < 1e-12);
            let b = m.bounds();
            assert!((b.max - b.min - Vector::new(0.5, 1.0, 2.0)).norm() < 1e-12);
            assert!((b.center() - Point::new(5.0, 6.0, 7.0)).norm() < 1e-12);
        }
    }

    #[test]
    fn noise_gives_a_closed_oriented_surface_whatever_meets() {
        let noise = |i: i64, j: i64, k: i64| {
            let mut x = (i * 73_856_093 ^ j * 19_349_663 ^ k * 83_492_791) as u32;
            x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
            x = (x ^ (x >> 12)).wrapping_mul(0x297A_2D39);
            (x ^ (x >> 15)) & 1 == 1
        };
        let mask = mask([12, 11, 10], Matrix3::identity(), noise);
        let m = marching_cubes(&mask);
        let edges = directed_edges(&m);
        assert!(m.triangles.len() > 3000);
        for ((a, b), n) in &edges {
            assert_eq!(edges.get(&(*b, *a)), Some(n), "edge {a} {b}");
            assert_eq!(*n, 1, "edge {a} {b}");
        }
    }

    #[test]
    fn a_ball_of_voxels_has_one_sphere_near_its_volume() {
        let m = mask([20, 12, 8], Matrix3::identity(), |i, j, k| {
            let v = Vector::new((i as f64 - 9.5) * 0.5, j as f64 - 5.5, (k as f64 - 3.5) * 2.0);
            v.norm() < 4.5
        });
        let s = marching_cubes(&m);
        let edges = directed_edges(&s).len() / 2;
        assert_eq!(s.points.len() as i64 - edges as i64 + s.triangles.len() as i64, 2);
        assert!((s.volume() / m.volume() - 1.0).abs() < 0.1);
        assert!(marching_cubes(&mask([3, 3, 3], Matrix3::identity(), |_, _, _| false)).triangles.is_empty());
    }
}
