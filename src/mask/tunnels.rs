//! Closing noise-sized tunnels at their narrowest place.
//!
//! The lumen is dilated by the 3×3×3 cube, which closes every gap of one or two voxels, and then thinned back without
//! changing its topology, farthest voxels first. What cannot be taken away spans the tunnels that the dilation closed,
//! at their narrowest place (the topological hull of Aktouf, Bertrand and Perroton 2002, bounded to two voxels), or
//! bridges a gap between neighbouring vessels; the Euler characteristic tells one from the other. A gap between two
//! vessels that leads to the outside all along leaves nothing behind, so neighbouring vessels stay apart.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rayon::prelude::*;

use super::components::{Connectivity, label_data};
use super::neighborhood::{STEPS_6, face_neighbors, gather, is_simple};
use super::topology::euler_of;
use super::workspace::Workspace;

/// Voxels that dilation added hold this plus the rank of their distance to the lumen.
const BAND: u8 = 2;

/// Closes tunnels and returns the voxels filled for each.
///
/// A tunnel is closed where its narrowest section is at most two voxels wide and has at most `max_hole` voxels.
pub(super) fn close(work: &mut Workspace, spacing: [f64; 3], max_hole: usize) -> Vec<Vec<usize>> {
    let spans = hull(work, spacing);
    let mut closed: Vec<Vec<usize>> = Vec::new();
    for span in spans {
        if span.len() <= max_hole && euler_change(work, &span) > 0 {
            span.iter().for_each(|&n| work.data[n] = 1);
            closed.push(span);
        }
    }
    reopen_cavities(work, &mut closed);
    for span in &mut closed {
        fill_pits(work, span, max_hole);
    }
    closed
}

/// 26-connected sets of voxels that thinning the dilated lumen leaves behind, in scan order.
fn hull(work: &mut Workspace, spacing: [f64; 3]) -> Vec<Vec<usize>> {
    let dims = work.dims;
    let grown = super::morphology::dilate(&work.data, dims);
    let band: Vec<usize> = (0..grown.len()).filter(|&n| grown[n] != 0 && work.data[n] == 0 && work.may_fill(n)).collect();
    drop(grown);
    let rank = ranks(spacing);
    // Farthest from the lumen first, then in scan order.
    let ranked: Vec<u8> = band.par_iter().map(|&n| BAND + farthest(gather(&work.data, dims, n, |c| c != 0), &rank)).collect();
    band.iter().zip(&ranked).for_each(|(&n, &r)| work.data[n] = r);
    let mut heap: BinaryHeap<(u8, Reverse<usize>)> = band.iter().zip(&ranked).map(|(&n, &r)| (r, Reverse(n))).collect();
    while let Some((_, Reverse(n))) = heap.pop() {
        if work.data[n] < BAND || !is_simple(gather(&work.data, dims, n, |c| c != 0)) {
            continue;
        }
        work.data[n] = 0;
        heap.extend(neighbors_26(dims, n).filter(|&m| work.data[m] >= BAND).map(|m| (work.data[m], Reverse(m))));
    }
    let mut spans = Vec::new();
    for &n in &band {
        if work.data[n] < BAND {
            continue;
        }
        let mut span = vec![n];
        work.data[n] = 0;
        let mut at = 0;
        while at < span.len() {
            for m in neighbors_26(dims, span[at]) {
                if work.data[m] >= BAND {
                    work.data[m] = 0;
                    span.push(m);
                }
            }
            at += 1;
        }
        span.sort_unstable();
        spans.push(span);
    }
    spans
}

fn neighbors_26(dims: [usize; 3], n: usize) -> impl Iterator<Item = usize> {
    let (row, slab) = (dims[0], dims[0] * dims[1]);
    [n - slab, n, n + slab].into_iter().flat_map(move |k| [k - row, k, k + row]).flat_map(|j| j - 1..=j + 1).filter(move |&m| m != n)
}

/// For each of the 27 steps, the rank of its length in mm among all of them.
fn ranks(spacing: [f64; 3]) -> [u8; 27] {
    let length: [f64; 27] = std::array::from_fn(|n| {
        let step = [n % 3, n / 3 % 3, n / 9];
        (0..3).map(|a| if step[a] == 1 { 0.0 } else { spacing[a] * spacing[a] }).sum()
    });
    std::array::from_fn(|n| length.iter().filter(|l| **l < length[n]).count() as u8)
}

/// Rank of the distance to the nearest object voxel of a neighbourhood.
fn farthest(bits: u32, rank: &[u8; 27]) -> u8 {
    (0..27).filter(|n| bits >> n & 1 != 0).map(|n| rank[n]).min().unwrap_or(27)
}

/// Change of the Euler characteristic when voxels are added.
fn euler_change(work: &Workspace, added: &[usize]) -> i64 {
    let (mut low, mut high) = ([i64::MAX; 3], [i64::MIN; 3]);
    for &n in added {
        let v = work.index(n);
        for a in 0..3 {
            low[a] = low[a].min(v[a] - 1);
            high[a] = high[a].max(v[a] + 1);
        }
    }
    let dims = [0, 1, 2].map(|a| (high[a] - low[a] + 1) as usize);
    let [nx, ny, _] = work.dims;
    let mut block = Vec::with_capacity(dims.iter().product());
    for k in low[2]..=high[2] {
        for j in low[1]..=high[1] {
            let first = (k as usize * ny + j as usize) * nx + low[0] as usize;
            block.extend_from_slice(&work.data[first..first + dims[0]]);
        }
    }
    let before = euler_of(&block, dims);
    for &n in added {
        let v = work.index(n);
        let at = [0, 1, 2].map(|a| (v[a] - low[a]) as usize);
        block[at[0] + dims[0] * (at[1] + dims[1] * at[2])] = 1;
    }
    euler_of(&block, dims) - before
}

/// Takes back what shut a pit off from the outside: that makes a cavity and closes no tunnel.
fn reopen_cavities(work: &mut Workspace, closed: &mut Vec<Vec<usize>>) {
    if closed.is_empty() {
        return;
    }
    let background = label_data(&work.data, work.dims, false, Connectivity::Six);
    let cavity = |n: usize| {
        let [i, j, k] = work.index(n).map(|c| c as usize);
        background.at(i, j, k).is_some_and(|l| !background.components()[l as usize].on_border)
    };
    let strides = [1, work.dims[0] as i64, (work.dims[0] * work.dims[1]) as i64];
    let beside = |n: usize| STEPS_6.map(|s| (n as i64 + s[0] * strides[0] + s[1] * strides[1] + s[2] * strides[2]) as usize);
    let (shut, kept): (Vec<_>, Vec<_>) =
        std::mem::take(closed).into_iter().partition(|span| span.iter().any(|&n| beside(n).into_iter().any(cavity)));
    for span in shut {
        span.iter().for_each(|&n| work.data[n] = 0);
    }
    *closed = kept;
}

/// Fills what is left of the tunnel on either side of its span, as long as it is one voxel wide and within bounds.
fn fill_pits(work: &mut Workspace, span: &mut Vec<usize>, max_hole: usize) {
    let mut at = 0;
    while at < span.len() {
        for m in neighbors_26(work.dims, span[at]) {
            let pit = work.data[m] == 0
                && span.len() < max_hole
                && work.may_fill(m)
                && face_neighbors(gather(&work.data, work.dims, m, |c| c != 0)) >= 5;
            if pit {
                work.data[m] = 1;
                span.push(m);
            }
        }
        at += 1;
    }
}
