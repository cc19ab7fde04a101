//! Voxel values of any scalar type on a grid, as a picture file holds them.

use rayon::prelude::*;
use serde::Serialize;

use super::Grid;

/// Voxel values in the type of the file; x runs fastest.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// 8 bits, unsigned.
    U8(Vec<u8>),
    /// 8 bits, signed.
    I8(Vec<i8>),
    /// 16 bits, unsigned.
    U16(Vec<u16>),
    /// 16 bits, signed.
    I16(Vec<i16>),
    /// 32 bits, unsigned.
    U32(Vec<u32>),
    /// 32 bits, signed.
    I32(Vec<i32>),
    /// 64 bits, unsigned.
    U64(Vec<u64>),
    /// 64 bits, signed.
    I64(Vec<i64>),
    /// Single precision.
    F32(Vec<f32>),
    /// Double precision.
    F64(Vec<f64>),
}

/// Runs an expression with `$v` bound to the slice inside a [`Values`].
macro_rules! with_values {
    ($values:expr, $v:ident => $body:expr) => {
        match $values {
            $crate::mask::Values::U8($v) => $body,
            $crate::mask::Values::I8($v) => $body,
            $crate::mask::Values::U16($v) => $body,
            $crate::mask::Values::I16($v) => $body,
            $crate::mask::Values::U32($v) => $body,
            $crate::mask::Values::I32($v) => $body,
            $crate::mask::Values::U64($v) => $body,
            $crate::mask::Values::I64($v) => $body,
            $crate::mask::Values::F32($v) => $body,
            $crate::mask::Values::F64($v) => $body,
        }
    };
}
pub(crate) use with_values;

/// A scalar that a picture can hold.
pub(crate) trait Scalar: Copy + Send + Sync {
    /// The value as a double; 64-bit integers beyond 2⁵³ are rounded.
    fn to_f64(self) -> f64;
    /// Whether the value is that whole number, as near as [`ROUNDING`].
    fn is_label(self, label: i64) -> bool;
    /// The value as a label, where it is a whole number, as near as [`ROUNDING`].
    fn label(self) -> Option<i64>;
    /// Neither zero nor NaN.
    fn is_object(self) -> bool;
}

/// How far a label may lie from its whole number: headers that scale the stored integers leave it beside.
const ROUNDING: f64 = 0.01;

macro_rules! integer_scalar {
    ($($t:ty),*) => {$(
        impl Scalar for $t {
            fn to_f64(self) -> f64 { self as f64 }
            fn is_label(self, label: i64) -> bool { i128::from(self) == i128::from(label) }
            fn label(self) -> Option<i64> { i64::try_from(self).ok() }
            fn is_object(self) -> bool { self != 0 }
        }
    )*};
}
integer_scalar!(u8, i8, u16, i16, u32, i32, u64, i64);

macro_rules! float_scalar {
    ($($t:ty),*) => {$(
        impl Scalar for $t {
            fn to_f64(self) -> f64 { f64::from(self) }
            fn is_label(self, label: i64) -> bool { self.label() == Some(label) }
            fn label(self) -> Option<i64> {
                let x = f64::from(self);
                ((x - x.round()).abs() <= ROUNDING && x.abs() < 9e15).then_some(x.round() as i64)
            }
            fn is_object(self) -> bool { !self.is_nan() && self != 0.0 }
        }
    )*};
}
float_scalar!(f32, f64);

impl Values {
    /// Number of voxels.
    pub fn len(&self) -> usize {
        with_values!(self, v => v.len())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Value at an offset as a double. Panics outside.
    pub fn get(&self, n: usize) -> f64 {
        with_values!(self, v => v[n].to_f64())
    }

    /// All values as doubles: 8 bytes a voxel.
    pub fn to_f64(&self) -> Vec<f64> {
        with_values!(self, v => v.par_iter().map(|x| x.to_f64()).collect())
    }

    /// Smallest and largest value, NaN left out; `None` where every value is NaN.
    pub fn range(&self) -> Option<[f64; 2]> {
        let [lo, hi] = with_values!(self, v => v
            .par_iter()
            .map(|x| x.to_f64())
            .fold(|| [f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
            .reduce(|| [f64::INFINITY, f64::NEG_INFINITY], |p, q| [p[0].min(q[0]), p[1].max(q[1])]));
        (lo <= hi).then_some([lo, hi])
    }

    /// Name of the type: `uint8`, `float32`, ...
    pub fn type_name(&self) -> &'static str {
        match self {
            Values::U8(_) => "uint8",
            Values::I8(_) => "int8",
            Values::U16(_) => "uint16",
            Values::I16(_) => "int16",
            Values::U32(_) => "uint32",
            Values::I32(_) => "int32",
            Values::U64(_) => "uint64",
            Values::I64(_) => "int64",
            Values::F32(_) => "float32",
            Values::F64(_) => "float64",
        }
    }
}

/// Unit of the lengths in an image's header.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LengthUnit {
    /// 10⁻⁶ m.
    #[serde(rename = "um")]
    Micrometre,
    /// 10⁻³ m: what nearly every medical image uses.
    #[default]
    #[serde(rename = "mm")]
    Millimetre,
    /// 10⁻² m.
    #[serde(rename = "cm")]
    Centimetre,
    /// SI.
    #[serde(rename = "m")]
    Metre,
}

impl LengthUnit {
    /// Millimetres in one unit.
    pub fn millimetres(self) -> f64 {
        match self {
            LengthUnit::Micrometre => 1e-3,
            LengthUnit::Millimetre => 1.0,
            LengthUnit::Centimetre => 10.0,
            LengthUnit::Metre => 1000.0,
        }
    }

    /// The unit with this symbol: `um`, `µm`, `mm`, `cm`, `m`.
    pub fn from_symbol(s: &str) -> Option<LengthUnit> {
        match s.trim() {
            "um" | "µm" | "μm" => Some(LengthUnit::Micrometre),
            "mm" => Some(LengthUnit::Millimetre),
            "cm" => Some(LengthUnit::Centimetre),
            "m" => Some(LengthUnit::Metre),
            _ => None,
        }
    }
}

/// A picture: values on a grid in LPS millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Where the voxels lie, mm.
    pub grid: Grid,
    /// One value a voxel.
    pub values: Values,
    /// The unit that the header states for its lengths; `grid` is in millimetres already. `None`: nothing is stated, mm is taken.
    pub stated_unit: Option<LengthUnit>,
    /// What a segmentation's header calls its parts; empty where it names none.
    pub segments: Vec<Segment>,
    /// Layers of a segmentation beyond the first, which `values` holds: parts in different layers may overlap.
    pub layers: Vec<Values>,
    /// What the header leaves in doubt, and what was taken; a sentence each.
    pub doubts: Vec<String>,
}

/// A named part of a segmentation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segment {
    /// Its name.
    pub name: String,
    /// The value of its voxels.
    pub label: i64,
    /// The layer that holds them, from 0.
    pub layer: usize,
}

impl Image {
    /// A picture without names.
    pub fn new(grid: Grid, values: Values, stated_unit: Option<LengthUnit>) -> Image {
        Image { grid, values, stated_unit, segments: Vec::new(), layers: Vec::new(), doubts: Vec::new() }
    }

    /// The values of a layer, from 0; `None` where the file lacks it.
    pub fn layer(&self, n: usize) -> Option<&Values> {
        if n == 0 { Some(&self.values) } else { self.layers.get(n - 1) }
    }

    /// The same picture with the header's numbers read in `unit`, whatever the header itself states.
    #[must_use]
    pub fn with_unit(mut self, unit: LengthUnit) -> Image {
        let factor = unit.millimetres() / self.stated_unit.unwrap_or_default().millimetres();
        if factor != 1.0 {
            self.grid = self.grid.scaled(factor);
        }
        self.stated_unit = Some(unit);
        self
    }
}
