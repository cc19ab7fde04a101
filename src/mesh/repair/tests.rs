use super::*;
use crate::mesh::test_shapes::sphere;
use crate::mesh::winding::WindingNumbers;

fn count(r: &Repaired, fault: Fault) -> usize {
    r.repairs.iter().find(|x| x.fault == fault).map_or(0, |x| x.count)
}

#[test]
fn a_sound_surface_stays_as_it_is() {
    let mesh = sphere(Point::new(1.0, 2.0, 3.0), 2.0, 8);
    let r = repair(&mesh).expect("sound");
    assert_eq!((r.mesh, r.shells, r.repairs), (mesh, 1, vec![]));
}

#[test]
fn triangles_turned_doubled_degenerate_and_without_shared_points_become_one_sphere() {
    let whole = sphere(Point::new(1.0, 2.0, 3.0), 2.0, 8);
    let mut soup = TriMesh::default();
    for t in 0..whole.triangles.len() {
        let n = soup.points.len() as u32;
        // Rounded otherwise in each triangle.
        soup.points.extend(whole.corners(t).map(|p| p + crate::mesh::test_shapes::grid_noise(n) * 1e-6));
        soup.triangles.push(if t % 7 == 0 { [n + 1, n, n + 2] } else { [n, n + 1, n + 2] });
    }
    soup.triangles.push(soup.triangles[40]);
    soup.triangles.push([3, 3, 5]);
    soup.patch = vec![crate::mesh::WALL; soup.triangles.len()];
    let r = repair(&soup).expect("repaired");
    assert!(topology::check(&r.mesh).is_closed_manifold());
    assert!((r.mesh.volume() / whole.volume() - 1.0).abs() < 1e-4);
    assert_eq!((count(&r, Fault::DuplicateTriangles), count(&r, Fault::DegenerateTriangles)), (1, 1));
    assert_eq!(count(&r, Fault::TurnedTriangles), whole.triangles.len().div_ceil(7));
    assert!(count(&r, Fault::UnsharedPoints) > 1000);
    assert!(r.repairs.iter().all(|x| (x.places[0] - Point::new(1.0, 2.0, 3.0)).norm() < 2.1));
}

#[test]
fn a_surface_inside_out_is_turned_and_its_cavity_with_it() {
    let outer = sphere(Point::origin(), 4.0, 8);
    let mut inner = sphere(Point::new(0.5, 0.0, 0.0), 1.0, 8);
    inner.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let mut both = outer.clone();
    both.points.extend(&inner.points);
    let n = outer.points.len() as u32;
    both.triangles.extend(inner.triangles.iter().map(|t| t.map(|v| v + n)));
    both.patch.extend(&inner.patch);
    let wanted = both.volume();
    let sound = repair(&both).expect("sound");
    assert!(sound.repairs.is_empty() && sound.shells == 2);
    both.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let r = repair(&both).expect("repaired");
    assert_eq!(count(&r, Fault::TurnedShells), 2);
    assert!((r.mesh.volume() - wanted).abs() < 1e-9);
    let w = WindingNumbers::new(&r.mesh);
    assert!(w.at(&Point::new(0.5, 0.1, 0.0)).abs() < 0.05 && w.at(&Point::new(-2.0, 0.1, 0.0)) > 0.95);
}

#[test]
fn edges_of_three_triangles_and_crossings_are_told_with_their_places() {
    let mut mesh = sphere(Point::origin(), 4.0, 8);
    // A fin on one edge, and a sphere that pokes through.
    let [a, b, _] = mesh.triangles[0];
    mesh.points.push(Point::new(9.0, 9.0, 9.0));
    mesh.triangles.push([a, b, mesh.points.len() as u32 - 1]);
    let other = sphere(Point::new(-4.0, 0.1, 0.2), 1.0, 4);
    let n = mesh.points.len() as u32;
    mesh.points.extend(&other.points);
    mesh.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + n)));
    mesh.patch = vec![crate::mesh::WALL; mesh.triangles.len()];
    let r = repair(&mesh).expect("repaired");
    assert_eq!(count(&r, Fault::NonManifoldEdges), 1);
    assert!(count(&r, Fault::Crossings) > 4);
    let text = r.repairs.iter().map(ToString::to_string).collect::<String>();
    assert!(text.contains("more than two triangles") && text.contains("mm"), "{text}");
}

#[test]
fn what_is_no_surface_is_refused() {
    assert_eq!(repair(&TriMesh::default()), Err(RepairError::Empty));
    let mut mesh = sphere(Point::origin(), 4.0, 2);
    mesh.points[3].x = f64::NAN;
    assert_eq!(repair(&mesh), Err(RepairError::NotFinite(3)));
}
