//! Solids of which random samples are put together, their voxels, and sections through them.

use nalgebra::Matrix3;

use super::{Shape, Truth};
use crate::geometry::{Aabb, Plane, Point, Vector};
use crate::implicit::Implicit;
use crate::mask::Grid;

/// A simple body.
#[derive(Debug, Clone)]
pub(super) enum Body {
    /// A ball, a capsule or a bent tube.
    Round(Shape),
    /// An ellipsoid with the unit columns of `axes` as axes.
    Ellipsoid { center: Point, axes: Matrix3<f64>, semi: Vector },
    /// A straight tube with flat ends and an elliptic section: `radii[0]` along the unit vector `u`, `radii[1]` across it.
    Prism { from: Point, to: Point, u: Vector, radii: [f64; 2] },
    /// A vessel with blends.
    Blended(Truth),
    /// A block with the unit columns of `axes` as axes.
    Block { center: Point, axes: Matrix3<f64>, half: Vector },
}

impl Body {
    /// A capsule of one radius.
    pub(super) fn tube(a: Point, b: Point, r: f64) -> Body {
        Body::Round(Shape::Capsule { a, b, radii: [r, r] })
    }

    fn holds(&self, p: &Point) -> bool {
        match self {
            Body::Round(shape) => shape.value_gradient(p).0 < 0.0,
            Body::Ellipsoid { center, axes, semi } => (axes.transpose() * (p - center)).component_div(semi).norm_squared() < 1.0,
            Body::Prism { from, to, u, radii } => {
                let (w, axis) = (p - from, to - from);
                let t = w.dot(&axis) / axis.norm_squared();
                let across = w - axis * t;
                let x = across.dot(u);
                let y2 = across.norm_squared() - x * x;
                (0.0..=1.0).contains(&t) && (x / radii[0]).powi(2) + y2 / (radii[1] * radii[1]) < 1.0
            }
            Body::Blended(truth) => truth.value(p) < 0.0,
            Body::Block { center, axes, half } => {
                let w = axes.transpose() * (p - center);
                (0..3).all(|a| w[a].abs() < half[a])
            }
        }
    }

    fn bounds(&self) -> Aabb {
        let around = |c: &Point, reach: Vector| Aabb { min: c - reach, max: c + reach };
        match self {
            Body::Round(shape) => {
                let e = [Vector::x(), Vector::y(), Vector::z()].map(|e| shape.extent(&e));
                Aabb { min: Point::new(e[0][0], e[1][0], e[2][0]), max: Point::new(e[0][1], e[1][1], e[2][1]) }
            }
            Body::Ellipsoid { center, axes, semi } => {
                around(center, (axes.component_mul(axes) * semi.component_mul(semi)).map(f64::sqrt))
            }
            Body::Prism { from, to, radii, .. } => {
                let r = Vector::repeat(radii[0].max(radii[1]));
                around(from, r).union(&around(to, r))
            }
            Body::Blended(truth) => truth.bounds(),
            Body::Block { center, axes, half } => around(center, axes.abs() * half),
        }
    }
}

/// A plane that takes off what lies beyond it, within `reach` of its origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    pub plane: Plane,
    pub reach: f64,
}

/// The union of some bodies without what the cuts take off.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    pub bodies: Vec<Body>,
    pub cuts: Vec<Cut>,
    /// Whether it is taken away from what stands before it, not added.
    pub carves: bool,
}

impl Piece {
    pub(super) fn new(bodies: Vec<Body>, cuts: Vec<Cut>) -> Piece {
        Piece { bodies, cuts, carves: false }
    }

    fn keeps(&self, p: &Point) -> bool {
        self.cuts.iter().all(|c| c.plane.signed_distance(p) < 0.0 || (p - c.plane.origin).norm() > c.reach)
    }
}

/// Pieces, one after the other.
#[derive(Debug, Clone, Default)]
pub(super) struct Solid {
    pub pieces: Vec<Piece>,
}

impl Solid {
    pub(super) fn holds(&self, p: &Point) -> bool {
        let holds = |piece: &Piece| piece.keeps(p) && piece.bodies.iter().any(|b| b.holds(p));
        self.pieces.iter().fold(false, |inside, piece| if inside == piece.carves && holds(piece) { !inside } else { inside })
    }

    /// One byte a voxel of `grid`: 1 where its centre lies inside.
    pub(super) fn voxelize(&self, grid: &Grid) -> Vec<u8> {
        let mut data = vec![0; grid.len()];
        for piece in &self.pieces {
            let value = u8::from(!piece.carves);
            for body in &piece.bodies {
                let Some([x, y, z]) = index_box(&body.bounds(), grid) else { continue };
                for k in z[0]..=z[1] {
                    for j in y[0]..=y[1] {
                        let row = (k * grid.dims[1] + j) * grid.dims[0];
                        for i in x[0]..=x[1] {
                            if data[row + i] != value {
                                let p = grid.to_world(Vector::new(i as f64, j as f64, k as f64));
                                if body.holds(&p) && piece.keeps(&p) {
                                    data[row + i] = value;
                                }
                            }
                        }
                    }
                }
            }
        }
        data
    }
}

/// The voxels whose centres may lie in a box.
fn index_box(bounds: &Aabb, grid: &Grid) -> Option<[[usize; 2]; 3]> {
    let mut low = Vector::repeat(f64::INFINITY);
    let mut high = Vector::repeat(f64::NEG_INFINITY);
    for corner in 0..8 {
        let pick = |a: usize| if corner >> a & 1 == 0 { bounds.min[a] } else { bounds.max[a] };
        let at = grid.to_index(&Point::new(pick(0), pick(1), pick(2)));
        low = low.inf(&at);
        high = high.sup(&at);
    }
    let mut out = [[0; 2]; 3];
    for a in 0..3 {
        let (first, last) = (low[a].floor().max(0.0), high[a].ceil().min(grid.dims[a] as f64 - 1.0));
        if first > last {
            return None;
        }
        out[a] = [first as usize, last as usize];
    }
    Some(out)
}

/// A connected section through a solid.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaneSection {
    /// Its area, mm².
    pub area: f64,
    /// Its centroid.
    pub centroid: Point,
    /// Centres of its cells.
    pub cells: Vec<Point>,
}

/// The connected section that holds the plane's origin, or lies within `near` of it, counted in cells of `step` mm within
/// `reach` of the origin.
pub fn plane_section(inside: impl Fn(&Point) -> bool, plane: &Plane, [reach, near, step]: [f64; 3]) -> Option<PlaneSection> {
    let (u, v) = plane.basis();
    let n = (reach / step).ceil() as i64;
    let wide = 2 * n + 1;
    let at = |i: i64, j: i64| plane.origin + u * (i as f64 * step) + v * (j as f64 * step);
    let around = (near / step).ceil() as i64;
    let mut seeds: Vec<(i64, i64)> = (-around..=around).flat_map(|i| (-around..=around).map(move |j| (i, j))).collect();
    seeds.sort_by_key(|(i, j)| (i * i + j * j, *i, *j));
    let (i, j) = seeds.into_iter().find(|&(i, j)| inside(&at(i, j)))?;
    let mut seen = vec![false; (wide * wide) as usize];
    let mut stack = vec![(i, j)];
    let mut cells = Vec::new();
    let mut sum = Vector::zeros();
    seen[((i + n) * wide + j + n) as usize] = true;
    while let Some((i, j)) = stack.pop() {
        let p = at(i, j);
        cells.push(p);
        sum += p - plane.origin;
        for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let (a, b) = (i + di, j + dj);
            if a.abs() > n || b.abs() > n {
                continue;
            }
            let slot = &mut seen[((a + n) * wide + b + n) as usize];
            if !*slot && inside(&at(a, b)) {
                *slot = true;
                stack.push((a, b));
            }
        }
    }
    let count = cells.len() as f64;
    Some(PlaneSection { area: count * step * step, centroid: plane.origin + sum / count, cells })
}
