//! Sections that more than one branch runs out through: next to a bifurcation a plane may cut both of its branches.
//!
//! A cut there would take the other branch off too. Where that one ends right behind the plane as well, one opening
//! serves both ends, the larger section's; where it goes on, the end stays closed rather than another vessel lost.

use super::detect::BlindReason;
use super::section::Section;
use crate::centerline::{Centerlines, EndKind};
use crate::geometry::{Plane, Point};

/// A found end, as far as others matter to it.
#[derive(Debug, Clone)]
pub(super) struct Ending {
    /// Its branch.
    pub branch: usize,
    /// Where its centerline ends.
    pub tip: Point,
    /// Where it is cut.
    pub plane: Plane,
    /// Radius at the plane.
    pub radius: f64,
    /// Area of the section.
    pub area: f64,
    /// Other branches that run out through the section.
    pub others: Vec<usize>,
    /// Whether one of them goes on beyond it.
    pub takes_off: bool,
}

/// A tip within this many radii of the plane's origin goes with the cut.
const NEAR: f64 = 4.0;

/// Branches other than `branch` that cross the plane outwards within the section.
pub(super) fn others(lines: &Centerlines, branch: usize, plane: &Plane, section: &Section) -> Vec<usize> {
    let through = |n: usize| {
        lines.branches[n].samples.windows(2).any(|w| {
            let [a, b] = [w[0].point, w[1].point];
            let (da, db) = (plane.signed_distance(&a), plane.signed_distance(&b));
            (da <= 0.0) != (db <= 0.0) && section.holds(plane, &(a + (b - a) * (da / (da - db))))
        })
    };
    (0..lines.branches.len()).filter(|&n| n != branch && through(n)).collect()
}

/// Whether a cut would take off a branch that goes on, as those of `others` do that do not end right behind the plane.
pub(super) fn takes_off(lines: &Centerlines, others: &[usize], plane: &Plane, radius: f64) -> bool {
    let ends_here = |n: usize| {
        let b = &lines.branches[n];
        let tips = [b.samples.first(), b.samples.last()];
        (0..2).any(|e| b.ends[e] == EndKind::Free && tips[e].is_some_and(|s| is_behind(plane, radius, &s.point)))
    };
    others.iter().any(|&n| !ends_here(n))
}

/// Whether a tip lies right behind the plane: a cut there takes no more off than the end itself.
fn is_behind(plane: &Plane, radius: f64, tip: &Point) -> bool {
    plane.signed_distance(tip) > 0.0 && (tip - plane.origin).norm() <= NEAR * radius
}

/// Which of the ends stay closed, and why.
pub(super) fn settle(ends: &[Ending]) -> Vec<Option<BlindReason>> {
    let mut closed: Vec<Option<BlindReason>> = vec![None; ends.len()];
    // Largest sections first: they take the others along.
    let mut order: Vec<usize> = (0..ends.len()).filter(|&n| !ends[n].others.is_empty()).collect();
    order.sort_by(|&a, &b| ends[b].area.total_cmp(&ends[a].area).then(a.cmp(&b)));
    for n in order {
        if closed[n].is_some() {
            continue;
        }
        let e = &ends[n];
        let ends_here = |m: usize| {
            let t = &ends[m];
            e.others.contains(&t.branch) && is_behind(&e.plane, e.radius, &t.tip)
        };
        let along: Vec<usize> = (0..ends.len()).filter(|&m| m != n && ends_here(m)).collect();
        if e.takes_off {
            closed[n] = Some(BlindReason::SharedSection);
        } else {
            along.into_iter().for_each(|m| closed[m] = Some(BlindReason::SharedOpening));
        }
    }
    closed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn end(branch: usize, x: f64, length: f64, area: f64, others: &[usize], takes_off: bool) -> Ending {
        let plane = Plane::new([x, 0.0, 0.0].into(), [0.0, 0.0, 1.0].into()).expect("a plane");
        Ending { branch, tip: Point::new(x, 0.0, length), plane, radius: 1.0, area, others: others.to_vec(), takes_off }
    }

    #[test]
    fn two_ends_side_by_side_share_the_larger_opening() {
        let ends = [end(4, 0.0, 2.0, 5.0, &[7], false), end(7, 1.0, 2.0, 6.0, &[4], false)];
        assert_eq!(settle(&ends), [Some(BlindReason::SharedOpening), None]);
    }

    #[test]
    fn a_stub_beside_a_vessel_that_goes_on_stays_closed() {
        let ends = [end(4, 0.0, 2.0, 5.0, &[7], true), end(7, 1.0, 12.0, 3.0, &[], false)];
        assert_eq!(settle(&ends), [Some(BlindReason::SharedSection), None]);
    }

    #[test]
    fn ends_by_themselves_stay_open() {
        assert_eq!(settle(&[end(0, 0.0, 2.0, 5.0, &[], false), end(1, 9.0, 2.0, 6.0, &[], false)]), [None, None]);
    }

    #[test]
    fn a_twig_at_the_tip_of_a_vessel_closes_nothing() {
        // Branch 5 is a bump: it is no end, and ends right behind the plane.
        assert_eq!(settle(&[end(0, 0.0, 2.0, 5.0, &[5], false)]), [None]);
    }
}
