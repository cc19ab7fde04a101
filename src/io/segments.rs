//! The parts that 3D Slicer names in the header of a `.seg.nrrd` file, and the layers that hold them.

use std::collections::BTreeMap;

use crate::mask::{Segment, Values, with_values};

/// The segments of `Segment0_Name:=lumen` and the like, in their order.
///
/// Older files have a layer for each segment and neither number of layer nor value: then it is the segment's own, and 1.
pub(super) fn named(pairs: &BTreeMap<String, String>) -> Vec<Segment> {
    let number = |key: &str| pairs.get(key).and_then(|v| v.trim().parse::<i64>().ok());
    (0..)
        .map(|n| (n, format!("Segment{n}_")))
        .take_while(|(_, prefix)| pairs.keys().any(|k| k.starts_with(prefix.as_str())))
        .map(|(n, prefix)| {
            let get = |key: &str| pairs.get(&format!("{prefix}{key}"));
            let name = get("Name").or_else(|| get("ID")).map_or_else(|| format!("Segment_{n}"), |s| s.trim().to_owned());
            let layer = number(&format!("{prefix}Layer")).and_then(|l| usize::try_from(l).ok()).unwrap_or(n);
            Segment { name, label: number(&format!("{prefix}LabelValue")).unwrap_or(1), layer }
        })
        .collect()
}

/// The layers of values among which an axis of `count` layers stands; `stride` voxels run faster than it.
pub(super) fn layers(values: Values, count: usize, stride: usize) -> Vec<Values> {
    if count == 1 {
        return vec![values];
    }
    macro_rules! split {
        ($($variant:ident),*) => {
            match values {
                $(Values::$variant(v) => (0..count)
                    .map(|n| Values::$variant(v.chunks(stride * count).flat_map(|c| &c[n * stride..(n + 1) * stride]).copied().collect()))
                    .collect(),)*
            }
        };
    }
    debug_assert!(with_values!(&values, v => v.len() % (stride * count) == 0));
    split!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64)
}
