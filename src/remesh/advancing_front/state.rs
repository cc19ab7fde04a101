//! The front: closed loops of edges with the unmeshed side on their left, found again by a spatial hash.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

use crate::geometry::{Point, Vector};

pub(super) const NONE: u32 = u32::MAX;

/// Multiplicative hashing of integer keys; the maps are never iterated.
#[derive(Default)]
pub(super) struct IntHasher(u64);

impl Hasher for IntHasher {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u64(u64::from(b)));
    }
    fn write_u64(&mut self, x: u64) {
        self.0 = (self.0 ^ x).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 ^= self.0 >> 29;
    }
}

type IntMap = HashMap<u64, u32, BuildHasherDefault<IntHasher>>;
type IntSet = HashSet<u64, BuildHasherDefault<IntHasher>>;

/// A front edge from `vertex` to the vertex of `next`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub vertex: u32,
    pub next: u32,
    pub prev: u32,
    pub alive: bool,
    /// How often it was put off, which is how lenient the next attempt is.
    pub level: u8,
    pub generation: u32,
    stamp: u32,
    cell: u64,
    grid: u8,
    cell_next: u32,
    cell_prev: u32,
}

/// Levels of cells, each of twice the size of the one before; level 0 has the smallest.
const GRIDS: usize = 24;

pub(super) struct Front {
    pub points: Vec<Point>,
    pub normals: Vec<Vector>,
    pub sizes: Vec<f64>,
    pub triangles: Vec<[u32; 3]>,
    pub nodes: Vec<Node>,
    edges: IntSet,
    cells: IntMap,
    used: [u32; GRIDS],
    smallest: f64,
    origin: Point,
    heap: BinaryHeap<Reverse<(u64, u32, u32)>>,
    pushed: u32,
}

fn edge_key(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b))
}

impl Front {
    /// An empty front in the neighbourhood of `origin` whose edges are hardly shorter than `smallest`.
    pub fn new(origin: Point, smallest: f64) -> Front {
        Front {
            points: Vec::new(),
            normals: Vec::new(),
            sizes: Vec::new(),
            triangles: Vec::new(),
            nodes: Vec::new(),
            edges: IntSet::default(),
            cells: IntMap::default(),
            used: [0; GRIDS],
            smallest,
            origin,
            heap: BinaryHeap::new(),
            pushed: 0,
        }
    }

    pub fn add_vertex(&mut self, p: Point, n: Vector, size: f64) -> u32 {
        self.points.push(p);
        self.normals.push(n);
        self.sizes.push(size);
        self.points.len() as u32 - 1
    }

    pub fn has_edge(&self, a: u32, b: u32) -> bool {
        self.edges.contains(&edge_key(a, b))
    }

    pub fn add_triangle(&mut self, t: [u32; 3]) {
        self.triangles.push(t);
        for k in 0..3 {
            self.edges.insert(edge_key(t[k], t[(k + 1) % 3]));
        }
    }

    pub fn node(&self, i: u32) -> &Node {
        &self.nodes[i as usize]
    }

    pub fn next(&self, i: u32) -> u32 {
        self.nodes[i as usize].next
    }

    pub fn prev(&self, i: u32) -> u32 {
        self.nodes[i as usize].prev
    }

    /// First and second vertex of a front edge.
    pub fn ends(&self, i: u32) -> (u32, u32) {
        let n = self.node(i);
        (n.vertex, self.node(n.next).vertex)
    }

    /// A closed loop through the given vertices, unmeshed side on its left.
    pub fn add_loop(&mut self, vertices: &[u32]) {
        let first = self.nodes.len() as u32;
        let n = vertices.len() as u32;
        for (i, &v) in vertices.iter().enumerate() {
            let i = i as u32;
            self.new_node(v, first + (i + 1) % n, first + (i + n - 1) % n, 0);
        }
        (first..first + n).for_each(|i| self.refresh(i));
    }

    fn new_node(&mut self, vertex: u32, next: u32, prev: u32, generation: u32) -> u32 {
        self.nodes.push(Node {
            vertex,
            next,
            prev,
            alive: true,
            level: 0,
            generation,
            stamp: 0,
            cell: 0,
            grid: u8::MAX,
            cell_next: NONE,
            cell_prev: NONE,
        });
        self.nodes.len() as u32 - 1
    }

    fn join(&mut self, i: u32, k: u32) {
        self.nodes[i as usize].next = k;
        self.nodes[k as usize].prev = i;
    }

    fn kill(&mut self, i: u32) {
        self.unhash(i);
        self.nodes[i as usize].alive = false;
    }

    /// Puts a triangle on edge `i` with a new vertex as its apex.
    pub fn grow(&mut self, i: u32, apex: u32) {
        let (a, b) = self.ends(i);
        let j = self.next(i);
        self.add_triangle([a, b, apex]);
        let generation = self.node(i).generation + 1;
        let m = self.new_node(apex, j, i, generation);
        self.nodes[i as usize].generation = generation;
        self.join(i, m);
        self.join(m, j);
        self.renew(&[i, m]);
    }

    /// Puts a triangle on edge `i` with the vertex of front node `k` as its apex: cuts an ear, closes, splits or merges.
    pub fn connect(&mut self, i: u32, k: u32) {
        let (a, b) = self.ends(i);
        let (j, h) = (self.next(i), self.prev(i));
        let c = self.node(k).vertex;
        self.add_triangle([a, b, c]);
        let generation = self.node(i).generation.min(self.node(k).generation) + 1;
        if k == h && k == self.next(j) {
            [i, j, k].into_iter().for_each(|n| self.kill(n));
        } else if k == self.next(j) {
            self.kill(j);
            self.join(i, k);
            self.nodes[i as usize].generation = generation;
            self.renew(&[i]);
        } else if k == h {
            self.kill(i);
            self.join(k, j);
            self.nodes[k as usize].generation = generation;
            self.renew(&[k]);
        } else {
            let p = self.prev(k);
            let m = self.new_node(c, j, p, generation);
            self.join(p, m);
            self.join(m, j);
            self.join(i, k);
            self.nodes[i as usize].generation = generation;
            self.renew(&[i, m]);
        }
    }

    /// Queues changed edges and their neighbours afresh.
    fn renew(&mut self, changed: &[u32]) {
        for &i in changed {
            self.refresh(i);
        }
        for &i in changed {
            for n in [self.prev(i), self.next(i)] {
                if !changed.contains(&n) {
                    self.queue(n, 0);
                }
            }
        }
    }

    fn refresh(&mut self, i: u32) {
        self.unhash(i);
        self.hash(i);
        self.queue(i, 0);
    }

    /// Interior angle, on the unmeshed side, at the vertex of node `i`, in radians from 0 to 2π.
    pub fn corner(&self, i: u32) -> f64 {
        let n = self.node(i);
        let v = n.vertex as usize;
        let out = self.points[self.node(n.next).vertex as usize] - self.points[v];
        let back = self.points[self.node(n.prev).vertex as usize] - self.points[v];
        let angle = self.normals[v].dot(&out.cross(&back)).atan2(out.dot(&back));
        if angle < 0.0 { angle + std::f64::consts::TAU } else { angle }
    }

    /// Queues an edge for an attempt at the given level; sharp corners go first, then older generations.
    pub fn queue(&mut self, i: u32, level: u8) {
        let sharp = self.corner(i).min(self.corner(self.next(i))) < 1.35;
        let n = &mut self.nodes[i as usize];
        n.level = level;
        n.stamp += 1;
        let generation = if sharp { 0 } else { n.generation.min(0xFF_FFFF) + 1 };
        let key = u64::from(level) << 58 | u64::from(generation) << 32 | u64::from(self.pushed);
        self.pushed = self.pushed.wrapping_add(1);
        self.heap.push(Reverse((key, i, n.stamp)));
    }

    /// The next edge to try.
    pub fn pop(&mut self) -> Option<u32> {
        while let Some(Reverse((_, i, stamp))) = self.heap.pop() {
            let n = self.node(i);
            if n.alive && n.stamp == stamp {
                return Some(i);
            }
        }
        None
    }

    /// Live nodes of each remaining loop.
    pub fn loops(&self) -> Vec<Vec<u32>> {
        let mut seen = vec![false; self.nodes.len()];
        let mut out = Vec::new();
        for start in 0..self.nodes.len() as u32 {
            if !self.node(start).alive || seen[start as usize] {
                continue;
            }
            let mut all = Vec::new();
            let mut i = start;
            while !seen[i as usize] {
                seen[i as usize] = true;
                all.push(i);
                i = self.next(i);
            }
            out.push(all);
        }
        out
    }

    pub fn kill_all(&mut self, nodes: &[u32]) {
        nodes.iter().for_each(|&n| self.kill(n));
    }

    fn cell_size(&self, grid: usize) -> f64 {
        2.0 * self.smallest * (1u64 << grid) as f64
    }

    /// The grid whose edges are at most half a cell long.
    fn grid_for(&self, length: f64) -> usize {
        let mut g = 0;
        while g + 1 < GRIDS && length > 0.5 * self.cell_size(g) {
            g += 1;
        }
        g
    }

    fn cell_key(grid: usize, c: [i64; 3]) -> u64 {
        let bits = |x: i64| (x + (1 << 18)) as u64 & 0x7_FFFF;
        (grid as u64) << 57 | bits(c[0]) << 38 | bits(c[1]) << 19 | bits(c[2])
    }

    fn hash(&mut self, i: u32) {
        let (a, b) = self.ends(i);
        let (p, q) = (self.points[a as usize], self.points[b as usize]);
        let g = self.grid_for((q - p).norm());
        let m = (nalgebra::center(&p, &q) - self.origin) / self.cell_size(g);
        let key = Self::cell_key(g, [0, 1, 2].map(|a| m[a].floor() as i64));
        let head = self.cells.insert(key, i).unwrap_or(NONE);
        if head != NONE {
            self.nodes[head as usize].cell_prev = i;
        }
        let n = &mut self.nodes[i as usize];
        (n.cell, n.grid, n.cell_next, n.cell_prev) = (key, g as u8, head, NONE);
        self.used[g] += 1;
    }

    fn unhash(&mut self, i: u32) {
        let n = *self.node(i);
        if n.grid == u8::MAX {
            return;
        }
        self.used[n.grid as usize] -= 1;
        if n.cell_next != NONE {
            self.nodes[n.cell_next as usize].cell_prev = n.cell_prev;
        }
        if n.cell_prev != NONE {
            self.nodes[n.cell_prev as usize].cell_next = n.cell_next;
        } else if n.cell_next != NONE {
            self.cells.insert(n.cell, n.cell_next);
        } else {
            self.cells.remove(&n.cell);
        }
        self.nodes[i as usize].grid = u8::MAX;
    }

    /// Collects the front edges near a ball: all whose middle is nearer than `radius` and half of their own length.
    ///
    /// Edges more than about four times shorter or longer than `length` may be left out.
    pub fn near(&self, center: &Point, radius: f64, length: f64, out: &mut Vec<u32>) {
        out.clear();
        let g = self.grid_for(length);
        for grid in g.saturating_sub(2)..(g + 3).min(GRIDS) {
            if self.used[grid] == 0 {
                continue;
            }
            let size = self.cell_size(grid);
            let r = radius + 0.25 * size;
            let low = (center - self.origin).map(|x| ((x - r) / size).floor() as i64);
            let high = (center - self.origin).map(|x| ((x + r) / size).floor() as i64);
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    for x in low.x..=high.x {
                        let mut n = self.cells.get(&Self::cell_key(grid, [x, y, z])).copied().unwrap_or(NONE);
                        while n != NONE {
                            out.push(n);
                            n = self.node(n).cell_next;
                        }
                    }
                }
            }
        }
    }
}
