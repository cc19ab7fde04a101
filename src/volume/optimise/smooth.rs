//! Vertices move, tetrahedra stay: optimal Delaunay positions for the mean, search for the worst.

use rayon::prelude::*;

use super::cavity::Cone;
use super::complex::{Complex, faces};
use super::quality::{shape, volume6};
use crate::geometry::{Point, Vector};

/// Below this a star's worst quality may not fall for the sake of its mean.
const FLOOR: f64 = 0.45;

/// One round over all free vertices: each goes towards the volume-weighted mean of the circumcentres (ODT, Chen 2004)
/// or of the barycentres of its star, where the star's mean quality rises and its worst does not suffer.
/// Vertices of one colour share no tetrahedron and move at the same time. Gives the number of moves.
pub(super) fn sweep(c: &mut Complex, colours: &[Vec<u32>]) -> usize {
    let mut moves = 0;
    for class in colours {
        let moved: Vec<(u32, Point)> = class
            .par_iter()
            .with_min_len(256)
            .filter_map(|&v| better_place(c, v).map(|p| (v, p)))
            .collect();
        moves += moved.len();
        for (v, p) in moved {
            c.points[v as usize] = p;
        }
    }
    moves
}

/// Free vertices in classes without common tetrahedra, greedily in order of their ids.
pub(super) fn colours(c: &Complex) -> Vec<Vec<u32>> {
    let mut colour = vec![u8::MAX; c.points.len()];
    let mut classes: Vec<Vec<u32>> = vec![];
    for v in 0..c.points.len() {
        if c.frozen[v] || c.stars[v].is_empty() {
            continue;
        }
        let mut taken = 0u128;
        for &t in &c.stars[v] {
            for w in c.tets[t as usize] {
                let k = colour[w as usize];
                if k < 127 {
                    taken |= 1 << k;
                }
            }
        }
        let k = (!taken).trailing_zeros() as usize;
        if k >= 127 {
            continue;
        }
        colour[v] = k as u8;
        if classes.len() <= k {
            classes.resize(k + 1, vec![]);
        }
        classes[k].push(v as u32);
    }
    classes
}

/// Moves one free vertex as [`sweep`] does.
pub(super) fn improve_mean(c: &mut Complex, v: u32) {
    if !c.frozen[v as usize]
        && !c.stars[v as usize].is_empty()
        && let Some(p) = better_place(c, v)
    {
        c.set_point(v, p);
    }
}

fn better_place(c: &Complex, v: u32) -> Option<Point> {
    let star = &c.stars[v as usize];
    let here = c.points[v as usize];
    let (mut odt, mut cpt, mut volume) = (Vector::zeros(), Vector::zeros(), 0.0);
    let (mut sum, mut worst) = (0.0, f64::INFINITY);
    for &t in star {
        let p = c.corners(c.tets[t as usize]);
        let six = volume6(&p);
        let q = shape(&p);
        sum += q;
        worst = worst.min(q);
        let centre = (p[0].coords + p[1].coords + p[2].coords + p[3].coords) / 4.0;
        cpt += centre * six;
        // A flat tetrahedron's circumcentre lies anywhere: its barycentre stands in.
        odt += circumcentre(&p, six).filter(|_| q > 0.05).unwrap_or(centre) * six;
        volume += six;
    }
    if volume <= 0.0 {
        return None;
    }
    let floor = worst.min(FLOOR);
    let mut top = sum + 1e-4 * star.len() as f64;
    let mut best = None;
    // Half a step where a whole one is not better.
    for step in [1.0, 0.5] {
        for target in [odt / volume, cpt / volume] {
            let p = here + (Point::from(target) - here) * step;
            let mut left = star.len() as f64;
            let mut s = 0.0;
            for &t in star {
                let x = c.tets[t as usize].map(|w| if w == v { p } else { c.points[w as usize] });
                let q = shape(&x);
                s += q;
                left -= 1.0;
                if q < floor || q <= 0.0 || s + left <= top {
                    s = 0.0;
                    break;
                }
            }
            if s > top {
                top = s;
                best = Some(p);
            }
        }
        if best.is_some() {
            break;
        }
    }
    best
}

fn circumcentre(p: &[Point; 4], six: f64) -> Option<Vector> {
    let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
    let v = b.cross(&c) * a.norm_squared() + c.cross(&a) * b.norm_squared() + a.cross(&b) * c.norm_squared();
    (six > 0.0).then(|| p[0].coords + v / (2.0 * six))
}

/// Moves one free vertex to where the worst score of its star is better, if there is such a place.
pub(super) fn relax(c: &mut Complex, v: u32) -> bool {
    if c.frozen[v as usize] {
        return false;
    }
    let star = &c.stars[v as usize];
    let old = c.worst(star);
    let here = c.points[v as usize];
    let mut shortest = f64::INFINITY;
    let mut centre = Vector::zeros();
    let mut cone = Cone { bases: Vec::with_capacity(star.len()) };
    for &t in star {
        let t = c.tets[t as usize];
        let Some(i) = t.iter().position(|&w| w == v) else { continue };
        // Across from v, seen so that v makes a positive tetrahedron.
        let base = faces(t)[i].map(|w| c.points[w as usize]);
        for p in base {
            shortest = shortest.min((p - here).norm());
            centre += p.coords;
        }
        cone.bases.push([base[0], base[2], base[1]]);
    }
    centre /= 3.0 * cone.bases.len() as f64;
    let (mut start, mut value) = (here, cone.worst(&here, f64::NEG_INFINITY));
    for step in [1.0, 0.5] {
        let p = here + (Point::from(centre) - here) * step;
        let w = cone.worst(&p, value);
        if w > value {
            (start, value) = (p, w);
            break;
        }
    }
    let (p, q) = cone.climb(start, value, shortest);
    // A score held down by two faces on the surface does not rise by moving: their vertices are frozen anyway.
    if q <= old + 1e-6 {
        return false;
    }
    c.set_point(v, p);
    true
}
