//! The measures of OpenFOAM's `checkMesh -allGeometry`, computed as v1912 computes them.
//!
//! Formulas follow `primitiveMeshTools` and `primitiveMeshCheck`; values agree with what checkMesh prints.
//! OpenFOAM's "skewness" is a distance ratio: it has nothing to do with equi-angle or equi-volume skewness.

use rayon::prelude::*;
use serde::Serialize;

use super::stats::sum;
use crate::geometry::{Point, Vector};
use crate::mesh::faces::{CellFaces, FaceMesh};

/// OpenFOAM's guard against division by zero.
const ROOT_VSMALL: f64 = 1e-150;
const VSMALL: f64 = 1e-300;

/// A face or cell among the worst.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Place {
    /// Face or cell id (faces in OpenFOAM's order).
    pub id: u32,
    /// The measure there.
    pub value: f64,
    /// Centre, mm.
    pub center: Point,
}

/// What `checkMesh -allGeometry -allTopology` prints, by its names.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoamQuality {
    /// Faces.
    pub faces: usize,
    /// Inner faces.
    pub internal_faces: usize,
    /// Largest openness of a cell (0 is closed).
    pub max_cell_openness: f64,
    /// Largest aspect ratio of a cell; limit 1000.
    pub max_aspect_ratio: f64,
    /// Smallest face area, mm².
    pub min_face_area: f64,
    /// Largest face area, mm².
    pub max_face_area: f64,
    /// Smallest cell volume, mm³.
    pub min_volume: f64,
    /// Largest cell volume, mm³.
    pub max_volume: f64,
    /// Sum of cell volumes, mm³.
    pub total_volume: f64,
    /// Cells whose volume is not positive.
    pub nonpositive_volumes: usize,
    /// Largest angle between the line of the cell centres and the face normal, degrees.
    pub non_orthogonality_max: f64,
    /// Angle of the mean cosine, degrees: checkMesh's "average".
    pub non_orthogonality_average: f64,
    /// Faces above 70°, those at 90° and more left out.
    pub non_orthogonality_over_70: usize,
    /// Faces at 90° and more: errors.
    pub non_orthogonality_errors: usize,
    /// Face pyramids of wrong orientation.
    pub wrong_pyramids: usize,
    /// Largest OpenFOAM skewness; limit 4.
    pub skewness_max: f64,
    /// Faces of OpenFOAM skewness above 4.
    pub skewness_over_4: usize,
    /// Faces that do not split into positive tetrahedra of quality above 1e-15 with both cell centres.
    pub wrong_face_tets: usize,
    /// Smallest flatness of faces with more than three corners; `None` where all are triangles.
    pub min_flatness: Option<f64>,
    /// Mean flatness of those faces.
    pub average_flatness: Option<f64>,
    /// Smallest cell determinant (inner faces only); limit 0.001.
    pub determinant_min: f64,
    /// Mean cell determinant.
    pub determinant_average: f64,
    /// Cells with a determinant below 0.001.
    pub determinant_under_0001: usize,
    /// Concave cells; slightly bent quads make prisms concave.
    pub concave_cells: usize,
    /// Smallest interpolation weight; limit 0.05.
    pub weight_min: f64,
    /// Mean interpolation weight of inner faces.
    pub weight_average: f64,
    /// Faces with a weight below 0.05.
    pub weight_under_005: usize,
    /// Smallest volume ratio of neighbours; limit 0.01.
    pub volume_ratio_min: f64,
    /// Mean volume ratio of inner faces.
    pub volume_ratio_average: f64,
    /// Faces with a volume ratio below 0.01.
    pub volume_ratio_under_001: usize,
    /// Cells with zero or one inner face.
    pub cells_with_at_most_one_internal_face: usize,
    /// Cells with two inner faces.
    pub cells_with_two_internal_faces: usize,
    /// Cells with two and more boundary faces.
    pub cells_with_two_boundary_faces: usize,
    /// The faces of largest non-orthogonality.
    pub worst_non_orthogonality: Vec<Place>,
    /// The faces of largest OpenFOAM skewness.
    pub worst_skewness: Vec<Place>,
    /// The cells of smallest determinant.
    pub worst_determinant: Vec<Place>,
}

impl FoamQuality {
    /// Whether checkMesh would end with "Mesh OK" as far as geometry goes; with `-allGeometry` where `all`.
    pub fn mesh_ok(&self, all: bool) -> bool {
        let plain = self.nonpositive_volumes == 0
            && self.max_cell_openness <= 1e-6
            && self.max_aspect_ratio <= 1000.0
            && self.non_orthogonality_errors == 0
            && self.wrong_pyramids == 0
            && self.skewness_over_4 == 0
            && self.min_face_area > 0.0;
        plain
            && (!all
                || self.determinant_under_0001 == 0
                    && self.wrong_face_tets == 0
                    && self.concave_cells == 0
                    && self.weight_under_005 == 0
                    && self.volume_ratio_under_001 == 0)
    }
}

/// Centre and area vector of a face: triangles about the mean of its corners.
pub fn face_geometry(points: &[Point], face: &[u32]) -> (Point, Vector) {
    let p = |i: usize| points[face[i % face.len()] as usize];
    if face.len() == 3 {
        let (a, b, c) = (p(0), p(1), p(2));
        return (Point::from((a.coords + b.coords + c.coords) / 3.0), 0.5 * (b - a).cross(&(c - a)));
    }
    let middle = face.iter().map(|&v| points[v as usize].coords).sum::<Vector>() / face.len() as f64;
    let (mut sum_n, mut sum_a, mut sum_ac) = (Vector::zeros(), 0.0, Vector::zeros());
    for i in 0..face.len() {
        let (a, b) = (p(i), p(i + 1));
        let n = (b - a).cross(&(Point::from(middle) - a));
        let area = n.norm();
        sum_n += n;
        sum_a += area;
        sum_ac += area * (a.coords + b.coords + middle);
    }
    let center = if sum_a > VSMALL { sum_ac / (3.0 * sum_a) } else { middle };
    (Point::from(center), 0.5 * sum_n)
}

/// Volumes and centres of all cells, and the faces of each.
#[derive(Debug)]
pub(super) struct Cells {
    pub faces: CellFaces,
    pub centers: Vec<Point>,
    pub volumes: Vec<f64>,
}

impl Cells {
    pub(super) fn build(mesh: &impl FaceMesh) -> Cells {
        let faces = CellFaces::build(mesh);
        let (centers, volumes) = (0..mesh.cells())
            .into_par_iter()
            .map(|c| {
                let mut estimate = Vector::zeros();
                let of = faces.of(c);
                for &f in of {
                    estimate += face_geometry(mesh.points(), mesh.face(f as usize)).0.coords;
                }
                estimate /= of.len().max(1) as f64;
                let (mut center, mut volume) = (Vector::zeros(), 0.0);
                for &f in of {
                    let (fc, s) = face_geometry(mesh.points(), mesh.face(f as usize));
                    let v = outward(mesh, f, c, s).dot(&(fc.coords - estimate));
                    center += v * (0.75 * fc.coords + 0.25 * estimate);
                    volume += v;
                }
                let center = if volume.abs() > VSMALL { center / volume } else { estimate };
                (Point::from(center), volume / 3.0)
            })
            .unzip();
        Cells { faces, centers, volumes }
    }
}

/// The area vector `s` of face `f`, out of cell `c`.
fn outward(mesh: &impl FaceMesh, f: u32, c: usize, s: Vector) -> Vector {
    if mesh.owner()[f as usize] as usize == c { s } else { -s }
}

/// Cosine of the angle between the line of the cell centres and the normal of inner face `f`.
pub(super) fn orthogonality(mesh: &impl FaceMesh, cells: &Cells, f: usize) -> f64 {
    let d = cells.centers[mesh.neighbour()[f] as usize] - cells.centers[mesh.owner()[f] as usize];
    let s = face_geometry(mesh.points(), mesh.face(f)).1;
    d.dot(&s) / (d.norm() * s.norm() + ROOT_VSMALL)
}

/// OpenFOAM's skewness of a face.
fn skewness(mesh: &impl FaceMesh, cells: &Cells, f: usize) -> f64 {
    let points = mesh.points();
    let (fc, s) = face_geometry(points, mesh.face(f));
    let own = cells.centers[mesh.owner()[f] as usize];
    let cpf = fc - own;
    let (d, share) = match mesh.neighbour().get(f) {
        Some(&n) => (cells.centers[n as usize] - own, 0.2),
        None => {
            let normal = s / (s.norm() + VSMALL);
            (normal * normal.dot(&cpf), 0.4)
        }
    };
    let sv = cpf - (s.dot(&cpf) / (s.dot(&d) + ROOT_VSMALL)) * d;
    let hat = sv / (sv.norm() + ROOT_VSMALL);
    let reach = mesh.face(f).iter().map(|&v| hat.dot(&(points[v as usize] - fc)).abs()).fold(share * d.norm() + ROOT_VSMALL, f64::max);
    sv.norm() / reach
}

/// Whether the tetrahedra over `base` (a face corner) with both cell centres are positive.
fn splits_from(mesh: &impl FaceMesh, cells: &Cells, f: usize, base: usize) -> bool {
    let face = mesh.face(f);
    let p = |i: usize| mesh.points()[face[i % face.len()] as usize];
    (1..face.len() - 1).all(|i| {
        let (a, b, c) = (p(base), p(base + i), p(base + i + 1));
        let own = tet_quality([cells.centers[mesh.owner()[f] as usize], a, b, c]);
        let other = mesh.neighbour().get(f).map_or(1.0, |&n| tet_quality([cells.centers[n as usize], a, c, b]));
        own > 1e-15 && other > 1e-15
    })
}

/// Signed volume over that of the regular tetrahedron of the same circumsphere.
pub(super) fn tet_quality([a, b, c, d]: [Point; 4]) -> f64 {
    let (u, v, w) = (b - a, c - a, d - a);
    let six = u.cross(&v).dot(&w);
    // Circumradius from the products of opposite edges.
    let (p, q, r) = (
        ((b - a).norm_squared() * (d - c).norm_squared()).sqrt(),
        ((c - a).norm_squared() * (d - b).norm_squared()).sqrt(),
        ((d - a).norm_squared() * (c - b).norm_squared()).sqrt(),
    );
    let area = ((p + q + r) * (p + q - r) * (p - q + r) * (q + r - p)).max(0.0).sqrt();
    if !(six.abs() > 0.0) || !(area > 0.0) {
        return 0.0;
    }
    // R = area / (24 V), V = six / 6, V_opt = (8√3/27) R³, so V/V_opt = 12√3 six⁴ / area³.
    let t = six.abs() / area;
    let quality = 12.0 * 3f64.sqrt() * t * t * t * six.abs();
    quality.min(1.0).copysign(six)
}

struct FaceMeasures {
    cosine: f64,
    skewness: f64,
    weight: f64,
    ratio: f64,
    area: f64,
    flatness: f64,
    bad_pyramids: u8,
    bad_tets: bool,
}

fn measure_face(mesh: &impl FaceMesh, cells: &Cells, f: usize) -> FaceMeasures {
    let points = mesh.points();
    let face = mesh.face(f);
    let (fc, s) = face_geometry(points, face);
    let o = mesh.owner()[f] as usize;
    let (mut cosine, mut weight, mut ratio) = (f64::NAN, 1.0, 1.0);
    let mut bad_pyramids = u8::from(!(s.dot(&(fc - cells.centers[o])) / 3.0 > VSMALL));
    if let Some(&n) = mesh.neighbour().get(f) {
        let n = n as usize;
        cosine = orthogonality(mesh, cells, f);
        let (a, b) = (s.dot(&(fc - cells.centers[o])).abs(), s.dot(&(cells.centers[n] - fc)).abs());
        weight = a.min(b) / (a + b + VSMALL);
        let (a, b) = (cells.volumes[o].abs(), cells.volumes[n].abs());
        ratio = a.min(b) / (a.max(b) + VSMALL);
        bad_pyramids += u8::from(!(s.dot(&(cells.centers[n] - fc)) / 3.0 > VSMALL));
    }
    let mut flatness = f64::NAN;
    if face.len() > 3 {
        let sum: f64 = (0..face.len())
            .map(|i| {
                let (a, b) = (points[face[i] as usize], points[face[(i + 1) % face.len()] as usize]);
                0.5 * (b - a).cross(&(fc - a)).norm()
            })
            .sum();
        flatness = s.norm() / (sum + ROOT_VSMALL);
    }
    let bad_tets = face.len() < 3 || !(0..face.len()).any(|base| splits_from(mesh, cells, f, base));
    FaceMeasures { cosine, skewness: skewness(mesh, cells, f), weight, ratio, area: s.norm(), flatness, bad_pyramids, bad_tets }
}

struct CellMeasures {
    openness: f64,
    aspect: f64,
    determinant: f64,
    concave: bool,
    inner: u32,
    outer: u32,
}

fn measure_cell(mesh: &impl FaceMesh, cells: &Cells, c: usize) -> CellMeasures {
    let (mut closed, mut magnitude) = (Vector::zeros(), Vector::zeros());
    let (mut mean, mut inner, mut outer) = (0.0, 0u32, 0u32);
    let of = cells.faces.of(c);
    let geometry: Vec<(Point, Vector, bool)> = of
        .iter()
        .map(|&f| {
            let (fc, s) = face_geometry(mesh.points(), mesh.face(f as usize));
            (fc, outward(mesh, f, c, s), (f as usize) < mesh.neighbour().len())
        })
        .collect();
    for (_, s, inside) in &geometry {
        closed += s;
        magnitude += s.abs();
        if *inside {
            mean += s.norm();
            inner += 1;
        } else {
            outer += 1;
        }
    }
    let openness = (0..3).map(|i| closed[i].abs() / (magnitude[i] + ROOT_VSMALL)).fold(0.0, f64::max);
    let volume = cells.volumes[c].max(ROOT_VSMALL);
    let aspect = (magnitude.max() / (magnitude.min() + ROOT_VSMALL)).max(magnitude.sum() / 6.0 / volume.powf(2.0 / 3.0));
    let mut determinant = 0.0;
    if inner > 0 && mean >= ROOT_VSMALL {
        mean /= f64::from(inner);
        let tensor = geometry.iter().filter(|g| g.2).fold(nalgebra::Matrix3::zeros(), |m, g| {
            let v = g.1 / mean;
            m + v * v.transpose()
        });
        determinant = tensor.determinant().abs() / 8.0;
    }
    let concave = geometry.iter().enumerate().any(|(i, a)| {
        let normal = a.1 / a.1.norm().max(VSMALL);
        geometry.iter().enumerate().any(|(j, b)| {
            let d = b.0 - a.0;
            i != j && d.dot(&normal) / d.norm().max(VSMALL) > -1e-6
        })
    });
    CellMeasures { openness, aspect, determinant, concave, inner, outer }
}

/// Number of items measured together: bounds the memory of large meshes.
const BLOCK: usize = 1 << 20;

/// The `n` items with the largest `badness`, worst first, carried from block to block.
struct Worst {
    n: usize,
    items: Vec<(f64, u32)>,
}

impl Worst {
    fn offer(&mut self, badness: f64, id: u32) {
        let badness = if badness.is_nan() { f64::INFINITY } else { badness };
        if self.items.len() == self.n && self.items.last().is_none_or(|l| badness <= l.0) {
            return;
        }
        let at = self.items.partition_point(|i| i.0 >= badness);
        self.items.insert(at, (badness, id));
        self.items.truncate(self.n);
    }
}

/// Measures a mesh as checkMesh does; lists `worst` places of the measures that fail most often.
pub(super) fn measure(mesh: &impl FaceMesh, cells: &Cells, worst: usize) -> FoamQuality {
    let (nf, ni, nc) = (mesh.owner().len(), mesh.neighbour().len(), mesh.cells());
    let list = || Worst { n: worst, items: vec![] };
    let (mut ortho, mut skew, mut det) = (list(), list(), list());
    let mut q = FoamQuality {
        faces: nf,
        internal_faces: ni,
        max_cell_openness: 0.0,
        max_aspect_ratio: 0.0,
        min_face_area: f64::INFINITY,
        max_face_area: 0.0,
        min_volume: cells.volumes.iter().copied().fold(f64::INFINITY, f64::min),
        max_volume: cells.volumes.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        total_volume: sum(&cells.volumes),
        nonpositive_volumes: cells.volumes.iter().filter(|&&v| !(v > VSMALL)).count(),
        non_orthogonality_max: 0.0,
        non_orthogonality_average: 0.0,
        non_orthogonality_over_70: 0,
        non_orthogonality_errors: 0,
        wrong_pyramids: 0,
        skewness_max: 0.0,
        skewness_over_4: 0,
        wrong_face_tets: 0,
        min_flatness: None,
        average_flatness: None,
        determinant_min: f64::INFINITY,
        determinant_average: 0.0,
        determinant_under_0001: 0,
        concave_cells: 0,
        weight_min: f64::INFINITY,
        weight_average: 0.0,
        weight_under_005: 0,
        volume_ratio_min: f64::INFINITY,
        volume_ratio_average: 0.0,
        volume_ratio_under_001: 0,
        cells_with_at_most_one_internal_face: 0,
        cells_with_two_internal_faces: 0,
        cells_with_two_boundary_faces: 0,
        worst_non_orthogonality: vec![],
        worst_skewness: vec![],
        worst_determinant: vec![],
    };
    let severe = 70f64.to_radians().cos();
    let (mut cos_sum, mut cos_min) = (0.0, f64::INFINITY);
    let (mut flat_sum, mut flat_min, mut flat_n) = (0.0, f64::INFINITY, 0usize);
    for from in (0..nf).step_by(BLOCK) {
        let block: Vec<FaceMeasures> =
            (from..nf.min(from + BLOCK)).into_par_iter().map(|f| measure_face(mesh, cells, f)).collect();
        for (f, m) in (from..).zip(&block) {
            if f < ni {
                cos_sum += m.cosine;
                q.weight_average += m.weight;
                q.volume_ratio_average += m.ratio;
                cos_min = cos_min.min(m.cosine);
                if m.cosine < severe {
                    if m.cosine > 1e-15 {
                        q.non_orthogonality_over_70 += 1;
                    } else {
                        q.non_orthogonality_errors += 1;
                    }
                }
                ortho.offer(-m.cosine, f as u32);
            }
            skew.offer(m.skewness, f as u32);
            q.skewness_max = q.skewness_max.max(m.skewness);
            q.skewness_over_4 += usize::from(m.skewness > 4.0);
            q.weight_min = q.weight_min.min(m.weight);
            q.weight_under_005 += usize::from(m.weight < 0.05);
            q.volume_ratio_min = q.volume_ratio_min.min(m.ratio);
            q.volume_ratio_under_001 += usize::from(m.ratio < 0.01);
            q.min_face_area = q.min_face_area.min(m.area);
            q.max_face_area = q.max_face_area.max(m.area);
            q.wrong_pyramids += m.bad_pyramids as usize;
            q.wrong_face_tets += usize::from(m.bad_tets);
            if !m.flatness.is_nan() {
                flat_sum += m.flatness;
                flat_min = flat_min.min(m.flatness);
                flat_n += 1;
            }
        }
    }
    let angle = |c: f64| c.clamp(-1.0, 1.0).acos().to_degrees();
    if ni > 0 {
        q.non_orthogonality_max = angle(cos_min);
        q.non_orthogonality_average = angle(cos_sum / ni as f64);
    }
    q.weight_average /= ni.max(1) as f64;
    q.volume_ratio_average /= ni.max(1) as f64;
    if flat_n > 0 {
        q.min_flatness = Some(flat_min);
        q.average_flatness = Some(flat_sum / flat_n as f64);
    }
    for from in (0..nc).step_by(BLOCK) {
        let block: Vec<CellMeasures> =
            (from..nc.min(from + BLOCK)).into_par_iter().map(|c| measure_cell(mesh, cells, c)).collect();
        for (c, m) in (from..).zip(&block) {
            q.max_cell_openness = q.max_cell_openness.max(m.openness);
            q.max_aspect_ratio = q.max_aspect_ratio.max(m.aspect);
            q.determinant_min = q.determinant_min.min(m.determinant);
            q.determinant_average += m.determinant;
            q.determinant_under_0001 += usize::from(m.determinant < 0.001);
            det.offer(-m.determinant, c as u32);
            q.concave_cells += usize::from(m.concave);
            q.cells_with_at_most_one_internal_face += usize::from(m.inner <= 1);
            q.cells_with_two_internal_faces += usize::from(m.inner == 2);
            q.cells_with_two_boundary_faces += usize::from(m.outer >= 2);
        }
    }
    q.determinant_average /= nc.max(1) as f64;
    let at_face = |list: Worst, value: &dyn Fn(f64) -> f64| {
        let place = |&(v, id): &(f64, u32)| Place { id, value: value(v), center: face_geometry(mesh.points(), mesh.face(id as usize)).0 };
        list.items.iter().map(place).collect::<Vec<_>>()
    };
    q.worst_non_orthogonality = at_face(ortho, &|v| angle(-v));
    q.worst_skewness = at_face(skew, &|v| v);
    q.worst_determinant =
        det.items.iter().map(|&(v, id)| Place { id, value: -v, center: cells.centers[id as usize] }).collect();
    q
}
