//! Sections of the mask by parallel planes, followed from plane to plane.

use crate::geometry::{Plane, Point, Vector};
use crate::mask::Mask;

/// A raster over the planes parallel to one plane. Depth is measured against the plane's normal, so that it grows into
/// a vessel whose end the plane closes. A sample is lumen where its nearest voxel is.
pub(super) struct Slices<'a> {
    mask: &'a Mask,
    plane: Plane,
    u: Vector,
    v: Vector,
    step: f64,
    half: i64,
    /// Index of the middle, and steps of the index along the raster's sides and by a millimetre of depth.
    base: Vector,
    du: Vector,
    dv: Vector,
    dn: Vector,
}

/// A part of one section: which samples of the raster it holds.
#[derive(Debug, Clone)]
pub(super) struct Slice {
    /// Row by row, (2 half + 1)² samples.
    pub own: Vec<bool>,
    /// Number of them.
    pub count: usize,
    /// Whether it goes on beyond the raster.
    pub clipped: bool,
}

impl<'a> Slices<'a> {
    /// A square raster that reaches `reach` mm to all sides of the plane's origin, its samples `step` mm apart.
    pub fn new(mask: &'a Mask, plane: &Plane, reach: f64, step: f64) -> Slices<'a> {
        let (u, v) = plane.basis();
        let base = mask.grid.to_index(&plane.origin);
        let along = |d: Vector| mask.grid.to_index(&(plane.origin + d)) - base;
        let (du, dv, dn) = (along(u * step), along(v * step), along(-plane.normal));
        Slices { mask, plane: *plane, u, v, step, half: (reach / step).ceil() as i64, base, du, dv, dn }
    }

    fn side(&self) -> i64 {
        2 * self.half + 1
    }

    /// Area that a number of samples stands for, mm².
    pub fn area(&self, count: usize) -> f64 {
        count as f64 * self.step * self.step
    }

    fn lumen(&self, n: usize, depth: f64) -> bool {
        let side = self.side();
        let (i, j) = (n as i64 % side - self.half, n as i64 / side - self.half);
        let x = self.base + self.du * i as f64 + self.dv * j as f64 + self.dn * depth;
        self.mask.at(x.x.round() as i64, x.y.round() as i64, x.z.round() as i64)
    }

    /// The place of a sample at a depth.
    pub fn at(&self, n: usize, depth: f64) -> Point {
        let side = self.side();
        let (i, j) = ((n as i64 % side - self.half) as f64, (n as i64 / side - self.half) as f64);
        self.plane.origin + (self.u * i + self.v * j) * self.step - self.plane.normal * depth
    }

    /// The connected part of the section at `depth` that holds the samples of `seeds`.
    fn grown(&self, seeds: impl Iterator<Item = usize>, depth: f64) -> Slice {
        let side = self.side() as usize;
        let mut own = vec![false; side * side];
        let mut looked_at = vec![false; side * side];
        let mut stack = Vec::new();
        let mut slice = Slice { own: Vec::new(), count: 0, clipped: false };
        let push = |n: usize, own: &mut Vec<bool>, looked_at: &mut Vec<bool>, stack: &mut Vec<usize>| {
            if !std::mem::replace(&mut looked_at[n], true) && self.lumen(n, depth) {
                own[n] = true;
                stack.push(n);
            }
        };
        for n in seeds {
            push(n, &mut own, &mut looked_at, &mut stack);
        }
        while let Some(n) = stack.pop() {
            slice.count += 1;
            let (i, j) = (n % side, n / side);
            if i == 0 || j == 0 || i + 1 == side || j + 1 == side {
                slice.clipped = true;
                continue;
            }
            for m in [n - 1, n + 1, n - side, n + side] {
                push(m, &mut own, &mut looked_at, &mut stack);
            }
        }
        Slice { own, ..slice }
    }

    /// The section at `depth` that holds the sample nearest to the origin, no farther from it than `near` mm.
    pub fn first(&self, depth: f64, near: f64) -> Option<Slice> {
        let reach = ((near / self.step).floor() as i64).min(self.half);
        let side = self.side();
        let mut around: Vec<(i64, usize)> = Vec::new();
        for j in -reach..=reach {
            for i in -reach..=reach {
                let n = (i + self.half) + (j + self.half) * side;
                around.push((i * i + j * j, n as usize));
            }
        }
        around.sort_unstable();
        let (_, seed) = around.into_iter().find(|&(_, n)| self.lumen(n, depth))?;
        Some(self.grown(std::iter::once(seed), depth))
    }

    /// What the section at `depth` has in common with a slice near by, grown to the connected parts that it belongs to.
    pub fn next(&self, slice: &Slice, depth: f64) -> Slice {
        self.grown((0..slice.own.len()).filter(|&n| slice.own[n]), depth)
    }

    /// Part of a slice's samples that are lumen at another depth.
    pub fn covered(&self, slice: &Slice, depth: f64) -> f64 {
        let lumen = (0..slice.own.len()).filter(|&n| slice.own[n] && self.lumen(n, depth)).count();
        lumen as f64 / slice.count.max(1) as f64
    }

    /// Middle of a slice, and the half axes of the ellipse of equal moments, longer first, mm.
    pub fn shape(&self, slice: &Slice, depth: f64) -> (Point, [f64; 2]) {
        let side = self.side();
        let (mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for n in (0..slice.own.len()).filter(|&n| slice.own[n]) {
            let (x, y) = ((n as i64 % side - self.half) as f64, (n as i64 / side - self.half) as f64);
            sx += x;
            sy += y;
            sxx += x * x;
            sxy += x * y;
            syy += y * y;
        }
        let count = slice.count.max(1) as f64;
        let (mx, my) = (sx / count, sy / count);
        let (xx, xy, yy) = (sxx / count - mx * mx + 1.0 / 12.0, sxy / count - mx * my, syy / count - my * my + 1.0 / 12.0);
        let (mean, root) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        let center = self.plane.origin + (self.u * mx + self.v * my) * self.step - self.plane.normal * depth;
        (center, [mean + root, (mean - root).max(1.0 / 12.0)].map(|l| 2.0 * l.sqrt() * self.step))
    }

    /// Part of a slice's rim beyond which, `away` mm from the middle, there is background at each of the depths.
    pub fn free_rim(&self, slice: &Slice, away: f64, depths: &[f64]) -> f64 {
        let side = self.side();
        let (mut sx, mut sy) = (0.0, 0.0);
        for n in (0..slice.own.len()).filter(|&n| slice.own[n]) {
            sx += (n as i64 % side) as f64;
            sy += (n as i64 / side) as f64;
        }
        let (mx, my) = (sx / slice.count.max(1) as f64, sy / slice.count.max(1) as f64);
        let (mut rim, mut free) = (0usize, 0usize);
        for n in (0..slice.own.len()).filter(|&n| slice.own[n]) {
            let (i, j) = (n as i64 % side, n as i64 / side);
            if i == 0 || j == 0 || i + 1 == side || j + 1 == side {
                continue;
            }
            let inner = [n - 1, n + 1, n - side as usize, n + side as usize].into_iter().all(|m| slice.own[m]);
            if inner {
                continue;
            }
            let (x, y) = (i as f64 - mx, j as f64 - my);
            let out = 1.0 + away / self.step / x.hypot(y).max(1.0);
            let (i, j) = ((mx + x * out).round() as i64, (my + y * out).round() as i64);
            rim += 1;
            let inside = (0..side).contains(&i) && (0..side).contains(&j);
            free += usize::from(inside && depths.iter().all(|&d| !self.lumen((i + j * side) as usize, d)));
        }
        free as f64 / rim.max(1) as f64
    }

    /// Whether the slice holds the sample at the foot of a point.
    pub fn holds(&self, slice: &Slice, p: &Point) -> bool {
        let d = p - self.plane.origin;
        let [i, j] = [self.u, self.v].map(|e| (d.dot(&e) / self.step).round() as i64);
        i.abs() <= self.half && j.abs() <= self.half && slice.own[((i + self.half) + (j + self.half) * self.side()) as usize]
    }
}
