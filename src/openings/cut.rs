//! Plane cuts after remeshing: local to one branch, rim in the plane, cap triangulated, the neighbourhood repaired
//! (the paper's Figure 19).

mod sheet;
#[cfg(test)]
mod tests;

use serde::Serialize;

use super::rims::{self, RimOptions, RimSummary};
use super::{Error, Opening};
use crate::geometry::{Point, Vector};
use crate::implicit::Implicit;
use crate::mesh::{PatchKind, TriMesh};
use crate::remesh::last_resort::Rung;
use crate::remesh::{SizeField, Stop, Supports, angle_repair, ears};

/// How openings are cut.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CutOptions {
    /// Vertices nearer to the plane than this part of the wished edge length are moved into it.
    pub snap: f64,
    /// How rims and caps are remeshed.
    pub rims: RimOptions,
    /// The loop must lie within this many radii of the opening's centre.
    pub reach: f64,
    /// Repair of the triangles at rim and cap.
    pub repair: angle_repair::RepairOptions,
}

impl Default for CutOptions {
    fn default() -> Self {
        CutOptions { snap: 0.3, rims: RimOptions::default(), reach: 3.0, repair: angle_repair::RepairOptions::default() }
    }
}

/// A planar end as it was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OpeningMeasure {
    /// Patch name.
    pub name: String,
    /// Patch number.
    pub id: u32,
    /// Inlet or outlet.
    pub kind: PatchKind,
    /// Centroid of the cap, mm.
    pub center: Point,
    /// Unit normal out of the vessel.
    pub normal: Vector,
    /// Area, mm².
    pub area: f64,
    /// Length of the rim, mm.
    pub perimeter: f64,
    /// 4 area / perimeter, mm.
    pub hydraulic_diameter: f64,
    /// Largest distance of a vertex of the cap from the plane, mm.
    pub planarity: f64,
    /// Triangles of the cap.
    pub faces: usize,
}

/// What the cuts did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct CutSummary {
    /// Vertices moved into a plane.
    pub snapped: usize,
    /// Edges divided by a plane.
    pub divided: usize,
    /// Triangles beyond the planes that were taken away.
    pub removed: usize,
    /// Remeshing of rims and caps.
    pub rims: Vec<RimSummary>,
    /// Places remeshed by themselves in the end, with what each attempt brought.
    pub last_resort: Vec<Rung>,
    /// Triangles of the wall that still had two edges on rims after all this, which prisms cannot grow from; opened.
    pub ears: usize,
}

/// Cuts one surface open, end by end; what is cut stays cut where a later end cannot be.
pub struct Cutter<'a> {
    sheet: sheet::Sheet,
    supports: Supports<'a>,
    size: &'a dyn SizeField,
    options: &'a CutOptions,
    openings: Vec<Opening>,
    summary: CutSummary,
}

impl<'a> Cutter<'a> {
    /// Begins with a closed surface.
    pub fn new(mesh: &TriMesh, wall: &'a dyn Implicit, size: &'a dyn SizeField, options: &'a CutOptions) -> Self {
        Cutter {
            sheet: sheet::Sheet::new(mesh),
            supports: Supports::new(wall),
            size,
            options,
            openings: Vec::new(),
            summary: CutSummary::default(),
        }
    }

    /// Cuts at the planes of `ends` and closes each hole by a cap. Only the branch at an end's centre is cut. Planes
    /// that open something only together, as two on a ring do, are given together; others one by one. The cost is
    /// that of what is cut, not of the whole surface.
    ///
    /// # Errors
    /// [`Error`] with coordinates where a plane misses the vessel, cuts a ring, would leave nothing, or has no simple
    /// section; the surface is then as before.
    pub fn open(&mut self, ends: &[Opening]) -> Result<(), Error> {
        let before = self.supports.clone();
        self.supports = ends.iter().fold(before.clone(), |s, o| s.with_plane(o.id, o.plane));
        let (reach, snap) = (self.options.reach, self.options.snap);
        let made = match self.sheet.open(ends, &self.supports, self.size, reach, snap) {
            // A snapped vertex can pinch the rim; without snapping it cannot.
            Err(Error::NotSimple { .. }) => self.sheet.open(ends, &self.supports, self.size, reach, 0.0),
            other => other,
        };
        match made {
            Ok(done) => {
                self.summary.snapped += done.snapped;
                self.summary.divided += done.divided;
                self.summary.removed += done.removed;
                self.openings.extend(ends.iter().cloned());
                Ok(())
            }
            Err(e) => {
                self.supports = before;
                Err(e)
            }
        }
    }

    /// The openings cut so far, by id.
    pub fn openings(&self) -> Vec<Opening> {
        let mut all = self.openings.clone();
        all.sort_by_key(|o| o.id);
        all
    }

    /// Remeshes and repairs rims and caps. The result is closed; each cap lies in its plane to rounding and has its
    /// opening's patch id. No triangle of the wall has two edges on rims,
    /// unless it is folded back on its neighbour. Where `stop` says so, triangles above the target may be left.
    pub fn finish(self, stop: &Stop) -> (TriMesh, Vec<OpeningMeasure>, CutSummary) {
        let openings = self.openings();
        let Cutter { sheet, supports, size, options, mut summary, .. } = self;
        let work = sheet.into_mesh();
        if openings.is_empty() {
            return (work, Vec::new(), summary);
        }
        let (mut work, rims, last_resort) = rims::remesh(&work, &supports, size, &options.rims, &options.repair, stop);
        summary.rims = rims;
        summary.last_resort = last_resort;
        summary.ears = ears::open(&mut work, &supports);
        let mut measures = Vec::with_capacity(openings.len());
        let mut faces = faces_by_patch(&work);
        for o in &openings {
            let own = faces.remove(&o.id).unwrap_or_default();
            for v in vertices(&work, &own) {
                work.points[v as usize] = o.plane.project(&work.points[v as usize]);
            }
            measures.push(measure_faces(&work, o, &own));
        }
        (work, measures, summary)
    }
}

/// Cuts `mesh` open at every plane of `openings`, caps the holes and repairs rims and caps: see [`Cutter`].
///
/// # Errors
/// As [`Cutter::open`]; the first end that cannot be cut. Planes on one ring are tried together.
pub fn cut(
    mesh: &TriMesh,
    wall: &dyn Implicit,
    size: &dyn SizeField,
    openings: &[Opening],
    options: &CutOptions,
) -> Result<(TriMesh, Vec<OpeningMeasure>, CutSummary), Error> {
    let mut cutter = Cutter::new(mesh, wall, size, options);
    cut_each(&mut cutter, openings, |_, e| Err(e))?;
    Ok(cutter.finish(&|| false))
}

/// Cuts at `openings` one by one, those on rings together at the end. `change` is asked what to do about one that
/// cannot be cut: another plane to try in its place, `None` to leave it closed, or an error to give up with.
///
/// # Errors
/// What `change` gives.
pub fn cut_each<E>(
    cutter: &mut Cutter,
    openings: &[Opening],
    mut change: impl FnMut(&Opening, Error) -> Result<Option<Opening>, E>,
) -> Result<(), E> {
    let mut on_rings: Vec<(Opening, Error)> = Vec::new();
    for o in openings {
        let mut end = o.clone();
        loop {
            match cutter.open(std::slice::from_ref(&end)) {
                Ok(()) => break,
                Err(e @ Error::Ring { .. }) => {
                    on_rings.push((end, e));
                    break;
                }
                Err(e) => match change(&end, e)? {
                    Some(other) => end = other,
                    None => break,
                },
            }
        }
    }
    // A plane on a ring separates nothing by itself: two on the same ring do.
    while let Some((first, error)) = on_rings.pop() {
        let partner = (0..on_rings.len()).rev().find(|&i| cutter.open(&[on_rings[i].0.clone(), first.clone()]).is_ok());
        match partner {
            Some(i) => {
                on_rings.remove(i);
            }
            None => {
                change(&first, error)?;
            }
        }
    }
    Ok(())
}

fn faces_by_patch(mesh: &TriMesh) -> std::collections::BTreeMap<u32, Vec<u32>> {
    let mut faces: std::collections::BTreeMap<u32, Vec<u32>> = Default::default();
    for (t, &id) in mesh.patch.iter().enumerate().filter(|(_, id)| **id != crate::mesh::WALL) {
        faces.entry(id).or_default().push(t as u32);
    }
    faces
}

fn vertices(mesh: &TriMesh, faces: &[u32]) -> Vec<u32> {
    let mut v: Vec<u32> = faces.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
    v.sort_unstable();
    v.dedup();
    v
}

/// Area, rim and planarity of an opening's cap.
pub fn measure(mesh: &TriMesh, o: &Opening) -> OpeningMeasure {
    let faces: Vec<u32> = (0..mesh.triangles.len() as u32).filter(|&t| mesh.patch[t as usize] == o.id).collect();
    measure_faces(mesh, o, &faces)
}

fn measure_faces(mesh: &TriMesh, o: &Opening, faces: &[u32]) -> OpeningMeasure {
    let mut area = 0.0;
    let mut moment = Vector::zeros();
    let mut edges: Vec<[u32; 2]> = Vec::new();
    for t in faces.iter().map(|&t| t as usize) {
        let [a, b, c] = mesh.corners(t);
        let part = 0.5 * mesh.area_vector2(t).norm();
        area += part;
        moment += part * ((a - o.plane.origin) + (b - o.plane.origin) + (c - o.plane.origin)) / 3.0;
        let ids = mesh.triangles[t];
        edges.extend((0..3).map(|i| [ids[i].min(ids[(i + 1) % 3]), ids[i].max(ids[(i + 1) % 3])]));
    }
    edges.sort_unstable();
    let rim = edges.chunk_by(|a, b| a == b).filter(|c| c.len() == 1);
    let perimeter: f64 = rim.map(|c| (mesh.points[c[0][0] as usize] - mesh.points[c[0][1] as usize]).norm()).sum();
    let planarity = vertices(mesh, faces).iter().map(|&v| o.plane.signed_distance(&mesh.points[v as usize]).abs()).fold(0.0, f64::max);
    OpeningMeasure {
        name: o.name.clone(),
        id: o.id,
        kind: o.kind,
        center: if area > 0.0 { o.plane.origin + moment / area } else { o.plane.origin },
        normal: o.plane.normal,
        area,
        perimeter,
        hydraulic_diameter: if perimeter > 0.0 { 4.0 * area / perimeter } else { 0.0 },
        planarity,
        faces: faces.len(),
    }
}
