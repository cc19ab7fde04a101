//! Bad input, one by one: the exit code, the words of the message, and that nothing is left half-written.
//!
//! `cargo test --test bad_input -- --nocapture` prints every message, to be read aloud.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn lumenmesh(args: &[&str], dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumenmesh")).args(args).current_dir(dir).output().expect("the program starts")
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Names in a folder, hidden ones too.
fn names(dir: &Path) -> Vec<String> {
    let mut all: Vec<String> =
        fs::read_dir(dir).expect("list").map(|e| e.expect("entry").file_name().to_string_lossy().into_owned()).collect();
    all.sort();
    all
}

/// The code, the words of the message, and that the folder is as it was.
fn refused(args: &[&str], dir: &Path, code: i32, words: &[&str]) {
    let before = names(dir);
    let out = lumenmesh(args, dir);
    let message = String::from_utf8_lossy(&out.stderr).into_owned();
    println!("$ lumenmesh {}\n{message}", args.join(" "));
    assert_eq!(out.status.code(), Some(code), "{args:?}: {message}");
    for w in words {
        assert!(message.contains(w), "{args:?}: `{w}` is missing in: {message}");
    }
    for internal in ["os error", "serde", "Policy", "mapping start", "unwrap", "panicked"] {
        assert!(!message.contains(internal), "{args:?}: `{internal}` speaks of internals in: {message}");
    }
    assert_eq!(names(dir), before, "{args:?}: something was left half-written: {message}");
}

const HEAD: &str = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 8\nspacings: 1 1 1\nencoding: raw\n\n";

/// A ball of radius 2.6 in a picture of 8 × 8 × 8.
fn ball() -> Vec<u8> {
    let d = |i: usize| (i as f64 - 3.5).powi(2);
    (0..512).map(|n| u8::from(d(n % 8) + d(n / 8 % 8) + d(n / 64) < 7.0)).collect()
}

fn write(dir: &Path, name: &str, parts: &[&[u8]]) {
    fs::write(dir.join(name), parts.concat()).expect("write");
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    out.write_all(bytes).expect("gzip");
    out.finish().expect("gzip")
}

#[test]
fn masks_that_cannot_be_used() {
    let dir = folder();
    let dir = dir.path();
    let with = |old: &str, new: &str| HEAD.replace(old, new).into_bytes();
    let packed = gzip(&ball());
    write(dir, "empty.nrrd", &[HEAD.as_bytes(), &[0; 512]]);
    write(dir, "full.nrrd", &[HEAD.as_bytes(), &[1; 512]]);
    let mut one = [0; 512];
    one[100] = 1;
    write(dir, "speck.nrrd", &[HEAD.as_bytes(), &one]);
    write(dir, "nan.nrrd", &[&with("1 1 1", "1 nan 1"), &ball()]);
    write(dir, "cut.nrrd", &[&with("raw", "gzip"), &packed[..packed.len() / 2]]);
    write(dir, "short.nrrd", &[HEAD.as_bytes(), &ball()[..300]]);
    write(dir, "detached.nhdr", &[&with("\n\n", "\ndata file: gone.raw\n\n")]);
    let mhd = "ObjectType = Image\nNDims = 3\nDimSize = 8 8 8\nElementSpacing = 1 1 1\nElementType = MET_UCHAR\nElementDataFile = gone.raw\n";
    write(dir, "detached.mhd", &[mhd.as_bytes()]);
    write(dir, "flat.nrrd", &[&with("sizes: 8 8 8", "sizes: 8 8").replace3("dimension: 3", "dimension: 2").replace3("1 1 1", "1 1"), &ball()[..64]]);
    write(dir, "huge.nrrd", &[&with("8 8 8", "100000 100000 100000"), &ball()]);
    write(dir, "hugegzip.nrrd", &[&with("8 8 8", "100000 100000 100000").replace3("raw", "gzip"), &packed]);
    write(dir, "zero.nrrd", &[&with("8 8 8", "8 0 8"), &ball()]);
    write(dir, "photo.nrrd", &[b"\xff\xd8\xff\xe0 JFIF"]);
    write(dir, "notes.txt", &[b"x"]);
    let two: Vec<u8> = ball().iter().enumerate().map(|(n, v)| if n / 64 < 4 { *v } else { 2 * v }).collect();
    write(dir, "labels.nrrd", &[HEAD.as_bytes(), &two]);
    let grey: Vec<u8> = (0..512usize).map(|n| (n * 2_654_435_761 >> 7) as u8).collect();
    write(dir, "grey.nrrd", &[HEAD.as_bytes(), &grey]);
    write(dir, "inverted.nrrd", &[HEAD.as_bytes(), &ball().iter().map(|v| 1 - v).collect::<Vec<u8>>()]);
    let slice: Vec<u8> = (0..512).map(|n| u8::from(n / 64 == 3 && (1..7).contains(&(n % 8)) && (1..7).contains(&(n / 8 % 8)))).collect();
    write(dir, "slice.nrrd", &[HEAD.as_bytes(), &slice]);
    write(dir, "metres.nrrd", &[&with("1 1 1", "1e-6 1e-6 1e-6"), &ball()]);
    let dicom = [vec![0; 128], b"DICM....1.2.840.10008.5.1.4.1.1.66.4".to_vec()].concat();
    write(dir, "seg.dcm", &[&dicom]);
    fs::create_dir(dir.join("series")).expect("folder");
    write(dir, "series/1", &[&[0; 128], b"DICM"]);
    let segments = "NRRD0004\ntype: uint8\ndimension: 4\nspace: LPS\nsizes: 2 8 8 8\nspace directions: none (1,0,0) (0,1,0) (0,0,1)\nencoding: raw\nSegment0_Name:=lumen\nSegment0_LabelValue:=1\nSegment0_Layer:=0\nSegment1_Name:=sac\nSegment1_LabelValue:=1\nSegment1_Layer:=1\n\n";
    write(dir, "two.seg.nrrd", &[segments.as_bytes(), &ball().iter().flat_map(|v| [*v, *v]).collect::<Vec<u8>>()]);
    write(dir, "nothing.nii", &[]);
    for (file, code, words) in [
        ("none.nrrd", 3, &["none.nrrd", "no such file", "check the path"][..]),
        ("empty.nrrd", 3, &["empty.nrrd", "mask is empty", "value 0 everywhere", "choose a label"]),
        ("full.nrrd", 3, &["full.nrrd", "no background", "choose a label"]),
        ("speck.nrrd", 4, &["holds no vessel", "1 voxels at", "check the label"]),
        ("nan.nrrd", 3, &["nan.nrrd", "spacing is [1.0, NaN, 1.0]", "set it in the file's header"]),
        ("cut.nrrd", 3, &["cut.nrrd", "end early", "copy or export it again"]),
        ("short.nrrd", 3, &["short.nrrd", "announces 512 bytes", "holds 300", "copy or export it again"]),
        ("detached.nhdr", 3, &["detached.nhdr", "gone.raw", "no such file", "put it where the header names it"]),
        ("detached.mhd", 3, &["detached.mhd", "gone.raw", "no such file", "put it where the header names it"]),
        ("flat.nrrd", 3, &["flat.nrrd", "sizes [8, 8]", "three axes"]),
        ("huge.nrrd", 3, &["huge.nrrd", "announces 1000000000000000 bytes", "copy or export it again"]),
        ("hugegzip.nrrd", 3, &["hugegzip.nrrd", "announces 1000000000000000 bytes", "copy or export it again"]),
        ("zero.nrrd", 3, &["zero.nrrd", "dimensions [8, 0, 8]"]),
        ("photo.nrrd", 3, &["photo.nrrd", "NRRD0", "give a NRRD file"]),
        ("notes.txt", 3, &["notes.txt", "format", ".nii.gz", "convert"]),
        ("nothing.nii", 3, &["nothing.nii", "header", "export it again"]),
        ("labels.nrrd", 3, &["labels.nrrd", "the image holds labels", "1 (", "2 (", "voxels)", "input.label="]),
        ("grey.nrrd", 3, &["grey.nrrd", "grey image", "input.threshold", "input.label"]),
        ("inverted.nrrd", 3, &["inverted.nrrd", "inverted", "input.label=0"]),
        ("slice.nrrd", 4, &["more than two voxels thick", "input.label"]),
        ("metres.nrrd", 3, &["metres.nrrd", "no vessel has that size", "input.units"]),
        ("seg.dcm", 3, &["seg.dcm", "a DICOM file", "segimage2itkimage", "3D Slicer"]),
        ("series", 3, &["a folder of DICOM files", "SimpleITK", "dcmqi"]),
        ("two.seg.nrrd", 3, &["`lumen` (label 1, ", "`sac` (label 1, ", "input.label="]),
    ] {
        refused(&["mesh", file, "-o", "out"], dir, code, words);
    }
}

/// `replace` for the bytes of a header.
trait Replace3 {
    fn replace3(&self, old: &str, new: &str) -> Vec<u8>;
}

impl Replace3 for Vec<u8> {
    fn replace3(&self, old: &str, new: &str) -> Vec<u8> {
        String::from_utf8_lossy(self).replace(old, new).into_bytes()
    }
}

#[test]
fn case_files_that_cannot_be_used() {
    let dir = folder();
    let dir = dir.path();
    write(dir, "ok.nrrd", &[HEAD.as_bytes(), &ball()]);
    // Every case file of tests/bad-input begins with `# exit CODE` and `# says: words | words`.
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bad-input");
    let mut files: Vec<_> = fs::read_dir(cases).expect("tests/bad-input").map(|e| e.expect("entry").path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "yaml"));
    files.sort();
    assert!(files.len() > 20, "{} case files", files.len());
    for file in files {
        let text = fs::read_to_string(&file).expect("UTF-8");
        let mut lines = text.lines();
        let code = lines.next().and_then(|l| l.strip_prefix("# exit ")).and_then(|c| c.parse().ok()).expect("# exit CODE");
        let says: Vec<&str> = lines.next().and_then(|l| l.strip_prefix("# says: ")).expect("# says:").split(" | ").collect();
        let name = file.file_name().expect("name").to_string_lossy().into_owned();
        fs::copy(&file, dir.join(&name)).expect("copy");
        refused(&["run", &name, "-o", "out"], dir, code, &says);
    }
    fs::write(dir.join("empty.yaml"), "").expect("write");
    refused(&["run", "empty.yaml", "-o", "out"], dir, 2, &["empty.yaml", "the file is empty", "`input: {mask: vessel.nrrd}`"]);
    fs::write(dir.join("latin.yaml"), b"input: {mask: ok.nrrd}\n# caf\xe9\n").expect("write");
    refused(&["run", "latin.yaml", "-o", "out"], dir, 2, &["latin.yaml:2", "not UTF-8", "save the file as UTF-8"]);
    refused(&["run", "none.yaml", "-o", "out"], dir, 2, &["none.yaml", "no such file", "check the path"]);
}

#[test]
fn files_of_the_wrong_kind_are_sent_to_the_right_command() {
    let dir = folder();
    let dir = dir.path();
    write(dir, "ok.nrrd", &[HEAD.as_bytes(), &ball()]);
    fs::write(dir.join("case.yaml"), "input: {mask: ok.nrrd}\n").expect("write");
    for (args, code, words) in [
        (&["run", "ok.nrrd", "-o", "out"][..], 2, &["ok.nrrd", "not a case file", "lumenmesh mesh ok.nrrd"][..]),
        (&["validate", "ok.nrrd"], 2, &["not a case file"]),
        (&["mesh", "case.yaml", "-o", "out"], 2, &["case.yaml", "is a case file", "lumenmesh run case.yaml"]),
        (&["init", "case.yaml"], 2, &["is a case file"]),
        (&["check", "."], 3, &["is a folder", "name a mesh"]),
        (&["mesh", "ok.nrrd", "-o", "out", "--set", "input.label=1.5"], 2, &["one value or a list"]),
    ] {
        refused(args, dir, code, words);
    }
}

#[test]
fn a_run_that_stops_early_says_what_it_did() {
    let dir = folder();
    let made = lumenmesh(&["phantom", "tube", "-o", "case"], dir.path());
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    for (stage, said) in [("mask", "stopped after the mask, as asked"), ("reconstruction", "stopped after the reconstruction")] {
        let out = lumenmesh(&["run", "case/case.yaml", "-o", stage, "--stop-after", stage], dir.path());
        let (text, progress) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
        assert_eq!(out.status.code(), Some(0), "{text}{progress}");
        assert!(text.contains(said) && text.contains("lumen voxels") && !text.contains("MISSED"), "{text}");
        // One line a stage with its seconds, though nobody watches on a terminal.
        assert!(progress.lines().any(|l| l.starts_with("clean ") && l.contains(" s  ")), "{progress}");
    }
}

#[test]
fn overrides_that_cannot_be_used() {
    let dir = folder();
    let dir = dir.path();
    write(dir, "ok.nrrd", &[HEAD.as_bytes(), &ball()]);
    for (set, words) in [
        ("surface.scal=2", &["unknown key `scal`", "did you mean `scale`?"][..]),
        ("surface.scale=big", &["`big`", "a number"]),
        ("surface.scale", &["no `=`", "--set key.path=value"]),
        ("surface.scale=99", &["99 is out of range", "0.05 to 20"]),
        ("surface.edge_length=0.4", &["no unit", "`0.4 mm`"]),
        ("exports=[vtk, foo]", &["unknown value `foo`", "openfoam"]),
        ("volume.boundary_layers.count=-1", &["-1", "a whole number from 0 up"]),
        ("input.cleaning=3", &["3", "keys"]),
    ] {
        let words: Vec<&str> = words.iter().copied().chain(["--set", set]).collect();
        refused(&["mesh", "ok.nrrd", "-o", "out", "--set", set], dir, 2, &words);
    }
    refused(&["mesh", "ok.nrrd", "-o", "out", "--threads", "0"], dir, 2, &["--threads 0", "at least 1"]);
}

#[test]
fn a_foreign_folder_and_a_folder_that_takes_no_files_are_refused() {
    let dir = folder();
    let dir = dir.path();
    write(dir, "ok.nrrd", &[HEAD.as_bytes(), &ball()]);
    fs::create_dir(dir.join("thesis")).expect("create");
    fs::write(dir.join("thesis/chapter.tex"), "x").expect("write");
    refused(&["mesh", "ok.nrrd", "-o", "thesis"], dir, 2, &["thesis", "manifest.json", "choose another folder with -o"]);
    assert_eq!(names(&dir.join("thesis")), ["chapter.tex"]);
    refused(&["mesh", "ok.nrrd", "-o", "ok.nrrd"], dir, 2, &["ok.nrrd", "-o"]);
    refused(&["mesh", "ok.nrrd", "-o", "ok.nrrd/out"], dir, 2, &["ok.nrrd", "-o"]);
}

/// A small file system that is there for one test; `None`, said aloud, where this user may not mount.
struct Tmpfs(tempfile::TempDir);

impl Tmpfs {
    fn new(options: &str) -> Option<Tmpfs> {
        let dir = folder();
        let done = Command::new("mount").args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(dir.path()).stderr(Stdio::null()).status();
        if done.is_ok_and(|s| s.success()) {
            return Some(Tmpfs(dir));
        }
        eprintln!("SKIPPED: a file system with {options} cannot be mounted here (needs root)");
        None
    }
}

impl Drop for Tmpfs {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

#[test]
fn a_full_disk_is_said_and_earlier_results_stay_whole() {
    let dir = folder();
    write(dir.path(), "ok.nrrd", &[HEAD.as_bytes(), &ball()]);
    let Some(disk) = Tmpfs::new("size=300k") else { return };
    let out = disk.0.path().join("out");
    fs::create_dir(&out).expect("create");
    fs::write(out.join("report.json"), "earlier results").expect("write");
    let path = out.to_string_lossy();
    refused(&["mesh", "ok.nrrd", "-o", &path, "--keep"], dir.path(), 2, &["no space left"]);
    assert_eq!(names(disk.0.path()), ["out"]);
    assert_eq!(fs::read_to_string(out.join("report.json")).expect("kept"), "earlier results");
}

#[test]
fn a_read_only_folder_is_said() {
    let dir = folder();
    write(dir.path(), "ok.nrrd", &[HEAD.as_bytes(), &ball()]);
    let Some(disk) = Tmpfs::new("ro,size=300k") else { return };
    let path = disk.0.path().join("out");
    refused(&["mesh", "ok.nrrd", "-o", &path.to_string_lossy()], dir.path(), 2, &["out", "read-only", "you may write to with -o"]);
}

#[test]
fn a_failed_second_run_keeps_the_first_results() {
    let dir = folder();
    let dir = dir.path();
    write(dir, "ok.nrrd", &[HEAD.as_bytes(), &ball()]);
    let out = lumenmesh(&["mesh", "ok.nrrd", "-o", "out", "--stop-after", "mask", "--quiet"], dir);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let first = fs::read(dir.join("out/report.json")).expect("report");
    // The input vanishes; then it is there and holds nothing.
    fs::rename(dir.join("ok.nrrd"), dir.join("away.nrrd")).expect("rename");
    refused(&["mesh", "ok.nrrd", "-o", "out"], dir, 3, &["ok.nrrd", "no such file"]);
    write(dir, "ok.nrrd", &[HEAD.as_bytes(), &[0; 512]]);
    refused(&["mesh", "ok.nrrd", "-o", "out"], dir, 3, &["mask is empty"]);
    assert_eq!(fs::read(dir.join("out/report.json")).expect("report"), first);
}

#[test]
fn an_interrupted_run_ends_with_130_and_leaves_nothing() {
    let dir = folder();
    let dir = dir.path();
    let made = lumenmesh(&["phantom", "aneurysm", "-o", "case"], dir);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let before = names(dir);
    // One signal early, one in the midst of the work.
    for (signal, wait) in [("INT", 300), ("TERM", 1500)] {
        let child = Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
            .args(["run", "case/case.yaml", "-o", "out", "--threads", "1", "--set", "surface.scale=0.6"])
            .current_dir(dir)
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .expect("starts");
        std::thread::sleep(Duration::from_millis(wait));
        let start = Instant::now();
        let sent = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().expect("kill");
        assert!(sent.success(), "the run was over before the signal");
        let out = child.wait_with_output().expect("ends");
        let message = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(130), "{message}");
        assert!(message.contains("interrupted; nothing was written"), "{message}");
        assert!(start.elapsed() < Duration::from_secs(20), "it took {:?} to stop", start.elapsed());
        assert_eq!(names(dir), before, "{message}");
    }
}

#[test]
fn a_reader_that_has_gone_is_no_error() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_lumenmesh"))
        .args(["phantom", "list"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts");
    drop(child.stdout.take());
    let out = child.wait_with_output().expect("ends");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}
