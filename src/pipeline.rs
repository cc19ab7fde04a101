//! The stages in order, as in the paper's Figure 2; progress, timing, cancellation.

mod error;
mod explain;
mod gates;
mod options;
mod results;
mod retry;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

pub use error::{Error, ErrorKind};
pub use results::write;

use crate::centerline::{self, Centerlines};
use crate::config::{Case, Detect, Method, Profile, Remesher};
use crate::geometry::Point;
use crate::implicit::guard::{GuardOptions, Guarded, MaskBoundary};
use crate::implicit::{self, Implicit};
use crate::io;
use crate::mask::{self, Mask};
use crate::mesh::{self, TriMesh, VolumeMesh};
use crate::openings::{self, Opening};
use crate::pointcloud;
use crate::polygonize;
use crate::quality;
use crate::remesh::size_field::GuidanceField;
use crate::remesh::{self, SizeField, Supports};
use crate::report::{Report, StageTime};
use crate::volume;

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

/// One connected component on its way from mask to surface.
pub struct Part {
    /// The component, cropped, padded at the picture's border.
    pub mask: Mask,
    /// Its wall.
    pub implicit: Box<dyn Implicit>,
    /// Its centerlines.
    pub centerlines: Centerlines,
    /// Its guidance field.
    pub size: Box<dyn SizeField>,
    /// The polygonized implicit.
    pub polygons: TriMesh,
    /// Its surface.
    pub surface: TriMesh,
    /// Its openings.
    pub openings: Vec<Opening>,
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

    let raw = clock.run("read", || read(case, &mut report), |m| format!("{} lumen voxels", m.count()))?;
    let (cleaned, cleaning) =
        clock.run("clean", || mask::clean(&raw, &options::cleaning(case)), |(m, _)| format!("{} lumen voxels", m.count()))?;
    drop(raw);
    explain::cleaning(&cleaning).iter().for_each(|line| context.progress.explain(line));
    report.put("cleaning", &cleaning);
    let mut outcome = Outcome {
        report,
        mask: cleaned,
        surface: None,
        deviation: Vec::new(),
        curvature: Vec::new(),
        surface_skewness: Vec::new(),
        cell_skewness: Vec::new(),
        centerlines: Centerlines::default(),
        openings: Vec::new(),
        volume: None,
    };
    if context.stop_after > Stage::Mask {
        surface_stages(case, &mut clock, &mut outcome)?;
    }
    outcome.report.run.stages = clock.stages;
    Ok(outcome)
}

/// The mask that the case names.
fn read(case: &Case, report: &mut Report) -> Result<Mask, Error> {
    let Some(path) = &case.input.mask else {
        return Err(Error::Configuration("input: only `mask` can be meshed so far: give `input: {mask: FILE}`".into()));
    };
    let image = io::image::read(path)?;
    // A file that names its own unit is believed.
    let image = if image.stated_unit.is_none() { image.with_unit(options::unit(case.input.units)) } else { image };
    let mask = mask::select(&image, &options::selection(case)).map_err(|source| Error::Selection { path: path.clone(), source })?;
    report.put("input", &results::provenance(path, &image, &mask));
    Ok(mask)
}

/// From the cleaned mask to the patched surface, each component by itself.
fn surface_stages(case: &Case, clock: &mut Clock, outcome: &mut Outcome) -> Result<(), Error> {
    let topology = mask::topology(&outcome.mask);
    let voxel_diagonal = outcome.mask.grid.voxel_diagonal();
    let mut parts = Vec::new();
    for component in mask::split_components(&outcome.mask) {
        parts.push(part(case, clock, &mut outcome.report, component)?);
    }
    let context = clock.context;
    if context.stop_after >= Stage::Surface {
        clock.run("openings", || cut(case, &outcome.mask, &mut parts, &mut outcome.report), |n| format!("{n} openings"))?;
    }
    outcome.openings = parts.iter().flat_map(|p| p.openings.iter().cloned()).collect();
    outcome.openings.iter().for_each(|o| context.progress.explain(&explain::opening(o)));
    outcome.centerlines = results::joined_centerlines(&parts);
    let surface = results::joined_surface(&parts);

    let quality = clock.run("quality", || Ok::<_, Error>(quality::surface(&surface, &options::surface_quality(case))), |q| format!("S max {:.3}, mean {:.3}", q.s_max, q.s_mean))?;
    let combinatorial = mesh::topology::check(&surface);
    let crossings = mesh::intersect::self_intersections(&surface);
    outcome.report.put("surface", &quality);
    outcome.report.put_in("surface", "worst", &results::worst_triangles(&quality.worst, &surface, &parts, case.surface.target_skewness));
    outcome.report.put_in("surface", "topology", &combinatorial);
    outcome.report.put_in("surface", "self_intersections", &crossings.len());
    gates::surface(&mut outcome.report, case, &combinatorial, crossings.len(), &quality, &topology);

    let cuts: Vec<_> = outcome.openings.iter().map(quality::fidelity::Cut::from).collect();
    let fidelity = clock.run(
        "fidelity",
        || {
            let reference = quality::fidelity::Reference::new(&outcome.mask)?;
            let measured = quality::fidelity::measure(&surface, &reference, &cuts, &Default::default())?;
            let radii = quality::fidelity::radii(&outcome.centerlines, &surface, &reference);
            Ok::<_, Error>((measured, radii))
        },
        |(f, _)| format!("deviation median {:.3}, max {:.3} voxel diagonals", f.to_marching_cubes.voxel_diagonals.median, f.to_marching_cubes.voxel_diagonals.max),
    )?;
    let lost = quality::fidelity::lost(&results::inside_picture(&outcome.centerlines, &outcome.mask), &surface, &cuts, voxel_diagonal);
    outcome.report.put("fidelity", &fidelity.0);
    outcome.report.put_in("fidelity", "topology", &serde_json::json!({"mask": topology, "surface": combinatorial}));
    outcome.report.put_in("fidelity", "lost", &lost.parts);
    outcome.report.put_in("fidelity", "radius", &fidelity.1);
    gates::fidelity(&mut outcome.report, case, &fidelity.0, &lost);
    outcome.deviation = fidelity.0.deviation.iter().map(|d| d / voxel_diagonal).collect();
    outcome.curvature = results::gaussian_curvature(&parts);
    outcome.surface_skewness = quality.per_triangle;

    if context.stop_after >= Stage::Volume {
        let sizes = Sizes(&parts);
        let (cells, built) = clock.run(
            "volume",
            || volume::build(&surface, &sizes, &options::volume(case, &context.worker), Some(context.cancel)),
            |(v, _)| format!("{} tetrahedra, {} prisms", v.tets.len(), v.prisms.len()),
        )?;
        for w in built.layers.iter().flat_map(|l| &l.warnings) {
            outcome.report.warn("boundary layers", w.clone());
        }
        let measured = clock.run(
            "volume quality",
            || quality::volume(&cells, &Default::default()),
            |q| format!("S_V max {:.3}, mean {:.3}", q.sv_max, q.sv_mean),
        )?;
        outcome.report.put("volume", &measured);
        results::contract_keys(&mut outcome.report, &measured);
        outcome.report.put_in("volume", "build", &built);
        let faults = results::boundary_faces_unlike(&surface, &cells);
        gates::volume(&mut outcome.report, case, &measured, faults);
        outcome.cell_skewness = measured.per_cell;
        outcome.volume = Some(cells);
    }
    outcome.surface = Some(surface);
    Ok(())
}

/// One component: implicit, polygons, centerlines, sizes, triangles.
fn part(case: &Case, clock: &mut Clock, report: &mut Report, component: Mask) -> Result<Part, Error> {
    let context = clock.context;
    let mask = mask::crop_pad(&component, 4, PAD);
    let wanted = mask::topology(&mask);
    let polygons = |f: &dyn Implicit| polygonize::polygonize(f, &mask, &options::polygonizer(case));
    let described = |p: &(TriMesh, polygonize::PolygonizeSummary)| format!("{} triangles", p.0.triangles.len());
    let mut implicit = clock.run("reconstruct", || reconstruct(case, &mask, report), |_| String::new())?;
    let (mut surface, mut summary) = clock.run("polygonize", || polygons(implicit.as_ref()), described)?;
    let topology = mesh::topology::check(&surface);
    if options::method(case) == Method::Smooth && (topology.euler, topology.components) != (2 * wanted.euler, wanted.components) {
        // The guard costs smoothness where it acts; it is taken where the fit alone has another topology than the mask.
        context.progress.explain("the fit has another topology than the mask: it is guarded by the mask's boundary");
        let boundary = MaskBoundary::new(&mask, &GuardOptions::default()).ok_or(Error::EmptyComponent)?;
        implicit = Box::new(Guarded::new(implicit, boundary));
        (surface, summary) = clock.run("polygonize", || polygons(implicit.as_ref()), described)?;
        report.put_in("reconstruction", "guarded", &true);
    }
    let polygons = surface;
    report.put_in("reconstruction", "polygonizer", &summary);
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
    let size = clock.run("guidance field", || guidance(case, &mask, implicit.as_ref(), &polygons, &centerlines), |(_, s)| s.why.clone())?;
    context.progress.explain(&size.1.why);
    report.put_in("remeshing", "guidance_field", &size.1);
    let mut part = Part { mask, implicit, centerlines, size: Box::new(size.0), surface: polygons.clone(), polygons, openings: Vec::new() };
    if context.stop_after >= Stage::Surface {
        let made = clock.run(
            "remesh",
            || triangles(case, case.surface.remesher, &part, part.size.as_ref()),
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

/// The guidance field of a component.
fn guidance(
    case: &Case,
    mask: &Mask,
    implicit: &dyn Implicit,
    polygons: &TriMesh,
    centerlines: &Centerlines,
) -> Result<(GuidanceField, remesh::size_field::Summary), remesh::Error> {
    let mut radii: Vec<(Point, f64)> = centerlines.branches.iter().flat_map(|b| &b.samples).map(|s| (s.point, s.radius)).collect();
    let [x, y, z] = mask.grid.spacing();
    let mut sorted: Vec<f64> = radii.iter().map(|r| r.1).collect();
    sorted.sort_by(f64::total_cmp);
    // Lengths of the whole case in R and D are taken at the median radius.
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(x);
    radii.retain(|r| r.1 > 0.0);
    let options = options::guidance(case, x.min(y).min(z), median);
    GuidanceField::new(polygons, implicit, &radii, [x, y, z], &options)
}

/// Voxels by which a vessel that leaves the picture is continued, so that the cut lies inside the picture.
const PAD: usize = 4;

fn reconstruct(case: &Case, mask: &Mask, report: &mut Report) -> Result<Box<dyn Implicit>, Error> {
    report.put_in("reconstruction", "profile", &case.reconstruction.profile);
    match options::method(case) {
        Method::Smooth => {
            let (f, summary) = implicit::smooth::fit(mask, &Default::default())?;
            report.put_in("reconstruction", "smooth", &summary);
            Ok(Box::new(f))
        }
        Method::Mpu => {
            let points = match case.reconstruction.profile {
                Profile::Paper => pointcloud::PointCloudOptions::paper(),
                Profile::Cfd => pointcloud::PointCloudOptions::cfd(),
            };
            let boundary = MaskBoundary::new(mask, &GuardOptions::default()).ok_or(Error::EmptyComponent)?;
            let (points, cloud) = pointcloud::extract(mask, &points)?;
            let (f, summary) = implicit::mpu::fit(&points, &implicit::mpu::MpuOptions::estimate(&mask.grid, &points))?;
            report.put_in("reconstruction", "point_cloud", &cloud);
            report.put_in("reconstruction", "mpu", &summary);
            Ok(Box::new(Guarded::new(f, boundary)))
        }
    }
}

/// Finds the ends and cuts them open; gives the number of openings.
fn cut(case: &Case, mask: &Mask, parts: &mut [Part], report: &mut Report) -> Result<usize, Error> {
    let found = ends(case, mask, &results::joined_centerlines(parts), report)?;
    let diagonal = parts.iter().fold(crate::geometry::Aabb::EMPTY, |b, p| b.union(&p.surface.bounds())).diagonal();
    let mut measures = Vec::new();
    let mut off_implicit = 0.0f64;
    let mut retries = Vec::new();
    for (n, part) in parts.iter_mut().enumerate() {
        part.openings = found.iter().filter(|o| o.component as usize == n).cloned().collect();
        let whole: &Part = part;
        let (mesh, made, tried) = retry::surface(&whole.polygons, case.surface.max_skewness, case.surface.remesher, |attempt, places| {
            cut_part(case, whole, attempt, places)
        })?;
        if let Some(fraction) = made.front_fraction {
            report.put_in("surface", "front_fraction", &fraction);
        }
        if !tried.is_empty() {
            report.warn("surface", format!("component {n}: the surface missed a hard gate and was made {} times; see remeshing.retries", tried.len()));
            retries.push(serde_json::json!({"component": n, "attempts": tried}));
        }
        let supports = carriers(part);
        off_implicit = off_implicit.max(remesh::off_implicit(&mesh, &supports));
        part.surface = mesh;
        part.polygons = TriMesh::default();
        measures.extend(made.measures);
        report.put_in("remeshing", "cuts", &made.summary);
    }
    let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    report.put_in("remeshing", "off_implicit", &serde_json::json!({"max": off_implicit, "max_voxels": off_implicit / voxel}));
    if !retries.is_empty() {
        report.put_in("remeshing", "retries", &retries);
    }
    measures.sort_by_key(|m| m.id);
    report.put("openings", &results::opening_rows(&measures, &found));
    let inlets = found.iter().filter(|o| o.kind == mesh::PatchKind::Inlet).count();
    gates::openings(report, case, &measures, inlets, diagonal);
    if found.is_empty() {
        report.warn("openings", "there is no opening: the vessel is closed on all sides; give planes under `openings:`");
    }
    Ok(found.len())
}

/// The planes at which to cut: those detected, and what the user wants of them.
fn ends(case: &Case, mask: &Mask, lines: &Centerlines, report: &mut Report) -> Result<Vec<Opening>, Error> {
    // The centerlines run on through the padding; so must the mask that they are held against.
    let padded = mask::crop_pad(mask, 4, PAD);
    let (detected, summary) = match case.openings.detect {
        Detect::Auto => openings::detect(&padded, lines, &Default::default()),
        Detect::Off => Default::default(),
    };
    for w in &summary.warnings {
        report.warn("openings", w.clone());
    }
    report.put("ends", &summary);
    let (found, warnings) = openings::apply_user(&padded, lines, detected, &options::user_openings(case))?;
    for w in warnings {
        report.warn("openings", w);
    }
    Ok(found)
}

/// The carriers of all patches of a component.
fn carriers(part: &Part) -> Supports<'_> {
    part.openings.iter().fold(Supports::new(part.implicit.as_ref()), |s, o| s.with_plane(o.id, o.plane))
}

/// What cutting a component open gave.
struct Opened {
    measures: Vec<openings::OpeningMeasure>,
    summary: openings::CutSummary,
    front_fraction: Option<f64>,
}

/// Cuts a component open; remeshes it before where it is another attempt than the first.
fn cut_part(case: &Case, part: &Part, attempt: retry::Attempt, places: &[Point]) -> Result<(TriMesh, Opened), Error> {
    let opened = |mesh: &TriMesh, size: &dyn SizeField, front_fraction| {
        let (mesh, measures, summary) = openings::cut(mesh, part.implicit.as_ref(), size, &part.openings, &options::cut(case))?;
        Ok((mesh, Opened { measures, summary, front_fraction }))
    };
    if attempt == retry::Attempt::FIRST {
        return opened(&part.surface, part.size.as_ref(), None);
    }
    let everywhere = [part.polygons.bounds().center()];
    let near = places.iter().map(|p| part.size.size(p)).fold(0.0, f64::max);
    let size = remesh::size_field::Scaled {
        field: part.size.as_ref(),
        centers: if attempt.local { places } else { &everywhere },
        reach: if attempt.local { 6.0 * near } else { f64::INFINITY },
        factor: attempt.factor,
    };
    let made = triangles(case, attempt.remesher(case.surface.remesher), part, &size)?;
    opened(&made.mesh, &size, made.front_fraction)
}

/// A remeshed surface and what its remesher says of it.
struct Remeshed {
    mesh: TriMesh,
    summaries: Vec<(&'static str, serde_json::Value)>,
    front_fraction: Option<f64>,
}

/// Remeshes the polygons of a component and repairs angles.
fn triangles(case: &Case, remesher: Remesher, part: &Part, size: &dyn SizeField) -> Result<Remeshed, Error> {
    let supports = Supports::new(part.implicit.as_ref());
    let polygons = &part.polygons;
    let mut made = match remesher {
        Remesher::AdvancingFront => {
            let (mesh, summary) = remesh::advancing_front::remesh(polygons, part.implicit.as_ref(), size, &Default::default())?;
            let summaries = vec![("advancing_front", serde_json::json!(summary))];
            Remeshed { mesh, summaries, front_fraction: Some(summary.front_fraction) }
        }
        Remesher::Auto | Remesher::Isotropic => {
            let (mesh, summary) = remesh::isotropic::remesh(polygons, &supports, size, &Default::default())?;
            Remeshed { mesh, summaries: vec![("isotropic", serde_json::json!(summary))], front_fraction: None }
        }
        Remesher::Improve => {
            let improve = remesh::improve::ImproveOptions { max_skewness: case.surface.max_skewness, ..Default::default() };
            let (mesh, summary) = remesh::improve::improve(polygons, &supports, size, &improve)?;
            return Ok(Remeshed { mesh, summaries: vec![("improve", serde_json::json!(summary))], front_fraction: None });
        }
    };
    let (mesh, summary) = remesh::angle_repair::repair(&made.mesh, &supports, size, &options::repair(case))?;
    made.summaries.push(("angle_repair", serde_json::json!(summary)));
    made.mesh = mesh;
    Ok(made)
}
