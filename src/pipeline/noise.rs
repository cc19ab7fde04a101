//! Voxels that the fit takes for noise are relabelled, so that nothing after it runs after them: centerlines, ends, and the
//! boundary that the surface is held against.

use serde::Serialize;

use crate::geometry::{Point, Vector};
use crate::implicit::Implicit;
use crate::implicit::smooth::SmoothOptions;
use crate::mask::neighborhood::STEPS_6;
use crate::mask::{self, Mask, Topology};
use crate::openings::Evidence;

/// Places that the report lists.
const PLACES: usize = 10;

/// Voxels taken for noise, as the report has them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PassedOver {
    /// Lumen taken for background.
    pub removed: usize,
    /// Background taken for lumen.
    pub added: usize,
    /// Where, at most ten places spread over all, LPS mm.
    pub places: Vec<[f64; 3]>,
}

/// A voxel's middle and what it is now.
pub(super) type Relabelled = (Point, u8);

/// A component cropped, with a margin of four voxels, and carried on by `pad` voxels where it leaves the image; of a noisy one the
/// layers at the image's border are rid of noise first, which would be carried on with them.
pub(super) fn padded(component: &Mask, evidence: &Evidence, pad: usize) -> (Mask, Vec<Relabelled>) {
    let mask = evidence.carried_on(component, 4, pad);
    let continued = mask.count() > component.count();
    if !continued || mask::noise::estimate(&mask, &mask::interface(&mask)) == 0.0 {
        return (mask, Vec::new());
    }
    let (quiet, changed) = mask::noise::quiet_border(component);
    let quieted = evidence.carried_on(&quiet, 4, pad);
    if mask::topology(&quieted) != mask::topology(&mask) {
        return (mask, Vec::new());
    }
    let told = |&n: &usize| (quiet.grid.to_world(Vector::from(quiet.grid.voxel(n).map(|c| c as f64))), quiet.data[n]);
    (quieted, changed.iter().map(told).collect())
}

/// The mask without the voxels that lie on the wrong side of `wall`, and what was relabelled. All stays where the topology would
/// not be `wanted`.
pub(super) fn relabel(mask: Mask, wall: &dyn Implicit, wanted: &Topology) -> (Mask, Vec<Relabelled>) {
    let smallest = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    // What the fit calls given up, then all on the wrong side.
    for beyond in [SmoothOptions::default().refine_beyond * smallest, 0.0] {
        let (clean, changed) = on_their_side(&mask, wall, beyond);
        if mask::topology(&clean) == *wanted {
            return (clean, changed);
        }
    }
    (mask, Vec::new())
}

/// Relabels from the boundary on, as far as voxels contradict the wall by more than `beyond` mm.
fn on_their_side(mask: &Mask, wall: &dyn Implicit, beyond: f64) -> (Mask, Vec<Relabelled>) {
    let mut clean = mask.clone();
    let mut looked_at = vec![false; mask.data.len()];
    let faces = |n: usize| {
        let [i, j, k] = mask.grid.voxel(n).map(|c| c as i64);
        STEPS_6.into_iter().filter_map(move |d| mask.grid.linear(i + d[0], j + d[1], k + d[2]))
    };
    let mut stack: Vec<usize> = (0..mask.data.len()).filter(|&n| faces(n).any(|m| mask.data[m] != mask.data[n])).collect();
    let mut changed = Vec::new();
    while let Some(n) = stack.pop() {
        if std::mem::replace(&mut looked_at[n], true) {
            continue;
        }
        let p = mask.grid.to_world(Vector::from(mask.grid.voxel(n).map(|c| c as f64)));
        let value = wall.value(&p);
        if value.abs() > beyond && (value < 0.0) != (mask.data[n] != 0) {
            clean.data[n] = u8::from(value < 0.0);
            changed.push((p, clean.data[n]));
            stack.extend(faces(n).filter(|&m| !looked_at[m]));
        }
    }
    changed.sort_by(|a, b| a.0.coords.as_slice().partial_cmp(b.0.coords.as_slice()).unwrap_or(std::cmp::Ordering::Equal));
    (clean, changed)
}

/// Takes what was relabelled in a component over into the mask of all.
pub(super) fn carry_over(mask: &mut Mask, changed: &[Relabelled]) {
    for (p, label) in changed {
        let [i, j, k]: [i64; 3] = mask.grid.to_index(p).map(|x| x.round() as i64).into();
        // A component's mask goes on beyond the picture.
        if let Some(n) = mask.grid.linear(i, j, k) {
            mask.data[n] = *label;
        }
    }
}

/// The report's entry.
pub(super) fn entry(changed: &[Relabelled]) -> PassedOver {
    let removed = changed.iter().filter(|c| c.1 == 0).count();
    let step = changed.len().div_ceil(PLACES).max(1);
    PassedOver { removed, added: changed.len() - removed, places: changed.iter().step_by(step).map(|c| c.0.into()).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;
    use crate::mask::Grid;
    use nalgebra::Matrix3;

    struct Ball;

    impl Implicit for Ball {
        fn value(&self, p: &Point) -> f64 {
            p.coords.norm() - 5.0
        }
        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            (self.value(p), p.coords.normalize())
        }
        fn bounds(&self) -> Aabb {
            Aabb { min: Point::new(-5.0, -5.0, -5.0), max: Point::new(5.0, 5.0, 5.0) }
        }
        fn resolution(&self) -> f64 {
            0.5
        }
    }

    #[test]
    fn bumps_and_dents_that_the_wall_passes_over_go_and_are_told() {
        let grid = Grid::new([16; 3], [1.0; 3], Point::new(-7.5, -7.5, -7.5), Matrix3::identity()).expect("grid");
        let inside = |n: usize| u8::from(Ball.value(&grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64)))) < 0.0);
        let exact = Mask::new(grid.clone(), (0..grid.len()).map(inside).collect());
        let mut noisy = exact.clone();
        for v in [[13, 8, 8], [14, 8, 8], [3, 8, 8], [8, 12, 8]] {
            let n = grid.linear(v[0], v[1], v[2]).expect("a voxel");
            noisy.data[n] = 1 - noisy.data[n];
        }
        let wanted = mask::topology(&exact);
        let (clean, changed) = relabel(noisy, &Ball, &wanted);
        assert_eq!(clean, exact);
        let told = entry(&changed);
        assert_eq!((told.removed, told.added, told.places.len()), (2, 2, 4), "{told:?}");
        let mut whole = Mask::new(grid.clone(), vec![0; grid.len()]);
        carry_over(&mut whole, &changed);
        assert_eq!(whole.count(), 2);
    }
}
