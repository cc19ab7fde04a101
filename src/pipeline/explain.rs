//! Decisions in sentences, for `-v`.

use crate::mask::{ChangeKind, CleaningReport};
use crate::openings::{FoundBy, Opening};

/// What was repaired in the mask, a sentence a kind.
pub(super) fn cleaning(report: &CleaningReport) -> Vec<String> {
    let word = |kind: ChangeKind| match kind {
        ChangeKind::IslandDropped => "islands dropped (input.components, input.cleaning.min_island)",
        ChangeKind::CavityFilled => "enclosed cavities filled (input.cleaning.fill_cavities)",
        ChangeKind::BorderHoleFilled => "holes at the picture's border filled (input.cleaning.max_hole)",
        ChangeKind::TunnelClosed => "tunnels closed (input.cleaning.max_hole)",
        ChangeKind::ContactFilled => "voxels added where others touched at an edge or corner only (input.cleaning.contacts)",
        ChangeKind::ContactCut => "voxels taken away where they touched others at an edge or corner only (input.cleaning.contacts)",
    };
    if report.totals.is_empty() {
        return vec!["the mask needs no repair".into()];
    }
    report.totals.iter().map(|t| format!("{} {}, {} voxels in all", t.changes, word(t.kind), t.voxels)).collect()
}

/// Why there is an opening.
pub(super) fn opening(o: &Opening) -> String {
    let why = match o.found_by {
        FoundBy::User => "given under openings.planes",
        FoundBy::ImageBorder => "the vessel leaves the picture",
        FoundBy::BluntEnd => "the vessel ends bluntly",
    };
    let c = o.plane.origin;
    format!("{}: {why} at ({:.2}, {:.2}, {:.2}) mm, radius {:.2} mm, confidence {:.2}", o.name, c.x, c.y, c.z, o.radius, o.confidence)
}
