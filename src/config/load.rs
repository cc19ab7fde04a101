//! Reading a case file, with errors that name line, column and the way out.

use std::path::{Path, PathBuf};

use super::case::{Case, Labels};
use super::explain::explain;
use super::length::Unit;
use super::place::locate;

/// Why a case file cannot be used.
#[derive(Debug, Clone, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{file}: cannot be read: {reason}; check the path and its permissions", file = file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// The text is not a valid case.
    #[error("{place}: {message}")]
    Invalid {
        /// File, line and column; or the override.
        place: String,
        /// What is wrong, with the text and the nearest valid key.
        message: String,
    },
}

fn invalid(place: impl Into<String>, message: impl Into<String>) -> ConfigError {
    ConfigError::Invalid { place: place.into(), message: message.into() }
}

/// Reads and checks a case file and applies `overrides` of the form `key.path=value`.
/// Relative paths in it are taken from the file's folder.
pub fn load(file: &Path, overrides: &[String]) -> Result<Case, ConfigError> {
    let bytes = std::fs::read(file).map_err(|e| ConfigError::Unreadable { file: file.into(), reason: crate::io::reason(&e) })?;
    let text = String::from_utf8(bytes).map_err(|e| {
        let line = e.as_bytes()[..e.utf8_error().valid_up_to()].iter().filter(|b| **b == b'\n').count() + 1;
        invalid(format!("{}:{line}", file.display()), "a letter of this line is not UTF-8: save the file as UTF-8")
    })?;
    let mut case = from_text(&text, &file.display().to_string(), overrides)?;
    let base = file.parent().unwrap_or(Path::new("."));
    for path in case.files_mut() {
        if path.is_relative() {
            *path = base.join(&*path);
        }
    }
    Ok(case)
}

/// Reads and checks a case from text; `name` stands in the errors.
pub fn from_text(text: &str, name: &str, overrides: &[String]) -> Result<Case, ConfigError> {
    let empty = || serde_saphyr::from_str::<serde_json::Value>(text).ok().and_then(|v| empty_value(&v, &mut vec![]));
    let mut case: Case = match (serde_saphyr::from_str(text), empty()) {
        (Ok(case), None) => case,
        // A key that there is not is the better news.
        (Err(e), key) if key.is_none() || e.to_string().contains("unknown field") => return Err(yaml_error(&e, text, name)),
        (_, key) => {
            let key = key.unwrap_or_default();
            let last = key.rsplit('.').next().unwrap_or_default();
            let message = format!("`{last}` has no value: give one, or take the key out");
            return Err(match locate(text, &key) {
                Some((line, column)) => at_place(name, text, line, column, &message),
                None => invalid(name, format!("{key}: {message}")),
            });
        }
    };
    if !overrides.is_empty() {
        let mut value = serde_json::to_value(&case).map_err(|e| invalid(name, e.to_string()))?;
        for o in overrides {
            apply(&mut value, o)?;
            // Each override is checked by itself, so that the error names the right one.
            case = serde_json::from_value(value.clone()).map_err(|e| {
                invalid(format!("--set {o}"), explain(&e.to_string(), "", 1))
            })?;
        }
    }
    check(&case).map_err(|(key, message)| {
        let set = overrides.iter().rfind(|o| o.split('=').next().is_some_and(|k| sets(k.trim(), &key)));
        // A list of planes may stand right under `openings`.
        let at = || locate(text, &key).or_else(|| locate(text, &key.replacen("openings.planes[", "openings[", 1)));
        match (set, at()) {
            (Some(o), _) => invalid(format!("--set {o}"), message),
            (None, Some((line, column))) => at_place(name, text, line, column, &format!("{key}: {message}")),
            (None, None) => invalid(name, format!("{key}: {message}")),
        }
    })?;
    Ok(case)
}

/// The case as YAML that [`load`] reads back to the same case.
pub fn to_yaml(case: &Case) -> Result<String, ConfigError> {
    serde_saphyr::to_string(case).map_err(|e| invalid("resolved configuration", e.to_string()))
}

/// Path of the first key without a value. Sections may be empty: all they hold may be commented out.
fn empty_value(at: &serde_json::Value, path: &mut Vec<String>) -> Option<String> {
    let inner: Vec<(String, &serde_json::Value)> = match at {
        serde_json::Value::Null if !is_section(path) => return Some(path.join(".").replace(".[", "[")),
        serde_json::Value::Object(map) => map.iter().map(|(k, v)| (k.clone(), v)).collect(),
        serde_json::Value::Array(list) => list.iter().enumerate().map(|(n, v)| (format!("[{n}]"), v)).collect(),
        _ => return None,
    };
    inner.into_iter().find_map(|(key, value)| {
        path.push(key);
        let found = empty_value(value, path);
        path.pop();
        found
    })
}

/// Whether a path leads to a mapping or list of the default case.
fn is_section(path: &[String]) -> bool {
    let Ok(case) = serde_json::to_value(Case::for_mask(PathBuf::new())) else { return true };
    path.iter().try_fold(&case, |at, key| at.get(key)).is_none_or(|v| v.is_object() || v.is_array()) && path.len() < 2
}

fn apply(value: &mut serde_json::Value, text: &str) -> Result<(), ConfigError> {
    let place = || format!("--set {text}");
    let (path, new) = text
        .split_once('=')
        .ok_or_else(|| invalid(place(), "there is no `=`: write `--set key.path=value`, such as `--set surface.scale=2`"))?;
    let new: serde_json::Value = serde_saphyr::from_str(new)
        .map_err(|e| invalid(place(), format!("the value is not valid YAML: {}", first_line(&e.to_string()))))?;
    if new.is_null() {
        return Err(invalid(place(), "there is no value behind the `=`: give one, or leave the override out"));
    }
    let mut at = value;
    for key in path.trim().split('.') {
        if let serde_json::Value::Array(items) = at {
            let n = items.len();
            at = key
                .parse::<usize>()
                .ok()
                .and_then(|i| items.get_mut(i))
                .ok_or_else(|| invalid(place(), format!("`{key}` is not an entry of a list of {n}: count from 0")))?;
        } else {
            if !at.is_object() {
                *at = serde_json::Value::Object(serde_json::Map::new());
            }
            let serde_json::Value::Object(map) = at else { continue };
            at = map.entry(key).or_insert(serde_json::Value::Null);
        }
    }
    *at = new;
    Ok(())
}

/// Whether an override of `key` gives what stands at `path`: the same key, or one that holds it.
fn sets(key: &str, path: &str) -> bool {
    let path = path.replace('[', ".").replace(']', "");
    path.strip_prefix(key).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

fn first_line(text: &str) -> &str {
    text.lines().next().unwrap_or_default()
}

/// File, line and column, and the line itself with a mark under the column.
fn at_place(name: &str, text: &str, line: usize, column: usize, message: &str) -> ConfigError {
    let shown = text.lines().nth(line.saturating_sub(1)).unwrap_or_default();
    if shown.trim().is_empty() {
        return invalid(format!("{name}:{line}:{column}"), message);
    }
    let mark = " ".repeat(column.saturating_sub(1));
    // Tabs count as one column; shown as one space the mark stays below its letter.
    let shown = shown.replace('\t', " ");
    invalid(format!("{name}:{line}:{column}"), format!("{message}\n    {shown}\n    {mark}^"))
}

fn yaml_error(e: &serde_saphyr::Error, text: &str, name: &str) -> ConfigError {
    let message = first_line(&e.without_snippet().to_string()).to_string();
    // The location is given by itself; the text of the error may repeat it.
    let message = message.split(" at line ").next().unwrap_or(&message).trim_end_matches([':', ',', ' ']).to_string();
    match e.location() {
        Some(at) if at.line() > 0 => {
            let (line, column) = (at.line() as usize, at.column() as usize);
            let shown = text.lines().nth(line - 1).unwrap_or_default();
            at_place(name, text, line, column, &explain(&message, shown, column))
        }
        _ => invalid(name, explain(&message, "", 1)),
    }
}

/// What types cannot say: ranges and keys that exclude each other.
/// The error is the key's path and the sentence.
fn check(case: &Case) -> Result<(), (String, String)> {
    let fail = |key: &str, message: String| Err((key.to_string(), message));
    let i = &case.input;
    match [&i.mask, &i.probability, &i.surface].iter().filter(|p| p.is_some()).count() {
        1 => {}
        0 => return fail("input", "names no file: give one of mask, probability and surface, such as `input: {mask: vessel.nrrd}`".into()),
        n => return fail("input", format!("names {n} files: give only one of mask, probability and surface")),
    }
    if i.threshold.is_some() && i.label != Labels::Unset {
        return fail("input", "has both label and threshold: give only one".into());
    }
    if i.isovalue.is_some() && i.probability.is_none() {
        return fail("input.isovalue", "only a probability map has an isovalue: give `probability` instead, or use `threshold`".into());
    }
    if i.probability.is_some() && (i.label != Labels::Unset || i.threshold.is_some()) {
        return fail("input", "a probability map is cut at `isovalue`; label and threshold are for masks".into());
    }
    match i.spacing {
        Some(_) if i.surface.is_none() => return fail("input.spacing", "an image has its own voxels: spacing is for surfaces".into()),
        Some(l) if l.unit != Unit::Millimetre || l.value <= 0.0 => return fail("input.spacing", "give it in mm, such as `0.2 mm`".into()),
        _ => {}
    }
    let range = |key: &str, v: f64, lo: f64, hi: f64| {
        if v.is_finite() && (lo..=hi).contains(&v) {
            Ok(())
        } else {
            Err((key.to_string(), format!("{v} is out of range: use {lo} to {hi}")))
        }
    };
    let s = &case.surface;
    range("surface.scale", s.scale, 0.05, 20.0)?;
    range("surface.edges_around", s.edges_around, 6.0, 400.0)?;
    range("surface.growth", s.growth, 0.01, 1.0)?;
    range("surface.max_skewness", s.max_skewness, 0.3, 0.95)?;
    range("surface.target_skewness", s.target_skewness, 0.2, s.max_skewness)?;
    for (n, r) in s.refine.iter().enumerate() {
        if r.sphere.is_some() == r.cuboid.is_some() {
            return fail(&format!("surface.refine[{n}]"), "give either sphere or box".into());
        }
    }
    for (n, p) in s.patches.iter().enumerate() {
        let key = format!("surface.patches[{n}] `{}`", p.name);
        if p.sphere.is_some() == p.plane.is_some() {
            return fail(&key, "give either sphere or plane".into());
        }
        if p.plane.as_ref().is_some_and(|q| crate::geometry::Plane::new(q.center.into(), q.normal.into()).is_none()) {
            return fail(&key, "its normal has no direction: give the direction into the sac".into());
        }
    }
    if let Some(cell) = case.reconstruction.cell {
        range("reconstruction.cell", cell, 0.1, 2.0)?;
    }
    if let Some(offset) = case.reconstruction.offset {
        range("reconstruction.offset", offset, -1.0, 1.0)?;
    }
    if case.volume.boundary_layers.count > 0 && matches!(case.volume.boundary_layers.total.unit, Unit::Millimetre | Unit::Voxel) {
        return fail(
            "volume.boundary_layers.total",
            "give a part of the local radius, such as `0.25 R`; a fixed height goes into first_height".into(),
        );
    }
    range("volume.growth", case.volume.growth, 0.0, 2.0)?;
    range("volume.boundary_layers.growth", case.volume.boundary_layers.growth, 0.5, 3.0)?;
    range("volume.boundary_layers.count", f64::from(case.volume.boundary_layers.count), 0.0, 50.0)?;
    range("volume.series", f64::from(case.volume.series), 1.0, 5.0)?;
    range("volume.time_limit", case.volume.time_limit, 1.0, 1e7)?;
    range("volume.memory_limit", case.volume.memory_limit, 0.1, 1e5)?;
    super::flow::check(&case.flow)?;
    super::names::check(case)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        from_text(text, "case.yaml", &[]).expect_err("must be refused").to_string()
    }

    #[test]
    fn an_unknown_key_is_named_with_line_column_and_the_nearest_key() {
        let e = error("input: {mask: a.nrrd}\nsurface:\n  edge_lenght: 0.4 mm\n");
        assert!(e.starts_with("case.yaml:3:3: "), "{e}");
        assert!(e.contains("`edge_lenght`") && e.contains("did you mean `edge_length`?"), "{e}");
    }

    #[test]
    fn a_length_without_unit_is_refused_in_its_line() {
        let e = error("input: {mask: a.nrrd}\nsurface: {edge_length: 0.4}\n");
        assert!(e.starts_with("case.yaml:2:"), "{e}");
        assert!(e.contains("`0.4 mm`"), "{e}");
    }

    #[test]
    fn a_key_without_a_value_is_no_default() {
        let e = error("input: {mask: a.nrrd}\nflow:\n  inlet:\n    flow_rate:\n");
        assert!(e.starts_with("case.yaml:4:") && e.contains("`flow_rate` has no value"), "{e}");
        assert!(error("input: {mask: a.nrrd}\nextensions: {length: }\n").contains("`length` has no value"));
        assert!(error("input: {mask: a.nrrd}\nvolume: {boundary_layers: {count: }}\n").contains("`count` has no value"));
        assert!(error("input: {mask: a.nrrd}\nsurface: {sclae: }\n").contains("did you mean"));
        for o in ["flow.inlet.flow_rate=", "flow.inlet.flow_rate=null"] {
            let e = from_text("input: {mask: a.nrrd}\n", "c", &[o.into()]).expect_err("no value").to_string();
            assert!(e.contains("no value"), "{e}");
        }
    }

    #[test]
    fn no_input_and_two_inputs_are_refused() {
        assert!(error("surface: {scale: 1}\n").contains("input"));
        assert!(error("input: {}\n").contains("names no file"));
        assert!(error("input: {mask: a.nrrd, surface: b.stl}\n").contains("names 2 files"));
    }

    #[test]
    fn openings_are_a_list_or_a_mapping() {
        let list = "input: {mask: a.nrrd}\nopenings:\n- {name: inlet, center: [0, 0, 1], normal: [0, 0, 1]}\n";
        let case = from_text(list, "c", &[]).expect("list");
        assert_eq!((case.openings.detect, case.openings.planes.len()), (super::super::Detect::Off, 1));
        let map = from_text("input: {mask: a.nrrd}\nopenings: {detect: auto, drop: [outlet_3]}\n", "c", &[]).expect("map");
        assert_eq!(map.openings.drop, ["outlet_3"]);
        assert!(error("input: {mask: a.nrrd}\nopenings:\n- {name: inlet, center: [0, 0, 1], normal: [0, 0, 0]}\n").contains("no direction"));
        let e = error("input: {mask: a.nrrd}\nopenings: {detct: auto}\n");
        assert!(e.contains("case.yaml:2:") && e.contains("detect"), "{e}");
    }

    #[test]
    fn overrides_change_values_and_are_checked() {
        let base = "input: {mask: a.nrrd}\n";
        let case = from_text(base, "c", &["surface.edge_length=0.4 mm".into(), "volume.boundary_layers.count=4".into()]).expect("fine");
        assert_eq!(case.surface.edge_length, super::super::AutoLength::Given(super::super::Length::mm(0.4)));
        assert_eq!(case.volume.boundary_layers.count, 4);
        let e = from_text(base, "c", &["surface.edgelength=1 mm".into()]).expect_err("unknown").to_string();
        assert!(e.starts_with("--set surface.edgelength=1 mm") && e.contains("edge_length"), "{e}");
    }

    #[test]
    fn the_resolved_configuration_reads_back_the_same() {
        let text = "input: {mask: a.nrrd, label: [1, 4]}\nopenings:\n- {name: inlet, center: [0, 0.1, 1e-7], normal: [0, 0, 1]}\nsurface: {refine: [{sphere: {center: [1,2,3], radius: 4}, edge_length: 0.2 R}]}\n";
        let case = from_text(text, "c", &[]).expect("fine");
        let yaml = to_yaml(&case).expect("writes");
        assert_eq!(from_text(&yaml, "resolved", &[]).expect("reads"), case, "{yaml}");
        assert_eq!(to_yaml(&from_text(&yaml, "resolved", &[]).expect("reads")).expect("writes"), yaml);
    }

    #[test]
    fn skewness_limits_out_of_range_are_refused() {
        assert!(error("input: {mask: a.nrrd}\nsurface: {max_skewness: 1.5}\n").contains("out of range"));
    }
}
