//! The direction of a vessel near its end, from the middles of its sections.
//!
//! A centerline turns aside within a radius of a blunt tip, towards the farthest corner. The middle of a section does
//! not: in a straight vessel it lies on the axis whatever the plane's tilt, so that a line through the middles of a few
//! sections gives the axis even where the first guess is far off.

use crate::geometry::{Plane, Point, Vector};

/// Sections to either side reach this many radii inwards and towards the tip.
const WINDOW: [f64; 2] = [1.0, 0.5];
/// And at least this many voxels.
const VOXELS: f64 = 2.5;
/// Passes: each takes its sections square to the direction of the one before.
const PASSES: usize = 4;

/// The axis through the vessel at `p`, whose first guess is `outward`: a point on it in the plane of `p`, and its unit
/// direction towards the tip. `inwards` bounds the look away from the tip, mm; `cross` gives middle and area of the
/// section by a plane, where that section may be used. The first guess where fewer than three sections can be.
pub(super) fn axis(
    p: &Point,
    outward: &Vector,
    radius: f64,
    spacing: [f64; 3],
    inwards: f64,
    cross: impl Fn(&Plane) -> Option<(Point, f64)>,
) -> (Point, Vector) {
    let voxel = spacing.into_iter().fold(f64::INFINITY, f64::min);
    let coarse = spacing.into_iter().fold(0.0, f64::max);
    let back = (WINDOW[0] * radius).max(VOXELS * coarse).min(inwards.max(0.5 * radius));
    let ahead = (WINDOW[1] * radius).max(VOXELS * coarse).min(back);
    let step = (0.2 * radius).max(0.5 * voxel);
    let (mut middle, mut direction) = (*p, *outward);
    for _ in 0..PASSES {
        let mut found: Vec<(f64, Point, f64)> = Vec::new();
        let steps = |reach: f64| (reach / step).floor() as i64;
        for i in -steps(back)..=steps(ahead) {
            let h = i as f64 * step;
            let Some(plane) = Plane::new(middle + direction * h, direction) else { continue };
            if let Some((center, area)) = cross(&plane) {
                found.push((h, center, area));
            }
        }
        let mut areas: Vec<f64> = found.iter().map(|f| f.2).collect();
        areas.sort_by(f64::total_cmp);
        let Some(&usual) = areas.get(areas.len() / 2) else { break };
        // Sections through the tip are cut short, those near a junction are wide: both have their middles elsewhere.
        found.retain(|f| f.2 > 0.9 * usual && f.2 < 1.3 * usual);
        if found.len() < 3 {
            break;
        }
        let weight = |h: f64| 1.0 - (if h < 0.0 { -h / back } else { h / ahead }) * 0.9;
        let total: f64 = found.iter().map(|f| weight(f.0)).sum();
        let mean_h = found.iter().map(|f| weight(f.0) * f.0).sum::<f64>() / total;
        let mean = found.iter().map(|f| f.1.coords * weight(f.0)).sum::<Vector>() / total;
        let spread: f64 = found.iter().map(|f| weight(f.0) * (f.0 - mean_h).powi(2)).sum();
        let slope = found.iter().map(|f| (f.1.coords - mean) * (weight(f.0) * (f.0 - mean_h))).sum::<Vector>() / spread.max(1e-12);
        let Some(turned) = slope.try_normalize(1e-9) else { break };
        // A turn by more than 75 degrees is no correction of the same end.
        if turned.dot(outward) < 0.26 {
            break;
        }
        let change = turned.dot(&direction);
        middle = Point::from(mean - slope * mean_h);
        direction = turned;
        if change > 0.9998 {
            break;
        }
    }
    (middle, direction)
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::mask::{Grid, Mask};
    use crate::openings::section::section;

    #[test]
    fn the_axis_of_a_slanted_tube_is_found_from_a_guess_forty_degrees_off() {
        let grid = Grid::new([40, 40, 20], [0.5, 0.5, 1.0], Point::origin(), Matrix3::identity()).unwrap();
        let axis_direction = Vector::new(0.3, 0.2, 1.0).normalize();
        let center = Point::new(10.0, 10.0, 10.0);
        let data = (0..grid.len())
            .map(|n| {
                let d = grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64))) - center;
                let along = d.dot(&axis_direction);
                // Cut off square, one radius beyond the middle.
                u8::from((d - axis_direction * along).norm() < 2.5 && along < 2.5)
            })
            .collect();
        let mask = Mask::new(grid, data);
        let guess = Vector::new(-0.4, 0.3, 0.8).normalize();
        assert!(guess.angle(&axis_direction).to_degrees() > 40.0);
        let (p, d) = axis(&center, &guess, 2.5, [0.5, 0.5, 1.0], 9.0, |q| section(&mask, q, 8.5).filter(|s| !s.clipped).map(|s| (s.center, s.area)));
        assert!(d.angle(&axis_direction).to_degrees() < 3.0, "{}", d.angle(&axis_direction).to_degrees());
        let off = p - center;
        assert!((off - axis_direction * off.dot(&axis_direction)).norm() < 0.15, "{off}");
    }
}
