//! Centerlines with the radius of the largest inscribed sphere.
//!
//! [`trace`] thins the mask in the order of its exact distance transform, holding the geodesic tips, so that
//! the curves have the mask's loops and a free end at each tip and nowhere else; spurs are pruned, and the
//! curves are centred below the voxel by the outlines of their sections. [`refine`] does the last step on the
//! implicit surface instead of the voxels.

mod axis;
mod curve;
mod field;
mod graph;
mod places;
mod ring;
mod thin;
mod tips;

pub use places::{ClosePlace, ThinPlace, close_places, thin_places};

use rayon::prelude::*;
use serde::Serialize;

use crate::geometry::{Point, Vector};
use crate::implicit::Implicit;
use crate::mask::Mask;

/// A sample of a centerline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Position on the axis, mm.
    pub point: Point,
    /// Radius of the largest inscribed sphere there, mm. In the last stretch before a free end, where only ever
    /// smaller spheres fit, that of the last full one.
    pub radius: f64,
    /// Unit tangent in the direction of the branch's samples.
    pub tangent: Vector,
    /// Arc length from the branch's first sample, mm.
    pub arc_length: f64,
}

/// What a branch ends in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndKind {
    /// A node shared with other branches.
    Junction,
    /// A free end: a tip of the vessel.
    Free,
}

/// A piece of vessel between two nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Samples from the first node to the last, evenly spaced in arc length.
    pub samples: Vec<Sample>,
    /// Node ids of the first and the last sample.
    pub nodes: [u32; 2],
    /// What the two ends are.
    pub ends: [EndKind; 2],
    /// Connected component of the mask (26 neighbours): 0 is the largest, ties by the first voxel.
    pub component: u32,
}

impl Branch {
    /// Arc length of the branch, mm.
    pub fn length(&self) -> f64 {
        self.samples.last().map_or(0.0, |s| s.arc_length)
    }
}

/// All centerlines of a mask.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Centerlines {
    /// Branches; a loop is a branch or a chain of branches that returns to its node.
    pub branches: Vec<Branch>,
    /// Positions of the nodes.
    pub nodes: Vec<Point>,
}

impl Centerlines {
    /// Length of all branches, mm.
    pub fn length(&self) -> f64 {
        self.branches.iter().map(Branch::length).sum()
    }

    /// Number of branch ends at each node: 1 at a free end, 2 for the node of a lone ring, 3 and more at bifurcations.
    pub fn degrees(&self) -> Vec<u32> {
        let mut d = vec![0; self.nodes.len()];
        for n in self.branches.iter().flat_map(|b| b.nodes) {
            d[n as usize] += 1;
        }
        d
    }

    /// Bifurcation group of each node: junctions joined by a branch shorter than the larger of the radii at its
    /// ends belong together. `None` for free ends. Groups are numbered by their first node.
    pub fn groups(&self) -> Vec<Option<u32>> {
        let degree = self.degrees();
        let mut root: Vec<usize> = (0..self.nodes.len()).collect();
        fn find(root: &mut [usize], mut n: usize) -> usize {
            while root[n] != n {
                root[n] = root[root[n]];
                n = root[n];
            }
            n
        }
        for b in &self.branches {
            let [Some(first), Some(last)] = [b.samples.first(), b.samples.last()] else { continue };
            let inner = b.ends == [EndKind::Junction; 2];
            if inner && b.length() < first.radius.max(last.radius) {
                let [x, y] = b.nodes.map(|n| find(&mut root, n as usize));
                root[x.max(y)] = x.min(y);
            }
        }
        let mut number = vec![None; self.nodes.len()];
        let mut next = 0;
        (0..self.nodes.len())
            .map(|n| {
                if degree[n] < 3 {
                    return None;
                }
                let r = find(&mut root, n);
                Some(*number[r].get_or_insert_with(|| {
                    next += 1;
                    next - 1
                }))
            })
            .collect()
    }
}

/// How centerlines are traced.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CenterlineOptions {
    /// Free ends that reach less than this many radii (of their junction) from their junction are spurs.
    pub spur_radii: f64,
    /// Distance of samples, in radii of the branch.
    pub sample_radii: f64,
    /// Components with fewer voxels get no centerline.
    pub min_voxels: usize,
}

impl Default for CenterlineOptions {
    fn default() -> Self {
        CenterlineOptions { spur_radii: 1.2, sample_radii: 0.25, min_voxels: 8 }
    }
}

/// Why there are no centerlines.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// Nothing to trace.
    #[error("the mask has no lumen voxel: check the label or threshold that selects the lumen")]
    Empty,
    /// All components are too small.
    #[error("the mask holds no vessel: its largest part has {voxels} voxels at {center:?} (LPS mm), too few for a centerline: check the label or threshold that selects the lumen, or segment the vessel at a finer spacing")]
    TooSmall {
        /// Voxels of the largest component.
        voxels: usize,
        /// One of its voxels, LPS mm.
        center: [f64; 3],
    },
    /// More voxels than 32 bits can number.
    #[error("the lumen's bounding box has {0} voxels, more than 4 294 967 295: crop or resample the mask")]
    TooLarge(usize),
}

/// What tracing found.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Branches.
    pub branches: usize,
    /// Free ends.
    pub free_ends: usize,
    /// Nodes where three or more branches meet.
    pub junctions: usize,
    /// Independent loops.
    pub loops: usize,
    /// Components with a centerline.
    pub components: usize,
    /// Components too small for one.
    pub skipped_components: usize,
    /// Cavity voxels treated as lumen.
    pub filled_voxels: usize,
    /// Spurs pruned.
    pub pruned: usize,
    /// Length of all branches, mm.
    pub length: f64,
    /// Smallest and largest inscribed radius, mm.
    pub radius: [f64; 2],
}

/// Centerlines of every component of `mask`.
///
/// Guaranteed: the number of loops is that of the mask's tunnels (26-connected lumen, cavities filled); curves
/// are the same for any number of threads. Where the vessel runs out of the picture they run on through the
/// padding. A round section's middle is met within about 0.1 voxel; in a junction, whose axis is a matter of
/// definition, only the distance transform's ridge is followed.
pub fn trace(mask: &Mask, options: &CenterlineOptions) -> Result<(Centerlines, Summary), Error> {
    if mask.grid.len() >= u32::MAX as usize {
        return Err(Error::TooLarge(mask.grid.len()));
    }
    let field = field::Field::new(mask).ok_or(Error::Empty)?;
    let tips = tips::find(&field, options.min_voxels);
    if tips.is_empty() {
        let largest = field.component.iter().position(|&c| c == 0).unwrap_or(0);
        let voxels = field.component.iter().filter(|&&c| c == 0).count();
        return Err(Error::TooSmall { voxels, center: field.position(largest as u32).into() });
    }
    let kept = thin::thin(&field, &tips);
    let mut graph = graph::Graph::new(&field, &kept);
    let pruned = graph.prune(&field, options.spur_radii);
    let lines = axis::lines(&field, &graph, options);
    let mut sizes = vec![false; field.components];
    lines.branches.iter().for_each(|b| sizes[b.component as usize] = true);
    let components = sizes.iter().filter(|&&s| s).count();
    let degrees = lines.degrees();
    let radius = lines.branches.iter().flat_map(|b| &b.samples).fold([f64::INFINITY, 0.0f64], |[l, h], s| {
        [l.min(s.radius), h.max(s.radius)]
    });
    let summary = Summary {
        branches: lines.branches.len(),
        free_ends: degrees.iter().filter(|&&d| d == 1).count(),
        junctions: degrees.iter().filter(|&&d| d > 2).count(),
        loops: (lines.branches.len() + components).saturating_sub(lines.nodes.len()),
        components,
        skipped_components: field.components - components,
        filled_voxels: field.filled,
        pruned,
        length: lines.length(),
        radius,
    };
    Ok((lines, summary))
}

/// Centres the curves on the implicit surface and measures the inscribed radius there: free of voxel stairs.
/// Nodes and free ends stay; samples in a junction keep their place and get a radius no larger than before.
pub fn refine(lines: &mut Centerlines, surface: &dyn Implicit) {
    lines.branches.par_iter_mut().for_each(|b| axis::refine(b, surface));
}

#[cfg(test)]
mod tests;
