//! What the openings take off the vessel, voxel by voxel.

use super::ExtendError;
use super::tube::Tube;
use crate::geometry::{Point, Vector};
use crate::mask::Mask;

/// Where a voxel stands to the extended openings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// Far from lumen.
    Background,
    /// Vessel that stays.
    Kept,
    /// Vessel beyond the opening of this tube.
    Removed(u16),
    /// Vessel at the opening of this tube: the plane decides.
    Slab(u16),
}

/// All lumen stays.
pub(super) fn fresh(mask: &Mask) -> Vec<Mark> {
    mask.data.iter().map(|&v| if v == 0 { Mark::Background } else { Mark::Kept }).collect()
}

fn neighbours(mask: &Mask, n: usize) -> impl Iterator<Item = usize> {
    let [i, j, k] = mask.grid.voxel(n).map(|c| c as i64);
    (0..27).filter(|&d| d != 13).filter_map(move |d| mask.grid.linear(i + d % 3 - 1, j + d / 3 % 3 - 1, k + d / 9 - 1))
}

fn position(mask: &Mask, n: usize) -> Point {
    mask.grid.to_world(Vector::from(mask.grid.voxel(n).map(|c| c as f64)))
}

/// Marks the lumen at and beyond a tube's plane: that which hangs together with the section, and no other vessel.
pub(super) fn take_off(mask: &Mask, tube: &Tube, number: usize, marks: &mut [Mark]) -> Result<(), ExtendError> {
    let diagonal = mask.grid.voxel_diagonal();
    let number = number as u16;
    let height = |p: &Point| tube.plane.signed_distance(p);
    let from_axis = |p: &Point| (tube.plane.project(p) - tube.plane.origin).norm();
    // As far as the vessel goes over into the outline, and three voxels at least.
    let thick = (2.5 * diagonal).max(tube.lead + 1.5 * diagonal);
    let in_slab = |p: &Point| height(p).abs() <= thick && from_axis(p) <= 2.0 * tube.reach + diagonal;
    let mut stack: Vec<usize> = (0..marks.len())
        .filter(|&n| marks[n] == Mark::Kept)
        .filter(|&n| {
            let p = position(mask, n);
            height(&p).abs() <= 0.6 * diagonal && tube.in_section(&p)
        })
        .collect();
    let mut slab = stack.clone();
    stack.iter().for_each(|&n| marks[n] = Mark::Slab(number));
    while let Some(n) = stack.pop() {
        for m in neighbours(mask, n) {
            if marks[m] == Mark::Kept && in_slab(&position(mask, m)) {
                marks[m] = Mark::Slab(number);
                slab.push(m);
                stack.push(m);
            }
        }
    }
    let mut stack: Vec<usize> = slab.into_iter().filter(|&n| height(&position(mask, n)) >= 0.0).collect();
    let mut came_round = false;
    while let Some(n) = stack.pop() {
        let leaving = marks[n] == Mark::Slab(number);
        for m in neighbours(mask, n) {
            if marks[m] != Mark::Kept {
                continue;
            }
            let p = position(mask, m);
            if leaving && height(&p) < 0.0 {
                continue;
            }
            marks[m] = Mark::Removed(number);
            came_round |= from_axis(&p) < tube.reach && (-thick - 1.5 * diagonal..-thick).contains(&height(&p));
            stack.push(m);
        }
    }
    if came_round {
        return Err(ExtendError::Ring { name: tube.name.clone(), center: tube.plane.origin.into() });
    }
    Ok(())
}

/// Carries the marks three voxels out into the background: each voxel has the mark of lumen nearest to it.
pub(super) fn widen(mask: &Mask, mut marks: Vec<Mark>) -> Vec<Mark> {
    let mut front: Vec<usize> = (0..marks.len()).filter(|&n| marks[n] != Mark::Background).collect();
    for _ in 0..3 {
        let mut next = Vec::new();
        for &n in &front {
            for m in neighbours(mask, n) {
                if marks[m] == Mark::Background {
                    marks[m] = marks[n];
                    next.push(m);
                }
            }
        }
        front = next;
    }
    marks
}
