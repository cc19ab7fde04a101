//! How many of a mask's labels are noise.

use std::collections::BTreeMap;

use super::labels::{Label, Near};
use super::likelihood;
use super::solve::Weights;
use crate::mask::Mask;

/// Of the voxels at the wall that are wrong, the share that five or six of their face neighbours contradict.
const SEEN: f64 = 0.4;
/// Fewer such voxels tell nothing.
const LEAST: usize = 4;
/// A smaller share is none.
const LEAST_SHARE: f64 = 0.004;
/// Voxels of their own label within two voxels (of 125) that such voxels of a thin part have at most.
const WIDE: usize = 28;
/// Contradicted labels of one side within a voxel of one that noise explains, itself among them.
const FEW: usize = 4;

/// The share of the boundary's labels that are wrong: 0 on a mask without noise.
///
/// Told by dents and bumps a voxel wide, with at most one face neighbour of their own label, which a smooth wall hardly ever
/// leaves; the tips of thin vessels and gaps are left out.
pub(super) fn estimate(mask: &Mask, near: &[Near]) -> f64 {
    let odd = near.iter().filter(|n| {
        let v = n.voxel.map(i64::from);
        let here = mask.at(v[0], v[1], v[2]);
        let other = |a: usize, d: i64| {
            let mut w = v;
            w[a] += d;
            mask.at(w[0], w[1], w[2]) != here
        };
        let faces = (0..3).map(|a| usize::from(other(a, -1)) + usize::from(other(a, 1))).sum::<usize>();
        faces >= 5 && support(mask, n.voxel) > WIDE
    });
    let odd = odd.count();
    let share = odd as f64 / (SEEN * near.len().max(1) as f64);
    if odd < LEAST || share < LEAST_SHARE { 0.0 } else { share.min(0.2) }
}

/// Voxels of the same label in the 5×5×5 round a voxel, itself among them.
pub(super) fn support(mask: &Mask, voxel: [i16; 3]) -> usize {
    let at = |v: [i16; 3]| mask.at(v[0].into(), v[1].into(), v[2].into());
    cube(voxel, 2).filter(|&v| at(v) == at(voxel)).count()
}

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
