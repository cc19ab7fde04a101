//! Open edges of a surface and the loops that they form.

use std::collections::BTreeMap;

use super::TriMesh;

/// Edges that triangles run along more often in one direction than in the other, in that direction, as often as that; ascending.
///
/// The rims of an oriented surface. They always form loops, whatever the surface: at each vertex as many begin as end.
pub fn open_edges(triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut all: Vec<([u32; 2], i8)> = triangles
        .iter()
        .flat_map(|t| (0..3).map(|i| (t[i], t[(i + 1) % 3])))
        .filter(|(a, b)| a != b)
        .map(|(a, b)| if a < b { ([a, b], 1) } else { ([b, a], -1) })
        .collect();
    all.sort_unstable();
    let mut open = Vec::new();
    for edge in all.chunk_by(|a, b| a.0 == b.0) {
        let net: i32 = edge.iter().map(|e| i32::from(e.1)).sum();
        let [a, b] = edge[0].0;
        open.extend(std::iter::repeat_n(if net > 0 { [a, b] } else { [b, a] }, net.unsigned_abs() as usize));
    }
    open.sort_unstable();
    open
}

/// The open edges as loops that pass no vertex twice, in the direction of the triangles: a rim seen from outside the body turns
/// clockwise round the opening.
pub fn loops(mesh: &TriMesh) -> Vec<Vec<u32>> {
    loops_of(&mesh.triangles)
}

/// [`loops`] of some triangles.
pub(super) fn loops_of(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let open = open_edges(triangles);
    let mut used = vec![false; open.len()];
    let mut place: BTreeMap<u32, usize> = BTreeMap::new();
    let mut found = Vec::new();
    for first in 0..open.len() {
        if used[first] {
            continue;
        }
        let mut path: Vec<u32> = Vec::new();
        let mut at = open[first][0];
        loop {
            if let Some(&from) = place.get(&at) {
                // Back at a vertex of the path: what lies between is a loop.
                let round = path.split_off(from);
                for v in &round {
                    place.remove(v);
                }
                found.push(round);
            }
            let own = open.partition_point(|e| e[0] < at);
            let next = (own..open.len()).take_while(|&e| open[e][0] == at).find(|&e| !used[e]);
            let Some(e) = next else { break };
            used[e] = true;
            place.insert(at, path.len());
            path.push(at);
            at = open[e][1];
        }
    }
    found.retain(|l| l.len() > 2);
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    #[test]
    fn two_rims_that_touch_in_a_vertex_are_two_loops() {
        // Two triangles that share one vertex.
        let points = (0..5).map(|i| Point::new(f64::from(i), f64::from(i % 2), 0.0)).collect();
        let mesh = TriMesh::new(points, vec![[0, 1, 2], [2, 3, 4]]);
        let mut found = loops(&mesh);
        found.iter_mut().for_each(|l| l.sort_unstable());
        found.sort();
        assert_eq!(found, [vec![0, 1, 2], vec![2, 3, 4]]);
    }

    #[test]
    fn an_edge_of_three_triangles_is_open_once() {
        let open = open_edges(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!(open.iter().filter(|e| **e == [0, 1]).count(), 1);
    }
}
