//! What a cut takes off.

use std::collections::HashSet;

use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;
use crate::mask::neighborhood::STEPS_6;

/// The lumen beyond a plane that hangs together with its section.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Removed {
    /// Its volume, mm³; no more than asked for is counted.
    pub volume: f64,
    /// Whether there is more than was asked for.
    pub more: bool,
    /// Largest distance of its voxels from the plane, mm.
    pub length: f64,
}

/// What a cut takes off: voxels beyond `plane` connected with those within `reach` of its origin, up to `most` mm³.
/// Only lumen that the section itself touches counts, so that other vessels the plane crosses do not.
pub(super) fn removed(mask: &Mask, plane: &Plane, section: impl Iterator<Item = Point>, most: f64) -> Removed {
    let unit = mask.grid.voxel_volume();
    let limit = (most / unit).ceil() as usize;
    let at = |v: &[i64; 3]| mask.grid.to_world(Vector::new(v[0] as f64, v[1] as f64, v[2] as f64));
    let mut seen: HashSet<[i64; 3]> = HashSet::new();
    let mut stack: Vec<[i64; 3]> = Vec::new();
    let h = (0..3).map(|a| mask.grid.axes.column(a).dot(&plane.normal).abs()).sum::<f64>();
    for p in section {
        // The voxel at the section and the one behind it: one of them lies beyond.
        for out in [0.0, 0.5, 1.0] {
            let x = mask.grid.to_index(&(p + plane.normal * (out * h)));
            let v = [0, 1, 2].map(|a| x[a].round() as i64);
            if mask.at(v[0], v[1], v[2]) && plane.signed_distance(&at(&v)) > 0.0 && seen.insert(v) {
                stack.push(v);
            }
        }
    }
    let (mut count, mut length) = (0usize, 0.0f64);
    while let Some(v) = stack.pop() {
        count += 1;
        length = length.max(plane.signed_distance(&at(&v)));
        if count > limit {
            return Removed { volume: count as f64 * unit, more: true, length };
        }
        for d in STEPS_6 {
            let w = [v[0] + d[0], v[1] + d[1], v[2] + d[2]];
            if mask.at(w[0], w[1], w[2]) && plane.signed_distance(&at(&w)) > 0.0 && seen.insert(w) {
                stack.push(w);
            }
        }
    }
    Removed { volume: count as f64 * unit, more: false, length }
}
