//! Whether a mask can be a vessel's lumen by its size: in millimetres, and in voxels.

use rayon::prelude::*;

use super::Mask;

/// Fewest voxels that are looked at: less is no vessel whatever its shape.
const FEWEST: usize = 27;

/// Faces of voxels are larger than the wall that they stand for: 1.5 times for a wall that faces every way.
const STAIRS: f64 = 1.5;

impl Mask {
    /// Whether a voxel has lumen on all sides, six neighbours, beyond the picture's border too: else the lumen is
    /// nowhere more than two voxels thick.
    pub fn has_inside(&self) -> bool {
        self.count() < FEWEST || (0..self.data.len()).into_par_iter().any(|n| self.data[n] != 0 && self.sides(n).into_iter().all(|s| s != Some(false)))
    }

    /// Mean diameter, mm: four times the volume by the area of the wall. Infinite without a wall.
    pub fn mean_diameter(&self) -> f64 {
        let s = self.grid.spacing();
        let face = [s[1] * s[2], s[0] * s[2], s[0] * s[1]];
        let walls = |n: usize| self.sides(n).into_iter().enumerate().filter(|(_, s)| *s == Some(false)).map(|(i, _)| face[i / 2]).sum::<f64>();
        let area: f64 = (0..self.data.len()).filter(|&n| self.data[n] != 0).map(walls).sum();
        4.0 * self.volume() * STAIRS / area
    }

    /// Whether each of the six neighbours is lumen, by axes; `None` beyond the picture.
    fn sides(&self, n: usize) -> [Option<bool>; 6] {
        let [nx, ny, _] = self.grid.dims;
        let (index, steps) = (self.grid.voxel(n), [1, nx, nx * ny]);
        std::array::from_fn(|i| {
            let (a, up) = (i / 2, i % 2 == 1);
            let there = if up { index[a] + 1 < self.grid.dims[a] } else { index[a] > 0 };
            there.then(|| self.data[if up { n + steps[a] } else { n - steps[a] }] != 0)
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::Grid;

    fn tube(spacing: f64, lumen: impl Fn(f64) -> bool) -> Mask {
        let grid = Grid::new([24, 24, 40], [spacing; 3], Point::origin(), Matrix3::identity()).expect("grid");
        let off = |n: usize| {
            let i = grid.voxel(n).map(|i| i as f64 - 11.5);
            i[0].hypot(i[1])
        };
        let data = (0..grid.len()).map(|n| u8::from(lumen(off(n)))).collect();
        Mask::new(grid, data)
    }

    #[test]
    fn the_mean_diameter_is_that_of_the_tube_in_mm() {
        let d = tube(0.5, |r| r < 8.0).mean_diameter();
        assert!((d / 8.0 - 1.0).abs() < 0.25, "{d}");
    }

    #[test]
    fn a_wall_of_one_voxel_and_a_vessel_of_two_have_no_inside() {
        assert!(!tube(0.5, |r| (7.0..8.0).contains(&r)).has_inside());
        assert!(!tube(0.5, |r| r < 1.0).has_inside());
        assert!(tube(0.5, |r| r < 3.0).has_inside());
    }
}
