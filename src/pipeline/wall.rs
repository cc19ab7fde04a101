//! A component's wall, polygonized, with the mask's topology: what is done, in turn, where the fit's surface has another.

use super::{Clock, Error, Source, options, reconstruct};
use crate::config::Case;
use crate::implicit::Implicit;
use crate::implicit::guard::{GuardOptions, Guarded, MaskBoundary};
use crate::mask::{Mask, Topology};
use crate::mesh::{self, TriMesh};
use crate::polygonize::{self, PolygonizeOptions, PolygonizeSummary};
use crate::report::Report;

/// Factors on the polygonizer's cells, where the narrowest guard still leaves another topology than the mask's: two sheets
/// nearer than a cell are one where no corner of the lattice lies between them.
const FINER: [f64; 2] = [0.7, 0.5];

/// Voxels round what the guard changes that it acts in too; the second where the first leave another topology.
const ROOM: [i64; 2] = [1, 3];

/// A component's wall and its polygons.
pub(super) struct Polygonized {
    pub implicit: Box<dyn Implicit>,
    /// Whether the mask is noisy.
    pub noisy: bool,
    pub polygons: TriMesh,
    pub summary: PolygonizeSummary,
    /// How they were made.
    pub options: PolygonizeOptions,
}

/// The wall of `mask`, with the topology `wanted` as far as the fit kept strictly, ever narrower guards and finer cells bring
/// it there. What was done stands in the report; where all of it fails a gate tells.
pub(super) fn polygonized(case: &Case, source: &Source, clock: &mut Clock, report: &mut Report, mask: &Mask, wanted: &Topology) -> Result<Polygonized, Error> {
    let context = clock.context;
    let mut options = options::polygonizer(case);
    let described = |p: &(TriMesh, PolygonizeSummary)| format!("{} triangles", p.0.triangles.len());
    let reconstruct::Wall { mut implicit, noisy } = clock.run("reconstruct", || reconstruct::reconstruct(case, source, mask, report), |_| String::new())?;
    let (mut polygons, mut summary) = clock.run("polygonize", || polygonize::polygonize(implicit.as_ref(), mask, &options), described)?;
    let as_wanted = |surface: &TriMesh| {
        let topology = mesh::topology::check(surface);
        (topology.euler, topology.components) == (2 * wanted.euler, wanted.components)
    };
    let unlike = |surface: &TriMesh| {
        let (found, twice) = (mesh::topology::check(surface), 2 * wanted.euler);
        format!("the surface has another topology than the mask (Euler number {} instead of {twice}, {} parts instead of {})", found.euler, found.components, wanted.components)
    };
    // On a noisy mask the fit gives up labels, which can go too far.
    if !as_wanted(&polygons)
        && let Some(f) = clock.run("reconstruct", || reconstruct::strictly(case, source, mask, report), |_| String::new())?
    {
        context.progress.explain(&format!("{}: every label that it might need is kept", unlike(&polygons)));
        implicit = f;
        (polygons, summary) = clock.run("polygonize", || polygonize::polygonize(implicit.as_ref(), mask, &options), described)?;
    }
    // The guard costs smoothness where it acts: it is taken where the fit alone has another topology than the mask, and
    // drawn narrower where its band still lets sheets meet. It stays where it mends the topology alone.
    let mut guards = GuardOptions::default().narrower().peekable();
    if options::guarded(case, source) {
        guards.next();
    }
    let alone = if as_wanted(&polygons) { TriMesh::default() } else { polygons.clone() };
    while let Some(guard) = guards.next_if(|_| !as_wanted(&polygons)) {
        context.progress.explain(&format!("{}: it is held within {:.2} voxel diagonals of the mask's boundary", unlike(&polygons), guard.band));
        let boundary = MaskBoundary::new(mask, &guard).ok_or(Error::EmptyComponent)?;
        let mut guarded = Guarded::new(implicit, boundary);
        (polygons, summary) = clock.run("polygonize", || polygonize::polygonize(&guarded, mask, &options), described)?;
        report.put_in("reconstruction", "guarded", &true);
        report.put_in("reconstruction", "guard", &guard);
        if !as_wanted(&polygons) {
            // A narrower one is laid on the fit itself.
            implicit = if guards.peek().is_some() { guarded.into_inner() } else { Box::new(guarded) };
            continue;
        }
        for grow in ROOM {
            let places = polygonize::differences(&alone, &polygons, &mask.grid, grow);
            let (mending, idle): (Vec<_>, Vec<_>) = places.into_iter().partition(|d| d.euler != 0);
            guarded = guarded.only_in(mending.iter().flat_map(|d| &d.voxels));
            let local = clock.run("polygonize", || polygonize::polygonize(&guarded, mask, &options), described)?;
            if as_wanted(&local.0) {
                context.progress.explain(&format!("it is held there in {} places alone; in {} others the fit is as good without", mending.len(), idle.len()));
                report.put_in("reconstruction", "guarded_places", &mending.len());
                (polygons, summary) = local;
                break;
            }
            guarded = guarded.everywhere();
        }
        implicit = Box::new(guarded);
    }
    for factor in FINER {
        if as_wanted(&polygons) {
            break;
        }
        let finer = PolygonizeOptions { cell: factor * options::polygonizer(case).cell, ..options };
        context.progress.explain(&format!("{}: it is polygonized with cells of {:.2} voxels", unlike(&polygons), finer.cell));
        (polygons, summary) = clock.run("polygonize", || polygonize::polygonize(implicit.as_ref(), mask, &finer), described)?;
        report.put_in("reconstruction", "finer_cells", &finer.cell);
        options = finer;
    }
    Ok(Polygonized { implicit, noisy, polygons, summary, options })
}
