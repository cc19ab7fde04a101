//! The lattice on which the polygonizer samples, and the cells it starts from.

use nalgebra::Matrix3;

use crate::geometry::{Point, Vector};
use crate::mask::{Grid, Mask, interface};

/// A lattice of boxes in any orientation, left-handed ones included.
#[derive(Debug, Clone, PartialEq)]
pub struct Lattice {
    origin: Point,
    /// Columns: the three edges of a cell.
    axes: Matrix3<f64>,
    inverse: Matrix3<f64>,
    /// Lengths of these edges, mm.
    edges: [f64; 3],
}

impl Lattice {
    /// Cubes of edge `cell` mm along the world axes; `origin` is a corner.
    pub fn axis_aligned(origin: Point, cell: f64) -> Lattice {
        Lattice { origin, axes: Matrix3::identity() * cell, inverse: Matrix3::identity() / cell, edges: [cell; 3] }
    }

    /// Boxes along the axes of `grid`; the centre of voxel (0, 0, 0) is a corner.
    ///
    /// Their edges are `cell` times the voxel's, but none is longer than `stretch` times the shortest: 1 makes cubes.
    pub fn along(grid: &Grid, cell: f64, stretch: f64) -> Lattice {
        let s = grid.spacing();
        let longest = stretch * s[0].min(s[1]).min(s[2]);
        let edges = s.map(|s| cell * s.min(longest));
        let scale = Matrix3::from_diagonal(&Vector::new(edges[0] / s[0], edges[1] / s[1], edges[2] / s[2]));
        let axes = grid.axes * scale;
        // A grid's axes are orthogonal to within 1e-3, so this inverse always exists.
        let inverse = axes.try_inverse().unwrap_or_else(|| {
            let squares = edges.map(|h| h * h);
            Matrix3::from_diagonal(&Vector::from(squares.map(f64::recip))) * axes.transpose()
        });
        Lattice { origin: grid.origin, axes, inverse, edges }
    }

    /// Shortest edge of a cell, mm.
    pub fn cell(&self) -> f64 {
        self.edges[0].min(self.edges[1]).min(self.edges[2])
    }

    /// Longest edge of a cell, mm.
    pub(super) fn longest(&self) -> f64 {
        self.edges[0].max(self.edges[1]).max(self.edges[2])
    }

    /// Position of a lattice corner.
    pub fn corner(&self, c: [i32; 3]) -> Point {
        self.origin + self.axes * Vector::new(c[0] as f64, c[1] as f64, c[2] as f64)
    }

    /// The cell that contains `p`, named by its lowest corner.
    pub fn cell_of(&self, p: &Point) -> [i32; 3] {
        let v = self.inverse * (p - self.origin);
        [0, 1, 2].map(|a| v[a].floor() as i32)
    }

    /// Corner (0, 0, 0), and the edges of a cell as columns.
    pub fn frame(&self) -> (&Point, &Matrix3<f64>) {
        (&self.origin, &self.axes)
    }

    /// Whether the edges form a left-handed system.
    pub fn is_left_handed(&self) -> bool {
        self.axes.determinant() < 0.0
    }
}

/// The cells that meet a voxel with a face neighbour of the other label; beyond the mask lies background.
pub(super) fn boundary_cells(mask: &Mask, lattice: &Lattice) -> impl Iterator<Item = [i32; 3]> {
    let s = mask.grid.spacing();
    let per_voxel: [f64; 3] = std::array::from_fn(|a| s[a] / lattice.edges[a]);
    let range = move |a: usize, i: i32| {
        let (lo, hi) = ((f64::from(i) - 0.5) * per_voxel[a], (f64::from(i) + 0.5) * per_voxel[a]);
        lo.floor() as i32..hi.ceil() as i32
    };
    interface(mask).into_iter().flat_map(move |(v, _)| {
        let (x, y, z) = (range(0, v[0]), range(1, v[1]), range(2, v[2]));
        z.flat_map(move |k| {
            let x = x.clone();
            y.clone().flat_map(move |j| x.clone().map(move |i| [i, j, k]))
        })
    })
}
