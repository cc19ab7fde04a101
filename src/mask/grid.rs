//! The affine grid that places voxels in the world.

use nalgebra::Matrix3;

use crate::geometry::{Point, Vector};

/// Why a grid cannot carry an image.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// An axis has no voxels or too many.
    #[error("the image has dimensions {0:?}; every axis needs at least one voxel and the product must fit in memory")]
    Dimensions([usize; 3]),
    /// Spacing is zero, negative, infinite or not a number.
    #[error("the voxel spacing is {0:?} mm; every axis needs a finite spacing above zero: set it in the file's header")]
    Spacing([f64; 3]),
    /// The direction matrix is singular or sheared.
    #[error("the direction matrix {0:?} is not a rotation or reflection (columns must be unit vectors square to each other within 1e-3): resample the image to an orthogonal grid")]
    Direction([[f64; 3]; 3]),
    /// The origin is infinite or not a number.
    #[error("the origin {0:?} is not finite: correct the file's header")]
    Origin([f64; 3]),
}

/// Voxel (i, j, k) has its centre at `origin + axes · (i, j, k)`, in LPS millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Number of voxels along each axis.
    pub dims: [usize; 3],
    /// World position of the centre of voxel (0, 0, 0).
    pub origin: Point,
    /// Columns: the step from one voxel to the next along each axis. May be left-handed.
    pub axes: Matrix3<f64>,
    inverse: Matrix3<f64>,
}

impl Grid {
    /// A grid from the header's own numbers. `direction` has one unit column per axis.
    pub fn new(dims: [usize; 3], spacing: [f64; 3], origin: Point, direction: Matrix3<f64>) -> Result<Grid, GridError> {
        let total = dims.iter().try_fold(1usize, |a, &n| a.checked_mul(n));
        if dims.contains(&0) || total.is_none_or(|n| n > isize::MAX as usize / 16) {
            return Err(GridError::Dimensions(dims));
        }
        if spacing.iter().any(|s| !s.is_finite() || *s <= 0.0) {
            return Err(GridError::Spacing(spacing));
        }
        if !origin.coords.iter().all(|c| c.is_finite()) {
            return Err(GridError::Origin(origin.into()));
        }
        let gram = direction.transpose() * direction - Matrix3::identity();
        if !gram.iter().all(|g| g.abs() < 1e-3) {
            return Err(GridError::Direction(direction.into()));
        }
        let axes = direction * Matrix3::from_diagonal(&Vector::from(spacing));
        let inverse = axes.try_inverse().ok_or(GridError::Direction(direction.into()))?;
        Ok(Grid { dims, origin, axes, inverse })
    }

    /// Edge lengths of a voxel, mm.
    pub fn spacing(&self) -> [f64; 3] {
        [0, 1, 2].map(|a| self.axes.column(a).norm())
    }

    /// Length of the space diagonal of a voxel, mm: the unit of the fidelity figures.
    pub fn voxel_diagonal(&self) -> f64 {
        self.spacing().iter().map(|s| s * s).sum::<f64>().sqrt()
    }

    /// Volume of a voxel, mm³.
    pub fn voxel_volume(&self) -> f64 {
        self.axes.determinant().abs()
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.dims.iter().product()
    }

    /// Whether there are no voxels; never so for a grid made by [`Grid::new`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Offset of voxel (i, j, k) in an array with x fastest, `None` outside.
    pub fn linear(&self, i: i64, j: i64, k: i64) -> Option<usize> {
        let [nx, ny, nz] = self.dims.map(|n| n as i64);
        let inside = (0..nx).contains(&i) && (0..ny).contains(&j) && (0..nz).contains(&k);
        inside.then(|| (i + nx * (j + ny * k)) as usize)
    }

    /// The voxel at an offset.
    pub fn voxel(&self, n: usize) -> [usize; 3] {
        let [nx, ny, _] = self.dims;
        [n % nx, n / nx % ny, n / (nx * ny)]
    }

    /// World position of a continuous index.
    pub fn to_world(&self, index: Vector) -> Point {
        self.origin + self.axes * index
    }

    /// Continuous index of a world position.
    pub fn to_index(&self, p: &Point) -> Vector {
        self.inverse * (p - self.origin)
    }

    /// Carries a gradient taken with respect to the index over to the world.
    pub fn gradient_to_world(&self, g: &Vector) -> Vector {
        self.inverse.transpose() * g
    }

    /// Whether the axes form a left-handed system.
    pub fn is_left_handed(&self) -> bool {
        self.axes.determinant() < 0.0
    }

    /// The same lattice seen through another window: `low` becomes voxel (0, 0, 0).
    #[must_use]
    pub fn window(&self, low: [i64; 3], dims: [usize; 3]) -> Grid {
        let origin = self.to_world(Vector::new(low[0] as f64, low[1] as f64, low[2] as f64));
        Grid { dims, origin, axes: self.axes, inverse: self.inverse }
    }

    /// The same grid with every length multiplied by `factor`, which must be finite and above zero: a change of unit.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Grid {
        Grid {
            dims: self.dims,
            origin: Point::from(self.origin.coords * factor),
            axes: self.axes * factor,
            inverse: self.inverse / factor,
        }
    }

    /// Unit columns: the directions of the axes in the world.
    pub fn direction(&self) -> Matrix3<f64> {
        let s = self.spacing();
        Matrix3::from_fn(|r, c| self.axes[(r, c)] / s[c])
    }
}
