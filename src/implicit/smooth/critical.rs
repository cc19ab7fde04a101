//! Which contradicted labels matter: those without which the digitised fit would have another topology.

use std::collections::BTreeSet;

use super::labels::Label;
use super::noise;
use crate::mask::Mask;
use crate::mask::neighborhood::is_simple;
use crate::mask::noise::support;
use crate::mask::topology::topology_of;

/// Neighbours of its own label (of 26) that a voxel needs to be given up: tips and thin sheets have fewer.
const SUPPORT: u32 = 8;
/// And on a noisy mask voxels of its label within [`ROUND`] voxels (of 343): bumps of a wide part have more, a vessel of two voxels'
/// diameter 28 at most.
const WIDE: usize = 30;
/// Of a bump of two or three voxels on a vessel of some ten, fewer voxels see too little of the vessel.
const ROUND: i64 = 3;

/// Of the labels at `places`, contradicted by `amount` each, those that must be kept, in the same order.
///
/// The others can be flipped one after the other, each a simple point: the digitised fit then differs from the mask by
/// bumps and dents alone. Voxels of thin parts are never given up, simple or not, or twigs would shrink from their tips.
///
/// `leniently`, for noisy masks: a voxel with few neighbours of its label belongs to a thin part only if there are few of them
/// farther round too; neighbours may be flipped together; flipped voxels may touch others in an edge or a corner.
pub(super) fn critical(mask: &Mask, labels: &[Label], places: &[usize], leniently: bool, amount: impl Fn(usize) -> f32) -> Vec<usize> {
    let mut flipped = BTreeSet::new();
    // Lumen voxels of the 3×3×3 block, a bit each; the middle is bit 13.
    let block = |v: [i16; 3], flipped: &BTreeSet<[i16; 3]>| {
        (0..27).fold(0u32, |bits, n| {
            let w = [v[0] + n % 3 - 1, v[1] + n / 3 % 3 - 1, v[2] + n / 9 - 1];
            let lumen = mask.at(w[0].into(), w[1].into(), w[2].into()) != flipped.contains(&w);
            bits | u32::from(lumen) << n
        })
    };
    let thin = |l: &Label| {
        let lumen = (block(l.voxel, &BTreeSet::new()) & !(1 << 13)).count_ones();
        (if l.sign < 0 { lumen } else { 26 - lumen }) < SUPPORT && !(leniently && support(mask, l.voxel.map(i32::from), ROUND) >= WIDE)
    };
    let mut left: Vec<(usize, bool)> = places.iter().map(|&l| (l, thin(&labels[l]))).collect();
    // The worst contradicted first: they are the surest flips.
    left.sort_by(|a, b| amount(b.0).total_cmp(&amount(a.0)).then(a.0.cmp(&b.0)));
    loop {
        let before = left.len();
        left.retain(|&(l, thin)| {
            // Simple whichever of lumen and background counts as connected over edges: what the fit does where two
            // voxels touch in an edge is not known.
            let simple = || {
                let bits = block(labels[l].voxel, &flipped);
                is_simple(bits) && is_simple(!bits & ((1 << 27) - 1))
            };
            let give_up = !thin && simple();
            if give_up {
                flipped.insert(labels[l].voxel);
            }
            !give_up
        });
        if left.len() < before {
            continue;
        }
        // Labels that noise made wrong side by side may be flipped together only.
        let stuck: BTreeSet<[i16; 3]> = left.iter().filter(|k| leniently && !k.1).map(|k| labels[k.0].voxel).collect();
        let group = stuck.iter().map(|v| noise::cube(*v, 1).filter(|w| stuck.contains(w)).collect::<Vec<_>>()).find(|g| g.len() > 1 && together(mask, g, &flipped));
        let Some(group) = group else { break };
        flipped.extend(group);
        left.retain(|k| !flipped.contains(&labels[k.0].voxel));
    }
    let touching = |l: &usize| !leniently && flipped.contains(&labels[*l].voxel) && has_contact(block(labels[*l].voxel, &flipped));
    let mut out: Vec<usize> = left.into_iter().map(|k| k.0).chain(places.iter().copied().filter(touching)).collect();
    out.sort_unstable();
    out
}

/// Whether flipping the voxels of `group`, which lie in a cube of three, changes no component, tunnel or cavity, whichever
/// of lumen and background counts as connected over edges.
fn together(mask: &Mask, group: &[[i16; 3]], flipped: &BTreeSet<[i16; 3]>) -> bool {
    let low: [i16; 3] = std::array::from_fn(|a| group.iter().map(|v| v[a]).min().unwrap_or(0) - 1);
    let dims: [usize; 3] = std::array::from_fn(|a| (group.iter().map(|v| v[a]).max().unwrap_or(0) + 2 - low[a]) as usize);
    let lumen = |with: bool, swap: bool| -> Vec<u8> {
        (0..dims.iter().product())
            .map(|n| {
                let at = [n % dims[0], n / dims[0] % dims[1], n / (dims[0] * dims[1])];
                let v: [i16; 3] = std::array::from_fn(|a| low[a] + at[a] as i16);
                let lumen = mask.at(v[0].into(), v[1].into(), v[2].into()) != flipped.contains(&v);
                u8::from((lumen != (with && group.contains(&v))) != swap)
            })
            .collect()
    };
    [false, true].into_iter().all(|swap| topology_of(&lumen(false, swap), dims) == topology_of(&lumen(true, swap), dims))
}

/// Whether the middle voxel and another of its label touch in an edge or a corner alone: which of the two sides is
/// joined there is not told by the voxels, so that the fit may join either.
fn has_contact(bits: u32) -> bool {
    let at = |d: [i32; 3]| bits >> (13 + d[0] + 3 * d[1] + 9 * d[2]) & 1;
    let here = at([0; 3]);
    (0..27).map(|n| [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1]).any(|d: [i32; 3]| {
        let axes: Vec<usize> = (0..3).filter(|&a| d[a] != 0).collect();
        // Everything between the two voxels is of the other label.
        axes.len() > 1
            && at(d) == here
            && (1..(1 << axes.len()) - 1).all(|m: i32| {
                let mut e = [0; 3];
                for (bit, &a) in axes.iter().enumerate() {
                    e[a] = if m >> bit & 1 == 1 { d[a] } else { 0 };
                }
                at(e) != here
            })
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::Grid;

    /// The labels of `voxels` in a mask of 24³ voxels that are kept on a noisy mask where the fit contradicts them all.
    fn kept(lumen: impl Fn([i64; 3]) -> bool, voxels: &[[i16; 3]]) -> Vec<usize> {
        let grid = Grid::new([24; 3], [1.0; 3], Point::origin(), Matrix3::identity()).expect("grid");
        let data = (0..grid.len()).map(|n| u8::from(lumen(grid.voxel(n).map(|c| c as i64)))).collect();
        let mask = Mask::new(grid, data);
        let label = |v: &[i16; 3]| Label { voxel: *v, sign: if mask.at(v[0].into(), v[1].into(), v[2].into()) { -1 } else { 1 }, phase: 0, axes: 7 };
        let labels: Vec<Label> = voxels.iter().map(label).collect();
        critical(&mask, &labels, &(0..labels.len()).collect::<Vec<_>>(), true, |l| l as f32)
    }

    #[test]
    fn on_a_noisy_mask_a_bump_of_a_wide_vessel_is_given_up_like_a_dent_and_a_twigs_tip_is_kept() {
        let wide = |v: [i64; 3]| (v[1] - 11).pow(2) + (v[2] - 11).pow(2) <= 16;
        // A ball of seven voxels round one at the wall, outside and inside.
        let ball = |v: [i64; 3], y: i64| (v[0] - 12).pow(2) + (v[1] - y).pow(2) + (v[2] - 11).pow(2) <= 1;
        assert!(kept(|v| wide(v) || ball(v, 16), &[[12, 17, 11]]).is_empty());
        assert!(kept(|v| wide(v) && !ball(v, 15), &[[12, 14, 11]]).is_empty());
        let twig = |v: [i64; 3]| v[0] < 14 && (11..13).contains(&v[1]) && (11..13).contains(&v[2]);
        assert_eq!(kept(twig, &[[13, 11, 11]]), [0]);
    }

    #[test]
    fn contacts_over_edges_and_corners_are_seen() {
        let bit = |x: i32, y: i32, z: i32| 1u32 << (13 + x + 3 * y + 9 * z);
        let here = bit(0, 0, 0);
        assert!(has_contact(here | bit(1, 1, 0)));
        assert!(has_contact(here | bit(-1, 1, 1)));
        assert!(!has_contact(here | bit(1, 1, 0) | bit(0, 1, 0)));
        assert!(!has_contact(here | bit(1, 0, 0) | bit(1, 1, 1) | bit(1, 1, 0)));
        // Background in lumen.
        assert!(has_contact(!(here | bit(0, 1, -1)) & ((1 << 27) - 1)));
    }
}
