//! Mesh improvement as in the paper: the polygonizer's surface with bad triangles collapsed away and edges flipped.
//!
//! Schumann et al., section "Mesh Quality Improvement", after Bade, Konrad and Preim: triangles above the limit lose
//! their shortest edge. Where one of its ends is a feature vertex the edge falls onto it, where none or both are onto
//! its middle; then it is put back on the implicit. Edges are flipped where the smallest angle of their pair grows.
//! What collapses and flips cannot bring below the limit goes to [`super::angle_repair`].

use serde::Serialize;

use super::angle_repair::{self, RepairOptions};
use super::isotropic::{flip_for_angle, flip_shapes};
use super::repair_moves::collapsed_shape;
use super::shape::cosine_of_skewness;
use super::surface::{Kind, Surface};
use super::{Error, SizeField, Supports};
use crate::geometry::{Point, Vector};
use crate::mesh::TriMesh;

/// Options of [`improve`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImproveOptions {
    /// Every triangle is brought below this skewness.
    pub max_skewness: f64,
    /// Rounds of collapses and flips before angle repair takes over.
    pub rounds: usize,
    /// Edges between triangles that differ in direction by more than this angle, in degrees, are features; none
    /// without it. Rims between patches always are.
    pub feature_angle: Option<f64>,
    /// Feature edges given by the user, as pairs of vertex ids.
    #[serde(skip)]
    pub features: Vec<[u32; 2]>,
}

impl Default for ImproveOptions {
    fn default() -> Self {
        ImproveOptions { max_skewness: 0.75, rounds: 10, feature_angle: None, features: Vec::new() }
    }
}

/// What [`improve`] did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Triangles before.
    pub faces_before: usize,
    /// Triangles after.
    pub faces_after: usize,
    /// Triangles at or above the limit before.
    pub above_limit_before: usize,
    /// Edges that fell onto a feature vertex.
    pub collapses_onto_feature: usize,
    /// Edges that fell onto their middle.
    pub collapses_onto_middle: usize,
    /// Edges flipped.
    pub flips: usize,
    /// Triangles at or above the limit that were left to angle repair.
    pub left_to_repair: usize,
    /// What angle repair did.
    pub repair: angle_repair::Summary,
}

/// Collapses and flips until every triangle is below the limit.
///
/// # Errors
/// As [`super::isotropic::remesh`].
pub fn improve(
    mesh: &TriMesh,
    supports: &Supports,
    field: &dyn SizeField,
    options: &ImproveOptions,
) -> Result<(TriMesh, Summary), Error> {
    let mut summary = Summary { faces_before: mesh.triangles.len(), ..Summary::default() };
    let mut features = options.features.clone();
    if let Some(angle) = options.feature_angle {
        features.extend(sharp_edges(mesh, angle));
    }
    let mut s = super::take_over(mesh, supports, field, None, &features)?;
    let limit = cosine_of_skewness(options.max_skewness);
    let bad = |s: &Surface| -> Vec<u32> {
        let mut list: Vec<(f64, u32)> = (0..s.mesh.triangle_ids() as u32)
            .filter(|&t| s.mesh.has_triangle(t))
            .map(|t| (s.shape_of(t), t))
            .filter(|e| e.0 >= limit)
            .collect();
        list.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        list.into_iter().map(|e| e.1).collect()
    };
    summary.above_limit_before = bad(&s).len();
    for _ in 0..options.rounds {
        let mut changed = 0;
        for t in bad(&s) {
            if s.mesh.has_triangle(t) && s.shape_of(t) >= limit {
                changed += usize::from(collapse_shortest(&mut s, t, limit, &mut summary));
            }
        }
        let flips = flip_for_angle(&mut s);
        summary.flips += flips;
        if changed + flips == 0 || bad(&s).is_empty() {
            break;
        }
    }
    summary.left_to_repair = bad(&s).len();
    s.project_all();
    // Strictly below: the goal lies a step under the limit.
    let goal = options.max_skewness - 0.005;
    let repair = RepairOptions { target_skewness: goal, max_skewness: options.max_skewness, ..RepairOptions::default() };
    let (mesh, done) = angle_repair::finish(s, &repair);
    summary.repair = done;
    summary.faces_after = mesh.triangles.len();
    Ok((mesh, summary))
}

/// Edges between triangles that differ in direction by more than `degrees`.
fn sharp_edges(mesh: &TriMesh, degrees: f64) -> Vec<[u32; 2]> {
    let cosine = degrees.to_radians().cos();
    let Ok(m) = crate::mesh::halfedge::HalfEdgeMesh::new(mesh) else { return Vec::new() };
    m.edges()
        .filter(|&h| {
            let [a, b] = [h, m.twin(h)].map(|h| mesh.area_vector2(h as usize / 3));
            a.dot(&b) < cosine * a.norm() * b.norm()
        })
        .map(|h| [m.origin(h), m.target(h)])
        .collect()
}

/// The paper's collapse. False where a guard forbids it or it would leave the ring worse.
fn collapse_shortest(s: &mut Surface, t: u32, limit: f64, summary: &mut Summary) -> bool {
    let mut sides = [3 * t, 3 * t + 1, 3 * t + 2];
    let length = |s: &Surface, h: u32| (s.point(s.mesh.origin(h)) - s.point(s.mesh.target(h))).norm_squared();
    sides.sort_by(|&a, &b| length(s, a).total_cmp(&length(s, b)).then(a.cmp(&b)));
    // A cap (one angle near 180°) is better flipped over its longest edge.
    let longest = sides[2];
    if flip_shapes(s, longest).is_some_and(|(old, new)| new < old) && s.mesh.can_flip(longest) && !s.is_locked(longest) {
        s.mesh.flip(longest);
        summary.flips += 1;
        return true;
    }
    for h in sides {
        let g = s.mesh.twin(h);
        let ranks = [h, g].map(|h| s.kind[s.mesh.origin(h) as usize].rank());
        // Onto the feature vertex where there is exactly one, else onto the middle.
        let (e, middle) = if ranks[0] == ranks[1] { (h, true) } else if ranks[0] < ranks[1] { (h, false) } else { (g, false) };
        if !s.may_collapse(e) {
            continue;
        }
        let keep = s.mesh.target(e);
        let end = (*s.point(keep), s.normal[keep as usize]);
        let middle = middle.then(|| s.place_on_edge(e, 0.5)).flatten().filter(|p| matches!(p.2, Kind::Surface(_) | Kind::Curve(..)));
        let places: Vec<(Point, Vector)> = middle.map(|(p, n, _)| (p, n)).into_iter().chain([end]).collect();
        let before = worst_round(s, e);
        for (p, n) in places {
            let Some(after) = collapsed_shape(s, e, &p, &n) else { continue };
            if after > before.max(limit) {
                continue;
            }
            s.collapse(e);
            if p == end.0 {
                summary.collapses_onto_feature += 1;
            } else {
                s.set(keep, p, n);
                summary.collapses_onto_middle += 1;
            }
            return true;
        }
    }
    false
}

fn worst_round(s: &Surface, h: u32) -> f64 {
    [s.mesh.origin(h), s.mesh.target(h)]
        .into_iter()
        .flat_map(|v| s.mesh.outgoing(v))
        .map(|h| s.shape_of(h / 3))
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implicit::Implicit;
    use crate::mesh::topology;
    use crate::remesh::Uniform;
    use crate::remesh::testing::{Capsules, polygonize};

    #[test]
    fn every_triangle_of_the_polygonizer_falls_below_the_limit() {
        let f = Capsules::y();
        let raw = polygonize(&f, 0.4);
        let (m, summary) = improve(&raw, &Supports::new(&f), &Uniform(0.4), &ImproveOptions::default()).unwrap();
        assert!(summary.above_limit_before > raw.triangles.len() / 10, "{summary:?}");
        assert!(summary.repair.s_max < 0.75 && summary.repair.above_limit == 0, "{summary:?}");
        assert!(summary.collapses_onto_middle > 100 && summary.flips > 0, "{summary:?}");
        assert!(m.triangles.len() > raw.triangles.len() / 3);
        assert_eq!(topology::check(&m).euler, 2);
        assert!(m.points.iter().all(|p| f.value(p).abs() < 1e-7));
    }
}
