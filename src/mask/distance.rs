//! Exact anisotropic Euclidean distance transforms at voxel centres.
//!
//! Separable lower envelopes of parabolas (Felzenszwalb and Huttenlocher 2012), one pass an axis, lines in parallel:
//! O(voxels). The axes of the grid are taken as square to each other, as [`super::Grid`] promises within 1e-3.

use rayon::prelude::*;

use super::Mask;

/// Squared distance in mm² from every voxel centre to the nearest centre of a voxel whose value is `target`.
///
/// Voxels outside the array do not count. Infinite everywhere where no voxel has that value. Four bytes a voxel,
/// eight while it runs.
pub fn squared_distance_to(mask: &Mask, target: bool) -> Vec<f32> {
    transform(mask, target, Site::Centre)
}

/// Signed distance in mm from every voxel centre to the boundary between lumen and background voxels: negative in the lumen.
///
/// The boundary is the set of voxel faces with lumen on one side and background on the other; the distance to it is
/// exact (a voxel at a flat wall has ∓ half its edge). The array's own border is no boundary. Infinite where there is none.
pub fn signed_distance(mask: &Mask) -> Vec<f32> {
    let mut out = transform(mask, true, Site::Box);
    let inside = transform(mask, false, Site::Box);
    out.par_iter_mut().zip(&inside).zip(&mask.data).for_each(|((o, i), &v)| *o = if v != 0 { -i.sqrt() } else { o.sqrt() });
    out
}

/// What of a voxel the distance is measured to.
#[derive(Clone, Copy, PartialEq)]
enum Site {
    Centre,
    /// The whole closed voxel.
    Box,
}

/// Columns handled together, so that strided passes read whole cache lines.
const TILE: usize = 16;

fn transform(mask: &Mask, target: bool, site: Site) -> Vec<f32> {
    let [nx, ny, nz] = mask.grid.dims;
    let spacing = mask.grid.spacing();
    let mut f = vec![0f32; mask.data.len()];
    f.par_chunks_mut(nx).zip(mask.data.par_chunks(nx)).for_each_init(
        || Line::new(nx, spacing[0], site),
        |line, (row, voxels)| {
            let mut any = false;
            for (r, &v) in row.iter_mut().zip(voxels) {
                let hit = (v != 0) == target;
                any |= hit;
                *r = if hit { 0.0 } else { f32::INFINITY };
            }
            if any {
                line.run(row);
            }
        },
    );
    f.par_chunks_mut(nx * ny).for_each_init(
        || (Line::new(ny, spacing[1], site), vec![0f32; TILE * ny]),
        |(line, tile), slab| {
            for x0 in (0..nx).step_by(TILE) {
                let w = TILE.min(nx - x0);
                for y in 0..ny {
                    for x in 0..w {
                        tile[x * ny + y] = slab[y * nx + x0 + x];
                    }
                }
                tile.chunks_mut(ny).take(w).for_each(|t| line.run(t));
                for y in 0..ny {
                    for x in 0..w {
                        slab[y * nx + x0 + x] = tile[x * ny + y];
                    }
                }
            }
        },
    );
    // The last pass writes planes of constant y, which are then put back in order.
    let mut g = vec![0f32; f.len()];
    g.par_chunks_mut(nx * nz).enumerate().for_each_init(
        || (Line::new(nz, spacing[2], site), vec![0f32; TILE * nz]),
        |(line, tile), (y, plane)| {
            for x0 in (0..nx).step_by(TILE) {
                let w = TILE.min(nx - x0);
                for z in 0..nz {
                    for x in 0..w {
                        tile[x * nz + z] = f[(z * ny + y) * nx + x0 + x];
                    }
                }
                tile.chunks_mut(nz).take(w).for_each(|t| line.run(t));
                for z in 0..nz {
                    for x in 0..w {
                        plane[z * nx + x0 + x] = tile[x * nz + z];
                    }
                }
            }
        },
    );
    f.par_chunks_mut(nx * ny).enumerate().for_each(|(z, slab)| {
        for (y, row) in slab.chunks_mut(nx).enumerate() {
            row.copy_from_slice(&g[(y * nz + z) * nx..][..nx]);
        }
    });
    f
}

/// One-dimensional transform of a line, with its scratch space.
struct Line {
    spacing: f64,
    site: Site,
    /// Position and height of the parabolas of the envelope, and where each begins to be lowest.
    hull: Vec<(f64, f64, f64)>,
    heights: Vec<f32>,
}

impl Line {
    fn new(n: usize, spacing: f64, site: Site) -> Line {
        Line { spacing, site, hull: Vec::with_capacity(n + 1), heights: Vec::with_capacity(n) }
    }

    /// Replaces `f[i]` by the least `f[j] + d(i, j)²`.
    fn run(&mut self, f: &mut [f32]) {
        // Lines wholly inside or wholly out of reach are the most of a picture.
        if f.iter().all(|&h| h == 0.0) || f.iter().all(|&h| h == f32::INFINITY) {
            return;
        }
        self.heights.clear();
        self.heights.extend_from_slice(f);
        let (n, h) = (f.len(), &self.heights);
        self.hull.clear();
        match self.site {
            Site::Centre => (0..n).for_each(|j| push(&mut self.hull, j as f64 * self.spacing, f64::from(h[j]))),
            // To the near end of the voxel from outside it, 0 within: parabolas stand at the voxels' ends.
            Site::Box => (0..=n).for_each(|j| {
                let before = if j > 0 { h[j - 1] } else { f32::INFINITY };
                let after = if j < n { h[j] } else { f32::INFINITY };
                push(&mut self.hull, (j as f64 - 0.5) * self.spacing, f64::from(before.min(after)));
            }),
        }
        if self.hull.is_empty() {
            return;
        }
        let mut at = 0;
        for (i, out) in f.iter_mut().enumerate() {
            let x = i as f64 * self.spacing;
            while at + 1 < self.hull.len() && self.hull[at + 1].2 <= x {
                at += 1;
            }
            let (p, height, _) = self.hull[at];
            let value = height + (x - p) * (x - p);
            *out = match self.site {
                Site::Centre => value as f32,
                Site::Box => (value as f32).min(*out),
            };
        }
    }
}

/// Adds a parabola to the lower envelope.
fn push(hull: &mut Vec<(f64, f64, f64)>, position: f64, height: f64) {
    if height == f64::INFINITY {
        return;
    }
    let mut from = f64::NEG_INFINITY;
    while let Some(&(p, h, begins)) = hull.last() {
        from = ((height + position * position) - (h + p * p)) / (2.0 * (position - p));
        if from > begins {
            break;
        }
        hull.pop();
        from = f64::NEG_INFINITY;
    }
    hull.push((position, height, from));
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::Grid;

    fn scattered(dims: [usize; 3], spacing: [f64; 3], every: usize) -> Mask {
        let grid = Grid::new(dims, spacing, Point::origin(), Matrix3::identity()).expect("grid");
        let data = (0..grid.len()).map(|n| u8::from((n * 2_654_435_761) % 1009 < every)).collect();
        Mask::new(grid, data)
    }

    /// Brute force over all voxels.
    fn slow(mask: &Mask, n: usize, target: bool, half: f64) -> f64 {
        let s = mask.grid.spacing();
        let a = mask.grid.voxel(n);
        let to = |m: usize| {
            let b = mask.grid.voxel(m);
            (0..3).map(|i| ((a[i].abs_diff(b[i]) as f64 - half).max(0.0) * s[i]).powi(2)).sum::<f64>()
        };
        (0..mask.data.len()).filter(|&m| (mask.data[m] != 0) == target).map(to).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn distances_to_centres_agree_with_brute_force_at_any_anisotropy() {
        for spacing in [[1.0, 1.0, 1.0], [0.4, 0.7, 2.5]] {
            let mask = scattered([11, 9, 7], spacing, 40);
            for target in [true, false] {
                let d = squared_distance_to(&mask, target);
                for n in 0..d.len() {
                    approx::assert_relative_eq!(f64::from(d[n]), slow(&mask, n, target, 0.0), max_relative = 1e-6);
                }
            }
        }
    }

    #[test]
    fn signed_distances_to_the_voxel_faces_are_exact() {
        let mask = scattered([11, 9, 7], [0.4, 0.7, 2.5], 300);
        let d = signed_distance(&mask);
        for n in 0..d.len() {
            let inside = mask.data[n] != 0;
            let sign = if inside { -1.0 } else { 1.0 };
            approx::assert_relative_eq!(f64::from(d[n]), sign * slow(&mask, n, !inside, 0.5).sqrt(), max_relative = 1e-6);
        }
    }

    #[test]
    fn without_a_target_the_distance_is_infinite() {
        let mask = scattered([3, 3, 3], [1.0; 3], 0);
        assert!(squared_distance_to(&mask, true).iter().all(|d| d.is_infinite()));
        assert!(squared_distance_to(&mask, false).iter().all(|d| *d == 0.0));
    }
}
