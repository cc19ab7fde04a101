//! Random masks of kinds that are hard to open right, with their true ends: slanted cuts, splits at the image border,
//! vessels that graze it, chambers, sacs, dissections. A kind and a seed give the same mask everywhere.

mod chambers;
mod cuts;
mod dissections;
mod draft;
mod grazing;
mod oblique;
mod sacs;
mod splits;
mod tips;

use serde_json::{Value, json};

use super::Random;
use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;
use draft::Draft;

/// A true end of a sample's vessel.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueEnd {
    /// `inlet` for the largest section square to the axis, `outlet_1`, ... by falling area.
    pub name: String,
    /// The plane in which the vessel was cut, or, for a round tip, the plane square to the axis where the axis ends;
    /// the normal points out of the vessel.
    pub plane: Plane,
    /// Unit direction of the axis out of the vessel.
    pub axis: Vector,
    /// Radius of the circle that has the area of the section square to the axis, mm.
    pub radius: f64,
    /// Area of the section square to the axis, mm².
    pub area: f64,
    /// Area of the section in `plane`, mm².
    pub cap_area: f64,
    /// Whether the end is flat; a round tip otherwise.
    pub flat: bool,
    /// Whether the image border cuts the vessel there.
    pub on_border: bool,
    /// Length of the stub in its diameters, where it is one.
    pub diameters: Option<f64>,
    /// What ends there, for example `side branch`.
    pub kind: &'static str,
}

impl TrueEnd {
    /// Degrees between the plane's normal and the axis.
    pub fn tilt(&self) -> f64 {
        self.plane.normal.angle(&self.axis).to_degrees()
    }
}

/// A place that looks like an end and is none.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosedEnd {
    /// Its middle.
    pub at: Point,
    /// Its area, mm², where it is flat.
    pub area: Option<f64>,
    /// Why it stays closed.
    pub reason: &'static str,
}

/// A mask with its true ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Kind and seed, for example `grazing-7`.
    pub name: String,
    /// What it is, in a sentence.
    pub description: String,
    /// The mask.
    pub mask: Mask,
    /// The ends by falling area; the first is the inlet.
    pub ends: Vec<TrueEnd>,
    /// Places that stay closed.
    pub closed: Vec<ClosedEnd>,
}

/// Makes a draft of a kind, or `None` where these random numbers give none.
type Maker = fn(&mut Random) -> Option<Draft>;

const KINDS: [(&str, Maker); 10] = [
    ("cuts", |r| cuts::draft(r, false)),
    ("cuts-anisotropic", |r| cuts::draft(r, true)),
    ("splits", splits::draft),
    ("grazing", grazing::draft),
    ("chambers", chambers::draft),
    ("sacs", |r| sacs::draft(r, true)),
    ("trees", |r| sacs::draft(r, false)),
    ("dissections", dissections::draft),
    ("tips", tips::draft),
    ("oblique", oblique::draft),
];

/// Draws of random numbers until a sample is fair; the rarest kind needs some tens.
const DRAWS: u64 = 1000;

/// The kinds of samples.
pub fn kinds() -> Vec<&'static str> {
    KINDS.iter().map(|k| k.0).collect()
}

/// The sample of a kind with a seed; `None` where there is no such kind.
///
/// Each end is one that a person would see: wider than four voxels, free of other vessels.
pub fn sample(kind: &str, seed: u64) -> Option<Sample> {
    let number = KINDS.iter().position(|k| k.0 == kind)?;
    let mut seeds = Random::new(seed ^ (number as u64) << 48);
    (0..DRAWS).find_map(|_| {
        let mut random = Random::new(seeds.bits());
        let draft = KINDS[number].1(&mut random)?;
        draft.finish(format!("{kind}-{seed}"), &mut random)
    })
}

/// The sample called KIND-SEED.
pub fn sample_by_name(name: &str) -> Option<Sample> {
    let (kind, seed) = name.rsplit_once('-')?;
    sample(kind, seed.parse().ok()?)
}

impl Sample {
    /// Everything that is known exactly, for other programs.
    pub fn truth_json(&self) -> Value {
        let end = |e: &TrueEnd| {
            let (c, n) = (e.plane.origin, e.plane.normal);
            json!({
                "name": e.name,
                "center": [c.x, c.y, c.z],
                "normal": [n.x, n.y, n.z],
                "axis": [e.axis.x, e.axis.y, e.axis.z],
                "radius": e.radius,
                "area": e.area,
                "cap_area": e.cap_area,
                "tilt": e.tilt(),
                "diameters": e.diameters,
                "kind": e.kind,
                "flat": e.flat,
                "where": if e.on_border { "border" } else { "inside" },
            })
        };
        let closed = |c: &ClosedEnd| json!({"center": [c.at.x, c.at.y, c.at.z], "area": c.area, "reason": c.reason});
        json!({
            "name": self.name,
            "note": self.description,
            "units": "mm",
            "coordinates": "LPS",
            "spacing": self.mask.grid.spacing(),
            "ends": self.ends.iter().map(end).collect::<Vec<_>>(),
            "closed": self.closed.iter().map(closed).collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
mod tests;
