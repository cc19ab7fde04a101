//! `lumenmesh run` and `lumenmesh mesh`.

use std::path::{Path, PathBuf};

use super::args::{Common, MeshArgs, RunArgs};
use super::console::{self, Console};
use super::exit::{self, Failure};
use super::mark;
use super::output::manifest::Origin;
use super::output::{self, Earlier, Staging};
use crate::config::{self, Case};
use crate::pipeline::{self, Stage};
use crate::report::{Report, Status};

/// `lumenmesh run CASE.yaml`
pub fn run(args: &RunArgs) -> Result<u8, Failure> {
    let case = config::load(&args.case, &args.common.set)?;
    let output = args.output.clone().unwrap_or_else(|| PathBuf::from(args.case.file_stem().unwrap_or_default()));
    execute(&case, &output, &args.common).map_err(|f| f.in_case(&args.case))
}

/// `lumenmesh mesh MASK`
pub fn mesh(args: &MeshArgs) -> Result<u8, Failure> {
    let case = case_for(&args.input, &args.common.set)?;
    execute(&case, &args.output, &args.common)
}

/// The case for a mask or surface with all defaults but `set`.
pub fn case_for(input: &Path, set: &[String]) -> Result<Case, Failure> {
    let name = input.to_string_lossy().to_lowercase();
    let surface = [".stl", ".vtp", ".ply"].iter().any(|e| name.ends_with(e));
    let case = if surface { Case::for_surface(input.into()) } else { Case::for_mask(input.into()) };
    Ok(config::from_text(&config::to_yaml(&case)?, "the command line", set)?)
}

fn execute(case: &Case, output: &Path, common: &Common) -> Result<u8, Failure> {
    console::catch_interrupt(console::PATIENCE);
    if common.threads == Some(0) {
        return Err(Failure::usage("--threads 0: give at least 1"));
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(common.threads.unwrap_or(0))
        .build()
        .map_err(|e| Failure::new(exit::USAGE, e))?;
    let progress = Console::new(common.quiet, common.verbose);
    let stage = common.stop_after.map_or(Stage::Exports, Stage::from);
    let (report, kept) = pool.install(|| run_case(case, output, Earlier::from_flag(common.keep), stage, &progress))?;
    if !common.quiet {
        output::tell_kept(kept.as_deref());
    }
    if common.json {
        say!("{}", report.to_json().trim_end());
    } else if !common.quiet {
        summary(&report, output);
    }
    Ok(if report.status == Status::Passed { 0 } else { exit::GATE })
}

/// Runs a case and puts the results into `output`; gives the report and where earlier results were kept.
pub fn run_case(
    case: &Case,
    output: &Path,
    earlier: Earlier,
    stage: Stage,
    progress: &dyn pipeline::Progress,
) -> Result<(Report, Option<PathBuf>), Failure> {
    let staging = Staging::new(output, earlier)?;
    staging.guard(case.clone().files_mut().map(|f| f.clone()))?;
    // An input that cannot be read is the reader's to tell.
    let mark = mark::of(case, stage).ok();
    let worker = std::env::current_exe().map_err(|e| Failure::new(exit::ENGINE, e))?;
    let context = pipeline::Context { stop_after: stage, progress, cancel: &console::CANCELLED, worker };
    let report = pipeline::run_and_write(case, &staging.path(), &context)?;
    let kept = staging.publish(Origin { command: "run", case: mark.as_deref() })?;
    Ok((report, kept))
}

fn number(report: &Report, section: &str, key: &str) -> String {
    match report.sections.get(section).and_then(|s| s.get(key)) {
        Some(serde_json::Value::Number(n)) => match n.as_u64() {
            Some(i) => i.to_string(),
            None => format!("{:.3}", n.as_f64().unwrap_or(f64::NAN)),
        },
        _ => "–".into(),
    }
}

/// Four digits, and none too many.
pub fn rounded(value: f64) -> String {
    if value == 0.0 || value.abs() >= 1e-3 {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    } else {
        format!("{value:.2e}")
    }
}

/// The lines a person reads last.
fn summary(report: &Report, output: &Path) {
    for w in &report.warnings {
        eprintln!("warning: {}", w.message);
    }
    say!(
        "surface  {} triangles, equi-angle skewness S max {} mean {}",
        number(report, "surface", "faces"),
        number(report, "surface", "s_max"),
        number(report, "surface", "s_mean"),
    );
    if report.sections.contains_key("volume") {
        say!(
            "volume   {} cells ({} tetrahedra, {} prisms), equi-volume skewness S_V max {} mean {}",
            number(report, "volume", "cells"),
            number(report, "volume", "tets"),
            number(report, "volume", "prisms"),
            number(report, "volume", "sv_max"),
            number(report, "volume", "sv_mean"),
        );
    }
    for g in report.gates.iter().filter(|g| !g.passed) {
        say!("{} {}: {} (limit {})", if g.hard { "MISSED  " } else { "advisory" }, g.name, rounded(g.value), g.limit);
    }
    let verdict = if report.status == Status::Passed { "all hard gates met" } else { "A HARD GATE IS MISSED" };
    let warnings = match report.warnings.len() {
        0 => String::new(),
        1 => ", 1 warning".into(),
        n => format!(", {n} warnings"),
    };
    say!("results  {} ({verdict}{warnings}); open {}", output.display(), output.join("report.html").display());
}
