//! Where the lumen leaves the picture.

use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;

/// Depth of a cut along the picture's face below the outermost voxels' outer sides, in voxels.
const INSET: f64 = 0.25;

/// A connected piece of lumen in the outermost layer of voxels on one face of the picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Region {
    /// Axis of the grid and side of the picture.
    face: (usize, bool),
    voxels: Vec<[i64; 3]>,
}

impl Region {
    /// The region that a tip leaves through; `None` for a tip inside the picture.
    pub fn at(mask: &Mask, tip: &Point) -> Option<Region> {
        let x = mask.grid.to_index(tip);
        for a in 0..3 {
            let [low, high] = mask.image[a];
            let upper = x[a] >= high as f64 - 1.0;
            if x[a] > low as f64 + 1.0 && !upper {
                continue;
            }
            let mut v = [0, 1, 2].map(|b| (x[b].round() as i64).clamp(mask.image[b][0], mask.image[b][1]));
            v[a] = if upper { high } else { low };
            let steps = (0..9).map(|n| [n % 3 - 1, n / 3 - 1]);
            let near = steps.map(|[p, q]| {
                let mut w = v;
                w[(a + 1) % 3] += p;
                w[(a + 2) % 3] += q;
                w
            });
            let first = near.filter(|w| mask.at(w[0], w[1], w[2])).min_by_key(|w| (0..3).map(|b| (w[b] - v[b]).pow(2)).sum::<i64>());
            if let Some(first) = first {
                return Some(Region::flood(mask, first, (a, upper)));
            }
        }
        None
    }

    fn flood(mask: &Mask, first: [i64; 3], face: (usize, bool)) -> Region {
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
        Region { face, voxels }
    }

    /// Area on the face, mm².
    pub fn area(&self, mask: &Mask) -> f64 {
        let s = mask.grid.spacing();
        self.voxels.len() as f64 * s[(self.face.0 + 1) % 3] * s[(self.face.0 + 2) % 3]
    }

    /// Whether all of it lies beyond a plane.
    pub fn beyond(&self, mask: &Mask, plane: &Plane) -> bool {
        self.voxels.iter().all(|v| plane.signed_distance(&self.outer(mask, v)) > 0.0)
    }

    /// The plane just inside the face, at the region's voxel nearest to `near`, its normal out of the picture.
    pub fn plane(&self, mask: &Mask, near: &Point) -> Option<Plane> {
        let position = |v: &[i64; 3]| mask.grid.to_world(Vector::new(v[0] as f64, v[1] as f64, v[2] as f64));
        // Away from the region's rim, as far as voxels tell: the nearest of those with four neighbours.
        let full = |v: &[i64; 3]| {
            (0..4).all(|n| {
                let mut w = *v;
                w[(self.face.0 + 1 + n / 2) % 3] += if n % 2 == 0 { 1 } else { -1 };
                self.voxels.binary_search(&w).is_ok()
            })
        };
        let distance = |v: &[i64; 3]| (position(v) - near).norm();
        let nearest = self.voxels.iter().min_by(|a, b| full(b).cmp(&full(a)).then(distance(a).total_cmp(&distance(b))))?;
        let outward = mask.grid.axes.column(self.face.0).into_owned() * if self.face.1 { 1.0 } else { -1.0 };
        Plane::new(position(nearest) + outward * (0.5 - INSET), outward)
    }

    /// Middle of a voxel's outer side.
    fn outer(&self, mask: &Mask, v: &[i64; 3]) -> Point {
        let mut x = Vector::new(v[0] as f64, v[1] as f64, v[2] as f64);
        x[self.face.0] += if self.face.1 { 0.5 } else { -0.5 };
        mask.grid.to_world(x)
    }
}

/// Whether a plane lies along a face of the picture, within a voxel of it, where lumen meets that face.
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

/// Whether the disc lies between the centres of the picture's outermost voxels.
pub(super) fn disc_inside(mask: &Mask, plane: &Plane, radius: f64) -> bool {
    let (u, v) = plane.basis();
    (0..16).all(|n| {
        let (s, c) = (std::f64::consts::TAU * f64::from(n) / 16.0).sin_cos();
        in_image(mask, &(plane.origin + (u * c + v * s) * radius))
    })
}
