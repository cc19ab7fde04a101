//! Which voxels lie near some few given ones.

/// The voxels within some steps of given ones, so many along each axis: a byte for each in the box of them all.
pub(super) struct Neighbourhood {
    low: [i16; 3],
    dims: [usize; 3],
    inside: Vec<bool>,
}

impl Neighbourhood {
    pub fn of(voxels: &[[i16; 3]], reach: [i32; 3]) -> Neighbourhood {
        let reach = reach.map(|r| r as i16);
        let low: [i16; 3] = std::array::from_fn(|a| voxels.iter().map(|v| v[a]).min().unwrap_or(0) - reach[a]);
        let high: [i16; 3] = std::array::from_fn(|a| voxels.iter().map(|v| v[a]).max().unwrap_or(0) + reach[a]);
        let dims: [usize; 3] = std::array::from_fn(|a| (high[a] - low[a] + 1) as usize);
        let mut inside = vec![false; dims.iter().product()];
        for v in voxels {
            let [x, y, z]: [std::ops::RangeInclusive<usize>; 3] =
                std::array::from_fn(|a| (v[a] - reach[a] - low[a]) as usize..=(v[a] + reach[a] - low[a]) as usize);
            for k in z {
                for j in y.clone() {
                    inside[dims[0] * (j + dims[1] * k)..][x.clone()].fill(true);
                }
            }
        }
        Neighbourhood { low, dims, inside }
    }

    /// Whether one of the given voxels lies within reach of `v`.
    #[inline]
    pub fn holds(&self, v: [i16; 3]) -> bool {
        let at: [i32; 3] = std::array::from_fn(|a| i32::from(v[a]) - i32::from(self.low[a]));
        let there = (0..3).all(|a| at[a] >= 0 && (at[a] as usize) < self.dims[a]);
        there && self.inside[at[0] as usize + self.dims[0] * (at[1] as usize + self.dims[1] * at[2] as usize)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exactly_the_voxels_within_reach_are_near() {
        let given = [[0, 3, 5], [17, 9, 2], [-1, 20, 20]];
        let n = Neighbourhood::of(&given, [3, 3, 1]);
        for k in -3..25 {
            for j in -3..24 {
                for i in -3..23 {
                    let near = given.iter().any(|g| (i - g[0]).abs() <= 3 && (j - g[1]).abs() <= 3 && (k - g[2]).abs() <= 1);
                    assert_eq!(n.holds([i, j, k]), near, "{i} {j} {k}");
                }
            }
        }
    }
}
