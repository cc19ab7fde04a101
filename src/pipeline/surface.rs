//! A surface as what a case starts from: repaired, its ends found, put on a grid.

use std::path::Path;

use serde::Serialize;

use super::{Error, results};
use crate::config::Case;
use crate::geometry::{Aabb, Point};
use crate::io::{self, mesh::AnyMesh};
use crate::mask::Mask;
use crate::mesh::TriMesh;
use crate::mesh::ends::{self, SurfaceEnd};
use crate::mesh::repair::{self, Fault, Repair};
use crate::pointcloud::{self, OrientedPoints};
use crate::report::Report;

/// A surface as it was given, and what stands for it.
pub struct GivenSurface {
    /// Repaired and closed at its ends, mm: what results are held against. Lids have patch ids other than the wall's.
    pub given: TriMesh,
    /// The same with its ends carried on, so that a cut in an end's plane cuts a full tube.
    pub extended: TriMesh,
    /// Its ends.
    pub ends: Vec<SurfaceEnd>,
}

/// Most voxels of the grid that a surface is put on.
const MOST_VOXELS: f64 = 2e7;

/// Where a surface came from and what was made of it.
#[derive(Debug, Serialize)]
struct Provenance<'a> {
    file: String,
    sha256: String,
    points: usize,
    triangles: usize,
    /// Connected pieces.
    shells: usize,
    repairs: &'a [Repair],
    ends: &'a [SurfaceEnd],
    /// Voxel edge of the grid that it was put on, mm.
    spacing: f64,
    lumen_voxels: usize,
}

/// Reads a surface, and the mask that stands for it.
pub fn read(case: &Case, path: &Path, report: &mut Report) -> Result<(Mask, GivenSurface), Error> {
    let wrong = |what: &dyn std::fmt::Display| Error::Surface { file: path.into(), what: what.to_string() };
    let AnyMesh::Surface(mut mesh) = io::mesh::read(path)? else {
        return Err(wrong(&"the file holds no surface of triangles: give an STL, VTP, VTK, OBJ or PLY surface, or a mask"));
    };
    let factor = case.input.units.in_mm();
    mesh.points.iter_mut().for_each(|p| p.coords *= factor);
    // Openings are found by shape, not by the file's patches.
    let mesh = TriMesh::new(mesh.points, mesh.triangles);
    let repair::Repaired { mesh, shells, mut repairs } = repair::repair(&mesh).map_err(|e| wrong(&e))?;
    let vessel = ends::find(&mesh);
    repairs.extend(Repair::of(Fault::Holes, &vessel.filled));
    let given = vessel.closed();
    pointcloud::check_surface(&given).map_err(|e| wrong(&e))?;
    let spacing = match case.input.spacing {
        Some(l) => l.value,
        None => pointcloud::resolving_spacing(&given, MOST_VOXELS).map_err(|e| wrong(&e))?,
    };
    let extended = vessel.extended(spacing);
    let mask = pointcloud::rasterize(&extended, spacing).map_err(|e| wrong(&e))?;
    for r in &repairs {
        report.warn("input", format!("the surface was repaired: {r}"));
    }
    report.put(
        "input",
        &Provenance {
            file: results::file_name(path),
            sha256: results::sha256(path),
            points: mesh.points.len(),
            triangles: mesh.triangles.len(),
            shells,
            repairs: &repairs,
            ends: &vessel.ends,
            spacing,
            lumen_voxels: mask.count(),
        },
    );
    if mask.count() == 0 {
        return Err(wrong(&format!("no voxel of {spacing:.4} mm fits into the surface: check input.units, or set input.spacing")));
    }
    Ok((mask, GivenSurface { given, extended, ends: vessel.ends }))
}

/// Voxels from a sample within which its component's boundary must lie.
const NEAR: i64 = 2;

/// Points on the part of a surface that bounds a component: pieces of others, and cavities that cleaning filled, get none.
pub fn samples(surface: &GivenSurface, mask: &Mask, pitch: f64) -> Result<OrientedPoints, Error> {
    let all = pointcloud::from_surface(&surface.extended, &pointcloud::SurfaceOptions { pitch: Some(pitch) })?;
    let bounds = |p: &Point| {
        let at = mask.grid.to_index(p);
        let [i, j, k] = [0, 1, 2].map(|a| at[a].round() as i64);
        let (mut lumen, mut outside) = (false, false);
        for n in 0..(2 * NEAR + 1).pow(3) {
            let side = 2 * NEAR + 1;
            let inside = mask.at(i + n % side - NEAR, j + n / side % side - NEAR, k + n / (side * side) - NEAR);
            (lumen, outside) = (lumen || inside, outside || !inside);
        }
        lumen && outside
    };
    let mut own = OrientedPoints::default();
    for n in (0..all.len()).filter(|&n| bounds(&all.points[n])) {
        own.points.push(all.points[n]);
        own.normals.push(all.normals[n]);
        own.pitch.push(all.pitch[n]);
    }
    Ok(own)
}

/// Whether a point lies in what was added beyond an end's plane.
pub fn is_added(surface: &GivenSurface, p: &Point) -> bool {
    surface.ends.iter().any(|e| {
        let beyond = e.normal.dot(&(p - e.center));
        let foot = p - e.direction * (beyond / e.direction.dot(&e.normal));
        let reach = Aabb::of(&e.rim).diagonal();
        // The tube is no longer than half a radius and some voxels; a vessel that comes by is farther off.
        beyond > 0.0 && (foot - e.center).norm() < 0.6 * reach && beyond < 3.0 * reach
    })
}
