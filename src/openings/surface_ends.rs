//! Ends that a surface itself has, joined with those found in its mask.

use super::names::{self, Sized};
use super::{DetectReport, FoundBy, FoundEnd, Opening, Support};
use crate::geometry::{Plane, Vector};
use crate::mesh::PatchKind;

/// An open rim or a flat cap of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct RimEnd {
    /// The rim's plane, origin inside the rim, normal out of the vessel.
    pub plane: Plane,
    /// Radius of the largest circle in the rim, mm.
    pub radius: f64,
    /// Area in the rim, mm².
    pub area: f64,
    /// Direction in which the vessel runs out of it, of unit length.
    pub axis: Vector,
    /// Component of the mask that it belongs to.
    pub component: u32,
}

/// The openings of a surface: one in the plane of each of its ends, besides those of `detected` that lie farther than two radii from
/// all of them. Names and numbers are given anew, by area; the report follows.
pub fn join_rims(detected: Vec<Opening>, rims: &[RimEnd], report: &mut DetectReport) -> Vec<Opening> {
    if rims.is_empty() {
        return detected;
    }
    let near = |o: &Opening, r: &RimEnd| (o.plane.origin - r.plane.origin).norm() <= 2.0 * r.radius.max(o.radius);
    let mut list = Vec::new();
    let mut found = Vec::new();
    for o in detected.into_iter().filter(|o| !rims.iter().any(|r| near(o, r))) {
        let Some(f) = report.found.iter().find(|f| f.name == o.name) else { continue };
        list.push(Sized { opening: Opening { kind: PatchKind::Outlet, ..o }, fixed: false });
        found.push(f.clone());
    }
    for r in rims {
        let opening = Opening {
            id: 0,
            name: String::new(),
            kind: PatchKind::Outlet,
            plane: r.plane,
            radius: r.radius,
            support: Support { axis: r.axis, square_area: r.area * r.axis.dot(&r.plane.normal).abs(), expected_area: Some(r.area), along_face: true },
            found_by: FoundBy::SurfaceRim,
            confidence: 1.0,
            component: r.component,
        };
        let center = r.plane.origin;
        found.push(FoundEnd { name: String::new(), center, tip: center, from_tip: 0.0, area: r.area });
        list.push(Sized { opening, fixed: false });
    }
    report.blind.retain(|b| !rims.iter().any(|r| (b.tip - r.plane.origin).norm() <= 2.0 * r.radius.max(b.radius)));
    report.close_choices = names::choose_inlets(&mut list);
    let openings = names::assign(list);
    report.found = openings
        .iter()
        .filter_map(|o| found.iter().find(|f| f.center == o.plane.origin).map(|f| FoundEnd { name: o.name.clone(), ..f.clone() }))
        .collect();
    openings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;

    #[test]
    fn rims_take_the_place_of_ends_found_near_them_and_the_largest_is_the_inlet() {
        let found = |name: &str, z: f64| Opening {
            id: 2,
            name: name.into(),
            kind: PatchKind::Inlet,
            plane: Plane { origin: Point::new(0.0, 0.0, z), normal: Vector::z() },
            radius: 1.0,
            support: Support { axis: Vector::z(), square_area: 3.0, expected_area: None, along_face: false },
            found_by: FoundBy::BluntEnd,
            confidence: 0.6,
            component: 0,
        };
        let mut report = DetectReport::default();
        for (name, z) in [("inlet", 1.5), ("outlet_1", 30.0)] {
            let center = Point::new(0.0, 0.0, z);
            report.found.push(FoundEnd { name: name.into(), center, tip: center, from_tip: 1.0, area: 3.0 });
        }
        let plane = Plane { origin: Point::origin(), normal: -Vector::z() };
        let rims = [RimEnd { plane, radius: 1.0, area: 3.1, axis: -Vector::z(), component: 0 }];
        let all = join_rims(vec![found("inlet", 1.5), found("outlet_1", 30.0)], &rims, &mut report);
        let told: Vec<(&str, FoundBy)> = all.iter().map(|o| (o.name.as_str(), o.found_by)).collect();
        assert_eq!(told, [("inlet", FoundBy::SurfaceRim), ("outlet_1", FoundBy::BluntEnd)]);
        assert_eq!((all[0].plane, all[0].confidence), (plane, 1.0));
        assert_eq!(report.found.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(), ["inlet", "outlet_1"]);
    }
}
