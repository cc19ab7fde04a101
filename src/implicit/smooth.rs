//! The smooth fit: the likeliest smooth function whose signs are the mask's.
//!
//! A mask sampled at voxel centres tells the sign of the distance to the wall there and nothing else. The fit
//! is the maximum a posteriori estimate of a function u given these signs, −ln p =
//!
//! ½ λ τ ∫ ln(1 + |D³u|²/τ) − Σ ln(ε + (1 − 2ε) Φ(s·u/σ)) + ½ μ Σ (n·∇u − 1)²
//!
//! over the voxels at the wall: s is the voxel's sign, Φ the normal distribution function, n the direction of
//! ∇u. Third derivatives vanish on quadrics, so tubes and bulges do not shrink as under a membrane or
//! thin-plate energy; the logarithm (a heavy-tailed prior, met by reweighting λ in every step) lets creases be where vessels
//! join, so that λ can be large elsewhere; σ well below a voxel lets every centre that the wall nearly touches place it to a
//! fraction of a voxel; ε, 0 on a clean mask, is the share of labels that are wrong whatever the distance, estimated from the
//! mask and once more from the fit; the last term makes u a distance. u is a uniform cubic B-spline, hence C² with exact first
//! and second derivatives, on a band round the wall. The problem is solved by Newton's method with conjugate
//! gradients.
//!
//! Three levels: a node every four voxels (of the shortest side) for a start, then every two, which is fine enough
//! wherever the wall's radius is several voxels and leaves a well-conditioned problem of a quarter of the size. Where
//! that contradicts labels, the spline is subdivided (exactly) to a node a voxel and the estimate repeated there alone.
//! Labels that are contradicted still, and without which the digitised fit would have another topology or lose a thin
//! part, are given a margin, so that nothing vanishes and neighbours do not merge.

mod band;
mod critical;
mod energy;
mod fine;
mod labels;
mod lanes;
mod level;
mod likelihood;
mod noise;
mod neighbourhood;
mod refine;
mod solve;
mod spline;

use nalgebra::Matrix3;
use rayon::prelude::*;
use serde::Serialize;

use super::Implicit;
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::{self, Grid, Mask};
use band::Nodes;
use labels::Near;
use level::{Level, subdivide, tile};
use refine::Coarse;
use solve::{Effort, Problem, Weights};
use spline::{TiledSpline, tile_of};

/// How to weigh smoothness against the labels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SmoothOptions {
    /// λ, weight of the squared third derivatives, lengths in smallest voxel spacings. Larger is smoother.
    pub smoothness: f64,
    /// τ, squared third derivative (smallest spacings⁻⁴) at which λ is halved: creases where vessels join stay sharper.
    pub crease: f64,
    /// σ, width of a label's likelihood, in smallest voxel spacings. Larger forgives noisy labels.
    pub sigma: f64,
    /// μ, weight of unit slope at the wall.
    pub gauge: f64,
    /// Newton steps at most.
    pub steps: usize,
    /// Products with the system's matrix in one step at most.
    pub products: usize,
    /// Labels contradicted by more than this, in smallest voxel spacings, call for the finest level.
    pub refine_beyond: f64,
    /// Rounds of giving contradicted labels a margin at most.
    pub repairs: usize,
    /// ε, share of the labels that are wrong whatever the distance; estimated from the mask where `None`. Where it is not 0,
    /// labels that everything round them contradicts are given up, and the fit is smoother.
    pub outliers: Option<f64>,
    /// Keep, on a noisy mask too, every label that the topology might need: where without it the surface has another one.
    pub strict: bool,
}

impl Default for SmoothOptions {
    fn default() -> Self {
        SmoothOptions {
            smoothness: 3.0,
            crease: 0.01,
            sigma: 0.07,
            gauge: 1.0,
            steps: 2,
            products: 12,
            refine_beyond: 0.2,
            repairs: 8,
            outliers: None,
            strict: false,
        }
    }
}

/// What the fit did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SmoothSummary {
    /// Spline coefficients of the level with a node every two voxels.
    pub unknowns: usize,
    /// Coefficients of the finest level that were solved for.
    pub refined: usize,
    /// Voxels whose label was used.
    pub labels: usize,
    /// Products with the system's matrix: of the first two levels, of the finest.
    pub products: [usize; 2],
    /// Share of the boundary's labels taken for noise; 0 on a clean mask.
    pub outliers: f64,
    /// Labels that were given up as noise: contradicted by more than `refine_beyond`.
    pub given_up: usize,
    /// Labels that were given a margin.
    pub repaired: usize,
    /// Of these, labels the function still contradicts.
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
    /// The share of outliers is none.
    #[error("smooth fit: outliers is {0}; it must be a share from 0 to below 0.5")]
    Outliers(f64),
    /// Spacing so uneven that the refined grid does not fit.
    #[error("the voxels are {0:.0} times longer than wide; resample the mask to at most 20")]
    Anisotropy(f64),
    /// Voxel indices beyond 16 bits.
    #[error("the mask is {0} voxels long; crop it to at most 32000 along each axis")]
    TooLong(usize),
}

/// A cubic spline round the wall; a constant of the right sign, some voxels large, elsewhere.
///
/// C² within about a voxel of the wall; continuous, save between tiles of the far field.
#[derive(Debug, Clone)]
pub struct SmoothImplicit {
    coarse: TiledSpline,
    fine: TiledSpline,
    grid: Grid,
    /// Nodes of the coarse level a voxel.
    refine: Vector,
    low: Vector,
    unit: f64,
    bounds: Aabb,
}

impl SmoothImplicit {
    /// The spline that holds at `p`, the place in its nodes, and its nodes a voxel.
    #[inline(always)]
    fn at(&self, p: &Point) -> (&TiledSpline, Vector, f64) {
        let x = self.grid.to_index(p).component_mul(&self.refine) - self.low;
        let fine = 2.0 * x;
        if self.fine.holds(&fine) { (&self.fine, fine, 2.0) } else { (&self.coarse, x, 1.0) }
    }
}

impl Implicit for SmoothImplicit {
    fn value(&self, p: &Point) -> f64 {
        let (spline, x, _) = self.at(p);
        self.unit * spline.value(&x)
    }

    fn values(&self, points: &[Point], out: &mut [f64]) {
        pulp::Arch::new().dispatch(Values { f: self, points, out });
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let (spline, x, level) = self.at(p);
        let (v, g) = spline.value_gradient(&x);
        (self.unit * v, self.grid.gradient_to_world(&g.component_mul(&self.refine)) * (self.unit * level))
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn resolution(&self) -> f64 {
        self.unit
    }

    fn values_on(&self, origin: &Point, steps: &Matrix3<f64>, low: [i32; 3], size: usize, out: &mut [f64]) -> bool {
        let first = self.grid.to_index(origin);
        let m = Matrix3::from_columns(&[0, 1, 2].map(|a| self.grid.to_index(&(origin + steps.column(a))) - first));
        // Off the axes by less than a millionth of a step over ten thousand steps.
        if (0..9).any(|n| n / 3 != n % 3 && m[n].abs() > 1e-10 * m[4 * (n / 3)].abs()) {
            return false;
        }
        let place = |a: usize, c: i32| (first[a] + m[(a, a)] * f64::from(c)) * self.refine[a] - self.low[a];
        let x = [0, 1, 2].map(|a| (low[a]..).take(size).map(|c| place(a, c)).collect::<Vec<f64>>());
        // Runs within a tile of the finer spline, which lies within one of the coarser.
        let tiles = |a: usize| x[a].chunk_by(|p, q| tile_of(2.0 * p) == tile_of(2.0 * q));
        let mut at = [0; 3];
        for z in tiles(2) {
            at[1] = 0;
            for y in tiles(1) {
                at[0] = 0;
                for x in tiles(0) {
                    let run = [x, y, z];
                    let fine = run.map(|r| r.iter().map(|x| 2.0 * x).collect::<Vec<f64>>());
                    let corner = Vector::from_fn(|a, _| fine[a][0]);
                    if self.fine.holds(&corner) {
                        self.fine.fill([&fine[0], &fine[1], &fine[2]], at, size, out);
                    } else {
                        self.coarse.fill(run, at, size, out);
                    }
                    at[0] += x.len();
                }
                at[1] += y.len();
            }
            at[2] += z.len();
        }
        out.iter_mut().for_each(|v| *v *= self.unit);
        true
    }

    fn hessian(&self, p: &Point) -> Matrix3<f64> {
        let (spline, x, level) = self.at(p);
        let s = Matrix3::from_diagonal(&(self.refine * level));
        let m = s * spline.hessian(&x) * s;
        let columns = [0, 1, 2].map(|a| self.grid.gradient_to_world(&m.column(a).into_owned()));
        let half = Matrix3::from_columns(&columns).transpose();
        let columns = [0, 1, 2].map(|a| self.grid.gradient_to_world(&half.column(a).into_owned()));
        Matrix3::from_columns(&columns) * self.unit
    }
}

/// The value at many points; compiled for several kinds of processor.
struct Values<'a> {
    f: &'a SmoothImplicit,
    points: &'a [Point],
    out: &'a mut [f64],
}

impl pulp::WithSimd for Values<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        for (v, p) in self.out.iter_mut().zip(self.points) {
            let (spline, x, _) = self.f.at(p);
            *v = self.f.unit * spline.value(&x);
        }
    }
}

/// Fits a smooth function to the labels of `mask`; beyond the mask lies background.
///
/// The value has the sign of the label at the voxel centres, save some whose flip changes neither the topology nor a
/// thin part, and those counted in [`SmoothSummary::contradicted`]. Near the wall it is close to the signed distance
/// in mm.
///
/// # Errors
/// [`SmoothError`]: no lumen voxel, or options out of range.
pub fn fit(mask: &Mask, options: &SmoothOptions) -> Result<(SmoothImplicit, SmoothSummary), SmoothError> {
    // Thousands of short parallel loops: from a thread of the pool they start without waking and waiting.
    rayon::scope(|_| fit_inside(mask, options))
}

fn fit_inside(mask: &Mask, options: &SmoothOptions) -> Result<(SmoothImplicit, SmoothSummary), SmoothError> {
    for (name, value) in [("smoothness", options.smoothness), ("crease", options.crease), ("sigma", options.sigma), ("gauge", options.gauge)] {
        if !value.is_finite() || value <= 0.0 {
            return Err(SmoothError::Option { name, value });
        }
    }
    if let Some(value) = options.outliers.filter(|e| !(0.0..0.5).contains(e)) {
        return Err(SmoothError::Outliers(value));
    }
    if let Some(&n) = mask.grid.dims.iter().find(|&&n| n > 32_000) {
        return Err(SmoothError::TooLong(n));
    }
    let spacing = mask.grid.spacing();
    let least = spacing[0].min(spacing[1]).min(spacing[2]);
    let refine = spacing.map(|s| (s / least).round() as i32);
    if let Some(&m) = refine.iter().find(|&&m| m > 20) {
        return Err(SmoothError::Anisotropy(m as f64));
    }
    let unit = (0..3).map(|a| spacing[a] / refine[a] as f64).fold(f64::INFINITY, f64::min);
    let interface = mask::interface(mask);
    let near = labels::boundary(&interface);

    if near.is_empty() {
        return Err(SmoothError::Empty);
    }
    let outliers = options.outliers.unwrap_or_else(|| mask::noise::estimate(mask, &interface));
    let noisy = outliers > 0.0;
    // Noise looks like creases, so that the prior must not make way for it so soon.
    let [smoother, duller] = if noisy { [2.0, 3.0] } else { [1.0, 1.0] };
    let mut weights = Weights {
        smoothness: (smoother * options.smoothness) as f32,
        crease: (duller * options.crease) as f32,
        sigma: options.sigma as f32,
        outliers: outliers as f32,
        gauge: options.gauge as f32,
        scale: std::array::from_fn(|a| (unit * refine[a] as f64 / spacing[a]) as f32),
    };
    let effort = Effort { steps: options.steps, sigma: 0.4, products: options.products, tolerance: 0.1, change: 0.03 };

    let mut products = 0;
    let mut coarse = Level::new(mask, Nodes::of(mask, refine, 4), &near, None, false, weights.scale);

    let problem = Problem { band: &coarse.band, labels: &coarse.labels, weights, frozen: &[] };
    let (mut c, started) = problem.start(spacing.map(|s| (s / unit) as f32), effort);
    products += started + problem.newton(&mut c, &[], effort);

    let level = Level::new(mask, Nodes::of(mask, refine, 2), &near, None, true, weights.scale);

    c = subdivide(&coarse.band, &c, &level.band);

    coarse = level;
    let problem = Problem { band: &coarse.band, labels: &coarse.labels, weights, frozen: &[] };
    let effort = Effort { sigma: options.sigma, ..effort };
    products += problem.newton(&mut c, &[], effort);

    let mut values = coarse.labels.sample(&c);
    if noisy {
        weights.outliers = noise::share(&coarse.labels.labels, &values, &weights);
        let problem = Problem { band: &coarse.band, labels: &coarse.labels, weights, frozen: &[] };
        products += problem.newton(&mut c, &[], effort);
        values = coarse.labels.sample(&c);
    }
    let mut hard = coarse.below(&values, -options.refine_beyond as f32);
    if noisy {
        hard = noise::crowded(&coarse.labels.labels, &hard);
    }
    let mut summary = SmoothSummary {
        unknowns: coarse.band.coefficients(),
        refined: 0,
        labels: coarse.labels.labels.len(),
        products: [products, 0],
        outliers: f64::from(weights.outliers),
        given_up: 0,
        repaired: 0,
        contradicted: 0,
        contradictions: Vec::new(),
    };
    let leniently = noisy && !options.strict;
    let base = Coarse { mask, level: coarse, c, near: &near, weights, effort, leniently };
    hard.extend(base.must_keep(&values, None));

    let fine = if hard.is_empty() { TiledSpline::nowhere() } else { base.refine(&hard, values, options.repairs, &mut summary) };

    let Coarse { level: coarse, c, .. } = base;
    let nodes = coarse.band.nodes;
    let table = tile(mask, &coarse.band, &c);

    let g = &mask.grid;
    let corners = (0..8).map(|n| {
        let pick = |a: usize| if n >> a & 1 == 0 { -1.5 } else { g.dims[a] as f64 + 0.5 };
        g.to_world(Vector::new(pick(0), pick(1), pick(2)))
    });
    let bounds = Aabb::of(&corners.collect::<Vec<_>>());
    let f = SmoothImplicit {
        coarse: table,
        fine,
        grid: g.clone(),
        refine: Vector::from_fn(|a, _| f64::from(refine[a]) / 2.0),
        low: Vector::from_fn(|a, _| f64::from(nodes.low[a])),
        unit,
        bounds,
    };
    if noisy {
        let against = |n: &Near| {
            let v = n.voxel.map(i64::from);
            let side = if mask.at(v[0], v[1], v[2]) { -1.0 } else { 1.0 };
            side * f.value(&g.to_world(Vector::from(n.voxel.map(f64::from)))) < -options.refine_beyond * unit
        };
        summary.given_up = near.par_iter().filter(|n| against(n)).count();
    }
    Ok((f, summary))
}

#[cfg(test)]
#[path = "smooth/tests.rs"]
mod tests;
