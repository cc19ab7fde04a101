//! The main job as a user sees it: a mask in, a checked volume mesh out; and what happens when the input is bad.

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

/// The code, the message, and that nothing but the input lies in the folder afterwards.
fn refused(args: &[&str], dir: &Path, code: i32, words: &[&str]) {
    let before = fs::read_dir(dir).expect("list").count();
    let out = lumenmesh(args, dir);
    let message = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(code), "{message}");
    for w in words {
        assert!(message.contains(w), "`{w}` is missing in: {message}");
    }
    assert_eq!(fs::read_dir(dir).expect("list").count(), before, "something was left half-written: {message}");
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

#[test]
fn a_missing_file_is_named() {
    let dir = folder();
    refused(&["mesh", "none.nrrd", "-o", "out"], dir.path(), 3, &["none.nrrd"]);
}

#[test]
fn an_empty_and_a_full_mask_are_refused() {
    let dir = folder();
    for (name, value) in [("empty", 0u8), ("full", 1)] {
        let mut bytes = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 4 4\nspacings: 1 1 1\nencoding: raw\n\n".to_vec();
        bytes.extend([value; 64]);
        fs::write(dir.path().join(format!("{name}.nrrd")), bytes).expect("write");
    }
    refused(&["mesh", "empty.nrrd", "-o", "out"], dir.path(), 3, &["no"]);
    refused(&["mesh", "full.nrrd", "-o", "out"], dir.path(), 3, &["every"]);
}

#[test]
fn a_spacing_that_is_not_a_number_is_refused() {
    let dir = folder();
    let mut bytes = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: 1 nan 1\nencoding: raw\n\n".to_vec();
    bytes.extend([0, 1, 0, 1, 0, 1, 0, 0]);
    fs::write(dir.path().join("m.nrrd"), bytes).expect("write");
    refused(&["mesh", "m.nrrd", "-o", "out"], dir.path(), 3, &["m.nrrd", "spacing"]);
}

#[test]
fn a_truncated_gzip_is_refused() {
    let dir = folder();
    phantom("sphere", dir.path());
    let bytes = fs::read(dir.path().join("case/mask.nrrd")).expect("mask");
    fs::write(dir.path().join("cut.nrrd"), &bytes[..bytes.len() - 40]).expect("write");
    refused(&["mesh", "cut.nrrd", "-o", "out"], dir.path(), 3, &["cut.nrrd"]);
}

#[test]
fn a_plane_that_misses_the_vessel_is_refused_with_coordinates() {
    let dir = folder();
    phantom("tube", dir.path());
    fs::write(
        dir.path().join("c.yaml"),
        "input: {mask: case/mask.nrrd}\nopenings:\n- {name: inlet, center: [900, 0, 0], normal: [1, 0, 0]}\n",
    )
    .expect("write");
    refused(&["run", "c.yaml", "-o", "out"], dir.path(), 4, &["inlet", "900", "nearest"]);
}

#[test]
fn an_unknown_key_is_refused_with_line_and_column() {
    let dir = folder();
    fs::write(dir.path().join("c.yaml"), "input: {mask: m.nrrd}\nsurface:\n  edge_lenght: 1 mm\n").expect("write");
    refused(&["run", "c.yaml", "-o", "out"], dir.path(), 2, &["c.yaml:3:3", "edge_length"]);
}

#[test]
fn a_foreign_folder_is_not_overwritten() {
    let dir = folder();
    phantom("sphere", dir.path());
    fs::create_dir(dir.path().join("thesis")).expect("create");
    fs::write(dir.path().join("thesis/chapter.tex"), "x").expect("write");
    refused(&["run", "case/case.yaml", "-o", "thesis"], dir.path(), 2, &["thesis", "-o"]);
    assert!(dir.path().join("thesis/chapter.tex").is_file());
}
