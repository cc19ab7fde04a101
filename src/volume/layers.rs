//! Boundary layers: prisms grown from the wall inwards, flush in the planes of the caps.
//!
//! Thickness starts at a part of the local radius, shrinks where space is short (opposite wall, concave bends, necks)
//! with a bounded gradient along the wall, and once more wherever a prism or the inner surface would be bad. The
//! number of layers is the same everywhere. At the rims of openings the layers are never flatter than solvers take.

mod rim;
mod turn;

use rayon::prelude::*;
use serde::Serialize;

use super::creases::{hinge, wings};
use super::directions::{Corner, directions};
use super::sizing::{inscribed_radius, smooth_lower};
use crate::geometry::{Point, Vector};
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::halfedge::HalfEdgeMesh;
use crate::mesh::intersect::self_intersections;
use crate::mesh::{BoundaryFace, TriMesh, VolumeMesh, WALL};

/// Most rounds of taking back thickness: a hundred-thousandth of it is left then.
const MOST_ROUNDS: u32 = 40;

/// After so many rounds, thickness is taken back on one more ring of vertices.
const WIDEN: u32 = 6;

/// Rounds in which directions are turned before any thickness is taken back.
const TURNS: u32 = 3;

/// Part of the thickness that is left where the tetrahedra inside came out poor.
const THINNER: f64 = 0.8;

/// Height of the first layer, as a part of the edges round a vertex, under which that is not done.
const LEAST_FIRST: f64 = 0.08;

/// Least angle of the inner surface between two of its triangles, measured inside, degrees.
const LEAST_ANGLE: f64 = 60.0;

/// Least scaled Jacobian at a corner of a prism.
const LEAST_JACOBIAN: f64 = 0.2;

/// Prisms along the wall.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LayerOptions {
    /// Number of layers, at least 1.
    pub count: u32,
    /// Ratio of the heights of neighbouring layers, inwards.
    pub growth: f64,
    /// Thickness of all layers together as a part of the local radius.
    pub total: f64,
    /// Height of the layer at the wall, mm; where given it sets the thickness (never above `total`).
    pub first_height: Option<f64>,
    /// Largest equi-angle skewness of the surface inside the layers.
    pub max_inner_skewness: f64,
}

impl Default for LayerOptions {
    fn default() -> Self {
        LayerOptions { count: 4, growth: 1.2, total: 0.25, first_height: None, max_inner_skewness: 0.6 }
    }
}

/// What became of the layers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LayerSummary {
    /// Prisms.
    pub prisms: usize,
    /// Part of the wall's area with at least 95 % of the wished thickness.
    pub area_at_full_thickness: f64,
    /// Least, median and largest thickness, mm.
    pub thickness: [f64; 3],
    /// Least height of the first layer over the length of a rim edge there; under 0.035 OpenFOAM's determinant fails.
    pub rim_height_ratio: f64,
    /// Largest height of the first layer where it was raised at rims, mm.
    pub rim_first_height: Option<f64>,
    /// Largest equi-angle skewness of a prism.
    pub prism_skewness: f64,
    /// Largest equi-angle skewness of the surface inside the layers.
    pub inner_skewness: f64,
    /// Rounds in which thickness was taken back.
    pub rounds: u32,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// Layers, and the closed surface inside them that is to be filled.
#[derive(Debug, Clone, PartialEq)]
pub struct Layers {
    /// Points of the surface (those of the wall unchanged, those inside the caps moved in their planes), then the
    /// points between the layers.
    pub points: Vec<Point>,
    /// Prisms; triangle 0 1 2 towards the wall.
    pub prisms: Vec<[u32; 6]>,
    /// Wall triangles, quadrilaterals of the caps beside the layers. The rest of the caps belongs to the inner surface.
    pub boundary: Vec<BoundaryFace>,
    /// The surface inside the layers, ids of its own.
    pub inner: TriMesh,
    /// Id in `points` of each point of `inner`.
    pub inner_ids: Vec<u32>,
    /// Thickness at each point of the surface, mm; 0 off the wall.
    pub thickness: Vec<f64>,
    /// Thickness that was wished there, mm.
    pub wished: Vec<f64>,
}

/// Grows layers from the wall of `surface`, which is closed, oriented and free of self-intersection.
///
/// No prism is inverted: at all six corners the three edges are right-handed. Layers start thinner round the vertices
/// of `thinner`, once for each time that one stands there. `stop` is asked before each round.
///
/// # Errors
/// The vertices at which even thin layers are not possible; none where there is no wall and where `stop` said so.
pub fn grow(
    surface: &TriMesh,
    options: &LayerOptions,
    thinner: &[u32],
    stop: &dyn Fn() -> bool,
) -> Result<(Layers, LayerSummary), Vec<u32>> {
    let mut wall = Wall::new(surface).ok_or_else(Vec::new)?;
    let wished = wall.wished(surface, options);
    let steps = steps(options);
    let mut t = wall.limited(surface, &wished);
    for v in thinner.iter().flat_map(|&v| wall.around(surface, v)) {
        let v = v as usize;
        // Never so thin that a solver refuses the first layer.
        t[v] = t[v].min((THINNER * t[v]).max(LEAST_FIRST * wall.size[v] / steps[1]));
    }
    let raised = rim::raise(&wall, surface, &mut t, &steps, options);
    let mut t = smooth_lower(surface, t, 0.25);
    let mut rounds = 0;
    let inner = loop {
        if stop() {
            return Err(Vec::new());
        }
        let ends = wall.ends(surface, &t);
        let inner = wall.inner(surface, &ends);
        // What does not become good by itself suffers from how far its neighbours have moved.
        let bad = wall.bad_vertices(surface, &t, &steps, &inner, options, rounds / WIDEN);
        if bad.is_empty() {
            break inner;
        }
        rounds += 1;
        if rounds > MOST_ROUNDS {
            return Err(bad);
        }
        if rounds <= TURNS && turn::turn(&mut wall, surface, &t, &steps, options, &bad) > 0 {
            continue;
        }
        for v in bad {
            t[v as usize] *= 0.75;
        }
        // Off the wall nothing limits: those entries must not hold the wall down.
        for v in 0..t.len() {
            if !wall.on_wall[v] {
                t[v] = f64::INFINITY;
            }
        }
        t = smooth_lower(surface, t, 0.25);
    };
    let (layers, mut summary) = wall.assemble(surface, t, wished, &steps, inner, options, rounds);
    if let Some(height) = raised {
        let asked = options.first_height.map_or(String::new(), |h| format!(" instead of {h:.4} mm"));
        summary.rim_first_height = Some(height);
        summary.warnings.push(format!(
            "at the rims of openings the first layer is up to {height:.4} mm high{asked}: flatter prisms there fail OpenFOAM's \
             determinant; away from the rims it is as asked for"
        ));
    }
    Ok((layers, summary))
}

/// Depth of each level as a part of the thickness: 0 at the wall, 1 at the end.
fn steps(o: &LayerOptions) -> Vec<f64> {
    let mut s = vec![0.0];
    for k in 0..o.count {
        s.push(s[k as usize] + o.growth.powi(k as i32));
    }
    let all = s[o.count as usize];
    s.iter().map(|x| x / all).collect()
}

struct Wall {
    on_wall: Vec<bool>,
    /// Inward unit direction of growth, and 1 / cosine to the wall's normal.
    direction: Vec<Vector>,
    stretch: Vec<f64>,
    normal: Vec<Vector>,
    /// Unit normal of the cap in whose plane a vertex of a rim moves.
    rim: Vec<Option<Vector>>,
    size: Vec<f64>,
    triangles: Vec<usize>,
    /// Edges of the wall: the ends and the vertices across, their triangles, the angle inside.
    edges: Vec<([u32; 4], [usize; 2], f64)>,
}

impl Wall {
    fn new(s: &TriMesh) -> Option<Wall> {
        let n = s.points.len();
        let triangles: Vec<usize> = (0..s.triangles.len()).filter(|&t| s.patch[t] == WALL).collect();
        if triangles.is_empty() {
            return None;
        }
        let mut corners = vec![Corner::default(); n];
        let mut size = vec![(0.0, 0.0); n];
        for &t in &triangles {
            let c = s.triangles[t];
            let p = s.corners(t);
            let unit = s.area_vector2(t).normalize();
            for i in 0..3 {
                let v = c[i] as usize;
                let (e, f) = (p[(i + 1) % 3] - p[i], p[(i + 2) % 3] - p[i]);
                corners[v].faces.push(unit);
                corners[v].normal += unit * e.angle(&f);
                corners[v].neighbours.extend([c[(i + 1) % 3], c[(i + 2) % 3]]);
                size[v].0 += e.norm();
                size[v].1 += 1.0;
            }
        }
        // A cap is planar: one normal a patch, the sum of its triangles'.
        let caps: std::collections::BTreeMap<u32, Vector> = {
            let mut m = std::collections::BTreeMap::new();
            for t in (0..s.triangles.len()).filter(|&t| s.patch[t] != WALL) {
                *m.entry(s.patch[t]).or_insert_with(Vector::zeros) += s.area_vector2(t);
            }
            m
        };
        for t in (0..s.triangles.len()).filter(|&t| s.patch[t] != WALL) {
            for v in s.triangles[t] {
                if !corners[v as usize].faces.is_empty() {
                    corners[v as usize].rim = caps[&s.patch[t]].try_normalize(0.0);
                }
            }
        }
        for c in &mut corners {
            c.normal = c.normal.try_normalize(0.0).unwrap_or_else(Vector::zeros);
        }
        let direction = directions(&corners);
        let on_wall = corners.iter().map(|c| !c.faces.is_empty()).collect();
        let normal: Vec<Vector> = corners.iter().map(|c| c.normal).collect();
        let stretch = (0..n).map(|v| 1.0 / (-direction[v].dot(&normal[v])).max(0.5)).collect();
        let size = size.iter().map(|s| s.0 / f64::max(s.1, 1.0)).collect();
        let rim = corners.iter().map(|c| c.rim).collect();
        let edges = HalfEdgeMesh::new(s).map_or(vec![], |m| {
            let wall = m.edges().filter(|&h| m.patch(h / 3) == WALL && m.patch(m.twin(h) / 3) == WALL);
            wall.map(|h| {
                let four = wings(&m, h);
                (four, [h as usize / 3, m.twin(h) as usize / 3], hinge(four.map(|v| s.points[v as usize])))
            })
            .collect()
        });
        Some(Wall { on_wall, direction, stretch, normal, rim, size, triangles, edges })
    }

    fn wished(&self, s: &TriMesh, o: &LayerOptions) -> Vec<f64> {
        // Caps are no obstacle: the vessel goes on behind them.
        let bvh = self.tree(s);
        let reach = bvh.bounds().diagonal();
        let series: f64 = (0..o.count).map(|k| o.growth.powi(k as i32)).sum();
        let t: Vec<f64> = (0..s.points.len())
            .into_par_iter()
            .map(|v| {
                if !self.on_wall[v] {
                    return f64::INFINITY;
                }
                let r = inscribed_radius(&bvh, &s.points[v], &self.normal[v], self.size[v], reach);
                let t = o.total * r;
                o.first_height.map_or(t, |y| t.min(y * series))
            })
            .collect();
        smooth_lower(s, t, 0.25)
    }

    fn tree(&self, s: &TriMesh) -> TriangleBvh {
        let wall: Vec<[u32; 3]> = self.triangles.iter().map(|&t| s.triangles[t]).collect();
        TriangleBvh::of(&s.points, &wall)
    }

    /// Wished thickness, bounded by the way to the opposite wall.
    fn limited(&self, s: &TriMesh, wished: &[f64]) -> Vec<f64> {
        let bvh = self.tree(s);
        (0..s.points.len())
            .into_par_iter()
            .map(|v| {
                if !self.on_wall[v] {
                    return f64::INFINITY;
                }
                let start = s.points[v] + self.direction[v] * (0.01 * self.size[v]);
                let hit = bvh.ray(&start, &self.direction[v], 4.0 * wished[v]);
                hit.map_or(wished[v], |h| wished[v].min(0.35 * h.t))
            })
            .collect()
    }

    /// Where each vertex of the surface ends up on the inner surface.
    fn ends(&self, s: &TriMesh, t: &[f64]) -> Vec<Point> {
        let n = s.points.len();
        let mut move_by: Vec<Vector> = (0..n)
            .map(|v| if self.on_wall[v] { self.direction[v] * (t[v] * self.stretch[v]) } else { Vector::zeros() })
            .collect();
        // Inside the caps: harmonic, so that the triangles shrink evenly; sums of in-plane vectors stay in the plane.
        let mut neighbours: Vec<Vec<u32>> = vec![vec![]; n];
        for c in &s.triangles {
            for i in 0..3 {
                if !self.on_wall[c[i] as usize] {
                    neighbours[c[i] as usize].push(c[(i + 1) % 3]);
                }
            }
        }
        let inside: Vec<usize> = (0..n).filter(|&v| !self.on_wall[v]).collect();
        let largest = self.size.iter().copied().fold(1e-300, f64::max);
        for _ in 0..200 {
            let mut change = 0.0f64;
            for &v in &inside {
                let k = neighbours[v].len().max(1) as f64;
                let new = neighbours[v].iter().map(|&w| move_by[w as usize]).sum::<Vector>() / k;
                change = change.max((new - move_by[v]).norm() / largest);
                move_by[v] = new;
            }
            if change < 1e-6 {
                break;
            }
        }
        let mut ends: Vec<Point> = (0..n).map(|v| s.points[v] + move_by[v]).collect();
        turn::even_caps(s, &self.on_wall, &mut ends);
        ends
    }

    fn inner(&self, s: &TriMesh, ends: &[Point]) -> TriMesh {
        TriMesh { points: ends.to_vec(), ..s.clone() }
    }

    /// Wall vertices whose thickness must fall: those of bad triangles, and so many rings of vertices round them.
    fn bad_vertices(&self, s: &TriMesh, t: &[f64], steps: &[f64], inner: &TriMesh, o: &LayerOptions, rings: u32) -> Vec<u32> {
        let mut bad: Vec<usize> = self
            .triangles
            .par_iter()
            .copied()
            .filter(|&tri| {
                let c = s.triangles[tri];
                let at = |v: u32, f: f64| self.level(s, t, v, f);
                steps.windows(2).any(|w| {
                    let p = [
                        at(c[0], w[0]), at(c[1], w[0]), at(c[2], w[0]),
                        at(c[0], w[1]), at(c[1], w[1]), at(c[2], w[1]),
                    ];
                    scaled_jacobian(&p) < LEAST_JACOBIAN
                })
            })
            .collect();
        bad.extend((0..inner.triangles.len()).filter(|&i| {
            let outer = skewness(&s.corners(i));
            skewness(&inner.corners(i)) > o.max_inner_skewness.max(outer + 0.05)
        }));
        // A sharper ridge than the wall's own binds the tetrahedra inside.
        for (four, triangles, outer) in &self.edges {
            if hinge(four.map(|v| inner.points[v as usize])) < LEAST_ANGLE.min(outer - 5.0) {
                bad.extend(triangles);
            }
        }
        bad.extend(self_intersections(inner).into_iter().flat_map(|(i, j)| [i as usize, j as usize]));
        if bad.is_empty() {
            return vec![];
        }
        let mut marked = vec![false; s.points.len()];
        for &i in &bad {
            s.triangles[i].iter().for_each(|&v| marked[v as usize] = true);
            // A triangle within a cap moves with the rim of that cap.
            if !s.triangles[i].iter().any(|&v| self.on_wall[v as usize]) {
                let cap = (0..s.triangles.len()).filter(|&k| s.patch[k] == s.patch[i]).flat_map(|k| s.triangles[k]);
                cap.filter(|&v| self.on_wall[v as usize]).for_each(|v| marked[v as usize] = true);
            }
        }
        for _ in 0..rings {
            let before = marked.clone();
            for c in s.triangles.iter().filter(|c| c.iter().any(|&v| before[v as usize])) {
                c.iter().for_each(|&v| marked[v as usize] = true);
            }
        }
        (0..s.points.len() as u32).filter(|&v| marked[v as usize] && self.on_wall[v as usize]).collect()
    }

    /// A vertex and its neighbours on the wall.
    fn around(&self, s: &TriMesh, v: u32) -> Vec<u32> {
        let near = self.triangles.iter().map(|&t| s.triangles[t]).filter(|c| c.contains(&v));
        let mut all: Vec<u32> = near.flatten().collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    fn level(&self, s: &TriMesh, t: &[f64], v: u32, f: f64) -> Point {
        let v = v as usize;
        if f == 0.0 { s.points[v] } else { s.points[v] + self.direction[v] * (t[v] * self.stretch[v] * f) }
    }

    #[allow(clippy::too_many_arguments)]
    fn assemble(
        &self,
        s: &TriMesh,
        mut t: Vec<f64>,
        mut wished: Vec<f64>,
        steps: &[f64],
        inner: TriMesh,
        o: &LayerOptions,
        rounds: u32,
    ) -> (Layers, LayerSummary) {
        let levels = steps.len();
        // Level 0 and the cap's inner points keep the surface's ids; the other levels follow, a column a wall vertex.
        let mut points = s.points.clone();
        let mut column = vec![u32::MAX; s.points.len()];
        for v in 0..s.points.len() {
            if self.on_wall[v] {
                column[v] = points.len() as u32;
                for (k, f) in steps.iter().enumerate().skip(1) {
                    let last = k + 1 == levels;
                    points.push(if last { inner.points[v] } else { self.level(s, &t, v as u32, *f) });
                }
            } else {
                points[v] = inner.points[v];
            }
        }
        let id = |v: u32, k: usize| if k == 0 { v } else { column[v as usize] + k as u32 - 1 };
        let mut prisms = Vec::with_capacity(self.triangles.len() * (levels - 1));
        let mut boundary = vec![];
        for &tri in &self.triangles {
            let c = s.triangles[tri];
            boundary.push(BoundaryFace::triangle(c, s.patch[tri]));
            for k in 1..levels {
                prisms.push([
                    id(c[0], k - 1), id(c[1], k - 1), id(c[2], k - 1),
                    id(c[0], k), id(c[1], k), id(c[2], k),
                ]);
            }
        }
        let mut ratio = f64::INFINITY;
        let rims = rim_edges(s);
        for &(a, b, patch) in &rims {
            let edge = (s.points[a as usize] - s.points[b as usize]).norm();
            for k in 1..levels {
                // a → b as the cap's triangle runs, so that the quadrilateral has the cap's normal.
                boundary.push(BoundaryFace::quad([id(a, k - 1), id(b, k - 1), id(b, k), id(a, k)], patch));
            }
            let first = points[id(a, 1) as usize] - points[a as usize];
            ratio = ratio.min(first.norm() / edge);
        }
        let inner_ids: Vec<u32> =
            (0..s.points.len() as u32).map(|v| if self.on_wall[v as usize] { id(v, levels - 1) } else { v }).collect();
        let prism_skewness = prisms
            .par_iter()
            .map(|p| prism_skewness(&p.map(|v| points[v as usize])))
            .reduce(|| 0.0, f64::max);
        let inner_skewness = (0..inner.triangles.len()).map(|i| skewness(&inner.corners(i))).fold(0.0, f64::max);
        let (mut full, mut area) = (0.0, 0.0);
        for &tri in &self.triangles {
            let a = s.area_vector2(tri).norm();
            area += a;
            let share = s.triangles[tri].iter().filter(|&&v| t[v as usize] >= 0.95 * wished[v as usize]).count();
            full += a * share as f64 / 3.0;
        }
        for v in 0..t.len() {
            if !self.on_wall[v] {
                (t[v], wished[v]) = (0.0, 0.0);
            }
        }
        let mut sorted: Vec<f64> = (0..t.len()).filter(|&v| self.on_wall[v]).map(|v| t[v]).collect();
        sorted.sort_by(f64::total_cmp);
        let mut warnings = vec![];
        if ratio < 0.035 {
            warnings.push(format!(
                "the first layer is {ratio:.3} of the edge at a rim: under 0.035 OpenFOAM's determinant check fails; \
                 use a larger first height or fewer layers"
            ));
        }
        let summary = LayerSummary {
            prisms: prisms.len(),
            area_at_full_thickness: full / area,
            thickness: [sorted[0], sorted[sorted.len() / 2], sorted[sorted.len() - 1]],
            rim_height_ratio: if rims.is_empty() { 1.0 } else { ratio },
            rim_first_height: None,
            prism_skewness,
            inner_skewness,
            rounds,
            warnings,
        };
        debug_assert_eq!(o.count as usize + 1, levels);
        (Layers { points, prisms, boundary, inner, inner_ids, thickness: t, wished }, summary)
    }
}

impl Layers {
    /// Puts the mesh of the inner surface into the layers.
    pub fn join(self, filled: VolumeMesh) -> VolumeMesh {
        let mut points = self.points;
        let n = self.inner.points.len();
        let mut ids = self.inner_ids;
        for p in &filled.points[n..] {
            ids.push(points.len() as u32);
            points.push(*p);
        }
        let map = |v: u32| ids[v as usize];
        let mut boundary = self.boundary;
        for f in filled.boundary.iter().filter(|f| f.patch != WALL) {
            boundary.push(BoundaryFace { vertices: f.vertices.map(map), patch: f.patch });
        }
        boundary.sort_by_key(|f| f.patch);
        let tets = filled.tets.iter().map(|t| t.map(map)).collect();
        VolumeMesh { points, tets, prisms: self.prisms, boundary, patches: filled.patches }
    }
}

/// Edges between the wall and a cap, directed as in the cap's triangle, with the cap's patch.
fn rim_edges(s: &TriMesh) -> Vec<(u32, u32, u32)> {
    let mut wall: Vec<(u32, u32)> = vec![];
    let mut caps: Vec<(u32, u32, u32)> = vec![];
    for (c, &p) in s.triangles.iter().zip(&s.patch) {
        for i in 0..3 {
            let (a, b) = (c[i], c[(i + 1) % 3]);
            if p == WALL { wall.push((b, a)) } else { caps.push((a, b, p)) }
        }
    }
    wall.sort_unstable();
    caps.retain(|&(a, b, _)| wall.binary_search(&(a, b)).is_ok());
    caps.sort_unstable_by_key(|&(a, b, p)| (p, a, b));
    caps
}

/// Equi-angle skewness of a triangle.
fn skewness(p: &[Point; 3]) -> f64 {
    let mut s = 0.0f64;
    for i in 0..3 {
        let angle = (p[(i + 1) % 3] - p[i]).angle(&(p[(i + 2) % 3] - p[i])).to_degrees();
        s = s.max((angle - 60.0) / 120.0).max((60.0 - angle) / 60.0);
    }
    s
}

/// Equi-angle skewness of a prism: the worst of its two triangles (60°) and three quadrilaterals (90°).
pub fn prism_skewness(p: &[Point; 6]) -> f64 {
    let mut s = skewness(&[p[0], p[1], p[2]]).max(skewness(&[p[3], p[4], p[5]]));
    for i in 0..3 {
        let j = (i + 1) % 3;
        let q = [p[i], p[j], p[j + 3], p[i + 3]];
        for k in 0..4 {
            let angle = (q[(k + 1) % 4] - q[k]).angle(&(q[(k + 3) % 4] - q[k])).to_degrees();
            s = s.max((angle - 90.0).abs() / 90.0);
        }
    }
    s
}

/// Least of the six corner Jacobians, each over its edges' lengths times that of an upright prism on an equilateral
/// triangle (√3/2 at the corner): 1 for the perfect prism, negative for an inverted corner.
fn scaled_jacobian(p: &[Point; 6]) -> f64 {
    let mut least = f64::INFINITY;
    for i in 0..3 {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        for (a, b, c, up) in [(i, j, k, i + 3), (i + 3, j + 3, k + 3, i)] {
            let (e, f) = (p[b] - p[a], p[c] - p[a]);
            // The triangle at the wall has its normal outwards: away from the inner one.
            let g = if up > 2 { p[a] - p[up] } else { p[up] - p[a] };
            let v = e.cross(&f).dot(&g) / (e.norm() * f.norm() * g.norm() * 0.866_025_403_784_438_6);
            least = if v.is_finite() { least.min(v) } else { -1.0 };
        }
    }
    least
}
