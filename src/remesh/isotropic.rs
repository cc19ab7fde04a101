//! Adaptive isotropic remeshing on the implicit surface.
//!
//! Split, collapse, flip, relax, project (Botsch and Kobbelt 2004; Dunyach et al. 2013 for the adaptive size), with
//! three differences: vertices lie on the implicit itself and not on the input triangles; guards compare triangles
//! with the implicit's gradient, so folded input straightens and sheets close together stay apart; rims between
//! patches and other features are kept, their vertices sliding along the curve.

use rayon::prelude::*;
use serde::Serialize;

use super::anneal::anneal;
use super::relax::{Balance, relax};
use super::rim_spacing::space_rims;
use super::shape::worst_cosine;
use super::surface::Surface;
use super::valence::Valences;
use super::{Error, Normals, SizeField, Supports};
use crate::geometry::{Point, Vector};
use crate::mesh::TriMesh;
use crate::mesh::halfedge::HalfEdgeMesh;

/// Options of [`remesh`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IsotropicOptions {
    /// Rounds of split, collapse, flip and relax.
    pub iterations: usize,
    /// Relaxation steps in each round.
    pub relaxations: usize,
    /// Rounds of flip and relax at the end, without splits and collapses.
    pub finishing: usize,
    /// Relaxation steps in each of these.
    pub finishing_relaxations: usize,
    /// Edges longer than this many wished lengths are split.
    pub split_above: f64,
    /// Edges shorter than this many wished lengths are collapsed.
    pub collapse_below: f64,
    /// Factor on both in the first round, where the whole surface may change.
    pub coarse_first: f64,
    /// What triangles are held against, so that none turns over.
    pub normals: Normals,
    /// Vertices that may change, by id of the input mesh; everything without it. Where it is given, only edges with
    /// such an end are touched and all other vertices keep position and order.
    #[serde(skip)]
    pub region: Option<Vec<bool>>,
    /// Feature edges besides the rims between patches, as pairs of vertex ids.
    #[serde(skip)]
    pub features: Vec<[u32; 2]>,
}

impl Default for IsotropicOptions {
    fn default() -> Self {
        IsotropicOptions {
            iterations: 8,
            relaxations: 8,
            finishing: 6,
            finishing_relaxations: 8,
            split_above: 1.4,
            collapse_below: 0.85,
            coarse_first: 1.7,
            normals: Normals::Gradient,
            region: None,
            features: Vec::new(),
        }
    }
}

/// What [`remesh`] did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Triangles before.
    pub faces_before: usize,
    /// Triangles after.
    pub faces_after: usize,
    /// Edges split.
    pub splits: usize,
    /// Edges collapsed.
    pub collapses: usize,
    /// Edges flipped.
    pub flips: usize,
    /// Relaxation steps over all vertices.
    pub relaxations: usize,
    /// Vertices that could not be brought onto their carrier; 0 on a sound implicit.
    pub unprojected: usize,
}

/// Remeshes `mesh` so that edges come as close as they can to the length that `field` wishes.
///
/// Vertices of the result lie on their carriers (the implicit; rims on the curve and in the plane to rounding). The
/// surface stays a closed manifold with the same components and genus. Triangle quality is high but has no bound:
/// [`super::angle_repair`] gives one. With a region vertices that survive keep their order; without one ids follow a walk.
///
/// # Errors
/// [`Error::NotManifold`] for input that is not closed, oriented and 2-manifold; [`Error::BadSize`] where the field
/// is not positive; [`Error::MaskLength`] for a region of the wrong length.
pub fn remesh(
    mesh: &TriMesh,
    supports: &Supports,
    field: &dyn SizeField,
    options: &IsotropicOptions,
) -> Result<(TriMesh, Summary), Error> {
    let mut summary = Summary { faces_before: mesh.triangles.len(), ..Summary::default() };
    let mut s = super::take_over(mesh, supports, field, options.region.as_deref(), &options.features)?;
    if options.normals == Normals::Averaged {
        s.average_normals();
    }
    run(&mut s, options, &mut summary);
    summary.faces_after = s.mesh.triangle_count();
    Ok((s.mesh.into_mesh(), summary))
}

fn run(s: &mut Surface, options: &IsotropicOptions, summary: &mut Summary) {
    for i in 0..options.iterations {
        // Much too coarse first, where all may change: what follows is not the lattice of the polygonizer any more,
        // whose rows a long relaxation straightens but cannot turn nor space anew.
        let factor = if i == 0 && options.region.is_none() { options.coarse_first } else { 1.0 };
        summary.collapses += collapse_short(s, factor * options.collapse_below, factor * options.split_above);
        s.compact();
        summary.splits += split_long(s, factor * options.split_above);
        let (fewer, more) = space_rims(s, factor);
        summary.collapses += fewer;
        summary.splits += more;
        if options.region.is_none() {
            s.sort_by_walk();
        }
        summary.flips += flip_for_valence(s);
        if 2 * i >= options.iterations {
            summary.flips += anneal(s, 3);
        }
        settle(s, options.relaxations, if i < 2 { 0.7 } else { 1.0 }, 0.0, summary);
    }
    for i in 0..options.finishing {
        summary.flips += flip_for_valence(s) + anneal(s, 6);
        // Sizes first, then angles.
        let shape = (i as f64 / options.finishing as f64).min(0.9);
        settle(s, options.finishing_relaxations, 1.0, shape, summary);
    }
    summary.flips += flip_for_angle(s);
    settle(s, options.finishing_relaxations, 0.8, 0.9, summary);
    summary.flips += flip_for_angle(s);
    summary.unprojected = s.project_all();
}

/// A group of relaxation steps; every second one and the last end on the carrier.
fn settle(s: &mut Surface, steps: usize, step: f64, shape: f64, summary: &mut Summary) {
    let ids = s.vertices();
    for i in 0..steps {
        let project = i % 2 == 1 || i + 1 == steps;
        relax(s, &ids, Balance { step, shape, project });
        summary.relaxations += 1;
    }
}

/// Splits edges that are too long, longest first, until none is left (at most 12 halvings).
fn split_long(s: &mut Surface, above: f64) -> usize {
    let limit = above * above;
    let mut count = 0;
    for _ in 0..12 {
        let mut long: Vec<(f64, u32)> = edges(s)
            .into_par_iter()
            .filter(|&h| !s.is_locked(h))
            .map(|h| (s.relative_length2(s.mesh.origin(h), s.mesh.target(h)), h))
            .filter(|e| e.0 > limit)
            .collect();
        if long.is_empty() {
            break;
        }
        long.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let placed: Vec<_> = long
            .par_iter()
            .map(|&(_, h)| (s.mesh.origin(h), s.mesh.target(h), s.place_on_edge(h, 0.5)))
            .collect();
        let before = count;
        for (a, b, place) in placed {
            // Splits leave other edges alone but renumber their half-edges.
            if let (Some(place), Some(h)) = (place, s.mesh.find(a, b)) {
                if split_stands(s, h, &place.0, &place.1) {
                    s.split(h, place);
                    count += 1;
                }
            }
        }
        if count == before {
            break;
        }
    }
    count
}

pub(crate) fn split_stands(s: &Surface, h: u32, p: &Point, n: &Vector) -> bool {
    [h, s.mesh.twin(h)].into_iter().all(|h| {
        let t = h / 3;
        let before = s.uprightness_of(t);
        let (a, b, c) = (s.mesh.origin(h), s.mesh.target(h), s.mesh.apex(h));
        let normal = |v: u32| &s.normal[v as usize];
        let patch = s.mesh.patch(t);
        let first = s.uprightness(patch, [s.point(a), p, s.point(c)], [normal(a), n, normal(c)]);
        let second = s.uprightness(patch, [p, s.point(b), s.point(c)], [n, normal(b), normal(c)]);
        Surface::stands(before, first) && Surface::stands(before, second)
    })
}

/// Classes of length in which edges are collapsed, the shortest first.
const CLASSES: f64 = 6.0;

/// Collapses edges shorter than `below` wished lengths, shortest first, where none longer than `above` arises.
fn collapse_short(s: &mut Surface, below: f64, above: f64) -> usize {
    let limit = below * below;
    let longest = above * above;
    let mut count = 0;
    for _ in 0..8 {
        s.compact();
        // Half-edges by classes of length, in the order of their ids within each: neighbours come one after the other,
        // which memory likes.
        let mut short: Vec<u64> = edges(s)
            .into_par_iter()
            .map(|h| (s.relative_length2(s.mesh.origin(h), s.mesh.target(h)), h))
            .filter(|e| e.0 < limit)
            .map(|(l, h)| ((CLASSES * (l / limit).sqrt()) as u64) << 32 | u64::from(h))
            .collect();
        short.par_sort_unstable();
        let before = count;
        for h in short.into_iter().map(|key| key as u32) {
            // Collapses before may have taken the edge away or drawn it out.
            if !s.mesh.has_triangle(h / 3) {
                continue;
            }
            let (a, b) = (s.mesh.origin(h), s.mesh.target(h));
            if s.relative_length2(a, b) >= limit {
                continue;
            }
            // The firmer vertex stays; of equals the one with more edges.
            let key = |v: u32| (s.kind[v as usize].rank(), s.mesh.valence(v));
            let first = if key(a) <= key(b) { h } else { s.mesh.twin(h) };
            for h in [first, s.mesh.twin(first)] {
                if s.kind[s.mesh.origin(h) as usize].rank() > s.kind[s.mesh.target(h) as usize].rank() {
                    continue;
                }
                if collapse_stands(s, h, longest) && s.may_collapse(h) {
                    s.collapse(h);
                    count += 1;
                    break;
                }
            }
        }
        if count - before < 1 + s.mesh.triangle_count() / 200 {
            break;
        }
    }
    count
}

pub(crate) fn collapse_stands(s: &Surface, h: u32, longest: f64) -> bool {
    let (a, b) = (s.mesh.origin(h), s.mesh.target(h));
    let (t0, t1) = (h / 3, s.mesh.twin(h) / 3);
    let (pb, nb) = (s.point(b), &s.normal[b as usize]);
    s.mesh.outgoing(a).all(|e| {
        let t = e / 3;
        let c = s.mesh.target(e);
        if c != b && s.relative_length2(b, c) > longest {
            return false;
        }
        if t == t0 || t == t1 {
            return true;
        }
        let d = s.mesh.apex(e);
        let normal = |v: u32| &s.normal[v as usize];
        let after = s.uprightness(s.mesh.patch(t), [pb, s.point(c), s.point(d)], [nb, normal(c), normal(d)]);
        Surface::stands(s.uprightness_of(t), after)
    })
}

/// Flips edges where that brings valences nearer to what they should be and costs no triangle its shape.
fn flip_for_valence(s: &mut Surface) -> usize {
    let mut valences = Valences::new(s);
    let mut count = 0;
    for _ in 0..3 {
        let before = count;
        for h in 0..3 * s.mesh.triangle_ids() as u32 {
            if !s.mesh.has_triangle(h / 3) || h > s.mesh.twin(h) || s.mesh.is_feature(h) || s.is_locked(h) {
                continue;
            }
            if valences.change(s, h) >= 0 {
                continue;
            }
            let Some((old, new)) = flip_shapes(s, h) else { continue };
            // cos 15°: a flip may worsen a pair for a while, relaxation rounds it again.
            if (new <= 0.966 || new < old) && s.mesh.can_flip(h) {
                valences.flip(s, h);
                count += 1;
            }
        }
        if count == before {
            break;
        }
    }
    count
}

/// Flips edges where the smallest angle of the pair grows.
pub(crate) fn flip_for_angle(s: &mut Surface) -> usize {
    let mut count = 0;
    for _ in 0..10 {
        let before = count;
        for h in 0..3 * s.mesh.triangle_ids() as u32 {
            if !s.mesh.has_triangle(h / 3) || h > s.mesh.twin(h) || s.mesh.is_feature(h) || s.is_locked(h) {
                continue;
            }
            if flip_shapes(s, h).is_some_and(|(old, new)| new < old - 1e-6) && s.mesh.can_flip(h) {
                s.mesh.flip(h);
                count += 1;
            }
        }
        if count == before {
            break;
        }
    }
    count
}

/// Worst cosine of the pair at `h` before and after a flip; `None` where the flip would turn a triangle over.
pub(crate) fn flip_shapes(s: &Surface, h: u32) -> Option<(f64, f64)> {
    let g = s.mesh.twin(h);
    let [a, b, c, d] = [s.mesh.origin(h), s.mesh.target(h), s.mesh.apex(h), s.mesh.apex(g)];
    let (t0, t1) = (h / 3, g / 3);
    let [pa, pb, pc, pd] = [a, b, c, d].map(|v| s.point(v));
    let old = worst_cosine(pa, pb, pc).max(worst_cosine(pb, pa, pd));
    let new = worst_cosine(pc, pa, pd).max(worst_cosine(pd, pb, pc));
    let normal = |v: u32| &s.normal[v as usize];
    let patch = s.mesh.patch(t0);
    let before = s.uprightness_of(t0).min(s.uprightness_of(t1));
    let after = s
        .uprightness(patch, [pc, pa, pd], [normal(c), normal(a), normal(d)])
        .min(s.uprightness(patch, [pd, pb, pc], [normal(d), normal(b), normal(c)]));
    Surface::stands(before, after).then_some((old, new))
}

/// One half-edge of every edge.
pub(crate) fn edges(s: &Surface) -> Vec<u32> {
    let m: &HalfEdgeMesh = &s.mesh;
    m.edges().collect()
}


#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::topology;
    use crate::remesh::Uniform;
    use crate::remesh::shape::skewness;
    use crate::remesh::testing::{Capsules, Torus, polygonize};

    fn mean_and_max(m: &TriMesh) -> (f64, f64) {
        let s: Vec<f64> = (0..m.triangles.len())
            .map(|t| {
                let [a, b, c] = m.corners(t);
                skewness(&a, &b, &c)
            })
            .collect();
        (s.iter().sum::<f64>() / s.len() as f64, s.iter().copied().fold(0.0, f64::max))
    }

    #[test]
    fn a_torus_stays_a_torus() {
        let f = Torus { axis: 3.0, radius: 1.0 };
        let raw = polygonize(&f, 0.2);
        let (m, _) = remesh(&raw, &Supports::new(&f), &Uniform(0.25), &IsotropicOptions::default()).unwrap();
        let r = topology::check(&m);
        assert!(r.is_closed_manifold() && r.euler == 0, "{r:?}");
        let (mean, max) = mean_and_max(&m);
        assert!(mean < 0.15 && max < 0.6, "{mean} {max}");
        for p in &m.points {
            assert!(crate::implicit::Implicit::value(&f, p).abs() < 1e-8);
        }
    }

    #[test]
    fn a_y_at_three_sizes() {
        let f = Capsules::y();
        let raw = polygonize(&f, 0.35);
        for h in [0.2, 0.4, 0.7] {
            let (m, _) = remesh(&raw, &Supports::new(&f), &Uniform(h), &IsotropicOptions::default()).unwrap();
            assert_eq!(topology::check(&m).euler, 2);
            let (mean, max) = mean_and_max(&m);
            assert!(mean < 0.17, "{h} {mean} {max}");
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let f = Capsules::y();
        let raw = polygonize(&f, 0.4);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| remesh(&raw, &Supports::new(&f), &Uniform(0.4), &IsotropicOptions::default()).unwrap())
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn two_vessels_side_by_side_stay_two() {
        let a = |x: f64| (Point::new(x, 0.0, -4.0), Point::new(x, 0.0, 4.0), 1.0);
        let f = Capsules { parts: vec![a(-1.075), a(1.075)], blend: 0.0, voxel: 0.3 };
        let (m, _) =
            remesh(&polygonize(&f, 0.1), &Supports::new(&f), &Uniform(0.4), &IsotropicOptions::default()).unwrap();
        let r = topology::check(&m);
        assert!(r.is_closed_manifold() && (r.components, r.euler) == (2, 4), "{r:?}");
        assert_eq!(crate::mesh::intersect::self_intersections(&m), vec![]);
    }

    #[test]
    fn a_marked_edge_survives() {
        let f = Torus { axis: 3.0, radius: 1.0 };
        let raw = polygonize(&f, 0.25);
        let [a, b, _] = raw.triangles[100];
        let options = IsotropicOptions { features: vec![[a, b]], ..IsotropicOptions::default() };
        let (m, _) = remesh(&raw, &Supports::new(&f), &Uniform(0.3), &options).unwrap();
        for v in [a, b] {
            let p = raw.points[v as usize];
            assert!(m.points.iter().any(|q| (p - q).norm() < 1e-12), "an end of the marked edge moved");
        }
        assert_eq!(topology::check(&m).euler, 0);
    }
}
