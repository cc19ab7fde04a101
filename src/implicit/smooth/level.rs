//! A level of the fit: its band and labels, and how a level's coefficients become the next one's and the tiles of the result.

use rayon::prelude::*;

use super::band::{Band, Nodes, Run};
use super::critical;
use super::labels::{self, Labels, Near};
use super::neighbourhood::Neighbourhood;
use super::spline::{NODES, TILE, TILE_LEN, Tile, TiledSpline, tiles_of};
use crate::mask::Mask;

/// A band and its labels.
pub(super) struct Level {
    pub band: Band,
    pub labels: Labels,
}

impl Level {
    /// The band round the voxels `near`, as far as nodes lie at a voxel of `within`, and their labels, with those of their
    /// neighbours if `second`.
    pub fn new(mask: &Mask, nodes: Nodes, near: &[Near], within: Option<&Neighbourhood>, second: bool, scale: [f32; 3]) -> Level {
        let band = Band::of(nodes, near, within);
        let labels = Labels::of(mask, &band, near, second, scale);
        Level { band, labels }
    }

    /// Labels whose value lies less than `least` on their side of zero.
    pub fn below(&self, values: &[[f32; 4]], least: f32) -> Vec<usize> {
        (0..values.len()).filter(|&i| f32::from(self.labels.labels[i].sign) * values[i][0] < least).collect()
    }

    /// Labels of this level, with these values, that are contradicted and that the topology needs.
    pub fn must_keep(&self, mask: &Mask, values: &[[f32; 4]], leniently: bool) -> Vec<usize> {
        let amount = |l: usize| -f32::from(self.labels.labels[l].sign) * values[l][0];
        critical::critical(mask, &self.labels.labels, &self.below(values, 0.0), leniently, amount)
    }
}

/// Distance from zero of the far field, smallest spacings.
pub(super) const FAR: f32 = 6.0;

/// Along an axis, for a node of the next finer level: the first of three coefficients that make its own, and their weights.
fn halves(from: &Nodes, to: &Nodes, axis: usize, node: i32) -> (i32, [f32; 3]) {
    let at = node + to.low[axis];
    let half = at.div_euclid(2) - from.low[axis];
    if at.rem_euclid(2) == 0 { (half - 1, [0.125, 0.75, 0.125]) } else { (half, [0.5, 0.5, 0.0]) }
}

/// The coefficients of the spline at a row of nodes of the next finer level, from node `n` on, into `out`: of those that `from` has.
pub(super) fn subdivided(from: &Band, c: &[f32], to: &Nodes, n: [i32; 3], out: &mut [f32]) {
    const PIECE: usize = 32;
    if out.len() > PIECE {
        for (piece, x) in out.chunks_mut(PIECE).zip((n[0]..).step_by(PIECE)) {
            subdivided(from, c, to, [x, n[1], n[2]], piece);
        }
        return;
    }
    let [(first, _), (y, wy), (z, wz)] = [0, 1, 2].map(|a| halves(&from.nodes, to, a, n[a]));
    // Across the rows first: sums, and of the weights that found a coefficient.
    let mut row = [0.0; PIECE / 2 + 4];
    let row = &mut row[..out.len() / 2 + 4];
    let mut sums = [[0.0f32; 2]; PIECE / 2 + 4];
    for k in 0..3 {
        for j in 0..3 {
            let w = wy[j] * wz[k];
            if w == 0.0 {
                continue;
            }
            row.fill(f32::NAN);
            from.fetch(c, y + j as i32, z + k as i32, first, row);
            for (v, sum) in row.iter().zip(&mut sums).filter(|(v, _)| !v.is_nan()) {
                *sum = [sum[0] + w * v, sum[1] + w];
            }
        }
    }
    for (out, i) in out.iter_mut().zip(n[0]..) {
        let (x, w) = halves(&from.nodes, to, 0, i);
        let at = (x - first) as usize;
        let [sum, total] = [0, 1].map(|s| (0..3).map(|i| w[i] * sums[at + i][s]).sum::<f32>());
        *out = if total > 0.0 { sum / total } else { 0.0 };
    }
}

/// The same spline with twice the nodes.
pub(super) fn subdivide(from: &Band, c: &[f32], to: &Band) -> Vec<f32> {
    let run = |r: &Run| {
        let mut out = vec![0.0; r.len as usize];
        subdivided(from, c, &to.nodes, [r.x, r.y, r.z], &mut out);
        out
    };
    to.fill(0.0, run)
}

/// What stands for a coefficient that the band lacks: a constant by the nearest voxel's label.
fn side(mask: &Mask, nodes: &Nodes, n: [i32; 3]) -> f32 {
    let v = nodes.voxel(n);
    if mask.at(v[0], v[1], v[2]) { -FAR } else { FAR }
}

/// The coefficients of a tile of the next finer level, from node `low` on.
pub(super) fn subdivided_tile(mask: &Mask, from: &Band, c: &[f32], to: &Nodes, low: [i32; 3]) -> Vec<f32> {
    // Two of these make three, and one more at either end.
    const FROM: usize = NODES / 2 + 4;
    let [x, y, z] = [0, 1, 2].map(|a| {
        let base = (low[a] + to.low[a]).div_euclid(2) - from.nodes.low[a] - 1;
        let of = |i: usize| {
            let (first, w) = halves(&from.nodes, to, a, low[a] + i as i32);
            ((first - base) as usize, w)
        };
        (base, std::array::from_fn::<_, NODES, _>(of))
    });
    let mut across = [[0.0f32; NODES]; FROM];
    let mut layers = [[[0.0f32; NODES]; NODES]; FROM];
    for (k, layer) in layers.iter_mut().enumerate() {
        for (j, sums) in across.iter_mut().enumerate() {
            let at = [x.0, y.0 + j as i32, z.0 + k as i32];
            let mut row = [f32::NAN; FROM];
            from.fetch(c, at[1], at[2], at[0], &mut row);
            for (v, x) in row.iter_mut().zip(at[0]..).filter(|(v, _)| v.is_nan()) {
                *v = side(mask, &from.nodes, [x, at[1], at[2]]);
            }
            for (sum, (i, w)) in sums.iter_mut().zip(&x.1) {
                *sum = w[0] * row[*i] + w[1] * row[i + 1] + w[2] * row[i + 2];
            }
        }
        for (sums, (j, w)) in layer.iter_mut().zip(&y.1) {
            for i in 0..NODES {
                sums[i] = w[0] * across[*j][i] + w[1] * across[j + 1][i] + w[2] * across[j + 2][i];
            }
        }
    }
    let mut out = Vec::with_capacity(TILE_LEN);
    for (k, w) in &z.1 {
        for j in 0..NODES {
            out.extend((0..NODES).map(|i| w[0] * layers[*k][j][i] + w[1] * layers[k + 1][j][i] + w[2] * layers[k + 2][j][i]));
        }
    }
    out
}

/// The coefficients in tiles; beyond the band stands a constant by the nearest voxel's label.
pub(super) fn tile(mask: &Mask, band: &Band, c: &[f32]) -> TiledSpline {
    let tiles = band.nodes.dims.map(|n| n.div_ceil(TILE));
    let index = |t: [usize; 3]| t[0] + tiles[0] * (t[1] + tiles[1] * t[2]);
    let mut needed = vec![false; tiles.iter().product()];
    for r in &band.runs {
        for z in tiles_of(tiles[2], r.z, r.z) {
            for y in tiles_of(tiles[1], r.y, r.y) {
                for x in tiles_of(tiles[0], r.x, r.x + r.len as i32 - 1) {
                    needed[index([x, y, z])] = true;
                }
            }
        }
    }
    let mut table = Vec::with_capacity(needed.len());
    let mut keys = Vec::new();
    for (n, &want) in needed.iter().enumerate() {
        let t = [n % tiles[0], n / tiles[0] % tiles[1], n / (tiles[0] * tiles[1])];
        if want {
            table.push(Tile::Stored(keys.len() as u32));
            keys.push(t);
        } else {
            table.push(Tile::Constant(side(mask, &band.nodes, t.map(|t| (t * TILE) as i32))));
        }
    }
    let parts: Vec<Vec<f32>> = keys
        .par_iter()
        .map(|t| {
            let low = t.map(|t| (t * TILE) as i32 - 1);
            let mut out = Vec::with_capacity(TILE_LEN);
            for z in (low[2]..).take(NODES) {
                for y in (low[1]..).take(NODES) {
                    let mut row = [f32::NAN; NODES];
                    band.fetch(c, y, z, low[0], &mut row);
                    for (v, x) in row.iter_mut().zip(low[0]..).filter(|(v, _)| v.is_nan()) {
                        *v = side(mask, &band.nodes, [x, y, z]);
                    }
                    out.extend(row);
                }
            }
            out
        })
        .collect();
    TiledSpline { tiles, table, coefficients: labels::in_order(parts), outside: f64::from(FAR) }
}
