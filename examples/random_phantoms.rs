//! Accuracy of the default fit on the built-in phantoms as other pictures of them would show them:
//! `cargo run --release --example random_phantoms [ROUNDS [SEED [NOISE]]]`.
//!
//! Voxel size, offset of the grid and, in every other set, its direction are drawn at random, with voxels one to three
//! times as long as wide; trees are of random shape too. So no figure hangs on the few positions of the phantoms as they
//! are built in, and the method cannot be fitted to them. Prints a Markdown table: distances in voxel diagonals, angles in
//! degrees, the mean over the rounds, and how many of the pictures meet all limits of validation/accuracy.
//! With NOISE that share of the voxels at the boundary is flipped, and the mask cleaned.

use std::error::Error;

use lumenmesh::geometry::{Point, Vector};
use lumenmesh::implicit::Implicit;
use lumenmesh::implicit::smooth::{self, SmoothOptions};
use lumenmesh::mask::{CleaningOptions, Mask, clean, crop_pad, interface};
use lumenmesh::phantom::{self, Random, Truth};
use lumenmesh::polygonize::{PolygonizeOptions, polygonize};
use nalgebra::{Matrix3, Rotation3, Unit};

/// Voxels from the grid's border that are left out.
const BORDER: f64 = 4.0;
const NAMES: [&str; 11] = ["aneurysm", "tube", "bend", "bifurcation", "stenosis", "helix", "kissing", "thin", "tree", "sphere", "torus"];

/// Median, rms, bias, 99 % and maximum of the distance; median and 99 % of the normals' angle.
type Figures = [f64; 7];

fn main() -> Result<(), Box<dyn Error>> {
    let number = |n: usize, d: u64| std::env::args().nth(n).map_or(Ok(d), |a| a.parse());
    let (rounds, seed) = (number(1, 3)?, number(2, 7)?);
    let noise: f64 = std::env::args().nth(3).map_or(Ok(0.0), |a| a.parse())?;
    let mut random = Random::new(seed);
    println!("| grid | voxels | phantom | median | rms | bias | 99 % | max | normals 50 % | 99 % | met |\n|---|---|---|---|---|---|---|---|---|---|---|");
    for turned in [true, false] {
        for ratio in [1.0, 2.0, 3.0] {
            for name in NAMES {
                let mut found = Vec::new();
                for _ in 0..rounds {
                    let (mut mask, truth) = picture(name, ratio, turned, &mut random)?;
                    if noise > 0.0 {
                        mask = noisy(&mask, noise, &mut random)?;
                    }
                    found.push(figures(&mask, &truth)?);
                }
                let mean: Figures = std::array::from_fn(|i| found.iter().map(|f| f[i]).sum::<f64>() / found.len() as f64);
                let met = found.iter().filter(|f| within_limits(f, ratio > 1.5)).count();
                let [median, rms, bias, p99, max, n50, n99] = mean;
                let grid = if turned { "turned" } else { "along the axes" };
                println!("| {grid} | 1:1:{ratio} | {name} | {median:.3} | {rms:.3} | {bias:+.3} | {p99:.3} | {max:.3} | {n50:.1} | {n99:.1} | {met} of {rounds} |");
            }
        }
    }
    Ok(())
}

/// A picture of a phantom: size, offset and, where `turned`, direction of the voxels are random.
fn picture(name: &str, ratio: f64, turned: bool, random: &mut Random) -> Result<(Mask, Truth), Box<dyn Error>> {
    let mut p = match name {
        "tree" => phantom::build(&format!("tree-{}", random.bits() % 1000 + 2))?,
        _ => phantom::build(name)?,
    };
    let edge = p.spacing[0] * random.uniform(0.85, 1.25);
    let offset = [0, 1, 2].map(|_| random.uniform(0.0, 1.0));
    let turn = Rotation3::from_axis_angle(&Unit::new_normalize(random.direction()), random.uniform(0.0, std::f64::consts::TAU));
    let mut direction = Matrix3::identity();
    if turned {
        direction = turn.into_inner();
        for a in 0..3 {
            // The windows were made for the grid's own axes.
            let endless = !p.truth.extent(&direction.column(a).into_owned())[0].is_finite();
            p.window[a] = if endless { [Some(-12.0), Some(12.0)] } else { [None, None] };
        }
    }
    Ok((p.voxelize([edge, edge, edge * ratio], offset, direction), p.truth))
}

/// The mask with a share of the voxels at its boundary flipped, cleaned.
fn noisy(mask: &Mask, share: f64, random: &mut Random) -> Result<Mask, Box<dyn Error>> {
    let mut out = mask.clone();
    for (v, _) in interface(mask) {
        let [i, j, k] = v.map(i64::from);
        if let Some(n) = mask.grid.linear(i, j, k).filter(|_| random.uniform(0.0, 1.0) < share) {
            out.data[n] ^= 1;
        }
    }
    Ok(clean(&out, &CleaningOptions::default())?.0)
}

fn figures(picture: &Mask, truth: &Truth) -> Result<Figures, Box<dyn Error>> {
    let grid = &picture.grid;
    let mask = crop_pad(picture, 4, 4);
    let (f, _) = smooth::fit(&mask, &SmoothOptions::default())?;
    let (mesh, _) = polygonize(&f, &mask, &PolygonizeOptions::default())?;
    // Distance, angle and area of every triangle.
    let mut found: Vec<[f64; 3]> = Vec::new();
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.points[i as usize]);
        let middle = Point::from((a.coords + b.coords + c.coords) / 3.0);
        let x = grid.to_index(&middle);
        if (0..3).all(|k| x[k] > BORDER && x[k] < grid.dims[k] as f64 - 1.0 - BORDER) {
            let (value, gradient): (f64, Vector) = truth.value_gradient(&middle);
            let slope = gradient.norm().max(0.2);
            let n = (b - a).cross(&(c - a));
            let angle = (n.dot(&gradient) / (n.norm() * slope).max(1e-300)).clamp(-1.0, 1.0).acos().to_degrees();
            found.push([value / slope / grid.voxel_diagonal(), angle, 0.5 * n.norm()]);
        }
    }
    let area: f64 = found.iter().map(|f| f[2]).sum();
    let mean = |g: &dyn Fn(f64) -> f64| found.iter().map(|f| g(f[0]) * f[2]).sum::<f64>() / area;
    let share = |g: &dyn Fn(&[f64; 3]) -> f64, q: f64| {
        let mut sorted: Vec<(f64, f64)> = found.iter().map(|f| (g(f), f[2])).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut passed = 0.0;
        sorted.iter().find(|f| {
            passed += f.1;
            passed >= q * area
        })
        .or(sorted.last())
        .map_or(f64::NAN, |f| f.0)
    };
    let distance = |f: &[f64; 3]| f[0].abs();
    Ok([
        share(&distance, 0.5),
        mean(&|d| d * d).sqrt(),
        mean(&|d| d),
        share(&distance, 0.99),
        share(&distance, 2.0),
        share(&|f| f[1], 0.5),
        share(&|f| f[1], 0.99),
    ])
}

fn within_limits(f: &Figures, anisotropic: bool) -> bool {
    let [n50, n99] = if anisotropic { [5.0, 20.0] } else { [3.5, 15.0] };
    f.iter().zip([0.03, 0.05, 0.01, 0.15, 0.45, n50, n99]).all(|(f, limit)| f.abs() <= limit)
}
