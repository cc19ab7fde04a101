//! How many of a mask's voxels at its boundary are noise.

use super::Mask;

/// Of the voxels at the wall that are wrong, the share that five or six of their face neighbours contradict.
const SEEN: f64 = 0.4;
/// Fewer such voxels tell nothing.
const LEAST: usize = 4;
/// A smaller share is none.
const LEAST_SHARE: f64 = 0.004;
/// Voxels of their own label within two voxels (of 125) that such voxels of a thin part have at most.
const WIDE: usize = 28;

/// The share of the boundary's labels that are wrong: 0 on a mask without noise.
///
/// Told by dents and bumps a voxel wide, with at most one face neighbour of their own label, which a smooth wall hardly ever
/// leaves; the tips of thin vessels and gaps are left out.
pub(crate) fn estimate(mask: &Mask, near: &[([i32; 3], u8)]) -> f64 {
    let odd = near.iter().filter(|(voxel, _)| {
        let v = voxel.map(i64::from);
        let here = mask.at(v[0], v[1], v[2]);
        let other = |a: usize, d: i64| {
            let mut w = v;
            w[a] += d;
            mask.at(w[0], w[1], w[2]) != here
        };
        let faces = (0..3).map(|a| usize::from(other(a, -1)) + usize::from(other(a, 1))).sum::<usize>();
        faces >= 5 && support(mask, *voxel) > WIDE
    });
    let odd = odd.count();
    let share = odd as f64 / (SEEN * near.len().max(1) as f64);
    if odd < LEAST || share < LEAST_SHARE { 0.0 } else { share.min(0.2) }
}

/// Voxels of the same label in the 5×5×5 round a voxel, itself among them.
pub(crate) fn support(mask: &Mask, voxel: [i32; 3]) -> usize {
    let [x, y, z] = voxel.map(i64::from);
    let here = mask.at(x, y, z);
    let span = |c: i64| c - 2..=c + 2;
    let row = |j: i64, k: i64| span(x).filter(|&i| mask.at(i, j, k) == here).count();
    span(z).map(|k| span(y).map(|j| row(j, k)).sum::<usize>()).sum()
}
