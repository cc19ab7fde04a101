//! Opens the ends of the remeshed surface, and says what became of ends that cannot be cut where they were found.

use std::collections::BTreeMap;

use super::error::Error;
use super::{Part, gates, options, remeshing, results, retry};
use crate::config::Case;
use crate::geometry::Point;
use crate::mask::Mask;
use crate::mesh::{TriMesh, intersect};
use crate::openings::{self, FoundBy, Opening};
use crate::remesh::{self, SizeField, Stop, Supports};
use crate::report::Report;

/// How often a found plane is moved inwards, each time by half a radius: two diameters would be another place.
const MOVES: usize = 4;

/// Part by which the number of triangles may differ from the one wished before the surface is made once more.
const COUNT: f64 = 0.03;

/// Cuts the ends open; gives the number of openings. `evidence` says whether the mask shows any end. `stop` is asked while surfaces are made.
pub(super) fn cut(case: &Case, mask: &Mask, parts: &mut [Part], evidence: bool, report: &mut Report, stop: &Stop) -> Result<usize, Error> {
    let diagonal = parts.iter().fold(crate::geometry::Aabb::EMPTY, |b, p| b.union(&p.surface.bounds())).diagonal();
    let mut measures = Vec::new();
    let mut off_implicit = 0.0f64;
    let mut retries = Vec::new();
    let mut left_closed = 0;
    for (n, part) in parts.iter_mut().enumerate() {
        let (mut mesh, mut made, mut tried) = make(case, part, stop)?;
        // One correction where the number of triangles is off; a surface that was made otherwise keeps its own.
        let off = part.target_faces.map_or(1.0, |wanted| mesh.triangles.len() as f64 / wanted);
        if (off - 1.0).abs() > COUNT && tried.is_empty() {
            let field = std::mem::replace(&mut part.size, Box::new(remesh::Uniform(1.0)));
            part.size = Box::new(remeshing::Rescaled { field, factor: off.sqrt() });
            part.surface = remeshing::triangles(case, case.surface.remesher, part, part.size.as_ref(), stop)?.mesh;
            report.put_in("remeshing", "recounted", &serde_json::json!({"component": n, "faces": mesh.triangles.len(), "factor": off.sqrt()}));
            (mesh, made, tried) = make(case, part, stop)?;
        }
        for note in made.notes {
            report.warn("openings", note);
        }
        if let Some(fraction) = made.front_fraction {
            report.put_in("surface", "front_fraction", &fraction);
        }
        if !tried.is_empty() {
            report.warn("surface", format!("component {n}: the surface missed a hard gate and was made {} times; see remeshing.retries", tried.len()));
            retries.push(serde_json::json!({"component": n, "attempts": tried}));
        }
        let shown = |o: &&Opening| matches!(o.found_by, FoundBy::FlatFace | FoundBy::ImageBorder | FoundBy::SurfaceRim);
        left_closed += part.openings.iter().filter(shown).filter(|o| made.openings.iter().all(|m| m.name != o.name)).count();
        take_over(part, made.openings);
        let supports = carriers(part);
        off_implicit = off_implicit.max(remesh::off_implicit(&mesh, &supports));
        if options::chord_correction(case) {
            let (corrected, summary) = remesh::chord::compensate(&mesh, &supports, options::skewness_targets(case));
            // Where two sheets nearly touch, they stay as they are.
            let touching = !intersect::self_intersections(&corrected).is_empty() && intersect::self_intersections(&mesh).is_empty();
            report.put_in("remeshing", "chord_correction", &serde_json::json!({"applied": !touching, "summary": summary}));
            if !touching {
                mesh = corrected;
            }
        }
        measures.extend(part.openings.iter().map(|o| openings::measure(&mesh, o)));
        part.surface = mesh;
        part.polygons = TriMesh::default();
        report.put_in("remeshing", "cuts", &made.summary);
    }
    let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    report.put_in("remeshing", "off_implicit", &serde_json::json!({"max": off_implicit, "max_voxels": off_implicit / voxel}));
    if !retries.is_empty() {
        report.put_in("remeshing", "retries", &retries);
    }
    measures.sort_by_key(|m| m.id);
    let found: Vec<Opening> = parts.iter().flat_map(|p| p.openings.iter().cloned()).collect();
    report.put("openings", &results::opening_rows(&measures, &found));
    let extensions = results::extension_rows(parts, &measures);
    if !extensions.is_empty() {
        report.put("extensions", &extensions);
    }
    let plain = |o: &&Opening| parts.iter().flat_map(|p| &p.extensions).all(|t| t.name() != o.name);
    let cut: Vec<Opening> = found.iter().filter(plain).cloned().collect();
    let voxel = mask.grid.spacing().into_iter().fold(0.0, f64::max);
    gates::openings(report, case, &gates::Ends { measures: &measures, cut: &cut, left_closed, evidence, diagonal, voxel });
    if found.is_empty() {
        report.warn("openings", "there is no opening: the vessel is closed on all sides; give planes under `openings:`");
    }
    Ok(found.len())
}

/// The surface of a part with its ends open, made in other ways where it misses a hard gate.
fn make(case: &Case, part: &Part, stop: &Stop) -> Result<(TriMesh, Opened, Vec<retry::Tried>), Error> {
    retry::surface(&part.polygons, case.surface.max_skewness, case.surface.remesher, stop, |attempt, places| {
        cut_part(case, part, attempt, places, stop)
    })
}

/// The ends of a part become those that were cut, where they were cut. Only ends without an extension move, so that
/// for them both lists have the same plane.
fn take_over(part: &mut Part, cut: Vec<Opening>) {
    part.ends.retain(|e| cut.iter().any(|o| o.name == e.name));
    for e in &mut part.ends {
        if let Some(o) = cut.iter().find(|o| o.name == e.name && part.extensions.iter().all(|x| x.name() != o.name)) {
            e.plane = o.plane;
        }
    }
    part.openings = cut;
}

/// The carriers of all patches of a component.
pub(super) fn carriers(part: &Part) -> Supports<'_> {
    part.openings.iter().fold(Supports::new(part.implicit.as_ref()), |s, o| s.with_plane(o.id, o.plane))
}

/// What cutting a component open gave.
struct Opened {
    openings: Vec<Opening>,
    summary: openings::CutSummary,
    front_fraction: Option<f64>,
    notes: Vec<String>,
}

/// Cuts a component open; remeshes it before where it is another attempt than the first.
fn cut_part(case: &Case, part: &Part, attempt: retry::Attempt, places: &[Point], stop: &Stop) -> Result<(TriMesh, Opened), Error> {
    if attempt == retry::Attempt::FIRST {
        return open(case, part, &part.surface, part.size.as_ref(), None, stop);
    }
    let everywhere = [part.polygons.bounds().center()];
    let near = places.iter().map(|p| part.size.size(p)).fold(0.0, f64::max);
    let size = remesh::size_field::Scaled {
        field: part.size.as_ref(),
        centers: if attempt.local { places } else { &everywhere },
        reach: if attempt.local { 6.0 * near } else { f64::INFINITY },
        factor: attempt.factor,
    };
    let made = remeshing::triangles(case, attempt.remesher(case.surface.remesher), part, &size, stop)?;
    open(case, part, &made.mesh, &size, made.front_fraction, stop)
}

fn open(case: &Case, part: &Part, mesh: &TriMesh, size: &dyn SizeField, front_fraction: Option<f64>, stop: &Stop) -> Result<(TriMesh, Opened), Error> {
    let options = options::cut(case);
    let mut cutter = openings::Cutter::new(mesh, part.implicit.as_ref(), size, &options);
    let mut notes = Vec::new();
    let mut moves: BTreeMap<String, usize> = BTreeMap::new();
    openings::cut_each(&mut cutter, &part.openings, |o, error| {
        let fixed = o.found_by == FoundBy::User || part.extensions.iter().any(|e| e.name() == o.name);
        let moved = moves.entry(o.name.clone()).or_default();
        let (other, note) = way_out(o, fixed, *moved, error)?;
        *moved += 1;
        notes.push(note);
        Ok::<_, openings::Error>(other)
    })?;
    let openings = cutter.openings();
    let (mesh, _, summary) = cutter.finish(stop);
    Ok((mesh, Opened { openings, summary, front_fraction, notes }))
}

/// What to do about an end that cannot be cut: one that was found is moved inwards, and after [`MOVES`] moves left
/// closed; one that was given, or carries an extension, is what the user wants and stays an error.
fn way_out(o: &Opening, fixed: bool, moved: usize, error: openings::Error) -> Result<(Option<Opening>, String), openings::Error> {
    if fixed {
        return Err(error);
    }
    if matches!(error, openings::Error::NotSimple { .. }) && moved < MOVES {
        let mut other = o.clone();
        other.plane.origin -= o.plane.normal * (0.5 * o.radius);
        return Ok((Some(other), format!("{error}; it was found, not given, and moved inwards by half a radius")));
    }
    Ok((None, format!("{error}; it was found, not given: that end stays closed")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Plane;
    use crate::mesh::PatchKind;

    fn end() -> Opening {
        let plane = Plane::new([1.0, 2.0, 3.0].into(), [0.0, 0.0, 1.0].into()).expect("a plane");
        Opening {
            id: 3,
            name: "outlet_1".into(),
            kind: PatchKind::Outlet,
            plane,
            radius: 2.0,
            support: openings::Support::round(&plane, 2.0),
            found_by: FoundBy::BluntEnd,
            confidence: 0.5,
            component: 0,
        }
    }

    fn not_simple() -> openings::Error {
        openings::Error::NotSimple { name: "outlet_1".into(), at: Point::origin() }
    }

    #[test]
    fn a_found_end_without_a_simple_section_moves_inwards_and_after_two_diameters_stays_closed() {
        let (moved, note) = way_out(&end(), false, 0, not_simple()).expect("a way out");
        let moved = moved.expect("another plane");
        assert_eq!(moved.plane.origin, Point::new(1.0, 2.0, 2.0));
        assert!(note.contains("moved inwards"), "{note}");
        let (closed, note) = way_out(&moved, false, MOVES, not_simple()).expect("a way out");
        assert!(closed.is_none() && note.contains("stays closed"), "{note}");
    }

    #[test]
    fn a_found_end_on_a_ring_stays_closed() {
        let ring = openings::Error::Ring { name: "outlet_1".into(), at: Point::origin() };
        assert!(way_out(&end(), false, 0, ring).expect("a way out").0.is_none());
    }

    #[test]
    fn a_given_plane_is_never_moved() {
        assert_eq!(way_out(&end(), true, 0, not_simple()), Err(not_simple()));
    }
}
