//! The smooth fit: the likeliest smooth function whose signs are the mask's.
//!
//! A mask sampled at voxel centres tells the sign of the distance to the wall there and nothing else. The fit
//! is the maximum a posteriori estimate of a function u given these signs, −ln p =
//!
//! ½ λ ∫|D³u|² − Σ ln Φ(s·u/σ) + ½ μ Σ (n·∇u − 1)²
//!
//! over the voxels at the wall: s is the voxel's sign, Φ the normal distribution function, n the direction of
//! ∇u. Third derivatives vanish on quadrics, so tubes and bulges do not shrink as under a membrane or
//! thin-plate energy; σ well below a voxel lets every centre that the wall nearly touches place it to a
//! fraction of a voxel; the last term makes u a distance. u is a uniform cubic B-spline on the voxel grid (long
//! axes of anisotropic voxels are subdivided), hence C² with exact first and second derivatives. The problem
//! is solved by Newton's method with conjugate gradients on a band of three voxels either side of the wall.
//!
//! Where the estimate contradicts a label (vessels of one or two voxels), the label is given a margin and the
//! estimate repeated, so that nothing vanishes and neighbours do not merge.

use nalgebra::Matrix3;
use rayon::prelude::*;
use serde::Serialize;

use super::Implicit;
use super::band::Band;
use super::solve::{self, Effort, Weights};
use super::spline::{NODES, TILE, TILE_LEN, Tile, TiledSpline};
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::{Grid, Mask};

/// How to weigh smoothness against the labels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SmoothOptions {
    /// λ, weight of the squared third derivatives, lengths in smallest voxel spacings. Larger is smoother.
    pub smoothness: f64,
    /// σ, width of a label's likelihood, in smallest voxel spacings. Larger forgives noisy labels.
    pub sigma: f64,
    /// μ, weight of unit slope at the wall.
    pub gauge: f64,
    /// Newton steps at most.
    pub steps: usize,
    /// Products with the system's matrix in one step at most; half as many more where voxels are anisotropic.
    pub products: usize,
    /// Rounds of giving contradicted labels a margin at most.
    pub repairs: usize,
}

impl Default for SmoothOptions {
    fn default() -> Self {
        SmoothOptions { smoothness: 1.0, sigma: 0.1, gauge: 1.0, steps: 8, products: 40, repairs: 4 }
    }
}

/// What the fit did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SmoothSummary {
    /// Spline coefficients solved for.
    pub unknowns: usize,
    /// Voxels whose label was used.
    pub labels: usize,
    /// Products with the system's matrix.
    pub products: usize,
    /// Labels that were given a margin.
    pub repaired: usize,
    /// Labels the function still contradicts.
    pub contradicted: usize,
    /// Where it does, at most ten places, mm.
    pub contradictions: Vec<[f64; 3]>,
}

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SmoothError {
    /// Nothing to fit.
    #[error("the mask has no boundary: it needs at least one lumen voxel")]
    Empty,
    /// An option is out of range.
    #[error("smooth fit: {name} is {value}; it must be a number above 0")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// Spacing so uneven that the refined grid does not fit.
    #[error("the voxels are {0:.0} times longer than wide; resample the mask to at most 20")]
    Anisotropy(f64),
}

/// A cubic spline round the wall; a constant of the right sign, three smallest voxel spacings large, elsewhere.
///
/// C² within about a voxel and a half of the wall; continuous, save between tiles of the far field.
#[derive(Debug, Clone)]
pub struct SmoothImplicit {
    spline: TiledSpline,
    grid: Grid,
    refine: Vector,
    low: Vector,
    unit: f64,
    bounds: Aabb,
}

impl SmoothImplicit {
    fn node(&self, p: &Point) -> Vector {
        self.grid.to_index(p).component_mul(&self.refine) - self.low
    }
}

impl Implicit for SmoothImplicit {
    fn value(&self, p: &Point) -> f64 {
        self.unit * self.spline.value(&self.node(p))
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let (v, g) = self.spline.value_gradient(&self.node(p));
        (self.unit * v, self.grid.gradient_to_world(&g.component_mul(&self.refine)) * self.unit)
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn resolution(&self) -> f64 {
        self.unit
    }

    fn hessian(&self, p: &Point) -> Matrix3<f64> {
        let h = self.spline.hessian(&self.node(p));
        let s = Matrix3::from_diagonal(&self.refine);
        let m = s * h * s;
        let columns = [0, 1, 2].map(|a| self.grid.gradient_to_world(&m.column(a).into_owned()));
        let half = Matrix3::from_columns(&columns).transpose();
        let columns = [0, 1, 2].map(|a| self.grid.gradient_to_world(&half.column(a).into_owned()));
        Matrix3::from_columns(&columns) * self.unit
    }
}

/// Fits a smooth function to the labels of `mask`; beyond the mask lies background.
///
/// The value has the sign of the label at every voxel centre, save those counted in
/// [`SmoothSummary::contradicted`]. Near the wall it is close to the signed distance in mm.
///
/// # Errors
/// [`SmoothError`]: no lumen voxel, or options out of range.
pub fn fit(mask: &Mask, options: &SmoothOptions) -> Result<(SmoothImplicit, SmoothSummary), SmoothError> {
    for (name, value) in [("smoothness", options.smoothness), ("sigma", options.sigma), ("gauge", options.gauge)] {
        if !value.is_finite() || value <= 0.0 {
            return Err(SmoothError::Option { name, value });
        }
    }
    let spacing = mask.grid.spacing();
    let least = spacing[0].min(spacing[1]).min(spacing[2]);
    let refine = spacing.map(|s| (s / least).round() as i32);
    if let Some(&m) = refine.iter().find(|&&m| m > 20) {
        return Err(SmoothError::Anisotropy(m as f64));
    }
    let unit = (0..3).map(|a| spacing[a] / refine[a] as f64).fold(f64::INFINITY, f64::min);
    let band = Band::of(mask, refine);
    if band.len() == 0 {
        return Err(SmoothError::Empty);
    }
    let weights = Weights {
        smoothness: options.smoothness as f32,
        sigma: options.sigma as f32,
        gauge: options.gauge as f32,
        scale: std::array::from_fn(|a| (unit * refine[a] as f64 / spacing[a]) as f32),
    };
    let mut c = start(&band, &weights);
    let mut margin = vec![0.0f32; band.len()];
    // Between the planes of long voxels only smoothness acts, which conjugate gradients find late.
    let inner = if refine == [1; 3] { options.products } else { options.products + options.products / 2 };
    let effort = Effort { steps: options.steps, sigma: 0.4, products: inner, tolerance: 0.1 };
    let mut products = solve::newton(&band, &mut c, &weights, &margin, effort);
    // Contradicted labels: a growing margin each round.
    let wrong = |c: &[f32], least: f32| -> Vec<usize> {
        let now = solve::sample(&band, c, &weights);
        (0..band.len()).filter(|&i| band.sign[i] as f32 * now.value[i] < least * band.sign[i].abs() as f32).collect()
    };
    let mut left = wrong(&c, 0.02);
    for _ in 0..options.repairs {
        if left.is_empty() {
            break;
        }
        for &i in &left {
            margin[i] += 0.15;
        }
        let effort = Effort { steps: 2, sigma: options.sigma, products: inner / 2, tolerance: 0.1 };
        products += solve::newton(&band, &mut c, &weights, &margin, effort);
        left = wrong(&c, 0.02);
    }
    let left = wrong(&c, 0.0);
    let summary = SmoothSummary {
        unknowns: band.len(),
        labels: band.sign.iter().filter(|&&s| s != 0).count(),
        products,
        repaired: margin.iter().filter(|&&m| m > 0.0).count(),
        contradicted: left.len(),
        contradictions: left.iter().take(10).map(|&i| mask.grid.to_world(band.voxel(i)).into()).collect(),
    };
    let spline = tile(&band, mask, &c);
    let g = &mask.grid;
    let corners = (0..8).map(|n| {
        let pick = |a: usize| if n >> a & 1 == 0 { -1.5 } else { g.dims[a] as f64 + 0.5 };
        g.to_world(Vector::new(pick(0), pick(1), pick(2)))
    });
    let bounds = Aabb::of(&corners.collect::<Vec<_>>());
    let v = |a: [i32; 3]| Vector::new(a[0] as f64, a[1] as f64, a[2] as f64);
    let f = SmoothImplicit { spline, grid: g.clone(), refine: v(refine), low: v(band.low), unit, bounds };
    Ok((f, summary))
}

/// First guess: city-block distance to the other label, smoothed and brought to unit slope.
fn start(band: &Band, w: &Weights) -> Vec<f32> {
    let opposite: Vec<f32> = band.side.iter().map(|&s| s as f32).collect();
    // Distances in nodes: 0.5 next to the other label.
    let mut d = neighbours(band, &opposite, |here, near| {
        if near.iter().flatten().any(|n| n * here < 0.0) { 0.5 } else { 4.5 }
    });
    for _ in 0..3 {
        d = neighbours(band, &d, |here, near| near.iter().flatten().fold(here, |m, n| m.min(n + 1.0)));
    }
    let mut c: Vec<f32> = d.iter().zip(&band.side).map(|(d, &s)| d * s as f32).collect();
    let most = band.refine.iter().max().copied().unwrap_or(1);
    for _ in 0..(2 * most * most).clamp(3, 24) {
        c = neighbours(band, &c, |here, near| {
            let count = near.iter().flatten().count() as f32;
            (here + 0.5 * near.iter().flatten().sum::<f32>()) / (1.0 + 0.5 * count)
        });
    }
    let now = solve::sample(band, &c, w);
    for i in 0..c.len() {
        let slope = now.gradient[i].iter().map(|v| v * v).sum::<f32>().sqrt();
        c[i] /= if band.sign[i] != 0 { slope.clamp(0.7, 1.8) } else { 1.3 };
    }
    c
}

/// One Jacobi pass of `f(value here, values of the six neighbours)`.
fn neighbours(band: &Band, c: &[f32], f: impl Fn(f32, &[Option<f32>; 6]) -> f32 + Sync) -> Vec<f32> {
    let parts: Vec<Vec<f32>> = band
        .runs
        .par_iter()
        .map(|r| {
            let (n, at) = (r.len as usize, r.start as usize);
            let mut near = vec![[None; 6]; n];
            for i in 0..n {
                near[i][0] = (i > 0).then(|| c[at + i - 1]);
                near[i][1] = (i + 1 < n).then(|| c[at + i + 1]);
            }
            for (s, (y, z)) in [(r.y - 1, r.z), (r.y + 1, r.z), (r.y, r.z - 1), (r.y, r.z + 1)].into_iter().enumerate() {
                for o in band.row(y, z) {
                    let (a, b) = (o.x.max(r.x), (o.x + o.len as i32).min(r.x + r.len as i32));
                    for x in a..b.max(a) {
                        near[(x - r.x) as usize][s + 2] = Some(c[o.start as usize + (x - o.x) as usize]);
                    }
                }
            }
            (0..n).map(|i| f(c[at + i], &near[i])).collect()
        })
        .collect();
    parts.concat()
}

/// The coefficients in tiles; beyond the band ±3 nodes by the nearest voxel's label.
fn tile(band: &Band, mask: &Mask, c: &[f32]) -> TiledSpline {
    const FAR: f32 = 3.0;
    let tiles = band.dims.map(|n| n.div_ceil(TILE));
    let index = |t: [usize; 3]| t[0] + tiles[0] * (t[1] + tiles[1] * t[2]);
    let mut needed = vec![false; tiles.iter().product()];
    // Node i belongs to cells i−2 ..= i+1.
    let span = |a: usize, lo: i32, hi: i32| {
        let last = tiles[a] as i32 - 1;
        let tile = |i: i32| i.div_euclid(TILE as i32).clamp(0, last) as usize;
        tile(lo - 2)..=tile(hi + 1)
    };
    for r in &band.runs {
        for z in span(2, r.z, r.z) {
            for y in span(1, r.y, r.y) {
                for x in span(0, r.x, r.x + r.len as i32 - 1) {
                    needed[index([x, y, z])] = true;
                }
            }
        }
    }
    let m = band.refine;
    let side = |n: [i32; 3]| -> f32 {
        let v: [i64; 3] = std::array::from_fn(|a| (2 * (n[a] + band.low[a]) + m[a]).div_euclid(2 * m[a]) as i64);
        if mask.at(v[0], v[1], v[2]) { -FAR } else { FAR }
    };
    let mut stored = 0;
    let mut table = Vec::with_capacity(needed.len());
    let mut keys = Vec::new();
    for (n, &want) in needed.iter().enumerate() {
        let t = [n % tiles[0], n / tiles[0] % tiles[1], n / (tiles[0] * tiles[1])];
        if want {
            table.push(Tile::Stored(stored));
            stored += 1;
            keys.push(t);
        } else {
            table.push(Tile::Constant(side(t.map(|t| (t * TILE) as i32))));
        }
    }
    let parts: Vec<Vec<f32>> = keys
        .par_iter()
        .map(|t| {
            let low = t.map(|t| (t * TILE) as i32 - 1);
            let mut out = Vec::with_capacity(TILE_LEN);
            for k in 0..NODES as i32 {
                for j in 0..NODES as i32 {
                    let (y, z) = (low[1] + j, low[2] + k);
                    let first = out.len();
                    out.extend((0..NODES as i32).map(|i| side([low[0] + i, y, z])));
                    for r in band.row(y, z) {
                        let (a, b) = (r.x.max(low[0]), (r.x + r.len as i32).min(low[0] + NODES as i32));
                        for x in a..b.max(a) {
                            out[first + (x - low[0]) as usize] = c[r.start as usize + (x - r.x) as usize];
                        }
                    }
                }
            }
            out
        })
        .collect();
    TiledSpline { tiles, table, coefficients: parts.concat(), outside: FAR as f64 }
}

#[cfg(test)]
#[path = "smooth_tests.rs"]
mod tests;
