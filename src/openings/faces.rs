//! Flat ends of the lumen: where a person or a crop cut a vessel through.
//!
//! A flat end shows as a step in the areas of sections parallel to it: no lumen a voxel outside, the whole section half
//! a voxel and a voxel inside, the same section deeper, and lumen that goes on for as far as the section is wide. A dome
//! has a fraction of its section a voxel inside, the flank of a vessel ends before it is as deep as it is long.
//!
//! Candidates come from planes fitted to the boundary's points round seeds all over it; the test is sharp and cheap.

use rayon::prelude::*;

use super::boundary_points::{BoundaryPoint, BoundaryPoints};
use super::slices::{Slice, Slices};
use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;

/// A place where the lumen ends in a plane.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatFace {
    /// Middle of the face; its normal points out of the vessel.
    pub plane: Plane,
    /// Area of the face, mm².
    pub area: f64,
    /// Farthest point of the face from its middle, mm.
    pub reach: f64,
    /// Direction of the vessel behind it, out of the vessel; the normal where too little of it is straight.
    pub axis: Vector,
    /// Depth to which the sections parallel to the face stay alike, mm.
    pub straight: f64,
    /// Size of a voxel along the normal, mm.
    pub voxel: f64,
    /// Whether something wider joins it within two voxels.
    pub joined: bool,
}

impl FlatFace {
    /// Radius of the circle of its area, mm.
    pub fn radius(&self) -> f64 {
        (self.area / std::f64::consts::PI).sqrt()
    }

    /// Whether the tip of a centerline is the one that this face closes.
    pub fn closes(&self, tip: &Point) -> bool {
        let d = tip - self.plane.origin;
        let out = d.dot(&self.plane.normal);
        let aside = (d - self.plane.normal * out).norm();
        // A centerline stops up to a radius behind its end, or runs into a corner of it.
        aside <= 1.2 * self.reach + 2.0 * self.voxel && out <= 8.0 * self.voxel && out >= -1.5 * self.radius() - 2.0 * self.voxel
    }
}

/// Distance of seeds, in the largest voxel edge.
const SEEDS: f64 = 1.5;
/// Radii of neighbourhoods to which planes are fitted, in the largest voxel edge.
const NEIGHBOURHOODS: [f64; 3] = [1.8, 3.0, 5.0];
/// Passes of a fit.
const PASSES: usize = 6;
/// Cosine of the largest angle between a point's direction and the plane's, 55 degrees: they turn near a rim.
const AGREE: f64 = 0.57;
/// Radius within which a candidate is tested at first, in the largest voxel edge.
const WINDOW: f64 = 8.0;
/// Part of the section that may be lumen on the outside.
const OUTSIDE: f64 = 0.2;
/// Least part of the section half a voxel inside.
const AT_ONCE: f64 = 0.72;
/// Least part of the section a voxel inside that two voxels inside have, and the other way round.
const STEADY: f64 = 0.86;
/// Least ratio of the section a voxel inside to that half a radius inside.
const DEEPER: f64 = 0.75;
/// The same of a section that is there at once.
const GROWING: f64 = 0.75;
/// Sharpness from which a section need not stay the same.
const CLEAR: f64 = 0.75;
/// Least part of the rim that stays where it is, times the part of the section that is there at once, of a stub that joins
/// its parent within two voxels.
const FREE: f64 = 0.54;
/// Steadiness below which a section grows abruptly, as where a stub joins its parent and no dome does; the part of the
/// rim that must stay where it grows gradually.
const ABRUPT: f64 = 0.7;
const MOSTLY_FREE: f64 = 0.77;
/// Least part of the section at a depth of its longer half axis: a flank is not as deep as it is long.
const DEEP: f64 = 0.5;
/// Largest ratio of the half axes.
const ASPECT: f64 = 5.0;
/// Least sharpness of a round face, what it grows by with each unit of the ratio of the half axes above 1.5, and the most
/// that is asked for: slender sections are those of flanks more often than not.
const SHARP: f64 = 0.62;
const SLENDER: f64 = 0.16;
const SHARPEST: f64 = 0.88;
/// What is asked for more with each voxel of radius below three.
const SMALL: f64 = 0.05;
/// Least radius, in the largest voxel edge.
const LEAST_RADIUS: f64 = 1.8;

/// Size of a voxel along a direction, mm.
fn voxel_along(mask: &Mask, n: &Vector) -> f64 {
    (0..3).map(|a| mask.grid.axes.column(a).dot(n).powi(2)).sum::<f64>().sqrt()
}

/// The flat faces of a mask, best first. `mask` is one component within its image; where the image ends there is no
/// face, see [`super::border`].
pub fn flat_faces(mask: &Mask) -> Vec<FlatFace> {
    let coarse = mask.grid.spacing().into_iter().fold(0.0, f64::max);
    let points = BoundaryPoints::new(mask);
    let seeds = seeds(&points, SEEDS * coarse);
    let mut candidates: Vec<(f64, Plane)> = seeds
        .par_iter()
        .flat_map_iter(|seed| {
            let mut own: Vec<(f64, Plane)> = NEIGHBOURHOODS
                .iter()
                .filter_map(|r| {
                    let plane = fit(&points, &seed.at, &seed.normal, r * coarse, mask)?;
                    Some((score(mask, &plane, WINDOW * coarse)?, plane))
                })
                .collect();
            own.sort_by(|a, b| b.0.total_cmp(&a.0));
            own.truncate(1);
            own
        })
        .collect();
    let order = |p: &Plane| [p.origin.x, p.origin.y, p.origin.z];
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| order(&a.1).partial_cmp(&order(&b.1)).unwrap_or(std::cmp::Ordering::Equal)));
    let mut found: Vec<FlatFace> = Vec::new();
    let mut refused: Vec<Plane> = Vec::new();
    for (_, plane) in candidates {
        let taken = |f: &FlatFace| {
            let d = plane.origin - f.plane.origin;
            let out = d.dot(&f.plane.normal).abs();
            (d - f.plane.normal * d.dot(&f.plane.normal)).norm() <= f.reach + f.voxel && out <= 2.0 * f.voxel || d.norm() < 0.8 * f.radius()
        };
        if found.iter().any(taken) {
            continue;
        }
        let alike = |p: &Plane| (p.origin - plane.origin).norm() < 1.5 * coarse && p.normal.dot(&plane.normal) > 0.97;
        if refused.iter().any(alike) {
            continue;
        }
        let Some(face) = whole(mask, &points, &plane) else {
            refused.push(plane);
            continue;
        };
        let same = |f: &FlatFace| (f.plane.origin - face.plane.origin).norm() < 0.8 * f.radius().max(face.radius());
        if !found.iter().any(same) {
            found.push(face);
        }
    }
    found
}

/// Some points of the boundary, about `apart` mm from one another.
fn seeds(points: &BoundaryPoints, apart: f64) -> Vec<BoundaryPoint> {
    let mut taken = std::collections::HashSet::new();
    let cell = |p: &Point| [0, 1, 2].map(|a| (p[a] / apart).floor() as i64);
    points.all().iter().filter(|p| taken.insert(cell(&p.at))).copied().collect()
}

/// The plane through what lies flat round a place.
fn fit(points: &BoundaryPoints, center: &Point, normal: &Vector, radius: f64, mask: &Mask) -> Option<Plane> {
    let near: Vec<&BoundaryPoint> = points.near(center, radius).collect();
    if near.len() < 6 {
        return None;
    }
    let agree = |p: &&&BoundaryPoint| p.normal.dot(normal) > AGREE;
    let mut n = near.iter().filter(agree).map(|p| p.normal).sum::<Vector>().try_normalize(1e-9)?;
    let mut origin = *center;
    for pass in 0..PASSES {
        let thick = 0.5 * mask.grid.voxel_diagonal() * if pass == 0 { 1.5 } else { 1.0 };
        let own: Vec<Point> = near.iter().filter(|p| (p.at - origin).dot(&n).abs() <= thick && p.normal.dot(&n) > AGREE).map(|p| p.at).collect();
        let (middle, turned) = plane_of(&own, &n)?;
        let still = turned.dot(&n) > 0.99999 && (middle - origin).dot(&n).abs() < 1e-3 * thick;
        (origin, n) = (middle, turned);
        if still {
            break;
        }
    }
    Plane::new(origin, n)
}

/// Middle and direction of least spread.
fn plane_of(own: &[Point], like: &Vector) -> Option<(Point, Vector)> {
    if own.len() < 6 {
        return None;
    }
    let middle = Point::from(own.iter().map(|p| p.coords).sum::<Vector>() / own.len() as f64);
    let spread: nalgebra::Matrix3<f64> = own.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
    let eigen = spread.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let n: Vector = eigen.eigenvectors.column(least).into_owned();
    let n = if n.dot(like) < 0.0 { -n } else { n };
    (n.dot(like) > 0.5).then_some((middle, n))
}

/// How a section a voxel behind a plane stands to those round it.
struct Step {
    /// Part of it that is lumen on the outside.
    outside: f64,
    /// Part of it that is there half a voxel inside.
    at_once: f64,
    /// Ratio to the section two voxels inside.
    steady: f64,
    /// Part of its rim with background beside it a voxel and two inside.
    free: f64,
    /// Whether it is five voxels wide on either side: of smaller ones the voxels' own steps look alike.
    large: bool,
}

impl Step {
    fn new(slices: &Slices, one: &Slice, h: f64, coarse: f64) -> Step {
        Step {
            outside: slices.covered(one, -0.9 * h),
            at_once: slices.covered(one, 0.5 * h),
            steady: ratio(one.count, slices.next(one, 2.2 * h).count),
            free: slices.free_rim(one, 0.6 * coarse, &[h, 2.2 * h]),
            large: slices.area(one.count) > std::f64::consts::PI * (5.0 * coarse).powi(2),
        }
    }

    /// Whether the section is there at once and grows but slowly behind, as that of a chamber does.
    fn is_crisp(&self) -> bool {
        self.large && self.at_once >= 0.85 && self.outside < 0.05 && self.steady >= GROWING
    }

    /// From 0 to 1; `None` where the lumen does not end in the plane. A stub that joins its parent on one side within two
    /// voxels has no steady section, but a rim that stays where it is on the others: that of a dome or flank moves outwards.
    fn sharpness(&self) -> Option<f64> {
        let at_once = if self.steady > 0.95 && self.outside < 0.03 { AT_ONCE - 0.07 } else { AT_ONCE };
        if self.outside > OUTSIDE || self.at_once < at_once {
            return None;
        }
        if self.is_crisp() {
            return Some((1.0 - self.outside) * self.steady.max(STEADY) * self.at_once);
        }
        let joined = self.free * self.at_once >= if self.steady < ABRUPT { FREE } else { MOSTLY_FREE } && self.at_once > 0.8 && self.outside < 0.06;
        match self.steady {
            s if s >= STEADY => Some((1.0 - self.outside) * s * self.at_once),
            _ if joined => Some((1.0 - self.outside) * STEADY * self.at_once),
            _ => None,
        }
    }
}

/// How sharply the lumen ends at a plane, above 0; `None` where it does not. Looks no farther than `window` mm.
fn score(mask: &Mask, plane: &Plane, window: f64) -> Option<f64> {
    let coarse = mask.grid.spacing().into_iter().fold(0.0, f64::max);
    let h = voxel_along(mask, &plane.normal);
    let slices = Slices::new(mask, plane, window, 0.6 * coarse);
    let one = slices.first(h, 1.5 * coarse)?;
    if slices.area(one.count) < std::f64::consts::PI * (0.8 * LEAST_RADIUS * coarse).powi(2) || slices.covered(&one, -0.9 * h) > OUTSIDE {
        return None;
    }
    Step::new(&slices, &one, h, coarse).sharpness()
}

fn ratio(a: usize, b: usize) -> f64 {
    a.min(b) as f64 / a.max(b).max(1) as f64
}

/// A raster that holds the whole section at a depth.
fn raster<'a>(mask: &'a Mask, plane: &Plane, depth: f64, near: f64) -> Option<(Slices<'a>, Slice)> {
    let spacing = mask.grid.spacing();
    let (fine, coarse) = (spacing.into_iter().fold(f64::INFINITY, f64::min), spacing.into_iter().fold(0.0, f64::max));
    let most = (0..3).map(|a| (mask.grid.dims[a] as f64 * spacing[a]).powi(2)).sum::<f64>().sqrt();
    let mut reach = 12.0 * coarse;
    loop {
        let slices = Slices::new(mask, plane, reach, (0.5 * fine).max(reach / 90.0));
        let slice = slices.first(depth, near)?;
        if !slice.clipped || reach > most {
            return Some((slices, slice));
        }
        reach *= 1.7;
    }
}

/// The whole face at a candidate, fitted to all of its points; `None` where it is none.
fn whole(mask: &Mask, points: &BoundaryPoints, plane: &Plane) -> Option<FlatFace> {
    let coarse = mask.grid.spacing().into_iter().fold(0.0, f64::max);
    let mut plane = *plane;
    // The middle moves with the fit, and the fit with what the section holds.
    for _ in 0..2 {
        let h = voxel_along(mask, &plane.normal);
        let (slices, slice) = raster(mask, &plane, h, 1.5 * coarse)?;
        let (middle, [long, _]) = slices.shape(&slice, 0.0);
        let thick = 0.5 * mask.grid.voxel_diagonal();
        let near = points.near(&middle, 1.3 * long + coarse);
        let own: Vec<Point> = near
            .filter(|p| plane.signed_distance(&p.at).abs() <= thick && p.normal.dot(&plane.normal) > AGREE && slices.holds(&slice, &p.at))
            .map(|p| p.at)
            .collect();
        if let Some((fitted, n)) = plane_of(&own, &plane.normal) {
            plane = Plane::new(fitted, n)?;
            plane.origin = plane.project(&middle);
        }
    }
    let h = voxel_along(mask, &plane.normal);
    let (slices, one) = raster(mask, &plane, h, 1.5 * coarse)?;
    let (_, [long, short]) = slices.shape(&one, 0.0);
    let area = slices.area(one.count);
    let radius = (area / std::f64::consts::PI).sqrt();
    let step = Step::new(&slices, &one, h, coarse);
    let sharp = step.sharpness()?;
    let slender = long / short;
    if radius < LEAST_RADIUS * coarse || slender > ASPECT || sharp < (SHARP + SLENDER * (slender - 1.5).max(0.0) + SMALL * (3.0 - radius / coarse).max(0.0)).min(SHARPEST) {
        return None;
    }
    let joined = step.steady < STEADY && !step.is_crisp();
    if joined && slender > 2.0 {
        return None;
    }
    let profile = Profile::new(mask, &plane, h, h, 1.5 * coarse, long.max(2.5 * radius))?;
    let at = |depth: f64| profile.area(depth);
    // A blurred step needs a section that stays; a sharp one may lead into something wider at once.
    let stays = area >= DEEPER * at((0.5 * radius).min(4.0 * h).max(2.2 * h));
    let depth = long * (0.5 + 0.5 * ((slender - 1.6) / 0.8).clamp(0.0, 1.0));
    // Behind a slender section all the way counts: another leg of a bent vessel may come up farther on.
    let behind = if slender > 1.6 { profile.range(2.0 * h, depth.max(2.0 * h))[0] } else { at(depth.max(2.0 * h)) };
    if !joined && !step.is_crisp() && sharp < CLEAR && !stays || behind < DEEP * area {
        return None;
    }
    if joined {
        let reach = (0..one.own.len()).filter(|&n| one.own[n]).map(|n| (slices.at(n, 0.0) - plane.origin).norm()).fold(0.0, f64::max);
        return Some(FlatFace { plane, area, reach, axis: plane.normal, straight: 0.0, voxel: h, joined });
    }
    let two = slices.next(&one, 2.0 * h);
    let (middle, _) = slices.shape(&two, 0.0);
    let area = if step.steady < 0.95 { area } else { 0.5 * (area + slices.area(two.count)) };
    let (axis, straight) = profile.axis(&plane.normal, radius);
    // Sections of a slanted vessel wander along its axis.
    let slide = axis - plane.normal * axis.dot(&plane.normal);
    plane.origin = plane.project(&(middle + slide * (1.5 * h / axis.dot(&plane.normal).max(0.3))));
    let reach = (0..one.own.len()).filter(|&n| one.own[n]).map(|n| (slices.at(n, 0.0) - plane.origin).norm()).fold(0.0, f64::max);
    Some(FlatFace { plane, area, reach, axis, straight, voxel: h, joined })
}

/// The sections behind a plane, each connected to the one before.
pub(super) struct Profile {
    /// Depth, area and middle.
    sections: Vec<(f64, f64, Point)>,
    aspect: f64,
}

impl Profile {
    /// Sections from `first` to `last` mm behind the plane, the first one nearest to the plane's origin, no farther from it than `near`.
    pub fn new(mask: &Mask, plane: &Plane, voxel: f64, first: f64, near: f64, last: f64) -> Option<Profile> {
        let spacing = mask.grid.spacing();
        let fine = spacing.into_iter().fold(f64::INFINITY, f64::min);
        let (wide, one) = raster(mask, plane, first, near)?;
        let (middle, [long, short]) = wide.shape(&one, 0.0);
        let reach = (middle - plane.origin).norm() + 2.5 * long + last.min(4.0 * long);
        let slices = Slices::new(mask, plane, reach, (0.5 * fine).max(reach / 70.0));
        let mut slice = slices.first(first, near)?;
        let mut depth = first;
        let mut sections = Vec::new();
        let step = (0.75 * voxel).max(last / 60.0);
        while slice.count > 0 {
            let (middle, _) = slices.shape(&slice, depth);
            sections.push((depth, slices.area(slice.count), middle));
            if depth >= last {
                break;
            }
            depth += step;
            slice = slices.next(&slice, depth);
        }
        Some(Profile { sections, aspect: long / short })
    }

    /// Ratio of the half axes of the first section.
    pub fn aspect(&self) -> f64 {
        self.aspect
    }

    /// Area at a depth, 0 behind the last section.
    pub fn area(&self, depth: f64) -> f64 {
        let n = self.sections.partition_point(|s| s.0 < depth);
        match (n.checked_sub(1).map(|n| self.sections[n]), self.sections.get(n)) {
            (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (depth - a.0) / (b.0 - a.0),
            (None, Some(b)) => b.1,
            _ => 0.0,
        }
    }

    /// Least and largest area between two depths.
    pub fn range(&self, from: f64, to: f64) -> [f64; 2] {
        let inner = self.sections.iter().filter(|s| s.0 >= from && s.0 <= to).map(|s| s.1);
        let all = inner.chain([self.area(from), self.area(to)]);
        all.fold([f64::INFINITY, 0.0], |[low, high], a| [low.min(a), high.max(a)])
    }

    /// Direction in which the middles run while the sections stay alike, towards the plane, and the depth to which they do.
    pub fn axis(&self, normal: &Vector, radius: f64) -> (Vector, f64) {
        let Some(first) = self.sections.first() else { return (*normal, 0.0) };
        let usual = self.sections.get(1).map_or(first.1, |s| s.1);
        let alike: Vec<_> = self.sections.iter().take_while(|s| s.1 > 0.75 * usual && s.1 < 1.3 * usual && s.0 < first.0 + 2.5 * radius).collect();
        let straight = alike.last().map_or(0.0, |s| s.0);
        let used: Vec<_> = alike.iter().filter(|s| s.0 <= first.0 + 1.5 * radius).collect();
        if used.len() < 4 || straight < 0.5 * radius {
            return (*normal, straight);
        }
        let n = used.len() as f64;
        let depth = used.iter().map(|s| s.0).sum::<f64>() / n;
        let middle = used.iter().map(|s| s.2.coords).sum::<Vector>() / n;
        let slope: Vector = used.iter().map(|s| (s.2.coords - middle) * (s.0 - depth)).sum();
        let axis = (-slope).try_normalize(1e-12).filter(|a| a.dot(normal) > 0.3).unwrap_or(*normal);
        (axis, straight)
    }
}
