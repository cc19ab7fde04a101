//! Figures of detection and cuts on cases whose truth is exact: `cargo run --release --example opening_figures [trees]`.
//!
//! Prints two tables: the openings of the built-in cases (distance and angle to the exact ends, area against the exact
//! section in the same plane), and the ends of random trees with every miss.

use std::f64::consts::TAU;
use std::sync::atomic::AtomicBool;

use lumenmesh::centerline::{CenterlineOptions, refine as refine_lines, trace};
use lumenmesh::config::Case;
use lumenmesh::geometry::{Plane, Point, Vector};
use lumenmesh::implicit::{Implicit, smooth};
use lumenmesh::io::nrrd;
use lumenmesh::mask::crop_pad;
use lumenmesh::openings::{DetectOptions, Evidence, Opening, detect, refine};
use lumenmesh::phantom::{self, End, Phantom, TreeOptions, random_tree};
use lumenmesh::pipeline::{self, Context, Silent, Stage};
use rayon::prelude::*;

/// Area of the exact lumen in a plane, round a point inside.
fn exact_area(truth: &dyn Implicit, plane: &Plane) -> Option<f64> {
    let (u, v) = plane.basis();
    let ray = |n: usize| {
        let (s, c) = (TAU * n as f64 / 720.0).sin_cos();
        let d: Vector = u * c + v * s;
        let at = |t: f64| truth.value(&(plane.origin + d * t));
        let mut high = 0.05;
        while at(high) < 0.0 {
            high += 0.05;
            if high > 60.0 {
                return None;
            }
        }
        let mut low = high - 0.05;
        for _ in 0..40 {
            let mid = 0.5 * (low + high);
            if at(mid) < 0.0 { low = mid } else { high = mid }
        }
        Some(0.5 * high * high * TAU / 720.0)
    };
    (0..720).map(ray).sum()
}

/// Degrees between an opening's normal and the vessel's axis there: at the exact end where the plane lies beyond it.
fn off_axis(phantom: &Phantom, opening: &Opening, end: &End) -> f64 {
    let axis = phantom.truth.axis(&opening.plane.origin).map_or(end.plane.normal, |a| a.direction);
    let angle = opening.plane.normal.angle(&axis);
    angle.min(std::f64::consts::PI - angle).to_degrees()
}

/// How far centerlines lie from the exact axis, in edges of a cube of the voxel's volume, and how much their radius differs, in %:
/// (median, 95 %, max) of each, over samples in one vessel alone and more than a radius from its ends.
fn centerline(phantom: &Phantom) -> Option<[[f64; 3]; 2]> {
    let picture = phantom.mask();
    let voxel = picture.grid.spacing().into_iter().product::<f64>().cbrt();
    let mask = crop_pad(&picture, 4, 4);
    let (mut lines, _) = trace(&mask, &CenterlineOptions::default()).ok()?;
    let (wall, _) = smooth::fit(&mask, &Default::default()).ok()?;
    refine_lines(&mut lines, &wall);
    let ends = phantom.ends(&picture.grid);
    let (mut off, mut radius) = (Vec::new(), Vec::new());
    for s in lines.branches.iter().flat_map(|b| &b.samples) {
        let free = ends.iter().all(|e| (s.point - e.plane.origin).norm() > 1.5 * e.radius);
        let Some(axis) = phantom.truth.axis(&s.point).filter(|_| free) else { continue };
        off.push((s.point - axis.point).norm() / voxel);
        radius.push(100.0 * (s.radius / axis.radius - 1.0).abs());
    }
    let three = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        let at = |q: f64| v[((v.len() - 1) as f64 * q).round() as usize];
        (!v.is_empty()).then(|| [at(0.5), at(0.95), at(1.0)])
    };
    Some([three(off)?, three(radius)?])
}

fn built_in(name: &str) -> Result<(), Box<dyn std::error::Error>> {
    let phantom = phantom::build(name)?;
    let mask = phantom.mask();
    let voxel = mask.grid.spacing().into_iter().fold(0.0, f64::max);
    let dir = std::env::temp_dir().join(format!("opening-figures-{}", std::process::id()));
    std::fs::create_dir_all(&dir)?;
    let file = dir.join(format!("{name}.nrrd"));
    nrrd::write_mask(&file, &mask)?;
    let cancel = AtomicBool::new(false);
    let context = Context { stop_after: Stage::Surface, progress: &Silent, cancel: &cancel, worker: std::env::current_exe()? };
    let outcome = pipeline::run(&Case::for_mask(file), &context)?;
    std::fs::remove_dir_all(&dir)?;
    let rows = outcome.report.sections.get("openings").and_then(|o| o.as_array()).cloned().unwrap_or_default();
    let ends = phantom.ends(&mask.grid);
    let lost = outcome.report.gates.iter().find(|g| g.name.starts_with("lost length")).map_or(f64::NAN, |g| g.value);
    for o in &outcome.openings {
        let end = ends.iter().min_by(|a, b| {
            (a.plane.origin - o.plane.origin).norm().total_cmp(&(b.plane.origin - o.plane.origin).norm())
        });
        let Some(end) = end else { continue };
        let row = rows.iter().find(|r| r["name"] == o.name.as_str());
        let area = row.and_then(|r| r["area"].as_f64()).unwrap_or(f64::NAN);
        let exact = exact_area(&phantom.truth, &o.plane).unwrap_or(f64::NAN);
        println!(
            "| {name} | {} | {:.1} | {:.2} | {:.1} | {:+.1} | {:.4} |",
            o.name,
            2.0 * end.radius / voxel,
            (o.plane.origin - end.plane.origin).norm() / end.radius,
            off_axis(&phantom, o, end),
            100.0 * (area / exact - 1.0),
            lost
        );
    }
    if outcome.openings.len() != ends.len() {
        println!("| {name} | {} of {} ends | | | | | {lost:.4} |", outcome.openings.len(), ends.len());
    }
    Ok(())
}

/// Ends, ends that are right, openings invented, and what is wrong in words.
fn tree(phantom: &Phantom) -> (usize, usize, usize, Vec<String>) {
    let picture = phantom.mask();
    let evidence = [Evidence::of(&picture)];
    let mask = evidence[0].carried_on(&picture, 4, 4);
    let ends = phantom.ends(&picture.grid);
    let mut wrong = Vec::new();
    let lines = match trace(&mask, &CenterlineOptions::default()) {
        Ok((lines, _)) => lines,
        Err(e) => return (ends.len(), 0, 0, vec![format!("{}: {e}", phantom.name)]),
    };
    let (found, report) = detect(&mask, &lines, &evidence, &DetectOptions::default());
    let openings: Vec<Opening> = match smooth::fit(&mask, &Default::default()) {
        Ok((wall, _)) => found.iter().map(|o| refine(&mask, &wall, o)).collect(),
        Err(_) => found,
    };
    let mut used = vec![false; openings.len()];
    let mut right = 0;
    for end in &ends {
        let away = |p: &Point| (p - end.plane.origin).norm() / end.radius;
        let free = (0..openings.len()).filter(|&n| !used[n]);
        let nearest = free.min_by(|&a, &b| away(&openings[a].plane.origin).total_cmp(&away(&openings[b].plane.origin)));
        match nearest.filter(|&n| away(&openings[n].plane.origin) < 2.5) {
            Some(n) => {
                used[n] = true;
                let angle = off_axis(phantom, &openings[n], end);
                if angle > 10.0 {
                    wrong.push(format!("{}: {} is {angle:.1} degrees off, radius {:.2} mm", phantom.name, end.name, end.radius));
                } else {
                    right += 1;
                }
            }
            None => {
                let blind = report.blind.iter().filter(|b| away(&b.tip) < 6.0).map(|b| format!("{:?} at {:.1} R", b.reason, away(&b.tip)));
                let openings = openings.iter().map(|o| away(&o.plane.origin)).fold(f64::INFINITY, f64::min);
                let blind: Vec<String> = blind.collect();
                wrong.push(format!("{}: {} of radius {:.2} mm is missed; nearest opening {openings:.1} R away; closed near by: {blind:?}", phantom.name, end.name, end.radius));
            }
        }
    }
    let invented = used.iter().filter(|u| !**u).count();
    if invented > 0 {
        wrong.push(format!("{}: {invented} invented", phantom.name));
    }
    (ends.len(), right, invented, wrong)
}

fn main() {
    let only_trees = std::env::args().any(|a| a == "trees");
    if !only_trees {
        println!("| case | opening | voxels across | from the end, R | off the axis, ° | area against the exact section, % | lost |\n|-|-|-|-|-|-|-|");
        for name in phantom::list().iter().filter(|n| !n.starts_with("sphere") && !n.starts_with("torus")) {
            if let Err(e) = built_in(name) {
                println!("| {name} | {e} | | | | | |");
            }
        }
        println!("\n| case | least voxels across | axis off, voxels: median | 95 % | max | radius off, %: median | 95 % | max |\n|-|-|-|-|-|-|-|-|");
        for name in phantom::list() {
            let Ok(phantom) = phantom::build(&name) else { continue };
            let ends = phantom.ends(&phantom.mask().grid);
            let across = ends.iter().map(|e| e.radius).fold(f64::INFINITY, f64::min) * 2.0 / phantom.spacing.into_iter().fold(0.0, f64::max);
            if let Some([a, r]) = centerline(&phantom) {
                println!("| {name} | {across:.1} | {:.2} | {:.2} | {:.2} | {:.1} | {:.1} | {:.1} |", a[0], a[1], a[2], r[0], r[1], r[2]);
            }
        }
    }
    let scores: Vec<_> = (1000..1200u64).into_par_iter().map(|seed| tree(&random_tree(seed, &TreeOptions::default()))).collect();
    let [ends, right, invented] = scores.iter().fold([0; 3], |s, x| [s[0] + x.0, s[1] + x.1, s[2] + x.2]);
    println!("\n200 random trees: {right} of {ends} ends right ({:.2} %), {invented} invented\n", 100.0 * right as f64 / ends as f64);
    scores.iter().flat_map(|s| &s.3).for_each(|w| println!("- {w}"));
}
