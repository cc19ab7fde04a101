//! Which voxels lie near some few given ones.

/// Edge of a bucket, voxels.
const SIDE: i32 = 8;
/// Voxels beyond the array that are looked after.
const RIM: i32 = 8;

/// The voxels within some steps of given ones, so many along each axis.
pub(super) struct Neighbourhood {
    reach: [i32; 3],
    dims: [i32; 3],
    /// First of the voxels in each bucket; one more at the end.
    first: Vec<u32>,
    voxels: Vec<[i16; 3]>,
    /// Whether anything in a bucket may be near.
    warm: Vec<bool>,
}

impl Neighbourhood {
    /// `size`: of the array that the voxels belong to.
    pub fn of(size: [usize; 3], voxels: &[[i16; 3]], reach: [i32; 3]) -> Neighbourhood {
        let dims = size.map(|n| (n as i32 + 2 * RIM) / SIDE + 1);
        let count: usize = dims.iter().map(|&n| n as usize).product();
        let mut out = Neighbourhood { reach, dims, first: vec![0; count + 1], voxels: Vec::new(), warm: vec![false; count] };
        let mut sorted: Vec<(usize, [i16; 3])> = voxels.iter().map(|&v| (out.bucket(v.map(i32::from)), v)).collect();
        sorted.sort_unstable();
        sorted.dedup();
        for (b, v) in sorted {
            out.first[b + 1] += 1;
            out.voxels.push(v);
            out.buckets(v).for_each(|b| out.warm[b] = true);
        }
        for b in 0..count {
            out.first[b + 1] += out.first[b];
        }
        out
    }

    fn bucket(&self, v: [i32; 3]) -> usize {
        let b: [usize; 3] = std::array::from_fn(|a| ((v[a] + RIM) / SIDE).clamp(0, self.dims[a] - 1) as usize);
        b[0] + self.dims[0] as usize * (b[1] + self.dims[1] as usize * b[2])
    }

    /// The buckets that the box round `v` meets.
    fn buckets(&self, v: [i16; 3]) -> impl Iterator<Item = usize> + use<> {
        let (reach, dims) = (self.reach, self.dims);
        let range = move |a: usize| {
            let at = |d: i32| ((i32::from(v[a]) + d + RIM) / SIDE).clamp(0, dims[a] - 1);
            at(-reach[a])..=at(reach[a])
        };
        let row = move |z: i32, y: i32| range(0).map(move |x| (x + dims[0] * (y + dims[1] * z)) as usize);
        range(2).flat_map(move |z| range(1).flat_map(move |y| row(z, y)))
    }

    /// Whether one of the given voxels lies within reach of `v`.
    pub fn holds(&self, v: [i16; 3]) -> bool {
        if !self.warm[self.bucket(v.map(i32::from))] {
            return false;
        }
        let near = |w: &[i16; 3]| (0..3).all(|a| (i32::from(w[a]) - i32::from(v[a])).abs() <= self.reach[a]);
        self.buckets(v).any(|b| self.voxels[self.first[b] as usize..self.first[b + 1] as usize].iter().any(near))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exactly_the_voxels_within_reach_are_near() {
        let given = [[0, 3, 5], [17, 9, 2], [-1, 20, 20]];
        let n = Neighbourhood::of([20, 21, 22], &given, [3, 3, 1]);
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
