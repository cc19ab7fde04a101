//! The stages in order, as in the paper's Figure 2; progress, timing, cancellation.

mod creases;
mod cutting;
mod error;
mod explain;
mod filling;
mod gates;
mod input;
mod naming;
mod noise;
mod options;
mod reconstruct;
mod remeshing;
mod results;
mod retry;
mod series;
mod surface;
mod surface_ends;
mod survey;
mod wall;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

pub use error::{Error, ErrorKind};
use input::Source;
pub use results::write;
pub use series::run_and_write;
pub use survey::Survey;

use crate::centerline::{self, Centerlines};
use crate::config::{Case, Detect};
use crate::geometry::Point;
use crate::implicit::{self, Implicit};
use crate::mask::{self, Mask};
use crate::mesh::{self, TriMesh, VolumeMesh};
use crate::openings::{self, DetectReport, Evidence, Opening};
use crate::polygonize;
use crate::quality;
use crate::remesh::{self, SizeField};
use crate::report::{Report, StageTime};

/// How far a run goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// The cleaned mask.
    Mask,
    /// The polygonized implicit surface.
    Reconstruction,
    /// The remeshed surface with its openings.
    Surface,
    /// The volume mesh.
    Volume,
    /// The solver cases.
    Exports,
}

/// Watches a run.
pub trait Progress: Sync {
    /// A stage begins.
    fn begin(&self, stage: &str);
    /// A stage has ended; `result` says what it made.
    fn end(&self, stage: &str, seconds: f64, result: &str);
    /// A decision and its reason.
    fn explain(&self, text: &str);
}

/// Watches nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str) {}
    fn end(&self, _: &str, _: f64, _: &str) {}
    fn explain(&self, _: &str) {}
}

/// What a run needs besides its case.
pub struct Context<'a> {
    /// How far to go.
    pub stop_after: Stage,
    /// Who watches.
    pub progress: &'a dyn Progress,
    /// Becomes true when the run should stop.
    pub cancel: &'a AtomicBool,
    /// The program that serves as worker of the volume engine.
    pub worker: PathBuf,
}

impl<'a> Context<'a> {
    /// Whether the run should stop, to be asked during long work.
    fn stop(&self) -> impl Fn() -> bool + Sync + use<'a> {
        let cancel = self.cancel;
        move || cancel.load(Ordering::Relaxed)
    }
}

/// One connected component as reconstructed, before its ends are known.
struct Draft {
    /// The component, cropped, carried on where it leaves the image, noise taken off.
    mask: Mask,
    /// What its boundary says of where the vessel ends.
    evidence: Evidence,
    /// Voxels of it that were relabelled as noise.
    relabelled: Vec<noise::Relabelled>,
    /// Its wall.
    implicit: Box<dyn Implicit>,
    /// Its polygonized wall.
    polygons: TriMesh,
    /// How it was polygonized.
    polygonizer: polygonize::PolygonizeOptions,
    /// Its centerlines.
    centerlines: Centerlines,
}

/// One connected component on its way from mask to surface.
pub struct Part {
    /// Its wall, extensions included.
    pub implicit: Box<dyn Implicit>,
    /// Its centerlines as traced in the mask.
    pub traced: Centerlines,
    /// Its centerlines, along the extensions too.
    pub centerlines: Centerlines,
    /// Its guidance field.
    pub size: Box<dyn SizeField>,
    /// The polygonized implicit.
    pub polygons: TriMesh,
    /// What the guidance field wishes on the whole.
    pub guidance: remesh::size_field::Summary,
    /// Triangles that it shall have, where the case says so.
    pub target_faces: Option<f64>,
    /// Its surface.
    pub surface: TriMesh,
    /// Its openings in the mask.
    pub ends: Vec<Opening>,
    /// Its openings where they are cut: at the ends of the extensions.
    pub openings: Vec<Opening>,
    /// Its extensions.
    pub extensions: Vec<openings::Tube>,
}

/// The wished edge length where several components are.
struct Sizes<'a>(&'a [Part]);

impl SizeField for Sizes<'_> {
    fn size(&self, p: &Point) -> f64 {
        let near = self.0.iter().min_by(|a, b| {
            a.implicit.bounds().squared_distance(p).total_cmp(&b.implicit.bounds().squared_distance(p))
        });
        near.map_or(f64::INFINITY, |part| part.size.size(p))
    }
}

/// What a run made.
pub struct Outcome {
    /// The report, without the gates of files.
    pub report: Report,
    /// The cleaned mask.
    pub mask: Mask,
    /// The surface of all components.
    pub surface: Option<TriMesh>,
    /// Signed distance of each vertex to the mask's marching cubes surface, mm.
    pub deviation: Vec<f64>,
    /// Gaussian curvature at each vertex, 1/mm².
    pub curvature: Vec<f64>,
    /// Equi-angle skewness of each triangle.
    pub surface_skewness: Vec<f64>,
    /// Skewness of each cell, tetrahedra first.
    pub cell_skewness: Vec<f64>,
    /// Thickness of the prism layers at each vertex of the surface, mm, as made and as wished; empty without layers.
    pub layer_thickness: (Vec<f64>, Vec<f64>),
    /// Centerlines of all components.
    pub centerlines: Centerlines,
    /// Openings of all components.
    pub openings: Vec<Opening>,
    /// The volume mesh.
    pub volume: Option<VolumeMesh>,
}

/// Times stages and looks for cancellation between them.
struct Clock<'a> {
    context: &'a Context<'a>,
    stages: Vec<StageTime>,
}

impl Clock<'_> {
    fn run<T, E>(&mut self, name: &str, work: impl FnOnce() -> Result<T, E>, result: impl FnOnce(&T) -> String) -> Result<T, Error>
    where
        Error: From<E>,
    {
        if self.context.cancel.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        self.context.progress.begin(name);
        let start = Instant::now();
        let value = work()?;
        let seconds = start.elapsed().as_secs_f64();
        self.context.progress.end(name, seconds, &result(&value));
        match self.stages.iter_mut().find(|s| s.name == name) {
            Some(s) => s.seconds += seconds,
            None => self.stages.push(StageTime { name: name.into(), seconds }),
        }
        Ok(value)
    }
}

/// Takes a case from its mask as far as `context.stop_after` says.
///
/// # Errors
/// [`Error`] names the stage, the element and the way out. A missed gate is no error: it stands in the report.
pub fn run(case: &Case, context: &Context) -> Result<Outcome, Error> {
    let mut clock = Clock { context, stages: Vec::new() };
    let mut report = Report::default();
    if context.stop_after >= Stage::Exports {
        // A fault in what only the last stage needs shows before hours of meshing.
        results::flow_options(case)?;
    }

    let (raw, source) = clock.run("read", || input::read(case, &mut report), |(m, _)| format!("{} lumen voxels", m.count()))?;
    let (cleaned, cleaning) =
        clock.run("clean", || mask::clean(&raw, &options::cleaning(case)), |(m, _)| format!("{} lumen voxels", m.count()))?;
    input::thick_enough(&cleaned)?;
    drop(raw);
    explain::cleaning(&cleaning).iter().for_each(|line| context.progress.explain(line));
    report.put("cleaning", &cleaning);
    explain::large_islands(&cleaning, cleaned.count()).into_iter().for_each(|w| report.warn("clean", w));
    let mut outcome = Outcome {
        report,
        mask: cleaned,
        surface: None,
        deviation: Vec::new(),
        curvature: Vec::new(),
        surface_skewness: Vec::new(),
        cell_skewness: Vec::new(),
        layer_thickness: Default::default(),
        centerlines: Centerlines::default(),
        openings: Vec::new(),
        volume: None,
    };
    if context.stop_after > Stage::Mask {
        surface_stages(case, &source, &mut clock, &mut outcome)?;
    }
    if context.stop_after < Stage::Surface {
        outcome.report.without_gates();
    }
    outcome.report.run.stages = clock.stages;
    Ok(outcome)
}

/// Looks at a case without meshing it: sizes, ends, and places that deserve a look.
///
/// # Errors
/// As [`run`].
pub fn survey(case: &Case, context: &Context) -> Result<Survey, Error> {
    let context = Context { stop_after: Stage::Reconstruction, worker: context.worker.clone(), ..*context };
    let mut clock = Clock { context: &context, stages: Vec::new() };
    let mut report = Report::default();
    let (raw, source) = clock.run("read", || input::read(case, &mut report), |(m, _)| format!("{} lumen voxels", m.count()))?;
    let (mut mask, cleaning) =
        clock.run("clean", || mask::clean(&raw, &options::cleaning(case)), |(m, _)| format!("{} lumen voxels", m.count()))?;
    input::thick_enough(&mask)?;
    drop(raw);
    let mut drafts = Vec::new();
    for component in mask::split_components(&mask) {
        drafts.push(draft(case, &source, &mut clock, &mut report, component)?);
    }
    drafts.iter().for_each(|d| noise::carry_over(&mut mask, &d.relabelled));
    let lines = results::joined_centerlines(drafts.iter().map(|d| &d.centerlines));
    let found = clock.run("ends", || ends(case, &source, &mask, &lines, &drafts, &mut report), |(o, _)| format!("{} openings", o.len()))?;
    let mut parts = Vec::new();
    let shares = shares(&drafts);
    for (draft, share) in drafts.into_iter().zip(shares) {
        parts.push(part(case, &mut clock, &mut report, draft, Vec::new(), share)?);
    }
    Ok(Survey::new(mask, cleaning, lines, &parts, found, report))
}

/// From the cleaned mask to the patched surface, each component by itself.
fn surface_stages(case: &Case, source: &Source, clock: &mut Clock, outcome: &mut Outcome) -> Result<(), Error> {
    let voxel_diagonal = outcome.mask.grid.voxel_diagonal();
    let context = clock.context;
    let mut drafts = Vec::new();
    for component in mask::split_components(&outcome.mask) {
        drafts.push(draft(case, source, clock, &mut outcome.report, component)?);
    }
    drafts.iter().for_each(|d| noise::carry_over(&mut outcome.mask, &d.relabelled));
    let topology = mask::topology(&outcome.mask);
    let traced = results::joined_centerlines(drafts.iter().map(|d| &d.centerlines));
    let (found, detected) = if context.stop_after >= Stage::Surface {
        clock.run("ends", || ends(case, source, &outcome.mask, &traced, &drafts, &mut outcome.report), |(o, d)| explain::ends(o, &d.blind))?
    } else {
        Default::default()
    };
    // Who turns detection off, or drops ends, has decided; a sphere has none.
    let decided = case.openings.detect == Detect::Off || !case.openings.drop.is_empty();
    let shown = !decided && (!found.is_empty() || detected.blind.iter().any(|b| b.reason.is_of_a_vessel()));
    let evidence: Vec<Evidence> = drafts.iter().map(|d| d.evidence.clone()).collect();
    let mut parts = Vec::new();
    let shares = shares(&drafts);
    for (n, (draft, share)) in drafts.into_iter().zip(shares).enumerate() {
        let own = found.iter().filter(|o| o.component as usize == n).cloned().collect();
        parts.push(part(case, clock, &mut outcome.report, draft, own, share)?);
    }
    if context.stop_after >= Stage::Surface {
        clock.run("openings", || cutting::cut(case, &outcome.mask, &mut parts, shown, &mut outcome.report, &context.stop()), |n| format!("{n} openings"))?;
        creases::soften(case, &outcome.mask, &mut parts, &mut outcome.report, context);
    }
    // Before the surface is measured: where it cannot be filled well it is mended.
    let filled = match context.stop_after >= Stage::Volume {
        true => Some(filling::fill(case, &outcome.mask, &mut parts, clock)?),
        false => None,
    };
    outcome.openings = parts.iter().flat_map(|p| p.openings.iter().cloned()).collect();
    outcome.openings.iter().for_each(|o| context.progress.explain(&explain::opening(o)));
    outcome.centerlines = results::joined_centerlines(parts.iter().map(|p| &p.centerlines));
    let surface = results::joined_surface(&parts);

    let quality = clock.run("quality", || Ok::<_, Error>(quality::surface(&surface, &options::surface_quality(case))), |q| format!("S max {:.3}, mean {:.3}", q.s_max, q.s_mean))?;
    let combinatorial = mesh::topology::check(&surface);
    let crossings = mesh::intersect::self_intersections(&surface);
    outcome.report.put("surface", &quality);
    outcome.report.put_in("surface", "worst", &results::worst_triangles(&quality.worst, &surface, &parts, case.surface.target_skewness));
    outcome.report.put_in("surface", "topology", &combinatorial);
    outcome.report.put_in("surface", "self_intersections", &crossings.len());
    gates::surface(&mut outcome.report, case, &combinatorial, crossings.len(), &quality, &topology);

    // Extensions have no counterpart in the mask: they are left out of what is held against it.
    let cuts: Vec<_> = parts.iter().flat_map(|p| &p.ends).map(quality::fidelity::Cut::from).collect();
    let mut fidelity = clock.run(
        "fidelity",
        || {
            // A wall that was not cut goes on through the padding; so must the mask that it is held against.
            let padded = cuts.is_empty().then(|| Evidence::all_carried_on(evidence.iter(), &outcome.mask, 4, PAD));
            let reference = quality::fidelity::Reference::new(padded.as_ref().unwrap_or(&outcome.mask))?;
            let vessel = results::without_extensions(&surface, &parts);
            let mut measured = quality::fidelity::measure(&vessel, &reference, &cuts, &Default::default())?;
            results::leave_out_extensions(&mut measured, &surface, &parts);
            let radii = quality::fidelity::radii(&traced, &surface, &reference);
            Ok::<_, Error>((measured, radii))
        },
        |(f, _)| format!("deviation median {:.3}, max {:.3} voxel diagonals", f.to_marching_cubes.voxel_diagonals.median, f.to_marching_cubes.voxel_diagonals.max),
    )?;
    let lost = quality::fidelity::lost(&surface_ends::within(source, results::inside_picture(&traced, &outcome.mask)), &surface, &cuts, voxel_diagonal);
    let to_given = match source {
        Source::Surface(given) => Some(surface_ends::fidelity(given, &surface, &parts, &cuts)?),
        _ => None,
    };
    // Voxels that stand for a surface count its volume less well than the surface itself.
    if let Some(ratio) = to_given.as_ref().and_then(|t| t.volume_ratio) {
        fidelity.0.volume_ratio = ratio;
    }
    outcome.report.put("fidelity", &fidelity.0);
    outcome.report.put_in("fidelity", "topology", &serde_json::json!({"mask": topology, "surface": combinatorial}));
    outcome.report.put_in("fidelity", "lost", &lost.parts);
    outcome.report.put_in("fidelity", "radius", &fidelity.1);
    if let Some(measured) = &to_given {
        outcome.report.put_in("fidelity", "to_input_surface", measured);
    }
    gates::fidelity(&mut outcome.report, case, &fidelity.0, &lost);
    let wall: f64 = (0..surface.triangles.len()).filter(|&t| surface.patch[t] == mesh::WALL).map(|t| 0.5 * surface.area_vector2(t).norm()).sum();
    // A wall that was moved on purpose is off by that.
    let moved = case.reconstruction.offset.map_or(0.0, f64::abs) * voxel_diagonal;
    let slight = 0.15 * outcome.mask.grid.voxel_volume().cbrt();
    gates::volume_ratio(&mut outcome.report, fidelity.0.volume_ratio, (slight + 1.5 * moved) * wall / fidelity.0.kept_mask_volume.max(1e-12));
    outcome.deviation = fidelity.0.deviation.iter().map(|d| d / voxel_diagonal).collect();
    outcome.curvature = results::gaussian_curvature(&parts);
    outcome.surface_skewness = quality.per_triangle;

    // A copy with the wall's named parts; everything up to the files goes by one wall.
    let mut named = surface.clone();
    if context.stop_after >= Stage::Surface {
        for (name, region) in options::wall_patches(case) {
            mesh::regions::mark(&mut named, name, &region)?;
        }
    }
    if let Some(filling::Filled { mut cells, built, quality: measured, mended }) = filled {
        for w in built.layers.iter().flat_map(|l| &l.warnings) {
            outcome.report.warn("boundary layers", w.clone());
        }
        if let Some(m) = &mended {
            let kept = if m.kept { "and filled once more" } else { "without the mesh becoming better: it stays as it was" };
            outcome.report.warn("volume", format!("{}; the wall was mended in {} places {kept}, see volume.mended", m.why, m.changes.len()));
            outcome.report.put_in("volume", "mended", m);
        }
        outcome.report.put("volume", &measured);
        results::contract_keys(&mut outcome.report, &measured);
        outcome.report.put_in("volume", "build", &built);
        outcome.layer_thickness = (built.thickness, built.wished_thickness);
        let faults = results::boundary_faces_unlike(&surface, &cells);
        gates::volume(&mut outcome.report, case, &measured, faults);
        outcome.cell_skewness = measured.per_cell;
        if !case.surface.patches.is_empty() {
            mesh::regions::carry_over(&named, &mut cells);
        }
        outcome.volume = Some(cells);
    }
    outcome.surface = Some(named);
    Ok(())
}

/// One component: implicit, polygons, centerlines.
fn draft(case: &Case, source: &Source, clock: &mut Clock, report: &mut Report, component: Mask) -> Result<Draft, Error> {
    let look = || {
        let mut evidence = Evidence::of(&component);
        // What was added to a surface ends flat too.
        evidence.faces.retain(|f| surface_ends::is_given(source, &(f.plane.origin - f.plane.normal * f.voxel)));
        Ok::<_, Error>(evidence)
    };
    let evidence = clock.run("evidence", look, |e| format!("{} flat faces, {} border regions", e.faces.len(), e.regions.len()))?;
    let (mask, quieted) = noise::padded(&component, &evidence, PAD);
    let wanted = mask::topology(&mask);
    let wall::Polygonized { implicit, noisy, polygons, summary, options: polygonizer } = wall::polygonized(case, source, clock, report, &mask, &wanted)?;
    report.put_in("reconstruction", "polygonizer", &summary);
    let (mask, mut relabelled) = if noisy { noise::relabel(mask, implicit.as_ref(), &wanted) } else { (mask, Vec::new()) };
    // The later label counts: what was flipped at the border may have been flipped back.
    relabelled.splice(..0, quieted);
    if noisy {
        report.put_in("reconstruction", "passed_over", &noise::entry(&relabelled));
    }
    let offset = summary.level;
    let implicit: Box<dyn Implicit> = if offset == 0.0 { implicit } else { Box::new(implicit::offset::Offset::new(implicit, offset)) };
    let centerlines = clock.run(
        "centerlines",
        || {
            let (mut lines, summary) = centerline::trace(&mask, &Default::default())?;
            centerline::refine(&mut lines, implicit.as_ref());
            report.put("centerlines", &summary);
            Ok::<_, Error>(lines)
        },
        |c| format!("{} branches", c.branches.len()),
    )?;
    Ok(Draft { mask, evidence, relabelled, implicit, polygons, polygonizer, centerlines })
}

/// Part of the whole surface that each component has: polygons are of one size.
fn shares(drafts: &[Draft]) -> Vec<f64> {
    let all: usize = drafts.iter().map(|d| d.polygons.triangles.len()).sum();
    drafts.iter().map(|d| d.polygons.triangles.len() as f64 / all.max(1) as f64).collect()
}

/// One component with its ends known: extensions, sizes, triangles.
/// `share` is its part of the whole surface, of which `target_faces` speaks.
fn part(case: &Case, clock: &mut Clock, report: &mut Report, draft: Draft, ends: Vec<Opening>, share: f64) -> Result<Part, Error> {
    let context = clock.context;
    let Draft { mask, mut implicit, mut polygons, polygonizer, centerlines: traced, .. } = draft;
    let mut centerlines = traced.clone();
    let (mut openings, mut extensions) = (ends.clone(), Vec::new());
    let mut wanted = options::extensions(case, &mask, implicit.as_ref(), &traced, &ends)?;
    let (clear, shortened) = loop {
        match openings::clear_extensions(implicit.as_ref(), &mask, &ends, &wanted) {
            // Asked for by name, it is refused; of those wished for everywhere, one without room is left out.
            Err(openings::ExtendError::Collides { name, at, distance }) if !case.extensions.openings.contains_key(&name) => {
                report.warn(
                    "extensions",
                    format!("`{name}` has no extension: it would run into another vessel {distance:.2} mm from its start, at {at:.3?} (LPS mm), and be shorter than {:.0} % of its length; a direction of its own would clear it", 100.0 * openings::LEAST_LEFT),
                );
                wanted.retain(|e| e.opening != name);
            }
            other => break other?,
        }
    };
    if !clear.is_empty() {
        for (n, distance) in shortened {
            let (name, length, wished) = (&wanted[n].opening, clear[n].length, wanted[n].length);
            report.warn(
                "extensions",
                format!("the extension of `{name}` is {length:.2} mm long instead of {wished:.2} mm: it would run into another vessel {distance:.2} mm from its start; a direction of its own would clear it"),
            );
        }
        let extend = || -> Result<_, Error> {
            let (extended, moved) = openings::Extended::new(implicit, &mask, &ends, &clear)?;
            let level = polygonize::PolygonizeOptions { offset: 0.0, ..polygonizer };
            let (polygons, _) = polygonize::polygonize(&extended, &mask, &level)?;
            Ok((extended, moved, polygons))
        };
        let (extended, moved, surface) = clock.run("extensions", extend, |(e, ..)| format!("{} extensions", e.tubes().len()))?;
        for tube in extended.tubes().iter().filter(|t| t.is_carried() && clear.iter().any(|e| e.opening == t.name() && e.transition.is_some())) {
            report.warn("extensions", format!("the section of `{}` is no outline round its middle: its extension keeps it instead of turning into a circle", tube.name()));
        }
        centerlines = extended.centerlines(&traced);
        extensions = extended.tubes().to_vec();
        (implicit, openings, polygons) = (Box::new(extended), moved, surface);
    }
    let size = clock.run("guidance field", || remeshing::guidance(case, &mask, implicit.as_ref(), &polygons, &centerlines, &openings, share), |(_, s)| format!("median {:.3} mm", s.median))?;
    context.progress.explain(&size.1.why);
    report.put_in("remeshing", "guidance_field", &size.1);
    size.1.bounded.iter().for_each(|w| report.warn("surface", w.clone()));
    let mut part = Part {
        implicit,
        traced,
        centerlines,
        size: Box::new(size.0),
        guidance: size.1,
        target_faces: case.surface.target_faces.map(|n| share * n as f64),
        surface: polygons.clone(),
        polygons,
        ends,
        openings,
        extensions,
    };
    if context.stop_after >= Stage::Surface {
        let made = clock.run(
            "remesh",
            || remeshing::triangles(case, case.surface.remesher, &part, part.size.as_ref(), &context.stop()),
            |m| format!("{} triangles", m.mesh.triangles.len()),
        )?;
        part.surface = made.mesh;
        for (name, summary) in made.summaries {
            report.put_in("remeshing", name, &summary);
        }
        if let Some(fraction) = made.front_fraction {
            report.put_in("surface", "front_fraction", &fraction);
        }
    }
    Ok(part)
}

/// Voxels by which a vessel that leaves the picture is continued, so that the cut lies inside the picture.
const PAD: usize = 4;

/// The planes at which to cut: those detected, and what the user wants of them.
fn ends(
    case: &Case,
    source: &Source,
    mask: &Mask,
    lines: &Centerlines,
    drafts: &[Draft],
    report: &mut Report,
) -> Result<(Vec<Opening>, DetectReport), Error> {
    // The centerlines run on through the padding; so must the mask that they are held against.
    let padded = Evidence::all_carried_on(drafts.iter().map(|d| &d.evidence), mask, 4, PAD);
    let evidence: Vec<Evidence> = drafts.iter().map(|d| d.evidence.clone()).collect();
    let (mut detected, mut summary) = match case.openings.detect {
        Detect::Auto => openings::detect(&padded, &surface_ends::other_ends(source, lines), &evidence, &options::detection(case)),
        Detect::Off => Default::default(),
    };
    for o in &mut detected {
        let Some(draft) = drafts.get(o.component as usize) else { continue };
        *o = openings::refine(&padded, draft.implicit.as_ref(), o);
        if let Some(f) = summary.found.iter_mut().find(|f| f.name == o.name) {
            f.center = o.plane.origin;
        }
    }
    if !matches!(case.openings.detect, Detect::Off) {
        detected = surface_ends::join(source, drafts, detected, &mut summary);
    }
    if case.openings.inlet.0.is_empty() && case.openings.planes.is_empty() {
        let close = std::mem::take(&mut summary.close_choices);
        summary.warnings.extend(close);
    }
    for w in &summary.warnings {
        report.warn("openings", w.clone());
    }
    report.put("ends", &summary);
    let (found, warnings) = openings::apply_user(&padded, lines, detected, &options::user_openings(case))?;
    naming::check(case, &found)?;
    for w in warnings {
        report.warn("openings", w);
    }
    Ok((found, summary))
}
