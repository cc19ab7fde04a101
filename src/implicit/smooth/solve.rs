//! The penalised maximum-likelihood problem of the smooth fit, and its Newton solver.

use rayon::prelude::*;

use super::band::{Band, TERMS};
use super::energy;
use super::labels::{Labels, gather, scatter};
use super::lanes::{Job, Lanes, dispatch};
use super::likelihood;

/// Layers of a slab: slabs of one parity are worked on at the same time. Products reach from a node to three layers
/// above, so that slabs of one parity touch no common layer.
const SLAB: usize = 4;

/// The smoothness never weighs less than this share, however sharp the wall.
const LEAST_SHARE: f32 = 0.05;

/// Weights of the parts of the objective. Lengths are in units of the smallest voxel spacing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weights {
    /// Of |D³u|².
    pub smoothness: f32,
    /// |D³u|² at which that weight is halved.
    pub crease: f32,
    /// Width of the probit likelihood of a voxel's label.
    pub sigma: f32,
    /// Share of labels that are wrong, whatever the distance.
    pub outliers: f32,
    /// Of (n·∇u − 1)².
    pub gauge: f32,
    /// Finest nodes a smallest spacing, per axis.
    pub scale: [f32; 3],
}

/// What there is to solve: the band, its labels, and which coefficients may change.
pub(super) struct Problem<'a> {
    pub band: &'a Band,
    pub labels: &'a Labels,
    pub weights: Weights,
    /// Coefficients that keep their value; empty where none does.
    pub frozen: &'a [bool],
}

/// The data's part of the quadratic form at an iterate, per label.
#[derive(Debug, Clone, Copy, Default)]
struct Datum {
    /// Second derivative of the likelihood.
    curvature: f32,
    /// Direction of the gauge, times the square root of its weight.
    normal: [f32; 3],
}

/// The quadratic form at an iterate.
struct Quadratic<'a> {
    problem: &'a Problem<'a>,
    terms: [f32; 10],
    data: Vec<Datum>,
    /// Share of the regulariser's weight, per coefficient where its differences start.
    share: &'a [f32],
}

/// Calls `f` on every range of layers of the band with the part of `out` from there to three layers above.
fn slabs(band: &Band, out: &mut [f32], f: impl Fn(std::ops::Range<usize>, &mut [f32], usize) + Sync) {
    let nz = band.nodes.dims[2];
    for parity in 0..2 {
        let mut rest = &mut *out;
        let mut at = 0usize;
        let mut parts = Vec::new();
        let mut z = parity * SLAB;
        while z < nz {
            let first = band.layers[z] as usize;
            let last = band.layers[(z + SLAB + 3).min(nz)] as usize;
            let (_, tail) = std::mem::take(&mut rest).split_at_mut(first - at);
            let (part, tail) = tail.split_at_mut(last - first);
            (rest, at) = (tail, last);
            if !part.is_empty() {
                parts.push((z..(z + SLAB).min(nz), first, part));
            }
            z += 2 * SLAB;
        }
        parts.into_par_iter().for_each(|(z, first, part)| f(z, part, first));
    }
}

fn axpy(a: f32, x: &[f32], y: &mut [f32]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}

impl Quadratic<'_> {
    /// out = H x
    fn apply(&self, x: &[f32], out: &mut [f32]) {
        out.par_chunks_mut(1 << 16).for_each(|c| c.fill(0.0));
        slabs(self.problem.band, out, |layers, part, first| dispatch(Product { form: self, x, layers, part, first }));
    }

    /// Diagonal of H.
    fn diagonal(&self) -> Vec<f32> {
        let mut out = vec![0.0f32; self.problem.band.len()];
        slabs(self.problem.band, &mut out, |layers, part, first| dispatch(Diagonal { form: self, layers, part, first }));
        out
    }

    /// The labels of a cell that say something.
    #[inline(always)]
    fn speaking(&self, c: usize) -> impl Iterator<Item = (usize, Datum)> {
        let data = |l: usize| (l, self.data[l]);
        self.problem.labels.of_cell(c).map(data).filter(|(_, d)| d.curvature != 0.0 || d.normal != [0.0; 3])
    }
}

/// What some layers of the band add to a product with the system's matrix.
struct Product<'a, 'b> {
    form: &'a Quadratic<'b>,
    x: &'a [f32],
    layers: std::ops::Range<usize>,
    part: &'a mut [f32],
    first: usize,
}

impl Job for Product<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Product { form, x, layers, part, first } = self;
        let Problem { band, labels, .. } = *form.problem;
        for chunk in band.chunk_layers[layers.start] as usize..band.chunk_layers[layers.end] as usize {
            energy::product(lanes, band, &form.terms, form.share, x, chunk, part, first);
        }
        for c in labels.moving(&layers) {
            let rows = &labels.cells[c].rows;
            let mut speaking = form.speaking(c).peekable();
            if speaking.peek().is_none() {
                continue;
            }
            let block = gather(lanes, x, rows);
            let mut sum = [lanes.splat(0.0); 4];
            for (l, Datum { curvature, normal: n }) in speaking {
                let taps = labels.taps(l);
                let v = taps.sample(lanes, &block);
                let along = n[0] * v[1] + n[1] * v[2] + n[2] * v[3];
                taps.spread(lanes, &mut sum, curvature * v[0], n.map(|n| n * along));
            }
            scatter(lanes, part, first, rows, sum);
        }
    }
}

/// The same of its diagonal.
struct Diagonal<'a, 'b> {
    form: &'a Quadratic<'b>,
    layers: std::ops::Range<usize>,
    part: &'a mut [f32],
    first: usize,
}

impl Job for Diagonal<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Diagonal { form, layers, part, first } = self;
        let Problem { band, labels, .. } = *form.problem;
        for chunk in band.chunk_layers[layers.start] as usize..band.chunk_layers[layers.end] as usize {
            energy::diagonal(lanes, band, &form.terms, form.share, chunk, part, first);
        }
        for c in labels.moving(&layers) {
            let mut sum = [lanes.splat(0.0); 4];
            for (l, d) in form.speaking(c) {
                labels.taps(l).squares(lanes, &mut sum, d.curvature, d.normal);
            }
            scatter(lanes, part, first, &labels.cells[c].rows, sum);
        }
    }
}

/// What some layers' labels add to a gradient.
struct Spread<'a, F> {
    labels: &'a Labels,
    f: &'a F,
    layers: std::ops::Range<usize>,
    part: &'a mut [f32],
    first: usize,
}

impl<F: Fn(usize) -> (f32, f32, [f32; 3])> Job for Spread<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Spread { labels, f, layers, part, first } = self;
        for c in labels.moving(&layers) {
            let mut sum = [lanes.splat(0.0); 4];
            for l in labels.of_cell(c) {
                let (p, q, n) = f(l);
                labels.taps(l).spread(lanes, &mut sum, p, n.map(|n| n * q));
            }
            scatter(lanes, part, first, &labels.cells[c].rows, sum);
        }
    }
}

fn inner(a: &[f32], b: &[f32]) -> f64 {
    let parts: Vec<f64> = a
        .par_chunks(4096)
        .zip(b.par_chunks(4096))
        .map(|(a, b)| {
            let mut s = [0.0f64; 4];
            let (ca, cb) = (a.chunks_exact(4), b.chunks_exact(4));
            let rest: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(a, b)| *a as f64 * *b as f64).sum();
            for (a, b) in ca.zip(cb) {
                for i in 0..4 {
                    s[i] += a[i] as f64 * b[i] as f64;
                }
            }
            s.iter().sum::<f64>() + rest
        })
        .collect();
    parts.iter().sum()
}

/// How hard to try.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    /// Newton steps at most.
    pub steps: usize,
    /// Width of the likelihood in the first step, halved from step to step.
    pub sigma: f64,
    /// Products of a step at most.
    pub products: usize,
    /// Fall of the preconditioned residual at which a step's equation counts as solved.
    pub tolerance: f64,
    /// Change of a coefficient, in smallest spacings, below which there is no further step.
    pub change: f32,
}

impl<'a> Problem<'a> {
    /// Weights of the squared differences in the objective: those of the integral.
    fn energy(&self) -> [f32; 10] {
        self.terms(self.weights.smoothness * (self.band.nodes.step as f32).powi(3))
    }

    /// Weights of the squared differences; `weight`: of |D³u|² over a cube of a smallest spacing.
    fn terms(&self, weight: f32) -> [f32; 10] {
        let w = &self.weights;
        let step = self.band.nodes.step as f32;
        std::array::from_fn(|t| {
            let (o, m) = TERMS[t];
            weight * m * (0..3).map(|a| (w.scale[a] / step).powi(2 * o[a] as i32)).product::<f32>()
        })
    }

    /// A first guess: half a voxel from the wall next to the other label, a voxel more in the second layer.
    pub fn start(&self, spacing: [f32; 3], effort: Effort) -> (Vec<f32>, usize) {
        let n = self.band.len();
        let labels = &self.labels.labels;
        let aim: Vec<(f32, f32)> = labels
            .par_iter()
            .map(|l| {
                let near = (0..3).filter(|a| l.axes >> a & 1 == 1).map(|a| spacing[a]).fold(f32::INFINITY, f32::min);
                let (d, w) = if near.is_finite() { (0.45 * near, 0.3 * near) } else { (1.2, 0.7) };
                (f32::from(l.sign) * d, 1.0 / (w * w))
            })
            .collect();
        let data = aim.iter().map(|a| Datum { curvature: a.1, normal: [0.0; 3] }).collect();
        let share = vec![1.0; n];
        let h = Quadratic { problem: self, terms: self.energy(), data, share: &share };
        let mut right = vec![0.0f32; n];
        self.spread(&mut right, |l| (aim[l].0 * aim[l].1, 0.0, [0.0; 3]));
        conjugate_gradients(&h, &right, effort)
    }

    /// Adds the effects (p, q, n) of `f(label)` to `out`.
    fn spread(&self, out: &mut [f32], f: impl Fn(usize) -> (f32, f32, [f32; 3]) + Sync) {
        slabs(self.band, out, |layers, part, first| dispatch(Spread { labels: self.labels, f: &f, layers, part, first }));
    }

    /// Newton's method with conjugate gradients inside; returns the number of products with H.
    ///
    /// A label counts as kept where the value lies beyond `margin` on its side of zero.
    pub fn newton(&self, c: &mut [f32], margin: &[f32], effort: Effort) -> usize {
        let (w, labels) = (&self.weights, self.labels);
        let mut products = 0;
        let mut gradient = vec![0.0f32; c.len()];
        let root = w.gauge.sqrt();
        for k in 0..effort.steps {
            let now = labels.sample(c);
            let sigma = (w.sigma as f64).max(effort.sigma * 0.5f64.powi(k as i32));
            let (data, slope): (Vec<Datum>, Vec<f32>) = now
                .par_iter()
                .zip(&labels.labels)
                .enumerate()
                .map(|(i, (v, l))| {
                    let s = f64::from(l.sign);
                    let margin = margin.get(i).map_or(0.0, |&m| f64::from(m));
                    // What the topology needs is no outlier.
                    let outliers = if margin > 0.0 { 0.0 } else { f64::from(w.outliers) };
                    let (slope, curvature) = likelihood::derivatives((s * f64::from(v[0]) - margin) / sigma, outliers);
                    let len = (v[1] * v[1] + v[2] * v[2] + v[3] * v[3]).sqrt();
                    // Unit slope is asked for next to the wall alone.
                    let normal = if len > 0.05 && l.axes != 0 { [v[1], v[2], v[3]].map(|v| root * v / len) } else { [0.0; 3] };
                    (Datum { curvature: (curvature / (sigma * sigma)) as f32, normal }, (s * slope / sigma) as f32)
                })
                .unzip();
            // Gradient of the objective: the regulariser's, the likelihood's slope, and the gauge's aim.
            let share = energy::of_density(self.band, &self.terms(1.0), c, 1.0, |e| (1.0 / (1.0 + e / w.crease)).max(LEAST_SHARE));
            let h = Quadratic { problem: self, terms: self.energy(), data, share: &share };
            let smooth = Quadratic { problem: self, terms: h.terms, data: vec![Datum::default(); h.data.len()], share: &share };
            smooth.apply(c, &mut gradient);
            self.spread(&mut gradient, |l| {
                let (m, v) = (h.data[l].normal, now[l]);
                (slope[l], m[0] * v[1] + m[1] * v[2] + m[2] * v[3] - root, m)
            });
            let (step, k) = conjugate_gradients(&h, &gradient, effort);
            products += k + 1;
            // What counts is the change at the wall; coefficients at the band's rim are hardly determined.
            let big = labels.sample(&step).par_iter().zip(&labels.labels).filter(|(_, l)| l.axes != 0).map(|(v, _)| v[0].abs()).reduce(|| 0.0, f32::max);
            let damp = (0.5 / big.max(1e-9)).min(1.0);
            axpy(-damp, &step, c);
            if sigma == f64::from(w.sigma) && big < effort.change {
                break;
            }
        }
        products
    }
}

/// H⁻¹ g, preconditioned by the diagonal; frozen coefficients do not change.
fn conjugate_gradients(h: &Quadratic, g: &[f32], effort: Effort) -> (Vec<f32>, usize) {
    let n = g.len();
    let mut inverse: Vec<f32> = h.diagonal().into_iter().map(|d| 1.0 / d.max(1e-12)).collect();
    inverse.iter_mut().zip(h.problem.frozen).filter(|(_, f)| **f).for_each(|(d, _)| *d = 0.0);
    let mut x = vec![0.0f32; n];
    let mut r = g.to_vec();
    let mut z: Vec<f32> = r.iter().zip(&inverse).map(|(r, d)| r * d).collect();
    let mut p = z.clone();
    let mut q = vec![0.0f32; n];
    let mut rz = inner(&r, &z);
    let goal = rz * effort.tolerance * effort.tolerance;
    for k in 0..effort.products {
        h.apply(&p, &mut q);
        let curvature = inner(&p, &q);
        if curvature.is_nan() || curvature <= 0.0 {
            return (x, k);
        }
        let alpha = (rz / curvature) as f32;
        x.par_chunks_mut(4096).zip(p.par_chunks(4096)).for_each(|(x, p)| axpy(alpha, p, x));
        r.par_chunks_mut(4096).zip(q.par_chunks(4096)).for_each(|(r, q)| axpy(-alpha, q, r));
        z.par_chunks_mut(4096)
            .zip(r.par_chunks(4096))
            .zip(inverse.par_chunks(4096))
            .for_each(|((z, r), d)| z.iter_mut().zip(r).zip(d).for_each(|((z, r), d)| *z = r * d));
        let next = inner(&r, &z);
        if next <= goal {
            return (x, k + 1);
        }
        let beta = (next / rz) as f32;
        rz = next;
        p.par_chunks_mut(4096).zip(z.par_chunks(4096)).for_each(|(p, z)| p.iter_mut().zip(z).for_each(|(p, z)| *p = z + beta * *p));
    }
    (x, effort.products)
}
