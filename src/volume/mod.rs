//! From a closed, patched surface to tetrahedra (and prisms along the wall) that a solver can run on.
//!
//! The surface is frozen: its triangles come back as boundary faces, its points stand first and bit-equal.
//! Interior points are laid out by [`sizing`] and packed at the wished spacing; TetGen (in a worker process,
//! see [`worker`]) connects them and recovers the surface; [`optimise`](mod@optimise) then removes what TetGen leaves: slivers.

pub mod build;
pub mod check;
pub mod creases;
mod directions;
pub mod layers;
pub mod optimise;
pub mod packing;
mod protocol;
mod search;
pub mod series;
pub mod sizing;
pub mod worker;

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use serde::Serialize;

use crate::geometry::Point;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::intersect::self_intersections;
use crate::mesh::{BoundaryFace, Patch, TriMesh, VolumeMesh};
use crate::remesh::SizeField;

pub use build::{BuildOptions, BuildSummary, build, build_watched};
pub use check::SurfaceFault;
pub use creases::{Crease, CreaseOptions};
pub use layers::{LayerOptions, LayerSummary};
pub use optimise::{OptimiseOptions, OptimiseSummary, optimise};
pub use sizing::SizingOptions;
pub use worker::{WorkerError, WorkerOptions};

/// How a surface is filled.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct VolumeOptions {
    /// Sizes in the interior.
    pub sizing: SizingOptions,
    /// The TetGen process.
    pub worker: WorkerOptions,
}

/// What went wrong in the volume stage.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The surface cannot be filled.
    #[error("volume: {0}")]
    Surface(Box<SurfaceFault>),
    /// An option has no meaning.
    #[error("volume: option {option} is {value}: it must be {must}")]
    Option {
        /// Which.
        option: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        must: &'static str,
    },
    /// The worker could not be started.
    #[error("volume: {0}")]
    Start(WorkerError),
    /// No attempt brought a mesh.
    #[error(
        "volume: no tetrahedra after {} attempts on {triangles} triangles: {}. The surface passed the checks for \
         closedness, orientation and self-intersection; remesh it with shorter edges or another seed, or raise the limits",
        attempts.len(), list(attempts)
    )]
    TetGen {
        /// What was tried and what became of it.
        attempts: Vec<Attempt>,
        /// Size of the surface.
        triangles: usize,
        /// Where the surface may be at fault, mm: TetGen does not say. Its sharpest edges and its most skewed triangles,
        /// nothing where a time limit ended the work.
        places: Vec<Point>,
    },
    /// There is no room for layers, however thin.
    #[error(
        "volume: boundary layers are not possible on this surface{}, even at a thousandth of the wished thickness: \
         remesh it (folds or triangles of high skewness at the wall), or set the number of layers to 0",
        near(places)
    )]
    Layers {
        /// Vertices of the wall where they fail, mm.
        places: Vec<Point>,
    },
    /// The caller asked to stop.
    #[error("volume: cancelled")]
    Cancelled,
}

fn near(places: &[Point]) -> String {
    places.first().map_or(String::new(), |p| {
        format!(" at {} vertices, the first near ({:.2}, {:.2}, {:.2})", places.len(), p.x, p.y, p.z)
    })
}

fn list(attempts: &[Attempt]) -> String {
    attempts.iter().map(|a| format!("{}: {}", a.name, a.failure.as_deref().unwrap_or("done"))).collect::<Vec<_>>().join("; ")
}

/// One call of TetGen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Attempt {
    /// What was different about it.
    pub name: &'static str,
    /// TetGen's switches.
    pub switches: String,
    /// Seconds it took.
    #[serde(skip_serializing)]
    pub seconds: f64,
    /// Why it was not good; nothing where it was.
    pub failure: Option<String>,
}

/// What the volume stage did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Cells expected before the work began.
    pub estimated_cells: u64,
    /// Cells there are.
    pub cells: usize,
    /// Points laid out in the interior.
    pub interior_points: usize,
    /// Factor on all interior sizes that `target_cells` asked for; 1 without.
    pub size_factor: f64,
    /// Every call of TetGen, the failed ones too.
    pub attempts: Vec<Attempt>,
    /// Ratio of mean edge length round an interior vertex to the wished size: 5th, 50th and 95th percentile.
    pub size_ratio: [f64; 3],
}

/// Fills a closed, patched surface with tetrahedra.
///
/// `size` is the guidance field that the surface was made with. The points of `surface` are the first points
/// of the mesh, bit-equal; its triangles are the boundary faces, in the same order.
///
/// # Errors
/// [`Error::Surface`] where the surface is open, crossing, inside out or the like; [`Error::TetGen`] where no
/// rung of the ladder of attempts worked, each with its reason.
pub fn fill(surface: &TriMesh, size: &dyn SizeField, options: &VolumeOptions) -> Result<(VolumeMesh, Summary), Error> {
    fill_cancellable(surface, size, options, None)
}

/// As [`fill`]; stops soon after `cancel` becomes true.
///
/// # Errors
/// As [`fill`], and [`Error::Cancelled`].
pub fn fill_cancellable(
    surface: &TriMesh,
    size: &dyn SizeField,
    options: &VolumeOptions,
    cancel: Option<&AtomicBool>,
) -> Result<(VolumeMesh, Summary), Error> {
    fill_and(surface, size, options, cancel, &|_| (), &mut |_| ())
}

/// Most times that points are laid out anew where their number misses `target_cells`.
const CORRECTIONS: usize = 3;

/// As [`fill_cancellable`]; `expect` hears the number of cells to expect before the work starts, `finish` works on the
/// mesh before its sizes are held against the wished ones.
fn fill_and(
    surface: &TriMesh,
    size: &dyn SizeField,
    options: &VolumeOptions,
    cancel: Option<&AtomicBool>,
    expect: &dyn Fn(u64),
    finish: &mut dyn FnMut(&mut VolumeMesh),
) -> Result<(VolumeMesh, Summary), Error> {
    options.sizing.check()?;
    check_surface(surface)?;
    let bvh = TriangleBvh::new(surface);
    let mut sizing = sizing::Sizing::new(surface, &bvh, size, &options.sizing);
    expect(sizing.estimate());
    let mut interior = packing::pack(surface, &sizing, &|| cancelled(cancel));
    if let Some(target) = options.sizing.target_cells {
        for _ in 0..CORRECTIONS {
            let (cells, target) = (sizing::cells_of_points(interior.len(), surface.points.len()), target as f64);
            if (cells / target - 1.0).abs() < 0.03 || !sizing.correct(cells, target) {
                break;
            }
            interior = packing::pack(surface, &sizing, &|| cancelled(cancel));
        }
    }
    if cancelled(cancel) {
        return Err(Error::Cancelled);
    }
    let (points, tets, attempts) = tetrahedralize(surface, &interior, &sizing, &options.worker, cancel)?;
    let boundary = surface.triangles.iter().zip(&surface.patch).map(|(&t, &p)| BoundaryFace::triangle(t, p)).collect();
    let patches = if surface.patches.is_empty() { vec![Patch::wall()] } else { surface.patches.clone() };
    let mut mesh = VolumeMesh { points, tets, prisms: vec![], boundary, patches };
    finish(&mut mesh);
    let summary = Summary {
        estimated_cells: sizing.estimate(),
        cells: mesh.tets.len(),
        interior_points: interior.len(),
        size_factor: sizing.factor(),
        attempts,
        size_ratio: sizing::size_ratio(&sizing, surface.points.len(), &mesh.points, &mesh.tets),
    };
    Ok((mesh, summary))
}

fn cancelled(cancel: Option<&AtomicBool>) -> bool {
    cancel.is_some_and(|c| c.load(std::sync::atomic::Ordering::Relaxed))
}

/// Everything that TetGen would choke on, crossing triangles included.
fn check_surface(surface: &TriMesh) -> Result<(), Error> {
    check::surface(surface).map_err(|f| Error::Surface(Box::new(f)))?;
    let crossing = self_intersections(surface);
    if let Some(&(first, _)) = crossing.first() {
        let [a, b, c] = surface.corners(first as usize);
        let mut triangles: Vec<u32> = crossing.iter().take(5).flat_map(|&(i, j)| [i, j]).collect();
        triangles.dedup();
        return Err(Error::Surface(Box::new(SurfaceFault {
            what: "triangles that cross or touch each other, in pairs",
            count: crossing.len(),
            triangles,
            near: Some(((a.coords + b.coords + c.coords) / 3.0).into()),
            advice: "remesh with shorter edges there, or separate the parts that touch in the mask",
        })));
    }
    Ok(())
}

/// The ladder: the same surface with other switches, until a mesh passes every check.
fn tetrahedralize(
    surface: &TriMesh,
    interior: &[Point],
    sizing: &sizing::Sizing<'_>,
    options: &WorkerOptions,
    cancel: Option<&AtomicBool>,
) -> Result<(Vec<Point>, Vec<[u32; 4]>, Vec<Attempt>), Error> {
    let given = surface.points.len() + interior.len();
    let budget = options.steiner_budget.unwrap_or((4 * given as u64).max(100_000)).min(i32::MAX as u64 / 2);
    let mut attempts: Vec<Attempt> = vec![];
    // Name, switches, whether our own points are given, whether sizes are given.
    let ladder: [(&'static str, &str, bool, bool); 4] = [
        ("own interior points", "pYO0", true, false),
        ("own interior points, fine tolerance", "pYO2T1e-12", true, false),
        ("TetGen's refinement by sizes", "pYq1.4/10mO4", false, true),
        ("no interior points", "pYT1e-12", false, false),
    ];
    for (name, switches, with_points, with_sizes) in ladder {
        let switches = format!("{switches}S{budget}Q");
        let mut input = tetgen_sys::Input {
            points: surface.points.iter().map(|p| p.coords.into()).collect(),
            triangles: surface.triangles.clone(),
            markers: surface.patch.iter().map(|&p| p as i32).collect(),
            sizes: vec![],
        };
        if with_points {
            input.points.extend(interior.iter().map(|p| <[f64; 3]>::from(p.coords)));
        }
        if with_sizes {
            input.sizes = sizing.wall_sizes().to_vec();
        }
        let before = input.points.len();
        let begin = Instant::now();
        let result = worker::run(input, &switches, options, cancel);
        let seconds = begin.elapsed().as_secs_f64();
        let failure = match result {
            Ok(out) => {
                let points: Vec<Point> = out.points.iter().map(|&p| Point::from(p)).collect();
                if points.len() as u64 >= before as u64 + budget {
                    Some(format!("the budget of {budget} added points was used up"))
                } else if let Some(fault) = check::filled(surface, &points, &out.tets) {
                    Some(fault)
                } else {
                    attempts.push(Attempt { name, switches, seconds, failure: None });
                    return Ok((points, out.tets, attempts));
                }
            }
            Err(WorkerError::Cancelled) => return Err(Error::Cancelled),
            Err(e @ WorkerError::Start { .. }) => return Err(Error::Start(e)),
            Err(e) => {
                // A time limit only fails: what mesh comes out must not depend on the machine's speed.
                let last = matches!(e, WorkerError::TimeLimit { .. });
                let failure = Some(e.to_string());
                if last {
                    attempts.push(Attempt { name, switches, seconds, failure });
                    return Err(Error::TetGen { attempts, triangles: surface.triangles.len(), places: vec![] });
                }
                failure
            }
        };
        attempts.push(Attempt { name, switches, seconds, failure });
    }
    Err(Error::TetGen { attempts, triangles: surface.triangles.len(), places: check::doubtful(surface) })
}
