//! Bias of the default fit on shapes placed at random: `cargo run --release --example random_placement`.
//!
//! A vessel along a voxel axis is cut by every slice in the same places, so that the error of one section stands for the
//! whole length. Here cylinders, tori and spheres of known radius lie anyhow in the grid, so that such errors average out
//! and what is left is the method's own. Prints a Markdown table; lengths of radii in smallest voxel edges.

use std::error::Error;

use lumenmesh::geometry::{Point, Vector};
use lumenmesh::implicit::smooth::{self, SmoothOptions};
use lumenmesh::mask::{Grid, Mask};
use lumenmesh::phantom::Random;
use lumenmesh::polygonize::{PolygonizeOptions, polygonize};

/// Shapes of each kind and radius.
const ROUNDS: usize = 8;
/// Voxels from the grid's border that are left out.
const BORDER: f64 = 4.0;

fn main() -> Result<(), Box<dyn Error>> {
    let mut random = Random::new(1);
    println!("| voxels | shape | radius | bias | rms |\n|---|---|---|---|---|");
    for long in [1.0, 2.0] {
        for shape in ["cylinder", "torus", "sphere"] {
            for radius in [1.5, 2.0, 3.0, 4.5, 7.0] {
                let mut found = Vec::new();
                for _ in 0..ROUNDS {
                    errors(shape, radius, long, &mut random, &mut found)?;
                }
                let area: f64 = found.iter().map(|f| f.1).sum();
                let mean = |power: i32| found.iter().map(|f| f.0.powi(power) * f.1).sum::<f64>() / area;
                println!("| 1:1:{long} | {shape} | {radius} | {:+.4} | {:.4} |", mean(1), mean(2).sqrt());
            }
        }
    }
    Ok(())
}

/// Adds the signed distance to the truth (voxel diagonals) and the area of every triangle of one random shape.
fn errors(shape: &str, radius: f64, long: f64, random: &mut Random, found: &mut Vec<(f64, f64)>) -> Result<(), Box<dyn Error>> {
    let major = (4.0 * radius).max(8.0);
    let reach = if shape == "torus" { major + radius } else { radius.max(10.0) };
    let edge = 2.0 * reach + 14.0;
    let dims = [edge as usize, edge as usize, (edge / long) as usize];
    let grid = Grid::new(dims, [1.0, 1.0, long], Point::origin(), nalgebra::Matrix3::identity())?;
    let center = Point::from(Vector::from_fn(|a, _| 0.5 * edge + random.uniform(0.0, 1.0) * [1.0, 1.0, long][a]));
    let axis = random.direction();
    let truth = |p: &Point| {
        let w = p - center;
        let along = w.dot(&axis);
        match shape {
            "cylinder" => (w - axis * along).norm() - radius,
            "torus" => ((w - axis * along).norm() - major).hypot(along) - radius,
            _ => w.norm() - radius,
        }
    };
    let center_of = |n: usize| grid.to_world(Vector::from(grid.voxel(n).map(|v| v as f64)));
    let data = (0..grid.len()).map(|n| u8::from(truth(&center_of(n)) <= 0.0)).collect();
    let mask = Mask::new(grid.clone(), data);
    let (f, _) = smooth::fit(&mask, &SmoothOptions::default())?;
    let (mesh, _) = polygonize(&f, &mask, &PolygonizeOptions::default())?;
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.points[i as usize]);
        let middle = Point::from((a.coords + b.coords + c.coords) / 3.0);
        let x = grid.to_index(&middle);
        if (0..3).all(|k| x[k] > BORDER && x[k] < dims[k] as f64 - 1.0 - BORDER) {
            found.push((truth(&middle) / grid.voxel_diagonal(), 0.5 * (b - a).cross(&(c - a)).norm()));
        }
    }
    Ok(())
}
