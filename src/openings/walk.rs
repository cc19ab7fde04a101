//! A branch as seen from its free end.

use super::axis::axis;
use super::section::section;
use crate::centerline::{Branch, EndKind};
use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;

/// A branch seen from its free end.
pub(super) struct Walk {
    pub point: Vec<Point>,
    /// Unit tangents towards the tip.
    pub outward: Vec<Vector>,
    pub radius: Vec<f64>,
    /// Distance from the tip along the axis.
    pub arc: Vec<f64>,
    /// The other end is a junction with this radius.
    pub junction: Option<f64>,
}

impl Walk {
    pub fn new(branch: &Branch, end: usize) -> Walk {
        let mut s = branch.samples.clone();
        let sign = if end == 0 { -1.0 } else { 1.0 };
        if end == 1 {
            s.reverse();
        }
        let total = branch.length();
        let arc = s.iter().map(|s| if end == 0 { s.arc_length } else { total - s.arc_length }).collect();
        let radius: Vec<f64> = s.iter().map(|s| s.radius).collect();
        let junction = (branch.ends[1 - end] == EndKind::Junction).then(|| radius[radius.len() - 1]);
        Walk { point: s.iter().map(|s| s.point).collect(), outward: s.iter().map(|s| s.tangent * sign).collect(), radius, arc, junction }
    }

    pub fn total(&self) -> f64 {
        self.arc[self.arc.len() - 1]
    }

    /// Samples outside the junction's sphere.
    pub fn free(&self) -> usize {
        let reach = self.total() - self.junction.unwrap_or(0.0);
        self.arc.partition_point(|&t| t < reach).max(1)
    }

    /// Length outside the junction's sphere and the largest radius there.
    pub fn outside(&self) -> (f64, f64) {
        let n = self.free();
        let length = (self.total() - self.junction.unwrap_or(0.0)).max(0.0);
        (length, self.radius[..n].iter().fold(0.0, |a, &b| a.max(b)))
    }

    /// Position, outward direction and radius at a distance from the tip; the direction is averaged over
    /// half a radius towards the tip and one radius away from it.
    pub fn at(&self, t: f64) -> (Point, Vector, f64) {
        let i = self.arc.partition_point(|&a| a < t).clamp(1, self.arc.len() - 1);
        let f = ((t - self.arc[i - 1]) / (self.arc[i] - self.arc[i - 1])).clamp(0.0, 1.0);
        let p = self.point[i - 1] + (self.point[i] - self.point[i - 1]) * f;
        let r = self.radius[i - 1] + (self.radius[i] - self.radius[i - 1]) * f;
        let own = self.outward[i - 1] * (1.0 - f) + self.outward[i] * f;
        let mut d = own * 1e-6;
        for j in 0..self.free() {
            let x = (self.arc[j] - t) / r;
            let w = if x < 0.0 { 1.0 + x / 0.5 } else { 1.0 - x / 1.0 };
            if w > 0.0 {
                d += self.outward[j] * w;
            }
        }
        (p, d.try_normalize(0.0).unwrap_or(own), r)
    }

    /// Position, direction square to the sections, and radius at a distance from the tip.
    ///
    /// Near a tip the centerline may turn aside by more than a right angle's half: its direction there, a radius and
    /// two further in, and the way from there are each made square; the one with the smallest section half a radius
    /// further in, away from the tip, is the vessel's.
    pub fn square(&self, mask: &Mask, t: f64, inwards: f64) -> (Point, Vector, f64) {
        let (p, own, r) = self.at(t);
        let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
        let far = t + (2.0 * r).min(inwards);
        let further: [(Point, Vector, f64); 2] = [0.5, 1.0].map(|f| self.at(t + f * (far - t)));
        let mut guesses = vec![own, further[0].1, further[1].1];
        guesses.extend((p - further[1].0).try_normalize(0.1 * r));
        let cross = |plane: &Plane| {
            let s = section(mask, plane, 3.0 * r + 2.0 * voxel).filter(|s| !s.clipped)?;
            Some((s.center, s.area))
        };
        let mut best: Option<(f64, Point, Vector)> = None;
        for guess in guesses {
            if best.as_ref().is_some_and(|b| b.2.dot(&guess) > 0.98) {
                continue;
            }
            let (q, d) = axis(&p, &guess, r, mask.grid.spacing(), inwards, cross);
            let inside = Plane::new(q - d * (0.5 * r).min(inwards), d);
            let area = inside.and_then(|plane| section(mask, &plane, 4.0 * r + 2.0 * voxel)).map_or(f64::INFINITY, |s| s.area);
            if best.as_ref().is_none_or(|b| area < 0.97 * b.0) {
                best = Some((area, q, d));
            }
        }
        best.map_or((p, own, r), |b| (b.1, b.2, r))
    }
}
