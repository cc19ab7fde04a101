//! Third differences of the spline's coefficients, whole rows at a time, and what is made of them.

use rayon::prelude::*;

use super::band::{Band, CHUNK, TERMS};
use super::lanes::{Job, Lanes, Line, dispatch};

/// The rows of a chunk's neighbourhood.
type Rows<L> = [<L as Lanes>::Wide; 10];

/// Layers whose differences are taken together.
const LAYERS: usize = 4;

/// Place of row (j, k) of a neighbourhood, j + k ≤ 3: the order of [`TERMS`].
pub(super) const fn slot(j: usize, k: usize) -> usize {
    [0, 4, 7, 9][k] + j
}

/// Δyʲ Δzᵏ of the rows, in place: every row (j, k) becomes the difference of that order at the first row.
#[inline(always)]
fn across<L: Lanes>(l: L, rows: &mut Rows<L>) {
    for k in 0..3 {
        for s in 1..4 - k {
            for j in (s..4 - k).rev() {
                rows[slot(j, k)] = l.sub(rows[slot(j, k)], rows[slot(j - 1, k)]);
            }
        }
    }
    for s in 1..4 {
        for k in (s..4).rev() {
            for j in 0..4 - k {
                rows[slot(j, k)] = l.sub(rows[slot(j, k)], rows[slot(j, k - 1)]);
            }
        }
    }
}

/// The transpose of [`across`].
#[inline(always)]
fn unacross<L: Lanes>(l: L, rows: &mut Rows<L>) {
    for s in (1..4).rev() {
        for k in s..4 {
            for j in 0..4 - k {
                rows[slot(j, k - 1)] = l.sub(rows[slot(j, k - 1)], rows[slot(j, k)]);
            }
        }
    }
    for k in 0..3 {
        for s in (1..4 - k).rev() {
            for j in s..4 - k {
                rows[slot(j - 1, k)] = l.sub(rows[slot(j - 1, k)], rows[slot(j, k)]);
            }
        }
    }
}

/// The differences of all terms that start at the coefficients of a chunk. What is no whole difference is of no meaning.
#[inline(always)]
fn differences<L: Lanes>(l: L, band: &Band, x: &[f32], chunk: usize) -> Rows<L> {
    let mut rows = [l.splat(0.0); 10];
    for (row, &at) in rows.iter_mut().zip(&band.places[chunk]) {
        *row = l.load(line(x, at as usize));
    }
    across(l, &mut rows);
    for (t, row) in rows.iter_mut().enumerate() {
        for _ in 0..TERMS[t].0[0] {
            *row = l.sub(l.next(*row), *row);
        }
    }
    rows
}

/// The line that begins at a place.
#[inline(always)]
fn line(x: &[f32], at: usize) -> &Line {
    x[at..].first_chunk().unwrap_or(&[0.0; 16])
}

/// Adds the rows of a chunk's neighbourhood, 0 behind its own, to `part`, which starts at the place `first`.
#[inline(always)]
fn add<L: Lanes>(l: L, band: &Band, part: &mut [f32], first: usize, chunk: usize, rows: Rows<L>) {
    for (row, &at) in rows.into_iter().zip(&band.places[chunk]) {
        if let Some(to) = part[at as usize - first..].first_chunk_mut() {
            *to = l.store(l.add(l.load(to), row));
        }
    }
}

/// Adds the product of the energy's matrix with `x`, as far as the differences that start in a chunk make it.
///
/// `share` of the `terms`' weights, per place.
#[inline(always)]
pub(super) fn product<L: Lanes>(l: L, band: &Band, terms: &[f32; 10], share: &[f32], x: &[f32], chunk: usize, part: &mut [f32], first: usize) {
    let mut rows = differences(l, band, x, chunk);
    let share = l.load(line(share, band.places[chunk][0] as usize));
    for (t, row) in rows.iter_mut().enumerate() {
        *row = l.keep(l.mul(*row, l.mul(l.splat(terms[t]), share)), band.valid[chunk][t]);
        for _ in 0..TERMS[t].0[0] {
            *row = l.sub(l.previous(*row), *row);
        }
    }
    unacross(l, &mut rows);
    add(l, band, part, first, chunk, rows);
}

/// Adds the matrix's diagonal likewise.
#[inline(always)]
pub(super) fn diagonal<L: Lanes>(l: L, band: &Band, terms: &[f32; 10], share: &[f32], chunk: usize, part: &mut [f32], first: usize) {
    // Squares of the binomials.
    const WEIGHTS: [&[f32]; 4] = [&[1.0], &[1.0, 1.0], &[1.0, 4.0, 1.0], &[1.0, 9.0, 9.0, 1.0]];
    let share = l.load(line(share, band.places[chunk][0] as usize));
    let mut rows = [l.splat(0.0); 10];
    for (t, (o, _)) in TERMS.iter().enumerate() {
        let mut weight = l.keep(l.mul(l.splat(terms[t]), share), band.valid[chunk][t]);
        let mut along = weight;
        for w in &WEIGHTS[o[0]][1..] {
            weight = l.previous(weight);
            along = l.mul_add(l.splat(*w), weight, along);
        }
        for (k, wk) in WEIGHTS[o[2]].iter().enumerate() {
            for (j, wj) in WEIGHTS[o[1]].iter().enumerate() {
                rows[slot(j, k)] = l.mul_add(l.splat(wj * wk), along, rows[slot(j, k)]);
            }
        }
    }
    add(l, band, part, first, chunk, rows);
}

/// What `f` makes of the density of the energy, the squared differences with their weights, at each coefficient where
/// differences start; `idle` at the other places.
pub(super) fn of_density(band: &Band, terms: &[f32; 10], x: &[f32], idle: f32, f: impl Fn(f32) -> f32 + Sync) -> Vec<f32> {
    let mut out = vec![idle; band.len()];
    let mut rest = &mut out[..];
    let mut parts = Vec::new();
    let nz = band.nodes.dims[2];
    for z in (0..nz).step_by(LAYERS) {
        let end = (z + LAYERS).min(nz);
        let (part, tail) = std::mem::take(&mut rest).split_at_mut((band.layers[end] - band.layers[z]) as usize);
        rest = tail;
        parts.push((band.chunk_layers[z] as usize..band.chunk_layers[end] as usize, band.layers[z] as usize, part));
    }
    parts.into_par_iter().for_each(|(chunks, first, part)| dispatch(Density { band, terms, x, f: &f, chunks, first, part }));
    out
}

/// [`of_density`] for some chunks.
struct Density<'a, F> {
    band: &'a Band,
    terms: &'a [f32; 10],
    x: &'a [f32],
    f: &'a F,
    chunks: std::ops::Range<usize>,
    first: usize,
    part: &'a mut [f32],
}

impl<F: Fn(f32) -> f32> Job for Density<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        for chunk in self.chunks {
            let rows = differences(l, self.band, self.x, chunk);
            let mut sum = l.splat(0.0);
            for (t, row) in rows.into_iter().enumerate() {
                let row = l.keep(row, self.band.valid[chunk][t]);
                sum = l.mul_add(l.mul(l.splat(self.terms[t]), row), row, sum);
            }
            let sum = l.store(sum);
            let at = self.band.places[chunk][0] as usize - self.first;
            let len = (self.band.chunks[chunk].len as usize).min(CHUNK);
            self.part[at..at + len].iter_mut().zip(sum).for_each(|(o, s)| *o = (self.f)(s));
        }
    }
}
