//! Fewer irregular vertices: glides and annihilations.
//!
//! In a triangulation of even size a pair of neighbours with five and seven edges is a dislocation. A flip moves it by
//! one edge at no cost in valence; where it meets another of opposite sense both vanish. Greedy flips stop at the
//! cost; here short chains of free flips are tried from each pair and kept where they end in a gain.

use super::isotropic::flip_shapes;
use super::surface::Surface;

/// Cosine of the smallest angle that a flip may leave: 13°; relaxation rounds the triangles afterwards.
const SHAPE: f64 = 0.974;

/// Tries chains of up to `depth` flips from every irregular vertex. Returns the flips that were kept.
pub(crate) fn anneal(s: &mut Surface, depth: usize) -> usize {
    let mut valence = vec![0i32; s.mesh.points.len()];
    for t in (0..s.mesh.triangle_ids() as u32).filter(|&t| s.mesh.has_triangle(t)) {
        for v in s.mesh.triangle(t) {
            valence[v as usize] += 1;
        }
    }
    let mut kept = 0;
    for v in 0..s.mesh.points.len() as u32 {
        if !s.mesh.has_vertex(v) || valence[v as usize] == 6 || !s.kind[v as usize].moves() {
            continue;
        }
        let mut chain = Vec::with_capacity(depth);
        let mut budget = 60;
        if search(s, &mut valence, &[v], depth, 0, &mut chain, &mut budget) {
            kept += chain.len();
        }
    }
    kept
}

/// Depth-first over chains of flips near `near` whose total cost never rises; true when a chain gains.
fn search(
    s: &mut Surface,
    valence: &mut [i32],
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
            for h in [e, crate::mesh::halfedge::HalfEdgeMesh::next(e)] {
                let (a, b) = (s.mesh.origin(h), s.mesh.target(h));
                if s.mesh.is_feature(h) || s.is_locked(h) {
                    continue;
                }
                let (c, d) = (s.mesh.apex(h), s.mesh.apex(s.mesh.twin(h)));
                let change = 4 + 2
                    * (valence[c as usize] + valence[d as usize] - valence[a as usize] - valence[b as usize]);
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
        let (c, d) = (s.mesh.apex(h), s.mesh.apex(s.mesh.twin(h)));
        flip(s, valence, h, [a, b, c, d]);
        chain.push([a, b, c, d]);
        if cost + change < 0 {
            return true;
        }
        let irregular: Vec<u32> = [a, b, c, d].into_iter().filter(|&v| valence[v as usize] != 6).collect();
        if depth > 1 && search(s, valence, &irregular, depth - 1, cost + change, chain, budget) {
            return true;
        }
        // Back: the flip of the new edge restores the old one.
        chain.pop();
        if let Some(h) = s.mesh.find(c, d) {
            flip(s, valence, h, [c, d, a, b]);
        }
    }
    false
}

fn flip(s: &mut Surface, valence: &mut [i32], h: u32, [a, b, c, d]: [u32; 4]) {
    s.mesh.flip(h);
    valence[a as usize] -= 1;
    valence[b as usize] -= 1;
    valence[c as usize] += 1;
    valence[d as usize] += 1;
}
