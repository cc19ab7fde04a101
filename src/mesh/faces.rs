//! The faces of a volume mesh with the cells on both sides, in OpenFOAM's order.
//!
//! Inner faces come first, sorted by (owner, neighbour) with owner < neighbour ("upper-triangular"), then the
//! boundary, patch by patch, sorted by owner. The right-hand normal of a face points out of its owner.
//! Cell ids: tetrahedra first, prisms after them. Time and memory are linear in the number of cells.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use rayon::prelude::*;

use super::{Patch, VolumeMesh};
use crate::geometry::Point;

/// Faces of a tetrahedron, normals out of it.
pub const TET_FACES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
/// Faces of a prism in VTK's order, normals out of it; the last index repeats for a triangle.
pub const PRISM_FACES: [[usize; 4]; 5] = [[0, 1, 2, 2], [3, 5, 4, 4], [0, 3, 4, 1], [1, 4, 5, 2], [2, 5, 3, 0]];
/// No vertex, no cell.
const NONE: u32 = u32::MAX;

/// Why the cells do not make a mesh.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FaceError {
    /// Three or more cells on one face.
    #[error("face {vertices:?} belongs to more than two cells, among them cells {cells:?}: remove the duplicate or overlapping cells")]
    Shared {
        /// Vertices of the face.
        vertices: Vec<u32>,
        /// Three of its cells.
        cells: [u32; 3],
    },
    /// A face with one cell that is not in the boundary list.
    #[error("face {vertices:?} of cell {cell} has no neighbour and no patch: the mesh does not conform there, or the boundary list is incomplete")]
    Unlisted {
        /// Vertices of the face.
        vertices: Vec<u32>,
        /// Its cell.
        cell: u32,
    },
    /// A boundary face that no cell has, that two cells share, or that is listed twice.
    #[error("boundary face {face} {vertices:?} is listed twice, or is not the face of exactly one cell")]
    NotOuter {
        /// Index in the boundary list.
        face: u32,
        /// Its vertices.
        vertices: Vec<u32>,
    },
    /// A vertex id beyond the points.
    #[error("cell {cell} names vertex {vertex}, but there are only {points} points")]
    Vertex {
        /// Cell id.
        cell: u32,
        /// Vertex id.
        vertex: u32,
        /// Number of points.
        points: usize,
    },
    /// More cells than ids.
    #[error("{0} cells are more than this program can number (858 million)")]
    TooMany(usize),
}

/// The faces of a patch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PatchRange {
    /// The patch.
    pub patch: Patch,
    /// First face.
    pub start: usize,
    /// Number of faces; may be 0.
    pub count: usize,
}

/// What measures and writers ask of a mesh made of faces.
pub trait FaceMesh: Sync {
    /// Vertex positions.
    fn points(&self) -> &[Point];
    /// Number of cells.
    fn cells(&self) -> usize;
    /// Vertices of a face; the right-hand normal points out of the owner.
    fn face(&self, f: usize) -> &[u32];
    /// Owner of each face.
    fn owner(&self) -> &[u32];
    /// Neighbour of each inner face; inner faces come first.
    fn neighbour(&self) -> &[u32];
    /// Patches, covering all faces from `neighbour().len()` on.
    fn patches(&self) -> &[PatchRange];
}

/// Owner, neighbour and vertices of every face of a [`VolumeMesh`].
#[derive(Debug, Clone)]
pub struct FaceList<'a> {
    /// The mesh's points.
    pub points: &'a [Point],
    /// Number of cells.
    pub cells: usize,
    /// Vertex ids; the last repeats the third for a triangle.
    pub vertices: Vec<[u32; 4]>,
    /// Owner of each face.
    pub owner: Vec<u32>,
    /// Neighbour of each inner face.
    pub neighbour: Vec<u32>,
    /// Patches by id, faces contiguous.
    pub patches: Vec<PatchRange>,
}

impl FaceMesh for FaceList<'_> {
    fn points(&self) -> &[Point] {
        self.points
    }
    fn cells(&self) -> usize {
        self.cells
    }
    fn face(&self, f: usize) -> &[u32] {
        let v = &self.vertices[f];
        if v[2] == v[3] { &v[..3] } else { v }
    }
    fn owner(&self) -> &[u32] {
        &self.owner
    }
    fn neighbour(&self) -> &[u32] {
        &self.neighbour
    }
    fn patches(&self) -> &[PatchRange] {
        &self.patches
    }
}

/// A mesh of arbitrary polyhedra given by its faces.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PolyMesh {
    /// Vertex positions.
    pub points: Vec<Point>,
    /// Number of cells.
    pub cells: usize,
    /// Where each face starts in `vertices`; one more entry than faces.
    pub offsets: Vec<usize>,
    /// Vertex ids of all faces.
    pub vertices: Vec<u32>,
    /// Owner of each face.
    pub owner: Vec<u32>,
    /// Neighbour of each inner face.
    pub neighbour: Vec<u32>,
    /// Patches, contiguous after the inner faces.
    pub patches: Vec<PatchRange>,
}

impl FaceMesh for PolyMesh {
    fn points(&self) -> &[Point] {
        &self.points
    }
    fn cells(&self) -> usize {
        self.cells
    }
    fn face(&self, f: usize) -> &[u32] {
        &self.vertices[self.offsets[f]..self.offsets[f + 1]]
    }
    fn owner(&self) -> &[u32] {
        &self.owner
    }
    fn neighbour(&self) -> &[u32] {
        &self.neighbour
    }
    fn patches(&self) -> &[PatchRange] {
        &self.patches
    }
}

/// Sorted vertices of a face; a triangle ends in `NONE`.
fn key(mut v: [u32; 4]) -> [u32; 4] {
    if v[2] == v[3] {
        v[3] = NONE;
    }
    v.sort_unstable();
    v
}

/// Vertices of a face as a list.
fn ids(v: &[u32; 4]) -> Vec<u32> {
    if v[2] == v[3] { v[..3].to_vec() } else { v.to_vec() }
}

impl VolumeMesh {
    /// Number of cells.
    pub fn cell_count(&self) -> usize {
        self.tets.len() + self.prisms.len()
    }

    /// Vertex ids of a cell: four or six.
    pub fn cell(&self, c: usize) -> &[u32] {
        match c.checked_sub(self.tets.len()) {
            None => &self.tets[c],
            Some(p) => &self.prisms[p],
        }
    }

    /// Number of faces of a cell.
    fn face_count(&self, c: usize) -> usize {
        if c < self.tets.len() { 4 } else { 5 }
    }

    /// Number of the first face of a cell, counting each cell's faces by itself.
    fn first_handle(&self, c: usize) -> usize {
        4 * c + c.saturating_sub(self.tets.len())
    }

    /// Cell of such a number.
    fn cell_of(&self, h: u32) -> u32 {
        let (h, t) = (h as usize, self.tets.len());
        (if h < 4 * t { h / 4 } else { t + (h - 4 * t) / 5 }) as u32
    }

    /// Face `i` of cell `c`, normal out of it; the last vertex repeats the third for a triangle.
    pub fn cell_face(&self, c: usize, i: usize) -> [u32; 4] {
        match c.checked_sub(self.tets.len()) {
            None => {
                let [a, b, d] = TET_FACES[i].map(|j| self.tets[c][j]);
                [a, b, d, d]
            }
            Some(p) => PRISM_FACES[i].map(|j| self.prisms[p][j]),
        }
    }

    /// For every face of every cell the number of the same face in the neighbour, or `NONE`.
    fn mates(&self) -> Result<Vec<AtomicU32>, FaceError> {
        let (n, cells) = (self.points.len(), self.cell_count());
        let handles = self.first_handle(cells);
        if handles >= NONE as usize {
            return Err(FaceError::TooMany(cells));
        }
        if let Some(c) = (0..cells).into_par_iter().find_first(|&c| self.cell(c).iter().any(|&v| v as usize >= n)) {
            let vertex = self.cell(c).iter().copied().find(|&v| v as usize >= n).unwrap_or(NONE);
            return Err(FaceError::Vertex { cell: c as u32, vertex, points: n });
        }
        // Bucket by smallest vertex.
        let cursor: Vec<AtomicU32> = (0..=n).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        (0..cells).into_par_iter().for_each(|c| {
            for i in 0..self.face_count(c) {
                cursor[key(self.cell_face(c, i))[0] as usize].fetch_add(1, Relaxed);
            }
        });
        let mut sum = 0;
        for c in &cursor {
            sum += c.swap(sum, Relaxed);
        }
        let start: Vec<u32> = cursor.iter().map(|c| c.load(Relaxed)).collect();
        let bucket: Vec<AtomicU32> = (0..handles).into_par_iter().map(|_| AtomicU32::new(NONE)).collect();
        (0..cells).into_par_iter().for_each(|c| {
            let first = self.first_handle(c);
            for i in 0..self.face_count(c) {
                let at = cursor[key(self.cell_face(c, i))[0] as usize].fetch_add(1, Relaxed);
                bucket[at as usize].store((first + i) as u32, Relaxed);
            }
        });
        drop(cursor);
        // The order inside a bucket depends on the threads; sorting by (key, number) undoes that.
        let mate: Vec<AtomicU32> = (0..handles).into_par_iter().map(|_| AtomicU32::new(NONE)).collect();
        let bad = (0..n).into_par_iter().find_map_first(|v| {
            let mut list: Vec<([u32; 4], u32)> = bucket[start[v] as usize..start[v + 1] as usize]
                .iter()
                .map(|h| {
                    let h = h.load(Relaxed);
                    let c = self.cell_of(h) as usize;
                    (key(self.cell_face(c, h as usize - self.first_handle(c))), h)
                })
                .collect();
            list.sort_unstable();
            for group in list.chunk_by(|a, b| a.0 == b.0) {
                match group {
                    [_] => {}
                    [a, b] => {
                        mate[a.1 as usize].store(b.1, Relaxed);
                        mate[b.1 as usize].store(a.1, Relaxed);
                    }
                    more => {
                        let vertices = more[0].0.iter().copied().filter(|&v| v != NONE).collect();
                        let cells = [0, 1, 2].map(|i| self.cell_of(more[i].1));
                        return Some(FaceError::Shared { vertices, cells });
                    }
                }
            }
            None
        });
        bad.map_or(Ok(mate), Err)
    }

    /// Every face that belongs to one cell only, normal out of the mesh, in the order of the cells.
    ///
    /// # Errors
    /// Where a face has more than two cells or a vertex id is out of range.
    pub fn outer_faces(&self) -> Result<Vec<[u32; 4]>, FaceError> {
        let mate = self.mates()?;
        Ok((0..self.cell_count())
            .into_par_iter()
            .flat_map_iter(|c| {
                let (first, mate) = (self.first_handle(c), &mate);
                (0..self.face_count(c))
                    .filter(move |i| mate[first + i].load(Relaxed) == NONE)
                    .map(move |i| self.cell_face(c, i))
            })
            .collect())
    }
}

impl<'a> FaceList<'a> {
    /// Builds the list. An empty `patches` is taken as one wall.
    ///
    /// # Errors
    /// Where the cells do not conform or `mesh.boundary` is not exactly the outside.
    pub fn build(mesh: &'a VolumeMesh) -> Result<FaceList<'a>, FaceError> {
        let mate = mesh.mates()?;
        let cells = mesh.cell_count();
        // Inner faces, by owner and then neighbour.
        const CHUNK: usize = 1 << 14;
        let chunks: Vec<(Vec<[u32; 4]>, Vec<u32>, Vec<u32>, Vec<(u32, [u32; 4])>)> = (0..cells.div_ceil(CHUNK))
            .into_par_iter()
            .map(|k| {
                let (mut faces, mut owner, mut neighbour, mut outer) = (vec![], vec![], vec![], vec![]);
                let mut own: Vec<(u32, usize)> = Vec::with_capacity(5);
                for c in k * CHUNK..cells.min((k + 1) * CHUNK) {
                    own.clear();
                    let first = mesh.first_handle(c);
                    for i in 0..mesh.face_count(c) {
                        match mate[first + i].load(Relaxed) {
                            NONE => outer.push((c as u32, mesh.cell_face(c, i))),
                            h => {
                                let other = mesh.cell_of(h);
                                // A cell that meets itself: the lower face number owns.
                                if other as usize > c || (other as usize == c && h as usize > first + i) {
                                    own.push((other, i));
                                }
                            }
                        }
                    }
                    own.sort_unstable();
                    for &(other, i) in &own {
                        faces.push(mesh.cell_face(c, i));
                        owner.push(c as u32);
                        neighbour.push(other);
                    }
                }
                (faces, owner, neighbour, outer)
            })
            .collect();
        drop(mate);
        let inner: usize = chunks.iter().map(|c| c.0.len()).sum();
        let outer: usize = chunks.iter().map(|c| c.3.len()).sum();
        let mut vertices = Vec::with_capacity(inner + outer);
        let mut owner = Vec::with_capacity(inner + outer);
        let mut neighbour = Vec::with_capacity(inner);
        let mut outside = Vec::with_capacity(outer);
        for (f, o, n, b) in chunks {
            vertices.extend_from_slice(&f);
            owner.extend_from_slice(&o);
            neighbour.extend_from_slice(&n);
            outside.extend_from_slice(&b);
        }
        // Patches of the outer faces.
        let mut listed: Vec<([u32; 4], u32)> =
            mesh.boundary.par_iter().enumerate().map(|(i, b)| (key(b.vertices), i as u32)).collect();
        listed.par_sort_unstable();
        let mut ranked: Vec<(u32, u32, [u32; 4], u32)> = outside
            .par_iter()
            .map(|&(cell, v)| {
                let at = listed.binary_search_by(|e| e.0.cmp(&key(v)));
                let at = at.map_err(|_| FaceError::Unlisted { vertices: ids(&v), cell })?;
                let face = listed[at].1;
                Ok((mesh.boundary[face as usize].patch, cell, v, face))
            })
            .collect::<Result<_, FaceError>>()?;
        if ranked.len() != listed.len() {
            let mut used = vec![false; listed.len()];
            ranked.iter().for_each(|r| used[r.3 as usize] = true);
            let face = used.iter().position(|u| !u).unwrap_or(0);
            return Err(FaceError::NotOuter { face: face as u32, vertices: mesh.boundary[face].ids().to_vec() });
        }
        ranked.par_sort_unstable();
        let mut patches: Vec<PatchRange> = if mesh.patches.is_empty() {
            vec![PatchRange { patch: Patch::wall(), start: 0, count: 0 }]
        } else {
            mesh.patches.iter().map(|p| PatchRange { patch: p.clone(), start: 0, count: 0 }).collect()
        };
        patches.sort_by_key(|p| p.patch.id);
        for group in ranked.chunk_by(|a, b| a.0 == b.0) {
            let id = group[0].0;
            let at = patches.binary_search_by_key(&id, |p| p.patch.id).unwrap_or_else(|at| {
                let patch = Patch { id, name: format!("patch_{id}"), kind: super::PatchKind::Wall };
                patches.insert(at, PatchRange { patch, start: 0, count: 0 });
                at
            });
            patches[at].count = group.len();
        }
        let mut start = inner;
        for p in &mut patches {
            p.start = start;
            start += p.count;
        }
        vertices.extend(ranked.iter().map(|r| r.2));
        owner.extend(ranked.iter().map(|r| r.1));
        Ok(FaceList { points: &mesh.points, cells, vertices, owner, neighbour, patches })
    }
}

/// Faces of each cell of a [`FaceMesh`], in rising order.
#[derive(Debug, Clone)]
pub struct CellFaces {
    offsets: Vec<u32>,
    faces: Vec<u32>,
}

impl CellFaces {
    /// Gathers them; every owner and neighbour must be below `mesh.cells()`.
    pub fn build(mesh: &impl FaceMesh) -> CellFaces {
        let mut offsets = vec![0u32; mesh.cells() + 2];
        for &c in mesh.owner().iter().chain(mesh.neighbour()) {
            offsets[c as usize + 2] += 1;
        }
        for i in 2..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let mut faces = vec![0u32; mesh.owner().len() + mesh.neighbour().len()];
        let neighbour = mesh.neighbour();
        for (f, &o) in mesh.owner().iter().enumerate() {
            for c in [Some(o), neighbour.get(f).copied()].into_iter().flatten() {
                let at = &mut offsets[c as usize + 1];
                faces[*at as usize] = f as u32;
                *at += 1;
            }
        }
        offsets.pop();
        CellFaces { offsets, faces }
    }

    /// Faces of cell `c`.
    pub fn of(&self, c: usize) -> &[u32] {
        &self.faces[self.offsets[c] as usize..self.offsets[c + 1] as usize]
    }
}
