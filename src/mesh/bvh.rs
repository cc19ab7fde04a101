//! Bounding volume hierarchy over triangles: closest points, rays, boxes, inside or outside.

use rayon::prelude::*;

use super::TriMesh;
use super::intersect::{Side, side_of_plane};
use crate::geometry::{Aabb, Point, Vector};

const LEAF: usize = 4;
const PARALLEL: usize = 4096;

/// The point of a mesh nearest to a query point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closest {
    /// The nearest point of the mesh.
    pub point: Point,
    /// The triangle it lies on; the lowest id where several are equally near.
    pub triangle: u32,
    /// Distance from the query point.
    pub distance: f64,
}

/// Where a ray first meets a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// Distance along the ray in lengths of its direction vector.
    pub t: f64,
    /// The triangle that was hit.
    pub triangle: u32,
    /// Where it was hit.
    pub point: Point,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Aabb,
    /// Inner node: index of the right child, the left one follows its parent. Leaf: first slot.
    index: u32,
    /// Number of slots of a leaf, 0 for an inner node.
    count: u32,
}

const NO_NODE: Node = Node { bounds: Aabb::EMPTY, index: 0, count: 0 };

/// A hierarchy of boxes over the triangles of a mesh. Holds copies of the corners, so the mesh may change or go.
///
/// All answers are functions of the mesh alone, whatever the number of threads that built the tree.
#[derive(Debug, Clone)]
pub struct TriangleBvh {
    nodes: Vec<Node>,
    ids: Vec<u32>,
    corners: Vec<[Point; 3]>,
}

impl TriangleBvh {
    /// Builds the tree by median splits, in parallel. O(n log n).
    pub fn new(mesh: &TriMesh) -> TriangleBvh {
        TriangleBvh::of(&mesh.points, &mesh.triangles)
    }

    /// The tree over some triangles of a point array; ids in answers count in `triangles`.
    pub fn of(points: &[Point], triangles: &[[u32; 3]]) -> TriangleBvh {
        let boxes: Vec<Aabb> = triangles.par_iter().map(|t| Aabb::of(t.map(|v| points[v as usize]).iter())).collect();
        let mut slots: Vec<(Point, u32)> =
            boxes.par_iter().enumerate().map(|(i, b)| (b.center(), i as u32)).collect();
        let leaves = slots.len().div_ceil(LEAF);
        let mut nodes = vec![NO_NODE; (2 * leaves).saturating_sub(1)];
        if leaves > 0 {
            build(&mut nodes, 0, &mut slots, 0, &boxes);
        }
        let ids: Vec<u32> = slots.iter().map(|s| s.1).collect();
        let corners = ids.par_iter().map(|&i| triangles[i as usize].map(|v| points[v as usize])).collect();
        TriangleBvh { nodes, ids, corners }
    }

    /// Whether there are no triangles.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// The box round all triangles.
    pub fn bounds(&self) -> Aabb {
        self.nodes.first().map_or(Aabb::EMPTY, |n| n.bounds)
    }

    /// The nearest point of the mesh; `None` only for a mesh without triangles.
    pub fn closest(&self, p: &Point) -> Option<Closest> {
        self.closest_within(p, f64::INFINITY)
    }

    /// The nearest point of the mesh no farther than `max_distance`.
    pub fn closest_within(&self, p: &Point, max_distance: f64) -> Option<Closest> {
        let limit = max_distance * max_distance;
        let mut best = (limit, u32::MAX, *p);
        let mut stack = Stack::new();
        if let Some(root) = self.nodes.first() {
            stack.push(0, root.bounds.squared_distance(p));
        }
        while let Some((n, d)) = stack.pop() {
            if d > best.0 {
                continue;
            }
            let node = &self.nodes[n as usize];
            if node.count > 0 {
                let first = node.index as usize;
                for s in first..first + node.count as usize {
                    let q = closest_on_triangle(p, &self.corners[s]);
                    let d = (q - p).norm_squared();
                    if d < best.0 || d == best.0 && self.ids[s] < best.1 {
                        best = (d, self.ids[s], q);
                    }
                }
            } else {
                let (a, b) = (n + 1, node.index);
                let da = self.nodes[a as usize].bounds.squared_distance(p);
                let db = self.nodes[b as usize].bounds.squared_distance(p);
                let ((near, dn), (far, df)) = if da <= db { ((a, da), (b, db)) } else { ((b, db), (a, da)) };
                if df <= best.0 {
                    stack.push(far, df);
                }
                if dn <= best.0 {
                    stack.push(near, dn);
                }
            }
        }
        (best.1 != u32::MAX).then(|| Closest { point: best.2, triangle: best.1, distance: best.0.sqrt() })
    }

    /// The nearest points to many points, in order and in parallel; queries that lie near each other in the list are
    /// faster. Empty only for a mesh without triangles or a list without points.
    pub fn closest_many(&self, points: &[Point]) -> Vec<Closest> {
        points
            .par_chunks(512)
            .flat_map_iter(|chunk| {
                let mut last: Option<Closest> = None;
                chunk.iter().filter_map(move |p| {
                    // The last answer bounds this one; the slack keeps ties in reach of the lowest id.
                    let bound = last.map_or(f64::INFINITY, |c| (c.point - p).norm() * (1.0 + 1e-9));
                    last = self.closest_within(p, bound).or_else(|| self.closest(p));
                    last
                })
            })
            .collect()
    }

    /// The first triangle that the ray `origin + t · direction`, 0 ≤ t ≤ `t_max`, meets, from either side.
    ///
    /// In floating point: a ray through an edge may miss both of its triangles. [`TriangleBvh::contains`] is exact.
    pub fn ray(&self, origin: &Point, direction: &Vector, t_max: f64) -> Option<RayHit> {
        self.ray_filtered(origin, direction, t_max, |_| true)
    }

    /// The first hit among the triangles that `accept` takes.
    pub fn ray_filtered(
        &self,
        origin: &Point,
        direction: &Vector,
        t_max: f64,
        accept: impl Fn(u32) -> bool,
    ) -> Option<RayHit> {
        let inverse = direction.map(|d| 1.0 / d);
        let mut best: Option<(f64, u32)> = None;
        let mut stack = Stack::new();
        if !self.nodes.is_empty() {
            stack.push(0, 0.0);
        }
        while let Some((n, t)) = stack.pop() {
            let limit = best.map_or(t_max, |b| b.0);
            if t > limit {
                continue;
            }
            let node = &self.nodes[n as usize];
            if node.count > 0 {
                let first = node.index as usize;
                for s in first..first + node.count as usize {
                    let id = self.ids[s];
                    let Some(t) = ray_triangle(origin, direction, &self.corners[s]) else { continue };
                    if t <= t_max && best.is_none_or(|b| (t, id) < b) && accept(id) {
                        best = Some((t, id));
                    }
                }
            } else {
                let (a, b) = (n + 1, node.index);
                let ta = ray_box(origin, &inverse, &self.nodes[a as usize].bounds, limit);
                let tb = ray_box(origin, &inverse, &self.nodes[b as usize].bounds, limit);
                let mut both = [(a, ta), (b, tb)];
                if ta.unwrap_or(f64::INFINITY) <= tb.unwrap_or(f64::INFINITY) {
                    both.swap(0, 1);
                }
                for (c, t) in both {
                    if let Some(t) = t {
                        stack.push(c, t);
                    }
                }
            }
        }
        best.map(|(t, triangle)| RayHit { t, triangle, point: origin + direction * t })
    }

    /// Calls `visit` with the id of every triangle whose box meets `query`, in the tree's order.
    pub fn overlapping(&self, query: &Aabb, mut visit: impl FnMut(u32)) {
        let mut stack = Stack::new();
        if !self.nodes.is_empty() {
            stack.push(0, 0.0);
        }
        while let Some((n, _)) = stack.pop() {
            let node = &self.nodes[n as usize];
            if !node.bounds.intersects(query) {
                continue;
            }
            if node.count > 0 {
                let first = node.index as usize;
                for s in first..first + node.count as usize {
                    if Aabb::of(self.corners[s].iter()).intersects(query) {
                        visit(self.ids[s]);
                    }
                }
            } else {
                stack.push(node.index, 0.0);
                stack.push(n + 1, 0.0);
            }
        }
    }

    /// Whether `p` lies inside a closed mesh, by exact counting of crossings. Points on the surface count as inside.
    pub fn contains(&self, p: &Point) -> bool {
        let b = self.bounds();
        if !b.intersects(&Aabb { min: *p, max: *p }) {
            return false;
        }
        let reach = b.diagonal().max(f64::MIN_POSITIVE);
        // A segment that touches an edge or a vertex says nothing: take the next direction.
        for k in 0..64 {
            let a = 0.7390851 + 2.399963 * f64::from(k);
            let z = 0.8414 - 0.0261 * f64::from(k);
            let r = (1.0 - z * z).sqrt();
            let q = p + Vector::new(r * a.cos(), r * a.sin(), z) * (2.0 * reach);
            match self.crossings(p, &q) {
                Crossings::Even => return false,
                Crossings::Odd | Crossings::OnSurface => return true,
                Crossings::Unclear => {}
            }
        }
        false
    }

    fn crossings(&self, p: &Point, q: &Point) -> Crossings {
        let direction = q - p;
        let inverse = direction.map(|d| 1.0 / d);
        let grow = 1e-12 * direction.norm();
        let mut odd = false;
        let mut stack = Stack::new();
        stack.push(0, 0.0);
        while let Some((n, _)) = stack.pop() {
            let node = &self.nodes[n as usize];
            if ray_box(p, &inverse, &node.bounds.inflated(grow), 1.0).is_none() {
                continue;
            }
            if node.count == 0 {
                stack.push(node.index, 0.0);
                stack.push(n + 1, 0.0);
                continue;
            }
            let first = node.index as usize;
            for [a, b, c] in &self.corners[first..first + node.count as usize] {
                let (sp, sq) = (side_of_plane(a, b, c, p), side_of_plane(a, b, c, q));
                if sp == sq && sp != Side::On {
                    continue;
                }
                let s = [side_of_plane(p, q, a, b), side_of_plane(p, q, b, c), side_of_plane(p, q, c, a)];
                let (above, below) = (s.contains(&Side::Above), s.contains(&Side::Below));
                if above && below {
                    continue;
                }
                if sp == Side::On && (above || below) {
                    return Crossings::OnSurface;
                }
                if s.contains(&Side::On) || sp == Side::On || sq == Side::On {
                    return Crossings::Unclear;
                }
                odd = !odd;
            }
        }
        if odd { Crossings::Odd } else { Crossings::Even }
    }
}

enum Crossings {
    Even,
    Odd,
    OnSurface,
    Unclear,
}

/// A stack that needs no allocation at the depths that median splits reach.
struct Stack {
    items: [(u32, f64); 64],
    len: usize,
}

impl Stack {
    fn new() -> Stack {
        Stack { items: [(0, 0.0); 64], len: 0 }
    }

    fn push(&mut self, node: u32, key: f64) {
        self.items[self.len] = (node, key);
        self.len += 1;
    }

    fn pop(&mut self) -> Option<(u32, f64)> {
        self.len = self.len.checked_sub(1)?;
        Some(self.items[self.len])
    }
}

/// Fills `nodes`, the subtree of `slots`; `base` and `first` are their places in the whole arrays. Returns its box.
fn build(nodes: &mut [Node], base: u32, slots: &mut [(Point, u32)], first: u32, boxes: &[Aabb]) -> Aabb {
    if slots.len() <= LEAF {
        let bounds = slots.iter().fold(Aabb::EMPTY, |b, s| b.union(&boxes[s.1 as usize]));
        nodes[0] = Node { bounds, index: first, count: slots.len() as u32 };
        return bounds;
    }
    let centers = slots.iter().fold(Aabb::EMPTY, |mut b, s| {
        b.include(&s.0);
        b
    });
    let axis = (centers.max - centers.min).imax();
    // Full leaves on the left, so that the number of nodes of a subtree follows from its number of slots.
    let left = slots.len().div_ceil(LEAF) / 2 * LEAF;
    slots.select_nth_unstable_by(left, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let left_nodes = 2 * (left / LEAF) - 1;
    let parallel = slots.len() > PARALLEL;
    let (sl, sr) = slots.split_at_mut(left);
    let (head, tail) = nodes.split_at_mut(1);
    let (nl, nr) = tail.split_at_mut(left_nodes);
    let right = base + 1 + left_nodes as u32;
    let (a, b) = if parallel {
        rayon::join(
            || build(nl, base + 1, sl, first, boxes),
            || build(nr, right, sr, first + left as u32, boxes),
        )
    } else {
        (build(nl, base + 1, sl, first, boxes), build(nr, right, sr, first + left as u32, boxes))
    };
    head[0] = Node { bounds: a.union(&b), index: right, count: 0 };
    head[0].bounds
}

/// The point of a triangle nearest to `p` (Ericson, Real-Time Collision Detection, 5.1.5). Degenerate triangles are
/// treated as the segments that they are.
pub fn closest_on_triangle(p: &Point, [a, b, c]: &[Point; 3]) -> Point {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 - d3 > 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 - d6 > 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    let (e, f) = (d4 - d3, d5 - d6);
    if va <= 0.0 && e >= 0.0 && f >= 0.0 && e + f > 0.0 {
        return b + (c - b) * (e / (e + f));
    }
    let sum = va + vb + vc;
    if sum > 0.0 { a + ab * (vb / sum) + ac * (vc / sum) } else { *a }
}

fn ray_triangle(o: &Point, d: &Vector, [a, b, c]: &[Point; 3]) -> Option<f64> {
    let (e, f) = (b - a, c - a);
    let h = d.cross(&f);
    let det = e.dot(&h);
    if det == 0.0 {
        return None;
    }
    let s = o - a;
    let u = s.dot(&h) / det;
    let q = s.cross(&e);
    let v = d.dot(&q) / det;
    let t = f.dot(&q) / det;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0).then_some(t)
}

fn ray_box(o: &Point, inverse: &Vector, b: &Aabb, t_max: f64) -> Option<f64> {
    let (mut low, mut high) = (0.0f64, t_max);
    for i in 0..3 {
        let (s, t) = ((b.min[i] - o[i]) * inverse[i], (b.max[i] - o[i]) * inverse[i]);
        // 0 · ∞ is no number: min and max skip it, and the slab then does not cut.
        low = low.max(s.min(t));
        high = high.min(s.max(t));
    }
    (low <= high * (1.0 + 1e-15)).then_some(low)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::{grid_noise, sphere};

    #[test]
    fn closest_agrees_with_looking_at_every_triangle() {
        let m = sphere(Point::new(3.0, -2.0, 1.0), 2.0, 12);
        let bvh = TriangleBvh::new(&m);
        let queries: Vec<Point> = (0..300).map(|i| Point::new(3.0, -2.0, 1.0) + grid_noise(i) * 6.0).collect();
        for (p, many) in queries.iter().zip(bvh.closest_many(&queries)) {
            let brute = (0..m.triangles.len())
                .map(|t| (closest_on_triangle(p, &m.corners(t)) - p).norm())
                .fold(f64::INFINITY, f64::min);
            let c = bvh.closest(p).unwrap();
            assert_eq!(c.distance, brute);
            assert_eq!(c, many);
            let t = c.triangle as usize;
            assert_eq!(closest_on_triangle(p, &m.corners(t)), c.point);
            assert!(bvh.closest_within(p, 0.99 * brute).is_none());
        }
    }

    #[test]
    fn contains_tells_inside_from_outside_even_from_lattice_points() {
        let m = sphere(Point::origin(), 2.0, 10);
        let bvh = TriangleBvh::new(&m);
        for i in 0..400 {
            let p = Point::origin() + (grid_noise(i) * 8.0).map(|x| (x * 2.0).round() / 2.0);
            let r = p.coords.norm();
            if !(1.95..=2.0).contains(&r) {
                assert_eq!(bvh.contains(&p), r < 2.0, "{p}");
            }
        }
        assert!(bvh.contains(&m.points[5]));
    }

    #[test]
    fn a_ray_meets_the_sphere_where_geometry_says() {
        let m = sphere(Point::origin(), 1.0, 24);
        let bvh = TriangleBvh::new(&m);
        let hit = bvh.ray(&Point::new(-3.0, 0.1, 0.2), &Vector::new(2.0, 0.0, 0.0), 10.0).unwrap();
        assert!((hit.point.coords.norm() - 1.0).abs() < 0.01 && hit.point.x < 0.0);
        assert!((hit.t * 2.0 - 3.0 - hit.point.x).abs() < 1e-12);
        assert!(bvh.ray(&Point::new(-3.0, 0.1, 0.2), &Vector::new(2.0, 0.0, 0.0), 0.9).is_none());
        assert!(bvh.ray(&Point::new(-3.0, 1.1, 0.2), &Vector::x(), 10.0).is_none());
    }

    #[test]
    fn overlapping_finds_exactly_the_triangles_whose_boxes_meet_the_query() {
        let m = sphere(Point::origin(), 1.0, 10);
        let bvh = TriangleBvh::new(&m);
        let q = Aabb { min: Point::new(0.2, 0.1, -0.3), max: Point::new(0.9, 0.6, 0.8) };
        let mut found = Vec::new();
        bvh.overlapping(&q, |t| found.push(t));
        found.sort_unstable();
        let brute: Vec<u32> = (0..m.triangles.len() as u32)
            .filter(|&t| Aabb::of(m.corners(t as usize).iter()).intersects(&q))
            .collect();
        assert!(!brute.is_empty());
        assert_eq!(found, brute);
    }
}
