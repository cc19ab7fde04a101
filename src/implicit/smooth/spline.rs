//! Uniform cubic B-splines in three dimensions, stored in tiles where they are needed.

use nalgebra::Matrix3;

use crate::geometry::Vector;

/// Cells of a tile along an axis; a tile stores three more nodes, so that every cell finds its 4×4×4 in one tile.
pub(super) const TILE: usize = 8;
pub(super) const NODES: usize = TILE + 3;
pub(super) const TILE_LEN: usize = NODES * NODES * NODES;

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

#[inline]
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

    /// Whether there is a tile at node coordinates `x`.
    #[inline]
    pub fn holds(&self, x: &Vector) -> bool {
        let mut tile = [0usize; 3];
        for a in 0..3 {
            if !(x[a] >= 0.0 && x[a] < (self.tiles[a] * TILE) as f64) {
                return false;
            }
            tile[a] = x[a] as usize / TILE;
        }
        self.table[tile[0] + self.tiles[0] * (tile[1] + self.tiles[1] * tile[2])] != Tile::Absent
    }

    /// The 64 coefficients' first place and the fractions within the cell; `Err` is the constant there.
    #[inline]
    fn locate(&self, x: &Vector) -> Result<(&[f32], [f64; 3]), f64> {
        let mut tile = [0usize; 3];
        let mut cell = [0usize; 3];
        let mut t = [0.0; 3];
        for a in 0..3 {
            let f = x[a].floor();
            if !(f >= 0.0 && f < (self.tiles[a] * TILE) as f64) {
                return Err(self.outside);
            }
            let i = f as usize;
            (tile[a], cell[a], t[a]) = (i / TILE, i % TILE, x[a] - f);
        }
        match self.table[tile[0] + self.tiles[0] * (tile[1] + self.tiles[1] * tile[2])] {
            Tile::Absent => Err(self.outside),
            Tile::Constant(v) => Err(v as f64),
            Tile::Stored(n) => {
                let first = n as usize * TILE_LEN + cell[0] + NODES * (cell[1] + NODES * cell[2]);
                Ok((&self.coefficients[first..first + 3 * (1 + NODES + NODES * NODES) + 1], t))
            }
        }
    }

    /// Value at node coordinates `x`.
    pub fn value(&self, x: &Vector) -> f64 {
        let (c, t) = match self.locate(x) {
            Ok(found) => found,
            Err(v) => return v,
        };
        let (wx, wy, wz) = (weights(t[0]), weights(t[1]), weights(t[2]));
        let mut sum = 0.0;
        for k in 0..4 {
            let mut plane = 0.0;
            for j in 0..4 {
                let r = &c[NODES * (j + NODES * k)..][..4];
                plane += wy[j] * (wx[0] * r[0] as f64 + wx[1] * r[1] as f64 + wx[2] * r[2] as f64 + wx[3] * r[3] as f64);
            }
            sum += wz[k] * plane;
        }
        sum
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
