//! The lines a person reads last: openings, closed ends, counts, times, verdict.

use std::path::Path;

use serde_json::Value;

use crate::pipeline::Stage;
use crate::report::{Report, Status, rounded};

/// Openings that are listed one by one.
const LISTED: usize = 4;

/// Everything there is to say about a run that stopped after `stage`, about ten lines.
pub fn lines(report: &Report, output: &Path, stage: Stage) -> Vec<String> {
    let mut out = ends(report);
    match stage {
        Stage::Mask => out.push(mask(report)),
        Stage::Reconstruction => out.extend([mask(report), surface(report, "not remeshed yet")]),
        _ => out.push(surface(report, &skewness(report, "surface", "equi-angle skewness S", ["s_max", "s_mean"]))),
    }
    if report.sections.contains_key("volume") {
        out.push(format!(
            "volume   {} cells ({} tetrahedra, {} prisms), {}",
            number(report, &["volume", "cells"]),
            number(report, &["volume", "tets"]),
            number(report, &["volume", "prisms"]),
            skewness(report, "volume", "equi-volume skewness S_V", ["sv_max", "sv_mean"]),
        ));
    }
    out.extend(times(report));
    for g in report.gates.iter().filter(|g| !g.passed) {
        out.push(format!("{} {}: {} (limit {})", if g.hard { "MISSED  " } else { "advisory" }, g.name, rounded(g.value), g.limit));
    }
    out.push(verdict(report, output, stage));
    out
}

/// The openings, and the ends that stay closed.
pub fn ends(report: &Report) -> Vec<String> {
    let rows = report.sections.get("openings").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
    let text = |row: &Value, key: &str| row.get(key).and_then(Value::as_str).unwrap_or("–").replace('-', " ");
    let width = rows.iter().take(LISTED).filter_map(|r| r.get("name")?.as_str()).map(str::len).max().unwrap_or(0);
    let mut out: Vec<String> = rows
        .iter()
        .take(LISTED)
        .map(|r| {
            format!(
                "{:<8} {:<width$}  {} mm across at {} (LPS mm), {}, confidence {}",
                text(r, "kind"),
                r.get("name").and_then(Value::as_str).unwrap_or("–"),
                across(r),
                point(r.get("center")),
                text(r, "found_by"),
                r.get("confidence").and_then(Value::as_f64).map_or("–".into(), |c| format!("{c:.2}")),
            )
        })
        .collect();
    if rows.len() > LISTED {
        let inlets = rows.iter().filter(|r| r.get("kind").and_then(Value::as_str) == Some("inlet")).count();
        let (all, outlets) = (rows.len(), rows.len() - inlets);
        out.push(format!("         and {} more: {all} openings, {inlets} in and {outlets} out; see report.html", all - LISTED));
    }
    let blind = report.sections.get("ends").and_then(|e| e.get("blind")).and_then(Value::as_array);
    let blind = blind.map(Vec::as_slice).unwrap_or_default();
    if !blind.is_empty() {
        let first: Vec<String> = blind.iter().take(3).map(|b| format!("{} at {}", text(b, "reason"), point(b.get("tip")))).collect();
        let more = if blind.len() > 3 { ", …" } else { "" };
        let ends = if blind.len() == 1 { "end" } else { "ends" };
        out.push(format!("closed   {} {ends}: {}{more}", blind.len(), first.join(", ")));
    }
    out
}

/// Diameter of the circle of an opening's area.
fn across(row: &Value) -> String {
    let area = row.get("area").and_then(Value::as_f64);
    area.map_or("–".into(), |a| format!("{:.2}", 2.0 * (a / std::f64::consts::PI).sqrt()))
}

fn point(at: Option<&Value>) -> String {
    let xyz: Vec<String> = at.and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_f64).map(|x| format!("{x:.1}")).collect();
    format!("({})", xyz.join(", "))
}

fn at<'a>(report: &'a Report, path: &[&'a str]) -> Option<&'a Value> {
    let (first, rest) = path.split_first()?;
    rest.iter().try_fold(report.sections.get(first)?, |at, key| at.get(key))
}

fn number<'a>(report: &'a Report, path: &[&'a str]) -> String {
    match at(report, path) {
        Some(Value::Number(n)) => n.as_u64().map_or_else(|| format!("{:.3}", n.as_f64().unwrap_or(f64::NAN)), |i| i.to_string()),
        _ => "–".into(),
    }
}

fn skewness(report: &Report, section: &str, what: &str, [max, mean]: [&str; 2]) -> String {
    format!("{what} max {} mean {}", number(report, &[section, max]), number(report, &[section, mean]))
}

fn mask(report: &Report) -> String {
    let voxels = |n: usize| at(report, &["cleaning", "voxels"]).and_then(|v| v.get(n)).map_or("–".into(), ToString::to_string);
    let after = |key| number(report, &["cleaning", "after", key]);
    format!("mask     {} lumen voxels, {} before cleaning; components {}", voxels(1), voxels(0), after("components"))
}

fn surface(report: &Report, what: &str) -> String {
    format!("surface  {} triangles, {what}", number(report, &["surface", "faces"]))
}

/// The whole time, and the stages that took most of it.
fn times(report: &Report) -> Option<String> {
    let stages = &report.run.stages;
    let all: f64 = stages.iter().map(|s| s.seconds).sum();
    let mut by_time: Vec<_> = stages.iter().filter(|s| s.seconds >= 0.05 * all).collect();
    by_time.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    let most: Vec<String> = by_time.iter().take(4).map(|s| format!("{} {}", s.name, seconds(s.seconds))).collect();
    let memory = match report.run.peak_memory_bytes {
        0 => String::new(),
        bytes => format!("; {:.0} MB of memory", bytes as f64 / 1e6),
    };
    (all > 0.0).then(|| format!("time     {} s: {}{memory}", seconds(all), most.join(", ")))
}

fn seconds(s: f64) -> String {
    if s < 10.0 { format!("{s:.1}") } else { format!("{s:.0}") }
}

/// Confidence below which an opening is named in the verdict.
const SURE: f64 = 0.6;

fn unsure(report: &Report) -> String {
    let rows = report.sections.get("openings").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
    let low = rows.iter().filter(|r| r.get("confidence").and_then(Value::as_f64).is_some_and(|c| c < SURE));
    let names: Vec<&str> = low.filter_map(|r| r.get("name").and_then(Value::as_str)).collect();
    if names.is_empty() { String::new() } else { format!(", check {}", names.join(", ")) }
}

fn verdict(report: &Report, output: &Path, stage: Stage) -> String {
    let passed = report.status == Status::Passed;
    let verdict = match (passed, stage) {
        (true, Stage::Mask) => "stopped after the mask, as asked",
        (true, Stage::Reconstruction) => "stopped after the reconstruction, as asked",
        (true, _) => "all hard gates met",
        (false, _) => "A HARD GATE IS MISSED",
    };
    let warnings = match report.warnings.len() {
        0 => String::new(),
        1 => ", 1 warning".into(),
        n => format!(", {n} warnings"),
    };
    let unsure = unsure(report);
    let open = match stage {
        Stage::Mask => output.join("input/mask-cleaned.nrrd"),
        _ => output.join("report.html"),
    };
    format!("results  {} ({verdict}{unsure}{warnings}); open {}", output.display(), open.display())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{Gate, Limit, StageTime};

    fn report(openings: usize) -> Report {
        let mut r = Report::default();
        let row = |n: usize| serde_json::json!({"name": format!("outlet_{n}"), "kind": if n == 0 { "inlet" } else { "outlet" }, "center": [1.04, -2.0, 3.0],
            "area": 12.566, "found_by": "image-border", "confidence": 0.875});
        r.put("openings", &(0..openings).map(row).collect::<Vec<_>>());
        r.put("ends", &serde_json::json!({"blind": [{"tip": [1.0, 2.0, 3.0], "reason": "wide-sac"}]}));
        r.put("surface", &serde_json::json!({"faces": 1200, "s_max": 0.5123, "s_mean": 0.1}));
        r.run.stages = vec![StageTime { name: "remesh".into(), seconds: 12.3 }, StageTime { name: "read".into(), seconds: 0.01 }];
        r
    }

    #[test]
    fn a_run_is_told_in_about_ten_lines() {
        let text = lines(&report(12), Path::new("out"), Stage::Exports);
        assert!(text.len() <= 10, "{text:#?}");
        assert_eq!(text[0], "inlet    outlet_0  4.00 mm across at (1.0, -2.0, 3.0) (LPS mm), image border, confidence 0.88");
        assert!(text[LISTED].contains("and 8 more: 12 openings, 1 in and 11 out"), "{text:#?}");
        assert!(text[LISTED + 1].contains("closed   1 end: wide sac at (1.0, 2.0, 3.0)"), "{text:#?}");
        assert!(text.iter().any(|l| l == "time     12 s: remesh 12"), "{text:#?}");
        assert!(text.last().is_some_and(|l| l.contains("all hard gates met")), "{text:#?}");
    }

    #[test]
    fn a_missed_gate_stands_before_the_verdict() {
        let mut r = report(1);
        r.gate(Gate::hard("caps planar", 2.1895e-16, Limit::AtMost(1e-17)));
        let text = lines(&r, Path::new("out"), Stage::Volume);
        assert_eq!(text[text.len() - 2], "MISSED   caps planar: 2.19e-16 (limit ≤ 1e-17)");
        assert!(text[text.len() - 1].contains("A HARD GATE IS MISSED"), "{text:#?}");
    }

    #[test]
    fn a_run_that_stops_early_says_what_it_did() {
        let mut r = Report::default();
        r.put("cleaning", &serde_json::json!({"voxels": [120, 100], "after": {"components": 1}}));
        let text = lines(&r, Path::new("out"), Stage::Mask);
        assert_eq!(text[0], "mask     100 lumen voxels, 120 before cleaning; components 1");
        assert!(text[1].contains("stopped after the mask, as asked"), "{text:#?}");
    }
}
