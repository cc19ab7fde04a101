//! Other ways in and out of a case: a commented case to start from, surfaces, probability maps, flow extensions.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use lumenmesh::geometry::Vector;
use lumenmesh::implicit::Implicit;
use serde_json::Value;

fn lumenmesh(args: &[&str], dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumenmesh")).args(args).current_dir(dir).output().expect("the program starts")
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn done(args: &[&str], dir: &Path) -> String {
    let out = lumenmesh(args, dir);
    let text = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert_eq!(out.status.code(), Some(0), "{args:?}: {text}");
    text
}

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

fn report(dir: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(dir.join("report.json")).expect("report.json")).expect("JSON")
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or_else(|| panic!("{v} is no number"))
}

fn point(v: &Value) -> Vector {
    Vector::new(number(&v[0]), number(&v[1]), number(&v[2]))
}

fn same_openings(a: &Value, b: &Value, distance: f64) {
    like_openings(a, b, distance, 0.01);
}

fn like_openings(a: &Value, b: &Value, distance: f64, area: f64) {
    let (a, b) = (a["openings"].as_array().expect("openings"), b["openings"].as_array().expect("openings"));
    assert_eq!(a.len(), b.len());
    for (o, p) in a.iter().zip(b) {
        assert_eq!((&o["name"], &o["id"], &o["kind"]), (&p["name"], &p["id"], &p["kind"]));
        assert!((point(&o["center"]) - point(&p["center"])).norm() < distance, "{o} {p}");
        assert!((number(&o["area"]) / number(&p["area"]) - 1.0).abs() < area, "{o} {p}");
    }
}

#[test]
fn a_case_made_by_init_and_run_unedited_has_the_openings_that_a_run_finds_by_itself() {
    let dir = folder();
    let dir = dir.path();
    done(&["phantom", "bifurcation", "-o", "case"], dir);
    done(&["init", "case/mask.nrrd", "-o", "own.yaml", "--set", "surface.scale=1.5"], dir);
    let text = fs::read_to_string(dir.join("own.yaml")).expect("own.yaml");
    for word in ["mask: case/mask.nrrd", "# image", "name: outlet_2", "confidence", "scale: 1.5", "# extensions:"] {
        assert!(text.contains(word), "`{word}` is missing in:\n{text}");
    }
    done(&["run", "own.yaml", "-o", "planes", "--stop-after", "surface"], dir);
    done(&["run", "case/case.yaml", "-o", "found", "--stop-after", "surface", "--set", "surface.scale=1.5"], dir);
    same_openings(&report(&dir.join("planes")), &report(&dir.join("found")), 0.01);
    refused(&["init", "case/mask.nrrd", "-o", "own.yaml"], dir, 2, &["own.yaml", "--force"]);
    assert_eq!(fs::read_to_string(dir.join("own.yaml")).expect("kept"), text);
}

#[test]
fn extensions_move_the_openings_out_and_keep_area_and_quality() {
    let dir = folder();
    let dir = dir.path();
    done(&["phantom", "bend", "-o", "case"], dir);
    // At the default size: polygons of fewer edges enclose areas that differ by more than sections do.
    let common = ["run", "case/case.yaml", "--stop-after", "surface"];
    done(&[&common[..], &["-o", "plain"]].concat(), dir);
    let long = ["-o", "long", "--set", "extensions.length=3 D", "--set", "extensions.blend=1 D", "--set", "extensions.openings={outlet_1: {length: 8 mm}}"];
    done(&[&common[..], &long].concat(), dir);
    let (plain, long) = (report(&dir.join("plain")), report(&dir.join("long")));
    assert!(number(&long["surface"]["s_max"]) <= 0.45, "{}", long["surface"]["s_max"]);
    for (n, e) in long["extensions"].as_array().expect("extensions").iter().enumerate() {
        let (before, after) = (&plain["openings"][n], &long["openings"][n]);
        assert!((number(&after["area"]) / number(&before["area"]) - 1.0).abs() < 0.005, "{before} {after}");
        let moved = point(&after["center"]) - point(&before["center"]);
        let diameter = (4.0 * number(&e["section_area"]) / std::f64::consts::PI).sqrt();
        let wanted = if n == 0 { 3.0 * diameter } else { 8.0 };
        assert!((moved.norm() / wanted - 1.0).abs() < 0.02, "{moved} for {wanted}");
        assert!(moved.normalize().dot(&point(&before["normal"])) > 0.99);
    }
    refused(&["run", "case/case.yaml", "-o", "x", "--set", "extensions.openings={outlet_7: {length: 8 mm}}"], dir, 2, &["outlet_7", "outlet_1"]);
}

#[test]
fn an_extension_without_room_is_left_out_with_a_warning_or_refused_where_it_was_named() {
    let dir = folder();
    let dir = dir.path();
    done(&["phantom", "kissing-anisotropic", "-o", "case"], dir);
    let common = ["run", "case/case.yaml", "--stop-after", "surface", "--set", "surface.scale=1.5", "--set", "extensions.length=12 D"];
    done(&[&common[..], &["-o", "all"]].concat(), dir);
    let r = report(&dir.join("all"));
    let extended: Vec<_> = r["extensions"].as_array().expect("extensions").iter().map(|e| e["opening"].clone()).collect();
    assert_eq!(extended, ["outlet_1"], "{r:#}");
    assert!(r["warnings"].to_string().contains("`inlet` has no extension"), "{}", r["warnings"]);
    refused(&[&common[..], &["-o", "named", "--set", "extensions.openings={inlet: {length: 12 D}}"]].concat(), dir, 4, &["`inlet`", "mm from its start"]);
}

#[test]
fn a_surface_is_meshed_anew_closed_or_open_at_its_ends() {
    let dir = folder();
    let dir = dir.path();
    done(&["phantom", "bend", "-o", "case"], dir);
    done(&["run", "case/case.yaml", "-o", "first", "--stop-after", "surface"], dir);
    let first = report(&dir.join("first"));
    // The wall alone is open at both ends.
    for (file, out, capped) in [("first/surface/lumen.stl", "closed", true), ("first/surface/wall.stl", "open", false)] {
        done(&["mesh", file, "-o", out, "--stop-after", "surface", "--set", "surface.scale=1.5"], dir);
        let r = report(&dir.join(out));
        let ends = r["input"]["ends"].as_array().expect("ends");
        assert!(ends.len() == 2 && ends.iter().all(|e| e["capped"] == capped), "{ends:?}");
        // In the planes of the first run's caps, as large as they.
        same_openings(&first, &r, 0.02 * number(&first["openings"][0]["radius"]));
        assert!(r["openings"].as_array().expect("openings").iter().all(|o| o["found_by"] == "surface-rim"));
        assert_eq!(r["fidelity"]["lost"].as_array().expect("lost").len(), 0);
        for worst in r["surface"]["worst"].as_array().expect("worst") {
            let limit = if worst["patch"] == "wall" { 0.45 } else { 0.5 };
            assert!(number(&worst["s"]) <= limit, "{worst}");
        }
        assert_eq!(r["openings"].as_array().expect("openings").len(), 2);
        let diagonal = number(&first["fidelity"]["voxel_diagonal"]);
        let off = number(&r["fidelity"]["to_input_surface"]["median"]);
        assert!(off < 0.05 * diagonal, "{off} mm from the surface given");
    }
    let soup = "solid soup\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\nvertex 2 2 3\nvertex 1 3 3\nendloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\nvertex 2 2 3\nvertex 1 2 9\nendloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\nvertex 2 2 3\nvertex 1 9 9\nendloop\nendfacet\nendsolid soup\n";
    fs::write(dir.join("soup.stl"), soup).expect("write");
    refused(&["mesh", "soup.stl", "-o", "x"], dir, 3, &["soup.stl", "1.0000, 2.0000, 3.0000"]);
}

/// A tube of radius 2 from z = 0 to 40 as ASCII STL, some triangles turned, doubled, and without shared points; its upper end cut obliquely.
fn faulty_tube(tilt: f64) -> String {
    let n = 32;
    let slope = tilt.to_radians().tan();
    let corner = |i: u32, k: u32| {
        let a = std::f64::consts::TAU * f64::from(i % n) / f64::from(n);
        let top = 40.0 + 2.0 * a.cos() * slope;
        [2.0 * a.cos(), 2.0 * a.sin(), top * f64::from(k) / 20.0]
    };
    let mut text = String::from("solid tube\n");
    let mut facet = |t: [[f64; 3]; 3], noise: f64| {
        text += "facet normal 0 0 0\nouter loop\n";
        t.iter().for_each(|p| text += &format!("vertex {} {} {}\n", p[0] + noise, p[1] - noise, p[2]));
        text += "endloop\nendfacet\n";
    };
    for (count, (i, k)) in (0..n).flat_map(|i| (0..20).map(move |k| (i, k))).enumerate() {
        let (a, b, c, d) = (corner(i, k), corner(i + 1, k), corner(i + 1, k + 1), corner(i, k + 1));
        let noise = 1e-6 * (count % 3) as f64;
        facet(if count % 5 == 0 { [a, c, b] } else { [a, b, c] }, noise);
        facet([a, c, d], noise);
        if count % 50 == 0 {
            facet([a, c, d], noise);
        }
    }
    text + "endsolid tube\n"
}

#[test]
fn a_surface_with_faults_is_repaired_and_told_and_opened_in_its_rims() {
    let dir = folder();
    let dir = dir.path();
    fs::write(dir.join("tube.stl"), faulty_tube(35.0)).expect("write");
    let text = done(&["mesh", "tube.stl", "-o", "out", "--stop-after", "surface"], dir);
    for word in ["points lay at the place of another", "triangles were turned", "copies of others"] {
        assert!(text.contains(word), "`{word}` is missing in {text}");
    }
    let r = report(&dir.join("out"));
    let section = 0.5 * 32.0 * 4.0 * (std::f64::consts::TAU / 32.0).sin();
    let openings = r["openings"].as_array().expect("openings");
    assert_eq!(openings.len(), 2);
    for o in openings {
        let upper = number(&o["center"][2]) > 20.0;
        let cosine = if upper { 35f64.to_radians().cos() } else { 1.0 };
        assert!((number(&o["area"]) * cosine / section - 1.0).abs() < 0.01, "{o}");
        assert!((number(&o["normal"][2]).abs() - cosine).abs() < 1e-3, "{o}");
        assert!((number(&o["center"][2]) - if upper { 40.0 } else { 0.0 }).abs() < 0.02, "{o}");
    }
    assert!((number(&r["fidelity"]["to_input_surface"]["volume_ratio"]) - 1.0).abs() < 0.01, "{}", r["fidelity"]["to_input_surface"]);
    assert!(number(&r["fidelity"]["to_input_surface"]["from"]["max"]) < 0.1, "{}", r["fidelity"]["to_input_surface"]);
}

#[test]
fn a_probability_map_tells_the_wall_better_than_its_mask() {
    let dir = folder();
    let dir = dir.path();
    let phantom = lumenmesh::phantom::build("bend").expect("built in");
    let mask = phantom.mask();
    let truth = &phantom.truth;
    // A soft edge a voxel wide.
    let grid = &mask.grid;
    let edge = grid.spacing()[0];
    let values = (0..grid.len()).map(|n| {
        let p = grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)));
        (1.0 / (1.0 + (truth.value(&p) / (0.5 * edge)).exp())) as f32
    });
    let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
    let axis = |a: usize| format!("({},{},{})", grid.axes[(0, a)], grid.axes[(1, a)], grid.axes[(2, a)]);
    let [nx, ny, nz] = grid.dims;
    let header = format!(
        "NRRD0004\ntype: float\ndimension: 3\nspace: left-posterior-superior\nsizes: {nx} {ny} {nz}\nspace directions: {} {} {}\nspace origin: ({},{},{})\nendian: little\nencoding: raw\n\n",
        axis(0), axis(1), axis(2), grid.origin.x, grid.origin.y, grid.origin.z
    );
    fs::write(dir.join("map.nrrd"), [header.into_bytes(), bytes].concat()).expect("write");
    fs::write(dir.join("c.yaml"), "input: {probability: map.nrrd}\nsurface: {scale: 0.7}\n").expect("write");
    done(&["run", "c.yaml", "-o", "out", "--stop-after", "surface"], dir);
    let r = report(&dir.join("out"));
    assert_eq!(r["openings"].as_array().expect("openings").len(), 2);
    let lumenmesh::io::mesh::AnyMesh::Surface(mesh) = lumenmesh::io::mesh::read(&dir.join("out/surface/lumen.vtp")).expect("reads") else {
        panic!("a surface")
    };
    let wall = (0..mesh.triangles.len()).filter(|&t| mesh.patch[t] == lumenmesh::mesh::WALL).flat_map(|t| mesh.triangles[t]);
    let mut off: Vec<f64> = wall.map(|v| truth.value(&mesh.points[v as usize]).abs()).collect();
    off.sort_by(f64::total_cmp);
    let median = off[off.len() / 2] / grid.voxel_diagonal();
    assert!(median < 0.01, "{median} voxel diagonals from the truth");
    fs::write(dir.join("no.yaml"), "input: {probability: map.nrrd, isovalue: 1.5}\n").expect("write");
    refused(&["run", "no.yaml", "-o", "x"], dir, 3, &["1.5"]);
}

#[test]
fn a_mask_of_which_every_seventh_boundary_voxel_is_wrong_has_the_ends_and_the_size_of_the_clean_one() {
    use lumenmesh::{io, mask};
    let dir = folder();
    let dir = dir.path();
    done(&["phantom", "bend", "-o", "case"], dir);
    let image = io::image::read(dir.join("case/mask.nrrd")).expect("the phantom's mask");
    let mut noisy = mask::select(&image, &Default::default()).expect("lumen");
    let clean = noisy.clone();
    let mut state = 12345u64;
    for n in 0..clean.data.len() {
        let [i, j, k] = clean.grid.voxel(n).map(|c| c as i64);
        let differs = |d: [i64; 3]| clean.at(i + d[0], j + d[1], k + d[2]) != clean.at(i, j, k);
        if [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]].into_iter().any(differs) {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            if (state >> 33) % 7 == 0 {
                noisy.data[n] = 1 - noisy.data[n];
            }
        }
    }
    io::nrrd::write_mask(&dir.join("noisy.nrrd"), &noisy).expect("written");
    done(&["mesh", "case/mask.nrrd", "-o", "clean", "--stop-after", "surface", "--set", "surface.scale=1.5"], dir);
    done(&["mesh", "noisy.nrrd", "-o", "noisy", "--stop-after", "surface", "--set", "surface.scale=1.5"], dir);
    let (clean, noisy) = (report(&dir.join("clean")), report(&dir.join("noisy")));
    assert!(clean["reconstruction"]["passed_over"].is_null());
    assert!(number(&noisy["reconstruction"]["passed_over"]["removed"]) > 50.0, "{}", noisy["reconstruction"]);
    assert!(noisy["warnings"].to_string().contains("noisy"));
    let faces = |r: &Value| number(&r["surface"]["faces"]);
    assert!((faces(&noisy) / faces(&clean) - 1.0).abs() < 0.15, "{} {}", faces(&noisy), faces(&clean));
    // Half a voxel.
    like_openings(&clean, &noisy, 0.25, 0.03);
}

#[test]
fn cells_too_coarse_for_a_thin_vessel_are_made_finer_and_it_is_told() {
    let dir = folder();
    let dir = dir.path();
    done(&["phantom", "thin", "-o", "case"], dir);
    lumenmesh(&["mesh", "case/mask.nrrd", "-o", "out", "--stop-after", "reconstruction", "--set", "reconstruction.cell=2"], dir);
    let out = report(&dir.join("out"));
    assert_eq!(number(&out["surface"]["topology"]["euler"]), 2.0 * number(&out["cleaning"]["after"]["euler"]));
    assert!(number(&out["reconstruction"]["finer_cells"]) < 2.0, "{}", out["reconstruction"]);
    // Nothing of it is cut, and the vessels go on beyond the picture: so does the mask that the wall is held against.
    lumenmesh(&["mesh", "case/mask.nrrd", "-o", "fine", "--stop-after", "reconstruction"], dir);
    let fine = report(&dir.join("fine"));
    assert!(fine["reconstruction"]["finer_cells"].is_null());
    assert!(number(&fine["fidelity"]["from_marching_cubes"]["max"]) < 0.6, "{}", fine["fidelity"]);
}

#[test]
fn a_mask_with_values_between_its_levels_has_its_wall_half_way_below_the_voxel() {
    let dir = folder();
    let dir = dir.path();
    let phantom = lumenmesh::phantom::build("bend").expect("built in");
    let (mask, truth) = (phantom.mask(), &phantom.truth);
    let grid = &mask.grid;
    let value = |n: usize| {
        let p = grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)));
        (255.0 / (1.0 + (truth.value(&p) / (0.5 * grid.spacing()[0])).exp())).round() as u8
    };
    let axis = |a: usize| format!("({},{},{})", grid.axes[(0, a)], grid.axes[(1, a)], grid.axes[(2, a)]);
    let ([nx, ny, nz], o) = (grid.dims, grid.origin);
    let header = format!(
        "NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: {nx} {ny} {nz}\nspace directions: {} {} {}\nspace origin: ({},{},{})\nencoding: raw\n\n",
        axis(0), axis(1), axis(2), o.x, o.y, o.z
    );
    fs::write(dir.join("soft.nrrd"), [header.into_bytes(), (0..grid.len()).map(value).collect()].concat()).expect("write");
    let said = done(&["mesh", "soft.nrrd", "-o", "out", "--stop-after", "surface", "--set", "surface.scale=0.8"], dir);
    assert!(said.contains("half-way value"), "{said}");
    let r = report(&dir.join("out"));
    assert!((number(&r["input"]["isovalue"]) - 127.5).abs() < 1.0, "{}", r["input"]);
    let lumenmesh::io::mesh::AnyMesh::Surface(mesh) = lumenmesh::io::mesh::read(&dir.join("out/surface/lumen.vtp")).expect("reads") else {
        panic!("a surface")
    };
    let wall = (0..mesh.triangles.len()).filter(|&t| mesh.patch[t] == lumenmesh::mesh::WALL).flat_map(|t| mesh.triangles[t]);
    let mut off: Vec<f64> = wall.map(|v| truth.value(&mesh.points[v as usize]).abs()).collect();
    off.sort_by(f64::total_cmp);
    let median = off[off.len() / 2] / grid.voxel_diagonal();
    assert!(median < 0.015, "{median} voxel diagonals from the truth");
    // A label of it other than its upper level would be a shell of single values.
    refused(&["mesh", "soft.nrrd", "-o", "x", "--set", "input.label=100"], dir, 3, &["100", "input.threshold"]);
}
