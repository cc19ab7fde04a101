//! From what a run made to files in a folder.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use sha2::{Digest, Sha256};

use super::{Context, Error, Outcome, Part, Stage};
use crate::centerline::Centerlines;
use crate::config::{Case, Export};
use crate::flow::{FlowError, FlowOptions, FlowPlan, Waveform};
use crate::geometry::Point;
use crate::io::vtp::{Array, Extra, Values};
use crate::io::{fluent, fluent_journal, gmsh, openfoam, ply, simvascular, stl, vtp, vtu};
use crate::mask::{Image, Mask};
use crate::mesh::faces::FaceList;
use crate::mesh::{Patch, TriMesh, VolumeMesh};
use crate::openings::{self, FoundBy, Opening, OpeningMeasure};
use crate::quality::VolumeQuality;
use crate::quality::fidelity::Fidelity;
use crate::report::{Report, html};

/// Where the input came from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Provenance {
    /// The file's name.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Voxels along each axis.
    pub dims: [usize; 3],
    /// Voxel edges, mm.
    pub spacing: [f64; 3],
    /// Centre of the first voxel, LPS mm.
    pub origin: Point,
    /// Unit vectors of the axes, one column an axis, row by row.
    pub direction: [[f64; 3]; 3],
    /// Type of the voxels.
    pub scalar: &'static str,
    /// Lumen voxels.
    pub lumen_voxels: usize,
}

pub(super) fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

pub(super) fn sha256(path: &Path) -> String {
    let bytes = std::fs::read(path).unwrap_or_default();
    Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect()
}

pub(super) fn provenance(path: &Path, image: &Image, mask: &Mask) -> Provenance {
    let d = image.grid.direction();
    Provenance {
        file: file_name(path),
        sha256: sha256(path),
        dims: image.grid.dims,
        spacing: image.grid.spacing(),
        origin: image.grid.origin,
        direction: [0, 1, 2].map(|r| [0, 1, 2].map(|c| d[(r, c)])),
        scalar: image.values.type_name(),
        lumen_voxels: mask.count(),
    }
}

/// One mesh of all components; patch ids are those of the openings.
pub(super) fn joined_surface(parts: &[Part]) -> TriMesh {
    let mut all = TriMesh { patches: vec![Patch::wall()], ..TriMesh::default() };
    for part in parts {
        let base = all.points.len() as u32;
        all.points.extend_from_slice(&part.surface.points);
        all.triangles.extend(part.surface.triangles.iter().map(|t| t.map(|v| v + base)));
        all.patch.extend_from_slice(&part.surface.patch);
        all.patches.extend(part.surface.patches.iter().filter(|p| p.id != crate::mesh::WALL).cloned());
    }
    all.patches.sort_by_key(|p| p.id);
    all
}

/// Whether each vertex belongs to a triangle of the wall.
fn on_wall(surface: &TriMesh) -> Vec<bool> {
    let mut wall = vec![false; surface.points.len()];
    for (t, patch) in surface.triangles.iter().zip(&surface.patch) {
        if *patch == crate::mesh::WALL {
            t.iter().for_each(|v| wall[*v as usize] = true);
        }
    }
    wall
}

/// Gaussian curvature of the implicit wall at each vertex of the joined surface, 1/mm²; 0 inside caps, which are flat.
pub(super) fn gaussian_curvature(parts: &[Part]) -> Vec<f64> {
    let of_part = |part: &Part| {
        let mut curvature = crate::quality::curvature::of_implicit(&part.surface.points, part.implicit.as_ref()).gaussian;
        curvature.iter_mut().zip(on_wall(&part.surface)).filter(|(_, wall)| !wall).for_each(|(k, _)| *k = 0.0);
        curvature
    };
    parts.iter().flat_map(of_part).collect()
}

/// A triangle among the worst, with what keeps it from being better.
#[derive(Debug, Clone, Serialize)]
pub(super) struct WorstRow<'a> {
    #[serde(flatten)]
    triangle: &'a crate::quality::WorstTriangle,
    cause: crate::remesh::angle_repair::Reason,
}

/// The worst triangles of the joined surface with their causes.
pub(super) fn worst_triangles<'a>(
    worst: &'a [crate::quality::WorstTriangle],
    surface: &TriMesh,
    parts: &[Part],
    target: f64,
) -> Vec<WorstRow<'a>> {
    let ends: Vec<usize> = parts
        .iter()
        .scan(0, |end, p| {
            *end += p.surface.triangles.len();
            Some(*end)
        })
        .collect();
    let row = |triangle: &'a crate::quality::WorstTriangle| {
        let part = &parts[ends.partition_point(|&end| end <= triangle.id as usize).min(parts.len().checked_sub(1)?)];
        let cause = crate::remesh::angle_repair::reason(surface, &super::cutting::carriers(part), triangle.id as usize, target);
        Some(WorstRow { triangle, cause })
    };
    worst.iter().filter_map(row).collect()
}

/// The centerlines of all components, given in their order.
pub(super) fn joined_centerlines<'a>(components: impl Iterator<Item = &'a Centerlines>) -> Centerlines {
    let mut all = Centerlines::default();
    for (component, lines) in components.enumerate() {
        let base = all.nodes.len() as u32;
        all.nodes.extend_from_slice(&lines.nodes);
        all.branches.extend(lines.branches.iter().cloned().map(|mut b| {
            b.nodes = b.nodes.map(|n| n + base);
            b.component = component as u32;
            b
        }));
    }
    all
}

/// Whether a point of the surface belongs to an extension.
fn in_extension(parts: &[Part], p: &Point) -> bool {
    parts.iter().flat_map(|p| &p.extensions).any(|t| t.holds(p))
}

/// The surface with the walls of extensions as a patch of their own.
pub(super) fn without_extensions<'a>(surface: &'a TriMesh, parts: &[Part]) -> Cow<'a, TriMesh> {
    if parts.iter().all(|p| p.extensions.is_empty()) {
        return Cow::Borrowed(surface);
    }
    let mut vessel = surface.clone();
    for t in 0..surface.triangles.len() {
        let [a, b, c] = surface.corners(t);
        // A triangle astride the old opening belongs to neither side.
        if surface.patch[t] == crate::mesh::WALL && [a, b, c].iter().any(|p| in_extension(parts, p)) {
            vessel.patch[t] = u32::MAX;
        }
    }
    Cow::Owned(vessel)
}

/// Takes the extensions out of what was measured: their volume, and the deviation of their vertices, which becomes 0.
pub(super) fn leave_out_extensions(fidelity: &mut Fidelity, surface: &TriMesh, parts: &[Part]) {
    let volume: f64 = parts.iter().flat_map(|p| &p.extensions).map(openings::Tube::volume).sum();
    if volume > 0.0 {
        fidelity.volume_ratio -= volume / fidelity.kept_mask_volume;
        for (d, p) in fidelity.deviation.iter_mut().zip(&surface.points) {
            if in_extension(parts, p) {
                *d = 0.0;
            }
        }
    }
}

/// An extension in the report.
#[derive(Debug, Clone, Serialize)]
pub struct ExtensionRow {
    /// Name of the opening.
    opening: String,
    /// Length along its axis, mm.
    length: f64,
    /// Middle of the section that it starts from, mm.
    from: Point,
    /// Area of the section that it carries, mm².
    section_area: f64,
    /// Area of the opening at its end, mm²: less than the section's by what a polygon lacks of a circle.
    opening_area: f64,
}

pub(super) fn extension_rows(parts: &[Part], measures: &[OpeningMeasure]) -> Vec<ExtensionRow> {
    let tubes = parts.iter().flat_map(|p| &p.extensions);
    tubes
        .map(|t| ExtensionRow {
            opening: t.name().into(),
            length: t.length(),
            from: t.old_end().origin,
            section_area: t.area(),
            opening_area: measures.iter().find(|m| m.name == t.name()).map_or(0.0, |m| m.area),
        })
        .collect()
}

/// The centerlines without their run through the padding beyond the picture.
pub(super) fn inside_picture(lines: &Centerlines, picture: &Mask) -> Centerlines {
    let inside = |p: &Point| {
        let i = picture.grid.to_index(p);
        (0..3).all(|a| i[a] >= -0.5 && i[a] <= picture.grid.dims[a] as f64 - 0.5)
    };
    let mut kept = lines.clone();
    for b in &mut kept.branches {
        b.samples.retain(|s| inside(&s.point));
    }
    kept
}

/// Boundary triangles of the volume mesh that the surface lacks, and the other way round.
pub(super) fn boundary_faces_unlike(surface: &TriMesh, volume: &VolumeMesh) -> usize {
    let key = |ids: &[u32], patch: u32| {
        let mut k = ids.to_vec();
        k.sort_unstable();
        (k, patch)
    };
    // With prism layers the caps are quadrilaterals beside the layers: only the wall keeps its triangles.
    let compared = |patch: u32| volume.prisms.is_empty() || patch == crate::mesh::WALL;
    let triangles = surface.triangles.iter().zip(&surface.patch).filter(|(_, p)| compared(**p));
    let mut wanted: Vec<_> = triangles.map(|(t, p)| key(t, *p)).collect();
    let mut found: Vec<_> = volume.boundary.iter().filter(|f| compared(f.patch)).map(|f| key(f.ids(), f.patch)).collect();
    wanted.sort();
    found.sort();
    let (mut i, mut j, mut unlike) = (0, 0, 0);
    while i < wanted.len() || j < found.len() {
        match (wanted.get(i), found.get(j)) {
            (Some(a), Some(b)) if a == b => (i, j) = (i + 1, j + 1),
            (Some(a), Some(b)) if a < b => (i, unlike) = (i + 1, unlike + 1),
            (Some(_), None) => (i, unlike) = (i + 1, unlike + 1),
            _ => (j, unlike) = (j + 1, unlike + 1),
        }
    }
    unlike
}

/// Largest resident memory of this process so far, bytes; 0 where the system does not tell.
fn peak_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM:"));
    let kib = line.and_then(|l| l.split_whitespace().nth(1)).and_then(|n| n.parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}

/// Writes everything that a run made into `dir` and gives the final report.
///
/// # Errors
/// [`Error::File`] names the file that could not be written.
pub fn write(outcome: &Outcome, case: &Case, dir: &Path, context: &Context) -> Result<Report, Error> {
    let folder = |name: &str| -> Result<std::path::PathBuf, Error> {
        let path = dir.join(name);
        std::fs::create_dir_all(&path).map_err(|e| crate::io::Error::write(&path, e))?;
        Ok(path)
    };
    crate::io::nrrd::write_mask(&folder("input")?.join("mask-cleaned.nrrd"), &outcome.mask)?;
    let mut report = outcome.report.clone();
    let start = std::time::Instant::now();
    if let Some(surface) = &outcome.surface {
        files_of_surface(outcome, surface, case, &folder("surface")?)?;
    }
    if let Some(volume) = &outcome.volume {
        files_of_volume(outcome, volume, &folder("volume")?)?;
        if context.stop_after >= Stage::Exports {
            exports(outcome, volume, case, dir, &mut report)?;
        }
    }
    report.run.stages.push(crate::report::StageTime { name: "write".into(), seconds: start.elapsed().as_secs_f64() });
    report.run.peak_memory_bytes = peak_memory();
    report.run.threads = rayon::current_num_threads();
    let yaml = crate::config::to_yaml(&case.with_absolute_paths()).map_err(|e| Error::Configuration(e.to_string()))?;
    let text = |name: &str, text: &str| -> Result<(), Error> {
        let path = dir.join(name);
        std::fs::write(&path, text).map_err(|e| crate::io::Error::write(&path, e).into())
    };
    text("case.resolved.yaml", &yaml)?;
    text("lumenmesh.log", &log(&report))?;
    if let Some(surface) = &outcome.surface {
        let scene = html::Scene {
            surface,
            skewness: &outcome.surface_skewness,
            deviation: on_wall(surface).iter().zip(&outcome.deviation).map(|(wall, d)| if *wall { *d } else { f64::NAN }).collect(),
            curvature: &outcome.curvature,
            centerlines: segments(&outcome.centerlines),
            volume: outcome.volume.as_ref().map(|v| (v, outcome.cell_skewness.as_slice())),
            title: title(case),
            case: &yaml,
        };
        text("report.html", &html::page(&report, &scene))?;
        let path = dir.join("thumbnail.png");
        std::fs::write(&path, html::thumbnail(surface)).map_err(|e| crate::io::Error::write(&path, e))?;
    }
    text("report.json", &report.to_json())?;
    Ok(report)
}

/// An opening in the report: as found and as made.
#[derive(Debug, Clone, Serialize)]
pub struct OpeningRow<'a> {
    #[serde(flatten)]
    measure: &'a OpeningMeasure,
    found_by: FoundBy,
    confidence: f64,
    /// Radius of the vessel at the plane, mm.
    radius: f64,
    /// Area of the vessel's section square to its axis, mm²; `area` is that of the cap.
    square_area: f64,
    /// Angle between the cap's normal and the vessel's axis, degrees.
    tilt: f64,
    /// Area that the flat face, border region or rim has that the opening stands for, mm².
    #[serde(skip_serializing_if = "Option::is_none")]
    expected_area: Option<f64>,
    component: u32,
}

pub(super) fn opening_rows<'a>(measures: &'a [OpeningMeasure], found: &[Opening]) -> Vec<OpeningRow<'a>> {
    let rows = measures.iter().filter_map(|measure| {
        let o = found.iter().find(|o| o.id == measure.id)?;
        Some(OpeningRow { measure, found_by: o.found_by, confidence: o.confidence, radius: o.radius, square_area: o.support.square_area, tilt: o.tilt(), expected_area: o.support.expected_area, component: o.component })
    });
    rows.collect()
}

fn create(path: &Path, body: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>) -> Result<(), Error> {
    let failed = |e| Error::from(crate::io::Error::write(path, e));
    let mut file = std::io::BufWriter::with_capacity(1 << 20, std::fs::File::create(path).map_err(failed)?);
    body(&mut file).map_err(failed)?;
    std::io::Write::flush(&mut file).map_err(failed)
}

fn files_of_surface(outcome: &Outcome, surface: &TriMesh, case: &Case, dir: &Path) -> Result<(), Error> {
    let mut extra = Extra::default();
    if outcome.deviation.len() == surface.points.len() {
        extra.point.push(Array::scalars("DeviationVox", Values::F64(outcome.deviation.clone())));
    }
    if outcome.curvature.len() == surface.points.len() {
        extra.point.push(Array::scalars("GaussianCurvature", Values::F64(outcome.curvature.clone())));
    }
    let (made, wished) = &outcome.layer_thickness;
    if made.len() == surface.points.len() {
        extra.point.push(Array::scalars("LayerThickness", Values::F64(made.clone())));
        extra.point.push(Array::scalars("LayerThicknessWished", Values::F64(wished.clone())));
    }
    create(&dir.join("lumen.vtp"), |w| vtp::write_surface(w, surface, &extra))?;
    create(&dir.join("centerlines.vtp"), |w| vtp::write_centerlines(w, &outcome.centerlines))?;
    if case.exports.contains(&Export::Stl) {
        create(&dir.join("lumen.stl"), |w| stl::write(w, surface))?;
        for patch in &surface.patches {
            create(&dir.join(format!("{}.stl", patch.name)), |w| stl::write_patch(w, surface, patch))?;
        }
    }
    if case.exports.contains(&Export::Ply) {
        create(&dir.join("lumen.ply"), |w| ply::write(w, surface))?;
    }
    Ok(())
}

fn files_of_volume(outcome: &Outcome, volume: &VolumeMesh, dir: &Path) -> Result<(), Error> {
    create(&dir.join("lumen.vtu"), |w| vtu::write(w, volume, &outcome.cell_skewness, &Extra::default()))?;
    create(&dir.join("boundary.vtp"), |w| vtp::write_boundary(w, volume))?;
    create(&dir.join("boundary.vtu"), |w| vtu::write_boundary(w, volume))
}

/// Keys of the contract that the volume's quality has deeper down.
pub(super) fn contract_keys(report: &mut Report, q: &VolumeQuality) {
    report.put_in("volume", "non_orthogonality", &q.openfoam.non_orthogonality_max);
    report.put_in("volume", "openfoam_skewness", &q.openfoam.skewness_max);
    report.put_in("volume", "orthogonal_quality", &q.fluent.orthogonal_quality_min);
    report.put_in("volume", "histogram", &q.equi_volume.histogram);
    report.put_in("volume", "worst", &q.equi_volume.worst);
}

fn exports(outcome: &Outcome, volume: &VolumeMesh, case: &Case, dir: &Path, report: &mut Report) -> Result<(), Error> {
    let wanted = |e: Export| case.exports.contains(&e);
    let faces = FaceList::build(volume).map_err(Error::Faces)?;
    let failed = |path: &Path, e: std::io::Error| Error::from(crate::io::Error::write(path, e));
    let folder = |name: &str| -> Result<PathBuf, Error> {
        let path = dir.join(name);
        std::fs::create_dir_all(&path).map_err(|e| failed(&path, e))?;
        Ok(path)
    };
    let flow = flow_plan(case, &faces, square_areas(outcome))?;
    match &flow {
        Some((options, plan)) => {
            for w in &plan.warnings {
                report.warn("flow", w.clone());
            }
            report.put("flow", &crate::report::handover::sheet(options, plan));
        }
        None => report.warn("flow", "there is no inlet or no outlet: openfoam/ holds the mesh only, without 0/ and system/, and fluent/ no journal"),
    }
    if wanted(Export::Openfoam) {
        let path = folder("openfoam")?;
        match &flow {
            Some((options, plan)) => openfoam::write_case(&path, &faces, options, plan),
            None => openfoam::write_poly_mesh(&path, &faces),
        }
        .map_err(|e| failed(&path, e))?;
    }
    if wanted(Export::Fluent) {
        let path = folder("fluent")?;
        create(&path.join("lumen.msh"), |w| fluent::write(w, volume, &faces))?;
        if let Some((options, plan)) = &flow {
            for w in fluent_journal::warnings(options) {
                report.warn("fluent", w);
            }
            fluent_journal::write(&path, &faces, options, plan).map_err(|e| failed(&path, e))?;
        }
    }
    if wanted(Export::Gmsh) {
        create(&folder("gmsh")?.join("lumen.msh"), |w| gmsh::write(w, volume))?;
    }
    if wanted(Export::Vmtk) {
        create(&folder("vmtk")?.join("lumen.vtu"), |w| vtu::write_vmtk(w, volume))?;
    }
    if wanted(Export::Simvascular) {
        let path = folder("simvascular")?.join("mesh-complete");
        simvascular(&path, volume, &faces, report)?;
    }
    Ok(())
}

/// SimVascular's folder. Its reader takes one kind of cells, so that prisms are split into tetrahedra there.
fn simvascular(path: &Path, volume: &VolumeMesh, faces: &FaceList<'_>, report: &mut Report) -> Result<(), Error> {
    let failed = |e| Error::from(crate::io::Error::write(path, e));
    if volume.prisms.is_empty() {
        return simvascular::write(path, volume, faces).map_err(failed);
    }
    let split = match crate::mesh::split::prisms(volume) {
        Ok(split) => split,
        Err(e) => {
            report.warn("simvascular", format!("simvascular/ holds no mesh: {e}; ask for fewer or thicker boundary layers"));
            return Ok(());
        }
    };
    report.put_in("volume", "simvascular", &serde_json::json!({"tets": split.tets.len(), "from_prisms": 3 * volume.prisms.len()}));
    let faces = FaceList::build(&split).map_err(Error::Faces)?;
    simvascular::write(path, &split, &faces).map_err(failed)
}

/// The flow as the case asks for it.
pub(super) fn flow_options(case: &Case) -> Result<FlowOptions, Error> {
    let waveform = match &case.flow.waveform {
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|e| crate::io::Error::read(path, e))?;
            let wrong = |e: FlowError| Error::Configuration(format!("{}: {e}", path.display()));
            Some(Waveform::parse_csv(&text).map_err(wrong)?)
        }
        None => None,
    };
    Ok(super::options::flow(case, waveform))
}

/// Areas of the sections square to the vessels at their openings, mm², as the caps were made; an extension ends square.
fn square_areas(outcome: &Outcome) -> BTreeMap<String, f64> {
    let rows = |key: &str| outcome.report.sections.get(key).and_then(|v| v.as_array()).cloned().unwrap_or_default();
    let (caps, extended) = (rows("openings"), rows("extensions"));
    let one = |o: &Opening| {
        let cap = caps.iter().find(|r| r["name"] == o.name.as_str())?["area"].as_f64()?;
        let square = extended.iter().all(|r| r["opening"] != o.name.as_str());
        Some((o.name.clone(), if square { cap * o.tilt().to_radians().cos() } else { cap }))
    };
    outcome.openings.iter().filter_map(one).collect()
}

/// The flow through the openings; `None` where nothing can flow.
fn flow_plan(case: &Case, faces: &FaceList<'_>, square_areas: BTreeMap<String, f64>) -> Result<Option<(FlowOptions, FlowPlan)>, Error> {
    let options = FlowOptions { square_areas, ..flow_options(case)? };
    match FlowPlan::resolve(&options, faces) {
        Ok(plan) => Ok(Some((options, plan))),
        Err(FlowError::NoOpening(_)) => Ok(None),
        Err(e) => Err(e.into()),
    }
}

fn title(case: &Case) -> String {
    let input = &case.input;
    let path = input.mask.as_ref().or(input.probability.as_ref()).or(input.surface.as_ref());
    path.and_then(|p| p.file_name()).map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

fn segments(lines: &Centerlines) -> Vec<[Point; 2]> {
    lines.branches.iter().flat_map(|b| b.samples.windows(2).map(|w| [w[0].point, w[1].point])).collect()
}

fn log(report: &Report) -> String {
    let mut out = format!("lumenmesh {}\n", report.version);
    for s in &report.run.stages {
        out.push_str(&format!("{:<16}{:>10.3} s\n", s.name, s.seconds));
    }
    for w in &report.warnings {
        out.push_str(&format!("warning ({}): {}\n", w.stage, w.message));
    }
    for g in &report.gates {
        out.push_str(&format!("{} {}: {} (limit {})\n", if g.passed { "met   " } else { "missed" }, g.name, crate::report::rounded(g.value), g.limit));
    }
    out
}
