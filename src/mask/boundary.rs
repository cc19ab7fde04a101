//! Exact signed distance from any point to the voxel-face boundary of a mask, near that boundary.

use super::Mask;
use super::morphology::dilate;
use crate::geometry::{Point, Vector};

/// Signed distance to the faces between lumen and background voxels, for points anywhere in the world.
///
/// Negative in the lumen. Exact within [`BoundaryDistance::reach`] of the boundary; farther away only the sign and
/// "at least the reach" are promised. Outside the mask's array all is background, so the boundary is closed.
/// Two bytes for each voxel of the array, grown by the reach in voxels.
#[derive(Debug, Clone)]
pub struct BoundaryDistance {
    grid: super::Grid,
    spacing: [f64; 3],
    pad: i64,
    dims: [i64; 3],
    /// Object (bit 0) and whether the other kind is near (bit 1).
    cells: Vec<u8>,
    /// Voxels round the middle one by rising least distance: squared mm, step per axis, step in `cells`.
    offsets: Vec<(f64, [i32; 3], i64)>,
    reach: f64,
}

const OBJECT: u8 = 1;
const NEAR: u8 = 2;

impl BoundaryDistance {
    /// Prepares the distance up to `layers` voxels (at least 1) to either side of the boundary.
    pub fn new(mask: &Mask, layers: usize) -> BoundaryDistance {
        let layers = layers.max(1);
        let pad = layers as i64 + 1;
        let padded = super::crop::window(mask, [-pad; 3], mask.grid.dims.map(|n| n + 2 * pad as usize));
        let dims = padded.grid.dims.map(|n| n as i64);
        let mut grown = padded.data.clone();
        let mut background: Vec<u8> = padded.data.iter().map(|&v| 1 - v).collect();
        for _ in 0..layers {
            grown = dilate(&grown, padded.grid.dims);
            background = dilate(&background, padded.grid.dims);
        }
        let cells = padded.data.iter().zip(&grown).zip(&background).map(|((&v, &g), &b)| v | (NEAR * (g & b))).collect();
        let spacing = mask.grid.spacing();
        let n = layers as i64;
        let mut offsets = Vec::new();
        for k in -n..=n {
            for j in -n..=n {
                for i in -n..=n {
                    let least = |o: i64, s: f64| ((o.abs() - 1).max(0) as f64 * s).powi(2);
                    let d = least(i, spacing[0]) + least(j, spacing[1]) + least(k, spacing[2]);
                    // Face neighbours before edge and corner neighbours: the nearest is found early.
                    offsets.push((d, i.abs() + j.abs() + k.abs(), [i as i32, j as i32, k as i32], i + dims[0] * (j + dims[1] * k)));
                }
            }
        }
        offsets.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let offsets = offsets.into_iter().map(|(d, _, o, s)| (d, o, s)).collect();
        // A point anywhere in its voxel still sees this far within `layers` voxels.
        let reach = spacing.iter().copied().fold(f64::INFINITY, f64::min) * layers as f64;
        BoundaryDistance { grid: mask.grid.clone(), spacing, pad, dims, cells, offsets, reach }
    }

    /// Distance in mm up to which values are exact: layers times the least spacing.
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Signed distance at `p`, mm, clamped to ± [`BoundaryDistance::reach`] far from the boundary.
    pub fn value(&self, p: &Point) -> f64 {
        self.nearest(p).0
    }

    /// Signed distance and its gradient: a unit vector out of the lumen; zero where the distance is clamped.
    pub fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let (value, hit) = self.nearest(p);
        let Some((within, offset)) = hit else { return (value, Vector::zeros()) };
        let sign = if value.is_sign_negative() { -1.0 } else { 1.0 };
        // The way to the nearest box of the other kind; on the face itself towards that box.
        let way = [0, 1, 2].map(|a| {
            let (c, h) = (f64::from(offset[a]) * self.spacing[a], 0.5 * self.spacing[a]);
            within[a].clamp(c - h, c + h) - within[a]
        });
        let along = if value.abs() > 1e-9 * self.reach { way } else { offset.map(f64::from) };
        let world = self.grid.axes * Vector::from_fn(|a, _| along[a] / self.spacing[a]);
        (value, world.try_normalize(0.0).unwrap_or_else(Vector::zeros) * -sign)
    }

    /// Signed distance, and the place in its voxel with the step to the nearest voxel of the other kind.
    #[inline]
    fn nearest(&self, p: &Point) -> (f64, Option<([f64; 3], [i32; 3])>) {
        let c = self.grid.to_index(p);
        let mut n = 0i64;
        let mut within = [0.0; 3];
        for a in [2, 1, 0] {
            let r = (c[a] + 0.5).floor();
            let v = r as i64 + self.pad;
            // `layers` voxels of padding stay free all round: every neighbour lies in the array.
            if v < self.pad - 1 || v > self.dims[a] - self.pad {
                return (self.reach, None);
            }
            within[a] = (c[a] - r) * self.spacing[a];
            n = n * self.dims[a] + v;
        }
        let cell = self.cells[n as usize];
        let object = cell & OBJECT;
        let sign = if object != 0 { -1.0 } else { 1.0 };
        if cell & NEAR == 0 {
            return (sign * self.reach, None);
        }
        let mut best = self.reach * self.reach;
        let mut hit = None;
        for &(least, offset, step) in &self.offsets {
            if least >= best {
                break;
            }
            if self.cells[(n + step) as usize] & OBJECT == object {
                continue;
            }
            let mut d = 0.0;
            for a in 0..3 {
                let away = (f64::from(offset[a]) * self.spacing[a] - within[a]).abs() - 0.5 * self.spacing[a];
                d += away.max(0.0).powi(2);
            }
            if d < best {
                best = d;
                hit = Some((within, offset));
            }
        }
        (sign * best.sqrt(), hit)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3};

    use super::*;
    use crate::geometry::Vector;
    use crate::mask::{Grid, signed_distance};

    fn blob(direction: Matrix3<f64>) -> Mask {
        let grid = Grid::new([9, 8, 7], [0.4, 0.7, 1.5], Point::new(-3.0, 5.0, 11.0), direction).expect("grid");
        let data = (0..grid.len())
            .map(|n| {
                let [i, j, k] = grid.voxel(n);
                u8::from((2..7).contains(&i) && (2..6).contains(&j) && (1..5).contains(&k) && (i * 5 + j * 3 + k * 7) % 4 != 0)
            })
            .collect();
        Mask::new(grid, data)
    }

    /// Brute force over every voxel box of the other kind; outside the array is background.
    fn slow(mask: &Mask, p: &Point) -> f64 {
        let (c, s) = (mask.grid.to_index(p), mask.grid.spacing());
        let v = c.map(|x| (x + 0.5).floor() as i64);
        let object = mask.at(v.x, v.y, v.z);
        let mut best = f64::INFINITY;
        for k in -4..12 {
            for j in -4..12 {
                for i in -4..14 {
                    if mask.at(i, j, k) != object {
                        let o = Vector::new(i as f64, j as f64, k as f64);
                        best = best.min((0..3).map(|a| (((c[a] - o[a]).abs() - 0.5).max(0.0) * s[a]).powi(2)).sum());
                    }
                }
            }
        }
        if object { -best.sqrt() } else { best.sqrt() }
    }

    #[test]
    fn values_near_the_boundary_are_exact_on_an_oblique_left_handed_grid() {
        let turn = Rotation3::from_euler_angles(0.3, -0.7, 1.1).into_inner();
        let mask = blob(turn * Matrix3::from_diagonal(&Vector::new(1.0, 1.0, -1.0)));
        let field = BoundaryDistance::new(&mask, 3);
        let mut exact = 0;
        for n in 0..4000u32 {
            let unit = |m: u32| f64::from((n.wrapping_mul(2_654_435_761).wrapping_add(m * 97_531)).wrapping_mul(m * 2 + 1) >> 8) / f64::from(1u32 << 24);
            let p = mask.grid.to_world(Vector::new(unit(1) * 11.0 - 1.5, unit(2) * 10.0 - 1.5, unit(3) * 9.0 - 1.5));
            let (d, truth) = (field.value(&p), slow(&mask, &p));
            assert_eq!(d.is_sign_negative(), truth.is_sign_negative());
            if truth.abs() < field.reach() {
                approx::assert_abs_diff_eq!(d, truth, epsilon = 1e-12);
                exact += 1;
            } else {
                assert_eq!(d.abs(), field.reach());
            }
        }
        assert!(exact > 1000, "{exact} points near the boundary");
    }

    #[test]
    fn at_voxel_centres_it_equals_the_distance_transform() {
        let mask = blob(Matrix3::identity());
        let field = BoundaryDistance::new(&mask, 3);
        for (n, d) in signed_distance(&mask).into_iter().enumerate() {
            let [i, j, k] = mask.grid.voxel(n);
            let p = mask.grid.to_world(Vector::new(i as f64, j as f64, k as f64));
            approx::assert_relative_eq!(field.value(&p), f64::from(d).clamp(-field.reach(), field.reach()), max_relative = 1e-6);
        }
    }

    #[test]
    fn gradient_is_the_derivative_of_the_distance_and_points_out_of_the_lumen() {
        let grid = Grid::new([9, 9, 9], [0.5, 1.0, 2.0], Point::origin(), Matrix3::from_diagonal(&Vector::new(-1.0, 1.0, 1.0))).expect("grid");
        let data = (0..grid.len()).map(|n| u8::from(grid.voxel(n).iter().all(|c| (2..7).contains(c)))).collect();
        let d = BoundaryDistance::new(&Mask::new(grid, data), 3);
        for p in [Point::new(-0.6, 4.1, 7.9), Point::new(-0.9, 4.0, 8.0), Point::new(-3.4, 7.0, 13.6), Point::new(-1.3, 6.3, 8.2)] {
            let (value, gradient) = d.value_gradient(&p);
            assert_eq!(value, d.value(&p));
            for a in 0..3 {
                let mut e = Vector::zeros();
                e[a] = 1e-6;
                let slope = (d.value(&(p + e)) - d.value(&(p - e))) / 2e-6;
                approx::assert_relative_eq!(gradient[a], slope, epsilon = 1e-6);
            }
        }
        // On a face: lumen begins at x = -0.75 (the axis runs against the world's).
        assert_eq!(d.value_gradient(&Point::new(-0.75, 4.0, 8.0)).1, Vector::x());
    }
}
