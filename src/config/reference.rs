//! The JSON Schema and the reference page, both generated from the doc comments of [`super::Case`].

use std::fmt::Write;

use serde_json::Value;

use super::Case;

/// JSON Schema (draft-07) of a case file.
pub fn schema() -> Value {
    let generator = schemars::generate::SchemaSettings::draft07().into_generator();
    let mut value = generator.into_root_schema_for::<Case>().to_value();
    if let Some(map) = value.as_object_mut() {
        map.insert("title".into(), "lumenmesh case".into());
    }
    value
}

/// Every key with its type, default and meaning, as Markdown.
pub fn reference_page() -> String {
    let root = schema();
    let mut page = String::from(
        "# Case file reference\nGenerated from the schema (`lumenmesh schema`). Everything but `input` is optional.\n",
    );
    let plain = |value: &&Value| resolve(&root, value).get("properties").is_none();
    let top: Vec<_> = root.get("properties").and_then(Value::as_object).into_iter().flatten().filter(|(_, v)| plain(v)).collect();
    if !top.is_empty() {
        let _ = writeln!(page, "\nKeys of the outermost level; each section has a table of its own.\n\n{HEAD}");
        top.iter().for_each(|(key, value)| row(&mut page, &root, key, value));
    }
    section(&mut page, &root, &root, "");
    page
}

fn resolve<'a>(root: &'a Value, mut at: &'a Value) -> &'a Value {
    loop {
        let target = at.get("$ref").or_else(|| at.get("allOf").and_then(|a| a.get(0)).and_then(|a| a.get("$ref")));
        match target.and_then(Value::as_str).and_then(|r| root.pointer(r.trim_start_matches('#'))) {
            Some(next) => at = next,
            None => return at,
        }
    }
}

const HEAD: &str = "| key | values | default | meaning |\n|---|---|---|---|";

/// One key of a table.
fn row(page: &mut String, root: &Value, key: &str, value: &Value) {
    let meaning = value.get("description").and_then(Value::as_str).unwrap_or_default().replace('\n', " ");
    let default = value.get("default").map(|d| format!("`{d}`")).unwrap_or_default();
    let default = if default.len() > 60 { "see below".into() } else { default };
    // Of a list the values that its entries may have.
    let of = resolve(root, value);
    let known = of.get("items").map(|i| values(root, i)).filter(|v| v.contains('`'));
    let values = known.map_or_else(|| values(root, value), |v| format!("list of {v}"));
    let _ = writeln!(page, "| `{key}` | {values} | {default} | {meaning} |");
}

fn section(page: &mut String, root: &Value, at: &Value, path: &str) {
    let Some(properties) = at.get("properties").and_then(Value::as_object) else { return };
    if !path.is_empty() {
        let _ = writeln!(page, "\n## `{path}`");
        let _ = writeln!(page, "{}\n", at.get("description").and_then(Value::as_str).unwrap_or_default());
        let _ = writeln!(page, "{HEAD}");
        properties.iter().for_each(|(key, value)| row(page, root, key, value));
    }
    for (key, value) in properties {
        let name = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        let inner = resolve(root, value);
        section(page, root, inner, &name);
        if let Some(items) = inner.get("items") {
            section(page, root, resolve(root, items), &format!("{name}[]"));
        }
        for option in inner.get("anyOf").and_then(Value::as_array).into_iter().flatten() {
            let option = resolve(root, option);
            if option.get("type").and_then(Value::as_str) == Some("object") {
                section(page, root, option, &name);
            } else if let Some(items) = option.get("items") {
                section(page, root, resolve(root, items), &format!("{name}[]"));
            }
        }
    }
}

fn values(root: &Value, at: &Value) -> String {
    let at = resolve(root, at);
    let constants = |list: &Value| -> Vec<String> {
        list.as_array().into_iter().flatten().filter_map(Value::as_str).map(|s| format!("`{s}`")).collect()
    };
    if let Some(list) = at.get("enum") {
        return constants(list).join(", ");
    }
    if let Some(one) = at.get("const").and_then(Value::as_str) {
        return format!("`{one}`");
    }
    for key in ["oneOf", "anyOf"] {
        if let Some(options) = at.get(key).and_then(Value::as_array) {
            return options.iter().map(|o| values(root, o)).filter(|s| s != "null").collect::<Vec<_>>().join(", ");
        }
    }
    if at.get("pattern").is_some() {
        return if at.get("description").is_some() { "length".into() } else { "`N voxels`".into() };
    }
    match at.get("type") {
        Some(Value::String(t)) => t.clone(),
        Some(Value::Array(ts)) => ts.iter().filter_map(Value::as_str).filter(|t| *t != "null").collect::<Vec<_>>().join(", "),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_names_every_section_of_the_contract() {
        let page = reference_page();
        assert!(page.contains("| `exports` | list of `vtk`, `stl`"), "{page}");
        for key in ["input", "reconstruction", "surface", "openings", "extensions", "volume", "volume.boundary_layers", "flow", "gates"] {
            assert!(page.contains(&format!("## `{key}`")), "{key} is missing in\n{page}");
        }
    }

    #[test]
    fn every_key_has_a_meaning() {
        for line in reference_page().lines().filter(|l| l.starts_with("| `")) {
            let meaning = line.trim_end_matches('|').rsplit('|').next().unwrap_or_default();
            assert!(meaning.trim().len() > 3, "no meaning in {line}");
        }
    }

    /// What an editor underlines is what a run refuses.
    #[test]
    fn the_ranges_of_the_schema_are_those_that_are_checked() {
        let root = schema();
        for path in ["surface.scale", "surface.edges_around", "surface.max_skewness", "reconstruction.offset", "volume.memory_limit", "volume.boundary_layers.growth"] {
            let at = path.split('.').fold(&root, |at, key| &resolve(&root, at)["properties"][key]);
            let (low, high) = (at["minimum"].as_f64().expect(path), at["maximum"].as_f64().expect(path));
            let accepted = |v: f64| super::super::from_text("input: {mask: a.nrrd}", "c", &[format!("{path}={v}")]).is_ok();
            let beyond = 0.01 * (high - low);
            assert!(accepted(high) && !accepted(low - beyond) && !accepted(high + beyond), "{path}: {low} to {high}");
        }
    }

    #[test]
    fn the_schema_forbids_unknown_keys_and_is_draft_07() {
        let s = schema();
        assert!(s["$schema"].as_str().is_some_and(|d| d.contains("draft-07")));
        assert_eq!(s["additionalProperties"], false);
    }
}
