use nalgebra::Rotation3;

use super::*;
use crate::polygonize::{PolygonizeOptions, polygonize};

/// The mask of everything where `f` is not positive.
fn digitise(grid: Grid, f: impl Fn(Point) -> f64) -> Mask {
    let data = (0..grid.len())
        .map(|n| {
            let [i, j, k] = grid.voxel(n);
            u8::from(f(grid.to_world(Vector::new(i as f64, j as f64, k as f64))) <= 0.0)
        })
        .collect();
    Mask::new(grid, data)
}

fn grid(dims: [usize; 3], spacing: [f64; 3]) -> Grid {
    let turn = Rotation3::from_euler_angles(0.2, 0.4, -0.3);
    Grid::new(dims, spacing, Point::new(11.0, -3.0, 5.5), *turn.matrix()).unwrap()
}

/// Root mean square and mean of the distance, in voxel diagonals, over the vertices.
fn errors(mask: &Mask, f: &SmoothImplicit, truth: impl Fn(Point) -> f64) -> (f64, f64) {
    let (mesh, _) = polygonize(f, mask, &PolygonizeOptions::default()).unwrap();
    let d: Vec<f64> = mesh.points.iter().map(|p| truth(*p) / mask.grid.voxel_diagonal()).collect();
    let n = d.len() as f64;
    ((d.iter().map(|d| d * d).sum::<f64>() / n).sqrt(), d.iter().sum::<f64>() / n)
}

#[test]
fn a_ball_is_met_to_a_twentieth_of_a_voxel_diagonal_without_bias() {
    for (spacing, dims) in [([1.0; 3], [18, 18, 18]), ([0.5, 0.5, 1.0], [30, 30, 18])] {
        let g = grid(dims, spacing);
        let c = g.to_world(Vector::new(dims[0] as f64 * 0.47, dims[1] as f64 * 0.48, dims[2] as f64 * 0.49));
        let truth = |p: Point| (p - c).norm() - 5.3;
        let m = digitise(g, truth);
        let (f, s) = fit(&m, &SmoothOptions::default()).unwrap();
        let (rms, bias) = errors(&m, &f, truth);
        assert!(rms < 0.05 && bias.abs() < 0.02, "{rms} {bias} {s:?}");
        assert_eq!(s.contradicted, 0);
    }
}

#[test]
fn a_noisy_mask_is_met_twice_as_well_as_when_every_label_is_believed() {
    let g = grid([34, 24, 24], [1.0; 3]);
    let (a, b) = (g.to_world(Vector::new(9.0, 11.2, 11.6)), g.to_world(Vector::new(24.0, 12.1, 12.4)));
    let truth = |p: Point| {
        let t = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
        (p - (a + t * (b - a))).norm() - 6.2
    };
    let clean = digitise(g.clone(), truth);
    let (_, s) = fit(&clean, &SmoothOptions::default()).unwrap();
    assert_eq!((s.outliers, s.given_up), (0.0, 0));

    let mut noisy = clean.clone();
    let mut random = crate::phantom::Random::new(3);
    for (v, _) in crate::mask::interface(&clean) {
        if random.uniform(0.0, 1.0) < 0.08 {
            noisy.data[g.linear(v[0].into(), v[1].into(), v[2].into()).unwrap()] ^= 1;
        }
    }
    let (noisy, _) = crate::mask::clean(&noisy, &crate::mask::CleaningOptions::default()).unwrap();
    let (f, s) = fit(&noisy, &SmoothOptions::default()).unwrap();
    assert!((0.04..0.16).contains(&s.outliers) && s.given_up > 50, "{s:?}");
    let (rms, bias) = errors(&noisy, &f, truth);
    let (believing, _) = fit(&noisy, &SmoothOptions { outliers: Some(0.0), ..SmoothOptions::default() }).unwrap();
    let (worse, _) = errors(&noisy, &believing, truth);
    assert!(rms < 0.07 && bias.abs() < 0.015 && rms < 0.5 * worse, "{rms} {bias} {worse}");
    let (mesh, _) = polygonize(&f, &noisy, &PolygonizeOptions::default()).unwrap();
    assert_eq!(crate::mesh::topology::check(&mesh).euler, 2, "a ball");
}

#[test]
fn a_vessel_one_voxel_wide_stays_and_neighbours_one_voxel_apart_stay_apart() {
    let g = grid([24, 12, 12], [1.0; 3]);
    let mut m = digitise(g.clone(), |_| 1.0);
    for i in 2..22 {
        m.data[g.linear(i, 4, 5).unwrap()] = 1;
        m.data[g.linear(i, 6, 5).unwrap()] = 1;
    }
    let (f, s) = fit(&m, &SmoothOptions::default()).unwrap();
    assert_eq!(s.contradicted, 0);
    for n in 0..g.len() {
        let [i, j, k] = g.voxel(n);
        let v = f.value(&g.to_world(Vector::new(i as f64, j as f64, k as f64)));
        assert_eq!(v < 0.0, m.data[n] != 0, "{i} {j} {k}: {v}");
    }
    let (mesh, _) = polygonize(&f, &m, &PolygonizeOptions::default()).unwrap();
    let edges = mesh.triangles.len() * 3 / 2;
    assert_eq!(mesh.points.len() as i64 - edges as i64 + mesh.triangles.len() as i64, 4, "two balls");
}

#[test]
fn gradient_and_hessian_are_those_of_the_value() {
    let g = grid([14, 14, 10], [0.8, 0.8, 1.3]);
    let c = g.to_world(Vector::new(6.6, 6.4, 4.7));
    let m = digitise(g, |p| (p - c).norm() - 3.5);
    let (f, _) = fit(&m, &SmoothOptions::default()).unwrap();
    let p = c + Vector::new(2.0, -1.9, 2.2);
    let (v, gradient) = f.value_gradient(&p);
    assert!((v - f.value(&p)).abs() < 1e-12 && (gradient.norm() - 1.0).abs() < 0.2, "{v} {gradient}");
    let h = f.hessian(&p);
    for a in 0..3 {
        let mut e = Vector::zeros();
        e[a] = 1e-5;
        approx::assert_relative_eq!(gradient[a], (f.value(&(p + e)) - f.value(&(p - e))) / 2e-5, epsilon = 1e-6);
        let d = (f.gradient(&(p + e)) - f.gradient(&(p - e))) / 2e-5;
        for b in 0..3 {
            approx::assert_relative_eq!(h[(b, a)], d[b], epsilon = 1e-6);
        }
    }
}

#[test]
fn a_fit_with_margins_is_the_same_for_any_number_of_threads() {
    // A tilted ring, hardly thicker than a voxel is long.
    let g = grid([28, 28, 14], [0.8, 0.8, 2.0]);
    let c = g.to_world(Vector::new(13.4, 13.7, 6.4));
    let axis = Vector::new(0.3, 0.5, 0.8).normalize();
    let m = digitise(g, |p| {
        let (along, d) = ((p - c).dot(&axis), (p - c).norm_squared());
        along.hypot((d - along * along).max(0.0).sqrt() - 7.0) - 1.2
    });
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (f, summary) = pool.install(|| fit(&m, &SmoothOptions::default()).unwrap());
        (polygonize(&f, &m, &PolygonizeOptions::default()).unwrap().0, summary)
    };
    let (one, three) = (run(1), run(3));
    assert!(one.1.repaired > 0 && one.1.contradicted == 0, "{:?}", one.1);
    assert_eq!(one, three);
}

#[test]
fn an_empty_mask_and_bad_options_are_refused() {
    let m = digitise(grid([4, 4, 4], [1.0; 3]), |_| 1.0);
    assert_eq!(fit(&m, &SmoothOptions::default()).unwrap_err(), SmoothError::Empty);
    let bad = SmoothOptions { sigma: f64::NAN, ..SmoothOptions::default() };
    assert!(matches!(fit(&m, &bad), Err(SmoothError::Option { name: "sigma", .. })));
    let bad = SmoothOptions { outliers: Some(0.5), ..SmoothOptions::default() };
    assert_eq!(fit(&m, &bad).unwrap_err(), SmoothError::Outliers(0.5));
}
