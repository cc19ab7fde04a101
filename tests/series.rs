//! A grid-convergence study: one vessel, three meshes, one command.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

fn report(dir: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(dir.join("report.json")).expect("report.json")).expect("JSON")
}

fn lumenmesh(arguments: &[&str], dir: &Path) {
    let out = Command::new(env!("CARGO_BIN_EXE_lumenmesh")).args(arguments).current_dir(dir).output().expect("runs");
    assert_eq!(out.status.code(), Some(0), "{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
}

#[test]
fn a_series_has_three_meshes_with_the_same_patches_and_a_table_to_fill() {
    let dir = tempfile::tempdir().expect("a folder");
    lumenmesh(&["phantom", "tube", "-o", "case"], dir.path());
    lumenmesh(&["run", "case/case.yaml", "-o", "out", "--quiet", "--set", "surface.scale=1.4", "--set", "volume.series=3"], dir.path());
    let out = dir.path().join("out");
    let all = report(&out);
    let mut sizes = vec![];
    for name in ["coarse", "medium", "fine"] {
        let own = report(&out.join("series").join(name));
        let patches: Vec<&Value> = own["openings"].as_array().expect("openings").iter().map(|o| &o["name"]).collect();
        let wanted: Vec<&Value> = all["openings"].as_array().expect("openings").iter().map(|o| &o["name"]).collect();
        assert_eq!(patches, wanted, "{name}");
        assert!(out.join("series").join(name).join("openfoam/constant/polyMesh/faces").is_file(), "{name}");
        sizes.push(own["volume"]["volume"].as_f64().expect("volume") / own["volume"]["cells"].as_f64().expect("cells"));
    }
    // Factor 1.4 on edges is 2.74 on the volume of a cell.
    for pair in sizes.windows(2) {
        assert!((1.9..3.9).contains(&(pair[0] / pair[1])), "{sizes:?}");
    }
    assert_eq!(report(&out.join("series/medium"))["volume"]["cells"], all["volume"]["cells"]);
    assert_eq!(all["series"].as_array().map(Vec::len), Some(3));
    let table = fs::read_to_string(out.join("series/convergence.csv")).expect("a table");
    assert_eq!(table.lines().count(), 4);
    assert!(table.starts_with("mesh,folder,cells,h_mm,ratio,figure\ncoarse,series/coarse,"), "{table}");
}
