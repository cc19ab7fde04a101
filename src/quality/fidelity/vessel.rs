//! Fidelity along the centerlines: radii before and after, parts of the vessel that are missing.

use rayon::prelude::*;
use serde::Serialize;

use crate::centerline::Centerlines;
use crate::geometry::Point;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::{TriMesh, WALL};

use super::{Cut, Reference};

/// Radius of the vessel at a centerline sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RadiusSample {
    /// Branch of the centerlines.
    pub branch: u32,
    /// Arc length in that branch, mm.
    pub arc_length: f64,
    /// Position, mm.
    pub point: Point,
    /// Distance to the mask's marching cubes surface, mm.
    pub mask: f64,
    /// Distance to the wall, mm.
    pub surface: f64,
}

/// The narrowest place of a branch before and after.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Narrowest {
    /// Branch of the centerlines.
    pub branch: u32,
    /// Smallest radius in the mask, mm.
    pub mask: f64,
    /// Where that is, mm.
    pub mask_at: Point,
    /// Smallest radius in the surface, mm.
    pub surface: f64,
    /// Where that is, mm.
    pub surface_at: Point,
}

/// Radii along the vessel in mask and surface.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Radii {
    /// The narrowest place of each branch.
    pub narrowest: Vec<Narrowest>,
    /// Largest drop of radius from mask to surface, mm; 0 where the vessel is nowhere narrower.
    pub largest_loss: f64,
    /// Where that is, mm.
    pub largest_loss_at: Option<Point>,
    /// Every sample inside the surface.
    #[serde(skip)]
    pub samples: Vec<RadiusSample>,
}

/// Radius of the largest sphere round each centerline sample that fits in the mask's marching cubes surface and in
/// the wall; samples outside either are left out, [`lost`] tells of them.
pub fn radii(centerlines: &Centerlines, surface: &TriMesh, reference: &Reference) -> Radii {
    let inside = TriangleBvh::new(surface);
    let wall: Vec<[u32; 3]> =
        surface.triangles.iter().zip(&surface.patch).filter(|x| *x.1 == WALL).map(|x| *x.0).collect();
    let wall = TriangleBvh::of(&surface.points, &wall);
    let flat: Vec<(u32, f64, Point)> = centerlines
        .branches
        .iter()
        .enumerate()
        .flat_map(|(b, branch)| branch.samples.iter().map(move |s| (b as u32, s.arc_length, s.point)))
        .collect();
    let samples: Vec<RadiusSample> = flat
        .par_iter()
        .filter(|s| inside.contains(&s.2) && reference.bvh().contains(&s.2))
        .filter_map(|&(branch, arc_length, point)| {
            let mask = reference.bvh().closest(&point)?.distance;
            let surface = wall.closest(&point)?.distance;
            Some(RadiusSample { branch, arc_length, point, mask, surface })
        })
        .collect();
    let mut out = Radii::default();
    for s in &samples {
        if s.mask - s.surface > out.largest_loss {
            out.largest_loss = s.mask - s.surface;
            out.largest_loss_at = Some(s.point);
        }
        match out.narrowest.last_mut() {
            Some(n) if n.branch == s.branch => {
                if s.mask < n.mask {
                    (n.mask, n.mask_at) = (s.mask, s.point);
                }
                if s.surface < n.surface {
                    (n.surface, n.surface_at) = (s.surface, s.point);
                }
            }
            _ => out.narrowest.push(Narrowest {
                branch: s.branch,
                mask: s.mask,
                mask_at: s.point,
                surface: s.surface,
                surface_at: s.point,
            }),
        }
    }
    out.samples = samples;
    out
}

/// Why a part of the vessel is not in the surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LostReason {
    /// Beyond a plane that the user gave.
    CutByUser(String),
    /// Beyond a plane that was found.
    CutAtOpening(String),
    /// The surface does not contain it.
    NotInSurface,
}

/// A connected piece of centerline outside the surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LostPart {
    /// The sample in its middle, mm.
    pub center: Point,
    /// Its length, mm.
    pub length: f64,
    /// Why.
    pub reason: LostReason,
}

/// A detected opening may lie this many radii before the tip of its vessel without anything counting as lost.
const END_ALLOWANCE: f64 = 2.5;

/// What of the vessel is missing.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct LostLength {
    /// Missing pieces, longest first.
    pub parts: Vec<LostPart>,
    /// Missing length, mm: planes given by the user and the last 2.5 radii before a detected end aside.
    pub length: f64,
    /// Length of all centerlines less what the user cut off, mm.
    pub total: f64,
    /// `length` over `total`.
    pub fraction: f64,
}

/// The pieces of centerline that lie outside a closed surface.
///
/// A piece that starts beyond a cut's disc, within two radii and two samples of it, counts as cut there with all that
/// hangs on it. Each sample stands for half of the way to its neighbours. Samples within `tolerance` (mm) of the
/// surface count as inside: the centerline's tips lie on the mask's outermost voxels.
pub fn lost(centerlines: &Centerlines, surface: &TriMesh, cuts: &[Cut], tolerance: f64) -> LostLength {
    let tree = TriangleBvh::new(surface);
    let samples: Vec<(usize, usize)> = centerlines
        .branches
        .iter()
        .enumerate()
        .flat_map(|(b, branch)| (0..branch.samples.len()).map(move |s| (b, s)))
        .collect();
    let sample = |i: usize| &centerlines.branches[samples[i].0].samples[samples[i].1];
    let gone = |p: &Point| !tree.contains(p) && tree.closest_within(p, tolerance).is_none();
    let missing: Vec<bool> = (0..samples.len()).into_par_iter().map(|i| gone(&sample(i).point)).collect();
    let mut length = vec![0.0; samples.len()];
    let mut parent: Vec<usize> = (0..samples.len()).collect();
    let mut at_node: Vec<Option<usize>> = vec![None; centerlines.nodes.len()];
    let mut first = 0;
    for branch in &centerlines.branches {
        let n = branch.samples.len();
        for i in first..(first + n).saturating_sub(1) {
            let d = (sample(i + 1).point - sample(i).point).norm();
            length[i] += 0.5 * d;
            length[i + 1] += 0.5 * d;
            if missing[i] && missing[i + 1] {
                join(&mut parent, i, i + 1);
            }
        }
        if n > 0 {
            for (end, node) in [(first, branch.nodes[0]), (first + n - 1, branch.nodes[1])] {
                let Some(slot) = at_node.get_mut(node as usize).filter(|_| missing[end]) else { continue };
                match *slot {
                    Some(other) => join(&mut parent, end, other),
                    None => *slot = Some(end),
                }
            }
        }
        first += n;
    }
    let mut groups: std::collections::BTreeMap<usize, Vec<usize>> = std::collections::BTreeMap::new();
    for i in (0..samples.len()).filter(|&i| missing[i]) {
        groups.entry(root(&mut parent, i)).or_default().push(i);
    }
    let mut out = LostLength { total: length.iter().sum(), ..LostLength::default() };
    for group in groups.values() {
        let sum: f64 = group.iter().map(|&i| length[i]).sum();
        let cut = cuts.iter().find(|c| {
            group.iter().any(|&i| {
                let (p, d) = (sample(i).point, c.plane.signed_distance(&sample(i).point));
                let slack = 2.0 * length[i];
                d > -slack && d <= 2.0 * c.radius + slack && (c.plane.project(&p) - c.plane.origin).norm() <= 1.5 * c.radius
            })
        });
        let reason = match cut {
            Some(c) if c.user => LostReason::CutByUser(c.name.clone()),
            Some(c) => LostReason::CutAtOpening(c.name.clone()),
            None => LostReason::NotInSurface,
        };
        match (&reason, cut) {
            (LostReason::CutByUser(_), _) => out.total -= sum,
            // The tip beyond a detected opening is the end itself; only what exceeds its allowance was a vessel.
            (LostReason::CutAtOpening(_), Some(c)) => out.length += (sum - END_ALLOWANCE * c.radius).max(0.0),
            _ => out.length += sum,
        }
        out.parts.push(LostPart { center: sample(group[group.len() / 2]).point, length: sum, reason });
    }
    out.parts.sort_by(|a, b| b.length.total_cmp(&a.length));
    out.fraction = if out.total > 0.0 { out.length / out.total } else { 0.0 };
    out
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

fn join(parent: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(parent, a), root(parent, b));
    // The lower sample leads, so that groups come in the order of the centerlines.
    parent[a.max(b)] = a.min(b);
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::centerline::{Branch, EndKind, Sample};
    use crate::geometry::{Plane, Vector};
    use crate::mask::{Grid, Mask};
    use crate::mesh::test_shapes::sphere;

    /// A straight line from x = −10 to x = 10 in steps of a half.
    fn line() -> Centerlines {
        let samples = (0..=40).map(|i| {
            let s = f64::from(i) * 0.5;
            Sample { point: Point::new(s - 10.0, 0.0, 0.0), radius: 4.0, tangent: Vector::x(), arc_length: s }
        });
        let branch = Branch { samples: samples.collect(), nodes: [0, 1], ends: [EndKind::Free; 2], component: 0 };
        Centerlines { branches: vec![branch], nodes: vec![Point::new(-10.0, 0.0, 0.0), Point::new(10.0, 0.0, 0.0)] }
    }

    #[test]
    fn what_a_ball_does_not_hold_is_lost_at_both_ends() {
        let ball = sphere(Point::origin(), 5.25, 16);
        let l = lost(&line(), &ball, &[], 0.0);
        assert_eq!(l.parts.len(), 2);
        // Ten samples at 0.5 mm from 5.5 to 10; the last stands for half a step.
        assert!((l.length - 2.0 * (9.0 * 0.5 + 0.25)).abs() < 1e-9, "{}", l.length);
        assert!((l.total - 20.0).abs() < 1e-9);
        assert!(l.parts.iter().all(|p| p.reason == LostReason::NotInSurface && p.center.x.abs() > 6.0));
    }

    #[test]
    fn a_part_beyond_a_given_plane_is_not_held_against_the_surface() {
        let ball = sphere(Point::origin(), 5.25, 16);
        let cut = |user, name: &str, x: f64| Cut {
            plane: Plane::new(Point::new(x * 5.0, 0.0, 0.0), Vector::x() * x).unwrap(),
            radius: 1.0,
            name: name.into(),
            user,
        };
        // Of the 4.75 mm beyond the detected opening, 2.5 radii are its own.
        let l = lost(&line(), &ball, &[cut(true, "inlet", -1.0), cut(false, "outlet_1", 1.0)], 0.0);
        assert!((l.length - 2.25).abs() < 1e-9 && (l.total - 15.25).abs() < 1e-9);
        assert!((l.fraction - 2.25 / 15.25).abs() < 1e-12);
        let mut reasons: Vec<_> = l.parts.iter().map(|p| (p.center.x > 0.0, p.reason.clone())).collect();
        reasons.sort_by_key(|r| r.0);
        assert_eq!(reasons[0].1, LostReason::CutByUser("inlet".into()));
        assert_eq!(reasons[1].1, LostReason::CutAtOpening("outlet_1".into()));
    }

    #[test]
    fn radii_tell_how_much_narrower_the_surface_is() {
        let grid = Grid::new([25; 3], [1.0; 3], Point::new(-12.0, -12.0, -12.0), Matrix3::identity()).unwrap();
        let data = (0..grid.len()).map(|n| {
            let v = Vector::from(grid.voxel(n).map(|x| x as f64)) - Vector::repeat(12.0);
            u8::from(v.norm() < 8.0)
        });
        let data = data.collect();
        let mask = Mask::new(grid, data);
        let reference = Reference::new(&mask).unwrap();
        let r = radii(&line(), &sphere(Point::origin(), 6.0, 20), &reference);
        assert_eq!(r.narrowest.len(), 1);
        let c = r.samples.iter().find(|s| s.point.x == 0.0).unwrap();
        assert!((c.surface - 6.0).abs() < 0.05 && (c.mask - 7.6).abs() < 0.5, "{c:?}");
        assert!((r.largest_loss - 1.7).abs() < 0.5, "{}", r.largest_loss);
    }
}
