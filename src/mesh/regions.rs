//! Parts of the wall as patches of their own, such as an aneurysm's sac.

use super::{Patch, PatchKind, TriMesh, VolumeMesh, WALL};
use crate::geometry::{Plane, Point};

/// Which part of the wall.
#[derive(Debug, Clone, PartialEq)]
pub enum Region {
    /// What lies inside a ball.
    Ball {
        /// Centre, mm.
        center: Point,
        /// Radius, mm.
        radius: f64,
    },
    /// What a plane cuts off at its origin, on its normal's side.
    Beyond(Plane),
}

/// Why there is no such part.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RegionError {
    /// Nothing of the wall is there.
    #[error("surface.patches `{name}`: no triangle of the wall lies there; the nearest point of the wall is at ({x:.3}, {y:.3}, {z:.3}) mm: move or enlarge it", x = nearest[0], y = nearest[1], z = nearest[2])]
    Empty {
        /// The patch.
        name: String,
        /// Nearest point of the wall.
        nearest: [f64; 3],
    },
    /// All of the wall is there.
    #[error("surface.patches `{name}`: the whole wall lies there: make it smaller")]
    Everything {
        /// The patch.
        name: String,
    },
    /// An opening lies in it.
    #[error("surface.patches `{name}`: opening `{opening}` at ({x:.3}, {y:.3}, {z:.3}) mm lies in it, so that it is more than a sac: turn the plane's normal round, or shift it", x = at[0], y = at[1], z = at[2])]
    HoldsOpening {
        /// The patch.
        name: String,
        /// The opening.
        opening: String,
        /// A point of the opening's rim.
        at: [f64; 3],
    },
    /// Two patches have one name.
    #[error("surface.patches `{0}`: there is a patch of that name already: choose another name")]
    SameName(String),
}

/// Gives the triangles of the wall in `region` a patch of their own, numbered after all others; returns its number.
///
/// The patch is one connected piece of the wall, bounded by edges of triangles; no vertex moves.
///
/// # Errors
/// [`RegionError`] where the region holds nothing, everything, or (cut off by a plane) an opening.
pub fn mark(mesh: &mut TriMesh, name: &str, region: &Region) -> Result<u32, RegionError> {
    if mesh.patches.iter().any(|p| p.name == name) {
        return Err(RegionError::SameName(name.into()));
    }
    let middle = |t: usize| {
        let [a, b, c] = mesh.corners(t);
        Point::from((a.coords + b.coords + c.coords) / 3.0)
    };
    let center = match region {
        Region::Ball { center, .. } => *center,
        Region::Beyond(plane) => plane.origin,
    };
    let chosen: Vec<bool> = (0..mesh.triangles.len())
        .map(|t| {
            mesh.patch[t] == WALL
                && match region {
                    Region::Ball { center, radius } => (middle(t) - center).norm() <= *radius,
                    Region::Beyond(plane) => plane.signed_distance(&middle(t)) > 0.0,
                }
        })
        .collect();
    let pieces = pieces(mesh, &chosen);
    let best = match region {
        // The largest piece: other vessels may pass through the ball.
        Region::Ball { .. } => pieces.into_iter().max_by(|a, b| {
            let area = |p: &Vec<usize>| p.iter().map(|&t| mesh.area_vector2(t).norm()).sum::<f64>();
            area(a).total_cmp(&area(b))
        }),
        // The piece whose rim is nearest: other vessels may lie beyond the plane.
        Region::Beyond(_) => pieces.into_iter().min_by(|a, b| {
            let distance = |p: &Vec<usize>| p.iter().map(|&t| (middle(t) - center).norm()).fold(f64::INFINITY, f64::min);
            distance(a).total_cmp(&distance(b))
        }),
    };
    let Some(piece) = best else {
        let walls = (0..mesh.triangles.len()).filter(|&t| mesh.patch[t] == WALL).map(middle);
        let nearest = walls.min_by(|a, b| (a - center).norm().total_cmp(&(b - center).norm())).unwrap_or(center);
        return Err(RegionError::Empty { name: name.into(), nearest: nearest.into() });
    };
    if piece.len() == mesh.patch.iter().filter(|p| **p == WALL).count() {
        return Err(RegionError::Everything { name: name.into() });
    }
    if let Region::Beyond(_) = region {
        let mut touched = vec![false; mesh.points.len()];
        piece.iter().for_each(|&t| mesh.triangles[t].iter().for_each(|&v| touched[v as usize] = true));
        let caps = (0..mesh.triangles.len()).filter(|&t| mesh.patch[t] != WALL);
        for t in caps {
            let Some(opening) = mesh.patches.iter().find(|p| p.id == mesh.patch[t] && p.kind != PatchKind::Wall) else { continue };
            if let Some(&v) = mesh.triangles[t].iter().find(|v| touched[**v as usize]) {
                let at = mesh.points[v as usize].into();
                return Err(RegionError::HoldsOpening { name: name.into(), opening: opening.name.clone(), at });
            }
        }
    }
    let id = mesh.patches.iter().map(|p| p.id).max().unwrap_or(WALL).max(WALL) + 1;
    piece.into_iter().for_each(|t| mesh.patch[t] = id);
    mesh.patches.push(Patch { id, name: name.into(), kind: PatchKind::Wall });
    Ok(id)
}

/// Connected pieces of the chosen triangles, by shared edges, in the order of their first triangle.
fn pieces(mesh: &TriMesh, chosen: &[bool]) -> Vec<Vec<usize>> {
    let mut edges: Vec<([u32; 2], usize)> = (0..mesh.triangles.len())
        .filter(|&t| chosen[t])
        .flat_map(|t| {
            let [a, b, c] = mesh.triangles[t];
            [[a, b], [b, c], [c, a]].map(|[p, q]| ([p.min(q), p.max(q)], t))
        })
        .collect();
    edges.sort_unstable();
    let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); mesh.triangles.len()];
    for pair in edges.windows(2).filter(|w| w[0].0 == w[1].0) {
        neighbours[pair[0].1].push(pair[1].1);
        neighbours[pair[1].1].push(pair[0].1);
    }
    let mut seen = vec![false; mesh.triangles.len()];
    let mut out = Vec::new();
    for first in (0..chosen.len()).filter(|&t| chosen[t]) {
        if seen[first] {
            continue;
        }
        seen[first] = true;
        let (mut piece, mut next) = (vec![first], 0);
        while next < piece.len() {
            for &m in &neighbours[piece[next]] {
                if !seen[m] {
                    seen[m] = true;
                    piece.push(m);
                }
            }
            next += 1;
        }
        out.push(piece);
    }
    out
}

/// Gives boundary faces of the volume mesh the patches of the surface's triangles that they are.
pub fn carry_over(surface: &TriMesh, volume: &mut VolumeMesh) {
    let key = |t: &[u32]| {
        let mut k = [t[0], t[1], t[2]];
        k.sort_unstable();
        k
    };
    let mut own: Vec<([u32; 3], u32)> = surface.triangles.iter().zip(&surface.patch).map(|(t, p)| (key(t), *p)).collect();
    own.sort_unstable();
    for face in volume.boundary.iter_mut().filter(|f| f.patch == WALL && f.ids().len() == 3) {
        let k = key(face.ids());
        if let Ok(i) = own.binary_search_by(|e| e.0.cmp(&k)) {
            face.patch = own[i].1;
        }
    }
    volume.patches = surface.patches.clone();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;
    use crate::mesh::test_shapes::sphere;

    #[test]
    fn the_part_beyond_a_plane_and_the_part_in_a_ball_become_patches() {
        let mut mesh = sphere(Point::origin(), 5.0, 24);
        let plane = Plane { origin: Point::new(0.0, 0.0, 3.0), normal: Vector::z() };
        let id = mark(&mut mesh, "dome", &Region::Beyond(plane)).unwrap();
        assert_eq!(id, 2);
        assert!((0..mesh.triangles.len()).all(|t| (mesh.patch[t] == 2) == (mesh.corners(t).iter().map(|p| p.z).sum::<f64>() / 3.0 > 3.0)));
        let ball = Region::Ball { center: Point::new(0.0, 0.0, -5.0), radius: 2.0 };
        assert_eq!(mark(&mut mesh, "sac", &ball).unwrap(), 3);
        assert_eq!(mesh.patches.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["wall", "dome", "sac"]);
        assert_eq!(mark(&mut mesh, "sac", &ball), Err(RegionError::SameName("sac".into())));
        let away = Region::Ball { center: Point::new(0.0, 40.0, 0.0), radius: 2.0 };
        assert!(matches!(mark(&mut mesh, "x", &away), Err(RegionError::Empty { nearest, .. }) if nearest[1] > 4.5));
    }

    #[test]
    fn a_plane_that_would_cut_off_an_opening_is_refused_with_its_place() {
        let mut mesh = sphere(Point::origin(), 5.0, 24);
        for t in 0..mesh.triangles.len() {
            if mesh.corners(t).iter().all(|p| p.z > 4.0) {
                mesh.patch[t] = 2;
            }
        }
        mesh.patches.push(Patch { id: 2, name: "inlet".into(), kind: PatchKind::Inlet });
        let plane = Plane { origin: Point::new(0.0, 0.0, 3.0), normal: Vector::z() };
        let e = mark(&mut mesh, "sac", &Region::Beyond(plane)).unwrap_err();
        assert!(matches!(&e, RegionError::HoldsOpening { opening, .. } if opening == "inlet"), "{e}");
        let back = Plane { origin: Point::new(0.0, 0.0, 3.0), normal: -Vector::z() };
        assert!(mark(&mut mesh, "rest", &Region::Beyond(back)).is_ok());
    }
}
