//! Oriented points and masks from triangle surfaces; inside and outside by winding numbers.

use rayon::prelude::*;
use serde::Serialize;

use super::OrientedPoints;
use crate::geometry::{Aabb, Point, Vector};
use crate::mask::{Grid, Mask};
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::winding::WindingNumbers;
use crate::mesh::{TriMesh, rims};

/// How a surface is sampled.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SurfaceOptions {
    /// Distance between points, mm; `None`: the median edge length.
    pub pitch: Option<f64>,
}

/// Why a surface cannot be the wall of a lumen.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// Nothing is enclosed.
    #[error("the surface encloses nothing: its {triangles} triangles, the first at ({x:.4}, {y:.4}, {z:.4}) mm, bound no body; repair the surface or give the mask that it came from", x = at[0], y = at[1], z = at[2])]
    Empty {
        /// Triangles.
        triangles: usize,
        /// The first point.
        at: [f64; 3],
    },
    /// Inside and outside cannot be told apart.
    #[error("inside and outside of the surface cannot be told at ({x:.4}, {y:.4}, {z:.4}) mm: the winding number is {winding:.2} there, {distance:.3} mm from the nearest open edge, and undecided at {voxels} voxels in all; close the hole there, or give the mask that the surface came from", x = at[0], y = at[1], z = at[2])]
    Undecided {
        /// Voxels of winding numbers from 0.3 to 0.7 farther than an edge from any rim.
        voxels: usize,
        /// The one farthest from a rim.
        at: [f64; 3],
        /// Its winding number.
        winding: f64,
        /// Its distance from the rim, mm.
        distance: f64,
    },
    /// The distance between points is no positive number.
    #[error("the distance between points is {0} mm; it must be a finite number above zero")]
    Pitch(f64),
}

/// Checks that a surface whose triangles agree (see [`crate::mesh::repair`]) encloses something.
///
/// # Errors
/// [`SurfaceError::Empty`] with its first point.
pub fn check_surface(mesh: &TriMesh) -> Result<(), SurfaceError> {
    let ball = mesh.area().powf(1.5) / (6.0 * std::f64::consts::PI.sqrt());
    if ball > 0.0 && mesh.volume() > ENCLOSES * ball {
        return Ok(());
    }
    Err(SurfaceError::Empty { triangles: mesh.triangles.len(), at: mesh.points.first().map_or([f64::NAN; 3], |p| (*p).into()) })
}

/// A body has at least this part of the volume of the ball of its area: a tube ten thousand times as long as wide has more.
const ENCLOSES: f64 = 1e-5;

/// How far on either side of the surface a sample asks whether that is inside, in distances between points.
const BESIDE: f64 = 0.03;

/// Samples a surface evenly where it parts inside from outside by winding numbers, points about `pitch` apart, with normals
/// interpolated from those of its corners; across edges of 45 degrees and more they are not smoothed.
///
/// Pieces inside the body or outside of it, as where shells overlap or the surface crosses itself, get no points.
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
    let normals = corner_normals(mesh);
    let inside = WindingNumbers::new(mesh);
    let samples: Vec<Vec<(Point, Vector)>> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let Some(flat) = mesh.area_vector2(t).try_normalize(0.0) else { return Vec::new() };
            let mut out = Vec::new();
            spread(&mesh.corners(t), &normals[t], pitch, &mut out);
            out.retain_mut(|(p, n)| {
                let step = flat * (BESIDE * pitch);
                let sides = (inside.contains(&(*p + step)), inside.contains(&(*p - step)));
                *n = n.try_normalize(0.0).unwrap_or(flat);
                if sides.0 {
                    *n = -*n;
                }
                sides.0 != sides.1
            });
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

/// Part of the distance between points at which rows run across a triangle, and points along a row.
const ROWS: f64 = 0.66;

/// Points on a triangle about `pitch` apart, in rows across its longest edge, so that long triangles get no more than others.
fn spread(corners: &[Point; 3], normals: &[Vector; 3], pitch: f64, out: &mut Vec<(Point, Vector)>) {
    let length = |i: usize| (corners[(i + 1) % 3] - corners[i]).norm();
    let k = (0..3).fold(0, |k, i| if length(i) > length(k) { i } else { k });
    let [a, b, c] = [k, (k + 1) % 3, (k + 2) % 3];
    let long = length(k);
    let step = ROWS * pitch;
    // Where along the longest edge the third corner stands, and how high.
    let foot = (corners[c] - corners[a]).dot(&(corners[b] - corners[a])) / (long * long);
    let height = (corners[b] - corners[a]).cross(&(corners[c] - corners[a])).norm() / long;
    let rows = (long / step).ceil().clamp(1.0, 65536.0);
    for i in 0..rows as usize {
        let x = (i as f64 + 0.5) / rows;
        // The part of the height that the triangle has here.
        let part = if x < foot { x / foot } else { (1.0 - x) / (1.0 - foot) };
        let across = (part * height / step).ceil().clamp(1.0, 65536.0);
        for j in 0..across as usize {
            let wc = part * (j as f64 + 0.5) / across;
            let wb = x - wc * foot;
            let w = [(a, 1.0 - wb - wc), (b, wb), (c, wc)];
            let p = w.iter().map(|(v, w)| corners[*v].coords * *w).sum::<Vector>();
            out.push((Point::from(p), w.iter().map(|(v, w)| normals[*v] * *w).sum()));
        }
    }
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

/// Cosine of the angle from which on an edge is a crease.
const CREASE: f64 = 0.707;

/// The normal at each corner of each triangle: of the triangles round its vertex that look in about the same direction, by their angles.
fn corner_normals(mesh: &TriMesh) -> Vec<[Vector; 3]> {
    let mut round: Vec<Vec<(Vector, f64)>> = vec![Vec::new(); mesh.points.len()];
    for (t, tri) in mesh.triangles.iter().enumerate() {
        let p = mesh.corners(t);
        let Some(n) = mesh.area_vector2(t).try_normalize(0.0) else { continue };
        for i in 0..3 {
            let (u, v) = (p[(i + 1) % 3] - p[i], p[(i + 2) % 3] - p[i]);
            round[tri[i] as usize].push((n, u.angle(&v)));
        }
    }
    let of = |t: usize| {
        let own = mesh.area_vector2(t).try_normalize(0.0).unwrap_or_else(Vector::zeros);
        let near = |v: u32| round[v as usize].iter().filter(|(n, _)| n.dot(&own) > CREASE).map(|(n, w)| n * *w).sum::<Vector>();
        mesh.triangles[t].map(|v| near(v).try_normalize(0.0).unwrap_or(own))
    };
    (0..mesh.triangles.len()).into_par_iter().map(of).collect()
}

/// Largest number of voxels that [`rasterize`] makes.
const MOST_VOXELS: f64 = 1e9;

/// The voxels of edge `spacing` mm whose centres lie inside a surface by its winding number, with four voxels to spare on every side.
///
/// This is the mask that guards the function fitted to [`from_surface`]'s points. Parts thinner than a voxel are lost,
/// gaps narrower than a voxel may close: compare the topologies.
///
/// # Errors
/// Whatever [`check_surface`] finds; [`SurfaceError::Undecided`] where a surface with holes has winding numbers from 0.3 to 0.7 farther than
/// an edge (or a voxel) from every rim; [`SurfaceError::Pitch`] for a spacing that is no positive number or makes more than 10⁹ voxels.
pub fn rasterize(mesh: &TriMesh, spacing: f64) -> Result<Mask, SurfaceError> {
    check_surface(mesh)?;
    let bounds = mesh.bounds();
    let cells = (bounds.max - bounds.min) / spacing;
    if !(spacing.is_finite() && spacing > 0.0) || cells.iter().map(|c| c + 9.0).product::<f64>() > MOST_VOXELS {
        return Err(SurfaceError::Pitch(spacing));
    }
    let dims = [0, 1, 2].map(|a| cells[a].ceil() as usize + 9);
    // Off by a quarter of a voxel, so that no flat end lies on voxel centres.
    let origin = bounds.min - Vector::repeat(4.25 * spacing);
    let grid = Grid::new(dims, [spacing; 3], origin, nalgebra::Matrix3::identity()).map_err(|_| SurfaceError::Pitch(spacing))?;
    let tree = TriangleBvh::new(mesh);
    let winding = WindingNumbers::new(mesh);
    let rims = Rims::of(mesh, spacing);
    // Blocks that no triangle comes near lie on one side as a whole; where there are holes those do whose middle is clearly on one.
    let blocks = dims.map(|d| d.div_ceil(BLOCK));
    let filled: Vec<(Vec<u8>, Vec<Doubt>)> = (0..blocks.iter().product::<usize>())
        .into_par_iter()
        .map(|b| {
            let low = [b % blocks[0], b / blocks[0] % blocks[1], b / (blocks[0] * blocks[1])].map(|i| i * BLOCK);
            let at = |d: [usize; 3]| grid.to_world(Vector::from([0, 1, 2].map(|a| (low[a] + d[a]) as f64)));
            let mut near = false;
            tree.overlapping(&Aabb::of(&[at([0; 3]), at([BLOCK - 1; 3])]).inflated(0.5 * spacing), |_| near = true);
            let middle = winding.at(&at([BLOCK / 2; 3]));
            near = near || rims.is_some() && (0.05..0.95).contains(&middle);
            if !near {
                return (vec![u8::from(middle > 0.5)], Vec::new());
            }
            let mut doubts = Vec::new();
            let side = |n: usize| {
                let p = at([n % BLOCK, n / BLOCK % BLOCK, n / (BLOCK * BLOCK)]);
                let w = winding.at(&p);
                if let Some(distance) = rims.as_ref().filter(|_| UNDECIDED.contains(&w)).and_then(|r| r.far(&p)) {
                    doubts.push(Doubt { at: p, winding: w, distance });
                }
                u8::from(w > 0.5)
            };
            ((0..BLOCK.pow(3)).map(side).collect(), doubts)
        })
        .collect();
    let doubts = || filled.iter().flat_map(|f| &f.1);
    if let Some(d) = doubts().max_by(|a, b| a.distance.total_cmp(&b.distance)) {
        return Err(SurfaceError::Undecided { voxels: doubts().count(), at: d.at.into(), winding: d.winding, distance: d.distance });
    }
    let data = (0..grid.len())
        .into_par_iter()
        .map(|n| {
            let v = grid.voxel(n);
            let [i, j, k] = v.map(|c| c / BLOCK);
            let block = &filled[i + blocks[0] * (j + blocks[1] * k)].0;
            let [i, j, k] = v.map(|c| c % BLOCK);
            if block.len() == 1 { block[0] } else { block[i + BLOCK * (j + BLOCK * k)] }
        })
        .collect();
    Ok(Mask::new(grid, data))
}

/// Winding numbers that tell neither inside nor outside.
const UNDECIDED: std::ops::Range<f64> = 0.3..0.7;

/// A voxel of which it is not known on which side it is.
struct Doubt {
    at: Point,
    winding: f64,
    distance: f64,
}

/// The open edges of a surface.
struct Rims {
    edges: TriangleBvh,
    /// Their longest, or a voxel.
    reach: f64,
}

impl Rims {
    fn of(mesh: &TriMesh, spacing: f64) -> Option<Rims> {
        let open = rims::open_edges(&mesh.triangles);
        let length = |e: &[u32; 2]| (mesh.points[e[0] as usize] - mesh.points[e[1] as usize]).norm();
        let reach = open.iter().map(length).fold(spacing, f64::max);
        let edges: Vec<[u32; 3]> = open.iter().map(|&[a, b]| [a, b, b]).collect();
        (!edges.is_empty()).then(|| Rims { edges: TriangleBvh::of(&mesh.points, &edges), reach })
    }

    /// The distance of a point that is farther than an edge from all of them.
    fn far(&self, p: &Point) -> Option<f64> {
        self.edges.closest(p).map(|c| c.distance).filter(|d| *d > self.reach)
    }
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
    let step = mesh.triangles.len().div_ceil(4000);
    let reach = mesh.bounds().diagonal();
    let mut across: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .step_by(step)
        .filter_map(|t| {
            let [a, b, c] = mesh.corners(t);
            let middle = Point::from((a.coords + b.coords + c.coords) / 3.0);
            let direction = -mesh.area_vector2(t).try_normalize(0.0)?;
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
    fn points_of_a_sphere_lie_on_it_with_true_normals() {
        let center = Point::new(4.0, -3.0, 2.0);
        let mesh = sphere(center, 5.0, 24);
        let cloud = from_surface(&mesh, &SurfaceOptions { pitch: Some(0.4) }).unwrap();
        assert!(cloud.len() as f64 > 4.0 * std::f64::consts::PI * 25.0 / 0.16);
        for (p, n) in cloud.points.iter().zip(&cloud.normals) {
            assert!(((p - center).norm() - 5.0).abs() < 0.1);
            assert!(n.angle(&(p - center)).to_degrees() < 6.0);
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
    fn a_surface_with_a_wide_hole_is_refused_with_the_place_and_one_with_a_narrow_hole_is_not() {
        let whole = sphere(Point::origin(), 5.0, 12);
        let without = |keep: &dyn Fn(&Point) -> bool| {
            let kept = (0..whole.triangles.len()).filter(|&t| whole.corners(t).iter().any(keep)).map(|t| whole.triangles[t]);
            TriMesh::new(whole.points.clone(), kept.collect())
        };
        match rasterize(&without(&|p| p.x < 2.5), 0.25) {
            Err(SurfaceError::Undecided { at, winding, distance, .. }) => assert!(at[0] > 0.0 && (0.3..0.7).contains(&winding) && distance > 1.0),
            other => panic!("{:?}", other.map(|m| m.count())),
        }
        let mask = rasterize(&without(&|p| p.x < 4.9), 0.25).unwrap();
        assert!((mask.volume() / whole.volume() - 1.0).abs() < 0.01);
        assert!(matches!(check_surface(&TriMesh::default()), Err(SurfaceError::Empty { .. })));
    }

    #[test]
    fn shells_that_overlap_are_one_body_and_get_no_points_inside() {
        let mut two = sphere(Point::origin(), 5.0, 12);
        let other = sphere(Point::new(3.0, 0.3, 0.2), 5.0, 12);
        let n = two.points.len() as u32;
        two.points.extend(&other.points);
        two.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + n)));
        two.patch.extend(&other.patch);
        let cloud = from_surface(&two, &SurfaceOptions { pitch: Some(0.3) }).unwrap();
        assert!(cloud.points.iter().all(|p| p.coords.norm() > 4.8 && (p - Point::new(3.0, 0.3, 0.2)).norm() > 4.8));
        let mask = rasterize(&two, 0.25).unwrap();
        // Two balls less their lens.
        let d = Vector::new(3.0, 0.3, 0.2).norm();
        let lens = std::f64::consts::PI * (4.0 * 5.0 + d) * (2.0 * 5.0 - d).powi(2) / 12.0;
        let wanted = 2.0 * 4.0 / 3.0 * std::f64::consts::PI * 125.0 - lens;
        assert!((mask.volume() / wanted - 1.0).abs() < 0.03, "{} {wanted}", mask.volume());
    }

    #[test]
    fn long_triangles_and_sharp_edges_keep_even_points_and_true_normals() {
        // A closed prism of 24 faces: a facet is one pair of triangles, forty times as long as wide.
        let ring = |z: f64| (0..24).map(move |i| std::f64::consts::TAU * f64::from(i) / 24.0).map(move |a| Point::new(2.0 * a.cos(), 2.0 * a.sin(), z));
        let mut points: Vec<Point> = ring(0.0).chain(ring(20.0)).collect();
        points.extend([Point::origin(), Point::new(0.0, 0.0, 20.0)]);
        let facets = (0..24u32).map(|i| (i, (i + 1) % 24)).flat_map(|(a, b)| [[a, b, b + 24], [a, b + 24, a + 24], [b, a, 48], [a + 24, b + 24, 49]]);
        let mesh = TriMesh::new(points, facets.collect());
        let cloud = from_surface(&mesh, &SurfaceOptions { pitch: Some(0.25) }).unwrap();
        let even = mesh.area() / cloud.len() as f64 / (0.25 * 0.25);
        assert!((0.1..0.6).contains(&even), "{even}");
        for (p, n) in cloud.points.iter().zip(&cloud.normals) {
            let flat = p.z < 1e-9 || p.z > 20.0 - 1e-9;
            assert!(if flat { n.z.abs() > 0.99 } else { n.z.abs() < 0.01 }, "{p} {n}");
        }
    }
}
