//! Local quadrics.

use nalgebra::{SMatrix, SVector};

use super::Quadric;
use crate::geometry::{Plane, Point, Vector};
use crate::pointcloud::OrientedPoints;

/// Which kind of quadric a cell got.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Bivariate,
    General,
}

/// A cell's fit about its centre.
pub(super) struct Fit {
    pub quadric: Quadric,
    pub kind: Kind,
}

/// Weighted points of a cell.
struct Patch<'a> {
    cloud: &'a OrientedPoints,
    ids: &'a [u32],
    weights: Vec<f64>,
    center: Point,
    half: f64,
    radius: f64,
    /// Weighted mean of the points, and of the normals (unit).
    origin: Point,
    normal: Vector,
}

/// Fits a quadric to the points `ids` in the ball of `radius` round `center`; `last` forces an answer.
///
/// A general quadric where the normals spread over more than a half space, else a bivariate one.
pub(super) fn fit(cloud: &OrientedPoints, ids: &[u32], center: Point, half: f64, radius: f64, last: bool) -> Option<Fit> {
    let patch = Patch::new(cloud, ids, center, half, radius);
    let Some(patch) = patch else {
        return last.then(|| single_normal(cloud, ids, center, half, radius));
    };
    let spread = ids.iter().any(|&i| cloud.normals[i as usize].dot(&patch.normal) < 0.0);
    if !spread {
        return Some(Fit { quadric: patch.bivariate(), kind: Kind::Bivariate });
    }
    match patch.general() {
        Some(quadric) => Some(Fit { quadric, kind: Kind::General }),
        None if last => Some(single_normal(cloud, ids, center, half, radius)),
        None => None,
    }
}

/// Where no general quadric can be told: the points that face the same way as the one nearest to the centre.
fn single_normal(cloud: &OrientedPoints, ids: &[u32], center: Point, half: f64, radius: f64) -> Fit {
    let nearest = ids.iter().copied().min_by(|&a, &b| {
        let d = |i: u32| (cloud.points[i as usize] - center).norm_squared();
        d(a).total_cmp(&d(b)).then(a.cmp(&b))
    });
    let lead = nearest.map_or(0, |i| i as usize);
    let same: Vec<u32> = ids.iter().copied().filter(|&i| cloud.normals[i as usize].dot(&cloud.normals[lead]) > 0.3).collect();
    let quadric = match Patch::new(cloud, &same, center, half, radius) {
        Some(p) => p.bivariate(),
        None => plane(cloud.points[lead], cloud.normals[lead], center),
    };
    Fit { quadric, kind: Kind::Bivariate }
}

fn plane(origin: Point, normal: Vector, center: Point) -> Quadric {
    Quadric { constant: normal.dot(&(center - origin)), linear: normal.into(), second: [0.0; 6] }
}

impl<'a> Patch<'a> {
    fn new(cloud: &'a OrientedPoints, ids: &'a [u32], center: Point, half: f64, radius: f64) -> Option<Patch<'a>> {
        let mut weights = Vec::with_capacity(ids.len());
        let (mut sum, mut origin, mut normal) = (0.0, Vector::zeros(), Vector::zeros());
        for &i in ids {
            let y = cloud.points[i as usize] - center;
            let (w, _) = super::weight(y.norm_squared(), radius * radius);
            weights.push(w);
            sum += w;
            origin += y * w;
            normal += cloud.normals[i as usize] * w;
        }
        let length = normal.norm();
        if sum <= 0.0 || length < 1e-6 * sum {
            return None;
        }
        Some(Patch { cloud, ids, weights, center, half, radius, origin: center + origin / sum, normal: normal / length })
    }

    /// Height over the plane through the origin, a quadratic polynomial of two coordinates.
    fn bivariate(&self) -> Quadric {
        let Some(frame) = Plane::new(self.origin, self.normal) else {
            return plane(self.origin, self.normal, self.center);
        };
        let (t1, t2) = frame.basis();
        let mut a = SMatrix::<f64, 6, 6>::zeros();
        let mut b = SVector::<f64, 6>::zeros();
        let scale = 1.0 / self.radius;
        for (&i, &w) in self.ids.iter().zip(&self.weights) {
            let y = (self.cloud.points[i as usize] - self.origin) * scale;
            let (u, v, h) = (y.dot(&t1), y.dot(&t2), y.dot(&self.normal));
            let row = SVector::<f64, 6>::from([1.0, u, v, u * u, u * v, v * v]);
            a.syger(w * w, &row, &row, 1.0);
            b.axpy(w * w * h, &row, 1.0);
        }
        // The constant term's diagonal is Σw²; a light pull of the second-order terms to zero keeps sparse cells tame.
        let ridge = a[(0, 0)];
        for d in 0..6 {
            a[(d, d)] += ridge * if d < 3 { 1e-10 } else { 1e-4 };
        }
        a.fill_upper_triangle_with_lower_triangle();
        let Some(c) = a.cholesky().map(|c| c.solve(&b)) else {
            return plane(self.origin, self.normal, self.center);
        };
        // f = n·(x − o) − g(u, v), moved to the cell's centre.
        let (d1, d2) = (t1 * c[1] + t2 * c[2], (t1, t2));
        let linear = self.normal - d1;
        let uu = d2.0 * d2.0.transpose();
        let vv = d2.1 * d2.1.transpose();
        let uv = d2.0 * d2.1.transpose();
        let h = -(uu * (2.0 * c[3]) + (uv + uv.transpose()) * c[4] + vv * (2.0 * c[5])) * scale;
        shift(-c[0] * self.radius, linear, &h, self.center - self.origin)
    }

    /// Ten coefficients from the points (f = 0) and from auxiliary places whose distance to their nearest points is
    /// sure of its sign.
    fn general(&self) -> Option<Quadric> {
        let scale = 1.0 / self.radius;
        let mut a = SMatrix::<f64, 10, 10>::zeros();
        let mut b = SVector::<f64, 10>::zeros();
        let row = |p: &Point| {
            let y = (p - self.origin) * scale;
            SVector::<f64, 10>::from([1.0, y.x, y.y, y.z, y.x * y.x, y.y * y.y, y.z * y.z, y.x * y.y, y.x * y.z, y.y * y.z])
        };
        let total: f64 = self.weights.iter().sum();
        for (&i, &w) in self.ids.iter().zip(&self.weights) {
            a.syger((w / total).powi(2), &row(&self.cloud.points[i as usize]), &row(&self.cloud.points[i as usize]), 1.0);
        }
        // Rows are scaled as Ohtake's: points by w/Σw, auxiliary places by one over their number.
        let mut used = 0;
        let corners = (0..8).map(|c| Vector::new((c & 1) as f64, (c >> 1 & 1) as f64, (c >> 2) as f64) * 2.0 - Vector::repeat(1.0));
        for q in corners.map(|c| self.center + c * self.half).chain([self.center]) {
            let mut near: Vec<(f64, u32)> = self.ids.iter().map(|&i| ((self.cloud.points[i as usize] - q).norm_squared(), i)).collect();
            let six = near.len().min(6);
            near.select_nth_unstable_by(six - 1, |x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
            near[..six].sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
            let d = |i: u32| self.cloud.normals[i as usize].dot(&(q - self.cloud.points[i as usize]));
            let first = d(near[0].1);
            if near[..six].iter().any(|&(_, i)| d(i) * first <= 0.0) {
                continue;
            }
            let mean = near[..six].iter().map(|&(_, i)| d(i)).sum::<f64>() / six as f64;
            let r = row(&q);
            a.syger(1.0 / 81.0, &r, &r, 1.0);
            b.axpy(mean * scale / 81.0, &r, 1.0);
            used += 1;
        }
        if used == 0 {
            return None;
        }
        let ridge = 1e-10 * a.trace();
        for d in 0..10 {
            a[(d, d)] += ridge;
        }
        a.fill_upper_triangle_with_lower_triangle();
        let c = a.cholesky()?.solve(&b);
        let linear = Vector::new(c[1], c[2], c[3]);
        let h = nalgebra::Matrix3::new(2.0 * c[4], c[7], c[8], c[7], 2.0 * c[5], c[9], c[8], c[9], 2.0 * c[6]) * scale;
        Some(shift(c[0] * self.radius, linear, &h, self.center - self.origin))
    }
}

/// Moves c + l·y + yᵀHy/2 (y from one origin) to an origin `by` farther on.
fn shift(constant: f64, linear: Vector, h: &nalgebra::Matrix3<f64>, by: Vector) -> Quadric {
    let hb = h * by;
    Quadric {
        constant: constant + linear.dot(&by) + 0.5 * by.dot(&hb),
        linear: (linear + hb).into(),
        second: [h[(0, 0)], h[(1, 1)], h[(2, 2)], h[(0, 1)], h[(0, 2)], h[(1, 2)]],
    }
}
