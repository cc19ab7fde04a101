//! The gates of the contract, each a figure held against its limit.

use crate::config::Case;
use crate::mask::Topology;
use crate::mesh::topology::TopologyReport;
use crate::mesh::PatchKind;
use crate::openings::{FoundBy, Opening, OpeningMeasure};
use crate::quality::fidelity::{Fidelity, LostLength};
use crate::quality::{SurfaceQuality, VolumeQuality};
use crate::report::{Gate, Limit, Report};

/// Closedness, self-intersection, topology, equi-angle skewness.
pub fn surface(report: &mut Report, case: &Case, topology: &TopologyReport, crossings: usize, quality: &SurfaceQuality, mask: &Topology) {
    let faults = topology.open_edges
        + topology.nonmanifold_edges
        + topology.inconsistent_edges
        + topology.nonmanifold_vertices
        + topology.degenerate_triangles
        + crossings;
    let s = &case.surface;
    report.gate(Gate::hard(
        "surface closed, oriented, 2-manifold, free of self-intersection (violations)",
        faults as f64,
        Limit::Exactly(0.0),
    ));
    report.gate(Gate::hard("equi-angle skewness, max over all triangles", quality.s_max, Limit::Below(s.max_skewness)));
    let worst = |wall: bool| {
        let patches = quality.patches.iter().filter(|p| (p.id == crate::mesh::WALL) == wall);
        patches.map(|p| p.s_max).fold(0.0, f64::max)
    };
    report.gate(Gate::advisory("equi-angle skewness aimed at, wall and rims", worst(true), Limit::AtMost(s.target_skewness)));
    report.gate(Gate::advisory("equi-angle skewness aimed at, caps", worst(false), Limit::AtMost(super::options::skewness_targets(case)[1])));
    report.gate(Gate::hard(
        "Euler characteristic of the surface = 2 × that of the cleaned mask",
        topology.euler as f64,
        Limit::Exactly(2.0 * mask.euler as f64),
    ));
    report.gate(Gate::hard(
        "components of the surface = components of the cleaned mask",
        topology.components as f64,
        Limit::Exactly(mask.components as f64),
    ));
}

/// Distance to the mask and lost length.
pub fn fidelity(report: &mut Report, case: &Case, fidelity: &Fidelity, lost: &LostLength) {
    let max = fidelity.to_marching_cubes.voxel_diagonals.max.max(fidelity.from_marching_cubes.voxel_diagonals.max);
    report.gate(Gate::hard("distance to the mask's boundary, max (voxel diagonals)", max, Limit::AtMost(case.gates.max_distance)));
    report.gate(Gate::hard("lost length, part of the centerline", lost.fraction, Limit::AtMost(case.gates.lost_length)));
}

/// What the openings are held against.
pub struct Ends<'a> {
    /// The caps as they were made.
    pub measures: &'a [OpeningMeasure],
    /// The openings as they were cut, without those that carry an extension.
    pub cut: &'a [Opening],
    /// Ends with a flat face or at the border that could not be cut open.
    pub left_closed: usize,
    /// Whether the mask shows any end.
    pub evidence: bool,
    /// Diagonal of the bounding box, mm.
    pub diagonal: f64,
    /// Largest voxel edge, mm.
    pub voxel: f64,
}

/// Openings: at least one of each where the mask shows an end, caps planar, and as large as what they stand for.
pub fn openings(report: &mut Report, case: &Case, ends: &Ends) {
    let Ends { measures, cut, .. } = ends;
    let inlets = measures.iter().filter(|m| m.kind == PatchKind::Inlet).count();
    let both: fn(&str, f64, Limit) -> Gate = if ends.evidence { Gate::hard } else { Gate::advisory };
    report.gate(both("inlets", inlets as f64, Limit::AtLeast(1.0)));
    report.gate(both("outlets", (measures.len() - inlets) as f64, Limit::AtLeast(1.0)));
    let planarity = measures.iter().map(|m| m.planarity).fold(0.0, f64::max) / ends.diagonal;
    report.gate(Gate::hard("caps planar (part of the bounding box)", planarity, Limit::AtMost(case.gates.cap_planarity)));
    report.gate(Gate::hard("ends with a flat face or at the border that could not be opened", ends.left_closed as f64, Limit::Exactly(0.0)));
    let unlike = |o: &Opening| {
        let (m, expected) = (measures.iter().find(|m| m.id == o.id)?, o.support.expected_area?);
        let part = if o.found_by == FoundBy::BluntEnd { 0.3 } else { 0.1 };
        // Half a voxel round the rim is what the mask itself leaves open.
        Some((m.area - expected).abs() / (part * expected).max(0.5 * ends.voxel * m.perimeter))
    };
    let worst = cut.iter().filter_map(unlike).fold(0.0, f64::max);
    report.gate(Gate::hard("openings: area off the face, rim or section that each stands for (1 is what is allowed)", worst, Limit::AtMost(1.0)));
}

/// Volume of the result against that of the part of the mask that was kept; `allowed` is what a small part of a voxel over the
/// whole wall makes.
pub fn volume_ratio(report: &mut Report, ratio: f64, allowed: f64) {
    report.gate(Gate::hard("volume off that of the mask's kept part (part of it)", (ratio - 1.0).abs(), Limit::AtMost(allowed.max(0.03))));
}

/// Cells, skewness, OpenFOAM's measures.
pub fn volume(report: &mut Report, case: &Case, q: &VolumeQuality, boundary_faults: usize) {
    let g = &case.gates;
    report.gate(Gate::hard("cells not positive, boundary faces unlike the surface's (violations)", (q.nonpositive_cells + boundary_faults) as f64, Limit::Exactly(0.0)));
    report.gate(Gate::hard("equi-volume skewness, max over all tetrahedra", q.sv_max, Limit::Below(g.max_volume_skewness)));
    let aim = if q.prisms > 0 { 0.85 } else { 0.80 };
    report.gate(Gate::advisory("equi-volume skewness aimed at, max", q.sv_max, Limit::AtMost(aim)));
    report.gate(Gate::advisory("equi-volume skewness aimed at, mean", q.sv_mean, Limit::AtMost(0.28)));
    if let (Some(least), Some(largest)) = (q.min_dihedral, q.max_dihedral) {
        report.gate(Gate::advisory("dihedral angle of a tetrahedron aimed at, least (degrees)", least, Limit::AtLeast(15.0)));
        report.gate(Gate::advisory("dihedral angle of a tetrahedron aimed at, largest (degrees)", largest, Limit::AtMost(155.0)));
    }
    report.gate(Gate::advisory("FLUENT orthogonal quality aimed at, min", q.fluent.orthogonal_quality_min, Limit::AtLeast(0.15)));
    let f = &q.openfoam;
    report.gate(Gate::hard("OpenFOAM non-orthogonality, max (degrees)", f.non_orthogonality_max, Limit::AtMost(g.max_non_orthogonality)));
    report.gate(Gate::advisory("OpenFOAM non-orthogonality aimed at, max (degrees)", f.non_orthogonality_max, Limit::AtMost(65.0)));
    report.gate(Gate::hard("OpenFOAM skewness, max", f.skewness_max, Limit::Below(g.max_openfoam_skewness)));
    report.gate(Gate::hard("OpenFOAM cell determinant, min", f.determinant_min, Limit::AtLeast(g.min_determinant)));
}
