//! Oriented points from a closed triangle surface.

use rayon::prelude::*;
use serde::Serialize;

use super::OrientedPoints;
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::{Grid, Mask};
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::{TriMesh, intersect, topology};

/// How a surface is sampled.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SurfaceOptions {
    /// Distance between points, mm; `None`: the median edge length.
    pub pitch: Option<f64>,
}

/// Why a surface cannot be the wall of a lumen.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// There is no triangle.
    #[error("the surface has no triangles: check the file")]
    Empty,
    /// An edge has one triangle only.
    #[error("the surface is open: {edges} edges have one triangle only, the first at ({x:.4}, {y:.4}, {z:.4}) mm; close the holes, or give the mask that the surface came from", x = at[0], y = at[1], z = at[2])]
    Open {
        /// Edges with one triangle.
        edges: usize,
        /// Position of the first.
        at: [f64; 3],
    },
    /// Triangle soup: edges with more than two triangles, neighbours of opposite orientation, vertices with several fans.
    #[error("the surface is no oriented 2-manifold: {edges} edges have more than two triangles, {turned} edges join triangles of opposite orientation, {vertices} vertices join several fans, {degenerate} triangles have no three distinct corners; the first fault lies at ({x:.4}, {y:.4}, {z:.4}) mm; repair the surface or give the mask that it came from", x = at[0], y = at[1], z = at[2])]
    NotManifold {
        /// Edges with more than two triangles.
        edges: usize,
        /// Edges whose triangles disagree.
        turned: usize,
        /// Vertices whose triangles form more than one fan.
        vertices: usize,
        /// Triangles without three distinct corners.
        degenerate: usize,
        /// Position of the first fault.
        at: [f64; 3],
    },
    /// Triangles cut each other.
    #[error("the surface cuts itself: {pairs} pairs of triangles, the first (triangles {first} and {second}) at ({x:.4}, {y:.4}, {z:.4}) mm; repair the surface or give the mask that it came from", x = at[0], y = at[1], z = at[2])]
    SelfIntersecting {
        /// Number of pairs.
        pairs: usize,
        /// First triangle of the first pair.
        first: u32,
        /// Second triangle of the first pair.
        second: u32,
        /// Middle of the first triangle.
        at: [f64; 3],
    },
    /// A coordinate is infinite or not a number, or the surface encloses nothing.
    #[error("the surface is flat or has coordinates that are no finite numbers (point {0}): check the file")]
    Degenerate(usize),
    /// The distance between points is no positive number.
    #[error("the distance between points is {0} mm; it must be a finite number above zero")]
    Pitch(f64),
}

/// Checks that `mesh` bounds a body: closed, oriented 2-manifold without self-intersections, of finite coordinates.
///
/// A surface that is turned inside out as a whole passes; its volume is negative.
///
/// # Errors
/// Names the first fault with its place.
pub fn check_surface(mesh: &TriMesh) -> Result<(), SurfaceError> {
    if mesh.triangles.is_empty() {
        return Err(SurfaceError::Empty);
    }
    if let Some(n) = mesh.points.iter().position(|p| !p.coords.iter().all(|c| c.is_finite())) {
        return Err(SurfaceError::Degenerate(n));
    }
    let report = topology::check(mesh);
    let at = report.first_fault(mesh).map_or([f64::NAN; 3], Into::into);
    if report.open_edges > 0 && report.nonmanifold_edges + report.inconsistent_edges + report.degenerate_triangles == 0 {
        return Err(SurfaceError::Open { edges: report.open_edges, at });
    }
    if !report.is_closed_manifold() {
        return Err(SurfaceError::NotManifold {
            edges: report.nonmanifold_edges,
            turned: report.inconsistent_edges,
            vertices: report.nonmanifold_vertices,
            degenerate: report.degenerate_triangles,
            at,
        });
    }
    let cuts = intersect::self_intersections(mesh);
    if let Some(&(first, second)) = cuts.first() {
        let [a, b, c] = mesh.corners(first as usize);
        let at = Point::from((a.coords + b.coords + c.coords) / 3.0).into();
        return Err(SurfaceError::SelfIntersecting { pairs: cuts.len(), first, second, at });
    }
    if mesh.volume() == 0.0 {
        return Err(SurfaceError::Degenerate(0));
    }
    Ok(())
}

/// Samples a closed surface evenly: every triangle carries a lattice of points at most `pitch` apart, with normals
/// interpolated from the angle-weighted normals of its corners. A surface turned inside out is turned back.
///
/// # Errors
/// Whatever [`check_surface`] finds, and a pitch that is no positive number.
pub fn from_surface(mesh: &TriMesh, options: &SurfaceOptions) -> Result<OrientedPoints, SurfaceError> {
    check_surface(mesh)?;
    let pitch = match options.pitch {
        Some(p) if p.is_finite() && p > 0.0 => p,
        Some(p) => return Err(SurfaceError::Pitch(p)),
        None => median_edge(mesh),
    };
    let outward = mesh.volume().signum();
    let normals = vertex_normals(mesh);
    let samples: Vec<Vec<(Point, Vector)>> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            let flat = mesh.area_vector2(t);
            let [na, nb, nc] = mesh.triangles[t].map(|v| normals[v as usize]);
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            let rows = (longest / pitch).ceil().clamp(1.0, 4096.0) as usize;
            let mut out = Vec::new();
            // Middles of the rows × rows congruent subtriangles, up and down.
            for i in 0..rows {
                for j in 0..rows - i {
                    for third in [1.0, 2.0] {
                        if third == 2.0 && i + j + 1 >= rows {
                            continue;
                        }
                        let (u, v) = ((i as f64 + third / 3.0) / rows as f64, (j as f64 + third / 3.0) / rows as f64);
                        let p = a + (b - a) * u + (c - a) * v;
                        let n = na * (1.0 - u - v) + nb * u + nc * v;
                        if let Some(n) = n.try_normalize(0.0).or_else(|| flat.try_normalize(0.0)) {
                            out.push((p, n * outward));
                        }
                    }
                }
            }
            out
        })
        .collect();
    let mut cloud = OrientedPoints::default();
    for (p, n) in samples.into_iter().flatten() {
        cloud.points.push(p);
        cloud.normals.push(n);
        cloud.pitch.push(pitch);
    }
    Ok(cloud)
}

fn median_edge(mesh: &TriMesh) -> f64 {
    let mut lengths: Vec<f64> = (0..mesh.triangles.len())
        .flat_map(|t| {
            let [a, b, c] = mesh.corners(t);
            [(b - a).norm(), (c - b).norm(), (a - c).norm()]
        })
        .collect();
    let middle = lengths.len() / 2;
    *lengths.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn vertex_normals(mesh: &TriMesh) -> Vec<Vector> {
    let mut normals = vec![Vector::zeros(); mesh.points.len()];
    for (t, tri) in mesh.triangles.iter().enumerate() {
        let p = mesh.corners(t);
        let Some(n) = mesh.area_vector2(t).try_normalize(0.0) else { continue };
        for i in 0..3 {
            let (u, v) = (p[(i + 1) % 3] - p[i], p[(i + 2) % 3] - p[i]);
            normals[tri[i] as usize] += n * u.angle(&v);
        }
    }
    normals.iter().map(|n| n.try_normalize(0.0).unwrap_or_else(Vector::zeros)).collect()
}

/// Largest number of voxels that [`rasterize`] makes.
const MOST_VOXELS: f64 = 1e9;

/// The voxels of edge `spacing` mm whose centres lie inside a closed surface, with four voxels to spare on every side.
///
/// This is the mask that guards the function fitted to [`from_surface`]'s points. Parts thinner than a voxel are lost,
/// gaps narrower than a voxel may close: compare the topologies.
///
/// # Errors
/// Whatever [`check_surface`] finds; [`SurfaceError::Pitch`] for a spacing that is no positive number or makes more than
/// 10⁹ voxels.
pub fn rasterize(mesh: &TriMesh, spacing: f64) -> Result<Mask, SurfaceError> {
    check_surface(mesh)?;
    let bounds = mesh.bounds();
    let cells = (bounds.max - bounds.min) / spacing;
    if !(spacing.is_finite() && spacing > 0.0) || cells.iter().map(|c| c + 9.0).product::<f64>() > MOST_VOXELS {
        return Err(SurfaceError::Pitch(spacing));
    }
    let dims = [0, 1, 2].map(|a| cells[a].ceil() as usize + 9);
    // Half a voxel off, so that no flat end lies on voxel centres.
    let origin = bounds.min - Vector::repeat(4.25 * spacing);
    let grid = Grid::new(dims, [spacing; 3], origin, nalgebra::Matrix3::identity()).map_err(|_| SurfaceError::Pitch(spacing))?;
    let tree = TriangleBvh::new(mesh);
    // Blocks that no triangle comes near lie on one side as a whole.
    let blocks = dims.map(|d| d.div_ceil(BLOCK));
    let filled: Vec<Vec<u8>> = (0..blocks.iter().product::<usize>())
        .into_par_iter()
        .map(|b| {
            let low = [b % blocks[0], b / blocks[0] % blocks[1], b / (blocks[0] * blocks[1])].map(|i| i * BLOCK);
            let at = |d: [usize; 3]| grid.to_world(Vector::from([0, 1, 2].map(|a| (low[a] + d[a]) as f64)));
            let mut near = false;
            tree.overlapping(&Aabb::of(&[at([0; 3]), at([BLOCK - 1; 3])]).inflated(0.5 * spacing), |_| near = true);
            let side = |d: [usize; 3]| u8::from(tree.contains(&at(d)));
            if near {
                (0..BLOCK.pow(3)).map(|n| side([n % BLOCK, n / BLOCK % BLOCK, n / (BLOCK * BLOCK)])).collect()
            } else {
                vec![side([0; 3])]
            }
        })
        .collect();
    let data = (0..grid.len())
        .into_par_iter()
        .map(|n| {
            let v = grid.voxel(n);
            let [i, j, k] = v.map(|c| c / BLOCK);
            let block = &filled[i + blocks[0] * (j + blocks[1] * k)];
            let [i, j, k] = v.map(|c| c % BLOCK);
            if block.len() == 1 { block[0] } else { block[i + BLOCK * (j + BLOCK * k)] }
        })
        .collect();
    Ok(Mask::new(grid, data))
}

/// Voxels a side of the blocks that are rasterized together.
const BLOCK: usize = 8;

/// A voxel edge at which nearly all of a closed surface's lumen is eight voxels across, mm.
///
/// Taken from the thickness inwards of triangles spread over the surface; no finer than makes `most` voxels.
///
/// # Errors
/// Whatever [`check_surface`] finds.
pub fn resolving_spacing(mesh: &TriMesh, most: f64) -> Result<f64, SurfaceError> {
    check_surface(mesh)?;
    let tree = TriangleBvh::new(mesh);
    let inwards = -mesh.volume().signum();
    let step = mesh.triangles.len().div_ceil(4000);
    let reach = mesh.bounds().diagonal();
    let mut across: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .step_by(step)
        .filter_map(|t| {
            let [a, b, c] = mesh.corners(t);
            let middle = Point::from((a.coords + b.coords + c.coords) / 3.0);
            let direction = mesh.area_vector2(t).try_normalize(0.0)? * inwards;
            tree.ray_filtered(&middle, &direction, reach, |other| other as usize != t).map(|hit| hit.t)
        })
        .collect();
    across.sort_by(f64::total_cmp);
    let size = mesh.bounds().max - mesh.bounds().min;
    let least = (size.product() / most).cbrt();
    let thin = across.get(across.len() / 20).copied().unwrap_or(reach);
    Ok((thin / 8.0).clamp(least, (reach / 20.0).max(least)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::sphere;

    #[test]
    fn points_of_a_sphere_lie_on_it_with_true_normals_even_when_it_is_inside_out() {
        let center = Point::new(4.0, -3.0, 2.0);
        let mut mesh = sphere(center, 5.0, 24);
        for turned in [false, true] {
            if turned {
                mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
            }
            let cloud = from_surface(&mesh, &SurfaceOptions { pitch: Some(0.4) }).unwrap();
            assert!(cloud.len() as f64 > 4.0 * std::f64::consts::PI * 25.0 / 0.16);
            for (p, n) in cloud.points.iter().zip(&cloud.normals) {
                assert!(((p - center).norm() - 5.0).abs() < 0.1);
                assert!(n.angle(&(p - center)).to_degrees() < 6.0);
            }
        }
    }

    #[test]
    fn a_surface_gets_voxels_that_resolve_it() {
        let mesh = sphere(Point::new(4.0, -3.0, 2.0), 5.0, 24);
        // Ten across at its middle, eight voxels.
        let h = resolving_spacing(&mesh, 1e6).unwrap();
        assert!((0.5..1.3).contains(&h), "{h}");
        assert!((resolving_spacing(&mesh, 1000.0).unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_rasterized_sphere_has_its_volume_and_topology() {
        let mesh = sphere(Point::new(4.0, -3.0, 2.0), 5.0, 24);
        let mask = rasterize(&mesh, 0.5).unwrap();
        assert!((mask.volume() / mesh.volume().abs() - 1.0).abs() < 0.01);
        assert_eq!(crate::mask::topology(&mask).euler, 1);
    }

    #[test]
    fn open_surfaces_and_soup_are_refused_with_the_place() {
        let whole = sphere(Point::origin(), 5.0, 12);
        let mut open = whole.clone();
        open.triangles.pop();
        open.patch.pop();
        assert!(matches!(from_surface(&open, &SurfaceOptions::default()), Err(SurfaceError::Open { edges: 3, .. })));
        let mut soup = TriMesh::new(Vec::new(), Vec::new());
        for t in 0..whole.triangles.len() {
            let n = soup.points.len() as u32;
            soup.points.extend(whole.corners(t));
            soup.triangles.push([n, n + 1, n + 2]);
            soup.patch.push(crate::mesh::WALL);
        }
        let message = from_surface(&soup, &SurfaceOptions::default()).unwrap_err().to_string();
        assert!(message.contains("open") && message.contains("mm"), "{message}");
        assert_eq!(check_surface(&TriMesh::default()), Err(SurfaceError::Empty));
    }

    #[test]
    fn a_surface_that_cuts_itself_is_refused_with_both_triangles_and_the_place() {
        let mut two = sphere(Point::origin(), 5.0, 12);
        let other = sphere(Point::new(3.0, 0.3, 0.2), 5.0, 12);
        let n = two.points.len() as u32;
        two.points.extend(&other.points);
        two.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + n)));
        two.patch.extend(&other.patch);
        assert!(matches!(check_surface(&two), Err(SurfaceError::SelfIntersecting { pairs, .. }) if pairs > 10));
    }
}
