//! Interior points at the wished spacing: neighbours of accepted points are proposed in the fourteen
//! directions of the body-centred cubic lattice and kept where nothing is too near.
//!
//! Where the size is constant the points form a body-centred cubic lattice, whose tetrahedra have an equi-volume
//! skewness of 0.07; where it grows, the lattice tears and the optimiser mends.

use std::collections::VecDeque;

use super::sizing::Sizing;
use crate::geometry::{Point, Vector};
use crate::mesh::TriMesh;

/// Least distance from the wall, in local sizes.
const WALL: f64 = 0.55;
/// Least distance between points, in local sizes.
const APART: f64 = 0.74;
/// Depth of the first points under the middle of a triangle, in its sizes.
const SEED: f64 = 0.9;
/// Cell edge of the body-centred lattice whose tetrahedra have edges of mean length 1: of the six edges four
/// have √3/2 of it and two all of it. A little less, since where the size grows each point proposes by its own. These
/// four figures together give the lowest mean skewness for the number of cells (tubes and aneurysms at three sizes).
const LATTICE: f64 = 0.984 * 6.0 / (2.0 + 4.0 * 0.866_025_403_784_438_6);

/// Points found so far, all of them in a grid for each level of distance (powers of two): a question looks at a few
/// cells of one grid, however fine the finest is.
struct Levels {
    base: f64,
    origin: Point,
    cells: Vec<Table>,
}

/// Open addressing from a cell to its points.
struct Table {
    edge: f64,
    slots: Vec<(u64, u32)>,
    next: Vec<u32>,
    ids: Vec<u32>,
    used: usize,
}

const NONE: u32 = u32::MAX;

impl Table {
    fn new(edge: f64) -> Table {
        Table { edge, slots: vec![(u64::MAX, NONE); 64], next: vec![], ids: vec![], used: 0 }
    }

    fn key(c: [i64; 3]) -> u64 {
        c.iter().fold(0, |k, &x| k << 21 | (x as u64 & 0x1F_FFFF))
    }

    fn slot(&self, key: u64) -> usize {
        let mask = self.slots.len() - 1;
        let mut s = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20) as usize & mask;
        while self.slots[s].0 != key && self.slots[s].0 != u64::MAX {
            s = (s + 1) & mask;
        }
        s
    }

    fn insert(&mut self, c: [i64; 3], id: u32) {
        if 2 * (self.used + 1) > self.slots.len() {
            let old = std::mem::replace(&mut self.slots, vec![(u64::MAX, NONE); 0]);
            self.slots = vec![(u64::MAX, NONE); old.len() * 2];
            for e in old.into_iter().filter(|e| e.0 != u64::MAX) {
                let s = self.slot(e.0);
                self.slots[s] = e;
            }
        }
        let k = Table::key(c);
        let s = self.slot(k);
        if self.slots[s].0 == u64::MAX {
            self.slots[s] = (k, NONE);
            self.used += 1;
        }
        self.ids.push(id);
        self.next.push(self.slots[s].1);
        self.slots[s].1 = self.ids.len() as u32 - 1;
    }

    fn each(&self, c: [i64; 3], mut f: impl FnMut(u32) -> bool) -> bool {
        let s = self.slot(Table::key(c));
        let mut e = self.slots[s].1;
        while self.slots[s].0 != u64::MAX && e != NONE {
            if f(self.ids[e as usize]) {
                return true;
            }
            e = self.next[e as usize];
        }
        false
    }
}

impl Levels {
    fn insert(&mut self, p: &Point, id: u32) {
        for table in &mut self.cells {
            let c = cell(&self.origin, p, table.edge);
            table.insert(c, id);
        }
    }

    /// Whether any point lies nearer to `p` than `r`.
    fn near(&mut self, p: &Point, r: f64, points: &[Point]) -> bool {
        // Cells of at least 0.8 r: two or three in each direction.
        let level = (r / self.base).log2().floor().max(0.0) as usize;
        while self.cells.len() <= level {
            let mut table = Table::new(self.base * (1u64 << self.cells.len()) as f64 * 1.6);
            points.iter().enumerate().for_each(|(id, p)| table.insert(cell(&self.origin, p, table.edge), id as u32));
            self.cells.push(table);
        }
        let t = &self.cells[level];
        let v = Vector::repeat(r);
        let (a, b) = (cell(&self.origin, &(p - v), t.edge), cell(&self.origin, &(p + v), t.edge));
        (a[0]..=b[0]).any(|i| {
            (a[1]..=b[1]).any(|j| {
                (a[2]..=b[2]).any(|k| t.each([i, j, k], |id| (points[id as usize] - p).norm_squared() < r * r))
            })
        })
    }
}

/// A point whose neighbours are to be proposed.
struct Packed {
    at: Point,
    size: f64,
    /// A shorter step does not leave the surface.
    free: f64,
    /// A point on the wall or beside it, not far away.
    wall: Point,
}

fn cell(origin: &Point, p: &Point, edge: f64) -> [i64; 3] {
    [0, 1, 2].map(|i| ((p[i] - origin[i]) / edge).floor() as i64)
}

/// For each edge between two patches: a point just inside its middle and one well inside, and the edge's length.
fn rim_points(surface: &TriMesh) -> Vec<((Point, Point), f64)> {
    let mut edges: Vec<([u32; 2], u32)> = Vec::new();
    let caps: Vec<bool> = {
        // Only triangles at a vertex of another patch than the first can have a rim edge.
        let mut seen = vec![u32::MAX; surface.points.len()];
        let mut rim = vec![false; surface.points.len()];
        for (t, &patch) in surface.triangles.iter().zip(&surface.patch) {
            for &v in t {
                let v = v as usize;
                if seen[v] != u32::MAX && seen[v] != patch {
                    rim[v] = true;
                }
                seen[v] = patch;
            }
        }
        rim
    };
    for (n, t) in surface.triangles.iter().enumerate() {
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            if caps[a as usize] && caps[b as usize] {
                edges.push(([a.min(b), a.max(b)], n as u32));
            }
        }
    }
    edges.sort_unstable();
    let pairs = edges.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() == 2);
    let between = pairs.filter(|g| surface.patch[g[0].1 as usize] != surface.patch[g[1].1 as usize]);
    between
        .filter_map(|g| {
            let normal = |t: u32| surface.area_vector2(t as usize).try_normalize(0.0);
            let inwards = -(normal(g[0].1)? + normal(g[1].1)?).try_normalize(0.1)?;
            let [a, b] = g[0].0.map(|v| surface.points[v as usize]);
            let (middle, h) = (nalgebra::center(&a, &b), (a - b).norm());
            Some(((middle + inwards * (0.05 * h), middle + inwards * (0.7 * h)), h))
        })
        .collect()
}

/// Points inside `surface` spaced as `sizing` wishes, away from the wall, in a fixed order. Stops early (with what
/// there is) when `stop` says so.
pub fn pack(surface: &TriMesh, sizing: &Sizing<'_>, stop: &dyn Fn() -> bool) -> Vec<Point> {
    let least = sizing.wall_sizes().iter().copied().fold(f64::INFINITY, f64::min) * sizing.factor().min(1.0);
    let mut levels = Levels { base: least, origin: surface.bounds().min, cells: vec![] };
    let mut points: Vec<Point> = vec![];
    let mut queue: VecDeque<Packed> = VecDeque::new();
    let mut directions: Vec<Vector> = vec![];
    for s in 0..8 {
        let sign = |b: i32| if s >> b & 1 == 0 { 0.5 } else { -0.5 };
        directions.push(Vector::new(sign(0), sign(1), sign(2)));
    }
    for a in 0..3 {
        for s in [1.0, -1.0] {
            let mut v = Vector::zeros();
            v[a] = s;
            directions.push(v);
        }
    }
    // First a point inwards of every rim edge, on the bisector: else the triangles on its two sides end up in one
    // tetrahedron, which OpenFOAM's determinant does not forgive.
    for (p, h) in rim_points(surface) {
        let start = p.0;
        if sizing.bvh().ray(&start, &(p.1 - start), 1.0).is_none() && !levels.near(&p.1, 0.6 * h, &points) {
            levels.insert(&p.1, points.len() as u32);
            points.push(p.1);
            queue.push_back(Packed { at: p.1, size: h, free: 0.4 * h, wall: p.0 });
        }
    }
    let mut offer = |p: Point, guess: f64, wall: &Point, queue: &mut VecDeque<Packed>| {
        // Most proposals end here, before the dearer question for the wall.
        if levels.near(&p, 0.6 * APART * guess, &points) {
            return;
        }
        let here = sizing.at_near(&p, wall);
        if here.distance < WALL * here.size || levels.near(&p, APART * here.size, &points) {
            return;
        }
        levels.insert(&p, points.len() as u32);
        points.push(p);
        queue.push_back(Packed { at: p, size: here.size, free: here.distance, wall: here.wall });
    };
    // A seed under each triangle, used only where the points before it have not come.
    for t in 0..surface.triangles.len() {
        let Some(n) = surface.area_vector2(t).try_normalize(0.0) else { continue };
        let [a, b, c] = surface.corners(t);
        let middle = Point::from((a.coords + b.coords + c.coords) / 3.0);
        let h = surface.triangles[t].iter().map(|&v| sizing.wall_sizes()[v as usize]).sum::<f64>() / 3.0;
        let (start, seed) = (middle - n * (0.01 * h), middle - n * (SEED * h));
        if sizing.bvh().ray(&start, &(seed - start), 1.0).is_none() {
            offer(seed, h, &middle, &mut queue);
        }
        let mut count = 0;
        while let Some(Packed { at, size, free, wall }) = queue.pop_front() {
            for d in &directions {
                let step = d * (LATTICE * size);
                if step.norm() < free || sizing.bvh().ray(&at, &step, 1.0).is_none() {
                    offer(at + step, size, &wall, &mut queue);
                }
            }
            count += 1;
            if count % 1024 == 0 && stop() {
                return points;
            }
        }
    }
    points
}
