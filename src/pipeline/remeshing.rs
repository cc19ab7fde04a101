//! From polygons to a remeshed surface under the guidance field.

use super::error::Error;
use super::{Part, options};
use crate::centerline::Centerlines;
use crate::config::{Case, Remesher};
use crate::geometry::Point;
use crate::implicit::Implicit;
use crate::mask::Mask;
use crate::mesh::{self, TriMesh};
use crate::openings::Opening;
use crate::remesh::size_field::{EdgeLength, End, GuidanceField};
use crate::remesh::{self, SizeField, Stop, Supports};

/// The guidance field of a component.
pub(super) fn guidance(
    case: &Case,
    mask: &Mask,
    implicit: &dyn Implicit,
    polygons: &TriMesh,
    centerlines: &Centerlines,
    openings: &[Opening],
    share: f64,
) -> Result<(GuidanceField, remesh::size_field::Summary), remesh::Error> {
    let mut radii: Vec<(Point, f64)> = centerlines.branches.iter().flat_map(|b| &b.samples).map(|s| (s.point, s.radius)).collect();
    let [x, y, z] = mask.grid.spacing();
    let mut sorted: Vec<f64> = radii.iter().map(|r| r.1).collect();
    sorted.sort_by(f64::total_cmp);
    // Lengths of the whole case in R and D are taken at the median radius.
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(x);
    radii.retain(|r| r.1 > 0.0);
    let mut options = options::guidance(case, x.min(y).min(z), median);
    if let EdgeLength::TargetFaces(n) = &mut options.edge_length {
        *n = (share * *n as f64).round().max(4.0) as usize;
    }
    options.ends = openings.iter().map(|o| End { plane: o.plane, radius: o.radius }).collect();
    let wishes = options::patch_edge_lengths(case, x.min(y).min(z), median);
    if wishes.is_empty() {
        return GuidanceField::new(polygons, implicit, &radii, [x, y, z], &options);
    }
    let mut marked = polygons.clone();
    for (name, region, h) in wishes {
        // A patch that lies on another component is no fault here; one that lies nowhere is told of when it is made.
        if let Ok(id) = mesh::regions::mark(&mut marked, name, &region) {
            options.patches.push((id, h));
        }
    }
    GuidanceField::new(&marked, implicit, &radii, [x, y, z], &options)
}

/// The guidance field of a part with all lengths times `factor`.
pub(super) struct Rescaled {
    pub field: Box<dyn SizeField>,
    pub factor: f64,
}

impl SizeField for Rescaled {
    fn size(&self, p: &Point) -> f64 {
        self.factor * self.field.size(p)
    }
}

/// A remeshed surface and what its remesher says of it.
pub(super) struct Remeshed {
    pub mesh: TriMesh,
    pub summaries: Vec<(&'static str, serde_json::Value)>,
    pub front_fraction: Option<f64>,
}

/// Remeshes the polygons of a component and repairs angles, unless `stop` says so.
pub(super) fn triangles(case: &Case, remesher: Remesher, part: &Part, size: &dyn SizeField, stop: &Stop) -> Result<Remeshed, Error> {
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
    let unless_stopped = || if stop() { Err(Error::Interrupted) } else { Ok(()) };
    unless_stopped()?;
    let (mesh, summary) = remesh::angle_repair::repair_until(&made.mesh, &supports, size, &options::repair(case), stop)?;
    unless_stopped()?;
    made.summaries.push(("angle_repair", serde_json::json!(summary)));
    made.mesh = mesh;
    Ok(made)
}
