//! Other windows on a mask: cropping, padding, splitting.

use rayon::prelude::*;

use super::components::{Connectivity, label};
use super::Mask;

/// First and last index of the lumen along each axis; `None` where the mask is empty.
pub fn lumen_box(mask: &Mask) -> Option<[[usize; 2]; 3]> {
    let [nx, ny, _] = mask.grid.dims;
    let boxes: Vec<Option<[[usize; 2]; 3]>> = mask
        .data
        .par_chunks(nx * ny)
        .enumerate()
        .map(|(k, slab)| {
            let mut found: Option<[[usize; 2]; 3]> = None;
            for (j, row) in slab.chunks(nx).enumerate() {
                let Some(first) = row.iter().position(|&v| v != 0) else { continue };
                let last = row.iter().rposition(|&v| v != 0).unwrap_or(first);
                found = Some(join(found, [[first, last], [j, j], [k, k]]));
            }
            found
        })
        .collect();
    boxes.into_iter().flatten().fold(None, |all, b| Some(join(all, b)))
}

fn join(all: Option<[[usize; 2]; 3]>, b: [[usize; 2]; 3]) -> [[usize; 2]; 3] {
    all.map_or(b, |a| [0, 1, 2].map(|i| [a[i][0].min(b[i][0]), a[i][1].max(b[i][1])]))
}

/// The mask seen through another window: voxel `low` becomes (0, 0, 0); what lies outside the array is background.
pub(crate) fn window(mask: &Mask, low: [i64; 3], dims: [usize; 3]) -> Mask {
    resample(mask, low, dims, |v, _| v)
}

/// Copies rows from the source; `source(index, axis)` tells which index of the mask stands at an index of the lattice.
fn resample(mask: &Mask, low: [i64; 3], dims: [usize; 3], source: impl Fn(i64, usize) -> i64 + Sync) -> Mask {
    let [sx, sy, sz] = mask.grid.dims.map(|n| n as i64);
    let [nx, ny, _] = dims;
    let grid = mask.grid.window(low, dims);
    let mut data = vec![0; grid.len()];
    data.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slab)| {
        let z = source(low[2] + k as i64, 2);
        if !(0..sz).contains(&z) {
            return;
        }
        for (j, row) in slab.chunks_mut(nx).enumerate() {
            let y = source(low[1] + j as i64, 1);
            if !(0..sy).contains(&y) {
                continue;
            }
            let from = &mask.data[((z * sy + y) * sx) as usize..][..sx as usize];
            for (i, out) in row.iter_mut().enumerate() {
                let x = source(low[0] + i as i64, 0);
                if (0..sx).contains(&x) {
                    *out = from[x as usize];
                }
            }
        }
    });
    let image = [0, 1, 2].map(|a| mask.image[a].map(|i| i - low[a]));
    Mask { grid, data, image }
}

/// Crops to the lumen's bounding box plus `margin` voxels of background.
///
/// Where the lumen touches the picture's border, the border voxels are first replicated `replicate` times along the
/// border's normal, so that a surface runs straight through the border and can be cut there; the margin of background
/// stands behind them, so that the lumen is closed within the array. `Mask::image` keeps telling where the picture is.
/// An empty mask comes back as one background voxel.
pub fn crop_pad(mask: &Mask, margin: usize, replicate: usize) -> Mask {
    let Some(found) = lumen_box(mask) else { return window(mask, [0; 3], [1; 3]) };
    let (margin, replicate) = (margin as i64, replicate as i64);
    let reach = [0, 1, 2].map(|a| found[a].map(|i| i as i64));
    // Lumen that stands at the border goes on.
    let before = [0, 1, 2].map(|a| if reach[a][0] == mask.image[a][0] { replicate } else { 0 });
    let after = [0, 1, 2].map(|a| if reach[a][1] == mask.image[a][1] { replicate } else { 0 });
    let low = [0, 1, 2].map(|a| reach[a][0] - before[a] - margin);
    let dims = [0, 1, 2].map(|a| (reach[a][1] + after[a] + margin - low[a] + 1) as usize);
    resample(mask, low, dims, |v, a| {
        if v < reach[a][0] && v >= reach[a][0] - before[a] {
            reach[a][0]
        } else if v > reach[a][1] && v <= reach[a][1] + after[a] {
            reach[a][1]
        } else {
            v
        }
    })
}

/// The 26-connected components of the lumen, each cropped to its bounding box, by falling number of voxels
/// (ties in scan order). `Mask::image` of each tells where the picture is.
pub fn split_components(mask: &Mask) -> Vec<Mask> {
    let labels = label(mask, true, Connectivity::TwentySix);
    let parts = labels.components();
    let mut order: Vec<usize> = (0..parts.len()).collect();
    order.sort_by_key(|&c| std::cmp::Reverse(parts[c].voxels));
    order
        .into_iter()
        .map(|c| {
            let b = parts[c].bounds;
            let low = b.map(|r| r[0] as i64);
            let mut part = Mask {
                grid: mask.grid.window(low, b.map(|r| r[1] - r[0] + 1)),
                data: Vec::new(),
                image: [0, 1, 2].map(|a| mask.image[a].map(|i| i - low[a])),
            };
            part.data = vec![0; part.grid.len()];
            let [nx, ny, _] = part.grid.dims;
            labels.for_each_run(c as u32, |j, k, x0, x1| {
                let row = ((k - b[2][0]) * ny + j - b[1][0]) * nx;
                part.data[row + x0 - b[0][0]..row + x1 - b[0][0]].fill(1);
            });
            part
        })
        .collect()
}
