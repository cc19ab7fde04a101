//! Which contradicted labels matter: those without which the digitised fit would have another topology.

use super::labels::Label;
use crate::mask::Mask;
use crate::mask::neighborhood::{gather, is_simple};

/// Neighbours of its own label (of 26) that a voxel needs to be given up: tips and thin sheets have fewer.
const SUPPORT: u32 = 8;

/// Of the labels at `places`, contradicted by `amount` each, those that must be kept, in the same order.
///
/// The others can be flipped one after the other, each a simple point: the digitised fit then differs from the mask by
/// bumps and dents alone. Voxels of thin parts are never given up, simple or not, or twigs would shrink from their tips.
pub(super) fn critical(mask: &Mask, labels: &[Label], places: &[usize], amount: impl Fn(usize) -> f32) -> Vec<usize> {
    if places.is_empty() {
        return Vec::new();
    }
    // Two layers all round: labels reach one voxel beyond the array, their neighbours two.
    let [nx, ny, nz] = mask.grid.dims;
    let size = [nx + 6, ny + 6, nz + 6];
    let mut data = vec![0u8; size.iter().product()];
    for (r, row) in mask.data.chunks(nx).enumerate() {
        let at = 3 + size[0] * (r % ny + 3 + size[1] * (r / ny + 3));
        data[at..at + nx].iter_mut().zip(row).for_each(|(d, v)| *d = u8::from(*v != 0));
    }
    let at = |l: &Label| {
        let v = l.voxel.map(|v| (v + 3) as usize);
        v[0] + size[0] * (v[1] + size[1] * v[2])
    };
    let mut left: Vec<usize> = places.to_vec();
    // The worst contradicted first: they are the surest flips.
    left.sort_by(|&a, &b| amount(b).total_cmp(&amount(a)).then(a.cmp(&b)));
    let thin: Vec<bool> = left
        .iter()
        .map(|&l| {
            let bits = gather(&data, size, at(&labels[l]), |v| v != 0) & !(1 << 13);
            let lumen = bits.count_ones();
            let own = if labels[l].sign < 0 { lumen } else { 26 - lumen };
            own < SUPPORT
        })
        .collect();
    let mut kept: Vec<(usize, bool)> = left.into_iter().zip(thin).collect();
    loop {
        let before = kept.len();
        kept.retain(|&(l, thin)| {
            let n = at(&labels[l]);
            // Simple whichever of lumen and background counts as connected over edges: what the fit does at a contact
            // of two voxels is not known.
            let simple = || is_simple(gather(&data, size, n, |v| v != 0)) && is_simple(gather(&data, size, n, |v| v == 0));
            if thin || !simple() {
                return true;
            }
            data[n] ^= 1;
            false
        });
        if kept.len() == before {
            break;
        }
    }
    let mut out: Vec<usize> = kept.into_iter().map(|k| k.0).collect();
    out.sort_unstable();
    out
}
