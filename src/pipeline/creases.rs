//! The surface made fit to be filled: creases that would bind the tetrahedra at them are softened, and reported.

use super::cutting::carriers;
use super::{Context, Part};
use crate::config::Case;
use crate::mask::Mask;
use crate::report::Report;
use crate::volume::creases::{self, CreaseOptions};

/// How far from the implicit wall a vertex may be moved, in voxels: a quarter of what the mask resolves at best.
const MAX_DISTANCE: f64 = 0.25;

/// How far the wall may be changed for the volume's sake.
pub(super) fn options(case: &Case, mask: &Mask) -> CreaseOptions {
    let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    CreaseOptions { max_skewness: case.surface.target_skewness, max_distance: MAX_DISTANCE * voxel, ..CreaseOptions::default() }
}

/// Softens the creases of all components.
pub fn soften(case: &Case, mask: &Mask, parts: &mut [Part], report: &mut Report, context: &Context) {
    let options = options(case, mask);
    let mut all = Vec::new();
    for part in parts.iter_mut() {
        let Some((mesh, found)) = creases::soften(&part.surface, &carriers(part), &options) else { continue };
        part.surface = mesh;
        all.extend(found);
    }
    if all.is_empty() {
        return;
    }
    let left = all.iter().filter(|c| c.change.is_none()).count();
    context.progress.explain(&format!(
        "{} creases of the wall under {}° inside were softened, {left} could not be",
        all.len() - left,
        options.least_angle
    ));
    if let Some(c) = all.iter().find(|c| c.change.is_none()) {
        report.warn(
            "surface",
            format!(
                "{left} creases of the wall are left, the sharpest {:.0}° inside near ({:.2}, {:.2}, {:.2}) mm: cells there may be \
                 flat; shorter edges there (surface.refine) help",
                c.angle, c.at.x, c.at.y, c.at.z
            ),
        );
    }
    report.put_in("remeshing", "creases", &all);
}
