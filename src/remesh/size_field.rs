//! The guidance field: how long edges shall be, everywhere.
//!
//! After Schreiner, Scheidegger and Silva 2006 ("High-quality extraction of isosurfaces from regular and irregular
//! grids"): ideal lengths at samples of the surface, from curvature and here also from the vessel's radius, the
//! voxel's size and the user's wishes, made Lipschitz so that lengths change slowly. It is kept on a lattice round
//! the surface: reading it costs tens of nanoseconds.

use std::f64::consts::PI;

use rayon::prelude::*;
use serde::Serialize;

use super::band_grid::BandGrid;
use super::curvature::largest_curvature;
use super::rim_spacing::BALANCE;
use super::reach::{self, Reach};
use super::{Error, SizeField};
use crate::geometry::{Aabb, Plane, Point};
use crate::implicit::Implicit;
use crate::mesh::{PatchId, TriMesh};

/// Where edge lengths come from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EdgeLength {
    /// From radius, curvature and the chord error that the voxels allow.
    Auto,
    /// This many millimetres where nothing asks for less.
    Fixed(f64),
    /// As `Auto`, scaled so that about this many triangles come out.
    TargetFaces(usize),
}

/// A part of space with its own edge length.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refinement {
    /// Edges inside a ball are at most `edge_length` long.
    Sphere {
        /// Centre.
        center: Point,
        /// Radius, mm.
        radius: f64,
        /// Edge length, mm.
        edge_length: f64,
    },
    /// Edges inside a box are at most `edge_length` long.
    Box {
        /// The box.
        bounds: Aabb,
        /// Edge length, mm.
        edge_length: f64,
    },
}

impl Refinement {
    fn at(&self, p: &Point) -> Option<f64> {
        let (inside, h) = match self {
            Refinement::Sphere { center, radius, edge_length } => ((p - center).norm() <= *radius, *edge_length),
            Refinement::Box { bounds, edge_length } => (bounds.squared_distance(p) <= 0.0, *edge_length),
        };
        inside.then_some(h)
    }
}

/// A planar end at which the surface will be cut open, for the number of triangles to expect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct End {
    /// The plane, its normal out of the vessel.
    pub plane: Plane,
    /// Radius of the opening, mm.
    pub radius: f64,
}

impl End {
    /// Whether `p` lies in what the cut takes away: beyond the plane, and not so far that it is of another branch.
    fn cuts_off(&self, p: &Point) -> bool {
        self.plane.signed_distance(p) > 0.0 && (p - self.plane.origin).norm() < 3.0 * self.radius
    }
}

/// Options of [`GuidanceField::new`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GuidanceOptions {
    /// Where lengths come from.
    pub edge_length: EdgeLength,
    /// Edges round a vessel's circumference at least, with `Auto`: 28 is 13° of arc an edge.
    pub edges_per_circumference: f64,
    /// Edges round the circle that the surface bends along most, with `Auto`.
    pub edges_per_turn: f64,
    /// Chord error bound with `Auto`: h ≤ √(this · voxel diagonal · R), that is h²/(16 R) ≤ 1 % of the diagonal.
    pub chord: f64,
    /// Edges round the circumference at least, whatever is asked for: fewer lose the tube's shape.
    pub least_edges_per_circumference: f64,
    /// Shortest wish, mm; a fifth of a voxel without it.
    pub min: Option<f64>,
    /// Longest wish, mm.
    pub max: Option<f64>,
    /// Factor on every wish: 0.5 halves all edges. Bounded by the least number of edges round.
    pub scale: f64,
    /// Largest change of the wish per distance.
    pub gradation: f64,
    /// Finer parts.
    pub refine: Vec<Refinement>,
    /// Patches of the mesh with an edge length of their own, mm, instead of `edge_length`.
    pub patches: Vec<(PatchId, f64)>,
    /// Where the surface will be cut open.
    pub ends: Vec<End>,
}

impl Default for GuidanceOptions {
    fn default() -> Self {
        GuidanceOptions {
            edge_length: EdgeLength::Auto,
            edges_per_circumference: 28.0,
            edges_per_turn: 20.0,
            chord: 0.16,
            least_edges_per_circumference: 8.0,
            min: None,
            max: None,
            scale: 1.0,
            gradation: 0.15,
            refine: Vec::new(),
            patches: Vec::new(),
            ends: Vec::new(),
        }
    }
}

/// What limited the edge length, as parts of the surface's area.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Limits {
    /// Edges round the circumference.
    pub radius: f64,
    /// Bending.
    pub curvature: f64,
    /// Chord error.
    pub chord: f64,
    /// The length given.
    pub fixed: f64,
    /// Spheres and boxes.
    pub refinement: f64,
    /// The length given for a patch.
    pub patch: f64,
    /// Shortest length.
    pub min: f64,
    /// Longest length.
    pub max: f64,
    /// Least number of edges round.
    pub least: f64,
}

/// What [`GuidanceField::new`] chose and why.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Shortest wish on the surface, mm.
    pub min: f64,
    /// Median over the area, mm.
    pub median: f64,
    /// Longest wish on the surface, mm.
    pub max: f64,
    /// Factor that was applied, `target_faces` included.
    pub scale: f64,
    /// Triangles that may be expected.
    pub predicted_faces: usize,
    /// Part of the area that each rule decided.
    pub decided_by: Limits,
    /// One sentence for the report.
    pub why: String,
    /// What was asked for and could not be had everywhere.
    pub bounded: Option<String>,
}

/// Wished edge length on a lattice round the surface.
#[derive(Debug, Clone)]
pub struct GuidanceField {
    grid: BandGrid,
}

impl SizeField for GuidanceField {
    #[inline]
    fn size(&self, p: &Point) -> f64 {
        self.grid.at(p)
    }
}

impl GuidanceField {
    /// Builds the field over `mesh`, a closed polygonization of `f` with vertices on it. `radii` are places on the
    /// vessels' axes with the radius of the largest inscribed sphere there; without any, curvature alone tells the
    /// radius. `spacing` is the voxel's, mm.
    ///
    /// # Errors
    /// [`Error::NotManifold`] for a mesh that is not closed; [`Error::BadLength`] for a wish that is not positive.
    pub fn new(
        mesh: &TriMesh,
        f: &dyn Implicit,
        radii: &[(Point, f64)],
        spacing: [f64; 3],
        options: &GuidanceOptions,
    ) -> Result<(GuidanceField, Summary), Error> {
        check_lengths(options)?;
        let diagonal = spacing.iter().map(|s| s * s).sum::<f64>().sqrt();
        let voxel = (spacing[0] * spacing[1] * spacing[2]).cbrt();
        let kappa = largest_curvature(mesh, f)?;
        let radius = local_radius(mesh, radii, &kappa);
        let min = options.min.unwrap_or(0.2 * voxel);
        let max = options.max.unwrap_or(f64::INFINITY);
        let least_edges = options.least_edges_per_circumference.min(options.edges_per_circumference);
        let longest: Vec<f64> = radius.iter().map(|r| 2.0 * r * (PI / least_edges).sin()).collect();
        let own = patch_lengths(mesh, &options.patches);
        let wish = |v: usize| {
            let round = |n: f64| 2.0 * radius[v] * (PI / n).sin();
            if let Some(h) = own[v] {
                return (h, Rule::Patch);
            }
            match options.edge_length {
                EdgeLength::Fixed(h) => (h, Rule::Fixed),
                _ => [
                    (round(options.edges_per_circumference), Rule::Radius),
                    (2.0 * (PI / options.edges_per_turn).sin() / kappa[v].max(1e-12), Rule::Curvature),
                    ((options.chord * diagonal * radius[v]).sqrt(), Rule::Chord),
                ]
                .into_iter()
                .fold((f64::INFINITY, Rule::Chord), |a, b| if b.0 < a.0 { b } else { a }),
            }
        };
        let wishes: Vec<(f64, Rule)> = (0..mesh.points.len()).into_par_iter().map(wish).collect();
        let mut area = vertex_areas(mesh);
        for (p, a) in mesh.points.iter().zip(&mut area) {
            if options.ends.iter().any(|e| e.cuts_off(p)) {
                *a = 0.0;
            }
        }
        let reach = Reach { low: min, most: max, longest: &longest, area: &area, volume: mesh.volume() };
        reach::check(&reach, options, &own)?;
        let bounded = |v: usize, scale: f64| {
            let (h, rule) = wishes[v];
            let (mut h, mut rule) = (h * scale, rule);
            if h > longest[v] {
                (h, rule) = (longest[v], Rule::Least);
            }
            for r in &options.refine {
                if let Some(inside) = r.at(&mesh.points[v]).filter(|x| x * scale < h) {
                    (h, rule) = (inside * scale, Rule::Refinement);
                }
            }
            if h < min * scale.min(1.0) {
                (h, rule) = (min * scale.min(1.0), Rule::Min);
            }
            if h > max {
                (h, rule) = (max, Rule::Max);
            }
            (h, rule)
        };
        let build = |scale: f64| {
            let samples: Vec<(Point, f64)> =
                (0..mesh.points.len()).into_par_iter().map(|v| (mesh.points[v], bounded(v, scale).0)).collect();
            let longest = samples.iter().map(|s| s.1).fold(0.0, f64::max);
            let bounds = mesh.bounds();
            // Lattice cells of about a voxel, finer only where the wishes themselves are far longer or shorter.
            let grid = BandGrid::new(&bounds, voxel.max(0.05 * longest), &samples, options.gradation, longest);
            let field = GuidanceField { grid };
            let sizes: Vec<f64> = mesh.points.par_iter().map(|p| field.size(p)).collect();
            let faces = predicted_faces(&area, &sizes) + options.ends.iter().map(|e| cap_faces(e, &field)).sum::<f64>();
            (field, sizes, faces)
        };
        let mut scale = options.scale;
        let (mut field, mut sizes, mut faces) = build(scale);
        let mut missed = None;
        if let EdgeLength::TargetFaces(wanted) = options.edge_length {
            let wanted = wanted.max(4) as f64;
            for _ in 0..12 {
                if (faces / wanted - 1.0).abs() < 0.01 {
                    break;
                }
                scale *= (faces / wanted).sqrt();
                (field, sizes, faces) = build(scale);
            }
            missed = ((faces / wanted - 1.0).abs() > 0.05).then_some(wanted);
        }
        let rules: Vec<Rule> = (0..mesh.points.len()).map(|v| bounded(v, scale).1).collect();
        let mut summary = summarise(&area, &sizes, &rules, scale, faces, options);
        let held = summary.decided_by.min + summary.decided_by.least;
        summary.bounded = reach::bounded(held, missed, options, &summary);
        Ok((field, summary))
    }
}

/// A guidance field with other lengths round some places.
pub struct Scaled<'a> {
    /// The field.
    pub field: &'a dyn SizeField,
    /// The places.
    pub centers: &'a [Point],
    /// Distance over which the factor goes back to 1, mm.
    pub reach: f64,
    /// Factor at the places.
    pub factor: f64,
}

impl SizeField for Scaled<'_> {
    fn size(&self, p: &Point) -> f64 {
        let h = self.field.size(p);
        if self.factor == 1.0 {
            return h;
        }
        let d = self.centers.iter().map(|c| (p - c).norm_squared()).fold(f64::INFINITY, f64::min).sqrt();
        h * (self.factor + (1.0 - self.factor) * (d / self.reach).min(1.0))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    Radius,
    Curvature,
    Chord,
    Fixed,
    Refinement,
    Patch,
    Min,
    Max,
    Least,
}

fn check_lengths(o: &GuidanceOptions) -> Result<(), Error> {
    let fixed = match o.edge_length {
        EdgeLength::Fixed(h) => Some(h),
        _ => None,
    };
    let mut named = vec![
        ("edge_length", fixed),
        ("min", o.min),
        ("max", o.max),
        ("scale", Some(o.scale)),
        ("gradation", Some(o.gradation)),
        ("edges_per_circumference", Some(o.edges_per_circumference)),
        ("edges_per_turn", Some(o.edges_per_turn)),
        ("chord", Some(o.chord)),
    ];
    for r in &o.refine {
        match r {
            Refinement::Sphere { edge_length, .. } | Refinement::Box { edge_length, .. } => {
                named.push(("refine.edge_length", Some(*edge_length)));
            }
        }
    }
    named.extend(o.patches.iter().map(|p| ("patches.edge_length", Some(p.1))));
    match named.into_iter().find(|(_, v)| v.is_some_and(|v| !(v.is_finite() && v > 0.0))) {
        Some((name, Some(value))) => Err(Error::BadLength { name, value }),
        _ => Ok(()),
    }
}

/// Radius of the vessel at every vertex: of the axis sample whose sphere comes nearest (power distance).
fn local_radius(mesh: &TriMesh, radii: &[(Point, f64)], kappa: &[f64]) -> Vec<f64> {
    let bend = |v: usize| 1.0 / kappa[v].max(1e-12);
    let diagonal = mesh.bounds().diagonal();
    if radii.is_empty() {
        return (0..mesh.points.len()).map(|v| bend(v).min(0.5 * diagonal)).collect();
    }
    // Power distance |x−c|² − R² as a Euclidean one, with a fourth coordinate.
    let largest = radii.iter().map(|r| r.1 * r.1).fold(0.0, f64::max);
    let lifted: Vec<[f64; 4]> = radii.iter().map(|(c, r)| [c.x, c.y, c.z, (largest - r * r).max(0.0).sqrt()]).collect();
    let tree = kiddo::ImmutableKdTree::<f64, 4>::new_from_slice(&lifted);
    mesh.points
        .par_iter()
        .map(|p| {
            let found = tree.nearest_one::<kiddo::SquaredEuclidean>(&[p.x, p.y, p.z, 0.0]);
            radii[found.item as usize].1
        })
        .collect()
}

fn vertex_areas(mesh: &TriMesh) -> Vec<f64> {
    let mut area = vec![0.0; mesh.points.len()];
    for (t, tri) in mesh.triangles.iter().enumerate() {
        let a = mesh.area_vector2(t).norm() / 6.0;
        for &v in tri {
            area[v as usize] += a;
        }
    }
    area
}

/// The edge length that a patch gives to its vertices: the shortest where several meet.
fn patch_lengths(mesh: &TriMesh, patches: &[(PatchId, f64)]) -> Vec<Option<f64>> {
    let mut own: Vec<Option<f64>> = vec![None; mesh.points.len()];
    for &(id, h) in patches {
        for t in (0..mesh.triangles.len()).filter(|&t| mesh.patch.get(t) == Some(&id)) {
            for v in mesh.triangles[t] {
                let o = &mut own[v as usize];
                *o = Some(o.map_or(h, |x| x.min(h)));
            }
        }
    }
    own
}

/// Area of a triangle of a mesh whose wish is `h`.
pub(super) fn triangle_area(h: f64) -> f64 {
    0.75f64.sqrt() * 0.5 * (BALANCE * h).powi(2)
}

/// Triangles of a mesh under the field.
fn predicted_faces(area: &[f64], sizes: &[f64]) -> f64 {
    area.iter().zip(sizes).map(|(a, h)| a / triangle_area(*h)).sum()
}

/// Triangles of a cap under the field.
fn cap_faces(end: &End, field: &GuidanceField) -> f64 {
    let (u, v) = end.plane.basis();
    let rim = [u, v, -u, -v].map(|d| field.size(&(end.plane.origin + d * end.radius)));
    let h = rim.iter().sum::<f64>() / 4.0;
    PI * end.radius * end.radius / triangle_area(h)
}

fn summarise(
    area: &[f64],
    sizes: &[f64],
    rules: &[Rule],
    scale: f64,
    faces: f64,
    options: &GuidanceOptions,
) -> Summary {
    let total: f64 = area.iter().sum();
    let part = |rule: Rule| area.iter().zip(rules).filter(|x| *x.1 == rule).fold(0.0, |sum, x| sum + x.0) / total;
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_unstable_by(|&a, &b| sizes[a].total_cmp(&sizes[b]).then(a.cmp(&b)));
    let mut seen = 0.0;
    let median = order.iter().find(|&&v| { seen += area[v]; seen >= 0.5 * total }).map_or(0.0, |&v| sizes[v]);
    let (min, max) = (order.first().map_or(0.0, |&v| sizes[v]), order.last().map_or(0.0, |&v| sizes[v]));
    let decided_by = Limits {
        radius: part(Rule::Radius),
        curvature: part(Rule::Curvature),
        chord: part(Rule::Chord),
        fixed: part(Rule::Fixed),
        refinement: part(Rule::Refinement),
        patch: part(Rule::Patch),
        min: part(Rule::Min),
        max: part(Rule::Max),
        least: part(Rule::Least),
    };
    let round = (options.edges_per_circumference / scale).round();
    let named = [
        (decided_by.radius, format!("by radius (at least {round} edges round)")),
        (decided_by.curvature, "by curvature".into()),
        (decided_by.chord, "by chord error".into()),
        (decided_by.fixed, "as given".into()),
        (decided_by.refinement, "by refinement".into()),
        (decided_by.patch, "as given for a patch".into()),
        (decided_by.min, "at the shortest length".into()),
        (decided_by.max, "at the longest length".into()),
        (decided_by.least, format!("at the least number of edges round, {}", options.least_edges_per_circumference)),
    ];
    // Shares that round to nothing are left out.
    let shares: Vec<String> =
        named.into_iter().filter(|(x, _)| *x >= 0.005).map(|(x, how)| format!("{:.0} % {how}", 100.0 * x)).collect();
    let why = format!(
        "edges of {min:.3} to {max:.3} mm (median {median:.3} mm), scale {scale:.3}; of the area {}",
        shares.join(", ")
    );
    Summary { min, median, max, scale, predicted_faces: faces.round() as usize, decided_by, why, bounded: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector;
    use crate::remesh::testing::{Capsules, polygonize};

    const VOXEL: [f64; 3] = [0.5; 3];

    #[test]
    fn auto_puts_the_edges_round_a_tube_and_says_why() {
        let f = Capsules::tube(2.0, 12.0);
        let mesh = polygonize(&f, 0.35);
        let axis: Vec<(Point, f64)> = (-12..=12).map(|i| (Point::new(0., 0., 0.5 * f64::from(i)), 2.0)).collect();
        let (field, summary) = GuidanceField::new(&mesh, &f, &axis, VOXEL, &GuidanceOptions::default()).unwrap();
        let expected = 2.0 * 2.0 * (PI / 28.0).sin();
        assert!((field.size(&Point::new(2.0, 0.0, 0.0)) / expected - 1.0).abs() < 0.02, "{summary:?}");
        assert!(summary.decided_by.radius > 0.9, "{summary:?}");
        assert!(summary.why.contains("% by radius (at least 28 edges round)"), "{}", summary.why);
        assert!(!summary.why.contains("-0") && !summary.why.contains("as given"), "{}", summary.why);
        let half = GuidanceOptions { scale: 0.5, ..GuidanceOptions::default() };
        let (half, finer) = GuidanceField::new(&mesh, &f, &axis, VOXEL, &half).unwrap();
        assert!((half.size(&Point::new(2.0, 0.0, 0.0)) / expected - 0.5).abs() < 0.02);
        // Half the edges round at twice the scale, and no fewer than eight.
        let coarse = |scale| {
            let options = GuidanceOptions { scale, ..GuidanceOptions::default() };
            GuidanceField::new(&mesh, &f, &axis, VOXEL, &options).unwrap().1
        };
        assert!(coarse(2.0).why.contains("at least 14 edges round") && coarse(2.0).bounded.is_none(), "{:?}", coarse(2.0));
        let most = coarse(20.0);
        assert!((most.median / (4.0 * (PI / 8.0).sin()) - 1.0).abs() < 0.02, "{most:?}");
        assert!(most.bounded.as_ref().is_some_and(|b| b.contains("scale")), "{most:?}");
        assert!((finer.predicted_faces as f64 / summary.predicted_faces as f64 - 4.0).abs() < 0.2);
    }

    #[test]
    fn a_refined_sphere_grades_into_the_rest() {
        let f = Capsules::tube(2.0, 20.0);
        let mesh = polygonize(&f, 0.4);
        let center = Point::new(2.0, 0.0, 0.0);
        let options = GuidanceOptions {
            edge_length: EdgeLength::Fixed(0.8),
            refine: vec![Refinement::Sphere { center, radius: 1.0, edge_length: 0.2 }],
            ..GuidanceOptions::default()
        };
        let (field, summary) = GuidanceField::new(&mesh, &f, &[], VOXEL, &options).unwrap();
        assert!((field.size(&center) - 0.2).abs() < 0.02 && (summary.max - 0.8).abs() < 1e-6, "{summary:?}");
        assert!((field.size(&Point::new(-2.0, 0.0, 10.0)) - 0.8).abs() < 1e-6);
        // Lipschitz along the tube, and positive far away.
        for i in 0..200 {
            let p = Point::new(2.0, 0.0, -10.0 + 0.1 * f64::from(i));
            let q = p + Vector::new(0.0, 0.0, 0.1);
            assert!((field.size(&p) - field.size(&q)).abs() <= 0.15 * 0.1 * 1.3, "{i}");
        }
        assert!(field.size(&Point::new(500.0, 0.0, 0.0)) > 0.1);
    }

    #[test]
    fn target_faces_are_met_by_prediction() {
        let f = Capsules::y();
        let mesh = polygonize(&f, 0.35);
        let options = GuidanceOptions { edge_length: EdgeLength::TargetFaces(6000), ..GuidanceOptions::default() };
        let (_, summary) = GuidanceField::new(&mesh, &f, &[], VOXEL, &options).unwrap();
        assert!((summary.predicted_faces as f64 / 6000.0 - 1.0).abs() < 0.02, "{summary:?}");
    }

    #[test]
    fn an_end_that_will_be_cut_does_not_count() {
        let f = Capsules::tube(2.0, 20.0);
        let mesh = polygonize(&f, 0.4);
        let predicted = |ends: Vec<End>| {
            let options = GuidanceOptions { edge_length: EdgeLength::Fixed(0.5), ends, ..GuidanceOptions::default() };
            GuidanceField::new(&mesh, &f, &[], VOXEL, &options).unwrap().1.predicted_faces as f64
        };
        let plane = Plane::new(Point::new(0.0, 0.0, 7.0), Vector::new(0.0, 0.0, 1.0)).unwrap();
        let (whole, cut) = (predicted(Vec::new()), predicted(vec![End { plane, radius: 2.0 }]));
        // The tube ends at z = 10 in half a sphere; instead there is a disc.
        let taken = 2.0 * PI * 2.0 * (10.0 - 7.0) + 2.0 * PI * 4.0 - PI * 4.0;
        assert!(((whole - cut) * triangle_area(0.5) / taken - 1.0).abs() < 0.1, "{whole} {cut}");
    }

    #[test]
    fn a_patch_has_its_own_length_longer_or_shorter() {
        let f = Capsules::tube(2.0, 20.0);
        let mut mesh = polygonize(&f, 0.4);
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            if a.z + b.z + c.z > 12.0 {
                mesh.patch[t] = 7;
            }
        }
        for h in [0.2, 1.0] {
            let options = GuidanceOptions { edge_length: EdgeLength::Fixed(0.5), patches: vec![(7, h)], ..GuidanceOptions::default() };
            let (field, summary) = GuidanceField::new(&mesh, &f, &[], VOXEL, &options).unwrap();
            assert!((field.size(&Point::new(2.0, 0.0, 9.0)) - h).abs() < 0.05, "{h} {}", field.size(&Point::new(2.0, 0.0, 9.0)));
            // Read from a lattice: up to the gradation times half a cell more than the wish.
            assert!((field.size(&Point::new(2.0, 0.0, -9.0)) - 0.5).abs() < 0.06);
            assert!(summary.decided_by.patch > 0.2 && summary.why.contains("given for a patch"), "{}", summary.why);
        }
    }

    #[test]
    fn a_length_that_cannot_hold_is_refused_with_the_range() {
        let f = Capsules::tube(2.0, 12.0);
        let mesh = polygonize(&f, 0.4);
        let axis: Vec<(Point, f64)> = (-12..=12).map(|i| (Point::new(0., 0., 0.5 * f64::from(i)), 2.0)).collect();
        let field = |options: GuidanceOptions| GuidanceField::new(&mesh, &f, &axis, VOXEL, &options).map(|r| r.1);
        let fixed = |h| GuidanceOptions { edge_length: EdgeLength::Fixed(h), ..GuidanceOptions::default() };
        for h in [0.001, 0.09, 1.6, 50.0] {
            let Err(Error::OutOfReach { asked, low, high, faces, .. }) = field(fixed(h)) else { panic!("{h} must be refused") };
            assert!(asked == h && (low - 0.1).abs() < 1e-9 && (high - 4.0 * (PI / 8.0).sin()).abs() < 1e-6, "{low} {high}");
            // Both ends of the range can be had.
            assert!(field(fixed(low)).is_ok() && field(fixed(high)).is_ok());
            assert!((faces * triangle_area(h) / mesh.area() - 1.0).abs() < 1e-6, "{faces}");
        }
        let summary = field(fixed(0.6)).unwrap();
        assert!((summary.min - 0.6).abs() < 1e-6 && (summary.max - 0.6).abs() < 1e-6 && summary.bounded.is_none(), "{summary:?}");
        let within = Refinement::Sphere { center: Point::new(2.0, 0.0, 0.0), radius: 1.0, edge_length: 0.01 };
        assert!(matches!(field(GuidanceOptions { refine: vec![within], ..fixed(0.6) }), Err(Error::OutOfReach { .. })));
        assert!(matches!(field(GuidanceOptions { min: Some(0.7), ..fixed(0.6) }), Err(Error::OutOfReach { .. })));
        assert!(matches!(field(GuidanceOptions { max: Some(0.5), ..fixed(0.6) }), Err(Error::OutOfReach { .. })));
    }

    #[test]
    fn a_negative_length_is_named() {
        let f = Capsules::tube(2.0, 6.0);
        let options = GuidanceOptions { edge_length: EdgeLength::Fixed(-1.0), ..GuidanceOptions::default() };
        let error = GuidanceField::new(&polygonize(&f, 0.6), &f, &[], VOXEL, &options).unwrap_err();
        assert_eq!(error.to_string(), "edge_length is -1; give a positive number");
    }
}
