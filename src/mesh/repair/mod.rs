//! Surfaces as people have them made fit to tell inside from outside.
//!
//! In order: points at one place are joined (those on open edges up to a hundred-thousandth of the surface's size apart); triangles with
//! two equal corners and second copies of triangles are dropped; neighbours are given one orientation, each shell's own majority
//! deciding; shells are turned outwards by their volume, a shell inside another keeps its orientation relative to that one, so that
//! cavities stay cavities. Edges of more than two triangles and triangles that cross stay: winding numbers
//! ([`super::winding`]) tell inside from outside all the same.

mod orient;
mod points;

use serde::Serialize;

use super::{TriMesh, intersect, rims, topology};
use crate::geometry::{Aabb, Point};

/// A kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// Points at one place that were joined.
    UnsharedPoints,
    /// Triangles with two equal corners, dropped.
    DegenerateTriangles,
    /// Further copies of a triangle, dropped.
    DuplicateTriangles,
    /// Triangles turned to agree with their neighbours.
    TurnedTriangles,
    /// Shells that were inside out and were turned as a whole.
    TurnedShells,
    /// Edges of more than two triangles; they stay.
    NonManifoldEdges,
    /// Pairs of triangles that cross; they stay.
    Crossings,
    /// Holes in the wall that were closed.
    Holes,
}

/// What was found of one kind of fault, and where.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Repair {
    /// The kind.
    pub fault: Fault,
    /// How many.
    pub count: usize,
    /// Where the first of them lie, mm; five at most.
    pub places: Vec<Point>,
}

/// Most places that a [`Repair`] names.
const PLACES: usize = 5;

impl Repair {
    /// What was found of a kind; `None` where there is none.
    pub fn of(fault: Fault, places: &[Point]) -> Option<Repair> {
        (!places.is_empty()).then(|| Repair { fault, count: places.len(), places: places.iter().take(PLACES).copied().collect() })
    }
}

impl std::fmt::Display for Repair {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let what = match self.fault {
            Fault::UnsharedPoints => "points lay at the place of another and were joined",
            Fault::DegenerateTriangles => "triangles had two equal corners and were dropped",
            Fault::DuplicateTriangles => "triangles were copies of others and were dropped",
            Fault::TurnedTriangles => "triangles were turned to agree with their neighbours",
            Fault::TurnedShells => "shells were inside out and were turned",
            Fault::NonManifoldEdges => "edges have more than two triangles; inside and outside are told by winding numbers there",
            Fault::Crossings => "pairs of triangles cross each other; inside and outside are told by winding numbers there",
            Fault::Holes => "holes in the wall were closed",
        };
        let p = self.places[0];
        let first = if self.count > 1 { "the first at " } else { "at " };
        write!(f, "{} {what} ({first}({:.4}, {:.4}, {:.4}) mm)", self.count, p.x, p.y, p.z)
    }
}

/// Why a surface cannot be repaired.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RepairError {
    /// There is no triangle with an area.
    #[error("the surface has no triangles with an area: check the file")]
    Empty,
    /// A coordinate is infinite or not a number.
    #[error("the surface has coordinates that are no finite numbers (point {0}): check the file")]
    NotFinite(usize),
}

/// A surface whose triangles agree, and what was done to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Repaired {
    /// The surface, without unused points.
    pub mesh: TriMesh,
    /// Connected pieces.
    pub shells: usize,
    /// What was found and done, a kind each.
    pub repairs: Vec<Repair>,
}

/// Repairs a surface. Vertices do not move; triangles are dropped and turned only.
///
/// # Errors
/// [`RepairError`] for a surface without triangles or with coordinates that are no numbers.
pub fn repair(mesh: &TriMesh) -> Result<Repaired, RepairError> {
    let used = mesh.triangles.iter().flatten().map(|&v| v as usize);
    if let Some(v) = used.clone().filter(|&v| !mesh.points[v].coords.iter().all(|c| c.is_finite())).min() {
        return Err(RepairError::NotFinite(v));
    }
    let size = Aabb::of(used.map(|v| &mesh.points[v])).diagonal();
    let (mut mesh, joined) = points::joined(mesh, points::TOLERANCE * size);
    let mut repairs = Vec::from_iter(Repair::of(Fault::UnsharedPoints, &joined));
    let middle = |m: &TriMesh, t: usize| {
        let [a, b, c] = m.corners(t);
        Point::from((a.coords + b.coords + c.coords) / 3.0)
    };

    let flat = |t: &[u32; 3]| t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
    let gone: Vec<bool> = mesh.triangles.iter().map(flat).collect();
    repairs.extend(drop_triangles(&mut mesh, &gone, Fault::DegenerateTriangles));
    let mut order: Vec<usize> = (0..mesh.triangles.len()).collect();
    let key = |t: usize| {
        let mut k = mesh.triangles[t];
        k.sort_unstable();
        k
    };
    order.sort_by_key(|&t| (key(t), t));
    let mut gone = vec![false; mesh.triangles.len()];
    order.chunk_by(|&a, &b| key(a) == key(b)).flat_map(|same| &same[1..]).for_each(|&t| gone[t] = true);
    repairs.extend(drop_triangles(&mut mesh, &gone, Fault::DuplicateTriangles));
    if mesh.triangles.is_empty() || mesh.area() == 0.0 {
        return Err(RepairError::Empty);
    }
    let mut mesh = points::used(&mesh);

    let oriented = orient::orient(&mut mesh);
    let places = |all: &[usize]| all.iter().map(|&t| middle(&mesh, t)).collect::<Vec<_>>();
    repairs.extend(Repair::of(Fault::TurnedTriangles, &places(&oriented.turned)));
    repairs.extend(Repair::of(Fault::TurnedShells, &places(&oriented.turned_shells)));
    let several: Vec<Point> = oriented.several.iter().map(|e| nalgebra::center(&mesh.points[e[0] as usize], &mesh.points[e[1] as usize])).collect();
    repairs.extend(Repair::of(Fault::NonManifoldEdges, &several));
    let crossings: Vec<usize> = intersect::self_intersections(&mesh).into_iter().map(|pair| pair.0 as usize).collect();
    repairs.extend(Repair::of(Fault::Crossings, &places(&crossings)));
    Ok(Repaired { shells: topology::triangle_components(&mesh).1, mesh, repairs })
}

fn drop_triangles(mesh: &mut TriMesh, gone: &[bool], fault: Fault) -> Option<Repair> {
    let places: Vec<Point> = (0..gone.len()).filter(|&t| gone[t]).map(|t| mesh.points[mesh.triangles[t][0] as usize]).collect();
    let kept = |t: &usize| !gone[*t];
    mesh.patch = (0..gone.len()).filter(kept).map(|t| mesh.patch[t]).collect();
    mesh.triangles = (0..gone.len()).filter(kept).map(|t| mesh.triangles[t]).collect();
    Repair::of(fault, &places)
}

/// The surface with a lid on every rim: what its volume and orientation are taken from.
fn closed(mesh: &TriMesh) -> TriMesh {
    let mut out = mesh.clone();
    for rim in rims::loops(mesh) {
        super::holes::close(&mut out, &rim);
    }
    out
}

#[cfg(test)]
mod tests;
