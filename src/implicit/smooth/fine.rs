//! The finest level, in tiles where it differs from the one before.

use rayon::prelude::*;

use super::band::{Band, Nodes};
use super::level::{FAR, subdivided, subdivided_tile};
use super::labels;
use super::spline::{NODES, TILE, TILE_LEN, Tile, TiledSpline, tiles_of};
use crate::geometry::Vector;
use crate::mask::Mask;

/// The finest level's coefficients; where there is no tile they are those of the coarser level, subdivided.
pub(super) struct Fine<'a> {
    pub nodes: Nodes,
    mask: &'a Mask,
    coarser: &'a Band,
    c: &'a [f32],
    spline: TiledSpline,
    /// Per tile, a bit for each of its own nodes: whether it was ever free to change.
    freed: Vec<[u64; TILE]>,
}

impl<'a> Fine<'a> {
    /// The coarser level's spline.
    pub fn new(mask: &'a Mask, coarser: &'a Band, c: &'a [f32]) -> Fine<'a> {
        let from = coarser.nodes;
        let nodes = Nodes { step: 1, low: from.low.map(|l| 2 * l), dims: from.dims.map(|d| 2 * d), ..from };
        let tiles = nodes.dims.map(|n| n.div_ceil(TILE));
        let table = vec![Tile::Absent; tiles.iter().product()];
        let spline = TiledSpline { tiles, table, coefficients: Vec::new(), outside: f64::from(FAR) };
        Fine { nodes, mask, coarser, c, spline, freed: Vec::new() }
    }

    fn index(&self, t: [usize; 3]) -> usize {
        t[0] + self.spline.tiles[0] * (t[1] + self.spline.tiles[1] * t[2])
    }

    /// Makes the tiles on which free coefficients have an effect.
    pub fn cover(&mut self, band: &Band, frozen: &[bool]) {
        let mut wanted = Vec::new();
        each_stretch(band, frozen, |x, len, y, z, _| {
            let tiles = self.spline.tiles;
            for tz in tiles_of(tiles[2], z, z) {
                for ty in tiles_of(tiles[1], y, y) {
                    let row = tiles_of(tiles[0], x, x + len - 1).map(|tx| self.index([tx, ty, tz]));
                    wanted.extend(row.filter(|&n| self.spline.table[n] == Tile::Absent));
                }
            }
        });
        wanted.sort_unstable();
        wanted.dedup();
        let of = |&n: &usize| {
            let tiles = self.spline.tiles;
            let t = [n % tiles[0], n / tiles[0] % tiles[1], n / (tiles[0] * tiles[1])];
            subdivided_tile(self.mask, self.coarser, self.c, &self.nodes, t.map(|t| (t * TILE) as i32 - 1))
        };
        let parts: Vec<Vec<f32>> = wanted.par_iter().map(of).collect();
        for n in wanted {
            self.spline.table[n] = Tile::Stored(self.freed.len() as u32);
            self.freed.push([0; TILE]);
        }
        self.spline.coefficients.extend(labels::in_order(parts));
    }

    /// The coefficients at the places of a band.
    pub fn read(&self, band: &Band) -> Vec<f32> {
        band.fill(0.0, |r| {
            let mut out = vec![0.0; r.len as usize];
            let mut rest = &mut out[..];
            let mut x = r.x;
            while !rest.is_empty() {
                let left = TILE - x.rem_euclid(TILE as i32) as usize;
                let (piece, tail) = rest.split_at_mut(left.min(rest.len()));
                // The tile whose own the nodes are: it has every change.
                let tile = [x, r.y, r.z].map(|n| n as usize / TILE);
                match self.spline.table[self.index(tile)] {
                    Tile::Stored(n) => {
                        let from = n as usize * TILE_LEN + place(tile, [x, r.y, r.z]);
                        piece.copy_from_slice(&self.spline.coefficients[from..from + piece.len()]);
                    }
                    _ => subdivided(self.coarser, self.c, &self.nodes, [x, r.y, r.z], piece),
                }
                x += piece.len() as i32;
                rest = tail;
            }
            out
        })
    }

    /// Takes the free coefficients of a band, whose tiles were made.
    pub fn write(&mut self, band: &Band, c: &[f32], frozen: &[bool]) {
        each_stretch(band, frozen, |x, len, y, z, from| {
            let tiles = self.spline.tiles;
            for tz in tiles_of(tiles[2], z, z) {
                for ty in tiles_of(tiles[1], y, y) {
                    for tx in tiles_of(tiles[0], x, x + len - 1) {
                        let Tile::Stored(n) = self.spline.table[self.index([tx, ty, tz])] else { continue };
                        let low = (tx * TILE) as i32 - 1;
                        let (first, end) = (x.max(low), (x + len).min(low + NODES as i32));
                        let to = n as usize * TILE_LEN + place([tx, ty, tz], [first, y, z]);
                        let from = from + (first - x) as usize;
                        self.spline.coefficients[to..][..(end - first) as usize].copy_from_slice(&c[from..][..(end - first) as usize]);
                        if [ty, tz] == [y as usize / TILE, z as usize / TILE] {
                            let own = (first..end).filter(|&x| x as usize / TILE == tx);
                            let bits = own.fold(0, |bits, x| bits | 1 << (x as usize % TILE + TILE * (y as usize % TILE)));
                            self.freed[n as usize][z as usize % TILE] |= bits;
                        }
                    }
                }
            }
        });
    }

    /// The function at a voxel index, where there is a tile.
    pub fn value(&self, voxel: &Vector) -> Option<f32> {
        let x = Vector::from_fn(|a, _| voxel[a] * f64::from(self.nodes.refine[a]) - f64::from(self.nodes.low[a]));
        self.spline.holds(&x).then(|| self.spline.value(&x) as f32)
    }

    /// How many coefficients were ever free to change.
    pub fn freed(&self) -> usize {
        self.freed.iter().flatten().map(|bits| bits.count_ones() as usize).sum()
    }

    pub fn into_spline(self) -> TiledSpline {
        self.spline
    }
}

/// Where a node's coefficient stands in a tile.
fn place(tile: [usize; 3], n: [i32; 3]) -> usize {
    let at: [usize; 3] = std::array::from_fn(|a| (n[a] + 1) as usize - tile[a] * TILE);
    at[0] + NODES * (at[1] + NODES * at[2])
}

/// Calls `f` on each stretch of free coefficients of a row: first node, length, row and place.
fn each_stretch(band: &Band, frozen: &[bool], mut f: impl FnMut(i32, i32, i32, i32, usize)) {
    for r in &band.runs {
        let mut at = 0;
        for piece in frozen[r.start as usize..][..r.len as usize].chunk_by(|a, b| a == b) {
            if !piece[0] {
                f(r.x + at as i32, piece.len() as i32, r.y, r.z, r.start as usize + at);
            }
            at += piece.len();
        }
    }
}
