//! The labels that the fit is to respect: voxels at the wall, and the spline's value and gradient there.

use rayon::prelude::*;

use super::band::{Band, Nodes};
use super::lanes::{Job, Lanes, Line, dispatch};
use super::spline;
use crate::mask::Mask;

/// A voxel with a face neighbour of the other label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Near {
    pub voxel: [i16; 3],
    /// Bit a: the neighbour along axis a.
    pub axes: u8,
}

/// The boundary voxels of both labels, in the order of the array; beyond the mask lies background.
pub(super) fn boundary(interface: &[([i32; 3], u8)]) -> Vec<Near> {
    interface.iter().map(|&(v, axes)| Near { voxel: v.map(|v| v as i16), axes }).collect()
}

/// Joins what threads made piece by piece.
pub(super) fn in_order<T>(parts: Vec<Vec<T>>) -> Vec<T> {
    let mut out = Vec::with_capacity(parts.iter().map(Vec::len).sum());
    for p in parts {
        out.extend(p);
    }
    out
}

/// A label: what a voxel says about the sign of the function.
#[derive(Debug, Clone, Copy)]
pub(super) struct Label {
    pub voxel: [i16; 3],
    /// −1 in the lumen, +1 outside.
    pub sign: i8,
    /// Bits 2a and 2a+1: where the voxel lies between two nodes along axis a, in quarters.
    pub phase: u8,
    /// Axes along which a neighbour has the other label; 0 in the second layer.
    pub axes: u8,
}

/// Labels in the same cell of the spline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    /// Places of the 16 rows of 4 coefficients.
    pub rows: [u32; 16],
    /// First label; the next cell's first is the end.
    pub first: u32,
    /// Whether none of the coefficients may change.
    pub frozen: bool,
}

/// All labels, sorted by cell.
pub(super) struct Labels {
    pub labels: Vec<Label>,
    pub cells: Vec<Cell>,
    /// First cell whose lowest node lies in a layer, and the number of cells at the end.
    pub layers: Vec<u32>,
    /// By the phases along x and y, weights of a cell's coefficients across z.
    across: Vec<[Line; 3]>,
    /// By the phase along z, weights along it.
    along: Vec<[[f32; 4]; 2]>,
}

/// The 64 coefficients of a cell, x fastest, a line for each z.
pub(super) type Block<L> = [<L as Lanes>::Wide; 4];

/// Weights of a cell's coefficients for the value and the derivatives at a label, per smallest spacing: products of those across
/// z and those along z.
#[derive(Debug, Clone, Copy)]
pub(super) struct Taps<'a> {
    /// For the value, for the derivatives along x and y.
    across: &'a [Line; 3],
    /// For the value and for the derivative along z.
    along: &'a [[f32; 4]; 2],
}

impl Taps<'_> {
    #[inline(always)]
    fn load<L: Lanes>(&self, l: L) -> [L::Wide; 3] {
        [l.load(&self.across[0]), l.load(&self.across[1]), l.load(&self.across[2])]
    }

    /// Value and gradient, given the coefficients.
    #[inline(always)]
    pub fn sample<L: Lanes>(&self, l: L, block: &Block<L>) -> [f32; 4] {
        let [z, dz] = self.along;
        let [mut value, mut slope] = [l.mul(l.splat(z[0]), block[0]), l.mul(l.splat(dz[0]), block[0])];
        for k in 1..4 {
            value = l.mul_add(l.splat(z[k]), block[k], value);
            slope = l.mul_add(l.splat(dz[k]), block[k], slope);
        }
        let [w, x, y] = self.load(l);
        l.sums([l.mul(w, value), l.mul(x, value), l.mul(y, value), l.mul(w, slope)])
    }

    /// Adds to the coefficients the effect of `p` on the value and of `q` on the gradient.
    #[inline(always)]
    pub fn spread<L: Lanes>(&self, l: L, sum: &mut Block<L>, p: f32, q: [f32; 3]) {
        let [w, x, y] = self.load(l);
        let level = l.mul_add(l.splat(p), w, l.mul_add(l.splat(q[0]), x, l.mul(l.splat(q[1]), y)));
        let steep = l.mul(l.splat(q[2]), w);
        let [value, slope] = self.along;
        for k in 0..4 {
            sum[k] = l.mul_add(l.splat(value[k]), level, l.mul_add(l.splat(slope[k]), steep, sum[k]));
        }
    }

    /// Adds the squares of the weights for the value, `p` times, and for the derivative along `n`.
    #[inline(always)]
    pub fn squares<L: Lanes>(&self, l: L, sum: &mut Block<L>, p: f32, n: [f32; 3]) {
        let [w, x, y] = self.load(l);
        let level = l.mul_add(l.splat(n[0]), x, l.mul(l.splat(n[1]), y));
        let steep = l.mul(l.splat(n[2]), w);
        let [value, slope] = self.along;
        for k in 0..4 {
            let (v, s) = (l.splat(value[k]), l.splat(slope[k]));
            let (at, along) = (l.mul(v, w), l.mul_add(v, level, l.mul(s, steep)));
            sum[k] = l.mul_add(l.mul(l.splat(p), at), at, l.mul_add(along, along, sum[k]));
        }
    }
}

impl Labels {
    /// The boundary voxels `near` and their neighbours, as far as the band carries the spline there.
    ///
    /// `second`: with the neighbours. `scale`: finest nodes a smallest spacing, per axis.
    pub fn of(mask: &Mask, band: &Band, near: &[Near], second: bool, scale: [f32; 3]) -> Labels {
        let nodes = band.nodes;
        // The box of these voxels and their neighbours.
        let low: [i16; 3] = std::array::from_fn(|a| near.iter().map(|n| n.voxel[a]).min().unwrap_or(0) - 1);
        let size: [usize; 3] = std::array::from_fn(|a| (near.iter().map(|n| n.voxel[a]).max().unwrap_or(0) + 2 - low[a]) as usize);
        let mut wanted = vec![0u8; size.iter().product()];
        let at = |v: [i16; 3]| (v[0] - low[0]) as usize + size[0] * ((v[1] - low[1]) as usize + size[1] * (v[2] - low[2]) as usize);
        for n in near.iter().filter(|_| second) {
            for k in -1..=1 {
                for j in -1..=1 {
                    let from = at([n.voxel[0] - 1, n.voxel[1] + j, n.voxel[2] + k]);
                    wanted[from..from + 3].iter_mut().for_each(|w| *w |= 8);
                }
            }
        }
        for n in near {
            wanted[at(n.voxel)] |= n.axes;
        }
        let slabs: Vec<Vec<(u64, Label)>> = wanted
            .par_chunks(size[0] * size[1])
            .enumerate()
            .map(|(k, layer)| {
                let mut out = Vec::new();
                for (n, &w) in layer.iter().enumerate().filter(|(_, w)| **w != 0) {
                    let voxel: [i64; 3] = std::array::from_fn(|a| [n % size[0], n / size[0], k][a] as i64 + i64::from(low[a]));
                    let first: [(i32, u8); 3] = std::array::from_fn(|a| nodes.first(a, voxel[a]));
                    let key = key(&nodes, first.map(|f| f.0));
                    let phase = (0..3).fold(0, |p, a| p | first[a].1 << (2 * a));
                    let sign = if mask.at(voxel[0], voxel[1], voxel[2]) { -1 } else { 1 };
                    out.push((key, Label { voxel: voxel.map(|v| v as i16), sign, phase, axes: w & 7 }));
                }
                out
            })
            .collect();
        let mut found = in_order(slabs);
        found.par_sort_by_key(|(key, _)| *key);
        let mut out = Labels { labels: Vec::new(), cells: Vec::new(), layers: vec![0; nodes.dims[2] + 1], across: across(&nodes, scale), along: along(&nodes, scale) };
        for group in found.chunk_by(|a, b| a.0 == b.0) {
            let low: [i32; 3] = std::array::from_fn(|a| nodes.first(a, i64::from(group[0].1.voxel[a])).0);
            let Some(rows) = rows_of(band, low) else { continue };
            out.cells.push(Cell { rows, first: out.labels.len() as u32, frozen: false });
            out.layers[low[2] as usize + 1] = out.cells.len() as u32;
            out.labels.extend(group.iter().map(|(_, l)| *l));
        }
        for k in 1..out.layers.len() {
            out.layers[k] = out.layers[k].max(out.layers[k - 1]);
        }
        out
    }

    /// Place of a voxel's label; `nodes`: the band's.
    pub fn find(&self, nodes: &Nodes, voxel: [i16; 3]) -> Option<usize> {
        let of = |v: [i16; 3]| key(nodes, std::array::from_fn(|a| nodes.first(a, i64::from(v[a])).0));
        let cell = self.cells.binary_search_by_key(&of(voxel), |c| of(self.labels[c.first as usize].voxel)).ok()?;
        self.of_cell(cell).find(|&l| self.labels[l].voxel == voxel)
    }

    /// Marks the cells none of whose coefficients may change.
    pub fn skip_frozen(&mut self, frozen: &[bool]) {
        self.cells.par_iter_mut().for_each(|c| c.frozen = c.rows.iter().all(|&r| frozen[r as usize..r as usize + 4].iter().all(|&f| f)));
    }

    /// The cells whose lowest nodes lie in some layers, save those that are skipped.
    pub fn moving(&self, layers: &std::ops::Range<usize>) -> impl Iterator<Item = usize> {
        (self.layers[layers.start] as usize..self.layers[layers.end] as usize).filter(|&c| !self.cells[c].frozen)
    }

    /// The labels of a cell, as places in [`Labels::labels`].
    pub fn of_cell(&self, c: usize) -> std::ops::Range<usize> {
        let end = self.cells.get(c + 1).map_or(self.labels.len(), |c| c.first as usize);
        self.cells[c].first as usize..end
    }

    /// Weights of a label in its cell.
    #[inline(always)]
    pub fn taps(&self, label: usize) -> Taps<'_> {
        let phase = usize::from(self.labels[label].phase);
        Taps { across: &self.across[phase & 15], along: &self.along[phase >> 4] }
    }

    /// Value and gradient (per smallest spacing) of the spline at every label.
    pub fn sample(&self, c: &[f32]) -> Vec<[f32; 4]> {
        const PIECE: usize = 256;
        let piece = |first: usize| dispatch(Sampling { labels: self, c, cells: first..(first + PIECE).min(self.cells.len()) });
        in_order((0..self.cells.len()).into_par_iter().step_by(PIECE).map(piece).collect())
    }
}

/// The order of cells, by their lowest nodes.
fn key(nodes: &Nodes, low: [i32; 3]) -> u64 {
    (0..3).rev().fold(0u64, |key, a| key * nodes.dims[a] as u64 + low[a].max(0) as u64)
}

/// Places of the 16 rows of the cell whose lowest node is `low`, where the band has them all.
fn rows_of(band: &Band, low: [i32; 3]) -> Option<[u32; 16]> {
    let mut rows = [0; 16];
    for (n, row) in (0..).zip(&mut rows) {
        *row = band.place(low[0], low[1] + n % 4, low[2] + n / 4, 4)?;
    }
    low.iter().all(|&n| n >= 0).then_some(rows)
}

/// The spline at the labels of some cells.
struct Sampling<'a> {
    labels: &'a Labels,
    c: &'a [f32],
    cells: std::ops::Range<usize>,
}

impl Job for Sampling<'_> {
    type Output = Vec<[f32; 4]>;

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) -> Vec<[f32; 4]> {
        let Sampling { labels, c, cells } = self;
        let mut out = Vec::with_capacity(4 * cells.len());
        for cell in cells {
            let block = gather(l, c, &labels.cells[cell].rows);
            for n in labels.of_cell(cell) {
                out.push(labels.taps(n).sample(l, &block));
            }
        }
        out
    }
}

/// The coefficients of a cell.
#[inline(always)]
pub(super) fn gather<L: Lanes>(l: L, c: &[f32], rows: &[u32; 16]) -> Block<L> {
    let mut block = [l.splat(0.0); 4];
    for k in 0..4 {
        let mut pieces = [[0.0; 4]; 4];
        for (piece, &at) in pieces.iter_mut().zip(&rows[4 * k..]) {
            *piece = c[at as usize..].first_chunk().copied().unwrap_or_default();
        }
        block[k] = l.join(pieces);
    }
    block
}

/// Adds the rows of a cell to `part`, which starts at the coefficient `first`.
#[inline(always)]
pub(super) fn scatter<L: Lanes>(l: L, part: &mut [f32], first: usize, rows: &[u32; 16], sum: Block<L>) {
    for (sum, rows) in sum.into_iter().zip(rows.chunks_exact(4)) {
        for (row, &at) in l.store(sum).chunks_exact(4).zip(rows) {
            let at = at as usize - first;
            part[at..at + 4].iter_mut().zip(row).for_each(|(o, s)| *o += s);
        }
    }
}

/// Weights for the value and the derivative at a phase, quarters of the way from one node to the next along an axis.
fn weights(nodes: &Nodes, scale: [f32; 3], axis: usize, phase: usize) -> [[f32; 4]; 2] {
    let t = phase as f64 / 4.0;
    let slope = f64::from(scale[axis]) / f64::from(nodes.step);
    [spline::weights(t).map(|w| w as f32), spline::slopes(t).map(|w| (w * slope) as f32)]
}

/// By the phases along x (bits 0 and 1) and y.
fn across(nodes: &Nodes, scale: [f32; 3]) -> Vec<[Line; 3]> {
    let of = |phases: usize| {
        let [x, y] = [weights(nodes, scale, 0, phases & 3), weights(nodes, scale, 1, phases >> 2)];
        [[0, 0], [1, 0], [0, 1]].map(|o| std::array::from_fn(|n| x[o[0]][n % 4] * y[o[1]][n / 4]))
    };
    (0..16).map(of).collect()
}

/// By the phase along z.
fn along(nodes: &Nodes, scale: [f32; 3]) -> Vec<[[f32; 4]; 2]> {
    (0..4).map(|phase| weights(nodes, scale, 2, phase)).collect()
}
