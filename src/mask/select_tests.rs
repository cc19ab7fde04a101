use nalgebra::Matrix3;

use super::*;
use crate::geometry::Point;
use crate::mask::{Grid, LengthUnit, Segment, Values};

fn image(values: Values) -> Image {
    let n = values.len();
    let grid = Grid::new([n, 1, 1], [0.5; 3], Point::new(1.0, 2.0, 3.0), Matrix3::identity()).expect("grid");
    Image::new(grid, values, None)
}

fn numbers(labels: &[i64]) -> Selection {
    Selection::Label(labels.iter().map(|&l| LabelKey::Number(l)).collect())
}

fn names(names: &[&str]) -> Selection {
    Selection::Label(names.iter().map(|n| LabelKey::Name((*n).into())).collect())
}

fn refused(image: &Image, selection: &Selection, words: &[&str]) {
    let e = select(image, selection).expect_err("refused").to_string();
    words.iter().for_each(|w| assert!(e.contains(w), "`{w}` is missing in: {e}"));
}

#[test]
fn masks_labels_and_thresholds_pick_their_voxels() {
    let labelled = image(Values::I16(vec![0, 1, 2, 4, -3]));
    assert_eq!(select(&labelled, &numbers(&[4, 1])).unwrap().data, [0, 1, 0, 1, 0]);
    let mask = image(Values::F32(vec![0.0, 255.0, 0.0]));
    assert_eq!(select(&mask, &Selection::Mask).unwrap().data, [0, 1, 0]);
    let soft = image(Values::F32(vec![0.2, 0.5, f32::NAN, 0.9, 0.0]));
    let half = Selection::Threshold { lower: Some(0.5), upper: None };
    assert_eq!(select(&soft, &half).unwrap().data, [0, 1, 0, 1, 0]);
}

#[test]
fn labels_that_scaling_left_beside_their_numbers_are_the_numbers() {
    let scaled = image(Values::F64(vec![0.0, 1.000_015_258, 1.999_999_999_5, 0.0]));
    assert_eq!(select(&scaled, &numbers(&[2])).unwrap().data, [0, 0, 1, 0]);
    assert_eq!(select(&scaled, &numbers(&[1])).unwrap().data, [0, 1, 0, 0]);
}

#[test]
fn an_empty_choice_names_the_labels_that_are_there() {
    refused(&image(Values::U8(vec![0, 2, 4, 4])), &numbers(&[1]), &["label 1", "0, 2, 4"]);
    refused(&image(Values::U8(vec![3, 3])), &Selection::Mask, &["every voxel", "the value 3 everywhere"]);
}

#[test]
fn which_of_several_labels_is_lumen_has_to_be_said() {
    let labelled = image(Values::U8([vec![0; 40], vec![1; 12], vec![2; 9]].concat()));
    refused(&labelled, &Selection::Mask, &["1 (12 voxels), 2 (9 voxels)", "input.label=1"]);
    // Nothing says which of two values is the background.
    refused(&image(Values::I16(vec![-1000, -1000, 0])), &Selection::Mask, &["-1000 (2 voxels), 0 (1 voxels)", "input.label=0"]);
}

#[test]
fn a_label_of_interpolated_labels_is_refused() {
    let blurred = image(Values::F32(vec![0.0, 0.4, 1.0, 1.0, 1.5, 2.0, 1.3, 0.3, 0.0]));
    refused(&blurred, &numbers(&[1]), &["label 1", "nearest neighbour"]);
}

#[test]
fn segments_are_chosen_by_name_across_layers_and_never_merged_unasked() {
    let segment = |name: &str, label, layer| Segment { name: name.into(), label, layer };
    let mut two = image(Values::U8(vec![0, 1, 1, 0, 0]));
    two.layers.push(Values::U8(vec![0, 0, 1, 1, 0]));
    two.segments = vec![segment("lumen", 1, 0), segment("wall", 1, 1)];
    assert_eq!(select(&two, &names(&["lumen"])).unwrap().data, [0, 1, 1, 0, 0]);
    assert_eq!(select(&two, &names(&["wall"])).unwrap().data, [0, 0, 1, 1, 0]);
    assert_eq!(select(&two, &names(&["lumen", "wall"])).unwrap().data, [0, 1, 1, 1, 0]);
    refused(&two, &Selection::Mask, &["`lumen` (label 1, 2 voxels), `wall` (label 1, 2 voxels)", "input.label=lumen"]);
    refused(&two, &numbers(&[1]), &["1 is the label of 2 segments", "`wall`"]);
    refused(&two, &names(&["Lumen"]), &["no segment `Lumen`", "`lumen`"]);
    two.layers.clear();
    assert_eq!(select(&two, &Selection::Mask).unwrap().data, [0, 1, 1, 0, 0]);
    assert_eq!(select(&two, &numbers(&[1])).unwrap().data, [0, 1, 1, 0, 0]);
    refused(&two, &names(&["wall"]), &["no segment `wall`", "which the file lacks"]);
}

#[test]
fn the_surroundings_of_a_vessel_are_no_lumen() {
    let grid = Grid::new([12; 3], [0.5; 3], Point::origin(), Matrix3::identity()).expect("grid");
    let values = (0..grid.len()).map(|n| u8::from(!grid.voxel(n).iter().all(|i| (5..8).contains(i)))).collect();
    let image = Image::new(grid, Values::U8(values), None);
    refused(&image, &Selection::Mask, &["inverted", "98 %", "input.label=0"]);
    assert_eq!(select(&image, &numbers(&[0])).unwrap().count(), 27);
}

#[test]
fn a_unit_scales_the_grid_and_overrides_the_header() {
    let metres = image(Values::U8(vec![0, 1])).with_unit(LengthUnit::Metre);
    assert_eq!(metres.grid.spacing(), [500.0; 3]);
    assert_eq!(metres.grid.origin, Point::new(1000.0, 2000.0, 3000.0));
    assert_eq!(metres.with_unit(LengthUnit::Millimetre).grid.spacing(), [0.5; 3]);
}
