//! The Gaussian-smoothed mask with its derivatives, at any place.

use nalgebra::Matrix3;

use super::lattice::Lattice;
use crate::geometry::Vector;

/// The lattice's labels seen through a Gaussian: 1 deep inside the lumen, 0 far outside, about 0.5 on the wall.
pub(super) struct Smoothed<'a> {
    lattice: &'a Lattice,
}

/// Value and derivatives with respect to world coordinates.
pub(super) struct Jet {
    pub value: f64,
    pub gradient: Vector,
    pub hessian: Matrix3<f64>,
}

/// Weights of one axis with first and second derivative, normalised to sum 1, 0, 0.
struct AxisWeights {
    first: i64,
    w: [[f64; 3]; 24],
    len: usize,
}

impl AxisWeights {
    fn new(x: f64, sigma: f64) -> AxisWeights {
        let reach = (3.0 * sigma).min(11.0);
        let first = (x - reach).ceil() as i64;
        let len = ((x + reach).floor() as i64 - first + 1).clamp(1, 24) as usize;
        let mut w = [[0.0; 3]; 24];
        let mut sum = [0.0; 3];
        for (n, w) in w[..len].iter_mut().enumerate() {
            let u = ((first + n as i64) as f64 - x) / sigma;
            let g = (-0.5 * u * u).exp();
            *w = [g, g * u / sigma, g * (u * u - 1.0) / (sigma * sigma)];
            (0..3).for_each(|d| sum[d] += w[d]);
        }
        // Quotient rule: the weights are g / Σg, and so are their derivatives.
        let (s, s1, s2) = (sum[0], sum[1] / sum[0], sum[2] / sum[0]);
        for w in &mut w[..len] {
            let [g, g1, g2] = w.map(|v| v / s);
            *w = [g, g1 - g * s1, g2 - 2.0 * s1 * g1 + g * (2.0 * s1 * s1 - s2)];
        }
        AxisWeights { first, w, len }
    }
}

impl<'a> Smoothed<'a> {
    pub fn new(lattice: &'a Lattice) -> Self {
        Smoothed { lattice }
    }

    /// Jet at continuous lattice index `x` with standard deviations `sigma`, voxels along each axis.
    pub fn jet(&self, x: &Vector, sigma: &Vector) -> Jet {
        let axes = [0, 1, 2].map(|a| AxisWeights::new(x[a], sigma[a]));
        let [ax, ay, az] = &axes;
        let grid = &self.lattice.grid;
        let [nx, ny, nz] = grid.dims.map(|n| n as i64);
        let mut f = 0.0;
        let mut g = Vector::zeros();
        let mut h = Matrix3::zeros();
        for kz in 0..az.len {
            let k = az.first + kz as i64;
            if !(0..nz).contains(&k) {
                continue;
            }
            let [z0, z1, z2] = az.w[kz];
            for ky in 0..ay.len {
                let j = ay.first + ky as i64;
                if !(0..ny).contains(&j) {
                    continue;
                }
                let row = nx * (j + ny * k);
                let (mut r0, mut r1, mut r2) = (0.0, 0.0, 0.0);
                for kx in 0..ax.len {
                    let i = ax.first + kx as i64;
                    if (0..nx).contains(&i) && self.lattice.label((row + i) as usize) != 0 {
                        r0 += ax.w[kx][0];
                        r1 += ax.w[kx][1];
                        r2 += ax.w[kx][2];
                    }
                }
                let [y0, y1, y2] = ay.w[ky];
                f += r0 * y0 * z0;
                g += Vector::new(r1 * y0 * z0, r0 * y1 * z0, r0 * y0 * z1);
                h[(0, 0)] += r2 * y0 * z0;
                h[(1, 1)] += r0 * y2 * z0;
                h[(2, 2)] += r0 * y0 * z2;
                h[(0, 1)] += r1 * y1 * z0;
                h[(0, 2)] += r1 * y0 * z1;
                h[(1, 2)] += r0 * y1 * z1;
            }
        }
        h[(1, 0)] = h[(0, 1)];
        h[(2, 0)] = h[(0, 2)];
        h[(2, 1)] = h[(1, 2)];
        let columns = |m: &Matrix3<f64>| Matrix3::from_columns(&[0, 1, 2].map(|a| grid.gradient_to_world(&m.column(a).into())));
        let hessian = columns(&columns(&h).transpose());
        Jet { value: f, gradient: grid.gradient_to_world(&g), hessian }
    }
}
