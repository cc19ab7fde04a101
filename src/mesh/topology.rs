//! Topology of a triangle mesh: closed, oriented, 2-manifold, components, Euler characteristic.

use serde::Serialize;

use super::TriMesh;
use crate::geometry::Point;

/// What [`check`] found. Combinatorial only: self-intersection is a question of geometry and asked elsewhere.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct TopologyReport {
    /// Vertices that a triangle uses.
    pub vertices: usize,
    /// Edges that a triangle uses.
    pub edges: usize,
    /// Triangles.
    pub triangles: usize,
    /// Edges with one triangle.
    pub open_edges: usize,
    /// Edges with more than two triangles.
    pub nonmanifold_edges: usize,
    /// Edges whose two triangles run along them in the same direction.
    pub inconsistent_edges: usize,
    /// Vertices whose triangles form more than one fan.
    pub nonmanifold_vertices: usize,
    /// Triangles that name a vertex twice or one that does not exist.
    pub degenerate_triangles: usize,
    /// Points that no triangle uses.
    pub unused_points: usize,
    /// Connected components, over shared vertices.
    pub components: usize,
    /// V − E + F of the used vertices.
    pub euler: i64,
    /// Vertex ids of the first offending edge, for messages.
    pub first_bad_edge: Option<[u32; 2]>,
    /// First offending vertex, for messages.
    pub first_bad_vertex: Option<u32>,
}

impl TopologyReport {
    /// Closed, oriented and 2-manifold at edges and vertices.
    pub fn is_closed_manifold(&self) -> bool {
        self.open_edges == 0
            && self.nonmanifold_edges == 0
            && self.inconsistent_edges == 0
            && self.nonmanifold_vertices == 0
            && self.degenerate_triangles == 0
            && self.triangles > 0
    }

    /// Where the first fault lies.
    pub fn first_fault(&self, mesh: &TriMesh) -> Option<Point> {
        let v = self.first_bad_edge.map(|e| e[0]).or(self.first_bad_vertex)?;
        mesh.points.get(v as usize).copied()
    }
}

/// Counts every breach of "closed, oriented, 2-manifold" and the invariants that go with it. O(n log n), any input.
pub fn check(mesh: &TriMesh) -> TopologyReport {
    let nv = mesh.points.len();
    let mut report = TopologyReport { triangles: mesh.triangles.len(), ..TopologyReport::default() };
    // Corner c = 3t + i; its edge runs from corner i to the next. An edge is known by any of its corners, so that four bytes a corner
    // do: corners in the order of their edges' lower vertices, `first` where those of a vertex begin.
    let ends = |c: u32| {
        let tri = mesh.triangles[c as usize / 3];
        (tri[c as usize % 3], tri[(c as usize + 1) % 3])
    };
    let sound = |tri: &[u32; 3]| tri[0] != tri[1] && tri[1] != tri[2] && tri[2] != tri[0] && tri.iter().all(|&v| (v as usize) < nv);
    let mut first = vec![0u32; nv + 1];
    let mut used = vec![false; nv];
    let mut vertex_sets = DisjointSets::new(nv);
    for tri in &mesh.triangles {
        if !sound(tri) {
            report.degenerate_triangles += 1;
            continue;
        }
        for i in 0..3 {
            let (u, v) = (tri[i], tri[(i + 1) % 3]);
            used[u as usize] = true;
            vertex_sets.join(u, v);
            first[u.min(v) as usize + 1] += 1;
        }
    }
    (0..nv).for_each(|v| first[v + 1] += first[v]);
    let mut corners = vec![0u32; first[nv] as usize];
    // Filled from behind, each vertex's end moves to its beginning.
    for t in (0..mesh.triangles.len()).rev().filter(|&t| sound(&mesh.triangles[t])) {
        for c in (3 * t as u32..3 * t as u32 + 3).rev() {
            let (u, v) = ends(c);
            let end = &mut first[u.min(v) as usize + 1];
            *end -= 1;
            corners[*end as usize] = c;
        }
    }
    let mut corner_sets = DisjointSets::new(3 * mesh.triangles.len());
    let mut begin = 0;
    for v in 0..nv as u32 {
        // Where the next vertex's corners begin.
        let end = first.get(v as usize + 2).map_or(corners.len(), |&n| n as usize);
        let of = &mut corners[begin..end];
        begin = end;
        let higher = |c: u32| {
            let (u, w) = ends(c);
            u.max(w)
        };
        of.sort_unstable_by_key(|&c| (higher(c), c));
        for edge in of.chunk_by(|&a, &b| higher(a) == higher(b)) {
            report.edges += 1;
            let fault = match *edge {
                [_] => {
                    report.open_edges += 1;
                    true
                }
                [a, b] => {
                    let bad = ends(a) == ends(b);
                    report.inconsistent_edges += usize::from(bad);
                    bad
                }
                _ => {
                    report.nonmanifold_edges += 1;
                    true
                }
            };
            let both = [v, higher(edge[0])];
            if fault && report.first_bad_edge.is_none() {
                report.first_bad_edge = Some(both);
            }
            // Triangles that share an edge lie in one fan at both of its ends.
            for pair in edge.windows(2) {
                for end in both {
                    corner_sets.join(corner_at(mesh, pair[0] / 3, end), corner_at(mesh, pair[1] / 3, end));
                }
            }
        }
    }
    let mut fan = vec![u32::MAX; nv];
    let mut split = vec![false; nv];
    for &corner in &corners {
        let v = ends(corner).0 as usize;
        let root = corner_sets.root(corner);
        if fan[v] == u32::MAX {
            fan[v] = root;
        } else if fan[v] != root && !split[v] {
            split[v] = true;
            report.nonmanifold_vertices += 1;
        }
    }
    report.first_bad_vertex = split.iter().position(|&s| s).map(|v| v as u32);
    for v in 0..nv {
        if used[v] {
            report.vertices += 1;
            report.components += usize::from(vertex_sets.root(v as u32) == v as u32);
        } else {
            report.unused_points += 1;
        }
    }
    let faces = report.triangles - report.degenerate_triangles;
    report.euler = report.vertices as i64 - report.edges as i64 + faces as i64;
    report
}

/// Component of every triangle, numbered by the first triangle of each; components hang together over shared vertices.
pub fn triangle_components(mesh: &TriMesh) -> (Vec<u32>, usize) {
    let mut sets = DisjointSets::new(mesh.points.len());
    for t in &mesh.triangles {
        sets.join(t[0], t[1]);
        sets.join(t[1], t[2]);
    }
    let mut number = vec![u32::MAX; mesh.points.len()];
    let mut count = 0;
    let labels = mesh
        .triangles
        .iter()
        .map(|t| {
            let root = sets.root(t[0]) as usize;
            if number[root] == u32::MAX {
                number[root] = count;
                count += 1;
            }
            number[root]
        })
        .collect();
    (labels, count as usize)
}

fn corner_at(mesh: &TriMesh, t: u32, v: u32) -> u32 {
    let tri = mesh.triangles[t as usize];
    3 * t + if tri[0] == v { 0 } else if tri[1] == v { 1 } else { 2 }
}

/// Union-find whose roots are the smallest members.
pub(crate) struct DisjointSets(Vec<u32>);

impl DisjointSets {
    pub fn new(n: usize) -> Self {
        DisjointSets((0..n as u32).collect())
    }

    pub fn root(&mut self, mut a: u32) -> u32 {
        while self.0[a as usize] != a {
            let up = self.0[self.0[a as usize] as usize];
            self.0[a as usize] = up;
            a = up;
        }
        a
    }

    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        let (low, high) = (a.min(b), a.max(b));
        self.0[high as usize] = low;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub fn tetrahedron(offset: f64) -> TriMesh {
        let p = |x, y, z| Point::new(x + offset, y, z);
        TriMesh::new(
            vec![p(0., 0., 0.), p(1., 0., 0.), p(0., 1., 0.), p(0., 0., 1.)],
            vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        )
    }

    pub fn merged(a: &TriMesh, b: &TriMesh) -> TriMesh {
        let n = a.points.len() as u32;
        let points = a.points.iter().chain(&b.points).copied().collect();
        let triangles = a.triangles.iter().copied().chain(b.triangles.iter().map(|t| t.map(|v| v + n))).collect();
        TriMesh::new(points, triangles)
    }

    #[test]
    fn a_tetrahedron_is_a_sphere() {
        let r = check(&tetrahedron(0.0));
        assert!(r.is_closed_manifold());
        assert_eq!((r.components, r.euler, r.edges, r.unused_points), (1, 2, 6, 0));
    }

    #[test]
    fn a_missing_triangle_leaves_three_open_edges() {
        let mut m = tetrahedron(0.0);
        m.triangles.pop();
        let r = check(&m);
        assert_eq!((r.open_edges, r.nonmanifold_edges, r.nonmanifold_vertices), (3, 0, 0));
        assert!(!r.is_closed_manifold());
    }

    #[test]
    fn a_reversed_triangle_is_seen_at_its_three_edges() {
        let mut m = tetrahedron(0.0);
        m.triangles[2].swap(0, 1);
        assert_eq!(check(&m).inconsistent_edges, 3);
    }

    #[test]
    fn two_bodies_that_touch_in_a_vertex_or_an_edge() {
        let mut m = merged(&tetrahedron(0.0), &tetrahedron(5.0));
        assert_eq!((check(&m).components, check(&m).euler), (2, 4));
        let (labels, n) = triangle_components(&m);
        assert_eq!((n, labels[0], labels[7]), (2, 0, 1));
        for t in &mut m.triangles {
            *t = t.map(|v| if v == 4 { 0 } else { v });
        }
        let r = check(&m);
        assert_eq!((r.nonmanifold_vertices, r.nonmanifold_edges, r.components, r.unused_points), (1, 0, 1, 1));
        for t in &mut m.triangles {
            *t = t.map(|v| if v == 5 { 1 } else { v });
        }
        let r = check(&m);
        assert_eq!((r.nonmanifold_edges, r.first_bad_edge), (1, Some([0, 1])));
    }
}
