//! Built-in synthetic vessels with an exact wall and exact ends; generated, never stored.

mod cases;
mod random;
mod samples;
mod solid;
mod tree;
mod truth;

use nalgebra::Matrix3;
use rayon::prelude::*;
use serde_json::{Value, json};

pub use random::Random;
pub use samples::{ClosedEnd, Sample, TrueEnd, kinds, sample, sample_by_name};
pub use solid::{PlaneSection, plane_section};
pub use tree::{TreeOptions, random_tree};
pub use truth::{Axis, Primitive, Shape, Truth};

use crate::geometry::{Plane, Point, Vector};
use crate::implicit::Implicit;
use crate::mask::{Grid, Mask};

/// Why a phantom cannot be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// There is no such phantom.
    #[error("there is no phantom \"{name}\"; there are {known}, each also with -anisotropic or -oblique behind its name, tree-SEED for other random trees, and KIND-SEED for samples with flat and hard ends (cuts-7); `lumenmesh phantom list` has the kinds")]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The names there are.
        known: String,
    },
}

/// The straight last piece of a vessel: an opening lies where it ends, or where it leaves the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Tip {
    /// A point of the axis before the end, inside the picture.
    pub from: Point,
    /// End of the axis; the vessel's round end lies beyond it.
    pub to: Point,
    /// Radii at `from` and `to`, mm.
    pub radii: [f64; 2],
}

/// An exact opening.
#[derive(Debug, Clone, PartialEq)]
pub struct End {
    /// `inlet`, `outlet_1`, ... by falling radius; the largest is the inlet.
    pub name: String,
    /// Plane across the axis; the normal points out of the vessel.
    pub plane: Plane,
    /// Exact radius there, mm.
    pub radius: f64,
    /// Whether the picture's border cuts the vessel; otherwise it ends within the picture.
    pub on_border: bool,
}

/// A synthetic vessel and the picture that is taken of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Phantom {
    /// Its name in [`list`], with the variant's ending.
    pub name: String,
    /// What it is, in a sentence.
    pub description: String,
    /// The exact wall.
    pub truth: Truth,
    /// The vessel's ends, in any order.
    pub tips: Vec<Tip>,
    /// Voxel spacing of its picture, mm.
    pub spacing: [f64; 3],
    /// Offset of the first voxel's centre from the corner of the picture, in voxels.
    pub offset: [f64; 3],
    /// Directions of the picture's axes, one a column.
    pub direction: Matrix3<f64>,
    /// Where the picture ends before the vessel does: lower and upper coordinate along each of the picture's axes, mm.
    pub window: [[Option<f64>; 2]; 3],
}

/// Voxels of background round a vessel that ends within the picture.
const MARGIN: f64 = 5.0;

/// Names of the built-in phantoms.
pub fn list() -> Vec<String> {
    let base = cases::NAMES.iter().map(|n| (*n).to_owned());
    base.clone().chain(base.map(|n| format!("{n}-anisotropic"))).collect()
}

/// Builds a phantom by name: one of [`list`], also with `-oblique` (a rotated, left-handed grid), or `tree-SEED`.
///
/// # Errors
/// [`Error::Unknown`] where there is none of that name.
pub fn build(name: &str) -> Result<Phantom, Error> {
    let (mut base, mut anisotropic, mut oblique) = (name, false, false);
    loop {
        if let Some(rest) = base.strip_suffix("-anisotropic") {
            (base, anisotropic) = (rest, true);
        } else if let Some(rest) = base.strip_suffix("-oblique") {
            (base, oblique) = (rest, true);
        } else {
            break;
        }
    }
    let seed = base.strip_prefix("tree-").and_then(|s| s.parse().ok());
    let found = match seed {
        Some(seed) => Some(random_tree(seed, &TreeOptions::default())),
        None => cases::build(base),
    };
    let mut phantom = found.ok_or_else(|| Error::Unknown { name: name.into(), known: cases::NAMES.join(", ") })?;
    phantom.name = name.into();
    if anisotropic {
        phantom.spacing[2] *= 2.5;
    }
    if oblique {
        phantom.direction = cases::oblique_left_handed();
        // The third axis is mirrored: what was its lower border is its upper one.
        phantom.window[2] = [phantom.window[2][1].map(|w| -w), phantom.window[2][0].map(|w| -w)];
    }
    Ok(phantom)
}

impl Phantom {
    /// The picture: voxel = 1 where the wall's value at its centre is not above 0.
    pub fn mask(&self) -> Mask {
        self.voxelize(self.spacing, self.offset, self.direction)
    }

    /// A picture with another spacing (mm), offset of the grid (voxels) and direction (an orthogonal matrix).
    ///
    /// The picture holds the whole vessel and a margin, save where [`Phantom::window`] cuts it.
    /// Panics where the spacing is not positive or the direction not orthogonal.
    pub fn voxelize(&self, spacing: [f64; 3], offset: [f64; 3], direction: Matrix3<f64>) -> Mask {
        let mut low = [0.0; 3];
        let mut dims = [1; 3];
        for a in 0..3 {
            let [from, to] = self.truth.extent(&direction.column(a).into_owned());
            low[a] = self.window[a][0].unwrap_or(from - MARGIN * spacing[a]);
            let high = self.window[a][1].unwrap_or(to + MARGIN * spacing[a]);
            low[a] += offset[a] * spacing[a];
            dims[a] = (((high - low[a]) / spacing[a]).floor() as usize).max(1) + 1;
        }
        let origin = Point::from(direction * Vector::from(low));
        let grid = match Grid::new(dims, spacing, origin, direction) {
            Ok(grid) => grid,
            Err(e) => panic!("a phantom's grid: {e}"),
        };
        let [nx, ny, _] = dims;
        let mut data = vec![0; grid.len()];
        data.par_chunks_mut(nx).enumerate().for_each(|(row, out)| {
            let (j, k) = ((row % ny) as f64, (row / ny) as f64);
            let mut i = 0;
            while i < nx {
                let d = self.truth.value(&grid.to_world(Vector::new(i as f64, j, k)));
                out[i] = u8::from(d <= 0.0);
                // The value changes by less than twice the way: blends and tapers are gentle.
                i += ((d.abs() / (2.0 * spacing[0])) as usize).max(1);
                if d <= 0.0 {
                    let end = i.min(nx);
                    let from = (0..end).rev().take_while(|&n| out[n] == 0).last().unwrap_or(end);
                    out[from..end].fill(1);
                }
            }
        });
        Mask::new(grid, data)
    }

    /// The exact openings in a picture of this phantom.
    pub fn ends(&self, grid: &Grid) -> Vec<End> {
        let mut ends: Vec<End> = self.tips.iter().filter_map(|t| end_of(t, grid)).collect();
        ends.sort_by(|a, b| b.radius.total_cmp(&a.radius));
        for (n, end) in ends.iter_mut().enumerate() {
            end.name = if n == 0 { "inlet".into() } else { format!("outlet_{n}") };
        }
        ends
    }

    /// Everything that is known exactly, for other programs: name, primitives, ends of the picture.
    pub fn truth_json(&self, grid: &Grid) -> Value {
        let ends: Vec<Value> = self
            .ends(grid)
            .iter()
            .map(|e| {
                let (c, n) = (e.plane.origin, e.plane.normal);
                json!({
                    "name": e.name,
                    "center": [c.x, c.y, c.z],
                    "normal": [n.x, n.y, n.z],
                    "radius": e.radius,
                    "where": if e.on_border { "border" } else { "inside" },
                })
            })
            .collect();
        json!({
            "name": self.name,
            "note": self.description,
            "units": "mm",
            "coordinates": "LPS",
            "prims": self.truth.json(),
            "formula": "f = prims[0]; for q in prims[1:]: b = q; f = min(f, b) - h*h*k/4 with h = max(k - |f - b|, 0)/k where q has k, else min(f, b); a voxel is 1 where f(centre) <= 0",
            "spacing": grid.spacing(),
            "ends": ends,
        })
    }

    /// A case file that meshes this phantom's mask.
    pub fn case_yaml(&self, mask_file: &str) -> String {
        format!("# {}\ninput:\n  mask: {mask_file}\n", self.description)
    }
}

/// Where a tip's axis ends or leaves the box of voxels.
fn end_of(tip: &Tip, grid: &Grid) -> Option<End> {
    let (a, b) = (grid.to_index(&tip.from), grid.to_index(&tip.to));
    let mut t = 1.0f64;
    for axis in 0..3 {
        let step = b[axis] - a[axis];
        let wall = if step > 0.0 { grid.dims[axis] as f64 - 0.5 } else { -0.5 };
        if step != 0.0 {
            t = t.min(((wall - a[axis]) / step).max(0.0));
        }
    }
    let plane = Plane::new(tip.from + (tip.to - tip.from) * t, tip.to - tip.from)?;
    let radius = tip.radii[0] + t * (tip.radii[1] - tip.radii[0]);
    Some(End { name: String::new(), plane, radius, on_border: t < 1.0 })
}

#[cfg(test)]
mod tests;
