//! Decisions in sentences, for `-v`.

use crate::mask::{Change, ChangeKind, CleaningReport};
use crate::openings::{BlindEnd, FoundBy, Opening};

/// Part of the kept lumen above which a dropped island is told, whoever asks.
const LARGE_ISLAND: f64 = 0.02;

/// What was repaired in the mask, a sentence a kind.
pub(super) fn cleaning(report: &CleaningReport) -> Vec<String> {
    let word = |kind: ChangeKind| match kind {
        ChangeKind::IslandDropped => "islands dropped (input.components, input.cleaning.min_island)",
        ChangeKind::CavityFilled => "enclosed cavities filled (a lumen has none)",
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

/// Parts dropped as islands that are large enough to be vessels, a sentence each.
pub(super) fn large_islands(report: &CleaningReport, kept: usize) -> Vec<String> {
    let large = |c: &&Change| c.kind == ChangeKind::IslandDropped && c.voxels as f64 > LARGE_ISLAND * kept as f64;
    let tell = |c: &Change| {
        let percent = 100.0 * c.voxels as f64 / kept as f64;
        let [x, y, z] = c.center;
        format!(
            "a part of {} voxels, {percent:.0} % of what is kept, was dropped at ({x:.1}, {y:.1}, {z:.1}) mm: input.components: all keeps it as a vessel of its own",
            c.voxels
        )
    };
    report.changes.iter().filter(large).map(tell).collect()
}

/// Ends named in a progress line.
const NAMED: usize = 6;

/// Openings and closed ends in one line, before anything is meshed.
pub(super) fn ends(openings: &[Opening], blind: &[BlindEnd]) -> String {
    let one = |o: &Opening| {
        let c = o.plane.origin;
        let diameter = 2.0 * (o.support.square_area / std::f64::consts::PI).sqrt();
        format!("{} {diameter:.2} mm across at ({:.1}, {:.1}, {:.1})", o.name, c.x, c.y, c.z)
    };
    let named: Vec<String> = openings.iter().take(NAMED).map(one).collect();
    let more = if openings.len() > NAMED { format!(" and {} more", openings.len() - NAMED) } else { String::new() };
    let closed = if blind.is_empty() { String::new() } else { format!("; {} closed", blind.len()) };
    format!("{} openings{}{}{more}{closed}", openings.len(), if named.is_empty() { "" } else { ": " }, named.join("; "))
}

/// Why there is an opening.
pub(super) fn opening(o: &Opening) -> String {
    let why = match o.found_by {
        FoundBy::User => "given under openings.planes",
        FoundBy::ImageBorder => "the vessel leaves the image",
        FoundBy::FlatFace => "the vessel is cut flat",
        FoundBy::BluntEnd => "the vessel ends bluntly",
        FoundBy::SurfaceRim => "the surface has a rim or flat cap there",
    };
    let c = o.plane.origin;
    format!("{}: {why} at ({:.2}, {:.2}, {:.2}) mm, radius {:.2} mm, confidence {:.2}", o.name, c.x, c.y, c.z, o.radius, o.confidence)
}
