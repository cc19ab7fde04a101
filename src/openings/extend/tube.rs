//! The section's outline carried along a straight axis.

use super::section::Section;
use super::{ExtendError, Extension, Opening};
use crate::centerline::{Branch, Centerlines, EndKind, Sample};
use crate::geometry::{Aabb, Plane, Point, Vector};
use crate::implicit::Implicit;

/// Harmonics of the outline.
const HARMONICS: usize = 16;
/// Rays by which the outline is found.
const RAYS: usize = 96;
/// The wall stays straight beyond the new opening for this part of the mean radius, so that its rim meets a full
/// section; a dome closes it.
const OVERHANG: f64 = 0.3;

/// Part of a section's area by which its outline, told as a radius over the angle, may differ from it.
const OUTLINE_ERROR: f64 = 0.04;
/// Steps of the implicit on either side of the opening's plane over which a carried section levels off.
const LEVEL: f64 = 2.0;

/// The wall of an extension.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    /// The outline's Fourier coefficients say it.
    Outline,
    /// The section is carried on as it is: no radius over the angle tells it.
    Carried {
        section: Section,
        /// Radius by which the end is rounded.
        round: f64,
    },
}

/// An extension: the outline carried along the axis.
#[derive(Debug, Clone)]
pub struct Tube {
    shape: Shape,
    pub(super) name: String,
    /// Centroid of the section and the opening's normal.
    pub(super) plane: Plane,
    /// Step along the axis for each mm along the normal.
    step: Vector,
    u: Vector,
    v: Vector,
    /// Fourier coefficients of r².
    cosine: [f64; HARMONICS + 1],
    sine: [f64; HARMONICS + 1],
    length: f64,
    transition: Option<f64>,
    /// Length before the plane over which the vessel passes to the outline.
    pub(super) lead: f64,
    /// Largest radius.
    pub(super) reach: f64,
    /// Where the straight wall ends and the dome begins.
    straight: f64,
    /// Tip of the dome.
    pub(super) end: f64,
}

/// s and ds/dx of the quintic step from 0 at x = 0 to 1 at x = 1: curvature goes over smoothly too.
pub(super) fn smoothstep(x: f64) -> (f64, f64) {
    let x = x.clamp(0.0, 1.0);
    (x * x * x * (x * (6.0 * x - 15.0) + 10.0), 30.0 * x * x * (x - 1.0) * (x - 1.0))
}

impl Tube {
    pub(super) fn new(surface: &dyn Implicit, opening: &Opening, e: &Extension) -> Result<Tube, ExtendError> {
        let name = || opening.name.clone();
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if !positive(e.length) || !e.transition.is_none_or(positive) {
            return Err(ExtendError::Length { name: name(), length: e.length, transition: e.transition });
        }
        let normal = opening.plane.normal;
        let direction = e.direction.unwrap_or(normal);
        let along = direction.dot(&normal);
        if !(along > 0.5 * direction.norm()) {
            let angle = (along / direction.norm()).acos().to_degrees();
            return Err(ExtendError::Direction { name: name(), angle });
        }
        let center: [f64; 3] = opening.plane.origin.into();
        let no_section = || ExtendError::Section { name: name(), center };
        let (u, v) = opening.plane.basis();
        let section = Section::new(surface, &opening.plane, opening.radius).ok_or_else(no_section)?;
        let area = section.area();
        let carried = |section: Section| Tube::carried(surface, opening, e, direction / along, section);
        // The centroid first, then the outline as seen from it.
        let mut origin = opening.plane.origin;
        let mut squares = [0.0; RAYS];
        for _ in 0..6 {
            let (mut area, mut moment) = (0.0, Vector::zeros());
            for (n, square) in squares.iter_mut().enumerate() {
                let (s, c) = angle(n).sin_cos();
                let d = u * c + v * s;
                let Some(r) = cast(surface, &origin, &d, 4.0 * opening.radius) else { return Ok(carried(section)) };
                *square = r * r;
                area += 0.5 * r * r;
                moment += d * (r * r * r / 3.0);
            }
            let shift = moment / area;
            if shift.norm() < 1e-6 * opening.radius {
                break;
            }
            origin += shift;
        }
        let mut cosine = [0.0; HARMONICS + 1];
        let mut sine = [0.0; HARMONICS + 1];
        for (n, square) in squares.iter().enumerate() {
            for k in 0..=HARMONICS {
                let (s, c) = (k as f64 * angle(n)).sin_cos();
                let w = if k == 0 { 1.0 } else { 2.0 } / RAYS as f64;
                cosine[k] += w * c * square;
                sine[k] += w * s * square;
            }
        }
        if (std::f64::consts::PI * cosine[0] / area - 1.0).abs() > OUTLINE_ERROR {
            return Ok(carried(section));
        }
        let mean = cosine[0].sqrt();
        let straight = e.length + OVERHANG * mean;
        let mut tube = Tube {
            shape: Shape::Outline,
            name: name(),
            plane: Plane { origin, normal },
            step: direction / along,
            u,
            v,
            cosine,
            sine,
            length: e.length,
            transition: e.transition,
            lead: 0.5 * mean,
            reach: mean,
            straight,
            end: straight + mean,
        };
        for n in 0..RAYS {
            let (r, ..) = tube.radius(angle(n), 0.0);
            if !(r > 0.2 * mean) {
                return Ok(carried(section));
            }
            tube.reach = tube.reach.max(r);
        }
        Ok(tube)
    }

    /// A section of any shape, carried on without change.
    fn carried(surface: &dyn Implicit, opening: &Opening, e: &Extension, step: Vector, section: Section) -> Tube {
        let plane = Plane { origin: section.centroid(), normal: opening.plane.normal };
        let (u, v) = plane.basis();
        let mut cosine = [0.0; HARMONICS + 1];
        cosine[0] = section.area() / std::f64::consts::PI;
        let mean = cosine[0].sqrt();
        let round = section.inscribed();
        let straight = e.length + OVERHANG * mean;
        let reach = section.points().map(|p| (p - plane.origin).norm()).fold(mean, f64::max) + surface.resolution();
        Tube {
            name: opening.name.clone(),
            plane,
            step,
            u,
            v,
            cosine,
            sine: [0.0; HARMONICS + 1],
            length: e.length,
            transition: None,
            lead: (LEVEL * surface.resolution()).min(0.5 * mean),
            reach,
            straight,
            end: straight + round,
            shape: Shape::Carried { section, round },
        }
    }

    /// Whether the section is carried on as it is, since no radius over the angle tells its outline.
    pub fn is_carried(&self) -> bool {
        matches!(self.shape, Shape::Carried { .. })
    }

    /// Area of the section, the same all along, mm².
    pub fn area(&self) -> f64 {
        std::f64::consts::PI * self.cosine[0]
    }

    /// Name of the opening.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The opening's plane before it was extended.
    pub fn old_end(&self) -> Plane {
        self.plane
    }

    /// The opening's plane at the end of the extension.
    pub fn new_end(&self) -> Plane {
        Plane { origin: self.plane.origin + self.step * self.length, normal: self.plane.normal }
    }

    /// Length along the axis, mm.
    pub fn length(&self) -> f64 {
        self.length * self.step.norm()
    }

    /// Volume between the old and the new opening, mm³.
    pub fn volume(&self) -> f64 {
        self.area() * self.length
    }

    /// Whether `p` lies in the extension or next to it.
    pub fn holds(&self, p: &Point) -> bool {
        let z = self.plane.signed_distance(p);
        z > 0.0 && z < self.end && self.local(p, z).norm() < 1.3 * self.reach
    }

    /// Radius of the largest circle inside the outline at a height, mm.
    pub(super) fn inscribed(&self, z: f64) -> f64 {
        match self.shape {
            Shape::Carried { round, .. } => round,
            Shape::Outline => (0..RAYS).map(|n| self.radius(angle(n), z).0).fold(f64::INFINITY, f64::min),
        }
    }

    pub(super) fn bounds(&self) -> Aabb {
        [0.0, self.end].into_iter().fold(Aabb::EMPTY, |b, z| {
            let c = self.plane.origin + self.step * z;
            b.union(&Aabb { min: c, max: c }.inflated(1.5 * self.reach))
        })
    }

    /// Points on the wall in rings half a radius apart, with their heights.
    pub(super) fn rings(&self) -> Vec<(Point, f64)> {
        let step = 0.5 * self.reach;
        let count = (self.straight / step).ceil() as usize;
        let height = |k: usize| (k as f64 * step).min(self.straight);
        if let Shape::Carried { section, .. } = &self.shape {
            return (1..=count).flat_map(|k| section.points().map(move |p| (p + self.step * height(k), height(k)))).collect();
        }
        let ring = |k: usize| {
            let z = height(k);
            (0..24).map(move |n| {
                let a = std::f64::consts::TAU * n as f64 / 24.0;
                let d = self.u * a.cos() + self.v * a.sin();
                (self.plane.origin + self.step * z + d * self.radius(a, z).0, z)
            })
        };
        (1..=count).flat_map(ring).collect()
    }

    /// In-plane vector from the axis to `p`, whose height is `z`.
    fn local(&self, p: &Point, z: f64) -> Vector {
        p - self.plane.origin - self.step * z
    }

    /// Whether `p`, near height 0, lies in the section, seen along the normal.
    pub(super) fn in_section(&self, p: &Point) -> bool {
        if let Shape::Carried { section, .. } = &self.shape {
            return section.holds(&self.plane.project(p));
        }
        let q = self.local(p, self.plane.signed_distance(p));
        q.norm() < self.radius(self.v.dot(&q).atan2(self.u.dot(&q)), 0.0).0
    }

    /// Of a carried section: the point of the vessel whose wall stands at `p`, and how fast its height grows with that of `p`.
    ///
    /// The height goes smoothly from that of `p`, before the plane, to 0, so that the vessel is stretched: nothing of it
    /// closes or opens.
    pub(super) fn origin_of(&self, p: &Point, z: f64) -> (Point, f64) {
        let x = (z - self.lead).clamp(-2.0 * self.lead, 0.0);
        let (own, rate) = if z <= -self.lead { (z, 1.0) } else { (-x * x / (4.0 * self.lead), -x / (2.0 * self.lead)) };
        (p + self.step * (own - z), rate)
    }

    /// Of a carried section: `f` and its gradient at the origin of a point at height `z` made those at the point, the end
    /// rounded.
    pub(super) fn carry(&self, (f, g): (f64, Vector), z: f64, rate: f64) -> (f64, Vector) {
        let g = g + self.plane.normal * ((rate - 1.0) * g.dot(&self.step));
        let Shape::Carried { round, .. } = self.shape else { return (f, g) };
        let w = z - self.straight;
        if w <= 0.0 {
            return (f, g);
        }
        let q = (f + round).max(0.0);
        let rho = q.hypot(w);
        (rho - round, g * (q / rho) + self.plane.normal * (w / rho))
    }

    /// The wall's function and gradient at height `z` of `p`; `None` far from it. Before the plane the outline goes on.
    pub(super) fn wall(&self, p: &Point, z: f64) -> Option<(f64, Vector)> {
        let local = self.local(p, z);
        let q = local.norm();
        if q > 1.6 * self.reach || z > self.end + self.reach {
            return None;
        }
        let radial = if q > 0.0 { local / q } else { self.u };
        let (r, r_angle, r_z) = self.radius(self.v.dot(&local).atan2(self.u.dot(&local)), z.max(0.0));
        let turn = self.plane.normal.cross(&radial) / q.max(0.1 * r);
        let (value, along_q, along_angle, along_z);
        if z <= self.straight {
            value = q - r;
            (along_q, along_angle, along_z) = (1.0, -r_angle, if z > 0.0 { -r_z } else { 0.0 });
        } else {
            // Half an ellipsoid on the outline, round at its tip.
            let w = z - self.straight;
            let rho2 = (q * q + w * w).max(1e-12 * self.cosine[0]);
            let (rho, part) = (rho2.sqrt(), q * q / rho2);
            let lobes = r * r - self.cosine[0];
            let own = (self.cosine[0] + part * lobes).sqrt();
            value = rho - own;
            let slope = q * w * lobes / (rho2 * rho2 * own);
            (along_q, along_angle, along_z) = (q / rho - slope * w, -part * r * r_angle / own, w / rho + slope * q - part * r * r_z / own);
        }
        // In the plane: radial and angular parts; along the axis: the blend and the lean of the axis.
        let flat = radial * along_q + turn * along_angle;
        Some((value, flat + self.plane.normal * (along_z - flat.dot(&self.step))))
    }

    /// Cuts the branch that runs through the opening and continues it along the axis.
    pub(super) fn continue_axis(&self, lines: &mut Centerlines) {
        continue_axis(lines, self);
    }

    /// Radius of the outline and its derivatives by angle and by height.
    fn radius(&self, a: f64, z: f64) -> (f64, f64, f64) {
        let (mut square, mut turn) = (0.0, 0.0);
        for k in 1..=HARMONICS {
            let (s, c) = (k as f64 * a).sin_cos();
            square += self.cosine[k] * c + self.sine[k] * s;
            turn += k as f64 * (self.sine[k] * c - self.cosine[k] * s);
        }
        let (s, ds) = match self.transition {
            Some(t) => {
                let (s, ds) = smoothstep(z / t);
                (s, ds / t)
            }
            None => (0.0, 0.0),
        };
        let r = (self.cosine[0] + (1.0 - s) * square).max(0.01 * self.cosine[0]).sqrt();
        (r, (1.0 - s) * turn / (2.0 * r), -ds * square / (2.0 * r))
    }
}

fn angle(n: usize) -> f64 {
    std::f64::consts::TAU * n as f64 / RAYS as f64
}

/// Distance to the wall in a direction, mm.
pub(super) fn cast(surface: &dyn Implicit, from: &Point, direction: &Vector, limit: f64) -> Option<f64> {
    let value = |t: f64| surface.value(&(from + direction * t));
    if value(0.0) >= 0.0 {
        return None;
    }
    let step = surface.resolution();
    let (mut low, mut high) = (0.0, 0.0);
    loop {
        high += step;
        if high > limit {
            return None;
        }
        if value(high) >= 0.0 {
            break;
        }
        low = high;
    }
    for _ in 0..40 {
        let mid = 0.5 * (low + high);
        if value(mid) < 0.0 { low = mid } else { high = mid }
    }
    Some(0.5 * (low + high))
}

/// The axis of the extension as samples from its start to its end.
fn axis(tube: &Tube, spacing: f64) -> Vec<(Point, f64)> {
    let count = (tube.length() / spacing).ceil().max(1.0) as usize;
    let height = |n: usize| tube.length * n as f64 / count as f64;
    (0..=count).map(|n| (tube.plane.origin + tube.step * height(n), tube.inscribed(height(n)))).collect()
}

fn sampled(points: &[(Point, f64)], fallback: &Vector) -> Vec<Sample> {
    let mut arc = 0.0;
    (0..points.len())
        .map(|n| {
            if n > 0 {
                arc += (points[n].0 - points[n - 1].0).norm();
            }
            let chord = points[(n + 1).min(points.len() - 1)].0 - points[n.saturating_sub(1)].0;
            let tangent = chord.try_normalize(0.0).unwrap_or(*fallback);
            Sample { point: points[n].0, radius: points[n].1, tangent, arc_length: arc }
        })
        .collect()
}

fn continue_axis(lines: &mut Centerlines, tube: &Tube) {
    // The branch that crosses the plane nearest to the section's middle.
    let mut best: Option<(f64, usize, usize)> = None;
    for (b, branch) in lines.branches.iter().enumerate() {
        for (i, s) in branch.samples.iter().enumerate() {
            let d = (s.point - tube.plane.origin).norm();
            if best.is_none_or(|(x, ..)| d < x) {
                best = Some((d, b, i));
            }
        }
    }
    let Some((_, b, i)) = best else { return };
    let component = lines.branches[b].component;
    let branch = &mut lines.branches[b];
    let end = usize::from(branch.samples[i].tangent.dot(&tube.plane.normal) > 0.0);
    let spacing = branch.length() / (branch.samples.len().max(2) - 1) as f64;
    let mut points: Vec<(Point, f64)> = branch.samples.iter().map(|s| (s.point, s.radius)).collect();
    if end == 0 {
        points.reverse();
    }
    let own = if end == 1 { i } else { points.len() - 1 - i };
    points.truncate(own + 1);
    while points.last().is_some_and(|(p, _)| tube.plane.signed_distance(p) > -0.5 * spacing) {
        points.pop();
    }
    let extension = axis(tube, spacing);
    let tip = extension[extension.len() - 1].0;
    if branch.ends[end] != EndKind::Free || points.is_empty() {
        // More vessel lies beyond: the extension is a branch of its own.
        let samples = sampled(&extension, &tube.plane.normal);
        let first = lines.nodes.len() as u32;
        lines.nodes.extend([extension[0].0, tip]);
        lines.branches.push(Branch { samples, nodes: [first, first + 1], ends: [EndKind::Free; 2], component });
        return;
    }
    points.extend(extension);
    if end == 0 {
        points.reverse();
    }
    branch.samples = sampled(&points, &tube.plane.normal);
    let node = branch.nodes[end] as usize;
    lines.nodes[node] = tip;
}
