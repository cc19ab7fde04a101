//! Exchanges that fill a cavity with a cone: contraction of an edge, insertion of a vertex. Each is proposed, not made.

use super::complex::{Complex, Exchange, faces, sorted};
use super::quality::{angles_of, has_poor_angles, quality_of, shape, volume6};
use crate::geometry::{Point, Vector};
use crate::volume::search::DIRECTIONS;

/// Contracts an edge of `t` onto its other end where its free end `v` disappears and the worst score rises.
pub(super) fn contract(c: &Complex, t: u32) -> Option<Exchange> {
    let corners = c.tets[t as usize];
    for v in corners.into_iter().filter(|&v| !c.frozen[v as usize]) {
        let star = &c.stars[v as usize];
        let old = c.worst(star);
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
            let volume = new.iter().map(|&n| volume6(&c.corners(n))).sum();
            if fills(c, star, volume) && new.iter().all(|&n| c.score(n) > old) {
                return Some(Exchange { old: star.clone(), new, apex: None });
            }
        }
    }
    None
}

/// Inserts a vertex into the tetrahedra round an edge of `t`, or into `t` and its neighbours, and moves it to
/// where the worst score is best; proposed where that is better than before, and than `floor`.
pub(super) fn insert(c: &Complex, t: u32, floor: f64) -> Option<Exchange> {
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
    let (_, p, cavity, shell) = best?;
    let volume = shell.iter().map(|&[x, y, z]| -volume6(&[p, c.points[x as usize], c.points[z as usize], c.points[y as usize]])).sum();
    let new = shell.iter().map(|&[x, y, z]| [x, z, y, Exchange::APEX]).collect();
    fills(c, &cavity, volume).then_some(Exchange { old: cavity, new, apex: Some(p) })
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

/// Whether tetrahedra of the given volume (six times it) fill the space of the old ones.
fn fills(c: &Complex, old: &[u32], volume: f64) -> bool {
    let before: f64 = old.iter().map(|&t| volume6(&c.corners(c.tets[t as usize]))).sum();
    (before - volume).abs() <= 1e-9 * before
}

/// The place for the apex of a cone over `shell` with the best worst shape, found from `start` by steps in
/// fourteen directions.
fn best_apex(c: &Complex, shell: &[[u32; 3]], start: Point) -> (Point, f64) {
    let corners: Vec<[Point; 3]> = shell.iter().map(|f| f.map(|v| c.points[v as usize])).collect();
    let shortest = corners
        .iter()
        .flat_map(|[a, b, d]| [(a - b).norm(), (b - d).norm(), (d - a).norm()])
        .fold(f64::INFINITY, f64::min);
    let mut cone = Cone::new(corners.iter().map(|[x, y, z]| Base::new([*x, *z, *y])).collect());
    let value = cone.worst(&start, f64::NEG_INFINITY);
    cone.climb(start, value, shortest)
}

/// A triangle under an apex, with what the shape needs of it.
pub(super) struct Base {
    corners: [Point; 3],
    /// Normal, twice as long as the triangle is large.
    normal: Vector,
    /// a |b|² − b |a|² with a, b the edges at the first corner.
    turn: Vector,
}

impl Base {
    /// The triangle `corners`, positive with an apex inside.
    #[inline]
    pub fn new(corners: [Point; 3]) -> Base {
        let (a, b) = (corners[1] - corners[0], corners[2] - corners[0]);
        Base { corners, normal: a.cross(&b), turn: a * b.norm_squared() - b * a.norm_squared() }
    }

    /// Six times the volume with the apex at `p`, and 2 (centre − first corner) times that.
    #[inline]
    pub fn circumcentre6(&self, p: &Point) -> (f64, Vector) {
        let d = p - self.corners[0];
        (self.normal.dot(&d), self.normal * d.norm_squared() + d.cross(&self.turn))
    }

    /// The shape with the apex at `p`; where that is not above `floor`, some number that is not.
    #[inline]
    pub fn shape(&self, p: &Point, floor: f64) -> f64 {
        let (six, v) = self.circumcentre6(p);
        self.shape_of(p, six, &v, floor)
    }

    /// As [`Base::shape`], where [`Base::circumcentre6`] is known.
    #[inline]
    pub fn shape_of(&self, p: &Point, six: f64, v: &Vector, floor: f64) -> f64 {
        let q = quality_of(six, v.norm_squared());
        // The angles are the dearer part.
        if q <= floor || !has_poor_angles(q) { q } else { q.min(self.angles(p)) }
    }

    /// The part of the shape that is for the dihedral angles, with the apex at `p`.
    #[inline]
    fn angles(&self, p: &Point) -> f64 {
        let [x, y, z] = self.corners;
        angles_of(self.normal, (z - x).cross(&(p - x)), (p - x).cross(&(y - x)))
    }

    /// Sum of the corners.
    #[inline]
    pub fn sum(&self) -> Vector {
        self.corners[0].coords + self.corners[1].coords + self.corners[2].coords
    }

    /// The corners of the triangle.
    pub fn corners(&self) -> &[Point; 3] {
        &self.corners
    }
}

/// Tetrahedra with a common apex that is looked for.
pub(super) struct Cone {
    pub bases: Vec<Base>,
    /// Scratch: which bases' angles are to be looked at.
    angles_due: Vec<u32>,
}

impl Cone {
    pub fn new(bases: Vec<Base>) -> Cone {
        Cone { bases, angles_due: vec![] }
    }

    /// The worst shape with the apex at `p`; where that is not above `floor`, some shape that is not.
    pub fn worst(&mut self, p: &Point, floor: f64) -> f64 {
        // What refused the last place refuses the next ones too, most likely: it is asked first, and by all measures; of
        // the others the angles, the dearer part, are asked for where nothing else refuses.
        let Some(front) = self.bases.first() else { return f64::INFINITY };
        let mut w = front.shape(p, floor);
        if w <= floor {
            return w;
        }
        self.angles_due.clear();
        for i in 1..self.bases.len() {
            let (six, v) = self.bases[i].circumcentre6(p);
            let q = quality_of(six, v.norm_squared());
            if q <= floor {
                self.bases.swap(0, i);
                return q;
            }
            w = w.min(q);
            if has_poor_angles(q) {
                self.angles_due.push(i as u32);
            }
        }
        for n in 0..self.angles_due.len() {
            let i = self.angles_due[n] as usize;
            w = w.min(self.bases[i].angles(p));
            if w <= floor {
                self.bases.swap(0, i);
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
                    let x = p + Vector::from(d) * (radius * length);
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
