//! The penalised maximum-likelihood problem of the smooth fit, and its Newton solver.

use rayon::prelude::*;

use super::band::{Band, CHUNK, Run, TERMS};

/// Layers of a slab: slabs of one parity are worked on at the same time. Products reach from one layer below a
/// node to three above, so that slabs of one parity touch no common layer.
const SLAB: usize = 8;
const S: [f32; 3] = [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0];
const D: [f32; 3] = [-0.5, 0.0, 0.5];
const DIFF: [&[f32]; 4] = [&[1.0], &[-1.0, 1.0], &[1.0, -2.0, 1.0], &[-1.0, 3.0, -3.0, 1.0]];

/// Weights of the parts of the objective. Lengths are in units of the smallest node spacing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weights {
    /// Of |D³u|².
    pub smoothness: f32,
    /// Width of the probit likelihood of a voxel's label.
    pub sigma: f32,
    /// Of (n·∇u − 1)².
    pub gauge: f32,
    /// Smallest spacing over each axis' spacing.
    pub scale: [f32; 3],
}

/// Value and gradient of the spline at every node.
pub(super) struct Sampled {
    pub value: Vec<f32>,
    pub gradient: Vec<[f32; 3]>,
}

/// The quadratic form at an iterate: `curvature` of the likelihood and direction `normal` of the gauge, per node.
struct Quadratic<'a> {
    band: &'a Band,
    weights: Weights,
    terms: [f32; 10],
    curvature: Vec<f32>,
    normal: Vec<[f32; 3]>,
}

/// A row of a neighbourhood: [`CHUNK`](super::band::CHUNK) nodes and four more.
type Line = [f32; CHUNK + 4];
const ZERO: Line = [0.0; CHUNK + 4];

/// Calls `f` on every chunk of the band with the part of `out` from one layer below to three above its slab.
fn slabs(band: &Band, out: &mut [f32], f: impl Fn(&Run, &mut [f32], usize) + Sync) {
    let nz = band.dims[2];
    for parity in 0..2 {
        let mut rest = &mut *out;
        let mut at = 0usize;
        let mut parts = Vec::new();
        let mut z = parity * SLAB;
        while z < nz {
            let first = band.layers[z.saturating_sub(1)] as usize;
            let last = band.layers[(z + SLAB + 3).min(nz)] as usize;
            let (_, tail) = std::mem::take(&mut rest).split_at_mut(first - at);
            let (part, tail) = tail.split_at_mut(last - first);
            (rest, at) = (tail, last);
            parts.push((z, first, part));
            z += 2 * SLAB;
        }
        parts.into_par_iter().for_each(|(z, first, part)| {
            for r in &band.chunks[band.chunk_layers[z] as usize..band.chunk_layers[(z + SLAB).min(nz)] as usize] {
                f(r, part, first);
            }
        });
    }
}

fn axpy(a: f32, x: &[f32], y: &mut [f32]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}

/// y += a·x over whole lines: fixed lengths, so that the compiler unrolls it.
#[inline(always)]
fn add_line(a: f32, x: &Line, y: &mut Line) {
    for i in 0..CHUNK + 4 {
        y[i] += a * x[i];
    }
}

/// Σ taps[t]·x[i+t] for the first [`CHUNK`] places; the rest is 0.
#[inline(always)]
fn filter(taps: &[f32], x: &Line) -> Line {
    let mut out = ZERO;
    for (t, &w) in taps.iter().enumerate() {
        for i in 0..CHUNK {
            out[i] += w * x[i + t];
        }
    }
    out
}

/// The transpose of [`filter`], added to `out`.
#[inline(always)]
fn unfilter(taps: &[f32], x: &Line, out: &mut Line) {
    for (t, &w) in taps.iter().enumerate() {
        for i in 0..CHUNK {
            out[i + t] += w * x[i];
        }
    }
}

impl Quadratic<'_> {
    /// out = H x
    fn apply(&self, x: &[f32], out: &mut [f32]) {
        out.par_chunks_mut(1 << 16).for_each(|c| c.fill(0.0));
        let band = self.band;
        slabs(band, out, |r, part, first| {
            let (n, at) = (r.len as usize, r.start as usize);
            // Rows y..y+3, z..z+3 with i + j ≤ 3, from x on.
            let mut rows = [ZERO; 16];
            for k in 0..4usize {
                for j in 0..4 - k {
                    band.fetch(x, r.y + j as i32, r.z + k as i32, r.x, &mut rows[j + 4 * k][..n + 3]);
                }
            }
            let mut sums = [ZERO; 16];
            for (t, (o, _)) in TERMS.iter().enumerate() {
                let mut line = ZERO;
                for (k, &wk) in DIFF[o[2]].iter().enumerate() {
                    for (j, &wj) in DIFF[o[1]].iter().enumerate() {
                        add_line(wj * wk, &rows[j + 4 * k], &mut line);
                    }
                }
                let mut d = filter(DIFF[o[0]], &line);
                let mut weight = ZERO;
                for (w, valid) in weight.iter_mut().zip(&band.valid[at..at + n]) {
                    *w = (valid >> t & 1) as f32 * self.terms[t];
                }
                for i in 0..CHUNK {
                    d[i] *= weight[i];
                }
                line = ZERO;
                unfilter(DIFF[o[0]], &d, &mut line);
                for (k, &wk) in DIFF[o[2]].iter().enumerate() {
                    for (j, &wj) in DIFF[o[1]].iter().enumerate() {
                        add_line(wj * wk, &line, &mut sums[j + 4 * k]);
                    }
                }
            }
            for k in 0..4usize {
                for j in 0..4 - k {
                    band.add(part, first, r.y + j as i32, r.z + k as i32, r.x, &sums[j + 4 * k][..n + 3]);
                }
            }
            if band.sign[at..at + n].iter().all(|&c| c == 0) {
                return;
            }
            let [v, gx, gy, gz] = sample_chunk(band, x, r, &self.weights);
            let (mut p, mut q) = (ZERO, [ZERO; 3]);
            for i in 0..n {
                p[i] = self.curvature[at + i] * v[i];
                let m = self.normal[at + i];
                let d = self.weights.gauge * (m[0] * gx[i] + m[1] * gy[i] + m[2] * gz[i]);
                for a in 0..3 {
                    q[a][i] = d * m[a];
                }
            }
            spread_chunk(band, r, &self.weights, &p, &q, part, first);
        });
    }

    /// Diagonal of H where every difference is in the band, plus that of the data.
    fn diagonal(&self) -> Vec<f32> {
        let band = self.band;
        let mut out = vec![0.0f32; band.len()];
        slabs(band, &mut out, |r, part, first| {
            let (n, at) = (r.len as usize, r.start as usize);
            for (t, (o, _)) in TERMS.iter().enumerate() {
                let bit = 1u16 << t;
                let mut line = vec![0.0f32; n + 4];
                for (i, valid) in band.valid[at..at + n].iter().enumerate() {
                    if valid & bit != 0 {
                        for (k, w) in DIFF[o[0]].iter().enumerate() {
                            line[i + k] += self.terms[t] * w * w;
                        }
                    }
                }
                for (k, &wk) in DIFF[o[2]].iter().enumerate() {
                    for (j, &wj) in DIFF[o[1]].iter().enumerate() {
                        let f = wj * wj * wk * wk;
                        let scaled: Vec<f32> = line.iter().map(|v| v * f).collect();
                        band.add(part, first, r.y + j as i32, r.z + k as i32, r.x, &scaled);
                    }
                }
            }
            // S² of the likelihood, and the gauge counted as isotropic.
            let mut line = vec![0.0f32; n + 2];
            let mut gauge = vec![0.0f32; n + 2];
            for i in 0..n {
                for k in 0..3 {
                    line[i + k] += self.curvature[at + i] * S[k] * S[k];
                    let m = self.normal[at + i];
                    gauge[i + k] += self.weights.gauge * (m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) * 0.1;
                }
            }
            for k in 0..3 {
                for j in 0..3 {
                    let f = S[j] * S[j] * S[k] * S[k];
                    let scaled: Vec<f32> = line.iter().zip(&gauge).map(|(v, g)| v * f + g * f).collect();
                    band.add(part, first, r.y + j as i32 - 1, r.z + k as i32 - 1, r.x - 1, &scaled);
                }
            }
        });
        out
    }
}

/// Value and the three derivatives along a chunk.
fn sample_chunk(band: &Band, x: &[f32], r: &Run, w: &Weights) -> [Line; 4] {
    let n = r.len as usize;
    let (mut ss, mut ds, mut sd) = (ZERO, ZERO, ZERO);
    for k in 0..3usize {
        for j in 0..3usize {
            let mut row = ZERO;
            band.fetch(x, r.y + j as i32 - 1, r.z + k as i32 - 1, r.x - 1, &mut row[..n + 2]);
            add_line(S[j] * S[k], &row, &mut ss);
            add_line(D[j] * S[k] * w.scale[1], &row, &mut ds);
            add_line(S[j] * D[k] * w.scale[2], &row, &mut sd);
        }
    }
    let along = D.map(|d| d * w.scale[0]);
    [filter(&S, &ss), filter(&along, &ss), filter(&S, &ds), filter(&S, &sd)]
}

/// The transpose of [`sample_chunk`]: adds the effect of `p` (values) and `q` (derivatives) to `part`.
fn spread_chunk(band: &Band, r: &Run, w: &Weights, p: &Line, q: &[Line; 3], part: &mut [f32], first: usize) {
    let n = r.len as usize;
    let (mut ss, mut ds, mut sd) = (ZERO, ZERO, ZERO);
    unfilter(&S, p, &mut ss);
    unfilter(&D.map(|d| d * w.scale[0]), &q[0], &mut ss);
    unfilter(&S, &q[1], &mut ds);
    unfilter(&S, &q[2], &mut sd);
    for k in 0..3usize {
        for j in 0..3usize {
            let mut line = ZERO;
            add_line(S[j] * S[k], &ss, &mut line);
            add_line(D[j] * S[k] * w.scale[1], &ds, &mut line);
            add_line(S[j] * D[k] * w.scale[2], &sd, &mut line);
            band.add(part, first, r.y + j as i32 - 1, r.z + k as i32 - 1, r.x - 1, &line[..n + 2]);
        }
    }
}

/// Value and gradient (per smallest spacing) of the spline at all nodes.
pub(super) fn sample(band: &Band, c: &[f32], w: &Weights) -> Sampled {
    let parts: Vec<[Line; 4]> = band.chunks.par_iter().map(|r| sample_chunk(band, c, r, w)).collect();
    let mut out = Sampled { value: Vec::with_capacity(c.len()), gradient: Vec::with_capacity(c.len()) };
    for ([v, x, y, z], r) in parts.iter().zip(&band.chunks) {
        let n = r.len as usize;
        out.gradient.extend((0..n).map(|i| [x[i], y[i], z[i]]));
        out.value.extend(&v[..n]);
    }
    out
}

/// φ(z)/Φ(z): minus the derivative of −ln Φ. Exact to 1e-6 for all z.
fn hazard(z: f64) -> f64 {
    if z > 8.0 {
        return 0.0;
    }
    if z < -4.0 {
        // Continued fraction of Mills' ratio.
        let x = -z;
        return x + 1.0 / (x + 2.0 / (x + 3.0 / (x + 4.0 / (x + 5.0 / (x + 6.0 / x)))));
    }
    // Abramowitz and Stegun 26.2.17.
    let phi = (-0.5 * z * z).exp() * 0.398_942_280_401_432_7;
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let tail = phi * t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    phi / if z > 0.0 { 1.0 - tail } else { tail }
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    let parts: Vec<f64> = a
        .par_chunks(4096)
        .zip(b.par_chunks(4096))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| *a as f64 * *b as f64).sum::<f64>())
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
}

/// Newton's method with conjugate gradients inside; returns the number of products with H.
///
/// A label counts as kept where the value lies beyond `margin` on its side of zero.
pub(super) fn newton(band: &Band, c: &mut [f32], w: &Weights, margin: &[f32], effort: Effort) -> usize {
    let terms: [f32; 10] = std::array::from_fn(|t| {
        let (o, m) = TERMS[t];
        w.smoothness * m * (0..3).map(|a| w.scale[a].powi(2 * o[a] as i32)).product::<f32>()
    });
    let mut products = 0;
    let n = band.len();
    let mut gradient = vec![0.0f32; n];
    for k in 0..effort.steps {
        let now = sample(band, c, w);
        let sigma = (w.sigma as f64).max(effort.sigma * 0.5f64.powi(k as i32));
        let mut slope = vec![0.0f32; n];
        let mut curvature = vec![0.0f32; n];
        let mut normal = vec![[0.0f32; 3]; n];
        for i in (0..n).filter(|&i| band.sign[i] != 0) {
            let s = band.sign[i] as f64;
            let z = (s * now.value[i] as f64 - margin[i] as f64) / sigma;
            let r = hazard(z);
            slope[i] = (-s * r / sigma) as f32;
            curvature[i] = (r * (z + r) / (sigma * sigma)) as f32;
            let g = now.gradient[i];
            let len = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
            if len > 0.05 {
                normal[i] = g.map(|v| v / len);
            }
        }
        let h = Quadratic { band, weights: *w, terms, curvature, normal };
        // Gradient of the objective: H c with the likelihood's part replaced by its slope, and the gauge's aim.
        let smooth = Quadratic { band, weights: *w, terms, curvature: vec![0.0; n], normal: vec![[0.0; 3]; n] };
        smooth.apply(c, &mut gradient);
        slabs(band, &mut gradient, |r, part, first| {
            let (at, n) = (r.start as usize, r.len as usize);
            let (mut p, mut q) = (ZERO, [ZERO; 3]);
            for i in 0..n {
                let (m, g) = (h.normal[at + i], now.gradient[at + i]);
                let d = w.gauge * (m[0] * g[0] + m[1] * g[1] + m[2] * g[2] - 1.0);
                p[i] = slope[at + i];
                for a in 0..3 {
                    q[a][i] = d * m[a];
                }
            }
            spread_chunk(band, r, w, &p, &q, part, first);
        });
        let (step, k) = conjugate_gradients(&h, &gradient, effort);
        products += k + 1;
        let big = step.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let damp = (1.0 / big.max(1e-9)).min(1.0);
        axpy(-damp, &step, c);
        if sigma == w.sigma as f64 && big < 0.03 {
            break;
        }
    }
    products
}

/// H⁻¹ g, preconditioned by the diagonal.
fn conjugate_gradients(h: &Quadratic, g: &[f32], effort: Effort) -> (Vec<f32>, usize) {
    let n = g.len();
    let inverse: Vec<f32> = h.diagonal().into_iter().map(|d| 1.0 / d.max(1e-12)).collect();
    let mut x = vec![0.0f32; n];
    let mut r = g.to_vec();
    let mut z: Vec<f32> = r.iter().zip(&inverse).map(|(r, d)| r * d).collect();
    let mut p = z.clone();
    let mut q = vec![0.0f32; n];
    let mut rz = dot(&r, &z);
    let goal = rz * effort.tolerance * effort.tolerance;
    for k in 0..effort.products {
        h.apply(&p, &mut q);
        let curvature = dot(&p, &q);
        if curvature.is_nan() || curvature <= 0.0 {
            return (x, k);
        }
        let alpha = (rz / curvature) as f32;
        x.par_chunks_mut(4096).zip(p.par_chunks(4096)).for_each(|(x, p)| axpy(alpha, p, x));
        r.par_chunks_mut(4096).zip(q.par_chunks(4096)).for_each(|(r, q)| axpy(-alpha, q, r));
        z.par_iter_mut().zip(&r).zip(&inverse).for_each(|((z, r), d)| *z = r * d);
        let next = dot(&r, &z);
        if next <= goal {
            return (x, k + 1);
        }
        let beta = (next / rz) as f32;
        rz = next;
        p.par_iter_mut().zip(&z).for_each(|(p, z)| *p = z + beta * *p);
    }
    (x, effort.products)
}
