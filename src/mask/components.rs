//! Connected components by runs along x and union-find: O(voxels) to scan, O(runs) to join.

use rayon::prelude::*;

use super::Mask;

/// Which voxels are neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Connectivity {
    /// Voxels that share a face.
    Six,
    /// Voxels that share a face, an edge or a corner.
    TwentySix,
}

/// A connected set of voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Component {
    /// Its size.
    pub voxels: usize,
    /// First and last index along each axis.
    pub bounds: [[usize; 2]; 3],
    /// Whether it meets the border of the array.
    pub on_border: bool,
}

/// The components of lumen or background, numbered in scan order.
#[derive(Debug, Clone)]
pub struct Labels {
    dims: [usize; 3],
    /// First run of each row, and the number of runs.
    rows: Vec<u32>,
    /// First voxel of each run and the one behind its last.
    runs: Vec<[u32; 2]>,
    label: Vec<u32>,
    components: Vec<Component>,
}

/// Labels the lumen (`object`) or the background of a mask. Outside the array there is nothing.
pub fn label(mask: &Mask, object: bool, connectivity: Connectivity) -> Labels {
    label_data(&mask.data, mask.grid.dims, object, connectivity)
}

pub(crate) fn label_data(data: &[u8], dims: [usize; 3], object: bool, connectivity: Connectivity) -> Labels {
    let [nx, ny, nz] = dims;
    let slabs: Vec<(Vec<u32>, Vec<[u32; 2]>)> =
        data.par_chunks(nx * ny).map(|slab| runs_of(slab, nx, u8::from(object))).collect();
    let mut rows = Vec::with_capacity(ny * nz + 1);
    let mut runs = Vec::with_capacity(slabs.iter().map(|s| s.1.len()).sum());
    for (counts, found) in slabs {
        for n in counts {
            rows.push(runs.len() as u32 + n);
        }
        runs.extend(found);
    }
    rows.push(runs.len() as u32);

    let mut parent: Vec<u32> = (0..runs.len() as u32).collect();
    let earlier: &[[i64; 2]] = match connectivity {
        Connectivity::Six => &[[-1, 0], [0, -1]],
        Connectivity::TwentySix => &[[-1, 0], [-1, -1], [0, -1], [1, -1]],
    };
    let slack = u32::from(connectivity == Connectivity::TwentySix);
    for k in 0..nz as i64 {
        for j in 0..ny as i64 {
            let row = (k * ny as i64 + j) as usize;
            for &[dj, dk] in earlier {
                let (y, z) = (j + dj, k + dk);
                if (0..ny as i64).contains(&y) && z >= 0 {
                    join_rows(&runs, &rows, row, (z * ny as i64 + y) as usize, slack, &mut parent);
                }
            }
        }
    }

    let mut label = vec![u32::MAX; runs.len()];
    let mut components: Vec<Component> = Vec::new();
    for row in 0..ny * nz {
        let (j, k) = (row % ny, row / ny);
        for r in rows[row]..rows[row + 1] {
            let root = find(&mut parent, r) as usize;
            let [x0, x1] = runs[r as usize].map(|x| x as usize);
            if label[root] == u32::MAX {
                label[root] = components.len() as u32;
                components.push(Component { voxels: 0, bounds: [[x0, x1 - 1], [j, j], [k, k]], on_border: false });
            }
            label[r as usize] = label[root];
            let c = &mut components[label[root] as usize];
            c.voxels += x1 - x0;
            for (b, [low, high]) in c.bounds.iter_mut().zip([[x0, x1 - 1], [j, j], [k, k]]) {
                *b = [b[0].min(low), b[1].max(high)];
            }
        }
    }
    for c in &mut components {
        c.on_border = (0..3).any(|a| c.bounds[a][0] == 0 || c.bounds[a][1] + 1 == dims[a]);
    }
    Labels { dims, rows, runs, label, components }
}

/// Runs of one value in a slab, with the number of runs before each row.
fn runs_of(slab: &[u8], nx: usize, value: u8) -> (Vec<u32>, Vec<[u32; 2]>) {
    let (mut counts, mut runs) = (Vec::new(), Vec::new());
    for row in slab.chunks(nx) {
        counts.push(runs.len() as u32);
        let mut x = 0;
        while let Some(start) = row[x..].iter().position(|&v| v == value).map(|n| x + n) {
            let end = row[start..].iter().position(|&v| v != value).map_or(nx, |n| start + n);
            runs.push([start as u32, end as u32]);
            x = end;
        }
    }
    (counts, runs)
}

fn join_rows(runs: &[[u32; 2]], rows: &[u32], a: usize, b: usize, slack: u32, parent: &mut [u32]) {
    let (mut p, mut q) = (rows[a], rows[b]);
    while p < rows[a + 1] && q < rows[b + 1] {
        let ([a0, a1], [b0, b1]) = (runs[p as usize], runs[q as usize]);
        if a0 < b1 + slack && b0 < a1 + slack {
            let (x, y) = (find(parent, p), find(parent, q));
            // The smaller root wins: labels follow the scan order.
            parent[x.max(y) as usize] = x.min(y);
        }
        if a1 <= b1 {
            p += 1;
        } else {
            q += 1;
        }
    }
}

fn find(parent: &mut [u32], mut n: u32) -> u32 {
    while parent[n as usize] != n {
        let up = parent[n as usize];
        parent[n as usize] = parent[up as usize];
        n = up;
    }
    n
}

impl Labels {
    /// The components, by label.
    pub fn components(&self) -> &[Component] {
        &self.components
    }

    /// Label of a voxel; `None` where it is of the other kind.
    pub fn at(&self, i: usize, j: usize, k: usize) -> Option<u32> {
        let row = k * self.dims[1] + j;
        let (first, last) = (self.rows[row] as usize, self.rows[row + 1] as usize);
        let n = self.runs[first..last].partition_point(|r| r[1] as usize <= i);
        let run = self.runs[first..last].get(n)?;
        (run[0] as usize <= i).then(|| self.label[first + n])
    }

    /// Calls `f(j, k, first, behind_last)` for every run of voxels of a component, in scan order.
    pub fn for_each_run(&self, label: u32, mut f: impl FnMut(usize, usize, usize, usize)) {
        let b = self.components[label as usize].bounds;
        for k in b[2][0]..=b[2][1] {
            for j in b[1][0]..=b[1][1] {
                let row = k * self.dims[1] + j;
                for r in self.rows[row] as usize..self.rows[row + 1] as usize {
                    if self.label[r] == label {
                        f(j, k, self.runs[r][0] as usize, self.runs[r][1] as usize);
                    }
                }
            }
        }
    }

    /// Sets the voxels of every component with `which(label)` to `value`.
    pub(crate) fn paint(&self, data: &mut [u8], value: u8, which: impl Fn(u32) -> bool) {
        let nx = self.dims[0];
        for row in 0..self.rows.len() - 1 {
            for r in self.rows[row] as usize..self.rows[row + 1] as usize {
                if which(self.label[r]) {
                    let [a, b] = self.runs[r].map(|x| row * nx + x as usize);
                    data[a..b].fill(value);
                }
            }
        }
    }
}
