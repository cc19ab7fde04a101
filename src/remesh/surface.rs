//! The surface while it is remeshed: a half-edge mesh whose vertices know what they lie on.

use rayon::prelude::*;
use serde::Serialize;

use super::shape::worst_cosine;
use super::{SizeField, Supports};
use crate::geometry::{Point, Vector};
use crate::mesh::halfedge::HalfEdgeMesh;
use crate::mesh::topology::TopologyReport;
use crate::mesh::{PatchId, TriMesh};

/// What holds a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// All its triangles are of one patch: moves on the patch's carrier.
    Surface(PatchId),
    /// On a rim between two patches: moves along the curve in which their carriers meet.
    Curve(PatchId, PatchId),
    /// On a feature inside one patch: keeps its place, may be drawn along the feature.
    Crease,
    /// Where features meet or end: keeps its place for ever.
    Corner,
    /// Outside the region that may change.
    Locked,
}

impl Kind {
    /// How firmly the vertex is held; of two that become one the firmer stays.
    pub fn rank(self) -> u8 {
        match self {
            Kind::Surface(_) => 0,
            Kind::Curve(..) | Kind::Crease => 1,
            Kind::Corner => 2,
            Kind::Locked => 3,
        }
    }

    /// Whether relaxation may move it.
    pub fn moves(self) -> bool {
        matches!(self, Kind::Surface(_) | Kind::Curve(..))
    }
}

/// What triangles are held against, so that none turns over.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Normals {
    /// The gradient of the implicit at their corners.
    #[default]
    Gradient,
    /// The mesh's own normals, averaged over two rings at the start. Where the implicit has kinks (a guard, a blend of
    /// few fits) its gradient jumps by more than a triangle across the kink may lean.
    Averaged,
}

/// A mesh under remeshing.
pub(crate) struct Surface<'a> {
    pub mesh: HalfEdgeMesh,
    pub supports: &'a Supports<'a>,
    pub field: &'a dyn SizeField,
    pub kind: Vec<Kind>,
    /// Unit normal of the wall at the vertex; zero at vertices that no wall triangle has.
    pub normal: Vec<Vector>,
    /// Wished edge length at the vertex.
    pub size: Vec<f64>,
    /// What `normal` holds.
    normals: Normals,
}

/// Triangles whose normal is closer than this to the carrier's (cosine) need no further look.
const UPRIGHT: f64 = 0.5;

impl<'a> Surface<'a> {
    /// Takes a mesh over; `active` marks the vertices that may change (all without it).
    pub fn new(
        mesh: &TriMesh,
        supports: &'a Supports<'a>,
        field: &'a dyn SizeField,
        active: Option<&[bool]>,
        features: &[[u32; 2]],
    ) -> Result<Surface<'a>, Box<TopologyReport>> {
        let mut mesh = HalfEdgeMesh::new(mesh)?;
        for &[a, b] in features {
            if (a as usize) < mesh.points.len() && (b as usize) < mesh.points.len() {
                if let Some(h) = mesh.find(a, b) {
                    mesh.mark_feature(h);
                }
            }
        }
        let ids: Vec<u32> = (0..mesh.points.len() as u32).collect();
        let kind: Vec<Kind> = ids
            .par_iter()
            .map(|&v| if active.is_some_and(|a| !a[v as usize]) { Kind::Locked } else { classify(&mesh, v) })
            .collect();
        let on_wall = |v: u32| mesh.outgoing(v).any(|h| supports.plane(mesh.patch(h / 3)).is_none());
        let normal = ids
            .par_iter()
            .map(|&v| {
                if !on_wall(v) {
                    return Vector::zeros();
                }
                supports.wall().gradient(&mesh.points[v as usize]).try_normalize(0.0).unwrap_or_else(Vector::zeros)
            })
            .collect();
        let size = mesh.points.par_iter().map(|p| field.size(p)).collect();
        Ok(Surface { mesh, supports, field, kind, normal, size, normals: Normals::Gradient })
    }

    /// Holds triangles against the mesh's own normals, averaged over two rings, from now on.
    pub fn average_normals(&mut self) {
        self.normals = Normals::Averaged;
        let unit = |v: Vector| v.try_normalize(0.0).unwrap_or_else(Vector::zeros);
        let of_ring = |v: u32| {
            let wall = |h: &u32| self.supports.plane(self.mesh.patch(h / 3)).is_none();
            let area = |h: u32| {
                let [a, b, c] = self.mesh.corners(h / 3);
                (b - a).cross(&(c - a))
            };
            unit(self.mesh.outgoing(v).filter(wall).map(area).sum())
        };
        let ids: Vec<u32> = (0..self.mesh.points.len() as u32).collect();
        let own: Vec<Vector> = ids.par_iter().map(|&v| of_ring(v)).collect();
        let mean = |v: u32| {
            if own[v as usize] == Vector::zeros() {
                return Vector::zeros();
            }
            unit(own[v as usize] + self.mesh.outgoing(v).map(|h| own[self.mesh.target(h) as usize]).sum::<Vector>())
        };
        self.normal = ids.par_iter().map(|&v| mean(v)).collect();
    }

    /// The normal to store for vertex `v` of the wall when it moves to where the gradient points along `n`.
    #[inline]
    pub fn normal_after_move(&self, v: u32, n: Vector) -> Vector {
        match self.normals {
            Normals::Gradient => n,
            Normals::Averaged => self.normal[v as usize],
        }
    }

    /// Gives ids without gaps where many were removed; what is left keeps its order.
    pub fn compact(&mut self) {
        if self.mesh.triangle_ids() < 5 * self.mesh.triangle_count() / 4 {
            return;
        }
        let old = self.mesh.compact();
        self.follow(&old);
    }

    /// Gives ids in the order of a walk over the surface; see [`HalfEdgeMesh::sort_by_walk`].
    pub fn sort_by_walk(&mut self) {
        let old = self.mesh.sort_by_walk();
        self.follow(&old);
    }

    fn follow(&mut self, old: &[u32]) {
        self.kind = old.iter().map(|&v| self.kind[v as usize]).collect();
        self.normal = old.iter().map(|&v| self.normal[v as usize]).collect();
        self.size = old.iter().map(|&v| self.size[v as usize]).collect();
    }

    /// Ids of the vertices that exist.
    pub fn vertices(&self) -> Vec<u32> {
        (0..self.mesh.points.len() as u32).filter(|&v| self.mesh.has_vertex(v)).collect()
    }

    #[inline]
    pub fn point(&self, v: u32) -> &Point {
        &self.mesh.points[v as usize]
    }

    /// Squared length of an edge over the wished one.
    #[inline]
    pub fn relative_length2(&self, a: u32, b: u32) -> f64 {
        let h = 0.5 * (self.size[a as usize] + self.size[b as usize]);
        (self.point(a) - self.point(b)).norm_squared() / (h * h)
    }

    /// Whether both ends of `h` lie outside the region that may change.
    #[inline]
    pub fn is_locked(&self, h: u32) -> bool {
        self.kind[self.mesh.origin(h) as usize] == Kind::Locked
            && self.kind[self.mesh.target(h) as usize] == Kind::Locked
    }

    /// Cosine between the normal of a triangle with these corners and its carrier's normals at them: the smallest.
    #[inline]
    pub fn uprightness(&self, patch: PatchId, p: [&Point; 3], n: [&Vector; 3]) -> f64 {
        let a = (p[1] - p[0]).cross(&(p[2] - p[0]));
        let length = a.norm();
        if length <= 0.0 {
            return -1.0;
        }
        if let Some(plane) = self.supports.plane(patch) {
            return a.dot(&plane.normal) / length;
        }
        n.iter().filter(|n| n.x != 0.0 || n.y != 0.0 || n.z != 0.0).map(|n| a.dot(n) / length).fold(1.0, f64::min)
    }

    /// [`Self::uprightness`] of triangle `t` as it is.
    #[inline]
    pub fn uprightness_of(&self, t: u32) -> f64 {
        let v = self.mesh.triangle(t);
        let [a, b, c] = v.map(|v| self.point(v));
        self.uprightness(self.mesh.patch(t), [a, b, c], v.map(|v| &self.normal[v as usize]))
    }

    /// Cosine of the smallest angle of triangle `t`.
    #[inline]
    pub fn shape_of(&self, t: u32) -> f64 {
        let [a, b, c] = self.mesh.triangle(t).map(|v| self.point(v));
        worst_cosine(a, b, c)
    }

    /// Whether triangles that stood at `before` may be replaced by ones that stand at `after`.
    #[inline]
    pub fn stands(before: f64, after: f64) -> bool {
        after >= UPRIGHT || after >= before
    }

    /// Position, wall normal and kind for a new vertex on the edge of `h`, near the point at `t` from its origin.
    pub fn place_on_edge(&self, h: u32, t: f64) -> Option<(Point, Vector, Kind)> {
        let (a, b) = (self.mesh.origin(h), self.mesh.target(h));
        let (pa, pb) = (*self.point(a), *self.point(b));
        let p = pa + (pb - pa) * t;
        let reach = 0.5 * (pb - pa).norm();
        let (left, right) = (self.mesh.patch(h / 3), self.mesh.patch(self.mesh.twin(h) / 3));
        let averaged = || (self.normal[a as usize] + self.normal[b as usize]).try_normalize(0.0).unwrap_or_else(Vector::zeros);
        let choose = |n: Vector| if self.normals == Normals::Averaged { averaged() } else { n };
        if left != right {
            let (p, n) = self.supports.project_curve(left, right, &p, reach)?;
            return Some((p, n.map_or_else(Vector::zeros, choose), Kind::Curve(left.min(right), left.max(right))));
        }
        let (p, n) = self.supports.project(left, &p, reach)?;
        let n = if self.supports.plane(left).is_some() { Vector::zeros() } else { choose(n) };
        Some((p, n, if self.mesh.is_feature(h) { Kind::Crease } else { Kind::Surface(left) }))
    }

    /// Splits the edge of `h` at a place from [`Self::place_on_edge`].
    pub fn split(&mut self, h: u32, (p, n, kind): (Point, Vector, Kind)) -> u32 {
        let v = self.mesh.split(h, p);
        self.kind.push(kind);
        self.normal.push(n);
        self.size.push(self.field.size(&p));
        v
    }

    /// Whether kinds and features let the origin of `h` be drawn onto its target.
    pub fn may_collapse(&self, h: u32) -> bool {
        let (a, b) = (self.mesh.origin(h), self.mesh.target(h));
        let (ka, kb) = (self.kind[a as usize], self.kind[b as usize]);
        let allowed = match ka {
            Kind::Surface(_) => true,
            Kind::Curve(..) => self.mesh.is_feature(h),
            Kind::Crease => self.mesh.is_feature(h) && kb != Kind::Surface(self.mesh.patch(h / 3)) && self.is_straight(a),
            Kind::Corner | Kind::Locked => false,
        };
        // A feature drawn onto another one would close up: both edges of a removed triangle are features then.
        let pinches = |h: u32| {
            self.mesh.is_feature(HalfEdgeMesh::next(h)) && self.mesh.is_feature(HalfEdgeMesh::prev(h))
        };
        allowed && !pinches(h) && !pinches(self.mesh.twin(h)) && self.mesh.can_collapse(h)
    }

    /// Whether the feature through `v` bends by less than about 8°.
    fn is_straight(&self, v: u32) -> bool {
        let ends: Vec<Vector> = self
            .mesh
            .outgoing(v)
            .filter(|&h| self.mesh.is_feature(h))
            .filter_map(|h| (self.point(self.mesh.target(h)) - self.point(v)).try_normalize(0.0))
            .collect();
        ends.len() == 2 && ends[0].dot(&ends[1]) < -0.99
    }

    /// Draws the origin of `h` onto its target.
    pub fn collapse(&mut self, h: u32) {
        self.mesh.collapse(h);
    }

    /// Moves vertex `v`.
    pub fn set(&mut self, v: u32, p: Point, n: Vector) {
        self.mesh.points[v as usize] = p;
        self.normal[v as usize] = n;
        self.size[v as usize] = self.field.size(&p);
    }

    /// Brings `p` onto what vertex `v` lies on. Gives the point and the wall normal to store.
    pub fn project(&self, v: u32, p: &Point, reach: f64) -> Option<(Point, Vector)> {
        match self.kind[v as usize] {
            Kind::Surface(patch) => {
                let (q, n) = self.supports.project(patch, p, reach)?;
                let plane = self.supports.plane(patch).is_some();
                Some((q, if plane { Vector::zeros() } else { self.normal_after_move(v, n) }))
            }
            Kind::Curve(a, b) => {
                let (q, n) = self.supports.project_curve(a, b, p, reach)?;
                Some((q, n.map_or_else(Vector::zeros, |n| self.normal_after_move(v, n))))
            }
            _ => None,
        }
    }

    /// Normal of the carrier at a vertex of kind `Surface`.
    #[inline]
    pub fn carrier_normal(&self, v: u32) -> Vector {
        match self.kind[v as usize] {
            Kind::Surface(patch) => self.supports.plane(patch).map_or(self.normal[v as usize], |p| p.normal),
            _ => self.normal[v as usize],
        }
    }

    /// Direction of the rim at a vertex of kind `Curve`.
    pub fn rim_direction(&self, v: u32) -> Option<Vector> {
        let Kind::Curve(a, b) = self.kind[v as usize] else { return None };
        let normal = |id| self.supports.plane(id).map_or(self.normal[v as usize], |p| p.normal);
        normal(a).cross(&normal(b)).try_normalize(1e-9)
    }

    /// The two neighbours of `v` along its feature.
    pub fn feature_neighbours(&self, v: u32) -> Option<[u32; 2]> {
        let mut it = self.mesh.outgoing(v).filter(|&h| self.mesh.is_feature(h)).map(|h| self.mesh.target(h));
        let pair = [it.next()?, it.next()?];
        it.next().is_none().then_some(pair)
    }

    /// Brings every vertex that may move onto its carrier to rounding. Returns how many could not be.
    pub fn project_all(&mut self) -> usize {
        let ids = self.vertices();
        let placed: Vec<Option<(Point, Vector)>> = ids
            .par_iter()
            .map(|&v| self.project(v, self.point(v), 2.0 * self.size[v as usize]))
            .collect();
        let mut failed = 0;
        for (&v, place) in ids.iter().zip(placed) {
            match place {
                Some((p, n)) => {
                    self.mesh.points[v as usize] = p;
                    self.normal[v as usize] = n;
                }
                None => failed += usize::from(self.kind[v as usize].moves()),
            }
        }
        failed
    }
}

fn classify(mesh: &HalfEdgeMesh, v: u32) -> Kind {
    if !mesh.has_vertex(v) {
        return Kind::Locked;
    }
    let mut features = 0;
    let mut patches: Vec<PatchId> = Vec::new();
    for h in mesh.outgoing(v) {
        features += usize::from(mesh.is_feature(h));
        let id = mesh.patch(h / 3);
        if !patches.contains(&id) {
            patches.push(id);
        }
    }
    patches.sort_unstable();
    match (features, patches.as_slice()) {
        (0, &[id]) => Kind::Surface(id),
        (2, &[a, b]) => Kind::Curve(a, b),
        (2, &[_]) => Kind::Crease,
        _ => Kind::Corner,
    }
}
