//! A part of a mesh, closed by cones over its border, so that it can be remeshed by itself and put back.
//!
//! Remeshing has to look at the whole mesh that it is given. Where only a few rings shall change, a cutout makes its
//! cost that of the rings, and lets any number of attempts be compared before one of them is kept.

use crate::geometry::{Point, Vector};
use crate::mesh::TriMesh;

const TIP: u32 = u32::MAX;

/// Some triangles of a mesh as a closed mesh of their own.
#[derive(Debug, Clone)]
pub(crate) struct Cutout {
    /// The triangles, then the cones. Vertices of the border and the cones' tips come first.
    pub mesh: TriMesh,
    /// Vertices that may change: those that have all their triangles here.
    pub active: Vec<bool>,
    /// Vertex in the whole mesh of each vertex here; [`TIP`] for the cones' tips.
    global: Vec<u32>,
    /// Vertices of the border and tips: the first so many.
    held: usize,
    /// Triangles taken, ascending.
    taken: Vec<u32>,
    /// Edges outside that join two vertices of the border, each as lower and higher id, ascending.
    outside: Vec<[u32; 2]>,
}

/// Triangles at each vertex.
pub(crate) struct Fans {
    first: Vec<u32>,
    list: Vec<u32>,
}

impl Fans {
    pub fn new(mesh: &TriMesh) -> Fans {
        let mut first = vec![0u32; mesh.points.len() + 1];
        for &v in mesh.triangles.iter().flatten() {
            first[v as usize + 1] += 1;
        }
        for i in 0..mesh.points.len() {
            first[i + 1] += first[i];
        }
        let mut next = first.clone();
        let mut list = vec![0; 3 * mesh.triangles.len()];
        for (t, ids) in mesh.triangles.iter().enumerate() {
            for &v in ids {
                list[next[v as usize] as usize] = t as u32;
                next[v as usize] += 1;
            }
        }
        Fans { first, list }
    }

    pub fn at(&self, v: u32) -> &[u32] {
        &self.list[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }

    /// `triangles` and what lies within `rings` rings of vertices round them, ascending.
    pub fn grown(&self, mesh: &TriMesh, triangles: &[u32], rings: usize) -> Vec<u32> {
        let mut all: Vec<u32> = triangles.to_vec();
        all.sort_unstable();
        for _ in 0..rings {
            let mut vertices: Vec<u32> = all.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
            vertices.sort_unstable();
            vertices.dedup();
            all = vertices.iter().flat_map(|&v| self.at(v).iter().copied()).collect();
            all.sort_unstable();
            all.dedup();
        }
        all
    }
}

/// The triangles within `rings` rings of `seeds`, in parts that share no vertex; each part ascending.
pub(crate) fn parts(mesh: &TriMesh, fans: &Fans, seeds: &[u32], rings: usize) -> Vec<Vec<u32>> {
    let all = fans.grown(mesh, seeds, rings);
    let mut part = vec![usize::MAX; all.len()];
    let mut found: Vec<Vec<u32>> = Vec::new();
    for start in 0..all.len() {
        if part[start] != usize::MAX {
            continue;
        }
        part[start] = found.len();
        let mut list = vec![all[start]];
        let mut i = 0;
        while i < list.len() {
            for &v in &mesh.triangles[list[i] as usize] {
                for t in fans.at(v) {
                    if let Ok(n) = all.binary_search(t).map_err(|_| ()) && part[n] == usize::MAX {
                        part[n] = found.len();
                        list.push(*t);
                    }
                }
            }
            i += 1;
        }
        list.sort_unstable();
        found.push(list);
    }
    found
}

impl Cutout {
    /// Takes `taken` (ascending) out of `mesh`.
    pub fn new(mesh: &TriMesh, fans: &Fans, taken: Vec<u32>) -> Cutout {
        // A vertex at which the part touches itself becomes one vertex for each of its fans.
        let mut corner: Vec<[u32; 3]> = vec![[TIP; 3]; taken.len()];
        let mut vertices: Vec<u32> = taken.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let place = |t: u32| taken.binary_search(&t).ok();
        let corner_of = |t: u32, v: u32| mesh.triangles[t as usize].iter().position(|&w| w == v);
        let (mut border, mut inner): (Vec<(u32, Vec<u32>)>, Vec<(u32, Vec<u32>)>) = Default::default();
        for &v in &vertices {
            let whole = fans.at(v).len();
            let mut left: Vec<u32> = fans.at(v).iter().copied().filter(|&t| place(t).is_some()).collect();
            while let Some(t) = left.pop() {
                let mut fan = vec![t];
                let mut i = 0;
                while i < fan.len() {
                    let here = mesh.triangles[fan[i] as usize];
                    let shares = |t: &u32| mesh.triangles[*t as usize].iter().any(|w| *w != v && here.contains(w));
                    let (joined, rest) = left.into_iter().partition(|t| shares(t));
                    left = rest;
                    let joined: Vec<u32> = joined;
                    fan.extend(joined);
                    i += 1;
                }
                if fan.len() == whole { inner.push((v, fan)) } else { border.push((v, fan)) }
            }
        }
        let borders = border.len();
        let mut global = Vec::with_capacity(borders + inner.len());
        let name = |corner: &mut [[u32; 3]], list: &[(u32, Vec<u32>)], shift: usize| {
            for (n, (v, fan)) in list.iter().enumerate() {
                for &t in fan {
                    if let (Some(i), Some(c)) = (place(t), corner_of(t, *v)) {
                        corner[i][c] = (n + shift) as u32;
                    }
                }
            }
        };
        name(&mut corner, &border, 0);
        global.extend(border.iter().map(|b| b.0));

        // Open edges, against the direction of the triangles that have them: cones run along them.
        let mut directed: Vec<[u32; 2]> = corner.iter().flat_map(|c| [[c[0], c[1]], [c[1], c[2]], [c[2], c[0]]]).collect();
        // The inner vertices are not named yet: edges between two border vertices are all that matter here.
        directed.retain(|e| e[0] != TIP && e[1] != TIP);
        directed.sort_unstable();
        let open: Vec<[u32; 2]> =
            directed.iter().filter(|e| directed.binary_search(&[e[1], e[0]]).is_err()).map(|e| [e[1], e[0]]).collect();
        let mut next = vec![TIP; borders];
        for e in &open {
            next[e[0] as usize] = e[1];
        }
        let mut tip_of = vec![TIP; borders];
        let mut tips: Vec<Point> = Vec::new();
        for start in 0..borders {
            if tip_of[start] != TIP {
                continue;
            }
            let (mut at, mut sum, mut count) = (start as u32, Vector::zeros(), 0.0);
            while at != TIP && tip_of[at as usize] == TIP {
                tip_of[at as usize] = (borders + tips.len()) as u32;
                sum += mesh.points[border[at as usize].0 as usize].coords;
                count += 1.0;
                at = next[at as usize];
            }
            tips.push(Point::from(sum / count));
        }
        let held = borders + tips.len();
        name(&mut corner, &inner, held);
        global.extend(tips.iter().map(|_| TIP));
        global.extend(inner.iter().map(|b| b.0));

        let mut points: Vec<Point> = border.iter().map(|b| mesh.points[b.0 as usize]).collect();
        points.extend(&tips);
        points.extend(inner.iter().map(|b| mesh.points[b.0 as usize]));
        let mut triangles = corner;
        let mut patch: Vec<u32> = taken.iter().map(|&t| mesh.patch[t as usize]).collect();
        for e in &open {
            triangles.push([e[0], e[1], tip_of[e[0] as usize]]);
            patch.push(crate::mesh::WALL);
        }
        let mut names: Vec<u32> = border.iter().map(|b| b.0).collect();
        names.sort_unstable();
        names.dedup();
        let mut outside = Vec::new();
        for &v in &names {
            for &t in fans.at(v).iter().filter(|&&t| place(t).is_none()) {
                let ids = mesh.triangles[t as usize];
                for i in 0..3 {
                    let (a, b) = (ids[i].min(ids[(i + 1) % 3]), ids[i].max(ids[(i + 1) % 3]));
                    if (a == v || b == v) && names.binary_search(&a).is_ok() && names.binary_search(&b).is_ok() {
                        outside.push([a, b]);
                    }
                }
            }
        }
        outside.sort_unstable();
        outside.dedup();
        let active = (0..points.len()).map(|v| v >= held).collect();
        Cutout {
            mesh: TriMesh { points, triangles, patch, patches: mesh.patches.clone() },
            active,
            global,
            held,
            taken,
            outside,
        }
    }

    /// Whether a triangle of the cutout or of what became of it belongs to a cone.
    pub fn is_cone(&self, triangle: &[u32; 3]) -> bool {
        triangle.iter().any(|&v| (v as usize) < self.held && self.global[v as usize] == TIP)
    }

    /// The triangles of `mesh`, which this cutout became, without the cones.
    pub fn real<'m>(&'m self, mesh: &'m TriMesh) -> impl Iterator<Item = usize> + 'm {
        (0..mesh.triangles.len()).filter(|&t| !self.is_cone(&mesh.triangles[t]))
    }

    /// Vertices of `mesh`, which this cutout became, that may change.
    pub fn active_in(&self, mesh: &TriMesh) -> Vec<bool> {
        (0..mesh.points.len()).map(|v| v >= self.held).collect()
    }

    /// Whether `mesh`, which this cutout became, fits back in: no edge between two vertices of the border that the
    /// rest of the whole mesh has too.
    pub fn fits(&self, mesh: &TriMesh) -> bool {
        let mut edges: Vec<[u32; 4]> = Vec::new();
        for t in self.real(mesh) {
            let ids = mesh.triangles[t];
            for i in 0..3 {
                let (a, b) = (ids[i], ids[(i + 1) % 3]);
                if (a as usize) < self.held && (b as usize) < self.held {
                    let (x, y) = (self.global[a as usize], self.global[b as usize]);
                    edges.push([x.min(y), x.max(y), a.min(b), a.max(b)]);
                }
            }
        }
        edges.sort_unstable();
        edges.dedup();
        // Edges of the border itself lie outside too: they were there before.
        let before = |e: &[u32; 4]| {
            self.mesh.triangles.iter().any(|t| t.contains(&e[2]) && t.contains(&e[3]) && self.is_cone(t))
        };
        edges.iter().all(|e| e[0] != e[1])
            && edges.windows(2).all(|w| w[0][..2] != w[1][..2])
            && edges.iter().all(|e| self.outside.binary_search(&[e[0], e[1]]).is_err() || before(e))
    }
}

/// Puts what cutouts became back into the mesh that they were taken from. The cutouts share no vertex.
pub(crate) fn put_back(mesh: &TriMesh, parts: &[(Cutout, TriMesh)]) -> TriMesh {
    let mut gone = vec![false; mesh.triangles.len()];
    let mut dropped = vec![false; mesh.points.len()];
    for (cutout, _) in parts {
        cutout.taken.iter().for_each(|&t| gone[t as usize] = true);
        cutout.global[cutout.held..].iter().for_each(|&v| dropped[v as usize] = true);
    }
    let mut number = vec![TIP; mesh.points.len()];
    let mut points = Vec::with_capacity(mesh.points.len());
    for (v, p) in mesh.points.iter().enumerate().filter(|(v, _)| !dropped[*v]) {
        number[v] = points.len() as u32;
        points.push(*p);
    }
    let kept: Vec<usize> = (0..mesh.triangles.len()).filter(|&t| !gone[t]).collect();
    let mut triangles: Vec<[u32; 3]> = kept.iter().map(|&t| mesh.triangles[t].map(|v| number[v as usize])).collect();
    let mut patch: Vec<u32> = kept.iter().map(|&t| mesh.patch[t]).collect();
    for (cutout, new) in parts {
        let base = points.len() as u32;
        points.extend(&new.points[cutout.held..]);
        let id = |v: u32| {
            if (v as usize) < cutout.held { number[cutout.global[v as usize] as usize] } else { base + v - cutout.held as u32 }
        };
        for t in cutout.real(new) {
            triangles.push(new.triangles[t].map(id));
            patch.push(new.patch[t]);
        }
    }
    TriMesh { points, triangles, patch, patches: mesh.patches.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::topology::check;
    use crate::remesh::testing::{Torus, polygonize};

    #[test]
    fn a_part_taken_out_and_put_back_is_the_same_surface() {
        let mesh = polygonize(&Torus { axis: 3.0, radius: 1.0 }, 0.4);
        let fans = Fans::new(&mesh);
        // Two patches on opposite sides, and a band right round the tube, which has two borders.
        let band: Vec<u32> = (0..mesh.triangles.len() as u32).filter(|&t| {
            let [a, ..] = mesh.corners(t as usize);
            a.x.abs() < 0.5 && a.y > 0.0
        }).collect();
        for seeds in [vec![5], band] {
            let taken = fans.grown(&mesh, &seeds, 2);
            let cutout = Cutout::new(&mesh, &fans, taken.clone());
            assert!(check(&cutout.mesh).is_closed_manifold(), "{:?}", check(&cutout.mesh));
            assert!(cutout.fits(&cutout.mesh));
            let local = cutout.mesh.clone();
            let back = put_back(&mesh, &[(cutout, local)]);
            let r = check(&back);
            assert!(r.is_closed_manifold() && r.euler == 0, "{r:?}");
            assert_eq!((back.triangles.len(), back.points.len()), (mesh.triangles.len(), mesh.points.len()));
            assert!((back.volume() - mesh.volume()).abs() < 1e-12);
        }
    }
}
