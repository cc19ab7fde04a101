//! Time of each stage from mask to surface on the built-in aneurysm: `cargo bench`, or `cargo bench -- isotropic`.
#![allow(missing_docs)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};

use lumenmesh::centerline::{self, Centerlines};
use lumenmesh::geometry::Point;
use lumenmesh::implicit::{Implicit, smooth};
use lumenmesh::mask::{Mask, crop_pad};
use lumenmesh::mesh::TriMesh;
use lumenmesh::openings::{self, Opening};
use lumenmesh::polygonize::{PolygonizeOptions, polygonize};
use lumenmesh::remesh::size_field::{GuidanceField, GuidanceOptions};
use lumenmesh::remesh::{Supports, advancing_front, angle_repair, isotropic};
use lumenmesh::{phantom, pointcloud};

/// Every stage's input on one phantom.
struct Case {
    mask: Mask,
    wall: smooth::SmoothImplicit,
    polygons: TriMesh,
    lines: Centerlines,
    radii: Vec<(Point, f64)>,
    field: GuidanceField,
    triangles: TriMesh,
    repaired: TriMesh,
    ends: Vec<Opening>,
}

fn case(name: &str) -> Case {
    let mask = crop_pad(&phantom::build(name).expect("a phantom").mask(), 4, 4);
    let (wall, _) = smooth::fit(&mask, &Default::default()).expect("a fit");
    let (polygons, _) = polygonize(&wall, &mask, &PolygonizeOptions::default()).expect("polygons");
    let (mut lines, _) = centerline::trace(&mask, &Default::default()).expect("centerlines");
    centerline::refine(&mut lines, &wall);
    let samples = lines.branches.iter().flat_map(|b| b.samples.iter());
    let radii: Vec<(Point, f64)> = samples.map(|s| (s.point, s.radius)).filter(|r| r.1 > 0.0).collect();
    let spacing = mask.grid.spacing();
    let (field, _) = GuidanceField::new(&polygons, &wall, &radii, spacing, &GuidanceOptions::default()).expect("a field");
    let supports = Supports::new(&wall);
    let (triangles, _) = isotropic::remesh(&polygons, &supports, &field, &Default::default()).expect("triangles");
    let (repaired, _) = angle_repair::repair(&triangles, &supports, &field, &Default::default()).expect("repair");
    let (ends, _) = openings::detect(&mask, &lines, &[openings::Evidence::of(&mask)], &Default::default());
    Case { mask, wall, polygons, lines, radii, field, triangles, repaired, ends }
}

fn stages(c: &mut Criterion) {
    let case = case("aneurysm");
    let wall: &dyn Implicit = &case.wall;
    let supports = Supports::new(wall);
    let mut group = c.benchmark_group("aneurysm");
    group.sample_size(10);
    group.bench_function("fit", |b| b.iter(|| smooth::fit(black_box(&case.mask), &Default::default())));
    group.bench_function("point cloud", |b| b.iter(|| pointcloud::extract(black_box(&case.mask), &Default::default())));
    group.bench_function("polygonize", |b| b.iter(|| polygonize(wall, &case.mask, &PolygonizeOptions::default())));
    group.bench_function("centerline", |b| b.iter(|| centerline::trace(&case.mask, &Default::default())));
    group.bench_function("guidance field", |b| {
        b.iter(|| GuidanceField::new(&case.polygons, wall, &case.radii, case.mask.grid.spacing(), &GuidanceOptions::default()))
    });
    group.bench_function("isotropic remesh", |b| {
        b.iter(|| isotropic::remesh(&case.polygons, &supports, &case.field, &Default::default()))
    });
    group.bench_function("advancing front", |b| {
        b.iter(|| advancing_front::remesh(&case.polygons, wall, &case.field, &Default::default()))
    });
    group.bench_function("angle repair", |b| {
        b.iter(|| angle_repair::repair(&case.triangles, &supports, &case.field, &Default::default()))
    });
    group.bench_function("detect openings", |b| b.iter(|| openings::detect(&case.mask, &case.lines, &[openings::Evidence::of(&case.mask)], &Default::default())));
    group.bench_function("cut", |b| {
        b.iter(|| openings::cut(&case.repaired, wall, &case.field, &case.ends, &Default::default()))
    });
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
