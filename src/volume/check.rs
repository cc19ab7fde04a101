//! Is the surface fit for TetGen, and did TetGen bring back what was asked?
//!
//! TetGen accepts open surfaces silently (no tetrahedra), aborts on NaN and flat input and merges
//! duplicate points: everything is looked at before, and again after.

use serde::Serialize;

use crate::geometry::{Point, Vector};
use crate::mesh::TriMesh;
use crate::mesh::intersect::{Side, side_of_plane};
use crate::remesh::shape::skewness;

/// Something wrong with a surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceFault {
    /// What is wrong.
    pub what: &'static str,
    /// How often.
    pub count: usize,
    /// Some of the triangles concerned, at most ten.
    pub triangles: Vec<u32>,
    /// Where the first one is, mm.
    pub near: Option<[f64; 3]>,
    /// What to change.
    pub advice: &'static str,
}

impl std::fmt::Display for SurfaceFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({} found", self.what, self.count)?;
        if !self.triangles.is_empty() {
            write!(f, "; triangles {:?}", self.triangles)?;
        }
        if let Some([x, y, z]) = self.near {
            write!(f, "; the first near ({x:.4}, {y:.4}, {z:.4}) mm")?;
        }
        write!(f, "): {}", self.advice)
    }
}

/// Where a sound surface is nearest to being at fault: the middles of its ten sharpest edges, as seen from either side, and
/// of its ten most skewed triangles.
pub(super) fn doubtful(mesh: &TriMesh) -> Vec<Point> {
    let mut edges: Vec<([u32; 2], u32, u32)> = Vec::with_capacity(3 * mesh.triangles.len());
    for t in &mesh.triangles {
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            edges.push(([a.min(b), a.max(b)], t[(i + 2) % 3], a));
        }
    }
    edges.sort_unstable();
    let p = |v: u32| mesh.points[v as usize];
    let mut sharp: Vec<(f64, Point)> = edges
        .chunk_by(|x, y| x.0 == y.0)
        .filter(|g| g.len() == 2)
        .map(|g| {
            let ([a, b], c, d) = (g[0].0, g[0].1, g[1].1);
            let e = p(b) - p(a);
            let (n, k) = (e.cross(&(p(c) - p(a))), (p(d) - p(a)).cross(&e));
            // 1 where both triangles lie in one plane, −1 where they lie on each other.
            (n.dot(&k) / (n.norm() * k.norm()), nalgebra::center(&p(a), &p(b)))
        })
        .collect();
    sharp.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut skewed: Vec<(f64, Point)> = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (skewness(&a, &b, &c), Point::from((a.coords + b.coords + c.coords) / 3.0))
        })
        .collect();
    skewed.sort_by(|a, b| b.0.total_cmp(&a.0));
    sharp.into_iter().take(10).chain(skewed.into_iter().take(10)).map(|(_, p)| p).collect()
}

/// The first fault of a surface that is to be filled, in the order: finite, ids, closed, oriented, crossing.
///
/// # Errors
/// The fault, with the triangles and what to change.
pub fn surface(mesh: &TriMesh) -> Result<(), SurfaceFault> {
    let fault = |what, bad: &[usize], advice| SurfaceFault {
        what,
        count: bad.len(),
        triangles: bad.iter().take(10).map(|&t| t as u32).collect(),
        near: bad.first().and_then(|&t| place(mesh, t)),
        advice,
    };
    let n = mesh.points.len();
    if mesh.triangles.is_empty() {
        return Err(fault("the surface has no triangles", &[], "give a closed surface"));
    }
    if mesh.patch.len() != mesh.triangles.len() {
        return Err(fault("the surface has not one patch number a triangle", &[], "give one patch number a triangle"));
    }
    let select = |f: &dyn Fn(usize) -> bool| -> Vec<usize> { (0..mesh.triangles.len()).filter(|&t| f(t)).collect() };
    let bad = select(&|t| mesh.triangles[t].iter().any(|&v| v as usize >= n));
    if !bad.is_empty() {
        return Err(fault("vertex ids beyond the list of points", &bad, "write the surface anew"));
    }
    let bad = select(&|t| mesh.corners(t).iter().any(|p| !p.coords.iter().all(|x| x.is_finite())));
    if !bad.is_empty() {
        return Err(fault("coordinates that are not finite", &bad, "remove NaN and infinite points"));
    }
    let bad = select(&|t| {
        let [a, b, c] = mesh.triangles[t];
        a == b || b == c || c == a || mesh.area_vector2(t).norm() == 0.0
    });
    if !bad.is_empty() {
        return Err(fault("degenerate triangles", &bad, "remesh the surface: collapse edges of no length"));
    }
    let mut used = vec![false; n];
    mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
    if let Some(v) = used.iter().position(|u| !u) {
        return Err(SurfaceFault {
            what: "points that no triangle uses",
            count: used.iter().filter(|&&u| !u).count(),
            triangles: vec![],
            near: Some(mesh.points[v].into()),
            advice: "remove unused points from the surface",
        });
    }
    let bounds = mesh.bounds();
    let reach = bounds.min.coords.amax().max(bounds.max.coords.amax());
    if !(1e-100..1e100).contains(&reach) || bounds.diagonal() < 1e-9 * reach {
        return Err(fault(
            "coordinates out of range",
            &[],
            "bring the surface to millimetres near the origin; its size must not drown in its distance from there",
        ));
    }
    edges(mesh)?;
    duplicates(mesh)?;
    if mesh.volume() <= 1e-12 * bounds.diagonal().powi(3) {
        return Err(fault(
            "the surface encloses no volume, or is inside out",
            &[],
            "turn the triangles so that their normals point outwards",
        ));
    }
    Ok(())
}

fn place(mesh: &TriMesh, t: usize) -> Option<[f64; 3]> {
    let c: Vec<&Point> = mesh.triangles[t].iter().filter_map(|&v| mesh.points.get(v as usize)).collect();
    let p = c.iter().fold(Vector::zeros(), |s, p| s + p.coords) / c.len().max(1) as f64;
    (!c.is_empty()).then(|| p.into())
}

fn edges(mesh: &TriMesh) -> Result<(), SurfaceFault> {
    let mut half: Vec<(u32, u32, bool, u32)> = mesh
        .triangles
        .iter()
        .enumerate()
        .flat_map(|(t, c)| {
            (0..3).map(move |i| {
                let (a, b) = (c[i], c[(i + 1) % 3]);
                (a.min(b), a.max(b), a < b, t as u32)
            })
        })
        .collect();
    half.sort_unstable();
    let (mut open, mut many, mut turned) = (vec![], vec![], vec![]);
    for g in half.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        match g {
            [one] => open.push(one.3),
            [a, b] if a.2 == b.2 => turned.push(a.3),
            [_, _] => {}
            more => many.push(more[0].3),
        }
    }
    for (bad, what, advice) in [
        (open, "edges with one triangle: the surface is open", "close the holes (caps at every opening)"),
        (many, "edges with more than two triangles", "remesh the surface, or clean the mask where parts touch"),
        (turned, "neighbouring triangles with opposite orientation", "orient all triangles outwards"),
    ] {
        if let Some(&first) = bad.first() {
            let near = place(mesh, first as usize);
            return Err(SurfaceFault {
                what,
                count: bad.len(),
                triangles: bad.into_iter().take(10).collect(),
                near,
                advice,
            });
        }
    }
    Ok(())
}

fn duplicates(mesh: &TriMesh) -> Result<(), SurfaceFault> {
    let mut order: Vec<u32> = (0..mesh.points.len() as u32).collect();
    let key = |v: u32| {
        // Adding zero makes -0.0 and 0.0 one.
        let p = mesh.points[v as usize];
        [p.x + 0.0, p.y + 0.0, p.z + 0.0].map(f64::to_bits)
    };
    order.sort_unstable_by_key(|&v| key(v));
    let twice: Vec<u32> = order.windows(2).filter(|w| key(w[0]) == key(w[1])).map(|w| w[1]).collect();
    let Some(&v) = twice.first() else { return Ok(()) };
    let triangles = (0..mesh.triangles.len() as u32).filter(|&t| mesh.triangles[t as usize].contains(&v)).take(10);
    Err(SurfaceFault {
        what: "points at the same place",
        count: twice.len(),
        triangles: triangles.collect(),
        near: Some(mesh.points[v as usize].into()),
        advice: "weld the points, or clean the mask where parts touch",
    })
}

/// What is wrong with a mesh that TetGen made from `surface`; `None` where it is as asked.
///
/// Looks at: the surface's points first and bit-equal, volumes positive, boundary faces equal to the surface's
/// (hence conforming), volume equal within 1e-9.
pub(super) fn filled(surface: &TriMesh, points: &[Point], tets: &[[u32; 4]]) -> Option<String> {
    if tets.is_empty() {
        return Some("no tetrahedra came back".into());
    }
    let n = surface.points.len();
    if points.len() < n || points[..n] != surface.points[..] {
        return Some("the surface's points were changed".into());
    }
    let mut volume = 0.0;
    let o = points[0];
    for t in tets {
        let p = t.map(|v| points[v as usize]);
        if side_of_plane(&p[0], &p[1], &p[2], &p[3]) != Side::Above {
            return Some(format!("a tetrahedron of no volume near {:?}", p[0].coords.as_slice()));
        }
        volume += (p[1] - p[0]).cross(&(p[2] - p[0])).dot(&(p[3] - p[0])) / 6.0;
    }
    let want = surface.volume();
    // The sum's rounding grows with the distances that enter the surface's own volume.
    let scale = surface.area() * points[..n].iter().map(|p| (p - o).norm()).fold(0.0, f64::max);
    if (volume - want).abs() > 1e-9 * want + 1e-14 * scale {
        return Some(format!("the tetrahedra fill {volume} mm³ of {want} mm³"));
    }
    let mut faces: Vec<[u32; 3]> = boundary_faces(tets);
    let mut wanted = surface.triangles.clone();
    for f in faces.iter_mut().chain(&mut wanted) {
        let least = (0..3).min_by_key(|&i| f[i]).unwrap_or(0);
        f.rotate_left(least);
    }
    faces.sort_unstable();
    wanted.sort_unstable();
    if faces != wanted {
        let missing = wanted.iter().filter(|f| faces.binary_search(f).is_err()).count();
        return Some(format!("{missing} of {} surface triangles are not faces of the mesh", wanted.len()));
    }
    None
}

/// Faces that belong to one tetrahedron only, counter-clockwise seen from outside, by rising vertex ids.
pub(super) fn boundary_faces(tets: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let mut keyed: Vec<([u32; 3], [u32; 3])> = tets
        .iter()
        .flat_map(|&[a, b, c, d]| [[b, c, d], [a, d, c], [a, b, d], [a, c, b]])
        .map(|f| {
            let mut k = f;
            k.sort_unstable();
            (k, f)
        })
        .collect();
    keyed.sort_unstable();
    keyed.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() == 1).map(|g| g[0].1).collect()
}
