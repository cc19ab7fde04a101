//! Gaussian and mean curvature at the vertices of a surface.

use rayon::prelude::*;
use serde::Serialize;

use crate::geometry::{Point, Vector};
use crate::implicit::Implicit;
use crate::mesh::TriMesh;

/// Curvature at every vertex of a mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Curvature {
    /// Gaussian curvature, 1/mm².
    pub gaussian: Vec<f64>,
    /// Mean curvature, 1/mm; positive where the surface is convex seen from outside: 1/R on a sphere.
    pub mean: Vec<f64>,
}

impl Curvature {
    /// Principal curvatures of vertex `v`, larger magnitude first, 1/mm.
    pub fn principal(&self, v: usize) -> [f64; 2] {
        let (h, k) = (self.mean[v], self.gaussian[v]);
        let d = (h * h - k).max(0.0).sqrt();
        let large = if h < 0.0 { h - d } else { h + d };
        [large, 2.0 * h - large]
    }
}

/// Gaussian and mean curvature of the level set of an implicit function at a point; 0 where the gradient vanishes.
///
/// K = gᵀ adj(H) g / |g|⁴ and M = (|g|² tr H − gᵀ H g) / (2 |g|³) (Goldman 2005, "Curvature formulas for implicit
/// curves and surfaces").
pub fn at(implicit: &dyn Implicit, p: &Point) -> (f64, f64) {
    let g = implicit.gradient(p);
    let h = implicit.hessian(p);
    let n = g.norm();
    if n <= 0.0 || !n.is_finite() {
        return (0.0, 0.0);
    }
    let (c0, c1, c2): (Vector, Vector, Vector) = (h.column(0).into(), h.column(1).into(), h.column(2).into());
    // H is symmetric: the adjugate's rows are the cross products of its columns.
    let adjugate = Vector::new(c1.cross(&c2).dot(&g), c2.cross(&c0).dot(&g), c0.cross(&c1).dot(&g));
    let gaussian = g.dot(&adjugate) / n.powi(4);
    let mean = (n * n * h.trace() - g.dot(&(h * g))) / (2.0 * n.powi(3));
    (gaussian, mean)
}

/// Curvature of the implicit's level set through each vertex, in parallel.
pub fn of_implicit(points: &[Point], implicit: &dyn Implicit) -> Curvature {
    let (gaussian, mean) = points.par_iter().map(|p| at(implicit, p)).unzip();
    Curvature { gaussian, mean }
}

/// Curvature of the triangle mesh itself: angle defect and cotangent Laplacian over the mixed area (Meyer, Desbrun,
/// Schröder and Barr 2003). For surfaces without an implicit, such as marching cubes. 0 at vertices without area.
pub fn of_mesh(mesh: &TriMesh) -> Curvature {
    let n = mesh.points.len();
    let (mut area, mut laplace, mut normal) = (vec![0.0; n], vec![Vector::zeros(); n], vec![Vector::zeros(); n]);
    for t in 0..mesh.triangles.len() {
        let ids = mesh.triangles[t].map(|v| v as usize);
        let p = mesh.corners(t);
        let a2 = mesh.area_vector2(t);
        let size = a2.norm();
        if size <= 0.0 {
            continue;
        }
        let dot = [0, 1, 2].map(|k| (p[(k + 1) % 3] - p[k]).dot(&(p[(k + 2) % 3] - p[k])));
        let obtuse = dot.iter().position(|d| *d < 0.0);
        for k in 0..3 {
            let (i, j) = (ids[(k + 1) % 3], ids[(k + 2) % 3]);
            let cot = dot[k] / size;
            let e = p[(k + 2) % 3] - p[(k + 1) % 3];
            laplace[i] -= 0.5 * cot * e;
            laplace[j] += 0.5 * cot * e;
            if obtuse.is_none() {
                let share = cot * e.norm_squared() / 8.0;
                area[i] += share;
                area[j] += share;
            }
            normal[ids[k]] += a2;
            if let Some(o) = obtuse {
                area[ids[k]] += 0.5 * size * if o == k { 0.5 } else { 0.25 };
            }
        }
    }
    let defect = angle_defects(mesh);
    let gaussian = (0..n).map(|v| if area[v] > 0.0 { defect[v] / area[v] } else { 0.0 }).collect();
    let mean = (0..n)
        .map(|v| {
            let m = normal[v].norm();
            if area[v] > 0.0 && m > 0.0 { 0.5 * laplace[v].dot(&normal[v]) / (m * area[v]) } else { 0.0 }
        })
        .collect();
    Curvature { gaussian, mean }
}

/// 2π less the angles at each vertex, in radians; 0 at vertices without triangles.
pub fn angle_defects(mesh: &TriMesh) -> Vec<f64> {
    let mut sum = vec![0.0; mesh.points.len()];
    let mut used = vec![false; mesh.points.len()];
    for (t, ids) in mesh.triangles.iter().enumerate() {
        let p = mesh.corners(t);
        for k in 0..3 {
            let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
            sum[ids[k] as usize] += a.cross(&b).norm().atan2(a.dot(&b));
            used[ids[k] as usize] = true;
        }
    }
    sum.iter().zip(used).map(|(s, u)| if u { std::f64::consts::TAU - s } else { 0.0 }).collect()
}

/// The theorem of Gauss and Bonnet as a check: on a closed surface the angle defects add up to 2πχ exactly.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GaussBonnet {
    /// Sum of the angle defects over 2π.
    pub total: f64,
    /// Vertices less edges plus triangles, counted.
    pub euler: i64,
    /// Sum over vertices of the implicit's Gaussian curvature by area, over 2π; as far from `euler` as the mesh is coarse.
    pub integral: Option<f64>,
}

/// Compares the angle defects of a closed mesh, and the curvature given for its vertices, with its Euler characteristic.
pub fn gauss_bonnet(mesh: &TriMesh, curvature: Option<&Curvature>) -> GaussBonnet {
    let tau = std::f64::consts::TAU;
    let integral = curvature.map(|c| {
        (0..mesh.triangles.len())
            .map(|t| {
                let k = mesh.triangles[t].iter().map(|&v| c.gaussian[v as usize]).sum::<f64>() / 3.0;
                0.5 * mesh.area_vector2(t).norm() * k / tau
            })
            .sum()
    });
    GaussBonnet {
        total: angle_defects(mesh).iter().sum::<f64>() / tau,
        euler: crate::mesh::topology::check(mesh).euler,
        integral,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;
    use crate::mesh::test_shapes::sphere;

    /// x²/a² + y²/b² + z²/c² − 1.
    struct Ellipsoid([f64; 3]);

    impl Implicit for Ellipsoid {
        fn value(&self, p: &Point) -> f64 {
            (0..3).map(|k| (p[k] / self.0[k]).powi(2)).sum::<f64>() - 1.0
        }
        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            (self.value(p), Vector::from_fn(|k, _| 2.0 * p[k] / self.0[k].powi(2)))
        }
        fn bounds(&self) -> Aabb {
            let m = Point::from(self.0);
            Aabb { min: -m, max: m }
        }
        fn resolution(&self) -> f64 {
            0.05
        }
    }

    #[test]
    fn an_ellipsoid_has_the_curvatures_of_the_textbook() {
        let f = Ellipsoid([3.0, 2.0, 1.0]);
        // At the end of the axis a: principal curvatures a/b² and a/c².
        let (k, m) = at(&f, &Point::new(3.0, 0.0, 0.0));
        assert!((k - 9.0 / 4.0).abs() < 1e-9, "{k}");
        assert!((m - 0.5 * (3.0 / 4.0 + 3.0)).abs() < 1e-9, "{m}");
        let c = of_implicit(&[Point::new(3.0, 0.0, 0.0)], &f);
        let [a, b] = c.principal(0);
        assert!((a - 3.0).abs() < 1e-6 && (b - 0.75).abs() < 1e-6);
    }

    #[test]
    fn the_meshed_sphere_has_curvature_one_over_its_radius() {
        let m = sphere(Point::new(4.0, 5.0, 6.0), 2.0, 30);
        let c = of_mesh(&m);
        let n = c.mean.len() as f64;
        assert!((c.mean.iter().sum::<f64>() / n - 0.5).abs() < 0.01);
        assert!((c.gaussian.iter().sum::<f64>() / n - 0.25).abs() < 0.01);
        assert!(c.mean.iter().all(|h| (h - 0.5).abs() < 0.05));
    }

    #[test]
    fn defects_add_up_to_the_euler_characteristic() {
        let mut m = sphere(Point::origin(), 1.0, 12);
        m.points.iter_mut().for_each(|p| *p = Point::new(3.0 * p.x, 2.0 * p.y, p.z));
        let c = of_implicit(&m.points, &Ellipsoid([3.0, 2.0, 1.0]));
        let g = gauss_bonnet(&m, Some(&c));
        assert_eq!(g.euler, 2);
        assert!((g.total - 2.0).abs() < 1e-10, "{}", g.total);
        assert!((g.integral.unwrap() - 2.0).abs() < 0.15, "{:?}", g.integral);
    }
}
