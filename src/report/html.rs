//! report.html: one self-contained page with verdict, figures, pictures and an interactive view.

use std::fmt::Write as _;
use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::Value;

use super::cohort::escape;
use super::picture::{diverging, patch_colour, render, viridis};
use super::{Report, Status};
use crate::geometry::{Point, Vector};
use crate::mesh::{TriMesh, VolumeMesh};

const STYLE: &str = include_str!("page/style.css");
const VIEWER: &str = include_str!("page/viewer.js");
const THREE: &str = include_str!("vendor/three.min.js");
/// Above this many tetrahedra the page would grow too large to open with ease; the cut then shows the surface only.
const MOST_TETS: usize = 400_000;

/// What the page shows besides the report.
pub struct Scene<'a> {
    /// The surface.
    pub surface: &'a TriMesh,
    /// Equi-angle skewness of each triangle.
    pub skewness: &'a [f64],
    /// Deviation of each vertex from the mask, voxel diagonals, NaN inside caps; may be empty.
    pub deviation: Vec<f64>,
    /// Gaussian curvature at each vertex, 1/mm²; may be empty.
    pub curvature: &'a [f64],
    /// Centerlines as pairs of points.
    pub centerlines: Vec<[Point; 2]>,
    /// The volume mesh and the equi-volume skewness of each tetrahedron.
    pub volume: Option<(&'a VolumeMesh, &'a [f64])>,
    /// Name of the case.
    pub title: String,
    /// The resolved case file.
    pub case: &'a str,
}

/// The page.
pub fn page(report: &Report, scene: &Scene) -> String {
    let json = serde_json::to_value(report).unwrap_or(Value::Null);
    let mut out = format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"><title>lumenmesh: {}</title><style>{STYLE}</style></head><body>\n",
        escape(&scene.title)
    );
    head(&mut out, report, &json, &scene.title);
    viewer(&mut out, scene, &json);
    stills(&mut out, scene);
    gates(&mut out, report);
    histograms(&mut out, &json, scene);
    worst(&mut out, &json);
    fidelity(&mut out, &json);
    openings(&mut out, &json);
    stages(&mut out, report);
    details(&mut out, &json, scene.case);
    let _ = write!(out, "<script>{THREE}</script>\n<script>{VIEWER}</script>\n</body></html>\n");
    out
}

fn figure(json: &Value, path: &[&str]) -> String {
    match path.iter().try_fold(json, |at, key| at.get(key)) {
        Some(Value::Number(n)) => match (n.as_u64(), n.as_f64()) {
            (Some(i), _) => group(i),
            (None, Some(f)) => short(f),
            _ => "–".into(),
        },
        Some(Value::String(s)) => escape(s),
        Some(Value::Bool(b)) => (if *b { "yes" } else { "no" }).into(),
        _ => "–".into(),
    }
}

fn group(i: u64) -> String {
    let digits = i.to_string();
    let mut out = String::new();
    for (n, c) in digits.chars().enumerate() {
        if n > 0 && (digits.len() - n).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(c);
    }
    out
}

fn short(f: f64) -> String {
    let a = f.abs();
    if f.fract() == 0.0 && a < 1e6 {
        format!("{f}")
    } else if a != 0.0 && !(1e-3..1e6).contains(&a) {
        format!("{f:.2e}")
    } else if a >= 100.0 {
        format!("{f:.1}")
    } else {
        format!("{f:.3}")
    }
}

fn head(out: &mut String, report: &Report, json: &Value, title: &str) {
    let (class, verdict) = match report.status {
        Status::Passed => ("", "✓ All hard gates are met"),
        Status::GateMissed => (" bad", "✗ A hard gate is missed"),
    };
    let missed = report.gates.iter().filter(|g| !g.passed).map(|g| escape(&g.name)).collect::<Vec<_>>().join("; ");
    let missed = if missed.is_empty() { "nothing missed, advisory ones included".into() } else { format!("{}missed: {missed}", if report.status == Status::Passed { "advisory limits " } else { "" }) };
    let warned = match report.warnings.len() {
        0 => String::new(),
        1 => "; 1 warning below".into(),
        n => format!("; {n} warnings below"),
    };
    let _ = write!(
        out,
        "<h1>{}</h1><p class=soft>lumenmesh {} · lengths in mm, coordinates LPS</p><div class=\"verdict{class}\"><b>{verdict}</b><span>{missed}{warned}</span></div>\n<div class=tiles>",
        escape(title),
        report.version
    );
    let tiles: [(&str, &[&str]); 8] = [
        ("triangles", &["surface", "faces"]),
        ("equi-angle skewness, max", &["surface", "s_max"]),
        ("equi-angle skewness, mean", &["surface", "s_mean"]),
        ("deviation from marching cubes, median (voxel diagonals)", &["fidelity", "to_marching_cubes", "median"]),
        ("deviation from marching cubes, max (voxel diagonals)", &["fidelity", "to_marching_cubes", "max"]),
        ("cells", &["volume", "cells"]),
        ("equi-volume skewness, max", &["volume", "sv_max"]),
        ("equi-volume skewness, mean", &["volume", "sv_mean"]),
    ];
    for (name, path) in tiles {
        let _ = write!(out, "<div class=tile><b>{}</b><span>{name}</span></div>", figure(json, path));
    }
    out.push_str("</div>\n");
    if !report.warnings.is_empty() {
        out.push_str("<h2>Warnings</h2><ul>");
        for w in &report.warnings {
            let _ = write!(out, "<li>{} <span class=soft>({})</span></li>", escape(&w.message), w.stage);
        }
        out.push_str("</ul>\n");
    }
}

fn pack(out: &mut String, id: &str, bytes: impl Iterator<Item = [u8; 4]>) {
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::new(6));
    let raw: Vec<u8> = bytes.flatten().collect();
    let data = packed.write_all(&raw).and_then(|()| packed.finish()).unwrap_or_default();
    let _ = writeln!(out, "<script type=\"text/plain\" id=\"{id}\">{}</script>", base64(&data));
}

fn pack_f32<'a>(out: &mut String, id: &str, values: impl Iterator<Item = &'a f64>) {
    pack(out, id, values.map(|v| (*v as f32).to_le_bytes()));
}

/// RFC 4648.
pub(super) fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().enumerate().fold(0u32, |w, (i, b)| w | u32::from(*b) << (16 - 8 * i));
        for i in 0..4 {
            let letter = ALPHABET[(word >> (18 - 6 * i) & 63) as usize];
            out.push(if i <= chunk.len() { char::from(letter) } else { '=' });
        }
    }
    out
}

fn viewer(out: &mut String, scene: &Scene, json: &Value) {
    out.push_str(concat!(
        "<section id=viewer><h2>Mesh</h2><div class=bar><label>colour <select id=field><option value=patch>patch<option value=skewness>equi-angle skewness",
        "<option value=deviation>deviation<option value=curvature>Gaussian curvature</select></label><label><input type=checkbox id=show-edges checked> edges</label>",
        "<label><input type=checkbox id=show-lines> centerlines</label><label>cut <select id=cut-axis><option>none<option>x<option>y<option>z</select></label>",
        "<input type=range id=cut-at min=0 max=1000 value=500 aria-label=\"position of the cut\"><button id=home>reset view</button></div>",
        "<div id=view><div id=legend></div></div><p class=soft>Drag to turn, wheel to zoom, right button to move.</p>\n",
    ));
    one_click(out, json);
    let s = scene.surface;
    let patches: Vec<Value> = s.patches.iter().map(|p| serde_json::json!({"id": p.id, "name": p.name})).collect();
    let limit = 0.75;
    let _ = writeln!(
        out,
        "<script type=\"application/json\" id=\"mesh-meta\">{}</script>",
        serde_json::json!({"patches": patches, "limit": limit}).to_string().replace('<', "\\u003c")
    );
    pack_f32(out, "mesh-points", s.points.iter().flat_map(|p| p.coords.iter()));
    pack(out, "mesh-triangles", s.triangles.iter().flatten().map(|v| v.to_le_bytes()));
    let mut patch: Vec<u8> = s.patch.iter().map(|p| u8::try_from(*p).unwrap_or(u8::MAX)).collect();
    patch.resize(patch.len().div_ceil(4) * 4, 0);
    pack(out, "mesh-patch", patch.chunks(4).map(|c| [c[0], c[1], c[2], c[3]]));
    pack_f32(out, "mesh-skewness", scene.skewness.iter());
    // Vertices inside caps have no deviation; the view shows them as 0.
    let deviation: Vec<f64> = scene.deviation.iter().map(|d| if d.is_finite() { *d } else { 0.0 }).collect();
    pack_f32(out, "mesh-deviation", deviation.iter());
    pack_f32(out, "mesh-curvature", scene.curvature.iter());
    pack_f32(out, "center-lines", scene.centerlines.iter().flatten().flat_map(|p| p.coords.iter()));
    if let Some((volume, sv)) = scene.volume.filter(|(v, _)| v.tets.len() <= MOST_TETS) {
        pack_f32(out, "tet-points", volume.points.iter().flat_map(|p| p.coords.iter()));
        pack(out, "tet-cells", volume.tets.iter().flatten().map(|v| v.to_le_bytes()));
        pack_f32(out, "tet-skewness", sv.iter());
    } else if scene.volume.is_some() {
        let _ = write!(out, "<p class=soft>The volume mesh has more than {MOST_TETS} tetrahedra; the cut shows the surface only. Open volume/lumen.vtu in ParaView.</p>");
    }
    out.push_str("</section>\n");
}

/// A small picture of the surface by patch (PNG), for lists of many cases.
pub fn thumbnail(surface: &TriMesh) -> Vec<u8> {
    render(surface, Vector::y(), 224, 168, |t| patch_colour(surface.patch[t]))
}

/// The value below which `q` of the magnitudes lie; never 0.
fn magnitude(values: &[f64], q: f64) -> f64 {
    let mut all: Vec<f64> = values.iter().map(|v| v.abs()).filter(|v| v.is_finite()).collect();
    all.sort_by(f64::total_cmp);
    all.get(((all.len().saturating_sub(1)) as f64 * q) as usize).copied().unwrap_or(1.0).max(1e-12)
}

fn stills(out: &mut String, scene: &Scene) {
    out.push_str("<section class=pictures><h2>Pictures</h2><div class=stills>");
    let s = scene.surface;
    let by_patch = |t: usize| patch_colour(s.patch[t]);
    let by_skewness = |t: usize| viridis(scene.skewness[t] / 0.75);
    let at_corners = |values: &[f64], t: usize| s.triangles[t].iter().map(|v| values[*v as usize]).sum::<f64>() / 3.0;
    let mut pictures = vec![
        ("patches, from the front".to_string(), render(s, Vector::y(), 480, 360, by_patch)),
        ("patches, from the side".into(), render(s, Vector::x(), 480, 360, by_patch)),
        ("equi-angle skewness from 0 (dark) to 0.75 (yellow)".into(), render(s, Vector::y(), 480, 360, by_skewness)),
    ];
    if scene.deviation.len() == s.points.len() {
        let by_deviation = |t: usize| diverging(0.5 + at_corners(&scene.deviation, t));
        let caption = "deviation from the mask from -0.5 (blue, inside) to 0.5 voxel diagonals (orange, outside)";
        pictures.push((caption.into(), render(s, Vector::y(), 480, 360, by_deviation)));
    }
    if scene.curvature.len() == s.points.len() {
        let m = magnitude(scene.curvature, 0.95);
        let by_curvature = |t: usize| diverging(0.5 + 0.5 * at_corners(scene.curvature, t) / m);
        let caption = format!("Gaussian curvature from {} (blue, saddle) to {} / mm² (orange, dome)", short(-m), short(m));
        pictures.push((caption, render(s, Vector::y(), 480, 360, by_curvature)));
    }
    for (caption, png) in pictures {
        let _ = write!(out, "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption class=soft>{caption}</figcaption></figure>", base64(&png));
    }
    out.push_str("</div><p class=soft>");
    for p in &s.patches {
        let [r, g, b] = patch_colour(p.id).map(|c| (c * 255.0).round());
        let _ = write!(out, "<span class=key><i style=\"background:rgb({r},{g},{b})\"></i>{}</span> ", escape(&p.name));
    }
    out.push_str("</p></section>\n");
}

fn gates(out: &mut String, report: &Report) {
    out.push_str("<h2>Gates</h2><div class=scroll><table><tr><th>gate<th class=t>verdict<th>value<th>limit<th class=t>kind</tr>");
    for g in &report.gates {
        let (class, word) = match (g.passed, g.hard) {
            (true, _) => ("yes", "met"),
            (false, true) => ("no", "missed"),
            (false, false) => ("adv", "missed"),
        };
        let kind = if g.hard { "hard" } else { "advisory" };
        let _ = write!(out, "<tr><td>{}<td class=\"t {class}\">{word}<td>{}<td>{}<td class=t>{kind}</tr>", escape(&g.name), short(g.value), escape(&g.limit));
    }
    out.push_str("</table></div>\n");
}

/// Counts of `values` in bins of equal width from `low` to `high`; what lies beyond falls into the outer bins.
fn counts(values: &[f64], low: f64, high: f64, bins: usize) -> Vec<f64> {
    let mut counts = vec![0.0; bins];
    for v in values.iter().filter(|v| v.is_finite()) {
        let at = ((v - low) / (high - low) * bins as f64).clamp(0.0, bins as f64 - 1.0);
        counts[at as usize] += 1.0;
    }
    counts
}

fn histograms(out: &mut String, json: &Value, scene: &Scene) {
    let of_report = |path: &str| -> Option<Vec<f64>> {
        let data = json.pointer(path)?;
        let counts = data.get("counts").unwrap_or(data).as_array()?;
        Some(counts.iter().map(|c| c.as_f64().unwrap_or(0.0)).collect())
    };
    let deviation = (!scene.deviation.is_empty()).then(|| counts(&scene.deviation, -1.0, 1.0, 40));
    // Title, counts, range, and the limit.
    let charts = [
        ("Equi-angle skewness of the triangles", of_report("/surface/histogram"), [0.0, 1.0], Some(0.75)),
        ("Equi-volume skewness of the tetrahedra", of_report("/volume/histogram"), [0.0, 1.0], Some(0.8)),
        ("Deviation of the vertices from the mask (voxel diagonals)", deviation, [-1.0, 1.0], None),
    ];
    if charts.iter().all(|c| c.1.is_none()) {
        return;
    }
    out.push_str("<h2>Histograms</h2><div class=charts>");
    for (title, data, [low, high], mark) in charts {
        let Some(counts) = data else { continue };
        let top = counts.iter().copied().fold(1.0, f64::max);
        let width = 400.0 / counts.len().max(1) as f64;
        let _ = write!(out, "<figure><svg viewBox=\"0 0 440 210\" role=img aria-label=\"{title}\"><text x=20 y=16>{title}</text>");
        for (i, c) in counts.iter().enumerate() {
            let h = 150.0 * c / top;
            let from = low + (high - low) * i as f64 / counts.len() as f64;
            let _ = write!(out, "<rect class=b x={:.1} y={:.1} width={:.1} height={h:.1}><title>{c} from {from:.3}</title></rect>", 20.0 + i as f64 * width, 180.0 - h, width * 0.9);
        }
        if let Some(mark) = mark {
            let x = 20.0 + 400.0 * (mark - low) / (high - low);
            let _ = write!(out, "<line class=l x1={x} x2={x} y1=28 y2=180 /><text x={x} y=196 text-anchor=middle>{mark}</text>");
        }
        let _ = write!(out, "<text x=20 y=196>{low}</text><text x=420 y=196 text-anchor=end>{high}</text></svg></figure>");
    }
    out.push_str("</div>\n");
}

fn coordinates(value: &Value) -> Option<[f64; 3]> {
    let list = value.as_array()?;
    let at = |i: usize| list.get(i).and_then(Value::as_f64);
    Some([at(0)?, at(1)?, at(2)?])
}

fn place(row: &Value) -> Option<[f64; 3]> {
    ["centroid", "center", "point", "at"].iter().find_map(|k| row.get(k).and_then(coordinates))
}

fn button(at: [f64; 3]) -> String {
    format!("<button data-at=\"{},{},{}\">{:.2}, {:.2}, {:.2}</button>", at[0], at[1], at[2], at[0], at[1], at[2])
}

/// The single worst triangle, cell and vertex, right below the view; a cell is shown in a cut through it.
fn one_click(out: &mut String, json: &Value) {
    let places = [("worst triangle", "/surface/worst/0", ""), ("worst cell", "/volume/worst/0", " data-cut=y"), ("farthest from the mask", "/fidelity/worst/0", "")];
    let found: Vec<String> = places
        .iter()
        .filter_map(|(name, path, cut)| {
            let [x, y, z] = json.pointer(path).and_then(place)?;
            Some(format!("<button data-at=\"{x},{y},{z}\"{cut}>{name}</button>"))
        })
        .collect();
    if !found.is_empty() {
        let _ = writeln!(out, "<p class=bar>Show the {}</p>", found.join(" "));
    }
}

fn worst(out: &mut String, json: &Value) {
    let groups = [("Worst triangles", "/surface/worst"), ("Worst cells", "/volume/worst"), ("Farthest from the mask", "/fidelity/worst")];
    out.push_str("<h2>Worst places</h2><p class=\"soft no-print\">A click on the coordinates shows the place above.</p>");
    for (title, path) in groups {
        let Some(rows) = json.pointer(path).and_then(Value::as_array).filter(|r| !r.is_empty()) else { continue };
        let _ = write!(out, "<details><summary>{title}</summary><div class=scroll><table>");
        let keys: Vec<&String> = rows[0].as_object().map(|o| o.iter().filter(|(_, v)| !v.is_array() && !v.is_object()).map(|(k, _)| k).collect()).unwrap_or_default();
        out.push_str("<tr>");
        for k in &keys {
            let _ = write!(out, "<th>{}", escape(&k.replace('_', " ")));
        }
        out.push_str("<th>place</tr>");
        for row in rows.iter().take(10) {
            out.push_str("<tr>");
            for k in &keys {
                let _ = write!(out, "<td>{}", figure(row, &[k.as_str()]));
            }
            let _ = write!(out, "<td>{}</tr>", place(row).map(button).unwrap_or_default());
        }
        out.push_str("</table></div></details>\n");
    }
}

fn fidelity(out: &mut String, json: &Value) {
    let Some(f) = json.get("fidelity") else { return };
    out.push_str("<h2>Fidelity to the mask</h2><p class=soft>Distances between the surface and marching cubes of the mask, in voxel diagonals. The mask's own stairs are part of them.</p><div class=scroll><table><tr><th>direction<th>median<th>mean<th>95 %<th>max</tr>");
    for (name, key) in [("surface to marching cubes", "to_marching_cubes"), ("marching cubes to surface", "from_marching_cubes")] {
        let _ = write!(out, "<tr><td>{name}");
        for q in ["median", "mean", "p95", "max"] {
            let _ = write!(out, "<td>{}", figure(f, &[key, q]));
        }
        out.push_str("</tr>");
    }
    let _ = write!(out, "</table></div><p>Volume over the mask's kept volume: {}. Parts of the vessel not kept, ends beyond the cuts included: {}.</p>\n", figure(f, &["volume_ratio"]), f.get("lost").and_then(Value::as_array).map_or(0, Vec::len));
}

fn openings(out: &mut String, json: &Value) {
    let Some(rows) = json.get("openings").and_then(Value::as_array).filter(|r| !r.is_empty()) else { return };
    out.push_str("<h2>Openings</h2><div class=scroll><table><tr><th>patch<th class=t>kind<th>area (mm²)<th>hydraulic diameter (mm)<th>planarity (mm)<th class=t>found by<th>confidence<th>centre</tr>");
    for r in rows {
        let _ = write!(out, "<tr><td>{}<td class=t>{}", figure(r, &["name"]), figure(r, &["kind"]));
        for k in ["area", "hydraulic_diameter", "planarity"] {
            let _ = write!(out, "<td>{}", figure(r, &[k]));
        }
        let _ = write!(out, "<td class=t>{}<td>{}<td>{}</tr>", figure(r, &["found_by"]), figure(r, &["confidence"]), place(r).map(button).unwrap_or_default());
    }
    out.push_str("</table></div>\n");
    out.push_str(&super::handover::section(json));
}

fn stages(out: &mut String, report: &Report) {
    out.push_str("<h2>Stages</h2><div class=scroll><table><tr><th>stage<th>seconds</tr>");
    for s in &report.run.stages {
        let _ = write!(out, "<tr><td>{}<td>{:.2}</tr>", escape(&s.name), s.seconds);
    }
    let total: f64 = report.run.stages.iter().map(|s| s.seconds).sum();
    let _ = write!(out, "<tr><td>all<td>{total:.2}</tr></table></div><p class=soft>{} threads, peak memory {:.0} MB</p>\n", report.run.threads, report.run.peak_memory_bytes as f64 / 1e6);
}

fn details(out: &mut String, json: &Value, case: &str) {
    let _ = write!(
        out,
        "<h2>Provenance</h2><p>lumenmesh {}, report schema {}. Input {}, SHA-256 <code>{}</code>. The resolved case file below gives the same bytes again with the same version.</p>\n",
        figure(json, &["version"]),
        figure(json, &["schema_version"]),
        figure(json, &["input", "file"]),
        figure(json, &["input", "sha256"]),
    );
    for (title, key) in [("What was repaired", "cleaning"), ("Reconstruction", "reconstruction"), ("Input", "input")] {
        if let Some(section) = json.get(key) {
            let text = serde_json::to_string_pretty(section).unwrap_or_default();
            let _ = write!(out, "<details><summary>{title}</summary><pre>{}</pre></details>\n", escape(&text));
        }
    }
    let _ = write!(out, "<details><summary>Resolved case file</summary><pre>{}</pre></details>\n", escape(case));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_the_standard_one() {
        for (plain, coded) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn the_page_holds_everything_and_loads_nothing() {
        let surface = crate::mesh::test_shapes::sphere(Point::origin(), 1.0, 4);
        let skewness = vec![0.1; surface.triangles.len()];
        let scene = Scene { surface: &surface, skewness: &skewness, deviation: Vec::new(), curvature: &[], centerlines: Vec::new(), volume: None, title: "<x>".into(), case: "input: {}" };
        let page = page(&Report::default(), &scene);
        assert!(!page.contains("src=\"http") && !page.contains("<link") && !page.contains("<x>"));
        assert!(page.len() < 2_000_000);
    }
}
