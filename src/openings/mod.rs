//! Inlets and outlets: detection, plane cuts, caps, flow extensions.

mod axis;
mod border;
mod boundary_points;
mod cut;
mod detect;
mod evidence;
mod extend;
mod faces;
mod names;
mod naming;
mod refine;
mod removed;
mod rims;
mod section;
mod shared;
mod slices;
mod surface_ends;
mod user;
mod walk;

pub use cut::{CutOptions, CutSummary, Cutter, OpeningMeasure, cut, cut_each, measure};
pub use rims::{RimOptions, RimSummary};
pub use detect::{BlindEnd, BlindReason, DetectOptions, DetectReport, FoundEnd, detect};
pub use border::{AtBorder, BorderRegion};
pub use evidence::{CutDirection, Evidence};
pub use faces::FlatFace;
pub use extend::{ExtendError, Extended, Extension, LEAST_LEFT, Tube, clear as clear_extensions, equivalent_radius};
pub use refine::refine;
pub use section::{Section, section};
pub use surface_ends::{RimEnd, join_rims};
pub use user::{UserError, UserOpenings, UserPlane, apply_user};

use serde::Serialize;

use crate::geometry::{Plane, Point, Vector};
use crate::mesh::{Patch, PatchId, PatchKind};

/// How an opening was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FoundBy {
    /// Given in the YAML.
    User,
    /// The vessel leaves the image there.
    ImageBorder,
    /// The lumen ends in a plane inside the image.
    FlatFace,
    /// A blunt end of the vessel inside the image.
    BluntEnd,
    /// An open rim or a flat cap of the surface that was given.
    SurfaceRim,
}

/// A planar end of a vessel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Opening {
    /// Patch number.
    pub id: PatchId,
    /// Patch name.
    pub name: String,
    /// Inlet or outlet.
    pub kind: PatchKind,
    /// Cut plane: origin on the vessel's axis, normal out of the vessel.
    pub plane: Plane,
    /// Radius of the vessel at the plane, mm: tells which branch is meant.
    pub radius: f64,
    /// What the mask says of the vessel there.
    pub support: Support,
    /// How it was found.
    pub found_by: FoundBy,
    /// 0 to 1; 1 for planes given by the user.
    pub confidence: f64,
    /// Connected component of the mask that it belongs to.
    pub component: u32,
}

/// What the mask says of a vessel at its opening.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Support {
    /// Axis of the vessel, out of it, of unit length.
    pub axis: Vector,
    /// Area of the section square to the axis, mm²: what sizes the vessel.
    pub square_area: f64,
    /// Area that the opening should have by the flat face or border region that it stands for, mm².
    pub expected_area: Option<f64>,
    /// Whether the plane lies along that face, and stays as it is.
    pub along_face: bool,
}

impl Support {
    /// A round vessel whose axis is the plane's normal.
    pub fn round(plane: &Plane, radius: f64) -> Support {
        Support { axis: plane.normal, square_area: std::f64::consts::PI * radius * radius, expected_area: None, along_face: false }
    }
}

impl Opening {
    /// Angle between the plane's normal and the vessel's axis, degrees.
    pub fn tilt(&self) -> f64 {
        self.plane.normal.dot(&self.support.axis).clamp(-1.0, 1.0).acos().to_degrees()
    }
}

/// Why an opening cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The plane meets no wall near its centre.
    #[error(
        "opening `{name}`: its plane meets no vessel near its centre ({:.3}, {:.3}, {:.3}); the nearest wall is at ({:.3}, {:.3}, {:.3}): move the centre into the vessel (LPS mm)",
        at.x, at.y, at.z, nearest.x, nearest.y, nearest.z
    )]
    Misses {
        /// Name of the opening.
        name: String,
        /// Its centre.
        at: Point,
        /// The nearest point of the wall.
        nearest: Point,
    },
    /// Both sides of the cut hang together.
    #[error(
        "opening `{name}`: the vessel cut at ({:.3}, {:.3}, {:.3}) is part of a ring, so that one plane opens nothing: give a second plane on the ring, or drop this one",
        at.x, at.y, at.z
    )]
    Ring {
        /// Name of the opening.
        name: String,
        /// A point of the cut.
        at: Point,
    },
    /// Everything lies beyond the plane.
    #[error("opening `{name}`: everything lies beyond its plane at ({:.3}, {:.3}, {:.3}): turn its normal round, it must point out of the vessel", at.x, at.y, at.z)]
    NothingLeft {
        /// Name of the opening.
        name: String,
        /// Its centre.
        at: Point,
    },
    /// The cut of an end that was found would take off more than that end.
    #[error(
        "opening `{name}`: the cut at ({:.3}, {:.3}, {:.3}) would take off another opening, or most of the vessel: give the plane of this end, its normal out of the vessel",
        at.x, at.y, at.z
    )]
    TakesOff {
        /// Name of the opening.
        name: String,
        /// Its centre.
        at: Point,
    },
    /// The section is no simple polygon.
    #[error("opening `{name}`: the section at ({:.3}, {:.3}, {:.3}) is not one simple loop: shift the plane along the vessel by about a radius", at.x, at.y, at.z)]
    NotSimple {
        /// Name of the opening.
        name: String,
        /// Its centre.
        at: Point,
    },
}

impl Error {
    /// Name of the opening that cannot be made.
    pub fn opening(&self) -> &str {
        match self {
            Error::Misses { name, .. } | Error::Ring { name, .. } | Error::NothingLeft { name, .. } | Error::TakesOff { name, .. } | Error::NotSimple { name, .. } => name,
        }
    }
}

/// The wall and the openings as patches, by id.
pub fn patches(openings: &[Opening]) -> Vec<Patch> {
    let mut all = vec![Patch::wall()];
    all.extend(openings.iter().map(|o| Patch { id: o.id, name: o.name.clone(), kind: o.kind }));
    all.sort_by_key(|p| p.id);
    all
}

#[cfg(test)]
mod tests;
