//! Found planes squared to the axis of the reconstructed wall, which is free of the mask's stairs.

use std::f64::consts::TAU;

use super::{FoundBy, Opening};
use super::axis::axis;
use super::border::{along_face, disc_inside};
use crate::geometry::{Plane, Point, Vector};
use crate::implicit::Implicit;
use crate::mask::Mask;

/// Directions in which a section is measured.
const RAYS: usize = 48;
/// Cosine of the largest correction, 30 degrees: beyond that the mask and the wall speak of different axes.
const LARGEST_TURN: f64 = 0.866;

/// The opening with its plane square to the vessel's axis, taken from the middles of the wall's sections round it.
///
/// A plane along the picture's face, one in a rim of a given surface, and one whose sections tell no better axis, stay as they are.
pub fn refine(mask: &Mask, wall: &dyn Implicit, opening: &Opening) -> Opening {
    let (o, spacing) = (opening, mask.grid.spacing());
    if o.support.along_face || o.found_by == FoundBy::SurfaceRim || along_face(mask, &o.plane) {
        return o.clone();
    }
    let cross = |plane: &Plane| {
        let s = section(wall, plane, 3.0 * o.radius)?;
        disc_inside(mask, plane, s.reach).then_some((s.center, s.area))
    };
    let (origin, normal) = axis(&o.plane.origin, &o.plane.normal, o.radius, spacing, 2.0 * o.radius, cross);
    let refined = Plane::new(origin, normal).filter(|q| q.normal.dot(&o.plane.normal) > LARGEST_TURN);
    let area = |q: &Plane| section(wall, q, 3.0 * o.radius).map(|s| s.area);
    // The section square to a vessel is its smallest.
    match (refined, refined.and_then(|q| area(&q)), area(&o.plane)) {
        (Some(plane), Some(new), Some(old)) if new <= 1.01 * old => Opening { plane, ..o.clone() },
        (Some(plane), Some(_), None) => Opening { plane, ..o.clone() },
        _ => o.clone(),
    }
}

struct Section {
    center: Point,
    area: f64,
    reach: f64,
}

/// The section of the lumen by a plane, as seen from the plane's origin; `None` where that is outside, or where the
/// section goes on beyond `limit` mm.
fn section(wall: &dyn Implicit, plane: &Plane, limit: f64) -> Option<Section> {
    if wall.value(&plane.origin) >= 0.0 {
        return None;
    }
    let (u, v) = plane.basis();
    let step = wall.resolution();
    let mut rim: Vec<Vector> = Vec::with_capacity(RAYS);
    for n in 0..RAYS {
        let (s, c) = (TAU * n as f64 / RAYS as f64).sin_cos();
        let d = u * c + v * s;
        let value = |t: f64| wall.value(&(plane.origin + d * t));
        let (mut low, mut high) = (0.0, step);
        while value(high) < 0.0 {
            (low, high) = (high, high + step);
            if high > limit {
                return None;
            }
        }
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if value(middle) < 0.0 { low = middle } else { high = middle }
        }
        rim.push(d * high);
    }
    let (mut area, mut moment) = (0.0, Vector::zeros());
    for n in 0..RAYS {
        let (a, b) = (rim[n], rim[(n + 1) % RAYS]);
        let part = 0.5 * a.cross(&b).norm();
        area += part;
        moment += (a + b) * (part / 3.0);
    }
    let reach = rim.iter().map(|r| r.norm()).fold(0.0, f64::max);
    Some(Section { center: plane.origin + moment / area, area, reach })
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::mask::Grid;
    use crate::mesh::PatchKind;
    use crate::remesh::testing::Capsules;

    #[test]
    fn a_plane_askew_by_twenty_degrees_is_squared_to_the_axis() {
        let wall = Capsules::tube(2.0, 12.0);
        let grid = Grid::new([20, 20, 40], [0.5; 3], Point::new(-5.0, -5.0, -10.0), Matrix3::identity()).unwrap();
        let mask = Mask::new(grid.clone(), vec![0; grid.len()]);
        let tilt = 20f64.to_radians();
        let plane = Plane::new(Point::new(0.2, -0.1, 4.5), Vector::new(tilt.sin(), 0.0, tilt.cos())).unwrap();
        let found = Opening {
            id: 2,
            name: "inlet".into(),
            kind: PatchKind::Inlet,
            plane,
            radius: 2.0,
            support: crate::openings::Support::round(&plane, 2.0),
            found_by: FoundBy::BluntEnd,
            confidence: 1.0,
            component: 0,
        };
        let squared = refine(&mask, &wall, &found).plane;
        let angle = squared.normal.dot(&Vector::z()).acos().to_degrees();
        assert!(angle < 1.0, "{angle}");
        assert!(squared.origin.x.hypot(squared.origin.y) < 0.02 && (squared.origin.z - 4.5).abs() < 0.2, "{squared:?}");
    }
}
