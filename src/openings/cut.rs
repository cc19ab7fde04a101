//! Plane cuts after remeshing: local to one branch, rim in the plane, cap triangulated, the neighbourhood repaired
//! (the paper's Figure 19).

use serde::Serialize;

use super::cap;
use super::rims::{self, RimOptions, RimSummary};
use super::{Error, Opening};
use crate::geometry::{Point, Vector};
use crate::implicit::Implicit;
use crate::mesh::{Patch, PatchKind, TriMesh, WALL};
use crate::remesh::{SizeField, Supports, angle_repair};

/// How openings are cut.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CutOptions {
    /// Vertices nearer to the plane than this part of the wished edge length are moved into it.
    pub snap: f64,
    /// How rims and caps are remeshed.
    pub rims: RimOptions,
    /// The loop must lie within this many radii of the opening's centre.
    pub reach: f64,
    /// Repair of the triangles at rim and cap.
    pub repair: angle_repair::RepairOptions,
}

impl Default for CutOptions {
    fn default() -> Self {
        CutOptions { snap: 0.3, rims: RimOptions::default(), reach: 3.0, repair: angle_repair::RepairOptions::default() }
    }
}

/// A planar end as it was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OpeningMeasure {
    /// Patch name.
    pub name: String,
    /// Patch number.
    pub id: u32,
    /// Inlet or outlet.
    pub kind: PatchKind,
    /// Centroid of the cap, mm.
    pub center: Point,
    /// Unit normal out of the vessel.
    pub normal: Vector,
    /// Area, mm².
    pub area: f64,
    /// Length of the rim, mm.
    pub perimeter: f64,
    /// 4 area / perimeter, mm.
    pub hydraulic_diameter: f64,
    /// Largest distance of a vertex of the cap from the plane, mm.
    pub planarity: f64,
    /// Triangles of the cap.
    pub faces: usize,
}

/// What the cuts did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct CutSummary {
    /// Vertices moved into a plane.
    pub snapped: usize,
    /// Edges divided by a plane.
    pub divided: usize,
    /// Triangles beyond the planes that were taken away.
    pub removed: usize,
    /// Remeshing of rims and caps.
    pub rims: Vec<RimSummary>,
}

/// Cuts `mesh` open at every plane of `openings`, caps the holes and repairs rims and caps.
///
/// Only the branch at an opening's centre is cut. The result is closed; each cap lies in its plane to rounding and has
/// the opening's patch id.
///
/// # Errors
/// [`Error`] with coordinates where a plane misses the vessel, cuts a ring, or would leave nothing.
pub fn cut(
    mesh: &TriMesh,
    wall: &dyn Implicit,
    size: &dyn SizeField,
    openings: &[Opening],
    options: &CutOptions,
) -> Result<(TriMesh, Vec<OpeningMeasure>, CutSummary), Error> {
    let mut summary = CutSummary::default();
    let mut supports = Supports::new(wall);
    let mut work = mesh.clone();
    for o in openings {
        supports = supports.with_plane(o.id, o.plane);
        let attempt = open(&work, &supports, size, o, options, options.snap, &mut summary);
        work = match attempt {
            // A snapped vertex can pinch the rim; without snapping it cannot.
            Err(Error::NotSimple { .. }) => open(&work, &supports, size, o, options, 0.0, &mut summary)?,
            other => other?,
        };
    }
    if openings.is_empty() {
        return Ok((work, Vec::new(), summary));
    }
    let (mut work, rims) = rims::remesh(&work, &supports, size, &options.rims, &options.repair);
    summary.rims = rims;
    for o in openings {
        let on_cap: Vec<u32> = cap_vertices(&work, o.id);
        for v in on_cap {
            work.points[v as usize] = o.plane.project(&work.points[v as usize]);
        }
    }
    let measures = openings.iter().map(|o| measure(&work, o)).collect();
    Ok((work, measures, summary))
}

fn cap_vertices(mesh: &TriMesh, id: u32) -> Vec<u32> {
    let mut v: Vec<u32> = (0..mesh.triangles.len()).filter(|&t| mesh.patch[t] == id).flat_map(|t| mesh.triangles[t]).collect();
    v.sort_unstable();
    v.dedup();
    v
}

/// Which side of the cut a vertex is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Kept,
    Rim,
    Beyond,
}

/// Cuts one branch and caps it.
fn open(
    mesh: &TriMesh,
    supports: &Supports,
    size: &dyn SizeField,
    o: &Opening,
    options: &CutOptions,
    snap: f64,
    summary: &mut CutSummary,
) -> Result<TriMesh, Error> {
    let mut work = mesh.clone();
    let mut distance: Vec<f64> = work.points.iter().map(|p| o.plane.signed_distance(p)).collect();
    let reach = options.reach * o.radius;
    if snap > 0.0 {
        summary.snapped += snap_to_plane(&mut work, &mut distance, supports, size, o, reach, snap);
    }
    let side = sides(&work, &distance, o, reach)?;
    if side.iter().all(|s| *s != Side::Kept) {
        return Err(Error::NothingLeft { name: o.name.clone(), at: o.plane.origin });
    }

    // Divide the crossed edges.
    let mut edges: Vec<[u32; 2]> = Vec::new();
    for t in &work.triangles {
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            if side[a as usize] == Side::Kept && side[b as usize] == Side::Beyond {
                edges.push([a, b]);
            }
        }
    }
    edges.sort_unstable();
    edges.dedup();
    let first_new = work.points.len() as u32;
    for &[a, b] in &edges {
        let (p, q) = (work.points[a as usize], work.points[b as usize]);
        let (da, db) = (distance[a as usize], distance[b as usize]);
        let middle = p + (q - p) * (da / (da - db));
        let on_curve = supports.project_curve(WALL, o.id, &middle, 0.5 * (q - p).norm());
        work.points.push(on_curve.map_or(o.plane.project(&middle), |c| c.0));
    }
    summary.divided += edges.len();
    let crossing = |a: u32, b: u32| edges.binary_search(&[a, b]).map(|i| first_new + i as u32).unwrap_or(a);

    let mut triangles = Vec::with_capacity(work.triangles.len());
    let mut patch = Vec::with_capacity(work.triangles.len());
    for (t, &id) in work.triangles.iter().zip(&work.patch) {
        let s = t.map(|v| side[v as usize]);
        let beyond = s.iter().filter(|s| **s == Side::Beyond).count();
        if beyond == 0 {
            triangles.push(*t);
            patch.push(id);
            continue;
        }
        let kept = s.iter().filter(|s| **s == Side::Kept).count();
        // The kept polygon of the triangle, in order.
        let mut polygon: Vec<u32> = Vec::with_capacity(4);
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            if s[i] != Side::Beyond {
                polygon.push(a);
            }
            match (s[i], s[(i + 1) % 3]) {
                (Side::Kept, Side::Beyond) => polygon.push(crossing(a, b)),
                (Side::Beyond, Side::Kept) => polygon.push(crossing(b, a)),
                _ => {}
            }
        }
        summary.removed += 1;
        if kept == 0 || polygon.len() < 3 {
            continue;
        }
        let n = polygon.len();
        let at = |i: usize| work.points[polygon[i % n] as usize];
        // A quadrilateral is divided by its shorter diagonal.
        let turn = usize::from(n == 4 && (at(0) - at(2)).norm() > (at(1) - at(3)).norm());
        for k in 1..n - 1 {
            triangles.push([polygon[turn], polygon[(turn + k) % n], polygon[(turn + k + 1) % n]]);
            patch.push(id);
        }
    }
    work.triangles = triangles;
    work.patch = patch;

    let on_rim = |v: u32| v >= first_new || side[v as usize] == Side::Rim;
    let rim = boundary_loop(&work, on_rim, o)?;
    let flat: Vec<[f64; 2]> = {
        let (u, v) = o.plane.basis();
        rim.iter().map(|&i| work.points[i as usize] - o.plane.origin).map(|d| [d.dot(&u), d.dot(&v)]).collect()
    };
    // The rim runs along the kept triangles; the cap runs against it.
    let order: Vec<usize> = (0..rim.len()).rev().collect();
    let reversed: Vec<[f64; 2]> = order.iter().map(|&i| flat[i]).collect();
    let caps = cap::triangulate(&reversed).ok_or(Error::NotSimple { name: o.name.clone(), at: o.plane.origin })?;
    for t in caps {
        work.triangles.push(t.map(|i| rim[order[i]]));
        work.patch.push(o.id);
    }
    work.patches.retain(|p| p.id != o.id);
    work.patches.push(Patch { id: o.id, name: o.name.clone(), kind: o.kind });
    work.patches.sort_by_key(|p| p.id);
    Ok(compacted(work))
}

/// Moves vertices close to the plane onto the curve in which it meets the wall.
fn snap_to_plane(
    work: &mut TriMesh,
    distance: &mut [f64],
    supports: &Supports,
    size: &dyn SizeField,
    o: &Opening,
    reach: f64,
    snap: f64,
) -> usize {
    let mut fans: Vec<Vec<u32>> = vec![Vec::new(); work.points.len()];
    let near = |p: &Point| (p - o.plane.origin).norm() < 1.5 * reach;
    for (t, ids) in work.triangles.iter().enumerate() {
        for &v in ids {
            if near(&work.points[v as usize]) {
                fans[v as usize].push(t as u32);
            }
        }
    }
    let mut count = 0;
    for v in 0..work.points.len() {
        let p = work.points[v];
        if fans[v].is_empty() || distance[v] == 0.0 {
            continue;
        }
        let h = size.size(&p);
        if distance[v].abs() > snap * h || fans[v].iter().any(|&t| work.patch[t as usize] != WALL) {
            continue;
        }
        let Some((q, _)) = supports.project_curve(WALL, o.id, &p, 0.6 * h) else { continue };
        let zeros = |t: u32| work.triangles[t as usize].iter().filter(|&&w| w as usize != v && distance[w as usize] == 0.0).count();
        let sound = fans[v].iter().all(|&t| {
            let before = work.area_vector2(t as usize);
            let [a, b, c] = work.triangles[t as usize].map(|w| if w as usize == v { q } else { work.points[w as usize] });
            let after = (b - a).cross(&(c - a));
            zeros(t) < 2 && after.dot(&before) > 0.5 * after.norm() * before.norm() && after.norm() > 0.2 * before.norm()
        });
        if sound {
            work.points[v] = q;
            distance[v] = 0.0;
            count += 1;
        }
    }
    count
}

/// Sides of all vertices with respect to the loop that belongs to the opening: other loops in the plane do not count.
fn sides(mesh: &TriMesh, distance: &[f64], o: &Opening, reach: f64) -> Result<Vec<Side>, Error> {
    // Crossed edges and vertices in the plane, joined by the triangles they share.
    let sign = |v: u32| distance[v as usize].partial_cmp(&0.0).unwrap_or(std::cmp::Ordering::Equal) as i32;
    let mut elements: Vec<[u32; 2]> = Vec::new();
    let mut links: Vec<Vec<[u32; 2]>> = Vec::new();
    for t in &mesh.triangles {
        let mut own = Vec::new();
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            if sign(a) == 0 {
                own.push([a, a]);
            }
            if sign(a) * sign(b) < 0 {
                own.push([a.min(b), a.max(b)]);
            }
        }
        let crossed = t.iter().any(|&v| sign(v) > 0);
        if crossed && !own.is_empty() && t.iter().any(|&v| sign(v) <= 0) {
            elements.extend(&own);
            links.push(own);
        }
    }
    elements.sort_unstable();
    elements.dedup();
    let index = |e: &[u32; 2]| elements.binary_search(e).unwrap_or(0);
    let mut root: Vec<usize> = (0..elements.len()).collect();
    fn find(root: &mut [usize], mut n: usize) -> usize {
        while root[n] != n {
            root[n] = root[root[n]];
            n = root[n];
        }
        n
    }
    for own in &links {
        for pair in own.windows(2) {
            let [a, b] = [index(&pair[0]), index(&pair[1])].map(|i| find(&mut root, i));
            root[a.max(b)] = a.min(b);
        }
    }
    let at = |e: &[u32; 2]| {
        let (p, q) = (mesh.points[e[0] as usize], mesh.points[e[1] as usize]);
        if e[0] == e[1] {
            return p;
        }
        let (d, f) = (distance[e[0] as usize], distance[e[1] as usize]);
        p + (q - p) * (d / (d - f))
    };
    // The loop nearest to the centre is the branch's own: its section holds the centre.
    let nearest = elements
        .iter()
        .enumerate()
        .map(|(i, e)| ((at(e) - o.plane.origin).norm(), i))
        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let Some((_, first)) = nearest.filter(|n| n.0 <= reach) else {
        let (_, p) = closest_vertex(mesh, &o.plane.origin);
        return Err(Error::Misses { name: o.name.clone(), at: o.plane.origin, nearest: p });
    };
    let chosen = find(&mut root, first);
    let in_loop: Vec<bool> = (0..elements.len()).map(|i| find(&mut root, i) == chosen).collect();
    let is_in_loop = |e: &[u32; 2]| elements.binary_search(e).is_ok_and(|i| in_loop[i]);

    // Flood what lies beyond the loop.
    let neighbours = Neighbours::of(mesh);
    let mut side = vec![Side::Kept; mesh.points.len()];
    let mut stack = Vec::new();
    for (_, e) in elements.iter().enumerate().filter(|(i, _)| in_loop[*i]) {
        if e[0] == e[1] {
            side[e[0] as usize] = Side::Rim;
        }
    }
    for (_, e) in elements.iter().enumerate().filter(|(i, _)| in_loop[*i]) {
        let starts: Vec<u32> = if e[0] == e[1] { neighbours.round(e[0]).iter().copied().filter(|&v| sign(v) > 0).collect() } else { e.iter().copied().filter(|&v| sign(v) > 0).collect() };
        for v in starts {
            if side[v as usize] == Side::Kept {
                side[v as usize] = Side::Beyond;
                stack.push(v);
            }
        }
    }
    while let Some(v) = stack.pop() {
        for &w in neighbours.round(v) {
            if side[w as usize] == Side::Kept && !is_in_loop(&[v.min(w), v.max(w)]) {
                side[w as usize] = Side::Beyond;
                stack.push(w);
            }
        }
    }
    // Where the flood came round to the kept side, the loop does not separate.
    for (_, e) in elements.iter().enumerate().filter(|(i, e)| in_loop[*i] && e[0] != e[1]) {
        if e.iter().all(|&v| side[v as usize] == Side::Beyond) {
            return Err(Error::Ring { name: o.name.clone(), at: at(e) });
        }
    }
    Ok(side)
}

fn closest_vertex(mesh: &TriMesh, p: &Point) -> (f64, Point) {
    let best = mesh.points.iter().map(|q| ((q - p).norm(), *q)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.unwrap_or((f64::INFINITY, *p))
}

/// The vertices round each vertex, one after the other in one array: a tree of hundreds of ends is cut as often.
struct Neighbours {
    first: Vec<u32>,
    all: Vec<u32>,
}

impl Neighbours {
    fn of(mesh: &TriMesh) -> Neighbours {
        let mut first = vec![0u32; mesh.points.len() + 1];
        for &v in mesh.triangles.iter().flatten() {
            first[v as usize + 1] += 1;
        }
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut next = first.clone();
        let mut all = vec![0u32; 3 * mesh.triangles.len()];
        for t in &mesh.triangles {
            for i in 0..3 {
                let slot = &mut next[t[i] as usize];
                all[*slot as usize] = t[(i + 1) % 3];
                *slot += 1;
            }
        }
        Neighbours { first, all }
    }

    fn round(&self, v: u32) -> &[u32] {
        &self.all[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }
}

/// The one loop of open edges, in the direction of the triangles that have them. Both ends of an open edge are on the
/// rim, for the mesh was closed before it was cut.
fn boundary_loop(mesh: &TriMesh, on_rim: impl Fn(u32) -> bool, o: &Opening) -> Result<Vec<u32>, Error> {
    let mut directed: Vec<[u32; 2]> = Vec::new();
    for t in &mesh.triangles {
        for i in 0..3 {
            let [a, b] = [t[i], t[(i + 1) % 3]];
            if on_rim(a) && on_rim(b) {
                directed.push([a, b]);
            }
        }
    }
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

/// The mesh without points that no triangle uses.
fn compacted(mesh: TriMesh) -> TriMesh {
    let mut number = vec![u32::MAX; mesh.points.len()];
    for &v in mesh.triangles.iter().flatten() {
        number[v as usize] = 0;
    }
    let mut points = Vec::with_capacity(mesh.points.len());
    for (p, n) in mesh.points.iter().zip(&mut number) {
        if *n == 0 {
            *n = points.len() as u32;
            points.push(*p);
        }
    }
    let triangles = mesh.triangles.iter().map(|t| t.map(|v| number[v as usize])).collect();
    TriMesh { points, triangles, patch: mesh.patch, patches: mesh.patches }
}

/// Area, rim and planarity of an opening's cap.
pub fn measure(mesh: &TriMesh, o: &Opening) -> OpeningMeasure {
    let faces: Vec<usize> = (0..mesh.triangles.len()).filter(|&t| mesh.patch[t] == o.id).collect();
    let mut area = 0.0;
    let mut moment = Vector::zeros();
    let mut edges: Vec<[u32; 2]> = Vec::new();
    for &t in &faces {
        let [a, b, c] = mesh.corners(t);
        let part = 0.5 * mesh.area_vector2(t).norm();
        area += part;
        moment += part * ((a - o.plane.origin) + (b - o.plane.origin) + (c - o.plane.origin)) / 3.0;
        let ids = mesh.triangles[t];
        edges.extend((0..3).map(|i| [ids[i].min(ids[(i + 1) % 3]), ids[i].max(ids[(i + 1) % 3])]));
    }
    edges.sort_unstable();
    let rim = edges.chunk_by(|a, b| a == b).filter(|c| c.len() == 1);
    let perimeter: f64 = rim.map(|c| (mesh.points[c[0][0] as usize] - mesh.points[c[0][1] as usize]).norm()).sum();
    let planarity = cap_vertices(mesh, o.id).iter().map(|&v| o.plane.signed_distance(&mesh.points[v as usize]).abs()).fold(0.0, f64::max);
    OpeningMeasure {
        name: o.name.clone(),
        id: o.id,
        kind: o.kind,
        center: if area > 0.0 { o.plane.origin + moment / area } else { o.plane.origin },
        normal: o.plane.normal,
        area,
        perimeter,
        hydraulic_diameter: if perimeter > 0.0 { 4.0 * area / perimeter } else { 0.0 },
        planarity,
        faces: faces.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Plane;
    use crate::mesh::intersect::self_intersections;
    use crate::mesh::topology::check;
    use crate::openings::FoundBy;
    use crate::remesh::{Uniform, isotropic};
    use crate::remesh::shape::skewness;
    use crate::remesh::testing::{Capsules, polygonize};

    fn opening(id: u32, name: &str, center: [f64; 3], normal: [f64; 3]) -> Opening {
        let plane = Plane::new(center.into(), normal.into()).expect("normal");
        let kind = if id == 2 { PatchKind::Inlet } else { PatchKind::Outlet };
        Opening { id, name: name.into(), kind, plane, radius: 2.0, found_by: FoundBy::User, confidence: 1.0, component: 0 }
    }

    fn tube() -> (Capsules, TriMesh) {
        let f = Capsules::tube(2.0, 10.0);
        let raw = polygonize(&f, 0.5);
        let supports = Supports::new(&f);
        let (mesh, _) = isotropic::remesh(&raw, &supports, &Uniform(0.6), &Default::default()).expect("remesh");
        (f, mesh)
    }

    #[test]
    fn an_oblique_cut_gives_a_planar_cap_of_the_exact_area_and_keeps_the_quality() {
        let (f, mesh) = tube();
        let tilt = [0.2, -0.1, 1.0];
        let ends = [opening(2, "inlet", [0.0, 0.0, 5.0], tilt), opening(3, "outlet_1", [0.0, 0.0, -5.0], [0.0, 0.0, -1.0])];
        let (cut, measures, summary) = super::cut(&mesh, &f, &Uniform(0.6), &ends, &CutOptions::default()).expect("cut");
        let t = check(&cut);
        assert!(t.is_closed_manifold() && t.euler == 2 && t.components == 1, "{t:?}");
        assert!(self_intersections(&cut).is_empty());
        let worst = |wall: bool| {
            let ids = (0..cut.triangles.len()).filter(|&i| (cut.patch[i] == WALL) == wall);
            ids.map(|i| { let [a, b, c] = cut.corners(i); skewness(&a, &b, &c) }).fold(0.0, f64::max)
        };
        assert!(worst(true) <= 0.45 && worst(false) <= 0.5, "wall {} caps {} {summary:?}", worst(true), worst(false));
        let cosine = 1.0 / (1.05f64).sqrt();
        for (m, exact) in measures.iter().zip([std::f64::consts::PI * 4.0 / cosine, std::f64::consts::PI * 4.0]) {
            assert!(m.planarity <= 1e-9 * cut.bounds().diagonal(), "{m:?}");
            assert!((m.area / exact - 1.0).abs() < 0.03, "{m:?} against {exact}");
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let (f, mesh) = tube();
        let ends = [opening(2, "inlet", [0.0, 0.0, 5.0], [0.2, 0.0, 1.0]), opening(3, "outlet_1", [0.0, 0.0, -5.0], [0.0, 0.0, -1.0])];
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| super::cut(&mesh, &f, &Uniform(0.6), &ends, &CutOptions::default()).expect("cut").0)
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn a_plane_that_misses_the_vessel_is_refused_with_coordinates() {
        let (f, mesh) = tube();
        let ends = [opening(2, "inlet", [40.0, 0.0, 0.0], [1.0, 0.0, 0.0])];
        let e = super::cut(&mesh, &f, &Uniform(0.6), &ends, &CutOptions::default()).expect_err("misses");
        assert!(matches!(e, Error::Misses { .. }) && e.to_string().contains("40.000"), "{e}");
    }
}
