//! Undoes the mean chord error of a mesh whose vertices lie on a curved wall.
//!
//! Between vertices on the wall the triangles run inside it where it is convex, outside where it is a neck: a tube with
//! 28 edges round it encloses 0.8 % less than the vessel and has a pressure drop 1.7 % too high. Each vertex moves along
//! the wall's normal by the mean distance of the wall from its triangles, so that the error is zero on the average. For
//! a quadratic wall that mean is 3/4 of the distance at the middle of a triangle (the mean of λi λj over a triangle is
//! 1/12, its value in the middle 1/9).

use rayon::prelude::*;
use serde::Serialize;

use super::Supports;
use super::shape::skewness;
use crate::geometry::{Point, Vector};
use crate::mesh::{TriMesh, WALL};

/// What the correction did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct ChordSummary {
    /// Mean distance of the triangles' middles from the wall before, mm; positive where the wall lies outside.
    pub before: f64,
    /// The same, as a mean over the triangles' areas, after: about a quarter of it stays in the middles.
    pub after: f64,
    /// Mean shift of a vertex of the wall, mm, outwards.
    pub mean: f64,
    /// Largest shift, mm.
    pub max: f64,
    /// Vertices left in place, lest a triangle's skewness exceed its target.
    pub left: usize,
}

/// The mean of the gap over a triangle by the gap at its middle.
const MEAN_OF_MIDDLE: f64 = 0.75;
/// A gap of more than this part of a triangle's mean edge is no chord of a smooth wall.
const LARGEST: f64 = 0.1;

/// Moves the vertices of the wall; those of rims move in their planes, those inside caps and where two
/// caps meet stay. No triangle's
/// skewness rises above `target` of its kind (wall, cap) that was not above it before.
pub fn compensate(mesh: &TriMesh, supports: &Supports, target: [f64; 2]) -> (TriMesh, ChordSummary) {
    let on_wall = |t: usize| mesh.patch.get(t).is_none_or(|&id| supports.plane(id).is_none());
    let gaps: Vec<Option<[f64; 2]>> = (0..mesh.triangles.len()).into_par_iter().map(|t| if on_wall(t) { gap(mesh, supports, t) } else { None }).collect();
    let mut shift = vec![[0.0; 2]; mesh.points.len()];
    let mut rim: Vec<Option<u32>> = vec![None; mesh.points.len()];
    let mut corner = vec![false; mesh.points.len()];
    for (t, ids) in mesh.triangles.iter().enumerate() {
        for &v in ids {
            match gaps[t] {
                Some([g, area]) => {
                    shift[v as usize][0] += g * area;
                    shift[v as usize][1] += area;
                }
                None if !on_wall(t) => corner[v as usize] |= rim[v as usize].replace(mesh.patch[t]).is_some_and(|id| id != mesh.patch[t]),
                None => {}
            }
        }
    }
    let moves: Vec<Option<Vector>> = (0..mesh.points.len())
        .into_par_iter()
        .map(|v| {
            let [sum, weight] = shift[v];
            // Where two caps meet, a way in both planes is none across the wall.
            if corner[v] {
                return None;
            }
            let way = if weight > 0.0 { MEAN_OF_MIDDLE * sum / weight } else { return None };
            let normal = supports.wall().gradient(&mesh.points[v]).try_normalize(0.0)?;
            match rim[v].and_then(|id| supports.plane(id)) {
                None => Some(normal * way),
                Some(plane) => {
                    let along = normal - plane.normal * normal.dot(&plane.normal);
                    // By how much more the plane is slanted to the wall, by that the way in it is longer.
                    (along.norm_squared() > 0.05).then(|| along * (way / along.norm_squared()))
                }
            }
        })
        .collect();

    let mut done: Vec<bool> = moves.iter().map(Option::is_some).collect();
    let mut points = mesh.points.clone();
    let shape = |t: usize, points: &[Point]| {
        let [a, b, c] = mesh.triangles[t].map(|v| points[v as usize]);
        skewness(&a, &b, &c)
    };
    loop {
        for v in 0..points.len() {
            points[v] = match moves[v] {
                Some(d) if done[v] => keep_in_plane(mesh.points[v] + d, rim[v], supports),
                _ => mesh.points[v],
            };
        }
        let worse: Vec<usize> = (0..mesh.triangles.len())
            .into_par_iter()
            .filter(|&t| {
                let limit = target[usize::from(!on_wall(t))];
                let now = shape(t, &points);
                now > limit && now > shape(t, &mesh.points)
            })
            .collect();
        let mut changed = false;
        for v in worse.iter().flat_map(|&t| mesh.triangles[t]) {
            changed |= std::mem::take(&mut done[v as usize]);
        }
        if !changed {
            break;
        }
    }
    let moved: Vec<f64> = (0..points.len())
        .filter(|&v| done[v])
        .map(|v| (points[v] - mesh.points[v]).norm() * moves[v].map_or(0.0, |_| shift[v][0].signum()))
        .collect();
    let mut summary = ChordSummary {
        before: mean(gaps.iter().flatten()),
        after: 0.0,
        mean: moved.iter().sum::<f64>() / moved.len().max(1) as f64,
        max: moved.iter().fold(0.0, |m, d| m.max(d.abs())),
        left: (0..points.len()).filter(|&v| moves[v].is_some() && !done[v]).count(),
    };
    let new = TriMesh { points, ..mesh.clone() };
    let after: Vec<[f64; 2]> = (0..new.triangles.len()).into_par_iter().filter(|&t| on_wall(t)).filter_map(|t| gap(&new, supports, t)).collect();
    summary.after = mean(after.iter());
    (new, summary)
}

/// Distance of the wall from a triangle's middle, positive outwards, and the triangle's area.
fn gap(mesh: &TriMesh, supports: &Supports, t: usize) -> Option<[f64; 2]> {
    let [a, b, c] = mesh.corners(t);
    let middle = Point::from((a.coords + b.coords + c.coords) / 3.0);
    let edge = ((b - a).norm() + (c - b).norm() + (a - c).norm()) / 3.0;
    let (foot, normal) = supports.project(WALL, &middle, edge)?;
    let g = (foot - middle).dot(&normal);
    (g.abs() <= LARGEST * edge).then(|| [g, 0.5 * mesh.area_vector2(t).norm()])
}

fn mean<'a>(gaps: impl Iterator<Item = &'a [f64; 2]>) -> f64 {
    let (sum, weight) = gaps.fold((0.0, 0.0), |s, [g, area]| (s.0 + g * area, s.1 + area));
    if weight > 0.0 { sum / weight } else { 0.0 }
}

fn keep_in_plane(p: Point, rim: Option<u32>, supports: &Supports) -> Point {
    rim.and_then(|id| supports.plane(id)).map_or(p, |plane| plane.project(&p))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::remesh::testing::{Capsules, polygonize};
    use crate::remesh::{Uniform, isotropic};

    #[test]
    fn a_vertex_of_two_caps_keeps_both_planes() {
        let f = Capsules::tube(2.0, 10.0);
        let (mut mesh, _) = isotropic::remesh(&polygonize(&f, 0.5), &Supports::new(&f), &Uniform(0.8), &Default::default()).expect("remesh");
        // Two neighbouring triangles stand for caps that share an edge.
        let [a, b, c] = mesh.triangles[0];
        let shared = |t: &[u32; 3]| t.contains(&a) && t.contains(&b) && !t.contains(&c);
        let next = mesh.triangles.iter().position(shared).expect("a neighbour");
        mesh.patch = vec![WALL; mesh.triangles.len()];
        (mesh.patch[0], mesh.patch[next]) = (2, 3);
        let plane = |t: usize| {
            let [p, q, r] = mesh.corners(t);
            crate::geometry::Plane::new(p, (q - p).cross(&(r - p))).expect("a plane")
        };
        let planes = [plane(0), plane(next)];
        let supports = Supports::new(&f).with_plane(2, planes[0]).with_plane(3, planes[1]);
        let (new, _) = compensate(&mesh, &supports, [0.9, 0.9]);
        for (t, plane) in [0, next].into_iter().zip(planes) {
            for p in new.corners(t) {
                assert!(plane.signed_distance(&p).abs() < 1e-12, "{}", plane.signed_distance(&p));
            }
        }
        assert!(new.points != mesh.points);
    }

    #[test]
    fn a_tube_of_coarse_triangles_encloses_its_volume_again() {
        let f = Capsules::tube(2.0, 10.0);
        let supports = Supports::new(&f);
        let (mesh, _) = isotropic::remesh(&polygonize(&f, 0.5), &supports, &Uniform(0.8), &Default::default()).expect("remesh");
        let exact = std::f64::consts::PI * (4.0 * 10.0 + 4.0 / 3.0 * 8.0);
        let (new, summary) = compensate(&mesh, &supports, [0.45, 0.5]);
        let [before, after] = [&mesh, &new].map(|m| m.volume() / exact - 1.0);
        assert!(before < -0.01 && after.abs() < 0.1 * before.abs(), "{before} {after} {summary:?}");
        assert!(summary.mean > 0.0 && summary.max < 0.1 * 0.8 && summary.left < mesh.points.len() / 20, "{summary:?}");
        let worst = |m: &TriMesh| {
            (0..m.triangles.len()).map(|t| { let [a, b, c] = m.corners(t); skewness(&a, &b, &c) }).fold(0.0, f64::max)
        };
        assert!(worst(&new) <= worst(&mesh).max(0.45), "{} {}", worst(&new), worst(&mesh));
    }
}
