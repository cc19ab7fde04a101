//! Third differences of the spline's coefficients, whole rows at a time, and the density of the energy made of them.

use rayon::prelude::*;

use super::band::{Band, CHUNK, LINE, TERMS};

/// A row of a neighbourhood.
pub(super) type Line = [f32; LINE];
pub(super) const ZERO: Line = [0.0; LINE];

/// y −= x over whole lines: fixed lengths, so that the compiler unrolls it.
#[inline(always)]
fn subtract(x: &Line, y: &mut Line) {
    for i in 0..LINE {
        y[i] -= x[i];
    }
}

/// The first differences along the line, in place; what is not a whole difference is never used.
#[inline(always)]
pub(super) fn difference(x: &mut Line) {
    for i in 0..LINE - 1 {
        x[i] = x[i + 1] - x[i];
    }
}

/// The transpose of [`difference`] on lines whose last place is 0.
#[inline(always)]
pub(super) fn undifference(x: &mut Line) {
    let old = *x;
    x[0] = -old[0];
    for i in 1..LINE {
        x[i] = old[i - 1] - old[i];
    }
}

/// Place of row (j, k) of a neighbourhood, j + k ≤ 3: the order of [`TERMS`].
pub(super) const fn slot(j: usize, k: usize) -> usize {
    [0, 4, 7, 9][k] + j
}

/// Δyʲ Δzᵏ of the rows, in place: every row (j, k) becomes the difference of that order at the first row.
#[inline(always)]
fn across(rows: &mut [Line; 10]) {
    for k in 0..3 {
        for s in 1..4 - k {
            for j in (s..4 - k).rev() {
                let before = rows[slot(j - 1, k)];
                subtract(&before, &mut rows[slot(j, k)]);
            }
        }
    }
    for s in 1..4 {
        for k in (s..4).rev() {
            for j in 0..4 - k {
                let before = rows[slot(j, k - 1)];
                subtract(&before, &mut rows[slot(j, k)]);
            }
        }
    }
}

/// The transpose of [`across`].
#[inline(always)]
pub(super) fn unacross(rows: &mut [Line; 10]) {
    for s in (1..4).rev() {
        for k in s..4 {
            for j in 0..4 - k {
                let above = rows[slot(j, k)];
                subtract(&above, &mut rows[slot(j, k - 1)]);
            }
        }
    }
    for k in 0..3 {
        for s in (1..4 - k).rev() {
            for j in s..4 - k {
                let above = rows[slot(j, k)];
                subtract(&above, &mut rows[slot(j - 1, k)]);
            }
        }
    }
}

/// Of the coefficients from a chunk on, the differences across the rows. What lies behind the chunk's own is of no meaning.
#[inline(always)]
pub(super) fn differences(band: &Band, x: &[f32], chunk: usize) -> [Line; 10] {
    let mut rows = [ZERO; 10];
    for (line, &at) in rows.iter_mut().zip(&band.places[chunk]) {
        line.copy_from_slice(&x[at as usize..at as usize + LINE]);
    }
    across(&mut rows);
    rows
}

/// Adds the rows of a chunk's neighbourhood, 0 behind its own, to `part`, which starts at the place `first`.
#[inline(always)]
pub(super) fn add(band: &Band, part: &mut [f32], first: usize, chunk: usize, rows: &[Line; 10]) {
    for (line, &at) in rows.iter().zip(&band.places[chunk]) {
        let to = &mut part[at as usize - first..at as usize - first + LINE];
        (0..LINE).for_each(|i| to[i] += line[i]);
    }
}

/// Sets to 0 what is no whole difference of the `term`-th kind.
#[inline(always)]
pub(super) fn keep_valid(line: &mut Line, valid: &[u16; CHUNK], term: usize) {
    for i in 0..CHUNK {
        line[i] *= f32::from(valid[i] >> term & 1);
    }
    line[CHUNK..].fill(0.0);
}

/// The squared differences with their weights, summed at the coefficient where they start.
pub(super) fn density(band: &Band, terms: &[f32; 10], x: &[f32]) -> Vec<f32> {
    let parts: Vec<[f32; CHUNK]> = (0..band.chunks.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|chunk| {
            let mut rows = differences(band, x, chunk);
            let mut out = [0.0f32; CHUNK];
            for (t, (line, (orders, _))) in rows.iter_mut().zip(&TERMS).enumerate() {
                for _ in 0..orders[0] {
                    difference(line);
                }
                keep_valid(line, &band.valid[chunk], t);
                for i in 0..CHUNK {
                    out[i] += terms[t] * line[i] * line[i];
                }
            }
            out
        })
        .collect();
    let mut out = vec![0.0; band.len()];
    for ((r, places), part) in band.chunks.iter().zip(&band.places).zip(parts) {
        out[places[0] as usize..][..r.len as usize].copy_from_slice(&part[..r.len as usize]);
    }
    out
}
