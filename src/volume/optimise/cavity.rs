//! Exchanges that fill a cavity with a cone: contraction of an edge, insertion of a vertex.

use super::complex::{Complex, faces, sorted};
use super::quality::{shape, volume6};
use crate::geometry::{Point, Vector};

/// Contracts an edge of `t` onto its other end where its free end `v` disappears and the worst score rises.
pub(super) fn contract(c: &mut Complex, t: u32) -> bool {
    let corners = c.tets[t as usize];
    for v in corners.into_iter().filter(|&v| !c.frozen[v as usize]) {
        let star = c.stars[v as usize].clone();
        let old = c.worst(&star);
        for w in corners.into_iter().filter(|&w| w != v) {
            let new: Vec<[u32; 4]> = star
                .iter()
                .map(|&s| c.tets[s as usize])
                .filter(|s| !s.contains(&w))
                .map(|s| s.map(|x| if x == v { w } else { x }))
                .collect();
            if new.is_empty() || new.iter().any(|&n| shape(&c.corners(n)) <= old.max(0.0)) {
                continue;
            }
            if fills(c, &star, &new) && new.iter().all(|&n| c.score(n) > old) {
                c.replace(&star, &new);
                return true;
            }
        }
    }
    false
}

/// Inserts a vertex into the tetrahedra round an edge of `t`, or into `t` and its neighbours, and moves it to
/// where the worst score is best; kept where that is better than before, and than `floor`.
pub(super) fn insert(c: &mut Complex, t: u32, floor: f64) -> bool {
    let corners = c.tets[t as usize];
    let mut cavities: Vec<Vec<u32>> = vec![];
    for i in 0..4 {
        for j in 0..i {
            if let Some((star, _)) = c.ring(corners[i], corners[j], 10) {
                cavities.push(star);
            }
        }
    }
    let near: Vec<u32> =
        faces(corners).into_iter().filter(|&f| !c.is_surface(f)).filter_map(|f| c.across(t, f)).collect();
    for skip in 0..=near.len() {
        let mut cavity = vec![t];
        cavity.extend(near.iter().enumerate().filter(|(i, _)| *i != skip).map(|(_, &o)| o));
        cavities.push(cavity);
    }
    cavities.extend(near.iter().map(|&o| vec![t, o]));
    cavities.push(vec![t]);
    let mut start = None;
    if c.surface_faces(corners) > 1 {
        start = wedge(c, corners);
        // A vertex across from a face takes the tetrahedron into its star and moves: no vertex more.
        for &o in &near {
            let Some(&x) = c.tets[o as usize].iter().find(|x| !corners.contains(x)) else { continue };
            if !c.frozen[x as usize] {
                let mut cavity = c.stars[x as usize].clone();
                cavity.push(t);
                cavities.push(cavity);
            }
        }
        // Wedged into a rim: more room is needed for a vertex with a view of all faces.
        let mut wide = vec![t];
        wide.extend(&near);
        for o in wide.clone() {
            for f in faces(c.tets[o as usize]) {
                if !c.is_surface(f) {
                    wide.extend(c.across(o, f));
                }
            }
        }
        wide.sort_unstable();
        wide.dedup();
        for i in 0..wide.len() {
            if wide[i] != t && !near.contains(&wide[i]) {
                let mut cavity = vec![t];
                cavity.extend(&near);
                cavity.push(wide[i]);
                cavities.push(cavity);
            }
        }
        cavities.push(wide);
    }
    let mut best: Option<(f64, Point, Vec<u32>, Vec<[u32; 3]>)> = None;
    for cavity in cavities {
        let old = c.worst(&cavity).max(best.as_ref().map_or(floor, |b| b.0));
        let shell = shell(c, &cavity);
        let middle = cavity
            .iter()
            .map(|&s| c.corners(c.tets[s as usize]).iter().map(|p| p.coords).sum::<Vector>() / 4.0)
            .sum::<Vector>()
            / cavity.len() as f64;
        let middle = Point::from(middle);
        let (p, q) = std::iter::once(middle)
            .chain(start)
            .map(|p| best_apex(c, &shell, p))
            .fold((middle, f64::NEG_INFINITY), |a, b| if b.1 > a.1 { b } else { a });
        if q > old + 1e-3 {
            best = Some((q, p, cavity, shell));
        }
    }
    let Some((_, p, cavity, shell)) = best else { return false };
    let v = c.add_point(p);
    let new: Vec<[u32; 4]> = shell.iter().map(|&[x, y, z]| [x, z, y, v]).collect();
    if !fills(c, &cavity, &new) {
        // The vertex stays unused and is dropped at the end.
        return false;
    }
    c.replace(&cavity, &new);
    true
}

/// Where a vertex sees both surface faces of a tetrahedron best: from the middle of their edge along the bisector.
fn wedge(c: &Complex, corners: [u32; 4]) -> Option<Point> {
    let on: Vec<[u32; 3]> = faces(corners).into_iter().filter(|&f| c.is_surface(f)).collect();
    let [f, g] = *on.first_chunk::<2>()?;
    let p = |v: u32| c.points[v as usize];
    let normal = |f: [u32; 3]| (p(f[1]) - p(f[0])).cross(&(p(f[2]) - p(f[0]))).try_normalize(0.0);
    let ends: Vec<Point> = f.iter().filter(|v| g.contains(v)).map(|&v| p(v)).collect();
    let [a, b] = *ends.first_chunk::<2>()?;
    let inwards = -(normal(f)? + normal(g)?).try_normalize(0.1)?;
    Some(nalgebra::center(&a, &b) + inwards * (0.7 * (a - b).norm()))
}

/// Faces of a set of tetrahedra that belong to one of them only, counter-clockwise seen from outside.
fn shell(c: &Complex, cavity: &[u32]) -> Vec<[u32; 3]> {
    let mut all: Vec<([u32; 3], [u32; 3])> =
        cavity.iter().flat_map(|&t| faces(c.tets[t as usize])).map(|f| (sorted(f), f)).collect();
    all.sort_unstable();
    all.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() == 1).map(|g| g[0].1).collect()
}

/// Whether new tetrahedra fill the space of the old ones.
fn fills(c: &Complex, old: &[u32], new: &[[u32; 4]]) -> bool {
    let before: f64 = old.iter().map(|&t| volume6(&c.corners(c.tets[t as usize]))).sum();
    let after: f64 = new.iter().map(|&t| volume6(&c.corners(t))).sum();
    (before - after).abs() <= 1e-9 * before
}

/// The place for the apex of a cone over `shell` with the best worst shape, found from `start` by steps in
/// fourteen directions.
fn best_apex(c: &Complex, shell: &[[u32; 3]], start: Point) -> (Point, f64) {
    let corners: Vec<[Point; 3]> = shell.iter().map(|f| f.map(|v| c.points[v as usize])).collect();
    let shortest = corners
        .iter()
        .flat_map(|[a, b, d]| [(a - b).norm(), (b - d).norm(), (d - a).norm()])
        .fold(f64::INFINITY, f64::min);
    let mut cone = Cone { bases: corners.iter().map(|[x, y, z]| [*x, *z, *y]).collect() };
    let value = cone.worst(&start, f64::NEG_INFINITY);
    cone.climb(start, value, shortest)
}

/// Tetrahedra with a common apex that is looked for.
pub(super) struct Cone {
    /// Triangles; each is positive with an apex inside.
    pub bases: Vec<[Point; 3]>,
}

impl Cone {
    /// The worst shape with the apex at `p`; where that is not above `floor`, some shape that is not.
    pub fn worst(&mut self, p: &Point, floor: f64) -> f64 {
        let mut w = f64::INFINITY;
        for i in 0..self.bases.len() {
            let [x, y, z] = self.bases[i];
            w = w.min(shape(&[x, y, z, *p]));
            if w <= floor {
                // What refuses one place refuses the next ones too, most likely: it is asked first from now on.
                self.bases[..=i].rotate_right(1);
                break;
            }
        }
        w
    }

    /// Climbs from `start`, where the worst shape is `value`, by steps of falling length.
    pub fn climb(&mut self, start: Point, value: f64, length: f64) -> (Point, f64) {
        let (mut p, mut q) = (start, value);
        for radius in [0.3, 0.12, 0.05, 0.02] {
            for _ in 0..4 {
                let mut moved = false;
                for d in DIRECTIONS {
                    let x = p + Vector::new(d[0], d[1], d[2]) * (radius * length);
                    let w = self.worst(&x, q);
                    if w > q {
                        (p, q, moved) = (x, w, true);
                    }
                }
                if !moved {
                    break;
                }
            }
        }
        (p, q)
    }
}

const D: f64 = 0.577_350_269_189_625_8;
const DIRECTIONS: [[f64; 3]; 14] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
    [D, D, D],
    [-D, -D, -D],
    [D, D, -D],
    [-D, -D, D],
    [D, -D, D],
    [-D, D, -D],
    [-D, D, D],
    [D, -D, -D],
];
