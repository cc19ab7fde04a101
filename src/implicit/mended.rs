//! A function mended smoothly in a few places.
//!
//! Where a fit has another topology than its mask, the guard would mend it, but leaves the stairs of the voxels there. Here
//! the fit is drawn towards the guard's band by a correction that is a uniform cubic B-spline with nodes half a voxel apart:
//! round by round, the smoothest part of what is missing first, so that it can stop as soon as the topology is the mask's.
//! Outside these places the function is what it was.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::Implicit;
use super::guard::MaskBoundary;
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::Grid;
use nalgebra::Matrix3;

/// Sum of `inner` and smooth corrections in some places, C² where `inner` is.
#[derive(Debug, Clone)]
pub struct Mended<I> {
    inner: I,
    /// Twice its index is a node's number.
    grid: Grid,
    /// Nodes by number, block after block, and their coefficients, mm.
    nodes: Vec<[i32; 3]>,
    coefficients: Vec<f64>,
    /// Where the nodes of each block stand in the list.
    blocks: BTreeMap<[i32; 3], std::ops::Range<usize>>,
    bounds: Aabb,
}

/// Nodes in a block, along each axis.
const BLOCK: i32 = 8;

/// Weights of the four nodes round a point at `t` in 0..1 between the middle two, and their derivatives.
fn weights(t: f64) -> ([f64; 4], [f64; 4]) {
    let s = 1.0 - t;
    let value = [s * s * s / 6.0, 2.0 / 3.0 - t * t * (2.0 - t) / 2.0, 2.0 / 3.0 - s * s * (2.0 - s) / 2.0, t * t * t / 6.0];
    let slope = [-s * s / 2.0, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), t * t / 2.0];
    (value, slope)
}

fn block_of(node: [i32; 3]) -> [i32; 3] {
    node.map(|c| c.div_euclid(BLOCK))
}

impl<I: Implicit> Mended<I> {
    /// `inner` drawn `steps` times nearer to the band of `boundary` in these voxels of `grid`: each time by what it strays
    /// at the nodes there, at and half a voxel round the middles of the voxels.
    pub fn towards(inner: I, grid: &Grid, boundary: &MaskBoundary, voxels: &[[i64; 3]], steps: usize) -> Mended<I> {
        let mut nodes: Vec<[i32; 3]> = Vec::new();
        for v in voxels {
            let n = v.map(|c| 2 * c as i32);
            nodes.extend((0..27).map(|k| [n[0] + k % 3 - 1, n[1] + k / 3 % 3 - 1, n[2] + k / 9 - 1]));
        }
        nodes.par_sort_unstable_by_key(|&n| (block_of(n), n));
        nodes.dedup();
        let mut blocks = BTreeMap::new();
        let mut start = 0;
        for run in nodes.chunk_by(|a, b| block_of(*a) == block_of(*b)) {
            blocks.insert(block_of(run[0]), start..start + run.len());
            start += run.len();
        }
        let bounds = inner.bounds().union(&boundary.bounds());
        let mut mended = Mended { inner, grid: grid.clone(), coefficients: vec![0.0; nodes.len()], nodes, blocks, bounds };
        for _ in 0..steps {
            mended.draw(boundary);
        }
        mended
    }

    /// One step nearer to the band.
    fn draw(&mut self, boundary: &MaskBoundary) {
        let by: Vec<f64> = self
            .nodes
            .par_iter()
            .map(|&n| {
                let p = self.grid.to_world(Vector::from(n.map(|c| 0.5 * f64::from(c))));
                let (d, _) = boundary.signed_distance(&p);
                let tau = boundary.band_at(&p);
                // Farther away the distance is a bound only.
                if d.abs() >= boundary.widest_band() + tau {
                    return 0.0;
                }
                let f = self.value(&p);
                f.clamp(d - tau, d + tau) - f
            })
            .collect();
        self.coefficients.iter_mut().zip(by).for_each(|(c, by)| *c += by);
    }

    /// The correction at `p` and its gradient; `None` where there is none.
    fn correction(&self, p: &Point) -> Option<(f64, Vector)> {
        let x = 2.0 * self.grid.to_index(p);
        let base = x.map(f64::floor);
        let low: [i32; 3] = base.map(|c| c as i32 - 1).into();
        let (first, last) = (block_of(low), block_of(low.map(|c| c + 3)));
        let mut sum: Option<(f64, Vector)> = None;
        let w = [0, 1, 2].map(|a| weights(x[a] - base[a]));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let Some(range) = self.blocks.get(&[x, y, z]) else { continue };
                    for (n, c) in self.nodes[range.clone()].iter().zip(&self.coefficients[range.clone()]) {
                        let k = [0, 1, 2].map(|a| (n[a] - low[a]) as usize);
                        if *c == 0.0 || k.iter().any(|&k| k > 3) {
                            continue;
                        }
                        let (v, g) = sum.get_or_insert((0.0, Vector::zeros()));
                        let [(vx, dx), (vy, dy), (vz, dz)] = &w;
                        *v += c * vx[k[0]] * vy[k[1]] * vz[k[2]];
                        *g += *c * Vector::new(dx[k[0]] * vy[k[1]] * vz[k[2]], vx[k[0]] * dy[k[1]] * vz[k[2]], vx[k[0]] * vy[k[1]] * dz[k[2]]);
                    }
                }
            }
        }
        sum.map(|(v, g)| (v, 2.0 * self.grid.gradient_to_world(&g)))
    }
}

impl<I: Implicit> Implicit for Mended<I> {
    fn value(&self, p: &Point) -> f64 {
        self.inner.value(p) + self.correction(p).map_or(0.0, |c| c.0)
    }

    fn values(&self, points: &[Point], out: &mut [f64]) {
        self.inner.values(points, out);
        out.iter_mut().zip(points).for_each(|(v, p)| *v += self.correction(p).map_or(0.0, |c| c.0));
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let (f, g) = self.inner.value_gradient(p);
        self.correction(p).map_or((f, g), |(c, by)| (f + c, g + by))
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn resolution(&self) -> f64 {
        self.inner.resolution()
    }

    fn values_on(&self, origin: &Point, steps: &Matrix3<f64>, low: [i32; 3], size: usize, out: &mut [f64]) -> bool {
        if !self.inner.values_on(origin, steps, low, size, out) {
            return false;
        }
        // Most lattices lie nowhere near.
        let corner = |c: usize| origin + steps * Vector::from_fn(|a, _| f64::from(low[a] + if c >> a & 1 == 0 { 0 } else { size as i32 - 1 }));
        let reach = (0..8).map(|c| 2.0 * self.grid.to_index(&corner(c)));
        let [least, most] = reach.fold([Vector::repeat(f64::INFINITY), Vector::repeat(f64::NEG_INFINITY)], |[l, m], x| [l.inf(&x), m.sup(&x)]);
        let [first, last] = [least.add_scalar(-2.0), most.add_scalar(2.0)].map(|x| block_of(x.map(|c| c.floor() as i32).into()));
        if !self.blocks.keys().any(|k| (0..3).all(|a| (first[a]..=last[a]).contains(&k[a]))) {
            return true;
        }
        for (n, v) in out.iter_mut().enumerate() {
            let c = [n % size, n / size % size, n / size / size];
            let p = origin + steps * Vector::from_fn(|a, _| f64::from(low[a] + c[a] as i32));
            *v += self.correction(&p).map_or(0.0, |c| c.0);
        }
        true
    }

    fn hessian(&self, p: &Point) -> Matrix3<f64> {
        let own = self.inner.hessian(p);
        if self.correction(p).is_none() {
            return own;
        }
        let h = 0.25 * self.resolution();
        let by = |e: Vector| self.correction(&(p + e)).map_or(Vector::zeros(), |c| c.1);
        let m = Matrix3::from_columns(&[0, 1, 2].map(|a| (by(Vector::ith(a, h)) - by(Vector::ith(a, -h))) / (2.0 * h)));
        own + 0.5 * (m + m.transpose())
    }
}

#[cfg(test)]
mod tests;
