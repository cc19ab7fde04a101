//! The mask's boundary as points with directions, found by place.

use rayon::prelude::*;

use crate::geometry::{Point, Vector};
use crate::mask::{Mask, interface};

/// Standard deviation of the blur that gives directions, in the largest voxel edge.
const BLUR: f64 = 1.3;

/// Side of the cells that points are sorted into, in the largest voxel edge.
const CELL: f64 = 2.0;

/// A middle of a face between lumen and background.
#[derive(Debug, Clone, Copy)]
pub(super) struct BoundaryPoint {
    pub at: Point,
    /// Out of the lumen, of unit length.
    pub normal: Vector,
}

/// Points by cell.
pub(super) struct BoundaryPoints {
    points: Vec<BoundaryPoint>,
    /// First point of each cell.
    starts: Vec<u32>,
    low: Point,
    dims: [i64; 3],
    side: f64,
}

impl BoundaryPoints {
    /// Faces that lie on the image's border are left out: there the image ends, and not the vessel.
    pub fn new(mask: &Mask) -> BoundaryPoints {
        let spacing = mask.grid.spacing();
        let coarse = spacing.into_iter().fold(0.0, f64::max);
        let weights = kernel(mask, BLUR * coarse);
        let voxels = interface(mask);
        let found: Vec<Vec<BoundaryPoint>> = voxels.par_iter().filter(|(v, _)| mask.at(v[0].into(), v[1].into(), v[2].into())).map(|(v, _)| faces(mask, *v, &weights)).collect();
        let mut points: Vec<BoundaryPoint> = found.into_iter().flatten().collect();
        let side = CELL * coarse;
        let bounds = crate::geometry::Aabb::of(points.iter().map(|p| &p.at));
        let low = if points.is_empty() { Point::origin() } else { bounds.min };
        let dims = if points.is_empty() { [1; 3] } else { [0, 1, 2].map(|a| ((bounds.max[a] - low[a]) / side) as i64 + 1) };
        let key = |p: &BoundaryPoint| {
            let c = [0, 1, 2].map(|a| ((p.at[a] - low[a]) / side) as i64);
            (c[0] + dims[0] * (c[1] + dims[1] * c[2])) as usize
        };
        points.sort_by_key(key);
        let mut starts = vec![0u32; (dims[0] * dims[1] * dims[2]) as usize + 1];
        points.iter().for_each(|p| starts[key(p) + 1] += 1);
        for n in 1..starts.len() {
            starts[n] += starts[n - 1];
        }
        BoundaryPoints { points, starts, low, dims, side }
    }

    /// All of them, near ones together.
    pub fn all(&self) -> &[BoundaryPoint] {
        &self.points
    }

    /// Points within `radius` of a place.
    pub fn near<'a>(&'a self, center: &Point, radius: f64) -> impl Iterator<Item = &'a BoundaryPoint> {
        let center = *center;
        let range = |a: usize| {
            let cell = |x: f64| (((x - self.low[a]) / self.side).floor() as i64).clamp(0, self.dims[a] - 1);
            cell(center[a] - radius)..=cell(center[a] + radius)
        };
        let (xs, ys, zs) = (range(0), range(1), range(2));
        let rows = zs.flat_map(move |k| ys.clone().map(move |j| (j, k)));
        let cells = rows.flat_map(move |(j, k)| {
            let first = self.dims[0] * (j + self.dims[1] * k);
            let (from, to) = (self.starts[(first + xs.start()) as usize], self.starts[(first + xs.end()) as usize + 1]);
            &self.points[from as usize..to as usize]
        });
        cells.filter(move |p| (p.at - center).norm_squared() <= radius * radius)
    }
}

/// Offsets within 2.2 standard deviations with their weighted directions.
fn kernel(mask: &Mask, sigma: f64) -> Vec<([i64; 3], Vector)> {
    let s = mask.grid.spacing();
    let reach = s.map(|s| (2.2 * sigma / s).floor() as i64);
    let mut all = Vec::new();
    for k in -reach[2]..=reach[2] {
        for j in -reach[1]..=reach[1] {
            for i in -reach[0]..=reach[0] {
                let d = mask.grid.axes * Vector::new(i as f64, j as f64, k as f64);
                let r = d.norm_squared() / (sigma * sigma);
                if r > 0.0 && r <= 2.2f64.powi(2) {
                    all.push(([i, j, k], d * (-0.5 * r).exp()));
                }
            }
        }
    }
    all
}

fn faces(mask: &Mask, v: [i32; 3], weights: &[([i64; 3], Vector)]) -> Vec<BoundaryPoint> {
    let v = v.map(i64::from);
    let mut inward = Vector::zeros();
    for (o, w) in weights {
        if mask.at(v[0] + o[0], v[1] + o[1], v[2] + o[2]) {
            inward += w;
        }
    }
    let Some(normal) = (-inward).try_normalize(1e-12) else { return Vec::new() };
    let mut found = Vec::new();
    for a in 0..3 {
        for sign in [-1i64, 1] {
            let mut w = v;
            w[a] += sign;
            let in_image = w[a] >= mask.image[a][0] && w[a] <= mask.image[a][1];
            if in_image && !mask.at(w[0], w[1], w[2]) {
                let mut x = Vector::new(v[0] as f64, v[1] as f64, v[2] as f64);
                x[a] += 0.5 * sign as f64;
                found.push(BoundaryPoint { at: mask.grid.to_world(x), normal });
            }
        }
    }
    found
}
