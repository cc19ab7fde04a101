//! How true a surface is to the mask: distances both ways, volume, places where it fails.

mod lumen;
mod marching_cubes;
mod vessel;

use rayon::prelude::*;
use serde::Serialize;

pub use lumen::kept_volume;
pub use marching_cubes::marching_cubes;
pub use vessel::{LostLength, LostPart, LostReason, Narrowest, RadiusSample, Radii, lost, radii};

use crate::geometry::{Plane, Point};
use crate::mask::{Grid, Mask};
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::{TriMesh, WALL};
use crate::openings::{FoundBy, Opening};

/// A planar cut: what lies beyond it was taken away on purpose.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cut {
    /// The plane, normal out of the vessel.
    pub plane: Plane,
    /// Radius of the vessel at the plane, mm.
    pub radius: f64,
    /// Name of the opening.
    pub name: String,
    /// Whether a person made the cut: gave the plane, or cut the mask or surface there.
    pub user: bool,
}

impl From<&Opening> for Cut {
    fn from(o: &Opening) -> Cut {
        Cut { plane: o.plane, radius: o.radius, name: o.name.clone(), user: o.found_by != FoundBy::BluntEnd }
    }
}

/// How fidelity is measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FidelityOptions {
    /// Sample points on the wall and on the marching cubes surface each.
    pub samples: usize,
    /// Number of worst places to report.
    pub worst: usize,
    /// Samples of the mask beyond a cut are left out up to this many vessel radii from the plane's origin, near the picture's sides
    /// up to twice as many.
    pub reach: f64,
}

impl Default for FidelityOptions {
    fn default() -> FidelityOptions {
        FidelityOptions { samples: 100_000, worst: 10, reach: 6.0 }
    }
}

/// Why fidelity cannot be measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FidelityError {
    /// The mask is all background.
    #[error("the mask has no lumen voxels: there is nothing to measure against")]
    EmptyMask,
    /// The surface has no wall.
    #[error("none of the surface's {0} triangles has the wall's patch id {WALL} and an area: nothing can be measured")]
    NoWall(usize),
}

/// Statistics of unsigned distances in one unit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Distances {
    /// Half of the area is nearer.
    pub median: f64,
    /// Mean over the area.
    pub mean: f64,
    /// Root of the mean square.
    pub rms: f64,
    /// 95 % of the area are nearer.
    pub p95: f64,
    /// 99 % of the area are nearer.
    pub p99: f64,
    /// Largest distance of a sample or vertex.
    pub max: f64,
}

impl Distances {
    fn of(sorted: &[f64], max: f64) -> Distances {
        let n = sorted.len().max(1) as f64;
        Distances {
            median: quantile(sorted, 0.5),
            mean: sorted.iter().sum::<f64>() / n,
            rms: (sorted.iter().map(|d| d * d).sum::<f64>() / n).sqrt(),
            p95: quantile(sorted, 0.95),
            p99: quantile(sorted, 0.99),
            max,
        }
    }

    fn scaled(&self, s: f64) -> Distances {
        Distances {
            median: self.median * s,
            mean: self.mean * s,
            rms: self.rms * s,
            p95: self.p95 * s,
            p99: self.p99 * s,
            max: self.max * s,
        }
    }
}

/// Value below which the share `q` of an ascending list lies, linear between its entries; 0 for an empty list.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let x = q * last as f64;
    let i = (x as usize).min(last);
    let j = (i + 1).min(last);
    sorted[i] + (sorted[j] - sorted[i]) * (x - i as f64)
}

/// Distances in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct OneWay {
    /// In voxel diagonals.
    #[serde(flatten)]
    pub voxel_diagonals: Distances,
    /// In millimetres.
    pub mm: Distances,
    /// Number of sample points; vertices, which only take part in the maximum, aside.
    pub samples: usize,
}

/// From which of the two surfaces a distance was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// The wall strays from the mask's boundary.
    ToMarchingCubes,
    /// A part of the mask's boundary has no wall nearby.
    FromMarchingCubes,
}

/// A place where wall and mask differ.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WorstPlace {
    /// Where, mm.
    pub point: Point,
    /// Distance to the other surface, mm.
    pub distance: f64,
    /// The same in voxel diagonals.
    pub voxel_diagonals: f64,
    /// Whose point it is.
    pub direction: Direction,
}

/// Fidelity of a surface to its mask.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fidelity {
    /// From the wall to the marching cubes surface of the mask.
    pub to_marching_cubes: OneWay,
    /// From the marching cubes surface, cut-off parts aside, to the surface.
    pub from_marching_cubes: OneWay,
    /// Enclosed volume over the volume of the mask's kept part; of the surface, where one was given and nothing else was cut.
    pub volume_ratio: f64,
    /// Volume of the mask's voxels on the kept side of all cuts, mm³.
    pub kept_mask_volume: f64,
    /// Share of the marching cubes surface that is not asked: beyond the cuts, or where the picture's sides close it.
    pub cut_off_fraction: f64,
    /// Length of a voxel's diagonal, mm.
    pub voxel_diagonal: f64,
    /// Worst places, at least three voxel diagonals apart, worst first.
    pub worst: Vec<WorstPlace>,
    /// Signed distance of each vertex to the marching cubes surface, mm; positive outside of it, 0 beyond the picture.
    #[serde(skip)]
    pub deviation: Vec<f64>,
}

/// The mask as the reference of measurements.
#[derive(Debug, Clone)]
pub struct Reference<'a> {
    mask: &'a Mask,
    surface: TriMesh,
    bvh: TriangleBvh,
}

impl<'a> Reference<'a> {
    /// The mask and its marching cubes surface.
    pub fn new(mask: &'a Mask) -> Result<Reference<'a>, FidelityError> {
        let surface = marching_cubes(mask);
        if surface.triangles.is_empty() {
            return Err(FidelityError::EmptyMask);
        }
        let bvh = TriangleBvh::new(&surface);
        Ok(Reference { mask, surface, bvh })
    }

    /// The marching cubes surface.
    pub fn surface(&self) -> &TriMesh {
        &self.surface
    }

    /// The tree over the marching cubes surface.
    pub fn bvh(&self) -> &TriangleBvh {
        &self.bvh
    }
}

/// Measures a closed surface against the mask, both ways.
///
/// Distances are taken at points spread evenly by area, with the vertices added for the maxima. Towards the mask only
/// wall triangles are asked; from the mask, caps count as surface and what lies beyond a cut is left out. Flow
/// extensions are not part of the mask: measure before they are added. Beyond the centres of the picture's outermost voxels
/// there is no mask to be true to: wall and marching cubes surface are left out there. Not a Hausdorff bound: between
/// samples the distance may be larger by up to the distance of samples.
///
/// # Errors
/// [`FidelityError::NoWall`] where no triangle of the wall has an area.
pub fn measure(
    surface: &TriMesh,
    reference: &Reference,
    cuts: &[Cut],
    options: &FidelityOptions,
) -> Result<Fidelity, FidelityError> {
    let unit = reference.mask.grid.voxel_diagonal();
    let mc = &reference.surface;
    let wall: Vec<u32> = (0..surface.triangles.len() as u32).filter(|&t| surface.patch[t as usize] == WALL).collect();
    let all: Vec<u32> = (0..mc.triangles.len() as u32).collect();

    let picture = Picture(&reference.mask.grid);
    let on_wall = spread(surface, &wall, options.samples);
    if on_wall.is_empty() {
        return Err(FidelityError::NoWall(surface.triangles.len()));
    }
    let on_wall: Vec<Point> = on_wall.into_iter().filter(|p| picture.depth(p) >= 0.0).collect();
    let there: Vec<f64> = reference.bvh.closest_many(&on_wall).iter().map(|c| c.distance).collect();
    let deviation: Vec<f64> = reference
        .bvh
        .closest_many(&surface.points)
        .par_iter()
        .zip(&surface.points)
        .map(|(c, p)| {
            let outside = mc.area_vector2(c.triangle as usize).dot(&(p - c.point)) >= 0.0;
            match picture.depth(p) {
                depth if depth < 0.0 => 0.0,
                _ if outside => c.distance,
                _ => -c.distance,
            }
        })
        .collect();
    let mut of_wall = vec![false; surface.points.len()];
    for &t in &wall {
        surface.triangles[t as usize].iter().for_each(|&v| of_wall[v as usize] = true);
    }

    let tree = TriangleBvh::new(surface);
    let kept = |p: &Point| {
        let depth = picture.depth(p);
        depth >= 0.0 && !cuts.iter().any(|c| beyond(c, p, unit, options.reach, depth))
    };
    let on_mask = spread(mc, &all, options.samples);
    let total = on_mask.len();
    let on_mask: Vec<Point> = on_mask.into_iter().filter(kept).collect();
    let back: Vec<f64> = tree.closest_many(&on_mask).iter().map(|c| c.distance).collect();
    let corners: Vec<Point> = mc.points.iter().copied().filter(kept).collect();
    let corner_distance: Vec<f64> = tree.closest_many(&corners).iter().map(|c| c.distance).collect();

    let mut places: Vec<(f64, Point, Direction)> = Vec::new();
    let vertices = surface.points.iter().zip(&deviation).zip(&of_wall).filter(|x| *x.1 && picture.depth(x.0.0) >= 0.0).map(|x| (x.0.1.abs(), *x.0.0));
    places.extend(on_wall.iter().zip(&there).map(|(p, d)| (*d, *p)).chain(vertices).map(|(d, p)| (d, p, Direction::ToMarchingCubes)));
    let samples = on_mask.iter().zip(&back).chain(corners.iter().zip(&corner_distance));
    places.extend(samples.map(|(p, d)| (*d, *p, Direction::FromMarchingCubes)));
    let max = |w: Direction| places.iter().filter(|p| p.2 == w).fold(0.0, |m: f64, p| m.max(p.0));
    let one_way = |mut d: Vec<f64>, w: Direction| {
        let max = max(w);
        d.par_sort_unstable_by(f64::total_cmp);
        let mm = Distances::of(&d, max);
        OneWay { voxel_diagonals: mm.scaled(1.0 / unit), mm, samples: d.len() }
    };
    let to_marching_cubes = one_way(there, Direction::ToMarchingCubes);
    let from_marching_cubes = one_way(back, Direction::FromMarchingCubes);
    let kept_mask_volume = kept_volume(reference.mask, cuts);
    Ok(Fidelity {
        to_marching_cubes,
        from_marching_cubes,
        volume_ratio: if kept_mask_volume > 0.0 { surface.volume() / kept_mask_volume } else { 0.0 },
        kept_mask_volume,
        cut_off_fraction: 1.0 - on_mask.len() as f64 / total.max(1) as f64,
        voxel_diagonal: unit,
        worst: worst_places(places, unit, options.worst),
        deviation,
    })
}

/// Distances between the wall and the wall of a surface that it was made after, both ways, mm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToSurface {
    /// From the wall to that surface.
    #[serde(flatten)]
    pub to: Distances,
    /// From that surface's wall, what the cuts took off aside, to the wall.
    pub from: Distances,
    /// Enclosed volume over that surface's; `None` where cuts took off some of it or extensions added to it.
    pub volume_ratio: Option<f64>,
}

/// Distances of the wall from another surface's wall and back, at points spread evenly over either.
///
/// # Errors
/// [`FidelityError::NoWall`] where no triangle of a wall has an area.
pub fn to_surface(surface: &TriMesh, other: &TriMesh, cuts: &[Cut], options: &FidelityOptions) -> Result<ToSurface, FidelityError> {
    let wall = |mesh: &TriMesh| -> Result<Vec<Point>, FidelityError> {
        let own: Vec<u32> = (0..mesh.triangles.len() as u32).filter(|&t| mesh.patch[t as usize] == WALL).collect();
        let points = spread(mesh, &own, options.samples);
        if points.is_empty() { Err(FidelityError::NoWall(mesh.triangles.len())) } else { Ok(points) }
    };
    let distances = |points: &[Point], mesh: &TriMesh| {
        let mut d: Vec<f64> = TriangleBvh::new(mesh).closest_many(points).iter().map(|c| c.distance).collect();
        d.par_sort_unstable_by(f64::total_cmp);
        Distances::of(&d, d.last().copied().unwrap_or(0.0))
    };
    let gone = |p: &Point| cuts.iter().any(|c| c.plane.signed_distance(p) > 0.0 && (p - c.plane.origin).norm() < options.reach * c.radius);
    let mut left = wall(other)?;
    left.retain(|p| !gone(p));
    Ok(ToSurface { to: distances(&wall(surface)?, other), from: distances(&left, surface), volume_ratio: None })
}

/// The space between the outermost voxels' centres.
struct Picture<'a>(&'a Grid);

impl Picture<'_> {
    /// Distance from the nearest side, mm, negative outside.
    fn depth(&self, p: &Point) -> f64 {
        let (i, spacing) = (self.0.to_index(p), self.0.spacing());
        (0..3).map(|a| spacing[a] * i[a].min(self.0.dims[a] as f64 - 1.0 - i[a])).fold(f64::INFINITY, f64::min)
    }
}

/// Whether a cut took `p` away: on its far side, or within a voxel diagonal of the plane, and not far along. A vessel that the
/// picture's side cuts at a slant tapers off beyond a square cut, over twice that way at most.
fn beyond(cut: &Cut, p: &Point, unit: f64, reach: f64, depth: f64) -> bool {
    let reach = if depth < SLANT * cut.radius { 2.0 * reach } else { reach };
    cut.plane.signed_distance(p) > -unit && (p - cut.plane.origin).norm() < reach * cut.radius
}

/// Radii from the picture's side within which a vessel may taper off: as wide as it is, and a little more.
const SLANT: f64 = 2.5;

/// About `n` points spread evenly over the area of some triangles; the same for the same mesh.
///
/// The i-th point lies where (i + ½)/n of the area has passed, at barycentric coordinates from a low-discrepancy
/// sequence.
fn spread(mesh: &TriMesh, triangles: &[u32], n: usize) -> Vec<Point> {
    let mut passed = Vec::with_capacity(triangles.len());
    let mut sum = 0.0;
    for &t in triangles {
        sum += 0.5 * mesh.area_vector2(t as usize).norm();
        passed.push(sum);
    }
    if !(sum > 0.0 && sum.is_finite()) {
        return Vec::new();
    }
    (0..n)
        .into_par_iter()
        .map(|i| {
            let a = (i as f64 + 0.5) / n as f64 * sum;
            let t = passed.partition_point(|&x| x <= a).min(triangles.len() - 1);
            let [p, q, r] = mesh.corners(triangles[t] as usize);
            // Martin Roberts' R2 sequence.
            let (mut u, mut v) = ((i as f64 * 0.754_877_666_246_692_7).fract(), (i as f64 * 0.569_840_290_998_053_2).fract());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            p + (q - p) * u + (r - p) * v
        })
        .collect()
}

fn worst_places(mut places: Vec<(f64, Point, Direction)>, unit: f64, n: usize) -> Vec<WorstPlace> {
    let order = |a: &(f64, Point, Direction), b: &(f64, Point, Direction)| {
        let key = |p: &Point| [p.x, p.y, p.z];
        b.0.total_cmp(&a.0).then_with(|| key(&a.1).partial_cmp(&key(&b.1)).unwrap_or(std::cmp::Ordering::Equal))
    };
    places.par_sort_by(order);
    let mut out: Vec<WorstPlace> = Vec::new();
    for (distance, point, direction) in places {
        if out.len() == n {
            break;
        }
        if out.iter().all(|w| (w.point - point).norm() >= 3.0 * unit) {
            out.push(WorstPlace { point, distance, voxel_diagonals: distance / unit, direction });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Vector;
    use crate::mesh::test_shapes::sphere;

    fn ball(r: f64) -> Mask {
        let n = (2.0 * r) as usize + 6;
        let grid = Grid::new([n; 3], [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
        let c = Vector::repeat((n as f64 - 1.0) / 2.0);
        let data = (0..grid.len()).map(|i| {
            let v = Vector::from(grid.voxel(i).map(|x| x as f64));
            u8::from((v - c).norm() < r)
        });
        let data = data.collect();
        Mask::new(grid, data)
    }

    fn center(m: &Mask) -> Point {
        Point::from(Vector::repeat((m.grid.dims[0] as f64 - 1.0) / 2.0))
    }

    #[test]
    fn the_marching_cubes_surface_itself_is_at_distance_zero() {
        let m = ball(6.0);
        let r = Reference::new(&m).unwrap();
        let f = measure(r.surface(), &r, &[], &FidelityOptions::default()).unwrap();
        assert!(f.to_marching_cubes.mm.max < 1e-12 && f.from_marching_cubes.mm.max < 1e-12);
        assert!(f.deviation.iter().all(|d| d.abs() < 1e-12));
        assert_eq!(f.cut_off_fraction, 0.0);
    }

    #[test]
    fn an_inflated_sphere_is_off_by_its_inflation_and_deviates_outwards() {
        let m = ball(8.0);
        let r = Reference::new(&m).unwrap();
        let near = measure(&sphere(center(&m), 8.0, 20), &r, &[], &FidelityOptions::default()).unwrap();
        let far = measure(&sphere(center(&m), 10.0, 20), &r, &[], &FidelityOptions::default()).unwrap();
        assert!(near.to_marching_cubes.mm.median < 0.3 && near.from_marching_cubes.mm.max < 0.8);
        let d = far.to_marching_cubes.mm.mean - 2.0;
        assert!(d.abs() < 0.25, "stairs reach out: {d}");
        assert!(far.deviation.iter().all(|d| *d > 1.0));
        let diagonal = 3f64.sqrt();
        assert!((far.to_marching_cubes.voxel_diagonals.mean * diagonal - far.to_marching_cubes.mm.mean).abs() < 1e-12);
        assert!((near.volume_ratio - 1.0).abs() < 0.02, "{}", near.volume_ratio);
        assert!((far.volume_ratio - (10f64 / 8.0).powi(3)).abs() < 0.05);
    }

    #[test]
    fn a_missing_half_is_seen_from_the_mask_unless_it_was_cut() {
        let m = ball(8.0);
        let r = Reference::new(&m).unwrap();
        let c = center(&m);
        // A flattened sphere: all points beyond the plane pressed onto it.
        let mut s = sphere(c, 8.0, 24);
        s.points.iter_mut().for_each(|p| p.x = p.x.min(c.x));
        for t in 0..s.triangles.len() {
            if s.corners(t).iter().all(|p| p.x == c.x) {
                s.patch[t] = 2;
            }
        }
        let whole = measure(&s, &r, &[], &FidelityOptions::default()).unwrap();
        assert!(whole.from_marching_cubes.mm.max > 7.0 && whole.to_marching_cubes.mm.max < 1.0);
        assert!(whole.worst[0].point.x > c.x + 7.0 && whole.worst[0].direction == Direction::FromMarchingCubes);
        let cut = Cut { plane: Plane::new(c, Vector::x()).unwrap(), radius: 8.0, name: "outlet_1".into(), user: true };
        let half = measure(&s, &r, &[cut], &FidelityOptions::default()).unwrap();
        assert!(half.from_marching_cubes.mm.max < 1.0, "{}", half.from_marching_cubes.mm.max);
        assert!((half.cut_off_fraction - 0.5).abs() < 0.15);
        assert!((half.volume_ratio - 1.0).abs() < 0.03, "{}", half.volume_ratio);
    }

    #[test]
    fn a_vessel_that_the_pictures_side_cuts_at_a_slant_is_held_to_the_mask_inside_the_picture_alone() {
        // A tube of radius 3 that leaves the picture through x = 40 at 18°: the square cut is 30 mm before its last voxel.
        let (dims, slant) = ([41, 40, 15], 18f64.to_radians());
        let along = Vector::new(slant.sin(), slant.cos(), 0.0);
        let foot = Point::new(30.0, 0.0, 7.0);
        let grid = Grid::new(dims, [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
        let off = |p: &Point| {
            let d = p - foot;
            (d - along * d.dot(&along)).norm()
        };
        let data = (0..grid.len()).map(|n| u8::from(off(&Point::from(Vector::from(grid.voxel(n).map(|x| x as f64)))) < 3.0)).collect();
        let m = Mask::new(grid, data);
        let r = Reference::new(&m).unwrap();
        // The tube as it is, to the cut, both ends closed by fans.
        let (u, v) = (along.cross(&Vector::z()), Vector::z());
        let ring = |k: u32| (0..24).map(move |n| f64::from(n) * std::f64::consts::TAU / 24.0).map(move |a| foot + along * (f64::from(k) - 6.0) + (u * a.cos() + v * a.sin()) * 3.0);
        let mut points: Vec<Point> = (0..23).flat_map(ring).collect();
        points.extend([foot - along * 6.0, foot + along * 16.0]);
        let wall = (0..22 * 24).flat_map(|n| {
            let (k, m) = (24 * (n / 24) + n % 24, 24 * (n / 24) + (n + 1) % 24);
            [[k, m, m + 24], [k, m + 24, k + 24]]
        });
        let caps = (0..24).flat_map(|n| [[(n + 1) % 24, n, 552], [528 + n, 528 + (n + 1) % 24, 553]]);
        let mut s = TriMesh::new(points, wall.chain(caps).collect());
        (22 * 48..s.triangles.len()).for_each(|t| s.patch[t] = 2);
        let cut = Cut { plane: Plane::new(foot + along * 16.0, along).unwrap(), radius: 3.0, name: "outlet_1".into(), user: false };
        let whole = measure(&s, &r, &[], &FidelityOptions::default()).unwrap();
        assert!(whole.from_marching_cubes.mm.max > 15.0, "{}", whole.from_marching_cubes.mm.max);
        let f = measure(&s, &r, &[cut], &FidelityOptions::default()).unwrap();
        assert!(f.from_marching_cubes.mm.max < 1.7 && f.to_marching_cubes.mm.max < 1.7, "{:?} {:?}", f.from_marching_cubes.mm, f.to_marching_cubes.mm);
    }

    #[test]
    fn empty_inputs_are_refused() {
        let grid = Grid::new([3; 3], [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
        let empty = Mask::new(grid, vec![0; 27]);
        assert_eq!(Reference::new(&empty).unwrap_err(), FidelityError::EmptyMask);
        let m = ball(3.0);
        let r = Reference::new(&m).unwrap();
        let none = TriMesh::new(Vec::new(), Vec::new());
        assert_eq!(measure(&none, &r, &[], &FidelityOptions::default()).unwrap_err(), FidelityError::NoWall(0));
    }
}
