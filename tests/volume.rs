//! A vessel surface becomes tetrahedra, with TetGen in a process of its own.

#[path = "common/vessels.rs"]
mod vessels;

use lumenmesh::mesh::TriMesh;
use lumenmesh::remesh::Uniform;
use lumenmesh::quality;
use lumenmesh::volume::{BuildOptions, Error, LayerOptions, VolumeOptions, WorkerOptions, build, fill};

fn options() -> VolumeOptions {
    let worker = WorkerOptions { executable: Some(env!("CARGO_BIN_EXE_lumenmesh").into()), ..WorkerOptions::default() };
    VolumeOptions { worker, ..VolumeOptions::default() }
}

fn volume(points: &[lumenmesh::geometry::Point], tets: &[[u32; 4]]) -> f64 {
    tets.iter()
        .map(|t| {
            let p = t.map(|v| points[v as usize]);
            (p[1] - p[0]).cross(&(p[2] - p[0])).dot(&(p[3] - p[0])) / 6.0
        })
        .sum()
}

#[test]
fn a_tube_is_filled_and_its_surface_comes_back_unchanged() {
    let s = vessels::straight(2.0, 8.0, 3);
    let (m, summary) = fill(&s, &Uniform(0.7), &options()).unwrap();
    assert_eq!(m.points[..s.points.len()], s.points[..]);
    let faces: Vec<_> = m.boundary.iter().map(|f| ([f.vertices[0], f.vertices[1], f.vertices[2]], f.patch)).collect();
    let wanted: Vec<_> = s.triangles.iter().copied().zip(s.patch.iter().copied()).collect();
    assert_eq!(faces, wanted);
    assert_eq!(m.patches, s.patches);
    assert!((volume(&m.points, &m.tets) / s.volume() - 1.0).abs() < 1e-12);
    let ratio = summary.estimated_cells as f64 / m.tets.len() as f64;
    assert!((0.6..1.6).contains(&ratio), "{ratio}");
    assert!(summary.size_ratio[0] > 1.0 / 1.5 && summary.size_ratio[2] < 1.5, "{:?}", summary.size_ratio);
}

#[test]
fn the_same_surface_gives_the_same_mesh_in_millimetres_and_metres() {
    let s = vessels::straight(2.0, 6.0, 2);
    // A power of two: exact, so that the meshes must be the same to the bit.
    let small = TriMesh { points: s.points.iter().map(|p| p * 0.0009765625).collect(), ..s.clone() };
    let (a, _) = fill(&s, &Uniform(f64::NAN), &options()).unwrap();
    let (b, _) = fill(&small, &Uniform(f64::NAN), &options()).unwrap();
    assert_eq!(a.tets, b.tets);
    assert!(a.points.iter().zip(&b.points).all(|(p, q)| p * 0.0009765625 == *q));
}

#[test]
fn a_surface_with_a_hole_is_refused_with_the_place() {
    let mut s = vessels::straight(2.0, 6.0, 2);
    s.triangles.remove(7);
    s.patch.remove(7);
    let e = fill(&s, &Uniform(1.0), &options()).unwrap_err();
    assert!(matches!(e, Error::Surface(_)));
    let text = e.to_string();
    assert!(text.contains("open") && text.contains("near (") && text.contains("close the holes"), "{text}");
}

/// A duct with a square section: creases of 90° along it.
fn duct() -> TriMesh {
    let t = lumenmesh::geometry::Vector::new(1.0, 2.0, 2.0) / 3.0;
    let u = lumenmesh::geometry::Vector::new(2.0, 1.0, -2.0) / 3.0;
    let w = t.cross(&u);
    let (around, rings, length) = (24, 8, 5.0);
    let mut s = vessels::tube(4, rings, |s| (lumenmesh::geometry::Point::origin() + t * (s * length), t, u), |_| 2.0);
    for (i, p) in s.points.iter_mut().enumerate() {
        let (x, y) = (p.coords.dot(&u), p.coords.dot(&w));
        let (r, mut phi) = (x.hypot(y), y.atan2(x));
        // Every second ring of the tube is turned by half a step: turned back, all rings have points on the creases.
        if i / around <= rings && i / around % 2 == 1 {
            phi -= std::f64::consts::PI / around as f64;
        }
        let r = r / phi.cos().abs().max(phi.sin().abs());
        *p += u * (r * phi.cos() - x) + w * (r * phi.sin() - y);
    }
    s
}

#[test]
fn creases_leave_no_cell_that_solvers_refuse() {
    let s = duct();
    let (m, _) = build(&s, &Uniform(f64::NAN), &BuildOptions { fill: options(), ..BuildOptions::default() }, None).unwrap();
    let q = quality::volume(&m, &quality::VolumeOptions::default()).unwrap();
    assert_eq!(q.openfoam.cells_with_two_boundary_faces, 0);
    assert_eq!(q.openfoam.determinant_under_0001, 0, "{}", q.openfoam.determinant_min);
    assert!(q.openfoam.mesh_ok(true));
    assert!(q.sv_max < 0.85, "{}", q.sv_max);
    assert!(q.min_dihedral.unwrap() > 15.0 && q.max_dihedral.unwrap() < 155.0, "{:?} {:?}", q.min_dihedral, q.max_dihedral);
    let faces: Vec<_> = m.boundary.iter().map(|f| ([f.vertices[0], f.vertices[1], f.vertices[2]], f.patch)).collect();
    assert_eq!(faces, s.triangles.iter().copied().zip(s.patch.iter().copied()).collect::<Vec<_>>());
}

#[test]
fn any_number_of_threads_gives_the_same_mesh() {
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let o = BuildOptions { fill: options(), ..BuildOptions::default() };
        pool.install(|| build(&duct(), &Uniform(f64::NAN), &o, None)).unwrap().0
    };
    assert!(with(1) == with(3));
}

#[test]
fn a_length_in_millimetres_bounds_the_edges_inside() {
    let s = vessels::straight(2.0, 5.0, 6);
    let with = |max_edge: Option<f64>| {
        let mut o = options();
        o.sizing.max_edge = max_edge;
        let (_, summary) = build(&s, &Uniform(f64::NAN), &BuildOptions { fill: o, ..BuildOptions::default() }, None).unwrap();
        let (ratio, fill) = (summary.fill.size_ratio, &summary.fill);
        assert!(ratio[0] > 1.0 / 1.5 && ratio[2] < 1.5, "sizes hold within a factor 1.5 after the optimiser too: {ratio:?}");
        let off = fill.estimated_cells as f64 / fill.cells as f64;
        assert!((0.6..1.6).contains(&off), "{off}");
        fill.cells
    };
    let (free, bounded) = (with(None), with(Some(0.36)));
    assert!(bounded as f64 > 1.15 * free as f64, "{free} {bounded}");
}

#[test]
fn a_wished_number_of_cells_comes_out_within_a_tenth_with_and_without_layers() {
    let s = vessels::straight(2.0, 6.0, 6);
    let with = |target: Option<u64>, layers: u32| {
        let mut o = BuildOptions { fill: options(), ..BuildOptions::default() };
        o.fill.sizing.target_cells = target;
        o.layers = (layers > 0).then(|| LayerOptions { count: layers, ..LayerOptions::default() });
        let (m, summary) = build(&s, &Uniform(f64::NAN), &o, None).unwrap();
        ((m.tets.len() + m.prisms.len()) as f64, summary.fill.size_factor)
    };
    let free = with(None, 0).0;
    for (part, layers) in [(0.9, 0), (1.5, 0), (3.0, 0), (3.0, 2)] {
        let target = part * free;
        let (cells, factor) = with(Some(target as u64), layers);
        assert!((cells / target - 1.0).abs() < 0.1, "{cells} cells for {target} with {layers} layers, factor {factor}");
    }
}

/// A surface pressed flat to a part of its width along `d`.
fn pressed(mut s: TriMesh, d: lumenmesh::geometry::Vector, part: f64) -> TriMesh {
    for p in &mut s.points {
        *p -= d * (p.coords.dot(&d) * (1.0 - part));
    }
    s
}

#[test]
fn layers_are_made_thinner_where_the_tetrahedra_inside_them_come_out_poor() {
    let across = lumenmesh::geometry::Vector::new(2.0, 1.0, -2.0) / 3.0;
    let along = lumenmesh::geometry::Vector::new(1.0, 2.0, 2.0) / 3.0;
    let diagonal = (across + along.cross(&across)) / 2f64.sqrt();
    // A ribbon and a rhombus: between their layers little room is left.
    let shapes = [(pressed(vessels::straight(2.0, 6.0, 4), across, 0.44), 0.2), (pressed(duct(), diagonal, 0.8), 0.35)];
    let mut retried = 0;
    for (s, total) in shapes {
        let layers = LayerOptions { count: 3, total, ..LayerOptions::default() };
        let o = BuildOptions { fill: options(), layers: Some(layers), ..BuildOptions::default() };
        let (m, summary) = build(&s, &Uniform(f64::NAN), &o, None).unwrap();
        let q = quality::volume(&m, &quality::VolumeOptions::default()).unwrap();
        assert!(q.nonpositive_cells == 0 && q.sv_max < 0.85 && q.openfoam.mesh_ok(true), "{}", q.sv_max);
        for retry in &summary.retries {
            retried += 1;
            assert!(retry.vertices > 0 && s.points.contains(&retry.first), "a place on the surface: {retry:?}");
        }
        // What was poor stands in the summary, whether or not the mesh with thinner layers was the better one.
        let thin = summary.thickness.iter().zip(&summary.wished_thickness).filter(|(t, w)| **t < 0.95 * **w).count();
        assert!(thin < s.points.len() / 2, "thin at {thin} of {} points", s.points.len());
    }
    assert!(retried > 0, "neither shape needed a second time: another is wanted for this test");
}

#[test]
fn an_interrupt_ends_the_work_on_layers() {
    let s = vessels::straight(2.0, 6.0, 4);
    let o = BuildOptions { fill: options(), layers: Some(LayerOptions::default()), ..BuildOptions::default() };
    let cancel = std::sync::atomic::AtomicBool::new(true);
    let ended = build(&s, &Uniform(f64::NAN), &o, Some(&cancel)).expect_err("no mesh");
    assert!(matches!(ended, lumenmesh::volume::Error::Cancelled), "{ended}");
}
