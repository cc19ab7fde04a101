//! Plane sections of the mask.

use crate::geometry::{Plane, Point};
use crate::mask::Mask;

/// The connected piece of lumen that a plane cuts at a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// Area, mm².
    pub area: f64,
    /// Middle of the area, LPS mm.
    pub center: Point,
    /// Largest distance of the section from the point asked for, mm.
    pub reach: f64,
    /// Ratio of the longer to the shorter axis of the ellipse of equal moments.
    pub aspect: f64,
    /// Whether the section goes on beyond the distance asked for.
    pub clipped: bool,
    /// Distance of the samples, mm.
    step: f64,
    /// Samples from the middle of a row to its end.
    half: i64,
    /// Which of the samples are the section's.
    own: Vec<bool>,
}

impl Section {
    /// The samples of the section of `plane`.
    pub fn points<'a>(&'a self, plane: &Plane) -> impl Iterator<Item = Point> + 'a {
        let (u, v) = plane.basis();
        let (u, v, origin) = (u * self.step, v * self.step, plane.origin);
        let side = 2 * self.half + 1;
        let own = (0..side * side).filter(|&n| self.own[n as usize]);
        own.map(move |n| origin + u * (n % side - self.half) as f64 + v * (n / side - self.half) as f64)
    }

    /// Whether a point of `plane`, the plane of the section, is in the section.
    pub fn holds(&self, plane: &Plane, p: &Point) -> bool {
        let (u, v) = plane.basis();
        let d = p - plane.origin;
        let [i, j] = [u, v].map(|e| (d.dot(&e) / self.step).round() as i64);
        i.abs() <= self.half && j.abs() <= self.half && self.own[((i + self.half) + (j + self.half) * (2 * self.half + 1)) as usize]
    }
}

/// Samples a side: bounds the work where a section is wide.
const MOST: f64 = 200.0;

/// The section of `mask` by `plane` at the plane's origin, no farther out than `limit` mm; `None` outside the lumen.
///
/// Exact for the mask interpolated linearly, but for a sampling of half a voxel (coarser in sections of more than
/// 100 voxels).
pub fn section(mask: &Mask, plane: &Plane, limit: f64) -> Option<Section> {
    let spacing = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    let step = (0.5 * spacing).max(2.0 * limit / MOST);
    let n = (limit / step).ceil() as i64;
    let side = (2 * n + 1) as usize;
    let (u, v) = plane.basis();
    let at = |i: i64, j: i64| plane.origin + u * (i as f64 * step) + v * (j as f64 * step);
    if lumen(mask, &plane.origin) < 0.5 {
        return None;
    }
    let mut seen = vec![false; side * side];
    let mut own = vec![false; side * side];
    let index = |i: i64, j: i64| ((i + n) + (j + n) * side as i64) as usize;
    let mut stack = vec![(0i64, 0i64)];
    seen[index(0, 0)] = true;
    let (mut count, mut reach, mut clipped) = (0.0, 0.0f64, false);
    let (mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    while let Some((i, j)) = stack.pop() {
        let (x, y) = (i as f64 * step, j as f64 * step);
        count += 1.0;
        own[index(i, j)] = true;
        sx += x;
        sy += y;
        sxx += x * x;
        sxy += x * y;
        syy += y * y;
        reach = reach.max(x.hypot(y));
        for (a, b) in [(i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)] {
            if a.abs() > n || b.abs() > n || (a * a + b * b) as f64 * step * step > limit * limit {
                clipped = clipped || lumen(mask, &at(a, b)) >= 0.5;
            } else if !seen[index(a, b)] {
                seen[index(a, b)] = true;
                if lumen(mask, &at(a, b)) >= 0.5 {
                    stack.push((a, b));
                }
            }
        }
    }
    let (mx, my) = (sx / count, sy / count);
    let cell = step * step / 12.0;
    let (xx, xy, yy) = (sxx / count - mx * mx + cell, sxy / count - mx * my, syy / count - my * my + cell);
    let mean = 0.5 * (xx + yy);
    let root = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    Some(Section {
        area: count * step * step,
        center: plane.origin + u * mx + v * my,
        reach: reach + 0.5 * step,
        aspect: ((mean + root) / (mean - root).max(cell)).sqrt(),
        clipped,
        step,
        half: n,
        own,
    })
}

/// The mask interpolated linearly: 0 to 1.
fn lumen(mask: &Mask, p: &Point) -> f64 {
    let x = mask.grid.to_index(p);
    let base = [0, 1, 2].map(|a| x[a].floor());
    let frac = [0, 1, 2].map(|a| x[a] - base[a]);
    let base = base.map(|b| b as i64);
    let mut sum = 0.0;
    for corner in 0..8 {
        let d = [0, 1, 2].map(|a| i64::from(corner >> a & 1));
        if mask.at(base[0] + d[0], base[1] + d[1], base[2] + d[2]) {
            sum += (0..3).map(|a| if d[a] == 1 { frac[a] } else { 1.0 - frac[a] }).product::<f64>();
        }
    }
    sum
}
