//! `lumenmesh check`: the quality report of any mesh, ours or not, held against the same gates.

use super::args::CheckArgs;
use super::exit::{self, Failure};
use crate::config::Gates;
use crate::io::mesh::{self, AnyMesh};
use crate::mesh::{intersect, topology};
use crate::quality::{self, VolumeQuality};
use crate::report::{Gate, Limit, Report, Status};

/// `lumenmesh check FILE…`
pub fn run(args: &CheckArgs) -> Result<u8, Failure> {
    let mut worst = 0;
    for file in &args.files {
        let mesh = mesh::read(file).map_err(|e| Failure::new(exit::INPUT, e))?;
        let report = report(&mesh).map_err(|e| Failure::new(exit::GEOMETRY, anyhow::anyhow!("{}: {e}", file.display())))?;
        if args.json {
            print!("{}", report.to_json());
        } else {
            println!("{}", file.display());
            for g in &report.gates {
                let verdict = if g.passed { "met     " } else if g.hard { "MISSED  " } else { "advisory" };
                println!("  {verdict} {}: {} (limit {})", g.name, g.value, g.limit);
            }
        }
        if report.status == Status::GateMissed {
            worst = exit::GATE;
        }
    }
    Ok(worst)
}

fn report(mesh: &AnyMesh) -> Result<Report, crate::mesh::faces::FaceError> {
    let mut r = Report::default();
    let limits = Gates::default();
    match mesh {
        AnyMesh::Surface(s) => {
            let q = quality::surface(s, &Default::default());
            let t = topology::check(s);
            let crossings = intersect::self_intersections(s).len();
            let faults = t.open_edges + t.nonmanifold_edges + t.inconsistent_edges + t.nonmanifold_vertices + t.degenerate_triangles;
            r.put("surface", &q);
            r.put_in("surface", "topology", &t);
            r.gate(Gate::hard("surface closed, oriented, 2-manifold (violations)", faults as f64, Limit::Exactly(0.0)));
            r.gate(Gate::hard("self-intersections", crossings as f64, Limit::Exactly(0.0)));
            r.gate(Gate::hard("equi-angle skewness, max", q.s_max, Limit::Below(q.limit)));
            r.gate(Gate::advisory("equi-angle skewness aimed at, max", q.s_max, Limit::AtMost(0.45)));
        }
        AnyMesh::Volume(v) => volume(&mut r, &limits, &quality::volume(v, &Default::default())?),
        AnyMesh::Polyhedral(p) => volume(&mut r, &limits, &quality::polyhedral(p, &Default::default())),
    }
    Ok(r)
}

fn volume(r: &mut Report, g: &Gates, q: &VolumeQuality) {
    r.put("volume", q);
    r.gate(Gate::hard("cells not positive", q.nonpositive_cells as f64, Limit::Exactly(0.0)));
    if q.tets > 0 {
        r.gate(Gate::hard("equi-volume skewness, max", q.sv_max, Limit::Below(g.max_volume_skewness)));
        r.gate(Gate::advisory("equi-volume skewness, mean", q.sv_mean, Limit::AtMost(0.28)));
    }
    let f = &q.openfoam;
    r.gate(Gate::hard("OpenFOAM non-orthogonality, max (degrees)", f.non_orthogonality_max, Limit::AtMost(g.max_non_orthogonality)));
    r.gate(Gate::hard("OpenFOAM skewness, max", f.skewness_max, Limit::Below(g.max_openfoam_skewness)));
    r.gate(Gate::hard("OpenFOAM cell determinant, min", f.determinant_min, Limit::AtLeast(g.min_determinant)));
    r.gate(Gate::advisory("FLUENT orthogonal quality, min", q.fluent.orthogonal_quality_min, Limit::AtLeast(0.15)));
}
