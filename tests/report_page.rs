//! report.html in a browser without a window: the 3D view starts, every button is there, nothing is loaded.

use std::fs;
use std::path::Path;
use std::process::Command;

fn chromium(args: &[&str], page: &Path, dir: &Path) -> Option<String> {
    let out = Command::new("chromium")
        .args(["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--virtual-time-budget=20000"])
        .arg(format!("--user-data-dir={}", dir.join("browser").display()))
        // Whatever the page asks for outside of itself fails.
        .arg("--host-resolver-rules=MAP * ~NOTFOUND")
        .args(args)
        .arg(format!("file://{}", page.display()))
        .output();
    match out {
        Ok(out) => Some(String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr)),
        Err(_) => {
            eprintln!("SKIPPED: chromium is not installed");
            None
        }
    }
}

#[test]
fn the_page_works_by_itself() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dir = dir.path();
    let run = |args: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_lumenmesh")).args(args).current_dir(dir).output().expect("starts");
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    };
    run(&["phantom", "tube", "-o", "case"]);
    run(&["run", "case/case.yaml", "-o", "out", "--quiet", "--set", "surface.scale=2", "--set", "exports=[vtk, openfoam]"]);
    let page = dir.join("out/report.html");
    let text = fs::read_to_string(&page).expect("report.html");
    // All that a browser would fetch: nothing has an address.
    for tag in ["src=\"http", "href=\"http", "<link", "@import", "url("] {
        assert!(!text.contains(tag), "the page has {tag}");
    }
    for heading in ["Mesh", "Pictures", "Gates", "Histograms", "Worst places", "Fidelity to the mask", "Openings", "Hand-over sheet", "Stages", "Provenance"] {
        assert!(text.contains(&format!("<h2>{heading}")), "{heading} is missing");
    }
    let size = text.len() as f64 / 1e6;
    assert!(size < 4.0, "{size:.1} MB for a small tube");
    let Some(dom) = chromium(&["--dump-dom"], &page, dir) else { return };
    assert!(dom.contains("data-ready=\"yes\""), "the 3D view did not start: {}", dom.chars().rev().take(800).collect::<String>().chars().rev().collect::<String>());
    for option in ["patch", "skewness", "deviation", "curvature"] {
        assert!(dom.contains(&format!("<option value=\"{option}\"")), "the colour {option} is missing");
    }
    assert!(dom.contains(">worst triangle</button>") && dom.contains(">worst cell</button>"));
}
