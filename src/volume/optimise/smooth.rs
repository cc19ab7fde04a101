//! Vertices move, tetrahedra stay: optimal Delaunay positions for the mean, search for the worst.

use rayon::prelude::*;

use super::cavity::{Base, Cone};
use super::complex::Complex;
use crate::geometry::{Point, Vector};

/// Below this a star's worst quality may not fall for the sake of its mean.
const FLOOR: f64 = 0.45;

/// Rounds over all free vertices: each goes towards the volume-weighted mean of the circumcentres (ODT, Chen 2004)
/// or of the barycentres of its star, where the star's mean quality rises and its worst does not suffer.
pub(super) struct Sweeps {
    /// Vertices of one colour share no tetrahedron and move at the same time.
    colours: Vec<Vec<u32>>,
    /// Whether a vertex is to be tried: not where it stayed and nothing in its star has moved since.
    open: Vec<bool>,
}

impl Sweeps {
    pub fn new(c: &Complex) -> Sweeps {
        Sweeps { colours: colours(c), open: vec![true; c.points.len()] }
    }

    /// One round; gives the number of moves. Scores are not renewed.
    pub fn round(&mut self, c: &mut Complex) -> usize {
        let mut moves = 0;
        for class in &self.colours {
            let open = &self.open;
            let places: Vec<Option<Point>> = class
                .par_iter()
                .with_min_len(256)
                .map_init(Vec::new, |bases, &v| if open[v as usize] { better_place(c, v, bases) } else { None })
                .collect();
            for (&v, place) in class.iter().zip(places) {
                self.open[v as usize] = place.is_some();
                let Some(p) = place else { continue };
                c.points[v as usize] = p;
                moves += 1;
                for &t in &c.stars[v as usize] {
                    c.tets[t as usize].iter().for_each(|&w| self.open[w as usize] = true);
                }
            }
        }
        moves
    }
}

/// Free vertices in classes without common tetrahedra, greedily in order of their ids.
fn colours(c: &Complex) -> Vec<Vec<u32>> {
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

/// Moves one free vertex as [`Sweeps`] do.
pub(super) fn improve_mean(c: &mut Complex, v: u32, bases: &mut Vec<Base>) {
    if !c.frozen[v as usize]
        && !c.stars[v as usize].is_empty()
        && let Some(p) = better_place(c, v, bases)
    {
        c.set_point(v, p);
    }
}

/// The triangles across from `v` in its star, each positive with `v`.
fn bases(c: &Complex, v: u32, into: &mut Vec<Base>) {
    into.clear();
    into.extend(c.stars[v as usize].iter().map(|&t| {
        let [w, x, y, z] = c.tets[t as usize];
        // Face i of a tetrahedron turned inwards.
        let base = match v {
            _ if v == w => [x, z, y],
            _ if v == x => [w, y, z],
            _ if v == y => [w, z, x],
            _ => [w, x, y],
        };
        Base::new(base.map(|u| c.points[u as usize]))
    }));
}

fn better_place(c: &Complex, v: u32, bases: &mut Vec<Base>) -> Option<Point> {
    self::bases(c, v, bases);
    let here = c.points[v as usize];
    let (mut odt, mut cpt, mut volume) = (Vector::zeros(), Vector::zeros(), 0.0);
    let (mut sum, mut worst) = (0.0, f64::INFINITY);
    for base in bases.iter() {
        let (six, twice) = base.circumcentre6(&here);
        let q = base.shape_of(&here, six, &twice, 0.0);
        sum += q;
        worst = worst.min(q);
        let centre = (base.sum() + here.coords) / 4.0;
        cpt += centre * six;
        // A flat tetrahedron's circumcentre lies anywhere: its barycentre stands in.
        odt += if q > 0.05 { base.corners()[0].coords * six + twice / 2.0 } else { centre * six };
        volume += six;
    }
    if volume <= 0.0 {
        return None;
    }
    let floor = worst.min(FLOOR);
    // What is below the floor need not be known any better.
    let least = floor * (1.0 - 1e-12);
    let n = bases.len() as f64;
    let mut top = sum + 1e-4 * n;
    let mut best = None;
    // Half a step where a whole one is not better.
    for step in [1.0, 0.5] {
        for target in [odt / volume, cpt / volume] {
            let p = here + (Point::from(target) - here) * step;
            let mut left = n;
            let mut s = 0.0;
            for base in bases.iter() {
                let q = base.shape(&p, least);
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

/// Where the worst score of a free vertex's star is better, if there is such a place.
pub(super) fn relax(c: &Complex, v: u32) -> Option<Point> {
    if c.frozen[v as usize] {
        return None;
    }
    let star = &c.stars[v as usize];
    let old = c.worst(star);
    let here = c.points[v as usize];
    let mut shortest = f64::INFINITY;
    let mut centre = Vector::zeros();
    let mut cone = Cone::new(Vec::with_capacity(star.len()));
    bases(c, v, &mut cone.bases);
    for base in &cone.bases {
        centre += base.sum();
        shortest = base.corners().iter().map(|p| (p - here).norm()).fold(shortest, f64::min);
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
    (q > old + 1e-6).then_some(p)
}
