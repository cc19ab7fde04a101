//! The voxels on both sides of a mask's boundary.

use rayon::prelude::*;

use super::Mask;

/// The voxels with a face neighbour of the other label, in the order of the array, and as bits the axes along which it
/// lies; beyond the mask lies background, whose voxels next to the array are told too.
pub fn interface(mask: &Mask) -> Vec<([i32; 3], u8)> {
    let [nx, ny, nz] = mask.grid.dims;
    // A row of voxels with one of background at either end; none outside the array.
    let row = |j: i64, k: i64| {
        let inside = j >= 0 && k >= 0 && j < ny as i64 && k < nz as i64;
        inside.then(|| &mask.data[nx * (j as usize + ny * k as usize)..][..nx])
    };
    let slabs: Vec<Vec<([i32; 3], u8)>> = (-1..=nz as i64)
        .into_par_iter()
        .map(|k| {
            let mut out = Vec::new();
            let mut differs = vec![0u8; nx + 2];
            for j in -1..=ny as i64 {
                let here = row(j, k);
                let lumen = |r: Option<&[u8]>| r.is_some_and(|r| r.iter().any(|&v| v != 0));
                let across = [(j - 1, k, 2), (j + 1, k, 2), (j, k - 1, 4), (j, k + 1, 4)];
                if !lumen(here) && !across.iter().any(|&(j, k, _)| lumen(row(j, k))) {
                    continue;
                }
                differs.fill(0);
                for (j, k, bit) in across {
                    let inner = &mut differs[1..=nx];
                    match (here, row(j, k)) {
                        (Some(a), Some(b)) => inner.iter_mut().zip(a.iter().zip(b)).for_each(|(d, (a, b))| *d |= u8::from((*a != 0) != (*b != 0)) * bit),
                        (Some(a), None) | (None, Some(a)) => inner.iter_mut().zip(a).for_each(|(d, a)| *d |= u8::from(*a != 0) * bit),
                        (None, None) => {}
                    }
                }
                if let Some(a) = here {
                    let at = |i: usize| i > 0 && i <= nx && a[i - 1] != 0;
                    for i in 0..=nx {
                        let step = u8::from(at(i) != at(i + 1));
                        differs[i] |= step;
                        differs[i + 1] |= step;
                    }
                }
                out.extend(differs.iter().zip(-1..).filter(|(d, _)| **d != 0).map(|(&d, i)| ([i, j as i32, k as i32], d)));
            }
            out
        })
        .collect();
    slabs.concat()
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::Grid;

    #[test]
    fn it_holds_every_voxel_with_a_neighbour_of_the_other_label_and_no_other() {
        let grid = Grid::new([7, 6, 5], [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
        let data = (0..grid.len()).map(|n| u8::from(n * 7919 % 5 < 2)).collect();
        let mask = Mask::new(grid, data);
        let mut wanted = Vec::new();
        for k in -1..=5i64 {
            for j in -1..=6i64 {
                for i in -1..=7i64 {
                    let differs = |d: [i64; 3]| mask.at(i + d[0], j + d[1], k + d[2]) != mask.at(i, j, k);
                    let step = |a: usize, s: i64| std::array::from_fn(|b| if a == b { s } else { 0 });
                    let axes = (0..3).fold(0, |bits, a| bits | u8::from(differs(step(a, 1)) || differs(step(a, -1))) << a);
                    if axes != 0 {
                        wanted.push(([i as i32, j as i32, k as i32], axes));
                    }
                }
            }
        }
        assert_eq!(interface(&mask), wanted);
    }
}
