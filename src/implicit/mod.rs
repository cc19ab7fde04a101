//! Implicit vessel surfaces: negative inside, zero on the wall, positive outside.

pub mod guard;
pub mod mended;
pub mod mpu;
pub mod offset;
pub mod smooth;
pub mod probability;

use nalgebra::Matrix3;

use crate::geometry::{Aabb, Point, Vector};

/// A function whose zero set is the vessel wall.
///
/// Values are in millimetres and close to a signed distance near the wall; far away only the sign is promised.
pub trait Implicit: Sync {
    /// Value at `p`: negative inside the lumen.
    fn value(&self, p: &Point) -> f64;

    /// Values at some points, as [`Implicit::value`] has them.
    fn values(&self, points: &[Point], out: &mut [f64]) {
        out.iter_mut().zip(points).for_each(|(v, p)| *v = self.value(p));
    }

    /// Value and gradient at `p`.
    fn value_gradient(&self, p: &Point) -> (f64, Vector);

    /// Box outside which the function is positive.
    fn bounds(&self) -> Aabb;

    /// Length over which the function changes its shape at most: about half a voxel. Step of numerical derivatives.
    fn resolution(&self) -> f64;

    /// Gradient at `p`; points out of the lumen near the wall.
    fn gradient(&self, p: &Point) -> Vector {
        self.value_gradient(p).1
    }

    /// Values at the lattice points `origin + steps·c`, c running through `size` numbers from `low` on along each axis, x
    /// fastest. `false`, and `out` as it was, where there is no faster way than point by point.
    ///
    /// Whether there is depends on the lattice alone, and a point's value not on `low` or `size`.
    fn values_on(&self, _origin: &Point, _steps: &Matrix3<f64>, _low: [i32; 3], _size: usize, _out: &mut [f64]) -> bool {
        false
    }

    /// Second derivatives; central differences of the gradient unless the function knows better.
    fn hessian(&self, p: &Point) -> Matrix3<f64> {
        let h = 0.5 * self.resolution();
        let mut m = Matrix3::zeros();
        for a in 0..3 {
            let mut e = Vector::zeros();
            e[a] = h;
            let d = (self.gradient(&(p + e)) - self.gradient(&(p - e))) / (2.0 * h);
            m.set_column(a, &d);
        }
        0.5 * (m + m.transpose())
    }
}

impl<I: Implicit + ?Sized> Implicit for &I {
    fn value(&self, p: &Point) -> f64 {
        (**self).value(p)
    }

    fn values(&self, points: &[Point], out: &mut [f64]) {
        (**self).values(points, out);
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        (**self).value_gradient(p)
    }

    fn bounds(&self) -> Aabb {
        (**self).bounds()
    }

    fn resolution(&self) -> f64 {
        (**self).resolution()
    }

    fn values_on(&self, origin: &Point, steps: &Matrix3<f64>, low: [i32; 3], size: usize, out: &mut [f64]) -> bool {
        (**self).values_on(origin, steps, low, size, out)
    }

    fn hessian(&self, p: &Point) -> Matrix3<f64> {
        (**self).hessian(p)
    }
}

impl<I: Implicit + ?Sized> Implicit for Box<I> {
    fn value(&self, p: &Point) -> f64 {
        (**self).value(p)
    }

    fn values(&self, points: &[Point], out: &mut [f64]) {
        (**self).values(points, out);
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        (**self).value_gradient(p)
    }

    fn bounds(&self) -> Aabb {
        (**self).bounds()
    }

    fn resolution(&self) -> f64 {
        (**self).resolution()
    }

    fn values_on(&self, origin: &Point, steps: &Matrix3<f64>, low: [i32; 3], size: usize, out: &mut [f64]) -> bool {
        (**self).values_on(origin, steps, low, size, out)
    }

    fn hessian(&self, p: &Point) -> Matrix3<f64> {
        (**self).hessian(p)
    }
}
