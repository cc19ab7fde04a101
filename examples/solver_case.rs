//! A volume mesh from elsewhere as a complete OpenFOAM case, in twenty lines.
//!
//! cargo run --release --example solver_case -- MESH.msh CASE_FOLDER [FLOW_RATE_ML_PER_S]
//!
//! The mesh is in millimetres and names its patches: Gmsh with physical groups, or VTU with boundary faces and
//! `CellEntityIds`. Patches called inlet… and outlet… become such, all others wall.

use std::path::Path;

use lumenmesh::flow::{FlowOptions, FlowPlan, Inflow};
use lumenmesh::io::mesh::{AnyMesh, read};
use lumenmesh::io::openfoam;
use lumenmesh::mesh::faces::FaceList;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [mesh, case, rest @ ..] = &arguments[..] else { return Err("usage: solver_case MESH CASE_FOLDER [ML_PER_S]".into()) };
    let AnyMesh::Volume(mesh) = read(Path::new(mesh))? else { return Err("the file holds no tetrahedra or prisms".into()) };
    let faces = FaceList::build(&mesh)?;
    let mut flow = FlowOptions::default();
    if let [rate, ..] = rest {
        flow.inflow = Inflow::FlowRate(rate.parse::<f64>()? * 1e-6);
    }
    let plan = FlowPlan::resolve(&flow, &faces)?;
    openfoam::write_case(Path::new(case), &faces, &flow, &plan)?;
    plan.warnings.iter().for_each(|w| eprintln!("warning: {w}"));
    Ok(())
}
