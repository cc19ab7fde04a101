//! Uniform cubic B-splines in three dimensions, stored in tiles where they are needed.

use nalgebra::Matrix3;

use crate::geometry::Vector;

/// Cells of a tile along an axis; a tile stores three more nodes, so that every cell finds its 4×4×4 in one tile.
pub(super) const TILE: usize = 8;
pub(super) const NODES: usize = TILE + 3;
pub(super) const TILE_LEN: usize = NODES * NODES * NODES;

/// From the first to the last of a cell's coefficients.
const REACH: usize = 3 * (1 + NODES + NODES * NODES) + 1;

/// What a tile holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Tile {
    /// Nothing: another spline holds there.
    Absent,
    /// Far from the wall: a constant.
    Constant(f32),
    /// Coefficients of nodes 8t−1 to 8t+9, at this place.
    Stored(u32),
}

/// A C² function of node coordinates.
#[derive(Debug, Clone)]
pub(super) struct TiledSpline {
    /// Tiles along each axis; node 0 is the first of tile 0.
    pub tiles: [usize; 3],
    pub table: Vec<Tile>,
    pub coefficients: Vec<f32>,
    /// Value outside all tiles.
    pub outside: f64,
}

/// The tile of a node coordinate along an axis.
#[inline]
pub(super) fn tile_of(x: f64) -> i64 {
    (x.floor() as i64).div_euclid(TILE as i64)
}

/// The tiles, of so many along an axis, on which the coefficients of nodes `first` to `last` have an effect: node i belongs to
/// cells i−2 to i+1. These are also the tiles that store one of them.
pub(super) fn tiles_of(tiles: usize, first: i32, last: i32) -> std::ops::RangeInclusive<usize> {
    let tile = |cell: i32| cell.div_euclid(TILE as i32).clamp(0, tiles as i32 - 1) as usize;
    tile(first - 2)..=tile(last + 1)
}

#[inline(always)]
pub(super) fn weights(t: f64) -> [f64; 4] {
    let (t2, s) = (t * t, 1.0 - t);
    let t3 = t2 * t;
    [s * s * s / 6.0, (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0, (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0, t3 / 6.0]
}

#[inline]
pub(super) fn slopes(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [-0.5 * s * s, 1.5 * t * t - 2.0 * t, -1.5 * t * t + t + 0.5, 0.5 * t * t]
}

#[inline]
fn bends(t: f64) -> [f64; 4] {
    [1.0 - t, 3.0 * t - 2.0, 1.0 - 3.0 * t, t]
}

impl TiledSpline {
    /// A spline without tiles.
    pub fn nowhere() -> TiledSpline {
        TiledSpline { tiles: [0; 3], table: Vec::new(), coefficients: Vec::new(), outside: 0.0 }
    }

    /// The tile and the cell at node coordinates `x`.
    #[inline(always)]
    fn tile(&self, x: &Vector) -> Option<(Tile, [usize; 3])> {
        if !(0..3).all(|a| x[a] >= 0.0 && x[a] < (self.tiles[a] * TILE) as f64) {
            return None;
        }
        let cell = [x[0] as usize, x[1] as usize, x[2] as usize];
        let tile = self.table[cell[0] / TILE + self.tiles[0] * (cell[1] / TILE + self.tiles[1] * (cell[2] / TILE))];
        Some((tile, cell))
    }

    /// Whether there is a tile at node coordinates `x`.
    #[inline(always)]
    pub fn holds(&self, x: &Vector) -> bool {
        self.tile(x).is_some_and(|(tile, _)| tile != Tile::Absent)
    }

    /// The 64 coefficients' first place and the fractions within the cell; `Err` is the constant there.
    #[inline(always)]
    fn locate(&self, x: &Vector) -> Result<(&[f32; REACH], [f64; 3]), f64> {
        let (tile, cell) = self.tile(x).ok_or(self.outside)?;
        match tile {
            Tile::Absent => Err(self.outside),
            Tile::Constant(v) => Err(v as f64),
            Tile::Stored(n) => {
                let first = n as usize * TILE_LEN + cell[0] % TILE + NODES * (cell[1] % TILE + NODES * (cell[2] % TILE));
                let t = [0, 1, 2].map(|a| x[a] - cell[a] as f64);
                self.coefficients[first..].first_chunk().map(|c| (c, t)).ok_or(self.outside)
            }
        }
    }

    /// Value at node coordinates `x`.
    #[inline(always)]
    pub fn value(&self, x: &Vector) -> f64 {
        let (c, t) = match self.locate(x) {
            Ok(found) => found,
            Err(v) => return v,
        };
        let (wx, wy, wz) = (weights(t[0]), weights(t[1]), weights(t[2]));
        let mut sum = [0.0; 4];
        for k in 0..4 {
            for j in 0..4 {
                let w = wy[j] * wz[k];
                let r = &c[NODES * (j + NODES * k)..][..4];
                for i in 0..4 {
                    sum[i] += w * f64::from(r[i]);
                }
            }
        }
        wx[0] * sum[0] + wx[1] * sum[1] + wx[2] * sum[2] + wx[3] * sum[3]
    }

    /// Values at the points of a lattice, given by their node coordinates along each axis, all in one tile, into `out`, a
    /// cube of edge `size`, from the place `at` on.
    pub fn fill(&self, x: [&[f64]; 3], at: [usize; 3], size: usize, out: &mut [f64]) {
        let row = |j: usize, k: usize| at[0] + size * (at[1] + j + size * (at[2] + k));
        let (c, places) = match self.locate(&Vector::new(x[0][0], x[1][0], x[2][0])) {
            Err(v) => {
                for k in 0..x[2].len() {
                    for j in 0..x[1].len() {
                        out[row(j, k)..row(j, k) + x[0].len()].fill(v);
                    }
                }
                return;
            }
            Ok(_) => {
                let tile = x.map(|x| tile_of(x[0]) as usize);
                let Tile::Stored(n) = self.table[tile[0] + self.tiles[0] * (tile[1] + self.tiles[1] * tile[2])] else { return };
                let place = |x: &f64| (x.floor() as usize % TILE, weights(x - x.floor()));
                let places = x.map(|x| x.iter().map(place).collect::<Vec<(usize, [f64; 4])>>());
                (&self.coefficients[n as usize * TILE_LEN..][..TILE_LEN], places)
            }
        };
        let nodes = |a: usize| {
            let cells = places[a].iter().map(|p| p.0);
            cells.clone().min().unwrap_or(0)..cells.max().unwrap_or(0) + 4
        };
        let (nx, ny) = (nodes(0), nodes(1));
        // Along z, then y, then x: each sum serves all points that share it.
        let mut plane = [[0.0f64; NODES]; NODES];
        for (k, (z, wz)) in places[2].iter().enumerate() {
            for j in ny.clone() {
                let rows: [&[f32]; 4] = std::array::from_fn(|k| &c[NODES * (j + NODES * (z + k))..][nx.clone()]);
                let sums = &mut plane[j][nx.clone()];
                for i in 0..sums.len() {
                    sums[i] = wz[0] * f64::from(rows[0][i]) + wz[1] * f64::from(rows[1][i]) + wz[2] * f64::from(rows[2][i]) + wz[3] * f64::from(rows[3][i]);
                }
            }
            for (j, (y, wy)) in places[1].iter().enumerate() {
                let mut line = [0.0f64; NODES];
                for i in nx.clone() {
                    line[i] = wy[0] * plane[*y][i] + wy[1] * plane[y + 1][i] + wy[2] * plane[y + 2][i] + wy[3] * plane[y + 3][i];
                }
                let to = &mut out[row(j, k)..row(j, k) + x[0].len()];
                for (v, (x, wx)) in to.iter_mut().zip(&places[0]) {
                    let c = &line[*x..x + 4];
                    *v = wx[0] * c[0] + wx[1] * c[1] + wx[2] * c[2] + wx[3] * c[3];
                }
            }
        }
    }

    /// Value and gradient with respect to node coordinates.
    pub fn value_gradient(&self, x: &Vector) -> (f64, Vector) {
        let (c, t) = match self.locate(x) {
            Ok(found) => found,
            Err(v) => return (v, Vector::zeros()),
        };
        let (wx, wy, wz) = (weights(t[0]), weights(t[1]), weights(t[2]));
        let (dx, dy, dz) = (slopes(t[0]), slopes(t[1]), slopes(t[2]));
        let (mut v, mut g) = (0.0, Vector::zeros());
        for k in 0..4 {
            let (mut p, mut px, mut py) = (0.0, 0.0, 0.0);
            for j in 0..4 {
                let r = &c[NODES * (j + NODES * k)..][..4];
                let r = [r[0] as f64, r[1] as f64, r[2] as f64, r[3] as f64];
                let s = wx[0] * r[0] + wx[1] * r[1] + wx[2] * r[2] + wx[3] * r[3];
                let d = dx[0] * r[0] + dx[1] * r[1] + dx[2] * r[2] + dx[3] * r[3];
                p += wy[j] * s;
                px += wy[j] * d;
                py += dy[j] * s;
            }
            v += wz[k] * p;
            g.x += wz[k] * px;
            g.y += wz[k] * py;
            g.z += dz[k] * p;
        }
        (v, g)
    }

    /// Second derivatives with respect to node coordinates.
    pub fn hessian(&self, x: &Vector) -> Matrix3<f64> {
        let Ok((c, t)) = self.locate(x) else { return Matrix3::zeros() };
        let w = t.map(|t| [weights(t), slopes(t), bends(t)]);
        let mut m = Matrix3::zeros();
        for k in 0..4 {
            for j in 0..4 {
                let r = &c[NODES * (j + NODES * k)..][..4];
                let line = |o: usize| (0..4).map(|i| w[0][o][i] * r[i] as f64).sum::<f64>();
                let (s, d, b) = (line(0), line(1), line(2));
                m[(0, 0)] += w[1][0][j] * w[2][0][k] * b;
                m[(0, 1)] += w[1][1][j] * w[2][0][k] * d;
                m[(0, 2)] += w[1][0][j] * w[2][1][k] * d;
                m[(1, 1)] += w[1][2][j] * w[2][0][k] * s;
                m[(1, 2)] += w[1][1][j] * w[2][1][k] * s;
                m[(2, 2)] += w[1][0][j] * w[2][2][k] * s;
            }
        }
        m.fill_lower_triangle_with_upper_triangle();
        m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_value() {
        let n = TILE_LEN;
        let coefficients: Vec<f32> = (0..n).map(|i| ((i * 7919 % 1013) as f32) / 500.0 - 1.0).collect();
        let s = TiledSpline { tiles: [1, 1, 1], table: vec![Tile::Stored(0)], coefficients, outside: 3.0 };
        let x = Vector::new(2.37, 5.81, 0.44);
        let (v, g) = s.value_gradient(&x);
        let h = s.hessian(&x);
        approx::assert_relative_eq!(v, s.value(&x), epsilon = 1e-12);
        for a in 0..3 {
            let mut e = Vector::zeros();
            e[a] = 1e-5;
            approx::assert_relative_eq!(g[a], (s.value(&(x + e)) - s.value(&(x - e))) / 2e-5, epsilon = 1e-7);
            let d = (s.value_gradient(&(x + e)).1 - s.value_gradient(&(x - e)).1) / 2e-5;
            for b in 0..3 {
                approx::assert_relative_eq!(h[(b, a)], d[b], epsilon = 1e-7);
            }
        }
        assert_eq!(s.value(&Vector::new(-0.1, 1.0, 1.0)), 3.0);
    }
}
