//! The `flow:` section: flow and blood for the solver cases.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, de};

/// Flow and blood for the solver cases.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Flow {
    /// Flow at the inlet.
    pub inlet: InletFlow,
    /// How the outlets share it.
    pub outlets: OutletFlow,
    /// The blood.
    pub blood: Blood,
    /// Waveform CSV with time (s) and flow rate (ml/s) columns, all inlets together: makes the case pulsatile. Its last
    /// row is the end of the beat. Relative paths start at the case file's folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub waveform: Option<PathBuf>,
    /// Heart beats to run, with a waveform. Default 3: the first two wash out the start.
    pub cycles: u32,
    /// Largest Courant number, with a waveform; sets the time step. Default 2.
    pub max_courant: f64,
    /// Parts of a parallel run, `./Allrun parallel`. Default 2.
    pub processes: u32,
}

impl Default for Flow {
    fn default() -> Self {
        Flow {
            inlet: InletFlow::default(),
            outlets: OutletFlow::default(),
            blood: Blood::default(),
            waveform: None,
            cycles: 3,
            max_courant: 2.0,
            processes: 2,
        }
    }
}

/// Flow at the inlet. Give one of `reynolds`, `flow_rate` and `velocity`, or a waveform; default Reynolds number 300.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InletFlow {
    /// Reynolds number of the mean flow and the hydraulic diameter, at every inlet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reynolds: Option<f64>,
    /// Flow rate of all inlets together, ml/s, shared by `fractions`, by area where there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow_rate: Option<f64>,
    /// Mean velocity at every inlet, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<f64>,
    /// Share of each inlet in the flow rate (`flow_rate` or the waveform), by name (`{inlet: 0.6, inlet_right: 0.4}`) or in
    /// the order of the patch ids; the sum must be 1. Default: by area.
    #[serde(skip_serializing_if = "Shares::is_empty")]
    pub fractions: Shares,
    /// Velocity profile.
    pub profile: VelocityProfile,
}

/// One number for each opening: by name, or a list in the order of the patch ids.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Shares {
    /// In the order of the patch ids.
    InOrder(Vec<f64>),
    /// By name.
    ByName(BTreeMap<String, f64>),
}

impl Default for Shares {
    fn default() -> Self {
        Shares::InOrder(Vec::new())
    }
}

impl Shares {
    /// Whether there is no number.
    pub fn is_empty(&self) -> bool {
        self.values().next().is_none()
    }

    /// The numbers.
    pub fn values(&self) -> impl Iterator<Item = f64> + '_ {
        let (list, map) = match self {
            Shares::InOrder(list) => (Some(list), None),
            Shares::ByName(map) => (None, Some(map)),
        };
        list.into_iter().flatten().chain(map.into_iter().flat_map(BTreeMap::values)).copied()
    }

    /// The names, where there are any.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let map = if let Shares::ByName(map) = self { Some(map) } else { None };
        map.into_iter().flat_map(BTreeMap::keys).map(String::as_str)
    }
}

impl<'de> Deserialize<'de> for Shares {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> de::Visitor<'de> for Either {
            type Value = Shares;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("numbers by name such as `{outlet_1: 0.6, outlet_2: 0.4}`, or a list of numbers")
            }
            fn visit_seq<A: de::SeqAccess<'de>>(self, seq: A) -> Result<Shares, A::Error> {
                Vec::deserialize(de::value::SeqAccessDeserializer::new(seq)).map(Shares::InOrder)
            }
            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Shares, A::Error> {
                BTreeMap::deserialize(de::value::MapAccessDeserializer::new(map)).map(Shares::ByName)
            }
        }
        d.deserialize_any(Either)
    }
}

impl JsonSchema for Shares {
    fn schema_name() -> Cow<'static, str> {
        "Shares".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let number = json_schema!({ "type": "number" });
        json_schema!({ "anyOf": [
            { "type": "array", "items": number },
            { "type": "object", "additionalProperties": number },
        ] })
    }
}

impl Flow {
    /// The numbers that are given for openings, with the path of their key.
    pub(super) fn shares(&self) -> [(&'static str, &Shares); 3] {
        let o = &self.outlets;
        [
            ("flow.inlet.fractions", &self.inlet.fractions),
            ("flow.outlets.fractions", &o.fractions),
            ("flow.outlets.resistances", &o.resistances),
        ]
    }
}

/// Velocity profile over the inlet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum VelocityProfile {
    /// Developed laminar flow.
    #[default]
    Parabolic,
    /// The same velocity everywhere.
    Flat,
}

/// How the outlets share the flow.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OutletFlow {
    /// Rule of the split.
    pub split: Split,
    /// With `fractions`: the share of each outlet, by name (`{outlet_1: 0.6, outlet_2: 0.4}`) or in the order of the patch
    /// ids; of each separate vessel the sum must be 1.
    pub fractions: Shares,
    /// With `resistance`: the resistance of each outlet, Pa s/m³, by name or in the order of the patch ids.
    pub resistances: Shares,
}

/// Rule by which the outlets share the flow.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// By the cube of the diameter (Murray's law).
    #[default]
    Murray,
    /// By area.
    Area,
    /// As given in `fractions`.
    Fractions,
    /// Pressure from flow and the given `resistances`.
    Resistance,
    /// The same pressure at all outlets.
    Pressure,
}

/// The blood.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Blood {
    /// Viscosity model.
    pub model: Viscosity,
    /// Density, kg/m³. Default 1060.
    pub density: f64,
    /// Dynamic viscosity, Pa s: constant with `newtonian` (default 0.003498), at high shear rate with `casson` (0.0035)
    /// and `carreau` (0.00345).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub viscosity: Option<f64>,
    /// With `casson`: yield stress, Pa. Default 0.004.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub yield_stress: Option<f64>,
    /// With `casson`: largest viscosity, Pa s, where shear vanishes. Default 0.1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_viscosity: Option<f64>,
    /// With `carreau`: viscosity at rest, Pa s. Default 0.056.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rest_viscosity: Option<f64>,
    /// With `carreau`: time constant, s. Default 3.313.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_constant: Option<f64>,
    /// With `carreau`: exponent n. Default 0.3568.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exponent: Option<f64>,
}

impl Default for Blood {
    fn default() -> Self {
        Blood {
            model: Viscosity::Newtonian,
            density: 1060.0,
            viscosity: None,
            yield_stress: None,
            max_viscosity: None,
            rest_viscosity: None,
            time_constant: None,
            exponent: None,
        }
    }
}

/// Viscosity model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Viscosity {
    /// Constant.
    #[default]
    Newtonian,
    /// Casson: √μ = √μ∞ + √(τ₀/γ̇), bounded above.
    Casson,
    /// Carreau: μ = μ∞ + (μ₀ − μ∞)(1 + (λγ̇)²)^((n−1)/2).
    Carreau,
}

/// A sum without the last digits' noise.
fn rounded(sum: f64) -> f64 {
    (sum * 1e6).round() / 1e6
}

/// What the types of the section cannot say: the key, and what is wrong with it.
pub(super) fn check(flow: &Flow) -> Result<(), (String, String)> {
    let fail = |key: &str, message: String| Err((format!("flow.{key}"), message));
    let i = &flow.inlet;
    let given: Vec<&str> = [("reynolds", i.reynolds), ("flow_rate", i.flow_rate), ("velocity", i.velocity)]
        .iter()
        .filter(|g| g.1.is_some())
        .map(|g| g.0)
        .collect();
    if given.len() > 1 {
        return fail("inlet", format!("has {} at once: give one", given.join(" and ")));
    }
    if let (Some(_), [key]) = (&flow.waveform, &given[..]) {
        return fail("inlet", format!("has {key}, and flow.waveform gives the flow rate already: remove one of them"));
    }
    let range = |key: &str, value: Option<f64>, low: f64, high: f64| match value {
        Some(v) if !(v.is_finite() && (low..=high).contains(&v)) => fail(key, format!("{v} is out of range: use {low} to {high}")),
        _ => Ok(()),
    };
    range("inlet.reynolds", i.reynolds, 1e-6, 1e5)?;
    range("inlet.flow_rate", i.flow_rate, 1e-9, 1e6)?;
    range("inlet.velocity", i.velocity, 1e-9, 100.0)?;
    let o = &flow.outlets;
    for (key, list, split) in [("fractions", &o.fractions, Split::Fractions), ("resistances", &o.resistances, Split::Resistance)] {
        let word = if split == Split::Fractions { "fractions" } else { "resistance" };
        if o.split == split && list.is_empty() {
            return fail("outlets", format!("splits by {word}, and {key} is empty: give one number for each outlet"));
        }
        if o.split != split && !list.is_empty() {
            return fail(&format!("outlets.{key}"), format!("is used with `split: {word}` only: set it, or remove the list"));
        }
        if let Some(v) = list.values().find(|v| !(v.is_finite() && *v >= 0.0)) {
            return fail(&format!("outlets.{key}"), format!("{v} is no share or resistance: use positive numbers"));
        }
    }
    // Vessels apart from each other have a whole of their own each.
    let sum: f64 = o.fractions.values().sum();
    if o.split == Split::Fractions && !(sum >= 1.0 - 1e-6 && (sum - sum.round()).abs() <= 1e-6) {
        return fail("outlets.fractions", format!("sum to {}: they must sum to 1", rounded(sum)));
    }
    if !i.fractions.is_empty() {
        if flow.waveform.is_none() && i.flow_rate.is_none() {
            return fail("inlet.fractions", "share a flow rate among the inlets: give flow.inlet.flow_rate or flow.waveform too".into());
        }
        if let Some(v) = i.fractions.values().find(|v| !(v.is_finite() && *v > 0.0)) {
            return fail("inlet.fractions", format!("{v} is no share: use numbers above 0"));
        }
        let sum: f64 = i.fractions.values().sum();
        if (sum - 1.0).abs() > 1e-6 {
            return fail("inlet.fractions", format!("sum to {}: they must sum to 1", rounded(sum)));
        }
    }
    let b = &flow.blood;
    range("blood.density", Some(b.density), 100.0, 20000.0)?;
    range("blood.viscosity", b.viscosity, 1e-6, 10.0)?;
    let own = [
        ("yield_stress", b.yield_stress, Viscosity::Casson, 0.0, 10.0),
        ("max_viscosity", b.max_viscosity, Viscosity::Casson, 1e-6, 1e3),
        ("rest_viscosity", b.rest_viscosity, Viscosity::Carreau, 1e-6, 1e3),
        ("time_constant", b.time_constant, Viscosity::Carreau, 0.0, 1e4),
        ("exponent", b.exponent, Viscosity::Carreau, 0.0, 1.0),
    ];
    for (key, value, model, low, high) in own {
        if value.is_some() && b.model != model {
            let name = if model == Viscosity::Casson { "casson" } else { "carreau" };
            return fail(&format!("blood.{key}"), format!("is used with `model: {name}` only: set it, or remove the key"));
        }
        range(&format!("blood.{key}"), value, low, high)?;
    }
    range("cycles", Some(f64::from(flow.cycles)), 1.0, 1000.0)?;
    range("max_courant", Some(flow.max_courant), 0.01, 100.0)?;
    range("processes", Some(f64::from(flow.processes)), 1.0, 4096.0)
}

#[cfg(test)]
mod tests {
    use crate::config::from_text;

    fn error(flow: &str) -> String {
        from_text(&format!("input: {{mask: a.nrrd}}\nflow: {{{flow}}}\n"), "case.yaml", &[]).expect_err("must be refused").to_string()
    }

    #[test]
    fn keys_that_exclude_each_other_are_refused_by_name() {
        for (flow, words) in [
            ("inlet: {reynolds: 300, velocity: 0.2}", "reynolds and velocity"),
            ("inlet: {flow_rate: 3}, waveform: beat.csv", "flow.waveform"),
            ("outlets: {split: fractions}", "fractions is empty"),
            ("outlets: {fractions: [0.5, 0.5]}", "split: fractions"),
            ("outlets: {split: fractions, fractions: [0.5, 0.6]}", "sum to 1"),
            ("outlets: {resistances: [1e9]}", "split: resistance"),
            ("blood: {yield_stress: 0.005}", "model: casson"),
            ("blood: {model: casson, exponent: 0.4}", "model: carreau"),
            ("inlet: {flow_rate: -3}", "out of range"),
            ("cycles: 0", "out of range"),
            ("inlet: {fractions: [0.5, 0.5]}", "flow_rate or flow.waveform"),
            ("inlet: {flow_rate: 3, fractions: {a: 0.5, b: 0.4}}", "sum to 0.9:"),
            ("inlet: {flow_rate: 3, fractions: [1, 0]}", "no share"),
            ("outlets: {split: fractions, fractions: big}", "numbers by name"),
        ] {
            let e = error(flow);
            assert!(e.contains(words), "{flow}: {e}");
        }
    }
}
