//! Faults at every step of putting results in their place: whatever happens, nothing of a person's is lost.

use std::collections::BTreeMap;

use super::disk::fault::{self, Fault};
use super::*;

const RUN: Origin = Origin { command: "run", case: None };

/// A run that writes these files.
fn run(target: &Path, earlier: Earlier, files: &[(&str, &str)]) -> Result<Option<PathBuf>, Failure> {
    let staging = Staging::new(target, earlier)?;
    for (name, text) in files {
        write(&staging.path().join(name), text.as_bytes())?;
    }
    staging.publish(RUN)
}

fn results(text: &str) -> [(&'static str, &str); 3] {
    [("report.json", text), ("openfoam/0/p", text), ("openfoam/system/controlDict", text)]
}

fn replaced(target: &Path, text: &str) {
    assert_eq!(run(target, Earlier::Replace, &results(text)).map_err(|e| e.message()), Ok(None));
}

fn refusal(target: &Path) -> String {
    let e = Staging::new(target, Earlier::Replace).err().expect("refused");
    assert_eq!(e.code(), USAGE);
    e.message()
}

/// Every file under a folder with its content; links by where they lead.
fn tree(dir: &Path) -> BTreeMap<String, String> {
    let mut all = BTreeMap::new();
    let mut open = vec![dir.to_path_buf()];
    while let Some(folder) = open.pop() {
        for path in fs::read_dir(&folder).into_iter().flatten().map(|e| e.expect("entry").path()) {
            let name = path.strip_prefix(dir).expect("inside").display().to_string();
            let meta = fs::symlink_metadata(&path).expect("there");
            if meta.is_dir() {
                open.push(path);
            } else if meta.is_file() {
                all.insert(name, fs::read_to_string(&path).expect("text"));
            } else {
                all.insert(name, format!("{:?}", fs::read_link(&path).ok()));
            }
        }
    }
    all
}

/// The whole results with this text under a folder of `tree`, manifest included.
fn whole(tree: &BTreeMap<String, String>, folder: &str, text: &str) -> bool {
    let under: BTreeMap<&str, &str> =
        tree.iter().filter_map(|(k, v)| Some((k.strip_prefix(folder)?.strip_prefix('/')?, v.as_str()))).collect();
    under.len() == 4 && under.contains_key(manifest::FILE) && results(text).iter().all(|(k, v)| under.get(k) == Some(v))
}

fn folder() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("temporary folder");
    let target = dir.path().join("out");
    (dir, target)
}

#[test]
fn results_appear_only_when_published_and_replace_earlier_ones() {
    let (dir, target) = folder();
    let staging = Staging::new(&target, Earlier::Replace).expect("new");
    write(&staging.path().join("report.json"), b"1").expect("write");
    assert!(!target.exists());
    staging.publish(RUN).expect("publish");
    let second = Staging::new(&target, Earlier::Replace).expect("again");
    write(&second.path().join("report.json"), b"2").expect("write");
    assert_eq!(fs::read(target.join("report.json")).expect("old kept"), b"1");
    second.publish(RUN).expect("publish");
    assert_eq!(fs::read(target.join("report.json")).expect("new"), b"2");
    assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 1, "nothing is left beside");
    drop(Staging::new(&target, Earlier::Replace).expect("a run that fails"));
    assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 1, "nothing is left beside");
}

#[test]
fn the_manifest_lists_every_file_with_its_size_and_hash() {
    let (_dir, target) = folder();
    let staging = Staging::new(&target, Earlier::Replace).expect("new");
    write(&staging.path().join("surface/a.stl"), b"abc").expect("write");
    staging.publish(Origin { command: "run", case: Some("12ab") }).expect("publish");
    let text = fs::read_to_string(target.join(".lumenmesh/manifest.json")).expect("manifest");
    let m: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(
        (&m["version"], &m["command"], &m["case"]),
        (&env!("CARGO_PKG_VERSION").into(), &"run".into(), &"12ab".into())
    );
    let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!(m["files"], serde_json::json!([{"path": "surface/a.stl", "size": 3, "sha256": abc}]));
    assert_eq!(m["folders"], serde_json::json!(["surface"]));
}

/// Something that a person did to results, and the words of the refusal.
type Change = (&'static str, fn(&Path));

#[test]
fn whatever_a_person_or_a_solver_adds_or_changes_is_kept() {
    let changes: [Change; 14] = [
        ("openfoam/295/ (not written by lumenmesh)", |o| put(o, "openfoam/295/U")),
        ("openfoam/processor0/ (not", |o| put(o, "openfoam/processor0/0/U")),
        ("openfoam/postProcessing/ (not", |o| put(o, "openfoam/postProcessing/p.dat")),
        ("openfoam/log.simpleFoam (not", |o| put(o, "openfoam/log.simpleFoam")),
        ("openfoam/0/wallShearStress (not", |o| put(o, "openfoam/0/wallShearStress")),
        ("fluent/ (not", |o| put(o, "fluent/lumen.cas.h5")),
        ("notes.txt (not", |o| put(o, "notes.txt")),
        (".lumenmesh/mine (not", |o| put(o, ".lumenmesh/mine")),
        ("mine/ (not", |o| fs::create_dir(o.join("mine")).expect("folder")),
        ("openfoam/system/controlDict (changed)", |o| {
            fs::write(o.join("openfoam/system/controlDict"), "2").expect("same length")
        }),
        ("report.json (changed)", |o| fs::write(o.join("report.json"), "longer").expect("write")),
        ("link (a link)", |o| std::os::unix::fs::symlink("report.json", o.join("link")).expect("link")),
        ("report.json (write-protected)", |o| protect(&o.join("report.json"), 0o444)),
        ("openfoam/ (write-protected)", |o| protect(&o.join("openfoam"), 0o555)),
    ];
    for (words, change) in changes {
        let (dir, target) = folder();
        replaced(&target, "1");
        change(&target);
        let before = tree(&target);
        let said = refusal(&target);
        assert!(said.contains(words) && said.contains("--keep"), "{words}: {said}");
        assert_eq!(tree(&target), before, "{words}");
        assert_eq!(
            run(&target, Earlier::Keep, &results("2")).map_err(|e| e.message()),
            Ok(Some(dir.path().join("out.1"))),
            "{words}"
        );
        assert_eq!(tree(&dir.path().join("out.1")), before, "{words}");
        assert!(whole(&tree(dir.path()), "out", "2"), "{words}");
        protect(&dir.path().join("out.1/openfoam"), 0o755);
    }
}

fn put(out: &Path, name: &str) {
    let path = out.join(name);
    fs::create_dir_all(path.parent().expect("parent")).expect("folders");
    fs::write(path, "mine").expect("write");
}

fn protect(path: &Path, mode: u32) {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("permissions");
}

#[test]
fn a_file_that_a_person_removed_or_touched_is_no_loss() {
    let (_dir, target) = folder();
    replaced(&target, "1");
    fs::remove_dir_all(target.join("openfoam/0")).expect("removed");
    fs::write(target.join("report.json"), "1").expect("the same content");
    replaced(&target, "2");
    assert_eq!(fs::read(target.join("report.json")).expect("new"), b"2");
}

#[test]
fn folders_that_lumenmesh_does_not_know_are_refused_and_an_empty_one_is_used() {
    let (dir, target) = folder();
    fs::create_dir(&target).expect("empty");
    protect(&target, 0o770);
    replaced(&target, "1");
    assert_eq!(fs::metadata(&target).expect("there").mode() & 0o777, 0o770, "a folder keeps its permissions");
    fs::remove_file(target.join(manifest::FILE)).expect("as an older version left it");
    let said = refusal(&target);
    assert!(said.contains("no .lumenmesh/manifest.json") && said.contains("--keep"), "{said}");
    fs::write(target.join(manifest::FILE), "{\"format\": 1").expect("damaged");
    assert!(refusal(&target).contains("cannot be used"), "{}", refusal(&target));
    fs::write(dir.path().join("file"), "x").expect("write");
    assert!(refusal(&dir.path().join("file")).contains("is a file"));
    std::os::unix::fs::symlink("nowhere", dir.path().join("dangling")).expect("link");
    assert!(refusal(&dir.path().join("dangling")).contains("leads nowhere"));
    assert!(refusal(Path::new("/")).contains("root"));
    assert!(refusal(Path::new(".")).contains("you are in"));
    if Path::new("/proc/self").exists() {
        assert!(refusal(Path::new("/proc")).contains("mount point"));
    }
}

#[test]
fn a_link_to_a_folder_stays_a_link() {
    let (dir, target) = folder();
    let real = dir.path().join("disk/real");
    replaced(&real, "1");
    std::os::unix::fs::symlink(&real, &target).expect("link");
    replaced(&target, "2");
    assert!(fs::symlink_metadata(&target).expect("there").is_symlink());
    assert!(whole(&tree(dir.path()), "disk/real", "2"));
    let kept = run(&target, Earlier::Keep, &results("3")).map_err(|e| e.message());
    assert_eq!(kept, Ok(Some(real.with_file_name("real.1").canonicalize().expect("there"))));
}

#[test]
fn a_second_run_into_the_same_folder_is_refused_and_a_dead_ones_lock_is_not() {
    let (dir, target) = folder();
    let first = Staging::new(&target, Earlier::Replace).expect("first");
    let said = refusal(&target);
    assert!(said.contains("another run") && said.contains(&std::process::id().to_string()), "{said}");
    write(&first.path().join("report.json"), b"1").expect("write");
    first.publish(RUN).expect("publish");
    // A process that died holds no lock, its file and its half-written results stay.
    let work = dir.path().join(".out.lumenmesh");
    fs::create_dir_all(work.join("new/surface")).expect("folders");
    fs::write(work.join("lock"), "lumenmesh 1\n").expect("lock");
    fs::write(work.join("new/surface/lumen.vtp"), "half").expect("half");
    replaced(&target, "2");
    assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 1, "{:?}", tree(dir.path()));
}

#[test]
fn a_working_folder_that_is_not_ours_is_left_alone() {
    for name in ["lock", "thesis.tex"] {
        let (dir, target) = folder();
        fs::create_dir(dir.path().join(".out.lumenmesh")).expect("folder");
        fs::write(dir.path().join(".out.lumenmesh").join(name), "mine").expect("write");
        let before = tree(dir.path());
        assert!(refusal(&target).contains("in the way"), "{}", refusal(&target));
        assert_eq!(tree(dir.path()), before);
    }
}

#[test]
fn inputs_inside_the_folder_are_not_replaced() {
    let (dir, target) = folder();
    replaced(&target, "1");
    let staging = Staging::new(&target, Earlier::Replace).expect("new");
    let input = target.join("report.json");
    assert!(staging.guard([input.clone()].into_iter()).is_err_and(|e| e.message().contains("input of this run")));
    assert!(staging.guard([dir.path().join("mask.nrrd")].into_iter()).is_ok());
    drop(staging);
    assert!(Staging::new(&target, Earlier::Keep).expect("new").guard([input].into_iter()).is_ok());
}

/// Who has results in the folder before the run.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Before {
    Nothing,
    Empty,
    Ours,
    Person,
}

fn prepare(target: &Path, before: Before) {
    match before {
        Before::Nothing => {}
        Before::Empty => fs::create_dir(target).expect("folder"),
        Before::Ours => replaced(target, "old"),
        Before::Person => {
            replaced(target, "old");
            put(target, "mine.txt");
        }
    }
}

/// After any fault and one more run: nothing of a person's is lost and no folder is half-written.
fn check(dir: &Path, before: Before, what: &str) {
    let now = tree(dir);
    let places = ["out", "out.1", "out.2", ".out.lumenmesh/new", ".out.lumenmesh/old"];
    let person = |now: &BTreeMap<String, String>| {
        places.iter().any(|p| now.get(&format!("{p}/mine.txt")).is_some_and(|t| t == "mine"))
    };
    let old = |now: &BTreeMap<String, String>| {
        places.iter().any(|p| results("old").iter().all(|(k, v)| now.get(&format!("{p}/{k}")).is_some_and(|t| t == v)))
    };
    let new = whole(&now, "out", "new");
    if before == Before::Person {
        assert!(person(&now) && old(&now), "{what}: {now:?}");
    }
    if before == Before::Ours {
        assert!(new || old(&now), "{what}: {now:?}");
    }
    // What stands in the place is whole: old, new, or nothing.
    let there = now.keys().any(|k| k.starts_with("out/"));
    assert!(!there || new || whole(&now, "out", "old") || before == Before::Person, "{what}: {now:?}");
    // The next run puts it right.
    let earlier = if before == Before::Person { Earlier::KeepChanged } else { Earlier::Replace };
    run(dir.join("out").as_path(), earlier, &results("next")).unwrap_or_else(|e| panic!("{what}: {}", e.message()));
    let then = tree(dir);
    assert!(whole(&then, "out", "next"), "{what}: {then:?}");
    assert!(!then.keys().any(|k| k.starts_with(".out.lumenmesh")), "{what}: {then:?}");
    if before == Before::Person {
        assert!(person(&then) && old(&then), "{what}: {then:?}");
    }
}

#[test]
fn no_fault_at_any_step_loses_or_halves_anything() {
    let mut injected = 0;
    for before in [Before::Nothing, Before::Empty, Before::Ours, Before::Person] {
        // Only results that are replaced are exchanged.
        for no_exchange in [false, true].into_iter().filter(|n| !n || before == Before::Ours) {
            for kind in [None, Some(ErrorKind::StorageFull), Some(ErrorKind::AlreadyExists)] {
                for at in 1.. {
                    let (dir, target) = folder();
                    prepare(&target, before);
                    let earlier = if before == Before::Person { Earlier::Keep } else { Earlier::Replace };
                    fault::plan(at, kind.map_or(Fault::Die, Fault::Fail), no_exchange);
                    let done = run(&target, earlier, &results("new"));
                    let steps = fault::clear();
                    check(
                        dir.path(),
                        before,
                        &format!(
                            "{before:?}, {kind:?} at step {at}, no exchange {no_exchange}, {:?}",
                            done.err().map(|e| e.message())
                        ),
                    );
                    if steps < at {
                        break;
                    }
                    injected += 1;
                }
            }
        }
    }
    eprintln!("{injected} faults injected, nothing lost");
    assert!(injected > 250, "{injected}");
}

#[test]
fn old_results_outlive_a_kill_between_two_renames_and_a_person_in_their_place() {
    let mut met = 0;
    for at in 1.. {
        let (dir, target) = folder();
        replaced(&target, "old");
        fault::plan(at, Fault::Die, true);
        let _ = run(&target, Earlier::Replace, &results("new"));
        if fault::clear() < at {
            break;
        }
        if target.exists() {
            continue;
        }
        met += 1;
        put(&target, "mine.txt");
        assert!(refusal(&target).contains("no .lumenmesh/manifest.json"));
        let now = tree(dir.path());
        assert!(whole(&now, "out.1", "old") && now.contains_key("out/mine.txt"), "{now:?}");
    }
    assert_eq!(met, 1);
}

#[test]
fn what_comes_into_the_folder_meanwhile_is_kept_at_any_step() {
    let mut seen = [0; 3];
    for no_exchange in [false, true] {
        for at in 1.. {
            let (dir, target) = folder();
            replaced(&target, "old");
            let (solver, wrote) = (target.clone(), std::rc::Rc::new(std::cell::Cell::new(false)));
            let write = {
                let wrote = wrote.clone();
                move || {
                    // Between two renames there is no folder to write into.
                    if solver.is_dir() {
                        put(&solver, "openfoam/100/U");
                        wrote.set(true);
                    }
                }
            };
            fault::plan(at, Fault::Meanwhile(Box::new(write)), no_exchange);
            let done = run(&target, Earlier::Replace, &results("new"));
            if fault::clear() < at {
                break;
            }
            if !wrote.get() {
                assert!(no_exchange && done.is_ok(), "step {at}");
                continue;
            }
            let now = tree(dir.path());
            let kept =
                now.keys().find(|k| k.ends_with("openfoam/100/U")).unwrap_or_else(|| panic!("step {at}: {now:?}"));
            // Beside it stand the results that it belongs to: in the place, or moved aside.
            let place = kept.strip_suffix("/openfoam/100/U").expect("suffix");
            assert!(["out", "out.1"].contains(&place), "step {at}: {kept}");
            match done {
                // It came before anything was made, or while the new results were made: those are kept as well.
                Err(e) if e.message().contains("out.new") => {
                    assert!(whole(&now, "out.new", "new"), "step {at}: {now:?}");
                    seen[0] += 1;
                }
                Err(e) => {
                    assert!(e.message().contains("openfoam/100/"), "step {at}: {}", e.message());
                    seen[1] += 1;
                }
                Ok(_) => seen[2] += 1,
            }
        }
    }
    assert!(seen.iter().all(|n| *n > 0), "{seen:?}");
}

#[test]
fn a_folder_that_vanishes_meanwhile_is_an_error_or_made_anew() {
    let mut refused = 0;
    for at in 1.. {
        let (dir, target) = folder();
        let target = dir.path().join("in").join(target.file_name().expect("name"));
        replaced(&target, "old");
        let parent = dir.path().join("in");
        fault::plan(at, Fault::Meanwhile(Box::new(move || fs::remove_dir_all(parent).expect("removed"))), false);
        let done = run(&target, Earlier::Replace, &results("new"));
        if fault::clear() < at {
            break;
        }
        let now = tree(dir.path());
        let there = now.keys().any(|k| k.starts_with("in/out/"));
        assert!(!there || whole(&now, "in/out", "new"), "step {at}: {now:?}");
        refused += usize::from(done.is_err());
        replaced(&target, "next");
    }
    assert!(refused >= 10, "{refused}");
}

#[test]
fn a_working_folder_that_another_run_made_anew_is_not_touched() {
    let (dir, target) = folder();
    let first = Staging::new(&target, Earlier::Replace).expect("first");
    write(&first.path().join("report.json"), b"1").expect("write");
    fs::remove_dir_all(dir.path().join(".out.lumenmesh")).expect("removed");
    let second = Staging::new(&target, Earlier::Replace).expect("second");
    write(&second.path().join("report.json"), b"2").expect("write");
    let e = first.publish(RUN).err().map(|e| e.message()).unwrap_or_default();
    assert!(e.contains("removed or emptied"), "{e}");
    second.publish(RUN).expect("publish");
    assert_eq!(fs::read(target.join("report.json")).expect("there"), b"2");
    assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 1);
}

#[test]
fn a_named_file_is_written_whole_and_an_existing_one_kept() {
    let (dir, _) = folder();
    let file = dir.path().join("case.yaml");
    assert_eq!(place(&file, b"1", Existing::Refuse("use --force")).map_err(|e| e.message()), Ok(None));
    let e = place(&file, b"2", Existing::Refuse("use --force")).err().map(|e| e.message()).unwrap_or_default();
    assert!(e.contains("exists") && e.contains("--force"), "{e}");
    assert_eq!(place(&file, b"2", Existing::Keep).map_err(|e| e.message()), Ok(Some(dir.path().join("case.yaml.1"))));
    assert_eq!(place(&file, b"3", Existing::Replace).map_err(|e| e.message()), Ok(None));
    assert_eq!(
        (fs::read(&file).expect("new"), fs::read(dir.path().join("case.yaml.1")).expect("kept")),
        (b"3".to_vec(), b"1".to_vec())
    );
    for at in 1.. {
        fault::plan(at, Fault::Fail(ErrorKind::StorageFull), false);
        let done = place(&file, b"half-written?", Existing::Replace);
        if fault::clear() < at {
            break;
        }
        let text = fs::read(&file).expect("there");
        assert!(if done.is_ok() { text == b"half-written?" } else { text == b"3" }, "step {at}");
        assert_eq!(fs::read_dir(dir.path()).expect("list").count(), 2, "step {at}");
    }
    // A link stays a link, a device a device.
    std::os::unix::fs::symlink("case.yaml", dir.path().join("link")).expect("link");
    place(&dir.path().join("link"), b"4", Existing::Replace).expect("written");
    assert!(fs::symlink_metadata(dir.path().join("link")).expect("there").is_symlink());
    assert_eq!(fs::read(&file).expect("new"), b"4");
    assert!(place(Path::new("/dev/null"), b"5", Existing::Replace).is_ok());
}
