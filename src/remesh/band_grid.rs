//! A scalar field on the lattice near a surface, made to vary slowly, and read at the speed of a table.

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::geometry::{Aabb, Point, Vector};

/// Nodes along the edge of a block.
const B: i64 = 8;
const BLOCK: usize = (B * B * B) as usize;
const ABSENT: u32 = u32::MAX;

/// Values at lattice nodes in blocks round given samples; trilinear between nodes. Elsewhere a coarse lattice over the
/// whole box answers.
#[derive(Debug, Clone)]
pub(crate) struct BandGrid {
    origin: Point,
    spacing: f64,
    blocks: [i64; 3],
    slot: Vec<u32>,
    cells: Vec<[i64; 3]>,
    values: Vec<f32>,
    coarse: Vec<f32>,
}

impl BandGrid {
    /// Lays blocks round `samples` (position, value) in `bounds` and takes at every node the least of the samples'
    /// values, each grown by `gradation` times the distance, and `cap`.
    pub fn new(bounds: &Aabb, spacing: f64, samples: &[(Point, f64)], gradation: f64, cap: f64) -> BandGrid {
        // A lattice of blocks that stays within some 10 million however fine the spacing is wished.
        let extent = bounds.max - bounds.min;
        let mut spacing = spacing;
        let count = |s: f64| (0..3).map(|a| (extent[a] / (s * B as f64)).ceil() + 3.0).product::<f64>();
        while count(spacing) > 1e7 {
            spacing *= 1.25;
        }
        let origin = bounds.min - Vector::repeat(1.5 * spacing * B as f64);
        let blocks: [i64; 3] = std::array::from_fn(|a| (extent[a] / (spacing * B as f64)).ceil() as i64 + 3);
        let mut grid = BandGrid {
            origin,
            spacing,
            blocks,
            slot: vec![ABSENT; (blocks[0] * blocks[1] * blocks[2]) as usize],
            cells: Vec::new(),
            values: Vec::new(),
            coarse: Vec::new(),
        };
        // Blocks that hold a node of a cell within one cell of a sample.
        let mut wanted = BTreeSet::new();
        for (p, _) in samples {
            let k = grid.node(p);
            for c in 0..8 {
                let corner: [i64; 3] = std::array::from_fn(|a| (k[a] + if c >> a & 1 == 0 { -1 } else { 2 }).div_euclid(B));
                if let Some(i) = grid.block_index(corner) {
                    wanted.insert((i, corner));
                }
            }
        }
        for (n, (i, cell)) in wanted.into_iter().enumerate() {
            grid.slot[i] = n as u32;
            grid.cells.push(cell);
        }
        let cap = cap as f32;
        grid.values = vec![cap; BLOCK * grid.cells.len()];
        for (p, v) in samples {
            let k = grid.node(p);
            for c in 0..8 {
                let n: [i64; 3] = std::array::from_fn(|a| k[a] + (c >> a & 1));
                if let Some(i) = grid.value_index(n) {
                    let d = (grid.position(n) - p).norm();
                    grid.values[i] = grid.values[i].min((v + gradation * d) as f32);
                }
            }
        }
        grid.grade(gradation);
        grid.fill_coarse(gradation, cap);
        grid
    }

    /// Value at `p`.
    #[inline]
    pub fn at(&self, p: &Point) -> f64 {
        let x = (p - self.origin) / self.spacing;
        let k = [x.x.floor(), x.y.floor(), x.z.floor()];
        let f = [x.x - k[0], x.y - k[1], x.z - k[2]];
        let k = k.map(|v| v as i64);
        let mut corner = [0.0f64; 8];
        for (c, value) in corner.iter_mut().enumerate() {
            let n = [k[0] + (c & 1) as i64, k[1] + (c >> 1 & 1) as i64, k[2] + (c >> 2 & 1) as i64];
            match self.value_index(n) {
                Some(i) => *value = f64::from(self.values[i]),
                None => return self.coarse_at(p),
            }
        }
        trilinear(&corner, f)
    }

    fn coarse_at(&self, p: &Point) -> f64 {
        // Nodes of the coarse lattice are the blocks' centres.
        let x = (p - self.origin) / (self.spacing * B as f64) - Vector::repeat(0.5);
        let mut k = [0; 3];
        let mut f = [0.0; 3];
        for a in 0..3 {
            let t = x[a].clamp(0.0, (self.blocks[a] - 1) as f64 - 1e-9);
            k[a] = t.floor() as i64;
            f[a] = t - t.floor();
        }
        let corner = std::array::from_fn(|c| {
            let n: [i64; 3] = std::array::from_fn(|a| k[a] + (c >> a & 1) as i64);
            self.block_index(n).map_or(f64::from(self.coarse[0]), |i| f64::from(self.coarse[i]))
        });
        trilinear(&corner, f)
    }

    fn node(&self, p: &Point) -> [i64; 3] {
        std::array::from_fn(|a| ((p[a] - self.origin[a]) / self.spacing).floor() as i64)
    }

    fn position(&self, n: [i64; 3]) -> Point {
        self.origin + Vector::new(n[0] as f64, n[1] as f64, n[2] as f64) * self.spacing
    }

    #[inline]
    fn block_index(&self, b: [i64; 3]) -> Option<usize> {
        let inside = (0..3).all(|a| (0..self.blocks[a]).contains(&b[a]));
        inside.then(|| ((b[2] * self.blocks[1] + b[1]) * self.blocks[0] + b[0]) as usize)
    }

    #[inline]
    fn value_index(&self, n: [i64; 3]) -> Option<usize> {
        let b = [n[0] >> 3, n[1] >> 3, n[2] >> 3];
        let slot = self.slot[self.block_index(b)?];
        if slot == ABSENT {
            return None;
        }
        Some(slot as usize * BLOCK + (((n[2] & 7) * B + (n[1] & 7)) * B + (n[0] & 7)) as usize)
    }

    /// Makes neighbours differ by at most gradation × distance: every node takes the least of its own value and its
    /// 26 neighbours' grown ones, until nothing changes. Jacobi over blocks, sweeps inside: the result does not
    /// depend on the order.
    fn grade(&mut self, gradation: f64) {
        let steps: Vec<([i64; 3], f32)> = (0..27)
            .map(|c| [c % 3 - 1, c / 3 % 3 - 1, c / 9 - 1])
            .filter(|d| *d != [0, 0, 0])
            .map(|d| (d, (gradation * self.spacing * ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) as f64).sqrt()) as f32))
            .collect();
        let mut active: Vec<usize> = (0..self.cells.len()).collect();
        while !active.is_empty() {
            let done: Vec<(usize, Vec<f32>)> = active
                .par_iter()
                .filter_map(|&slot| self.graded_block(slot, &steps).map(|v| (slot, v)))
                .collect();
            let mut next = BTreeSet::new();
            for (slot, values) in done {
                self.values[slot * BLOCK..(slot + 1) * BLOCK].copy_from_slice(&values);
                for (d, _) in &steps {
                    let c = self.cells[slot];
                    let n = self.block_index([c[0] + d[0], c[1] + d[1], c[2] + d[2]]).map(|i| self.slot[i]);
                    if let Some(n) = n.filter(|&n| n != ABSENT) {
                        next.insert(n as usize);
                    }
                }
            }
            active = next.into_iter().collect();
        }
    }

    /// The block's values made to vary slowly, given its neighbours; `None` where nothing changes.
    fn graded_block(&self, slot: usize, steps: &[([i64; 3], f32)]) -> Option<Vec<f32>> {
        const P: i64 = B + 2;
        let base = self.cells[slot].map(|c| c * B - 1);
        let mut padded = vec![f32::INFINITY; (P * P * P) as usize];
        let at = |i: i64, j: i64, k: i64| ((k * P + j) * P + i) as usize;
        for k in 0..P {
            for j in 0..P {
                for i in 0..P {
                    if let Some(n) = self.value_index([base[0] + i, base[1] + j, base[2] + k]) {
                        padded[at(i, j, k)] = self.values[n];
                    }
                }
            }
        }
        let mut changed = false;
        loop {
            let mut again = false;
            for backward in [false, true] {
                for n in 0..BLOCK as i64 {
                    let n = if backward { BLOCK as i64 - 1 - n } else { n };
                    let (i, j, k) = (n % B + 1, n / B % B + 1, n / (B * B) + 1);
                    let here = padded[at(i, j, k)];
                    let mut least = here;
                    for (d, w) in steps {
                        least = least.min(padded[at(i + d[0], j + d[1], k + d[2])] + w);
                    }
                    // Rounding must not keep the loop alive.
                    if least < here * (1.0 - 1e-6) {
                        padded[at(i, j, k)] = least;
                        again = true;
                    }
                }
            }
            changed |= again;
            if !again {
                break;
            }
        }
        changed.then(|| {
            (0..BLOCK as i64).map(|n| padded[at(n % B + 1, n / B % B + 1, n / (B * B) + 1)]).collect()
        })
    }

    /// Away from the band: the blocks' least values, grown with the distance between block centres.
    fn fill_coarse(&mut self, gradation: f64, cap: f32) {
        let mut coarse = vec![cap; self.slot.len()];
        for (slot, cell) in self.cells.iter().enumerate() {
            if let Some(i) = self.block_index(*cell) {
                coarse[i] = self.values[slot * BLOCK..(slot + 1) * BLOCK].iter().copied().fold(cap, f32::min);
            }
        }
        let [nx, ny, nz] = self.blocks;
        let w = |d: [i64; 3]| {
            (gradation * self.spacing * B as f64 * ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) as f64).sqrt()) as f32
        };
        // Two chamfer sweeps reach every node along every direction once; repeated until they change nothing.
        let half: Vec<([i64; 3], f32)> = (0..13).map(|c| [c % 3 - 1, c / 3 % 3 - 1, c / 9 - 1]).map(|d| (d, w(d))).collect();
        loop {
            let mut again = false;
            for forward in [true, false] {
                for n in 0..(nx * ny * nz) {
                    let n = if forward { n } else { nx * ny * nz - 1 - n };
                    let (i, j, k) = (n % nx, n / nx % ny, n / (nx * ny));
                    for (d, w) in &half {
                        let s = if forward { 1 } else { -1 };
                        if let Some(m) = self.block_index([i + s * d[0], j + s * d[1], k + s * d[2]]) {
                            let v = coarse[m] + w;
                            if v < coarse[n as usize] * (1.0 - 1e-6) {
                                coarse[n as usize] = v;
                                again = true;
                            }
                        }
                    }
                }
            }
            if !again {
                break;
            }
        }
        self.coarse = coarse;
    }
}

#[inline]
fn trilinear(v: &[f64; 8], f: [f64; 3]) -> f64 {
    let lerp = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let x = |i: usize| lerp(v[i], v[i + 1], f[0]);
    lerp(lerp(x(0), x(2), f[1]), lerp(x(4), x(6), f[1]), f[2])
}
