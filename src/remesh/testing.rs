//! Analytic implicits and a small marching-tetrahedra polygonizer for the tests of remeshing.

use std::collections::BTreeMap;

use crate::geometry::{Aabb, Plane, Point, Vector};
use crate::implicit::Implicit;
use crate::mesh::{PatchId, TriMesh};

/// Smooth union of capsules: tubes, bends and Ys.
pub struct Capsules {
    /// End points and radius of each.
    pub parts: Vec<(Point, Point, f64)>,
    /// Width of the blend; 0 for the sharp union.
    pub blend: f64,
    /// Voxel size that the case stands for.
    pub voxel: f64,
}

impl Capsules {
    /// A tube along z about the origin with round ends.
    pub fn tube(radius: f64, length: f64) -> Capsules {
        let e = Point::new(0.0, 0.0, 0.5 * length);
        Capsules { parts: vec![(-e, e, radius)].into_iter().map(|(a, b, r)| (Point::from(a.coords), b, r)).collect(), blend: 0.0, voxel: 0.5 }
    }

    /// A Y of three branches.
    pub fn y() -> Capsules {
        let o = Point::origin();
        Capsules {
            parts: vec![
                (Point::new(0., 0., -8.), o, 2.0),
                (o, Point::new(4., 1., 6.), 1.5),
                (o, Point::new(-4., 0., 6.), 1.2),
            ],
            blend: 0.5,
            voxel: 0.5,
        }
    }
}

impl Implicit for Capsules {
    fn value(&self, p: &Point) -> f64 {
        self.value_gradient(p).0
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let one = |(a, b, r): &(Point, Point, f64)| {
            let d = b - a;
            let t = ((p - a).dot(&d) / d.norm_squared()).clamp(0.0, 1.0);
            let v = p - (a + d * t);
            let n = v.norm();
            (n - r, if n > 0.0 { v / n } else { Vector::z() })
        };
        let mut it = self.parts.iter().map(one);
        let first = it.next().unwrap_or((1.0, Vector::z()));
        it.fold(first, |(f, g), (h, k)| {
            if self.blend <= 0.0 {
                return if f <= h { (f, g) } else { (h, k) };
            }
            // Polynomial smooth minimum, C1.
            let w = (self.blend - (f - h).abs()).max(0.0) / self.blend;
            let s = 0.5 * w;
            let (m, gm, go) = if f <= h { (f, g, k) } else { (h, k, g) };
            (m - w * w * self.blend * 0.25, gm * (1.0 - s) + go * s)
        })
    }

    fn bounds(&self) -> Aabb {
        let mut b = Aabb::EMPTY;
        for (p, q, r) in &self.parts {
            b = b.union(&Aabb::of([p, q]).inflated(r + self.blend));
        }
        b.inflated(self.voxel)
    }

    fn resolution(&self) -> f64 {
        0.5 * self.voxel
    }
}

/// A torus about z.
pub struct Torus {
    /// Radius of the axis.
    pub axis: f64,
    /// Radius of the tube.
    pub radius: f64,
}

impl Implicit for Torus {
    fn value(&self, p: &Point) -> f64 {
        self.value_gradient(p).0
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let rho = p.x.hypot(p.y).max(1e-12);
        let (u, d) = (Vector::new(p.x / rho, p.y / rho, 0.0), rho - self.axis);
        let n = d.hypot(p.z).max(1e-12);
        (n - self.radius, u * (d / n) + Vector::z() * (p.z / n))
    }

    fn bounds(&self) -> Aabb {
        let r = self.axis + 1.5 * self.radius;
        Aabb { min: Point::new(-r, -r, -1.5 * self.radius), max: Point::new(r, r, 1.5 * self.radius) }
    }

    fn resolution(&self) -> f64 {
        0.1 * self.radius
    }
}

/// Marching tetrahedra on a lattice: closed, full of slivers, vertices on the zero set.
pub fn polygonize(f: &dyn Implicit, cell: f64) -> TriMesh {
    let b = f.bounds();
    let n: [i64; 3] = std::array::from_fn(|a| ((b.max[a] - b.min[a]) / cell).ceil() as i64 + 1);
    let at = |k: [i64; 3]| Point::from(b.min.coords + Vector::new(k[0] as f64, k[1] as f64, k[2] as f64) * cell);
    let index = |k: [i64; 3]| ((k[2] * n[1] + k[1]) * n[0] + k[0]) as usize;
    let mut value = vec![0.0; (n[0] * n[1] * n[2]) as usize];
    for k in 0..n[2] {
        for j in 0..n[1] {
            for i in 0..n[0] {
                value[index([i, j, k])] = f.value(&at([i, j, k]));
            }
        }
    }
    let mut ids: BTreeMap<(usize, usize), u32> = BTreeMap::new();
    let mut m = TriMesh::default();
    for k in 0..n[2] - 1 {
        for j in 0..n[1] - 1 {
            for i in 0..n[0] - 1 {
                let corner = |c: usize| [i + (c & 1) as i64, j + (c >> 1 & 1) as i64, k + (c >> 2 & 1) as i64];
                for path in [[1, 3], [3, 2], [2, 6], [6, 4], [4, 5], [5, 1]] {
                    tetrahedron(f, [0, path[0], path[1], 7].map(corner), &value, &index, &at, &mut ids, &mut m);
                }
            }
        }
    }
    TriMesh::new(m.points, m.triangles)
}

#[allow(clippy::too_many_arguments)]
fn tetrahedron(
    f: &dyn Implicit,
    k: [[i64; 3]; 4],
    value: &[f64],
    index: &dyn Fn([i64; 3]) -> usize,
    at: &dyn Fn([i64; 3]) -> Point,
    ids: &mut BTreeMap<(usize, usize), u32>,
    m: &mut TriMesh,
) {
    let inside: Vec<usize> = (0..4).filter(|&i| value[index(k[i])] <= 0.0).collect();
    let outside: Vec<usize> = (0..4).filter(|&i| value[index(k[i])] > 0.0).collect();
    if inside.is_empty() || outside.is_empty() {
        return;
    }
    let mut cut = |i: usize, o: usize| {
        let key = (index(k[i]), index(k[o]));
        *ids.entry(key).or_insert_with(|| {
            let (mut a, mut b) = (at(k[i]), at(k[o]));
            for _ in 0..30 {
                let c = nalgebra::center(&a, &b);
                if f.value(&c) <= 0.0 { a = c } else { b = c }
            }
            m.points.push(a);
            m.points.len() as u32 - 1
        })
    };
    let quad = [(0, 0), (0, 1), (1, 1), (1, 0)];
    let sides: Vec<[(usize, usize); 3]> = match (inside.len(), outside.len()) {
        (1, 3) => vec![[(0, 0), (0, 1), (0, 2)]],
        (3, 1) => vec![[(0, 0), (1, 0), (2, 0)]],
        _ => vec![[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]],
    };
    // Orient by the lattice, from the inside corners to the outside ones, at the middles of the lattice edges:
    // triangles themselves may have no area.
    let mean = |s: &[usize]| s.iter().fold(Vector::zeros(), |v, &i| v + at(k[i]).coords) / s.len() as f64;
    let out = mean(&outside) - mean(&inside);
    for mut t in sides {
        let [a, b, c] = t.map(|(i, o)| nalgebra::center(&at(k[inside[i]]), &at(k[outside[o]])));
        if (b - a).cross(&(c - a)).dot(&out) < 0.0 {
            t.swap(1, 2);
        }
        let t = t.map(|(i, o)| cut(inside[i], outside[o]));
        m.triangles.push(t);
    }
}

/// Cuts a mesh by a plane, drops what lies on the normal's side and closes the one loop by a fan: as rough as can be.
pub fn cut_and_cap(m: &TriMesh, plane: &Plane, patch: PatchId) -> TriMesh {
    let d: Vec<f64> = m.points.iter().map(|p| plane.signed_distance(p)).collect();
    let mut out = TriMesh { points: m.points.clone(), patches: m.patches.clone(), ..TriMesh::default() };
    let mut ids: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let mut rim: Vec<[u32; 2]> = Vec::new();
    for (t, &id) in m.triangles.iter().zip(&m.patch) {
        let mut polygon = Vec::new();
        let mut ends = Vec::new();
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            let (da, db) = (d[a as usize], d[b as usize]);
            if da < 0.0 {
                polygon.push(a);
            }
            if (da < 0.0) != (db < 0.0) {
                let points = &mut out.points;
                let v = *ids.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    let (pa, pb) = (m.points[a as usize], m.points[b as usize]);
                    points.push(pa + (pb - pa) * (da / (da - db)));
                    points.len() as u32 - 1
                });
                polygon.push(v);
                ends.push(v);
                if da < 0.0 {
                    rim.push([v, u32::MAX]);
                }
            }
        }
        if let [x, y] = ends[..] {
            // Leaving the kept side at `rim`'s newest, coming back at the other.
            let leave = rim.pop().map_or(x, |r| r[0]);
            rim.push([leave, if leave == x { y } else { x }]);
        }
        for i in 1..polygon.len().saturating_sub(1) {
            out.triangles.push([polygon[0], polygon[i], polygon[i + 1]]);
            out.patch.push(id);
        }
    }
    let centre = rim.iter().fold(Vector::zeros(), |v, r| v + out.points[r[0] as usize].coords) / rim.len() as f64;
    out.points.push(Point::from(centre));
    let hub = out.points.len() as u32 - 1;
    for [a, b] in rim {
        out.triangles.push([b, a, hub]);
        out.patch.push(patch);
    }
    let mut used = vec![u32::MAX; out.points.len()];
    let mut points = Vec::new();
    for t in &mut out.triangles {
        *t = t.map(|v| {
            if used[v as usize] == u32::MAX {
                used[v as usize] = points.len() as u32;
                points.push(out.points[v as usize]);
            }
            used[v as usize]
        });
    }
    TriMesh { points, ..out }
}
