//! From a solid and its ends to a fair sample.

use nalgebra::Matrix3;

use super::{ClosedEnd, Sample, TrueEnd};
use crate::geometry::{Plane, Point, Vector};
use crate::mask::{Connectivity, Grid, Mask, label};
use crate::phantom::Random;
use crate::phantom::solid::{Solid, plane_section};

/// Most voxels of a sample.
const MOST_VOXELS: f64 = 3e6;

/// Cells across half the reach of an exact section.
const CELLS: f64 = 150.0;

/// What the image holds, between the outer faces of its border voxels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub low: Vector,
    pub high: Vector,
    pub spacing: Vector,
}

impl Frame {
    /// At least as much as asked for: `high` moves outwards to the next voxel face.
    pub(super) fn new(low: Vector, high: Vector, spacing: [f64; 3]) -> Frame {
        let spacing = Vector::from(spacing);
        let counts = (high - low).component_div(&spacing).map(|n| (n - 1e-9).ceil().max(1.0));
        Frame { low, high: low + counts.component_mul(&spacing), spacing }
    }

    fn voxels(&self) -> f64 {
        (self.high - self.low).component_div(&self.spacing).product()
    }

    fn holds(&self, p: &Point) -> bool {
        (0..3).all(|a| self.low[a] < p[a] && p[a] < self.high[a])
    }

    fn grid(&self) -> Option<Grid> {
        let dims = [0, 1, 2].map(|a| ((self.high[a] - self.low[a]) / self.spacing[a]).round() as usize);
        let origin = Point::from(self.low + self.spacing * 0.5);
        Grid::new(dims, self.spacing.into(), origin, Matrix3::identity()).ok()
    }
}

/// An end as it was made.
#[derive(Debug, Clone)]
pub(super) struct Cap {
    pub plane: Plane,
    pub axis: Vector,
    /// Radius of a round vessel; otherwise the sections are measured.
    pub radius: Option<f64>,
    /// No section of it is farther from the middle, mm.
    pub reach: f64,
    pub flat: bool,
    pub on_border: bool,
    pub diameters: Option<f64>,
    pub kind: &'static str,
}

impl Cap {
    /// A round vessel cut flat.
    pub(super) fn flat(at: Point, normal: Vector, axis: Vector, radius: f64, kind: &'static str) -> Option<Cap> {
        let plane = Plane::new(at, normal)?;
        Some(Cap { plane, axis: axis.normalize(), radius: Some(radius), reach: 4.0 * radius, flat: true, on_border: false, diameters: None, kind })
    }

    /// A round tip: the axis ends at `at`.
    pub(super) fn round(at: Point, axis: Vector, radius: f64, kind: &'static str) -> Option<Cap> {
        Some(Cap { flat: false, ..Cap::flat(at, axis, axis, radius, kind)? })
    }

    /// The image border cuts the vessel: the plane through `at` square to the image's axis along `normal`.
    pub(super) fn border(at: Point, normal: Vector, axis: Vector, radius: f64, kind: &'static str) -> Option<Cap> {
        Some(Cap { on_border: true, ..Cap::flat(at, normal, axis, radius, kind)? })
    }

    /// The same end of a vessel that is not round: its sections are measured and its middle becomes their centroid.
    pub(super) fn measured(self) -> Cap {
        Cap { radius: None, ..self }
    }

    fn tilt(&self) -> f64 {
        self.plane.normal.dot(&self.axis).clamp(-1.0, 1.0).acos()
    }
}

/// A sample before its voxels are made.
#[derive(Debug, Clone)]
pub(super) struct Draft {
    pub description: String,
    pub solid: Solid,
    pub frame: Frame,
    pub caps: Vec<Cap>,
    pub closed: Vec<ClosedEnd>,
    /// Whether the image's axes may be permuted and reversed.
    pub turns: bool,
    /// Whether ends may lie side by side, as the lumens of a dissection do.
    pub beside: bool,
}

impl Draft {
    /// The sample, or `None` where it is too large or an end is not fair.
    pub(super) fn finish(self, name: String, random: &mut Random) -> Option<Sample> {
        let coarse = self.frame.spacing.max();
        if self.frame.voxels() > MOST_VOXELS || self.caps.iter().any(|c| c.radius.is_some_and(|r| r < 2.0 * coarse)) {
            return None;
        }
        let mut ends: Vec<TrueEnd> = self.caps.iter().map(|c| self.end(c)).collect::<Option<_>>()?;
        let grid = self.frame.grid()?;
        let data = self.solid.voxelize(&grid);
        let mask = largest(Mask::new(grid, data));
        if ends.iter().any(|e| !fair(&mask, e, coarse)) || !self.beside && !apart(&ends) {
            return None;
        }
        ends.sort_by(|a, b| b.area.total_cmp(&a.area));
        for (n, end) in ends.iter_mut().enumerate() {
            end.name = if n == 0 { "inlet".into() } else { format!("outlet_{n}") };
        }
        let mask = if self.turns { turned(&mask, random)? } else { mask };
        Some(Sample { name, description: self.description, mask, ends, closed: self.closed })
    }

    /// Whether a point lies in the vessel and in the image.
    pub(super) fn holds(&self, p: &Point) -> bool {
        self.frame.holds(p) && self.solid.holds(p)
    }

    fn end(&self, cap: &Cap) -> Option<TrueEnd> {
        let section = |plane: &Plane| plane_section(|p| self.holds(p), plane, [cap.reach, 0.3 * cap.reach, cap.reach / CELLS]);
        let shifted = |p: &Plane, by: f64| Plane { origin: p.origin + p.normal * by, normal: p.normal };
        let mut plane = cap.plane;
        let circle = cap.radius.map(|r| std::f64::consts::PI * r * r);
        let cap_area = match circle {
            Some(area) if !cap.flat => area,
            _ => {
                let found = section(&shifted(&plane, -1e-6))?;
                if cap.radius.is_none() {
                    plane.origin = plane.project(&found.centroid);
                }
                found.area
            }
        };
        let area = match circle {
            // A slanted cut of a straight round vessel is an ellipse; far from one, something else is cut too.
            Some(area) => {
                let want = area / cap.tilt().cos();
                if !(0.8 * want..=1.3 * want).contains(&cap_area) {
                    return None;
                }
                area
            }
            None if cap.tilt() < 0.02 => cap_area,
            // Far enough inside for the whole section.
            None => section(&shifted(&Plane::new(plane.origin, cap.axis)?, -(cap_area / 2.0).sqrt() * cap.tilt().tan() - 1e-6))?.area,
        };
        Some(TrueEnd {
            name: String::new(),
            plane,
            axis: cap.axis,
            radius: (area / std::f64::consts::PI).sqrt(),
            area,
            cap_area,
            flat: cap.flat,
            on_border: cap.on_border,
            diameters: cap.diameters,
            kind: cap.kind,
        })
    }
}

/// The largest component alone.
fn largest(mut mask: Mask) -> Mask {
    let labels = label(&mask, true, Connectivity::Six);
    let parts = labels.components();
    let Some(most) = (0..parts.len()).max_by_key(|&n| (parts[n].voxels, std::cmp::Reverse(n))) else { return mask };
    mask.data.fill(0);
    let [nx, ny, _] = mask.grid.dims;
    labels.for_each_run(most as u32, |j, k, first, behind| mask.data[(k * ny + j) * nx + first..(k * ny + j) * nx + behind].fill(1));
    mask
}

/// Whether an end is one that a person would see: wide enough, the whole face there and nothing beyond it.
fn fair(mask: &Mask, end: &TrueEnd, coarse: f64) -> bool {
    if end.tilt() > 50.0 || end.radius < 2.0 * coarse {
        return false;
    }
    let at = |p: &Point| {
        let i = mask.grid.to_index(p).map(|c| c.round() as i64);
        mask.at(i.x, i.y, i.z)
    };
    let step = 0.7 * mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    let reach = 4.0 * (end.cap_area / std::f64::consts::PI).sqrt();
    let shift = |by: f64| Plane { origin: end.plane.origin + end.plane.normal * by, normal: end.plane.normal };
    let Some(face) = plane_section(at, &shift(-coarse), [reach, step, step]) else { return false };
    let whole = (0.8..=1.3).contains(&(face.area / end.cap_area));
    // A round tip goes on beyond its plane, by its radius.
    let beyond = if end.flat { coarse } else { end.radius + 2.0 * coarse };
    let covered = face.cells.iter().filter(|p| at(&(**p + end.plane.normal * (coarse + beyond)))).count();
    whole && covered as f64 <= 0.1 * face.cells.len() as f64
}

/// Whether no two ends touch.
fn apart(ends: &[TrueEnd]) -> bool {
    ends.iter().enumerate().all(|(n, e)| {
        ends[..n].iter().all(|f| {
            let slant = e.tilt().max(f.tilt()).to_radians().cos();
            (e.plane.origin - f.plane.origin).norm() >= (e.radius + f.radius) / slant
        })
    })
}

/// The same mask with the image's axes permuted and some reversed; the world stays as it is.
fn turned(mask: &Mask, random: &mut Random) -> Option<Mask> {
    let order = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]][random.below(6)];
    let reversed = [0, 1, 2].map(|_| random.below(2) == 1);
    let from = &mask.grid;
    let dims = order.map(|a| from.dims[a]);
    let mut corner = Vector::zeros();
    let mut direction = Matrix3::zeros();
    for (n, &a) in order.iter().enumerate() {
        corner[a] = if reversed[n] { from.dims[a] as f64 - 1.0 } else { 0.0 };
        direction.set_column(n, &(from.direction().column(a) * if reversed[n] { -1.0 } else { 1.0 }));
    }
    let spacing = order.map(|a| from.spacing()[a]);
    let grid = Grid::new(dims, spacing, from.to_world(corner), direction).ok()?;
    let mut data = vec![0; grid.len()];
    for (n, out) in data.iter_mut().enumerate() {
        let v = grid.voxel(n);
        let mut w = [0; 3];
        for (n, &a) in order.iter().enumerate() {
            w[a] = if reversed[n] { from.dims[a] - 1 - v[n] } else { v[n] };
        }
        *out = mask.data[(w[2] * from.dims[1] + w[1]) * from.dims[0] + w[0]];
    }
    Some(Mask::new(grid, data))
}
