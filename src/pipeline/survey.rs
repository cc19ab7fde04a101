//! What a case holds, before anything is meshed.

use super::Part;
use crate::centerline::{self, Centerlines, ClosePlace, ThinPlace};
use crate::mask::{CleaningReport, Mask};
use crate::openings::{BlindEnd, DetectReport, Opening};
use crate::report::Report;

/// Fewest voxels across at which a vessel's section is still round.
const VOXELS_ACROSS: f64 = 4.0;

/// Sizes, ends, and places that deserve a look.
#[derive(Debug, Clone)]
pub struct Survey {
    /// The cleaned mask.
    pub mask: Mask,
    /// What cleaning found and did.
    pub cleaning: CleaningReport,
    /// Centerlines of all components.
    pub centerlines: Centerlines,
    /// Openings in the order of their ids.
    pub openings: Vec<Opening>,
    /// Area of the mask's section at each opening that was found, mm²; `None` for planes given.
    pub areas: Vec<Option<f64>>,
    /// Ends that stay closed, with the reason.
    pub blind: Vec<BlindEnd>,
    /// Vessels of less than four voxels across, narrowest first.
    pub thin: Vec<ThinPlace>,
    /// Vessels one voxel apart.
    pub close: Vec<ClosePlace>,
    /// Smallest, median and largest radius of inscribed spheres along the axes, mm.
    pub radius: [f64; 3],
    /// Smallest and largest edge length that the surface would get, mm.
    pub edge_length: [f64; 2],
    /// Triangles that may be expected.
    pub predicted_faces: usize,
    /// Warnings and the stages' summaries.
    pub report: Report,
}

impl Survey {
    pub(super) fn new(
        mask: Mask,
        cleaning: CleaningReport,
        centerlines: Centerlines,
        parts: &[Part],
        (openings, detected): (Vec<Opening>, DetectReport),
        report: Report,
    ) -> Survey {
        let mut radii: Vec<f64> = centerlines.branches.iter().flat_map(|b| &b.samples).map(|s| s.radius).collect();
        radii.sort_by(f64::total_cmp);
        let at = |q: f64| radii.get(((radii.len().max(1) - 1) as f64 * q) as usize).copied().unwrap_or(0.0);
        let guidance = parts.iter().map(|p| &p.guidance);
        let least = guidance.clone().map(|g| g.min).fold(f64::INFINITY, f64::min);
        let most = guidance.clone().map(|g| g.max).fold(0.0, f64::max);
        let area = |o: &Opening| detected.found.iter().find(|f| f.center == o.plane.origin).map(|f| f.area);
        Survey {
            thin: centerline::thin_places(&centerlines, &mask, VOXELS_ACROSS),
            close: centerline::close_places(&centerlines, &mask),
            radius: [at(0.0), at(0.5), at(1.0)],
            edge_length: [least, most],
            predicted_faces: guidance.map(|g| g.predicted_faces).sum(),
            areas: openings.iter().map(area).collect(),
            blind: detected.blind,
            mask,
            cleaning,
            centerlines,
            openings,
            report,
        }
    }
}
