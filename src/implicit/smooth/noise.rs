//! Which of the labels that a fit contradicts are noise.

use std::collections::BTreeMap;

use super::labels::Label;
use super::likelihood;
use super::solve::Weights;

/// Contradicted labels of one side within a voxel of one that noise explains, itself among them.
const FEW: usize = 4;

/// The share of wrong labels, given the fit's values: one step of expectation maximisation.
pub(super) fn share(labels: &[Label], values: &[[f32; 4]], weights: &Weights) -> f32 {
    let (sigma, outliers) = (f64::from(weights.sigma), f64::from(weights.outliers));
    let wrong = |(l, v): (&Label, &[f32; 4])| 1.0 - likelihood::inlier(f64::from(l.sign) * f64::from(v[0]) / sigma, outliers);
    let near = || labels.iter().zip(values).filter(|(l, _)| l.axes != 0);
    let count = near().count().max(1);
    (near().map(wrong).sum::<f64>() / count as f64).clamp(1e-3, 0.25) as f32
}

/// Of the contradicted labels those with more than a few such of their side round them: a part that the fit lacks, not noise.
pub(super) fn crowded(labels: &[Label], contradicted: &[usize]) -> Vec<usize> {
    let side: BTreeMap<[i16; 3], i8> = contradicted.iter().map(|&l| (labels[l].voxel, labels[l].sign)).collect();
    let round = |l: usize| cube(labels[l].voxel, 1).filter(|w| side.get(w) == Some(&labels[l].sign)).count();
    contradicted.iter().copied().filter(|&l| round(l) > FEW).collect()
}

/// The voxels within `reach` of one along each axis, itself among them.
pub(super) fn cube(v: [i16; 3], reach: i16) -> impl Iterator<Item = [i16; 3]> {
    let steps = move || -reach..=reach;
    steps().flat_map(move |k| steps().flat_map(move |j| steps().map(move |i| [v[0] + i, v[1] + j, v[2] + k])))
}
