//! Advancing front on the implicit surface under the guidance field.
//!
//! After Schreiner, Scheidegger, Fleishman and Silva, "Direct (Re)Meshing for Efficient Surface Processing", 2006: a
//! front of edges sweeps over the surface; each step puts one triangle of the wished size on an edge, with a new vertex
//! projected to the implicit or one that the front already has, which cuts an ear, splits the front or merges two. Here
//! a step weighs all of these by one score, looks at its surroundings unrolled into the edge's tangent plane, and is
//! put off while only bad triangles are to be had. What the front cannot close is filled without new vertices, and a
//! component that does not come out closed and of the topology of the polygonized surface is given back as that.

mod fill;
mod grow;
mod state;

use rayon::prelude::*;
use serde::Serialize;

use crate::geometry::{Aabb, Point};
use crate::implicit::Implicit;
use crate::mesh::TriMesh;
use crate::mesh::topology::{check, triangle_components};

use super::SizeField;
use grow::{LAST_LEVEL, Scratch, Surface, attempt};
use state::Front;

/// How the front advances.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AdvancingFrontOptions {
    /// A component is given up when it has this many times the triangles that its area and the field ask for.
    pub runaway: f64,
    /// Largest relative change of a component's area against the polygonized surface's, beyond the chord error's share.
    pub area_tolerance: f64,
    /// Attempts at a component before it falls back, each from another seed: factors on the wished edge length.
    pub attempts: Vec<f64>,
}

impl Default for AdvancingFrontOptions {
    fn default() -> AdvancingFrontOptions {
        AdvancingFrontOptions { runaway: 3.0, area_tolerance: 0.25, attempts: vec![1.0, 1.0, 0.8, 0.6] }
    }
}

/// Why a component was given back as the polygonized surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FallbackReason {
    /// No triangle could be started: the gradient vanishes or the wished edge length exceeds the component.
    NoSeed,
    /// The front made far more triangles than asked for.
    Runaway,
    /// A loop could not be closed.
    OpenLoop,
    /// Closed, but not a manifold of the polygonized surface's topology and area.
    Topology,
}

/// A component that keeps the polygonized surface's triangles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Fallback {
    /// A point of the component, mm.
    pub at: Point,
    /// Number of its triangles.
    pub triangles: usize,
    /// Why.
    pub reason: FallbackReason,
}

/// What the front did.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct AdvancingFrontSummary {
    /// Triangles of the result.
    pub triangles: usize,
    /// Share of them that the front made; the rest filled holes or fell back.
    pub front_fraction: f64,
    /// Triangles put on by the front.
    pub front_triangles: usize,
    /// Holes filled without new vertices.
    pub holes: usize,
    /// Triangles in these.
    pub hole_triangles: usize,
    /// Triangles that were accepted by a lenient attempt, by leniency.
    pub by_leniency: [usize; LAST_LEVEL as usize + 1],
    /// Components that took more than one attempt.
    pub retried: usize,
    /// Components that keep the polygonized surface's triangles.
    pub fallbacks: Vec<Fallback>,
}

/// Why no surface was made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AdvancingFrontError {
    /// The polygonized surface is not a closed oriented manifold.
    #[error("the surface to remesh is not a closed, oriented 2-manifold near {at:?} mm: give a surface from the polygonizer")]
    NotClosed {
        /// Where the first fault lies.
        at: Option<[f64; 3]>,
    },
    /// The guidance field is zero, negative or not a number somewhere.
    #[error("the wished edge length is {size} mm at {at:?} mm: it must be finite and above zero everywhere")]
    Size {
        /// The field's value.
        size: f64,
        /// Where.
        at: [f64; 3],
    },
}

/// Meshes the zero set of `implicit` by an advancing front with edge lengths after `size`.
///
/// `background` is the polygonized surface: it says which components there are, where they start, and what topology
/// the result must have. The result is closed, oriented and 2-manifold, has the same components and Euler
/// characteristics, and its vertices lie on the zero set to 1e-9 of an edge where Newton's method gets there.
/// Triangle quality is *not* bounded and freedom from self-intersection is not proven: angle repair and the gate follow.
/// Components run in parallel; the result does not depend on the number of threads.
///
/// # Errors
/// [`AdvancingFrontError`]: a background that is no closed manifold, or a field that is not positive. A component that
/// cannot be meshed is no error: it keeps the background's triangles and stands in the summary.
pub fn remesh(
    background: &TriMesh,
    implicit: &dyn Implicit,
    size: &dyn SizeField,
    options: &AdvancingFrontOptions,
) -> Result<(TriMesh, AdvancingFrontSummary), AdvancingFrontError> {
    let topology = check(background);
    if !topology.is_closed_manifold() {
        return Err(AdvancingFrontError::NotClosed { at: topology.first_fault(background).map(Into::into) });
    }
    let sizes: Vec<f64> = background.points.par_iter().map(|p| size.size(p)).collect();
    if let Some(v) = sizes.iter().position(|s| !(s.is_finite() && *s > 0.0)) {
        return Err(AdvancingFrontError::Size { size: sizes[v], at: background.points[v].into() });
    }
    let (labels, count) = triangle_components(background);
    let mut parts: Vec<Vec<[u32; 3]>> = vec![Vec::new(); count];
    for (t, l) in background.triangles.iter().zip(&labels) {
        parts[*l as usize].push(*t);
    }
    let surface = Surface { implicit, size };
    let results: Vec<Part> = parts
        .par_iter()
        .map(|triangles| Part::mesh(&submesh(background, &sizes, triangles), &surface, options))
        .collect();

    let mut summary = AdvancingFrontSummary::default();
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for part in results {
        let base = points.len() as u32;
        triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + base)));
        points.extend(part.points);
        summary.front_triangles += part.by_front;
        summary.holes += part.holes;
        summary.hole_triangles += part.by_filling;
        summary.by_leniency.iter_mut().zip(part.by_leniency).for_each(|(s, n)| *s += n);
        summary.retried += usize::from(part.retried);
        summary.fallbacks.extend(part.fallback);
    }
    summary.triangles = triangles.len();
    summary.front_fraction = summary.front_triangles as f64 / triangles.len().max(1) as f64;
    Ok((TriMesh::new(points, triangles), summary))
}

/// A component of the background with ids of its own.
struct Component {
    mesh: TriMesh,
    sizes: Vec<f64>,
}

fn submesh(mesh: &TriMesh, sizes: &[f64], triangles: &[[u32; 3]]) -> Component {
    let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let id = |v: u32| used.partition_point(|&u| u < v) as u32;
    let triangles = triangles.iter().map(|t| t.map(id)).collect();
    let points = used.iter().map(|&v| mesh.points[v as usize]).collect();
    Component { mesh: TriMesh::new(points, triangles), sizes: used.iter().map(|&v| sizes[v as usize]).collect() }
}

/// A meshed component.
#[derive(Default)]
struct Part {
    points: Vec<Point>,
    triangles: Vec<[u32; 3]>,
    by_front: usize,
    by_filling: usize,
    holes: usize,
    by_leniency: [usize; LAST_LEVEL as usize + 1],
    retried: bool,
    fallback: Option<Fallback>,
}

/// A field times a factor.
struct Scaled<'a> {
    field: &'a dyn SizeField,
    scale: f64,
}

impl SizeField for Scaled<'_> {
    fn size(&self, p: &Point) -> f64 {
        self.scale * self.field.size(p)
    }
}

impl Part {
    fn mesh(component: &Component, surface: &Surface, options: &AdvancingFrontOptions) -> Part {
        let mut attempts = options.attempts.iter().enumerate().map(|(n, &a)| advance(component, surface, options, n, a));
        let first = attempts.next().unwrap_or(Err(FallbackReason::NoSeed));
        let best = first.or_else(|reason| attempts.find_map(Result::ok).ok_or(reason));
        match best {
            Ok(part) => part,
            Err(reason) => {
                let m = &component.mesh;
                let at = m.points[m.triangles[0][0] as usize];
                Part {
                    points: m.points.clone(),
                    triangles: m.triangles.clone(),
                    fallback: Some(Fallback { at, triangles: m.triangles.len(), reason }),
                    ..Part::default()
                }
            }
        }
    }
}

/// One attempt at a component: from seed number `start`, with `scale` times the wished edge length.
fn advance(
    component: &Component,
    surface: &Surface,
    options: &AdvancingFrontOptions,
    start: usize,
    scale: f64,
) -> Result<Part, FallbackReason> {
    let scaled = Scaled { field: surface.size, scale };
    let surface = &Surface { implicit: surface.implicit, size: &scaled };
    let background = &component.mesh;
    let smallest = scale * component.sizes.iter().copied().fold(f64::INFINITY, f64::min);
    let expected: f64 = (0..background.triangles.len())
        .map(|t| {
            let h = scale * background.triangles[t].iter().map(|&v| component.sizes[v as usize]).sum::<f64>() / 3.0;
            0.5 * background.area_vector2(t).norm() / (0.433 * h * h)
        })
        .sum();
    let limit = (options.runaway * expected) as usize + 1000;
    let mut front = Front::new(Aabb::of(&background.points).center(), 0.6 * smallest);
    seed(&mut front, component, surface, start).ok_or(FallbackReason::NoSeed)?;

    let mut part = Part { by_front: 1, retried: start > 0, ..Part::default() };
    let mut scratch = Scratch::default();
    while let Some(i) = front.pop() {
        let level = front.node(i).level;
        if attempt(&mut front, surface, i, &mut scratch) {
            part.by_front += 1;
            part.by_leniency[level as usize] += 1;
            if front.triangles.len() > limit {
                return Err(FallbackReason::Runaway);
            }
        } else if level < LAST_LEVEL {
            front.queue(i, level + 1);
        }
    }
    for hole in front.loops() {
        let before = front.triangles.len();
        if !fill::fill(&mut front, &hole) {
            return Err(FallbackReason::OpenLoop);
        }
        part.holes += 1;
        part.by_filling += front.triangles.len() - before;
    }
    let mesh = TriMesh::new(front.points, front.triangles);
    let (found, wished) = (check(&mesh), check(background));
    let area = mesh.area() / background.area();
    let alike = found.is_closed_manifold()
        && found.euler == wished.euler
        && found.components == 1
        && (area - 1.0).abs() <= options.area_tolerance;
    if !alike {
        return Err(FallbackReason::Topology);
    }
    part.points = mesh
        .points
        .par_iter()
        .zip(&front.sizes)
        .map(|(p, h)| surface.project(p, 0.1 * h, 1e-9 * h).map_or(*p, |q| q.0))
        .collect();
    part.triangles = mesh.triangles;
    Ok(part)
}

/// A first triangle at the first of 64 vertices of the background where one can be made; `start` shifts the order.
fn seed(front: &mut Front, component: &Component, surface: &Surface, start: usize) -> Option<()> {
    let n = component.mesh.points.len();
    let tries = n.min(64);
    for k in 0..tries {
        let v = (k + start * tries / 4) % tries * n / tries;
        let h = surface.size.size(&component.mesh.points[v]);
        let Some((p, normal)) = surface.project(&component.mesh.points[v], 0.5 * h, 1e-6 * h) else { continue };
        let plane = crate::geometry::Plane { origin: p, normal };
        let (u, w) = plane.basis();
        let other = |d: crate::geometry::Vector| surface.project(&(p + d * h), 0.6 * h, 1e-6 * h);
        let (Some(q), Some(r)) = (other(u), other(0.5 * u + 0.75f64.sqrt() * w)) else { continue };
        let corners = [(p, normal), q, r];
        if grow::shape(&p, &q.0, &r.0) < 0.6 || corners.iter().any(|c| c.1.dot(&normal) < 0.5) {
            continue;
        }
        let ids = corners.map(|(p, n)| front.add_vertex(p, n, surface.size.size(&p)));
        front.add_triangle(ids);
        front.add_loop(&[ids[1], ids[0], ids[2]]);
        return Some(());
    }
    None
}

#[cfg(test)]
mod tests;
