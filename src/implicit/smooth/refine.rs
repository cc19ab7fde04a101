//! The finest level: a node a voxel where labels are contradicted, and margins for those that the topology needs.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::band::{self, Nodes};
use super::labels::Near;
use super::neighbourhood::Neighbourhood;
use super::solve::{Effort, Problem, Weights};
use super::spline::TiledSpline;
use super::{Level, SmoothSummary, subdivide, tile};
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

/// How far from a contradicted label coefficients may change, and how much farther voxels tell of these, smallest spacings.
const FREE: i32 = 3;
const BEYOND: i32 = 6;
/// Values of neighbours, smallest spacings, up to which what lies between them is looked at.
const PINCH: f32 = 0.25;
/// By how much a label's margin grows from round to round, smallest spacings.
const MARGIN: f32 = 0.15;

/// A part of the finest level: its coefficients, and which of them keep their value.
pub(super) struct Patch {
    level: Level,
    c: Vec<f32>,
    frozen: Vec<bool>,
}

impl Coarse<'_> {
    /// The finest level round some voxels, its coefficients from the level before.
    fn patch(&self, voxels: &BTreeSet<[i16; 3]>) -> Patch {
        let voxels = &voxels.iter().copied().collect::<Vec<_>>();
        let voxels_of = |spacings: i32| self.level.band.nodes.refine.map(|m| (spacings + m - 1) / m);
        let (free, beyond) = (voxels_of(FREE), voxels_of(BEYOND));
        let reach = std::array::from_fn(|a| free[a] + beyond[a]);
        let reach = Neighbourhood::of(self.mask.grid.dims, voxels, reach);
        let near: Vec<Near> = self.near.iter().filter(|n| reach.holds(n.voxel)).copied().collect();
        let nodes = self.level.band.nodes;
        let nodes = Nodes { step: 1, low: nodes.low.map(|l| 2 * l), dims: nodes.dims.map(|d| 2 * d), ..nodes };
        let mut level = Level::new(self.mask, nodes, &near, true, self.weights.scale);
        let free = Neighbourhood::of(self.mask.grid.dims, voxels, free);
        let frozen = level.band.fill(true, |r| (r.x..r.x + r.len as i32).map(|x| !free.holds(nodes.voxel([x, r.y, r.z]).map(|v| v as i16))).collect());
        level.band.skip_frozen(&frozen);
        level.labels.skip_frozen(&frozen);
        let c = subdivide(&self.level.band, &self.c, &level.band);
        Patch { level, c, frozen }
    }

    /// Labels that the topology needs and the function contradicts, or nearly so, with a patch where there is one.
    pub fn must_keep(&self, patch: Option<&Patch>) -> Vec<usize> {
        let labels = &self.level.labels;
        let mut values = labels.sample(&self.c);
        if let Some(patch) = patch {
            let fine = patch.level.labels.sample(&patch.c);
            let mut fine: Vec<([i16; 3], [f32; 4])> = patch.level.labels.labels.iter().map(|l| l.voxel).zip(fine).collect();
            fine.par_sort_unstable_by_key(|f| f.0);
            values.par_iter_mut().zip(&labels.labels).with_min_len(1024).for_each(|(v, l)| {
                if let Ok(n) = fine.binary_search_by_key(&l.voxel, |f| f.0) {
                    *v = fine[n].1;
                }
            });
        }
        let mut keep = self.level.must_keep(self.mask, &values, self.leniently);
        keep.extend(self.pinched(&values, patch));
        keep.sort_unstable();
        keep.dedup();
        keep
    }

    /// Neighbours between which the function changes its sign twice: a neck or a gap thinner than a voxel.
    fn pinched(&self, values: &[[f32; 4]], patch: Option<&Patch>) -> Vec<usize> {
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
                let fine = patch.and_then(|p| p.level.band.value(&p.c, &middle));
                let value = fine.or_else(|| self.level.band.value(&self.c, &middle));
                value.is_some_and(|v| (v < 0.0) != (values[l][0] < 0.0))
            })
            .flat_map_iter(|(l, m, _)| [l, m])
            .collect()
    }

    /// Subdivides the spline round the labels `hard`, fits it there again and gives the labels that the topology needs
    /// a growing margin until none is contradicted or `rounds` are over.
    pub fn refine(&self, hard: &[usize], rounds: usize, summary: &mut SmoothSummary) -> TiledSpline {
        let mask = self.mask;
        let voxel = |l: &usize| self.level.labels.labels[*l].voxel;
        let mut voxels: BTreeSet<[i16; 3]> = hard.iter().map(voxel).collect();
        let mut all = self.patch(&voxels);

        let problem = Problem { band: &all.level.band, labels: &all.level.labels, weights: self.weights, frozen: &all.frozen };
        summary.products[1] += problem.newton(&mut all.c, &[], self.effort);

        let mut margins = BTreeMap::new();
        let mut left = self.must_keep(Some(&all));

        for _ in 0..rounds {
            if left.is_empty() {
                break;
            }
            let new: BTreeSet<[i16; 3]> = left.iter().map(voxel).collect();
            new.iter().for_each(|v| *margins.entry(*v).or_insert(0.0f32) += MARGIN);
            if !new.is_subset(&voxels) {
                voxels.extend(&new);
                let before = std::mem::replace(&mut all, self.patch(&voxels));
                all.take(&before, true);
            }

            let mut part = self.patch(&new);
            part.take(&all, false);

            let labels = &part.level.labels;
            let margin: Vec<f32> = labels.labels.iter().map(|l| margins.get(&l.voxel).copied().unwrap_or(0.0)).collect();
            let problem = Problem { band: &part.level.band, labels, weights: self.weights, frozen: &part.frozen };
            summary.products[1] += problem.newton(&mut part.c, &margin, self.effort);

            all.take(&part, true);
            left = self.must_keep(Some(&all));

        }
        summary.refined = all.frozen.iter().filter(|f| !**f).count();
        summary.repaired = margins.len();
        summary.contradicted = left.len();
        let world = |l: &usize| mask.grid.to_world(Vector::from(voxel(l).map(f64::from))).into();
        summary.contradictions = left.iter().take(10).map(world).collect();
        let changed = |r: &band::Run| (0..r.len as usize).any(|i| !all.frozen[r.start as usize + i]);
        // What did not change is taken from the level before, exactly, beyond its band too.
        all.c.iter_mut().zip(&all.frozen).filter(|(_, f)| **f).for_each(|(c, _)| *c = f32::NAN);
        tile(mask, &all.level.band, &all.c, Some((&self.level.band, &self.c)), changed)
    }
}

impl Patch {
    /// Takes the coefficients that may change there from `other`; from then on they may change here too if `free`.
    fn take(&mut self, other: &Patch, free: bool) {
        for r in &self.level.band.runs {
            for (n, x) in (r.start as usize..(r.start + r.len) as usize).zip(r.x..) {
                if let Some(m) = other.level.band.place(x, r.y, r.z, 1).filter(|&m| !other.frozen[m as usize]) {
                    self.c[n] = other.c[m as usize];
                    self.frozen[n] &= !free;
                }
            }
        }
    }
}
