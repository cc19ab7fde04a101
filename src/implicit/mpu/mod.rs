//! Multi-level partition of unity implicits (Ohtake et al. 2003).
//!
//! An octree over the points; every leaf carries a quadric fitted to the points in a ball round it, and the leaves'
//! quadrics are blended by quadratic B-splines of the distance to the leaf's centre. A cell whose quadric misses its
//! points by more than the tolerance (Taubin's distance) is divided.
//!
//! Alone the function is trustworthy near the points only: put it behind [`super::guard::Guarded`].

mod build;
mod fit;

use rayon::prelude::*;
use serde::Serialize;

use super::Implicit;
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::Grid;
use crate::pointcloud::OrientedPoints;

/// How the function is built. [`MpuOptions::estimate`] takes the lengths from image and points.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MpuOptions {
    /// Support radius of a cell as a multiple of its diagonal; Ohtake's α.
    pub support: f64,
    /// Fewest points for a fit; a ball with fewer grows. Ohtake's N_min.
    pub min_points: usize,
    /// Largest distance between points and quadric, mm, for points of pitch `reference_pitch`; in proportion to the
    /// pitch elsewhere. Ohtake's ε₀.
    pub tolerance: f64,
    /// Pitch that `tolerance` is meant for, mm.
    pub reference_pitch: f64,
    /// Edge of the smallest cell over its points' pitch: cells are never divided below it.
    pub leaf_pitches: f64,
    /// Cells with more points than this are divided without a fit: no quadric would do.
    pub max_points: usize,
}

impl MpuOptions {
    /// Parameters from the properties of image and point cloud, as the paper asks (its rules, in a thesis that is not
    /// public, are not known; these were measured on digitised tubes).
    ///
    /// The tolerance is 0.4 voxel diagonals (of the voxel with the same volume), the noise of the points' placement:
    /// less reproduces stairs. The smallest cell is two pitches wide, so that its ball holds about 21 points of a
    /// plane wall.
    pub fn estimate(grid: &Grid, points: &OrientedPoints) -> MpuOptions {
        let voxel = grid.voxel_volume().cbrt();
        // Where every point is fine, the voxel is still the size of the stairs.
        let coarsest = points.pitch.iter().copied().fold(0.0, f64::max);
        let reference = if coarsest > 0.0 { coarsest.min(voxel) } else { voxel };
        let tolerance = 0.4 * 3f64.sqrt() * reference;
        MpuOptions { support: 0.75, min_points: 15, tolerance, reference_pitch: reference, leaf_pitches: 2.0, max_points: 4096 }
    }

    fn validate(&self) -> Result<(), MpuError> {
        let check = |name, value: f64, low: f64, high: f64| {
            if value > low && value <= high { Ok(()) } else { Err(MpuError::Option { name, value, low, high }) }
        };
        // Below one half the balls of leaves stop covering space.
        check("the support of MPU cells (cell diagonals)", self.support, 0.5, 4.0)?;
        check("the fewest points of an MPU fit", self.min_points as f64, 5.0, 1e4)?;
        check("the tolerance of MPU fits (mm)", self.tolerance, 0.0, f64::MAX)?;
        check("the reference pitch of MPU fits (mm)", self.reference_pitch, 0.0, f64::MAX)?;
        check("the smallest MPU cell (pitches)", self.leaf_pitches, 0.0, 1e3)?;
        check("the most points of an MPU fit", self.max_points as f64, self.min_points as f64, 1e9)
    }
}

/// What [`fit`] built.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Points that were fitted.
    pub points: usize,
    /// Levels of the octree.
    pub levels: usize,
    /// Leaves, that is quadrics.
    pub leaves: usize,
    /// Leaves with a bivariate quadric.
    pub bivariate: usize,
    /// Leaves with a general quadric.
    pub general: usize,
    /// Smallest leaf's edge, mm.
    pub smallest_leaf: f64,
    /// Leaves at the smallest size whose quadric misses a point by more than the tolerance.
    pub over_tolerance: usize,
    /// Memory of the octree, bytes.
    pub bytes: usize,
}

/// Why no function could be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MpuError {
    /// Too few points.
    #[error("the point cloud has {found} points, a fit needs {needed}: the vessel is smaller than a few voxels, so use a finer image or reconstruction.method: smooth")]
    TooFewPoints {
        /// Points there are.
        found: usize,
        /// Points needed.
        needed: usize,
    },
    /// A point is infinite or not a number.
    #[error("point {0} of the cloud or its normal is not finite")]
    NotFinite(usize),
    /// An option is out of its range.
    #[error("{name} is {value}; it must lie above {low} and not above {high}")]
    Option {
        /// The option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Lower limit, excluded.
        low: f64,
        /// Upper limit.
        high: f64,
    },
}

/// A cell of the octree.
#[derive(Debug, Clone, Copy)]
struct Node {
    center: Point,
    half: f64,
    /// First of eight children, or the quadric of a leaf.
    link: u32,
    leaf: bool,
}

/// f(x) = c₀ + g·y + yᵀ H y / 2 with y = x − centre of the cell.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Quadric {
    constant: f64,
    linear: [f64; 3],
    /// xx, yy, zz, xy, xz, yz of H.
    second: [f64; 6],
}

impl Quadric {
    fn value(&self, y: &Vector) -> f64 {
        let [xx, yy, zz, xy, xz, yz] = self.second;
        let hx = xx * y.x + xy * y.y + xz * y.z;
        let hy = xy * y.x + yy * y.y + yz * y.z;
        let hz = xz * y.x + yz * y.y + zz * y.z;
        let [lx, ly, lz] = self.linear;
        self.constant + y.x * (lx + 0.5 * hx) + y.y * (ly + 0.5 * hy) + y.z * (lz + 0.5 * hz)
    }

    fn gradient(&self, y: &Vector) -> Vector {
        let [xx, yy, zz, xy, xz, yz] = self.second;
        let [lx, ly, lz] = self.linear;
        Vector::new(
            lx + xx * y.x + xy * y.y + xz * y.z,
            ly + xy * y.x + yy * y.y + yz * y.z,
            lz + xz * y.x + yz * y.y + zz * y.z,
        )
    }
}

/// The fitted function.
#[derive(Debug, Clone)]
pub struct Mpu {
    nodes: Vec<Node>,
    /// Of every leaf: its quadric, its centre and its squared support radius.
    quadrics: Vec<Quadric>,
    balls: Vec<(Point, f64)>,
    /// The leaves whose balls meet a leaf's cell, in the order of the octree, and the first of each leaf's.
    near: Vec<u32>,
    first: Vec<u32>,
    root: Aabb,
    points: Aabb,
    resolution: f64,
}

/// Fits the function to the points. Independent of the number of threads.
///
/// # Errors
/// [`MpuError`]: too few points, points that are not finite, options out of range.
pub fn fit(points: &OrientedPoints, options: &MpuOptions) -> Result<(Mpu, Summary), MpuError> {
    options.validate()?;
    if points.len() < options.min_points {
        return Err(MpuError::TooFewPoints { found: points.len(), needed: options.min_points });
    }
    let finite = |n: usize| points.points[n].coords.iter().chain(points.normals[n].iter()).all(|c| c.is_finite());
    if let Some(n) = (0..points.len()).into_par_iter().find_first(|&n| !finite(n)) {
        return Err(MpuError::NotFinite(n));
    }
    Ok(build::build(points, options))
}

impl Mpu {
    /// Adds up Σw, Σwf and their gradients over the leaves whose ball holds `p`, in the order of the octree.
    #[inline]
    fn blend(&self, p: &Point, mut add: impl FnMut(f64, Vector, &Quadric, f64)) {
        let mut node = &self.nodes[0];
        while !node.leaf {
            let octant = (0..3).fold(0, |o, a| o | u32::from(p[a] > node.center[a]) << a);
            node = &self.nodes[(node.link + octant) as usize];
        }
        let leaf = node.link as usize;
        for &l in &self.near[self.first[leaf] as usize..self.first[leaf + 1] as usize] {
            let (center, r2) = &self.balls[l as usize];
            let y = p - center;
            let d2 = y.norm_squared();
            if d2 < *r2 {
                add(d2, y, &self.quadrics[l as usize], *r2);
            }
        }
    }

    /// Nearest point of the root cell, and the way to it.
    fn clamp(&self, p: &Point) -> (Point, Vector) {
        let q = p.sup(&self.root.min).inf(&self.root.max);
        (q, p - q)
    }
}

/// Quadratic B-spline of t = 1.5 d / R, and its derivative by d² (so that ∇w = 2 w′ y).
#[inline]
fn weight(d2: f64, r2: f64) -> (f64, f64) {
    let t2 = 2.25 * d2 / r2;
    if t2 < 0.25 {
        (0.75 - t2, -2.25 / r2)
    } else {
        let t = t2.sqrt();
        let u = 1.5 - t;
        (0.5 * u * u, -0.5 * u / t * 2.25 / r2)
    }
}

impl Implicit for Mpu {
    fn value(&self, p: &Point) -> f64 {
        let (q, out) = self.clamp(p);
        let (mut sum, mut weights) = (0.0, 0.0);
        self.blend(&q, |d2, y, f, r2| {
            let (w, _) = weight(d2, r2);
            weights += w;
            sum += w * f.value(&y);
        });
        sum / weights + out.norm()
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let (q, out) = self.clamp(p);
        let (mut sum, mut weights) = (0.0, 0.0);
        let (mut dsum, mut dweights) = (Vector::zeros(), Vector::zeros());
        self.blend(&q, |d2, y, f, r2| {
            let (w, dw) = weight(d2, r2);
            let v = f.value(&y);
            let gw = y * (2.0 * dw);
            weights += w;
            sum += w * v;
            dweights += gw;
            dsum += gw * v + f.gradient(&y) * w;
        });
        let value = sum / weights;
        let mut gradient = (dsum - dweights * value) / weights;
        let far = out.norm();
        if far > 0.0 {
            (0..3).filter(|&a| out[a] != 0.0).for_each(|a| gradient[a] = out[a] / far);
        }
        (value + far, gradient)
    }

    fn bounds(&self) -> Aabb {
        self.points
    }

    fn resolution(&self) -> f64 {
        self.resolution
    }
}

#[cfg(test)]
mod tests;
