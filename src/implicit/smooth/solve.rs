//! The penalised maximum-likelihood problem of the smooth fit, and its Newton solver.

use rayon::prelude::*;

use super::band::{Band, CHUNK, TERMS};
use super::energy::{self, ZERO, difference, differences, keep_valid, slot, unacross, undifference};
use super::labels::{Block, Labels, Taps, dot, gather};
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
        let arch = pulp::Arch::new();
        slabs(self.problem.band, out, |layers, part, first| arch.dispatch(Product { form: self, x, layers, part, first }));
    }

    /// The regulariser's differences that start in a chunk.
    #[inline(always)]
    fn smoothness(&self, x: &[f32], chunk: usize, part: &mut [f32], first: usize) {
        let band = self.problem.band;
        let mut rows = differences(band, x, chunk);
        let share = &self.share[band.places[chunk][0] as usize..][..CHUNK];
        for (t, (line, (orders, _))) in rows.iter_mut().zip(&TERMS).enumerate() {
            for _ in 0..orders[0] {
                difference(line);
            }
            for i in 0..CHUNK {
                line[i] *= self.terms[t] * share[i];
            }
            keep_valid(line, &band.valid[chunk], t);
            for _ in 0..orders[0] {
                undifference(line);
            }
        }
        unacross(&mut rows);
        energy::add(band, part, first, chunk, &rows);
    }

    /// The data of a cell.
    #[inline(always)]
    fn cell(&self, x: &[f32], c: usize, part: &mut [f32], first: usize) {
        let labels = self.problem.labels;
        let rows = &labels.cells[c].rows;
        let mut block = None;
        let mut sum = [0.0f32; 64];
        for l in labels.of_cell(c) {
            let Datum { curvature, normal: n } = &self.data[l];
            if *curvature == 0.0 && *n == [0.0; 3] {
                continue;
            }
            let block = block.get_or_insert_with(|| gather(x, rows));
            let taps = labels.taps(l);
            let along = along(taps, n);
            spread(&mut sum, &taps[0], &along, curvature * dot(&taps[0], block), dot(&along, block));
        }
        if block.is_some() {
            scatter(part, first, rows, &sum);
        }
    }

    /// Diagonal of H.
    fn diagonal(&self) -> Vec<f32> {
        let Problem { band, labels, .. } = *self.problem;
        let binomial: [&[f32]; 4] = [&[1.0], &[1.0, 1.0], &[1.0, 4.0, 1.0], &[1.0, 9.0, 9.0, 1.0]];
        let mut out = vec![0.0f32; band.len()];
        slabs(band, &mut out, |z, part, first| {
            for chunk in band.chunk_layers[z.start] as usize..band.chunk_layers[z.end] as usize {
                let share = &self.share[band.places[chunk][0] as usize..][..CHUNK];
                let mut rows = [ZERO; 10];
                for (t, (o, _)) in TERMS.iter().enumerate() {
                    let mut weight = ZERO;
                    (0..CHUNK).for_each(|i| weight[i] = self.terms[t] * share[i]);
                    keep_valid(&mut weight, &band.valid[chunk], t);
                    let mut line = ZERO;
                    for (k, w) in binomial[o[0]].iter().enumerate() {
                        (0..CHUNK).for_each(|i| line[i + k] += w * weight[i]);
                    }
                    for (k, wk) in binomial[o[2]].iter().enumerate() {
                        for (j, wj) in binomial[o[1]].iter().enumerate() {
                            let w = wj * wk;
                            rows[slot(j, k)].iter_mut().zip(&line).for_each(|(s, v)| *s += w * v);
                        }
                    }
                }
                energy::add(band, part, first, chunk, &rows);
            }
            for c in labels.moving(&z) {
                let mut sum = [0.0f32; 64];
                for l in labels.of_cell(c) {
                    let Datum { curvature, normal: n } = &self.data[l];
                    if *curvature == 0.0 && *n == [0.0; 3] {
                        continue;
                    }
                    let value = &labels.taps(l)[0];
                    let along = along(labels.taps(l), n);
                    for i in 0..64 {
                        sum[i] += curvature * value[i] * value[i] + along[i] * along[i];
                    }
                }
                scatter(part, first, &labels.cells[c].rows, &sum);
            }
        });
        out
    }
}

/// What some layers of the band add to a product with the system's matrix; compiled for several kinds of processor.
struct Product<'a, 'b> {
    form: &'a Quadratic<'b>,
    x: &'a [f32],
    layers: std::ops::Range<usize>,
    part: &'a mut [f32],
    first: usize,
}

impl pulp::WithSimd for Product<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Product { form, x, layers, part, first } = self;
        let Problem { band, labels, .. } = *form.problem;
        for chunk in band.chunk_layers[layers.start] as usize..band.chunk_layers[layers.end] as usize {
            form.smoothness(x, chunk, part, first);
        }
        for c in labels.moving(&layers) {
            form.cell(x, c, part, first);
        }
    }
}

/// Weights of a cell's coefficients for the derivative along `n`.
#[inline(always)]
fn along(taps: &Taps, n: &[f32; 3]) -> Block {
    let mut out = [0.0; 64];
    for i in 0..64 {
        out[i] = n[0] * taps[1][i] + n[1] * taps[2][i] + n[2] * taps[3][i];
    }
    out
}

/// Adds the rows of a cell to `part`, which starts at the coefficient `first`.
#[inline(always)]
fn scatter(part: &mut [f32], first: usize, rows: &[u32; 16], sum: &Block) {
    for (row, &at) in sum.chunks_exact(4).zip(rows) {
        let at = at as usize - first;
        part[at..at + 4].iter_mut().zip(row).for_each(|(o, s)| *o += s);
    }
}

/// Adds the effect of `p` on the value and of `q` on the derivative to the coefficients of a cell.
#[inline(always)]
fn spread(sum: &mut Block, value: &Block, along: &Block, p: f32, q: f32) {
    for i in 0..64 {
        sum[i] += p * value[i] + q * along[i];
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
        let labels = self.labels;
        slabs(self.band, out, |z, part, first| {
            for c in labels.moving(&z) {
                let mut sum = [0.0f32; 64];
                for l in labels.of_cell(c) {
                    let (p, q, n) = f(l);
                    let taps = labels.taps(l);
                    spread(&mut sum, &taps[0], &along(taps, &n), p, q);
                }
                scatter(part, first, &labels.cells[c].rows, &sum);
            }
        });
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
            let share: Vec<f32> = energy::density(self.band, &self.terms(1.0), c).iter().map(|e| (1.0 / (1.0 + e / w.crease)).max(LEAST_SHARE)).collect();
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
