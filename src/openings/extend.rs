//! Flow extensions: the vessel continued beyond its openings, as part of the implicit.
//!
//! Beyond the opening's plane the wall is the section's outline r(θ) about its centroid, carried along a direction
//! and blended to a circle: r²(θ, z) = (1 − s) r²(θ) + s r₀² with s rising smoothly from 0 to 1 over the transition
//! and r₀² the mean of r². The area ½∮r²dθ is therefore the same at every z. Half a radius before the plane the
//! function passes smoothly from the vessel to the outline, so that the wall has no seam there, and the mesher meets
//! none either: the extended function is meshed like any other and cut at the new end.

use serde::Serialize;

use super::Opening;
use crate::centerline::{Centerlines, EndKind, Sample};
use crate::geometry::{Aabb, Plane, Point, Vector};
use crate::implicit::Implicit;
use crate::mask::{Grid, Mask};

/// An extension of one opening.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Extension {
    /// Name of the opening.
    pub opening: String,
    /// Length along the normal, mm.
    pub length: f64,
    /// Length over which the section becomes a circle, mm; `None` keeps the section.
    pub transition: Option<f64>,
    /// Direction, any length; `None` is the opening's normal. The centerline's tangent is the other usual choice.
    pub direction: Option<Vector>,
}

/// Why an opening cannot be extended.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ExtendError {
    /// No such opening.
    #[error("there is no opening `{0}` to extend: check the names under `extensions:`")]
    Unknown(String),
    /// The length is no length.
    #[error("the extension of `{name}` has a length of {length} mm and a transition of {transition:?} mm; both must be finite and above zero")]
    Length {
        /// Opening.
        name: String,
        /// As given, mm.
        length: f64,
        /// As given, mm.
        transition: Option<f64>,
    },
    /// The direction does not lead out.
    #[error("the extension of `{name}` would run {angle:.0}° off the opening's normal; less than 60° is needed")]
    Direction {
        /// Opening.
        name: String,
        /// Angle to the normal, degrees.
        angle: f64,
    },
    /// The section's outline cannot be told as a radius over the angle.
    #[error("the section of `{name}` at {center:.3?} (LPS mm) is no closed outline round its middle: move the opening along the branch")]
    Section {
        /// Opening.
        name: String,
        /// Centre of the opening, LPS mm.
        center: [f64; 3],
    },
    /// The vessel comes back to itself.
    #[error("the vessel beyond `{name}` at {center:.3?} (LPS mm) leads back to its other side: a ring has no end to extend")]
    Ring {
        /// Opening.
        name: String,
        /// Centre of the opening, LPS mm.
        center: [f64; 3],
    },
    /// The extension meets another vessel.
    #[error("the extension of `{name}` runs into the vessel {distance:.2} mm from its start, at {at:.3?} (LPS mm): shorten it or give a direction")]
    Collides {
        /// Opening.
        name: String,
        /// Where, LPS mm.
        at: [f64; 3],
        /// Distance from the opening, mm.
        distance: f64,
    },
}

/// Harmonics of the outline.
const HARMONICS: usize = 16;
/// Rays by which the outline is found.
const RAYS: usize = 96;

/// The outline carried along the axis.
#[derive(Debug, Clone)]
struct Tube {
    /// Centroid of the section and the opening's normal.
    plane: Plane,
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
    lead: f64,
    /// Largest radius.
    reach: f64,
    /// End of the tube: beyond the new opening, so that the cut meets a full section.
    end: f64,
}

/// A vessel with extensions. Values are close to distances near the wall where sections are nearly round.
pub struct Extended<'a> {
    inner: &'a dyn Implicit,
    tubes: Vec<Tube>,
    grid: Grid,
    /// Voxels at and near the parts that the openings take off.
    removed: Vec<bool>,
    bounds: Aabb,
}

impl<'a> Extended<'a> {
    /// Continues `surface` beyond the openings named in `extensions`; returns it with the openings moved to the new ends.
    ///
    /// `mask` tells what lies beyond an opening: that part of the vessel is taken off. The new normals are those of the
    /// old planes. The area of the section does not change along an extension.
    pub fn new(
        surface: &'a dyn Implicit,
        mask: &Mask,
        openings: &[Opening],
        extensions: &[Extension],
    ) -> Result<(Extended<'a>, Vec<Opening>), ExtendError> {
        let mut moved = openings.to_vec();
        let mut tubes = Vec::new();
        let mut removed = vec![false; mask.data.len()];
        let mut bounds = surface.bounds();
        for e in extensions {
            let n = openings.iter().position(|o| o.name == e.opening).ok_or(ExtendError::Unknown(e.opening.clone()))?;
            let tube = Tube::new(surface, &openings[n], e)?;
            take_off(mask, &tube, &openings[n], &mut removed)?;
            moved[n].plane = Plane { origin: tube.plane.origin + tube.step * e.length, normal: tube.plane.normal };
            for z in [0.0, tube.end] {
                let c = tube.plane.origin + tube.step * z;
                bounds = bounds.union(&Aabb { min: c, max: c }.inflated(1.5 * tube.reach));
            }
            tubes.push(tube);
        }
        let removed = widen(mask, &removed);
        let extended = Extended { inner: surface, tubes, grid: mask.grid.clone(), removed, bounds };
        for (tube, e) in extended.tubes.iter().zip(extensions) {
            extended.collision(tube, &e.opening)?;
        }
        Ok((extended, moved))
    }

    /// Points on the axes of the extensions, from the old openings to the new: seeds and sizes for the mesher.
    pub fn axes(&self) -> Vec<[Point; 2]> {
        self.tubes.iter().map(|t| [t.plane.origin, t.plane.origin + t.step * t.length]).collect()
    }

    /// The centerlines cut at the extended openings and continued along the extensions.
    pub fn centerlines(&self, lines: &Centerlines) -> Centerlines {
        let mut lines = lines.clone();
        for tube in &self.tubes {
            continue_axis(&mut lines, tube);
        }
        lines
    }

    fn collision(&self, tube: &Tube, name: &str) -> Result<(), ExtendError> {
        let step = 0.5 * tube.reach;
        let rings = (tube.end / step).ceil() as usize;
        for k in 1..=rings {
            let z = k as f64 * step;
            for n in 0..24 {
                let (s, c) = (std::f64::consts::TAU * n as f64 / 24.0).sin_cos();
                let wall = tube.radius(s.atan2(c), z).0;
                let p = tube.plane.origin + tube.step * z + (tube.u * c + tube.v * s) * wall;
                if self.rest(&p).0 < 0.0 {
                    return Err(ExtendError::Collides { name: name.into(), at: p.into(), distance: z });
                }
            }
        }
        Ok(())
    }

    /// The vessel without what the openings take off.
    fn rest(&self, p: &Point) -> (f64, Vector) {
        let (f, g) = self.inner.value_gradient(p);
        let x = self.grid.to_index(p);
        let gone = self
            .grid
            .linear(x[0].round() as i64, x[1].round() as i64, x[2].round() as i64)
            .is_some_and(|n| self.removed[n]);
        if !gone {
            return (f, g);
        }
        let nearest = self.tubes.iter().map(|t| (t.plane.signed_distance(p), t.plane.normal));
        let (z, n) = nearest.fold((f64::INFINITY, Vector::zeros()), |a, b| if b.0.abs() < a.0.abs() { b } else { a });
        if z > f { (z.max(1e-6 * self.inner.resolution()), n) } else { (f.max(1e-6 * self.inner.resolution()), g) }
    }
}

impl Implicit for Extended<'_> {
    fn value(&self, p: &Point) -> f64 {
        self.value_gradient(p).0
    }

    fn value_gradient(&self, p: &Point) -> (f64, Vector) {
        let mut best = self.rest(p);
        for tube in &self.tubes {
            let z = tube.plane.signed_distance(p);
            if z <= -tube.lead || z >= tube.end + tube.reach {
                continue;
            }
            let (q, radial) = tube.local(p, z);
            if q > 1.6 * tube.reach {
                continue;
            }
            let (r, r_angle, r_z) = tube.radius(tube.angle(p, z), z.max(0.0));
            // In the plane: radial and angular parts; along the axis: the blend.
            let turn = tube.plane.normal.cross(&radial);
            let flat = radial - turn * (r_angle / q.max(0.1 * r));
            let lean = tube.plane.normal * (flat.dot(&tube.step) + if z > 0.0 { r_z } else { 0.0 });
            let own = (q - r, flat - lean);
            if z >= 0.0 {
                let capped = if z - tube.end > own.0 { (z - tube.end, tube.plane.normal) } else { own };
                if capped.0 < best.0 {
                    best = capped;
                }
            } else {
                // From the vessel to the outline, with the slopes of both ends kept.
                let (s, ds) = smoothstep(1.0 + z / tube.lead);
                let g = best.1 * (1.0 - s) + own.1 * s + tube.plane.normal * (ds / tube.lead * (own.0 - best.0));
                best = (best.0 * (1.0 - s) + own.0 * s, g);
            }
        }
        best
    }

    fn bounds(&self) -> Aabb {
        self.bounds
    }

    fn resolution(&self) -> f64 {
        self.inner.resolution()
    }
}

/// s and ds/dx of the quintic step from 0 at x = 0 to 1 at x = 1: curvature goes over smoothly too.
fn smoothstep(x: f64) -> (f64, f64) {
    let x = x.clamp(0.0, 1.0);
    (x * x * x * (x * (6.0 * x - 15.0) + 10.0), 30.0 * x * x * (x - 1.0) * (x - 1.0))
}

impl Tube {
    fn new(surface: &dyn Implicit, opening: &Opening, e: &Extension) -> Result<Tube, ExtendError> {
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
        // The centroid first, then the outline as seen from it.
        let mut origin = opening.plane.origin;
        let mut squares = [0.0; RAYS];
        for _ in 0..6 {
            let (mut area, mut moment) = (0.0, Vector::zeros());
            for (n, square) in squares.iter_mut().enumerate() {
                let (s, c) = angle(n).sin_cos();
                let d = u * c + v * s;
                let r = cast(surface, &origin, &d, 4.0 * opening.radius).ok_or_else(no_section)?;
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
        let mean = cosine[0].sqrt();
        let mut tube = Tube {
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
            end: e.length + mean,
        };
        for n in 0..RAYS {
            let (r, ..) = tube.radius(angle(n), 0.0);
            if !(r > 0.2 * mean) {
                return Err(no_section());
            }
            tube.reach = tube.reach.max(r);
        }
        Ok(tube)
    }

    /// In-plane vector from the axis at height z: its length and direction.
    fn local(&self, p: &Point, z: f64) -> (f64, Vector) {
        let q = p - self.plane.origin - self.step * z;
        let n = q.norm();
        (n, if n > 0.0 { q / n } else { self.u })
    }

    fn angle(&self, p: &Point, z: f64) -> f64 {
        let q = p - self.plane.origin - self.step * z;
        self.v.dot(&q).atan2(self.u.dot(&q))
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
fn cast(surface: &dyn Implicit, from: &Point, direction: &Vector, limit: f64) -> Option<f64> {
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

/// Marks the lumen beyond the plane, from the section on.
fn take_off(mask: &Mask, tube: &Tube, opening: &Opening, removed: &mut [bool]) -> Result<(), ExtendError> {
    let diagonal = mask.grid.voxel_diagonal();
    let position = |n: usize| {
        let [i, j, k] = mask.grid.voxel(n);
        mask.grid.to_world(Vector::new(i as f64, j as f64, k as f64))
    };
    let reach = tube.reach + diagonal;
    let place = |n: usize| {
        let p = position(n);
        let z = tube.plane.signed_distance(&p);
        (z, (tube.plane.project(&p) - tube.plane.origin).norm())
    };
    // The plug: the layer before the section, through which nothing may pass.
    let plug = |n: usize| {
        let (z, q) = place(n);
        q < reach && (-2.0 * diagonal..0.0).contains(&z)
    };
    let mut stack: Vec<usize> = Vec::new();
    let mut gone = vec![false; mask.data.len()];
    for n in (0..mask.data.len()).filter(|&n| mask.data[n] != 0) {
        let (z, q) = place(n);
        if q < reach && (0.0..diagonal).contains(&z) {
            gone[n] = true;
            stack.push(n);
        }
    }
    while let Some(n) = stack.pop() {
        let [i, j, k] = mask.grid.voxel(n).map(|c| c as i64);
        for d in 0..27 {
            let [a, b, c] = [d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1];
            let Some(m) = mask.grid.linear(i + a, j + b, k + c) else { continue };
            if mask.data[m] != 0 && !gone[m] && !plug(m) {
                gone[m] = true;
                stack.push(m);
            }
        }
    }
    let behind = (0..gone.len()).filter(|&n| gone[n]).any(|n| {
        let (z, q) = place(n);
        q < tube.reach && (-3.5 * diagonal..-2.0 * diagonal).contains(&z)
    });
    if behind {
        return Err(ExtendError::Ring { name: opening.name.clone(), center: opening.plane.origin.into() });
    }
    for (r, g) in removed.iter_mut().zip(gone) {
        *r |= g;
    }
    Ok(())
}

/// Carries the marks three voxels out into the background: each voxel has the mark of lumen nearest to it.
fn widen(mask: &Mask, removed: &[bool]) -> Vec<bool> {
    let mut mark: Vec<u8> = removed.iter().zip(&mask.data).map(|(&r, &v)| if r { 2 } else { u8::from(v != 0) }).collect();
    let mut front: Vec<usize> = (0..mark.len()).filter(|&n| mark[n] != 0).collect();
    for _ in 0..3 {
        let mut next = Vec::new();
        for &n in &front {
            let [i, j, k] = mask.grid.voxel(n).map(|c| c as i64);
            for d in 0..27 {
                let [a, b, c] = [d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1];
                let Some(m) = mask.grid.linear(i + a, j + b, k + c) else { continue };
                if mark[m] == 0 {
                    mark[m] = mark[n];
                    next.push(m);
                }
            }
        }
        front = next;
    }
    mark.into_iter().map(|m| m == 2).collect()
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
    let branch = &mut lines.branches[b];
    let end = usize::from(branch.samples[i].tangent.dot(&tube.plane.normal) > 0.0);
    if branch.ends[end] != EndKind::Free || branch.samples.len() < 2 {
        return;
    }
    let spacing = branch.length() / (branch.samples.len() - 1) as f64;
    let radius = branch.samples[i].radius;
    let mut points: Vec<(Point, f64)> = branch.samples.iter().map(|s| (s.point, s.radius)).collect();
    let cut = if end == 1 { points.split_off(i).len() } else { points.drain(..=i).count() };
    if cut == 0 {
        return;
    }
    if end == 0 {
        points.reverse();
    }
    while points.last().is_some_and(|(p, _)| tube.plane.signed_distance(p) > -0.5 * spacing) {
        points.pop();
    }
    let stride = tube.step.norm();
    let count = (tube.end * stride / spacing).ceil().max(1.0) as usize;
    for n in 0..=count {
        points.push((tube.plane.origin + tube.step * (tube.end * n as f64 / count as f64), radius));
    }
    if end == 0 {
        points.reverse();
    }
    let mut arc = 0.0;
    branch.samples = (0..points.len())
        .map(|n| {
            if n > 0 {
                arc += (points[n].0 - points[n - 1].0).norm();
            }
            let chord = points[(n + 1).min(points.len() - 1)].0 - points[n.saturating_sub(1)].0;
            let tangent = chord.try_normalize(0.0).unwrap_or(tube.plane.normal);
            Sample { point: points[n].0, radius: points[n].1, tangent, arc_length: arc }
        })
        .collect();
    let node = branch.nodes[end] as usize;
    let tip = if end == 0 { branch.samples[0].point } else { branch.samples[branch.samples.len() - 1].point };
    lines.nodes[node] = tip;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::PatchKind;
    use crate::openings::FoundBy;
    use nalgebra::Matrix3;

    /// An elliptic tube along z with an end at |z| = 12.
    struct Ellipse;

    impl Implicit for Ellipse {
        fn value(&self, p: &Point) -> f64 {
            let q = (p.x / 3.0).hypot(p.y / 2.0);
            (2.4 * (q - 1.0)).max(p.z.abs() - 12.0)
        }
        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            let h = 1e-6;
            let d = |e: Vector| (self.value(&(p + e * h)) - self.value(&(p - e * h))) / (2.0 * h);
            (self.value(p), Vector::new(d(Vector::x()), d(Vector::y()), d(Vector::z())))
        }
        fn bounds(&self) -> Aabb {
            Aabb { min: Point::new(-3.0, -2.0, -12.0), max: Point::new(3.0, 2.0, 12.0) }
        }
        fn resolution(&self) -> f64 {
            0.25
        }
    }

    fn setup() -> (Mask, Opening) {
        let grid = Grid::new([20, 16, 60], [0.5; 3], Point::new(-4.8, -3.8, -14.8), Matrix3::identity()).unwrap();
        let data = (0..grid.len())
            .map(|n| {
                let [i, j, k] = grid.voxel(n).map(|c| c as f64);
                u8::from(Ellipse.value(&grid.to_world(Vector::new(i, j, k))) < 0.0)
            })
            .collect();
        let opening = Opening {
            id: 2,
            name: "inlet".into(),
            kind: PatchKind::Inlet,
            plane: Plane { origin: Point::new(0.3, -0.2, 10.0), normal: Vector::z() },
            radius: 2.0,
            found_by: FoundBy::BluntEnd,
            confidence: 1.0,
            component: 0,
        };
        (Mask::new(grid, data), opening)
    }

    fn extension(transition: Option<f64>, direction: Option<Vector>) -> Extension {
        Extension { opening: "inlet".into(), length: 20.0, transition, direction }
    }

    /// Area and shape (longest by shortest ray) at a height.
    fn area(f: &Extended, center: Point) -> (f64, f64) {
        let rays: Vec<f64> = (0..720)
            .map(|n| {
                let (s, c) = (std::f64::consts::TAU * f64::from(n) / 720.0).sin_cos();
                cast(f, &center, &Vector::new(c, s, 0.0), 9.0).unwrap()
            })
            .collect();
        let (low, high) = rays.iter().fold((f64::INFINITY, 0.0f64), |(l, h), &r| (l.min(r), h.max(r)));
        (rays.iter().map(|r| 0.5 * r * r).sum::<f64>() * std::f64::consts::TAU / 720.0, high / low)
    }

    #[test]
    fn an_extension_keeps_the_area_and_ends_in_a_circle() {
        let (mask, opening) = setup();
        let (f, moved) = Extended::new(&Ellipse, &mask, &[opening], &[extension(Some(8.0), None)]).unwrap();
        assert!((moved[0].plane.origin - Point::new(0.0, 0.0, 30.0)).norm() < 1e-3);
        let exact = std::f64::consts::PI * 6.0;
        for z in [8.0, 9.2, 9.8, 10.0, 10.5, 12.5, 15.0, 20.0, 29.0] {
            let (a, shape) = area(&f, Point::new(0.0, 0.0, z));
            assert!((a / exact - 1.0).abs() < 0.005, "area {a} at {z}");
            if z > 18.0 {
                assert!(shape < 1.001, "{shape}");
            }
        }
        assert!(f.value(&Point::new(0.0, 0.0, 35.0)) > 0.0);
    }

    #[test]
    fn the_gradient_is_the_derivative_of_the_value() {
        let (mask, opening) = setup();
        let slanted = Some(Vector::new(0.3, 0.1, 1.0));
        let (f, _) = Extended::new(&Ellipse, &mask, &[opening], &[extension(Some(8.0), slanted)]).unwrap();
        for p in [[2.1, 0.5, 9.4], [2.6, 0.9, 11.0], [3.4, -1.0, 14.0], [1.9, 2.4, 16.0]] {
            let p = Point::from(p);
            let (_, g) = f.value_gradient(&p);
            let h = 1e-5;
            let d = |e: Vector| (f.value(&(p + e * h)) - f.value(&(p - e * h))) / (2.0 * h);
            let n = Vector::new(d(Vector::x()), d(Vector::y()), d(Vector::z()));
            assert!((g - n).norm() < 2e-3, "{p}: {g} {n}");
        }
    }

    #[test]
    fn what_lies_beyond_the_opening_is_taken_off() {
        let (mask, mut opening) = setup();
        // Cut far from the end and lead aside: the old tube beyond the plane must be gone.
        opening.plane.origin = Point::new(0.0, 0.0, 2.0);
        let aside = Some(Vector::new(1.2, 0.0, 1.0));
        let (f, _) = Extended::new(&Ellipse, &mask, &[opening], &[extension(None, aside)]).unwrap();
        assert!(f.value(&Point::new(0.0, 0.0, 9.0)) > 0.0);
        assert!(f.value(&Point::new(8.4, 0.0, 9.0)) < 0.0);
        assert!(f.value(&Point::new(0.0, 0.0, -3.0)) < 0.0);
    }

    #[test]
    fn an_extension_into_the_vessel_is_refused() {
        let (mask, opening) = setup();
        let back = Some(Vector::new(1.0, 0.0, 0.2));
        let e = Extended::new(&Ellipse, &mask, &[opening.clone()], &[extension(None, back)]);
        assert!(matches!(e.err(), Some(ExtendError::Direction { .. })));
        let other = Extension { opening: "outlet_9".into(), ..extension(None, None) };
        assert!(matches!(Extended::new(&Ellipse, &mask, &[opening], &[other]).err(), Some(ExtendError::Unknown(_))));
    }
}
