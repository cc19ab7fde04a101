use super::*;
use crate::mask::topology;
use crate::phantom::plane_section;

/// Area of the mask's section just inside an end, mm².
fn face(sample: &Sample, end: &TrueEnd) -> f64 {
    let spacing = sample.mask.grid.spacing();
    let coarse = spacing.into_iter().fold(0.0, f64::max);
    let at = |p: &Point| {
        let i = sample.mask.grid.to_index(p).map(|c| c.round() as i64);
        sample.mask.at(i.x, i.y, i.z)
    };
    let plane = Plane { origin: end.plane.origin - end.plane.normal * coarse, normal: end.plane.normal };
    plane_section(at, &plane, [6.0 * end.radius, coarse, 0.3 * coarse]).map_or(0.0, |s| s.area)
}

#[test]
fn every_kind_repeats_by_seed_and_hangs_together() {
    for kind in kinds() {
        let s = sample(kind, 3).expect(kind);
        assert_eq!(s, sample_by_name(&format!("{kind}-3")).expect(kind), "{kind}");
        assert_ne!(s.mask, sample(kind, 4).expect(kind).mask, "{kind}");
        assert_eq!(topology(&s.mask).components, 1, "{kind}");
        assert!(s.mask.grid.len() <= 3_000_000 && s.ends.len() >= 2, "{kind}");
        assert!(s.ends[0].name == "inlet" && s.ends.windows(2).all(|e| e[0].area >= e[1].area), "{kind}");
    }
    assert!(sample("heart", 1).is_none() && sample_by_name("cuts").is_none() && sample_by_name("cuts-x").is_none());
}

#[test]
fn the_true_areas_are_those_of_the_mask() {
    for kind in kinds() {
        for seed in 1..4 {
            let s = sample(kind, seed).expect(kind);
            for end in &s.ends {
                let ratio = face(&s, end) / end.cap_area;
                assert!((0.8..1.3).contains(&ratio), "{}: {} {ratio:.2}", s.name, end.name);
                assert!(end.tilt() <= 50.0 && end.cap_area > 0.95 * end.area, "{}: {end:?}", s.name);
            }
        }
    }
}

#[test]
fn a_slanted_cut_of_a_straight_tube_is_an_ellipse() {
    for seed in 1..6 {
        let s = sample("oblique", seed).expect("a sample");
        for end in &s.ends {
            let exact = end.area / end.tilt().to_radians().cos();
            approx::assert_relative_eq!(end.cap_area, exact, max_relative = 0.01);
        }
    }
}

#[test]
fn ends_on_the_border_lie_on_a_face_of_the_image() {
    let mut seen = 0;
    for (kind, seed) in ["splits", "grazing", "dissections"].into_iter().flat_map(|k| (1..6).map(move |s| (k, s))) {
        let s = sample(kind, seed).expect(kind);
        for end in s.ends.iter().filter(|e| e.on_border) {
            let at = s.mask.grid.to_index(&end.plane.origin);
            let off = (0..3).map(|a| (at[a] + 0.5).abs().min((at[a] + 0.5 - s.mask.grid.dims[a] as f64).abs()));
            assert!(off.fold(f64::INFINITY, f64::min) < 1e-4, "{}: {at}", s.name);
            seen += 1;
        }
    }
    assert!(seen > 10, "{seen}");
}

#[test]
fn a_grazed_side_lies_on_the_face_and_has_its_area() {
    for seed in 1..9 {
        let s = sample("grazing", seed).expect("a sample");
        let [closed] = s.closed.as_slice() else { panic!("{}: {:?}", s.name, s.closed) };
        let plane = Plane { origin: closed.at + Vector::x() * (0.5 * s.mask.grid.voxel_diagonal()), normal: -Vector::x() };
        let at = |p: &Point| {
            let i = s.mask.grid.to_index(p).map(|c| c.round() as i64);
            s.mask.at(i.x, i.y, i.z)
        };
        assert!(closed.at.x.abs() < 1e-5, "{}", s.name);
        let reach = 40.0 * s.ends[0].radius;
        let found = plane_section(at, &plane, [reach, reach / 4.0, 0.4 * s.mask.grid.voxel_diagonal()]).expect("a section");
        // Half a voxel inside, a grazed side is wider than on the face.
        assert!(found.area > 0.8 * closed.area.expect("an area"), "{}: {} {closed:?}", s.name, found.area);
    }
}
