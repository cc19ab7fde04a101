//! The lumen in an opening's plane, whatever its shape.

use crate::geometry::{Plane, Point, Vector};
use crate::implicit::Implicit;

/// Lattice points across the radius of the opening at least.
const ACROSS: f64 = 12.0;
/// Radii of the opening round its middle that are looked at.
const FAR: f64 = 8.0;

/// The piece of lumen in a plane that hangs together with the opening's middle, as points of a square lattice.
#[derive(Debug, Clone)]
pub(super) struct Section {
    origin: Point,
    u: Vector,
    v: Vector,
    spacing: f64,
    /// Lattice points from −half to half along both axes.
    half: i64,
    inside: Vec<bool>,
}

impl Section {
    /// `None` where there is no lumen at the middle.
    pub(super) fn new(surface: &dyn Implicit, plane: &Plane, radius: f64) -> Option<Section> {
        let (u, v) = plane.basis();
        let spacing = (0.5 * surface.resolution()).min(radius / ACROSS);
        let half = (FAR * radius / spacing).ceil() as i64;
        let size = (2 * half + 1) as usize;
        let mut section = Section { origin: plane.origin, u, v, spacing, half, inside: vec![false; size * size] };
        let lumen = |s: &Section, c: [i64; 2]| surface.value(&s.point(c)) < 0.0;
        // The middle of a bent section lies beside it.
        let start = (0..=half)
            .flat_map(|r| (-r..=r).flat_map(move |i| [[i, -r], [i, r], [-r, i], [r, i]]))
            .take_while(|c| c[0].abs().max(c[1].abs()) as f64 * spacing <= radius)
            .find(|&c| lumen(&section, c))?;
        let mut stack = vec![start];
        while let Some(c) = stack.pop() {
            let Some(n) = section.index(c) else { continue };
            if section.inside[n] || !lumen(&section, c) {
                continue;
            }
            section.inside[n] = true;
            stack.extend([[1, 0], [-1, 0], [0, 1], [0, -1]].map(|d| [c[0] + d[0], c[1] + d[1]]));
        }
        Some(section)
    }

    fn index(&self, c: [i64; 2]) -> Option<usize> {
        let size = 2 * self.half + 1;
        let within = c.iter().all(|x| x.abs() <= self.half);
        within.then(|| ((c[1] + self.half) * size + c[0] + self.half) as usize)
    }

    fn point(&self, c: [i64; 2]) -> Point {
        self.origin + self.u * (c[0] as f64 * self.spacing) + self.v * (c[1] as f64 * self.spacing)
    }

    /// Its lattice points.
    pub(super) fn points(&self) -> impl Iterator<Item = Point> + '_ {
        let size = 2 * self.half + 1;
        self.inside.iter().enumerate().filter(|(_, inside)| **inside).map(move |(n, _)| {
            let n = n as i64;
            self.point([n % size - self.half, n / size - self.half])
        })
    }

    /// Area, mm², to the share of the lattice's cells.
    pub(super) fn area(&self) -> f64 {
        self.inside.iter().filter(|&&i| i).count() as f64 * self.spacing * self.spacing
    }

    /// Mean of its points.
    pub(super) fn centroid(&self) -> Point {
        let (sum, count) = self.points().fold((Vector::zeros(), 0.0), |(s, n), p| (s + (p - self.origin), n + 1.0));
        self.origin + sum / f64::max(count, 1.0)
    }

    /// Whether a point of the plane lies in it.
    pub(super) fn holds(&self, p: &Point) -> bool {
        let q = (p - self.origin) / self.spacing;
        self.index([q.dot(&self.u).round() as i64, q.dot(&self.v).round() as i64]).is_some_and(|n| self.inside[n])
    }

    /// Radius of the largest circle inside, mm, to the lattice's spacing.
    pub(super) fn inscribed(&self) -> f64 {
        // Peeled ring by ring: the number of rings is the depth.
        let mut left = self.inside.clone();
        let size = 2 * self.half + 1;
        let mut depth = 0.0;
        while left.iter().any(|&l| l) {
            let stays = |n: usize| {
                let c = [n as i64 % size - self.half, n as i64 / size - self.half];
                let near = [[1, 0], [-1, 0], [0, 1], [0, -1]];
                // Every other ring by the eight neighbours too: near to a circle.
                let all = near.iter().chain([[1, 1], [1, -1], [-1, 1], [-1, -1]].iter().filter(|_| depth as i64 % 2 == 1));
                all.map(|d| [c[0] + d[0], c[1] + d[1]]).all(|c| self.index(c).is_some_and(|m| left[m]))
            };
            left = (0..left.len()).map(|n| left[n] && stays(n)).collect();
            depth += 1.0;
        }
        f64::max(depth - 0.5, 0.5) * self.spacing
    }
}
