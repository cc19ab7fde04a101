//! Fewer irregular vertices: glides and annihilations.
//!
//! In a triangulation of even size a pair of neighbours with five and seven edges is a dislocation. A flip moves it by
//! one edge at no cost in valence; where it meets another of opposite sense both vanish. Greedy flips stop at the
//! cost; here short chains of free flips are tried from each pair and kept where they end in a gain.

use super::isotropic::flip_shapes;
use super::surface::{Kind, Surface};
use super::valence::Valences;
use crate::mesh::halfedge::HalfEdgeMesh;

/// Cosine of the smallest angle that a flip may leave: 13°; relaxation rounds the triangles afterwards.
const SHAPE: f64 = 0.974;

/// Flips tried from one irregular vertex.
const BUDGET: usize = 200;

/// Tries chains of up to `depth` flips from every irregular vertex. Returns the flips that were kept.
pub(crate) fn anneal(s: &mut Surface, depth: usize) -> usize {
    let mut valences = Valences::new(s);
    let mut kept = 0;
    for v in 0..s.mesh.points.len() as u32 {
        if !s.mesh.has_vertex(v) || s.kind[v as usize] == Kind::Locked || valences.is_regular(s, v) {
            continue;
        }
        let mut chain = Vec::with_capacity(depth);
        let mut budget = BUDGET;
        if search(s, &mut valences, &[v], depth, 0, &mut chain, &mut budget) {
            kept += chain.len();
        }
    }
    kept
}

/// Depth-first over chains of flips near `near` whose total cost never rises; true when a chain gains.
fn search(
    s: &mut Surface,
    valences: &mut Valences,
    near: &[u32],
    depth: usize,
    cost: i32,
    chain: &mut Vec<[u32; 4]>,
    budget: &mut usize,
) -> bool {
    // Flips that touch a vertex of `near` with one of their four corners; best first.
    let mut candidates: Vec<(i32, u32, u32)> = Vec::with_capacity(24);
    for &v in near {
        for e in s.mesh.outgoing(v) {
            for h in [e, HalfEdgeMesh::next(e)] {
                let (a, b) = (s.mesh.origin(h), s.mesh.target(h));
                if s.mesh.is_feature(h) || s.is_locked(h) {
                    continue;
                }
                let change = valences.change(s, h);
                let limit = if chain.is_empty() { 0 } else { -cost };
                let back = chain.last().is_some_and(|l| (l[2] == a && l[3] == b) || (l[2] == b && l[3] == a));
                if change <= limit && !back {
                    candidates.push((change, a.min(b), a.max(b)));
                }
            }
        }
    }
    candidates.sort_unstable();
    candidates.dedup();
    for (change, a, b) in candidates {
        if *budget == 0 {
            return false;
        }
        if change >= 0 && depth <= 1 {
            break;
        }
        let Some(h) = s.mesh.find(a, b) else { continue };
        let Some((old, new)) = flip_shapes(s, h) else { continue };
        if (new > SHAPE && new >= old) || !s.mesh.can_flip(h) {
            continue;
        }
        *budget -= 1;
        let ends = valences.flip(s, h);
        let [.., c, d] = ends;
        chain.push(ends);
        if cost + change < 0 {
            return true;
        }
        let irregular: Vec<u32> = ends.into_iter().filter(|&v| !valences.is_regular(s, v)).collect();
        if depth > 1 && search(s, valences, &irregular, depth - 1, cost + change, chain, budget) {
            return true;
        }
        // Back: the flip of the new edge restores the old one.
        chain.pop();
        if let Some(h) = s.mesh.find(c, d) {
            valences.flip(s, h);
        }
    }
    false
}
