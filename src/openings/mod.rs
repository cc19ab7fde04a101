//! Inlets and outlets: detection, plane cuts, caps, flow extensions.

use serde::Serialize;

use crate::geometry::Plane;
use crate::mesh::{PatchId, PatchKind};

/// How an opening was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FoundBy {
    /// Given in the YAML.
    User,
    /// The vessel leaves the image there.
    ImageBorder,
    /// A blunt end of the vessel inside the image.
    BluntEnd,
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
    /// Radius of the largest inscribed sphere at the plane, mm: tells which branch is meant.
    pub radius: f64,
    /// How it was found.
    pub found_by: FoundBy,
    /// 0 to 1; 1 for planes given by the user.
    pub confidence: f64,
    /// Connected component of the mask that it belongs to.
    pub component: u32,
}
