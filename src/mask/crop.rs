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

/// [`crop_pad`] that carries only those border voxels on for which `goes_on` says so, asked with the voxel in the mask's
/// own indices and the image's face: axis, and whether it is the upper one.
pub fn crop_pad_where(mask: &Mask, margin: usize, replicate: usize, goes_on: impl Fn(&[i64; 3], (usize, bool)) -> bool) -> Mask {
    let mut padded = crop_pad(mask, margin, replicate);
    let low = [0, 1, 2].map(|a| mask.image[a][0] - padded.image[a][0]);
    let beyond = |v: &[i64; 3]| (0..3).any(|a| v[a] < mask.image[a][0] || v[a] > mask.image[a][1]);
    let mut known = std::collections::HashMap::new();
    for n in 0..padded.data.len() {
        if padded.data[n] == 0 {
            continue;
        }
        let v = padded.grid.voxel(n);
        let v = [0, 1, 2].map(|a| v[a] as i64 + low[a]);
        if !beyond(&v) {
            continue;
        }
        let source = [0, 1, 2].map(|a| v[a].clamp(mask.image[a][0], mask.image[a][1]));
        let sides = (0..3).filter(|&a| v[a] != source[a]).map(|a| (a, v[a] > source[a]));
        let stays = sides.into_iter().all(|side| *known.entry((source, side)).or_insert_with(|| goes_on(&source, side)));
        padded.data[n] = u8::from(stays);
    }
    padded
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

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::*;
    use crate::geometry::Point;
    use crate::mask::Grid;

    fn mask(dims: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> Mask {
        let direction = Rotation3::from_euler_angles(0.2, 0.4, -0.9).into_inner();
        let grid = Grid::new(dims, [0.5, 0.75, 1.25], Point::new(10.0, -20.0, 30.0), direction).expect("grid");
        let data = (0..grid.len()).map(|n| u8::from(rule(grid.voxel(n)))).collect();
        Mask::new(grid, data)
    }

    fn world(mask: &Mask) -> Vec<Point> {
        let at = |n: usize| mask.grid.to_world(Vector3::from(mask.grid.voxel(n).map(|v| v as f64)));
        (0..mask.data.len()).filter(|&n| mask.data[n] != 0).map(at).collect()
    }

    #[test]
    fn cropping_keeps_every_voxel_at_its_place_in_the_world() {
        let blob = mask([20, 18, 16], |[i, j, k]| (5..9).contains(&i) && (6..12).contains(&j) && k == 7);
        let cropped = crop_pad(&blob, 3, 4);
        assert_eq!(cropped.grid.dims, [10, 12, 7]);
        assert_eq!(cropped.image, [[-2, 17], [-3, 14], [-4, 11]]);
        for (a, b) in world(&blob).iter().zip(world(&cropped)) {
            approx::assert_relative_eq!(*a, b, epsilon = 1e-12);
        }
        assert_eq!(cropped.count(), blob.count());
    }

    #[test]
    fn a_vessel_at_the_border_goes_on_beyond_it_and_is_closed_behind() {
        let tube = mask([9, 9, 12], |[i, j, _]| (3..6).contains(&i) && (3..6).contains(&j));
        let padded = crop_pad(&tube, 2, 5);
        assert_eq!(padded.grid.dims, [7, 7, 12 + 2 * 7]);
        assert_eq!(padded.image[2], [7, 18]);
        assert_eq!(padded.count(), 9 * 22);
        assert_eq!(lumen_box(&padded), Some([[2, 4], [2, 4], [2, 23]]));
        // Once more: what was added lies outside the picture and does not count as touching its border.
        let again = crop_pad(&padded, 1, 5);
        assert_eq!(again.count(), padded.count());
    }

    #[test]
    fn components_come_by_size_each_in_its_own_box() {
        let two = mask([20, 9, 9], |[i, j, k]| (j, k) == (4, 4) && ((2..5).contains(&i) || (8..15).contains(&i)));
        let parts = split_components(&two);
        assert_eq!(parts.iter().map(Mask::count).collect::<Vec<_>>(), [7, 3]);
        assert_eq!(parts[1].grid.dims, [3, 1, 1]);
        assert_eq!(parts[1].image, [[-2, 17], [-4, 4], [-4, 4]]);
        let mut together = world(&parts[1]);
        together.extend(world(&parts[0]));
        for (a, b) in world(&two).iter().zip(together) {
            approx::assert_relative_eq!(*a, b, epsilon = 1e-12);
        }
    }

    #[test]
    fn an_empty_mask_has_no_box() {
        let none = mask([4, 4, 4], |_| false);
        assert_eq!(lumen_box(&none), None);
        assert_eq!(crop_pad(&none, 2, 2).count(), 0);
        assert!(split_components(&none).is_empty());
    }
}
