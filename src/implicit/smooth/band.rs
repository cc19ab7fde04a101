//! The narrow band of spline coefficients round the boundary of a mask, stored as runs along x.

use rayon::prelude::*;

use super::labels::{Near, in_order};
use super::energy::slot;
use super::lanes::Line;
use super::neighbourhood::Neighbourhood;
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

/// Most coefficients of a chunk: differences look at three more.
pub(super) const CHUNK: usize = 12;

/// Nodes of a row that a chunk's differences look at, and a few more: a whole number of the processor's vectors.
pub(super) const LINE: usize = size_of::<Line>() / size_of::<f32>();

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
            (high / step + 3 - low[a] + 1) as usize
        });
        Nodes { refine, step, low, dims }
    }

    /// First of the four nodes that carry the spline at voxel `i` of an axis, counted in the box, and the
    /// quarters of the way from the second to the third.
    pub fn first(&self, axis: usize, i: i64) -> (i32, u8) {
        let at = i as i32 * self.refine[axis];
        (at.div_euclid(self.step) - 1 - self.low[axis], (at.rem_euclid(self.step) * 4 / self.step) as u8)
    }

    /// The voxels nearest to the nodes along an axis.
    pub fn voxels(&self, axis: usize) -> Vec<i16> {
        (0..self.dims[axis] as i32).map(|n| self.voxel([n; 3])[axis] as i16).collect()
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
///
/// The coefficients are stored with idle places between them, always 0, so that every row of a chunk's neighbourhood is
/// one piece.
pub(super) struct Band {
    pub nodes: Nodes,
    pub runs: Vec<Run>,
    /// Runs of coefficients at which a difference of [`TERMS`] starts, at most [`CHUNK`] long, and the first of each layer.
    pub chunks: Vec<Run>,
    pub chunk_layers: Vec<u32>,
    /// Per chunk and term, bit i: the difference that starts at the i-th coefficient lies in the band. 0 behind the chunk's own.
    pub valid: Vec<[u16; 10]>,
    /// Per chunk, where the ten rows of its neighbourhood begin, in the order of `energy::slot`.
    pub places: Vec<[u32; 10]>,
    /// First run of each row (y fastest), and the number of runs at the end.
    rows: Vec<u32>,
    /// First place of each z layer, and the number of places at the end.
    pub layers: Vec<u32>,
}

impl Band {
    /// The nodes that carry the spline at the voxels `near`, and half a voxel round them; of these the ones at a voxel of `within`.
    pub fn of(nodes: Nodes, near: &[Near], within: Option<&Neighbourhood>) -> Band {
        let [nx, ny, nz] = nodes.dims;
        let mut marked = mark(&nodes, near);
        if let Some(within) = within {
            marked.clip(&nodes, within);
        }
        let mut runs = Vec::new();
        let mut rows = Vec::with_capacity(ny * nz + 1);
        for r in 0..ny * nz {
            rows.push(runs.len() as u32);
            let (y, z) = ((r % ny) as i32, (r / ny) as i32);
            for (x, len) in marked.pieces(r) {
                runs.push(Run { x: x as i32, len: len as u32, start: 0, y, z });
                // How many nodes there are from each on, as far as differences reach.
                marked.bytes[nx * r + x..][..len].iter_mut().rev().zip(1..).for_each(|(v, n)| *v = n.min(4));
            }
        }
        rows.push(runs.len() as u32);
        let cut = |r: &Run| chunks_of(&marked.bytes, [nx, ny], r);
        let (chunks, valid): (Vec<Run>, Vec<[u16; 10]>) = in_order(runs.par_iter().map(cut).collect()).into_iter().unzip();
        // What is stored: the band, and what the chunks look at.
        for c in &chunks {
            for (j, k) in ROWS {
                marked.fill(c.x as usize, c.len as usize + 3, (c.y + j) as usize + ny * (c.z + k) as usize);
            }
        }
        let mut start = 0u32;
        let mut stored = Vec::new();
        let mut stored_rows = Vec::with_capacity(ny * nz + 1);
        let mut layers = Vec::with_capacity(nz + 1);
        for r in 0..ny * nz {
            if r % ny == 0 {
                // Room behind the last row for a whole line.
                start += if layers.last().is_some_and(|&l| l < start) { LINE as u32 } else { 0 };
                layers.push(start);
            }
            stored_rows.push(stored.len() as u32);
            let mut own = runs[rows[r] as usize..rows[r + 1] as usize].iter_mut().peekable();
            for (x, len) in marked.pieces(r) {
                while let Some(run) = own.next_if(|run| run.x < (x + len) as i32) {
                    run.start = start + run.x as u32 - x as u32;
                }
                stored.push((x as u32, start));
                start += len as u32;
            }
        }
        stored_rows.push(stored.len() as u32);
        layers.push(start + LINE as u32);
        let place = |c: &Run| {
            ROWS.map(|(j, k)| {
                let r = (c.y + j) as usize + ny * (c.z + k) as usize;
                let row = &stored[stored_rows[r] as usize..stored_rows[r + 1] as usize];
                let (x, start) = row[row.partition_point(|p| p.0 <= c.x as u32).saturating_sub(1)];
                start + c.x as u32 - x
            })
        };
        let places = chunks.par_iter().map(place).collect();
        let mut band = Band { nodes, runs, chunks, chunk_layers: Vec::new(), valid, places, rows, layers };
        band.count_chunks();
        band
    }

    fn count_chunks(&mut self) {
        let mut layers = vec![0u32; self.nodes.dims[2] + 1];
        self.chunks.iter().for_each(|c| layers[c.z as usize + 1] += 1);
        (1..layers.len()).for_each(|z| layers[z] += layers[z - 1]);
        self.chunk_layers = layers;
    }

    /// Leaves out the chunks none of whose differences touches a coefficient that may change.
    pub fn skip_frozen(&mut self, frozen: &[bool]) {
        let touches = |(c, places): (&Run, &[u32; 10])| places.iter().any(|&at| !frozen[at as usize..][..c.len as usize + 3].iter().all(|&f| f));
        let kept: Vec<bool> = self.chunks.par_iter().zip(&self.places).map(touches).collect();
        let mut flags = kept.iter();
        self.chunks.retain(|_| flags.next() == Some(&true));
        let mut flags = kept.iter();
        self.places.retain(|_| flags.next() == Some(&true));
        let mut flags = kept.iter();
        self.valid.retain(|_| flags.next() == Some(&true));
        self.count_chunks();
    }

    /// Places of coefficients, the idle ones included.
    pub fn len(&self) -> usize {
        self.layers.last().map_or(0, |&n| n as usize)
    }

    /// Number of coefficients.
    pub fn coefficients(&self) -> usize {
        self.runs.iter().map(|r| r.len as usize).sum()
    }

    /// For every place of a coefficient what `f` makes of its run; `idle` at the others.
    pub fn fill<T: Copy + Send>(&self, idle: T, f: impl Fn(&Run) -> Vec<T> + Sync + Send) -> Vec<T> {
        let mut out = vec![idle; self.len()];
        let parts: Vec<Vec<T>> = self.runs.par_iter().map(f).collect();
        for (r, part) in self.runs.iter().zip(parts) {
            out[r.start as usize..(r.start + r.len) as usize].copy_from_slice(&part);
        }
        out
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
}

/// Rows (y, z) that differences reach, in the order of `energy::slot`.
const ROWS: [(i32, i32); 10] = [(0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (0, 3)];

/// The pieces of a run at which differences start, and which, by how many nodes there are from each node on (at most 4).
fn chunks_of(nodes: &[u8], [nx, ny]: [usize; 2], r: &Run) -> Vec<(Run, [u16; 10])> {
    let mut out: Vec<(Run, [u16; 10])> = Vec::new();
    let mut from = 0;
    while from < r.len {
        let len = (r.len - from).min(CHUNK as u32);
        let at = (r.x as u32 + from) as usize + nx * (r.y as usize + ny * r.z as usize);
        // Least of the rows up to (j, k).
        let mut least = [[u8::MAX; CHUNK]; 10];
        for (row, (j, k)) in ROWS.into_iter().enumerate() {
            let there = &nodes[at + nx * (j as usize + ny * k as usize)..][..CHUNK];
            let before = [(j > 0).then(|| slot(j as usize - 1, k as usize)), (k > 0).then(|| slot(j as usize, k as usize - 1))];
            for i in 0..CHUNK {
                let low = |s: Option<usize>| s.map_or(u8::MAX, |s| least[s][i]);
                least[row][i] = there[i].min(low(before[0])).min(low(before[1]));
            }
        }
        let own = (1u16 << len) - 1;
        let valid = TERMS.map(|(o, _)| {
            let row = &least[slot(o[1], o[2])];
            (0..CHUNK).fold(0u16, |bits, i| bits | u16::from(usize::from(row[i]) > o[0]) << i) & own
        });
        let any = valid.iter().fold(0, |any, v| any | v);
        if any == 0 {
            from += len;
            continue;
        }
        if any & 1 == 0 {
            // The next piece begins where a difference does.
            from += any.trailing_zeros();
            continue;
        }
        let len = 16 - any.leading_zeros();
        out.push((Run { x: r.x + from as i32, len, start: 0, y: r.y, z: r.z }, valid));
        from += len;
    }
    out
}

/// A byte a node of the box, 0 unless marked, and between which nodes of each row any are.
struct Marked {
    width: usize,
    bytes: Vec<u8>,
    spans: Vec<std::ops::Range<u32>>,
}

impl Marked {
    /// Marks `len` nodes of a row from `x` on.
    fn fill(&mut self, x: usize, len: usize, row: usize) {
        let end = (x + len).min(self.width);
        self.bytes[self.width * row..][x..end].iter_mut().filter(|v| **v == 0).for_each(|v| *v = 1);
        let span = &mut self.spans[row];
        *span = if span.start >= span.end { x as u32..end as u32 } else { span.start.min(x as u32)..span.end.max(end as u32) };
    }

    /// Takes the marks off nodes whose voxel lies not `within`.
    fn clip(&mut self, nodes: &Nodes, within: &Neighbourhood) {
        let [x, y, z] = [0, 1, 2].map(|a| nodes.voxels(a));
        for (row, span) in self.spans.iter().enumerate().filter(|(_, s)| s.start < s.end) {
            let (y, z) = (y[row % y.len()], z[row / y.len()]);
            let range = span.start as usize..span.end as usize;
            for (v, &x) in self.bytes[self.width * row..][range.clone()].iter_mut().zip(&x[range]).filter(|(v, _)| **v != 0) {
                *v = u8::from(within.holds([x, y, z]));
            }
        }
    }

    /// First node and length of the pieces of a row that are marked.
    fn pieces(&self, row: usize) -> Vec<(usize, usize)> {
        let span = &self.spans[row];
        let (mut x, end) = (span.start as usize, span.end as usize);
        let bytes = &self.bytes[self.width * row..][..end];
        let mut out = Vec::new();
        while let Some(a) = bytes[x..].iter().position(|&v| v != 0) {
            let a = x + a;
            let len = bytes[a..].iter().position(|&v| v == 0).unwrap_or(end - a);
            out.push((a, len));
            x = a + len;
        }
        out
    }
}

/// Which nodes of the box carry a coefficient.
fn mark(nodes: &Nodes, near: &[Near]) -> Marked {
    let Nodes { refine, step, low, dims } = *nodes;
    // Differences look three rows and layers on.
    let beyond = LINE + 3 * dims[0] * (1 + dims[1]);
    let mut marked = Marked { width: dims[0], bytes: vec![0u8; dims.iter().product::<usize>() + beyond], spans: vec![0..0; dims[1] * dims[2]] };
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
                marked.fill(x.start, x.len(), y + dims[1] * z);
            }
        }
    }
    marked
}
