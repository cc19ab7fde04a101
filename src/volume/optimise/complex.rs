//! Tetrahedra that can be exchanged locally: each vertex knows its tetrahedra, each tetrahedron its quality.

use rayon::prelude::*;

use super::quality::shape;
use crate::geometry::Point;

const DEAD: u32 = u32::MAX;

/// Two faces on the surface leave a cell two inner faces, and OpenFOAM's determinant is 0: it counts as this bad at
/// best while others are improved too,
const TWO_FACES: f64 = 0.2;
/// and as this part of its shape when it is to go at any price.
const TWO_FACES_STRICT: f64 = 1e-3;

/// Tetrahedra that are to take the place of others.
pub(super) struct Exchange {
    pub old: Vec<u32>,
    /// Corners; [`Exchange::APEX`] stands for a vertex that is new.
    pub new: Vec<[u32; 4]>,
    /// The new vertex.
    pub apex: Option<Point>,
}

impl Exchange {
    pub const APEX: u32 = DEAD;
}

#[derive(Clone)]
pub(super) struct Complex {
    pub points: Vec<Point>,
    pub tets: Vec<[u32; 4]>,
    /// Quality of each tetrahedron as [`Complex::score`] gives it.
    pub scores: Vec<f64>,
    /// Tetrahedra of each vertex.
    pub stars: Vec<Vec<u32>>,
    /// Whether a vertex may not move.
    pub frozen: Vec<bool>,
    /// Whether tetrahedra with two faces on the surface are worse than any other.
    pub strict: bool,
    /// Faces on the surface, sorted; those of one least vertex follow each other from `surface_from` of it on.
    surface: Vec<[u32; 3]>,
    surface_from: Vec<u32>,
    /// Number of changes so far, and at each vertex the last one in its star.
    changes: u32,
    touched: Vec<u32>,
    free: Vec<u32>,
}

pub(super) fn sorted(mut f: [u32; 3]) -> [u32; 3] {
    f.sort_unstable();
    f
}

/// The faces of a positive tetrahedron, counter-clockwise seen from outside; face i is across from vertex i.
pub(super) fn faces([a, b, c, d]: [u32; 4]) -> [[u32; 3]; 4] {
    [[b, c, d], [a, d, c], [a, b, d], [a, c, b]]
}

impl Complex {
    /// Takes over points and tetrahedra; `boundary` are the triangles to keep; points from `fixed` on are free.
    pub fn new(points: Vec<Point>, tets: Vec<[u32; 4]>, boundary: impl Iterator<Item = [u32; 3]>) -> Complex {
        let mut frozen = vec![false; points.len()];
        let mut surface = Vec::new();
        for f in boundary {
            f.iter().for_each(|&v| frozen[v as usize] = true);
            surface.push(sorted(f));
        }
        let mut count = vec![0u32; points.len()];
        tets.iter().flatten().for_each(|&v| count[v as usize] += 1);
        let mut stars: Vec<Vec<u32>> = count.iter().map(|&n| Vec::with_capacity(n as usize + 2)).collect();
        for (t, c) in tets.iter().enumerate() {
            c.iter().for_each(|&v| stars[v as usize].push(t as u32));
        }
        surface.sort_unstable();
        let mut surface_from = vec![0u32; points.len() + 1];
        surface.iter().for_each(|f| surface_from[f[0] as usize + 1] += 1);
        for v in 0..points.len() {
            surface_from[v + 1] += surface_from[v];
        }
        let mut c = Complex { points, tets, scores: vec![], stars, frozen, strict: false, surface, surface_from, changes: 0, touched: vec![], free: vec![] };
        c.touched = vec![0; c.points.len()];
        c.rescore();
        c
    }

    /// Computes all scores anew.
    pub fn rescore(&mut self) {
        self.scores =
            self.tets.par_iter().map(|&t| if t[0] == DEAD { f64::INFINITY } else { self.score(t) }).collect();
    }

    #[inline]
    pub fn alive(&self, t: u32) -> bool {
        self.tets[t as usize][0] != DEAD
    }

    #[inline]
    pub fn corners(&self, t: [u32; 4]) -> [Point; 4] {
        t.map(|v| self.points[v as usize])
    }

    /// Number of faces of `t` on the surface.
    pub fn surface_faces(&self, t: [u32; 4]) -> usize {
        faces(t).into_iter().filter(|&f| self.is_surface(f)).count()
    }

    pub fn is_surface(&self, f: [u32; 3]) -> bool {
        if !f.iter().all(|&v| self.frozen[v as usize]) {
            return false;
        }
        let f = sorted(f);
        let v = f[0] as usize;
        // Vertices added since are free, but an id may lie beyond the table all the same.
        let range = self.surface_from.get(v).zip(self.surface_from.get(v + 1));
        range.is_some_and(|(&a, &b)| self.surface[a as usize..b as usize].contains(&f))
    }

    /// Shape, held down for cells with two faces on the surface.
    #[inline]
    pub fn score(&self, t: [u32; 4]) -> f64 {
        let q = shape(&self.corners(t));
        if q > 0.0 && self.is_wedge(t) {
            return if self.strict { TWO_FACES_STRICT * q } else { q.min(TWO_FACES) };
        }
        q
    }

    /// Whether `t` has two or more faces on the surface.
    #[inline]
    pub fn is_wedge(&self, t: [u32; 4]) -> bool {
        t.iter().all(|&v| self.frozen[v as usize]) && self.surface_faces(t) > 1
    }

    /// The tetrahedron on the other side of face `f` of `t`.
    pub fn across(&self, t: u32, f: [u32; 3]) -> Option<u32> {
        let least = f.into_iter().min_by_key(|&v| self.stars[v as usize].len())?;
        self.stars[least as usize].iter().copied().find(|&o| {
            o != t && f.iter().all(|v| self.tets[o as usize].contains(v))
        })
    }

    /// The tetrahedra round edge ab and the ring of vertices round it, right-handed about a→b; `None` where the
    /// edge lies on the surface or its ring is longer than `most`.
    pub fn ring(&self, a: u32, b: u32, most: usize) -> Option<(Vec<u32>, Vec<u32>)> {
        let mut star = Vec::with_capacity(8);
        let mut steps: Vec<(u32, u32)> = Vec::with_capacity(8);
        for &t in &self.stars[a as usize] {
            let c = self.tets[t as usize];
            if !c.contains(&b) {
                continue;
            }
            star.push(t);
            if star.len() > most {
                return None;
            }
            steps.push(self.opposite_edge(c, a, b)?);
        }
        let first = steps.first()?.0;
        let mut ring = vec![first];
        loop {
            let last = *ring.last()?;
            let next = steps.iter().find(|s| s.0 == last)?.1;
            if next == first {
                break;
            }
            ring.push(next);
            if ring.len() > steps.len() {
                return None;
            }
        }
        (ring.len() == steps.len() && ring.len() > 2).then_some((star, ring))
    }

    /// The other two vertices (c, d) of `t`, so that (a, b, c, d) is positive.
    pub fn opposite_edge(&self, t: [u32; 4], a: u32, b: u32) -> Option<(u32, u32)> {
        let i = t.iter().position(|&v| v == a)?;
        let j = t.iter().position(|&v| v == b)?;
        let mut rest = (0..4).filter(|&k| k != i && k != j);
        let (k, l) = (rest.next()?, rest.next()?);
        let even = is_even([i, j, k, l]);
        Some(if even { (t[k], t[l]) } else { (t[l], t[k]) })
    }

    /// Number of changes so far: what was tried at that time fails again while [`Complex::last_change`] is not later.
    pub fn now(&self) -> u32 {
        self.changes
    }

    /// The last change at the vertices of `t`.
    pub fn last_change(&self, t: u32) -> u32 {
        self.tets[t as usize].map(|v| self.touched[v as usize]).into_iter().fold(0, u32::max)
    }

    /// Whether nothing has changed at `vertices` since [`Complex::now`] was `then`.
    pub fn is_as_at(&self, then: u32, vertices: &[u32]) -> bool {
        vertices.iter().all(|&v| self.touched[v as usize] <= then)
    }

    /// Makes an exchange.
    pub fn make(&mut self, exchange: Exchange) {
        let Exchange { old, mut new, apex } = exchange;
        if let Some(p) = apex {
            let v = self.add_point(p);
            new.iter_mut().flatten().filter(|w| **w == Exchange::APEX).for_each(|w| *w = v);
        }
        self.replace(&old, &new);
    }

    /// Exchanges tetrahedra.
    pub fn replace(&mut self, old: &[u32], new: &[[u32; 4]]) {
        self.changes += 1;
        for &t in old {
            for v in self.tets[t as usize] {
                self.touched[v as usize] = self.changes;
                let star = &mut self.stars[v as usize];
                if let Some(i) = star.iter().position(|&x| x == t) {
                    star.swap_remove(i);
                }
            }
            self.tets[t as usize] = [DEAD; 4];
            self.scores[t as usize] = f64::INFINITY;
            self.free.push(t);
        }
        for &c in new {
            let score = self.score(c);
            let t = match self.free.pop() {
                Some(t) => {
                    self.tets[t as usize] = c;
                    self.scores[t as usize] = score;
                    t
                }
                None => {
                    self.tets.push(c);
                    self.scores.push(score);
                    self.tets.len() as u32 - 1
                }
            };
            for v in c {
                self.touched[v as usize] = self.changes;
                self.stars[v as usize].push(t);
            }
        }
    }

    /// Adds a free vertex.
    pub fn add_point(&mut self, p: Point) -> u32 {
        self.points.push(p);
        self.stars.push(Vec::with_capacity(16));
        self.frozen.push(false);
        self.touched.push(0);
        self.points.len() as u32 - 1
    }

    /// Moves a vertex.
    pub fn set_point(&mut self, v: u32, p: Point) {
        self.points[v as usize] = p;
        self.changes += 1;
        for i in 0..self.stars[v as usize].len() {
            let t = self.stars[v as usize][i] as usize;
            self.scores[t] = self.score(self.tets[t]);
            self.tets[t].iter().for_each(|&w| self.touched[w as usize] = self.changes);
        }
    }

    /// Least score of some tetrahedra.
    #[inline]
    pub fn worst(&self, tets: &[u32]) -> f64 {
        tets.iter().map(|&t| self.scores[t as usize]).fold(f64::INFINITY, f64::min)
    }

    /// Points and tetrahedra without the dead ones and without unused free vertices; frozen points keep their ids.
    pub fn finish(self) -> (Vec<Point>, Vec<[u32; 4]>) {
        let mut new_id = vec![DEAD; self.points.len()];
        let mut points = Vec::with_capacity(self.points.len());
        for (v, p) in self.points.iter().enumerate() {
            if self.frozen[v] || !self.stars[v].is_empty() {
                new_id[v] = points.len() as u32;
                points.push(*p);
            }
        }
        let tets =
            self.tets.iter().filter(|t| t[0] != DEAD).map(|t| t.map(|v| new_id[v as usize])).collect();
        (points, tets)
    }
}

fn is_even(p: [usize; 4]) -> bool {
    let mut swaps = 0;
    for i in 0..4 {
        for j in 0..i {
            swaps += usize::from(p[j] > p[i]);
        }
    }
    swaps % 2 == 0
}
