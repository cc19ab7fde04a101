//! Lengths as people write them: a number and a unit.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// What a length is measured in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Millimetres.
    Millimetre,
    /// The smallest voxel edge.
    Voxel,
    /// The vessel's local radius.
    Radius,
    /// The vessel's local diameter.
    Diameter,
}

/// A length with its unit, for example `0.4 mm`, `2 voxels`, `0.1 R`, `5 D`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// The number, not negative.
    pub value: f64,
    /// Its unit.
    pub unit: Unit,
}

/// Why a text is no length.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LengthError {
    /// There is no unit.
    #[error("`{0}` has no unit: write `{0} mm`, `{0} voxels`, `{0} R` (local radius) or `{0} D` (local diameter)")]
    NoUnit(String),
    /// The unit is unknown.
    #[error("`{text}`: unknown unit `{unit}`; use mm, cm, m, um, voxels, R (local radius) or D (local diameter)")]
    Unit {
        /// The whole text.
        text: String,
        /// What stands after the number.
        unit: String,
    },
    /// The number cannot be read, is negative or not finite.
    #[error("`{0}` is not a length: write a number from 0 up and a unit, such as `0.4 mm`")]
    Number(String),
}

impl Length {
    /// `value` millimetres.
    pub const fn mm(value: f64) -> Length {
        Length { value, unit: Unit::Millimetre }
    }

    /// `value` voxel edges.
    pub const fn voxels(value: f64) -> Length {
        Length { value, unit: Unit::Voxel }
    }

    /// `value` local diameters.
    pub const fn diameters(value: f64) -> Length {
        Length { value, unit: Unit::Diameter }
    }

    /// The length in millimetres where the smallest voxel edge is `voxel` and the local radius `radius`.
    pub fn to_mm(self, voxel: f64, radius: f64) -> f64 {
        self.value
            * match self.unit {
                Unit::Millimetre => 1.0,
                Unit::Voxel => voxel,
                Unit::Radius => radius,
                Unit::Diameter => 2.0 * radius,
            }
    }
}

impl FromStr for Length {
    type Err = LengthError;

    fn from_str(text: &str) -> Result<Length, LengthError> {
        let text = text.trim();
        // The number ends where the unit's letters start; `1e-3 mm` keeps its exponent.
        let split = text
            .char_indices()
            .find(|&(i, c)| {
                c.is_alphabetic()
                    && !(matches!(c, 'e' | 'E')
                        && text[i + 1..].starts_with(|n: char| n.is_ascii_digit() || n == '-' || n == '+'))
            })
            .map_or(text.len(), |(i, _)| i);
        let (number, unit) = (text[..split].trim(), text[split..].trim());
        let value: f64 = number.parse().map_err(|_| LengthError::Number(text.into()))?;
        if !value.is_finite() || value < 0.0 {
            return Err(LengthError::Number(text.into()));
        }
        let (factor, unit) = match unit {
            "" => return Err(LengthError::NoUnit(text.into())),
            "mm" => (1.0, Unit::Millimetre),
            "cm" => (10.0, Unit::Millimetre),
            "m" => (1000.0, Unit::Millimetre),
            "um" | "µm" => (1e-3, Unit::Millimetre),
            "voxel" | "voxels" | "vox" => (1.0, Unit::Voxel),
            "R" => (1.0, Unit::Radius),
            "D" => (1.0, Unit::Diameter),
            _ => return Err(LengthError::Unit { text: text.into(), unit: unit.into() }),
        };
        Ok(Length { value: value * factor, unit })
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = match self.unit {
            Unit::Millimetre => "mm",
            Unit::Voxel if self.value == 1.0 => "voxel",
            Unit::Voxel => "voxels",
            Unit::Radius => "R",
            Unit::Diameter => "D",
        };
        write!(f, "{} {unit}", self.value)
    }
}

impl Serialize for Length {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

/// A text, or a bare number turned into text so that the error can name what was written.
pub(super) fn scalar_text<'de, D: Deserializer<'de>>(d: D) -> Result<String, D::Error> {
    struct Text;
    impl de::Visitor<'_> for Text {
        type Value = String;
        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            f.write_str("a number with a unit, such as `0.4 mm`")
        }
        fn visit_str<E: de::Error>(self, v: &str) -> Result<String, E> {
            Ok(v.into())
        }
        fn visit_f64<E: de::Error>(self, v: f64) -> Result<String, E> {
            Ok(v.to_string())
        }
        fn visit_i64<E: de::Error>(self, v: i64) -> Result<String, E> {
            Ok(v.to_string())
        }
        fn visit_u64<E: de::Error>(self, v: u64) -> Result<String, E> {
            Ok(v.to_string())
        }
    }
    d.deserialize_any(Text)
}

impl<'de> Deserialize<'de> for Length {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Length, D::Error> {
        scalar_text(d)?.parse().map_err(de::Error::custom)
    }
}

impl JsonSchema for Length {
    fn schema_name() -> Cow<'static, str> {
        "Length".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "string",
            "description": "A number and a unit: mm, cm, m, um, voxels, R (local radius) or D (local diameter).",
            "pattern": r"^\s*[0-9.]+([eE][-+]?[0-9]+)?\s*(mm|cm|m|um|µm|voxels?|vox|R|D)\s*$"
        })
    }
}

/// A length, or `auto`: chosen by lumenmesh, which says what it chose and why.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum AutoLength {
    /// Chosen from the case.
    #[default]
    Auto,
    /// As given.
    Given(Length),
}

impl Serialize for AutoLength {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self {
            AutoLength::Auto => s.serialize_str("auto"),
            AutoLength::Given(l) => l.serialize(s),
        }
    }
}

impl<'de> Deserialize<'de> for AutoLength {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<AutoLength, D::Error> {
        let text = scalar_text(d)?;
        if text.trim() == "auto" {
            return Ok(AutoLength::Auto);
        }
        text.parse().map(AutoLength::Given).map_err(de::Error::custom)
    }
}

impl JsonSchema for AutoLength {
    fn schema_name() -> Cow<'static, str> {
        "AutoLength".into()
    }

    fn json_schema(g: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "const": "auto" }, g.subschema_for::<Length>()] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_carry_their_unit() {
        assert_eq!("0.4 mm".parse(), Ok(Length::mm(0.4)));
        assert_eq!("2voxels".parse(), Ok(Length::voxels(2.0)));
        assert_eq!("1e-3 m".parse(), Ok(Length::mm(1.0)));
        assert_eq!("5 D".parse::<Length>().map(|l| l.to_mm(0.5, 2.0)), Ok(20.0));
        assert_eq!("0.1 R".parse::<Length>().map(|l| l.to_mm(0.5, 2.0)), Ok(0.2));
    }

    #[test]
    fn a_length_without_unit_is_refused_with_the_ways_out() {
        assert_eq!("0.4".parse::<Length>(), Err(LengthError::NoUnit("0.4".into())));
        assert!("3 furlongs".parse::<Length>().is_err_and(|e| e.to_string().contains("furlongs")));
        assert!("-1 mm".parse::<Length>().is_err());
        assert!("NaN mm".parse::<Length>().is_err());
    }

    #[test]
    fn what_is_written_reads_back_the_same() {
        for text in ["0.4 mm", "1 voxel", "2.5 voxels", "0.1 R", "5 D"] {
            assert_eq!(text.parse::<Length>().map(|l| l.to_string()), Ok(text.to_string()));
        }
    }
}
