//! A closed triangle mesh that can be changed edge by edge.
//!
//! A corner table: half-edge `3t + i` runs from corner `i` of triangle `t` to the next corner. Every half-edge has a
//! twin, so rings are found without search. Ids of vertices stay valid through every operation that does not
//! remove the vertex; ids of half-edges do not.

use super::topology::{self, TopologyReport};
use super::{Patch, PatchId, TriMesh};
use crate::geometry::Point;

/// Marks what has been removed.
pub const NONE: u32 = u32::MAX;

/// A closed, oriented 2-manifold triangle mesh with edge operations.
#[derive(Debug, Clone, Default)]
pub struct HalfEdgeMesh {
    /// Positions; those of removed vertices are stale.
    pub points: Vec<Point>,
    tri: Vec<[u32; 3]>,
    patch: Vec<PatchId>,
    twin: Vec<u32>,
    feature: Vec<bool>,
    out: Vec<u32>,
    patches: Vec<Patch>,
    removed_triangles: usize,
}

impl HalfEdgeMesh {
    /// Takes a mesh over. Edges between two patches become features.
    ///
    /// # Errors
    /// The topology report where the mesh is not closed, oriented and 2-manifold.
    pub fn new(mesh: &TriMesh) -> Result<HalfEdgeMesh, Box<TopologyReport>> {
        let report = topology::check(mesh);
        if !report.is_closed_manifold() {
            return Err(Box::new(report));
        }
        let n = mesh.triangles.len();
        let mut keys: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * n);
        let mut out = vec![NONE; mesh.points.len()];
        for (t, tri) in mesh.triangles.iter().enumerate() {
            for i in 0..3 {
                let (a, b) = (tri[i], tri[(i + 1) % 3]);
                keys.push((a.min(b), a.max(b), (3 * t + i) as u32));
                out[a as usize] = (3 * t + i) as u32;
            }
        }
        keys.sort_unstable();
        let mut twin = vec![NONE; 3 * n];
        for pair in keys.chunks_exact(2) {
            twin[pair[0].2 as usize] = pair[1].2;
            twin[pair[1].2 as usize] = pair[0].2;
        }
        let patch = if mesh.patch.len() == n { mesh.patch.clone() } else { vec![super::WALL; n] };
        let feature = (0..3 * n).map(|h| patch[h / 3] != patch[twin[h] as usize / 3]).collect();
        Ok(HalfEdgeMesh {
            points: mesh.points.clone(),
            tri: mesh.triangles.clone(),
            patch,
            twin,
            feature,
            out,
            patches: mesh.patches.clone(),
            removed_triangles: 0,
        })
    }

    /// The mesh without what was removed; what is left keeps its order.
    pub fn into_mesh(self) -> TriMesh {
        let mut number = vec![NONE; self.points.len()];
        let mut points = Vec::with_capacity(self.points.len());
        for (v, p) in self.points.iter().enumerate() {
            if self.out[v] != NONE {
                number[v] = points.len() as u32;
                points.push(*p);
            }
        }
        let live = |t: &usize| self.tri[*t][0] != NONE;
        let triangles = (0..self.tri.len()).filter(live).map(|t| self.tri[t].map(|v| number[v as usize])).collect();
        let patch = (0..self.tri.len()).filter(live).map(|t| self.patch[t]).collect();
        TriMesh { points, triangles, patch, patches: self.patches }
    }

    /// Gives ids without gaps; what is left keeps its order. Returns the old id of each vertex. Scans over all ids cost
    /// what is there afterwards, not what was once there.
    pub fn compact(&mut self) -> Vec<u32> {
        let triangles: Vec<u32> = (0..self.tri.len() as u32).filter(|&t| self.has_triangle(t)).collect();
        let vertices: Vec<u32> = (0..self.points.len() as u32).filter(|&v| self.has_vertex(v)).collect();
        self.renumber(&triangles, &vertices);
        vertices
    }

    /// Gives ids without gaps in the order of a breadth-first walk, so that neighbours lie close together in memory:
    /// after many splits a scan over the rings of a large mesh waits for memory more than it computes. Returns the old
    /// id of each vertex.
    pub fn sort_by_walk(&mut self) -> Vec<u32> {
        let mut seen = vec![false; self.points.len()];
        let mut numbered = vec![false; self.tri.len()];
        let mut vertices: Vec<u32> = Vec::with_capacity(self.points.len());
        let mut triangles: Vec<u32> = Vec::with_capacity(self.triangle_count());
        for start in 0..self.points.len() as u32 {
            if seen[start as usize] || !self.has_vertex(start) {
                continue;
            }
            seen[start as usize] = true;
            let mut next = vertices.len();
            vertices.push(start);
            while let Some(&v) = vertices.get(next) {
                next += 1;
                for h in self.outgoing(v) {
                    let (t, w) = (h / 3, self.target(h));
                    if !std::mem::replace(&mut numbered[t as usize], true) {
                        triangles.push(t);
                    }
                    if !std::mem::replace(&mut seen[w as usize], true) {
                        vertices.push(w);
                    }
                }
            }
        }
        self.renumber(&triangles, &vertices);
        vertices
    }

    /// Puts triangles and vertices, all that there are, into the order given.
    fn renumber(&mut self, triangles: &[u32], vertices: &[u32]) {
        let mut triangle = vec![NONE; self.tri.len()];
        for (new, &old) in triangles.iter().enumerate() {
            triangle[old as usize] = new as u32;
        }
        let mut vertex = vec![NONE; self.points.len()];
        for (new, &old) in vertices.iter().enumerate() {
            vertex[old as usize] = new as u32;
        }
        let half_edge = |h: u32| 3 * triangle[h as usize / 3] + h % 3;
        let sides = || triangles.iter().flat_map(|&t| [3 * t, 3 * t + 1, 3 * t + 2]).map(|h| h as usize);
        self.twin = sides().map(|h| half_edge(self.twin[h])).collect();
        self.feature = sides().map(|h| self.feature[h]).collect();
        self.out = vertices.iter().map(|&v| half_edge(self.out[v as usize])).collect();
        self.points = vertices.iter().map(|&v| self.points[v as usize]).collect();
        self.patch = triangles.iter().map(|&t| self.patch[t as usize]).collect();
        self.tri = triangles.iter().map(|&t| self.tri[t as usize].map(|v| vertex[v as usize])).collect();
        self.removed_triangles = 0;
    }

    /// Number of triangle ids, removed ones included.
    pub fn triangle_ids(&self) -> usize {
        self.tri.len()
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.tri.len() - self.removed_triangles
    }

    /// Whether triangle `t` exists.
    pub fn has_triangle(&self, t: u32) -> bool {
        self.tri[t as usize][0] != NONE
    }

    /// Whether vertex `v` exists.
    pub fn has_vertex(&self, v: u32) -> bool {
        self.out[v as usize] != NONE
    }

    /// Vertices of triangle `t`.
    #[inline]
    pub fn triangle(&self, t: u32) -> [u32; 3] {
        self.tri[t as usize]
    }

    /// Corners of triangle `t`.
    #[inline]
    pub fn corners(&self, t: u32) -> [Point; 3] {
        self.tri[t as usize].map(|v| self.points[v as usize])
    }

    /// Patch of triangle `t`.
    #[inline]
    pub fn patch(&self, t: u32) -> PatchId {
        self.patch[t as usize]
    }

    /// The half-edge that runs back along the same edge.
    #[inline]
    pub fn twin(&self, h: u32) -> u32 {
        self.twin[h as usize]
    }

    /// Next half-edge of the same triangle.
    #[inline]
    pub fn next(h: u32) -> u32 {
        if h % 3 == 2 { h - 2 } else { h + 1 }
    }

    /// Previous half-edge of the same triangle.
    #[inline]
    pub fn prev(h: u32) -> u32 {
        if h % 3 == 0 { h + 2 } else { h - 1 }
    }

    /// Vertex that `h` starts at.
    #[inline]
    pub fn origin(&self, h: u32) -> u32 {
        self.tri[h as usize / 3][h as usize % 3]
    }

    /// Vertex that `h` ends at.
    #[inline]
    pub fn target(&self, h: u32) -> u32 {
        self.origin(Self::next(h))
    }

    /// Vertex across from `h` in its triangle.
    #[inline]
    pub fn apex(&self, h: u32) -> u32 {
        self.origin(Self::prev(h))
    }

    /// Whether the edge of `h` is a feature.
    #[inline]
    pub fn is_feature(&self, h: u32) -> bool {
        self.feature[h as usize]
    }

    /// Makes the edge of `h` a feature.
    pub fn mark_feature(&mut self, h: u32) {
        self.feature[h as usize] = true;
        let g = self.twin(h);
        self.feature[g as usize] = true;
    }

    /// Half-edges that start at `v`, counter-clockwise. The vertex must exist.
    #[inline]
    pub fn outgoing(&self, v: u32) -> Outgoing<'_> {
        let h = self.out[v as usize];
        Outgoing { mesh: self, first: h, at: h, done: h == NONE }
    }

    /// Number of edges at `v`.
    pub fn valence(&self, v: u32) -> usize {
        self.outgoing(v).count()
    }

    /// The half-edge from `a` to `b`.
    pub fn find(&self, a: u32, b: u32) -> Option<u32> {
        if !self.has_vertex(a) || !self.has_vertex(b) {
            return None;
        }
        self.outgoing(a).find(|&h| self.target(h) == b)
    }

    /// Half-edges that stand for their edge: the lower id of each pair of twins.
    pub fn edges(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.twin.len() as u32).filter(|&h| self.has_triangle(h / 3) && h < self.twin(h))
    }

    /// Whether the edge of `h` may be turned: no feature, and its new ends are not neighbours yet.
    pub fn can_flip(&self, h: u32) -> bool {
        if self.is_feature(h) {
            return false;
        }
        let (c, d) = (self.apex(h), self.apex(self.twin(h)));
        c != d && self.find(c, d).is_none()
    }

    /// Turns the edge of `h` in its quadrilateral. [`Self::can_flip`] must hold. Returns the half-edge of the new edge.
    pub fn flip(&mut self, h: u32) -> u32 {
        let g = self.twin(h);
        let (t0, t1) = (h / 3, g / 3);
        let (a, b, c, d) = (self.origin(h), self.target(h), self.apex(h), self.apex(g));
        let [bc, ca, ad, db] = [Self::next(h), Self::prev(h), Self::next(g), Self::prev(g)]
            .map(|e| (self.twin(e), self.feature[e as usize]));
        self.tri[t0 as usize] = [c, a, d];
        self.tri[t1 as usize] = [d, b, c];
        self.link(3 * t0, ca);
        self.link(3 * t0 + 1, ad);
        self.link(3 * t1, db);
        self.link(3 * t1 + 1, bc);
        self.link(3 * t0 + 2, (3 * t1 + 2, false));
        for (v, e) in [(a, 3 * t0 + 1), (b, 3 * t1 + 1), (c, 3 * t0), (d, 3 * t1)] {
            self.out[v as usize] = e;
        }
        3 * t0 + 2
    }

    /// Puts a vertex at `p` on the edge of `h` and joins it to both apexes. Returns it.
    pub fn split(&mut self, h: u32, p: Point) -> u32 {
        let g = self.twin(h);
        let (t0, t1) = (h / 3, g / 3);
        let (a, b, c, d) = (self.origin(h), self.target(h), self.apex(h), self.apex(g));
        let feature = self.is_feature(h);
        let [bc, ca, ad, db] = [Self::next(h), Self::prev(h), Self::next(g), Self::prev(g)]
            .map(|e| (self.twin(e), self.feature[e as usize]));
        let m = self.points.len() as u32;
        self.points.push(p);
        self.out.push(NONE);
        let (t2, t3) = (self.tri.len() as u32, self.tri.len() as u32 + 1);
        self.tri[t0 as usize] = [a, m, c];
        self.tri[t1 as usize] = [m, a, d];
        self.tri.push([m, b, c]);
        self.tri.push([b, m, d]);
        self.patch.push(self.patch[t0 as usize]);
        self.patch.push(self.patch[t1 as usize]);
        self.twin.extend([NONE; 6]);
        self.feature.extend([false; 6]);
        self.link(3 * t0, (3 * t1, feature));
        self.link(3 * t0 + 1, (3 * t2 + 2, false));
        self.link(3 * t0 + 2, ca);
        self.link(3 * t1 + 1, ad);
        self.link(3 * t1 + 2, (3 * t3 + 1, false));
        self.link(3 * t2, (3 * t3, feature));
        self.link(3 * t2 + 1, bc);
        self.link(3 * t3 + 2, db);
        for (v, e) in [(a, 3 * t0), (b, 3 * t3), (c, 3 * t0 + 2), (d, 3 * t1 + 2), (m, 3 * t2)] {
            self.out[v as usize] = e;
        }
        m
    }

    /// Whether the surface stays the same when the ends of `h` become one (the link condition).
    pub fn can_collapse(&self, h: u32) -> bool {
        let g = self.twin(h);
        let (a, b) = (self.origin(h), self.target(h));
        let (c, d) = (self.apex(h), self.apex(g));
        if c == d || self.valence(c) <= 3 || self.valence(d) <= 3 {
            return false;
        }
        self.outgoing(a).all(|e| {
            let x = self.target(e);
            x == b || x == c || x == d || self.find(b, x).is_none()
        })
    }

    /// Draws the origin of `h` onto its target, which keeps its position. [`Self::can_collapse`] must hold.
    /// Features of an edge that falls onto another are kept.
    pub fn collapse(&mut self, h: u32) {
        let g = self.twin(h);
        let (a, b) = (self.origin(h), self.target(h));
        let (c, d) = (self.apex(h), self.apex(g));
        let (t0, t1) = (h / 3, g / 3);
        let mut e = self.out[a as usize];
        let first = e;
        loop {
            self.tri[e as usize / 3][e as usize % 3] = b;
            e = self.twin(Self::prev(e));
            if e == first {
                break;
            }
        }
        // b c | c a fall together, and a d | d b.
        let (bc, ca) = (Self::next(h), Self::prev(h));
        let (ad, db) = (Self::next(g), Self::prev(g));
        let f0 = self.feature[bc as usize] || self.feature[ca as usize];
        let f1 = self.feature[ad as usize] || self.feature[db as usize];
        let (cb_out, ac_out) = (self.twin(bc), self.twin(ca));
        let (da_out, bd_out) = (self.twin(ad), self.twin(db));
        self.link(cb_out, (ac_out, f0));
        self.link(da_out, (bd_out, f1));
        // cb_out: c → b; ac_out: b → c (a became b); da_out: d → b; bd_out: b → d.
        for (v, e) in [(b, ac_out), (c, cb_out), (d, da_out)] {
            self.out[v as usize] = e;
        }
        for t in [t0, t1] {
            self.tri[t as usize] = [NONE; 3];
        }
        self.out[a as usize] = NONE;
        self.removed_triangles += 2;
    }

    #[inline]
    fn link(&mut self, h: u32, (twin, feature): (u32, bool)) {
        self.twin[h as usize] = twin;
        self.twin[twin as usize] = h;
        self.feature[h as usize] = feature;
        self.feature[twin as usize] = feature;
    }
}

/// Half-edges out of a vertex; see [`HalfEdgeMesh::outgoing`].
pub struct Outgoing<'a> {
    mesh: &'a HalfEdgeMesh,
    first: u32,
    at: u32,
    done: bool,
}

impl Iterator for Outgoing<'_> {
    type Item = u32;

    #[inline]
    fn next(&mut self) -> Option<u32> {
        if self.done {
            return None;
        }
        let h = self.at;
        self.at = self.mesh.twin(HalfEdgeMesh::prev(h));
        self.done = self.at == self.first;
        Some(h)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn octahedron() -> TriMesh {
        let points = vec![
            Point::new(1., 0., 0.),
            Point::new(0., 1., 0.),
            Point::new(-1., 0., 0.),
            Point::new(0., -1., 0.),
            Point::new(0., 0., 1.),
            Point::new(0., 0., -1.),
        ];
        let triangles =
            (0..4).flat_map(|i| [[i, (i + 1) % 4, 4], [(i + 1) % 4, i, 5]]).collect();
        TriMesh::new(points, triangles)
    }

    fn assert_sound(m: &HalfEdgeMesh) {
        let r = topology::check(&m.clone().into_mesh());
        assert!(r.is_closed_manifold() && r.euler == 2, "{r:?}");
        for h in 0..3 * m.triangle_ids() as u32 {
            if m.has_triangle(h / 3) {
                assert_eq!(m.twin(m.twin(h)), h);
                assert_eq!((m.origin(h), m.target(h)), (m.target(m.twin(h)), m.origin(m.twin(h))));
                assert!(m.outgoing(m.origin(h)).any(|e| e == h));
            }
        }
    }

    #[test]
    fn split_flip_and_collapse_keep_the_sphere() {
        let mut m = HalfEdgeMesh::new(&octahedron()).unwrap();
        let mut random = 12345u64;
        for step in 0..2000 {
            random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let edges: Vec<u32> = m.edges().collect();
            let h = edges[(random >> 33) as usize % edges.len()];
            match step % 5 {
                0 | 1 => {
                    let p = nalgebra::center(&m.points[m.origin(h) as usize], &m.points[m.target(h) as usize]);
                    m.split(h, p);
                }
                2 | 3 if m.can_flip(h) => {
                    let (c, d) = (m.apex(h), m.apex(m.twin(h)));
                    let e = m.flip(h);
                    assert!([m.origin(e), m.target(e)] == [d, c]);
                }
                _ if m.can_collapse(h) => m.collapse(h),
                _ => {}
            }
            if step % 50 == 0 {
                assert_sound(&m);
            }
            if step % 300 == 0 {
                let before = m.clone().into_mesh();
                let old = m.compact();
                assert_eq!((m.triangle_ids(), m.points.len()), (m.triangle_count(), old.len()));
                assert!(old.is_sorted() && m.clone().into_mesh() == before);
                assert_sound(&m);
            }
        }
        assert_sound(&m);
        assert_eq!(m.triangle_count(), m.clone().into_mesh().triangles.len());
    }

    #[test]
    fn rims_between_patches_are_features_and_survive_a_collapse() {
        let mut mesh = octahedron();
        mesh.patch = vec![1, 2, 1, 2, 1, 2, 1, 2];
        let mut m = HalfEdgeMesh::new(&mesh).unwrap();
        assert_eq!(m.edges().filter(|&h| m.is_feature(h)).count(), 4);
        let h = m.find(0, 1).unwrap();
        let v = m.split(h, Point::new(0.7, 0.7, 0.0));
        assert_eq!(m.edges().filter(|&h| m.is_feature(h)).count(), 5);
        let h = m.find(v, 1).unwrap();
        m.collapse(h);
        assert_eq!(m.edges().filter(|&h| m.is_feature(h)).count(), 4);
        assert!(!m.can_flip(m.find(0, 1).unwrap()));
    }

    #[test]
    fn a_walk_over_the_mesh_gives_new_ids_and_the_same_triangles() {
        let mut m = HalfEdgeMesh::new(&octahedron()).unwrap();
        for n in 0..40u32 {
            let h = m.edges().nth((7 * n as usize) % m.edges().count()).unwrap();
            let p = nalgebra::center(&m.points[m.origin(h) as usize], &m.points[m.target(h) as usize]);
            m.split(h, p);
        }
        let corners = |m: &HalfEdgeMesh| {
            let mut all: Vec<[[u64; 3]; 3]> = m.clone().into_mesh().triangles.iter().map(|t| {
                let mut c = t.map(|v| [0, 1, 2].map(|a| m.points[v as usize][a].to_bits()));
                let least = (0..3).min_by_key(|&i| c[i]).unwrap();
                c.rotate_left(least);
                c
            }).collect();
            all.sort_unstable();
            all
        };
        let (before, reach) = (corners(&m), |m: &HalfEdgeMesh| m.edges().map(|h| m.origin(h).abs_diff(m.target(h))).max());
        let far = reach(&m);
        m.sort_by_walk();
        assert_sound(&m);
        assert_eq!(corners(&m), before);
        assert!(reach(&m) < far, "{:?} {far:?}", reach(&m));
    }

    #[test]
    fn an_open_mesh_is_refused() {
        let mut mesh = octahedron();
        mesh.triangles.pop();
        mesh.patch.pop();
        assert_eq!(HalfEdgeMesh::new(&mesh).unwrap_err().open_edges, 3);
    }
}
