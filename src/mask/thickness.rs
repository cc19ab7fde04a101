//! Local thickness: the largest ball inside the lumen that reaches a voxel (Hildebrand and Rüegsegger 1997).

use rayon::prelude::*;

use super::{Mask, signed_distance, squared_distance_to};

/// For every lumen voxel the radius in mm of the largest ball inside the lumen that holds the voxel's centre, at most
/// `cap`; 0 in the background.
///
/// Balls stand at voxel centres and end at the nearest voxel face of the background, so a flat layer of n voxels has
/// radius n/2 voxels where n is odd, and half a voxel less where it is even. The array's border bounds no ball.
/// O(voxels · (cap / spacing)³): meant for telling thin parts from thick ones.
pub fn local_radius(mask: &Mask, cap: f64) -> Vec<f32> {
    let [nx, ny, nz] = mask.grid.dims;
    let s = mask.grid.spacing();
    let depth = signed_distance(mask);
    let limit = cap as f32;
    let deep: Vec<u8> = depth.par_iter().map(|&d| u8::from(-d >= limit)).collect();
    let to_deep = squared_distance_to(&Mask { data: deep, ..mask.clone() }, true);

    let reach = s.map(|s| (cap / s).floor() as i64);
    let mut steps = Vec::new();
    for k in -reach[2]..=reach[2] {
        for j in -reach[1]..=reach[1] {
            for i in -reach[0]..=reach[0] {
                let d = ((i as f64 * s[0]).powi(2) + (j as f64 * s[1]).powi(2) + (k as f64 * s[2]).powi(2)).sqrt();
                if d <= cap {
                    steps.push(([i, j, k], d as f32));
                }
            }
        }
    }
    let mut out = vec![0f32; mask.data.len()];
    out.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slab)| {
        for (n, out) in slab.iter_mut().enumerate() {
            let at = k * nx * ny + n;
            if mask.data[at] == 0 {
                continue;
            }
            if to_deep[at] <= limit * limit {
                *out = limit;
                continue;
            }
            let (i, j) = ((n % nx) as i64, (n / nx) as i64);
            for &([di, dj, dk], d) in &steps {
                let (x, y, z) = (i + di, j + dj, k as i64 + dk);
                if (0..nx as i64).contains(&x) && (0..ny as i64).contains(&y) && (0..nz as i64).contains(&z) {
                    let radius = -depth[(x + nx as i64 * (y + ny as i64 * z)) as usize];
                    if radius >= d {
                        *out = out.max(radius.min(limit));
                    }
                }
            }
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

    #[test]
    fn a_plate_with_a_thin_fin_has_both_radii() {
        let grid = Grid::new([20, 15, 11], [0.5; 3], Point::origin(), Matrix3::identity()).expect("grid");
        // A slab of 5 voxels along z, with a fin one voxel thick standing on it.
        let lumen = |[i, j, k]: [usize; 3]| (1..6).contains(&k) && (2..18).contains(&i) && (2..13).contains(&j) || i == 9 && (2..13).contains(&j) && (6..10).contains(&k);
        let data = (0..grid.len()).map(|n| u8::from(lumen(grid.voxel(n)))).collect();
        let mask = Mask::new(grid, data);
        let at = |r: &[f32], i, j, k| r[mask.grid.linear(i, j, k).expect("inside")];
        let r = local_radius(&mask, 10.0);
        assert_eq!(at(&r, 9, 7, 8), 0.25);
        assert_eq!(at(&r, 5, 7, 3), 1.25);
        assert_eq!(at(&r, 5, 7, 1), 1.25, "the surface of the slab is as thick as its middle");
        assert_eq!(at(&r, 0, 0, 0), 0.0);
        let capped = local_radius(&mask, 0.75);
        assert_eq!(at(&capped, 9, 7, 8), 0.25);
        assert_eq!(at(&capped, 5, 7, 1), 0.75);
    }
}
