//! How many of a mask's voxels at its boundary are noise.

use super::Mask;
use super::neighborhood::is_simple;

/// Of the voxels at the wall that are wrong, the share that five or six of their face neighbours contradict.
const SEEN: f64 = 0.4;
/// Fewer such voxels tell nothing.
const LEAST: usize = 4;
/// A smaller share is none.
const LEAST_SHARE: f64 = 0.004;
/// Voxels of their own label within two voxels (of 125) that such voxels of a thin part have at most.
const WIDE: usize = 28;

/// As [`WIDE`], of the 75 voxels of 5×5×5 that lie in the picture round one in its last layer.
const WIDE_AT_BORDER: usize = 17;

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
        faces >= 5 && support(mask, *voxel, 2) > WIDE
    });
    let odd = odd.count();
    let share = odd as f64 / (SEEN * near.len().max(1) as f64);
    if odd < LEAST || share < LEAST_SHARE { 0.0 } else { share.min(0.2) }
}

/// Voxels of the same label within `reach` voxels of one along each axis, itself among them.
pub(crate) fn support(mask: &Mask, voxel: [i32; 3], reach: i64) -> usize {
    let [x, y, z] = voxel.map(i64::from);
    let here = mask.at(x, y, z);
    let span = |c: i64| c - reach..=c + reach;
    let row = |j: i64, k: i64| span(x).filter(|&i| mask.at(i, j, k) == here).count();
    span(z).map(|k| span(y).map(|j| row(j, k)).sum::<usize>()).sum()
}

/// `mask`, whose box is the lumen's, with noise taken off its layers at the picture's border; and the voxels that changed.
///
/// Continued beyond the picture, as [`super::crop_pad`] does, a wrong voxel there is a ridge that no neighbour contradicts. A voxel is
/// flipped where most of the 3×3 in its layer have the other label, and most of the 3×3×2 with the next layer, unless it is of a thin
/// part or the topology would change.
pub(crate) fn quiet_border(mask: &Mask) -> (Mask, Vec<usize>) {
    let mut out = mask.clone();
    let mut changed = Vec::new();
    let last = mask.grid.dims.map(|n| n as i64 - 1);
    for a in 0..3 {
        for end in [0, last[a]].into_iter().filter(|e| mask.image[a].contains(e)) {
            let wrong = (0..mask.data.len()).filter(|&n| {
                let v = mask.grid.voxel(n).map(|c| c as i64);
                let reach = |r: i64, along: i64| [0, 1, 2].map(|b| if a == b { along } else { r });
                let outvoted = |along: i64| {
                    let (own, all) = like(mask, v, reach(1, along));
                    2 * own < all
                };
                v[a] == end && outvoted(0) && outvoted(1) && like(mask, v, reach(2, 2)).0 > WIDE_AT_BORDER
            });
            for n in wrong {
                // What lies beyond the border is as what lies at it.
                let v = mask.grid.voxel(n).map(|c| c as i64);
                let bits = (0..27).fold(0u32, |bits, b| {
                    let w = [0, 1, 2].map(|i| (v[i] + b / 3i64.pow(i as u32) % 3 - 1).clamp(mask.image[i][0], mask.image[i][1]));
                    bits | u32::from(out.at(w[0], w[1], w[2])) << b
                });
                if is_simple(bits) {
                    out.data[n] ^= 1;
                    changed.push(n);
                }
            }
        }
    }
    (out, changed)
}

/// Of the picture's voxels within `reach` of one along each axis: how many have its label, and how many there are.
fn like(mask: &Mask, v: [i64; 3], reach: [i64; 3]) -> (usize, usize) {
    let here = mask.at(v[0], v[1], v[2]);
    let span = |a: usize| (v[a] - reach[a]).max(mask.image[a][0])..=(v[a] + reach[a]).min(mask.image[a][1]);
    let mut found = (0, 0);
    for k in span(2) {
        for j in span(1) {
            for i in span(0) {
                found.0 += usize::from(mask.at(i, j, k) == here);
                found.1 += 1;
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::{Grid, split_components};

    #[test]
    fn noise_of_a_vessel_that_lies_in_the_pictures_border_goes_and_a_thin_branch_there_stays() {
        let grid = Grid::new([40, 24, 12], [1.0; 3], Point::origin(), Matrix3::identity()).expect("grid");
        // A tube along x whose middle lies in the last layer, and a branch one voxel wide in that layer.
        let inside = |[i, j, k]: [usize; 3]| (j as f64 - 12.0).hypot(k as f64 - 11.0) < 6.2 || (i == 20 && k == 11 && j >= 12);
        let exact = Mask::new(grid.clone(), (0..grid.len()).map(|n| u8::from(inside(grid.voxel(n)))).collect());
        let mut noisy = exact.clone();
        for v in [[5, 5, 11], [11, 18, 11], [15, 19, 11], [29, 6, 11]] {
            let n = grid.linear(v[0], v[1], v[2]).expect("a voxel");
            noisy.data[n] ^= 1;
        }
        let parts = split_components(&noisy);
        let (quiet, changed) = quiet_border(&parts[0]);
        assert_eq!(changed.len(), 4);
        let at = |m: &Mask| m.image.map(|i| -i[0]);
        let wanted = crate::mask::crop::window(&exact, at(&quiet), quiet.grid.dims);
        assert_eq!(quiet.data, wanted.data);
        assert_eq!(quiet_border(&quiet).1, Vec::<usize>::new());
    }
}
