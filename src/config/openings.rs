//! The `openings:` section: a list of planes, or detection with changes.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, de};

/// A plane that cuts one branch open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OpeningPlane {
    /// Patch name; `inlet…` makes it an inlet unless `kind` says otherwise.
    pub name: String,
    /// A point on the plane within the branch, LPS mm.
    pub center: [f64; 3],
    /// Direction out of the vessel; any length.
    pub normal: [f64; 3],
    /// Inlet or outlet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<OpeningKind>,
}

/// Inlet or outlet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OpeningKind {
    /// Flow enters.
    Inlet,
    /// Flow leaves.
    Outlet,
}

/// Whether ends are looked for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Detect {
    /// Ends are found by themselves.
    #[default]
    Auto,
    /// Only the planes given.
    Off,
}

/// Another name for a detected opening.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rename {
    /// Name that detection gave.
    pub from: String,
    /// Name to use.
    pub to: String,
}

/// Inlets and outlets: a list of planes is short for `{detect: off, planes: […]}`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct OpeningsSection {
    /// Whether ends are looked for. Default auto.
    pub detect: Detect,
    /// Planes besides the detected ones; one within two radii of a detected end replaces it.
    pub planes: Vec<OpeningPlane>,
    /// Names of detected openings to leave closed.
    pub drop: Vec<String>,
    /// Other names for detected openings.
    pub rename: Vec<Rename>,
    /// Name of the opening that is the inlet; default: the largest section.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inlet: Option<String>,
}

#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[derive(Default)]
struct Section {
    /// Whether ends are looked for. Default auto.
    detect: Detect,
    /// Planes besides the detected ones; one within two radii of a detected end replaces it.
    planes: Vec<OpeningPlane>,
    /// Names of detected openings to leave closed.
    drop: Vec<String>,
    /// Other names for detected openings.
    rename: Vec<Rename>,
    /// Name of the opening that is the inlet; default: the largest section.
    inlet: Option<String>,
}

impl<'de> Deserialize<'de> for OpeningsSection {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> de::Visitor<'de> for Either {
            type Value = OpeningsSection;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a list of planes, or a mapping such as `{detect: auto}`")
            }
            fn visit_seq<A: de::SeqAccess<'de>>(self, seq: A) -> Result<OpeningsSection, A::Error> {
                let planes = Vec::deserialize(de::value::SeqAccessDeserializer::new(seq))?;
                Ok(OpeningsSection { detect: Detect::Off, planes, ..OpeningsSection::default() })
            }
            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<OpeningsSection, A::Error> {
                let s = Section::deserialize(de::value::MapAccessDeserializer::new(map))?;
                Ok(OpeningsSection { detect: s.detect, planes: s.planes, drop: s.drop, rename: s.rename, inlet: s.inlet })
            }
        }
        d.deserialize_any(Either)
    }
}

impl JsonSchema for OpeningsSection {
    fn schema_name() -> Cow<'static, str> {
        "Openings".into()
    }

    fn json_schema(g: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [g.subschema_for::<Section>(), g.subschema_for::<Vec<OpeningPlane>>()] })
    }
}
