//! Keeps an implicit surface within a band round the mask's own boundary.
//!
//! Wherever the wrapped function strays from the voxel faces that separate lumen from background by more than the band
//! allows, the distance to these faces takes over. So nothing vanishes, nothing bulges, and no stray sheet appears.
//! The band is narrower where lumen or gap are thin, so that a vessel one voxel wide stays and vessels one voxel apart
//! do not merge.

use rayon::prelude::*;
use serde::Serialize;

use super::Implicit;
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::{BoundaryDistance, Grid, Mask, lumen_box};
use crate::pointcloud::block3;

/// How far the wall may lie from the mask's voxel faces.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GuardOptions {
    /// Half width of the band, voxel diagonals.
    pub band: f64,
    /// Largest share of the local inscribed radius (of the lumen inside, of the gap outside) that the band may take.
    pub share: f64,
}

impl Default for GuardOptions {
    /// 0.6 voxel diagonals and 60 % of the inscribed radius.
    fn default() -> Self {
        GuardOptions { band: 0.6, share: 0.6 }
    }
}

impl GuardOptions {
    /// This guard and ever narrower ones, down to an eighth of its band, where hardly more than the mask's own boundary
    /// is left and with it the mask's topology.
    pub fn narrower(&self) -> impl Iterator<Item = GuardOptions> + use<> {
        let GuardOptions { band, share } = *self;
        [1.0, 0.5, 0.25, 0.125].into_iter().map(move |f| GuardOptions { band: f * band, share: f * share })
    }
}

/// The mask's voxel-face boundary and the width of the band round it that the wall may use.
#[derive(Debug, Clone)]
pub struct MaskBoundary {
    distance: BoundaryDistance,
    grid: Grid,
    /// Band half width of each voxel of the array grown by one, in 255ths of the widest.
    band: Vec<u8>,
    widest: f64,
    bounds: Aabb,
}

impl MaskBoundary {
    /// Prepares the boundary of `mask`; `None` where there is no lumen. Beyond the array is background.
    pub fn new(mask: &Mask, options: &GuardOptions) -> Option<MaskBoundary> {
        let lumen = lumen_box(mask)?;
        let widest = options.band * mask.grid.voxel_diagonal();
        let least = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
        // Distances must be exact beyond the band, or a stray sheet far away could pass.
        let distance = BoundaryDistance::new(mask, (1.3 * widest / least).ceil() as usize + 1);
        let mut bounds = Aabb::EMPTY;
        for c in 0..8 {
            let corner = Vector::from_fn(|a, _| if c >> a & 1 == 0 { lumen[a][0] as f64 - 1.5 } else { lumen[a][1] as f64 + 1.5 });
            bounds.include(&mask.grid.to_world(corner));
        }
        // The lumen's faces, a voxel to spare, and the band, which is wider than a voxel where voxels are long.
        let bounds = bounds.inflated(widest);
        let grid = mask.grid.window([-1; 3], mask.grid.dims.map(|n| n + 2));
        let band = band_widths(&grid, &distance, options.share / widest);
        Some(MaskBoundary { distance, grid, band, widest, bounds })
    }

    /// Signed distance to the boundary faces, mm, negative in the lumen, and its gradient.
    ///
    /// Exact within 1.3 band widths of the boundary; farther away a lower bound of its size.
    pub fn signed_distance(&self, p: &Point) -> (f64, Vector) {
        self.distance.value_gradient(p)
    }

    /// Half width of the band at `p`, mm: trilinear between the voxels' own.
    pub fn band_at(&self, p: &Point) -> f64 {
        let x = self.grid.to_index(p);
        // Per axis, places and weights of the two voxels that `x` lies between.
        let axis = |a: usize| {
            let base = x[a].floor();
            let (f, low, last) = (x[a] - base, base as i64, self.grid.dims[a] as i64 - 1);
            ([low, low.saturating_add(1)].map(|v| v.clamp(0, last) as usize), [1.0 - f, f])
        };
        let [(i, wx), (j, wy), (k, wz)] = [axis(0), axis(1), axis(2)];
        let mut sum = 0.0;
        for c in 0..8 {
            let [x, y, z] = [c & 1, c >> 1 & 1, c >> 2];
            let n = i[x] + self.grid.dims[0] * (j[y] + self.grid.dims[1] * k[z]);
            sum += wx[x] * wy[y] * wz[z] * f64::from(self.band[n]);
        }
        sum * self.widest / 255.0
    }

    /// Box that holds the lumen and the band.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Widest half width of the band, mm.
    pub fn widest_band(&self) -> f64 {
        self.widest
    }
}

/// Band of every voxel near the boundary: no wider than a share of the inscribed radius of its own label there, nor of
/// that of a neighbour, for a wall has two sides.
fn band_widths(grid: &Grid, distance: &BoundaryDistance, share: f64) -> Vec<u8> {
    let spacing = grid.spacing();
    let least = spacing.iter().copied().fold(f64::INFINITY, f64::min);
    let depth: Vec<f32> = (0..grid.len())
        .into_par_iter()
        .map(|n| {
            let [i, j, k] = grid.voxel(n).map(|c| c as f64);
            distance.value(&grid.to_world(Vector::new(i, j, k))) as f32
        })
        .collect();
    let reach: Vec<([i64; 3], f64)> = (0..125)
        .map(|n| [n % 5 - 2, n / 5 % 5 - 2, n / 25 - 2])
        .map(|o: [i64; 3]| (o, (0..3).map(|a| (o[a] as f64 * spacing[a]).powi(2)).sum::<f64>().sqrt()))
        .collect();
    let own: Vec<u8> = (0..grid.len())
        .into_par_iter()
        .map(|n| {
            let mine = f64::from(depth[n]);
            if mine.abs() >= 0.99 * distance.reach() {
                return 255;
            }
            let v = grid.voxel(n).map(|c| c as i64);
            let mut radius = mine.abs();
            for &(o, away) in &reach {
                let Some(m) = grid.linear(v[0] + o[0], v[1] + o[1], v[2] + o[2]) else { continue };
                let theirs = f64::from(depth[m]);
                // The ball's surface may cut the voxel: stair corners belong to the thick part they stand on.
                if theirs * mine > 0.0 && theirs.abs() > radius && away - 0.6 * least <= theirs.abs() {
                    radius = theirs.abs();
                }
            }
            // Two voxels wide: the middle of a block of eight is as deep as no centre is.
            if radius < 0.9 * least && in_block_of_eight(grid, &depth, v) {
                radius = least;
            }
            ((share * radius).min(1.0) * 255.0) as u8
        })
        .collect();
    // Twice: where a thin branch leaves a trunk, the trunk's own wall must not be cut back past the branch's root.
    let least = |data: &[u8]| block3(data, grid.dims, |a, b, c| a.min(b).min(c));
    least(&least(&own))
}

/// Whether some 2×2×2 block that holds voxel `v` has one label.
fn in_block_of_eight(grid: &Grid, depth: &[f32], v: [i64; 3]) -> bool {
    let inside = |v: [i64; 3]| grid.linear(v[0], v[1], v[2]).is_some_and(|n| depth[n] < 0.0);
    let label = inside(v);
    (0..8).any(|b| {
        let low = [0, 1, 2].map(|a| v[a] - (b >> a & 1));
        (0..8).all(|c| inside([0, 1, 2].map(|a| low[a] + (c >> a & 1))) == label)
    })
}

/// An implicit function held within the band round the mask's boundary, everywhere or in some voxels.
#[derive(Debug, Clone)]
pub struct Guarded<I> {
    inner: I,
    boundary: MaskBoundary,
    /// Voxels of the array grown by one in which the guard acts, a bit each; all of them where there are none.
    only: Vec<u64>,
}

impl<I: Implicit> Guarded<I> {
    /// Guards `inner` by the boundary of the mask it was made from.
    pub fn new(inner: I, boundary: MaskBoundary) -> Guarded<I> {
        Guarded { inner, boundary, only: Vec::new() }
    }

    /// Lets the guard act in these voxels of the mask alone. Where the function without the guard has another zero set
    /// than with it, either all voxels of that place are to be among them or none.
    #[must_use]
    pub fn only_in<'a>(mut self, voxels: impl IntoIterator<Item = &'a [i64; 3]>) -> Guarded<I> {
        let grid = &self.boundary.grid;
        self.only = vec![0; grid.len() / 64 + 1];
        for [i, j, k] in voxels {
            if let Some(n) = grid.linear(i + 1, j + 1, k + 1) {
                self.only[n / 64] |= 1 << (n % 64);
            }
        }
        self
    }

    /// Lets the guard act everywhere.
    #[must_use]
    pub fn everywhere(self) -> Guarded<I> {
        Guarded { only: Vec::new(), ..self }
    }

    /// The function without the guard.
    pub fn into_inner(self) -> I {
        self.inner
    }

    /// The function without the guard, and the boundary that guards it.
    pub fn into_parts(self) -> (I, MaskBoundary) {
        (self.inner, self.boundary)
    }

    fn acts(&self, p: &Point) -> bool {
        let grid = &self.boundary.grid;
        self.only.is_empty() || {
            let [i, j, k] = grid.to_index(p).map(|x| x.round() as i64).into();
            grid.linear(i, j, k).is_some_and(|n| self.only[n / 64] >> (n % 64) & 1 == 1)
        }
    }

    /// The function without the guard.
    pub fn inner(&self) -> &I {
        &self.inner
    }

    /// The mask's boundary.
    pub fn boundary(&self) -> &MaskBoundary {
        &self.boundary
    }

    /// Band half width at `p` and the distance there, or the distance alone where it decides.
    fn limits(&self, p: &Point) -> (f64, Vector, f64) {
        let (d, g) = self.boundary.signed_distance(p);
        let tau = self.boundary.band_at(p);
        (d, g, tau)
    }

    /// Whether the guard replaces the function at `p`.
    pub fn intervenes(&self, p: &Point) -> bool {
        if !self.acts(p) {
            return false;
        }
        let (d, _, tau) = self.limits(p);
        let f = self.inner.value(p);
        !(f >= d - tau && f <= d + tau)
    }
}

impl<I: Implicit> Implicit for Guarded<I> {
    fn value(&self, p: &Point) -> f64 {
        if !self.acts(p) {
            return self.inner.value(p);
        }
        let (d, _, tau) = self.limits(p);
        if d.abs() >= self.boundary.widest + tau {
            return d;
        }
        let f = self.inner.value(p);
        if f.is_finite() { f.clamp(d - tau, d + tau) } else { d }
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        if !self.acts(p) {
            return self.inner.value_gradient(p);
        }
        let (d, g, tau) = self.limits(p);
        if d.abs() >= self.boundary.widest + tau {
            return (d, g);
        }
        let (f, gf) = self.inner.value_gradient(p);
        if f >= d - tau && f <= d + tau {
            (f, gf)
        } else if f > d + tau {
            (d + tau, g)
        } else if f < d - tau {
            (d - tau, g)
        } else {
            (d, g)
        }
    }

    fn bounds(&self) -> Aabb {
        self.boundary.bounds
    }

    fn resolution(&self) -> f64 {
        self.inner.resolution()
    }
}

#[cfg(test)]
mod tests;
