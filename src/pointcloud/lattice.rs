//! Voxels, subvoxels and their labels: thin structures, subdivision, relabelling, outer boundary.

use rayon::prelude::*;

use super::options::{Concavities, PointCloudOptions, SlotEnds, ThinStructures};
use super::rules::{holds_opposite_pair, sites};
use super::{Candidate, RuleCounts};
use crate::geometry::Vector;
use crate::mask::{Grid, Mask};

/// The six face neighbours, in the order of the bits of a six-neighbour pattern.
pub(super) const FACES: [[i64; 3]; 6] = [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]];

const OBJECT: u8 = 1;
const SUBDIVIDED: u8 = 2;

/// The lumen's neighbourhood: every voxel carries eight subvoxels, of which those of an undivided voxel share its label.
pub(super) struct Lattice {
    /// The window round the lumen, two voxels wider on every side.
    pub grid: Grid,
    /// Label bits of the eight subvoxels, bit x + 2y + 4z.
    children: Vec<u8>,
    flags: Vec<u8>,
    /// Thin lumen voxels.
    pub thin: usize,
    /// Background voxels in narrow concave places that are subdivided.
    pub concave: usize,
    /// Relabelled subvoxels.
    pub relabelled: usize,
}

impl Lattice {
    /// `None` where the mask has no lumen.
    pub fn new(mask: &Mask, options: &PointCloudOptions) -> Option<Lattice> {
        let (low, dims) = window(mask)?;
        let grid = mask.grid.window(low, dims);
        let [nx, ny, nz] = dims;
        let mut flags = vec![0u8; nx * ny * nz];
        flags.par_chunks_mut(nx * ny).enumerate().for_each(|(k, slab)| {
            for j in 0..ny {
                for i in 0..nx {
                    let at = mask.at(i as i64 + low[0], j as i64 + low[1], k as i64 + low[2]);
                    slab[i + nx * j] = u8::from(at) * OBJECT;
                }
            }
        });
        let children = flags.par_iter().map(|&f| if f & OBJECT != 0 { 0xff } else { 0 }).collect();
        let mut lattice = Lattice { grid, children, flags, thin: 0, concave: 0, relabelled: 0 };
        let thin = lattice.thin_voxels(mask, low, options.thin);
        lattice.thin = thin.iter().filter(|&&t| t).count();
        lattice.subdivide_thin(&thin);
        if options.relabel_subvoxels {
            lattice.relabel();
        }
        if options.concavities != Concavities::Ignore {
            lattice.subdivide_concave(options.concavities);
        }
        Some(lattice)
    }

    fn offset(&self, v: [i64; 3]) -> Option<usize> {
        self.grid.linear(v[0], v[1], v[2])
    }

    /// Whether a voxel of the mask is lumen; subvoxel labels do not matter.
    pub fn object(&self, v: [i64; 3]) -> bool {
        self.offset(v).is_some_and(|n| self.flags[n] & OBJECT != 0)
    }

    /// Whether a subvoxel is lumen; `s` counts subvoxels, two a voxel.
    pub fn fine_object(&self, s: [i64; 3]) -> bool {
        let bit = (s[0] & 1) | (s[1] & 1) << 1 | (s[2] & 1) << 2;
        self.offset(s.map(|c| c >> 1)).is_some_and(|n| self.children[n] >> bit & 1 != 0)
    }

    /// Coarse labels as bytes for the smoothing: 1 is lumen.
    pub fn label(&self, n: usize) -> u8 {
        self.flags[n] & OBJECT
    }

    fn pattern(at: [i64; 3], object: impl Fn([i64; 3]) -> bool) -> u8 {
        FACES.iter().enumerate().fold(0, |m, (b, d)| m | u8::from(object([at[0] + d[0], at[1] + d[1], at[2] + d[2]])) << b)
    }

    fn voxel(&self, n: usize) -> [i64; 3] {
        self.grid.voxel(n).map(|c| c as i64)
    }

    /// White top-hat with the full 3×3×3 block. Beyond the picture's border the lumen goes on as at the border, so that
    /// a vessel that leaves the picture is not thin there.
    fn thin_voxels(&self, mask: &Mask, low: [i64; 3], rule: ThinStructures) -> Vec<bool> {
        if rule == ThinStructures::Ignore {
            return vec![false; self.flags.len()];
        }
        let top = mask.grid.dims.map(|n| n as i64 - 1);
        let replicated: Vec<u8> = (0..self.flags.len())
            .into_par_iter()
            .map(|n| {
                let v = self.voxel(n);
                let w = [0, 1, 2].map(|a| (v[a] + low[a]).clamp(0, top[a]) - low[a]);
                self.offset(w).map_or(0, |m| self.flags[m] & OBJECT)
            })
            .collect();
        let dims = self.grid.dims;
        let eroded = block3(&replicated, dims, |a, b, c| a & b & c);
        let opened = block3(&eroded, dims, |a, b, c| a | b | c);
        (0..self.flags.len())
            .into_par_iter()
            .map(|n| {
                let hat = self.flags[n] & OBJECT != 0 && opened[n] == 0;
                hat && (rule == ThinStructures::TopHat || !self.near_full_block(&eroded, n))
            })
            .collect()
    }

    /// Whether the middle of a full 3×3×3 block lies within two voxels.
    fn near_full_block(&self, eroded: &[u8], n: usize) -> bool {
        let v = self.voxel(n);
        (-2..=2i64).any(|k| {
            (-2..=2i64).any(|j| {
                (-2..=2i64).any(|i| {
                    i * i + j * j + k * k <= 4 && self.offset([v[0] + i, v[1] + j, v[2] + k]).is_some_and(|m| eroded[m] != 0)
                })
            })
        })
    }

    /// Thin voxels and the outer boundary voxels that share a face with one are subdivided.
    fn subdivide_thin(&mut self, thin: &[bool]) {
        let marks: Vec<u8> = (0..self.flags.len())
            .into_par_iter()
            .map(|n| {
                let near = |d: &[i64; 3]| {
                    let v = self.voxel(n);
                    self.offset([v[0] + d[0], v[1] + d[1], v[2] + d[2]]).is_some_and(|m| thin[m])
                };
                let divide = thin[n] || (self.flags[n] & OBJECT == 0 && FACES.iter().any(near));
                if divide { SUBDIVIDED } else { 0 }
            })
            .collect();
        self.flags.par_iter_mut().zip(marks).for_each(|(f, m)| *f |= m);
    }

    /// Labels further subvoxels as lumen (Figures 6 and 7), all from the labels as they were.
    fn relabel(&mut self) {
        let grown: Vec<(usize, u8)> = (0..self.flags.len())
            .into_par_iter()
            .filter_map(|n| {
                if self.flags[n] & (OBJECT | SUBDIVIDED) != SUBDIVIDED {
                    return None;
                }
                let v = self.voxel(n);
                let n6 = Self::pattern(v, |w| self.object(w));
                // Adding subvoxels would fill a small cavity.
                if n6 == 0 || holds_opposite_pair(n6) || n6.count_ones() >= 5 {
                    return None;
                }
                let mut bits = 0u8;
                for c in 0..8i64 {
                    let s = [2 * v[0] + (c & 1), 2 * v[1] + (c >> 1 & 1), 2 * v[2] + (c >> 2)];
                    bits |= u8::from(self.joins_lumen(s)) << c;
                }
                (bits != 0).then_some((n, bits))
            })
            .collect();
        for &(n, bits) in &grown {
            self.children[n] |= bits;
            self.relabelled += bits.count_ones() as usize;
        }
        // A background voxel that now touches relabelled subvoxels has become an outer boundary voxel.
        for &(n, bits) in &grown {
            let v = self.voxel(n);
            for (b, d) in FACES.iter().enumerate() {
                let axis = b / 2;
                let side = if b % 2 == 0 { [0x55u8, 0x33, 0x0f][axis] } else { [0xaau8, 0xcc, 0xf0][axis] };
                if bits & side != 0
                    && let Some(m) = self.offset([v[0] + d[0], v[1] + d[1], v[2] + d[2]])
                    && self.flags[m] & OBJECT == 0
                {
                    self.flags[m] |= SUBDIVIDED;
                }
            }
        }
    }

    /// The paper's condition: among the 18 neighbours of subvoxel `s` there are two lumen subvoxels, one sharing a face
    /// with `s`, that do not share a face with each other.
    fn joins_lumen(&self, s: [i64; 3]) -> bool {
        let mut near = [[0i64; 3]; 18];
        let mut count = 0;
        for k in -1..=1i64 {
            for j in -1..=1i64 {
                for i in -1..=1i64 {
                    let reach = i.abs() + j.abs() + k.abs();
                    if (1..=2).contains(&reach) && self.fine_object([s[0] + i, s[1] + j, s[2] + k]) {
                        near[count] = [i, j, k];
                        count += 1;
                    }
                }
            }
        }
        let near = &near[..count];
        let length = |p: &[i64; 3]| p.iter().map(|c| c.abs()).sum::<i64>();
        let apart = |p: &[i64; 3], q: &[i64; 3]| (0..3).map(|a| (p[a] - q[a]).abs()).sum::<i64>();
        near.iter().filter(|p| length(p) == 1).any(|p| near.iter().any(|q| apart(p, q) > 1))
    }

    /// Outer boundary voxels that no full 3×3×3 block of background covers are subdivided.
    fn subdivide_concave(&mut self, rule: Concavities) {
        let background: Vec<u8> = self.flags.par_iter().map(|&f| u8::from(f & OBJECT == 0)).collect();
        let dims = self.grid.dims;
        let eroded = block3(&background, dims, |a, b, c| a & b & c);
        let opened = block3(&eroded, dims, |a, b, c| a | b | c);
        let marks: Vec<u8> = (0..self.flags.len())
            .into_par_iter()
            .map(|n| {
                let hat = background[n] != 0 && opened[n] == 0;
                // The opening treats the outside of the window as full blocks: it is all background.
                let hit = hat
                    && Self::pattern(self.voxel(n), |w| self.object(w)) != 0
                    && (rule == Concavities::TopHatOfInverse || !self.near_full_block(&eroded, n));
                u8::from(hit) * SUBDIVIDED
            })
            .collect();
        self.concave = marks.iter().filter(|&&m| m != 0).count();
        self.flags.par_iter_mut().zip(marks).for_each(|(f, m)| *f |= m);
    }

    /// Applies the placement rules to every outer boundary voxel and subvoxel, in the order of the voxels.
    pub fn candidates(&self, slots: SlotEnds, counts: &mut RuleCounts) -> Vec<Candidate> {
        let [nx, ny, nz] = self.grid.dims;
        let slabs: Vec<_> = (0..nz)
            .into_par_iter()
            .map(|k| {
                let mut found = Vec::new();
                let mut counts = Vec::new();
                for n in nx * ny * k..nx * ny * (k + 1) {
                    if self.flags[n] & OBJECT != 0 {
                        continue;
                    }
                    let v = self.voxel(n);
                    if self.flags[n] & SUBDIVIDED == 0 {
                        let n6 = Self::pattern(v, |w| self.object(w));
                        let center = Vector::new(v[0] as f64, v[1] as f64, v[2] as f64);
                        self.emit(n6, center, false, slots, &mut found, &mut counts);
                        continue;
                    }
                    for c in 0..8i64 {
                        let s = [2 * v[0] + (c & 1), 2 * v[1] + (c >> 1 & 1), 2 * v[2] + (c >> 2)];
                        if !self.fine_object(s) {
                            let n6 = Self::pattern(s, |w| self.fine_object(w));
                            let center = Vector::new(s[0] as f64, s[1] as f64, s[2] as f64) * 0.5 - Vector::repeat(0.25);
                            self.emit(n6, center, true, slots, &mut found, &mut counts);
                        }
                    }
                }
                (found, counts)
            })
            .collect();
        let mut all = Vec::new();
        for (found, rules) in slabs {
            all.extend(found);
            rules.into_iter().for_each(|r| counts.count(r));
        }
        all
    }

    fn emit(&self, n6: u8, center: Vector, fine: bool, slots: SlotEnds, out: &mut Vec<Candidate>, counts: &mut Vec<super::Rule>) {
        if n6 == 0 {
            return;
        }
        let sites = sites(n6, slots);
        counts.push(sites.rule);
        let half = if fine { 0.25 } else { 0.5 };
        let spacing = self.grid.spacing();
        // Outward: from the lumen neighbour towards this voxel.
        let outward = |b: usize| self.grid.axes.column(b / 2) * (if b % 2 == 0 { 1.0 } else { -1.0 } / spacing[b / 2]);
        let all_faces = (0..6).filter(|b| n6 >> b & 1 != 0).map(outward).fold(Vector::zeros(), |a, b| a + b);
        // Central differences of the labels; the gradient points into the lumen.
        let difference = Vector::from_fn(|a, _| f64::from(n6 >> (2 * a) & 1) - f64::from(n6 >> (2 * a + 1) & 1));
        let gradient = self.grid.gradient_to_world(&difference);
        if sites.centre {
            out.push(Candidate { at: center, faces: all_faces, gradient, by_face: false, fine });
        }
        for b in 0..6 {
            let by_face = sites.by_face >> b & 1 != 0;
            if by_face || sites.by_gradient >> b & 1 != 0 {
                let at = center + half * Vector::new(FACES[b][0] as f64, FACES[b][1] as f64, FACES[b][2] as f64);
                out.push(Candidate { at, faces: outward(b), gradient, by_face, fine });
            }
        }
    }
}

/// Index window round the lumen with two voxels to spare.
fn window(mask: &Mask) -> Option<([i64; 3], [usize; 3])> {
    let [nx, ny, _] = mask.grid.dims;
    let boxes = mask.data.par_chunks(nx * ny).enumerate().map(|(k, slab)| {
        let mut b: Option<[[usize; 2]; 3]> = None;
        for (j, row) in slab.chunks(nx).enumerate() {
            let Some(first) = row.iter().position(|&v| v != 0) else { continue };
            let last = row.iter().rposition(|&v| v != 0).unwrap_or(first);
            let r = [[first, last], [j, j], [k, k]];
            b = Some(b.map_or(r, |b| join(b, r)));
        }
        b
    });
    let found = boxes.reduce(|| None, |a, b| match (a, b) {
        (Some(a), Some(b)) => Some(join(a, b)),
        (a, b) => a.or(b),
    })?;
    Some((found.map(|[l, _]| l as i64 - 2), found.map(|[l, h]| h - l + 5)))
}

fn join(a: [[usize; 2]; 3], b: [[usize; 2]; 3]) -> [[usize; 2]; 3] {
    [0, 1, 2].map(|i| [a[i][0].min(b[i][0]), a[i][1].max(b[i][1])])
}

/// Combines every voxel with its two neighbours along x, then y, then z; beyond the array a voxel repeats itself.
pub(crate) fn block3(data: &[u8], [nx, ny, nz]: [usize; 3], combine: impl Fn(u8, u8, u8) -> u8 + Sync) -> Vec<u8> {
    let slab = nx * ny;
    let mut flat = vec![0u8; data.len()];
    flat.par_chunks_mut(slab).zip(data.par_chunks(slab)).for_each(|(out, input)| {
        let mut rows = vec![0u8; slab];
        for (r, row) in rows.chunks_mut(nx).zip(input.chunks(nx)) {
            for i in 0..nx {
                r[i] = combine(row[i.saturating_sub(1)], row[i], row[(i + 1).min(nx - 1)]);
            }
        }
        for j in 0..ny {
            let (a, b) = (j.saturating_sub(1) * nx, (j + 1).min(ny - 1) * nx);
            for i in 0..nx {
                out[j * nx + i] = combine(rows[a + i], rows[j * nx + i], rows[b + i]);
            }
        }
    });
    let mut out = vec![0u8; data.len()];
    out.par_chunks_mut(slab).enumerate().for_each(|(k, out)| {
        let (a, b) = (k.saturating_sub(1) * slab, (k + 1).min(nz - 1) * slab);
        for i in 0..slab {
            out[i] = combine(flat[a + i], flat[k * slab + i], flat[b + i]);
        }
    });
    out
}
