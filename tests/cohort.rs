//! Cohorts: many cases, some of them bad, a kill half-way, sweeps, and the same through Snakemake.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
}

fn lumenmesh(args: &[&str], dir: &Path) -> Output {
    program().args(args).current_dir(dir).output().expect("the program starts")
}

fn text(out: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr))
}

fn phantom(name: &str, dir: &Path) {
    let out = lumenmesh(&["phantom", name, "-o", &format!("cases/{name}")], dir);
    assert!(out.status.success(), "{}", text(&out));
}

/// Large triangles and no solver cases: quick.
const QUICK: [&str; 4] = ["--set", "surface.scale=3", "--set", "exports=[vtk]"];

/// Every file of a result but those with times in them.
fn files(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let (mut all, mut open) = (vec![], vec![dir.to_path_buf()]);
    while let Some(d) = open.pop() {
        for path in fs::read_dir(&d).expect("list").map(|e| e.expect("entry").path()) {
            let name = path.strip_prefix(dir).expect("inside").display().to_string();
            if path.is_dir() {
                open.push(path);
            } else if !["report.json", "report.html", "lumenmesh.log", ".lumenmesh/manifest.json"].contains(&name.as_str()) {
                all.push((name, fs::read(&path).expect("read")));
            }
        }
    }
    all.sort();
    all
}

#[test]
fn a_killed_cohort_goes_on_and_gives_what_single_runs_give() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dir = dir.path();
    phantom("sphere", dir);
    phantom("tube", dir);
    for (name, value) in [("empty_a", 0u8), ("empty_b", 0)] {
        let mut bytes = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 4 4\nspacings: 1 1 1\nencoding: raw\n\n".to_vec();
        bytes.extend([value; 64]);
        fs::write(dir.join(format!("{name}.nrrd")), bytes).expect("write");
    }
    let mut args = vec!["batch", "cases/sphere/case.yaml", "empty_a.nrrd", "cases/tube/case.yaml", "empty_b.nrrd", "none.nrrd", "-o", "cohort"];
    args.extend(QUICK);
    // Killed once the first case is done.
    let mut child = program().args(&args).current_dir(dir).stderr(Stdio::null()).stdout(Stdio::null()).spawn().expect("starts");
    let start = Instant::now();
    while !dir.join("cohort/sphere/.lumenmesh/manifest.json").is_file() && start.elapsed() < Duration::from_secs(300) {
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    assert!(!dir.join("cohort/cohort.csv").exists());
    let out = lumenmesh(&args, dir);
    let said = text(&out);
    assert_eq!(out.status.code(), Some(3), "{said}");
    assert!(said.contains("2 of 5 cases met all hard gates"), "{said}");
    let sphere = said.lines().find(|l| l.contains("sphere")).expect("a line for the sphere");
    assert!(sphere.contains("(kept)"), "{said}");

    let csv = fs::read_to_string(dir.join("cohort/cohort.csv")).expect("cohort.csv");
    let verdicts: Vec<String> = csv.lines().skip(1).map(|l| l.split(',').take(3).collect::<Vec<_>>().join(" ")).collect();
    assert_eq!(verdicts[..3], ["\"empty_a\" input 3", "\"empty_b\" input 3", "\"none\" input 3"], "failures come first");
    // A sphere has no openings, and either end of a tube may be its inlet: both are warned of.
    let mut warned = verdicts[3..].to_vec();
    warned.sort();
    assert_eq!(warned, ["\"sphere\" met with warnings 0", "\"tube\" met with warnings 0"]);
    assert!(said.contains("met all hard gates, 2 with warnings"), "{said}");
    assert!(csv.contains("flow: there is no inlet or no outlet"), "{csv}");
    let page = fs::read_to_string(dir.join("cohort/cohort.html")).expect("cohort.html");
    assert!(page.contains("(2): empty_a, empty_b"), "failures are not grouped by cause");
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 2, "a picture for each case that has a surface");
    assert!(!page.contains("http"), "the page loads something");
    assert!(fs::read_to_string(dir.join("cohort/none.log")).expect("log").contains("no such file"));

    // The same bytes as by itself.
    let mut single = vec!["run", "cases/tube/case.yaml", "-o", "single", "--quiet"];
    single.extend(QUICK);
    let out = lumenmesh(&single, dir);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out));
    let (a, b) = (files(&dir.join("cohort/tube")), files(&dir.join("single")));
    assert!(a.len() >= 6);
    assert!(a == b, "the cohort's files are not those of a single run");

    // Another mask under the same name is another case; the rest is kept.
    fs::copy(dir.join("cases/sphere/mask.nrrd"), dir.join("cases/tube/mask.nrrd")).expect("copy");
    let mut few = vec!["batch", "cases/sphere/case.yaml", "cases/tube/case.yaml", "-o", "cohort"];
    few.extend(QUICK);
    let said = text(&lumenmesh(&few, dir));
    assert_eq!(said.matches("(kept)").count(), 1, "{said}");
    // The page can be made from the folders alone.
    let mut collect = few.clone();
    collect.push("--collect");
    let out = lumenmesh(&collect, dir);
    assert!(text(&out).contains("2 of 2 cases"), "{}", text(&out));

    // A solver has run, a person has written: what is done stays done, and nothing of it is replaced unasked.
    for (name, file) in [("sphere", "openfoam/100/U"), ("tube", "notes.md")] {
        let path = dir.join("cohort").join(name).join(file);
        fs::create_dir_all(path.parent().expect("parent")).expect("folders");
        fs::write(path, "mine").expect("write");
    }
    fs::write(dir.join("cohort/cohort.csv"), "my column").expect("write");
    let out = lumenmesh(&few, dir);
    assert_eq!(out.status.code(), Some(2), "{}", text(&out));
    assert!(text(&out).contains("cohort.csv: was changed") && text(&out).contains("--keep"), "{}", text(&out));
    few.push("--keep");
    let out = lumenmesh(&few, dir);
    assert_eq!(text(&out).matches("(kept)").count(), 2, "{}", text(&out));
    assert_eq!(fs::read_to_string(dir.join("cohort/cohort.csv.1")).expect("kept"), "my column");
    let other = |args: &[&'static str]| {
        let mut all = vec!["batch", "cases/sphere/case.yaml", "cases/tube/case.yaml", "-o", "cohort", "--set", "surface.scale=3.1", "--set", "exports=[vtk]"];
        all.extend(args);
        lumenmesh(&all, dir)
    };
    let out = other(&[]);
    assert_eq!(out.status.code(), Some(2), "{}", text(&out));
    let log = |name: &str| fs::read_to_string(dir.join(format!("cohort/{name}.log"))).expect("log");
    assert!(log("sphere").contains("openfoam/ (not written by lumenmesh)"), "{}", log("sphere"));
    assert!(log("tube").contains("notes.md (not written by lumenmesh)"), "{}", log("tube"));
    let out = other(&["--keep"]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out));
    for file in ["sphere.1/openfoam/100/U", "tube.1/notes.md"] {
        assert_eq!(fs::read_to_string(dir.join("cohort").join(file)).expect(file), "mine");
    }
    assert!(!dir.join("cohort/sphere.log").exists(), "the log of a failure goes with the failure");
}

#[test]
fn two_inputs_never_share_a_folder() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dir = dir.path();
    phantom("sphere", dir);
    for name in ["1.2.840.1.nrrd", "1.2.840.2.nrrd", "a/x.nrrd", "b/x.nrrd"] {
        fs::create_dir_all(dir.join(name).parent().expect("parent")).expect("folder");
        fs::copy(dir.join("cases/sphere/mask.nrrd"), dir.join(name)).expect("copy");
    }
    let mut args = vec!["batch", "1.2.840.1.nrrd", "1.2.840.2.nrrd", "-o", "cohort"];
    args.extend(QUICK);
    let out = lumenmesh(&args, dir);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out));
    assert!(dir.join("cohort/1.2.840.1/report.json").is_file() && dir.join("cohort/1.2.840.2/report.json").is_file());
    let out = lumenmesh(&["batch", "a/x.nrrd", "b/x.nrrd", "-o", "other"], dir);
    assert_eq!(out.status.code(), Some(2), "{}", text(&out));
    assert!(text(&out).contains("a/x.nrrd would share the folder x"), "{}", text(&out));
    assert!(!dir.join("other").exists());
}

#[test]
fn a_sweep_moves_the_surface_of_one_case() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dir = dir.path();
    phantom("sphere", dir);
    let mut args = vec!["batch", "cases/sphere/mask.nrrd", "-o", "sweep", "--sweep", "reconstruction.offset=-0.25,0.25"];
    args.extend(QUICK);
    let out = lumenmesh(&args, dir);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out));
    let volume = |name: &str| {
        let report = fs::read_to_string(dir.join("sweep").join(name).join("report.json")).expect("report");
        let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
        report["fidelity"]["volume_ratio"].as_f64().expect("a ratio")
    };
    let (small, large) = (volume("sphere_offset-0.25"), volume("sphere_offset0.25"));
    assert!(small < 0.98 && large > 1.02, "volume ratios {small} and {large}");
}

#[test]
fn snakemake_gives_the_same_cohort() {
    let snakemake = std::env::var("LUMENMESH_SNAKEMAKE").unwrap_or_else(|_| "snakemake".into());
    if !Command::new(&snakemake).arg("--version").output().is_ok_and(|o| o.status.success()) {
        eprintln!("SKIPPED: {snakemake} is not there (pip install snakemake; LUMENMESH_SNAKEMAKE names it)");
        return;
    }
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dir = dir.path();
    phantom("sphere", dir);
    fs::write(dir.join("bad.yaml"), "input: {mask: none.nrrd}\n").expect("write");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let out = Command::new(&snakemake)
        .arg("-s")
        .arg(root.join("scripts/cohort/Snakefile"))
        .arg("--profile")
        .arg(root.join("scripts/cohort/local"))
        .args(["--config", "cases=['cases/sphere/case.yaml','bad.yaml']", "out=cohort", "threads=1", "set=surface.scale=3"])
        .arg(format!("lumenmesh={}", env!("CARGO_BIN_EXE_lumenmesh")))
        .current_dir(dir)
        .output()
        .expect("starts");
    assert!(out.status.success(), "{}", text(&out));
    let csv = fs::read_to_string(dir.join("cohort/cohort.csv")).expect("cohort.csv");
    assert!(csv.contains("\"bad\",input,3") && csv.contains("\"sphere\",met with warnings,0"), "{csv}");
    assert!(csv.contains("no such file"), "{csv}");
    let out = lumenmesh(&["run", "cases/sphere/case.yaml", "-o", "single", "--quiet", "--set", "surface.scale=3"], dir);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out));
    assert!(files(&dir.join("cohort/sphere")) == files(&dir.join("single")), "Snakemake's files are not those of a single run");
}
