//! Triangle and volume meshes and what every stage asks of them.

pub mod bvh;
pub mod ends;
pub mod faces;
pub mod halfedge;
pub mod holes;
pub mod intersect;
pub mod polygon;
pub mod regions;
pub mod repair;
pub mod rims;
pub mod split;
#[cfg(test)]
pub(crate) mod test_shapes;
pub mod topology;
pub mod winding;

use serde::Serialize;

use crate::geometry::{Aabb, Point, Vector};

/// Number of a patch: 1 is the wall, 2 the inlet, then further inlets, then outlets.
pub type PatchId = u32;

/// The wall's patch.
pub const WALL: PatchId = 1;

/// What a patch is to the flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PatchKind {
    /// No-slip vessel wall.
    Wall,
    /// Flow enters here.
    Inlet,
    /// Flow leaves here.
    Outlet,
}

/// A named part of the boundary.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Patch {
    /// Number used in cell arrays and solver files.
    pub id: PatchId,
    /// Name: lower case, digits, `_`, `-`; not starting with a digit.
    pub name: String,
    /// Role in the flow.
    pub kind: PatchKind,
}

impl Patch {
    /// The wall.
    pub fn wall() -> Patch {
        Patch { id: WALL, name: "wall".into(), kind: PatchKind::Wall }
    }
}

/// A triangle mesh; triangles run counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriMesh {
    /// Vertex positions, mm.
    pub points: Vec<Point>,
    /// Vertex ids of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Patch of each triangle; as long as `triangles`.
    pub patch: Vec<PatchId>,
    /// The patches, by id. Empty means: all of it is wall.
    pub patches: Vec<Patch>,
}

impl TriMesh {
    /// A mesh that is all wall.
    pub fn new(points: Vec<Point>, triangles: Vec<[u32; 3]>) -> TriMesh {
        let patch = vec![WALL; triangles.len()];
        TriMesh { points, triangles, patch, patches: vec![Patch::wall()] }
    }

    /// The mesh with points of equal coordinates joined into one, in the order of their first appearance.
    #[must_use]
    pub fn welded(&self) -> TriMesh {
        let key = |i: u32| {
            let p = &self.points[i as usize];
            [p.x, p.y, p.z].map(|c| (c + 0.0).to_bits())
        };
        let mut order: Vec<u32> = (0..self.points.len() as u32).collect();
        order.sort_by_key(|&i| (key(i), i));
        let mut first = vec![0u32; self.points.len()];
        for group in order.chunk_by(|&a, &b| key(a) == key(b)) {
            group.iter().for_each(|&i| first[i as usize] = group[0]);
        }
        let (mut id, mut points) = (vec![0u32; self.points.len()], Vec::new());
        for (i, p) in self.points.iter().enumerate() {
            id[i] = if first[i] as usize == i {
                points.push(*p);
                points.len() as u32 - 1
            } else {
                id[first[i] as usize]
            };
        }
        let triangles = self.triangles.iter().map(|t| t.map(|v| id[v as usize])).collect();
        TriMesh { points, triangles, patch: self.patch.clone(), patches: self.patches.clone() }
    }

    /// The three corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [Point; 3] {
        self.triangles[t].map(|v| self.points[v as usize])
    }

    /// Twice the area times the unit normal of triangle `t`.
    pub fn area_vector2(&self, t: usize) -> Vector {
        let [a, b, c] = self.corners(t);
        (b - a).cross(&(c - a))
    }

    /// Surface area, mm².
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| 0.5 * self.area_vector2(t).norm()).sum()
    }

    /// Enclosed volume, mm³; positive where the mesh is closed and oriented outwards.
    pub fn volume(&self) -> f64 {
        // Relative to a point of the mesh: far origins cost digits otherwise.
        let Some(&o) = self.points.first() else { return 0.0 };
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t);
                (a - o).dot(&(b - o).cross(&(c - o))) / 6.0
            })
            .sum()
    }

    /// The smallest box round all points.
    pub fn bounds(&self) -> Aabb {
        Aabb::of(&self.points)
    }
}

/// A triangle or quadrilateral of the boundary of a volume mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoundaryFace {
    /// Vertex ids, counter-clockwise seen from outside; the last repeats the third for a triangle.
    pub vertices: [u32; 4],
    /// Patch of the face.
    pub patch: PatchId,
}

impl BoundaryFace {
    /// A triangle.
    pub fn triangle([a, b, c]: [u32; 3], patch: PatchId) -> BoundaryFace {
        BoundaryFace { vertices: [a, b, c, c], patch }
    }

    /// A quadrilateral.
    pub fn quad(vertices: [u32; 4], patch: PatchId) -> BoundaryFace {
        BoundaryFace { vertices, patch }
    }

    /// The distinct vertices in order.
    pub fn ids(&self) -> &[u32] {
        if self.vertices[2] == self.vertices[3] { &self.vertices[..3] } else { &self.vertices }
    }
}

/// Tetrahedra and triangular prisms with a patched boundary.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VolumeMesh {
    /// Vertex positions, mm.
    pub points: Vec<Point>,
    /// (p1−p0)×(p2−p0)·(p3−p0) > 0: VTK's and TetGen's order.
    pub tets: Vec<[u32; 4]>,
    /// VTK's wedge: triangle 0 1 2 has its normal pointing away from triangle 3 4 5.
    pub prisms: Vec<[u32; 6]>,
    /// Every face that belongs to one cell only.
    pub boundary: Vec<BoundaryFace>,
    /// The patches, by id.
    pub patches: Vec<Patch>,
}
