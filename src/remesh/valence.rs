//! How many triangles meet at a vertex, against how many should.
//!
//! Six round a vertex inside a surface. At a vertex of a rim, of another feature or of the border of the region that
//! may change, each sector between such edges counts by itself: as many triangles as its angle has sixths of a turn,
//! so three on either side of a smooth rim, whatever the sum.

use std::f64::consts::FRAC_PI_3;

use super::surface::{Kind, Surface};
use crate::mesh::halfedge::HalfEdgeMesh;

/// Valences of all vertices, kept up to date over flips.
pub(crate) struct Valences {
    /// Edges at a vertex beyond six.
    beyond_six: Vec<i32>,
    /// Whether features or held edges part the triangles round a vertex.
    parted: Vec<bool>,
}

impl Valences {
    /// Counts the valences of `s`.
    pub fn new(s: &Surface) -> Valences {
        let mut beyond_six = vec![-6; s.mesh.points.len()];
        let mut parted: Vec<bool> = s.kind.iter().map(|k| *k == Kind::Locked).collect();
        for t in (0..s.mesh.triangle_ids() as u32).filter(|&t| s.mesh.has_triangle(t)) {
            for h in 3 * t..3 * t + 3 {
                let v = s.mesh.origin(h) as usize;
                beyond_six[v] += 1;
                parted[v] |= s.mesh.is_feature(h);
            }
        }
        Valences { beyond_six, parted }
    }

    /// Triangles too many at the origin of `h`, in the sector that the triangle of `h` lies in; negative for too few.
    #[inline]
    pub fn excess(&self, s: &Surface, h: u32) -> i32 {
        let v = s.mesh.origin(h) as usize;
        if self.parted[v] { sector(s, h) } else { self.beyond_six[v] }
    }

    /// Whether every sector at `v` has as many triangles as it should.
    pub fn is_regular(&self, s: &Surface, v: u32) -> bool {
        if self.parted[v as usize] {
            s.mesh.outgoing(v).all(|h| sector(s, h) == 0)
        } else {
            self.beyond_six[v as usize] == 0
        }
    }

    /// Change of the sum of squared excesses if the edge of `h` were flipped.
    #[inline]
    pub fn change(&self, s: &Surface, h: u32) -> i32 {
        let (next, prev) = (HalfEdgeMesh::next(h), HalfEdgeMesh::prev(h));
        let across = HalfEdgeMesh::prev(s.mesh.twin(h));
        let [a, b, c, d] = [h, next, prev, across].map(|e| self.excess(s, e));
        4 + 2 * (c + d - a - b)
    }

    /// Flips the edge of `h`; it must be one that can be. Gives the edge's old ends and its new ones.
    pub fn flip(&mut self, s: &mut Surface, h: u32) -> [u32; 4] {
        let ends = [s.mesh.origin(h), s.mesh.target(h), s.mesh.apex(h), s.mesh.apex(s.mesh.twin(h))];
        s.mesh.flip(h);
        for (v, by) in ends.into_iter().zip([-1, -1, 1, 1]) {
            self.beyond_six[v as usize] += by;
        }
        ends
    }
}

/// Excess of the sector at the origin of `h` that its triangle lies in.
fn sector(s: &Surface, h: u32) -> i32 {
    let ends = |e: u32| s.mesh.is_feature(e) || s.is_locked(e);
    // Back to the sector's first edge, then over its triangles.
    let mut first = h;
    while !ends(first) {
        first = HalfEdgeMesh::next(s.mesh.twin(first));
        if first == h {
            break;
        }
    }
    let (mut count, mut angle, mut e) = (0, 0.0, first);
    loop {
        let (p, a, b) = (s.point(s.mesh.origin(e)), s.point(s.mesh.target(e)), s.point(s.mesh.apex(e)));
        let (u, w) = (a - p, b - p);
        angle += u.cross(&w).norm().atan2(u.dot(&w));
        count += 1;
        e = s.mesh.twin(HalfEdgeMesh::prev(e));
        if e == first || ends(e) {
            break;
        }
    }
    count - ((angle / FRAC_PI_3).round() as i32).max(1)
}
