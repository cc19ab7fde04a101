//! cohort.html and cohort.csv: many cases on one page, worst first.

use std::fmt::Write;

use serde_json::Value;

use super::html::base64;

/// One case of a cohort.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Name and folder of the case.
    pub name: String,
    /// Exit code of its run.
    pub code: i32,
    /// Whether the results of an earlier run were kept.
    pub kept: bool,
    /// Gates missed, hard ones first; or the error.
    pub problem: String,
    /// Warnings of the run.
    pub warnings: Vec<String>,
    /// Figures in the order of [`COLUMNS`]; `None` where the run did not get there.
    pub figures: Vec<Option<f64>>,
    /// PNG of the surface, seen from the front.
    pub picture: Option<Vec<u8>>,
}

/// Column title and the path of the figure in report.json.
pub const COLUMNS: [(&str, &[&str]); 10] = [
    ("triangles", &["surface", "faces"]),
    ("S max", &["surface", "s_max"]),
    ("S mean", &["surface", "s_mean"]),
    ("deviation median (voxel diagonals)", &["fidelity", "to_marching_cubes", "median"]),
    ("deviation max (voxel diagonals)", &["fidelity", "to_marching_cubes", "max"]),
    ("volume ratio", &["fidelity", "volume_ratio"]),
    ("cells", &["volume", "cells"]),
    ("S_V max", &["volume", "sv_max"]),
    ("S_V mean", &["volume", "sv_mean"]),
    ("OpenFOAM non-orthogonality", &["volume", "non_orthogonality"]),
];

impl Row {
    /// A case that ended with a report.
    pub fn from_report(name: &str, report: &Value, kept: bool) -> Row {
        let figures = COLUMNS
            .iter()
            .map(|(_, path)| path.iter().try_fold(report, |at, key| at.get(key)).and_then(Value::as_f64))
            .collect();
        let gates = report.get("gates").and_then(Value::as_array).cloned().unwrap_or_default();
        let missed = |hard: bool| {
            gates
                .iter()
                .filter(move |g| g["passed"] == false && g["hard"] == hard)
                .filter_map(|g| g["name"].as_str())
                .map(str::to_string)
                .collect::<Vec<_>>()
        };
        let hard = missed(true);
        let code = if hard.is_empty() { 0 } else { 6 };
        let advisory = missed(false);
        let problem = hard.into_iter().chain(advisory.into_iter().map(|a| format!("({a})"))).collect::<Vec<_>>().join("; ");
        let warnings = report.get("warnings").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let text = |w: &Value| w["message"].as_str().map(|m| format!("{}: {m}", w["stage"].as_str().unwrap_or("run")));
        let warnings = warnings.iter().filter_map(text).collect();
        Row { name: name.into(), code, kept, problem, warnings, figures, picture: None }
    }

    /// The row with a picture.
    #[must_use]
    pub fn with_picture(self, picture: Option<Vec<u8>>) -> Row {
        Row { picture, ..self }
    }

    /// A case that ended with an error.
    pub fn failed(name: &str, code: i32, problem: String) -> Row {
        Row { name: name.into(), code, kept: false, problem, warnings: vec![], figures: vec![None; COLUMNS.len()], picture: None }
    }

    /// The outcome in words.
    pub fn verdict(&self) -> &'static str {
        match self.code {
            0 if self.warnings.is_empty() => "met",
            0 => "met with warnings",
            2 => "configuration",
            3 => "input",
            4 => "geometry",
            5 => "volume engine",
            6 => "gate missed",
            130 => "interrupted",
            _ => "crash",
        }
    }

    /// One line for the terminal.
    pub fn line(&self) -> String {
        let kept = if self.kept { " (kept)" } else { "" };
        match (self.code, self.warnings.as_slice()) {
            (0, []) => format!("met{kept}"),
            (0, [one]) => format!("met{kept}, 1 warning: {one}"),
            (0, [first, ..]) => format!("met{kept}, {} warnings: {first}; …", self.warnings.len()),
            _ => format!("{}{kept}: {}", self.verdict(), self.problem.lines().next().unwrap_or_default()),
        }
    }
}

/// Failures first, then missed gates, then warnings, then by falling S max; equal ones by name.
pub fn sort_worst_first(rows: &mut [Row]) {
    let rank = |r: &Row| match r.code {
        0 if r.warnings.is_empty() => 3,
        0 => 2,
        6 => 1,
        _ => 0,
    };
    rows.sort_by(|a, b| {
        let s = |r: &Row| r.figures.get(1).copied().flatten().unwrap_or(0.0);
        rank(a).cmp(&rank(b)).then(s(b).total_cmp(&s(a))).then_with(|| a.name.cmp(&b.name))
    });
}

/// The cohort as CSV (RFC 4180).
pub fn csv(rows: &[Row]) -> String {
    let quote = |s: &str| format!("\"{}\"", s.replace('"', "\"\""));
    let mut out = String::from("case,verdict,exit_code");
    for (title, _) in COLUMNS {
        let _ = write!(out, ",{}", quote(title));
    }
    out.push_str(",problem,warnings,\"warning texts\"\r\n");
    for r in rows {
        let _ = write!(out, "{},{},{}", quote(&r.name), r.verdict(), r.code);
        for f in &r.figures {
            let _ = write!(out, ",{}", f.map(|f| f.to_string()).unwrap_or_default());
        }
        let _ = write!(out, ",{},{},{}\r\n", quote(&r.problem), r.warnings.len(), quote(&r.warnings.join(" | ")));
    }
    out
}

/// The outcome of a cohort in words: warnings are never left out.
pub fn verdict(rows: &[Row]) -> String {
    let met = rows.iter().filter(|r| r.code == 0).count();
    let mut text = format!("{met} of {} cases met all hard gates", rows.len());
    let warned = rows.iter().filter(|r| !r.warnings.is_empty()).count();
    if warned > 0 {
        let all: usize = rows.iter().map(|r| r.warnings.len()).sum();
        let _ = write!(text, ", {warned} with warnings ({all} in all)");
    }
    text
}

/// Text made safe for HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The cohort as one self-contained page: causes of failure grouped, then every case.
pub fn html(rows: &[Row]) -> String {
    let mut out = String::from(concat!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">",
        "<title>lumenmesh cohort</title><style>:root{color-scheme:light dark;--line:color-mix(in srgb,currentColor 20%,transparent)}",
        "body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:78rem;padding:0 1rem}table{border-collapse:collapse;width:100%}",
        "th,td{text-align:right;padding:.35rem .6rem;border-bottom:1px solid var(--line)}th:first-child,td:first-child,td:last-child,th:last-child{text-align:left}",
        "td:nth-child(2),th:nth-child(2){text-align:left}td:last-child{min-width:14rem;white-space:pre-line}.scroll{overflow-x:auto}",
        "img{height:84px;display:block;border-radius:.3rem;background:#fff}.soft{opacity:.7}.bad{font-weight:700}.bad::before{content:\"✗ \"}.good::before{content:\"✓ \"}.warned::before{content:\"⚠ \"}",
        "@media print{body{max-width:none;font-size:10px}tr{break-inside:avoid}}</style>\n",
    ));
    let _ = writeln!(out, "<h1>Cohort: {}</h1>", verdict(rows));
    let failures = rows.iter().filter(|r| r.code != 0).map(|r| (format!("{}: {}", r.verdict(), cause(&r.problem)), r.name.as_str()));
    by_cause(&mut out, "Failures by cause", failures);
    let warnings = rows.iter().flat_map(|r| r.warnings.iter().map(|w| (without_digits(w), r.name.as_str())));
    by_cause(&mut out, "Warnings by cause", warnings);
    out.push_str("<p class=soft>Worst first: failures, then missed gates, then warnings, then by falling S max. S: equi-angle skewness of the triangles, S_V: equi-volume skewness of the tetrahedra. Advisory limits that are missed stand in brackets.</p>\n");
    out.push_str("<div class=scroll><table><thead><tr><th>case<th>surface<th>verdict");
    for (title, _) in COLUMNS {
        let _ = write!(out, "<th>{title}");
    }
    out.push_str("<th>notes</thead>\n");
    for r in rows {
        let class = match (r.code, r.warnings.is_empty()) {
            (0, true) => "good",
            (0, false) => "warned",
            _ => "bad",
        };
        let name = escape(&r.name);
        let link = match r.figures.iter().any(Option::is_some) {
            true => format!("<a href=\"{name}/report.html\">{name}</a>"),
            false => format!("<a href=\"{name}.log\">{name}</a>"),
        };
        let picture = match &r.picture {
            Some(png) => format!("<a href=\"{name}/report.html\"><img alt=\"surface of {name}\" src=\"data:image/png;base64,{}\"></a>", base64(png)),
            None => String::new(),
        };
        let _ = write!(out, "<tr><td>{link}<td>{picture}<td class={class}>{}", r.verdict());
        for f in &r.figures {
            let text = match f {
                Some(f) if f.fract() == 0.0 => format!("{f}"),
                Some(f) => format!("{f:.3}"),
                None => "–".into(),
            };
            let _ = write!(out, "<td>{text}");
        }
        let notes: Vec<&str> = std::iter::once(r.problem.as_str()).filter(|p| !p.is_empty()).chain(r.warnings.iter().map(String::as_str)).collect();
        let _ = writeln!(out, "<td>{}", escape(&notes.join("\n")));
    }
    out.push_str("</table></div></html>\n");
    out
}

/// A list of causes, each with its cases.
fn by_cause<'a>(out: &mut String, title: &str, all: impl Iterator<Item = (String, &'a str)>) {
    let mut causes: Vec<(String, Vec<&str>)> = Vec::new();
    for (cause, name) in all {
        match causes.iter_mut().find(|(c, _)| *c == cause) {
            Some((_, names)) if names.contains(&name) => {}
            Some((_, names)) => names.push(name),
            None => causes.push((cause, vec![name])),
        }
    }
    if causes.is_empty() {
        return;
    }
    let _ = writeln!(out, "<h2>{title}</h2><ul>");
    for (cause, names) in &causes {
        let _ = writeln!(out, "<li><b>{}</b> ({}): {}</li>", escape(cause), names.len(), escape(&names.join(", ")));
    }
    out.push_str("</ul>\n");
}

/// A text without its numbers, so that equal causes meet.
fn without_digits(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_digit() { '#' } else { c }).collect()
}

/// The first sentence of a problem without numbers and names, so that equal causes meet.
fn cause(problem: &str) -> String {
    let first = problem.lines().next().unwrap_or_default();
    let first = first.strip_prefix("error: ").unwrap_or(first);
    // The file's name, with line and column where it is a case file.
    let named = |head: &str| !head.contains(' ') && head.contains(['/', '.']);
    let first = first.split_once(": ").filter(|(head, _)| named(head)).map_or(first, |(_, tail)| tail);
    without_digits(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_come_first_then_missed_gates_then_the_worst_skewness() {
        let report = |s: f64, passed: bool| serde_json::json!({"surface": {"s_max": s, "faces": 10}, "gates": [{"name": "g", "hard": true, "passed": passed}]});
        let mut rows = vec![
            Row::from_report("good", &report(0.3, true), false),
            Row::from_report("worse", &report(0.4, true), false),
            Row::from_report("missed", &report(0.2, false), false),
            Row::failed("broken", 3, "error: x".into()),
        ];
        sort_worst_first(&mut rows);
        let names: Vec<_> = rows.iter().map(|r| r.name.as_str()).collect();
        assert_eq!(names, ["broken", "missed", "worse", "good"]);
        assert_eq!(csv(&rows).lines().count(), 5);
        assert!(html(&rows).contains("2 of 4 cases"));
    }

    #[test]
    fn warnings_are_never_hidden_behind_met_gates() {
        let report = |warnings: serde_json::Value| serde_json::json!({"surface": {"s_max": 0.3}, "gates": [], "warnings": warnings});
        let warned = serde_json::json!([{"stage": "openings", "message": "section at 12.5 is irregular"}, {"stage": "flow", "message": "no, \"outlet\""}]);
        let mut rows = vec![
            Row::from_report("fine", &report(serde_json::json!([])), false),
            Row::from_report("b", &report(warned.clone()), false),
            Row::from_report("a", &report(warned), false),
        ];
        sort_worst_first(&mut rows);
        assert_eq!(rows.iter().map(|r| (r.name.as_str(), r.verdict())).collect::<Vec<_>>(), [("a", "met with warnings"), ("b", "met with warnings"), ("fine", "met")]);
        assert_eq!(verdict(&rows), "3 of 3 cases met all hard gates, 2 with warnings (4 in all)");
        assert_eq!(verdict(&rows[2..]), "1 of 1 cases met all hard gates");
        assert!(rows[0].line().contains("2 warnings: openings: section"), "{}", rows[0].line());
        let text = csv(&rows);
        assert!(text.contains("\"a\",met with warnings,0,") && text.contains(",2,\"openings: section at 12.5 is irregular | flow: no, \"\"outlet\"\"\"\r\n"), "{text}");
        let page = html(&rows);
        assert!(page.contains("<h1>Cohort: 3 of 3 cases met all hard gates, 2 with warnings (4 in all)</h1>"), "{page}");
        assert!(page.contains("openings: section at ##.# is irregular</b> (2): a, b"), "{page}");
        assert!(page.contains("class=warned>met with warnings") && page.contains("section at 12.5 is irregular\nflow"), "{page}");
    }

    #[test]
    fn equal_causes_in_different_files_are_one_group() {
        let failed = |name: &str, text: &str| Row::failed(name, 3, text.into());
        let rows = [
            failed("a", "error: masks/a.nrrd: the mask is empty: no voxel is selected by label 7"),
            failed("b", "error: masks/b.nrrd: the mask is empty: no voxel is selected by label 7"),
            failed("c", "error: c.nrrd: cannot be read: no such file"),
        ];
        let page = html(&rows);
        assert!(page.contains("(2): a, b") && page.contains("(1): c"), "{page}");
    }

    #[test]
    fn names_and_messages_cannot_break_the_page() {
        let rows = [Row::failed("<script>", 3, "a \"quoted\" <b>".into())];
        assert!(!html(&rows).contains("<script>"));
        assert!(csv(&rows).contains("\"a \"\"quoted\"\" <b>\""));
    }
}
