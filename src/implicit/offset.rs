//! A surface moved along its normal.

use super::Implicit;
use crate::geometry::{Aabb, Point, Vector};

/// `inner` with its wall moved outwards by a distance, so that remeshing projects onto the same level as polygonizing.
#[derive(Debug, Clone)]
pub struct Offset<I> {
    inner: I,
    /// Outward distance, mm.
    distance: f64,
}

impl<I: Implicit> Offset<I> {
    /// The level `distance` mm outside the wall of `inner`; negative is inwards.
    pub fn new(inner: I, distance: f64) -> Offset<I> {
        Offset { inner, distance }
    }
}

impl<I: Implicit> Implicit for Offset<I> {
    fn value(&self, p: &Point) -> f64 {
        self.inner.value(p) - self.distance
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let (f, g) = self.inner.value_gradient(p);
        (f - self.distance, g)
    }

    fn bounds(&self) -> Aabb {
        self.inner.bounds().inflated(self.distance.max(0.0))
    }

    fn resolution(&self) -> f64 {
        self.inner.resolution()
    }
}
