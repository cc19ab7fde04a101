//! Where the lumen meets the border of the image, and what it does there.
//!
//! Every connected region of lumen on a face of the image is told apart by the areas of the sections parallel to that
//! face, R being the radius of the circle of the region's area:
//!
//! - it *grazes*: less than 0.6 of its area is left at a depth of 0.75 R, or the section is more than 1.9 times as large
//!   at 0.5 R; of a slender region, whose half axes differ by a factor of more than 1.6, if the section differs by more than
//!   about a tenth between 0.25 R and R; the vessel goes on beside the border, and the region is a piece of its side;
//! - it is a *cropped sac*: it is not slender, and within 2 R the section never grows beyond 1.75 times the region, and shrinks below 0.3 of it;
//! - otherwise the vessel *leaves* the image there.

use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;

use super::faces::Profile;

/// Depth of a cut along the image's face below the outermost voxels' outer sides, in voxels.
const INSET: f64 = 0.25;
/// A region below this many voxels is too small to tell.
const LEAST: usize = 4;

/// What the lumen does at the border.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtBorder {
    /// The vessel leaves the image.
    Leaves,
    /// The vessel runs along the border.
    Grazes,
    /// A sac is cropped.
    CroppedSac,
}

/// A connected piece of lumen in the outermost layer of voxels on one face of the image.
#[derive(Debug, Clone, PartialEq)]
pub struct BorderRegion {
    /// Axis of the grid and side of the image.
    face: (usize, bool),
    /// Voxels in the indices of the mask that it was found in, ascending.
    voxels: Vec<[i64; 3]>,
    /// Plane of the outermost voxels' outer sides, at the region's middle; normal out of the image.
    pub plane: Plane,
    /// Area on the face, mm².
    pub area: f64,
    /// Farthest of its voxels from the middle, mm.
    pub reach: f64,
    /// What the lumen does there.
    pub kind: AtBorder,
    /// Direction of the vessel behind it, out of the image.
    pub axis: Vector,
    /// Depth to which the sections parallel to the face stay alike, mm.
    pub straight: f64,
    /// Size of a voxel along the normal, mm.
    pub voxel: f64,
    /// Largest section parallel to the face within two radii, mm².
    pub largest: f64,
}

impl BorderRegion {
    /// Radius of the circle of its area, mm.
    pub fn radius(&self) -> f64 {
        (self.area / std::f64::consts::PI).sqrt()
    }

    /// Whether the tip of a centerline of the padded mask lies at this region.
    pub fn holds(&self, tip: &Point) -> bool {
        let d = tip - self.plane.origin;
        let out = d.dot(&self.plane.normal);
        let aside = (d - self.plane.normal * out).norm();
        aside <= 1.1 * self.reach + 2.0 * self.voxel && out >= -1.5 * self.radius().min(self.reach) - 2.0 * self.voxel
    }

    /// The plane just inside the face, its origin at the region's middle.
    pub fn inset(&self) -> Plane {
        Plane { origin: self.plane.origin - self.plane.normal * (INSET * self.voxel), normal: self.plane.normal }
    }

    /// Whether a voxel of the mask that it was found in belongs to it.
    pub fn has(&self, v: &[i64; 3]) -> bool {
        self.voxels.binary_search(v).is_ok()
    }

    /// Axis of the grid and side of the image.
    pub fn side(&self) -> (usize, bool) {
        self.face
    }
}

/// All regions of lumen on the image's border.
pub fn border_regions(mask: &Mask) -> Vec<BorderRegion> {
    let mut found = Vec::new();
    for a in 0..3 {
        for upper in [false, true] {
            let at = mask.image[a][usize::from(upper)];
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            let mut seen = std::collections::BTreeSet::new();
            for q in 0..mask.grid.dims[c] as i64 {
                for p in 0..mask.grid.dims[b] as i64 {
                    let mut v = [0; 3];
                    (v[a], v[b], v[c]) = (at, p, q);
                    if mask.at(v[0], v[1], v[2]) && !seen.contains(&v) {
                        let voxels = flood(mask, v, (a, upper));
                        seen.extend(voxels.iter().copied());
                        found.extend(region(mask, voxels, (a, upper)));
                    }
                }
            }
        }
    }
    found
}

fn flood(mask: &Mask, first: [i64; 3], face: (usize, bool)) -> Vec<[i64; 3]> {
    let mut voxels = vec![first];
    let mut seen = std::collections::BTreeSet::from([first]);
    let mut next = 0;
    while next < voxels.len() {
        let v = voxels[next];
        next += 1;
        for n in 0..4 {
            let mut w = v;
            w[(face.0 + 1 + n / 2) % 3] += if n % 2 == 0 { 1 } else { -1 };
            let inside = (0..3).all(|a| w[a] >= mask.image[a][0] && w[a] <= mask.image[a][1]);
            if inside && mask.at(w[0], w[1], w[2]) && seen.insert(w) {
                voxels.push(w);
            }
        }
    }
    voxels.sort_unstable();
    voxels
}

fn region(mask: &Mask, voxels: Vec<[i64; 3]>, face: (usize, bool)) -> Option<BorderRegion> {
    let s = mask.grid.spacing();
    let h = s[face.0];
    let area = voxels.len() as f64 * s[(face.0 + 1) % 3] * s[(face.0 + 2) % 3];
    let outer = |v: &[i64; 3]| {
        let mut x = Vector::new(v[0] as f64, v[1] as f64, v[2] as f64);
        x[face.0] += if face.1 { 0.5 } else { -0.5 };
        mask.grid.to_world(x)
    };
    let middle = Point::from(voxels.iter().map(|v| outer(v).coords).sum::<Vector>() / voxels.len() as f64);
    let outward = mask.grid.axes.column(face.0).into_owned() * if face.1 { 1.0 } else { -1.0 };
    // Of a ring or crescent the middle lies outside: its voxel nearest to the middle stands for it.
    let nearest = voxels.iter().map(outer).min_by(|p, q| (p - middle).norm().total_cmp(&(q - middle).norm()))?;
    let origin = if (nearest - middle).norm() <= s.into_iter().fold(0.0, f64::max) { middle } else { nearest };
    let plane = Plane::new(origin, outward)?;
    let reach = voxels.iter().map(|v| (outer(v) - origin).norm()).fold(0.0, f64::max);
    let radius = (area / std::f64::consts::PI).sqrt();
    let mut found =
        BorderRegion { face, plane, area, reach, kind: AtBorder::Grazes, axis: plane.normal, straight: 0.0, voxel: h, largest: area, voxels };
    if found.voxels.len() < LEAST {
        return Some(found);
    }
    let near = 2.0 * s.into_iter().fold(0.0, f64::max);
    let profile = Profile::new(mask, &plane, h, 0.5 * h, near, (2.0 * radius).max(2.0 * h))?;
    let at = |radii: f64| profile.area((radii * radius).max(0.5 * h));
    let first = at(0.0);
    let [least, most] = profile.range(0.5 * h, 2.0 * radius);
    (found.axis, found.straight) = profile.axis(&plane.normal, radius);
    found.largest = most;
    let slender = profile.aspect() > 1.6;
    let [low, high] = profile.range(0.25 * radius, radius);
    let changes = if slender { low < 0.85 * first || high > 1.12 * first } else { at(0.75) < 0.6 * first || at(0.5) > 1.9 * first };
    found.kind = if changes {
        AtBorder::Grazes
    } else if !slender && most <= 1.75 * first && least < 0.3 * first {
        AtBorder::CroppedSac
    } else {
        AtBorder::Leaves
    };
    Some(found)
}

/// Whether a plane lies along a face of the image, within a voxel of it, where lumen meets that face.
pub(super) fn along_face(mask: &Mask, plane: &Plane) -> bool {
    let x = mask.grid.to_index(&plane.origin);
    (0..3).any(|a| {
        let outward = mask.grid.axes.column(a).normalize().dot(&plane.normal);
        let face = if outward > 0.0 { mask.image[a][1] } else { mask.image[a][0] };
        outward.abs() > 0.9999 && (x[a] - face as f64).abs() <= 1.0 && {
            let mut v = [0, 1, 2].map(|b| x[b].round() as i64);
            v[a] = face;
            mask.at(v[0], v[1], v[2])
        }
    })
}

pub(super) fn in_image(mask: &Mask, p: &Point) -> bool {
    let x = mask.grid.to_index(p);
    (0..3).all(|a| x[a] >= mask.image[a][0] as f64 && x[a] <= mask.image[a][1] as f64)
}

/// Whether the disc lies between the centres of the image's outermost voxels.
pub(super) fn disc_inside(mask: &Mask, plane: &Plane, radius: f64) -> bool {
    let (u, v) = plane.basis();
    (0..16).all(|n| {
        let (s, c) = (std::f64::consts::TAU * f64::from(n) / 16.0).sin_cos();
        in_image(mask, &(plane.origin + (u * c + v * s) * radius))
    })
}
