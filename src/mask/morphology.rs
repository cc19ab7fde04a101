//! Erosion, dilation, opening and top-hats with the full 3×3×3 cube.
//!
//! What lies outside the array does not count, as though the border were replicated: a vessel that leaves the image is
//! neither eroded there nor thin. Separable, parallel, O(voxels).

use rayon::prelude::*;

use super::Mask;

/// Voxels with a lumen voxel among their 26 neighbours or themselves.
pub fn dilation(mask: &Mask) -> Mask {
    Mask { data: dilate(&mask.data, mask.grid.dims), ..mask.clone() }
}

/// Voxels whose 26 neighbours and themselves are all lumen.
pub fn erosion(mask: &Mask) -> Mask {
    Mask { data: erode(&mask.data, mask.grid.dims), ..mask.clone() }
}

/// Voxels that some 3×3×3 block inside the lumen covers.
pub fn opening(mask: &Mask) -> Mask {
    Mask { data: dilate(&erode(&mask.data, mask.grid.dims), mask.grid.dims), ..mask.clone() }
}

/// White top-hat: lumen voxels that no 3×3×3 block inside the lumen covers, which are thin parts and sharp corners.
pub fn top_hat(mask: &Mask) -> Mask {
    let mut out = opening(mask);
    out.data.iter_mut().zip(&mask.data).for_each(|(o, &v)| *o = v & (1 - *o));
    out
}

/// Top-hat of the inverse: background voxels that no 3×3×3 block of background covers, which are slits and concave edges.
pub fn inverse_top_hat(mask: &Mask) -> Mask {
    let mut out = Mask { data: erode(&dilate(&mask.data, mask.grid.dims), mask.grid.dims), ..mask.clone() };
    out.data.iter_mut().zip(&mask.data).for_each(|(o, &v)| *o &= 1 - v);
    out
}

pub(crate) fn dilate(data: &[u8], dims: [usize; 3]) -> Vec<u8> {
    combine(data, dims, |a, b| a | b)
}

pub(crate) fn erode(data: &[u8], dims: [usize; 3]) -> Vec<u8> {
    combine(data, dims, |a, b| a & b)
}

/// Folds every voxel with its two neighbours along each axis in turn.
fn combine(data: &[u8], [nx, ny, _]: [usize; 3], op: impl Fn(u8, u8) -> u8 + Sync) -> Vec<u8> {
    let slab = nx * ny;
    let fold = |out: &mut [u8], other: &[u8]| out.iter_mut().zip(other).for_each(|(o, &v)| *o = op(*o, v));
    let mut planes = data.to_vec();
    planes.par_chunks_mut(slab).enumerate().for_each(|(k, out)| {
        let source = &data[k * slab..][..slab];
        for (row, from) in out.chunks_mut(nx).zip(source.chunks(nx)) {
            fold(&mut row[1..], &from[..nx - 1]);
            fold(&mut row[..nx - 1], &from[1..]);
        }
        let rows = out.to_vec();
        fold(&mut out[nx..], &rows[..slab - nx]);
        fold(&mut out[..slab - nx], &rows[nx..]);
    });
    let mut out = planes.clone();
    out.par_chunks_mut(slab).enumerate().for_each(|(k, out)| {
        if k > 0 {
            fold(out, &planes[(k - 1) * slab..][..slab]);
        }
        if let Some(next) = planes.get((k + 1) * slab..(k + 2) * slab) {
            fold(out, next);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::Grid;

    fn mask(dims: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> Mask {
        let grid = Grid::new(dims, [1.0; 3], Point::origin(), Matrix3::identity()).expect("grid");
        let data = (0..grid.len()).map(|n| u8::from(rule(grid.voxel(n)))).collect();
        Mask::new(grid, data)
    }

    #[test]
    fn a_voxel_grows_to_a_cube_and_a_cube_shrinks_to_a_voxel() {
        let one = mask([7, 7, 7], |v| v == [3, 3, 3]);
        let cube = mask([7, 7, 7], |v| v.iter().all(|i| (2..5).contains(i)));
        assert_eq!(dilation(&one).data, cube.data);
        assert_eq!(erosion(&cube).data, one.data);
        assert_eq!(opening(&cube).data, cube.data);
    }

    #[test]
    fn the_top_hat_is_the_thin_branch_and_a_border_does_not_make_it() {
        // A 3×3 bar along x through both borders, with a 1×1 branch along y.
        let bar = mask([8, 9, 7], |[_, j, k]| (2..5).contains(&j) && (2..5).contains(&k));
        assert_eq!(top_hat(&bar).count(), 0);
        let branched = mask([8, 9, 7], |[i, j, k]| (2..5).contains(&k) && (2..5).contains(&j) || i == 4 && j >= 5 && k == 3);
        let thin = top_hat(&branched);
        assert_eq!(thin.count(), 4);
        assert!((5..9).all(|j| thin.at(4, j, 3)));
    }

    #[test]
    fn the_inverse_top_hat_is_the_slit_between_two_vessels() {
        let pair = mask([8, 9, 7], |[_, j, _]| j != 4);
        let slit = inverse_top_hat(&pair);
        assert_eq!(slit.count(), 8 * 7);
        assert!(slit.at(0, 4, 0));
    }
}
