//! The narrow band of spline coefficients round the boundary of a mask, stored as runs along x.

use rayon::prelude::*;

use crate::geometry::Vector;
use crate::mask::Mask;

/// Differences of the third order, as orders along x, y, z, and their multiplicity in |D³u|².
pub(super) const TERMS: [([usize; 3], f32); 10] = [
    ([3, 0, 0], 1.0),
    ([2, 1, 0], 3.0),
    ([2, 0, 1], 3.0),
    ([1, 2, 0], 3.0),
    ([1, 1, 1], 6.0),
    ([1, 0, 2], 3.0),
    ([0, 3, 0], 1.0),
    ([0, 2, 1], 3.0),
    ([0, 1, 2], 3.0),
    ([0, 0, 3], 1.0),
];

/// Most coefficients of a chunk.
pub(super) const CHUNK: usize = 12;

/// Consecutive coefficients of a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    pub x: i32,
    pub len: u32,
    pub start: u32,
    pub y: i32,
    pub z: i32,
}

/// The band: which nodes of the refined voxel grid carry a coefficient.
///
/// Node (i, j, k) lies at voxel index (i/m₀, j/m₁, k/m₂), where m is `refine`.
pub(super) struct Band {
    pub refine: [i32; 3],
    /// Lowest node of the box.
    pub low: [i32; 3],
    /// Nodes of the box.
    pub dims: [usize; 3],
    pub runs: Vec<Run>,
    /// The runs cut to at most [`CHUNK`] coefficients, and the first of each layer.
    pub chunks: Vec<Run>,
    pub chunk_layers: Vec<u32>,
    /// First run of each row (y fastest), and the number of runs at the end.
    pub rows: Vec<u32>,
    /// First coefficient of each z layer, and their number at the end.
    pub layers: Vec<u32>,
    /// −1 at object voxels, +1 at background voxels, 0 at nodes that are no voxel or lack support.
    pub sign: Vec<i8>,
    /// −1 or +1: label of the nearest voxel.
    pub side: Vec<i8>,
    /// Bit t: the t-th difference of [`TERMS`] that starts here lies in the band.
    pub valid: Vec<u16>,
}

impl Band {
    /// The nodes within a voxel (and one node more) of every voxel that touches the other label.
    pub fn of(mask: &Mask, refine: [i32; 3]) -> Band {
        let m = refine;
        let low = m.map(|m| -(2 * m + 3));
        let dims: [usize; 3] =
            std::array::from_fn(|a| (mask.grid.dims[a] as i32 - 1) as usize * m[a] as usize + 2 * (2 * m[a] + 3) as usize + 1);
        let active = mark(mask, m, low, dims);
        let mut runs = Vec::new();
        let mut chunks = Vec::new();
        let mut chunk_layers = Vec::with_capacity(dims[2] + 1);
        let mut rows = Vec::with_capacity(dims[1] * dims[2] + 1);
        let mut layers = Vec::with_capacity(dims[2] + 1);
        let mut start = 0u32;
        for (r, row) in active.chunks(dims[0]).enumerate() {
            if r % dims[1] == 0 {
                layers.push(start);
                chunk_layers.push(chunks.len() as u32);
            }
            rows.push(runs.len() as u32);
            let (y, z) = ((r % dims[1]) as i32, (r / dims[1]) as i32);
            let mut x = 0;
            while let Some(a) = row[x..].iter().position(|&v| v != 0) {
                let a = x + a;
                let len = row[a..].iter().position(|&v| v == 0).unwrap_or(row.len() - a);
                runs.push(Run { x: a as i32, len: len as u32, start, y, z });
                for from in (0..len).step_by(CHUNK) {
                    let len = (len - from).min(CHUNK) as u32;
                    chunks.push(Run { x: (a + from) as i32, len, start: start + from as u32, y, z });
                }
                start += len as u32;
                x = a + len;
            }
        }
        rows.push(runs.len() as u32);
        layers.push(start);
        chunk_layers.push(chunks.len() as u32);
        let mut band = Band {
            refine,
            low,
            dims,
            runs,
            chunks,
            chunk_layers,
            rows,
            layers,
            sign: Vec::new(),
            side: Vec::new(),
            valid: Vec::new(),
        };
        let at = |x: i32, y: i32, z: i32| -> bool {
            let inside = x >= 0 && y >= 0 && z >= 0 && (x as usize) < dims[0] && (y as usize) < dims[1] && (z as usize) < dims[2];
            inside && active[x as usize + dims[0] * (y as usize + dims[1] * z as usize)] != 0
        };
        let per_run: Vec<(Vec<i8>, Vec<i8>, Vec<u16>)> = band
            .runs
            .par_iter()
            .map(|r| {
                let (mut sign, mut side, mut valid) = (Vec::new(), Vec::new(), Vec::new());
                for x in r.x..r.x + r.len as i32 {
                    let node = [x + low[0], r.y + low[1], r.z + low[2]];
                    let voxel: [i64; 3] = std::array::from_fn(|a| (2 * node[a] + m[a]).div_euclid(2 * m[a]) as i64);
                    let s = if mask.at(voxel[0], voxel[1], voxel[2]) { -1 } else { 1 };
                    let is_voxel = (0..3).all(|a| node[a].rem_euclid(m[a]) == 0);
                    let supported = is_voxel && (0..27).all(|n| at(x + n % 3 - 1, r.y + n / 3 % 3 - 1, r.z + n / 9 - 1));
                    sign.push(if supported { s } else { 0 });
                    side.push(s);
                    let mut bits = 0;
                    for (t, (o, _)) in TERMS.iter().enumerate() {
                        let all = (0..=o[2] as i32)
                            .all(|k| (0..=o[1] as i32).all(|j| (0..=o[0] as i32).all(|i| at(x + i, r.y + j, r.z + k))));
                        bits |= u16::from(all) << t;
                    }
                    valid.push(bits);
                }
                (sign, side, valid)
            })
            .collect();
        for (sign, side, valid) in per_run {
            band.sign.extend(sign);
            band.side.extend(side);
            band.valid.extend(valid);
        }
        band
    }

    /// Number of coefficients.
    pub fn len(&self) -> usize {
        self.sign.len()
    }

    /// Voxel index of a coefficient.
    pub fn voxel(&self, i: usize) -> Vector {
        let r = &self.runs[self.runs.partition_point(|r| r.start as usize <= i).saturating_sub(1)];
        let node = [r.x + (i - r.start as usize) as i32, r.y, r.z];
        let at = |a: usize| (node[a] + self.low[a]) as f64 / self.refine[a] as f64;
        Vector::new(at(0), at(1), at(2))
    }

    /// The runs of a row; none outside the box.
    pub fn row(&self, y: i32, z: i32) -> &[Run] {
        if y < 0 || z < 0 || y as usize >= self.dims[1] || z as usize >= self.dims[2] {
            return &[];
        }
        let r = y as usize + self.dims[1] * z as usize;
        &self.runs[self.rows[r] as usize..self.rows[r + 1] as usize]
    }

    /// Copies `values` of row (y, z) from `x` on into `out`, 0 where there is no coefficient.
    pub fn fetch(&self, values: &[f32], y: i32, z: i32, x: i32, out: &mut [f32]) {
        out.fill(0.0);
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

    /// Adds `add` to `values` of row (y, z) from `x` on, where there are coefficients; `values` starts at `first`.
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
fn mark(mask: &Mask, m: [i32; 3], low: [i32; 3], dims: [usize; 3]) -> Vec<u8> {
    let steps = [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]];
    let mut active = vec![0u8; dims.iter().product()];
    let mut grow = |v: [i64; 3]| {
        let range = |a: usize| {
            let c = v[a] as i32 * m[a] - low[a];
            (c - m[a] - 1).max(0) as usize..((c + m[a] + 2) as usize).min(dims[a])
        };
        for z in range(2) {
            for y in range(1) {
                let x = range(0);
                let row = dims[0] * (y + dims[1] * z);
                active[row + x.start..row + x.end].fill(1);
            }
        }
    };
    let [nx, ny, _] = mask.grid.dims;
    for (r, row) in mask.data.chunks(nx).enumerate() {
        let (j, k) = ((r % ny) as i64, (r / ny) as i64);
        for i in (0..nx as i64).filter(|&i| row[i as usize] != 0) {
            let mut boundary = false;
            for d in &steps {
                let q = [i + d[0], j + d[1], k + d[2]];
                if !mask.at(q[0], q[1], q[2]) {
                    boundary = true;
                    grow(q);
                }
            }
            if boundary {
                grow([i, j, k]);
            }
        }
    }
    active
}
