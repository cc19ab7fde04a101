//! The hand-over sheet: what whoever sets up the flow needs of every opening, with units, in report.json and the page.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::cohort::escape;
use crate::flow::{FlowOptions, FlowPlan};

/// The report's section `flow`: fluid, totals, one row a patch, and the unit of every key.
pub fn sheet(options: &FlowOptions, plan: &FlowPlan) -> Value {
    let waveform = options.waveform.as_ref().map(|w| {
        json!({
            "period_s": w.period(), "mean_m3_per_s": w.mean(), "peak_m3_per_s": w.peak(), "rows": w.times.len(),
            "beats": options.cycles, "max_courant": options.max_courant,
        })
    });
    json!({
        "patches": plan.openings,
        "units": {
            "area": "mm^2", "hydraulic_diameter": "mm", "center": "mm, LPS", "normal": "unit vector out of the vessel, LPS",
            "flow": "m^3/s", "velocity": "m/s, mean over the area", "reynolds": "1, mean velocity and hydraulic diameter",
            "womersley": "1, hydraulic radius and the beat's angular frequency", "condition": "resistance in Pa s/m^3",
            "solver_files": "m, s, kg",
        },
        "total_m3_per_s": plan.total,
        "nu_m2_per_s": plan.nu,
        "density_kg_per_m3": options.density,
        "viscosity": options.viscosity,
        "profile": options.profile,
        "split": options.split,
        "waveform": waveform,
    })
}

/// Four significant digits.
fn digits(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return if x == 0.0 { "0".into() } else { "–".into() };
    }
    let places = 3 - x.abs().log10().floor() as i32;
    if (0..9).contains(&places) { format!("{x:.*}", places as usize) } else { format!("{x:.3e}") }
}

/// The sheet as a section of the page; empty where there is no flow.
pub(super) fn section(report: &Value) -> String {
    let Some(flow) = report.get("flow") else { return String::new() };
    let Some(rows) = flow.get("patches").and_then(Value::as_array) else { return String::new() };
    let number = |v: Option<&Value>, factor: f64| v.and_then(Value::as_f64).map_or("–".into(), |x| digits(x * factor));
    let triple = |v: Option<&Value>| {
        let list: Vec<String> = v.and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_f64).map(|x| format!("{x:.4}")).collect();
        list.join(", ")
    };
    let mut out = format!(
        "<h2>Hand-over sheet</h2><p class=soft>Lengths and coordinates here are mm, LPS; the solver files are in metres. Density {} kg/m³, kinematic viscosity {} mm²/s, total flow {} ml/s.",
        number(flow.get("density_kg_per_m3"), 1.0),
        number(flow.get("nu_m2_per_s"), 1e6),
        number(flow.get("total_m3_per_s"), 1e6),
    );
    if let Some(w) = flow.get("waveform").filter(|w| w.is_object()) {
        let _ = write!(out, " Pulsatile: beat of {} s, peak {} ml/s.", number(w.get("period_s"), 1.0), number(w.get("peak_m3_per_s"), 1e6));
    }
    out.push_str("</p><div class=scroll><table><tr><th>patch<th class=t>kind<th class=t>held by<th>area (mm²)<th>hydraulic diameter (mm)<th>flow (ml/s)<th>mean velocity (m/s)<th>Reynolds (1)<th>Womersley (1)<th class=t>centre (mm)<th class=t>normal, outwards</tr>");
    for row in rows {
        let get = |key: &str| row.get(key);
        let text = |key: &str| escape(get(key).and_then(Value::as_str).unwrap_or("–"));
        let held = match get("condition") {
            Some(Value::Object(c)) => format!("resistance {} Pa s/m³", number(c.get("resistance"), 1.0)),
            _ => match get("condition").and_then(Value::as_str) {
                Some("inflow") => "flow rate in",
                Some("outflow") => "flow rate out",
                _ => "zero pressure",
            }
            .into(),
        };
        let _ = write!(out, "<tr><td>{}<td class=t>{}<td class=t>{held}", text("name"), text("kind"));
        for (key, factor) in [("area", 1.0), ("hydraulic_diameter", 1.0), ("flow", 1e6), ("velocity", 1.0), ("reynolds", 1.0), ("womersley", 1.0)] {
            let _ = write!(out, "<td>{}", number(get(key), factor));
        }
        let _ = write!(out, "<td class=t>{}<td class=t>{}</tr>", triple(get("center")), triple(get("normal")));
    }
    out + "</table></div>\n<p class=soft>A dash: the solver finds it.</p>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits_and_every_column_its_unit() {
        assert_eq!([digits(19.41113), digits(0.000123456), digits(0.0), digits(299.99996)], ["19.41", "0.0001235", "0", "300.0"]);
        let report = json!({"flow": {"patches": [{"name": "inlet", "kind": "inlet", "condition": "inflow", "area": 19.41113, "flow": 3.87e-6, "center": [1, 2, 3]}], "density_kg_per_m3": 1060.0}});
        let page = section(&report);
        assert!(page.contains("area (mm²)") && page.contains("<td>3.870") && page.contains("19.41") && page.contains("1060 kg/m³"), "{page}");
    }
}
