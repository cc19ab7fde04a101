//! Planes and names given by the user.

use serde::Serialize;

use super::border::{along_face, in_image};
use super::names::{self, Sized};
use super::naming;
use super::removed::removed;
use super::section::{Section, section};
use super::slices::Slices;
use super::{FoundBy, Opening, Support};
use crate::centerline::Centerlines;
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
    /// The plane meets no lumen near its centre.
    #[error("opening `{name}`: the plane at {center:.3?} meets no lumen near its centre; the nearest lumen is at {nearest:.3?}, {distance:.3} mm away{}: give a point inside the branch to be cut (LPS mm)", hint(*flipped))]
    Misses {
        /// Opening.
        name: String,
        /// As given, LPS mm.
        center: [f64; 3],
        /// Distance of the nearest lumen, mm.
        distance: f64,
        /// The nearest lumen, LPS mm.
        nearest: [f64; 3],
        /// The centre as it would be were it given in RAS, where that lies in the lumen.
        flipped: Option<[f64; 3]>,
    },
    /// The normal points into the vessel: nothing but a tip would stay.
    #[error("opening `{name}` at {center:.3?} would cut off {share:.0} % of the vessel and leave the tip: turn the normal round, it must point out of the vessel")]
    CutsEverything {
        /// Opening.
        name: String,
        /// As given, LPS mm.
        center: [f64; 3],
        /// Percentage of the lumen's volume on the removed side.
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

fn hint(flipped: Option<[f64; 3]>) -> String {
    let said = |p: [f64; 3]| format!("; {p:.3?} lies in the lumen: the coordinates look like RAS, as 3D Slicer shows them, and must be LPS (x and y with the other sign)");
    flipped.map_or(String::new(), said)
}

impl UserError {
    /// Name of the opening at fault.
    pub fn opening(&self) -> &str {
        match self {
            UserError::Normal { name, .. }
            | UserError::Misses { name, .. }
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
    let mut list: Vec<Sized> = detected.into_iter().map(|opening| Sized { opening, fixed: false }).collect();
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
        list.push(Sized { opening, fixed: true });
    }
    naming::settle_inlets(&mut list, user, &given, &mut warnings)?;
    Ok((naming::distinct(names::keep(list, &found))?, warnings))
}

/// Distance from the centre within which a plane's lumen is looked for, in the largest voxel edge.
const NEAR: f64 = 3.0;
/// A part left by a cut that is smaller than this many cubes of the section's radius is a tip.
const TIP: f64 = 12.0;

fn resolve(mask: &Mask, lines: &Centerlines, user: &UserPlane, voxel: f64, warnings: &mut Vec<String>) -> Result<Opening, UserError> {
    let center: [f64; 3] = user.center.into();
    let given = Plane::new(user.center, user.normal).ok_or(UserError::Normal { name: user.name.clone(), normal: user.normal.into() })?;
    let coarse = mask.grid.spacing().into_iter().fold(0.0, f64::max);
    let Some((mut plane, mut cut)) = crossed(mask, &given, NEAR * coarse, voxel) else {
        let nearest = nearest_lumen(mask, &user.center);
        let flipped = Point::new(-user.center.x, -user.center.y, user.center.z);
        let x = mask.grid.to_index(&flipped);
        let inside = mask.at(x.x.round() as i64, x.y.round() as i64, x.z.round() as i64);
        let distance = (nearest - user.center).norm();
        return Err(UserError::Misses { name: user.name.clone(), center, distance, nearest: nearest.into(), flipped: inside.then(|| flipped.into()) });
    };
    // The axis tells sizes square to the vessel; where it runs along the plane it tells nothing.
    let sample = lines.branches.iter().flat_map(|b| b.samples.iter().map(move |s| (s, b.component)));
    let nearest = sample.min_by(|a, b| ((a.0.point - plane.origin).norm() - a.0.radius).total_cmp(&((b.0.point - plane.origin).norm() - b.0.radius)));
    let component = nearest.map_or(0, |n| n.1);
    let tangent = nearest.map_or(plane.normal, |n| n.0.tangent);
    let axis = if tangent.dot(&plane.normal) < 0.0 { -tangent } else { tangent };
    let axis = if axis.dot(&plane.normal) < 0.5 { plane.normal } else { axis };
    let face = along_face(mask, &given);
    if face {
        plane.origin = if section(mask, &given, voxel).is_some() { given.origin } else { plane.origin };
    } else {
        let inscribed = nearest.map_or(f64::INFINITY, |n| n.0.radius);
        let radius = inscribed.max((cut.area / std::f64::consts::PI).sqrt());
        let (drawn, way) = drawn_in(mask, &plane, radius, voxel);
        if way > 0.0 {
            warnings.push(format!(
                "opening `{}` lies at the tip of its vessel, where no section is whole: it is cut {way:.3} mm further in, at {:.3?} (LPS mm)",
                user.name,
                drawn.origin.coords.as_slice()
            ));
            if let Some((at, whole)) = crossed(mask, &drawn, NEAR * coarse, voxel) {
                (plane, cut) = (at, whole);
            }
        }
    }
    let radius = (cut.area / std::f64::consts::PI).sqrt().max(voxel);
    // What would go, and what would stay.
    let all = mask.volume();
    let taken = removed(mask, &plane, cut.points(&plane), all).volume;
    let left = all - taken;
    if !face && taken > left {
        let back = Plane { origin: plane.origin, normal: -plane.normal };
        let stays = removed(mask, &back, cut.points(&plane), all).volume;
        if stays < TIP * radius.powi(3) {
            return Err(UserError::CutsEverything { name: user.name.clone(), center, share: 100.0 * taken / (taken + stays) });
        }
        warnings.push(format!("opening `{}` cuts off {:.0} % of the lumen: turn its normal round where the other side is meant", user.name, 100.0 * taken / all));
    }
    let kind = user.kind.unwrap_or(if user.name.starts_with("inlet") { PatchKind::Inlet } else { PatchKind::Outlet });
    Ok(Opening {
        id: 0,
        name: user.name.clone(),
        kind,
        plane,
        radius,
        support: Support { axis, square_area: cut.area * axis.dot(&plane.normal), expected_area: None, along_face: face },
        found_by: FoundBy::User,
        confidence: 1.0,
        component,
    })
}

/// The plane with its origin in the lumen that it crosses nearest to its own, no farther than `near` mm, and the
/// section there: the one that holds the origin, whatever else the plane crosses.
fn crossed(mask: &Mask, plane: &Plane, near: f64, voxel: f64) -> Option<(Plane, Section)> {
    let whole = |plane: Plane| {
        let mut reach = 24.0 * voxel;
        loop {
            let cut = section(mask, &plane, reach)?;
            if !cut.clipped || reach > 4000.0 * voxel {
                return Some((plane, cut));
            }
            reach *= 2.0;
        }
    };
    whole(*plane).or_else(|| {
        let slices = Slices::new(mask, plane, near, 0.5 * voxel);
        let slice = slices.first(0.0, near)?;
        // A sample a little inside the lumen, where the blurred mask is lumen too.
        let samples = (0..slice.own.len()).filter(|&n| slice.own[n]).map(|n| slices.at(n, 0.0));
        let mut sorted: Vec<Point> = samples.collect();
        sorted.sort_by(|a, b| (a - plane.origin).norm().total_cmp(&(b - plane.origin).norm()));
        sorted.into_iter().find_map(|p| whole(Plane { origin: p, normal: plane.normal }))
    })
}

/// The middle of the lumen voxel nearest to a point.
fn nearest_lumen(mask: &Mask, p: &Point) -> Point {
    let at = |n: usize| mask.grid.to_world(Vector::from(mask.grid.voxel(n).map(|c| c as f64)));
    let lumen = (0..mask.data.len()).filter(|&n| mask.data[n] != 0);
    lumen.map(at).min_by(|a, b| (a - p).norm().total_cmp(&(b - p).norm())).unwrap_or(*p)
}

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
        found[if backed { 1 } else { 2 }].get_or_insert(way);
    }
    found.into_iter().flatten().next().map_or((*plane, 0.0), |way| (at(way), way))
}
