//! Which voxels of a picture are lumen.

use rayon::prelude::*;
use serde::Serialize;

use super::{Scalar, with_values};
use super::{Error, Image, Mask, Values};

/// The rule that makes a mask from a picture.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Selection {
    /// Every voxel that is neither zero nor NaN.
    #[default]
    NonZero,
    /// Every voxel whose value is one of these labels.
    Label(Vec<i64>),
    /// Every voxel from `lower` to `upper`, both included; a missing bound does not bind. NaN is background.
    Threshold {
        /// Smallest value that is lumen.
        lower: Option<f64>,
        /// Largest value that is lumen.
        upper: Option<f64>,
    },
}

impl std::fmt::Display for Selection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Selection::NonZero => write!(f, "the rule that every voxel but 0 is lumen"),
            Selection::Label(l) => write!(f, "label {}", list(l)),
            Selection::Threshold { lower, upper } => {
                let bound = |b: &Option<f64>, none: &str| b.map_or(none.to_owned(), |x| x.to_string());
                write!(f, "from {} to {}", bound(lower, "-inf"), bound(upper, "inf"))
            }
        }
    }
}

fn list(labels: &[i64]) -> String {
    labels.iter().map(i64::to_string).collect::<Vec<_>>().join(", ")
}

/// The mask of the voxels that `selection` names. One byte a voxel.
///
/// # Errors
/// [`Error::Empty`] where nothing is selected (the message says what the picture does hold),
/// [`Error::Full`] where everything is.
pub fn select(image: &Image, selection: &Selection) -> Result<Mask, Error> {
    let data: Vec<u8> = match selection {
        Selection::NonZero => with_values!(&image.values, v => pick(v, |x| x.is_object())),
        Selection::Label(labels) => {
            with_values!(&image.values, v => pick(v, |x| labels.iter().any(|&l| x.is_label(l))))
        }
        Selection::Threshold { lower, upper } => {
            let (lo, hi) = (lower.unwrap_or(f64::NEG_INFINITY), upper.unwrap_or(f64::INFINITY));
            with_values!(&image.values, v => pick(v, |x| (lo..=hi).contains(&x.to_f64())))
        }
    };
    let mask = Mask::new(image.grid.clone(), data);
    match mask.count() {
        0 => Err(Error::Empty { selection: selection.to_string(), present: contents(&image.values) }),
        n if n == mask.grid.len() => Err(Error::Full { selection: selection.to_string(), present: contents(&image.values) }),
        _ => Ok(mask),
    }
}

fn pick<T: Scalar>(values: &[T], rule: impl Fn(T) -> bool + Sync) -> Vec<u8> {
    values.par_iter().with_min_len(1 << 16).map(|&x| u8::from(rule(x))).collect()
}

/// The labels a picture holds where they are few whole numbers, else its range, in words.
fn contents(values: &Values) -> String {
    const MOST: usize = 20;
    let labels = with_values!(values, v => {
        let mut seen: Vec<i64> = Vec::new();
        let mut whole = true;
        for x in v {
            let Some(l) = x.label() else { whole = false; break };
            if let Err(at) = seen.binary_search(&l) {
                seen.insert(at, l);
                if seen.len() > MOST { whole = false; break }
            }
        }
        whole.then_some(seen)
    });
    match (labels, values.range()) {
        (Some(l), _) if l.len() == 1 => format!("the value {} everywhere", l[0]),
        (Some(l), _) => format!("the values {}", list(&l)),
        (None, Some([lo, hi])) => format!("values from {lo} to {hi}"),
        (None, None) => "no number at all (every voxel is NaN)".into(),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Point;
    use crate::mask::{Grid, LengthUnit};

    fn image(values: Values) -> Image {
        let n = values.len();
        let grid = Grid::new([n, 1, 1], [0.5; 3], Point::new(1.0, 2.0, 3.0), Matrix3::identity()).expect("grid");
        Image { grid, values, stated_unit: None }
    }

    #[test]
    fn labels_thresholds_and_non_zero_pick_their_voxels() {
        let labelled = image(Values::I16(vec![0, 1, 2, 4, -3]));
        assert_eq!(select(&labelled, &Selection::NonZero).unwrap().data, [0, 1, 1, 1, 1]);
        assert_eq!(select(&labelled, &Selection::Label(vec![4, 1])).unwrap().data, [0, 1, 0, 1, 0]);
        let soft = image(Values::F32(vec![0.2, 0.5, f32::NAN, 0.9, 0.0]));
        let half = Selection::Threshold { lower: Some(0.5), upper: None };
        assert_eq!(select(&soft, &half).unwrap().data, [0, 1, 0, 1, 0]);
        assert_eq!(select(&soft, &Selection::NonZero).unwrap().data, [1, 1, 0, 1, 0]);
    }

    #[test]
    fn an_empty_choice_names_the_labels_that_are_there() {
        let e = select(&image(Values::U8(vec![0, 2, 4, 4])), &Selection::Label(vec![1])).unwrap_err().to_string();
        assert!(e.contains("label 1") && e.contains("0, 2, 4"), "{e}");
        let e = select(&image(Values::U8(vec![3, 3])), &Selection::NonZero).unwrap_err().to_string();
        assert!(e.contains("every voxel") && e.contains("the value 3 everywhere"), "{e}");
    }

    #[test]
    fn a_unit_scales_the_grid_and_overrides_the_header() {
        let metres = image(Values::U8(vec![0, 1])).with_unit(LengthUnit::Metre);
        assert_eq!(metres.grid.spacing(), [500.0; 3]);
        assert_eq!(metres.grid.origin, Point::new(1000.0, 2000.0, 3000.0));
        assert_eq!(metres.with_unit(LengthUnit::Millimetre).grid.spacing(), [0.5; 3]);
    }
}
