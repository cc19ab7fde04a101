//! What the mask's boundary says of where the vessel ends, and the planes that follow from it.
//!
//! *The rule of the cut:* where a vessel was cut flat, by a person or by the image's border, it is cut along that face;
//! square to its axis only where the face is tilted by more than 30 degrees to the axis and the vessel behind it is
//! straight for as long as a square cut takes off.

use serde::Serialize;

use super::border::{BorderRegion, border_regions};
use super::faces::{FlatFace, flat_faces};
use super::removed::removed;
use super::section::section;
use crate::geometry::{Plane, Point, Vector};
use crate::mask::{Mask, crop_pad_where};

/// How found ends with a flat face are cut.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CutDirection {
    /// Along the face; square to the axis where the tilt is above 30 degrees and the vessel behind is long enough.
    #[default]
    Auto,
    /// Square to the axis wherever there is room.
    Square,
    /// Along the face.
    AsCut,
}

/// Largest tilt at which a face is cut along itself by default, degrees.
const TILT: f64 = 30.0;
/// The same where square cuts are asked for.
const SLIGHT_TILT: f64 = 3.0;
/// Distance of a cut behind a flat face, in voxels: the wall's rim is round for about a voxel.
const INSET: f64 = 1.25;

/// The same of a face that something wider joins within two voxels.
const JOINED_INSET: f64 = 0.75;

/// Flat faces and border regions of one component of the lumen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// Flat faces, most certain first.
    pub faces: Vec<FlatFace>,
    /// Regions of lumen on the image's border.
    pub regions: Vec<BorderRegion>,
    /// Where the component lies: centre of its first voxel.
    origin: Point,
}

/// A face that a plane can stand for.
pub(super) struct Face {
    /// The face; its normal points out of the vessel.
    pub plane: Plane,
    pub area: f64,
    pub axis: Vector,
    pub straight: f64,
    pub voxel: f64,
    /// Distance of a cut along the face from the face, mm.
    pub inset: f64,
}

impl From<&FlatFace> for Face {
    fn from(f: &FlatFace) -> Face {
        Face { plane: f.plane, area: f.area, axis: f.axis, straight: f.straight, voxel: f.voxel, inset: if f.joined { JOINED_INSET } else { INSET } * f.voxel }
    }
}

impl From<&BorderRegion> for Face {
    fn from(r: &BorderRegion) -> Face {
        let inset = (r.plane.origin - r.inset().origin).norm();
        Face { plane: r.plane, area: r.area, axis: r.axis, straight: r.straight, voxel: r.voxel, inset }
    }
}

/// Where a face is cut.
pub(super) struct Placed {
    pub plane: Plane,
    /// Whether it lies along the face.
    pub along: bool,
    /// Area that the opening should have, mm².
    pub expected: f64,
    /// Area of the section square to the axis, mm².
    pub square_area: f64,
    /// A square cut was asked for and there is no room for it.
    pub no_room: bool,
}

impl Evidence {
    /// Looks at one component. `mask` must know its image.
    pub fn of(mask: &Mask) -> Evidence {
        Evidence { faces: flat_faces(mask), regions: border_regions(mask), origin: mask.grid.origin }
    }

    /// The component with a margin of background, carried on by `pad` voxels where it leaves the image.
    pub fn carried_on(&self, mask: &Mask, margin: usize, pad: usize) -> Mask {
        Evidence::all_carried_on(std::iter::once(self), mask, margin, pad)
    }

    /// The same for a mask that holds several components.
    pub fn all_carried_on<'a>(parts: impl Iterator<Item = &'a Evidence> + Clone, mask: &Mask, margin: usize, pad: usize) -> Mask {
        let leaving: Vec<([i64; 3], &BorderRegion)> = parts
            .flat_map(|e| {
                let at = mask.grid.to_index(&e.origin);
                let shift = [0, 1, 2].map(|a| at[a].round() as i64);
                e.regions.iter().filter(|r| r.kind == super::border::AtBorder::Leaves).map(move |r| (shift, r))
            })
            .collect();
        crop_pad_where(mask, margin, pad, |v, side| {
            leaving.iter().any(|(shift, r)| r.side() == side && r.has(&[0, 1, 2].map(|a| v[a] - shift[a])))
        })
    }
}

impl Face {
    fn cosine(&self) -> f64 {
        self.axis.dot(&self.plane.normal).clamp(0.3, 1.0)
    }

    /// Where to cut, by the rule at the head of this module.
    pub(super) fn placed(&self, mask: &Mask, rule: CutDirection) -> Placed {
        let cosine = self.cosine();
        let square_area = self.area * cosine;
        let tilt = cosine.acos().to_degrees();
        let wanted = match rule {
            CutDirection::Auto => tilt > TILT,
            CutDirection::Square => tilt > SLIGHT_TILT,
            CutDirection::AsCut => false,
        };
        if wanted {
            if let Some(placed) = self.square(mask, square_area) {
                return placed;
            }
        }
        let plane = Plane { origin: self.plane.origin - self.axis * (self.inset / cosine), normal: self.plane.normal };
        Placed { plane, along: true, expected: self.area, square_area, no_room: wanted && rule == CutDirection::Square }
    }

    /// Square to the axis, right behind the face; `None` where there is no room or something else would go too.
    fn square(&self, mask: &Mask, square_area: f64) -> Option<Placed> {
        let radius = (square_area / std::f64::consts::PI).sqrt();
        let cosine = self.cosine();
        let sine = (1.0 - cosine * cosine).sqrt();
        let back = radius * sine / cosine + self.inset.max(self.voxel);
        if self.straight < 2.0 * radius * sine + self.voxel * cosine {
            return None;
        }
        let plane = Plane::new(self.plane.origin - self.axis * back, self.axis)?;
        let cut = section(mask, &plane, 4.0 * radius + 4.0 * self.voxel).filter(|s| !s.clipped)?;
        if !(0.75..=1.3).contains(&(cut.area / square_area)) {
            return None;
        }
        // The wedge, and as much again for what the voxels blur; beyond the border the padding goes too.
        let most = 2.0 * square_area * (back + 2.0 * self.voxel) + square_area * 10.0 * self.voxel;
        if removed(mask, &plane, cut.points(&plane), most).more {
            return None;
        }
        let plane = Plane { origin: plane.project(&cut.center), normal: plane.normal };
        Some(Placed { plane, along: false, expected: square_area, square_area: cut.area, no_room: false })
    }
}
