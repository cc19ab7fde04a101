//! Prisms into tetrahedra, for readers that take one kind of cells.
//!
//! After Dompierre, Labbé, Vallet and Camarero 1999 ("How to subdivide pyramids, prisms and hexahedra into
//! tetrahedra"): the diagonal of every quadrilateral starts at its vertex of least id, so that neighbours agree without
//! knowing of each other, and no prism is left without a subdivision.

use super::{BoundaryFace, VolumeMesh};
use crate::geometry::Point;

/// Why prisms cannot be split.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{count} of the tetrahedra that prisms are split into would be flat or inverted, the first at {at:.3?} mm")]
pub struct SplitError {
    /// How many.
    pub count: usize,
    /// Middle of the first, mm.
    pub at: [f64; 3],
}

/// The prism's corners, from each corner as the first: turned, never mirrored.
const TURNS: [[usize; 6]; 6] = [
    [0, 1, 2, 3, 4, 5],
    [1, 2, 0, 4, 5, 3],
    [2, 0, 1, 5, 3, 4],
    [3, 5, 4, 0, 2, 1],
    [4, 3, 5, 1, 0, 2],
    [5, 4, 3, 2, 1, 0],
];

/// The mesh with three tetrahedra instead of each prism and two triangles instead of each quadrilateral. Points keep
/// their ids; the tetrahedra that were there stay first, those of prism `k` follow in its order.
///
/// # Errors
/// [`SplitError`] where a prism is so warped that a tetrahedron in it is not positive.
pub fn prisms(mesh: &VolumeMesh) -> Result<VolumeMesh, SplitError> {
    let mut tets = mesh.tets.clone();
    tets.extend(mesh.prisms.iter().flat_map(split));
    let corner = |v: u32| mesh.points[v as usize];
    let positive = |t: &&[u32; 4]| {
        let [a, b, c, d] = t.map(corner);
        !((b - a).cross(&(c - a)).dot(&(d - a)) > 0.0)
    };
    let bad: Vec<&[u32; 4]> = tets[mesh.tets.len()..].iter().filter(positive).collect();
    if let Some(first) = bad.first() {
        let middle = first.iter().map(|&v| corner(v).coords).sum::<crate::geometry::Vector>() / 4.0;
        return Err(SplitError { count: bad.len(), at: Point::from(middle).into() });
    }
    let boundary = mesh.boundary.iter().flat_map(triangles).collect();
    Ok(VolumeMesh { points: mesh.points.clone(), tets, prisms: vec![], boundary, patches: mesh.patches.clone() })
}

fn split(p: &[u32; 6]) -> [[u32; 4]; 3] {
    let first = (0..6).min_by_key(|&i| p[i]).unwrap_or(0);
    let [a, b, c, d, e, f] = TURNS[first].map(|i| p[i]);
    // Two diagonals start at the first corner; the third lies across the opposite quadrilateral.
    let parts = if b.min(f) < c.min(e) {
        [[a, b, c, f], [a, b, f, e], [a, e, f, d]]
    } else {
        [[a, b, c, e], [a, e, c, f], [a, e, f, d]]
    };
    // Triangle 0 1 2 of a prism looks away from the others, a tetrahedron's towards its fourth corner.
    parts.map(|[a, b, c, d]| [a, c, b, d])
}

fn triangles(face: &BoundaryFace) -> Vec<BoundaryFace> {
    if face.ids().len() == 3 {
        return vec![*face];
    }
    let first = (0..4).min_by_key(|&i| face.vertices[i]).unwrap_or(0);
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| face.vertices[(first + i) % 4]);
    [[a, b, c], [a, c, d]].map(|t| BoundaryFace::triangle(t, face.patch)).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(mesh: &VolumeMesh) -> f64 {
        let six = |t: &[u32; 4]| {
            let [a, b, c, d] = t.map(|v| mesh.points[v as usize]);
            (b - a).cross(&(c - a)).dot(&(d - a))
        };
        mesh.tets.iter().map(six).sum::<f64>() / 6.0
    }

    /// Two prisms side by side and one below, under every numbering of the first six points.
    #[test]
    fn neighbours_agree_whatever_the_numbers_are() {
        let at = [
            [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0],
            [1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 1.0, -1.0],
        ];
        let prisms = [[0, 2, 1, 3, 5, 4], [1, 2, 6, 4, 5, 7], [8, 10, 9, 0, 2, 1]];
        let mut order: Vec<usize> = (0..at.len()).collect();
        for round in 0..500 {
            // A simple walk through the permutations.
            let n = at.len();
            order.swap(round % n, (round * 7 + round / n) % n);
            let mut mesh = VolumeMesh { points: vec![Point::origin(); n], ..VolumeMesh::default() };
            for (p, &id) in at.iter().zip(&order) {
                mesh.points[id] = Point::from(*p);
            }
            mesh.prisms = prisms.iter().map(|p: &[usize; 6]| p.map(|i| order[i] as u32)).collect();
            mesh.boundary = mesh.outer_faces().expect("the prisms conform").into_iter().map(|v| BoundaryFace { vertices: v, patch: 1 }).collect();
            let split = super::prisms(&mesh).expect("straight prisms");
            assert_eq!((split.tets.len(), split.prisms.len()), (9, 0));
            assert!((volume(&split) - 1.5).abs() < 1e-12);
            // Every outer triangle is one of the boundary's.
            let sorted = |mut v: Vec<u32>| {
                v.sort_unstable();
                v.dedup();
                v
            };
            let mut outer: Vec<_> = split.outer_faces().expect("tetrahedra conform").iter().map(|v| sorted(v.to_vec())).collect();
            let mut listed: Vec<_> = split.boundary.iter().map(|f| sorted(f.ids().to_vec())).collect();
            outer.sort();
            listed.sort();
            assert_eq!(outer, listed, "round {round}");
        }
    }

    #[test]
    fn a_prism_inside_out_is_refused_with_its_place() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
        let mesh = VolumeMesh { points: points.map(Point::from).to_vec(), prisms: vec![[0, 1, 2, 3, 4, 5]], ..VolumeMesh::default() };
        let e = prisms(&mesh).expect_err("inverted");
        assert_eq!(e.count, 3);
    }
}
