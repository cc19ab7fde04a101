//! Triangles of the wall with two edges on rims.
//!
//! Such a triangle has one neighbour on the wall only. The prisms that grow from it have two sides on caps, so that
//! all their inner faces are parallel to one line, and OpenFOAM's determinant of such a cell is 0 however good its
//! shape. They stand where two caps meet and where a rim turns sharply.

use std::collections::BTreeSet;

use super::Supports;
use super::shape::skewness;
use crate::mesh::{TriMesh, WALL};

/// The ears among `of`, ascending if `of` is.
pub(crate) fn among(mesh: &TriMesh, of: impl Iterator<Item = usize>) -> Vec<usize> {
    let rim = rim(mesh);
    if rim.is_empty() { Vec::new() } else { of.filter(|&t| mesh.patch[t] == WALL && free_edges(&rim, mesh.triangles[t]).len() == 1).collect() }
}

/// Gives each triangle of the wall at most one edge on a rim: the ear's third edge is flipped, or divided where that
/// gives better triangles or the flip would make another ear. Gives the number of ears opened; one that is folded back
/// on its neighbour stays.
pub(crate) fn open(mesh: &mut TriMesh, supports: &Supports) -> usize {
    let rim = rim(mesh);
    // A change makes no new ears: what it adds has an end inside the wall.
    among(mesh, 0..mesh.triangles.len()).into_iter().filter(|&ear| open_one(mesh, supports, &rim, ear)).count()
}

/// Edges of caps, as the triangles on their other sides run. Those inside caps are no triangle's of the wall.
fn rim(mesh: &TriMesh) -> BTreeSet<[u32; 2]> {
    edges(mesh, |patch| patch != WALL).map(|([a, b], _)| [b, a]).collect()
}

fn edges(mesh: &TriMesh, of: impl Fn(u32) -> bool) -> impl Iterator<Item = ([u32; 2], usize)> {
    let triangles = mesh.triangles.iter().zip(&mesh.patch).enumerate().filter(move |(_, (_, p))| of(**p));
    triangles.flat_map(|(t, (c, _))| (0..3).map(move |i| ([c[i], c[(i + 1) % 3]], t)))
}

/// Which edges of a triangle are on no rim.
fn free_edges(rim: &BTreeSet<[u32; 2]>, c: [u32; 3]) -> Vec<usize> {
    (0..3).filter(|&i| !rim.contains(&[c[i], c[(i + 1) % 3]])).collect()
}

fn open_one(mesh: &mut TriMesh, supports: &Supports, rim: &BTreeSet<[u32; 2]>, ear: usize) -> bool {
    let c = mesh.triangles[ear];
    // Two ears that share their third edge are opened together, with the first.
    let [from] = free_edges(rim, c)[..] else { return false };
    let (a, b, apex) = (c[from], c[(from + 1) % 3], c[(from + 2) % 3]);
    let Some((_, other)) = edges(mesh, |p| p == WALL).find(|(e, _)| *e == [b, a]) else { return false };
    let Some(far) = mesh.triangles[other].into_iter().find(|&v| v != a && v != b) else { return false };
    let place = |v: u32| mesh.points[v as usize];
    let (start, end) = (place(a), place(b));
    let middle = supports.project(WALL, &nalgebra::center(&start, &end), 0.5 * (end - start).norm()).map(|m| m.0);
    let new = mesh.points.len() as u32;
    let flipped = [[a, far, apex], [far, b, apex]];
    let divided = [[a, new, apex], [b, new, far], [new, b, apex], [new, a, far]];
    let outwards = mesh.area_vector2(ear) + mesh.area_vector2(other);
    // The worst skewness; nothing where a triangle would be folded back.
    let worst = |list: &[[u32; 3]]| {
        list.iter().try_fold(0.0f64, |worst, t| {
            let [x, y, z] = t.map(|v| if v == new { middle } else { Some(place(v)) });
            let (x, y, z) = (x?, y?, z?);
            ((y - x).cross(&(z - x)).dot(&outwards) > 0.0).then(|| worst.max(skewness(&x, &y, &z)))
        })
    };
    let joined = mesh.triangles.iter().any(|t| t.contains(&apex) && t.contains(&far));
    let makes_ears = flipped.iter().any(|&t| free_edges(rim, t).len() < 2);
    let flip = if joined || makes_ears { None } else { worst(&flipped) };
    let divide = worst(&divided);
    match (flip, divide, middle) {
        (Some(flip), divide, _) if divide.is_none_or(|divide| flip <= divide) => {
            (mesh.triangles[ear], mesh.triangles[other]) = (flipped[0], flipped[1]);
        }
        (_, Some(_), Some(middle)) => {
            mesh.points.push(middle);
            (mesh.triangles[ear], mesh.triangles[other]) = (divided[0], divided[1]);
            mesh.triangles.extend(&divided[2..]);
            mesh.patch.extend([WALL; 2]);
        }
        _ => return false,
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use crate::mesh::topology::check;
    use crate::remesh::testing::Capsules;

    /// A die whose faces have the patches `patches`: −x, +x, −y, +y, −z, +z. The face −y has its diagonal from
    /// 0 to 5, which lies on the caps −x and +z where these are some.
    fn die(patches: [u32; 6]) -> TriMesh {
        let points = (0..8).map(|i| Point::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect();
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let mut mesh = TriMesh { points, ..TriMesh::default() };
        for ([a, b, c, d], patch) in faces.into_iter().zip(patches) {
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
            mesh.patch.extend([patch; 2]);
        }
        mesh
    }

    /// A wall through the die's face −y, flat enough.
    fn wall() -> Capsules {
        let far = |x: f64| Point::new(x, 1e6, 0.0);
        Capsules { parts: vec![(far(-1.0), far(1.0), 1e6)], blend: 0.0, voxel: 0.1 }
    }

    fn opened(patches: [u32; 6]) -> (TriMesh, usize) {
        let wall = wall();
        let mut mesh = die(patches);
        let n = open(&mut mesh, &Supports::new(&wall));
        let t = check(&mesh);
        assert!(t.is_closed_manifold() && t.euler == 2 && (mesh.volume() - 1.0).abs() < 1e-4, "{t:?}");
        assert!(among(&mesh, 0..mesh.triangles.len()).is_empty());
        (mesh, n)
    }

    #[test]
    fn where_two_caps_meet_no_triangle_of_the_wall_lies_on_both() {
        // Both ears on the walls ±y are opened.
        let (mesh, n) = opened([2, 1, 1, 1, 1, 3]);
        assert_eq!((n, mesh.triangles.len()), (2, 12), "by flips");
        assert!(mesh.triangles.iter().any(|t| t.contains(&1) && t.contains(&4)));
    }

    #[test]
    fn a_piece_of_wall_between_four_caps_is_divided() {
        let (mesh, n) = opened([2, 3, 1, 6, 4, 5]);
        assert!(n >= 1 && mesh.triangles.len() > 12);
        let new = mesh.points.last().expect("a point");
        assert!(mesh.points.len() > 8 && (new.x - 0.5).abs() < 1e-6 && (new.z - 0.5).abs() < 1e-6, "{new:?}");
    }

    #[test]
    fn a_mesh_without_ears_stays_as_it_is() {
        for patches in [[1; 6], [2, 1, 1, 1, 1, 1]] {
            assert_eq!(opened(patches), (die(patches), 0));
        }
    }
}
