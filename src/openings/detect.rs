//! Ends of vessels found from the centerline and the mask.
//!
//! Every free end of the centerline is either an opening or a blind end with its reason.
//!
//! *Leaving the image*: the free end lies at or beyond the border of the picture and lumen voxels stand on that
//! border. The cut is square to the axis at the first place whose whole section lies inside the picture.
//!
//! *A blunt end* inside the image is cut at the first place, from half a radius and a voxel behind a flat tip and nine
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
//! it is a bump whatever its tip when it is shorter than wide, L ≤ D.

use serde::Serialize;

use super::axis::axis;
use super::names::{self, Sized};
use super::section::{Section, section};
use super::{FoundBy, Opening};
use crate::centerline::{Branch, Centerlines, EndKind};
use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;
use crate::mesh::PatchKind;

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
}

/// A free end of the centerline that stays closed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BlindEnd {
    /// Where the centerline ends, LPS mm.
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
}

/// Finds the openings of every component. The mask must be the one that the centerlines come from.
///
/// Openings come by id; see the module on names for their order. Never fails: a component without openings stands
/// in the warnings.
pub fn detect(mask: &Mask, lines: &Centerlines, options: &DetectOptions) -> (Vec<Opening>, DetectReport) {
    let mut report = DetectReport::default();
    let mut found: Vec<(Sized, FoundEnd)> = Vec::new();
    for (n, branch) in lines.branches.iter().enumerate() {
        for end in 0..2 {
            if branch.ends[end] != EndKind::Free || branch.samples.len() < 2 {
                continue;
            }
            let walk = Walk::new(branch, end);
            match one(mask, lines, n, &walk, options, &mut report.warnings) {
                Ok(f) => found.push(f),
                Err(reason) => {
                    let (length, radius) = walk.outside();
                    let component = branch.component;
                    report.blind.push(BlindEnd { tip: walk.point[0], reason, radius, length, component });
                }
            }
        }
    }
    let (mut sized, tips): (Vec<Sized>, Vec<FoundEnd>) = found.into_iter().unzip();
    names::choose_inlets(&mut sized);
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

/// A branch seen from its free end.
pub(super) struct Walk {
    pub point: Vec<Point>,
    /// Unit tangents towards the tip.
    pub outward: Vec<Vector>,
    pub radius: Vec<f64>,
    /// Distance from the tip along the axis.
    pub arc: Vec<f64>,
    /// The other end is a junction with this radius.
    pub junction: Option<f64>,
}

impl Walk {
    pub fn new(branch: &Branch, end: usize) -> Walk {
        let mut s = branch.samples.clone();
        let sign = if end == 0 { -1.0 } else { 1.0 };
        if end == 1 {
            s.reverse();
        }
        let total = branch.length();
        let arc = s.iter().map(|s| if end == 0 { s.arc_length } else { total - s.arc_length }).collect();
        let radius: Vec<f64> = s.iter().map(|s| s.radius).collect();
        let junction = (branch.ends[1 - end] == EndKind::Junction).then(|| radius[radius.len() - 1]);
        Walk { point: s.iter().map(|s| s.point).collect(), outward: s.iter().map(|s| s.tangent * sign).collect(), radius, arc, junction }
    }

    fn total(&self) -> f64 {
        self.arc[self.arc.len() - 1]
    }

    /// Samples outside the junction's sphere.
    fn free(&self) -> usize {
        let reach = self.total() - self.junction.unwrap_or(0.0);
        self.arc.partition_point(|&t| t < reach).max(1)
    }

    /// Length outside the junction's sphere and the largest radius there.
    fn outside(&self) -> (f64, f64) {
        let n = self.free();
        let length = (self.total() - self.junction.unwrap_or(0.0)).max(0.0);
        (length, self.radius[..n].iter().fold(0.0, |a, &b| a.max(b)))
    }

    /// Position, outward direction and radius at a distance from the tip; the direction is averaged over
    /// half a radius towards the tip and one radius away from it.
    fn at(&self, t: f64, keep: impl Fn(&Point) -> bool) -> (Point, Vector, f64) {
        let i = self.arc.partition_point(|&a| a < t).clamp(1, self.arc.len() - 1);
        let f = ((t - self.arc[i - 1]) / (self.arc[i] - self.arc[i - 1])).clamp(0.0, 1.0);
        let p = self.point[i - 1] + (self.point[i] - self.point[i - 1]) * f;
        let r = self.radius[i - 1] + (self.radius[i] - self.radius[i - 1]) * f;
        let own = self.outward[i - 1] * (1.0 - f) + self.outward[i] * f;
        let mut d = own * 1e-6;
        for j in 0..self.free() {
            let x = (self.arc[j] - t) / r;
            let w = if x < 0.0 { 1.0 + x / 0.5 } else { 1.0 - x / 1.0 };
            if w > 0.0 && keep(&self.point[j]) {
                d += self.outward[j] * w;
            }
        }
        (p, d.try_normalize(0.0).unwrap_or(own), r)
    }
}

impl Walk {
    /// Position, direction square to the sections, and radius at a distance from the tip.
    ///
    /// Near a tip the centerline may turn aside by more than a right angle's half: its direction there, a radius and
    /// two further in, and the way from there are each made square; the one with the smallest section half a radius
    /// further in, away from the tip, is the vessel's.
    fn square(&self, mask: &Mask, t: f64, inwards: f64, border: bool) -> (Point, Vector, f64) {
        let usable = |p: &Point| !border || in_image(mask, p);
        let whole = |plane: &Plane, reach: f64| !border || disc_inside(mask, plane, reach);
        let (p, own, r) = self.at(t, usable);
        let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
        let far = t + (2.0 * r).min(inwards);
        let further: [(Point, Vector, f64); 2] = [0.5, 1.0].map(|f| self.at(t + f * (far - t), usable));
        let mut guesses = vec![own, further[0].1, further[1].1];
        guesses.extend((p - further[1].0).try_normalize(0.1 * r));
        let mut best: Option<(f64, Point, Vector)> = None;
        for guess in guesses {
            if best.as_ref().is_some_and(|b| b.2.dot(&guess) > 0.98) {
                continue;
            }
            let (q, d) = axis(mask, &p, &guess, r, inwards, whole);
            let inside = Plane::new(q - d * (0.5 * r).min(inwards), d);
            let area = inside.and_then(|plane| section(mask, &plane, 4.0 * r + 2.0 * voxel)).map_or(f64::INFINITY, |s| s.area);
            if best.as_ref().is_none_or(|b| area < 0.97 * b.0) {
                best = Some((area, q, d));
            }
        }
        best.map_or((p, own, r), |b| (b.1, b.2, r))
    }
}

fn one(
    mask: &Mask,
    lines: &Centerlines,
    branch: usize,
    walk: &Walk,
    options: &DetectOptions,
    warnings: &mut Vec<String>,
) -> Result<(Sized, FoundEnd), BlindReason> {
    let border = leaves_image(mask, &walk.point[0]);
    let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    let flat = flatness(mask, walk, voxel);
    if !border {
        if let Some(reason) = blind(lines, branch, walk, options, flat) {
            return Err(reason);
        }
    }
    let inside = |p: &Point| in_image(mask, p);
    let (length, _) = walk.outside();
    let farthest = if walk.junction.is_some() { length.max(0.3 * walk.total()) } else { 0.5 * walk.total() };
    let from_tip = if flat { options.tip_radii * walk.radius[0] + voxel } else { options.dome_radii * walk.radius[0] + 0.5 * voxel };
    let first = if border { 0.0 } else { from_tip };
    let mut best: Option<(f64, f64, Plane, f64, Section)> = None;
    let mut settled_at: Option<f64> = None;
    let mut t = first.min(farthest);
    loop {
        let (p, d, r) = walk.square(mask, t, farthest - t, border);
        let looked = Plane::new(p, d).and_then(|plane| {
            let s = section(mask, &plane, 4.0 * r + 2.0 * voxel)?;
            Some((plane, s))
        });
        if let Some((plane, s)) = looked {
            let whole = !border || disc_inside(mask, &plane, s.reach.min(2.5 * r));
            let further = walk.at((t + r).min(farthest), |p| !border || inside(p));
            // Square to the same axis: near a tip the centerline's own direction is no measure.
            let next = Plane::new(further.0, d).and_then(|q| section(mask, &q, 4.0 * further.2 + 2.0 * voxel));
            let settled = options.settled - 0.1 * (voxel / r).min(1.0);
            let grown = next.is_some_and(|n| s.area < settled * n.area.min(1.5 * s.area) && n.area < 2.0 * s.area);
            // Thin sections are too rough to tell; in a vessel that widens for long the first places are as good.
            let late = t > first + 1.25 * r;
            if whole && (border || late || !grown) {
                let from = *settled_at.get_or_insert(t);
                let ratio = s.area / (std::f64::consts::PI * r * r);
                let badness = (ratio / options.max_area_ratio).max(s.aspect / 2.0).max(if s.clipped { 9.0 } else { 0.0 });
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
        let (p, d, r) = walk.square(mask, t, farthest - t, border);
        best = Plane::new(p, d).and_then(|plane| Some((2.0, walk.radius[0].min(farthest), plane, r, section(mask, &plane, 4.0 * r + 2.0 * voxel)?)));
    }
    let Some((badness, from_tip, plane, radius, s)) = best else { return Err(BlindReason::NoSection) };
    let diameters = length / (2.0 * radius);
    let mut confidence = if border { 1.0 } else { (0.6 + 0.2 * f64::from(flat) + 0.05 * (diameters - 1.0)).clamp(0.5, 0.95) };
    if badness > 1.0 {
        confidence *= 0.7;
        warnings.push(format!(
            "the section at {:.3?} is irregular ({:.2} times its inscribed circle, aspect {:.1}): check this opening",
            plane.origin.coords.as_slice(),
            s.area / (std::f64::consts::PI * radius * radius),
            s.aspect
        ));
    }
    let opening = Opening {
        id: 0,
        name: String::new(),
        kind: PatchKind::Outlet,
        plane,
        radius,
        found_by: if border { FoundBy::ImageBorder } else { FoundBy::BluntEnd },
        confidence,
        component: lines.branches[branch].component,
    };
    let end = FoundEnd { name: String::new(), center: plane.origin, tip: walk.point[0], from_tip, area: s.area };
    Ok((Sized { opening, area: s.area, fixed: false }, end))
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
        let (p, d, r) = walk.at(t.min(walk.total()), |_| true);
        Plane::new(p, d).and_then(|q| section(mask, &q, 4.0 * r + 2.0 * voxel)).map_or(0.0, |s| s.area)
    };
    // A half ball reaches 80 % of its section at 0.55 radii, a blunt end at once but for voxel stairs.
    let early = 0.2 * r + 0.75 * voxel;
    early < 0.45 * r && area(early) >= 0.8 * area(1.2 * r)
}

/// Whether the tip lies at or beyond the picture's border where lumen stands on that border.
fn leaves_image(mask: &Mask, tip: &Point) -> bool {
    let x = mask.grid.to_index(tip);
    (0..3).any(|a| {
        let [low, high] = mask.image[a];
        let face = if x[a] <= low as f64 + 1.0 {
            low
        } else if x[a] >= high as f64 - 1.0 {
            high
        } else {
            return false;
        };
        let mut v = [0, 1, 2].map(|b| (x[b].round() as i64).clamp(mask.image[b][0], mask.image[b][1]));
        v[a] = face;
        (-1..=1).any(|p| {
            (-1..=1).any(|q| {
                let mut w = v;
                w[(a + 1) % 3] += p;
                w[(a + 2) % 3] += q;
                mask.at(w[0], w[1], w[2])
            })
        })
    })
}

fn in_image(mask: &Mask, p: &Point) -> bool {
    let x = mask.grid.to_index(p);
    (0..3).all(|a| x[a] >= mask.image[a][0] as f64 && x[a] <= mask.image[a][1] as f64)
}

/// Whether the disc lies between the centres of the picture's outermost voxels.
fn disc_inside(mask: &Mask, plane: &Plane, radius: f64) -> bool {
    let (u, v) = plane.basis();
    (0..16).all(|n| {
        let (s, c) = (std::f64::consts::TAU * f64::from(n) / 16.0).sin_cos();
        in_image(mask, &(plane.origin + (u * c + v * s) * radius))
    })
}
