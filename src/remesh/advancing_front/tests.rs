use super::*;
use crate::geometry::Vector;
use crate::mesh::intersect::self_intersections;
use crate::polygonize::{Lattice, polygonize_from};
use crate::remesh::Uniform;

/// Distance to a torus round the z axis.
struct Torus {
    major: f64,
    minor: f64,
}

impl Implicit for Torus {
    fn value(&self, p: &Point) -> f64 {
        (p.x.hypot(p.y) - self.major).hypot(p.z) - self.minor
    }
    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let r = p.x.hypot(p.y);
        let d = (r - self.major).hypot(p.z);
        let s = (r - self.major) / d;
        (d - self.minor, Vector::new(p.x / r * s, p.y / r * s, p.z / d))
    }
    fn bounds(&self) -> Aabb {
        let r = self.major + self.minor;
        Aabb { min: Point::new(-r, -r, -self.minor), max: Point::new(r, r, self.minor) }
    }
    fn resolution(&self) -> f64 {
        0.1
    }
}

/// Capsules, joined smoothly.
struct Capsules {
    list: Vec<(Point, Point, f64)>,
    blend: f64,
}

impl Capsules {
    fn y() -> Capsules {
        let o = Point::origin();
        let list = vec![
            (Point::new(-8.0, 0.0, 0.0), o, 2.0),
            (o, Point::new(7.0, 4.0, 0.5), 1.5),
            (o, Point::new(7.0, -4.0, 0.0), 1.2),
        ];
        Capsules { list, blend: 0.8 }
    }
}

impl Implicit for Capsules {
    fn value(&self, p: &Point) -> f64 {
        self.value_gradient(p).0
    }
    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let mut out: Option<(f64, Vector)> = None;
        for (a, b, r) in &self.list {
            let ab = b - a;
            let t = ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
            let d = p - (a + ab * t);
            let (e, g) = (d.norm() - r, d.normalize());
            out = Some(match out {
                None => (e, g),
                Some((f, n)) => {
                    let h = (0.5 + 0.5 * (e - f) / self.blend).clamp(0.0, 1.0);
                    (e * (1.0 - h) + f * h - self.blend * h * (1.0 - h), g * (1.0 - h) + n * h)
                }
            });
        }
        out.unwrap()
    }
    fn bounds(&self) -> Aabb {
        Aabb::of(self.list.iter().flat_map(|c| [&c.0, &c.1])).inflated(3.0)
    }
    fn resolution(&self) -> f64 {
        0.1
    }
}

fn background(f: &dyn Implicit, seeds: &[Point], cell: f64) -> TriMesh {
    let lattice = Lattice::axis_aligned(Point::new(0.013, 0.017, 0.019), cell);
    polygonize_from(f, &lattice, seeds, 0.0).unwrap().0
}

fn skewness(m: &TriMesh) -> Vec<f64> {
    let mut s: Vec<f64> = m
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| m.points[v as usize]);
            1.0 - grow::shape(&a, &b, &c)
        })
        .collect();
    s.sort_by(f64::total_cmp);
    s
}

fn report(name: &str, m: &TriMesh, s: &AdvancingFrontSummary) {
    let q = skewness(m);
    let n = q.len();
    println!(
        "{name}: {n} faces, front {:.3}, S mean {:.3} p99 {:.3} max {:.3}, leniency {:?}, holes {} fallbacks {:?}, intersections {}",
        s.front_fraction,
        q.iter().sum::<f64>() / n as f64,
        q[n * 99 / 100],
        q[n - 1],
        s.by_leniency,
        s.holes,
        s.fallbacks,
        self_intersections(m).len()
    );
}

fn expect_good(name: &str, f: &dyn Implicit, b: &TriMesh, size: &dyn SizeField) -> TriMesh {
    let (m, s) = remesh(b, f, size, &AdvancingFrontOptions::default()).unwrap();
    report(name, &m, &s);
    let t = check(&m);
    assert!(t.is_closed_manifold() && t.euler == check(b).euler && t.unused_points == 0, "{name}: {t:?}");
    assert!(s.fallbacks.is_empty(), "{name}: {:?}", s.fallbacks);
    assert!(s.front_fraction >= 0.95, "{name}: {}", s.front_fraction);
    assert!(self_intersections(&m).is_empty(), "{name}");
    let worst = m.points.iter().map(|p| f.value(p).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-7, "{name}: {worst}");
    m
}

#[test]
fn a_torus_keeps_its_hole_and_gets_edges_of_the_wished_length() {
    let f = Torus { major: 5.0, minor: 2.0 };
    let b = background(&f, &[Point::new(7.0, 0.0, 0.0)], 0.4);
    for h in [0.25, 0.5, 1.0] {
        let m = expect_good(&format!("torus {h}"), &f, &b, &Uniform(h));
        let wished = f.major * f.minor * 4.0 * std::f64::consts::PI.powi(2) / (0.433 * h * h);
        let ratio = m.triangles.len() as f64 / wished;
        assert!((0.75..1.35).contains(&ratio), "{ratio}");
        let s = skewness(&m);
        assert!(s.iter().sum::<f64>() / (s.len() as f64) < 0.25);
    }
}

#[test]
fn a_bifurcation_is_meshed_whole_at_fine_and_coarse_size() {
    let f = Capsules::y();
    let b = background(&f, &[Point::new(-10.0, 0.0, 0.0)], 0.4);
    for h in [0.2, 0.35, 0.7] {
        expect_good(&format!("Y {h}"), &f, &b, &Uniform(h));
    }
}

/// Fine at the origin, coarser with distance.
struct Graded;

impl SizeField for Graded {
    fn size(&self, p: &Point) -> f64 {
        (0.1 + 0.2 * p.coords.norm()).min(0.8)
    }
}

#[test]
fn edges_follow_a_graded_field() {
    let f = Capsules::y();
    let b = background(&f, &[Point::new(-10.0, 0.0, 0.0)], 0.4);
    let m = expect_good("graded Y", &f, &b, &Graded);
    let mut ratios: Vec<f64> = m
        .triangles
        .iter()
        .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
        .map(|(a, b)| {
            let (p, q) = (m.points[a as usize], m.points[b as usize]);
            (q - p).norm() / Graded.size(&nalgebra::center(&p, &q))
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    let at = |q: f64| ratios[(q * (ratios.len() - 1) as f64) as usize];
    assert!((0.9..1.15).contains(&at(0.5)), "{}", at(0.5));
    assert!(at(0.01) > 0.6 && at(0.99) < 1.6, "{} {}", at(0.01), at(0.99));
}

#[test]
fn two_vessels_with_a_gap_far_below_the_edge_length_stay_apart() {
    let at = |y: f64| (Point::new(-5.0, y, 0.0), Point::new(5.0, y, 0.0), 1.5);
    let f = Capsules { list: vec![at(-1.55), at(1.55)], blend: 1e-3 };
    let b = background(&f, &[Point::new(0.0, -3.05, 0.0), Point::new(0.0, 3.05, 0.0)], 0.06);
    let m = expect_good("two vessels", &f, &b, &Uniform(0.5));
    assert_eq!(check(&m).components, 2);
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let f = Torus { major: 5.0, minor: 2.0 };
    let b = background(&f, &[Point::new(7.0, 0.0, 0.0)], 0.4);
    let run = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| remesh(&b, &f, &Uniform(0.6), &AdvancingFrontOptions::default()).unwrap().0)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn what_cannot_be_meshed_keeps_its_triangles_and_says_so() {
    let f = Torus { major: 5.0, minor: 2.0 };
    let b = background(&f, &[Point::new(7.0, 0.0, 0.0)], 0.4);
    let (m, s) = remesh(&b, &f, &Uniform(30.0), &AdvancingFrontOptions::default()).unwrap();
    assert_eq!(m.triangles.len(), b.triangles.len());
    assert_eq!(s.fallbacks.len(), 1);
    assert_eq!(s.front_fraction, 0.0);
    let mut open = b.clone();
    open.triangles.pop();
    open.patch.pop();
    let e = remesh(&open, &f, &Uniform(0.5), &AdvancingFrontOptions::default()).unwrap_err();
    assert!(matches!(e, AdvancingFrontError::NotClosed { at: Some(_) }));
    let e = remesh(&b, &f, &Uniform(0.0), &AdvancingFrontOptions::default()).unwrap_err();
    assert!(matches!(e, AdvancingFrontError::Size { .. }));
}
