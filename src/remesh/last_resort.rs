//! What is done where angle repair by single operations leaves triangles above the target.
//!
//! The rings round them are cut out, remeshed by themselves and put back where that is better: with wider rings from
//! rung to rung, with other edge lengths in the middle, and with triangles held against the mesh's averaged normals
//! instead of the implicit's gradient, which jumps at kinks. An attempt is kept only where the sorted list of bad
//! triangles falls and no self-intersection arises; the ladder has so many rungs and no more.

use rayon::prelude::*;
use serde::Serialize;

use super::angle_repair::{self, Badness, RepairOptions};
use super::cutout::{self, Cutout, Fans};
use super::isotropic::{self, IsotropicOptions};
use super::shape::worst_cosine;
use super::size_field::Scaled;
use super::{Normals, SizeField, Stop, Supports, ears};
use crate::geometry::Point;
use crate::mesh::TriMesh;
use crate::mesh::intersect::self_intersections;

/// One way of trying.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Try {
    /// Rings of triangles round the bad ones that may change.
    pub rings: usize,
    /// Factor on the wished edge length in the middle; 1 at the border.
    pub size: f64,
    /// What triangles are held against.
    pub normals: Normals,
    /// Whether to remesh before repairing.
    pub remesh: bool,
}

/// What a rung of the ladder brought.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rung {
    /// Rings of triangles round the bad ones that might change.
    pub rings: usize,
    /// Factor on the wished edge length in the middle.
    pub size: f64,
    /// What triangles were held against.
    pub normals: Normals,
    /// Places tried.
    pub places: usize,
    /// Places where it was better.
    pub kept: usize,
    /// Triangles still above the target.
    pub left: usize,
}

const fn remeshed(rings: usize, size: f64, normals: Normals) -> Try {
    Try { rings, size, normals, remesh: true }
}

const LADDER: [Try; 9] = [
    Try { rings: 3, size: 1.0, normals: Normals::Averaged, remesh: false },
    remeshed(4, 1.0, Normals::Gradient),
    remeshed(4, 1.0, Normals::Averaged),
    remeshed(5, 0.75, Normals::Averaged),
    remeshed(5, 1.3, Normals::Averaged),
    remeshed(6, 0.55, Normals::Averaged),
    remeshed(8, 0.75, Normals::Averaged),
    remeshed(8, 1.3, Normals::Averaged),
    remeshed(8, 0.4, Normals::Averaged),
];

/// Climbs the ladder until no triangle is above the target, it ends or `stop` says so.
pub(crate) fn climb(
    mut mesh: TriMesh,
    supports: &Supports,
    field: &dyn SizeField,
    options: &RepairOptions,
    stop: &Stop,
) -> (TriMesh, Vec<Rung>) {
    let badness = Badness::new(options.target_skewness.min(options.max_skewness));
    let mut rungs = Vec::new();
    let mut bad = above_target(&mesh, badness);
    for attempt in LADDER {
        if bad.is_empty() || stop() {
            break;
        }
        let fans = Fans::new(&mesh);
        let parts = cutout::parts(&mesh, &fans, &bad, attempt.rings);
        let places = parts.len();
        let better: Vec<(Cutout, TriMesh)> = parts
            .into_par_iter()
            .filter_map(|part| {
                if stop() {
                    return None;
                }
                let inside: Vec<u32> = bad.iter().copied().filter(|t| part.binary_search(t).is_ok()).collect();
                let centers: Vec<Point> = inside.iter().map(|&t| center(&mesh, t as usize)).collect();
                let cutout = Cutout::new(&mesh, &fans, part);
                let before = score(&cutout, &cutout.mesh, badness);
                let new = make(&cutout, supports, field, options, attempt, &centers)?;
                (score(&cutout, &new, badness) < before && sound(&cutout, &new)).then_some((cutout, new))
            })
            .collect();
        let kept = better.len();
        if kept > 0 {
            mesh = cutout::put_back(&mesh, &better);
            bad = above_target(&mesh, badness);
        }
        rungs.push(Rung { rings: attempt.rings, size: attempt.size, normals: attempt.normals, places, kept, left: bad.len() });
    }
    (mesh, rungs)
}

/// Remeshes and repairs a cutout; `None` where remeshing refuses it.
pub(crate) fn make(
    cutout: &Cutout,
    supports: &Supports,
    field: &dyn SizeField,
    options: &RepairOptions,
    attempt: Try,
    centers: &[Point],
) -> Option<TriMesh> {
    let reach = centers.iter().map(|p| field.size(p)).fold(0.0, f64::max) * attempt.rings as f64 * 0.8;
    let field = Scaled { field, centers, reach, factor: attempt.size };
    let mut mesh = cutout.mesh.clone();
    if attempt.remesh {
        let iso = IsotropicOptions { normals: attempt.normals, region: Some(cutout.active.clone()), ..IsotropicOptions::default() };
        mesh = isotropic::remesh(&mesh, supports, &field, &iso).ok()?.0;
    }
    let repair = RepairOptions {
        normals: attempt.normals,
        region: Some(cutout.active_in(&mesh)),
        list_worst: 0,
        features: Vec::new(),
        ..options.clone()
    };
    angle_repair::repair(&mesh, supports, &field, &repair).ok().map(|r| r.0)
}

/// Whether what a cutout became fits back in and does not cross itself.
pub(crate) fn sound(cutout: &Cutout, new: &TriMesh) -> bool {
    let real: Vec<usize> = cutout.real(new).collect();
    let alone = TriMesh {
        points: new.points.clone(),
        triangles: real.iter().map(|&t| new.triangles[t]).collect(),
        patch: real.iter().map(|&t| new.patch[t]).collect(),
        patches: Vec::new(),
    };
    cutout.fits(new) && self_intersections(&alone).is_empty()
}

/// Badness of the triangles above the target, worst first. An ear is as bad as a triangle of no height.
pub(crate) fn score(cutout: &Cutout, mesh: &TriMesh, badness: Badness) -> Vec<u32> {
    let mut list: Vec<u32> = cutout.real(mesh).map(|t| of(mesh, t, badness)).filter(|&b| b > 0).collect();
    list.extend(ears::among(mesh, cutout.real(mesh)).iter().map(|_| badness.of(1.0)));
    list.sort_unstable_by(|a, b| b.cmp(a));
    list
}

fn of(mesh: &TriMesh, t: usize, badness: Badness) -> u32 {
    let [a, b, c] = mesh.corners(t);
    badness.of(worst_cosine(&a, &b, &c))
}

/// Triangles above the target, and ears.
fn above_target(mesh: &TriMesh, badness: Badness) -> Vec<u32> {
    let skewed = (0..mesh.triangles.len()).filter(|&t| of(mesh, t, badness) > 0);
    let mut all: Vec<u32> = skewed.chain(ears::among(mesh, 0..mesh.triangles.len())).map(|t| t as u32).collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn center(mesh: &TriMesh, t: usize) -> Point {
    let [a, b, c] = mesh.corners(t);
    Point::from((a.coords + b.coords + c.coords) / 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implicit::Implicit;
    use crate::mesh::topology::check;
    use crate::remesh::Uniform;
    use crate::remesh::testing::{Capsules, polygonize};

    #[test]
    fn a_sharp_crease_reaches_the_target_on_the_surface() {
        // Two tubes crossing without a blend: the gradient jumps by up to 90° along the seam.
        let o = Point::origin();
        let (x, z) = (Point::new(5.0, 0.0, 0.0), Point::new(0.6, 0.0, 4.0));
        let f = Capsules { parts: vec![(-x, x, 1.6), (o, z, 1.1), (-z, o, 1.3)].into_iter().map(|(a, b, r)| (Point::from(a.coords), b, r)).collect(), blend: 0.0, voxel: 0.4 };
        let supports = Supports::new(&f);
        for h in [0.25, 0.5] {
            let (m, _) = isotropic::remesh(&polygonize(&f, 0.2), &supports, &Uniform(h), &IsotropicOptions::default()).unwrap();
            let (m, summary) = angle_repair::repair(&m, &supports, &Uniform(h), &RepairOptions::default()).unwrap();
            assert!(summary.s_max <= 0.451, "{h} {summary:?}");
            let r = check(&m);
            assert!(r.is_closed_manifold() && r.euler == 2, "{r:?}");
            assert!(self_intersections(&m).is_empty());
            assert!(m.points.iter().all(|p| f.value(p).abs() < 1e-7));
        }
    }
}
