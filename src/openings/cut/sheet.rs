//! A closed surface that is cut in place: work and memory of a cut are those of what it changes, so that a tree of
//! hundreds of ends is cut in the time of one.

use std::collections::{BTreeMap, BTreeSet};

use super::super::{Error, FoundBy, Opening};
use crate::geometry::{Plane, Point, Vector};
use crate::mesh::{Patch, PatchId, TriMesh, WALL};
use crate::remesh::{SizeField, Supports};

/// A crossed edge, lower vertex first, or a vertex in the plane, twice.
type Element = [u32; 2];

/// Which side of the cuts a vertex is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Kept,
    Rim,
    Beyond,
}

/// What one cut did.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Done {
    /// Vertices moved into a plane.
    pub snapped: usize,
    /// Edges divided.
    pub divided: usize,
    /// Triangles taken away or divided.
    pub removed: usize,
}

/// A surface with the triangles at each vertex.
#[derive(Debug, Clone)]
pub(super) struct Sheet {
    points: Vec<Point>,
    /// Those taken away stay, without a fan that names them.
    triangles: Vec<[u32; 3]>,
    patch: Vec<PatchId>,
    patches: Vec<Patch>,
    gone: Vec<bool>,
    /// Triangles at each vertex.
    fans: Vec<Vec<u32>>,
}

/// A plane and the vertices that were moved into it, with the places where they were.
struct Section<'a> {
    opening: &'a Opening,
    snapped: BTreeMap<u32, Point>,
}

impl Section<'_> {
    fn plane(&self) -> &Plane {
        &self.opening.plane
    }

    fn distance(&self, points: &[Point], v: u32) -> f64 {
        if self.snapped.contains_key(&v) { 0.0 } else { self.plane().signed_distance(&points[v as usize]) }
    }

    /// 1 beyond the plane, -1 before it, 0 in it.
    fn sign(&self, points: &[Point], v: u32) -> i32 {
        let d = self.distance(points, v);
        i32::from(d > 0.0) - i32::from(d < 0.0)
    }

    /// Where the plane meets an element.
    fn at(&self, points: &[Point], e: &Element) -> Point {
        let (p, q) = (points[e[0] as usize], points[e[1] as usize]);
        if e[0] == e[1] {
            return p;
        }
        let (d, f) = (self.distance(points, e[0]), self.distance(points, e[1]));
        p + (q - p) * (d / (d - f))
    }

    /// What of a triangle meets the plane, where the triangle reaches beyond it and not wholly.
    fn elements(&self, points: &[Point], t: &[u32; 3]) -> Vec<Element> {
        let sign = t.map(|v| self.sign(points, v));
        let mut own = Vec::new();
        if sign.iter().all(|s| *s <= 0) || sign.iter().all(|s| *s > 0) {
            return own;
        }
        for i in 0..3 {
            let j = (i + 1) % 3;
            if sign[i] == 0 {
                own.push([t[i], t[i]]);
            }
            if sign[i] * sign[j] < 0 {
                own.push([t[i].min(t[j]), t[i].max(t[j])]);
            }
        }
        own
    }
}

impl Sheet {
    pub fn new(mesh: &TriMesh) -> Sheet {
        let mut fans = vec![Vec::new(); mesh.points.len()];
        for (t, ids) in mesh.triangles.iter().enumerate() {
            ids.iter().for_each(|&v| fans[v as usize].push(t as u32));
        }
        Sheet {
            points: mesh.points.clone(),
            triangles: mesh.triangles.clone(),
            patch: mesh.patch.clone(),
            patches: mesh.patches.clone(),
            gone: vec![false; mesh.triangles.len()],
            fans,
        }
    }

    /// The mesh without what was taken away.
    pub fn into_mesh(self) -> TriMesh {
        let mut number = vec![u32::MAX; self.points.len()];
        let mut points = Vec::with_capacity(self.points.len());
        for (v, p) in self.points.iter().enumerate().filter(|(v, _)| !self.fans[*v].is_empty()) {
            number[v] = points.len() as u32;
            points.push(*p);
        }
        let kept = |t: &usize| !self.gone[*t];
        let triangles = (0..self.triangles.len()).filter(kept).map(|t| self.triangles[t].map(|v| number[v as usize])).collect();
        let patch = (0..self.triangles.len()).filter(kept).map(|t| self.patch[t]).collect();
        TriMesh { points, triangles, patch, patches: self.patches }
    }

    /// Cuts at the planes of `openings` together and caps the holes. An error leaves the sheet as it was.
    pub fn open(&mut self, openings: &[Opening], supports: &Supports, size: &dyn SizeField, reach: f64, snap: f64) -> Result<Done, Error> {
        let mut sections: Vec<Section> = openings.iter().map(|opening| Section { opening, snapped: BTreeMap::new() }).collect();
        for s in &mut sections {
            if snap > 0.0 {
                self.snap(s, supports, size, reach * s.opening.radius, snap);
            }
        }
        let made = self.cut(&sections, supports, reach);
        for s in &mut sections {
            // What the cut did not use goes back: other branches that the plane runs through, and all after an error.
            let id = s.opening.id;
            s.snapped.retain(|&v, p| {
                let used = made.is_ok() && self.fans[v as usize].iter().any(|&t| self.patch[t as usize] == id);
                if !used {
                    self.points[v as usize] = *p;
                }
                used
            });
        }
        made.map(|done| Done { snapped: sections.iter().map(|s| s.snapped.len()).sum(), ..done })
    }

    fn cut(&mut self, sections: &[Section], supports: &Supports, reach: f64) -> Result<Done, Error> {
        let loops = sections.iter().map(|s| self.own_loop(s, reach * s.opening.radius)).collect::<Result<Vec<_>, _>>()?;
        let side = self.sides(sections, &loops)?;
        let of = |v: u32| side.get(&v).copied().unwrap_or(Side::Kept);
        if side.len() >= self.fans.iter().filter(|f| !f.is_empty()).count() {
            let o = sections[0].opening;
            return Err(Error::NothingLeft { name: o.name.clone(), at: o.plane.origin });
        }

        if let [s] = sections
            && self.takes_off(s.opening, &side)
        {
            return Err(Error::TakesOff { name: s.opening.name.clone(), at: s.plane().origin });
        }

        // Divide the crossed edges.
        let first_new = self.points.len() as u32;
        let mut new_points: Vec<Point> = Vec::new();
        let mut crossing: BTreeMap<Element, u32> = BTreeMap::new();
        for (s, own) in sections.iter().zip(&loops) {
            for e in own.iter().filter(|e| e[0] != e[1]) {
                if crossing.insert(*e, first_new + new_points.len() as u32).is_some() {
                    return Err(Error::NotSimple { name: s.opening.name.clone(), at: s.at(&self.points, e) });
                }
                let middle = s.at(&self.points, e);
                let length = (self.points[e[0] as usize] - self.points[e[1] as usize]).norm();
                let beside = self.fans[e[0] as usize].iter().filter(|&&t| self.triangles[t as usize].contains(&e[1]));
                let mut carriers: Vec<PatchId> = beside.map(|&t| self.patch[t as usize]).collect();
                carriers.sort_unstable();
                let placed = match carriers[..] {
                    [WALL, WALL] => supports.project_curve(WALL, s.opening.id, &middle, 0.5 * length).map(|c| c.0),
                    // A corner of two caps.
                    [WALL, cap] => Some(supports.project_corner(cap, s.opening.id, &middle, 0.5 * length).unwrap_or(middle)),
                    // Inside another cap the point stays in that cap's plane, too.
                    _ => Some(middle),
                };
                new_points.push(placed.unwrap_or(s.plane().project(&middle)));
            }
        }
        let point = |v: u32| if v >= first_new { new_points[(v - first_new) as usize] } else { self.points[v as usize] };

        // Divide the triangles.
        let touched: BTreeSet<u32> =
            side.iter().filter(|(_, s)| **s == Side::Beyond).flat_map(|(v, _)| self.fans[*v as usize].iter().copied()).collect();
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        let mut patch: Vec<PatchId> = Vec::new();
        for &t in &touched {
            let ids = self.triangles[t as usize];
            let s = ids.map(of);
            if s.iter().all(|s| *s != Side::Kept) {
                continue;
            }
            // The kept polygon of the triangle, in order.
            let mut polygon: Vec<u32> = Vec::with_capacity(4);
            for i in 0..3 {
                let (a, b) = (ids[i], ids[(i + 1) % 3]);
                if s[i] != Side::Beyond {
                    polygon.push(a);
                }
                if matches!((s[i], s[(i + 1) % 3]), (Side::Kept, Side::Beyond) | (Side::Beyond, Side::Kept)) {
                    polygon.extend(crossing.get(&[a.min(b), a.max(b)]));
                }
            }
            let n = polygon.len();
            // A quadrilateral is divided by its shorter diagonal.
            let at = |i: usize| point(polygon[i % n]);
            let turn = usize::from(n == 4 && (at(0) - at(2)).norm() > (at(1) - at(3)).norm());
            for k in 1..n.saturating_sub(1) {
                triangles.push([polygon[turn], polygon[(turn + k) % n], polygon[(turn + k + 1) % n]]);
                patch.push(self.patch[t as usize]);
            }
        }

        // Open edges: in the new triangles, and in those that touch a rim and stay whole.
        let mut near = triangles.clone();
        let beside: BTreeSet<u32> =
            side.iter().filter(|(_, s)| **s == Side::Rim).flat_map(|(v, _)| self.fans[*v as usize].iter().copied()).collect();
        near.extend(beside.difference(&touched).map(|&t| self.triangles[t as usize]));
        for (s, own) in sections.iter().zip(&loops) {
            let vertex = |e: &Element| if e[0] == e[1] { e[0] } else { crossing[e] };
            let on_rim: BTreeSet<u32> = own.iter().map(vertex).collect();
            let rim = boundary_loop(&near, &on_rim, s.opening)?;
            let (u, v) = s.plane().basis();
            // The rim runs along the kept triangles; the cap runs against it.
            let order: Vec<u32> = rim.into_iter().rev().collect();
            let flat: Vec<[f64; 2]> = order.iter().map(|&i| point(i) - s.plane().origin).map(|d| [d.dot(&u), d.dot(&v)]).collect();
            let faces = crate::mesh::polygon::triangulate(&flat)
                .ok_or_else(|| Error::NotSimple { name: s.opening.name.clone(), at: s.plane().origin })?;
            patch.extend(faces.iter().map(|_| s.opening.id));
            triangles.extend(faces.iter().map(|t| t.map(|i| order[i])));
        }

        // All is well: take away and put in.
        let done = Done { snapped: 0, divided: new_points.len(), removed: touched.len() };
        for &t in &touched {
            self.gone[t as usize] = true;
            for v in self.triangles[t as usize] {
                self.fans[v as usize].retain(|&u| u != t);
            }
        }
        self.points.extend(new_points);
        self.fans.resize(self.points.len(), Vec::new());
        for (t, id) in triangles.into_iter().zip(patch) {
            t.iter().for_each(|&v| self.fans[v as usize].push(self.triangles.len() as u32));
            self.triangles.push(t);
            self.patch.push(id);
            self.gone.push(false);
        }
        for s in sections {
            let o = s.opening;
            self.patches.retain(|p| p.id != o.id);
            self.patches.push(Patch { id: o.id, name: o.name.clone(), kind: o.kind });
        }
        self.patches.sort_by_key(|p| p.id);
        Ok(done)
    }

    /// Vertices within `reach` of a point, ascending.
    fn ball(&self, center: &Point, reach: f64) -> Vec<u32> {
        let near = |v: &usize| (self.points[*v] - center).norm_squared() < reach * reach && !self.fans[*v].is_empty();
        (0..self.points.len()).filter(near).map(|v| v as u32).collect()
    }

    /// Moves vertices close to the plane onto the curve in which it meets the wall.
    fn snap(&mut self, s: &mut Section, supports: &Supports, size: &dyn SizeField, reach: f64, snap: f64) {
        for v in self.ball(&s.plane().origin, 1.5 * reach) {
            let p = self.points[v as usize];
            let d = s.distance(&self.points, v);
            let fan = &self.fans[v as usize];
            let h = size.size(&p);
            if d == 0.0 || d.abs() > snap * h || fan.iter().any(|&t| self.patch[t as usize] != WALL) {
                continue;
            }
            let Some((q, _)) = supports.project_curve(WALL, s.opening.id, &p, 0.6 * h) else { continue };
            let doubled = |[a, b, c]: [Point; 3]| -> Vector { (b - a).cross(&(c - a)) };
            let sound = fan.iter().all(|&t| {
                let ids = self.triangles[t as usize];
                let zeros = ids.iter().filter(|&&w| w != v && s.distance(&self.points, w) == 0.0).count();
                let before = doubled(ids.map(|w| self.points[w as usize]));
                let after = doubled(ids.map(|w| if w == v { q } else { self.points[w as usize] }));
                zeros < 2 && after.dot(&before) > 0.5 * after.norm() * before.norm() && after.norm() > 0.2 * before.norm()
            });
            if sound {
                s.snapped.insert(v, p);
                self.points[v as usize] = q;
            }
        }
    }

    /// The loop in which the plane cuts the opening's own branch, ascending: other loops in the plane do not count.
    fn own_loop(&self, s: &Section, reach: f64) -> Result<Vec<Element>, Error> {
        let origin = s.plane().origin;
        let mut nearest: Option<(f64, Element)> = None;
        // An edge that is crossed within reach has an end within half as much more.
        for t in self.ball(&origin, 1.5 * reach).into_iter().flat_map(|v| &self.fans[v as usize]) {
            for e in s.elements(&self.points, &self.triangles[*t as usize]) {
                let d = (s.at(&self.points, &e) - origin).norm();
                if d <= reach && nearest.is_none_or(|(best, own)| (d, e) < (best, own)) {
                    nearest = Some((d, e));
                }
            }
        }
        let Some((_, first)) = nearest else {
            let used = self.points.iter().zip(&self.fans).filter(|(_, f)| !f.is_empty());
            let closest = used.map(|(p, _)| ((p - origin).norm(), *p)).min_by(|a, b| a.0.total_cmp(&b.0));
            return Err(Error::Misses { name: s.opening.name.clone(), at: origin, nearest: closest.map_or(origin, |c| c.1) });
        };
        let mut own = BTreeSet::from([first]);
        let mut left = vec![first];
        while let Some([a, b]) = left.pop() {
            for &t in self.fans[a as usize].iter().filter(|&&t| self.triangles[t as usize].contains(&b)) {
                let more = s.elements(&self.points, &self.triangles[t as usize]);
                // A triangle that only touches the plane with one corner joins nothing to it.
                left.extend(more.into_iter().filter(|e| own.insert(*e)));
            }
        }
        Ok(own.into_iter().collect())
    }

    /// Whether the cut of an end that was found, behind which only a tip can lie, takes off an opening that was cut
    /// before, or more than half of what is left. A given plane cuts off what the user wants.
    fn takes_off(&self, o: &Opening, side: &BTreeMap<u32, Side>) -> bool {
        if o.found_by != FoundBy::BluntEnd {
            return false;
        }
        let beyond: Vec<u32> = side.iter().filter(|(_, s)| **s == Side::Beyond).map(|(v, _)| *v).collect();
        if 2 * beyond.len() > self.fans.iter().filter(|f| !f.is_empty()).count() {
            return true;
        }
        let on_caps = |t: usize| ![WALL, o.id].contains(&self.patch[t]);
        let touched: BTreeSet<PatchId> =
            beyond.iter().flat_map(|&v| &self.fans[v as usize]).filter(|&&t| on_caps(t as usize)).map(|&t| self.patch[t as usize]).collect();
        // Two caps may share a corner: what counts is that nothing would be left of one.
        let left = |id: &PatchId| {
            let own = (0..self.triangles.len()).filter(|&t| !self.gone[t] && self.patch[t] == *id);
            own.into_iter().any(|t| self.triangles[t].iter().any(|v| !side.contains_key(v)))
        };
        !touched.iter().all(left)
    }

    /// Sides of the vertices that do not stay: those beyond the loops and those in the planes.
    fn sides(&self, sections: &[Section], loops: &[Vec<Element>]) -> Result<BTreeMap<u32, Side>, Error> {
        let round = |v: u32| self.fans[v as usize].iter().flat_map(|&t| self.triangles[t as usize]).filter(move |&w| w != v);
        let mut side: BTreeMap<u32, Side> = BTreeMap::new();
        for e in loops.iter().flatten().filter(|e| e[0] == e[1]) {
            side.insert(e[0], Side::Rim);
        }
        let mut stack = Vec::new();
        for (s, own) in sections.iter().zip(loops) {
            for e in own {
                let starts: Vec<u32> = if e[0] == e[1] { round(e[0]).collect() } else { e.to_vec() };
                for v in starts.into_iter().filter(|&v| s.sign(&self.points, v) > 0) {
                    if let std::collections::btree_map::Entry::Vacant(free) = side.entry(v) {
                        free.insert(Side::Beyond);
                        stack.push(v);
                    }
                }
            }
        }
        let in_loop = |a: u32, b: u32| loops.iter().any(|l| l.binary_search(&[a.min(b), a.max(b)]).is_ok());
        while let Some(v) = stack.pop() {
            for w in round(v) {
                if !in_loop(v, w) && !side.contains_key(&w) {
                    side.insert(w, Side::Beyond);
                    stack.push(w);
                }
            }
        }
        // Where the flood came round to the kept side, the loops do not separate.
        for (s, own) in sections.iter().zip(loops) {
            if let Some(e) = own.iter().find(|e| e[0] != e[1] && e.iter().all(|v| side.get(v) == Some(&Side::Beyond))) {
                return Err(Error::Ring { name: s.opening.name.clone(), at: s.at(&self.points, e) });
            }
        }
        Ok(side)
    }
}

/// The one loop of open edges on `on_rim`, in the direction of the triangles that have them.
fn boundary_loop(triangles: &[[u32; 3]], on_rim: &BTreeSet<u32>, o: &Opening) -> Result<Vec<u32>, Error> {
    let mut directed: Vec<[u32; 2]> = triangles
        .iter()
        .flat_map(|t| (0..3).map(|i| [t[i], t[(i + 1) % 3]]))
        .filter(|[a, b]| on_rim.contains(a) && on_rim.contains(b))
        .collect();
    directed.sort_unstable();
    let open: Vec<[u32; 2]> = directed.iter().copied().filter(|[a, b]| directed.binary_search(&[*b, *a]).is_err()).collect();
    let broken = || Error::NotSimple { name: o.name.clone(), at: o.plane.origin };
    let next = |a: u32| -> Option<u32> {
        let i = open.partition_point(|e| e[0] < a);
        let one = open.get(i).filter(|e| e[0] == a)?;
        if open.get(i + 1).is_some_and(|e| e[0] == a) { None } else { Some(one[1]) }
    };
    let start = open.first().ok_or_else(broken)?[0];
    let mut rim = vec![start];
    let mut at = next(start).ok_or_else(broken)?;
    while at != start {
        rim.push(at);
        if rim.len() > open.len() {
            return Err(broken());
        }
        at = next(at).ok_or_else(broken)?;
    }
    if rim.len() == open.len() && rim.len() >= 3 { Ok(rim) } else { Err(broken()) }
}
