//! The finest level: a node a voxel where labels are contradicted, and margins for those that the topology needs.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::SmoothSummary;
use super::fine::Fine;
use super::labels::Near;
use super::level::Level;
use super::neighbourhood::Neighbourhood;
use super::solve::{Effort, Problem, Weights};
use super::spline::TiledSpline;
use crate::geometry::Vector;
use crate::mask::Mask;

/// What the second level is made from.
pub(super) struct Coarse<'a> {
    pub mask: &'a Mask,
    pub level: Level,
    pub c: Vec<f32>,
    pub near: &'a [Near],
    pub weights: Weights,
    pub effort: Effort,
    /// Whether labels that noise explains are given up.
    pub leniently: bool,
}

/// How far from a contradicted label coefficients may change, how far differences look from these, and how much farther than
/// the first voxels tell of them, smallest spacings.
const FREE: i32 = 3;
const SEEN: i32 = 3;
const BEYOND: i32 = 6;
/// Values of neighbours, smallest spacings, up to which what lies between them is looked at.
const PINCH: f32 = 0.25;
/// By how much a label's margin grows from round to round, smallest spacings.
const MARGIN: f32 = 0.15;

impl Coarse<'_> {
    /// Fits the finest level again round some voxels, and takes the values that labels have after it.
    ///
    /// Returns the products with the matrix.
    fn solve(&self, fine: &mut Fine, voxels: &BTreeSet<[i16; 3]>, margins: &BTreeMap<[i16; 3], f32>, values: &mut [[f32; 4]]) -> usize {
        let voxels = &voxels.iter().copied().collect::<Vec<_>>();
        let round = |spacings: [i32; 2]| {
            let reach = self.level.band.nodes.refine.map(|m| spacings.map(|s| (s + m - 1) / m).iter().sum());
            Neighbourhood::of(voxels, reach)
        };
        let (free, seen, reach) = (round([FREE, 0]), round([FREE, SEEN]), round([FREE, BEYOND]));
        let near: Vec<Near> = self.near.iter().filter(|n| reach.holds(n.voxel)).copied().collect();
        let Level { mut band, mut labels } = Level::new(self.mask, fine.nodes, &near, Some(&seen), true, self.weights.scale);
        let [x, y, z] = [0, 1, 2].map(|a| fine.nodes.voxels(a));
        let frozen = band.fill(true, |r| {
            let (y, z) = (y[r.y as usize], z[r.z as usize]);
            x[r.x as usize..][..r.len as usize].iter().map(|&x| !free.holds([x, y, z])).collect()
        });
        band.skip_frozen(&frozen);
        labels.skip_frozen(&frozen);
        fine.cover(&band, &frozen);
        let mut c = fine.read(&band);
        let margin: Vec<f32> = labels.labels.iter().map(|l| margins.get(&l.voxel).copied().unwrap_or(0.0)).collect();
        let problem = Problem { band: &band, labels: &labels, weights: self.weights, frozen: &frozen };
        let products = problem.newton(&mut c, &margin, self.effort);
        fine.write(&band, &c, &frozen);
        let now = labels.sample(&c);
        let changed = (0..labels.cells.len()).filter(|&cell| !labels.cells[cell].frozen).flat_map(|cell| labels.of_cell(cell));
        for l in changed {
            if let Some(n) = self.level.labels.find(&self.level.band.nodes, labels.labels[l].voxel) {
                values[n] = now[l];
            }
        }
        products
    }

    /// Labels that the topology needs and the function contradicts, or nearly so; `values`: the labels', `fine`: the finest level
    /// where there is one.
    pub fn must_keep(&self, values: &[[f32; 4]], fine: Option<&Fine>) -> Vec<usize> {
        let mut keep = self.level.must_keep(self.mask, values, self.leniently);
        keep.extend(self.pinched(values, fine));
        keep.sort_unstable();
        keep.dedup();
        keep
    }

    /// Neighbours between which the function changes its sign twice: a neck or a gap thinner than a voxel.
    fn pinched(&self, values: &[[f32; 4]], fine: Option<&Fine>) -> Vec<usize> {
        let labels = &self.level.labels.labels;
        // A margin would bring a label back that was given up as noise.
        let kept = |l: usize| !self.leniently || f32::from(labels[l].sign) * values[l][0] > 0.0;
        let mut close: Vec<([i16; 3], usize)> =
            (0..labels.len()).filter(|&l| values[l][0].abs() < PINCH && kept(l)).map(|l| (labels[l].voxel, l)).collect();
        close.par_sort_unstable();
        let pairs: Vec<(usize, usize, usize)> = close
            .iter()
            .flat_map(|&(v, l)| {
                (0..3).filter_map(|a| {
                    let mut w = v;
                    w[a] += 1;
                    let m = close[close.binary_search_by_key(&w, |c| c.0).ok()?].1;
                    ((values[l][0] < 0.0) == (values[m][0] < 0.0)).then_some((l, m, a))
                })
                .collect::<Vec<_>>()
            })
            .collect();
        pairs
            .into_par_iter()
            .filter(|&(l, _, a)| {
                let mut middle = Vector::from(labels[l].voxel.map(f64::from));
                middle[a] += 0.5;
                let value = fine.and_then(|f| f.value(&middle)).or_else(|| self.level.band.value(&self.c, &middle));
                value.is_some_and(|v| (v < 0.0) != (values[l][0] < 0.0))
            })
            .flat_map_iter(|(l, m, _)| [l, m])
            .collect()
    }

    /// Subdivides the spline round the labels `hard`, fits it there again and gives the labels that the topology needs
    /// a growing margin until none is contradicted or `rounds` are over. `values`: the labels'.
    pub fn refine(&self, hard: &[usize], mut values: Vec<[f32; 4]>, rounds: usize, summary: &mut SmoothSummary) -> TiledSpline {
        let voxel = |l: &usize| self.level.labels.labels[*l].voxel;
        let mut fine = Fine::new(self.mask, &self.level.band, &self.c);
        let mut margins = BTreeMap::new();
        let voxels = hard.iter().map(voxel).collect();
        summary.products[1] += self.solve(&mut fine, &voxels, &margins, &mut values);
        let mut left = self.must_keep(&values, Some(&fine));
        for _ in 0..rounds {
            if left.is_empty() {
                break;
            }
            let voxels: BTreeSet<[i16; 3]> = left.iter().map(voxel).collect();
            voxels.iter().for_each(|v| *margins.entry(*v).or_insert(0.0f32) += MARGIN);
            summary.products[1] += self.solve(&mut fine, &voxels, &margins, &mut values);
            left = self.must_keep(&values, Some(&fine));
        }
        summary.refined = fine.freed();
        summary.repaired = margins.len();
        summary.contradicted = left.len();
        let world = |l: &usize| self.mask.grid.to_world(Vector::from(voxel(l).map(f64::from))).into();
        summary.contradictions = left.iter().take(10).map(world).collect();
        fine.into_spline()
    }
}
