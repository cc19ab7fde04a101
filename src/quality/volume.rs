//! Quality of a volume mesh.
//!
//! * Equi-volume skewness of tetrahedra: S_V = 1 − V/V_opt with V_opt = (8√3/27) R³, R the circumradius
//!   (FLUENT's and TGrid's default for tetrahedra): 0 regular, 1 flat.
//! * Equi-angle skewness of prisms and other cells: the worst angle of all faces against 60° and 90°.
//! * FLUENT's orthogonality: over the faces of a cell the smallest cosine between the face's area vector and the
//!   lines from the cell centre to the face centre and to the neighbour's centre; orthogonal quality as in ANSYS
//!   Meshing is min(orthogonality, 1 − skewness).
//! * OpenFOAM's measures: see [`super::FoamQuality`].

use rayon::prelude::*;
use serde::Serialize;

use super::foam::{self, Cells, FoamQuality, face_geometry};
use super::stats::{Histogram, Summary, largest};
use crate::geometry::Point;
use crate::mesh::VolumeMesh;
use crate::mesh::faces::{FaceError, FaceList, FaceMesh, PolyMesh};

/// What to list.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VolumeOptions {
    /// How many of the worst cells and faces to list.
    pub worst: usize,
    /// Bins of the histograms over [0, 1].
    pub bins: usize,
}

impl Default for VolumeOptions {
    fn default() -> Self {
        VolumeOptions { worst: 10, bins: 20 }
    }
}

/// A cell among the worst.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstCell {
    /// Cell id: tetrahedra first, prisms after them.
    pub id: u32,
    /// The measure.
    pub value: f64,
    /// Centroid, mm.
    pub center: Point,
}

/// Distribution of a skewness.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Skewness {
    /// Cells measured.
    pub cells: usize,
    /// Largest, mean, percentiles.
    pub summary: Summary,
    /// Cells above 0.80.
    pub over_080: usize,
    /// Cells above 0.90.
    pub over_090: usize,
    /// Cells above 0.95.
    pub over_095: usize,
    /// Over [0, 1].
    pub histogram: Histogram,
    /// The worst, worst first.
    pub worst: Vec<WorstCell>,
}

/// FLUENT's orthogonality measures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FluentQuality {
    /// Smallest orthogonality of a cell, without the skewness term (older FLUENT's "orthogonal quality").
    pub orthogonality_min: f64,
    /// Mean orthogonality.
    pub orthogonality_mean: f64,
    /// Smallest min(orthogonality, 1 − skewness); equi-volume for tetrahedra, equi-angle otherwise.
    pub orthogonal_quality_min: f64,
    /// Mean of the same.
    pub orthogonal_quality_mean: f64,
    /// Cells with orthogonal quality below 0.1.
    pub orthogonal_quality_under_010: usize,
    /// The cells of smallest orthogonal quality.
    pub worst: Vec<WorstCell>,
}

/// Everything measured on a volume mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VolumeQuality {
    /// Cells.
    pub cells: usize,
    /// Tetrahedra.
    pub tets: usize,
    /// Prisms.
    pub prisms: usize,
    /// Cells that are neither (only in meshes read from elsewhere).
    pub other_cells: usize,
    /// Largest equi-volume skewness.
    pub sv_max: f64,
    /// Mean equi-volume skewness.
    pub sv_mean: f64,
    /// Tetrahedra above 0.80.
    pub sv_over_080: usize,
    /// Tetrahedra above 0.90.
    pub sv_over_090: usize,
    /// Tetrahedra above 0.95.
    pub sv_over_095: usize,
    /// Equi-volume skewness of the tetrahedra.
    pub equi_volume: Skewness,
    /// Equi-angle skewness of the cells that are no tetrahedra.
    pub equi_angle: Skewness,
    /// Cells of zero or negative volume.
    pub nonpositive_cells: usize,
    /// Sum of volumes, mm³.
    pub volume: f64,
    /// Smallest dihedral angle of a tetrahedron, degrees; `None` without tetrahedra.
    pub min_dihedral: Option<f64>,
    /// Largest dihedral angle of a tetrahedron, degrees.
    pub max_dihedral: Option<f64>,
    /// OpenFOAM's measures.
    pub openfoam: FoamQuality,
    /// FLUENT's measures.
    pub fluent: FluentQuality,
    /// Skewness of each cell: the cell array `EquiVolumeSkewness` (equi-angle for prisms).
    #[serde(skip)]
    pub per_cell: Vec<f64>,
}

/// Equi-volume skewness of a tetrahedron: 0 regular, 1 flat or inverted.
///
/// ```
/// use lumenmesh::{geometry::Point, quality::equi_volume_skewness};
/// // A corner of a cube: R = √3/2, V = 1/6, V_opt = √3/3 · √3/3.
/// let p = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Point::from);
/// assert!((equi_volume_skewness(p) - 0.5).abs() < 1e-12);
/// ```
pub fn equi_volume_skewness(corners: [Point; 4]) -> f64 {
    (1.0 - foam::tet_quality(corners)).clamp(0.0, 1.0)
}

/// Smallest and largest dihedral angle of a tetrahedron, degrees.
pub fn dihedral_range(p: [Point; 4]) -> (f64, f64) {
    let mut range = (180.0f64, 0.0f64);
    for [i, j, k, l] in [[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0], [2, 3, 0, 1]] {
        let e = p[j] - p[i];
        let (a, b) = (e.cross(&(p[k] - p[i])), e.cross(&(p[l] - p[i])));
        let angle = (a.cross(&b).norm()).atan2(a.dot(&b)).to_degrees();
        range = (range.0.min(angle), range.1.max(angle));
    }
    range
}

/// Equi-angle skewness of a face with three or more corners.
fn face_skewness(points: &[Point], face: &[u32]) -> f64 {
    let n = face.len();
    let ideal = if n == 3 { 60.0 } else { 180.0 - 360.0 / n as f64 };
    (0..n)
        .map(|i| {
            let o = points[face[i] as usize];
            let (u, v) = (points[face[(i + 1) % n] as usize] - o, points[face[(i + n - 1) % n] as usize] - o);
            let angle = if u.norm() > 0.0 && v.norm() > 0.0 { u.cross(&v).norm().atan2(u.dot(&v)).to_degrees() } else { 0.0 };
            super::surface::skewness([angle], ideal)
        })
        .fold(0.0, f64::max)
}

/// The four corners of cell `c` where it is a tetrahedron, positively ordered if its faces point outwards.
fn tetrahedron(mesh: &impl FaceMesh, cells: &Cells, c: usize) -> Option<[u32; 4]> {
    let of = cells.faces.of(c);
    if of.len() != 4 || of.iter().any(|&f| mesh.face(f as usize).len() != 3) {
        return None;
    }
    let f = of[0] as usize;
    let t = mesh.face(f);
    let apex = of[1..].iter().flat_map(|&g| mesh.face(g as usize)).copied().find(|v| !t.contains(v))?;
    // The face's normal points out of its owner, away from the apex.
    Some(if mesh.owner()[f] as usize == c { [t[0], t[2], t[1], apex] } else { [t[0], t[1], t[2], apex] })
}

/// Measures a mesh of tetrahedra and prisms; deterministic for any number of threads.
///
/// # Errors
/// Where the cells do not conform or the boundary list is not the outside: see [`FaceError`].
pub fn volume(mesh: &VolumeMesh, options: &VolumeOptions) -> Result<VolumeQuality, FaceError> {
    let faces = FaceList::build(mesh)?;
    Ok(measure(&faces, options, mesh.prisms.len(), |c| mesh.tets.get(c).copied()))
}

/// The same with a face list that is already there.
pub fn volume_of_faces(mesh: &VolumeMesh, faces: &FaceList<'_>, options: &VolumeOptions) -> VolumeQuality {
    measure(faces, options, mesh.prisms.len(), |c| mesh.tets.get(c).copied())
}

/// Measures a mesh of arbitrary polyhedra; owners and neighbours must be below `mesh.cells`.
pub fn polyhedral(mesh: &PolyMesh, options: &VolumeOptions) -> VolumeQuality {
    let cells = Cells::build(mesh);
    let prisms = (0..mesh.cells)
        .filter(|&c| {
            let of = cells.faces.of(c);
            of.len() == 5 && of.iter().filter(|&&f| mesh.face(f as usize).len() == 3).count() == 2
                && of.iter().filter(|&&f| mesh.face(f as usize).len() == 4).count() == 3
        })
        .count();
    let tets: Vec<Option<[u32; 4]>> = (0..mesh.cells).into_par_iter().map(|c| tetrahedron(mesh, &cells, c)).collect();
    finish(mesh, &cells, options, prisms, |c| tets[c])
}

fn measure(faces: &FaceList<'_>, options: &VolumeOptions, prisms: usize, tet: impl Fn(usize) -> Option<[u32; 4]> + Sync) -> VolumeQuality {
    finish(faces, &Cells::build(faces), options, prisms, tet)
}

fn finish(
    mesh: &impl FaceMesh,
    cells: &Cells,
    options: &VolumeOptions,
    prisms: usize,
    tet: impl Fn(usize) -> Option<[u32; 4]> + Sync,
) -> VolumeQuality {
    let points = mesh.points();
    let corners = |v: [u32; 4]| v.map(|i| points[i as usize]);
    let per_cell: Vec<f64> = (0..mesh.cells())
        .into_par_iter()
        .map(|c| match tet(c) {
            Some(v) => equi_volume_skewness(corners(v)),
            None => cells.faces.of(c).iter().map(|&f| face_skewness(points, mesh.face(f as usize))).fold(0.0, f64::max),
        })
        .collect();
    let (min_dihedral, max_dihedral) = (0..mesh.cells())
        .into_par_iter()
        .filter_map(|c| tet(c).map(|v| dihedral_range(corners(v))))
        .reduce(|| (f64::INFINITY, f64::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let distribution = |tets: bool| {
        let ids: Vec<u32> = (0..mesh.cells() as u32).filter(|&c| tet(c as usize).is_some() == tets).collect();
        let s: Vec<f64> = ids.iter().map(|&c| per_cell[c as usize]).collect();
        let over = |limit: f64| s.iter().filter(|&&v| v > limit).count();
        let worst = largest(&s, options.worst).into_iter().map(|k| {
            let id = ids[k as usize];
            WorstCell { id, value: s[k as usize], center: cells.centers[id as usize] }
        });
        Skewness {
            cells: s.len(),
            summary: Summary::of(&s),
            over_080: over(0.8),
            over_090: over(0.9),
            over_095: over(0.95),
            histogram: Histogram::of(&s, options.bins),
            worst: worst.collect(),
        }
    };
    let (equi_volume, equi_angle) = (distribution(true), distribution(false));
    let fluent = fluent(mesh, cells, &per_cell, options);
    let openfoam = foam::measure(mesh, cells, options.worst);
    let tets = equi_volume.cells;
    VolumeQuality {
        cells: mesh.cells(),
        tets,
        prisms,
        other_cells: mesh.cells() - tets - prisms,
        sv_max: equi_volume.summary.max,
        sv_mean: equi_volume.summary.mean,
        sv_over_080: equi_volume.over_080,
        sv_over_090: equi_volume.over_090,
        sv_over_095: equi_volume.over_095,
        nonpositive_cells: openfoam.nonpositive_volumes,
        volume: openfoam.total_volume,
        min_dihedral: (tets > 0).then_some(min_dihedral),
        max_dihedral: (tets > 0).then_some(max_dihedral),
        equi_volume,
        equi_angle,
        openfoam,
        fluent,
        per_cell,
    }
}

fn fluent(mesh: &impl FaceMesh, cells: &Cells, skewness: &[f64], options: &VolumeOptions) -> FluentQuality {
    let orthogonality: Vec<f64> = (0..mesh.cells())
        .into_par_iter()
        .map(|c| {
            let here = cells.centers[c];
            let mut worst = 1.0f64;
            for &f in cells.faces.of(c) {
                let f = f as usize;
                let (fc, s) = face_geometry(mesh.points(), mesh.face(f));
                let sign = if mesh.owner()[f] as usize == c { 1.0 } else { -1.0 };
                let cosine = |d: crate::geometry::Vector| sign * s.dot(&d) / (s.norm() * d.norm()).max(f64::MIN_POSITIVE);
                worst = worst.min(cosine(fc - here));
                if let Some(&n) = mesh.neighbour().get(f) {
                    let other = if sign > 0.0 { n } else { mesh.owner()[f] };
                    worst = worst.min(cosine(cells.centers[other as usize] - here));
                }
            }
            worst
        })
        .collect();
    let quality: Vec<f64> = orthogonality.iter().zip(skewness).map(|(o, s)| o.min(1.0 - s)).collect();
    let badness: Vec<f64> = quality.iter().map(|q| -q).collect();
    let min = |v: &[f64]| v.iter().copied().fold(1.0, f64::min);
    FluentQuality {
        orthogonality_min: min(&orthogonality),
        orthogonality_mean: super::stats::mean(&orthogonality),
        orthogonal_quality_min: min(&quality),
        orthogonal_quality_mean: super::stats::mean(&quality),
        orthogonal_quality_under_010: quality.iter().filter(|&&q| q < 0.1).count(),
        worst: largest(&badness, options.worst)
            .into_iter()
            .map(|id| WorstCell { id, value: quality[id as usize], center: cells.centers[id as usize] })
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{BoundaryFace, Patch};

    fn regular() -> VolumeMesh {
        let points = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(Point::from).to_vec();
        let mut m = VolumeMesh { points, tets: vec![[0, 1, 2, 3]], patches: vec![Patch::wall()], ..Default::default() };
        let v = (m.points[1] - m.points[0]).cross(&(m.points[2] - m.points[0])).dot(&(m.points[3] - m.points[0]));
        if v < 0.0 {
            m.tets[0].swap(0, 1);
        }
        m.boundary = m.outer_faces().unwrap().into_iter().map(|v| BoundaryFace { vertices: v, patch: 1 }).collect();
        m
    }

    #[test]
    fn a_regular_tetrahedron_is_perfect_by_every_measure() {
        let q = volume(&regular(), &VolumeOptions::default()).unwrap();
        assert!(q.sv_max < 1e-12);
        let dihedral = (1f64 / 3.0).acos().to_degrees();
        assert!((q.min_dihedral.unwrap() - dihedral).abs() < 1e-9 && (q.max_dihedral.unwrap() - dihedral).abs() < 1e-9);
        assert!((q.volume - 8.0 / 3.0).abs() < 1e-12);
        assert!((q.fluent.orthogonality_min - 1.0).abs() < 1e-12);
        assert_eq!((q.openfoam.faces, q.openfoam.internal_faces, q.nonpositive_cells), (4, 0, 0));
    }

    #[test]
    fn an_inverted_tetrahedron_is_counted_and_fully_skewed() {
        let mut m = regular();
        m.tets[0].swap(0, 1);
        m.boundary.iter_mut().for_each(|b| *b = BoundaryFace::triangle([b.vertices[0], b.vertices[2], b.vertices[1]], 1));
        let q = volume(&m, &VolumeOptions::default()).unwrap();
        assert_eq!((q.nonpositive_cells, q.sv_max), (1, 1.0));
    }

    #[test]
    fn skewness_does_not_depend_on_the_unit() {
        let p = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.3, 1.0, 0.2], [0.1, 0.2, 0.7]];
        let s = |k: f64| equi_volume_skewness(p.map(|c| Point::new(k * c[0], k * c[1], k * c[2])));
        assert!((s(1.0) - s(1e-3)).abs() < 1e-13 && (s(1.0) - s(1e6)).abs() < 1e-13 && s(1.0) > 0.0 && s(1.0) < 1.0);
    }

    #[test]
    fn missing_and_surplus_boundary_faces_are_errors() {
        let mut m = regular();
        let last = m.boundary.pop().unwrap();
        assert!(matches!(volume(&m, &VolumeOptions::default()), Err(FaceError::Unlisted { cell: 0, .. })));
        m.boundary.extend([last, last]);
        assert!(matches!(volume(&m, &VolumeOptions::default()), Err(FaceError::NotOuter { .. })));
        m.boundary.pop();
        m.tets.extend([m.tets[0]; 2]);
        assert!(matches!(volume(&m, &VolumeOptions::default()), Err(FaceError::Shared { .. })));
    }
}
