//! From a mask to surfaces, stage by stage, with the library alone:
//! `cargo run --release --example mask_to_surface -- MASK OUT_DIR [paper|cfd|smooth] [raw]`.
//!
//! `smooth` is the default reconstruction of the program: it writes `polygonized.stl` alone, the fit before remeshing.
//! `paper` and `cfd` fit MPU implicits to the one or the other point cloud; with `raw` they too stop there.
//!
//! Writes `polygonized.stl` (the polygonized implicit), `improved.stl` (its bad triangles repaired) and `front.stl`
//! (remeshed by an advancing front, then repaired): the three rows of the paper's Table 3. Prints one JSON object.

use std::error::Error;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;
use std::time::Instant;

use lumenmesh::implicit::guard::{GuardOptions, Guarded, MaskBoundary};
use lumenmesh::implicit::mpu::{self, MpuOptions};
use lumenmesh::implicit::offset::Offset;
use lumenmesh::implicit::smooth::{self, SmoothOptions};
use lumenmesh::mask::{CleaningOptions, Components, Mask, Selection, clean, crop_pad, select, topology};
use lumenmesh::mesh::{TriMesh, topology::check};
use lumenmesh::pointcloud::{self, PointCloudOptions};
use lumenmesh::polygonize::{PolygonizeOptions, polygonize};
use lumenmesh::remesh::advancing_front::{self, AdvancingFrontOptions};
use lumenmesh::remesh::angle_repair::{self, RepairOptions};
use lumenmesh::remesh::size_field::{GuidanceField, GuidanceOptions};
use lumenmesh::remesh::improve::{self, ImproveOptions};
use lumenmesh::remesh::{Supports, Uniform};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [input, out, rest @ ..] = &args[..] else { return Err("usage: mask_to_surface MASK OUT_DIR [paper|cfd|smooth] [raw]".into()) };
    let paper = rest.first().is_none_or(|p| p == "paper");
    let only_raw = rest.get(1).is_some_and(|p| p == "raw");
    fs::create_dir_all(out)?;
    let mut seconds = Vec::new();
    let mut processor = Vec::new();
    let (mut clock, mut used) = (Instant::now(), processor_seconds());
    let mut lap = |name: &str| {
        seconds.push((name.to_string(), serde_json::json!(clock.elapsed().as_secs_f64())));
        let now = processor_seconds();
        processor.push((name.to_string(), serde_json::json!(now.zip(used).map(|(a, b)| a - b))));
        (clock, used) = (Instant::now(), now);
    };

    let image = lumenmesh::io::image::read(input)?;
    let cleaning = CleaningOptions { components: Components::All, ..CleaningOptions::default() };
    let (mask, _) = clean(&select(&image, &Selection::Mask)?, &cleaning)?;
    lap("read and clean");
    if rest.first().is_some_and(|p| p == "smooth") {
        let mask = crop_pad(&mask, 4, 4);
        lap("crop");
        let (f, fit) = smooth::fit(&mask, &SmoothOptions::default())?;
        lap("fit");
        let (surface, polygonizer) = polygonize(&f, &mask, &PolygonizeOptions::default())?;
        lap("polygonize");
        write(out, "polygonized.stl", &surface)?;
        let report = serde_json::json!({
            "fit": fit, "polygonizer": polygonizer, "topology": {"mask": topology(&mask), "surface": check(&surface)},
            "volume": surface.volume(), "mask_volume": mask.volume(), "voxels": mask.grid.len(), "boundary_voxels": boundary_voxels(&mask),
            "peak_memory_bytes": peak_memory(),
            "seconds": seconds.into_iter().collect::<serde_json::Map<String, serde_json::Value>>(),
            "processor_seconds": processor.into_iter().collect::<serde_json::Map<String, serde_json::Value>>(),
        });
        println!("{report:#}");
        return Ok(());
    }

    let (cloud_options, polygon_options) = if paper {
        (PointCloudOptions::paper(), PolygonizeOptions::paper())
    } else {
        (PointCloudOptions::cfd(), PolygonizeOptions::default())
    };
    let (cloud, cloud_summary) = pointcloud::extract(&mask, &cloud_options)?;
    lap("points");
    let (f, mpu_summary) = mpu::fit(&cloud, &MpuOptions::estimate(&mask.grid, &cloud))?;
    lap("fit");
    let boundary = MaskBoundary::new(&mask, &GuardOptions::default()).ok_or("the mask has no lumen")?;
    let f = Guarded::new(f, boundary);
    lap("guard");
    let (surface, _) = polygonize(&f, &mask, &polygon_options)?;
    lap("polygonize");
    let guarded = surface.points.iter().filter(|p| f.intervenes(p)).count() as f64 / surface.points.len() as f64;
    write(out, "polygonized.stl", &surface)?;
    let mut report = serde_json::json!({
        "points": cloud_summary, "fit": mpu_summary, "guarded_share": guarded,
        "topology": {"mask": topology(&mask), "surface": check(&surface)},
    });

    if !only_raw {
        let level = polygon_options.offset * mask.grid.voxel_diagonal();
        let wall = Offset::new(&f as &dyn lumenmesh::implicit::Implicit, level);
        let supports = Supports::new(&wall);
        let spacing = mask.grid.spacing();
        let cell = polygon_options.cell * spacing[0].min(spacing[1]).min(spacing[2]);
        let repair = RepairOptions::default();
        let (improved, improvement) = improve::improve(&surface, &supports, &Uniform(cell), &ImproveOptions::default())?;
        lap("improve");
        write(out, "improved.stl", &improved)?;
        let (field, _) = GuidanceField::new(&surface, &wall, &[], spacing, &GuidanceOptions::default())?;
        lap("guidance field");
        let (front, front_summary) = advancing_front::remesh(&surface, &wall, &field, &AdvancingFrontOptions::default())?;
        lap("advancing front");
        let (front, _) = angle_repair::repair(&front, &supports, &field, &repair)?;
        lap("repair");
        write(out, "front.stl", &front)?;
        report["improve"] = serde_json::json!(improvement);
        report["front"] = serde_json::json!(front_summary);
    }
    report["seconds"] = seconds.into_iter().collect::<serde_json::Map<String, serde_json::Value>>().into();
    report["processor_seconds"] = processor.into_iter().collect::<serde_json::Map<String, serde_json::Value>>().into();
    println!("{report:#}");
    Ok(())
}

/// Lumen voxels with a background face neighbour, and background voxels with one in the lumen.
fn boundary_voxels(mask: &Mask) -> usize {
    let [nx, ny, nz] = mask.grid.dims.map(|n| n as i64);
    let steps = [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]];
    let mut count = 0;
    for k in -1..=nz {
        for j in -1..=ny {
            count += (-1..=nx).filter(|&i| steps.iter().any(|d| mask.at(i + d[0], j + d[1], k + d[2]) != mask.at(i, j, k))).count();
        }
    }
    count
}

/// Time that all threads together have had a processor, where the system tells.
fn processor_seconds() -> Option<f64> {
    let tasks = fs::read_dir("/proc/self/task").ok()?;
    let one = |t: std::io::Result<fs::DirEntry>| fs::read_to_string(t.ok()?.path().join("schedstat")).ok()?.split_whitespace().next()?.parse::<f64>().ok();
    Some(tasks.filter_map(one).sum::<f64>() * 1e-9)
}

/// Most memory that the process has held, where the system tells.
fn peak_memory() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kib| kib * 1024)
}

fn write(dir: &str, name: &str, mesh: &TriMesh) -> std::io::Result<()> {
    lumenmesh::io::stl::write_binary(&mut BufWriter::new(File::create(Path::new(dir).join(name))?), mesh)
}
