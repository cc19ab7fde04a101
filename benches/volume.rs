//! Time of the volume stage: `cargo bench --bench volume`.
//!
//! The optimiser is to take at most three times as long as TetGen itself; only the ratio of two figures of one run says
//! anything, since both depend on the machine alike.

#[path = "../tests/common/vessels.rs"]
mod vessels;

use std::hint::black_box;
use std::time::Duration;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use lumenmesh::quality;
use lumenmesh::remesh::Uniform;
use lumenmesh::volume::{BuildOptions, LayerOptions, OptimiseOptions, VolumeOptions, WorkerOptions, build, optimise};

fn options() -> BuildOptions {
    let worker = WorkerOptions { executable: Some(env!("CARGO_BIN_EXE_lumenmesh").into()), ..WorkerOptions::default() };
    BuildOptions { fill: VolumeOptions { worker, ..VolumeOptions::default() }, optimise: None, layers: None }
}

fn volume(c: &mut Criterion) {
    let surface = vessels::bent(2.0, 8.0, 2.0, 0.6, 6);
    let size = Uniform(f64::NAN);
    let Ok((raw, _)) = build(&surface, &size, &options(), None) else { return };
    let mut group = c.benchmark_group(format!("volume, {} tetrahedra", raw.tets.len()));
    group.sample_size(10).measurement_time(Duration::from_secs(8));
    group.bench_function("sizes, points and TetGen", |b| b.iter(|| build(black_box(&surface), &size, &options(), None)));
    group.bench_function("optimiser", |b| {
        b.iter_batched(|| raw.clone(), |mut m| optimise(&mut m, &OptimiseOptions::default()), BatchSize::LargeInput)
    });
    let layered = BuildOptions { layers: Some(LayerOptions::default()), ..options() };
    group.bench_function("four layers and TetGen", |b| b.iter(|| build(black_box(&surface), &size, &layered, None)));
    group.bench_function("quality", |b| b.iter(|| quality::volume(black_box(&raw), &quality::VolumeOptions::default())));
    group.finish();
}

criterion_group!(benches, volume);
criterion_main!(benches);
