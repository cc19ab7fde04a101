//! Voxels that touch at an edge or a corner only: where they are left, the lumen has no 2-manifold boundary.
//!
//! A mask without such contacts is well-composed (Latecki 1997): 6- and 26-connectivity agree and the boundary of the
//! voxels is a 2-manifold.

use rayon::prelude::*;

use super::neighborhood::{face_neighbors, gather, is_simple};
use super::workspace::Workspace;

/// For each pattern of a 2×2×2 block (bit dx + 2dy + 4dz): the voxels a contact passes between, 0 where there is none.
fn contacts() -> [u8; 256] {
    std::array::from_fn(|code| {
        let code = code as u8;
        let mut open = 0u8;
        for a in 0..8u8 {
            for axis in 0..3 {
                // The square of the block that holds voxel `a` and is square to `axis`; `b` lies across it.
                let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
                let b = a ^ u ^ v;
                let (object, other) = (1 << a | 1 << b, 1 << (a ^ u) | 1 << (a ^ v));
                if code & (object | other) == object {
                    open |= other;
                }
            }
            let pair = 1 << a | 1 << (7 - a);
            if code == pair || code == !pair {
                open |= !code;
            }
        }
        open
    })
}

fn code_of(data: &[u8], dims: [usize; 3], n: usize) -> u8 {
    let (row, slab) = (dims[0], dims[0] * dims[1]);
    let at = |m: usize| data[m] & 1;
    at(n)
        | at(n + 1) << 1
        | at(n + row) << 2
        | at(n + row + 1) << 3
        | at(n + slab) << 4
        | at(n + slab + 1) << 5
        | at(n + slab + row) << 6
        | at(n + slab + row + 1) << 7
}

fn corner(dims: [usize; 3], n: usize, bit: usize) -> usize {
    n + (bit & 1) + (bit >> 1 & 1) * dims[0] + (bit >> 2) * dims[0] * dims[1]
}

/// First voxels of all 2×2×2 blocks with a contact, in scan order.
fn find(work: &Workspace, table: &[u8; 256]) -> Vec<usize> {
    let [nx, ny, nz] = work.dims;
    (0..nz - 1)
        .into_par_iter()
        .flat_map_iter(|k| {
            let mut found = Vec::new();
            for j in 0..ny - 1 {
                let first = (k * ny + j) * nx;
                let rows = [first, first + nx, first + nx * ny, first + nx * ny + nx].map(|r| &work.data[r..r + nx]);
                let mut code = 0u8;
                for x in 0..nx {
                    // The block's right column becomes its left one.
                    code = code >> 1 & 0b0101_0101;
                    for (b, r) in rows.iter().enumerate() {
                        code |= (r[x] & 1) << (2 * b + 1);
                    }
                    if x > 0 && table[code as usize] != 0 {
                        found.push(first + x - 1);
                    }
                }
            }
            found
        })
        .collect()
}

/// How many contacts there are, counted by 2×2×2 blocks.
pub(super) fn count(work: &Workspace) -> usize {
    find(work, &contacts()).len()
}

/// Voxels flipped by [`resolve`].
#[derive(Debug, Default)]
pub(super) struct Flips {
    pub(super) filled: Vec<usize>,
    pub(super) removed: Vec<usize>,
}

/// Passes in which voxels may also be taken away; after them only filling is allowed, which must end.
const PASSES_WITH_REMOVAL: usize = 3;

/// Flips single voxels until no contact is left.
///
/// A background voxel between the touching ones is filled; where every such filling would change the topology, and taking one
/// of the touching voxels away would not, that is done instead. In a noisy mask both are often possible: there the voxels
/// round about decide, so that noise shifts the wall neither way, save where the lumen is thin. Among several of a kind the
/// one that undoes the most contacts wins, then the one with the most lumen round it, then the first in scan order.
pub(super) fn resolve(work: &mut Workspace, noisy: bool) -> Flips {
    let table = contacts();
    let mut flips = Flips::default();
    for pass in 0.. {
        let blocks = find(work, &table);
        if blocks.is_empty() {
            return flips;
        }
        let mut progress = false;
        for n in blocks {
            // A block has eight voxels: more flips would undo earlier ones.
            for _ in 0..8 {
                let Some(v) = best_flip(work, &table, n, pass < PASSES_WITH_REMOVAL, noisy) else { break };
                progress = true;
                work.data[v] ^= 1;
                if work.data[v] != 0 { flips.filled.push(v) } else { flips.removed.push(v) }
            }
        }
        if !progress {
            // Only contacts between voxels that must not be filled (outside the picture) could be left.
            return flips;
        }
    }
    flips
}

/// Lumen voxels of the 5×5×5 round one at which it belongs to no thin part.
const THIN: usize = 32;

/// The voxel to flip at a block with a contact; `None` where there is no contact (any more).
fn best_flip(work: &Workspace, table: &[u8; 256], n: usize, may_remove: bool, noisy: bool) -> Option<usize> {
    let code = code_of(&work.data, work.dims, n);
    let open = table[code as usize];
    if open == 0 {
        return None;
    }
    let score = |bit: usize| {
        let v = corner(work.dims, n, bit);
        let bits = gather(&work.data, work.dims, v, |c| c != 0);
        let fill = code >> bit & 1 == 0;
        let gain = contacts_round(bits & !(1 << 13) | u32::from(!fill) << 13, table) - contacts_round(bits & !(1 << 13) | u32::from(fill) << 13, table);
        let key = (is_simple(bits), fill, gain, face_neighbors(bits), std::cmp::Reverse(v));
        (key, v)
    };
    let fills = (0..8).filter(|b| open >> b & 1 != 0 && work.may_fill(corner(work.dims, n, *b)));
    let removals = (0..8).filter(|b| may_remove && code >> b & 1 != 0 && touches(code, *b));
    let fill = fills.map(score).max();
    let removal = removals.map(score).filter(|(key, _)| key.0 && key.2 > 0).max();
    match (fill, removal) {
        // Both keep the topology: what more of the voxels round about say, save where the lumen is thin.
        (Some((key, v)), Some((_, w))) if key.0 && noisy => {
            let ([for_fill, _], [lumen, all]) = (about(work, v), about(work, w));
            Some(if lumen >= THIN && all - lumen > for_fill { w } else { v })
        }
        (Some((key, v)), _) if key.0 => Some(v),
        _ => removal.or(fill).map(|(_, v)| v),
    }
}

/// Lumen voxels, and all, of the 5×5×5 voxels round one, as far as the array goes.
fn about(work: &Workspace, n: usize) -> [usize; 2] {
    let [nx, ny, nz] = work.dims;
    let span = |c: usize, size: usize| c.saturating_sub(2)..(c + 3).min(size);
    let mut count = [0; 2];
    for k in span(n / (nx * ny), nz) {
        for j in span(n / nx % ny, ny) {
            let row = nx * (j + ny * k);
            for &v in &work.data[row..][span(n % nx, nx)] {
                count[0] += usize::from(v & 1);
                count[1] += 1;
            }
        }
    }
    count
}

/// Whether a lumen voxel of a block is one of those that touch.
fn touches(code: u8, a: usize) -> bool {
    let set = |b: usize| code >> b & 1 != 0;
    let edge = (0..3).any(|axis| {
        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        set(a ^ u ^ v) && !set(a ^ u) && !set(a ^ v)
    });
    edge || code == 1 << a | 1 << (7 - a)
}

/// Number of the eight blocks round the middle of a neighbourhood that hold a contact.
fn contacts_round(bits: u32, table: &[u8; 256]) -> i32 {
    let mut sum = 0;
    for corner in [0, 1, 3, 4, 9, 10, 12, 13] {
        let b = bits >> corner;
        let code = (b & 3) | (b >> 3 & 3) << 2 | (b >> 9 & 3) << 4 | (b >> 12 & 3) << 6;
        sum += i32::from(table[code as usize] != 0);
    }
    sum
}
