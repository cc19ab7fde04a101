//! Statistics that do not depend on the number of threads.

use rayon::prelude::*;
use serde::Serialize;

/// Counts of values in equal bins over [0, 1]; values outside fall into the first or last bin.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Histogram {
    /// Bin `i` of `n` holds [i/n, (i+1)/n).
    pub counts: Vec<u64>,
}

impl Histogram {
    /// Counts `values` in `bins` bins; NaN counts as 1, the worst.
    pub fn of(values: &[f64], bins: usize) -> Histogram {
        let mut counts = vec![0; bins];
        for v in values {
            let v = if v.is_nan() { 1.0 } else { v.clamp(0.0, 1.0) };
            counts[((v * bins as f64) as usize).min(bins - 1)] += 1;
        }
        Histogram { counts }
    }
}

/// Smallest, mean and largest value with the percentiles that tables ask for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Smallest value.
    pub min: f64,
    /// Mean.
    pub mean: f64,
    /// Largest value.
    pub max: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
}

impl Summary {
    /// Of `values`; all zero where there are none.
    pub fn of(values: &[f64]) -> Summary {
        if values.is_empty() {
            return Summary::default();
        }
        let (mut work, mean) = (values.to_vec(), mean(values));
        let mut at = |q: f64| {
            let k = ((work.len() - 1) as f64 * q).round() as usize;
            *work.select_nth_unstable_by(k, f64::total_cmp).1
        };
        Summary { min: at(0.0), mean, max: at(1.0), p50: at(0.5), p95: at(0.95), p99: at(0.99) }
    }
}

/// Sum in fixed blocks: the same bits for any number of threads.
pub fn sum(values: &[f64]) -> f64 {
    let blocks: Vec<f64> = values.par_chunks(4096).map(|c| c.iter().sum()).collect();
    blocks.iter().sum()
}

/// Mean; 0 of nothing.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { sum(values) / values.len() as f64 }
}

/// Indices of the `n` largest values, falling; ties by index; NaN is largest.
pub fn largest(values: &[f64], n: usize) -> Vec<u32> {
    let mut best: Vec<(f64, u32)> = Vec::with_capacity(n + 1);
    let worse = |a: &(f64, u32), b: &(f64, u32)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
    for (i, &v) in values.iter().enumerate() {
        let v = if v.is_nan() { f64::INFINITY } else { v };
        let e = (v, i as u32);
        if best.len() == n && best.last().is_none_or(|l| worse(&e, l).is_ge()) {
            continue;
        }
        let at = best.partition_point(|b| worse(b, &e).is_lt());
        best.insert(at, e);
        best.truncate(n);
    }
    best.into_iter().map(|b| b.1).collect()
}
