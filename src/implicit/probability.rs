//! The wall as an isosurface of a probability map, interpolated by cubic B-splines.

use rayon::prelude::*;

use super::Implicit;
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::Grid;

/// Pole of the cubic B-spline's interpolation filter: √3 − 2.
const POLE: f64 = -0.267_949_192_431_122_7;

/// Why a map has no wall.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProbabilityError {
    /// One value a voxel is needed.
    #[error("the map has {values} values for {voxels} voxels")]
    Length {
        /// Values given.
        values: usize,
        /// Voxels of the grid.
        voxels: usize,
    },
    /// A value is infinite or not a number.
    #[error("the map's value at voxel {voxel:?} is not finite: replace it in the image")]
    NotFinite {
        /// Index of the first such voxel.
        voxel: [usize; 3],
    },
    /// No two neighbours lie on either side of the isovalue.
    #[error("the map never crosses the isovalue {isovalue}; its values run from {low} to {high}: choose an isovalue between them")]
    NoCrossing {
        /// The isovalue.
        isovalue: f64,
        /// Least value.
        low: f64,
        /// Largest value.
        high: f64,
    },
}

/// Where a map falls below its isovalue, negative where it lies above; scaled so that its slope at the wall is about 1.
///
/// The spline passes through every value of the map; between them it is twice differentiable. Beyond the image the
/// border's values go on. Sharp maps overshoot: guard it by the mask of the same threshold.
#[derive(Debug, Clone)]
pub struct Probability {
    grid: Grid,
    coefficients: Vec<f32>,
    isovalue: f64,
    /// mm for each unit of the map.
    scale: f64,
}

impl Probability {
    /// Prepares the spline of `values`, one a voxel, x fastest. 4 bytes a voxel.
    ///
    /// # Errors
    /// [`ProbabilityError`]: wrong length, values that are not finite, an isovalue that is never crossed.
    pub fn new(grid: &Grid, values: &[f64], isovalue: f64) -> Result<Probability, ProbabilityError> {
        if values.len() != grid.len() {
            return Err(ProbabilityError::Length { values: values.len(), voxels: grid.len() });
        }
        if let Some(n) = values.iter().position(|v| !v.is_finite()) {
            return Err(ProbabilityError::NotFinite { voxel: grid.voxel(n) });
        }
        let [nx, ny, _] = grid.dims;
        let (mut slope, mut crossings) = (0.0, 0usize);
        for (a, step) in [1, nx, nx * ny].into_iter().enumerate() {
            let spacing = grid.spacing()[a];
            for n in 0..values.len().saturating_sub(step) {
                if grid.voxel(n)[a] + 1 < grid.dims[a] && (values[n] >= isovalue) != (values[n + step] >= isovalue) {
                    slope += ((values[n] - values[n + step]) / spacing).powi(2);
                    crossings += 1;
                }
            }
        }
        if crossings == 0 {
            let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
            return Err(ProbabilityError::NoCrossing { isovalue, low, high });
        }
        let scale = 1.0 / (slope / crossings as f64).sqrt();
        let mut coefficients = values.to_vec();
        prefilter(&mut coefficients, grid.dims);
        let coefficients = coefficients.into_iter().map(|c| c as f32).collect();
        Ok(Probability { grid: grid.clone(), coefficients, isovalue, scale })
    }

    /// The map and its derivatives by the index at a continuous index.
    fn spline(&self, x: &Vector) -> (f64, Vector) {
        let [nx, ny, _] = self.grid.dims;
        let mut base = [0i64; 3];
        let mut w = [[[0.0; 2]; 4]; 3];
        let mut outside = [false; 3];
        for a in 0..3 {
            let top = (self.grid.dims[a] - 1) as f64;
            outside[a] = x[a] < 0.0 || x[a] > top;
            let c = x[a].clamp(0.0, top);
            base[a] = c.floor() as i64 - 1;
            let t = c - c.floor();
            let u = 1.0 - t;
            w[a] = [
                [u * u * u / 6.0, -0.5 * u * u],
                [2.0 / 3.0 - t * t * (1.0 - 0.5 * t), t * (1.5 * t - 2.0)],
                [2.0 / 3.0 - u * u * (1.0 - 0.5 * u), -u * (1.5 * u - 2.0)],
                [t * t * t / 6.0, 0.5 * t * t],
            ];
        }
        let mirror = |i: i64, n: usize| -> usize {
            let last = n as i64 - 1;
            if last == 0 {
                return 0;
            }
            let m = i.rem_euclid(2 * last);
            m.min(2 * last - m) as usize
        };
        let (mut f, mut g) = (0.0, Vector::zeros());
        for (c, wz) in w[2].iter().enumerate() {
            let k = mirror(base[2] + c as i64, self.grid.dims[2]);
            for (b, wy) in w[1].iter().enumerate() {
                let j = mirror(base[1] + b as i64, ny);
                for (a, wx) in w[0].iter().enumerate() {
                    let i = mirror(base[0] + a as i64, nx);
                    let v = f64::from(self.coefficients[i + nx * (j + ny * k)]);
                    f += v * wx[0] * wy[0] * wz[0];
                    g += Vector::new(wx[1] * wy[0] * wz[0], wx[0] * wy[1] * wz[0], wx[0] * wy[0] * wz[1]) * v;
                }
            }
        }
        (0..3).filter(|&a| outside[a]).for_each(|a| g[a] = 0.0);
        (f, g)
    }
}

/// Turns values into spline coefficients, axis by axis, mirrored at the ends (Unser 1999).
fn prefilter(data: &mut [f64], [nx, ny, nz]: [usize; 3]) {
    data.par_chunks_mut(nx).for_each(filter_line);
    let slab = nx * ny;
    data.par_chunks_mut(slab).for_each(|plane| {
        let mut line = vec![0.0; ny];
        for i in 0..nx {
            (0..ny).for_each(|j| line[j] = plane[i + nx * j]);
            filter_line(&mut line);
            (0..ny).for_each(|j| plane[i + nx * j] = line[j]);
        }
    });
    // Lines along z, gathered row by row.
    let source: &[f64] = data;
    let filtered: Vec<Vec<f64>> = (0..slab)
        .into_par_iter()
        .map(|n| {
            let mut line: Vec<f64> = (0..nz).map(|k| source[n + slab * k]).collect();
            filter_line(&mut line);
            line
        })
        .collect();
    data.par_chunks_mut(slab).enumerate().for_each(|(k, plane)| plane.iter_mut().zip(&filtered).for_each(|(v, line)| *v = line[k]));
}

fn filter_line(c: &mut [f64]) {
    let n = c.len();
    if n < 2 {
        return;
    }
    c.iter_mut().for_each(|v| *v *= 6.0);
    // The pole's powers fall below rounding after 30 steps.
    let (mut sum, mut power) = (c[0], 1.0);
    for i in 1..=30 {
        power *= POLE;
        let m = i % (2 * (n - 1));
        sum += power * c[m.min(2 * (n - 1) - m)];
    }
    c[0] = sum;
    for i in 1..n {
        c[i] += POLE * c[i - 1];
    }
    c[n - 1] = POLE / (POLE * POLE - 1.0) * (c[n - 1] + POLE * c[n - 2]);
    for i in (0..n - 1).rev() {
        c[i] = POLE * (c[i + 1] - c[i]);
    }
}

impl Implicit for Probability {
    fn value(&self, p: &Point) -> f64 {
        (self.isovalue - self.spline(&self.grid.to_index(p)).0) * self.scale
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let (f, g) = self.spline(&self.grid.to_index(p));
        ((self.isovalue - f) * self.scale, self.grid.gradient_to_world(&g) * -self.scale)
    }

    fn bounds(&self) -> Aabb {
        let corners: Vec<Point> = (0..8)
            .map(|c| self.grid.to_world(Vector::from_fn(|a, _| if c >> a & 1 == 0 { -0.5 } else { self.grid.dims[a] as f64 - 0.5 })))
            .collect();
        Aabb::of(&corners)
    }

    fn resolution(&self) -> f64 {
        0.5 * self.grid.spacing().into_iter().fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;

    fn ball() -> (Grid, Vec<f64>, Point) {
        let grid = Grid::new([22, 20, 14], [0.5, 0.5, 0.8], Point::new(1.0, 2.0, 3.0), Matrix3::from_diagonal(&Vector::new(1.0, -1.0, 1.0))).unwrap();
        let center = grid.to_world(Vector::new(10.3, 9.6, 6.4));
        let at = |n: usize| grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)));
        // A soft edge 1.2 mm wide round a radius of 3 mm.
        let values = (0..grid.len()).map(|n| 1.0 / (1.0 + (((at(n) - center).norm() - 3.0) / 0.6).exp())).collect();
        (grid, values, center)
    }

    #[test]
    fn the_wall_lies_where_the_map_crosses_the_isovalue_far_below_a_voxel() {
        let (grid, values, center) = ball();
        let f = Probability::new(&grid, &values, 0.5).unwrap();
        for i in 0..200 {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 200.0;
            let a = f64::from(i) * 2.399_963_229_728_653;
            let d = Vector::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z);
            let (v, g) = f.value_gradient(&(center + d * 3.0));
            assert!((v / g.norm()).abs() < 0.02, "{v}");
            assert!(g.angle(&d).to_degrees() < 2.0);
            assert!((g.norm() - 1.0).abs() < 0.5, "about a distance");
        }
        assert!(f.value(&center) < 0.0);
    }

    #[test]
    fn the_spline_passes_through_the_values_and_the_gradient_is_its_derivative() {
        let (grid, values, center) = ball();
        let f = Probability::new(&grid, &values, 0.25).unwrap();
        for n in (0..grid.len()).step_by(97) {
            let p = grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)));
            approx::assert_relative_eq!(f.value(&p), (0.25 - values[n]) * f.scale, epsilon = 1e-5);
        }
        let p = center + Vector::new(1.7, -1.1, 1.9);
        let g = f.gradient(&p);
        for a in 0..3 {
            let mut e = Vector::zeros();
            e[a] = 1e-4;
            approx::assert_relative_eq!(g[a], (f.value(&(p + e)) - f.value(&(p - e))) / 2e-4, epsilon = 1e-4);
        }
    }

    #[test]
    fn an_isovalue_out_of_range_and_bad_values_are_told() {
        let (grid, mut values, _) = ball();
        assert!(matches!(Probability::new(&grid, &values, 2.0), Err(ProbabilityError::NoCrossing { .. })));
        assert!(matches!(Probability::new(&grid, &values[1..], 0.5), Err(ProbabilityError::Length { .. })));
        values[5] = f64::NAN;
        assert_eq!(Probability::new(&grid, &values, 0.5).err(), Some(ProbabilityError::NotFinite { voxel: [5, 0, 0] }));
    }
}
