//! From a closed, patched surface to a volume mesh, with the library alone:
//! `cargo run --release --example surface_to_volume -- SURFACE [--layers N] [--target-cells N] [--sizes FRACTION_OF_R]
//! [--raw] [--openfoam DIR] [--vtu FILE]`.
//!
//! Prints one JSON object with what was done and every measure. `--raw` leaves TetGen's tetrahedra as they are. The
//! program is its own TetGen worker, as any program that uses the library can be.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

use lumenmesh::io::mesh::{AnyMesh, read};
use lumenmesh::io::{openfoam, vtu};
use lumenmesh::mesh::faces::FaceList;
use lumenmesh::quality;
use lumenmesh::remesh::Uniform;
use lumenmesh::volume::{BuildOptions, LayerOptions, build, worker};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if args.first().is_some_and(|a| a == worker::ARGUMENT) {
        std::process::exit(worker::serve());
    }
    let Some(path) = args.first() else { return Err("usage: surface_to_volume SURFACE [options]".into()) };
    let given = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let AnyMesh::Surface(surface) = read(Path::new(path))? else { return Err("not a surface".into()) };

    let mut options = BuildOptions::default();
    if let Some(n) = given("--layers") {
        options.layers = Some(LayerOptions { count: n.parse()?, ..LayerOptions::default() });
    }
    if let Some(n) = given("--target-cells") {
        options.fill.sizing.target_cells = Some(n.parse()?);
    }
    if let Some(x) = given("--sizes") {
        options.fill.sizing.radius_fraction = x.parse()?;
    }
    if args.iter().any(|a| a == "--raw") {
        options.optimise = None;
    }
    let begin = Instant::now();
    // No guidance field here: sizes start from the surface's own edges.
    let (mesh, summary) = build(&surface, &Uniform(f64::NAN), &options, None)?;
    let seconds = begin.elapsed().as_secs_f64();

    let faces = FaceList::build(&mesh)?;
    let q = quality::volume_of_faces(&mesh, &faces, &quality::VolumeOptions::default());
    if let Some(dir) = given("--openfoam") {
        openfoam::write_poly_mesh(&PathBuf::from(dir), &faces)?;
    }
    if let Some(file) = given("--vtu") {
        vtu::write(&mut std::io::BufWriter::new(std::fs::File::create(file)?), &mesh, &q.per_cell, &Default::default())?;
    }
    let times = serde_json::json!({
        "all": seconds,
        "tetgen": summary.fill.attempts.iter().map(|a| a.seconds).sum::<f64>(),
        "optimiser": summary.optimise.as_ref().map_or(0.0, |o| o.seconds),
    });
    let out = serde_json::json!({"seconds": times, "build": summary, "quality": q});
    println!("{}", serde_json::to_string_pretty(&out)?);
    Ok(())
}
