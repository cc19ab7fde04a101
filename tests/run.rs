//! The main job as a user sees it: a mask in, a checked volume mesh out.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn lumenmesh(args: &[&str], dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumenmesh")).args(args).current_dir(dir).output().expect("the program starts")
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn report(dir: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(dir.join("report.json")).expect("report.json")).expect("JSON")
}

fn phantom(name: &str, dir: &Path) {
    let out = lumenmesh(&["phantom", name, "-o", "case"], dir);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

#[test]
fn a_tube_becomes_a_checked_volume_mesh_with_inlet_and_outlet() {
    let dir = folder();
    phantom("tube", dir.path());
    let out = lumenmesh(&["run", "case/case.yaml", "-o", "out", "--set", "surface.scale=1.6"], dir.path());
    let text = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert_eq!(out.status.code(), Some(0), "{text}");
    let r = report(&dir.path().join("out"));
    assert_eq!(r["schema_version"], 1);
    assert_eq!(r["status"], "passed", "{}", r["gates"]);
    assert!(r["surface"]["s_max"].as_f64().is_some_and(|s| s < 0.75), "{}", r["surface"]["s_max"]);
    assert!(r["volume"]["sv_max"].as_f64().is_some_and(|s| s < 0.95));
    let names: Vec<&str> = r["openings"].as_array().expect("openings").iter().filter_map(|o| o["name"].as_str()).collect();
    assert_eq!(names, ["inlet", "outlet_1"]);
    for file in [
        "report.html",
        "case.resolved.yaml",
        "lumenmesh.log",
        "input/mask-cleaned.nrrd",
        "surface/lumen.vtp",
        "surface/lumen.stl",
        "surface/inlet.stl",
        "surface/centerlines.vtp",
        "volume/lumen.vtu",
        "volume/boundary.vtp",
        "volume/boundary.vtu",
        "openfoam/constant/polyMesh/points",
        "openfoam/system/controlDict",
        "fluent/lumen.msh",
    ] {
        assert!(dir.path().join("out").join(file).is_file(), "{file} is missing");
    }
    vtk_opens_the_volume(dir.path(), &r);
}

/// VTK's own reader sees the same cells, all positive, and the volume that the surface encloses.
fn vtk_opens_the_volume(dir: &Path, report: &Value) {
    let python = std::env::var("LUMENMESH_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_volume.py");
    let out = Command::new(&python).arg(&script).arg(dir.join("out")).output();
    match out {
        Ok(out) if out.status.code() == Some(77) => eprintln!("SKIPPED: {python} has no vtk; scripts/test.sh installs it"),
        Ok(out) => {
            let text = String::from_utf8_lossy(&out.stdout).into_owned();
            assert!(out.status.success(), "{text}{}", String::from_utf8_lossy(&out.stderr));
            let cells = report["volume"]["cells"].as_u64().expect("cells");
            assert!(text.contains(&format!("cells {cells}")), "{text}");
        }
        Err(e) => eprintln!("SKIPPED: {python}: {e}"),
    }
}

#[test]
fn the_files_are_the_same_for_any_number_of_threads() {
    let dir = folder();
    phantom("tube", dir.path());
    for (name, threads) in [("one", "1"), ("two", "2")] {
        let out = lumenmesh(&["run", "case/case.yaml", "-o", name, "--threads", threads, "--set", "surface.scale=2"], dir.path());
        assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    }
    for file in ["surface/lumen.vtp", "surface/centerlines.vtp", "volume/lumen.vtu", "openfoam/constant/polyMesh/points", "fluent/lumen.msh"] {
        let read = |run: &str| fs::read(dir.path().join(run).join(file)).expect(file);
        assert!(read("one") == read("two"), "{file} depends on the number of threads");
    }
}

#[test]
fn a_run_can_stop_after_the_surface() {
    let dir = folder();
    phantom("sphere", dir.path());
    let out = lumenmesh(&["run", "case/case.yaml", "-o", "out", "--stop-after", "surface"], dir.path());
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(dir.path().join("out/surface/lumen.vtp").is_file());
    assert!(!dir.path().join("out/volume").exists());
}

/// Every byte under a folder but the report's and log's times.
fn files(dir: &Path, under: &Path, out: &mut Vec<(String, Vec<u8>)>) {
    let mut entries: Vec<_> = fs::read_dir(dir).expect("list").map(|e| e.expect("entry").path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files(&path, under, out);
        } else if path.file_name().is_none_or(|n| n != "report.json" && n != "report.html" && n != "lumenmesh.log" && n != "manifest.json") {
            out.push((path.strip_prefix(under).expect("under").display().to_string(), fs::read(&path).expect("read")));
        }
    }
}

#[test]
fn the_resolved_case_gives_the_same_bytes_again() {
    let dir = folder();
    phantom("tube", dir.path());
    let first = ["run", "case/case.yaml", "-o", "first", "--set", "surface.scale=2", "--set", "exports=[vtk, stl, openfoam]", "--quiet"];
    let out = lumenmesh(&first, dir.path());
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    let out = lumenmesh(&["run", "first/case.resolved.yaml", "-o", "second", "--quiet"], dir.path());
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    let list = |name: &str| {
        let mut all = Vec::new();
        files(&dir.path().join(name), &dir.path().join(name), &mut all);
        all
    };
    let (a, b) = (list("first"), list("second"));
    assert!(a.len() > 15, "{} files", a.len());
    assert_eq!(a.iter().map(|f| &f.0).collect::<Vec<_>>(), b.iter().map(|f| &f.0).collect::<Vec<_>>());
    for (one, two) in a.iter().zip(&b) {
        assert!(one.1 == two.1, "{} differs between the run and its resolved case", one.0);
    }
    // All else in the reports is the same as well.
    let without_run = |name: &str| {
        let mut r = report(&dir.path().join(name));
        r.as_object_mut().expect("object").remove("run");
        r
    };
    let (one, two) = (without_run("first"), without_run("second"));
    for (key, value) in one.as_object().expect("object") {
        assert!(*value == two[key], "report.json differs under `{key}`");
    }
}
