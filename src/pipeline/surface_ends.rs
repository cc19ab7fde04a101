//! The ends of a given surface among the openings.

use super::input::Source;
use super::surface::GivenSurface;
use super::{Draft, Error, Part, results, surface};
use crate::centerline::{Centerlines, EndKind};
use crate::geometry::Point;
use crate::mesh::TriMesh;
use crate::openings::{self, DetectReport, FoundBy, Opening, RimEnd};
use crate::quality::fidelity::{self, Cut, ToSurface};

/// Whether a place belongs to what was given, not to what was added to a surface.
pub(super) fn is_given(source: &Source, p: &Point) -> bool {
    !matches!(source, Source::Surface(given) if surface::is_added(given, p))
}

/// The centerlines with the ends that lie in what was added to a surface no longer free: those are known.
pub(super) fn other_ends(source: &Source, lines: &Centerlines) -> Centerlines {
    let mut lines = lines.clone();
    let Source::Surface(given) = source else { return lines };
    for b in &mut lines.branches {
        let tips = [b.samples.first(), b.samples.last()].map(|s| s.is_some_and(|s| surface::is_added(given, &s.point)));
        for (end, known) in b.ends.iter_mut().zip(tips) {
            if known {
                *end = EndKind::Junction;
            }
        }
    }
    lines
}

/// The centerlines without what lies in what was added to a surface: nothing of the vessel is lost with that.
pub(super) fn within(source: &Source, mut lines: Centerlines) -> Centerlines {
    if let Source::Surface(given) = source {
        lines.branches.iter_mut().for_each(|b| b.samples.retain(|s| !surface::is_added(given, &s.point)));
    }
    lines
}

/// The ends of the surface joined with those that were found.
pub(super) fn join(source: &Source, drafts: &[Draft], detected: Vec<Opening>, summary: &mut DetectReport) -> Vec<Opening> {
    let Source::Surface(given) = source else { return detected };
    let rim = |e: &crate::mesh::ends::SurfaceEnd| {
        let inside = e.center - e.direction * (0.1 * e.radius);
        let wall = |n: usize| drafts[n].implicit.value(&inside);
        // A part that cleaning dropped has no end.
        let component = (0..drafts.len()).filter(|&n| wall(n) < 0.0).min_by(|&a, &b| wall(a).total_cmp(&wall(b)))?;
        Some(RimEnd { plane: e.plane(), radius: e.radius, area: e.area, axis: e.direction, component: component as u32 })
    };
    let rims: Vec<RimEnd> = given.ends.iter().filter_map(rim).collect();
    let joined = openings::join_rims(detected, &rims, summary);
    for component in 0..drafts.len() {
        let own = joined.iter().filter(|o| o.component as usize == component).count();
        if own > 1 {
            let few = format!("component {} has ", component + 1);
            summary.warnings.retain(|w| !w.starts_with(&few));
        }
    }
    joined
}

/// The result held against the surface as it was given.
pub(super) fn fidelity(given: &GivenSurface, surface: &TriMesh, parts: &[Part], cuts: &[Cut]) -> Result<ToSurface, Error> {
    let vessel = results::without_extensions(surface, parts);
    let measured = fidelity::to_surface(&vessel, &given.given, cuts, &Default::default())?;
    let ends = || parts.iter().flat_map(|p| &p.ends);
    let whole = ends().count() == given.ends.len() && ends().all(|o| o.found_by == FoundBy::SurfaceRim) && parts.iter().all(|p| p.extensions.is_empty());
    Ok(ToSurface { volume_ratio: whole.then(|| surface.volume() / given.given.volume()), ..measured })
}
