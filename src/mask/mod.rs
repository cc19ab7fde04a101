//! Binary masks on an affine voxel grid.

mod boundary;
mod clean;
mod components;
mod contacts;
mod content;
mod crop;
mod distance;
mod error;
mod grid;
mod image;
mod interface;
mod morphology;
pub(crate) mod neighborhood;
pub(crate) mod noise;
mod select;
mod size;
mod thickness;
pub(crate) mod topology;
mod tunnels;
mod workspace;

pub use boundary::BoundaryDistance;
pub use clean::{Change, ChangeKind, CleaningOptions, CleaningReport, Components, Total, clean};
pub use components::{Component, Connectivity, Labels, label};
pub use content::{Content, content};
pub use crop::{crop_pad, crop_pad_where, lumen_box, split_components};
pub use distance::{signed_distance, squared_distance_to};
pub use error::Error;
pub use grid::{Grid, GridError};
pub use image::{Image, LengthUnit, Segment, Values};
pub(crate) use image::{Scalar, with_values};
pub use interface::interface;
pub use morphology::{dilation, erosion, inverse_top_hat, opening, top_hat};
pub use select::{LabelKey, Selection, inventory, select};
pub use thickness::local_radius;
pub use topology::{Topology, topology};

/// A binary image: 1 is lumen, 0 is background; x runs fastest.
///
/// `image` is the index box of the picture that was read, in this mask's own indices, inclusive:
/// cropping and padding change `grid` and `data`, and `image` still tells where the picture's border is.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// Where the voxels lie.
    pub grid: Grid,
    /// One byte a voxel, 0 or 1.
    pub data: Vec<u8>,
    /// First and last index of the original picture along each axis.
    pub image: [[i64; 2]; 3],
}

impl Mask {
    /// A mask over the whole of `grid`. `data.len()` must be `grid.len()`.
    pub fn new(grid: Grid, data: Vec<u8>) -> Mask {
        assert_eq!(data.len(), grid.len(), "one byte a voxel");
        let image = grid.dims.map(|n| [0, n as i64 - 1]);
        Mask { grid, data, image }
    }

    /// Value at an index; background outside.
    pub fn at(&self, i: i64, j: i64, k: i64) -> bool {
        self.grid.linear(i, j, k).is_some_and(|n| self.data[n] != 0)
    }

    /// Number of lumen voxels.
    pub fn count(&self) -> usize {
        self.data.iter().filter(|&&v| v != 0).count()
    }

    /// Volume of the lumen voxels, mm³.
    pub fn volume(&self) -> f64 {
        self.count() as f64 * self.grid.voxel_volume()
    }
}
