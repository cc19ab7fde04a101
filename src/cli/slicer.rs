//! lumenmesh as a module of 3D Slicer, by the rules of the Slicer Execution Model: `--xml` describes the parameters,
//! flags come before the indexed mask, progress goes to standard output as XML, scalar results into a file.
//!
//! Whatever stands on standard error is shown as an error, so nothing else goes there.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::time::Instant;

use clap::Parser;
use serde_json::Value;

use super::console::{self, share};
use super::exit::{self, Failure};
use super::output::{self, Earlier, Existing};
use super::run::run_case;
use crate::config::{Case, Label, Labels};
use crate::pipeline::{Progress, Stage};
use crate::report::{Report, Status};

/// The description of the module, as Slicer reads it from `--xml`.
pub fn description() -> String {
    include_str!("slicer.xml").replace("@VERSION@", env!("CARGO_PKG_VERSION"))
}

/// lumenmesh as a command line module of 3D Slicer.
#[derive(Debug, Parser)]
#[command(name = "lumenmesh-slicer", version)]
struct Arguments {
    /// Print the module's description and end.
    #[arg(long)]
    xml: bool,
    /// Mask (.nrrd, .nii.gz, .mha, …).
    #[arg(required_unless_present = "xml")]
    mask: Option<PathBuf>,
    /// The surface (.vtp).
    #[arg(long, value_name = "FILE")]
    surface: Option<PathBuf>,
    /// Centerlines (.vtp).
    #[arg(long, value_name = "FILE")]
    centerlines: Option<PathBuf>,
    /// The volume mesh (.vtu).
    #[arg(long, value_name = "FILE")]
    volume: Option<PathBuf>,
    /// Folder in which a folder `lumenmesh` with all results is made.
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Label that is lumen; 0 takes the mask's one value.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    label: i64,
    /// Factor on the edge length.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true)]
    scale: f64,
    /// Limit of the equi-angle skewness.
    #[arg(long, default_value_t = 0.75, allow_negative_numbers = true)]
    max_skewness: f64,
    /// Stop after the surface.
    #[arg(long)]
    no_volume: bool,
    /// Prism layers on the wall.
    #[arg(long, default_value_t = 0)]
    layers: u32,
    /// Reynolds number at the inlet.
    #[arg(long, default_value_t = 300.0, allow_negative_numbers = true)]
    reynolds: f64,
    /// Threads; 0 takes all cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// File for the scalar results.
    #[arg(long = "returnparameterfile", value_name = "FILE")]
    results: Option<PathBuf>,
    /// Address that Slicer gives to modules that it has loaded; not used by a process of its own.
    #[arg(long = "processinformationaddress", value_name = "ADDRESS", hide = true)]
    _address: Option<String>,
}

/// Runs the module and gives its exit code; a missed gate is no failure to Slicer, which would drop the outputs:
/// the verdict tells it.
pub fn main() -> ExitCode {
    if let Some(code) = super::worker() {
        return code;
    }
    let arguments = match Arguments::try_parse() {
        Ok(a) => a,
        Err(e) => {
            let _ = e.print();
            return ExitCode::from(if e.use_stderr() { exit::USAGE } else { 0 });
        }
    };
    if arguments.xml {
        // A closed pipe is Slicer's own doing.
        let _ = std::io::stdout().lock().write_all(description().as_bytes());
        return ExitCode::SUCCESS;
    }
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{}", e.message());
            ExitCode::from(e.code())
        }
    }
}

/// The case that the parameters describe.
fn case(a: &Arguments, mask: &Path) -> Result<Case, Failure> {
    let mut case = Case::for_mask(mask.into());
    if a.label != 0 {
        case.input.label = Labels::One(Label::Number(a.label));
    }
    case.surface.scale = a.scale;
    case.surface.max_skewness = a.max_skewness;
    case.surface.target_skewness = case.surface.target_skewness.min(a.max_skewness);
    case.volume.boundary_layers.count = a.layers;
    case.flow.inlet.reynolds = Some(a.reynolds);
    Ok(crate::config::from_text(&crate::config::to_yaml(&case)?, "the parameters", &[])?)
}

fn run(a: &Arguments) -> Result<(), Failure> {
    console::catch_interrupt(console::PATIENCE);
    let mask = a.mask.clone().unwrap_or_default();
    let case = case(a, &mask)?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(a.threads).build().map_err(|e| Failure::new(exit::USAGE, e))?;
    let progress = Filter::new(if a.no_volume { SURFACE_SHARE } else { 100.0 });
    let stage = if a.no_volume { Stage::Surface } else { Stage::Exports };
    // Without a folder the results live only until what was asked for is copied.
    let scratch = if a.folder.is_none() { Some(output::Scratch::new("lumenmesh-slicer")?) } else { None };
    let dir = scratch.as_ref().map(output::Scratch::path).or(a.folder.as_deref()).unwrap_or(Path::new("")).join("lumenmesh");
    let done = pool.install(|| run_case(&case, &dir, Earlier::KeepChanged, stage, &progress)).and_then(|(report, kept)| {
        if let Some(kept) = kept {
            progress.comment(&format!("what was there before is in {}", kept.display()));
        }
        hand_over(a, &dir, &report)?;
        Ok(report)
    });
    drop(scratch);
    let report = done?;
    for w in &report.warnings {
        progress.comment(&w.message);
    }
    Ok(())
}

/// Copies what was asked for and writes the scalar results.
fn hand_over(a: &Arguments, dir: &Path, report: &Report) -> Result<(), Failure> {
    let files = [(&a.surface, "surface/lumen.vtp"), (&a.centerlines, "surface/centerlines.vtp"), (&a.volume, "volume/lumen.vtu")];
    for (to, from) in files {
        let from = dir.join(from);
        if let Some(to) = to
            && from.is_file()
        {
            let bytes = std::fs::read(&from).map_err(|e| Failure::new(exit::ENGINE, anyhow::anyhow!("{}: {e}", from.display())))?;
            output::place(to, &bytes, Existing::Replace)?;
        }
    }
    let Some(file) = &a.results else { return Ok(()) };
    let json = serde_json::to_value(report).unwrap_or(Value::Null);
    let figure = |path: &str| json.pointer(path).and_then(Value::as_f64).unwrap_or(0.0);
    let missed: Vec<&str> = report.gates.iter().filter(|g| g.hard && !g.passed).map(|g| g.name.as_str()).collect();
    let verdict = match report.status {
        Status::Passed => "all hard gates are met".into(),
        Status::GateMissed => format!("missed: {}", missed.join(", ")),
    };
    let page = if a.folder.is_some() { dir.join("report.html").display().to_string() } else { String::new() };
    let mut lines = vec![
        format!("verdict = {verdict}"),
        format!("worstSkewness = {}", figure("/surface/s_max")),
        format!("deviation = {}", figure("/fidelity/to_marching_cubes/max")),
        format!("triangles = {}", figure("/surface/faces")),
        format!("cells = {}", figure("/volume/cells")),
    ];
    if !page.is_empty() {
        lines.push(format!("report = {page}"));
    }
    // Slicer's reader takes a blank line or a second line of a value for a fault.
    let text: String = lines.iter().map(|l| l.replace(['\n', '\r'], " ") + "\n").collect();
    output::place(file, text.as_bytes(), Existing::Replace).map(|_| ())
}

/// Per cent of the whole work after which the surface stands.
const SURFACE_SHARE: f64 = 59.0;

/// Progress as Slicer reads it from standard output.
struct Filter {
    done: Mutex<f64>,
    whole: f64,
    start: Instant,
}

impl Filter {
    fn new(whole: f64) -> Filter {
        let filter = Filter { done: Mutex::new(0.0), whole, start: Instant::now() };
        filter.say("<filter-start><filter-name>lumenmesh</filter-name><filter-comment>starting</filter-comment></filter-start>");
        filter
    }

    fn say(&self, xml: &str) {
        let mut out = std::io::stdout().lock();
        // A reader that has gone needs no progress.
        let _ = writeln!(out, "{xml}").and_then(|()| out.flush());
    }

    fn comment(&self, text: &str) {
        let text: String = crate::report::cohort::escape(text).chars().take(900).collect();
        self.say(&format!("<filter-comment>{text}</filter-comment>"));
    }
}

impl Progress for Filter {
    fn begin(&self, stage: &str) {
        self.comment(stage);
    }

    fn end(&self, stage: &str, _: f64, _: &str) {
        let Ok(mut done) = self.done.lock() else { return };
        *done = (*done + share(stage)).min(self.whole);
        self.say(&format!("<filter-progress>{:.3}</filter-progress>", (*done / self.whole).min(1.0)));
    }

    fn explain(&self, _: &str) {}
}

impl Drop for Filter {
    fn drop(&mut self) {
        let time = self.start.elapsed().as_secs_f64();
        self.say(&format!("<filter-progress>1</filter-progress>\n<filter-end><filter-name>lumenmesh</filter-name><filter-time>{time:.1}</filter-time></filter-end>"));
    }
}
