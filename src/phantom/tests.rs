use super::*;
use crate::mask::topology;

#[test]
fn every_phantom_has_the_volume_and_the_topology_of_its_truth() {
    for (name, tunnels) in [("aneurysm", 0), ("bend", 0), ("bifurcation", 0), ("kissing", 0), ("sphere", 0), ("torus", 1), ("stenosis", 0), ("helix-oblique", 0), ("tube-anisotropic", 0)] {
        let phantom = build(name).expect(name);
        let mask = phantom.mask();
        let t = topology(&mask);
        assert_eq!([t.components, t.tunnels, t.cavities], [1, tunnels, 0], "{name}");
        let exact = match name {
            "sphere" => 4.0 / 3.0 * std::f64::consts::PI * 216.0,
            "torus" => 2.0 * std::f64::consts::PI.powi(2) * 8.0 * 6.25,
            "bend" => std::f64::consts::PI * 2.2 * 2.2 * (std::f64::consts::PI * 9.0 + 28.0) + 4.0 / 3.0 * std::f64::consts::PI * 2.2f64.powi(3),
            _ => continue,
        };
        approx::assert_relative_eq!(mask.volume(), exact, max_relative = 0.01);
    }
}

#[test]
fn every_voxel_has_the_sign_of_the_truth() {
    for name in ["aneurysm-anisotropic", "thin", "stenosis-oblique"] {
        let phantom = build(name).expect(name);
        let mask = phantom.mask();
        for n in 0..mask.data.len() {
            let [i, j, k] = mask.grid.voxel(n).map(|v| v as f64);
            let d = phantom.truth.value(&mask.grid.to_world(Vector::new(i, j, k)));
            assert_eq!(mask.data[n] != 0, d <= 0.0, "{name}: voxel {n}");
        }
    }
}

#[test]
fn gradients_are_the_derivatives_of_the_values() {
    for name in ["aneurysm", "stenosis", "tree", "torus"] {
        let truth = build(name).expect(name).truth;
        let mut random = Random::new(7);
        let (low, high) = (truth.bounds().min, truth.bounds().max);
        let mut compared = 0;
        for _ in 0..300 {
            let p = Point::from(Vector::from_fn(|a, _| random.uniform(low[a], high[a])));
            let h = 1e-6;
            let slope = |s: f64| Vector::from_fn(|a, _| (truth.value(&(p + Vector::ith(a, h * s))) - truth.value(&p)) / (h * s));
            // Where two pieces are equally near the function has a crease.
            let (forward, backward) = (slope(1.0), slope(-1.0));
            if (forward - backward).norm() < 1e-4 {
                approx::assert_relative_eq!(truth.value_gradient(&p).1, 0.5 * (forward + backward), epsilon = 1e-4);
                compared += 1;
            }
        }
        assert!(compared > 250, "{name}: {compared}");
    }
}

#[test]
fn ends_lie_on_the_axis_where_the_vessel_ends_or_leaves_the_image() {
    for name in ["aneurysm", "tube", "tube-oblique", "bend", "bifurcation-anisotropic", "stenosis", "helix", "tree"] {
        let phantom = build(name).expect(name);
        let mask = phantom.mask();
        let ends = phantom.ends(&mask.grid);
        assert!(ends.len() >= 2, "{name}");
        for end in &ends {
            let (u, v) = end.plane.basis();
            for s in [0.0, 1.0, 2.5, 4.0] {
                let at = |r: f64| phantom.truth.value(&(end.plane.origin + (u * f64::cos(s) + v * f64::sin(s)) * r - end.plane.normal * 1e-9));
                approx::assert_abs_diff_eq!(at(end.radius), 0.0, epsilon = 0.02 * end.radius);
            }
            let index = mask.grid.to_index(&end.plane.origin);
            let edge = (0..3).map(|a| (index[a] + 0.5).abs().min((index[a] + 0.5 - mask.grid.dims[a] as f64).abs())).fold(f64::INFINITY, f64::min);
            assert_eq!(end.on_border, edge < 1e-9, "{name}: {end:?}");
        }
        assert!(ends.windows(2).all(|w| w[0].radius >= w[1].radius) && ends[0].name == "inlet");
    }
    for name in ["aneurysm", "aneurysm-oblique"] {
        let phantom = build(name).expect(name);
        let ends = phantom.ends(&phantom.mask().grid);
        assert_eq!(ends.iter().map(|e| e.on_border).collect::<Vec<_>>(), [ends[0].plane.normal.z < -0.9, ends[1].plane.normal.z < -0.9, false], "{name}");
        assert_eq!(ends.iter().filter(|e| e.on_border).count(), 1, "{name}: only the inlet leaves the image");
    }
    assert!(build("tube").expect("tube").ends(&build("tube").expect("tube").mask().grid).iter().all(|e| e.on_border));
}

#[test]
fn random_trees_are_single_trees_and_repeat_by_seed() {
    for seed in 0..12 {
        let phantom = random_tree(seed, &TreeOptions::default());
        assert_eq!(phantom, random_tree(seed, &TreeOptions::default()));
        let mask = phantom.mask();
        let t = topology(&mask);
        assert_eq!([t.components, t.tunnels, t.cavities], [1, 0, 0], "seed {seed}");
        let ends = phantom.ends(&mask.grid);
        assert!(ends.len() >= 3, "seed {seed} has {} ends", ends.len());
        // Every tip lies free: just beyond its round end there is background.
        for end in ends.iter().filter(|e| !e.on_border) {
            assert!(phantom.truth.value(&(end.plane.origin + end.plane.normal * (1.2 * end.radius))) > 0.0, "seed {seed}: {end:?}");
        }
    }
}

#[test]
fn an_unknown_name_is_answered_with_the_names_there_are() {
    let e = build("heart").unwrap_err().to_string();
    assert!(e.contains("heart") && e.contains("aneurysm") && e.contains("-anisotropic"), "{e}");
    for name in list() {
        assert!(build(&name).is_ok(), "{name}");
    }
}

#[test]
fn the_axis_of_a_phantom_is_known_in_one_vessel_and_nowhere_else() {
    let bend = build("bend").unwrap();
    let top = bend.truth.axis(&Point::from(Vector::new(0.1, 1.0, 0.0).normalize() * 9.0));
    let top = top.expect("the middle of the bend");
    assert!((top.point.coords.norm() - 9.0).abs() < 1e-9 && (top.radius - 2.2).abs() < 1e-12, "{top:?}");
    let y = build("bifurcation").unwrap();
    let leg = y.truth.axis(&Point::new(0.3, 0.0, -10.0)).expect("the inlet's leg");
    assert!((leg.point - Point::new(0.0, 0.0, -10.0)).norm() < 1e-12 && leg.direction.z.abs() > 0.999);
    assert!(y.truth.axis(&Point::origin()).is_none(), "the junction belongs to three vessels");
    assert!(y.truth.axis(&Point::new(0.0, 0.0, -21.0)).is_none(), "beyond the end of the axis");
    assert!(y.truth.axis(&Point::new(9.0, 9.0, -9.0)).is_none(), "outside");
}
