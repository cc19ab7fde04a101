//! Fills the surface. Where that fails, or cells miss a hard gate or the skewness aimed at, the wall is mended round the
//! places and filled once more; the better mesh is kept, and the report says what was done.

use serde::Serialize;

use super::cutting::carriers;
use super::{Clock, Error, Part, Sizes, creases, options, results};
use crate::config::Case;
use crate::geometry::Point;
use crate::mask::Mask;
use crate::mesh::{TriMesh, VolumeMesh};
use crate::quality::{self, VolumeQuality};
use crate::volume::creases::Crease;
use crate::volume::{self, BuildSummary};

/// A filled surface.
pub(super) struct Filled {
    pub cells: VolumeMesh,
    pub built: BuildSummary,
    pub quality: VolumeQuality,
    /// What was done to the wall in between, where the first mesh missed something.
    pub mended: Option<Mended>,
}

/// What was done to the wall since its first mesh failed or missed something.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Mended {
    /// Why.
    pub why: String,
    /// Where the fault was, mm; of a failed filling, where it may be.
    pub places: Vec<Point>,
    /// What was changed.
    pub changes: Vec<Crease>,
    /// Whether the mesh on the changed wall was the better one and is the one delivered.
    pub kept: bool,
}

/// Fills the surface of all components; `parts` have the surface that was filled then.
pub(super) fn fill(case: &Case, mask: &Mask, parts: &mut [Part], clock: &mut Clock) -> Result<Filled, Error> {
    let first = once(case, mask, parts, clock);
    let (why, places) = match &first {
        Ok(filled) => missed(case, &filled.quality),
        Err(Error::Volume(e @ volume::Error::TetGen { places, .. })) => (e.to_string(), places.clone()),
        Err(_) => return first,
    };
    if places.is_empty() {
        return first;
    }
    let explain = |text: String| clock.context.progress.explain(&text);
    let at = places[0];
    let before: Vec<TriMesh> = parts.iter().map(|p| p.surface.clone()).collect();
    let changes = mend(case, mask, parts, &places);
    explain(format!(
        "the volume mesh is not as it should be, first near ({:.2}, {:.2}, {:.2}) mm: {why}; the wall there was mended in {} places{}",
        at.x, at.y, at.z, changes.len(),
        if changes.is_empty() { "" } else { " and is filled once more" }
    ));
    let mut mended = Mended { why, places, changes, kept: false };
    if mended.changes.is_empty() {
        return first.map(|f| Filled { mended: Some(mended), ..f });
    }
    let second = once(case, mask, parts, clock);
    mended.kept = match (&first, &second) {
        (_, Err(Error::Interrupted | Error::Volume(volume::Error::Cancelled))) => return second,
        (Ok(a), Ok(b)) => badness(case, &b.quality) < badness(case, &a.quality),
        (Err(_), Ok(_)) => true,
        (_, Err(_)) => false,
    };
    if mended.kept {
        return second.map(|f| Filled { mended: Some(mended), ..f });
    }
    parts.iter_mut().zip(before).for_each(|(part, surface)| part.surface = surface);
    match (first, second) {
        // Both ladders stand in the error.
        (
            Err(Error::Volume(volume::Error::TetGen { mut attempts, triangles, places })),
            Err(Error::Volume(volume::Error::TetGen { attempts: more, .. })),
        ) => {
            attempts.extend(more);
            Err(volume::Error::TetGen { attempts, triangles, places }.into())
        }
        (first, _) => first.map(|f| Filled { mended: Some(mended), ..f }),
    }
}

fn once(case: &Case, mask: &Mask, parts: &[Part], clock: &mut Clock) -> Result<Filled, Error> {
    let context = clock.context;
    let surface = results::joined_surface(parts);
    let sizes = Sizes(parts);
    let (cells, built) = clock.run(
        "volume",
        || {
            let [x, y, z] = mask.grid.spacing();
            let options = options::volume(case, &context.worker, x.min(y).min(z));
            let expect = |cells: u64| context.progress.explain(&format!("about {cells} tetrahedra are to be expected"));
            volume::build_watched(&surface, &sizes, &options, Some(context.cancel), &expect)
        },
        |(v, _)| format!("{} tetrahedra, {} prisms", v.tets.len(), v.prisms.len()),
    )?;
    let quality = clock.run(
        "volume quality",
        || quality::volume(&cells, &Default::default()),
        |q| format!("S_V max {:.3}, mean {:.3}", q.sv_max, q.sv_mean),
    )?;
    Ok(Filled { cells, built, quality, mended: None })
}

/// Mends the wall of all components round the places; gives what was changed.
fn mend(case: &Case, mask: &Mask, parts: &mut [Part], places: &[Point]) -> Vec<Crease> {
    let options = creases::options(case, mask);
    let mut all = Vec::new();
    for part in parts {
        let Some((mesh, changes)) = volume::creases::mend(&part.surface, &carriers(part), &options, places) else { continue };
        part.surface = mesh;
        all.extend(changes);
    }
    all
}

/// Each measure that a mesh misses, by name, and where its worst cells are.
fn faults(case: &Case, q: &VolumeQuality) -> Vec<(String, Vec<Point>)> {
    let (g, f) = (&case.gates, &q.openfoam);
    let aim = if q.prisms > 0 { 0.85 } else { 0.80 };
    let over = |limit: f64| q.equi_volume.worst.iter().filter(|w| w.value > limit).map(|w| w.center).collect::<Vec<_>>();
    let mut all = Vec::new();
    if q.sv_max > aim {
        all.push((format!("equi-volume skewness {:.3}", q.sv_max), over(aim)));
    }
    if f.non_orthogonality_max > g.max_non_orthogonality {
        let at = f.worst_non_orthogonality.iter().filter(|w| w.value > g.max_non_orthogonality).map(|w| w.center);
        all.push((format!("non-orthogonality {:.1} degrees", f.non_orthogonality_max), at.collect()));
    }
    if f.skewness_max >= g.max_openfoam_skewness {
        let at = f.worst_skewness.iter().filter(|w| w.value >= g.max_openfoam_skewness).map(|w| w.center);
        all.push((format!("OpenFOAM's skewness {:.2}", f.skewness_max), at.collect()));
    }
    if f.determinant_min < g.min_determinant {
        let at = f.worst_determinant.iter().filter(|w| w.value < g.min_determinant).map(|w| w.center);
        all.push((format!("determinant {:.5}", f.determinant_min), at.collect()));
    }
    all
}

fn missed(case: &Case, q: &VolumeQuality) -> (String, Vec<Point>) {
    let all = faults(case, q);
    (all.iter().map(|f| f.0.as_str()).collect::<Vec<_>>().join(", "), all.iter().flat_map(|f| f.1.iter().copied()).collect())
}

/// Less is better: hard gates missed, other figures missed, skewness.
fn badness(case: &Case, q: &VolumeQuality) -> (usize, usize, f64) {
    let all = faults(case, q).len();
    let soft = usize::from(q.sv_max > if q.prisms > 0 { 0.85 } else { 0.80 } && q.sv_max < case.gates.max_volume_skewness);
    (all - soft, soft, q.sv_max)
}
