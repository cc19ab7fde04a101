//! Whatever becomes of TetGen or the surface: one clear error, soon, and nothing left behind.

#[path = "common/vessels.rs"]
mod vessels;

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use lumenmesh::config::Case;
use lumenmesh::geometry::Point;
use lumenmesh::mesh::TriMesh;
use lumenmesh::pipeline::{self, Context, Silent, Stage};
use lumenmesh::remesh::Uniform;
use lumenmesh::volume::{Error, VolumeOptions, WorkerOptions, fill, fill_cancellable};

fn with(executable: impl Into<PathBuf>) -> VolumeOptions {
    let worker = WorkerOptions { executable: Some(executable.into()), time_limit: 20.0, ..WorkerOptions::default() };
    VolumeOptions { worker, ..VolumeOptions::default() }
}

fn real() -> VolumeOptions {
    with(env!("CARGO_BIN_EXE_lumenmesh"))
}

fn script(dir: &Path, body: &str) -> PathBuf {
    let path = dir.join("worker");
    std::fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

#[test]
fn a_killed_worker_is_an_error_that_names_the_signal() {
    let dir = tempfile::tempdir().unwrap();
    let e = fill(&vessels::straight(2.0, 6.0, 2), &Uniform(1.0), &with(script(dir.path(), "kill -9 $$"))).unwrap_err();
    assert!(matches!(e, Error::TetGen { .. }));
    assert!(e.to_string().contains("signal: 9"), "{e}");
}

#[test]
fn a_hanging_worker_is_stopped_at_the_time_limit() {
    let dir = tempfile::tempdir().unwrap();
    let mut o = with(script(dir.path(), "exec sleep 100"));
    o.worker.time_limit = 0.2;
    let begin = Instant::now();
    let e = fill(&vessels::straight(2.0, 6.0, 2), &Uniform(1.0), &o).unwrap_err();
    assert!(begin.elapsed() < Duration::from_secs(10));
    assert!(e.to_string().contains("time limit"), "{e}");
}

#[test]
fn a_worker_that_answers_nonsense_or_is_not_there_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let s = vessels::straight(2.0, 6.0, 2);
    assert!(matches!(fill(&s, &Uniform(1.0), &with("/bin/ls")), Err(Error::TetGen { .. })));
    assert!(matches!(fill(&s, &Uniform(1.0), &with(dir.path().join("none"))), Err(Error::Start(_))));
}

#[test]
fn cancelling_stops_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let o = with(script(dir.path(), "exec sleep 100"));
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    let thread = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(300));
        set.store(true, Ordering::Relaxed);
    });
    let begin = Instant::now();
    let e = fill_cancellable(&vessels::straight(2.0, 6.0, 2), &Uniform(1.0), &o, Some(&flag)).unwrap_err();
    assert!(matches!(e, Error::Cancelled));
    assert!(begin.elapsed() < Duration::from_secs(10));
    thread.join().unwrap();
}

#[test]
fn too_little_memory_is_an_error() {
    let mut o = real();
    o.worker.memory_limit = 8 << 20;
    // Less than the program itself needs: nothing more can be allocated, whatever the mesh.
    let e = fill(&vessels::straight(2.0, 8.0, 3), &Uniform(1.0), &o).map(|_| ());
    assert!(matches!(e, Err(Error::TetGen { .. })), "{e:?}");
}

#[test]
fn two_hundred_bad_surfaces_in_a_row_give_one_error_each() {
    let good = vessels::straight(2.0, 4.0, 2);
    for i in 0..200 {
        let mut s = good.clone();
        let t = i * 7 % s.triangles.len();
        let v = s.triangles[t][0] as usize;
        let says = match i % 8 {
            0 => {
                s.triangles.remove(t);
                s.patch.remove(t);
                "open"
            }
            1 => {
                s.points[v].x = f64::NAN;
                "not finite"
            }
            2 => {
                s.points[v] = Point::from(-3.0 * s.points[v].coords + s.points[0].coords);
                "cross"
            }
            3 => {
                let w = s.triangles[t][1] as usize;
                s.points[v] = s.points[w];
                "degenerate"
            }
            4 => {
                s.triangles.iter_mut().for_each(|t| t.swap(0, 1));
                "inside out"
            }
            5 => {
                s.triangles[t].swap(0, 1);
                "orientation"
            }
            6 => {
                s.points.iter_mut().for_each(|p| p.z = 0.0);
                ""
            }
            _ => {
                s = TriMesh::default();
                "no triangles"
            }
        };
        match fill(&s, &Uniform(1.0), &real()) {
            Err(e @ Error::Surface(_)) => assert!(e.to_string().contains(says), "{i}: {e}"),
            other => panic!("{i}: {:?}", other.map(|_| ())),
        }
    }
    assert!(fill(&good, &Uniform(1.0), &real()).is_ok());
}

/// Runs the built-in tube to its volume mesh with a worker that is killed the first so many times.
fn run_with_failures(times: u32) -> Result<serde_json::Value, String> {
    let dir = tempfile::tempdir().unwrap();
    let mask = dir.path().join("mask.nrrd");
    lumenmesh::io::nrrd::write_mask(&mask, &lumenmesh::phantom::build("tube").unwrap().mask()).unwrap();
    let (count, program) = (dir.path().join("count"), env!("CARGO_BIN_EXE_lumenmesh"));
    let count = count.display();
    let worker = script(
        dir.path(),
        &format!("n=$(cat {count} 2>/dev/null || echo 0)\necho $((n + 1)) > {count}\n[ \"$n\" -lt {times} ] && kill -9 $$\nexec {program} \"$@\""),
    );
    let mut case = Case::for_mask(mask);
    // Coarse: what is looked at is the order of work.
    case.surface.scale = 1.6;
    let context = Context { stop_after: Stage::Volume, progress: &Silent, cancel: &AtomicBool::new(false), worker };
    match pipeline::run(&case, &context) {
        Ok(outcome) => Ok(serde_json::from_str(&outcome.report.to_json()).unwrap()),
        Err(e) => Err(e.to_string()),
    }
}

#[test]
fn a_wall_that_cannot_be_filled_is_mended_at_its_doubtful_places_and_filled_once_more() {
    let sound = run_with_failures(0).unwrap();
    assert!(sound["volume"]["mended"].is_null());
    // All four attempts fail; the first one on the mended wall does not.
    let report = run_with_failures(4).unwrap();
    let mended = &report["volume"]["mended"];
    assert_eq!(mended["kept"], true);
    assert!(mended["why"].as_str().unwrap().contains("after 4 attempts"), "{mended}");
    assert!(!mended["places"].as_array().unwrap().is_empty() && !mended["changes"].as_array().unwrap().is_empty());
    assert!(report["warnings"].to_string().contains("mended"), "{}", report["warnings"]);
    // The surface that is measured and delivered is the one that was filled, as good as it was.
    let missed = report["gates"].as_array().unwrap().iter().filter(|g| g["hard"] == true && g["passed"] == false).count();
    assert_eq!(missed, 0, "{}", report["gates"]);
}

#[test]
fn a_wall_that_cannot_be_filled_even_when_mended_is_an_error_with_all_attempts() {
    let e = run_with_failures(100).unwrap_err();
    assert!(e.contains("after 8 attempts"), "{e}");
}
