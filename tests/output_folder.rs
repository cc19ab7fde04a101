//! Output folders through the program itself: killed, full, locked, and with files of a person or a solver in them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use sha2::{Digest, Sha256};

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
}

fn lumenmesh(args: &[&str], dir: &Path) -> Output {
    program().args(args).current_dir(dir).output().expect("the program starts")
}

fn text(out: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr))
}

fn succeeds(args: &[&str], dir: &Path) -> String {
    let out = lumenmesh(args, dir);
    assert_eq!(out.status.code(), Some(0), "{args:?}: {}", text(&out));
    text(&out)
}

fn refused(args: &[&str], dir: &Path) -> String {
    let out = lumenmesh(args, dir);
    assert_eq!(out.status.code(), Some(2), "{args:?}: {}", text(&out));
    text(&out)
}

/// Every file under a folder.
fn files(dir: &Path) -> Vec<PathBuf> {
    let (mut all, mut open) = (vec![], vec![dir.to_path_buf()]);
    while let Some(d) = open.pop() {
        for path in fs::read_dir(&d).expect("list").map(|e| e.expect("entry").path()) {
            if path.is_dir() { open.push(path) } else { all.push(path) }
        }
    }
    all.sort();
    all
}

/// Fails unless a folder holds what its manifest says, no more and no less; gives the manifest.
fn whole(dir: &Path, what: &str) -> Value {
    let text = fs::read_to_string(dir.join(".lumenmesh/manifest.json")).unwrap_or_else(|e| panic!("{what}: {e}"));
    let manifest: Value = serde_json::from_str(&text).expect("JSON");
    let mut wanted: Vec<PathBuf> = vec![dir.join(".lumenmesh/manifest.json")];
    for entry in manifest["files"].as_array().expect("files") {
        let path = dir.join(entry["path"].as_str().expect("path"));
        let bytes = fs::read(&path).unwrap_or_else(|e| panic!("{what}: {}: {e}", path.display()));
        let hash: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(
            (entry["size"].as_u64(), entry["sha256"].as_str()),
            (Some(bytes.len() as u64), Some(hash.as_str())),
            "{what}: {}",
            path.display()
        );
        wanted.push(path);
    }
    wanted.sort();
    assert_eq!(files(dir), wanted, "{what}");
    manifest
}

/// The phantom that a folder holds, whole.
fn phantom_in(dir: &Path, what: &str) -> String {
    whole(dir, what);
    let truth = fs::read_to_string(dir.join("truth.json")).expect("truth");
    serde_json::from_str::<Value>(&truth).expect("JSON")["name"].as_str().unwrap_or_default().to_string()
}

fn nothing_beside(dir: &Path, wanted: &[&str]) {
    let mut names: Vec<String> = fs::read_dir(dir)
        .expect("list")
        .map(|e| e.expect("entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, wanted);
}

#[test]
fn solver_results_in_a_series_and_notes_are_refused_or_moved_aside_whole() {
    let dir = tempfile::tempdir().expect("folder");
    let dir = dir.path();
    succeeds(&["phantom", "tube", "-o", "case"], dir);
    let run = ["run", "case/case.yaml", "-o", "out", "--stop-after", "mask", "--quiet"];
    succeeds(&run, dir);
    let manifest = whole(&dir.join("out"), "first");
    assert!(manifest["case"].as_str().is_some_and(|c| c.len() == 64) && manifest["command"] == "run", "{manifest}");
    // Unchanged results are replaced.
    succeeds(&run, dir);
    nothing_beside(dir, &["case", "out"]);
    let mine = [
        "series/fine/openfoam/295/U",
        "openfoam/processor3/0.1/p",
        "openfoam/postProcessing/p.dat",
        "fluent/run.cas.h5",
        "notes.md",
    ];
    for name in mine {
        let path = dir.join("out").join(name);
        fs::create_dir_all(path.parent().expect("parent")).expect("folders");
        fs::write(&path, name).expect("write");
    }
    fs::write(dir.join("out/case.resolved.yaml"), "edited").expect("write");
    let said = refused(&run, dir);
    for name in
        ["series/ (not", "openfoam/ (not", "fluent/ (not", "notes.md (not", "case.resolved.yaml (changed)", "--keep"]
    {
        assert!(said.contains(name), "{name}: {said}");
    }
    let mut keep = run.to_vec();
    keep.push("--keep");
    succeeds(&keep, dir);
    succeeds(&keep, dir);
    nothing_beside(dir, &["case", "out", "out.1", "out.2"]);
    for name in mine {
        assert_eq!(fs::read_to_string(dir.join("out.1").join(name)).expect("kept"), name);
    }
    assert_eq!(fs::read_to_string(dir.join("out.1/case.resolved.yaml")).expect("kept"), "edited");
    whole(&dir.join("out.2"), "unchanged results, kept");
    whole(&dir.join("out"), "new");
    // Results of an older version have no manifest.
    fs::remove_dir_all(dir.join("out/.lumenmesh")).expect("removed");
    assert!(refused(&run, dir).contains("older versions"));
    // The mask of the run lies in the folder.
    assert!(refused(&["run", "case/case.yaml", "-o", "case"], dir).contains("input of this run"));
    assert!(refused(&["mesh", "case/mask.nrrd", "-o", "."], dir).contains("you are in"));
    phantom_in(&dir.join("case"), "the input");
}

#[test]
fn a_second_run_is_refused_at_once_and_a_killed_one_leaves_no_lock() {
    let dir = tempfile::tempdir().expect("folder");
    let dir = dir.path();
    succeeds(&["phantom", "aneurysm", "-o", "case"], dir);
    succeeds(&["phantom", "sphere", "-o", "out"], dir);
    let mut first = start(&["run", "case/case.yaml", "-o", "out", "--quiet"], dir);
    let begun = Instant::now();
    while !dir.join(".out.lumenmesh/new").is_dir() {
        assert!(
            begun.elapsed() < Duration::from_secs(60) && first.try_wait().expect("state").is_none(),
            "the first run does not start"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    let begun = Instant::now();
    for args in [["run", "case/case.yaml", "-o", "out"], ["phantom", "tube", "-o", "out"]] {
        let said = refused(&args, dir);
        assert!(said.contains("another run") && said.contains(&first.id().to_string()), "{said}");
    }
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    assert!(first.try_wait().expect("state").is_none(), "the first run has ended too early for this test");
    first.kill().expect("killed");
    first.wait().expect("ended");
    phantom_in(&dir.join("out"), "after the kill");
    succeeds(&["phantom", "tube", "-o", "out"], dir);
    phantom_in(&dir.join("out"), "after the next run");
    nothing_beside(dir, &["case", "out"]);
}

fn start(args: &[&str], dir: &Path) -> Child {
    program()
        .args(args)
        .current_dir(dir)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts")
}

#[test]
fn killed_at_any_time_the_folder_holds_the_old_or_the_new_results() {
    let dir = tempfile::tempdir().expect("folder");
    let dir = dir.path();
    succeeds(&["phantom", "tube", "-o", "out"], dir);
    let begun = Instant::now();
    succeeds(&["phantom", "sphere", "-o", "out"], dir);
    let time = begun.elapsed();
    let mut found = std::collections::BTreeMap::new();
    for n in 0..30u32 {
        let name = if n % 2 == 0 { "tube" } else { "sphere" };
        let mut child = start(&["phantom", name, "-o", "out"], dir);
        std::thread::sleep(time.mul_f64(f64::from(n * 7 % 30) / 25.0));
        child.kill().expect("killed");
        child.wait().expect("ended");
        *found.entry(phantom_in(&dir.join("out"), &format!("kill {n}"))).or_insert(0) += 1;
    }
    eprintln!("30 kills: {found:?}");
    succeeds(&["phantom", "sphere", "-o", "out"], dir);
    nothing_beside(dir, &["out"]);
}

/// Whether strace can be used here.
fn strace() -> bool {
    Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).output().is_ok_and(|o| o.status.success())
}

#[test]
fn killed_or_failing_at_any_system_call_nothing_is_lost() {
    if !strace() {
        eprintln!("SKIPPED: strace is not there or not allowed (apt install strace)");
        return;
    }
    let dir = tempfile::tempdir().expect("folder");
    let dir = dir.path();
    succeeds(&["phantom", "tube", "-o", "old"], dir);
    let faults = [
        ("mkdir", "error=ENOSPC"),
        ("openat", "error=EROFS"),
        ("write", "error=ENOSPC"),
        ("fsync", "error=ENOSPC"),
        ("rename", "error=EROFS"),
        ("renameat2", "error=EROFS"),
        ("unlink", "error=EROFS"),
        ("rmdir", "error=EROFS"),
    ];
    let mut injected = 0;
    for (call, fault) in faults.into_iter().flat_map(|(call, error)| [(call, error), (call, "signal=KILL")]) {
        // The first calls of a kind one by one, then ever farther apart.
        let mut when = 1;
        loop {
            let work = dir.join(format!("{call}-{fault}-{when}"));
            copy(&dir.join("old"), &work.join("out"));
            let inject = format!("inject={call}:{fault}:when={when}");
            let traced = work.with_extension("trace");
            let out = Command::new("strace")
                .args(["-f", "-qq", "-e", &format!("trace={call}"), "-e", &inject, "-o"])
                .arg(&traced)
                .arg(env!("CARGO_BIN_EXE_lumenmesh"))
                .args(["phantom", "sphere", "-o", "out"])
                .current_dir(&work)
                .output()
                .expect("strace starts");
            let what = format!("{inject}: {}", text(&out));
            let holds = phantom_in(&work.join("out"), &what);
            assert!(out.status.code() != Some(0) || holds == "sphere", "{what}");
            // The next run puts the rest right.
            succeeds(&["phantom", "sphere", "-o", "out"], &work);
            assert_eq!(phantom_in(&work.join("out"), &what), "sphere");
            let left: Vec<_> = fs::read_dir(&work).expect("list").map(|e| e.expect("entry").file_name()).collect();
            assert!(left.iter().all(|n| n.to_string_lossy().starts_with("out")), "{what}: {left:?}");
            if !fs::read_to_string(&traced).is_ok_and(|t| t.contains("INJECTED") || t.contains("SIGKILL")) {
                break;
            }
            injected += 1;
            when += 1 + when / 3;
        }
    }
    eprintln!("{injected} system calls failed or killed, nothing lost");
    assert!(injected >= 30, "{injected}");
}

fn copy(from: &Path, to: &Path) {
    for file in files(from) {
        let path = to.join(file.strip_prefix(from).expect("inside"));
        fs::create_dir_all(path.parent().expect("parent")).expect("folder");
        fs::copy(&file, path).expect("copy");
    }
}

/// A file system of some kilobytes, gone with the value.
struct Small(PathBuf);

impl Small {
    fn new(path: PathBuf, kilobytes: usize) -> Option<Small> {
        fs::create_dir_all(&path).ok()?;
        let size = format!("size={kilobytes}k");
        let made = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(&path).output();
        made.is_ok_and(|o| o.status.success()).then_some(Small(path))
    }

    fn remount(&self, options: &str) {
        let done = Command::new("mount").args(["-o", &format!("remount,{options}")]).arg(&self.0).status();
        assert!(done.is_ok_and(|s| s.success()), "remount");
    }
}

impl Drop for Small {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_full_or_read_only_disk_leaves_the_old_results_whole() {
    let dir = tempfile::tempdir().expect("folder");
    let dir = dir.path();
    let Some(disk) = Small::new(dir.join("disk"), 64 << 10) else {
        eprintln!("SKIPPED: only root can make a small disk");
        return;
    };
    succeeds(&["phantom", "tube", "-o", "case"], dir);
    let run = [
        "run",
        "../case/case.yaml",
        "-o",
        "out",
        "--quiet",
        "--set",
        "surface.scale=3",
        "--set",
        "exports=[vtk,stl,ply,openfoam,fluent,gmsh,simvascular,vmtk]",
    ];
    succeeds(&run, &disk.0);
    whole(&disk.0.join("out"), "with room");
    let before: Vec<(PathBuf, Vec<u8>)> =
        files(&disk.0.join("out")).into_iter().map(|f| (f.clone(), fs::read(f).expect("read"))).collect();
    let kilobytes = before.iter().map(|f| f.1.len().div_ceil(4096) * 4).sum::<usize>();
    // From no room at all to all but a little, in steps that end inside other files each.
    let mut full = 0;
    for part in [0, 3, 11, 23, 37, 52, 66, 78, 85, 90, 94, 97] {
        disk.remount(&format!("size={}k", kilobytes + kilobytes * part / 100 + 8));
        let out = lumenmesh(&run, &disk.0);
        if out.status.code() == Some(0) {
            whole(&disk.0.join("out"), "it fits");
            continue;
        }
        full += 1;
        let said = text(&out);
        assert_eq!(out.status.code(), Some(2), "{part} %: {said}");
        assert!(said.contains("no space") && said.contains("free some space"), "{part} %: {said}");
        for (file, bytes) in &before {
            assert!(fs::read(file).is_ok_and(|b| b == *bytes), "{part} %: {}", file.display());
        }
        nothing_beside(&disk.0, &["out"]);
    }
    assert!(full >= 10, "{full} runs met a full disk");
    disk.remount("ro");
    let said = refused(&run, &disk.0);
    assert!(said.contains("read-only"), "{said}");
    whole(&disk.0.join("out"), "read-only");
}

#[test]
fn init_and_man_keep_what_is_there() {
    let dir = tempfile::tempdir().expect("folder");
    let dir = dir.path();
    succeeds(&["phantom", "sphere", "-o", "case"], dir);
    fs::write(dir.join("mine.yaml"), "mine").expect("write");
    let said = refused(&["init", "case/mask.nrrd", "-o", "mine.yaml"], dir);
    assert!(said.contains("--force") && said.contains("--keep"), "{said}");
    assert_eq!(fs::read_to_string(dir.join("mine.yaml")).expect("kept"), "mine");
    succeeds(&["init", "case/mask.nrrd", "-o", "mine.yaml", "--keep"], dir);
    assert_eq!(fs::read_to_string(dir.join("mine.yaml.1")).expect("kept"), "mine");
    assert!(fs::read_to_string(dir.join("mine.yaml")).expect("new").contains("input:"));
    // The same pages again are no change.
    succeeds(&["man", "-o", "man"], dir);
    succeeds(&["man", "-o", "man"], dir);
    fs::write(dir.join("man/lumenmesh.1"), "mine").expect("write");
    fs::remove_file(dir.join("man/lumenmesh-run.1")).expect("removed");
    assert!(refused(&["man", "-o", "man"], dir).contains("lumenmesh.1"));
    assert!(!dir.join("man/lumenmesh-run.1").exists(), "nothing is written where one is refused");
    assert_eq!(fs::read_to_string(dir.join("man/lumenmesh.1")).expect("kept"), "mine");
    succeeds(&["man", "-o", "man", "--force"], dir);
    assert!(fs::read_to_string(dir.join("man/lumenmesh.1")).expect("page").contains("lumenmesh"));
}
