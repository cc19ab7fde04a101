//! Components, tunnels and cavities of a mask.

use rayon::prelude::*;
use serde::Serialize;

use super::components::{Connectivity, label_data};
use super::Mask;

/// Betti numbers and Euler characteristic of the lumen: voxels are closed cubes (26-connected), the background is
/// 6-connected and goes on outside the array.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Topology {
    /// Connected components, b0.
    pub components: usize,
    /// Euler characteristic of the solid, χ = b0 − b1 + b2. A closed surface round it has 2 χ.
    pub euler: i64,
    /// Tunnels (independent loops), b1.
    pub tunnels: usize,
    /// Cavities, b2.
    pub cavities: usize,
}

/// Topology of the lumen. O(voxels), parallel.
pub fn topology(mask: &Mask) -> Topology {
    topology_of(&mask.data, mask.grid.dims)
}

pub(crate) fn topology_of(data: &[u8], dims: [usize; 3]) -> Topology {
    let components = label_data(data, dims, true, Connectivity::TwentySix).components().len();
    let background = label_data(data, dims, false, Connectivity::Six);
    let cavities = background.components().iter().filter(|c| !c.on_border).count();
    let euler = euler_of(data, dims);
    let tunnels = components as i64 + cavities as i64 - euler;
    Topology { components, euler, tunnels: usize::try_from(tunnels).unwrap_or(0), cavities }
}

/// χ by counting the vertices, edges, faces and cubes of the cubical complex, eighths of them at each lattice vertex.
pub(crate) fn euler_of(data: &[u8], dims: [usize; 3]) -> i64 {
    let table = eighths();
    let [nx, ny, nz] = dims;
    let empty = vec![0u8; nx];
    let row = |j: i64, k: i64| -> &[u8] {
        let inside = (0..ny as i64).contains(&j) && (0..nz as i64).contains(&k);
        if inside { &data[(k as usize * ny + j as usize) * nx..][..nx] } else { &empty }
    };
    let sum: i64 = (0..=nz as i64)
        .into_par_iter()
        .map(|k| {
            let mut sum = 0i64;
            for j in 0..=ny as i64 {
                let rows = [row(j - 1, k - 1), row(j, k - 1), row(j - 1, k), row(j, k)];
                // Bits 0..4: the four voxels to the left of the lattice vertex; bits 4..8: to the right.
                let mut code = 0usize;
                for x in 0..=nx {
                    code >>= 4;
                    if x < nx {
                        let [a, b, c, d] = rows.map(|r| usize::from(r[x]));
                        code |= (a | b << 1 | c << 2 | d << 3) << 4;
                    }
                    sum += i64::from(table[code]);
                }
            }
            sum
        })
        .sum();
    debug_assert_eq!(sum % 8, 0);
    sum / 8
}

/// Eight times the contribution of a lattice vertex to χ, by which of its eight voxels are lumen.
fn eighths() -> [i8; 256] {
    std::array::from_fn(|code| {
        let voxel = |v: usize| code >> v & 1 != 0;
        let any = |rule: &dyn Fn(usize) -> bool| (0..8).any(|v| rule(v) && voxel(v));
        if code == 0 {
            return 0;
        }
        let mut sum = 8i8;
        for axis in 0..3 {
            for side in 0..2 {
                // An edge leaves the vertex along `axis`: two vertices share it.
                sum -= 4 * i8::from(any(&|v| v >> axis & 1 == side));
                for other in axis + 1..3 {
                    for far in 0..2 {
                        // A face spans two axes: four vertices share it.
                        sum += 2 * i8::from(any(&|v| v >> axis & 1 == side && v >> other & 1 == far));
                    }
                }
            }
        }
        sum - code.count_ones() as i8
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::Grid;

    fn of(dims: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> Topology {
        let grid = Grid::new(dims, [1.0; 3], Point::origin(), Matrix3::identity()).expect("grid");
        let data = (0..grid.len()).map(|n| u8::from(rule(grid.voxel(n)))).collect();
        topology(&Mask::new(grid, data))
    }

    #[test]
    fn balls_rings_and_shells_have_their_known_numbers() {
        let ball = of([5, 5, 5], |v| v.iter().all(|i| (1..4).contains(i)));
        assert_eq!(ball, Topology { components: 1, euler: 1, tunnels: 0, cavities: 0 });
        let shell = of([5, 5, 5], |v| v != [2, 2, 2] && v.iter().all(|i| (1..4).contains(i)));
        assert_eq!(shell, Topology { components: 1, euler: 2, tunnels: 0, cavities: 1 });
        let ring = of([5, 5, 3], |[i, j, k]| k == 1 && (1..4).contains(&i) && (1..4).contains(&j) && [i, j] != [2, 2]);
        assert_eq!(ring, Topology { components: 1, euler: 0, tunnels: 1, cavities: 0 });
        let full = of([3, 3, 3], |_| true);
        assert_eq!(full, Topology { components: 1, euler: 1, tunnels: 0, cavities: 0 });
    }

    #[test]
    fn voxels_that_touch_at_a_corner_are_connected_and_the_gap_is_open() {
        let pair = of([4, 4, 4], |v| v == [1, 1, 1] || v == [2, 2, 2]);
        assert_eq!(pair, Topology { components: 1, euler: 1, tunnels: 0, cavities: 0 });
        // A diagonal ring of four voxels that touch at edges only.
        let ring = of([5, 5, 3], |[i, j, k]| k == 1 && (i.abs_diff(2) + j.abs_diff(2) == 1));
        assert_eq!(ring, Topology { components: 1, euler: 0, tunnels: 1, cavities: 0 });
    }
}
