//! Bloomenthal's polygonizer, by tetrahedra: the zero set of an implicit function as a closed triangle mesh.
//!
//! Box-shaped cells follow the mask's axes: cubes, or longer where voxels are. Every cell is split into six tetrahedra round its body diagonal, the
//! same way everywhere, so that neighbours agree on their shared faces: the result is a closed, oriented
//! 2-manifold whatever the function does (J. Bloomenthal, "An implicit surface polygonizer", Graphics Gems IV,
//! 1994; the cube table of the original is ambiguous and is not used).
//!
//! The original follows one component from a seed. Here every cell of every boundary voxel of the mask is a
//! seed, and the surface is followed out of these cells where it leaves them: the result equals that of the
//! original started on every component that meets a boundary voxel. Work and memory go with the area of the
//! wall, not with the volume of the image.

mod differences;
mod lattice;
mod march;
mod roots;

use serde::Serialize;

use crate::geometry::Point;
use crate::implicit::Implicit;
use crate::mask::Mask;
use crate::mesh::TriMesh;

pub use differences::{Difference, differences};
pub use lattice::Lattice;

/// How finely to sample the surface, and at which level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PolygonizeOptions {
    /// Edges of a cell, in units of the voxel's. The paper uses 0.7.
    pub cell: f64,
    /// No edge of a cell is longer than this many times its shortest, however long the voxels; 1 makes cubes, as the paper's.
    pub stretch: f64,
    /// Outward shift of the level, in voxel diagonals. The paper uses 0.05; anything but 0 biases the wall.
    pub offset: f64,
}

impl Default for PolygonizeOptions {
    fn default() -> Self {
        PolygonizeOptions { cell: 0.5, stretch: 2.0, offset: 0.0 }
    }
}

impl PolygonizeOptions {
    /// The paper's own numbers: cubes of 0.7 voxels, shifted outwards by 5 % of the voxel diagonal.
    pub fn paper() -> Self {
        PolygonizeOptions { cell: 0.7, stretch: 1.0, offset: 0.05 }
    }
}

/// What the polygonizer did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PolygonizeSummary {
    /// Shortest edge of a cell, mm.
    pub cell: f64,
    /// Level of the surface, mm; positive is outwards.
    pub level: f64,
    /// Cells looked at.
    pub cells: usize,
    /// Evaluations of the implicit function.
    pub evaluations: usize,
    /// Vertices of the surface.
    pub vertices: usize,
    /// Triangles of the surface.
    pub triangles: usize,
}

/// Why there is no surface.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PolygonizeError {
    /// An option is out of range.
    #[error("polygonizer: {name} is {value}; {must}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// The function has one sign on all cells.
    #[error("the implicit function has no zero near the mask's boundary ({cells} cells looked at): is the mask empty or full, or thinner than a cell of {cell} mm?")]
    NoSurface {
        /// Cells looked at.
        cells: usize,
        /// Edge of a cell, mm.
        cell: f64,
    },
    /// The function is infinite or not a number somewhere.
    #[error("the implicit function is {value} at {at:?} mm (LPS): its fit failed there; look for isolated voxels in the mask near that point")]
    NotFinite {
        /// What it returned.
        value: f64,
        /// Where.
        at: [f64; 3],
    },
    /// The zero set goes on outside the bounds the function itself states.
    #[error("the implicit surface leaves its own bounds at {at:?} mm (LPS): the function must be positive outside them")]
    LeavesBounds {
        /// Where.
        at: [f64; 3],
    },
    /// More vertices or triangles than ids.
    #[error("the surface would have {0} vertices, more than 32-bit ids can number: use larger cells or mesh a part of the mask")]
    TooLarge(usize),
}

/// Polygonizes `implicit` on a lattice along the axes of `mask`, starting at the boundary voxels of `mask`.
///
/// The mesh is closed, 2-manifold and oriented outwards; every vertex lies on the level set to within 1e-4 of
/// a cell, save that none comes nearer than 1/1000 of an edge to a lattice corner. Triangle quality is *not*
/// bounded. Components of the zero set that meet no boundary voxel are not found.
///
/// # Errors
/// [`PolygonizeError`]: options out of range, no surface, or a function that is not finite or not bounded.
pub fn polygonize(
    implicit: &dyn Implicit,
    mask: &Mask,
    options: &PolygonizeOptions,
) -> Result<(TriMesh, PolygonizeSummary), PolygonizeError> {
    let in_range = |name, value: f64, ok: bool, must| {
        if ok { Ok(()) } else { Err(PolygonizeError::Option { name, value, must }) }
    };
    let cell_ok = options.cell >= 0.05 && options.cell <= 4.0;
    in_range("cell", options.cell, cell_ok, "it must lie between 0.05 and 4 voxels")?;
    let stretch_ok = options.stretch >= 1.0 && options.stretch <= 20.0;
    in_range("stretch", options.stretch, stretch_ok, "it must lie between 1 and 20")?;
    let offset_ok = options.offset.abs() <= 2.0;
    in_range("offset", options.offset, offset_ok, "it must lie between -2 and 2 voxel diagonals")?;
    let lattice = Lattice::along(&mask.grid, options.cell, options.stretch);
    let level = options.offset * mask.grid.voxel_diagonal();
    // Many short parallel loops: from a thread of the pool they start without waking and waiting.
    rayon::scope(|_| march::sweep(implicit, &lattice, lattice::boundary_cells(mask, &lattice), level))
}

/// Polygonizes `implicit` on any lattice, starting in the cells that contain `seeds`.
///
/// The same guarantees as [`polygonize`]; of the zero set, the components that pass through a seed's cell or
/// one of its 26 neighbours are found. `level` is in mm, positive outwards.
///
/// # Errors
/// As [`polygonize`].
pub fn polygonize_from(
    implicit: &dyn Implicit,
    lattice: &Lattice,
    seeds: &[Point],
    level: f64,
) -> Result<(TriMesh, PolygonizeSummary), PolygonizeError> {
    let mut cells = Vec::with_capacity(27 * seeds.len());
    for p in seeds {
        let c = lattice.cell_of(p);
        for n in 0..27 {
            cells.push([c[0] + n % 3 - 1, c[1] + n / 3 % 3 - 1, c[2] + n / 9 - 1]);
        }
    }
    rayon::scope(|_| march::sweep(implicit, lattice, cells.into_iter(), level))
}

#[cfg(test)]
mod tests;
