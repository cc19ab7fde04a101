//! The openings found on random masks of hard kinds, against the true ends:
//! `cargo run --release --example opening_kinds -- --kind cuts --count 100 --seed 7`.
//!
//! - `--kind NAME[,NAME]` kinds of samples (all of them unless given), `--list` prints their names.
//! - `--count N` (50) samples of each kind, from `--seed S` (1) on.
//! - `--surface` makes the whole surface and judges the openings as they were cut, with the checks of the run;
//!   otherwise the planes are judged as `lumenmesh init` decides them.
//! - `--quick` looks at the decided planes before there is a wall to square them to; seconds for a hundred samples.
//! - `--write DIR` writes the samples at fault as KIND-SEED.nrrd and .json; `--write-all` writes all.
//! - `--sheet FILE.png` draws all samples; green are true ends, red the inlet found, blue the outlets found.
//!
//! One line a fault, then one line of counts a kind. A sample is made again by its name: `lumenmesh phantom cuts-7`.

mod judge;
mod sheet;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use judge::{Found, Judged};
use lumenmesh::config::Case;
use lumenmesh::io::nrrd;
use lumenmesh::mesh::PatchKind;
use lumenmesh::openings::{self, Evidence};
use lumenmesh::phantom::{self, Sample};
use lumenmesh::centerline;
use lumenmesh::pipeline::{self, Context, Silent, Stage};
use rayon::prelude::*;

struct Options {
    kinds: Vec<String>,
    count: u64,
    seed: u64,
    surface: bool,
    quick: bool,
    write: Option<PathBuf>,
    all: bool,
    sheet: Option<PathBuf>,
}

fn options() -> Result<Option<Options>, String> {
    let mut o = Options { kinds: Vec::new(), count: 50, seed: 1, surface: false, quick: false, write: None, all: false, sheet: None };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or(format!("{arg}: a value is missing"));
        match arg.as_str() {
            "--kind" => o.kinds.extend(value()?.split(',').map(str::to_owned)),
            "--count" => o.count = value()?.parse().map_err(|e| format!("--count: {e}"))?,
            "--seed" => o.seed = value()?.parse().map_err(|e| format!("--seed: {e}"))?,
            "--surface" => o.surface = true,
            "--quick" => o.quick = true,
            "--write" => o.write = Some(value()?.into()),
            "--write-all" => (o.write, o.all) = (Some(value()?.into()), true),
            "--sheet" | "--image" => o.sheet = Some(value()?.into()),
            "--list" => {
                phantom::kinds().iter().for_each(|k| println!("{k}"));
                return Ok(None);
            }
            other => return Err(format!("{other}: no such option; see the head of validation/openings/kinds.rs")),
        }
    }
    if o.kinds.is_empty() {
        o.kinds = phantom::kinds().into_iter().map(str::to_owned).collect();
    }
    Ok(Some(o))
}

/// Where the vessel ends by the program, and what the run said.
fn in_full(sample: &Sample, file: &Path, surface: bool) -> judge::Run {
    let cancel = AtomicBool::new(false);
    let worker = std::env::current_exe().unwrap_or_default();
    let case = Case::for_mask(file.into());
    let stop_after = if surface { Stage::Surface } else { Stage::Reconstruction };
    let context = Context { stop_after, progress: &Silent, cancel: &cancel, worker };
    let found = |openings: &[lumenmesh::openings::Opening], area: &dyn Fn(usize) -> Option<f64>| -> Vec<Found> {
        let one = |(n, o): (usize, &lumenmesh::openings::Opening)| Found {
            name: o.name.clone(),
            plane: o.plane,
            inlet: o.kind == PatchKind::Inlet,
            area: area(n),
            confidence: o.confidence,
        };
        openings.iter().enumerate().map(one).collect()
    };
    let mut run = judge::Run::default();
    let report = if surface {
        match pipeline::run(&case, &context) {
            Ok(outcome) => {
                let rows = outcome.report.sections.get("openings").and_then(|o| o.as_array()).cloned().unwrap_or_default();
                run.found = found(&outcome.openings, &|n| {
                    rows.iter().find(|r| r["name"] == outcome.openings[n].name.as_str())?["area"].as_f64()
                });
                outcome.report
            }
            Err(e) => {
                run.error = Some(e.to_string());
                return run;
            }
        }
    } else {
        match pipeline::survey(&case, &context) {
            Ok(s) => {
                run.found = found(&s.openings, &|n| s.areas[n]);
                s.report
            }
            Err(e) => {
                run.error = Some(e.to_string());
                return run;
            }
        }
    };
    debug_assert!(!sample.ends.is_empty());
    run.missed_checks = report.gates.iter().filter(|g| g.hard && !g.passed).map(|g| g.name.clone()).collect();
    run.warnings = report.warnings.iter().map(|w| format!("{}: {}", w.stage, w.message)).collect();
    run
}

/// The planes as they are decided on the mask, before a wall is there to square them to.
fn decided(sample: &Sample) -> judge::Run {
    let evidence = [Evidence::of(&sample.mask)];
    let mask = evidence[0].carried_on(&sample.mask, 4, 4);
    let lines = match centerline::trace(&mask, &Default::default()) {
        Ok((lines, _)) => lines,
        Err(e) => return judge::Run { error: Some(e.to_string()), ..Default::default() },
    };
    let (openings, report) = openings::detect(&mask, &lines, &evidence, &Default::default());
    let found = |o: &openings::Opening| Found {
        name: o.name.clone(),
        plane: o.plane,
        inlet: o.kind == PatchKind::Inlet,
        area: report.found.iter().find(|f| f.name == o.name).map(|f| f.area),
        confidence: o.confidence,
    };
    judge::Run { found: openings.iter().map(found).collect(), warnings: report.warnings, ..Default::default() }
}

fn one(kind: &str, seed: u64, o: &Options, folder: &Path) -> Result<(Sample, Judged), String> {
    let sample = phantom::sample(kind, seed).ok_or(format!("{kind}-{seed}: there is no such kind; --list prints them"))?;
    let file = folder.join(format!("{}.nrrd", sample.name));
    nrrd::write_mask(&file, &sample.mask).map_err(|e| e.to_string())?;
    let run = if o.quick { decided(&sample) } else { in_full(&sample, &file, o.surface) };
    let judged = judge::judge(&sample, run, o.surface);
    if let Some(dir) = o.write.as_ref().filter(|_| o.all || !judged.faults.is_empty()) {
        let text = serde_json::to_string_pretty(&sample.truth_json()).map_err(|e| e.to_string())?;
        std::fs::copy(&file, dir.join(format!("{}.nrrd", sample.name))).map_err(|e| e.to_string())?;
        std::fs::write(dir.join(format!("{}.json", sample.name)), text).map_err(|e| e.to_string())?;
    }
    std::fs::remove_file(&file).map_err(|e| e.to_string())?;
    Ok((sample, judged))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Some(o) = options()? else { return Ok(()) };
    let folder = std::env::temp_dir().join(format!("opening-kinds-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    if let Some(dir) = &o.write {
        std::fs::create_dir_all(dir)?;
    }
    let mut rows = Vec::new();
    let mut tiles = Vec::new();
    for kind in &o.kinds {
        let start = Instant::now();
        let judged: Vec<_> = (o.seed..o.seed + o.count).into_par_iter().map(|seed| one(kind, seed, &o, &folder)).collect();
        let mut sum = judge::Tally::default();
        for result in judged {
            let (sample, judged) = result?;
            if !judged.faults.is_empty() {
                println!("{}: {}", sample.name, judged.faults.join("; "));
            }
            sum.add(&judged);
            if o.sheet.is_some() {
                tiles.push(sheet::Tile::new(&sample, &judged));
            }
        }
        rows.push(sum.row(kind, start.elapsed().as_secs_f64()));
    }
    println!("\n{}", judge::Tally::HEAD);
    rows.iter().for_each(|r| println!("{r}"));
    if let Some(file) = &o.sheet {
        std::fs::write(file, sheet::png(&tiles)?)?;
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}
