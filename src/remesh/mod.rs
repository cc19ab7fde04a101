//! Surface remeshing on the implicit under a guidance field.

pub mod advancing_front;

pub mod angle_repair;
mod anneal;
mod band_grid;
pub mod curvature;
pub mod chord;
pub(crate) mod cutout;
pub(crate) mod ears;
mod even;
pub mod improve;
pub mod isotropic;
pub(crate) mod last_resort;
mod reach;
mod relax;
mod repair_moves;
mod rim_spacing;
pub mod shape;
pub mod size_field;
mod supports;
mod surface;
mod valence;
#[cfg(test)]
pub(crate) mod testing;

pub use supports::Supports;
pub use surface::Normals;

use crate::geometry::Point;
use crate::mesh::TriMesh;
use crate::mesh::topology::TopologyReport;
use surface::Surface;

/// Asked during long work: whether the caller wants it to end.
pub type Stop<'a> = dyn Fn() -> bool + Sync + 'a;

/// Wished edge length over space: the guidance field.
pub trait SizeField: Sync {
    /// Wished edge length at `p`, mm; positive everywhere and Lipschitz.
    fn size(&self, p: &Point) -> f64;
}

/// The same edge length everywhere.
#[derive(Debug, Clone, Copy)]
pub struct Uniform(pub f64);

impl SizeField for Uniform {
    fn size(&self, _: &Point) -> f64 {
        self.0
    }
}

/// Why a surface cannot be remeshed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The surface has holes, turned triangles or edges and vertices that are no manifold.
    #[error(
        "the surface to remesh is not a closed, oriented manifold: {} open, {} non-manifold, {} inconsistent edges, \
         {} non-manifold vertices{}; repair it first",
        report.open_edges, report.nonmanifold_edges, report.inconsistent_edges, report.nonmanifold_vertices,
        near(.at)
    )]
    NotManifold {
        /// What was counted.
        report: Box<TopologyReport>,
        /// Where the first fault lies.
        at: Option<Point>,
    },
    /// A mask over vertices does not belong to the mesh.
    #[error("the region has {given} entries but the mesh has {vertices} vertices; give one entry per vertex")]
    MaskLength {
        /// Length of the mask.
        given: usize,
        /// Vertices of the mesh.
        vertices: usize,
    },
    /// The guidance field has no usable value at a vertex.
    #[error("the wished edge length at ({:.3}, {:.3}, {:.3}) is {size}; it must be positive and finite", at.x, at.y, at.z)]
    BadSize {
        /// The vertex.
        at: Point,
        /// The value there.
        size: f64,
    },
    /// A length that was asked for cannot hold.
    #[error(
        "{name} is {asked} mm, and lengths from {} mm (a fifth of a voxel, or the shortest allowed) to {} mm (8 edges round a \
         vessel, or the longest allowed) can be had here; {asked} mm would mean {} triangles and {} tetrahedra of that size: \
         give a length in that range, or `auto`",
        (low * 1e4).ceil() / 1e4, (high * 1e4).floor() / 1e4, reach::about(*.faces), reach::about(*.cells)
    )]
    OutOfReach {
        /// Name of the option.
        name: &'static str,
        /// As asked for, mm.
        asked: f64,
        /// Shortest length that can be had, mm.
        low: f64,
        /// Longest length that can be had, mm.
        high: f64,
        /// Triangles that it would mean.
        faces: f64,
        /// Tetrahedra of that size that it would mean.
        cells: f64,
    },
    /// A length or factor that cannot be.
    #[error("{name} is {value}; give a positive number")]
    BadLength {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Largest distance of a vertex of the wall from the implicit, to first order, mm: 0 to rounding unless a vertex
/// could not be brought onto it.
pub fn off_implicit(mesh: &TriMesh, supports: &Supports) -> f64 {
    use rayon::prelude::*;
    let mut on_wall = vec![false; mesh.points.len()];
    for (t, ids) in mesh.triangles.iter().enumerate() {
        if mesh.patch.get(t).is_none_or(|&id| supports.plane(id).is_none()) {
            ids.iter().for_each(|&v| on_wall[v as usize] = true);
        }
    }
    let distance = |(p, on): (&Point, &bool)| if *on { supports.distance(crate::mesh::WALL, p) } else { 0.0 };
    mesh.points.par_iter().zip(&on_wall).map(distance).reduce(|| 0.0, f64::max)
}

fn near(at: &Option<Point>) -> String {
    at.map_or(String::new(), |p| format!(", the first at ({:.3}, {:.3}, {:.3})", p.x, p.y, p.z))
}

/// Checks the input of a remesher and takes it over.
pub(crate) fn take_over<'a>(
    mesh: &TriMesh,
    supports: &'a Supports<'a>,
    field: &'a dyn SizeField,
    region: Option<&[bool]>,
    features: &[[u32; 2]],
) -> Result<Surface<'a>, Error> {
    if let Some(r) = region {
        if r.len() != mesh.points.len() {
            return Err(Error::MaskLength { given: r.len(), vertices: mesh.points.len() });
        }
    }
    let s = Surface::new(mesh, supports, field, region, features)
        .map_err(|report| Error::NotManifold { at: report.first_fault(mesh), report })?;
    match s.size.iter().position(|h| !(h.is_finite() && *h > 0.0)) {
        Some(v) => Err(Error::BadSize { at: mesh.points[v], size: s.size[v] }),
        None => Ok(s),
    }
}
