//! The labels that the fit is to respect: voxels at the wall, and the spline's value and gradient there.

use rayon::prelude::*;

use super::band::{Band, Nodes};
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
    /// By the phases along the three axes, weights of a cell's coefficients.
    taps: Vec<Taps>,
}

/// Values of the 64 coefficients of a cell, x fastest: what fits the registers of any processor.
pub(super) type Block = [f32; 64];

/// Weights of a cell's coefficients: for the value and for the derivatives along x, y, z, per smallest spacing.
pub(super) type Taps = [Block; 4];

impl Labels {
    /// The boundary voxels `near` and their neighbours, as far as the band carries the spline there.
    ///
    /// `second`: with the neighbours. `scale`: finest nodes a smallest spacing, per axis.
    pub fn of(mask: &Mask, band: &Band, near: &[Near], second: bool, scale: [f32; 3]) -> Labels {
        let nodes = band.nodes;
        let size: [usize; 3] = std::array::from_fn(|a| mask.grid.dims[a] + 4);
        let mut wanted = vec![0u8; size.iter().product()];
        let at = |v: [i16; 3]| (v[0] + 2) as usize + size[0] * ((v[1] + 2) as usize + size[1] * (v[2] + 2) as usize);
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
                    let voxel = [(n % size[0]) as i64 - 2, (n / size[0]) as i64 - 2, k as i64 - 2];
                    let first: [(i32, u8); 3] = std::array::from_fn(|a| nodes.first(a, voxel[a]));
                    let key = (0..3).rev().fold(0u64, |key, a| key * nodes.dims[a] as u64 + first[a].0.max(0) as u64);
                    let phase = (0..3).fold(0, |p, a| p | first[a].1 << (2 * a));
                    let sign = if mask.at(voxel[0], voxel[1], voxel[2]) { -1 } else { 1 };
                    out.push((key, Label { voxel: voxel.map(|v| v as i16), sign, phase, axes: w & 7 }));
                }
                out
            })
            .collect();
        let mut found = in_order(slabs);
        found.par_sort_by_key(|(key, _)| *key);
        let mut out = Labels { labels: Vec::new(), cells: Vec::new(), layers: vec![0; nodes.dims[2] + 1], taps: taps(&nodes, scale) };
        for group in found.chunk_by(|a, b| a.0 == b.0) {
            let low: [i32; 3] = std::array::from_fn(|a| nodes.first(a, i64::from(group[0].1.voxel[a])).0);
            let rows: [Option<u32>; 16] =
                std::array::from_fn(|n| band.place(low[0], low[1] + (n % 4) as i32, low[2] + (n / 4) as i32, 4));
            if low.iter().any(|&n| n < 0) || rows.contains(&None) {
                continue;
            }
            out.cells.push(Cell { rows: rows.map(Option::unwrap_or_default), first: out.labels.len() as u32, frozen: false });
            out.layers[low[2] as usize + 1] = out.cells.len() as u32;
            out.labels.extend(group.iter().map(|(_, l)| *l));
        }
        for k in 1..out.layers.len() {
            out.layers[k] = out.layers[k].max(out.layers[k - 1]);
        }
        out
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
    pub fn taps(&self, label: usize) -> &Taps {
        &self.taps[usize::from(self.labels[label].phase)]
    }

    /// Value and gradient (per smallest spacing) of the spline at every label.
    pub fn sample(&self, c: &[f32]) -> Vec<[f32; 4]> {
        const PIECE: usize = 256;
        let arch = pulp::Arch::new();
        let piece = |first: usize| {
            let cells = first..(first + PIECE).min(self.cells.len());
            arch.dispatch(Sampling { labels: self, c, cells })
        };
        in_order((0..self.cells.len()).into_par_iter().step_by(PIECE).map(piece).collect())
    }
}

/// The spline at the labels of some cells; compiled for several kinds of processor.
struct Sampling<'a> {
    labels: &'a Labels,
    c: &'a [f32],
    cells: std::ops::Range<usize>,
}

impl pulp::WithSimd for Sampling<'_> {
    type Output = Vec<[f32; 4]>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<[f32; 4]> {
        let Sampling { labels, c, cells } = self;
        let mut out = Vec::with_capacity(4 * cells.len());
        for cell in cells {
            let block = gather(c, &labels.cells[cell].rows);
            for l in labels.of_cell(cell) {
                let t = labels.taps(l);
                out.push([dot(&t[0], &block), dot(&t[1], &block), dot(&t[2], &block), dot(&t[3], &block)]);
            }
        }
        out
    }
}

/// The coefficients of a cell.
#[inline(always)]
pub(super) fn gather(c: &[f32], rows: &[u32; 16]) -> Block {
    let mut out = [0.0; 64];
    for (row, &at) in out.chunks_exact_mut(4).zip(rows) {
        row.copy_from_slice(&c[at as usize..at as usize + 4]);
    }
    out
}

/// Their product, summed in eight lanes.
#[inline(always)]
pub(super) fn dot(a: &Block, b: &Block) -> f32 {
    let mut s = [0.0f32; 8];
    for n in 0..8 {
        for i in 0..8 {
            s[i] += a[8 * n + i] * b[8 * n + i];
        }
    }
    ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]))
}

/// By the phases, bits 2a and 2a+1 the quarters of the way from one node to the next along axis a.
fn taps(nodes: &Nodes, scale: [f32; 3]) -> Vec<Taps> {
    let axis = |a: usize, phases: usize| {
        let t = (phases >> (2 * a) & 3) as f64 / 4.0;
        let slope = f64::from(scale[a]) / f64::from(nodes.step);
        [spline::weights(t).map(|w| w as f32), spline::slopes(t).map(|w| (w * slope) as f32)]
    };
    let of = |phases: usize| {
        let [x, y, z] = [axis(0, phases), axis(1, phases), axis(2, phases)];
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|o| std::array::from_fn(|n| x[o[0]][n % 4] * y[o[1]][n / 4 % 4] * z[o[2]][n / 16]))
    };
    (0..64).map(of).collect()
}
