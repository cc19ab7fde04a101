//! Final position and normal of a point.

use nalgebra::Matrix3;

use super::lattice::Lattice;
use super::options::{Normals, PointCloudOptions, PointPlacement};
use super::smoothing::{Jet, Smoothed};
use super::Candidate;
use crate::geometry::{Point, Vector};

/// How a point left the place that its rule gave it.
pub(super) enum Moved {
    No,
    ToWall,
    ByBias,
}

pub(super) struct Placed {
    pub point: Point,
    pub normal: Vector,
    pub moved: Moved,
}

/// `None` where no normal can be told.
pub(super) fn place(c: &Candidate, lattice: &Lattice, smoothed: &Smoothed, options: &PointCloudOptions) -> Option<Placed> {
    let grid = &lattice.grid;
    let normal = match options.normals {
        Normals::CentralDifferences => {
            if c.by_face {
                c.faces.try_normalize(0.0)?
            } else {
                c.gradient.try_normalize(0.0).or_else(|| c.faces.try_normalize(0.0))?
            }
        }
        Normals::Gaussian { sigma } => gaussian_normal(c, &c.at, if c.fine { 0.7 * sigma } else { sigma }, lattice, smoothed)?,
    };
    let PointPlacement::SubVoxel { reach, fallback } = options.placement else {
        return Some(Placed { point: grid.to_world(c.at), normal, moved: Moved::No });
    };
    let size = if c.fine { 0.5 } else { 1.0 };
    // A voxel's extent along the normal, mm.
    let extent = grid.axes.tr_mul(&normal).norm();
    Some(match wall(c, &normal, reach * extent, lattice, smoothed) {
        Some(at) => {
            let normal = match options.normals {
                Normals::Gaussian { sigma } => gaussian_normal(c, &at, if c.fine { 0.7 * sigma } else { sigma }, lattice, smoothed)?,
                Normals::CentralDifferences => normal,
            };
            Placed { point: grid.to_world(at), normal, moved: Moved::ToWall }
        }
        None => Placed { point: grid.to_world(c.at) - normal * (fallback * size * extent), normal, moved: Moved::ByBias },
    })
}

/// Standard deviations along the axes, voxels, of a Gaussian `sigma` of the smallest spacing wide.
fn index_sigma(lattice: &Lattice, sigma: f64) -> Vector {
    let s = lattice.grid.spacing();
    let least = s[0].min(s[1]).min(s[2]);
    Vector::from(s.map(|s| (sigma * least / s).max(0.7 * sigma.min(1.0)).max(0.45)))
}

fn gaussian_normal(c: &Candidate, at: &Vector, sigma: f64, lattice: &Lattice, smoothed: &Smoothed) -> Option<Vector> {
    let g = -smoothed.jet(at, &index_sigma(lattice, sigma)).gradient;
    let faces = c.faces.try_normalize(0.0);
    let s = lattice.grid.spacing();
    // A plane wall answers with 1 / (√(2π) σ).
    let plane = 0.4 / (sigma * s[0].max(s[1]).max(s[2]));
    match (g.norm() > 0.05 * plane, faces) {
        (true, Some(f)) if g.dot(&f) < 0.2 * g.norm() => Some(f),
        (true, _) => g.try_normalize(0.0),
        (false, f) => f,
    }
}

/// The wall along the normal: where the smoothed mask is one half, moved back out by what smoothing shrinks.
fn wall(c: &Candidate, normal: &Vector, reach: f64, lattice: &Lattice, smoothed: &Smoothed) -> Option<Vector> {
    let grid = &lattice.grid;
    let start = grid.to_world(c.at);
    let index = |t: f64| grid.to_index(&(start + normal * t));
    let crossing = |sigma: &Vector, mut t: f64| -> Option<f64> {
        for _ in 0..8 {
            let Jet { value, gradient, .. } = smoothed.jet(&index(t), sigma);
            let slope = gradient.dot(normal);
            let error = value - 0.5;
            if slope.abs() * reach < 0.05 {
                return None;
            }
            let step = (-error / slope).clamp(-0.5 * reach, 0.5 * reach);
            t += step;
            if t.abs() > reach {
                return None;
            }
            if step.abs() < 1e-3 * reach {
                return (slope < 0.0).then_some(t);
            }
        }
        None
    };
    let first = crossing(&index_sigma(lattice, 0.7), 0.0)?;
    let shape = shape_operator(&smoothed.jet(&index(first), &index_sigma(lattice, 1.2)))?;
    let voxel = grid.voxel_volume().cbrt();
    let sharpest = shape.symmetric_eigenvalues().amax() * voxel;
    let sigma = index_sigma(lattice, if sharpest > 1.0 / 1.1 { 0.5 } else if sharpest > 0.4 { 0.7 } else { 1.0 });
    let t = crossing(&sigma, first).unwrap_or(first);
    // Σ ∂²/∂x² / 2 moves a level set by half the trace of Σ times the shape operator.
    let s = grid.spacing();
    let axes = Matrix3::from_fn(|r, a| grid.axes[(r, a)] / s[a]);
    let variance = Vector::from_fn(|a, _| (sigma[a] * s[a]).powi(2));
    let spread = axes * Matrix3::from_diagonal(&variance) * axes.transpose();
    let back = (0.5 * (spread * shape).trace()).clamp(-0.4 * voxel, 0.4 * voxel);
    Some(index(t + back))
}

/// Derivative of the outward unit normal, restricted to the tangent plane, 1/mm: positive eigenvalues where convex.
fn shape_operator(jet: &Jet) -> Option<Matrix3<f64>> {
    let length = jet.gradient.norm();
    let n = jet.gradient.try_normalize(0.0)?;
    let tangent = Matrix3::identity() - n * n.transpose();
    Some(tangent * -jet.hessian * tangent / length)
}
