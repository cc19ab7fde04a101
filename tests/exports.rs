//! From a mask to a finished solver run with no edit by hand, and every export through somebody else's reader.
//! Skipped aloud where a reader is not installed.

#[path = "common/foam.rs"]
mod foam;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

const EXPORTS: &str = "exports=[vtk, stl, ply, openfoam, fluent, gmsh, simvascular, vmtk]";

fn lumenmesh(args: &[&str], dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumenmesh")).args(args).current_dir(dir).output().expect("the program starts")
}

/// The tube phantom meshed coarsely with all exports; gives its report.
fn tube(dir: &Path, sets: &[&str]) -> Value {
    meshed("tube", dir, sets)
}

fn meshed(phantom: &str, dir: &Path, sets: &[&str]) -> Value {
    let made = lumenmesh(&["phantom", phantom, "-o", "case"], dir);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let mut args = vec!["run", "case/case.yaml", "-o", "out", "--set", EXPORTS, "--set", "surface.scale=1.8"];
    sets.iter().for_each(|s| args.extend(["--set", s]));
    let out = lumenmesh(&args, dir);
    // Exports are written whether the gates are met or not; the gates have their own tests.
    assert!(matches!(out.status.code(), Some(0 | 6)), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_str(&fs::read_to_string(dir.join("out/report.json")).expect("report.json")).expect("JSON")
}

/// Everything that was written, read by VTK, meshio and Gmsh.
fn others_read(out: &Path) {
    let python = std::env::var("LUMENMESH_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_exports.py");
    match Command::new(&python).arg(&script).arg(out).output() {
        Ok(o) if o.status.code() == Some(77) => eprintln!("SKIPPED: {python} has no vtk or meshio; scripts/test.sh installs them"),
        Ok(o) => assert!(o.status.success(), "{}{}", String::from_utf8_lossy(&o.stdout), String::from_utf8_lossy(&o.stderr)),
        Err(e) => eprintln!("SKIPPED: {python}: {e}"),
    }
}

fn fluent_converters_read(out: &Path) {
    for tool in ["fluentMeshToFoam", "fluent3DMeshToFoam"] {
        let folder = tempfile::tempdir().expect("folder");
        fs::create_dir(folder.path().join("system")).expect("system");
        for name in ["controlDict", "fvSchemes", "fvSolution"] {
            fs::copy(out.join("openfoam/system").join(name), folder.path().join("system").join(name)).expect("copy");
        }
        let mesh = out.join("fluent/lumen.msh");
        let Some((ok, log)) = foam::run(folder.path(), tool, &[&mesh.to_string_lossy()]) else { return };
        assert!(ok, "{tool}: {log}");
        let boundary = fs::read_to_string(folder.path().join("constant/polyMesh/boundary")).expect("boundary");
        for name in ["wall", "inlet", "outlet_1"] {
            assert!(boundary.split_whitespace().any(|w| w == name), "{tool}: no patch {name} in\n{boundary}");
        }
        let Some((_, log)) = foam::run(folder.path(), "checkMesh", &[]) else { return };
        assert!(log.contains("Mesh OK"), "{tool}: {log}");
    }
}

#[test]
fn a_mask_becomes_a_finished_solver_run_and_every_export_passes_its_reader() {
    let dir = tempfile::tempdir().expect("folder");
    let report = tube(dir.path(), &[]);
    let out = dir.path().join("out");
    others_read(&out);
    fluent_converters_read(&out);
    assert_eq!(report["flow"]["units"]["area"], "mm^2");
    assert!(fs::read_to_string(out.join("report.html")).expect("page").contains("Hand-over sheet"));
    let case = out.join("openfoam");
    let Some((ok, log)) = foam::run(&case, "./Allrun", &[]) else { return };
    if foam::run(&case, "simpleFoam", &["-help"]).is_none() {
        return;
    }
    assert!(ok, "{log}");
    assert!(fs::read_to_string(case.join("log.checkMesh")).expect("log").contains("Mesh OK"));
    assert!(fs::read_to_string(case.join("log.simpleFoam")).expect("log").contains("SIMPLE solution converged"));
    assert!(fs::read_dir(&case).expect("list").filter_map(Result::ok).any(|t| t.path().join("wallShearStress").is_file()));
    // What a person put beside stays, whatever it is called.
    let mine = ["2024-11-29", "2nd_try", "log.mine"];
    for name in mine {
        std::fs::create_dir(case.join(name)).unwrap();
    }
    foam::run(&case, "./Allclean", &[]);
    for name in mine {
        std::fs::remove_dir(case.join(name)).unwrap();
    }
    let mut left: Vec<_> = fs::read_dir(&case).expect("list").filter_map(Result::ok).map(|e| e.file_name()).collect();
    left.sort();
    assert_eq!(left, ["0", "Allclean", "Allrun", "constant", "system"]);
}

#[test]
fn prism_layers_pass_every_reader_too() {
    let dir = tempfile::tempdir().expect("folder");
    let report = tube(dir.path(), &["volume.boundary_layers.count=2"]);
    assert!(report["volume"]["prisms"].as_u64().is_some_and(|n| n > 0));
    let out = dir.path().join("out");
    others_read(&out);
    fluent_converters_read(&out);
    let Some((_, log)) = foam::run(&out.join("openfoam"), "checkMesh", &[]) else { return };
    assert!(log.contains("Mesh OK"), "{log}");
}

#[test]
fn a_waveform_makes_a_pulsatile_case_that_runs() {
    let dir = tempfile::tempdir().expect("folder");
    fs::write(dir.path().join("beat.csv"), "time,flow\n0,2\n0.2,6\n0.5,2.5\n0.9,2\n").expect("write");
    let beat = format!("flow.waveform={}", dir.path().join("beat.csv").display());
    let report = tube(dir.path(), &[&beat, "flow.cycles=1", "flow.blood.model=casson"]);
    assert!(report["flow"]["patches"][0]["womersley"].as_f64().is_some_and(|w| (3.0..5.0).contains(&w)), "{}", report["flow"]);
    let case = dir.path().join("out/openfoam");
    let control = case.join("system/controlDict");
    let text = fs::read_to_string(&control).expect("controlDict");
    let value = |key: &str| -> f64 { foam::printed(&text, key).trim_end_matches(';').parse().expect(key) };
    assert!((value("endTime  ") - 0.9).abs() < 1e-12);
    // A few steps only.
    let end = 6.0 * value("deltaT");
    fs::write(&control, text.replace(&format!("endTime         {}", foam::printed(&text, "endTime  ")), &format!("endTime         {end:e};"))).expect("write");
    let Some((ok, log)) = foam::run(&case, "pimpleFoam", &[]) else { return };
    assert!(ok && log.contains("End"), "{log}");
    let courant: f64 = foam::printed(&log[log.rfind("Courant Number").expect("Courant")..], "max:").parse().expect("number");
    assert!((0.05..=2.2).contains(&courant), "the largest Courant number is {courant}, aimed at 2\n{log}");
}

#[test]
fn outlets_far_stiffer_than_the_vessel_share_the_flow_by_their_resistances() {
    let dir = tempfile::tempdir().expect("folder");
    let report = meshed("bifurcation", dir.path(), &["flow.outlets.split=resistance", "flow.outlets.resistances=[2e9, 6e9]", "surface.scale=2"]);
    assert_eq!(report["flow"]["patches"][1]["condition"]["resistance"], 2e9);
    let case = dir.path().join("out/openfoam");
    let Some((ok, log)) = foam::run(&case, "simpleFoam", &[]) else { return };
    assert!(ok && log.contains("SIMPLE solution converged"), "{}", &log[log.len().saturating_sub(3000)..]);
    let last = |name: &str| -> f64 {
        let text = fs::read_to_string(case.join(format!("postProcessing/{name}/0/surfaceFieldValue.dat"))).expect(name);
        text.split_whitespace().last().and_then(|w| w.parse().ok()).expect(name)
    };
    for (k, r) in [(1, 2e9), (2, 6e9)] {
        let (p, q) = (last(&format!("p_outlet_{k}")) * 1060.0, last(&format!("phi_outlet_{k}")));
        assert!((p / (r * q) - 1.0).abs() < 0.01, "outlet {k}: {p} Pa at {q} m3/s, resistance {r}");
    }
}

#[test]
fn check_names_a_missed_gate_a_damaged_file_and_goes_on() {
    let dir = tempfile::tempdir().expect("folder");
    tube(dir.path(), &[]);
    let file = |name: &str| dir.path().join("out").join(name);
    let text = |o: &Output| format!("{}{}", String::from_utf8_lossy(&o.stdout), String::from_utf8_lossy(&o.stderr));
    for name in ["volume/lumen.vtu", "vmtk/lumen.vtu", "gmsh/lumen.msh", "fluent/lumen.msh", "openfoam", "surface/lumen.stl", "surface/lumen.ply", "surface/lumen.vtp"] {
        let out = lumenmesh(&["check", &file(name).to_string_lossy()], dir.path());
        assert!(matches!(out.status.code(), Some(0 | 6)), "{name}: {}", text(&out));
        // Patches keep their names wherever the format has them.
        if !name.starts_with("volume") && !name.starts_with("vmtk") {
            assert!(text(&out).contains("outlet_1"), "{name}: {}", text(&out));
        }
    }
    // A damaged file is named with its place; the others are looked at all the same, and the code is 3.
    let points = fs::read_to_string(file("openfoam/constant/polyMesh/points")).expect("points");
    fs::write(file("openfoam/constant/polyMesh/points"), points.replacen("(", "(x", 2)).expect("write");
    let out = lumenmesh(&["check", &file("openfoam").to_string_lossy(), &file("surface/lumen.vtp").to_string_lossy()], dir.path());
    assert_eq!(out.status.code(), Some(3), "{}", text(&out));
    assert!(text(&out).contains("polyMesh/points: line ") && text(&out).contains("triangles"), "{}", text(&out));
    // A flat triangle misses a gate.
    fs::write(dir.path().join("bad.stl"), "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 9 0 0\nvertex 4 0.1 0\nendloop\nendfacet\nendsolid a\n").expect("write");
    let out = lumenmesh(&["check", "bad.stl"], dir.path());
    assert_eq!(out.status.code(), Some(6), "{}", text(&out));
    assert!(text(&out).contains("MISSED"), "{}", text(&out));
}

#[test]
fn a_vessel_in_the_wrong_unit_is_asked_about() {
    let dir = tempfile::tempdir().expect("folder");
    lumenmesh(&["phantom", "tube", "-o", "case"], dir.path());
    let out = lumenmesh(&["run", "case/case.yaml", "-o", "out", "--set", "input.units=m", "--set", "surface.scale=2"], dir.path());
    let text = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(text.contains("the numbers of the header are in another unit") && text.contains("input.units"), "{text}");
    assert_eq!(out.status.code(), Some(3), "{text}");
}

#[test]
fn a_waveform_that_is_none_is_refused_before_the_work() {
    let dir = tempfile::tempdir().expect("folder");
    lumenmesh(&["phantom", "sphere", "-o", "case"], dir.path());
    fs::write(dir.path().join("beat.csv"), "time,flow\n0,2\n0.2,x\n").expect("write");
    let set = format!("flow.waveform={}", dir.path().join("beat.csv").display());
    let out = lumenmesh(&["run", "case/case.yaml", "-o", "out", "--set", &set], dir.path());
    let text = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(2), "{text}");
    assert!(text.contains("beat.csv") && text.contains("line 3"), "{text}");
    assert!(!dir.path().join("out").exists());
}
