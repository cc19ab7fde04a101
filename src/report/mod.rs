//! report.json: what was made, how good it is, and whether each gate was met.

pub mod cohort;
pub mod handover;
pub mod html;
pub mod picture;

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

/// Version of the layout of report.json; it changes when a key that others read changes.
pub const SCHEMA_VERSION: u32 = 1;

/// Four digits after the point, and none too many; small values with three significant digits.
pub fn rounded(value: f64) -> String {
    if value == 0.0 || value.abs() >= 1e-3 {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    } else {
        format!("{value:.2e}")
    }
}

/// One limit and how the result stands to it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gate {
    /// What is held against the limit.
    pub name: String,
    /// The limit in words, for example `< 0.75`.
    pub limit: String,
    /// The figure measured.
    pub value: f64,
    /// Whether a miss fails the run; advisory otherwise.
    pub hard: bool,
    /// Whether the limit is met.
    pub passed: bool,
}

/// How a value is held against its limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit {
    /// The value must be below.
    Below(f64),
    /// The value must not be above.
    AtMost(f64),
    /// The value must not be below.
    AtLeast(f64),
    /// The value must be exactly this.
    Exactly(f64),
}

impl Gate {
    fn new(name: &str, value: f64, limit: Limit, hard: bool) -> Gate {
        let number = |l: f64| if l != 0.0 && l.abs() < 1e-4 { format!("{l:e}") } else { l.to_string() };
        let (limit, passed) = match limit {
            Limit::Below(l) => (format!("< {}", number(l)), value < l),
            Limit::AtMost(l) => (format!("≤ {}", number(l)), value <= l),
            Limit::AtLeast(l) => (format!("≥ {}", number(l)), value >= l),
            Limit::Exactly(l) => (format!("= {}", number(l)), value == l),
        };
        Gate { name: name.into(), limit, value, hard, passed }
    }

    /// A limit whose miss fails the run. A value that is not a number misses it.
    pub fn hard(name: &str, value: f64, limit: Limit) -> Gate {
        Gate::new(name, value, limit, true)
    }

    /// A limit that is aimed at.
    pub fn advisory(name: &str, value: f64, limit: Limit) -> Gate {
        Gate::new(name, value, limit, false)
    }
}

/// Verdict of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Every hard gate is met.
    Passed,
    /// A hard gate is missed; all files are kept.
    GateMissed,
}

/// Units of everything in the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Units {
    /// Unit of lengths.
    pub length: &'static str,
    /// Frame of coordinates.
    pub coordinates: &'static str,
}

/// Seconds that a stage took.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageTime {
    /// Name of the stage.
    pub name: String,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// What differs from run to run.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RunInfo {
    /// The stages in order.
    pub stages: Vec<StageTime>,
    /// Largest resident memory of the process, bytes; 0 where the system does not tell.
    pub peak_memory_bytes: u64,
    /// Threads used.
    pub threads: usize,
}

/// A part of the vessel that the mesh lacks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Warning {
    /// Stage that warns.
    pub stage: &'static str,
    /// What, where and what to do.
    pub message: String,
}

/// The report. Sections hold the stages' own summaries.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// See [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Verdict.
    pub status: Status,
    /// Version of lumenmesh.
    pub version: &'static str,
    /// Units and frame.
    pub units: Units,
    /// Limits and how the result stands to them.
    pub gates: Vec<Gate>,
    /// What the user should know.
    pub warnings: Vec<Warning>,
    /// Times, memory, threads: the only part that differs from run to run.
    pub run: RunInfo,
    /// The stages' summaries by their keys: `input`, `cleaning`, `reconstruction`, `surface`, `fidelity`,
    /// `openings`, `volume`, `flow`, …
    #[serde(flatten)]
    pub sections: BTreeMap<&'static str, Value>,
}

impl Default for Report {
    fn default() -> Self {
        Report {
            schema_version: SCHEMA_VERSION,
            status: Status::Passed,
            version: env!("CARGO_PKG_VERSION"),
            units: Units { length: "mm", coordinates: "LPS" },
            gates: Vec::new(),
            warnings: Vec::new(),
            run: RunInfo::default(),
            sections: BTreeMap::new(),
        }
    }
}

impl Report {
    /// Puts a stage's summary under `key`, beside what was put into that section before. A number that JSON lacks (infinite, NaN) becomes `null`.
    pub fn put(&mut self, key: &'static str, summary: &impl Serialize) {
        match (self.sections.get_mut(key), serde_json::to_value(summary).unwrap_or(Value::Null)) {
            (Some(Value::Object(old)), Value::Object(new)) => old.extend(new),
            (_, value) => {
                self.sections.insert(key, value);
            }
        }
    }

    /// Adds a key to a section that is an object.
    pub fn put_in(&mut self, section: &'static str, key: &str, value: &impl Serialize) {
        let at = self.sections.entry(section).or_insert_with(|| Value::Object(serde_json::Map::new()));
        if let Value::Object(map) = at {
            map.insert(key.into(), serde_json::to_value(value).unwrap_or(Value::Null));
        }
    }

    /// Adds a gate and takes the verdict anew.
    pub fn gate(&mut self, gate: Gate) {
        self.gates.push(gate);
        let missed = self.gates.iter().any(|g| g.hard && !g.passed);
        self.status = if missed { Status::GateMissed } else { Status::Passed };
    }

    /// Takes all gates back: nothing is held against a limit where a run stops before there is a mesh.
    pub fn without_gates(&mut self) {
        self.gates.clear();
        self.status = Status::Passed;
    }

    /// Adds a warning.
    pub fn warn(&mut self, stage: &'static str, message: impl Into<String>) {
        self.warnings.push(Warning { stage, message: message.into() });
    }

    /// The report as indented JSON, ending in a line break.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_leaves_what_others_put_into_its_section() {
        let mut r = Report::default();
        r.put_in("surface", "front_fraction", &0.99);
        r.put("surface", &serde_json::json!({"faces": 12}));
        assert_eq!(r.sections["surface"], serde_json::json!({"front_fraction": 0.99, "faces": 12}));
    }

    #[test]
    fn a_missed_hard_gate_fails_the_run_and_an_advisory_one_does_not() {
        let mut r = Report::default();
        r.gate(Gate::advisory("mean", 0.3, Limit::AtMost(0.28)));
        assert_eq!(r.status, Status::Passed);
        r.gate(Gate::hard("max", 0.76, Limit::Below(0.75)));
        assert_eq!(r.status, Status::GateMissed);
    }

    #[test]
    fn figures_have_the_digits_that_say_something() {
        let text = [0.0, 0.75, 12.0, 1234.56789, 2.1895e-16, -3e-5].map(rounded);
        assert_eq!(text, ["0", "0.75", "12", "1234.5679", "2.19e-16", "-3.00e-5"]);
    }

    #[test]
    fn a_figure_that_is_not_a_number_misses_its_gate() {
        for limit in [Limit::Below(1.0), Limit::AtMost(1.0), Limit::AtLeast(0.0), Limit::Exactly(0.0)] {
            assert!(!Gate::hard("x", f64::NAN, limit).passed);
        }
    }
}
