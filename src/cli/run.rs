//! `lumenmesh run` and `lumenmesh mesh`.

use std::path::{Path, PathBuf};

use super::args::{Common, MeshArgs, RunArgs};
use super::console::{self, Console};
use super::exit::{self, Failure};
use super::kind;
use super::mark;
use super::output::manifest::Origin;
use super::output::{self, Earlier, Staging};
use crate::config::{self, Case};
use crate::pipeline::{self, Stage};
use crate::report::{Report, Status};

/// `lumenmesh run CASE.yaml`
pub fn run(args: &RunArgs) -> Result<u8, Failure> {
    kind::is_case(&args.case)?;
    let case = config::load(&args.case, &args.common.set)?;
    let output = args.output.clone().unwrap_or_else(|| PathBuf::from(args.case.file_stem().unwrap_or_default()));
    execute(&case, &output, &args.common).map_err(|f| f.in_case(&args.case))
}

/// `lumenmesh mesh MASK`
pub fn mesh(args: &MeshArgs) -> Result<u8, Failure> {
    kind::is_input(&args.input, "mesh")?;
    let case = case_for(&args.input, &args.common.set)?;
    execute(&case, &args.output, &args.common)
}

/// The case for a mask or surface with all defaults but `set`.
pub fn case_for(input: &Path, set: &[String]) -> Result<Case, Failure> {
    let name = input.to_string_lossy().to_lowercase();
    let surface = [".stl", ".vtp", ".vtk", ".ply", ".obj"].iter().any(|e| name.ends_with(e));
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
        for w in &report.warnings {
            eprintln!("warning: {}", w.message);
        }
        for line in super::summary::lines(&report, output, stage) {
            say!("{line}");
        }
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
