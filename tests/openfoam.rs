//! What OpenFOAM itself says about our meshes, measures and cases. Skipped aloud where it is not installed.

#[path = "common/foam.rs"]
mod foam;
#[path = "common/tube.rs"]
mod shapes;

use std::fs;
use std::path::Path;

use lumenmesh::flow::{FlowOptions, FlowPlan, Inflow, Viscosity};
use lumenmesh::io::{fluent, openfoam};
use lumenmesh::mesh::VolumeMesh;
use lumenmesh::mesh::faces::FaceList;
use lumenmesh::quality::{self, VolumeOptions};

fn case(folder: &Path, mesh: &VolumeMesh, options: &FlowOptions) -> FlowPlan {
    let faces = FaceList::build(mesh).unwrap();
    let plan = FlowPlan::resolve(options, &faces).unwrap();
    openfoam::write_case(folder, &faces, options, &plan).unwrap();
    plan
}

/// Moves inner vertices about, the same way every time.
fn shaken(mut mesh: VolumeMesh, by: f64) -> VolumeMesh {
    let mut outer = vec![false; mesh.points.len()];
    mesh.boundary.iter().flat_map(|b| b.vertices).for_each(|v| outer[v as usize] = true);
    for (i, p) in mesh.points.iter_mut().enumerate().filter(|(i, _)| !outer[*i]) {
        let wave = |k: f64| (i as f64 * k).sin() * by;
        *p += lumenmesh::geometry::Vector::new(wave(12.9898), wave(78.233), wave(37.719));
    }
    mesh
}

#[test]
fn our_measures_are_checkmeshs_to_all_printed_digits() {
    let meshes = [shapes::tube(2.0, 6.0, 3, 6, false), shaken(shapes::tube(2.0, 6.0, 4, 9, false), 0.09), shaken(shapes::tube(2.0, 6.0, 3, 8, true), 0.04)];
    for (k, mesh) in meshes.iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        case(folder.path(), mesh, &FlowOptions::default());
        let Some((_, log)) = foam::run(folder.path(), "checkMesh", &["-allGeometry", "-allTopology"]) else { return };
        let q = quality::volume(mesh, &VolumeOptions::default()).unwrap();
        let f = &q.openfoam;
        let mut wrong = vec![];
        let mut check = |name: &str, value: f64, key: &str| {
            let text = foam::printed(&log, key);
            if !foam::same_digits(value, text) {
                wrong.push(format!("{name}: ours {value:.9}, checkMesh {text}"));
            }
        };
        check("aspect ratio", f.max_aspect_ratio, "Max aspect ratio =");
        check("face area", f.min_face_area * 1e-6, "Minimum face area =");
        check("face area", f.max_face_area * 1e-6, "Maximum face area =");
        check("volume", f.min_volume * 1e-9, "Min volume =");
        check("volume", f.max_volume * 1e-9, "Max volume =");
        check("volume", f.total_volume * 1e-9, "Total volume =");
        check("non-orthogonality", f.non_orthogonality_max, "Mesh non-orthogonality Max:");
        check("non-orthogonality", f.non_orthogonality_average, "average:");
        check("skewness", f.skewness_max, "Max skewness =");
        check("determinant", f.determinant_min, "Cell determinant (wellposedness) : minimum:");
        let after = |key: &str| log.find(key).map_or("", |i| &log[i..]);
        let mut check_after = |name: &str, value: f64, start: &str, key: &str| {
            let text = foam::printed(after(start), key);
            if !foam::same_digits(value, text) {
                wrong.push(format!("{name}: ours {value:.9}, checkMesh {text}"));
            }
        };
        check_after("determinant", f.determinant_average, "Cell determinant (", "average:");
        check_after("weight", f.weight_min, "Face interpolation weight :", "minimum:");
        check_after("weight", f.weight_average, "Face interpolation weight :", "average:");
        check_after("volume ratio", f.volume_ratio_min, "Face volume ratio :", "minimum:");
        check_after("volume ratio", f.volume_ratio_average, "Face volume ratio :", "average:");
        if let (Some(min), Some(average)) = (f.min_flatness, f.average_flatness) {
            check_after("flatness", min, "Face flatness", "min =");
            check_after("flatness", average, "Face flatness", "average =");
        }
        let count = |key: &str| if log.contains(key) { foam::printed(after(key), "number of cells:").parse().unwrap() } else { 0usize };
        assert_eq!(f.determinant_under_0001, count("***Cells with small determinant"), "mesh {k}");
        assert_eq!(f.concave_cells, count("***Concave cells"), "mesh {k}:\n{log}");
        assert!(wrong.is_empty(), "mesh {k}: {wrong:#?}\n{log}");
        assert_eq!(f.mesh_ok(true), log.contains("Mesh OK"), "mesh {k}:\n{log}");
    }
}

#[test]
fn a_tube_of_prisms_obeys_poiseuilles_law() {
    let (radius, length) = (2.0, 16.0);
    let mesh = shapes::tube(radius, length, 5, 24, true);
    let folder = tempfile::tempdir().unwrap();
    let options = FlowOptions { inflow: Inflow::Reynolds(50.0), ..FlowOptions::default() };
    let plan = case(folder.path(), &mesh, &options);
    assert!((plan.openings[0].reynolds.unwrap() - 50.0).abs() < 1e-9);
    let Some((ok, log)) = foam::run(folder.path(), "./Allrun", &[]) else { return };
    if foam::run(folder.path(), "simpleFoam", &["-help"]).is_none() {
        return;
    }
    assert!(ok, "{log}");
    let log = fs::read_to_string(folder.path().join("log.simpleFoam")).unwrap();
    assert!(log.contains("SIMPLE solution converged"), "not converged:\n{}", &log[log.len().saturating_sub(2000)..]);
    let last = |name: &str| -> f64 {
        let text = fs::read_to_string(folder.path().join(format!("postProcessing/{name}/0/surfaceFieldValue.dat"))).unwrap();
        text.split_whitespace().last().unwrap().parse().unwrap()
    };
    // The mesh's own area: a polygon lies inside its circle.
    let area = plan.openings[0].area * 1e-6;
    let mu = options.viscosity.reference();
    let law = 8.0 * std::f64::consts::PI * mu * plan.total / (area * area) * length * 1e-3;
    let drop = (last("p_inlet") - last("p_outlet_1")) * options.density;
    assert!((drop / law - 1.0).abs() < 0.06, "pressure drop {drop} Pa, Poiseuille {law} Pa");
    assert!((last("phi_inlet") + plan.total).abs() < 1e-6 * plan.total, "the inlet's flow rate is exact");
    assert!((last("phi_outlet_1") - plan.total).abs() < 1e-4 * plan.total, "mass balance");
}

#[test]
fn both_fluent_converters_read_our_mesh_and_keep_the_names() {
    for prisms in [false, true] {
        let mesh = shapes::tube(2.0, 4.0, 3, 4, prisms);
        let faces = FaceList::build(&mesh).unwrap();
        for tool in ["fluentMeshToFoam", "fluent3DMeshToFoam"] {
            let folder = tempfile::tempdir().unwrap();
            case(folder.path(), &mesh, &FlowOptions::default());
            let path = folder.path().join("lumen.msh");
            fluent::write(&mut fs::File::create(&path).unwrap(), &mesh, &faces).unwrap();
            fs::remove_dir_all(folder.path().join("constant/polyMesh")).unwrap();
            let Some((ok, log)) = foam::run(folder.path(), tool, &["lumen.msh"]) else { return };
            assert!(ok, "{tool}: {log}");
            let boundary = fs::read_to_string(folder.path().join("constant/polyMesh/boundary")).unwrap();
            for name in ["wall", "inlet", "outlet_1"] {
                assert!(boundary.split_whitespace().any(|w| w == name), "{tool}: no patch {name} in\n{boundary}");
            }
            let Some((_, log)) = foam::run(folder.path(), "checkMesh", &[]) else { return };
            assert!(log.contains("Mesh OK"), "{tool}, prisms {prisms}: {log}");
            assert!(log.contains(&format!("cells:            {}", mesh.cell_count())), "{tool}: {log}");
        }
    }
}

#[test]
fn carreau_fluid_and_fixed_velocity_run_too() {
    let mesh = shapes::tube(2.0, 4.0, 3, 4, true);
    let folder = tempfile::tempdir().unwrap();
    let options = FlowOptions { inflow: Inflow::Velocity(0.1), viscosity: Viscosity::CARREAU, ..FlowOptions::default() };
    let plan = case(folder.path(), &mesh, &options);
    assert!((plan.openings[0].velocity.unwrap() - 0.1).abs() < 1e-12);
    let Some((ok, log)) = foam::run(folder.path(), "simpleFoam", &[]) else { return };
    assert!(ok && log.contains("SIMPLE solution converged"), "{log}");
}

#[test]
fn every_volume_format_reads_back_with_the_same_quality() {
    use lumenmesh::io::mesh::{AnyMesh, read};
    use lumenmesh::io::{gmsh, vtu};
    let mesh = shaken(shapes::tube(2.0, 6.0, 3, 6, false), 0.05);
    let faces = FaceList::build(&mesh).unwrap();
    let q = quality::volume(&mesh, &VolumeOptions::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let create = |name: &str| fs::File::create(at(name)).unwrap();
    vtu::write(&mut create("m.vtu"), &mesh, &q.per_cell, &Default::default()).unwrap();
    gmsh::write(&mut create("g.msh"), &mesh).unwrap();
    fluent::write(&mut create("f.msh"), &mesh, &faces).unwrap();
    openfoam::write_poly_mesh(&at("case"), &faces).unwrap();
    for name in ["m.vtu", "g.msh", "f.msh", "case"] {
        let back = match read(&at(name)).unwrap() {
            AnyMesh::Volume(m) => quality::volume(&m, &VolumeOptions::default()).unwrap(),
            AnyMesh::Polyhedral(m) => quality::polyhedral(&m, &VolumeOptions::default()),
            AnyMesh::Surface(_) => panic!("{name} is no surface"),
        };
        assert_eq!((back.cells, back.tets, back.nonpositive_cells), (q.cells, q.tets, 0), "{name}");
        assert!((back.sv_max - q.sv_max).abs() < 1e-9 && (back.sv_mean - q.sv_mean).abs() < 1e-9, "{name}");
        assert!((back.openfoam.non_orthogonality_max - q.openfoam.non_orthogonality_max).abs() < 1e-6, "{name}");
    }
    // Cut off anywhere, a file is an error and never a panic.
    for name in ["m.vtu", "g.msh", "f.msh"] {
        let whole = fs::read(at(name)).unwrap();
        for k in 1..12 {
            let path = at(&format!("cut_{name}"));
            fs::write(&path, &whole[..whole.len() * k / 13]).unwrap();
            assert!(read(&path).is_err(), "{name} cut after {k}/13");
        }
    }
}
