//! `lumenmesh check`: the quality report of any mesh, held against the same gates.

use std::path::Path;

use super::args::CheckArgs;
use super::exit::{self, Failure};
use crate::config::Gates;
use crate::io::mesh::{self, AnyMesh};
use crate::mesh::{intersect, topology};
use crate::quality::{self, VolumeQuality};
use crate::report::{Gate, Limit, Report, Status};

/// `lumenmesh check FILE…`: every file is looked at; the code is that of the worst, an unreadable one first.
pub fn run(args: &CheckArgs) -> Result<u8, Failure> {
    let (mut missed, mut failed) = (false, None::<Failure>);
    for file in &args.files {
        let report = match checked(file) {
            Ok(report) => report,
            Err(e) if args.files.len() == 1 => return Err(e),
            Err(e) => {
                eprintln!("error: {}", e.message());
                failed = failed.or(Some(e));
                continue;
            }
        };
        if args.json {
            say!("{}", report.to_json().trim_end());
        } else {
            say!("{}: {}", file.display(), facts(&report));
            for w in &report.warnings {
                say!("  warning  {}", w.message);
            }
            for g in &report.gates {
                let verdict = if g.passed { "met     " } else if g.hard { "MISSED  " } else { "advisory" };
                say!("  {verdict} {}: {} (limit {})", g.name, crate::report::rounded(g.value), g.limit);
            }
        }
        missed |= report.status == Status::GateMissed;
    }
    match failed {
        Some(e) => Ok(e.code()),
        None => Ok(if missed { exit::GATE } else { 0 }),
    }
}

fn checked(file: &Path) -> Result<Report, Failure> {
    let case = file.join("openfoam/constant/polyMesh");
    if case.is_dir() && !file.join("constant").exists() && !file.join("points").exists() {
        return Err(Failure::new(
            exit::INPUT,
            anyhow::anyhow!("{}: is a folder of results: name the mesh in it, such as {} or {}", file.display(), file.join("openfoam").display(), file.join("volume/lumen.vtu").display()),
        ));
    }
    super::kind::is_mesh(file)?;
    let mesh = mesh::read(file).map_err(|e| Failure::new(exit::INPUT, e))?;
    let mut r = report(&mesh).map_err(|e| Failure::new(exit::GEOMETRY, anyhow::anyhow!("{}: {e}", file.display())))?;
    let metres = mesh::is_in_metres(file);
    let size = mesh.size();
    if metres {
        r.units.length = "m";
    }
    r.put("file", &serde_json::json!({"name": file.display().to_string(), "size": size, "patches": mesh.patches()}));
    // Solver files are in metres, all others in millimetres; a vessel tree is between 1 mm and 2 m long.
    let mm = if metres { 1000.0 * size } else { size };
    if mm > 0.0 && !(1.0..=2000.0).contains(&mm) {
        let unit = r.units.length;
        r.warn("units", format!("the mesh is {size:.4} {unit} across if its unit is the format's usual {unit}: is it in another unit?"));
    }
    Ok(r)
}

/// What the mesh is, in a line.
fn facts(r: &Report) -> String {
    let number = |section: &str, key: &str| r.sections.get(section).and_then(|s| s.get(key)).cloned().unwrap_or_default();
    let patches = r.sections.get("file").and_then(|f| f.get("patches")).and_then(|p| p.as_array()).into_iter().flatten();
    let patches: Vec<String> = patches.filter_map(|p| Some(format!("{} {}", p.get("name")?.as_str()?, p.get("faces")?))).collect();
    let cells = match r.sections.contains_key("volume") {
        true => format!("{} cells ({} tetrahedra, {} prisms)", number("volume", "cells"), number("volume", "tets"), number("volume", "prisms")),
        false => format!("{} triangles", number("surface", "faces")),
    };
    format!("{cells}; faces: {}", patches.join(", "))
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
