use super::*;
use crate::mesh::test_shapes::sphere;
use crate::mesh::{repair, topology};

const AROUND: u32 = 48;

/// A tube of radius 2 along z, open at both ends; the height of the ends is a function of the angle.
fn tube(rows: u32, low: impl Fn(f64, u32) -> f64, high: impl Fn(f64, u32) -> f64) -> TriMesh {
    let mut mesh = TriMesh::default();
    for row in 0..=rows {
        for i in 0..AROUND {
            let a = std::f64::consts::TAU * f64::from(i) / f64::from(AROUND);
            let t = f64::from(row) / f64::from(rows);
            mesh.points.push(Point::new(2.0 * a.cos(), 2.0 * a.sin(), low(a, i) * (1.0 - t) + high(a, i) * t));
        }
    }
    for row in 0..rows {
        for i in 0..AROUND {
            let (a, b) = (row * AROUND + i, row * AROUND + (i + 1) % AROUND);
            mesh.triangles.extend([[a, b, b + AROUND], [a, b + AROUND, a + AROUND]]);
        }
    }
    mesh.patch = vec![crate::mesh::WALL; mesh.triangles.len()];
    mesh
}

/// A fan on each rim.
fn capped(open: &TriMesh) -> TriMesh {
    let mut out = open.clone();
    for rim in rims::loops(open) {
        let middle = out.points.len() as u32;
        let sum: Vector = rim.iter().map(|&v| open.points[v as usize].coords).sum();
        out.points.push(Point::from(sum / rim.len() as f64));
        out.triangles.extend((0..rim.len()).map(|i| [rim[(i + 1) % rim.len()], rim[i], middle]));
    }
    out.patch = vec![crate::mesh::WALL; out.triangles.len()];
    out
}

/// Area of a regular polygon in the circle of radius 2.
fn polygon_area() -> f64 {
    let n = f64::from(AROUND);
    0.5 * n * 4.0 * (std::f64::consts::TAU / n).sin()
}

#[test]
fn square_oblique_and_saw_toothed_ends_have_their_planes_and_areas_open_and_capped() {
    let cases: [(&str, f64, fn(f64, u32) -> f64); 4] =
        [("square", 0.0, |_, _| 20.0), ("oblique", 40.0, |a, _| 20.0 + 2.0 * 40f64.to_radians().tan() * a.cos()), ("saw-toothed", 0.0, |_, i| 20.0 + 0.3 * f64::from(i % 2)), ("finely saw-toothed", 0.0, |_, i| 20.0 + 0.05 * f64::from(i % 2))];
    for (name, tilt, high) in cases {
        let open = tube(8, |_, _| 0.0, high);
        // A cap on teeth as high as they are wide is as jagged as its rim: no flat cap.
        let both = [(open.clone(), false), (capped(&open), true)];
        for (mesh, is_capped) in both.into_iter().take(if name == "saw-toothed" { 1 } else { 2 }) {
            let vessel = find(&mesh);
            assert_eq!(vessel.ends.len(), 2, "{name} {is_capped}");
            let end = vessel.ends.iter().max_by(|a, b| a.center.z.total_cmp(&b.center.z)).expect("two");
            let cosine = f64::to_radians(tilt).cos();
            assert!((end.normal.z - cosine).abs() < 1e-3, "{name} {:?}", end.normal);
            assert!((end.area / (polygon_area() / cosine) - 1.0).abs() < 2e-3, "{name} {}", end.area);
            assert!((end.radius - 2.0).abs() < 0.02 && end.capped == is_capped);
            assert!(end.direction.z > 0.999, "{name} {:?}", end.direction);
            assert_eq!(vessel.filled.len() + vessel.left_open.len(), 0);
            for whole in [vessel.closed(), vessel.extended(0.25)] {
                assert!(topology::check(&whole).is_closed_manifold(), "{name}");
            }
            let longer = vessel.extended(0.25).volume() - vessel.closed().volume();
            // Four voxels and half a radius out of either plane.
            let added = |area: f64| area * (1.0 + 0.5 * (area / std::f64::consts::PI).sqrt());
            let wanted: f64 = vessel.ends.iter().map(|e| added(e.area)).sum();
            // The smallest lid spans the tips of teeth, the plane their middles.
            assert!((longer / wanted - 1.0).abs() < 0.05, "{name} {longer} for {wanted}");
        }
    }
}

#[test]
fn holes_in_the_wall_are_closed_and_are_no_ends() {
    let mut mesh = tube(40, |_, _| 0.0, |_, _| 20.0);
    // Two triangles of a quadrangle, and a patch of several.
    let hole: Vec<usize> = (0..mesh.triangles.len()).filter(|&t| {
        let [a, b, c] = mesh.corners(t);
        let p = (a.coords + b.coords + c.coords) / 3.0;
        (p - Vector::new(2.0, 0.0, 5.0)).norm() < 0.9 || (p - Vector::new(-2.0, 0.0, 12.0)).norm() < 0.3
    }).collect();
    assert!(hole.len() > 10);
    for t in hole.into_iter().rev() {
        mesh.triangles.remove(t);
        mesh.patch.remove(t);
    }
    let vessel = find(&mesh);
    assert_eq!((vessel.ends.len(), vessel.left_open.len()), (2, 0));
    assert!(vessel.filled.len() > 1);
    assert!(topology::check(&vessel.closed()).is_closed_manifold());
}

#[test]
fn a_funnel_is_carried_on_without_a_bend_at_its_rim() {
    let mut mesh = tube(8, |_, _| 0.0, |_, _| 20.0);
    mesh.points.iter_mut().for_each(|p| {
        let wide = 1.0 + p.z / 40.0;
        (p.x, p.y) = (p.x * wide, p.y * wide);
    });
    let vessel = find(&mesh);
    let extended = vessel.extended(0.25);
    // Two voxels beyond the rim the cone still goes on.
    let beyond = extended.points.iter().filter(|p| (p.z - 20.5).abs() < 1e-9);
    let radii: Vec<f64> = beyond.map(|p| p.x.hypot(p.y)).collect();
    assert_eq!(radii.len(), AROUND as usize);
    assert!(radii.iter().all(|r| (r - 2.0 * (1.0 + 20.5 / 40.0)).abs() < 5e-3), "{radii:?}");
}

#[test]
fn a_large_bent_hole_stays_open() {
    let mut mesh = sphere(Point::origin(), 5.0, 24);
    let kept: Vec<[u32; 3]> = (0..mesh.triangles.len()).filter(|&t| mesh.corners(t).iter().all(|p| p.x > 0.0 || p.y.abs() > 1.5)).map(|t| mesh.triangles[t]).collect();
    mesh.triangles = kept;
    mesh.patch.truncate(mesh.triangles.len());
    let vessel = find(&mesh);
    assert!(vessel.ends.is_empty() && vessel.left_open.len() == 1 && vessel.left_open[0].center.x < 0.0, "{:?}", vessel.left_open);
}

#[test]
fn a_wall_across_the_lumen_and_facets_of_a_coarse_tube_are_no_ends() {
    let mut mesh = tube(8, |_, _| 0.0, |_, _| 20.0);
    let (row, middle) = (4 * AROUND, mesh.points.len() as u32);
    mesh.points.push(Point::new(0.0, 0.0, 10.0));
    mesh.triangles.extend((0..AROUND).map(|i| [row + i, row + (i + 1) % AROUND, middle]));
    mesh.patch = vec![crate::mesh::WALL; mesh.triangles.len()];
    let mesh = repair::repair(&mesh).expect("repaired").mesh;
    assert_eq!(find(&mesh).ends.len(), 2);
    let cube = capped(&tube(1, |_, _| 0.0, |_, _| 4.0));
    let mut square = TriMesh::default();
    for (n, p) in cube.points.iter().enumerate() {
        let n = n as u32;
        if n % (AROUND / 6) == 0 || n >= 2 * AROUND {
            square.points.push(*p);
        }
    }
    for i in 0..6 {
        let (a, b) = (i, (i + 1) % 6);
        square.triangles.extend([[a, b, b + 6], [a, b + 6, a + 6]]);
    }
    for rim in rims::loops(&square) {
        let middle = if square.points[rim[0] as usize].z < 2.0 { 12 } else { 13 };
        square.triangles.extend((0..6).map(|i| [rim[(i + 1) % 6], rim[i], middle]));
    }
    square.patch = vec![crate::mesh::WALL; square.triangles.len()];
    let found = find(&square).ends;
    assert!(found.iter().all(|e| e.normal.z.abs() > 0.99), "{found:?}");
}

#[test]
fn ends_that_face_each_other_are_carried_on_only_as_far_as_there_is_room() {
    let mut mesh = tube(8, |_, _| 0.0, |_, _| 20.0);
    let other = tube(8, |_, _| 21.5, |_, _| 40.0);
    let n = mesh.points.len() as u32;
    mesh.points.extend(&other.points);
    mesh.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + n)));
    mesh.patch.extend(&other.patch);
    let extended = find(&mesh).extended(0.2);
    assert!(crate::mesh::intersect::self_intersections(&extended).is_empty());
}
