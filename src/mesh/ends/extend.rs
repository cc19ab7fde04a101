//! Ends carried on outwards, so that a plane cut in a rim's own plane finds a full tube.

use super::super::bvh::TriangleBvh;
use super::super::intersect::triangles_intersect;
use super::super::{TriMesh, WALL, holes, polygon};
use super::{SurfaceEnd, Vessel};
use crate::geometry::{Aabb, Point, Vector};

/// Voxels by which an end goes on beyond its plane, besides half a radius.
const VOXELS: f64 = 4.0;
/// Voxels for which it follows the wall's own direction at each point of the rim.
const STRAIGHT: f64 = 2.0;
/// Voxels that must lie between it and the rest of the surface.
const CLEAR: f64 = 1.5;
/// Shortest continuation, voxels.
const LEAST: f64 = 1.5;

impl Vessel {
    /// The surface with a flat lid on each end, each with a patch id of its own from 2 on.
    pub fn closed(&self) -> TriMesh {
        let mut out = self.open.clone();
        for (n, rim) in self.rims.iter().enumerate() {
            let from = out.triangles.len();
            holes::close(&mut out, rim);
            out.patch[from..].fill(n as u32 + 2);
        }
        out
    }

    /// The surface with each end carried on by a tube ruled from its rim, four voxels and half a radius out of its plane, or less where it
    /// would come near other wall; closed by a lid across. For two voxels it follows the wall's own direction at each point, so that the
    /// wall has no bend where it is to be cut; then the rim's mean direction.
    pub fn extended(&self, voxel: f64) -> TriMesh {
        let wall = TriangleBvh::new(&self.open);
        let mut lengths: Vec<f64> = self.ends.iter().map(|e| VOXELS * voxel + 0.5 * (e.area / std::f64::consts::PI).sqrt()).collect();
        for _ in 0..5 {
            let hulls: Vec<Vec<[Point; 3]>> = self.ends.iter().zip(&lengths).map(|(e, l)| hull(e, *l, voxel)).collect();
            let meets = |n: usize| {
                hulls[n].iter().any(|t| {
                    let mut hit = false;
                    wall.overlapping(&Aabb::of(t), |w| hit = hit || triangles_intersect(t, &self.open.corners(w as usize)));
                    hit || hulls.iter().enumerate().any(|(m, other)| m != n && other.iter().any(|o| triangles_intersect(t, o)))
                })
            };
            let short: Vec<usize> = (0..hulls.len()).filter(|&n| lengths[n] > LEAST * voxel && meets(n)).collect();
            if short.is_empty() {
                break;
            }
            short.into_iter().for_each(|n| lengths[n] = (0.5 * lengths[n]).max(LEAST * voxel));
        }
        let mut out = self.open.clone();
        for ((end, rim), length) in self.ends.iter().zip(&self.rims).zip(lengths) {
            carry_on(&mut out, end, rim, length, voxel);
        }
        out
    }
}

/// A point carried to `length` mm beyond the end's plane.
fn carried(end: &SurfaceEnd, p: &Point, length: f64) -> Point {
    let away = end.normal.dot(&(p - end.center));
    p + end.direction * ((length - away) / end.direction.dot(&end.normal))
}

/// The tube, a little wider and longer, from a little beyond the rim on.
fn hull(end: &SurfaceEnd, length: f64, voxel: f64) -> Vec<[Point; 3]> {
    let n = end.rim.len();
    let ring = |length: f64| -> Vec<Point> {
        let wider = |p: &Point| {
            let out: Vector = carried(end, p, 0.0) - end.center;
            carried(end, p, length) + out.try_normalize(0.0).unwrap_or_else(Vector::zeros) * (CLEAR * voxel)
        };
        end.rim.iter().map(wider).collect()
    };
    let (low, high) = (ring(CLEAR * voxel), ring(length + CLEAR * voxel));
    let top = carried(end, &end.center, length + CLEAR * voxel);
    (0..n)
        .flat_map(|i| {
            let j = (i + 1) % n;
            [[low[j], low[i], high[i]], [low[j], high[i], high[j]], [high[j], high[i], top]]
        })
        .collect()
}

fn carry_on(mesh: &mut TriMesh, end: &SurfaceEnd, rim: &[u32], length: f64, voxel: f64) {
    let n = rim.len();
    let first = mesh.points.len() as u32;
    let straight = (STRAIGHT * voxel).min(0.5 * length);
    let own = |(p, d): (&Point, &Vector)| {
        let along = if d.dot(&end.normal) > 0.3 { *d } else { end.direction };
        p + along * ((straight - end.normal.dot(&(p - end.center))) / along.dot(&end.normal))
    };
    let low: Vec<Point> = end.rim.iter().zip(&end.directions).map(own).collect();
    mesh.points.extend(&low);
    mesh.points.extend(low.iter().map(|p| carried(end, p, length)));
    let high = first + n as u32;
    for i in 0..n {
        let j = (i + 1) % n;
        let (a, b, c, d) = (rim[i], rim[j], first + i as u32, first + j as u32);
        let (e, f) = (high + i as u32, high + j as u32);
        mesh.triangles.extend([[b, a, c], [b, c, d], [d, c, e], [d, e, f]]);
    }
    let (u, v) = end.plane().basis();
    let flat: Vec<[f64; 2]> = (0..n).rev().map(|i| mesh.points[high as usize + i] - end.center).map(|d| [d.dot(&u), d.dot(&v)]).collect();
    match polygon::triangulate(&flat) {
        Some(lid) => mesh.triangles.extend(lid.into_iter().map(|t| t.map(|i| high + (n - 1 - i) as u32))),
        // Where the outline crosses itself a fan closes it as well: what lies inside follows from winding numbers.
        None => {
            let middle = mesh.points.len() as u32;
            mesh.points.push(carried(end, &end.center, length));
            mesh.triangles.extend((0..n).map(|i| [high + ((i + 1) % n) as u32, high + i as u32, middle]));
        }
    }
    mesh.patch.resize(mesh.triangles.len(), WALL);
}
