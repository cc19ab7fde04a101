//! Ends of vessels found from the mask's boundary, and from the centerline where the boundary says nothing.
//!
//! Every flat face, every region of lumen on the image's border and every other free end of the centerline is either
//! an opening or a closed end with its reason.
//!
//! *Flat faces and border regions* are found without the centerline: see [`super::faces`], [`super::border`] and, for
//! their planes, [`super::evidence`]. A free end of the centerline at one of them is that end.
//!
//! *A round end* inside the image is cut at the first place, from half a radius and a voxel behind a flat tip and nine
//! tenths of a radius behind a dome on, at which the section has settled: its area is no longer growing, and it is no
//! wider than a vessel's. The plane is square to the line through the middles of the sections round it.
//!
//! *A sac is told from a stub* by these rules, each on the part of the branch outside its junction's sphere; R is its
//! largest radius, D = 2R, L its length up to the tip. It is a sac, unless its tip is flat as a cut is, when
//! 1. it widens towards the tip: R ≥ 1.2 times the radius at its neck, neck to tip is no longer than 3 R, and the
//!    vessel behind the neck, where there are 3 R of it, is narrower than R too (else the neck is a stenosis); or
//! 2. it is wider than all vessels at its junction: the upper quartile of its radii ≥ 1.3 times their medians, and L ≤ 3.5 D, and its radius
//!    varies by a quarter (10 % to 90 % of its samples) or L ≤ 1.5 D; and
//!
//! it is a bump whatever its tip when it is shorter than wide, L ≤ D; or
//! 3. two ends or more were cut flat or by the border, and it is 1.3 times as wide as the widest of them.
//!
//! *A cut takes off its own branch only*: see [`super::shared`].

use serde::Serialize;

use super::border::AtBorder;
use super::evidence::{CutDirection, Evidence, Face};
use super::names::{self, Sized};
use super::removed::removed;
use super::section::{Section, section};
use super::shared::{self, Ending};
use super::walk::Walk;
use super::{FoundBy, Opening, Support};
use crate::centerline::{Centerlines, EndKind};
use crate::geometry::{Plane, Point};
use crate::mask::Mask;
use crate::mesh::PatchKind;

/// Radii from the tip beyond which the section is no longer waited for to settle.
const LATEST: f64 = 2.0;

/// How ends are told apart.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DetectOptions {
    /// Least distance of a cut from a tip that is flat, in radii; a voxel is added.
    pub tip_radii: f64,
    /// The same where the tip is a dome, whose section is whole one radius behind its tip only.
    pub dome_radii: f64,
    /// A section has settled when its area is at least this part of that one radius further inwards.
    pub settled: f64,
    /// Farthest shift inwards while the section is irregular, in radii.
    pub shift_radii: f64,
    /// A section of more than this many times the inscribed circle's area is irregular.
    pub max_area_ratio: f64,
    /// Rule 1: a tip this much wider than its neck is a sac.
    pub sac_widening: f64,
    /// Rule 2: an end this much wider than the vessels at its junction is a sac.
    pub sac_width: f64,
    /// Ends shorter than this many diameters outside their junction's sphere are bumps.
    pub bump_diameters: f64,
    /// How ends with a flat face are cut.
    pub cut: CutDirection,
    /// A section is left closed where it is this many times as irregular as `max_area_ratio` and an aspect of 2 allow.
    pub irregular: f64,
    /// A round end whose cut would take off more than this part of the lumen stays closed.
    pub most_of_the_lumen: f64,
    /// A round end whose section is above this many times its inscribed circle stays closed.
    pub largest_section: f64,
}

impl Default for DetectOptions {
    fn default() -> Self {
        DetectOptions {
            tip_radii: 0.5,
            dome_radii: 0.9,
            settled: 0.95,
            shift_radii: 2.0,
            max_area_ratio: 1.6,
            sac_widening: 1.2,
            sac_width: 1.3,
            bump_diameters: 1.0,
            cut: CutDirection::Auto,
            irregular: 1.25,
            most_of_the_lumen: 0.2,
            largest_section: 4.0,
        }
    }
}

/// Why a free end is not opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlindReason {
    /// It widens towards its tip behind a neck.
    SacWithNeck,
    /// It is wider than the vessels that it stands on.
    WideSac,
    /// It is shorter than wide.
    Bump,
    /// No place along it has a section that a plane could cut.
    NoSection,
    /// The opening of another end near by takes it off too.
    SharedOpening,
    /// Each of its sections runs through another vessel, which a cut would take off.
    SharedSection,
    /// Its section is far larger than its inscribed circle.
    LargeSection,
    /// A cut would take off more than its tip.
    TakesMore,
    /// The vessel runs along the image's border there.
    GrazesBorder,
    /// A sac is cropped by the image's border.
    CroppedSac,
}

impl BlindReason {
    /// Whether a vessel ends there that could not be cut, and not a sac or bump.
    pub fn is_of_a_vessel(self) -> bool {
        matches!(self, BlindReason::NoSection | BlindReason::SharedSection | BlindReason::LargeSection | BlindReason::TakesMore)
    }
}

/// An end that stays closed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BlindEnd {
    /// Where it ends, LPS mm.
    pub tip: Point,
    /// Why it is not opened.
    pub reason: BlindReason,
    /// Largest radius along it, mm.
    pub radius: f64,
    /// Length from the junction's sphere to the tip, mm.
    pub length: f64,
    /// Component.
    pub component: u32,
}

/// What stands behind an opening.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoundEnd {
    /// Name of the opening.
    pub name: String,
    /// Origin of the opening's plane, LPS mm.
    pub center: Point,
    /// Where the centerline ends, LPS mm.
    pub tip: Point,
    /// Distance of the plane from the tip along the axis, mm.
    pub from_tip: f64,
    /// Area of the mask's section, mm².
    pub area: f64,
}

/// What detection saw.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct DetectReport {
    /// One entry for each opening, in their order.
    pub found: Vec<FoundEnd>,
    /// Free ends that stay closed.
    pub blind: Vec<BlindEnd>,
    /// Sentences for people.
    pub warnings: Vec<String>,
    /// Inlets that were a close choice, a sentence each.
    pub close_choices: Vec<String>,
}

/// Finds the openings of every component. The mask must be the one that the centerlines come from; `evidence` has one
/// entry a component.
///
/// Openings come by id; see the module on names for their order. Never fails: a component without openings stands
/// in the warnings.
pub fn detect(mask: &Mask, lines: &Centerlines, evidence: &[Evidence], options: &DetectOptions) -> (Vec<Opening>, DetectReport) {
    let mut report = DetectReport::default();
    let mut found: Vec<(Sized, FoundEnd)> = Vec::new();
    for (component, own) in evidence.iter().enumerate() {
        let component = component as u32;
        for region in &own.regions {
            match region.kind {
                AtBorder::Leaves => found.push(opened(mask, &Face::from(region), FoundBy::ImageBorder, component, options, &mut report.warnings)),
                kind => report.blind.push(at_border(region, kind, component, &mut report.warnings)),
            }
        }
        for face in &own.faces {
            // A face in the image's border is a border region already.
            let twice = |r: &super::BorderRegion| (r.plane.origin - face.plane.origin).norm() < 0.8 * r.radius().max(face.radius()) && r.plane.normal.dot(&face.plane.normal) > 0.5;
            if !own.regions.iter().any(twice) {
                found.push(opened(mask, &Face::from(face), FoundBy::FlatFace, component, options, &mut report.warnings));
            }
        }
    }
    let mut inside: Vec<(Leaving, BlindEnd)> = Vec::new();
    for (n, branch) in lines.branches.iter().enumerate() {
        for end in 0..2 {
            if branch.ends[end] != EndKind::Free || branch.samples.len() < 2 {
                continue;
            }
            let walk = Walk::new(branch, end);
            let tip = walk.point[0];
            if evidence.get(branch.component as usize).is_some_and(|e| accounts_for(e, &tip)) {
                continue;
            }
            match one(mask, lines, n, &walk, options) {
                Ok(f) => inside.push((f, blind_end(&walk, BlindReason::SharedOpening, branch.component))),
                Err(reason) => report.blind.push(blind_end(&walk, reason, branch.component)),
            }
        }
    }
    // A round end wider than the ends that were cut is no vessel's.
    let cut: Vec<f64> = found.iter().map(|f| f.0.opening.radius).collect();
    if cut.len() > 1 {
        let widest = options.sac_width * cut.into_iter().fold(0.0, f64::max);
        let (wide, others): (Vec<_>, Vec<_>) = inside.into_iter().partition(|(f, _)| (f.end.area / std::f64::consts::PI).sqrt() > widest);
        report.blind.extend(wide.into_iter().map(|(_, closed)| BlindEnd { reason: BlindReason::WideSac, ..closed }));
        inside = others;
    }
    let endings: Vec<Ending> = inside.iter().map(|(f, _)| f.ending()).collect();
    for ((f, closed), reason) in inside.into_iter().zip(shared::settle(&endings)) {
        match reason.or_else(|| f.takes_more(mask, options, &found)) {
            None => found.push(f.settled(&mut report.warnings)),
            Some(reason) => report.blind.push(BlindEnd { reason, ..closed }),
        }
    }
    let (mut sized, tips): (Vec<Sized>, Vec<FoundEnd>) = found.into_iter().unzip();
    report.close_choices = names::choose_inlets(&mut sized);
    let openings = names::assign(sized);
    for o in &openings {
        if let Some(f) = tips.iter().find(|f| f.center == o.plane.origin) {
            report.found.push(FoundEnd { name: o.name.clone(), ..f.clone() });
        }
    }
    let mut components: Vec<u32> = lines.branches.iter().map(|b| b.component).collect();
    components.sort_unstable();
    components.dedup();
    for c in components {
        let n = openings.iter().filter(|o| o.component == c).count();
        if n < 2 {
            report.warnings.push(format!(
                "component {} has {n} opening{}: flow needs an inlet and an outlet; give planes under `openings:`",
                c + 1,
                if n == 1 { "" } else { "s" }
            ));
        }
    }
    (openings, report)
}

/// Whether a free end of the centerline is one that a face or border region stands for.
fn accounts_for(evidence: &Evidence, tip: &Point) -> bool {
    let at_region = |r: &super::BorderRegion| match r.kind {
        AtBorder::Leaves | AtBorder::CroppedSac => r.holds(tip),
        // Ends of the vessel that runs along there are ends of their own.
        AtBorder::Grazes => r.holds(tip) && r.plane.signed_distance(tip) > -1.5 * r.voxel,
    };
    evidence.faces.iter().any(|f| f.closes(tip)) || evidence.regions.iter().any(at_region)
}

/// The opening that a face or border region stands for.
fn opened(mask: &Mask, face: &Face, found_by: FoundBy, component: u32, options: &DetectOptions, warnings: &mut Vec<String>) -> (Sized, FoundEnd) {
    let placed = face.placed(mask, options.cut);
    let at = placed.plane.origin;
    if placed.no_room {
        warnings.push(format!("the flat end at {:.1?} is cut along its face: a square cut (openings.cut) has no room there", at.coords.as_slice()));
    }
    let radius = (placed.expected / std::f64::consts::PI).sqrt();
    let support = Support { axis: face.axis, square_area: placed.square_area, expected_area: Some(placed.expected), along_face: placed.along };
    let opening = Opening {
        id: 0,
        name: String::new(),
        kind: PatchKind::Outlet,
        plane: placed.plane,
        radius,
        support,
        found_by,
        confidence: if found_by == FoundBy::ImageBorder { 1.0 } else { 0.95 },
        component,
    };
    let end = FoundEnd {
        name: String::new(),
        center: at,
        tip: face.plane.origin,
        from_tip: -face.plane.signed_distance(&at),
        area: placed.expected,
    };
    (Sized { opening, fixed: false }, end)
}

/// A border region that stays closed.
fn at_border(region: &super::BorderRegion, kind: AtBorder, component: u32, warnings: &mut Vec<String>) -> BlindEnd {
    let reason = if kind == AtBorder::CroppedSac { BlindReason::CroppedSac } else { BlindReason::GrazesBorder };
    let at = region.plane.origin;
    let what = match kind {
        AtBorder::CroppedSac => "a sac is cropped by the image's border",
        _ => "the vessel runs along the image's border",
    };
    if region.reach > 2.0 * region.voxel {
        let share = 100.0 * (1.0 - region.area / region.largest.max(region.area)).clamp(0.0, 1.0);
        let narrower = if share >= 1.0 { format!(", {share:.0} % less than the section behind") } else { String::new() };
        warnings.push(format!(
            "{what} at ({:.1}, {:.1}, {:.1}) mm, over {:.1} mm2{narrower}: it is closed flat there; give a plane under `openings:` where it is an end",
            at.x, at.y, at.z, region.area
        ));
    }
    BlindEnd { tip: at, reason, radius: region.radius(), length: 0.0, component }
}

fn blind_end(walk: &Walk, reason: BlindReason, component: u32) -> BlindEnd {
    let (length, radius) = walk.outside();
    BlindEnd { tip: walk.point[0], reason, radius, length, component }
}

fn one(
    mask: &Mask,
    lines: &Centerlines,
    branch: usize,
    walk: &Walk,
    options: &DetectOptions,
) -> Result<Leaving, BlindReason> {
    let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    let flat = flatness(mask, walk, voxel);
    if let Some(reason) = blind(lines, branch, walk, options, flat) {
        return Err(reason);
    }
    let (length, _) = walk.outside();
    let farthest = if walk.junction.is_some() { length.max(0.3 * walk.total()) } else { 0.5 * walk.total() };
    let from_tip = if flat { options.tip_radii * walk.radius[0] + voxel } else { options.dome_radii * walk.radius[0] + 0.5 * voxel };
    let first = from_tip;
    let mut best: Option<(f64, f64, Plane, f64, Section)> = None;
    let mut settled_at: Option<f64> = None;
    let mut t = first.min(farthest);
    loop {
        let (p, d, r) = walk.square(mask, t, farthest - t);
        let looked = Plane::new(p, d).and_then(|plane| {
            let s = section(mask, &plane, 4.0 * r + 2.0 * voxel)?;
            Some((plane, s))
        });
        if let Some((plane, s)) = looked {
            let further = walk.at((t + r).min(farthest));
            // Square to the same axis: near a tip the centerline's own direction is no measure.
            let next = Plane::new(further.0, d).and_then(|q| section(mask, &q, 4.0 * further.2 + 2.0 * voxel));
            let settled = options.settled - 0.1 * (voxel / r).min(1.0);
            let grown = next.is_some_and(|n| s.area < settled * n.area.min(1.5 * s.area) && n.area < 2.0 * s.area);
            // Thin sections are too rough to tell; in a vessel that widens for long the first places are as good.
            let late = t > (first + 1.25 * r).min(LATEST * r).max(first);
            if late || !grown {
                let from = *settled_at.get_or_insert(t);
                let ratio = s.area / (std::f64::consts::PI * r * r);
                let taking = shared::takes_off(lines, &shared::others(lines, branch, &plane, &s), &plane, r);
                let badness = (ratio / options.max_area_ratio).max(s.aspect / 2.0).max(if s.clipped || taking { 9.0 } else { 0.0 });
                if best.as_ref().is_none_or(|b| badness < b.0) {
                    best = Some((badness, t, plane, r, s));
                }
                if badness <= 1.0 || t - from > options.shift_radii * r {
                    break;
                }
            }
        }
        if t >= farthest {
            break;
        }
        t = (t + 0.5 * voxel.max(0.1 * r)).min(farthest);
    }
    if best.is_none() {
        // Never settled: as far from the tip as may be is the best there is.
        let t = walk.radius[0].min(farthest);
        let (p, d, r) = walk.square(mask, t, farthest - t);
        best = Plane::new(p, d).and_then(|plane| Some((2.0, walk.radius[0].min(farthest), plane, r, section(mask, &plane, 4.0 * r + 2.0 * voxel)?)));
    }
    // The least bad place of several bad ones is no place to cut.
    let Some((badness, from_tip, plane, radius, s)) = best.filter(|b| b.0 <= options.irregular) else { return Err(BlindReason::NoSection) };
    let diameters = length / (2.0 * radius);
    // On a vessel of some length the opening should be as large as the section a radius further in.
    let further = Plane { origin: plane.origin - plane.normal * radius, normal: plane.normal };
    let inner = section(mask, &further, 4.0 * radius + 2.0 * voxel).filter(|_| diameters >= 2.0);
    let expected = inner.filter(|i| !i.clipped).map(|i| i.area);
    let confidence = (0.6 + 0.2 * f64::from(flat) + 0.05 * (diameters - 1.0)).clamp(0.5, 0.95);
    let opening = Opening {
        id: 0,
        name: String::new(),
        kind: PatchKind::Outlet,
        plane,
        radius,
        support: Support { axis: plane.normal, square_area: s.area, expected_area: expected, along_face: false },
        found_by: FoundBy::BluntEnd,
        confidence,
        component: lines.branches[branch].component,
    };
    let end = FoundEnd { name: String::new(), center: plane.origin, tip: walk.point[0], from_tip, area: s.area };
    let others = shared::others(lines, branch, &plane, &s);
    let takes_off = shared::takes_off(lines, &others, &plane, radius);
    Ok(Leaving { sized: Sized { opening, fixed: false }, end, badness, section: s, branch, others, takes_off })
}

/// An end with its place, before it is known how good that is.
struct Leaving {
    sized: Sized,
    end: FoundEnd,
    /// Above 1 the section is irregular.
    badness: f64,
    section: Section,
    branch: usize,
    /// Other branches that run out through the section.
    others: Vec<usize>,
    /// Whether one of them goes on.
    takes_off: bool,
}

impl Leaving {
    fn ending(&self) -> Ending {
        let o = &self.sized.opening;
        Ending {
            branch: self.branch,
            tip: self.end.tip,
            plane: o.plane,
            radius: o.radius,
            area: self.end.area,
            others: self.others.clone(),
            takes_off: self.takes_off,
        }
    }

    /// Why a cut there would be no cut of a tip, if it is none.
    fn takes_more(&self, mask: &Mask, options: &DetectOptions, faces: &[(Sized, FoundEnd)]) -> Option<BlindReason> {
        let o = &self.sized.opening;
        let area = self.end.area;
        if self.section.clipped || area > options.largest_section * std::f64::consts::PI * o.radius * o.radius {
            return Some(BlindReason::LargeSection);
        }
        let radius = (area / std::f64::consts::PI).sqrt();
        let longest = self.end.from_tip.max(2.0 * radius) + 2.0 * mask.grid.voxel_diagonal();
        let taken = removed(mask, &o.plane, self.section.points(&o.plane), 1.5 * area * longest);
        let beside = |f: &FoundEnd| {
            let d = f.center - o.plane.origin;
            d.norm() < longest + radius && o.plane.signed_distance(&f.center) > -0.5 * radius
        };
        let share = taken.volume / mask.volume();
        (taken.more || share > options.most_of_the_lumen || taken.length > 1.5 * longest || faces.iter().any(|f| f.0.opening.found_by != FoundBy::BluntEnd && beside(&f.1))).then_some(BlindReason::TakesMore)
    }

    /// The opening there; an irregular section costs confidence and is told.
    fn settled(mut self, warnings: &mut Vec<String>) -> (Sized, FoundEnd) {
        let o = &mut self.sized.opening;
        if self.badness > 1.0 {
            o.confidence *= 0.7;
            warnings.push(format!(
                "the section at {:.3?} is irregular ({:.2} times its inscribed circle, aspect {:.1}): check this opening",
                o.plane.origin.coords.as_slice(),
                self.section.area / (std::f64::consts::PI * o.radius * o.radius),
                self.section.aspect
            ));
        }
        (self.sized, self.end)
    }
}

/// Why this end is blind, if it is.
fn blind(lines: &Centerlines, branch: usize, walk: &Walk, options: &DetectOptions, flat: bool) -> Option<BlindReason> {
    let (length, radius) = walk.outside();
    if walk.junction.is_none() {
        return (walk.total() <= 2.5 * options.bump_diameters * radius).then_some(BlindReason::Bump);
    }
    if length <= 2.0 * options.bump_diameters * radius && !flat || length <= radius {
        return Some(BlindReason::Bump);
    }
    if flat {
        return None;
    }
    // From the tip to its widest place near by, then to the neck behind that.
    let n = walk.free();
    let r = &walk.radius[..n];
    let mut widest = 0;
    for i in 0..n {
        if r[i] > r[widest] && walk.arc[i] <= 3.0 * r[i] {
            widest = i;
        }
    }
    let mut neck = widest;
    for i in widest..n {
        if r[i] < r[neck] {
            neck = i;
        }
    }
    // Where the vessel behind the neck is as wide again for some length, the neck is a stenosis.
    let behind = (neck..n).filter(|&i| walk.arc[i] <= walk.arc[neck] + 6.0 * r[widest]);
    let long = walk.arc[n - 1] - walk.arc[neck] >= 3.0 * r[widest];
    let stenosis = long && options.sac_widening * quantile(behind.map(|i| r[i]), 0.75) > r[widest];
    if r[widest] >= options.sac_widening * r[neck] && walk.arc[neck] <= 3.0 * r[widest] && !stenosis {
        return Some(BlindReason::SacWithNeck);
    }
    // The vessels beyond the junction, or beyond the group of junctions that it belongs to.
    let groups = lines.groups();
    let group_of = |node: u32| groups[node as usize].map_or(u64::from(node) + (1 << 32), u64::from);
    let own = lines.branches[branch].nodes.map(group_of);
    let mut others: f64 = 0.0;
    for (m, b) in lines.branches.iter().enumerate() {
        let ends = b.nodes.map(group_of);
        let bridge = ends[0] == ends[1] && b.nodes[0] != b.nodes[1];
        if m != branch && !bridge && ends.iter().any(|n| own.contains(n)) {
            others = others.max(quantile(b.samples.iter().map(|s| s.radius), 0.5));
        }
    }
    let at = |q: f64| quantile(r.iter().copied(), q);
    let wide = others > 0.0 && at(0.75) >= options.sac_width * others && length <= 7.0 * at(0.75);
    // A vessel keeps its width; a sac does not, unless it is hardly longer than wide.
    let uneven = at(0.9) >= 1.25 * at(0.1) || length <= 3.0 * at(0.75);
    (wide && uneven).then_some(BlindReason::WideSac)
}

fn quantile(values: impl Iterator<Item = f64>, q: f64) -> f64 {
    let mut v: Vec<f64> = values.collect();
    v.sort_by(f64::total_cmp);
    v[((v.len() - 1) as f64 * q).round() as usize]
}

/// Whether the section is full right behind the tip, as a cut leaves it and a dome does not.
fn flatness(mask: &Mask, walk: &Walk, voxel: f64) -> bool {
    let r = walk.radius[0];
    let area = |t: f64| {
        let (p, d, r) = walk.at(t.min(walk.total()));
        Plane::new(p, d).and_then(|q| section(mask, &q, 4.0 * r + 2.0 * voxel)).map_or(0.0, |s| s.area)
    };
    // A half ball reaches 80 % of its section at 0.55 radii, a blunt end at once but for voxel stairs.
    let early = 0.2 * r + 0.75 * voxel;
    early < 0.45 * r && area(early) >= 0.8 * area(1.2 * r)
}
