//! The `openings:` section: a list of planes, or detection with changes.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// A plane that cuts one branch open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OpeningPlane {
    /// Patch name: lower case letters, digits, `_` and `-`, a letter first; `inlet…` makes it an inlet unless `kind` says otherwise.
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

/// How ends that were cut flat are cut.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CutDirection {
    /// Along the flat face; square to the vessel's axis where the face is tilted by more than 30 degrees and the vessel
    /// behind it is long enough.
    #[default]
    Auto,
    /// Square to the axis wherever there is room.
    Square,
    /// Along the flat face.
    AsCut,
}

/// Another name for a detected opening.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rename {
    /// Name that detection gave.
    pub from: String,
    /// Name to use; `inlet…` makes it an inlet, `outlet…` an outlet.
    pub to: String,
}

/// Inlets and outlets: a list of planes is short for `{detect: off, planes: […]}`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct OpeningsSection {
    /// Whether ends are looked for. Default auto.
    pub detect: Detect,
    /// Planes besides the detected ones; one within two radii of a detected end replaces it.
    pub planes: Vec<OpeningPlane>,
    /// Names of detected openings to leave closed; the others keep their names.
    pub drop: Vec<String>,
    /// Other names for detected openings; one that begins with `inlet` makes it an inlet, one with `outlet` an outlet.
    pub rename: Vec<Rename>,
    /// Name of the opening that is the inlet, or a list of names; default: the largest section.
    #[serde(skip_serializing_if = "InletNames::is_empty")]
    pub inlet: InletNames,
    /// How ends that were cut flat, by a person or by the image's border, are cut: auto, square or as-cut. Default auto.
    pub cut: CutDirection,
}

/// Names of the openings that are inlets: written as one name or as a list; empty where the case names none.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct InletNames(pub Vec<String>);

impl InletNames {
    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl Serialize for InletNames {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match &self.0[..] {
            [one] => s.serialize_str(one),
            names => names.serialize(s),
        }
    }
}

impl<'de> Deserialize<'de> for InletNames {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Names;
        impl<'de> de::Visitor<'de> for Names {
            type Value = InletNames;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("the name of an opening, or a list such as `[inlet, outlet_1]`")
            }
            fn visit_str<E: de::Error>(self, name: &str) -> Result<InletNames, E> {
                Ok(InletNames(vec![name.into()]))
            }
            fn visit_seq<A: de::SeqAccess<'de>>(self, seq: A) -> Result<InletNames, A::Error> {
                Vec::deserialize(de::value::SeqAccessDeserializer::new(seq)).map(InletNames)
            }
        }
        d.deserialize_any(Names)
    }
}

impl JsonSchema for InletNames {
    fn schema_name() -> Cow<'static, str> {
        "InletNames".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }] })
    }
}

#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[derive(Default)]
struct Section {
    /// Whether ends are looked for. Default auto.
    detect: Detect,
    /// Planes besides the detected ones; one within two radii of a detected end replaces it.
    planes: Vec<OpeningPlane>,
    /// Names of detected openings to leave closed; the others keep their names.
    drop: Vec<String>,
    /// Other names for detected openings; one that begins with `inlet` makes it an inlet, one with `outlet` an outlet.
    rename: Vec<Rename>,
    /// Name of the opening that is the inlet, or a list of names; default: the largest section.
    inlet: InletNames,
    /// How ends that were cut flat, by a person or by the image's border, are cut: auto, square or as-cut. Default auto.
    cut: CutDirection,
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
                Ok(OpeningsSection { detect: s.detect, planes: s.planes, drop: s.drop, rename: s.rename, inlet: s.inlet, cut: s.cut })
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
