//! Triangles that agree with their neighbours, shells that look outwards.

use super::super::TriMesh;
use super::super::winding::WindingNumbers;
use super::closed;
use crate::geometry::Aabb;

/// What was turned.
pub(super) struct Oriented {
    /// Triangles turned to agree with their shell.
    pub turned: Vec<usize>,
    /// The first triangle of each shell that was turned as a whole.
    pub turned_shells: Vec<usize>,
    /// Edges of more than two triangles.
    pub several: Vec<[u32; 2]>,
}

/// Shells whose volume is less than this part of that of a ball of their area keep their orientation: they enclose nothing.
const ENCLOSES: f64 = 1e-3;

pub(super) fn orient(mesh: &mut TriMesh) -> Oriented {
    let n = mesh.triangles.len();
    // Corners by their edge; a corner's edge runs to the next corner.
    let ends = |c: usize, m: &TriMesh| (m.triangles[c / 3][c % 3], m.triangles[c / 3][(c + 1) % 3]);
    let key = |c: usize, m: &TriMesh| {
        let (a, b) = ends(c, m);
        [a.min(b), a.max(b)]
    };
    let mut corners: Vec<usize> = (0..3 * n).collect();
    corners.sort_by_key(|&c| (key(c, mesh), c));
    let mut opposite = vec![usize::MAX; 3 * n];
    let mut several = Vec::new();
    for edge in corners.chunk_by(|&a, &b| key(a, mesh) == key(b, mesh)) {
        match *edge {
            [a, b] => (opposite[a], opposite[b]) = (b, a),
            [_] => {}
            _ => several.push(key(edge[0], mesh)),
        }
    }
    // Shells: triangles reached over edges of two.
    let mut shell = vec![usize::MAX; n];
    let mut flip = vec![false; n];
    let mut shells: Vec<Vec<usize>> = Vec::new();
    for first in 0..n {
        if shell[first] != usize::MAX {
            continue;
        }
        shell[first] = shells.len();
        let mut own = vec![first];
        let mut at = 0;
        while at < own.len() {
            let t = own[at];
            at += 1;
            for c in 3 * t..3 * t + 3 {
                let o = opposite[c];
                if o == usize::MAX || shell[o / 3] != usize::MAX {
                    continue;
                }
                shell[o / 3] = shells.len();
                flip[o / 3] = flip[t] ^ (ends(c, mesh) == ends(o, mesh));
                own.push(o / 3);
            }
        }
        // As most of its area has it.
        let area = |t: usize| mesh.area_vector2(t).norm();
        let (all, against) = own.iter().fold((0.0, 0.0), |(a, b), &t| (a + area(t), b + if flip[t] { area(t) } else { 0.0 }));
        if against > 0.5 * all {
            own.iter().for_each(|&t| flip[t] ^= true);
        }
        shells.push(own);
    }
    let turned: Vec<usize> = (0..n).filter(|&t| flip[t]).collect();
    turned.iter().for_each(|&t| mesh.triangles[t].swap(1, 2));
    let turned_shells = outwards(mesh, &shells);
    Oriented { turned, turned_shells, several }
}

/// Turns shells that look inwards, and with each what lies inside it.
fn outwards(mesh: &mut TriMesh, shells: &[Vec<usize>]) -> Vec<usize> {
    struct Shell {
        volume: f64,
        bounds: Aabb,
        first: usize,
        closed: TriMesh,
    }
    let mut known: Vec<Shell> = Vec::new();
    for own in shells {
        let part = alone(mesh, own);
        let area = part.area();
        let closed = closed(&part);
        let volume = closed.volume();
        let ball = area.powf(1.5) / (6.0 * std::f64::consts::PI.sqrt());
        if volume.abs() > ENCLOSES * ball {
            known.push(Shell { volume, bounds: part.bounds(), first: own[0], closed });
        }
    }
    known.sort_by(|a, b| b.volume.abs().total_cmp(&a.volume.abs()));
    let mut turn: Vec<bool> = Vec::new();
    let mut trees: Vec<Option<WindingNumbers>> = known.iter().map(|_| None).collect();
    for i in 0..known.len() {
        let s = &known[i];
        let p = s.closed.points[0];
        let around = (0..i).rev().find(|&j| {
            let within = known[j].bounds.union(&s.bounds) == known[j].bounds;
            within && trees[j].get_or_insert_with(|| WindingNumbers::new(&known[j].closed)).at(&p).abs() > 0.5
        });
        // A cavity runs against what is round it.
        turn.push(around.map_or(s.volume < 0.0, |j| turn[j]));
    }
    let turned: Vec<usize> = known.iter().zip(&turn).filter(|x| *x.1).map(|x| x.0.first).collect();
    for own in shells.iter().filter(|own| turned.contains(&own[0])) {
        own.iter().for_each(|&t| mesh.triangles[t].swap(1, 2));
    }
    turned
}

/// Some triangles of a mesh with their points; the work is theirs, not the mesh's, for there may be thousands of shells.
fn alone(mesh: &TriMesh, own: &[usize]) -> TriMesh {
    let mut ids: Vec<u32> = own.iter().flat_map(|&t| mesh.triangles[t]).collect();
    ids.sort_unstable();
    ids.dedup();
    let number = |v: u32| ids.partition_point(|&w| w < v) as u32;
    TriMesh::new(ids.iter().map(|&v| mesh.points[v as usize]).collect(), own.iter().map(|&t| mesh.triangles[t].map(number)).collect())
}
