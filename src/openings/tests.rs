use super::*;
use crate::centerline::{CenterlineOptions, trace};
use crate::geometry::Vector;
use crate::mask::Mask;
use crate::phantom::{self, TreeOptions, random_tree};

/// How the openings found in a phantom's picture compare with its own.
#[derive(Debug, Default)]
struct Score {
    ends: usize,
    found: usize,
    invented: usize,
    /// Sentences on what is wrong.
    wrong: Vec<String>,
}

fn score(phantom: &phantom::Phantom) -> Score {
    let picture = phantom.mask();
    let evidence = [Evidence::of(&picture)];
    let mask = evidence[0].carried_on(&picture, 2, 4);
    let ends = phantom.ends(&picture.grid);
    let mut s = Score { ends: ends.len(), ..Score::default() };
    let (lines, _) = trace(&mask, &CenterlineOptions::default()).unwrap();
    let (found, report) = detect(&mask, &lines, &evidence, &DetectOptions::default());
    let (wall, _) = crate::implicit::smooth::fit(&mask, &Default::default()).unwrap();
    let openings: Vec<Opening> = found.iter().map(|o| refine(&mask, &wall, o)).collect();
    let mut used = vec![false; openings.len()];
    for end in &ends {
        let near = |o: &Opening| (o.plane.origin - end.plane.origin).norm();
        let best = (0..openings.len()).filter(|&n| !used[n]).min_by(|&a, &b| near(&openings[a]).total_cmp(&near(&openings[b])));
        let Some(n) = best.filter(|&n| near(&openings[n]) < 2.5 * end.radius) else {
            let blind: Vec<_> = report.blind.iter().map(|b| (b.reason, (b.tip - end.plane.origin).norm() / end.radius)).collect();
            s.wrong.push(format!("{}: missed {:?} radius {:.2}; blind {blind:.2?}", phantom.name, end.name, end.radius));
            continue;
        };
        used[n] = true;
        // A flat end is cut along its face; what is square to the vessel is its axis.
        let o = &openings[n];
        let direction = if o.support.along_face { o.support.axis } else { o.plane.normal };
        let angle = direction.dot(&end.plane.normal).clamp(-1.0, 1.0).acos().to_degrees();
        if angle > 10.0 {
            s.wrong.push(format!("{}: {} is {angle:.1}° off, radius {:.2}, {:?} along its face {}, tilt {:.0}, face {:.2?} axis {:.2?} true {:.2?}", phantom.name, end.name, end.radius, o.found_by, o.support.along_face, o.tilt(), o.plane.normal.as_slice(), o.support.axis.as_slice(), end.plane.normal.as_slice()));
        } else {
            s.found += 1;
        }
    }
    for (o, _) in openings.iter().zip(&used).filter(|(_, u)| !**u) {
        s.invented += 1;
        s.wrong.push(format!("{}: invented {} radius {:.2} at {:.2?} by {:?}, normal {:.2?}", phantom.name, o.name, o.radius, o.plane.origin.coords.as_slice(), o.found_by, o.plane.normal.as_slice()));
    }
    s
}

#[test]
fn every_end_of_the_built_in_cases_is_found_and_none_invented() {
    // `thin` has ends of two voxels' width, whose cut may lie 2.6 radii in; the axis of `helix` turns by more than
    // 10 degrees within the radius between its end and the cut.
    let wrong: Vec<String> =
        phantom::list().iter().filter(|n| !n.starts_with("thin") && !n.starts_with("helix")).flat_map(|name| score(&phantom::build(name).unwrap()).wrong).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn ends_of_a_few_random_trees_are_found() {
    for seed in [1, 2, 3] {
        let s = score(&random_tree(seed, &TreeOptions::default()));
        assert!(s.found == s.ends && s.invented == 0, "{s:?}");
    }
}

/// `cargo test --release --lib -- --ignored --nocapture two_hundred` prints every miss.
#[test]
#[ignore = "takes minutes"]
fn of_two_hundred_random_trees_ninety_nine_percent_of_ends_are_right() {
    use rayon::prelude::*;
    let scores: Vec<Score> = (1000..1200u64).into_par_iter().map(|seed| score(&random_tree(seed, &TreeOptions::default()))).collect();
    let ends: usize = scores.iter().map(|s| s.ends).sum();
    let found: usize = scores.iter().map(|s| s.found).sum();
    let invented: usize = scores.iter().map(|s| s.invented).sum();
    scores.iter().flat_map(|s| &s.wrong).for_each(|w| println!("{w}"));
    println!("{found} of {ends} ends right, {invented} invented");
    assert!((found as f64 - invented as f64) >= 0.99 * ends as f64);
}

fn tube() -> (Mask, crate::centerline::Centerlines, Vec<Opening>) {
    let p = phantom::build("bend").unwrap();
    let picture = p.mask();
    let evidence = [Evidence::of(&picture)];
    let mask = evidence[0].carried_on(&picture, 2, 4);
    let (lines, _) = trace(&mask, &CenterlineOptions::default()).unwrap();
    let (openings, _) = detect(&mask, &lines, &evidence, &DetectOptions::default());
    (mask, lines, openings)
}

#[test]
fn names_and_ids_follow_the_contract_and_the_user() {
    let (mask, lines, found) = tube();
    assert_eq!(found.iter().map(|o| (o.id, o.name.as_str())).collect::<Vec<_>>(), [(2, "inlet"), (3, "outlet_1")]);
    let user = UserOpenings { inlets: vec!["outlet_1".into()], ..UserOpenings::default() };
    let (turned, _) = apply_user(&mask, &lines, found.clone(), &user).unwrap();
    assert_eq!((turned[0].name.as_str(), turned[0].plane.origin), ("inlet", found[1].plane.origin));
    assert_eq!((turned[1].name.as_str(), turned[1].plane.origin), ("outlet_2", found[0].plane.origin));
    let user = UserOpenings { rename: vec![("outlet_1".into(), "distal".into())], ..UserOpenings::default() };
    let (renamed, _) = apply_user(&mask, &lines, found.clone(), &user).unwrap();
    assert_eq!((renamed[1].name.as_str(), renamed[1].id), ("distal", 3));
    let user = UserOpenings { drop: vec!["outlet_7".into()], ..UserOpenings::default() };
    assert!(matches!(apply_user(&mask, &lines, found, &user), Err(UserError::UnknownName { .. })));
}

/// A trunk of radius 3 that ends in four branches, largest first.
fn four_outlets() -> (Mask, crate::centerline::Centerlines, Vec<Opening>) {
    let (mask, lines, found) = tube();
    let one = |n: usize, name: &str, kind, shift: f64| {
        let mut o = found[usize::from(n > 0)].clone();
        o.plane.origin += o.plane.normal * -shift;
        Opening { id: n as u32 + 2, name: name.into(), kind, ..o }
    };
    let out = PatchKind::Outlet;
    let all = vec![
        one(0, "inlet", PatchKind::Inlet, 0.0),
        one(1, "outlet_1", out, 0.0),
        one(2, "outlet_2", out, 3.0),
        one(3, "outlet_3", out, 6.0),
    ];
    (mask, lines, all)
}

#[test]
fn names_that_nobody_touched_stay_with_their_vessel() {
    let (mask, lines, found) = four_outlets();
    let place = |list: &[Opening], name: &str| list.iter().find(|o| o.name == name).map(|o| o.plane.origin);
    let apply = |user: UserOpenings| apply_user(&mask, &lines, found.clone(), &user).map(|r| r.0);
    let rename = |pairs: &[(&str, &str)]| pairs.iter().map(|(a, b)| (a.to_string(), b.to_string())).collect::<Vec<_>>();
    let users = [
        (UserOpenings { rename: rename(&[("outlet_1", "va_right")]), ..Default::default() }, &["inlet", "outlet_2", "outlet_3"][..]),
        (UserOpenings { drop: vec!["outlet_1".into()], ..Default::default() }, &["inlet", "outlet_2", "outlet_3"]),
        // One of them is the inlet then.
        (UserOpenings { drop: vec!["inlet".into()], ..Default::default() }, &[]),
        (UserOpenings { inlets: vec!["outlet_2".into()], ..Default::default() }, &["outlet_1", "outlet_3"]),
        (UserOpenings { inlets: vec!["inlet".into(), "outlet_2".into()], ..Default::default() }, &["inlet", "outlet_1", "outlet_3"]),
        (UserOpenings { rename: rename(&[("outlet_1", "inlet_right")]), ..Default::default() }, &["outlet_2", "outlet_3"]),
    ];
    for (user, untouched) in users {
        let list = apply(user.clone()).expect("openings");
        for name in untouched {
            assert_eq!(place(&list, name), place(&found, name), "{name}: {user:?}");
        }
        for o in &list {
            let same = place(&found, &o.name).is_none_or(|p| o.name == "inlet" || p == o.plane.origin);
            assert!(same, "{o:?}: {user:?}");
            assert!(!o.name.starts_with("inlet") || o.kind == PatchKind::Inlet, "{o:?}");
            assert!(!o.name.starts_with("outlet") || o.kind == PatchKind::Outlet, "{o:?}");
        }
    }
}

#[test]
fn inlets_are_made_by_name_and_by_list() {
    let (mask, lines, found) = four_outlets();
    let apply = |user: UserOpenings| apply_user(&mask, &lines, found.clone(), &user);
    let rename = |pairs: &[(&str, &str)]| pairs.iter().map(|(a, b)| (a.to_string(), b.to_string())).collect::<Vec<_>>();
    let inlets = |list: &[Opening]| {
        list.iter().filter(|o| o.kind == PatchKind::Inlet).map(|o| (o.name.clone(), o.plane.origin)).collect::<Vec<_>>()
    };
    let (first, second) = (found[0].plane.origin, found[1].plane.origin);
    let both = UserOpenings { rename: rename(&[("inlet", "inlet_left"), ("outlet_1", "inlet_right")]), ..Default::default() };
    let mut list = inlets(&apply(both).expect("openings").0);
    list.sort_by(|a, b| a.0.cmp(&b.0));
    assert_eq!(list, [("inlet_left".to_string(), first), ("inlet_right".into(), second)]);
    let (list, _) = apply(UserOpenings { inlets: vec!["inlet".into(), "outlet_1".into()], ..Default::default() }).expect("openings");
    assert_eq!(inlets(&list).iter().map(|i| i.0.as_str()).collect::<Vec<_>>(), ["inlet", "inlet_2"]);
    // A name that says nothing keeps what was found; one that is displaced is told.
    let aorta = UserOpenings { rename: rename(&[("inlet", "aorta")]), ..Default::default() };
    assert_eq!(inlets(&apply(aorta).expect("openings").0), [("aorta".to_string(), first)]);
    let displaced = UserOpenings { rename: rename(&[("inlet", "aorta"), ("outlet_1", "inlet_b")]), ..Default::default() };
    let (list, warnings) = apply(displaced).expect("openings");
    assert_eq!(inlets(&list), [("inlet_b".to_string(), second)]);
    assert!(warnings.iter().any(|w| w.contains("`aorta` is an outlet")), "{warnings:?}");
    let same = UserOpenings { rename: rename(&[("outlet_1", "outlet_3")]), ..Default::default() };
    assert!(matches!(apply(same), Err(UserError::SameName { .. })));
}

#[test]
fn a_given_plane_replaces_the_detected_one_and_bad_ones_are_refused_with_a_place() {
    let (mask, lines, found) = tube();
    let own = &found[1];
    let plane = |center, normal| UserOpenings {
        planes: vec![UserPlane { name: "out".into(), center, normal, kind: None }],
        ..UserOpenings::default()
    };
    let moved = own.plane.origin - own.plane.normal * own.radius;
    let (list, _) = apply_user(&mask, &lines, found.clone(), &plane(moved, own.plane.normal)).unwrap();
    assert_eq!(list.len(), 2);
    assert!(list.iter().any(|o| o.name == "out" && o.found_by == FoundBy::User && (o.plane.origin - moved).norm() < own.radius));
    let away = own.plane.origin + Vector::new(3.0, 4.0, 5.0) * (4.0 * own.radius);
    let e = apply_user(&mask, &lines, found.clone(), &plane(away, own.plane.normal)).unwrap_err();
    assert!(matches!(e, UserError::Misses { .. }), "{e}");
    // Turned round where it was found: less than a diameter would be left.
    let e = apply_user(&mask, &lines, found.clone(), &plane(own.plane.origin, -own.plane.normal)).unwrap_err();
    assert!(matches!(e, UserError::CutsEverything { .. }), "{e}");
    // A plane along the vessel cuts what it crosses.
    let (side, _) = own.plane.basis();
    let (list, _) = apply_user(&mask, &lines, found, &plane(moved, side)).unwrap();
    assert!(list.iter().any(|o| o.name == "out"), "{list:?}");
}

#[test]
fn a_plane_on_the_very_tip_is_drawn_in_to_the_first_whole_section() {
    let (mask, lines, found) = tube();
    let own = &found[1];
    // The tip lies a radius and more beyond the opening that was found.
    let tip = own.plane.origin + own.plane.normal * own.radius;
    let planes = vec![UserPlane { name: "out".into(), center: tip, normal: own.plane.normal, kind: None }];
    let (list, warnings) = apply_user(&mask, &lines, found.clone(), &UserOpenings { planes, ..UserOpenings::default() }).unwrap();
    let out = list.iter().find(|o| o.name == "out").unwrap();
    assert!((out.plane.origin - own.plane.origin).norm() < 1.0 * own.radius, "{out:?}");
    assert!(warnings.iter().any(|w| w.contains("further in")), "{warnings:?}");
}
