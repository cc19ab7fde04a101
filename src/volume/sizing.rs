//! Wished edge lengths inside: the surface's own at the wall, growing inwards, never more than a part of the radius.

use rayon::prelude::*;
use serde::Serialize;

use super::Error;
use crate::geometry::{Point, Vector};
use crate::mesh::TriMesh;
use crate::mesh::bvh::{Closest, TriangleBvh};
use crate::remesh::SizeField;

/// Sizes of the interior.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SizingOptions {
    /// Growth of the edge length for each mm away from the wall.
    pub growth: f64,
    /// Largest edge as a part of the local radius (of the largest ball inside that touches the wall there).
    pub radius_fraction: f64,
    /// Largest edge, mm, where given; the surface's own edges stay as they are.
    pub max_edge: Option<f64>,
    /// Wished number of cells; interior sizes are scaled within a factor of 4 to come near. The surface stays.
    pub target_cells: Option<u64>,
}

impl Default for SizingOptions {
    fn default() -> Self {
        SizingOptions { growth: 0.2, radius_fraction: 1.0 / 3.0, max_edge: None, target_cells: None }
    }
}

impl SizingOptions {
    pub(super) fn check(&self) -> Result<(), Error> {
        if !(0.0..=2.0).contains(&self.growth) {
            return Err(Error::Option { option: "growth", value: self.growth, must: "between 0 and 2" });
        }
        if !(0.02..=10.0).contains(&self.radius_fraction) {
            let value = self.radius_fraction;
            return Err(Error::Option { option: "radius_fraction", value, must: "between 0.02 and 10" });
        }
        if let Some(value) = self.max_edge.filter(|h| !(h.is_finite() && *h > 0.0)) {
            return Err(Error::Option { option: "max_edge", value, must: "above 0" });
        }
        if self.target_cells == Some(0) {
            return Err(Error::Option { option: "target_cells", value: 0.0, must: "at least 1" });
        }
        Ok(())
    }
}

/// Tetrahedra of edge h that fill h³: between the regular one (8.49, which does not fill space) and what meshes
/// of well-shaped tetrahedra are measured to have.
const TETS_PER_CUBE: f64 = 8.0;

/// What the factor on interior sizes may be.
const FACTORS: (f64, f64) = (0.25, 4.0);

/// Tetrahedra that `interior` points inside a surface of `surface` points end up with once they are optimised: each
/// vertex inside brings as many, each on the surface fewer. Measured on four vessels from 6,000 to 35,000 points inside, on
/// which it holds within 0.4 %.
pub(super) fn cells_of_points(interior: usize, surface: usize) -> f64 {
    6.05 * interior as f64 + 2.76 * surface as f64
}

/// The size field of the interior.
pub struct Sizing<'a> {
    bvh: &'a TriangleBvh,
    triangles: &'a [[u32; 3]],
    /// At each vertex of the surface: wall size, and the bound from the radius.
    wall: Vec<f64>,
    cap: Vec<f64>,
    growth: f64,
    factor: f64,
    estimate: u64,
    /// Volume, unscaled size and depth in wall edges at sample points.
    samples: Vec<(f64, f64, f64)>,
}

/// Size and where the wall is.
#[derive(Debug, Clone, Copy)]
pub struct Here {
    /// Wished edge length, mm.
    pub size: f64,
    /// Distance to the wall, mm.
    pub distance: f64,
    /// The nearest point of the wall.
    pub wall: Point,
}

impl<'a> Sizing<'a> {
    /// Sizes for the interior of `surface`; `size` counts on the surface only, within a factor 1.5 of its edges there.
    pub fn new(surface: &'a TriMesh, bvh: &'a TriangleBvh, size: &dyn SizeField, options: &SizingOptions) -> Sizing<'a> {
        let n = surface.points.len();
        let mut sum = vec![(0.0, 0u32); n];
        let mut normal = vec![Vector::zeros(); n];
        for (t, c) in surface.triangles.iter().enumerate() {
            let area = surface.area_vector2(t);
            for i in 0..3 {
                let (a, b) = (c[i] as usize, c[(i + 1) % 3] as usize);
                let l = (surface.points[a] - surface.points[b]).norm();
                for v in [a, b] {
                    sum[v].0 += l;
                    sum[v].1 += 1;
                }
                normal[a] += area;
            }
        }
        let wall: Vec<f64> = (0..n)
            .into_par_iter()
            .map(|v| {
                let edge = sum[v].0 / f64::from(sum[v].1.max(1));
                let s = size.size(&surface.points[v]);
                if s.is_finite() && s > 0.0 { s.clamp(edge / 1.5, 1.5 * edge) } else { edge }
            })
            .collect();
        let reach = bvh.bounds().diagonal();
        let cap: Vec<f64> = (0..n)
            .into_par_iter()
            .map(|v| {
                let r = inscribed_radius(bvh, &surface.points[v], &normal[v], wall[v], reach);
                (options.radius_fraction * r).min(options.max_edge.unwrap_or(f64::INFINITY)).max(wall[v])
            })
            .collect();
        let cap = smooth_lower(surface, cap, 0.3);
        let mut s = Sizing { bvh, triangles: &surface.triangles, wall, cap, growth: options.growth, factor: 1.0, estimate: 0, samples: vec![] };
        s.samples = s.samples(surface);
        if let Some(target) = options.target_cells {
            s.factor = s.factor_for(target as f64);
        }
        s.estimate = s.count(s.factor).round() as u64;
        s
    }

    /// Cells that fit the sizes with this factor.
    fn count(&self, factor: f64) -> f64 {
        self.samples.iter().map(|&(v, h, w)| v * TETS_PER_CUBE / self.scaled(h, w, factor).powi(3)).sum()
    }

    /// The factor with which [`Sizing::count`] gives `cells`, or the nearest that is allowed.
    fn factor_for(&self, cells: f64) -> f64 {
        let (mut lo, mut hi) = FACTORS;
        for _ in 0..40 {
            let mid = (lo * hi).sqrt();
            if self.count(mid) > cells {
                lo = mid;
            } else {
                hi = mid;
            }
        }
        (lo * hi).sqrt()
    }

    /// Corrects the factor where `cells` come out with it and `target` are wished; the estimate becomes what is to be
    /// expected then. `false` where the factor is as far as it may go.
    pub(super) fn correct(&mut self, cells: f64, target: f64) -> bool {
        let calibration = cells / self.count(self.factor);
        let factor = self.factor_for(target / calibration);
        let changes = (factor / self.factor - 1.0).abs() > 1e-3;
        self.factor = factor;
        self.estimate = (calibration * self.count(factor)).round() as u64;
        changes
    }

    /// Cells to expect, within some ten per cent where the interior decides; less sure where the surface does.
    pub fn estimate(&self) -> u64 {
        self.estimate
    }

    /// The factor on interior sizes that the wished number of cells asks for.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// Edge length wished at each vertex of the surface.
    pub fn wall_sizes(&self) -> &[f64] {
        &self.wall
    }

    pub(super) fn bvh(&self) -> &TriangleBvh {
        self.bvh
    }

    /// Sizes next to the wall follow the wall whatever the factor: it acts fully from two wall edges inwards.
    fn scaled(&self, size: f64, depth: f64, factor: f64) -> f64 {
        let t = (0.5 * depth).clamp(0.0, 1.0);
        size * (1.0 + t * (factor - 1.0))
    }

    /// Size and wall distance at `p`, which should lie inside.
    pub fn at(&self, p: &Point) -> Here {
        self.bvh.closest(p).map_or(Here { size: 1.0, distance: 0.0, wall: *p }, |c| self.over(c))
    }

    /// As [`Sizing::at`], the quicker the nearer to `p` the point `near` of the wall lies.
    pub fn at_near(&self, p: &Point, near: &Point) -> Here {
        // The slack keeps ties in reach of the lowest triangle, as without the bound.
        let bound = (near - p).norm() * (1.0 + 1e-9);
        self.bvh.closest_within(p, bound).map_or_else(|| self.at(p), |c| self.over(c))
    }

    /// What holds over the place `c` of the wall.
    fn over(&self, c: Closest) -> Here {
        let t = self.triangles[c.triangle as usize];
        let mean = |a: &[f64]| t.iter().map(|&v| a[v as usize]).sum::<f64>() / 3.0;
        let distance = c.distance;
        let wall = mean(&self.wall);
        let size = (wall + self.growth * distance).min(mean(&self.cap).max(wall));
        Here { size: self.scaled(size, distance / wall, self.factor), distance, wall: c.point }
    }

    /// Volume, unscaled size and depth in wall edges at sample points on lines through the surface's interior.
    fn samples(&self, surface: &TriMesh) -> Vec<(f64, f64, f64)> {
        // Lines along the longest axis keep them few; 64 to 96 across.
        let b = surface.bounds();
        let d = b.max - b.min;
        let along = d.imax();
        let (u, w) = ((along + 1) % 3, (along + 2) % 3);
        let mut sizes = self.wall.clone();
        sizes.sort_by(f64::total_cmp);
        let fine = sizes[sizes.len() / 4];
        let step = |x: f64, most: f64| (x / fine).ceil().clamp(8.0, most);
        let (nu, nw) = (step(d[u], 96.0), step(d[w], 96.0));
        let na = step(d[along], 256.0);
        let cell = d[u] / nu * d[w] / nw * d[along] / na;
        let lines: Vec<(f64, f64)> =
            (0..nu as usize).flat_map(|i| (0..nw as usize).map(move |j| (i as f64, j as f64))).collect();
        lines
            .par_iter()
            .flat_map_iter(|&(i, j)| {
                // Off-centre, so that lines miss the edges of regular surfaces.
                let mut p = b.min;
                p[u] += (i + 0.4837) * d[u] / nu;
                p[w] += (j + 0.5219) * d[w] / nw;
                p[along] -= 1e-3 * d[along];
                let mut direction = Vector::zeros();
                direction[along] = 1.0;
                let mut crossings = vec![];
                let mut from = 0.0;
                while let Some(h) = self.bvh.ray(&(p + direction * from), &direction, 2.0 * d[along]) {
                    from += h.t;
                    crossings.push(from);
                    from += 1e-9 * d[along];
                }
                let mut out = vec![];
                let mut last: Option<Here> = None;
                for k in 0..na as usize {
                    let x = 1e-3 * d[along] + (k as f64 + 0.5) * d[along] / na;
                    if crossings.iter().filter(|&&c| c < x).count() % 2 == 1 {
                        let q = p + direction * x;
                        let here = last.map_or_else(|| self.at(&q), |l| self.at_near(&q, &l.wall));
                        last = Some(here);
                        out.push((cell, here.size, here.distance / fine));
                    }
                }
                out
            })
            .collect()
    }
}

/// Radius of the largest ball inside that touches the surface at `p`: a ball shrinks until nothing pokes into it.
pub(super) fn inscribed_radius(bvh: &TriangleBvh, p: &Point, normal: &Vector, h: f64, reach: f64) -> f64 {
    let Some(n) = normal.try_normalize(0.0) else { return h };
    // Start a little inside: triangles round p are no obstacle.
    let start = p - n * (0.01 * h);
    let mut r = bvh.ray(&start, &-n, reach).map_or(0.5 * reach, |hit| 0.5 * hit.t);
    for _ in 0..8 {
        let c = p - n * r;
        // Anything nearer than that pokes into the ball.
        let Some(q) = bvh.closest_within(&c, 0.98 * r) else { break };
        let v = p - q.point;
        let s = n.dot(&v);
        if s <= 1e-9 * h || v.norm() < 1.5 * h {
            // The obstacle is the neighbourhood itself.
            break;
        }
        r = (v.norm_squared() / (2.0 * s)).min(0.999 * r);
    }
    r.max(h)
}

/// The largest function below `f` that changes at most `slope` for each mm along edges.
pub(super) fn smooth_lower(surface: &TriMesh, mut f: Vec<f64>, slope: f64) -> Vec<f64> {
    let mut edges: Vec<(u32, u32)> = surface
        .triangles
        .iter()
        .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
        .map(|(a, b)| (a.min(b), a.max(b)))
        .collect();
    edges.sort_unstable();
    edges.dedup();
    for round in 0..200 {
        let mut changed = false;
        let mut relax = |&(a, b): &(u32, u32)| {
            let (a, b) = (a as usize, b as usize);
            let l = slope * (surface.points[a] - surface.points[b]).norm();
            for (x, y) in [(a, b), (b, a)] {
                if f[x] > f[y] + l {
                    f[x] = f[y] + l;
                    changed = true;
                }
            }
        };
        if round % 2 == 0 { edges.iter().for_each(&mut relax) } else { edges.iter().rev().for_each(&mut relax) }
        if !changed {
            break;
        }
    }
    f
}

/// Percentiles 5, 50, 95 of (mean edge round a vertex / wished size) over the vertices that are not on the surface.
pub(super) fn size_ratio(sizing: &Sizing<'_>, surface_points: usize, points: &[Point], tets: &[[u32; 4]]) -> [f64; 3] {
    let mut sum = vec![(0.0, 0u32); points.len()];
    for t in tets {
        for i in 0..4 {
            for j in 0..i {
                let l = (points[t[i] as usize] - points[t[j] as usize]).norm();
                for v in [t[i], t[j]] {
                    sum[v as usize].0 += l;
                    sum[v as usize].1 += 1;
                }
            }
        }
    }
    let inside: Vec<usize> = (surface_points..points.len()).filter(|&v| sum[v].1 > 0).collect();
    let mut ratios: Vec<f64> = inside
        .par_chunks(512)
        .flat_map_iter(|some| {
            // Points that follow each other mostly lie near each other.
            let (mut last, sum) = (None::<Here>, &sum);
            some.iter().map(move |&v| {
                let p = &points[v];
                let here = last.map_or_else(|| sizing.at(p), |l| sizing.at_near(p, &l.wall));
                last = Some(here);
                sum[v].0 / f64::from(sum[v].1) / here.size
            })
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    [0.05, 0.5, 0.95].map(|q| ratios.get((q * (ratios.len().max(1) - 1) as f64) as usize).copied().unwrap_or(1.0))
}
