//! The voxels of a mask as the skeleton needs them: compact, padded, with distances to the wall.

use rayon::prelude::*;

use crate::geometry::{Point, Vector};
use crate::mask::{Connectivity, Grid, Mask, label};

pub(super) const NONE: u32 = u32::MAX;

/// Lumen voxels numbered in memory order inside a window that leaves two layers of background on every side.
pub(super) struct Field {
    pub grid: Grid,
    /// Lumen number of each voxel of the window, or `NONE`.
    pub id: Vec<u32>,
    /// Voxel of each lumen number.
    pub voxel: Vec<u32>,
    /// Distance to the nearest background voxel's centre, mm; by lumen number.
    pub distance: Vec<f32>,
    /// Connected component (26 neighbours) by lumen number: 0 is the largest, ties by first voxel.
    pub component: Vec<u32>,
    pub components: usize,
    /// Offsets to the 26 neighbours, in the order of `thin::STEPS`, and their lengths in mm.
    pub offsets: [i64; 26],
    pub lengths: [f64; 26],
    /// Smallest voxel edge, mm.
    pub voxel_size: f64,
    /// Squared edges over three: variance of the cubic B-spline along each axis, mm².
    axis_variance: [(Vector, f64); 3],
    /// Cavities filled for the skeleton's sake.
    pub filled: usize,
}

impl Field {
    /// `None` for an empty mask.
    pub fn new(mask: &Mask) -> Option<Field> {
        let [nx, ny, _] = mask.grid.dims;
        let mut low = [usize::MAX; 3];
        let mut high = [0usize; 3];
        for (row, line) in mask.data.chunks_exact(nx).enumerate() {
            let Some(first) = line.iter().position(|&v| v != 0) else { continue };
            let last = line.iter().rposition(|&v| v != 0).unwrap_or(first);
            for (a, (l, h)) in [(first, last), (row % ny, row % ny), (row / ny, row / ny)].into_iter().enumerate() {
                low[a] = low[a].min(l);
                high[a] = high[a].max(h);
            }
        }
        if low[0] == usize::MAX {
            return None;
        }
        let dims = [0, 1, 2].map(|a| high[a] - low[a] + 5);
        let grid = mask.grid.window(low.map(|l| l as i64 - 2), dims);
        let mut lumen = vec![0u8; grid.len()];
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                let from = low[0] + nx * (j + ny * k);
                let to = 2 + dims[0] * ((j - low[1] + 2) + dims[1] * (k - low[2] + 2));
                let n = high[0] - low[0] + 1;
                for (o, &v) in lumen[to..to + n].iter_mut().zip(&mask.data[from..from + n]) {
                    *o = u8::from(v != 0);
                }
            }
        }
        let mut window = Mask::new(grid.clone(), lumen);
        let filled = fill_cavities(&mut window);
        let lumen = window.data;
        let squared = squared_distance(&lumen, dims, grid.spacing());
        let mut id = vec![NONE; lumen.len()];
        let mut voxel = Vec::new();
        for (n, &v) in lumen.iter().enumerate() {
            if v != 0 {
                id[n] = voxel.len() as u32;
                voxel.push(n as u32);
            }
        }
        let distance = voxel.iter().map(|&n| squared[n as usize].sqrt()).collect();
        let s = grid.spacing();
        let mut offsets = [0; 26];
        let mut lengths = [0.0; 26];
        for (n, d) in super::thin::STEPS.iter().enumerate() {
            offsets[n] = d[0] + dims[0] as i64 * (d[1] + dims[1] as i64 * d[2]);
            lengths[n] = (0..3).map(|a| (d[a] as f64 * s[a]).powi(2)).sum::<f64>().sqrt();
        }
        let axis_variance = [0, 1, 2].map(|a| (grid.axes.column(a).normalize(), s[a] * s[a] / 3.0));
        let voxel_size = s.into_iter().fold(f64::INFINITY, f64::min);
        let component = Vec::new();
        let mut f =
            Field { grid, id, voxel, distance, component, components: 0, offsets, lengths, voxel_size, axis_variance, filled };
        f.label();
        Some(f)
    }

    fn label(&mut self) {
        let mut label = vec![NONE; self.voxel.len()];
        let mut sizes: Vec<usize> = Vec::new();
        let mut stack = Vec::new();
        for seed in 0..self.voxel.len() as u32 {
            if label[seed as usize] != NONE {
                continue;
            }
            let l = sizes.len() as u32;
            sizes.push(0);
            label[seed as usize] = l;
            stack.push(seed);
            while let Some(v) = stack.pop() {
                sizes[l as usize] += 1;
                for w in self.neighbors(v).map(|(w, _)| w) {
                    if label[w as usize] == NONE {
                        label[w as usize] = l;
                        stack.push(w);
                    }
                }
            }
        }
        let mut order: Vec<usize> = (0..sizes.len()).collect();
        order.sort_by_key(|&l| std::cmp::Reverse(sizes[l]));
        let mut rank = vec![0u32; sizes.len()];
        for (r, &l) in order.iter().enumerate() {
            rank[l] = r as u32;
        }
        self.components = sizes.len();
        self.component = label.into_iter().map(|l| rank[l as usize]).collect();
    }

    /// Lumen neighbours (26) with the length of the step, mm.
    pub fn neighbors(&self, v: u32) -> impl Iterator<Item = (u32, f64)> + '_ {
        let n = i64::from(self.voxel[v as usize]);
        (0..26).filter_map(move |s| {
            let w = self.id[(n + self.offsets[s]) as usize];
            (w != NONE).then_some((w, self.lengths[s]))
        })
    }

    /// World position of a lumen voxel's centre.
    pub fn position(&self, v: u32) -> Point {
        let [i, j, k] = self.grid.voxel(self.voxel[v as usize] as usize);
        self.grid.to_world(Vector::new(i as f64, j as f64, k as f64))
    }

    /// Distance to the wall, taken half a voxel before the nearest background centre, mm.
    pub fn radius(&self, v: u32) -> f64 {
        f64::from(self.distance[v as usize]) - 0.5 * self.voxel_size
    }

    /// One half minus the mask smoothed by the cubic B-spline: negative inside, without a unit.
    pub fn smooth(&self, p: &Point) -> f64 {
        let x = self.grid.to_index(p);
        let mut base = [0i64; 3];
        let mut weight = [[0.0; 4]; 3];
        for a in 0..3 {
            let f = x[a].floor();
            base[a] = f as i64 - 1;
            let t = x[a] - f;
            let u = 1.0 - t;
            weight[a] = [
                u * u * u / 6.0,
                (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
                (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
                t * t * t / 6.0,
            ];
        }
        let d = self.grid.dims.map(|n| n as i64);
        let mut sum = 0.0;
        for (c, wz) in weight[2].iter().enumerate() {
            let k = base[2] + c as i64;
            if k < 0 || k >= d[2] {
                continue;
            }
            for (b, wy) in weight[1].iter().enumerate() {
                let j = base[1] + b as i64;
                if j < 0 || j >= d[1] {
                    continue;
                }
                for (a, wx) in weight[0].iter().enumerate() {
                    let i = base[0] + a as i64;
                    if i >= 0 && i < d[0] && self.id[(i + d[0] * (j + d[1] * k)) as usize] != NONE {
                        sum += wx * wy * wz;
                    }
                }
            }
        }
        0.5 - sum
    }

    /// How far the smoothing has pulled a wall of curvature 1/`radius` (curved along `along`) inwards, mm.
    pub fn shrinkage(&self, along: &Vector, radius: f64) -> f64 {
        let variance: f64 = self.axis_variance.iter().map(|(e, v)| v * e.dot(along).powi(2)).sum();
        (0.5 * variance / radius).min(0.25 * self.voxel_size)
    }
}

/// Fills background that is not 6-connected to the window's border; returns how many voxels.
fn fill_cavities(mask: &mut Mask) -> usize {
    let background = label(mask, false, Connectivity::Six);
    let filled = background.components().iter().filter(|c| !c.on_border).map(|c| c.voxels).sum();
    background.paint(&mut mask.data, 1, |l| !background.components()[l as usize].on_border);
    filled
}

/// Exact squared distance to the nearest background voxel's centre, mm², by lower envelopes of parabolas
/// along each axis (Felzenszwalb and Huttenlocher 2012).
fn squared_distance(lumen: &[u8], dims: [usize; 3], spacing: [f64; 3]) -> Vec<f32> {
    let [nx, ny, nz] = dims;
    let far = (0..3).map(|a| (dims[a] as f64 * spacing[a]).powi(2)).sum::<f64>() as f32;
    let mut d: Vec<f32> = lumen.iter().map(|&v| if v == 0 { 0.0 } else { far }).collect();
    d.par_chunks_mut(nx).for_each(|line| {
        if line.iter().any(|&v| v > 0.0) {
            let mut work = Envelope::default();
            work.transform(line, spacing[0]);
        }
    });
    d.par_chunks_mut(nx * ny).for_each(|slab| {
        let mut work = Envelope::default();
        let mut line = vec![0.0; ny];
        for i in 0..nx {
            (0..ny).for_each(|j| line[j] = slab[i + nx * j]);
            if line.iter().any(|&v| v > 0.0) {
                work.transform(&mut line, spacing[1]);
                (0..ny).for_each(|j| slab[i + nx * j] = line[j]);
            }
        }
    });
    // Columns along z are strided: each row (j) gathers those with lumen, then they are written back.
    let mut crossed = vec![false; nx * ny];
    for slab in lumen.chunks_exact(nx * ny) {
        crossed.iter_mut().zip(slab).for_each(|(c, &v)| *c |= v != 0);
    }
    let columns: Vec<Vec<(usize, Vec<f32>)>> = (0..ny)
        .into_par_iter()
        .map(|j| {
            let mut work = Envelope::default();
            let column = |i: usize| {
                let mut line: Vec<f32> = (0..nz).map(|k| d[i + nx * (j + ny * k)]).collect();
                work.transform(&mut line, spacing[2]);
                (i, line)
            };
            (0..nx).filter(|&i| crossed[i + nx * j]).map(column).collect()
        })
        .collect();
    d.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slab)| {
        for (j, row) in columns.iter().enumerate() {
            for (i, line) in row {
                slab[i + nx * j] = line[k];
            }
        }
    });
    d
}

#[derive(Default)]
struct Envelope {
    site: Vec<usize>,
    from: Vec<f64>,
    value: Vec<f64>,
}

impl Envelope {
    fn transform(&mut self, line: &mut [f32], step: f64) {
        self.value.clear();
        self.value.extend(line.iter().map(|&v| f64::from(v)));
        self.site.clear();
        self.from.clear();
        let x = |q: usize| q as f64 * step;
        for q in 0..line.len() {
            let mut start = f64::NEG_INFINITY;
            while let (Some(&p), Some(&z)) = (self.site.last(), self.from.last()) {
                start = (self.value[q] - self.value[p] + x(q) * x(q) - x(p) * x(p)) / (2.0 * (x(q) - x(p)));
                if start > z {
                    break;
                }
                self.site.pop();
                self.from.pop();
                start = f64::NEG_INFINITY;
            }
            self.site.push(q);
            self.from.push(start);
        }
        let mut k = 0;
        for (q, out) in line.iter_mut().enumerate() {
            while k + 1 < self.site.len() && self.from[k + 1] <= x(q) {
                k += 1;
            }
            let p = self.site[k];
            *out = ((x(q) - x(p)).powi(2) + self.value[p]) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn distance_on_an_anisotropic_grid_equals_the_search_over_all_background() {
        let dims = [9, 8, 7];
        let spacing = [0.5, 0.7, 1.3];
        let lumen: Vec<u8> = (0..504usize).map(|n| u8::from((n * 2654435761) % 97 > 6)).collect();
        let d = squared_distance(&lumen, dims, spacing);
        let at = |n: usize| [n % 9, n / 9 % 8, n / 72].map(|c| c as f64);
        for n in 0..504 {
            let best = (0..504)
                .filter(|&m| lumen[m] == 0)
                .map(|m| (0..3).map(|a| ((at(n)[a] - at(m)[a]) * spacing[a]).powi(2)).sum::<f64>())
                .fold(f64::INFINITY, f64::min);
            assert!((f64::from(d[n]) - best).abs() < 1e-5, "{n}: {} {best}", d[n]);
        }
    }

    #[test]
    fn a_cavity_is_filled_and_components_come_by_size() {
        let mut data = vec![0u8; 20 * 9 * 9];
        for k in 1..8 {
            for j in 1..8 {
                for i in 1..8 {
                    data[i + 20 * (j + 9 * k)] = 1;
                }
            }
        }
        data[4 + 20 * (4 + 9 * 4)] = 0;
        data[15] = 1;
        let grid = Grid::new([20, 9, 9], [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
        let f = Field::new(&Mask::new(grid, data)).unwrap();
        assert_eq!((f.filled, f.components, f.voxel.len()), (1, 2, 344));
        let far = f.voxel.iter().position(|&n| f.grid.voxel(n as usize)[0] > 12).unwrap();
        assert_eq!(f.component[far], 1);
    }
}
