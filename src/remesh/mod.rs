//! Surface remeshing on the implicit under a guidance field.

use crate::geometry::Point;

/// Wished edge length over space: the guidance field.
pub trait SizeField: Sync {
    /// Wished edge length at `p`, mm; positive everywhere and Lipschitz.
    fn size(&self, p: &Point) -> f64;
}

/// The same edge length everywhere.
#[derive(Debug, Clone, Copy)]
pub struct Uniform(pub f64);

impl SizeField for Uniform {
    fn size(&self, _: &Point) -> f64 {
        self.0
    }
}
