//! Flow extensions: the vessel continued beyond its openings, as part of the implicit.
//!
//! Beyond the opening's plane the wall is the section's outline r(θ) about its centroid, carried along a direction
//! and blended to a circle: r²(θ, z) = (1 − s) r²(θ) + s r₀² with s rising smoothly from 0 to 1 over the transition
//! and r₀² the mean of r². The area ½∮r²dθ is therefore the same at every z. Half a radius before the plane the
//! function passes smoothly from the vessel to the outline, so that the wall has no seam there, and the mesher meets
//! none either: the extended function is meshed like any other and cut at the new end. Beyond that it ends in a dome.
//!
//! A section that no radius over the angle tells (vessels that meet in the plane, folds) is carried on as it is: the wall's
//! function at p is the vessel's at the point whose height levels off to 0 just behind the plane.

mod marks;
mod section;
mod tube;

use serde::Serialize;

use super::Opening;
use crate::centerline::Centerlines;
use crate::geometry::{Aabb, Point, Vector};
use crate::implicit::Implicit;
use crate::mask::{Grid, Mask};
use marks::Mark;
use tube::smoothstep;
pub use tube::Tube;

/// Part of its wished length that an extension must keep where another vessel is in its way.
pub const LEAST_LEFT: f64 = 0.25;

/// An extension of one opening.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Extension {
    /// Name of the opening.
    pub opening: String,
    /// Length along the normal, mm.
    pub length: f64,
    /// Length over which the section becomes a circle, mm; `None` keeps the section.
    pub transition: Option<f64>,
    /// Direction, any length; `None` is the opening's normal. The centerline's tangent is the other usual choice.
    pub direction: Option<Vector>,
}

/// Why an opening cannot be extended.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ExtendError {
    /// No such opening.
    #[error("extensions.openings: there is no opening `{name}`; there are {known}")]
    Unknown {
        /// As given.
        name: String,
        /// Names of the openings.
        known: String,
    },
    /// The length is no length.
    #[error("the extension of `{name}` has a length of {length} mm and a transition of {transition:?} mm; both must be finite and above zero")]
    Length {
        /// Opening.
        name: String,
        /// As given, mm.
        length: f64,
        /// As given, mm.
        transition: Option<f64>,
    },
    /// The direction does not lead out.
    #[error("the extension of `{name}` would run {angle:.0}° off the opening's normal; less than 60° is needed")]
    Direction {
        /// Opening.
        name: String,
        /// Angle to the normal, degrees.
        angle: f64,
    },
    /// The section's outline cannot be told as a radius over the angle.
    #[error("the section of `{name}` at {center:.3?} (LPS mm) is no closed outline round its middle: move the opening along the branch")]
    Section {
        /// Opening.
        name: String,
        /// Centre of the opening, LPS mm.
        center: [f64; 3],
    },
    /// The vessel comes back to itself.
    #[error("the vessel beyond `{name}` at {center:.3?} (LPS mm) leads back to its other side: a ring has no end to extend")]
    Ring {
        /// Opening.
        name: String,
        /// Centre of the opening, LPS mm.
        center: [f64; 3],
    },
    /// The extension meets another vessel.
    #[error("the extension of `{name}` runs into the vessel {distance:.2} mm from its start, at {at:.3?} (LPS mm): shorten it or give a direction")]
    Collides {
        /// Opening.
        name: String,
        /// Where, LPS mm.
        at: [f64; 3],
        /// Distance from the opening, mm.
        distance: f64,
    },
}

impl ExtendError {
    /// Name of the opening at fault.
    pub fn opening(&self) -> &str {
        match self {
            ExtendError::Unknown { name, .. }
            | ExtendError::Length { name, .. }
            | ExtendError::Direction { name, .. }
            | ExtendError::Section { name, .. }
            | ExtendError::Ring { name, .. }
            | ExtendError::Collides { name, .. } => name,
        }
    }
}

/// A vessel with extensions. Values are close to distances near the wall where sections are nearly round.
pub struct Extended<I> {
    inner: I,
    tubes: Vec<Tube>,
    grid: Grid,
    /// Which side of the openings each voxel is on, a few voxels into the background.
    marks: Vec<Mark>,
    bounds: Aabb,
}

impl<I: Implicit> Extended<I> {
    /// Continues `surface` beyond the openings named in `extensions`; returns it with the openings moved to the new ends.
    ///
    /// `mask` tells what lies beyond an opening: that part of the vessel is taken off. The new normals are those of the
    /// old planes. The area of the section does not change along an extension.
    pub fn new(surface: I, mask: &Mask, openings: &[Opening], extensions: &[Extension]) -> Result<(Extended<I>, Vec<Opening>), ExtendError> {
        let mut moved = openings.to_vec();
        let mut tubes = Vec::new();
        let mut marks = marks::fresh(mask);
        let mut bounds = surface.bounds();
        for e in extensions {
            let n = openings.iter().position(|o| o.name == e.opening).ok_or_else(|| ExtendError::Unknown {
                name: e.opening.clone(),
                known: openings.iter().map(|o| o.name.as_str()).collect::<Vec<_>>().join(", "),
            })?;
            let tube = Tube::new(&surface, &openings[n], e)?;
            marks::take_off(mask, &tube, tubes.len(), &mut marks)?;
            moved[n].plane = tube.new_end();
            moved[n].radius = tube.inscribed(e.length);
            bounds = bounds.union(&tube.bounds());
            tubes.push(tube);
        }
        let marks = marks::widen(mask, marks);
        let extended = Extended { inner: surface, tubes, grid: mask.grid.clone(), marks, bounds };
        for n in 0..extended.tubes.len() {
            extended.collision(n)?;
        }
        Ok((extended, moved))
    }

    /// The extensions, in the order in which they were asked for.
    pub fn tubes(&self) -> &[Tube] {
        &self.tubes
    }

    /// The centerlines cut at the extended openings and continued along the extensions.
    pub fn centerlines(&self, lines: &Centerlines) -> Centerlines {
        let mut lines = lines.clone();
        for tube in &self.tubes {
            tube.continue_axis(&mut lines);
        }
        lines
    }

    fn collision(&self, n: usize) -> Result<(), ExtendError> {
        let tube = &self.tubes[n];
        // Sheets closer than a cell of the polygonizer would grow together; the opening itself may lie as close.
        let margin = |z: f64| if z > tube.reach { self.inner.resolution() } else { 0.0 };
        for (p, z) in tube.rings() {
            let other = self.tubes.iter().enumerate().filter(|(m, _)| *m != n).any(|(_, t)| {
                let height = t.plane.signed_distance(&p);
                height > 0.0 && self.wall(t, &p, height).is_some_and(|w| w.0 < margin(z))
            });
            if other || self.rest(&p).0 < 0.0 {
                return Err(ExtendError::Collides { name: tube.name.clone(), at: p.into(), distance: z });
            }
        }
        Ok(())
    }

    fn mark(&self, p: &Point) -> Mark {
        let x = self.grid.to_index(p);
        let voxel = self.grid.linear(x[0].round() as i64, x[1].round() as i64, x[2].round() as i64);
        voxel.map_or(Mark::Background, |n| self.marks[n])
    }

    /// The wall's function and gradient of a tube at height `z` of `p`; `None` far from it.
    fn wall(&self, tube: &Tube, p: &Point, z: f64) -> Option<(f64, Vector)> {
        if !tube.is_carried() {
            return tube.wall(p, z);
        }
        let (origin, rate) = tube.origin_of(p, z);
        let Mark::Slab(n) = self.mark(&origin) else { return None };
        (self.tubes[usize::from(n)].name() == tube.name()).then(|| tube.carry(self.inner.value_gradient(&origin), z, rate))
    }

    /// The vessel without what the openings take off.
    fn rest(&self, p: &Point) -> (f64, Vector) {
        let (f, g) = self.inner.value_gradient(p);
        let mark = self.mark(p);
        let (Mark::Slab(n) | Mark::Removed(n)) = mark else { return (f, g) };
        let plane = &self.tubes[usize::from(n)].plane;
        let z = plane.signed_distance(p);
        if z < 0.0 && matches!(mark, Mark::Slab(_)) {
            return (f, g);
        }
        let least = 1e-6 * self.inner.resolution();
        if z > f { (z.max(least), plane.normal) } else { (f.max(least), g) }
    }
}

impl<I: Implicit> Implicit for Extended<I> {
    fn value(&self, p: &Point) -> f64 {
        self.value_gradient(p).0
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let mut best = self.rest(p);
        let mark = self.mark(p);
        for (n, tube) in self.tubes.iter().enumerate() {
            let z = tube.plane.signed_distance(p);
            if z <= -tube.lead || z >= tube.end + tube.reach {
                continue;
            }
            let Some(own) = self.wall(tube, p, z) else { continue };
            if z >= 0.0 {
                if own.0 < best.0 {
                    best = own;
                }
            } else if tube.is_carried() {
                best = own;
            } else if mark == Mark::Slab(n as u16) {
                // From the vessel to the outline, with the slopes of both ends kept; another vessel close by stays.
                let (s, ds) = smoothstep(1.0 + z / tube.lead);
                let g = best.1 * (1.0 - s) + own.1 * s + tube.plane.normal * (ds / tube.lead * (own.0 - best.0));
                best = (best.0 * (1.0 - s) + own.0 * s, g);
            }
        }
        best
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn resolution(&self) -> f64 {
        self.inner.resolution()
    }
}

/// Extensions that run into no other vessel: those that would are shortened to end before it.
///
/// Returns them, and for each that became shorter its place in the list and the distance at which it would have met the
/// other vessel, mm.
///
/// # Errors
/// As [`Extended::new`]; [`ExtendError::Collides`] where less than [`LEAST_LEFT`] of the wished length would be left.
pub fn clear(surface: &dyn Implicit, mask: &Mask, openings: &[Opening], wanted: &[Extension]) -> Result<(Vec<Extension>, Vec<(usize, f64)>), ExtendError> {
    let mut extensions = wanted.to_vec();
    let mut shortened: Vec<(usize, f64)> = Vec::new();
    loop {
        let (name, distance, collision) = match Extended::new(surface, mask, openings, &extensions) {
            Ok(_) => return Ok((extensions, shortened)),
            Err(ExtendError::Collides { name, at, distance }) => (name.clone(), distance, ExtendError::Collides { name, at, distance }),
            Err(e) => return Err(e),
        };
        let Some(n) = extensions.iter().position(|e| e.opening == name) else { return Err(collision) };
        // Beyond the new end the wall goes straight on and a dome closes it: 1.3 radii, and the distance is that of a ring,
        // half a radius apart from the next.
        let Some(opening) = openings.iter().find(|o| o.name == name) else { return Err(collision) };
        let length = (distance - 2.0 * equivalent_radius(surface, opening)?).min(0.9 * extensions[n].length);
        if length < LEAST_LEFT * wanted[n].length {
            return Err(collision);
        }
        extensions[n].length = length;
        shortened.retain(|s| s.0 != n);
        shortened.push((n, distance));
    }
}

/// Radius of the circle whose area is that of the opening's section, mm: half of the D in which lengths are given.
///
/// # Errors
/// [`ExtendError::Section`] where the section is no closed outline round its middle.
pub fn equivalent_radius(surface: &dyn Implicit, opening: &Opening) -> Result<f64, ExtendError> {
    let any = Extension { opening: opening.name.clone(), length: opening.radius, transition: None, direction: None };
    Ok((Tube::new(surface, opening, &any)?.area() / std::f64::consts::PI).sqrt())
}

#[cfg(test)]
mod tests;
