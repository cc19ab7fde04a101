//! The whole volume stage: layers along the wall, tetrahedra inside them, slivers out.

use std::sync::atomic::AtomicBool;

use serde::Serialize;

use super::layers::{self, LayerOptions, LayerSummary};
use super::optimise::{OptimiseOptions, OptimiseSummary, optimise_until, quality};
use super::{Error, Summary, VolumeOptions, cancelled, check_surface, fill_and};
use crate::geometry::Point;
use crate::mesh::{TriMesh, VolumeMesh, WALL};
use crate::remesh::SizeField;

/// Everything the volume stage can be told.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BuildOptions {
    /// Prisms along the wall; none by default.
    pub layers: Option<LayerOptions>,
    /// Sizes and the TetGen process.
    pub fill: VolumeOptions,
    /// Removal of slivers; `None` leaves TetGen's tetrahedra as they are.
    pub optimise: Option<OptimiseOptions>,
}

impl Default for BuildOptions {
    fn default() -> Self {
        BuildOptions { layers: None, fill: VolumeOptions::default(), optimise: Some(OptimiseOptions::default()) }
    }
}

/// What the volume stage did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BuildSummary {
    /// The layers.
    pub layers: Option<LayerSummary>,
    /// Each time that the layers were made thinner at some places, since the tetrahedra inside came out poor there; the
    /// best of all is the mesh.
    pub retries: Vec<Retry>,
    /// TetGen.
    pub fill: Summary,
    /// The optimiser.
    pub optimise: Option<OptimiseSummary>,
    /// Thickness of the layers at each point of the surface, mm; empty without layers.
    #[serde(skip)]
    pub thickness: Vec<f64>,
    /// Thickness that was wished there, mm; empty without layers.
    #[serde(skip)]
    pub wished_thickness: Vec<f64>,
}

/// Where layers were made thinner.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Retry {
    /// Vertices of the surface at poor tetrahedra.
    pub vertices: usize,
    /// The first of them, mm.
    pub first: Point,
}

type Filled = (VolumeMesh, Summary, Option<OptimiseSummary>);

/// Fills a closed, patched surface, with layers where asked for.
///
/// Without layers the boundary faces are the surface's triangles in their order and its points stand first. With
/// layers that holds for the wall; the caps consist of quadrilaterals beside the layers and of triangles inside, in
/// the same planes. Boundary faces run by rising patch then.
///
/// # Errors
/// As [`super::fill`], and [`Error::Layers`].
pub fn build(
    surface: &TriMesh,
    size: &dyn SizeField,
    options: &BuildOptions,
    cancel: Option<&AtomicBool>,
) -> Result<(VolumeMesh, BuildSummary), Error> {
    build_watched(surface, size, options, cancel, &|_| ())
}

/// As [`build`]; `expect` hears the number of tetrahedra to expect before the work on them starts.
///
/// # Errors
/// As [`build`].
pub fn build_watched(
    surface: &TriMesh,
    size: &dyn SizeField,
    options: &BuildOptions,
    cancel: Option<&AtomicBool>,
    expect: &dyn Fn(u64),
) -> Result<(VolumeMesh, BuildSummary), Error> {
    let Some(wanted) = options.layers.as_ref().filter(|l| l.count > 0) else {
        let (mesh, fill, optimise) = tetrahedra(surface, size, options, cancel, expect)?;
        let none = vec![];
        return Ok((mesh, BuildSummary { layers: None, retries: vec![], fill, optimise, thickness: none.clone(), wished_thickness: none }));
    };
    for (option, value, must, good) in [
        ("layers.growth", wanted.growth, "between 0.5 and 3", (0.5..=3.0).contains(&wanted.growth)),
        ("layers.total", wanted.total, "above 0 and at most 0.6", wanted.total > 0.0 && wanted.total <= 0.6),
        ("layers.count", f64::from(wanted.count), "at most 50", wanted.count <= 50),
        (
            "layers.first_height",
            wanted.first_height.unwrap_or(1.0),
            "above 0",
            wanted.first_height.is_none_or(|y| y.is_finite() && y > 0.0),
        ),
    ] {
        if !good {
            return Err(Error::Option { option, value, must });
        }
    }
    check_surface(surface)?;
    // The prisms count among the wished cells.
    let mut options = options.clone();
    if let Some(target) = &mut options.fill.sizing.target_cells {
        let wall = surface.patch.iter().filter(|&&p| p == WALL).count() as u64;
        *target = target.saturating_sub(wall * u64::from(wanted.count)).max(1);
    }
    let options = &options;
    let mut retries: Vec<Retry> = vec![];
    let mut thinner: Vec<u32> = vec![];
    let mut best: Option<((bool, f64), VolumeMesh, BuildSummary)> = None;
    loop {
        let (grown, summary) = match layers::grow(surface, wanted, &thinner, &|| cancelled(cancel)) {
            Ok(grown) => grown,
            Err(_) if cancelled(cancel) => return Err(Error::Cancelled),
            Err(_) if best.is_some() => break,
            Err(at) => return Err(Error::Layers { places: at.iter().map(|&v| surface.points[v as usize]).collect() }),
        };
        let quiet = |_| ();
        let heard: &dyn Fn(u64) = if retries.is_empty() { expect } else { &quiet };
        let (inside, fill, optimise) = match tetrahedra(&grown.inner, &Edges, options, cancel, heard) {
            Err(Error::TetGen { .. } | Error::Surface(_)) if best.is_some() => break,
            filled => filled?,
        };
        let (worst, bound) = poor(&inside, surface.points.len());
        let (thickness, wished_thickness) = (grown.thickness.clone(), grown.wished.clone());
        let mesh = grown.join(inside);
        let good = bound.is_empty() && best.is_none();
        let score = (good || solvers_accept(&mesh), worst);
        if best.as_ref().is_none_or(|b| score > b.0) {
            let summary = BuildSummary { layers: Some(summary), retries: vec![], fill, optimise, thickness, wished_thickness };
            best = Some((score, mesh, summary));
        }
        if bound.is_empty() || options.optimise.is_none() || retries.len() == MOST_RETRIES {
            break;
        }
        retries.push(Retry { vertices: bound.len(), first: surface.points[bound[0] as usize] });
        thinner.extend(bound);
    }
    let Some((_, mesh, summary)) = best else { return Err(Error::Layers { places: vec![] }) };
    Ok((mesh, BuildSummary { retries, ..summary }))
}

/// Whether checkMesh accepts the mesh where layers are thin: layers made thinner must not cost that.
fn solvers_accept(mesh: &VolumeMesh) -> bool {
    crate::quality::volume(mesh, &Default::default()).is_ok_and(|q| {
        q.openfoam.determinant_min >= 0.001 && q.openfoam.non_orthogonality_max <= 70.0 && q.sv_max < 0.95
    })
}

/// Most times that layers are made thinner where the tetrahedra inside them came out poor.
const MOST_RETRIES: usize = 3;

/// The worst shape of the tetrahedra, and the vertices of the surface at those that miss what is aimed at.
fn poor(mesh: &VolumeMesh, surface_points: usize) -> (f64, Vec<u32>) {
    let shapes = mesh.tets.iter().map(|t| (quality::shape(&t.map(|v| mesh.points[v as usize])), t));
    let (mut worst, mut at) = (1.0f64, vec![]);
    for (shape, tet) in shapes {
        worst = worst.min(shape);
        if shape < quality::AIM {
            at.extend(tet.iter().filter(|&&v| (v as usize) < surface_points));
        }
    }
    at.sort_unstable();
    at.dedup();
    (worst, at)
}

/// No wish: the surface's own edges count. The inner surface's are shorter than the field that made the wall's.
struct Edges;

impl SizeField for Edges {
    fn size(&self, _: &crate::geometry::Point) -> f64 {
        f64::NAN
    }
}

fn tetrahedra(
    surface: &TriMesh,
    size: &dyn SizeField,
    options: &BuildOptions,
    cancel: Option<&AtomicBool>,
    expect: &dyn Fn(u64),
) -> Result<Filled, Error> {
    let mut optimised = None;
    let (mesh, fill) = fill_and(surface, size, &options.fill, cancel, expect, &mut |mesh| {
        optimised = options.optimise.as_ref().map(|o| optimise_until(mesh, o, &|| cancelled(cancel)));
    })?;
    if cancelled(cancel) {
        return Err(Error::Cancelled);
    }
    Ok((mesh, fill, optimised))
}
