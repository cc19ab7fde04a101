//! Exact self-intersection test of a triangle mesh.

use rayon::prelude::*;
use robust::{Coord, Coord3D, orient2d, orient3d};

use super::TriMesh;
use super::bvh::TriangleBvh;
use crate::geometry::{Aabb, Point};

/// Side of a plane or line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Where the normal points to (counter-clockwise order seen from there); left of a line.
    Above,
    /// The other side.
    Below,
    /// Exactly on it.
    On,
}

fn side(value: f64) -> Side {
    if value > 0.0 {
        Side::Above
    } else if value < 0.0 {
        Side::Below
    } else {
        Side::On
    }
}

/// The side of the plane through a, b, c on which `p` lies, decided exactly.
pub fn side_of_plane(a: &Point, b: &Point, c: &Point, p: &Point) -> Side {
    let f = |p: &Point| Coord3D { x: p.x, y: p.y, z: p.z };
    // Shewchuk's orient3d is positive where p lies below the plane, seen so that a, b, c run counter-clockwise.
    side(-orient3d(f(a), f(b), f(c), f(p)))
}

fn side_of_line(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> Side {
    let f = |p: [f64; 2]| Coord { x: p[0], y: p[1] };
    side(orient2d(f(a), f(b), f(p)))
}

/// All pairs of triangles that share more than their common vertices and edges, each with the lower id first, sorted.
///
/// Exact: no tolerance takes part in the decision. Triangles are closed sets, so touching counts; so do two triangles
/// on one edge that are folded flat onto each other, and two that coincide. Vertices are the same when their ids are:
/// unwelded neighbours touch. Positions must be finite and not so small that products of three of them underflow.
pub fn self_intersections(mesh: &TriMesh) -> Vec<(u32, u32)> {
    let bvh = TriangleBvh::new(mesh);
    (0..mesh.triangles.len() as u32)
        .into_par_iter()
        .flat_map_iter(|i| {
            let mut found = Vec::new();
            let corners = mesh.corners(i as usize);
            bvh.overlapping(&Aabb::of(corners.iter()), |j| {
                if i < j && pair_intersects(mesh, i, j) {
                    found.push((i, j));
                }
            });
            found.sort_unstable();
            found
        })
        .collect()
}

/// Whether triangles `i` and `j` of a mesh share more than their common vertices and edges.
pub fn pair_intersects(mesh: &TriMesh, i: u32, j: u32) -> bool {
    let (t, u) = (mesh.triangles[i as usize], mesh.triangles[j as usize]);
    let p = |v: u32| mesh.points[v as usize];
    let shared: Vec<usize> = (0..3).filter(|&k| u.contains(&t[k])).collect();
    match shared[..] {
        [] => triangles_intersect(&mesh.corners(i as usize), &mesh.corners(j as usize)),
        [k] => {
            // Beyond the common vertex they can only meet where the edge across from it, of one, meets the other.
            let m = (0..3).find(|&m| u[m] == t[k]).unwrap_or(0);
            let (a, b) = (p(t[(k + 1) % 3]), p(t[(k + 2) % 3]));
            let (c, d) = (p(u[(m + 1) % 3]), p(u[(m + 2) % 3]));
            segment_meets_triangle(&a, &b, &mesh.corners(j as usize))
                || segment_meets_triangle(&c, &d, &mesh.corners(i as usize))
        }
        [k, l] => {
            let a = p(t[3 - k - l]);
            let Some(m) = (0..3).find(|&m| u[m] != t[k] && u[m] != t[l]) else { return true };
            let (e, f, b) = (p(t[k]), p(t[l]), p(u[m]));
            if side_of_plane(&e, &f, &a, &b) != Side::On {
                return false;
            }
            // Coplanar: an intersection exactly when both lie on the same side of the common edge.
            match flat_axis(&e, &f, &a) {
                Some(axis) => {
                    let s = |x: &Point| side_of_line(drop_axis(&e, axis), drop_axis(&f, axis), drop_axis(x, axis));
                    s(&a) == s(&b) || s(&b) == Side::On
                }
                None => true,
            }
        }
        _ => true,
    }
}

/// Whether two triangles, as closed sets, have a point in common. Exact, degenerate triangles included.
pub fn triangles_intersect(t: &[Point; 3], u: &[Point; 3]) -> bool {
    let apart = |t: &[Point; 3], u: &[Point; 3]| {
        let s = [0, 1, 2].map(|k| side_of_plane(&t[0], &t[1], &t[2], &u[k]));
        s[0] != Side::On && s[0] == s[1] && s[1] == s[2]
    };
    if apart(t, u) || apart(u, t) {
        return false;
    }
    (0..3).any(|k| {
        segment_meets_triangle(&t[k], &t[(k + 1) % 3], u) || segment_meets_triangle(&u[k], &u[(k + 1) % 3], t)
    })
}

/// Whether the closed segment pq and the closed triangle have a point in common. Exact.
pub fn segment_meets_triangle(p: &Point, q: &Point, t: &[Point; 3]) -> bool {
    let [a, b, c] = t;
    let (sp, sq) = (side_of_plane(a, b, c, p), side_of_plane(a, b, c, q));
    if sp != Side::On && sp == sq {
        return false;
    }
    if sp == Side::On && sq == Side::On {
        return match flat_axis(a, b, c) {
            Some(axis) => {
                let t = t.map(|x| drop_axis(&x, axis));
                segment_meets_triangle_flat(drop_axis(p, axis), drop_axis(q, axis), t)
            }
            // A triangle without area is the union of its edges.
            None => (0..3).any(|k| segments_meet(p, q, &t[k], &t[(k + 1) % 3])),
        };
    }
    let s = [side_of_plane(p, q, a, b), side_of_plane(p, q, b, c), side_of_plane(p, q, c, a)];
    !(s.contains(&Side::Above) && s.contains(&Side::Below))
}

/// An axis along which the triangle can be looked at without losing its area; `None` where it has none.
fn flat_axis(a: &Point, b: &Point, c: &Point) -> Option<usize> {
    let n = (b - a).cross(&(c - a)).abs();
    let first = n.imax();
    (0..3)
        .map(|k| (first + k) % 3)
        .find(|&k| side_of_line(drop_axis(a, k), drop_axis(b, k), drop_axis(c, k)) != Side::On)
}

fn drop_axis(p: &Point, axis: usize) -> [f64; 2] {
    [p[(axis + 1) % 3], p[(axis + 2) % 3]]
}

fn segment_meets_triangle_flat(p: [f64; 2], q: [f64; 2], t: [[f64; 2]; 3]) -> bool {
    let inside = |x| {
        let s = [0, 1, 2].map(|k| side_of_line(t[k], t[(k + 1) % 3], x));
        !(s.contains(&Side::Above) && s.contains(&Side::Below))
    };
    inside(p) || inside(q) || (0..3).any(|k| segments_meet_flat(p, q, t[k], t[(k + 1) % 3]))
}

fn segments_meet_flat(p: [f64; 2], q: [f64; 2], a: [f64; 2], b: [f64; 2]) -> bool {
    let (sa, sb) = (side_of_line(p, q, a), side_of_line(p, q, b));
    let (sp, sq) = (side_of_line(a, b, p), side_of_line(a, b, q));
    if [sa, sb, sp, sq].iter().all(|&s| s == Side::On) {
        return (0..2).all(|k| p[k].min(q[k]) <= a[k].max(b[k]) && a[k].min(b[k]) <= p[k].max(q[k]));
    }
    (sa != sb || sa == Side::On) && (sp != sq || sp == Side::On)
}

fn segments_meet(p: &Point, q: &Point, a: &Point, b: &Point) -> bool {
    // In one of the three views the plane of both segments keeps its area; there they meet only if they meet in space.
    side_of_plane(p, q, a, b) == Side::On
        && (0..3).all(|k| segments_meet_flat(drop_axis(p, k), drop_axis(q, k), drop_axis(a, k), drop_axis(b, k)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::sphere;

    fn mesh(points: &[[f64; 3]], triangles: &[[u32; 3]]) -> TriMesh {
        TriMesh::new(points.iter().map(|&p| p.into()).collect(), triangles.to_vec())
    }

    #[test]
    fn the_plane_side_follows_the_right_hand() {
        let o = Point::origin();
        let s = side_of_plane(&o, &Point::new(1.0, 0.0, 0.0), &Point::new(0.0, 1.0, 0.0), &Point::new(0.0, 0.0, 1e-300));
        assert_eq!(s, Side::Above);
    }

    #[test]
    fn a_clean_sphere_has_none_and_two_crossing_spheres_meet_along_a_circle() {
        let a = sphere(Point::origin(), 1.0, 16);
        assert!(self_intersections(&a).is_empty());
        let b = sphere(Point::new(1.0, 0.01, 0.02), 1.0, 16);
        let n = a.points.len() as u32;
        let points = [a.points.clone(), b.points.clone()].concat();
        let triangles = a.triangles.iter().copied().chain(b.triangles.iter().map(|t| t.map(|v| v + n))).collect();
        let both = TriMesh::new(points, triangles);
        let pairs = self_intersections(&both);
        assert!(pairs.len() > 30);
        for (i, j) in pairs {
            assert!((i as usize) < a.triangles.len() && (j as usize) >= a.triangles.len());
            for t in [i, j] {
                let c = both.corners(t as usize)[0];
                assert!((c.x - 0.5).abs() < 0.25, "{c}");
            }
        }
    }

    #[test]
    fn neighbours_across_an_edge_meet_only_when_folded_flat() {
        let p = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, 0.9, 0.0], [0.3, 0.9, 1e-200], [0.5, -1.0, 0.0]];
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [1, 0, 3]])), [(0, 1)]);
        assert!(self_intersections(&mesh(&p, &[[0, 1, 2], [1, 0, 4]])).is_empty());
        assert!(self_intersections(&mesh(&p, &[[0, 1, 2], [1, 0, 5]])).is_empty());
    }

    #[test]
    fn neighbours_at_a_vertex_meet_when_one_pierces_or_covers_the_other() {
        let p = [
            [0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0],
            [0.5, 0.5, 1.0], [0.5, 0.5, -1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0],
            [1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [-1.0, 0.0, 1.0],
        ];
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [0, 3, 4]])), [(0, 1)], "piercing");
        assert!(self_intersections(&mesh(&p, &[[0, 1, 2], [0, 5, 6]])).is_empty(), "coplanar, apart");
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [0, 7, 8]])), [(0, 1)], "coplanar, one inside");
        assert!(self_intersections(&mesh(&p, &[[0, 1, 2], [0, 5, 9]])).is_empty(), "standing on the vertex");
    }

    #[test]
    fn coplanar_overlap_touching_and_duplicates_count() {
        let p = [
            [0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0],
            [0.1, 0.1, 0.0], [0.4, 0.1, 0.0], [0.1, 0.4, 0.0],
            [1.0, 1.0, 0.0], [2.0, 2.0, 0.5], [2.0, 2.0, 1.0],
        ];
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [3, 4, 5]])), [(0, 1)], "inside");
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [6, 7, 8]])), [(0, 1)], "a corner on an edge");
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [1, 2, 0]])), [(0, 1)], "twice the same");
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [2, 1, 0]])), [(0, 1)], "its reverse");
    }

    #[test]
    fn triangles_without_area_are_the_segments_they_look_like() {
        let p = [
            [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0],
            [0.5, -1.0, 0.0], [0.5, 1.0, 0.0], [0.5, 2.0, 0.0], [0.5, 0.1, 1.0],
        ];
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [3, 4, 5]])), [(0, 1)]);
        assert!(self_intersections(&mesh(&p, &[[0, 1, 2], [4, 5, 6]])).is_empty());
        assert_eq!(self_intersections(&mesh(&p, &[[0, 1, 2], [3, 4, 6]])), [(0, 1)]);
    }
}
