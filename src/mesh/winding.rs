//! How often a surface winds round a point, also where the surface has holes, doubled sheets or crossings.
//!
//! Method: A. Jacobson, L. Kavan, O. Sorkine-Hornung, "Robust inside-outside segmentation using generalized winding numbers", ACM
//! Transactions on Graphics 32(4), 2013; the tree that takes far triangles together as dipoles: G. Barill, N. G. Dickson, R. Schmidt,
//! D. I. W. Levin, A. Jacobson, "Fast winding numbers for soups and clouds", ACM Transactions on Graphics 37(4), 2018. Angles of single
//! triangles: A. van Oosterom, J. Strackee, "The solid angle of a plane triangle", IEEE Transactions on Biomedical Engineering 30(2), 1983.

use super::TriMesh;
use crate::geometry::{Point, Vector};

/// Triangles of a leaf.
const LEAF: usize = 8;
/// A node is taken as one dipole from this many of its radii on.
const FAR: f64 = 2.5;

#[derive(Debug, Clone)]
struct Node {
    /// Middle of the area.
    center: Point,
    /// Sum of area times unit normal.
    moment: Vector,
    /// Distance of the farthest corner from the middle.
    radius: f64,
    /// First of the triangles below it, and one past the last.
    range: [u32; 2],
    /// The right child; the left one follows its parent. 0 for a leaf.
    right: u32,
}

/// A tree that tells winding numbers of a surface. Holds copies of the corners, so the surface may change or go.
#[derive(Debug, Clone)]
pub struct WindingNumbers {
    nodes: Vec<Node>,
    corners: Vec<[Point; 3]>,
}

impl WindingNumbers {
    /// The tree of a surface, by median splits. O(n log n).
    pub fn new(mesh: &TriMesh) -> WindingNumbers {
        let mut corners: Vec<[Point; 3]> = (0..mesh.triangles.len()).map(|t| mesh.corners(t)).collect();
        let mut nodes = Vec::with_capacity(corners.len() / 2 + 1);
        if !corners.is_empty() {
            let all = corners.len();
            build(&mut nodes, &mut corners, [0, all]);
        }
        WindingNumbers { nodes, corners }
    }

    /// The winding number at `p`: 1 inside and 0 outside of a closed surface that is oriented outwards, in between near holes, sums where
    /// bodies overlap. Within 0.03 of the exact value off the surface.
    pub fn at(&self, p: &Point) -> f64 {
        let mut sum = 0.0;
        let mut stack = Vec::with_capacity(64);
        if !self.nodes.is_empty() {
            stack.push(0usize);
        }
        while let Some(n) = stack.pop() {
            let node = &self.nodes[n];
            let d = node.center - p;
            let square = d.norm_squared();
            if square > (FAR * node.radius).powi(2) {
                sum += node.moment.dot(&d) / (square * square.sqrt());
            } else if node.right == 0 {
                sum += self.corners[node.range[0] as usize..node.range[1] as usize].iter().map(|t| solid_angle(p, t)).sum::<f64>();
            } else {
                stack.push(node.right as usize);
                stack.push(n + 1);
            }
        }
        sum / (4.0 * std::f64::consts::PI)
    }

    /// Whether `p` is rather inside than outside.
    pub fn contains(&self, p: &Point) -> bool {
        self.at(p) > 0.5
    }
}

/// The angle under which `p` sees a triangle, positive from behind; 0 on its plane.
fn solid_angle(p: &Point, [a, b, c]: &[Point; 3]) -> f64 {
    let (a, b, c) = (a - p, b - p, c - p);
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    let above = a.dot(&b.cross(&c));
    let below = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
    if above == 0.0 { 0.0 } else { 2.0 * above.atan2(below) }
}

/// Appends the subtree of `corners[range]`.
fn build(nodes: &mut Vec<Node>, corners: &mut [[Point; 3]], [first, end]: [usize; 2]) {
    let own = &mut corners[first..end];
    let (mut area, mut middle, mut moment) = (0.0, Vector::zeros(), Vector::zeros());
    let mut bounds = crate::geometry::Aabb::EMPTY;
    for t @ [a, b, c] in own.iter() {
        let v = 0.5 * (b - a).cross(&(c - a));
        moment += v;
        area += v.norm();
        middle += thrice(t) * (v.norm() / 3.0);
        bounds.include(&Point::from(thrice(t)));
    }
    let center = if area > 0.0 { Point::from(middle / area) } else { own[0][0] };
    let radius = own.iter().flatten().map(|p| (p - center).norm_squared()).fold(0.0, f64::max).sqrt();
    let at = nodes.len();
    nodes.push(Node { center, moment, radius, range: [first as u32, end as u32], right: 0 });
    if end - first <= LEAF {
        return;
    }
    let axis = (bounds.max - bounds.min).imax();
    let half = (end - first) / 2;
    own.select_nth_unstable_by(half, |s, t| thrice(s)[axis].total_cmp(&thrice(t)[axis]));
    build(nodes, corners, [first, first + half]);
    nodes[at].right = nodes.len() as u32;
    build(nodes, corners, [first + half, end]);
}

/// Three times the middle of a triangle.
fn thrice([a, b, c]: &[Point; 3]) -> Vector {
    a.coords + b.coords + c.coords
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{grid_noise, sphere};

    #[test]
    fn a_closed_surface_winds_once_round_what_is_inside() {
        let tree = WindingNumbers::new(&sphere(Point::new(1.0, 2.0, 3.0), 2.0, 24));
        for i in 0..500 {
            let d = grid_noise(i) * 7.0;
            let r = d.norm();
            if !(1.95..=2.0).contains(&r) {
                let w = tree.at(&(Point::new(1.0, 2.0, 3.0) + d));
                assert!((w - f64::from(u8::from(r < 2.0))).abs() < 0.03, "{w} at {r}");
            }
        }
    }

    #[test]
    fn a_missing_piece_leaves_a_value_between_near_by_only() {
        let mut mesh = sphere(Point::origin(), 2.0, 24);
        let whole = mesh.clone();
        mesh.triangles = (0..whole.triangles.len()).filter(|&t| whole.corners(t)[0].z < 1.5).map(|t| whole.triangles[t]).collect();
        let tree = WindingNumbers::new(&mesh);
        assert!((tree.at(&Point::new(0.0, 0.0, 1.5)) - 0.5).abs() < 0.25);
        assert!(tree.at(&Point::new(0.0, 0.0, -1.0)) > 0.9);
        assert!(tree.at(&Point::new(0.0, 0.0, -3.0)) < 0.1);
    }
}
