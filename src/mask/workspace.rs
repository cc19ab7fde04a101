//! The lumen's bounding box with background all round, in which cleaning works.

use super::{Mask, crop};
use crate::geometry::{Point, Vector};

/// A window on a mask with two layers of background or more on every side.
#[derive(Debug, Clone)]
pub(super) struct Workspace {
    pub(super) data: Vec<u8>,
    pub(super) dims: [usize; 3],
    /// Index of the window's first voxel in the mask.
    low: [i64; 3],
    /// First and last index, in the window, of the voxels that the mask has.
    allowed: [[i64; 2]; 3],
}

/// Layers kept free round the lumen: one for what dilation adds, one for neighbourhoods.
const MARGIN: i64 = 3;

impl Workspace {
    /// `None` for an empty mask.
    pub(super) fn new(mask: &Mask) -> Option<Workspace> {
        let found = crop::lumen_box(mask)?;
        let low = found.map(|b| b[0] as i64 - MARGIN);
        let dims = found.map(|b| b[1] - b[0] + 1 + 2 * MARGIN as usize);
        let data = crop::window(mask, low, dims).data;
        let allowed = [0, 1, 2].map(|a| [-low[a], mask.grid.dims[a] as i64 - 1 - low[a]]);
        Some(Workspace { data, dims, low, allowed })
    }

    pub(super) fn index(&self, n: usize) -> [i64; 3] {
        let [nx, ny, _] = self.dims;
        [n % nx, n / nx % ny, n / (nx * ny)].map(|i| i as i64)
    }

    /// Whether a voxel belongs to the mask's array and has a neighbour on every side in the window.
    pub(super) fn may_fill(&self, n: usize) -> bool {
        let v = self.index(n);
        (0..3).all(|a| {
            let [low, high] = self.allowed[a];
            (low.max(1)..=high.min(self.dims[a] as i64 - 2)).contains(&v[a])
        })
    }

    /// Whether the first (0) or last (1) plane of the picture along an axis lies in the window; its index.
    pub(super) fn border_plane(&self, axis: usize, side: usize) -> Option<usize> {
        let at = self.allowed[axis][side];
        (0..self.dims[axis] as i64).contains(&at).then_some(at as usize)
    }

    /// World position of the mean of some voxels of the window.
    pub(super) fn center(&self, mask: &Mask, voxels: impl IntoIterator<Item = usize>) -> Point {
        let (mut sum, mut n) = (Vector::zeros(), 0.0);
        for v in voxels {
            let i = self.index(v);
            sum += Vector::new((i[0] + self.low[0]) as f64, (i[1] + self.low[1]) as f64, (i[2] + self.low[2]) as f64);
            n += 1.0;
        }
        mask.grid.to_world(sum / f64::max(n, 1.0))
    }

    /// A mask like `mask` with the window's voxels in place of its own.
    pub(super) fn write_back(&self, mask: &Mask) -> Mask {
        let inner = Mask { grid: mask.grid.window(self.low, self.dims), data: self.data.clone(), image: mask.image };
        let mut out = crop::window(&inner, self.low.map(|l| -l), mask.grid.dims);
        out.grid = mask.grid.clone();
        out.image = mask.image;
        out
    }
}
