//! From a mask to oriented points near the vessel wall.
//!
//! After Schumann et al., "Implicit Vessel Surface Reconstruction for Visualization and CFD Simulation", section
//! "Point Cloud Extraction": points lie in the background voxels that touch the lumen (*outer boundary voxels*), at
//! places that six rules choose from the pattern of lumen voxels among the six face neighbours; thin structures are
//! found by a top-hat transformation and sampled on half-size subvoxels. [`PointCloudOptions::paper`] is that text rule
//! by rule; [`PointCloudOptions::cfd`] moves the points onto the sub-voxel wall and takes better normals.

mod lattice;
mod options;
mod placement;
mod rules;
mod smoothing;
mod surface;

pub use options::{Concavities, Normals, PointCloudOptions, PointPlacement, SlotEnds, ThinStructures};
pub use rules::{Rule, Sites, sites};
pub use surface::{SurfaceError, SurfaceOptions, check_surface, from_surface, rasterize, resolving_spacing};

use rayon::prelude::*;
use serde::Serialize;

use crate::geometry::{Point, Vector};
use crate::mask::Mask;
use lattice::Lattice;
pub(crate) use lattice::block3;
use smoothing::Smoothed;

/// Points near the wall with unit normals that point out of the lumen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OrientedPoints {
    /// Positions, LPS mm.
    pub points: Vec<Point>,
    /// Unit outward normals, one a point.
    pub normals: Vec<Vector>,
    /// Local spacing, mm: the cube root of the volume of the voxel or subvoxel that the point stands for.
    pub pitch: Vec<f64>,
}

impl OrientedPoints {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// What [`extract`] did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Points in the cloud.
    pub points: usize,
    /// Points on half-size subvoxels.
    pub fine_points: usize,
    /// Outer boundary voxels and subvoxels, by the rule that applied to them.
    pub rules: RuleCounts,
    /// Lumen voxels that belong to thin structures.
    pub thin_voxels: usize,
    /// Background voxels in narrow concave places.
    pub concave_voxels: usize,
    /// Background subvoxels relabelled as lumen.
    pub relabelled_subvoxels: usize,
    /// Points left out because no normal could be told.
    pub dropped: usize,
    /// Points moved to the sub-voxel wall.
    pub moved: usize,
    /// Points moved by the mean bias of the rules because no wall was found within reach.
    pub moved_by_bias: usize,
}

/// How often each rule applied.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RuleCounts {
    /// One lumen neighbour.
    pub shared_face: usize,
    /// Two opposite lumen neighbours.
    pub opposite_faces: usize,
    /// Four lumen neighbours in a plane.
    pub ring: usize,
    /// Five lumen neighbours: a small cavity.
    pub cavity: usize,
    /// Six lumen neighbours: a hole.
    pub hole: usize,
    /// Every other pattern: a stair.
    pub stair: usize,
}

impl RuleCounts {
    fn count(&mut self, rule: Rule) {
        *match rule {
            Rule::SharedFace => &mut self.shared_face,
            Rule::OppositeFaces => &mut self.opposite_faces,
            Rule::Ring => &mut self.ring,
            Rule::Cavity => &mut self.cavity,
            Rule::Hole => &mut self.hole,
            Rule::Stair => &mut self.stair,
        } += 1;
    }
}

/// Why no point cloud could be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// There is no lumen voxel.
    #[error("the mask has no lumen voxel: choose another label or threshold (input.label)")]
    Empty,
    /// An option is out of its range.
    #[error("{name} is {value}; it must be {must}")]
    Option {
        /// The option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
}

/// One point before smoothing and placement, in the lattice's continuous index coordinates.
pub(crate) struct Candidate {
    /// Continuous index of the point.
    pub at: Vector,
    /// The sum of the normals of the lumen faces it belongs to, world directions, not normalised.
    pub faces: Vector,
    /// Normal by central differences of the labels, world direction; zero where the pattern is symmetric.
    pub gradient: Vector,
    /// Whether the rule asks for the face normal.
    pub by_face: bool,
    /// Whether it stands on a subvoxel.
    pub fine: bool,
}

/// Places oriented points along the boundary of `mask`.
///
/// The lumen may touch the border of the array: beyond it is background. Points come ordered by voxel, x fastest,
/// independent of the number of threads.
///
/// # Errors
/// [`Error::Empty`] for a mask without lumen, [`Error::Option`] for a width or shift out of range.
pub fn extract(mask: &Mask, options: &PointCloudOptions) -> Result<(OrientedPoints, Summary), Error> {
    options.validate()?;
    let lattice = Lattice::new(mask, options).ok_or(Error::Empty)?;
    let mut summary = Summary {
        thin_voxels: lattice.thin,
        concave_voxels: lattice.concave,
        relabelled_subvoxels: lattice.relabelled,
        ..Summary::default()
    };
    let candidates = lattice.candidates(options.slot_ends, &mut summary.rules);
    let smoothed = Smoothed::new(&lattice);
    let placed: Vec<_> = candidates.par_iter().map(|c| placement::place(c, &lattice, &smoothed, options)).collect();
    let pitch = lattice.grid.voxel_volume().cbrt();
    let mut cloud = OrientedPoints::default();
    for (candidate, placed) in candidates.iter().zip(placed) {
        let Some(p) = placed else {
            summary.dropped += 1;
            continue;
        };
        match p.moved {
            placement::Moved::No => {}
            placement::Moved::ToWall => summary.moved += 1,
            placement::Moved::ByBias => summary.moved_by_bias += 1,
        }
        summary.fine_points += usize::from(candidate.fine);
        cloud.points.push(p.point);
        cloud.normals.push(p.normal);
        cloud.pitch.push(if candidate.fine { 0.5 * pitch } else { pitch });
    }
    summary.points = cloud.len();
    Ok((cloud, summary))
}

#[cfg(test)]
mod tests;
