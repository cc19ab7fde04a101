use nalgebra::Matrix3;

use super::*;
use crate::geometry::{Point, Vector};
use crate::mask::{Grid, Values};

/// Deterministic noise from -1 to 1.
fn noise(n: usize) -> f64 {
    let mut x = (n as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x ^= x >> 31;
    x = x.wrapping_mul(0xD6E8_FEB8_6659_FD93);
    x ^= x >> 32;
    (x >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Values by the distance to a slanted tube's wall in voxels, negative inside, and the voxel's number.
fn tube(value: impl Fn(f64, usize) -> f64) -> Image {
    let grid = Grid::new([30, 26, 34], [1.0; 3], Point::origin(), Matrix3::identity()).expect("grid");
    let axis = Vector::new(0.2, 0.1, 1.0).normalize();
    let values = (0..grid.len()).map(|n| {
        let x = Vector::from(grid.voxel(n).map(|i| i as f64)) - Vector::new(12.0, 12.0, 17.0);
        value((x - axis * x.dot(&axis)).norm() - 5.0, n)
    });
    let values = Values::F32(values.map(|v| v as f32).collect());
    Image::new(grid, values, None)
}

fn ramp(distance: f64, width: f64) -> f64 {
    1.0 / (1.0 + (4.0 * distance / width).exp())
}

#[test]
fn a_mask_has_a_background_of_zero_and_one_value() {
    assert_eq!(content(&tube(|d, _| f64::from(d < 0.0))), Content::Mask);
    assert_eq!(content(&tube(|d, _| if d < 0.0 { 0.7 } else { 0.0 })), Content::Mask);
    assert_eq!(content(&tube(|d, _| if d < 0.0 { 7.0 } else { f64::NAN })), Content::Mask);
    assert_eq!(content(&tube(|d, _| if d < 0.0 { 0.0 } else { -1000.0 })), Content::Labels);
    assert_eq!(content(&tube(|_, _| 4.0)), Content::Uniform);
}

#[test]
fn values_between_two_levels_along_the_boundary_are_a_soft_mask() {
    let half = |image: &Image| match content(image) {
        Content::Soft { low, high, .. } => 0.5 * (low + high),
        other => panic!("{other:?}"),
    };
    for width in [1.0, 2.0, 3.0] {
        assert!((half(&tube(|d, _| ramp(d, width))) - 0.5).abs() < 0.03, "{width}");
        assert!((half(&tube(|d, _| (255.0 * ramp(d, width)).round())) - 127.5).abs() < 8.0, "{width}");
    }
    // An interpolation that overshoots.
    let sharp = |d: f64, _| ramp(d, 1.5) + 0.1 * (-d * d / 4.0).exp() * -d.signum() * (d.abs() / 2.0).min(1.0);
    assert!((half(&tube(sharp)) - 0.5).abs() < 0.05);
}

#[test]
fn whole_values_in_regions_are_labels() {
    assert_eq!(content(&tube(|d, _| if d < -2.0 { 2.0 } else { f64::from(d < 0.0) })), Content::Labels);
    // A wall of one voxel lies between background and lumen, and is a label all the same.
    assert_eq!(content(&tube(|d, _| if d < -1.0 { 2.0 } else { f64::from(d < 0.0) })), Content::Labels);
    let many = |d: f64, n: usize| if d < 0.0 { (1 + n / (30 * 26 * 3)) as f64 + 1.5e-5 } else { 0.0 };
    assert_eq!(content(&tube(many)), Content::Labels);
}

#[test]
fn anything_else_is_a_grey_image() {
    let ct = |d: f64, n: usize| (40.0 + 300.0 * ramp(d, 1.5) + 25.0 * noise(n)).round();
    assert_eq!(content(&tube(ct)), Content::Grey);
    // Grey values of the lumen alone.
    assert_eq!(content(&tube(|d, n| if d < 0.0 { (350.0 + 60.0 * noise(n)).round() } else { -1024.0 })), Content::Grey);
    assert_eq!(content(&tube(|d, n| if d < 0.0 { (400.0 + 90.0 * noise(n)).round() } else { 0.0 })), Content::Grey);
    // A level set.
    assert_eq!(content(&tube(|d, _| d)), Content::Grey);
    assert_eq!(content(&tube(|_, n| (4.0 + 4.0 * noise(n)).round())), Content::Grey);
}
