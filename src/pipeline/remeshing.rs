//! From polygons to a remeshed surface under the guidance field.

use super::error::Error;
use super::{Part, options};
use crate::centerline::Centerlines;
use crate::config::{Case, Remesher};
use crate::geometry::Point;
use crate::implicit::Implicit;
use crate::mask::Mask;
use crate::mesh::TriMesh;
use crate::remesh::size_field::GuidanceField;
use crate::remesh::{self, SizeField, Supports};

/// The guidance field of a component.
pub(super) fn guidance(
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

/// A remeshed surface and what its remesher says of it.
pub(super) struct Remeshed {
    pub mesh: TriMesh,
    pub summaries: Vec<(&'static str, serde_json::Value)>,
    pub front_fraction: Option<f64>,
}

/// Remeshes the polygons of a component and repairs angles.
pub(super) fn triangles(case: &Case, remesher: Remesher, part: &Part, size: &dyn SizeField) -> Result<Remeshed, Error> {
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
