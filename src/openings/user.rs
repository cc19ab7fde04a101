//! Planes, names and wishes of the user.

use serde::Serialize;

use super::border::{Region, along_face, disc_inside, in_image};
use super::names::{self, Sized};
use super::naming;
use super::section::section;
use super::{FoundBy, Opening};
use crate::centerline::{Centerlines, EndKind};
use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;
use crate::mesh::PatchKind;

/// A plane given by the user.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UserPlane {
    /// Patch name.
    pub name: String,
    /// A point on the plane within the branch, LPS mm.
    pub center: Point,
    /// Direction out of the vessel, any length.
    pub normal: Vector,
    /// Inlet or outlet; by the name where not given: `inlet…` is an inlet.
    pub kind: Option<PatchKind>,
}

/// What the user wants of the openings.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct UserOpenings {
    /// Planes; one within two radii of a detected opening replaces it.
    pub planes: Vec<UserPlane>,
    /// Names of detected openings to leave closed.
    pub drop: Vec<String>,
    /// Other names: from, to.
    pub rename: Vec<(String, String)>,
    /// Names of the openings that are inlets; all others of their components are outlets then.
    pub inlets: Vec<String>,
}

/// Why a wish cannot be met.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UserError {
    /// The normal has no direction.
    #[error("opening `{name}`: the normal {normal:?} has no direction; give a vector out of the vessel")]
    Normal {
        /// Opening.
        name: String,
        /// As given.
        normal: [f64; 3],
    },
    /// The centre lies outside the lumen.
    #[error("opening `{name}`: the plane's centre {center:.3?} misses the vessel by {distance:.3} mm; the nearest point of the axis is {nearest:.3?} (LPS mm): give a point inside the branch to be cut")]
    Misses {
        /// Opening.
        name: String,
        /// As given, LPS mm.
        center: [f64; 3],
        /// Distance from the inscribed sphere nearest to it, mm.
        distance: f64,
        /// Nearest point of the centerline, LPS mm.
        nearest: [f64; 3],
    },
    /// The plane's normal points along the wall.
    #[error("opening `{name}`: at {center:.3?} the normal is {angle:.0}° off the vessel's axis {axis:.3?}; the plane must cross the vessel: turn it to less than 75°")]
    Grazes {
        /// Opening.
        name: String,
        /// As given, LPS mm.
        center: [f64; 3],
        /// Angle, degrees.
        angle: f64,
        /// Axis there, out of the vessel.
        axis: [f64; 3],
    },
    /// The plane lies in a closed piece of the vessel that is no branch.
    #[error("opening `{name}`: the plane at {center:.3?} cuts a sac or junction (its section is {ratio:.1} times that of the inscribed sphere): move it along the branch")]
    Sac {
        /// Opening.
        name: String,
        /// As given, LPS mm.
        center: [f64; 3],
        /// Section area by the area of the inscribed circle.
        ratio: f64,
    },
    /// The normal points into the vessel: all of it would go.
    #[error("opening `{name}` at {center:.3?} would cut off {share:.0} % of the vessel and leave the tip: turn the normal round")]
    CutsEverything {
        /// Opening.
        name: String,
        /// As given, LPS mm.
        center: [f64; 3],
        /// Percentage of the centerline's length on the removed side.
        share: f64,
    },
    /// A name in `drop`, `rename` or `inlet` is unknown.
    #[error("there is no opening `{name}` to {wish}: {known}")]
    UnknownName {
        /// As given.
        name: String,
        /// What was wished.
        wish: &'static str,
        /// Names that exist, in words.
        known: String,
    },
    /// Two openings share a name.
    #[error("two openings are called `{name}`, at {:.3?} and {:.3?} (LPS mm): choose another name, or drop the one that was found", places[0], places[1])]
    SameName {
        /// The name.
        name: String,
        /// Where they are, LPS mm.
        places: [[f64; 3]; 2],
    },
}

impl UserError {
    /// Name of the opening at fault.
    pub fn opening(&self) -> &str {
        match self {
            UserError::Normal { name, .. }
            | UserError::Misses { name, .. }
            | UserError::Grazes { name, .. }
            | UserError::Sac { name, .. }
            | UserError::CutsEverything { name, .. }
            | UserError::UnknownName { name, .. }
            | UserError::SameName { name, .. } => name,
        }
    }
}

/// Applies the user's planes and names to detected openings; returns them by id, with warnings.
pub fn apply_user(
    mask: &Mask,
    lines: &Centerlines,
    detected: Vec<Opening>,
    user: &UserOpenings,
) -> Result<(Vec<Opening>, Vec<String>), UserError> {
    let mut warnings = Vec::new();
    let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    let area = |o: &Opening| section(mask, &o.plane, 4.0 * o.radius + 2.0 * voxel).map_or(0.0, |s| s.area);
    let mut list: Vec<Sized> =
        detected.into_iter().map(|opening| Sized { area: area(&opening), opening, fixed: false }).collect();
    let found: Vec<String> = list.iter().map(|s| s.opening.name.clone()).collect();
    naming::drop_and_rename(&mut list, user)?;
    let mut given = naming::given(&list);
    for plane in &user.planes {
        let opening = resolve(mask, lines, plane, voxel, &mut warnings)?;
        list.retain(|s| {
            (s.opening.plane.origin - opening.plane.origin).norm() > 2.0 * s.opening.radius.max(opening.radius)
                || s.opening.found_by == FoundBy::User
        });
        given.push(opening.name.clone());
        list.push(Sized { area: area(&opening), opening, fixed: true });
    }
    naming::settle_inlets(&mut list, user, &given, &mut warnings)?;
    Ok((naming::distinct(names::keep(list, &found))?, warnings))
}

fn resolve(
    mask: &Mask,
    lines: &Centerlines,
    user: &UserPlane,
    voxel: f64,
    warnings: &mut Vec<String>,
) -> Result<Opening, UserError> {
    let name = user.name.clone();
    let center: [f64; 3] = user.center.into();
    let plane = Plane::new(user.center, user.normal).ok_or(UserError::Normal { name, normal: user.normal.into() })?;
    let name = user.name.clone();
    // The branch whose inscribed spheres are nearest.
    let mut nearest: Option<(f64, usize, usize)> = None;
    for (b, branch) in lines.branches.iter().enumerate() {
        for (i, s) in branch.samples.iter().enumerate() {
            let d = (s.point - user.center).norm() - s.radius;
            if nearest.is_none_or(|(n, ..)| d < n) {
                nearest = Some((d, b, i));
            }
        }
    }
    let misses = |distance: f64, p: [f64; 3]| UserError::Misses { name: name.clone(), center, distance, nearest: p };
    let Some((distance, b, i)) = nearest else { return Err(misses(f64::INFINITY, [f64::NAN; 3])) };
    let branch = &lines.branches[b];
    // Where the plane crosses the branch nearest to the centre.
    let s = branch.samples.windows(2).enumerate().filter_map(|(n, w)| {
        let [x, y] = [plane.signed_distance(&w[0].point), plane.signed_distance(&w[1].point)];
        (x * y <= 0.0 && x != y).then(|| {
            let p = w[0].point + (w[1].point - w[0].point) * (x / (x - y));
            ((p - user.center).norm(), n, p)
        })
    });
    let crossing = s.min_by(|a, b| a.0.total_cmp(&b.0));
    let sample = &branch.samples[i];
    if distance > 0.5 * sample.radius + voxel && !along_face(mask, &plane) {
        return Err(misses(distance, sample.point.into()));
    }
    let (at, origin) = match crossing {
        // There the centre itself is meant: the axis may leave the picture elsewhere.
        _ if along_face(mask, &plane) => (i, user.center),
        Some((d, n, p)) if d < 3.0 * sample.radius => (n, p),
        _ => (i, plane.project(&sample.point)),
    };
    let sample = &branch.samples[at];
    // A chord, not the tangent: near a tip the axis turns aside.
    let near = branch.samples.iter().filter(|s| (s.arc_length - sample.arc_length).abs() <= 1.5 * sample.radius);
    let (first, last) = near.fold((sample, sample), |(a, b), s| {
        (if s.arc_length < a.arc_length { s } else { a }, if s.arc_length > b.arc_length { s } else { b })
    });
    let axis = (last.point - first.point).try_normalize(0.0).unwrap_or(sample.tangent);
    let cosine = plane.normal.dot(&axis);
    // A plane along the image's face opens whatever leaves there.
    let face = along_face(mask, &plane);
    if cosine.abs() < MOST_OBLIQUE && !face {
        let axis = if cosine < 0.0 { -axis } else { axis };
        return Err(UserError::Grazes { name, center, angle: cosine.abs().acos().to_degrees(), axis: axis.into() });
    }
    let mut plane = Plane { origin, normal: plane.normal };
    // The axis may cross the plane beside the lumen where it turns aside.
    if section(mask, &plane, voxel).is_none() {
        plane.origin = user.center;
    }
    let end = usize::from(cosine > 0.0);
    let to_end = if end == 1 { branch.length() - sample.arc_length } else { sample.arc_length };
    if !face && branch.ends[end] == EndKind::Free && to_end <= 1.5 * sample.radius + voxel {
        let (drawn, way) = drawn_in(mask, &plane, sample.radius, voxel);
        if way > 0.0 {
            warnings.push(format!(
                "opening `{}` lies at the tip of its vessel, where no section is whole: it is cut {way:.3} mm further in, at {:.3?} (LPS mm)",
                user.name,
                drawn.origin.coords.as_slice()
            ));
            plane = drawn;
        }
    }
    let Some(cut) = section(mask, &plane, 4.0 * sample.radius + 2.0 * voxel) else {
        return Err(misses(distance.max(0.0), sample.point.into()));
    };
    let ratio = cut.area * cosine.abs() / (std::f64::consts::PI * sample.radius * sample.radius);
    if (cut.clipped || ratio > 4.0) && !face {
        return Err(UserError::Sac { name, center, ratio });
    }
    let leaving = if face { Region::at(mask, &plane.origin) } else { None };
    let radius = leaving.map_or(sample.radius, |r| (r.area(mask) / std::f64::consts::PI).sqrt());
    // What lies beyond: from the plane to the branch's end on the normal's side.
    let beyond = if end == 1 { branch.length() - sample.arc_length } else { sample.arc_length };
    let whole: f64 = lines.branches.iter().filter(|o| o.component == branch.component).map(|o| o.length()).sum();
    let left = branch.length() - beyond;
    let others = whole - branch.length();
    let lone_tip = branch.ends[1 - end] == EndKind::Free && left < 2.0 * sample.radius;
    if !face && (lone_tip || (branch.ends[end] == EndKind::Junction && branch.ends[1 - end] == EndKind::Free && beyond + others > left)) {
        return Err(UserError::CutsEverything { name, center, share: 100.0 * (beyond + others) / whole });
    }
    let kind = user.kind.unwrap_or(if user.name.starts_with("inlet") { PatchKind::Inlet } else { PatchKind::Outlet });
    if kind == PatchKind::Inlet && left < 2.0 * sample.radius {
        warnings.push(format!(
            "opening `{}` at {center:.3?} leaves {left:.3} mm of inlet before the next junction, less than a diameter ({:.3} mm): add an extension or move it out",
            user.name,
            2.0 * sample.radius
        ));
    }
    Ok(Opening {
        id: 0,
        name: user.name.clone(),
        kind,
        plane,
        radius,
        found_by: FoundBy::User,
        confidence: 1.0,
        component: branch.component,
    })
}

/// Cosine of the largest angle between a plane's normal and the vessel's axis, 75 degrees.
const MOST_OBLIQUE: f64 = 0.259;

/// A plane near a tip, moved inwards to the first place whose section is whole: not cut short by the tip, with a voxel of
/// lumen beyond, and inside the picture; where a vessel runs along the picture's side, inside it as far as the axis goes. The plane itself, and 0,
/// where there is none within a radius and a half.
fn drawn_in(mask: &Mask, plane: &Plane, radius: f64, voxel: f64) -> (Plane, f64) {
    let at = |way: f64| Plane { origin: plane.origin - plane.normal * way, normal: plane.normal };
    let cut = |way: f64| section(mask, &at(way), 4.0 * radius + 2.0 * voxel);
    let step = 0.25 * voxel;
    // The best of three: backed and inside, backed, whole.
    let mut found: [Option<f64>; 3] = [None; 3];
    for k in 0..=(1.5 * radius / step).ceil() as usize {
        let way = k as f64 * step;
        let Some(s) = cut(way) else { continue };
        let short = cut(way + 0.75 * radius).is_some_and(|d| s.area < 0.85 * d.area.min(1.5 * s.area) && !d.clipped);
        if short || s.clipped {
            continue;
        }
        // A voxel of lumen should lie beyond: the wall rounds the edge of a flat end, and a plane on it cuts no loop.
        let backed = cut(way - voxel).is_some_and(|d| d.area > 0.6 * s.area);
        if backed && s.points(&at(way)).all(|p| in_image(mask, &p)) {
            found[0] = Some(way);
            break;
        }
        let leaves = Region::at(mask, &at(way).origin).is_some() && !disc_inside(mask, &at(way), s.reach.min(2.5 * radius));
        if !leaves {
            found[if backed { 1 } else { 2 }].get_or_insert(way);
        }
    }
    found.into_iter().flatten().next().map_or((*plane, 0.0), |way| (at(way), way))
}
