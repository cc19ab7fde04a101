//! Cuts as a user would look at them.

use super::*;
use crate::geometry::Plane;
use crate::mesh::intersect::self_intersections;
use crate::mesh::WALL;
use crate::mesh::topology::check;
use crate::openings::FoundBy;
use crate::remesh::{Uniform, isotropic};
use crate::remesh::shape::skewness;
use crate::remesh::testing::{Capsules, Torus, polygonize};

fn opening(id: u32, name: &str, center: [f64; 3], normal: [f64; 3]) -> Opening {
    let plane = Plane::new(center.into(), normal.into()).expect("normal");
    let kind = if id == 2 { PatchKind::Inlet } else { PatchKind::Outlet };
    Opening { id, name: name.into(), kind, plane, radius: 2.0, support: crate::openings::Support::round(&plane, 2.0), found_by: FoundBy::User, confidence: 1.0, component: 0 }
}

fn tube() -> (Capsules, TriMesh) {
    let f = Capsules::tube(2.0, 10.0);
    let raw = polygonize(&f, 0.5);
    let supports = Supports::new(&f);
    let (mesh, _) = isotropic::remesh(&raw, &supports, &Uniform(0.6), &Default::default()).expect("remesh");
    (f, mesh)
}

#[test]
fn an_oblique_cut_gives_a_planar_cap_of_the_exact_area_and_keeps_the_quality() {
    let (f, mesh) = tube();
    let tilt = [0.2, -0.1, 1.0];
    let ends = [opening(2, "inlet", [0.0, 0.0, 5.0], tilt), opening(3, "outlet_1", [0.0, 0.0, -5.0], [0.0, 0.0, -1.0])];
    let (cut, measures, summary) = super::cut(&mesh, &f, &Uniform(0.6), &ends, &CutOptions::default()).expect("cut");
    let t = check(&cut);
    assert!(t.is_closed_manifold() && t.euler == 2 && t.components == 1, "{t:?}");
    assert!(self_intersections(&cut).is_empty());
    let worst = |wall: bool| {
        let ids = (0..cut.triangles.len()).filter(|&i| (cut.patch[i] == WALL) == wall);
        ids.map(|i| { let [a, b, c] = cut.corners(i); skewness(&a, &b, &c) }).fold(0.0, f64::max)
    };
    assert!(worst(true) <= 0.45 && worst(false) <= 0.5, "wall {} caps {} {summary:?}", worst(true), worst(false));
    let cosine = 1.0 / (1.05f64).sqrt();
    for (m, exact) in measures.iter().zip([std::f64::consts::PI * 4.0 / cosine, std::f64::consts::PI * 4.0]) {
        assert!(m.planarity <= 1e-9 * cut.bounds().diagonal(), "{m:?}");
        assert!((m.area / exact - 1.0).abs() < 0.03, "{m:?} against {exact}");
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (f, mesh) = tube();
    let ends = [opening(2, "inlet", [0.0, 0.0, 5.0], [0.2, 0.0, 1.0]), opening(3, "outlet_1", [0.0, 0.0, -5.0], [0.0, 0.0, -1.0])];
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| super::cut(&mesh, &f, &Uniform(0.6), &ends, &CutOptions::default()).expect("cut").0)
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn a_plane_that_misses_the_vessel_is_refused_with_coordinates() {
    let (f, mesh) = tube();
    let ends = [opening(2, "inlet", [40.0, 0.0, 0.0], [1.0, 0.0, 0.0])];
    let e = super::cut(&mesh, &f, &Uniform(0.6), &ends, &CutOptions::default()).expect_err("misses");
    assert!(matches!(e, Error::Misses { .. }) && e.to_string().contains("40.000"), "{e}");
}

#[test]
fn an_end_that_cannot_be_cut_leaves_the_others_cut() {
    let (f, mesh) = tube();
    let ends = [
        opening(2, "inlet", [0.0, 0.0, 5.0], [0.0, 0.0, 1.0]),
        opening(3, "outlet_1", [40.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        opening(4, "outlet_2", [0.0, 0.0, -5.0], [0.0, 0.0, -1.0]),
    ];
    let options = CutOptions::default();
    let mut cutter = Cutter::new(&mesh, &f, &Uniform(0.6), &options);
    let mut asked = Vec::new();
    cut_each(&mut cutter, &ends, |o, e| {
        asked.push((o.name.clone(), e));
        Ok::<_, Error>(None)
    })
    .expect("cut");
    assert!(matches!(&asked[..], [(name, Error::Misses { .. })] if name == "outlet_1"), "{asked:?}");
    let (cut, measures, _) = cutter.finish(&|| false);
    assert_eq!(measures.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["inlet", "outlet_2"]);
    assert!(check(&cut).is_closed_manifold());
    // What lies beyond the planes is gone, in equal parts.
    let b = cut.bounds();
    assert!((b.max.z - 5.0).abs() < 1e-9 && (b.min.z + 5.0).abs() < 1e-9, "{b:?}");
}

#[test]
fn a_found_end_takes_off_no_other_opening_and_not_most_of_the_vessel() {
    let (f, mesh) = tube();
    let options = CutOptions::default();
    let first = opening(2, "inlet", [0.0, 0.0, 5.0], [0.0, 0.0, 1.0]);
    let found = |z: f64| Opening { found_by: FoundBy::BluntEnd, ..opening(3, "outlet_1", [0.0, 0.0, z], [0.0, 0.0, 1.0]) };
    for (ends, wrong) in [(vec![first.clone(), found(4.0)], "another opening"), (vec![found(-3.0)], "most of it")] {
        let mut cutter = Cutter::new(&mesh, &f, &Uniform(0.6), &options);
        let mut asked = Vec::new();
        cut_each(&mut cutter, &ends, |_, e| {
            asked.push(e);
            Ok::<_, Error>(None)
        })
        .expect("cut");
        assert!(matches!(&asked[..], [Error::TakesOff { .. }]), "{wrong}: {asked:?}");
        assert_eq!(cutter.openings().len(), ends.len() - 1);
    }
    // A given plane is what the user wants.
    let mut cutter = Cutter::new(&mesh, &f, &Uniform(0.6), &options);
    let given = opening(3, "outlet_1", [0.0, 0.0, -3.0], [0.0, 0.0, 1.0]);
    cutter.open(&[given]).expect("cut");
}

#[test]
fn another_plane_may_be_tried_in_the_place_of_one_that_misses() {
    let (f, mesh) = tube();
    let options = CutOptions::default();
    let mut cutter = Cutter::new(&mesh, &f, &Uniform(0.6), &options);
    let miss = opening(2, "inlet", [0.0, 0.0, 30.0], [0.0, 0.0, 1.0]);
    let other = opening(2, "inlet", [0.0, 0.0, 4.0], [0.0, 0.0, 1.0]);
    cut_each(&mut cutter, &[miss], |_, _| Ok::<_, Error>(Some(other.clone()))).expect("cut");
    assert_eq!(cutter.openings(), [other]);
}

#[test]
fn a_ring_is_opened_by_two_planes_and_not_by_one() {
    let f = Torus { axis: 4.0, radius: 1.0 };
    let supports = Supports::new(&f);
    let (mesh, _) = isotropic::remesh(&polygonize(&f, 0.4), &supports, &Uniform(0.5), &Default::default()).expect("remesh");
    let mut first = opening(2, "inlet", [4.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let mut second = opening(3, "outlet_1", [0.0, 4.0, 0.0], [1.0, 0.0, 0.0]);
    first.radius = 1.0;
    second.radius = 1.0;
    let alone = super::cut(&mesh, &f, &Uniform(0.5), &[first.clone()], &CutOptions::default()).expect_err("a ring");
    assert!(matches!(alone, Error::Ring { .. }), "{alone}");
    // The quarter between the planes goes; what stays is a bent tube.
    let (cut, measures, _) = super::cut(&mesh, &f, &Uniform(0.5), &[first, second], &CutOptions::default()).expect("cut");
    let t = check(&cut);
    assert!(t.is_closed_manifold() && t.euler == 2 && t.components == 1, "{t:?}");
    assert_eq!(measures.len(), 2);
    assert!(measures.iter().all(|m| (m.area / std::f64::consts::PI - 1.0).abs() < 0.05), "{measures:?}");
}

#[test]
fn where_two_caps_meet_at_the_wall_their_corner_lies_on_all_three() {
    let (f, mesh) = tube();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let ends = [opening(2, "inlet", [0.5, 0.0, 5.0], [half, 0.0, half]), opening(3, "outlet_1", [-0.5, 0.0, 5.0], [-half, 0.0, half])];
    let (cut, ..) = super::cut(&mesh, &f, &Uniform(0.6), &ends, &CutOptions::default()).expect("cut");
    let mut patches = vec![std::collections::BTreeSet::new(); cut.points.len()];
    for (t, ids) in cut.triangles.iter().enumerate() {
        ids.iter().for_each(|&v| { patches[v as usize].insert(cut.patch[t]); });
    }
    let corners: Vec<Point> = (0..cut.points.len()).filter(|&v| patches[v].len() == 3).map(|v| cut.points[v]).collect();
    assert_eq!(corners.len(), 2, "{corners:?}");
    for c in corners {
        assert!(f.value(&c).abs() < 1e-9 && ends.iter().all(|o| o.plane.signed_distance(&c).abs() < 1e-12), "{c:?}");
    }
}
