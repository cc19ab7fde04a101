//! Which voxels of a picture are lumen.

use rayon::prelude::*;
use serde::Serialize;

use super::content::{Content, content, distinct};
use super::{Error, Image, Mask};
use super::{Scalar, with_values};

/// The rule that makes a mask from a picture.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// The picture is a mask: background 0 and one other value. Of a soft mask, what lies above the half-way value.
    #[default]
    Mask,
    /// Every voxel of these labels or segments.
    Label(Vec<LabelKey>),
    /// Every voxel from `lower` to `upper`, both included; a missing bound does not bind. NaN is background.
    Threshold {
        /// Smallest value that is lumen.
        lower: Option<f64>,
        /// Largest value that is lumen.
        upper: Option<f64>,
    },
}

/// A label by its number, or a segment by its name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum LabelKey {
    /// The value of its voxels.
    Number(i64),
    /// The name in the file's header.
    Name(String),
}

impl std::fmt::Display for LabelKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            LabelKey::Number(n) => write!(f, "{n}"),
            LabelKey::Name(name) => write!(f, "`{name}`"),
        }
    }
}

impl std::fmt::Display for Selection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Selection::Mask => write!(f, "the rule that every voxel but 0 is lumen"),
            Selection::Label(l) => write!(f, "label {}", list(l)),
            Selection::Threshold { lower, upper } => {
                let bound = |b: &Option<f64>, none: &str| b.map_or(none.to_owned(), |x| x.to_string());
                write!(f, "from {} to {}", bound(lower, "-inf"), bound(upper, "inf"))
            }
        }
    }
}

fn list<T: ToString>(all: &[T]) -> String {
    all.iter().map(T::to_string).collect::<Vec<_>>().join(", ")
}

/// The mask of the voxels that `selection` names. One byte a voxel.
///
/// # Errors
/// [`Error::Empty`] where nothing is selected (the message says what the picture does hold), [`Error::Full`] where
/// everything is; without a label or threshold [`Error::Labels`] and [`Error::Grey`] where the picture is no mask;
/// [`Error::Segment`] for a segment that there is not, [`Error::Blurred`] for a label of an interpolated picture.
pub fn select(image: &Image, selection: &Selection) -> Result<Mask, Error> {
    let empty = || Error::Empty { selection: selection.to_string(), present: contents(image) };
    let data: Vec<u8> = match selection {
        Selection::Mask if !image.segments.is_empty() => {
            // Where one segment alone has voxels it is the lumen; two are never merged unasked.
            let filled: Vec<Part> = parts(image).into_iter().filter(|p| p.voxels > 0).collect();
            match filled.as_slice() {
                [] => return Err(empty()),
                [one] => painted(image, &[(one.layer, one.label)]),
                _ => return Err(Error::Labels { present: inventory(image), example: example(&filled) }),
            }
        }
        Selection::Mask => match content(image) {
            Content::Mask => with_values!(&image.values, v => pick(v, |x| x.is_object())),
            Content::Uniform => with_values!(&image.values, v => pick(v, |x| x.is_object())),
            Content::Soft { low, high, .. } => with_values!(&image.values, v => pick(v, |x| x.to_f64() >= 0.5 * (low + high))),
            Content::Labels => return Err(Error::Labels { present: inventory(image), example: example(&parts(image)) }),
            Content::Grey => return Err(Error::Grey { present: contents(image) }),
        },
        Selection::Label(keys) => {
            let data = painted(image, &wanted(image, keys)?);
            if let Some(share) = blurred(image, &data) {
                return Err(Error::Blurred { selection: selection.to_string(), percent: 100.0 * share });
            }
            data
        }
        Selection::Threshold { lower, upper } => {
            let (lo, hi) = (lower.unwrap_or(f64::NEG_INFINITY), upper.unwrap_or(f64::INFINITY));
            with_values!(&image.values, v => pick(v, |x| (lo..=hi).contains(&x.to_f64())))
        }
    };
    let mask = Mask::new(image.grid.clone(), data);
    match mask.count() {
        0 => Err(empty()),
        n if n == mask.grid.len() => Err(Error::Full { selection: selection.to_string(), present: contents(image) }),
        n if inverted(&mask) => {
            let percent = 100.0 * n as f64 / mask.grid.len() as f64;
            Err(Error::Inverted { percent, selection: selection.to_string(), present: contents(image) })
        }
        _ => Ok(mask),
    }
}

/// Part of the picture's border that the lumen covers where it is the background instead.
const BACKGROUND_BORDER: f64 = 0.9;

/// Whether the selected voxels are the vessel's surroundings: nearly all of the border, and most of the picture.
fn inverted(mask: &Mask) -> bool {
    let dims = mask.grid.dims;
    // In a picture of a slice or two every voxel is on the border.
    if dims.iter().any(|&n| n < 3) || 2 * mask.count() < mask.grid.len() {
        return false;
    }
    let on_border = |n: &usize| mask.grid.voxel(*n).iter().zip(dims).any(|(&i, n)| i == 0 || i + 1 == n);
    let [border, lumen] = (0..mask.grid.len())
        .into_par_iter()
        .filter(on_border)
        .map(|n| [1, usize::from(mask.data[n])])
        .reduce(|| [0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
    lumen as f64 > BACKGROUND_BORDER * border as f64
}

fn pick<T: Scalar>(values: &[T], rule: impl Fn(T) -> bool + Sync) -> Vec<u8> {
    values.par_iter().map(|&x| u8::from(rule(x))).collect()
}

/// The voxels of all these values, each in its layer.
fn painted(image: &Image, wanted: &[(usize, i64)]) -> Vec<u8> {
    let mut data = vec![0; image.values.len()];
    for layer in 0..=image.layers.len() {
        let labels: Vec<i64> = wanted.iter().filter(|w| w.0 == layer).map(|w| w.1).collect();
        let Some(values) = image.layer(layer).filter(|_| !labels.is_empty()) else { continue };
        let own = with_values!(values, v => pick(v, |x| labels.iter().any(|&l| x.is_label(l))));
        data.par_iter_mut().zip(own).for_each(|(d, v)| *d |= v);
    }
    data
}

/// Layer and value of each label that is asked for.
fn wanted(image: &Image, keys: &[LabelKey]) -> Result<Vec<(usize, i64)>, Error> {
    let mut all = Vec::new();
    for key in keys {
        let named: Vec<_> = image
            .segments
            .iter()
            .filter(|s| match key {
                LabelKey::Number(n) => s.label == *n && image.layer(s.layer).is_some(),
                LabelKey::Name(name) => s.name == *name,
            })
            .collect();
        match (named.as_slice(), key) {
            ([one], _) if image.layer(one.layer).is_some() => all.push((one.layer, one.label)),
            ([], LabelKey::Number(n)) => all.extend((0..=image.layers.len()).map(|layer| (layer, *n))),
            (several, _) => {
                let what = if several.len() > 1 { format!("{key} is the label of {} segments", several.len()) } else { format!("there is no segment {key}") };
                return Err(Error::Segment { what, present: contents(image) });
            }
        }
    }
    Ok(all)
}

/// Share of the voxels around the selected ones that hold values between labels, where that is much: labels were
/// interpolated, and a label alone is its inner part.
fn blurred(image: &Image, data: &[u8]) -> Option<f64> {
    const MUCH: f64 = 0.2;
    let [nx, ny, _] = image.grid.dims;
    // Whole values too are between labels where the picture is a soft mask.
    if image.segments.is_empty() && matches!(content(image), Content::Soft { .. }) {
        return Some(1.0);
    }
    let whole = with_values!(&image.values, v => v.par_iter().all(|x| x.label().is_some()));
    if whole {
        return None;
    }
    let between = |n: usize| with_values!(&image.values, v => v[n].label().is_none() && !v[n].to_f64().is_nan());
    let [outside, soft] = (0..data.len())
        .into_par_iter()
        .flat_map_iter(|n| [(0, 1), (1, nx), (2, nx * ny)].map(|(a, step)| (n, a, n + step)))
        .filter(|&(n, a, m)| image.grid.voxel(n)[a] + 1 < image.grid.dims[a] && data[n] != data[m])
        .map(|(n, _, m)| [1, usize::from(between(if data[n] == 0 { n } else { m }))])
        .reduce(|| [0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
    let share = soft as f64 / outside.max(1) as f64;
    (share > MUCH).then_some(share)
}

/// A value of a picture, its name where it has one, and its voxels.
struct Part {
    name: Option<String>,
    layer: usize,
    label: i64,
    voxels: usize,
}

/// The parts of a picture of labels, 0 left out; nothing where the values are no labels.
fn parts(image: &Image) -> Vec<Part> {
    let mut all = Vec::new();
    for layer in 0..=image.layers.len() {
        let Some(values) = image.layer(layer) else { continue };
        let found = with_values!(values, v => distinct(v, 256)).unwrap_or_default();
        let label = |v: f64| (v.fract() == 0.0).then_some(v as i64);
        let background = if image.segments.is_empty() && found.first().is_some_and(|f| f.0 < 0.0) { None } else { Some(0) };
        for (label, voxels) in found.iter().filter_map(|&(v, n)| Some((label(v)?, n))).filter(|(l, _)| Some(*l) != background) {
            let name = image.segments.iter().find(|s| (s.layer, s.label) == (layer, label)).map(|s| s.name.clone());
            all.push(Part { name, layer, label, voxels });
        }
    }
    for s in &image.segments {
        if !all.iter().any(|p| (p.layer, p.label) == (s.layer, s.label)) {
            all.push(Part { name: Some(s.name.clone()), layer: s.layer, label: s.label, voxels: 0 });
        }
    }
    all
}

/// How the largest part is chosen; beside negative values the largest is the background.
fn example(parts: &[Part]) -> String {
    let mut by_size: Vec<&Part> = parts.iter().collect();
    by_size.sort_by_key(|p| std::cmp::Reverse(p.voxels));
    let background = usize::from(parts.len() > 1 && parts.iter().any(|p| p.label < 0));
    match by_size.get(background) {
        Some(Part { name: Some(name), .. }) => format!("input.label={name}"),
        Some(p) => format!("input.label={}", p.label),
        None => "input.label=1".into(),
    }
}

/// Most labels that a sentence lists; the largest are named.
const LISTED: usize = 20;

/// What a picture holds, with voxel counts: `1 (3123 voxels), 2 (1259 voxels)`, names of segments, or its range.
pub fn inventory(image: &Image) -> String {
    let mut parts = parts(image);
    if parts.is_empty() {
        return contents(image);
    }
    let rest = parts.len().saturating_sub(LISTED);
    if rest > 0 {
        parts.sort_by_key(|p| std::cmp::Reverse(p.voxels));
        parts.truncate(LISTED);
    }
    let word = |p: &Part| match &p.name {
        Some(name) if p.layer > image.layers.len() => format!("`{name}` (label {}, layer {}, which the file lacks)", p.label, p.layer),
        Some(name) => format!("`{name}` (label {}, {} voxels)", p.label, p.voxels),
        None => format!("{} ({} voxels)", p.label, p.voxels),
    };
    let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    parts.iter().map(word).collect::<Vec<_>>().join(", ") + &more
}

/// The labels a picture holds where they are few whole numbers, else its range, in words.
fn contents(image: &Image) -> String {
    if !image.segments.is_empty() {
        return format!("the segments {}", inventory(image));
    }
    let found = with_values!(&image.values, v => distinct(v, LISTED)).filter(|all| all.iter().all(|(v, _)| v.fract() == 0.0));
    let values = |all: &[(f64, usize)]| all.iter().map(|(v, _)| v.to_string()).collect::<Vec<_>>().join(", ");
    match (found, image.values.range()) {
        (Some(l), _) if l.len() == 1 => format!("the value {} everywhere", l[0].0),
        (Some(l), _) if !l.is_empty() => format!("the values {}", values(&l)),
        (_, Some([lo, hi])) => format!("values from {lo} to {hi}"),
        (_, None) => "no number at all (every voxel is NaN)".into(),
    }
}

#[cfg(test)]
#[path = "select_tests.rs"]
mod tests;
