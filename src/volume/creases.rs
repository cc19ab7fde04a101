//! Creases: edges of the wall so sharp, seen from inside, that no good tetrahedron fits between their two triangles.
//!
//! The volume stage keeps the surface as it is, so such an edge binds it: under an angle of 36° stand either one flat
//! tetrahedron or two of 18°. The wall is changed there, and only there: its vertices move, the edge is turned, or the
//! two vertices across from it become one. What is changed keeps to the wanted skewness and stays near the implicit
//! wall. Found where two vessels touch and the surface has ridges narrower than its triangles.

use serde::Serialize;

use crate::geometry::{Aabb, Point, Vector};
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::halfedge::HalfEdgeMesh;
use crate::mesh::intersect::pair_intersects;
use crate::mesh::{TriMesh, WALL};
use crate::remesh::Supports;
use crate::remesh::shape::skewness;
use crate::volume::search::DIRECTIONS;

/// When an edge counts as a crease, and how far the wall may be changed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CreaseOptions {
    /// Least angle between two triangles of the wall, measured inside, degrees.
    pub least_angle: f64,
    /// Largest equi-angle skewness of what is changed; what was above it before does not rise.
    pub max_skewness: f64,
    /// Farthest that a vertex may come to lie from the implicit wall, mm.
    pub max_distance: f64,
    /// Most creases that are worked on: with more, the surface as a whole is at fault.
    pub most: usize,
}

impl Default for CreaseOptions {
    fn default() -> Self {
        CreaseOptions { least_angle: 60.0, max_skewness: 0.45, max_distance: 0.1, most: 50 }
    }
}

/// A crease and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Crease {
    /// Middle of its edge, mm.
    pub at: Point,
    /// Angle inside, degrees.
    pub angle: f64,
    /// What was done; nothing where no change helped.
    pub change: Option<Change>,
    /// Least angle inside at the changed vertices, degrees.
    pub angle_after: f64,
    /// Farthest that a changed vertex lies from the implicit wall, mm.
    pub distance: f64,
}

/// A change of the wall at an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// Vertices moved.
    Moved,
    /// The edge was turned.
    Turned,
    /// The two vertices across from the edge became one.
    Pinched,
    /// An edge of its two triangles was drawn together.
    Drawn,
}

/// Angle inside between triangles abc and bad, degrees: under 180 at a ridge of the lumen.
pub(super) fn hinge([a, b, c, d]: [Point; 4]) -> f64 {
    let e = b - a;
    let (n, k) = (e.cross(&(c - a)), (d - a).cross(&e));
    let turn = n.cross(&k).dot(&e).atan2(n.dot(&k) * e.norm());
    180.0 - turn.to_degrees()
}

/// Ends of half-edge `h` and the vertices across from it, on its side and beyond.
pub(super) fn wings(m: &HalfEdgeMesh, h: u32) -> [u32; 4] {
    [m.origin(h), m.target(h), m.apex(h), m.apex(m.twin(h))]
}

fn angle(m: &HalfEdgeMesh, h: u32) -> f64 {
    hinge(wings(m, h).map(|v| m.points[v as usize]))
}

/// How far a triangle or edge is from what is wanted: 1 where it is just met, larger where it is missed.
struct Wish<'a> {
    options: &'a CreaseOptions,
    supports: &'a Supports<'a>,
}

impl Wish<'_> {
    fn of_edge(&self, m: &HalfEdgeMesh, h: u32) -> f64 {
        let inside = angle(m, h);
        self.options.least_angle / inside.min(360.0 - inside).max(1e-6)
    }

    fn of_triangle(&self, m: &HalfEdgeMesh, t: u32) -> f64 {
        let [a, b, c] = m.corners(t);
        skewness(&a, &b, &c) / self.options.max_skewness
    }

    /// The worst of the triangles and edges that depend on vertex `v`.
    fn of_star(&self, m: &HalfEdgeMesh, v: u32) -> f64 {
        m.outgoing(v)
            .map(|h| self.of_triangle(m, h / 3).max(self.of_edge(m, h)).max(self.of_edge(m, HalfEdgeMesh::next(h))))
            .fold(0.0, f64::max)
    }

    fn of_region(&self, m: &HalfEdgeMesh, region: &[u32]) -> f64 {
        region.iter().map(|&v| self.of_star(m, v)).fold(0.0, f64::max)
    }

    fn skewness_of_region(&self, m: &HalfEdgeMesh, region: &[u32]) -> f64 {
        region.iter().flat_map(|&v| m.outgoing(v)).map(|h| self.of_triangle(m, h / 3)).fold(0.0, f64::max)
    }

    /// `p`, on the wall where that is near, else as it is where the wall is near enough.
    fn place(&self, p: Point, step: f64) -> Option<Point> {
        if let Some((q, _)) = self.supports.project(WALL, &p, step)
            && (q - p).norm() <= 0.5 * step
        {
            return Some(q);
        }
        (self.supports.distance(WALL, &p) <= self.options.max_distance).then_some(p)
    }

    /// Moves the vertices of a region while the worst of their stars becomes better.
    fn relax(&self, m: &mut HalfEdgeMesh, region: &[u32]) {
        for _ in 0..40 {
            let mut moved = false;
            for &v in region {
                moved |= self.relax_vertex(m, v);
            }
            if !moved {
                break;
            }
        }
    }

    fn relax_vertex(&self, m: &mut HalfEdgeMesh, v: u32) -> bool {
        // A little better than wanted leaves room for the neighbours.
        let mut worst = self.of_star(m, v);
        if worst <= 0.95 {
            return false;
        }
        let shortest = m.outgoing(v).map(|h| (m.points[m.target(h) as usize] - m.points[v as usize]).norm()).fold(f64::INFINITY, f64::min);
        let mut moved = false;
        for part in [0.3, 0.12, 0.05, 0.02] {
            let step = part * shortest;
            for d in DIRECTIONS {
                let here = m.points[v as usize];
                let wanted = here + Vector::from(d) * step;
                // Off the wall too, within what is allowed: on a sharp ridge it says nothing.
                let off = Some(wanted).filter(|p| self.supports.distance(WALL, p) <= self.options.max_distance);
                for p in [self.place(wanted, step), off].into_iter().flatten() {
                    m.points[v as usize] = p;
                    let w = self.of_star(m, v);
                    if w < worst - 1e-6 {
                        (worst, moved) = (w, true);
                        break;
                    }
                    m.points[v as usize] = here;
                }
            }
        }
        moved
    }
}

/// Whether all triangles at `v` belong to the wall: rims and caps stay.
fn free(m: &HalfEdgeMesh, v: u32) -> bool {
    m.has_vertex(v) && m.outgoing(v).all(|h| m.patch(h / 3) == WALL)
}

/// Draws the free one of two neighbours onto the other, both to their middle where both are free.
fn draw(m: &mut HalfEdgeMesh, wish: &Wish<'_>, v: u32, w: u32) -> Option<u32> {
    let (from, to) = if free(m, v) { (v, w) } else { (w, v) };
    if !free(m, from) {
        return None;
    }
    let h = m.find(from, to)?;
    if !m.can_collapse(h) {
        return None;
    }
    if free(m, to) {
        let (a, b) = (m.points[from as usize], m.points[to as usize]);
        m.points[to as usize] = wish.place(nalgebra::center(&a, &b), (b - a).norm())?;
    }
    m.collapse(h);
    Some(to)
}

/// Every change that may help at edge ab with c and d across, and the vertices at which the mesh is another then.
fn changed(m: &HalfEdgeMesh, wish: &Wish<'_>, [a, b, c, d]: [u32; 4]) -> Vec<(Change, HalfEdgeMesh, Vec<u32>)> {
    let mut all = vec![(Change::Moved, m.clone(), vec![a, b, c, d])];
    let turned = m.find(a, b).filter(|&h| m.can_flip(h)).map(|h| {
        let mut n = m.clone();
        n.flip(h);
        n
    });
    if let Some(turned) = turned {
        let mut n = turned.clone();
        if let Some(x) = draw(&mut n, wish, c, d) {
            all.push((Change::Pinched, n, vec![a, b, x]));
        }
        all.push((Change::Turned, turned, vec![a, b, c, d]));
    }
    for (v, w) in [(a, b), (c, a), (c, b), (d, a), (d, b)] {
        let mut n = m.clone();
        if let Some(x) = draw(&mut n, wish, v, w) {
            let seeds = [a, b, c, d, x].into_iter().filter(|&s| n.has_vertex(s)).collect();
            all.push((Change::Drawn, n, seeds));
        }
    }
    all
}

/// The seeds and their neighbours.
fn neighbourhood(m: &HalfEdgeMesh, seeds: &[u32]) -> Vec<u32> {
    let mut all: Vec<u32> = seeds.iter().flat_map(|&s| m.outgoing(s).map(|h| m.target(h))).chain(seeds.iter().copied()).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Whether a triangle at one of these vertices meets another triangle beyond what they share.
fn crosses(m: &HalfEdgeMesh, region: &[u32]) -> bool {
    let live: Vec<u32> = (0..m.triangle_ids() as u32).filter(|&t| m.has_triangle(t)).collect();
    let mesh = TriMesh::new(m.points.clone(), live.iter().map(|&t| m.triangle(t)).collect());
    let bvh = TriangleBvh::new(&mesh);
    (0..mesh.triangles.len()).filter(|&i| mesh.triangles[i].iter().any(|v| region.binary_search(v).is_ok())).any(|i| {
        let mut found = false;
        bvh.overlapping(&Aabb::of(mesh.corners(i).iter()), |j| {
            found = found || (j != i as u32 && pair_intersects(&mesh, i as u32, j));
        });
        found
    })
}

/// Softens the creases of the wall, the sharpest first. `None` where there are none.
///
/// Caps, rims and everything that is not next to a crease keep their points and triangles. The surface stays closed and
/// free of self-intersection where it was. Not guaranteed: that every crease goes.
pub fn soften(mesh: &TriMesh, supports: &Supports<'_>, options: &CreaseOptions) -> Option<(TriMesh, Vec<Crease>)> {
    let mut m = HalfEdgeMesh::new(mesh).ok()?;
    let mut done: Vec<Crease> = Vec::new();
    let mut in_vain: Vec<(u32, u32)> = Vec::new();
    while done.len() < options.most {
        let sharpest = m
            .edges()
            .filter(|&h| m.patch(h / 3) == WALL && m.patch(m.twin(h) / 3) == WALL)
            .map(|h| (angle(&m, h), h))
            .filter(|&(a, h)| a < options.least_angle && !in_vain.contains(&(m.origin(h), m.target(h))))
            .min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let Some((sharp, h)) = sharpest else { break };
        let ends = (m.origin(h), m.target(h));
        let (next, crease) = work(m, h, sharp, supports, options);
        m = next;
        if crease.change.is_none() {
            in_vain.push(ends);
        }
        done.push(crease);
    }
    (!done.is_empty()).then(|| (m.into_mesh(), done))
}

/// Edges that are worked on round one place.
const EDGES_A_PLACE: usize = 3;

/// Works on the wall round some places, where it made filling fail or come out poor: at the edges that are farthest from
/// what is wished, whatever their angle. `None` where nothing became better.
///
/// What holds of [`soften`] holds here too; only vertices within two edges of a place change.
pub fn mend(mesh: &TriMesh, supports: &Supports<'_>, options: &CreaseOptions, places: &[Point]) -> Option<(TriMesh, Vec<Crease>)> {
    let mut m = HalfEdgeMesh::new(mesh).ok()?;
    // A good surface meets the usual wishes already; here it is to become another one.
    let options = &CreaseOptions { least_angle: 1.5 * options.least_angle, max_skewness: 0.5 * options.max_skewness, ..options.clone() };
    let mut done: Vec<Crease> = Vec::new();
    for place in places.iter().take(options.most) {
        let mut tried: Vec<(u32, u32)> = Vec::new();
        for _ in 0..EDGES_A_PLACE {
            let wish = Wish { options, supports };
            let of = |h: u32| wish.of_edge(&m, h).max(wish.of_triangle(&m, h / 3)).max(wish.of_triangle(&m, m.twin(h) / 3));
            let near = |h: u32| {
                let (a, b) = (m.points[m.origin(h) as usize], m.points[m.target(h) as usize]);
                (nalgebra::center(&a, &b) - place).norm() <= 2.0 * (b - a).norm()
            };
            let worst = m
                .edges()
                .filter(|&h| m.patch(h / 3) == WALL && m.patch(m.twin(h) / 3) == WALL && near(h))
                .filter(|&h| !tried.contains(&(m.origin(h), m.target(h))))
                .map(|h| (of(h), h))
                .filter(|w| w.0 > 1.0)
                .max_by(|x, y| x.0.total_cmp(&y.0).then(y.1.cmp(&x.1)));
            let Some((_, h)) = worst else { break };
            tried.push((m.origin(h), m.target(h)));
            let sharp = angle(&m, h);
            let (next, crease) = work(m, h, sharp, supports, options);
            m = next;
            if crease.change.is_some() {
                done.push(crease);
            }
        }
    }
    (!done.is_empty()).then(|| (m.into_mesh(), done))
}

/// Works on the edge of `h`, whose angle inside is `sharp`: the mesh then, as it was where nothing helps.
fn work(m: HalfEdgeMesh, h: u32, sharp: f64, supports: &Supports<'_>, options: &CreaseOptions) -> (HalfEdgeMesh, Crease) {
    let wish = Wish { options, supports };
    let corners = wings(&m, h);
    let at = nalgebra::center(&m.points[corners[0] as usize], &m.points[corners[1] as usize]);
    let before = neighbourhood(&m, &corners);
    let (worst, skewed) = (wish.of_region(&m, &before), wish.skewness_of_region(&m, &before));
    let mut best: Option<(f64, Change, HalfEdgeMesh, Vec<u32>)> = None;
    // The least distance from the wall that helps, then the other changes.
    let near = [0.4, 1.0].map(|part| CreaseOptions { max_distance: part * options.max_distance, ..options.clone() });
    let tries = near.iter().flat_map(|options| {
        let wish = Wish { options, supports };
        changed(&m, &wish, corners).into_iter().map(move |c| (c, Wish { options, supports })).collect::<Vec<_>>()
    });
    for ((change, mut n, seeds), wish) in tries {
        if best.as_ref().is_some_and(|b| b.0 <= 1.0) {
            break;
        }
        let region = neighbourhood(&n, &seeds);
        let movable: Vec<u32> = region.iter().copied().filter(|&v| free(&n, v)).collect();
        wish.relax(&mut n, &movable);
        let w = wish.of_region(&n, &region).max(1.0);
        if w < best.as_ref().map_or(worst, |b| b.0) - 0.02
            && wish.skewness_of_region(&n, &region) <= skewed.max(1.0)
            && !crosses(&n, &region)
        {
            best = Some((w, change, n, region));
        }
    }
    let Some((_, change, n, region)) = best else {
        return (m, Crease { at, angle: sharp, change: None, angle_after: sharp, distance: 0.0 });
    };
    let inside = region.iter().flat_map(|&v| n.outgoing(v)).map(|h| angle(&n, h)).fold(360.0, f64::min);
    let off = region.iter().filter(|&&v| free(&n, v)).map(|&v| supports.distance(WALL, &n.points[v as usize])).fold(0.0, f64::max);
    (n, Crease { at, angle: sharp, change: Some(change), angle_after: inside, distance: off })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implicit::Implicit;
    use crate::mesh::test_shapes::sphere;
    use crate::mesh::{intersect, topology};

    /// An ellipsoid of half axes 1, 1 and this, to first order a distance.
    struct Lens(f64);

    impl Implicit for Lens {
        fn value(&self, p: &Point) -> f64 {
            self.value_gradient(p).0
        }
        fn value_gradient(&self, p: &Point) -> (f64, Vector) {
            let s = Vector::new(1.0, 1.0, 1.0 / self.0);
            let q = p.coords.component_mul(&s);
            let g = q.component_mul(&s) / q.norm();
            let n = g.norm();
            ((q.norm() - 1.0) / n, g / n)
        }
        fn bounds(&self) -> Aabb {
            Aabb { min: Point::new(-2.0, -2.0, -2.0), max: Point::new(2.0, 2.0, 2.0) }
        }
        fn resolution(&self) -> f64 {
            0.1
        }
    }

    fn skewest(m: &TriMesh) -> f64 {
        (0..m.triangles.len()).map(|t| m.corners(t)).map(|[a, b, c]| skewness(&a, &b, &c)).fold(0.0, f64::max)
    }

    #[test]
    fn a_ridge_that_is_not_the_vessel_s_goes_and_the_rest_stays() {
        let smooth = sphere(Point::origin(), 1.0, 8);
        let wall = Lens(1.0);
        let supports = Supports::new(&wall);
        assert!(soften(&smooth, &supports, &CreaseOptions::default()).is_none());
        let mut ridge = smooth.clone();
        let [a, b, _] = ridge.triangles[40].map(|v| v as usize);
        for v in [a, b] {
            ridge.points[v] *= 1.45;
        }
        let (m, found) = soften(&ridge, &supports, &CreaseOptions::default()).expect("a crease");
        assert!(found[0].angle < 60.0 && found.iter().all(|c| c.change.is_some()), "{found:?}");
        assert!(soften(&m, &supports, &CreaseOptions::default()).is_none());
        assert!(topology::check(&m).is_closed_manifold() && intersect::self_intersections(&m).is_empty());
        assert!(skewest(&m) <= skewest(&ridge).max(0.45));
        let same = m.points.iter().filter(|p| ridge.points.contains(p)).count();
        assert!(same + 40 > ridge.points.len(), "{same} of {}", ridge.points.len());
    }

    #[test]
    fn mending_changes_the_wall_round_the_given_places_alone_and_for_the_better() {
        let wall = Lens(1.0);
        let supports = Supports::new(&wall);
        let mut ball = sphere(Point::origin(), 1.0, 6);
        // A bad triangle at either end; one of them is named.
        let ends = [Point::new(0.0, 0.0, 1.0), Point::new(0.0, 0.0, -1.0)];
        for end in ends {
            let near = |p: &Point| (p - end).norm();
            let v = (0..ball.points.len()).min_by(|&i, &j| near(&ball.points[i]).total_cmp(&near(&ball.points[j]))).unwrap_or(0);
            let moved = ball.points[v] + Vector::new(0.09, 0.05, 0.0);
            ball.points[v] = Point::from(moved.coords.normalize());
        }
        let (m, changes) = mend(&ball, &supports, &CreaseOptions::default(), &ends[..1]).expect("a change");
        assert!(!changes.is_empty() && changes.iter().all(|c| c.change.is_some() && (c.at - ends[0]).norm() < 0.5), "{changes:?}");
        let far = |m: &TriMesh| m.points.iter().filter(|p| p.z < 0.0).map(|p| p.coords.iter().map(|x| x.to_bits()).fold(0u64, u64::wrapping_add)).fold(0u64, u64::wrapping_add);
        assert_eq!(far(&m), far(&ball));
        let worst = |m: &TriMesh| {
            let upper = (0..m.triangles.len()).map(|t| m.corners(t)).filter(|c| c[0].z > 0.0);
            upper.map(|[a, b, c]| skewness(&a, &b, &c)).fold(0.0, f64::max)
        };
        assert!(worst(&m) < worst(&ball) - 0.02, "{} {}", worst(&m), worst(&ball));
        assert!(topology::check(&m).is_closed_manifold() && intersect::self_intersections(&m).is_empty());
    }

    #[test]
    fn an_edge_that_is_the_vessel_s_own_is_not_rounded_off() {
        // The rim of a thin lens: sharp wherever one looks.
        let wall = Lens(0.03);
        let mut lens = sphere(Point::origin(), 1.0, 6);
        lens.points.iter_mut().for_each(|p| p.z *= 0.03);
        let options = CreaseOptions { max_distance: 0.005, most: 5, ..CreaseOptions::default() };
        let (m, found) = soften(&lens, &Supports::new(&wall), &options).expect("creases");
        assert_eq!(found.len(), 5);
        assert!(topology::check(&m).is_closed_manifold() && intersect::self_intersections(&m).is_empty());
        assert!(skewest(&m) <= skewest(&lens).max(0.45) + 1e-12);
        assert!(m.points.iter().all(|p| lens.points.contains(p) || wall.value(p).abs() <= 0.005 + 1e-9));
    }
}
