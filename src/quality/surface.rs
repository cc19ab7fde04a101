//! Quality of a triangle mesh.
//!
//! Equi-angle skewness (the paper, "Mesh Quality Improvement"; FLUENT's definition):
//! S = max((α_max − 60°)/120°, (60° − α_min)/60°): 0 for the equilateral triangle, 1 for a degenerate one.

use rayon::prelude::*;
use serde::Serialize;

use super::stats::{Histogram, Summary, largest, mean};
use crate::geometry::Point;
use crate::mesh::{Patch, PatchId, PatchKind, TriMesh, WALL};

/// What to count and list.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceOptions {
    /// Triangles with S at or above this count as over the limit. The paper: 0.75.
    pub limit: f64,
    /// How many of the worst triangles to list.
    pub worst: usize,
    /// Bins of the histogram over [0, 1].
    pub bins: usize,
}

impl Default for SurfaceOptions {
    fn default() -> Self {
        SurfaceOptions { limit: 0.75, worst: 10, bins: 20 }
    }
}

/// Why a triangle is bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// No area: two corners coincide or all three lie on a line.
    Degenerate,
    /// One small angle and none above 120°: a short edge.
    Needle,
    /// One angle above 120°: a corner close to the opposite edge.
    Cap,
}

/// A triangle among the worst.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstTriangle {
    /// Triangle id.
    pub id: u32,
    /// Equi-angle skewness.
    pub s: f64,
    /// Centroid, mm.
    pub center: Point,
    /// Patch name.
    pub patch: String,
    /// What is wrong with it.
    pub reason: Shape,
}

/// Equi-angle skewness of one patch.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PatchSkewness {
    /// Patch id.
    pub id: PatchId,
    /// Patch name.
    pub name: String,
    /// Role in the flow.
    pub kind: PatchKind,
    /// Triangles.
    pub faces: usize,
    /// Area, mm².
    pub area: f64,
    /// Largest equi-angle skewness.
    pub s_max: f64,
    /// Mean equi-angle skewness.
    pub s_mean: f64,
}

/// How much the area changes over an edge: the ratio of the larger to the smaller triangle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct AreaRatio {
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// Equi-angle skewness of a surface and what goes with it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceQuality {
    /// Triangles.
    pub faces: usize,
    /// Largest equi-angle skewness.
    pub s_max: f64,
    /// Mean equi-angle skewness.
    pub s_mean: f64,
    /// Smallest equi-angle skewness.
    pub s_min: f64,
    /// Percentiles of the equi-angle skewness.
    pub s: Summary,
    /// The limit.
    pub limit: f64,
    /// Triangles at or above the limit.
    pub over_limit: usize,
    /// Equi-angle skewness over [0, 1].
    pub histogram: Histogram,
    /// The worst, worst first.
    pub worst: Vec<WorstTriangle>,
    /// Each patch.
    pub patches: Vec<PatchSkewness>,
    /// Smallest angle, degrees.
    pub min_angle: f64,
    /// Largest angle, degrees.
    pub max_angle: f64,
    /// Area of neighbours on the wall.
    pub wall_area_ratio: AreaRatio,
    /// Area of neighbours on the caps.
    pub cap_area_ratio: AreaRatio,
    /// S of every triangle: the cell array `EquiAngleSkewness`.
    #[serde(skip)]
    pub per_triangle: Vec<f64>,
}

/// The angles of a triangle in degrees, at its corners in order; NaN-free: a degenerate triangle has angles 0, 0, 180.
pub fn angles([a, b, c]: [Point; 3]) -> [f64; 3] {
    let cross = (b - a).cross(&(c - a)).norm();
    if !(cross > 0.0) {
        return [0.0, 0.0, 180.0];
    }
    // atan2 keeps full precision near 0 and 180 degrees.
    let at = |o: Point, p: Point, q: Point| cross.atan2((p - o).dot(&(q - o))).to_degrees();
    [at(a, b, c), at(b, c, a), at(c, a, b)]
}

/// Equi-angle skewness of a triangle: 0 equilateral, 1 degenerate (also where a coordinate is not finite).
///
/// ```
/// use lumenmesh::{geometry::Point, quality::equi_angle_skewness};
/// let right_angled = [Point::new(0.0, 0.0, 0.0), Point::new(1.0, 0.0, 0.0), Point::new(0.0, 1.0, 0.0)];
/// assert!((equi_angle_skewness(right_angled) - 0.25).abs() < 1e-12);
/// ```
pub fn equi_angle_skewness(corners: [Point; 3]) -> f64 {
    skewness(angles(corners), 60.0)
}

/// Skewness of angles in degrees against the angle `ideal` of the regular polygon.
pub(super) fn skewness<const N: usize>(a: [f64; N], ideal: f64) -> f64 {
    let (lo, hi) = a.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
    ((hi - ideal) / (180.0 - ideal)).max((ideal - lo) / ideal).clamp(0.0, 1.0)
}

/// Measures a surface; deterministic for any number of threads.
///
/// Guarantees `per_triangle.len() == mesh.triangles.len()`; says nothing about closedness or self-intersection.
pub fn surface(mesh: &TriMesh, options: &SurfaceOptions) -> SurfaceQuality {
    let n = mesh.triangles.len();
    let measured: Vec<(f64, f64, f64, f64)> = (0..n)
        .into_par_iter()
        .map(|t| {
            let a = angles(mesh.corners(t));
            let (lo, hi) = (a[0].min(a[1]).min(a[2]), a[0].max(a[1]).max(a[2]));
            (skewness(a, 60.0), lo, hi, 0.5 * mesh.area_vector2(t).norm())
        })
        .collect();
    let s: Vec<f64> = measured.iter().map(|m| m.0).collect();
    let patch_of = |t: usize| mesh.patch.get(t).copied().unwrap_or(WALL);
    let mut names: Vec<Patch> = mesh.patches.clone();
    let mut ids: Vec<PatchId> = (0..n).map(patch_of).collect();
    ids.sort_unstable();
    ids.dedup();
    for &id in &ids {
        if !names.iter().any(|p| p.id == id) {
            let p = Patch { id, name: format!("patch_{id}"), kind: PatchKind::Wall };
            names.push(if id == WALL { Patch::wall() } else { p });
        }
    }
    names.sort_by_key(|p| p.id);
    let mut groups: Vec<(Vec<f64>, Vec<f64>)> = vec![Default::default(); names.len()];
    for t in 0..n {
        if let Ok(k) = names.binary_search_by_key(&patch_of(t), |p| p.id) {
            groups[k].0.push(s[t]);
            groups[k].1.push(measured[t].3);
        }
    }
    let patches = names
        .iter()
        .zip(&groups)
        .map(|(p, (s, area))| PatchSkewness {
            id: p.id,
            name: p.name.clone(),
            kind: p.kind,
            faces: s.len(),
            area: super::stats::sum(area),
            s_max: s.iter().copied().fold(0.0, f64::max),
            s_mean: mean(s),
        })
        .collect();
    let name_of = |t: usize| {
        names.binary_search_by_key(&patch_of(t), |p| p.id).map_or_else(|_| String::new(), |k| names[k].name.clone())
    };
    let worst = largest(&s, options.worst)
        .into_iter()
        .map(|id| {
            let t = id as usize;
            let [a, b, c] = mesh.corners(t);
            let (_, _, hi, area) = measured[t];
            let reason = match () {
                () if !(area > 0.0) => Shape::Degenerate,
                () if hi > 120.0 => Shape::Cap,
                () => Shape::Needle,
            };
            WorstTriangle { id, s: s[t], center: Point::from((a.coords + b.coords + c.coords) / 3.0), patch: name_of(t), reason }
        })
        .collect();
    let wall: Vec<bool> = (0..n)
        .map(|t| names.binary_search_by_key(&patch_of(t), |p| p.id).is_ok_and(|k| names[k].kind == PatchKind::Wall))
        .collect();
    let [wall_area_ratio, cap_area_ratio] = area_ratios(mesh, &wall, &measured);
    let summary = Summary::of(&s);
    SurfaceQuality {
        faces: n,
        s_max: summary.max,
        s_mean: summary.mean,
        s_min: summary.min,
        s: summary,
        limit: options.limit,
        over_limit: s.iter().filter(|&&v| v >= options.limit).count(),
        histogram: Histogram::of(&s, options.bins),
        worst,
        patches,
        min_angle: measured.iter().map(|m| m.1).fold(180.0, f64::min),
        max_angle: measured.iter().map(|m| m.2).fold(0.0, f64::max),
        wall_area_ratio,
        cap_area_ratio,
        per_triangle: s,
    }
}

/// Area ratios over the edges inside the wall and inside the caps.
fn area_ratios(mesh: &TriMesh, wall: &[bool], measured: &[(f64, f64, f64, f64)]) -> [AreaRatio; 2] {
    let mut edges: Vec<(u32, u32, u32)> = mesh
        .triangles
        .par_iter()
        .enumerate()
        .flat_map_iter(|(t, v)| {
            (0..3).map(move |i| {
                let (a, b) = (v[i], v[(i + 1) % 3]);
                (a.min(b), a.max(b), t as u32)
            })
        })
        .collect();
    edges.par_sort_unstable();
    let mut ratios = [vec![], vec![]];
    for e in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if let [a, b] = e {
            let (a, b) = (a.2 as usize, b.2 as usize);
            if wall[a] == wall[b] {
                let (x, y) = (measured[a].3, measured[b].3);
                ratios[usize::from(!wall[a])].push(x.max(y) / x.min(y).max(f64::MIN_POSITIVE));
            }
        }
    }
    ratios.map(|r| {
        let s = Summary::of(&r);
        AreaRatio { p99: s.p99, max: s.max }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::sphere;

    fn tri(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> [Point; 3] {
        [a, b, c].map(|p| Point::new(p[0], p[1], 0.0))
    }

    #[test]
    fn skewness_follows_the_papers_formula() {
        assert!(equi_angle_skewness(tri([0.0, 0.0], [1.0, 0.0], [0.5, 0.75f64.sqrt()])) < 1e-12);
        // 30-30-120: both terms are 1/2.
        assert!((equi_angle_skewness(tri([0.0, 0.0], [2.0, 0.0], [1.0, 1.0 / 3f64.sqrt()])) - 0.5).abs() < 1e-12);
        // 15-82.5-82.5: the small angle decides, (60 - 15)/60.
        let h = 1.0 / (7.5f64.to_radians().tan());
        assert!((equi_angle_skewness(tri([-1.0, 0.0], [1.0, 0.0], [0.0, h])) - 0.75).abs() < 1e-12);
        assert_eq!(equi_angle_skewness(tri([0.0, 0.0], [1.0, 0.0], [2.0, 0.0])), 1.0);
        assert_eq!(equi_angle_skewness(tri([0.0, 0.0], [0.0, 0.0], [2.0, 0.0])), 1.0);
        assert_eq!(equi_angle_skewness(tri([0.0, 0.0], [f64::NAN, 0.0], [2.0, 0.0])), 1.0);
    }

    #[test]
    fn a_surface_report_names_the_worst_triangle_and_why() {
        let mut m = sphere(Point::new(5.0, -3.0, 2.0), 2.0, 6);
        let n = m.triangles.len();
        let good = surface(&m, &SurfaceOptions::default());
        assert_eq!((good.faces, good.over_limit), (n, 0));
        assert!(good.s_max < 0.75 && good.s_min >= 0.0 && good.s_min <= good.s_mean);
        assert_eq!(good.histogram.counts.iter().sum::<u64>(), n as u64);
        // Pull one corner across the opposite edge's neighbourhood.
        let [a, b, c] = m.triangles[17];
        m.points[a as usize] = nalgebra::center(&m.points[b as usize], &m.points[c as usize]);
        let bad = surface(&m, &SurfaceOptions::default());
        // The neighbours over the moved corner suffer too; the flattened one has S = 1 but for rounding.
        let flat = bad.worst.iter().find(|w| w.id == 17).expect("listed");
        assert!(flat.s > 0.999 && bad.s_max >= flat.s && bad.over_limit >= 1 && flat.reason != Shape::Needle);
        assert_eq!(bad.worst.len(), 10);
        assert!(bad.worst.windows(2).all(|w| w[0].s >= w[1].s));
    }
}
