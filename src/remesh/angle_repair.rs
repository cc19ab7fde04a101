//! Angle repair: raises the smallest angles of any mesh, and always ends.
//!
//! Triangles below the wished angle wait in a queue, worst first. For each one a flip, a collapse, a split and a move
//! of a corner are tried on the patch of triangles that they touch, and the first that makes the patch better is
//! kept. Better means: the list of the patch's bad triangles, worst first, each one's badness rounded to steps of
//! about 0.01°, comes earlier in lexicographic order than before. That is the multiset order over finitely many
//! steps, which has no infinite descent, so repair ends whatever the surface, even though splits add triangles. After
//! it, where something is still bad, the rings round it are remeshed by themselves ([`super::last_resort`]) under the
//! same order. Hu et al. 2017 ("Error-bounded and feature preserving surface remeshing with minimal angle
//! improvement") raise angles by the same local operations.

use std::collections::BinaryHeap;

use serde::Serialize;

use super::repair_moves::{self, Limits};
use super::shape::{cosine_of_skewness, skewness_of_cosine};
use super::surface::{Kind, Surface};
use super::even::even_out;
use super::last_resort::{self, Rung};
use super::{Error, Normals, SizeField, Stop, Supports};
use crate::geometry::Point;
use crate::mesh::{PatchId, TriMesh};

/// Options of [`repair`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RepairOptions {
    /// Skewness that every triangle is brought to where possible.
    pub target_skewness: f64,
    /// Skewness above which a triangle counts as failed.
    pub max_skewness: f64,
    /// How many of the worst triangles the summary lists.
    pub list_worst: usize,
    /// What triangles are held against, so that none turns over.
    pub normals: Normals,
    /// Whether the rings round what is still bad are remeshed by themselves. Not done with a region or marked features.
    pub last_resort: bool,
    /// Vertices that may change; everything without it.
    #[serde(skip)]
    pub region: Option<Vec<bool>>,
    /// Feature edges besides the rims between patches, as pairs of vertex ids.
    #[serde(skip)]
    pub features: Vec<[u32; 2]>,
}

impl Default for RepairOptions {
    fn default() -> Self {
        RepairOptions {
            target_skewness: 0.45,
            max_skewness: 0.75,
            list_worst: 10,
            normals: Normals::Gradient,
            last_resort: true,
            region: None,
            features: Vec::new(),
        }
    }
}

/// What [`repair`] did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Edges flipped.
    pub flips: usize,
    /// Edges collapsed.
    pub collapses: usize,
    /// Edges split.
    pub splits: usize,
    /// Vertices moved.
    pub moves: usize,
    /// Vertices moved to even out areas.
    pub evened: usize,
    /// Rings triangulated anew.
    pub retriangulations: usize,
    /// Places remeshed by themselves in the end, with what each attempt brought.
    pub last_resort: Vec<Rung>,
    /// Triangles above the target before.
    pub above_target_before: usize,
    /// Triangles above the target after.
    pub above_target: usize,
    /// Triangles above the limit after: the surface failed where this is not 0.
    pub above_limit: usize,
    /// Largest skewness after.
    pub s_max: f64,
    /// Mean skewness after.
    pub s_mean: f64,
    /// The worst triangles, worst first.
    pub worst: Vec<WorstTriangle>,
}

/// One of the worst triangles of a surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstTriangle {
    /// Id in the mesh that was returned.
    pub id: u32,
    /// Equi-angle skewness.
    pub skewness: f64,
    /// Centroid, mm.
    pub center: Point,
    /// Patch.
    pub patch: PatchId,
    /// What keeps it from being better.
    pub reason: Reason,
}

/// Why a triangle is no better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// It is within the target.
    WithinTarget,
    /// All its vertices are held: outside the region or where features meet.
    Held,
    /// Two of its edges are features that meet in a sharp angle.
    FeatureCorner,
    /// The implicit's gradient jumps across it: its surface has a kink there.
    Kink,
    /// No flip, collapse, split or move makes it better without making a neighbour worse or leaving the surface.
    LocalOptimum,
}

/// Raises the smallest angles of `mesh` until every triangle has the target skewness or nothing helps.
///
/// Ends always; never makes the sorted list of bad triangles worse; keeps the topology, rims, features and patches;
/// vertices stay on their carriers. Does not promise the target: look at `above_limit`.
///
/// # Errors
/// As [`super::isotropic::remesh`].
pub fn repair(
    mesh: &TriMesh,
    supports: &Supports,
    field: &dyn SizeField,
    options: &RepairOptions,
) -> Result<(TriMesh, Summary), Error> {
    repair_until(mesh, supports, field, options, &|| false)
}

/// As [`repair`]; what is left for the last resort stays as it is from when on `stop` says so.
///
/// # Errors
/// As [`repair`].
pub fn repair_until(
    mesh: &TriMesh,
    supports: &Supports,
    field: &dyn SizeField,
    options: &RepairOptions,
    stop: &Stop,
) -> Result<(TriMesh, Summary), Error> {
    let mut s = super::take_over(mesh, supports, field, options.region.as_deref(), &options.features)?;
    if options.normals == Normals::Averaged {
        s.average_normals();
    }
    let (mesh, mut summary) = finish(s, options);
    if summary.above_target == 0 || !options.last_resort || options.region.is_some() || !options.features.is_empty() {
        return Ok((mesh, summary));
    }
    let (mesh, rungs) = last_resort::climb(mesh, supports, field, options, stop);
    if rungs.iter().any(|r| r.kept > 0) {
        let s = super::take_over(&mesh, supports, field, None, &[])?;
        measure(&s, options, &mut summary);
        summary.worst = list_worst(&s, options);
    }
    summary.last_resort = rungs;
    Ok((mesh, summary))
}

/// Repairs a surface that was taken over and gives it back.
pub(crate) fn finish(mut s: Surface, options: &RepairOptions) -> (TriMesh, Summary) {
    let mut summary = run(&mut s, options);
    summary.worst = list_worst(&s, options);
    (s.mesh.into_mesh(), summary)
}

/// Badness of a triangle in steps; 0 at or below the target.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Badness {
    goal: f64,
}

impl Badness {
    pub fn new(target_skewness: f64) -> Badness {
        Badness { goal: cosine_of_skewness(target_skewness) }
    }

    /// In steps of 1e-4 of the cosine of the smallest angle: 0.01° at 33°.
    #[inline]
    pub fn of(self, cosine: f64) -> u32 {
        ((cosine - self.goal) * 1e4).ceil().max(0.0) as u32
    }
}

/// Repairs a surface that was taken over; `worst` of the summary stays empty.
pub(crate) fn run(s: &mut Surface, options: &RepairOptions) -> Summary {
    let mut summary = Summary::default();
    let badness = Badness::new(options.target_skewness.min(options.max_skewness));
    let limits = Limits { badness, longest: 2.0, shortest: 0.4 };
    let all = |s: &Surface| -> Vec<u32> { (0..s.mesh.triangle_ids() as u32).filter(|&t| s.mesh.has_triangle(t)).collect() };
    summary.above_target_before = all(s).iter().filter(|&&t| badness.of(s.shape_of(t)) > 0).count();
    // First within the wished edge lengths; then, for what is left, without them.
    for limits in [limits, Limits { longest: 4.0, shortest: 0.0, ..limits }] {
        let mut queue: BinaryHeap<(u32, u32)> =
            all(s).into_iter().map(|t| (badness.of(s.shape_of(t)), t)).filter(|e| e.0 > 0).collect();
        while let Some((level, t)) = queue.pop() {
            if !s.mesh.has_triangle(t) || badness.of(s.shape_of(t)) != level {
                continue;
            }
            for touched in repair_moves::improve(s, t, limits, &mut summary).unwrap_or_default() {
                let level = badness.of(s.shape_of(touched));
                if level > 0 {
                    queue.push((level, touched));
                }
            }
        }
    }
    summary.evened = even_out(s, badness);
    measure(s, options, &mut summary);
    summary
}

/// What the surface is like now.
fn measure(s: &Surface, options: &RepairOptions, summary: &mut Summary) {
    let badness = Badness::new(options.target_skewness.min(options.max_skewness));
    let mut total = 0.0;
    let mut count = 0usize;
    (summary.s_max, summary.above_target, summary.above_limit) = (0.0, 0, 0);
    for t in (0..s.mesh.triangle_ids() as u32).filter(|&t| s.mesh.has_triangle(t)) {
        let cosine = s.shape_of(t);
        let skewness = skewness_of_cosine(cosine);
        total += skewness;
        count += 1;
        summary.s_max = summary.s_max.max(skewness);
        summary.above_target += usize::from(badness.of(cosine) > 0);
        summary.above_limit += usize::from(skewness >= options.max_skewness);
    }
    summary.s_mean = total / count.max(1) as f64;
}

/// A triangle that leans more than this (cosine, 37°) against the gradient at a corner lies across a kink.
const KINK: f64 = 0.8;

/// What keeps triangle `t` of a finished surface from being better.
pub fn reason(mesh: &TriMesh, supports: &Supports, t: usize, target_skewness: f64) -> Reason {
    let [a, b, c] = mesh.corners(t);
    let patch = mesh.patch.get(t).copied().unwrap_or(crate::mesh::WALL);
    if super::shape::skewness(&a, &b, &c) <= target_skewness + 1e-3 {
        return Reason::WithinTarget;
    }
    let ids = mesh.triangles[t];
    let across = |u: &usize| mesh.triangles[*u].iter().filter(|v| ids.contains(v)).count() == 2;
    let rims = (0..mesh.triangles.len()).filter(|u| mesh.patch.get(*u).is_some_and(|&p| p != patch)).filter(across).count();
    let n = (b - a).cross(&(c - a));
    let leans = |p: &Point| {
        let g = supports.value_gradient(patch, p).1;
        n.dot(&g) < KINK * n.norm() * g.norm()
    };
    match rims {
        2.. => Reason::FeatureCorner,
        _ if [a, b, c].iter().any(leans) => Reason::Kink,
        _ => Reason::LocalOptimum,
    }
}

fn list_worst(s: &Surface, options: &RepairOptions) -> Vec<WorstTriangle> {
    let mut worst: Vec<(f64, u32, u32)> = (0..s.mesh.triangle_ids() as u32)
        .filter(|&t| s.mesh.has_triangle(t))
        .enumerate()
        .map(|(new, t)| (s.shape_of(t), new as u32, t))
        .collect();
    worst.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    worst.truncate(options.list_worst);
    worst
        .into_iter()
        .map(|(cosine, id, t)| {
            let skewness = skewness_of_cosine(cosine);
            let [a, b, c] = s.mesh.corners(t);
            let features = (0..3).filter(|i| s.mesh.is_feature(3 * t + i)).count();
            let held = s.mesh.triangle(t).iter().all(|&v| matches!(s.kind[v as usize], Kind::Corner | Kind::Locked));
            let reason = if skewness <= options.target_skewness + 1e-3 {
                Reason::WithinTarget
            } else if held {
                Reason::Held
            } else if features >= 2 {
                Reason::FeatureCorner
            } else if s.uprightness_of(t) < KINK {
                Reason::Kink
            } else {
                Reason::LocalOptimum
            };
            let center = Point::from((a.coords + b.coords + c.coords) / 3.0);
            WorstTriangle { id, skewness, center, patch: s.mesh.patch(t), reason }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Plane, Vector};
    use crate::implicit::Implicit;
    use crate::mesh::topology;
    use crate::remesh::Uniform;
    use crate::remesh::isotropic::{IsotropicOptions, remesh};
    use crate::remesh::testing::{Capsules, Torus, cut_and_cap, polygonize};

    #[test]
    fn slivers_of_the_polygonizer_become_sound_triangles() {
        let f = Torus { axis: 3.0, radius: 1.0 };
        let raw = polygonize(&f, 0.3);
        let (m, summary) = repair(&raw, &Supports::new(&f), &Uniform(0.3), &RepairOptions::default()).unwrap();
        assert!(summary.s_max <= 0.451, "{summary:?}");
        let r = topology::check(&m);
        assert!(r.is_closed_manifold() && r.euler == 0);
        assert!(m.points.iter().all(|p| f.value(p).abs() < 1e-7));
    }

    #[test]
    fn a_rough_cut_becomes_a_perfect_rim_and_cap() {
        let f = Capsules::tube(2.0, 10.0);
        let size = Uniform(0.5);
        let supports = Supports::new(&f);
        let (m, _) = remesh(&polygonize(&f, 0.35), &supports, &size, &IsotropicOptions::default()).unwrap();
        let plane = Plane::new(Point::new(0.1, 0.0, 2.3), Vector::new(0.3, 0.1, 1.0)).unwrap();
        let cut = cut_and_cap(&m, &plane, 2);
        let supports = supports.with_plane(2, plane);
        let (m, _) = remesh(&cut, &supports, &size, &IsotropicOptions::default()).unwrap();
        let (m, summary) = repair(&m, &supports, &size, &RepairOptions::default()).unwrap();
        assert!(summary.s_max <= 0.451, "{summary:?}");
        let r = topology::check(&m);
        assert!(r.is_closed_manifold() && r.euler == 2);
        let mut cap = vec![false; m.points.len()];
        let mut wall = vec![false; m.points.len()];
        for (t, p) in m.triangles.iter().zip(&m.patch) {
            for &v in t {
                if *p == 2 { cap[v as usize] = true } else { wall[v as usize] = true }
            }
        }
        for (v, p) in m.points.iter().enumerate() {
            assert!(!cap[v] || plane.signed_distance(p).abs() < 1e-13);
            assert!(!wall[v] || f.value(p).abs() < 1e-7);
        }
        let caps: f64 = (0..m.triangles.len()).filter(|&t| m.patch[t] == 2).map(|t| m.area_vector2(t).dot(&plane.normal)).sum();
        let exact = std::f64::consts::PI * 4.0 / plane.normal.z;
        assert!((0.5 * caps / exact - 1.0).abs() < 0.02);
    }

    #[test]
    fn held_vertices_stay() {
        let f = Torus { axis: 3.0, radius: 1.0 };
        let raw = polygonize(&f, 0.3);
        let region: Vec<bool> = raw.points.iter().map(|p| p.x > 0.0).collect();
        let options = RepairOptions { region: Some(region.clone()), ..RepairOptions::default() };
        let (m, summary) = repair(&raw, &Supports::new(&f), &Uniform(0.3), &options).unwrap();
        let kept: Vec<&Point> = raw.points.iter().zip(&region).filter(|k| !k.1).map(|k| k.0).collect();
        assert!(kept.iter().all(|p| m.points.contains(p)));
        assert!(summary.worst.iter().all(|w| w.center.x < 0.3), "{:?}", summary.worst);
        assert_eq!(topology::check(&m).euler, 0);
    }
}
