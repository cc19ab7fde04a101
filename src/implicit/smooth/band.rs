//! The narrow band of spline coefficients round the boundary of a mask, stored as runs along x.

use rayon::prelude::*;

use super::labels::{Near, in_order};
use super::energy::slot;
use super::spline::weights;
use crate::geometry::Vector;
use crate::mask::Mask;

/// Differences of the third order, as orders along x, y, z, and their multiplicity in |D³u|².
pub(super) const TERMS: [([usize; 3], f32); 10] = [
    ([3, 0, 0], 1.0),
    ([2, 1, 0], 3.0),
    ([1, 2, 0], 3.0),
    ([0, 3, 0], 1.0),
    ([2, 0, 1], 3.0),
    ([1, 1, 1], 6.0),
    ([0, 2, 1], 3.0),
    ([1, 0, 2], 3.0),
    ([0, 1, 2], 3.0),
    ([0, 0, 3], 1.0),
];

/// Most coefficients of a chunk.
pub(super) const CHUNK: usize = 12;

/// A row of a neighbourhood that has gaps, or no room for a whole line behind it.
pub(super) const APART: u32 = u32::MAX;

/// Consecutive coefficients of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    pub x: i32,
    pub len: u32,
    pub start: u32,
    pub y: i32,
    pub z: i32,
}

/// Where the nodes lie: node n of an axis at n·step/refine voxels.
///
/// The finest nodes are the voxel centres, with `refine` − 1 more between them along the longer sides of voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Nodes {
    /// Finest nodes a voxel.
    pub refine: [i32; 3],
    /// Every how many finest nodes there is a coefficient: 1, 2 or 4.
    pub step: i32,
    /// Lowest node of the box.
    pub low: [i32; 3],
    /// Nodes of the box.
    pub dims: [usize; 3],
}

impl Nodes {
    pub fn of(mask: &Mask, refine: [i32; 3], step: i32) -> Nodes {
        // A voxel's own support, from the background voxel outside the array, and a node.
        let low = refine.map(|m| -(m + 2 * step + m / 2) / step - 2);
        let dims = std::array::from_fn(|a| {
            let high = mask.grid.dims[a] as i32 * refine[a] + 2 * step + refine[a] / 2;
            (high / step + 2 - low[a] + 1) as usize
        });
        Nodes { refine, step, low, dims }
    }

    /// First of the four nodes that carry the spline at voxel `i` of an axis, counted in the box, and the
    /// quarters of the way from the second to the third.
    pub fn first(&self, axis: usize, i: i64) -> (i32, u8) {
        let at = i as i32 * self.refine[axis];
        (at.div_euclid(self.step) - 1 - self.low[axis], (at.rem_euclid(self.step) * 4 / self.step) as u8)
    }

    /// The voxel nearest to a node of the box.
    pub fn voxel(&self, n: [i32; 3]) -> [i64; 3] {
        std::array::from_fn(|a| {
            let m = self.refine[a];
            (2 * (n[a] + self.low[a]) * self.step + m).div_euclid(2 * m) as i64
        })
    }
}

/// The band: which nodes carry a coefficient.
pub(super) struct Band {
    pub nodes: Nodes,
    pub runs: Vec<Run>,
    /// The runs cut to at most [`CHUNK`] coefficients, and the first of each layer.
    pub chunks: Vec<Run>,
    pub chunk_layers: Vec<u32>,
    /// Per chunk, where the ten rows of its neighbourhood begin that are whole, in the order of `energy::slot`; [`APART`] where not.
    pub places: Vec<[u32; 10]>,
    /// First run of each row (y fastest), and the number of runs at the end.
    rows: Vec<u32>,
    /// First coefficient of each z layer, and their number at the end.
    pub layers: Vec<u32>,
    /// Bit t: the t-th difference of [`TERMS`] that starts here lies in the band.
    pub valid: Vec<u16>,
}

impl Band {
    /// The nodes that carry the spline at the voxels `near`, and half a voxel round them.
    pub fn of(nodes: Nodes, near: &[Near]) -> Band {
        let dims = nodes.dims;
        let active = mark(&nodes, near);
        let mut band = Band {
            nodes,
            runs: Vec::new(),
            chunks: Vec::new(),
            chunk_layers: Vec::with_capacity(dims[2] + 1),
            places: Vec::new(),
            rows: Vec::with_capacity(dims[1] * dims[2] + 1),
            layers: Vec::with_capacity(dims[2] + 1),
            valid: Vec::new(),
        };
        let mut start = 0u32;
        for (r, row) in active.chunks(dims[0]).enumerate() {
            if r % dims[1] == 0 {
                band.layers.push(start);
                band.chunk_layers.push(band.chunks.len() as u32);
            }
            band.rows.push(band.runs.len() as u32);
            let (y, z) = ((r % dims[1]) as i32, (r / dims[1]) as i32);
            let mut x = 0;
            while let Some(a) = row[x..].iter().position(|&v| v != 0) {
                let a = x + a;
                let len = row[a..].iter().position(|&v| v == 0).unwrap_or(row.len() - a);
                band.runs.push(Run { x: a as i32, len: len as u32, start, y, z });
                for from in (0..len).step_by(CHUNK) {
                    let len = (len - from).min(CHUNK) as u32;
                    band.chunks.push(Run { x: (a + from) as i32, len, start: start + from as u32, y, z });
                }
                start += len as u32;
                x = a + len;
            }
        }
        band.rows.push(band.runs.len() as u32);
        band.layers.push(start);
        band.chunk_layers.push(band.chunks.len() as u32);
        // The box holds two more nodes than any active one needs, so that no index leaves the array.
        let valid: Vec<Vec<u16>> = band
            .runs
            .par_iter()
            .map(|r| {
                let base = r.x as usize + dims[0] * (r.y as usize + dims[1] * r.z as usize);
                (base..base + r.len as usize)
                    .map(|n| {
                        let at = |i: usize, j: usize, k: usize| {
                            active.get(n + i + dims[0] * (j + dims[1] * k)).is_some_and(|&a| a != 0)
                        };
                        let mut bits = 0u16;
                        for (t, (o, _)) in TERMS.iter().enumerate() {
                            let all = (0..=o[2]).all(|k| (0..=o[1]).all(|j| (0..=o[0]).all(|i| at(i, j, k))));
                            bits |= u16::from(all) << t;
                        }
                        bits
                    })
                    .collect()
            })
            .collect();
        band.valid = in_order(valid);
        let room = band.len().saturating_sub(CHUNK + 4);
        let place = |r: &Run, j: usize, k: usize| {
            let at = band.place(r.x, r.y + j as i32, r.z + k as i32, r.len as i32 + 3);
            at.filter(|&at| at as usize <= room).unwrap_or(APART)
        };
        let places = |r: &Run| {
            let mut out = [APART; 10];
            (0..4).for_each(|k| (0..4 - k).for_each(|j| out[slot(j, k)] = place(r, j, k)));
            out
        };
        band.places = band.chunks.par_iter().map(places).collect();
        band
    }

    /// Leaves out the chunks none of whose differences touches a coefficient that may change.
    pub fn skip_frozen(&mut self, frozen: &[bool]) {
        let mut layers = vec![0u32; self.chunk_layers.len()];
        let touches = |r: &Run| {
            (0..4).any(|k| {
                (0..4 - k).any(|j| {
                    let mut free = [0u8; CHUNK + 3];
                    self.fetch_with(r.y + j, r.z + k, r.x, &mut free, |n| u8::from(!frozen[n]));
                    free[..r.len as usize + 3].contains(&1)
                })
            })
        };
        let kept: Vec<bool> = self.chunks.par_iter().map(touches).collect();
        let chunks: Vec<Run> = self.chunks.iter().zip(&kept).filter(|(_, k)| **k).map(|(c, _)| *c).collect();
        self.places = self.places.iter().zip(&kept).filter(|(_, k)| **k).map(|(c, _)| *c).collect();
        for c in &chunks {
            layers[c.z as usize + 1] += 1;
        }
        for z in 1..layers.len() {
            layers[z] += layers[z - 1];
        }
        (self.chunks, self.chunk_layers) = (chunks, layers);
    }

    /// Number of coefficients.
    pub fn len(&self) -> usize {
        self.valid.len()
    }

    /// The runs of a row; none outside the box.
    pub fn row(&self, y: i32, z: i32) -> &[Run] {
        let dims = self.nodes.dims;
        if y < 0 || z < 0 || y as usize >= dims[1] || z as usize >= dims[2] {
            return &[];
        }
        let r = y as usize + dims[1] * z as usize;
        &self.runs[self.rows[r] as usize..self.rows[r + 1] as usize]
    }

    /// Place of the first of `len` consecutive coefficients from node (x, y, z) on; `None` unless all are there.
    pub fn place(&self, x: i32, y: i32, z: i32, len: i32) -> Option<u32> {
        let row = self.row(y, z);
        let r = row[..row.partition_point(|r| r.x <= x)].last()?;
        (x + len <= r.x + r.len as i32).then(|| r.start + (x - r.x) as u32)
    }

    /// The spline at a voxel index, where all its coefficients are in the band.
    pub fn value(&self, c: &[f32], voxel: &Vector) -> Option<f32> {
        let x: [f64; 3] = std::array::from_fn(|a| {
            voxel[a] * f64::from(self.nodes.refine[a]) / f64::from(self.nodes.step) - f64::from(self.nodes.low[a])
        });
        let cell = x.map(|x| x.floor() as i32 - 1);
        let [wx, wy, wz] = x.map(|x| weights(x - x.floor()));
        let mut sum = 0.0;
        for k in 0..4 {
            for j in 0..4 {
                let at = self.place(cell[0], cell[1] + j as i32, cell[2] + k as i32, 4)? as usize;
                let row: f64 = wx.iter().zip(&c[at..at + 4]).map(|(w, c)| w * f64::from(*c)).sum();
                sum += wy[j] * wz[k] * row;
            }
        }
        Some(sum as f32)
    }

    /// Copies `values` of row (y, z) from `x` on into `out`, and leaves what has no coefficient.
    #[inline]
    pub fn fetch(&self, values: &[f32], y: i32, z: i32, x: i32, out: &mut [f32]) {
        let end = x + out.len() as i32;
        for r in self.row(y, z) {
            let (a, b) = (r.x.max(x), (r.x + r.len as i32).min(end));
            if a < b {
                let from = r.start as usize + (a - r.x) as usize;
                out[(a - x) as usize..(b - x) as usize].copy_from_slice(&values[from..from + (b - a) as usize]);
            }
            if r.x >= end {
                break;
            }
        }
    }

    /// As [`Band::fetch`], with what `f` makes of a coefficient's place.
    fn fetch_with<T>(&self, y: i32, z: i32, x: i32, out: &mut [T], f: impl Fn(usize) -> T) {
        let end = x + out.len() as i32;
        for r in self.row(y, z) {
            for n in r.x.max(x)..(r.x + r.len as i32).min(end) {
                out[(n - x) as usize] = f((r.start as i32 + n - r.x) as usize);
            }
        }
    }

    /// Adds `add` to `values` of row (y, z) from `x` on, where there are coefficients; `values` starts at `first`.
    #[inline]
    pub fn add(&self, values: &mut [f32], first: usize, y: i32, z: i32, x: i32, add: &[f32]) {
        let end = x + add.len() as i32;
        for r in self.row(y, z) {
            let (a, b) = (r.x.max(x), (r.x + r.len as i32).min(end));
            if a < b {
                let to = r.start as usize + (a - r.x) as usize - first;
                let from = &add[(a - x) as usize..(b - x) as usize];
                values[to..to + (b - a) as usize].iter_mut().zip(from).for_each(|(v, f)| *v += f);
            }
            if r.x >= end {
                break;
            }
        }
    }
}

/// One byte a node of the box: whether it carries a coefficient.
fn mark(nodes: &Nodes, near: &[Near]) -> Vec<u8> {
    let Nodes { refine, step, low, dims } = *nodes;
    let mut active = vec![0u8; dims.iter().product()];
    for v in near {
        let range = |a: usize| {
            // Twice the distance in finest nodes: four nodes carry the spline, and half a voxel.
            let (at, reach) = (2 * v.voxel[a] as i32 * refine[a], 4 * step + refine[a]);
            let first = (at - reach + 2 * step - 1).div_euclid(2 * step) - low[a];
            let last = (at + reach).div_euclid(2 * step) - low[a];
            first.max(0) as usize..((last + 1).max(0) as usize).min(dims[a])
        };
        let x = range(0);
        for z in range(2) {
            for y in range(1) {
                let row = dims[0] * (y + dims[1] * z);
                active[row + x.start..row + x.end].fill(1);
            }
        }
    }
    active
}
