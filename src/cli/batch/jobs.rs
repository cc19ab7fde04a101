//! The cases of a cohort: their names, what decides whether they are done, and the memory they are likely to take.

use std::path::PathBuf;

use super::names;
use crate::cli::args::BatchArgs;
use crate::cli::exit::Failure;
use crate::cli::mark;
use crate::cli::run::case_for;
use crate::config::{self, Case};
use crate::io;
use crate::mask::{self, Selection};
use crate::pipeline::Stage;

/// One case of a cohort.
pub struct Job {
    /// Name and folder.
    pub name: String,
    /// Case file, mask or surface.
    pub input: PathBuf,
    /// Whether the input is a case file.
    pub yaml: bool,
    /// Overrides: those of all cases and, in a sweep, its own.
    pub set: Vec<String>,
    /// The overrides of a sweep alone.
    pub own: Vec<String>,
}

/// What must be known before a case runs.
pub struct Work {
    /// Hash of the resolved case, its files and this version: results with the same mark are these results.
    pub mark: String,
    /// Bytes of memory that the run is likely to stay below.
    pub memory: u64,
}

/// The cases in the order given; with sweeps each of them with every combination of the values.
pub fn list(args: &BatchArgs) -> Result<Vec<Job>, Failure> {
    let mut jobs: Vec<Job> = Vec::new();
    let variants = sweep(&args.sweep)?;
    for input in &args.cases {
        let base = names::name(input);
        for (suffix, own) in &variants {
            let name = format!("{base}{suffix}");
            let yaml = input.extension().is_some_and(|e| e == "yaml" || e == "yml");
            jobs.push(Job { name, input: input.clone(), yaml, set: args.set.iter().chain(own).cloned().collect(), own: own.clone() });
        }
    }
    names::check(&jobs)?;
    Ok(jobs)
}

/// Suffix of the name and overrides of every combination of `key=a,b,c`; one without either where nothing is swept.
fn sweep(texts: &[String]) -> Result<Vec<(String, Vec<String>)>, Failure> {
    let mut all = vec![(String::new(), Vec::new())];
    for text in texts {
        let bad = || Failure::usage(format!("--sweep {text}: write key.path=value,value, such as --sweep reconstruction.offset=-0.25,0,0.25"));
        let (key, values) = text.split_once('=').ok_or_else(bad)?;
        let values: Vec<&str> = values.split(',').map(str::trim).filter(|v| !v.is_empty()).collect();
        if values.is_empty() {
            return Err(bad());
        }
        let short = key.rsplit('.').next().unwrap_or(key);
        all = all
            .iter()
            .flat_map(|(suffix, sets)| {
                values.iter().map(move |v| {
                    let safe: String = v.chars().map(|c| if c.is_alphanumeric() || matches!(c, '.' | '-' | '+') { c } else { '_' }).collect();
                    (format!("{suffix}_{short}{safe}"), sets.iter().cloned().chain([format!("{key}={v}")]).collect())
                })
            })
            .collect();
    }
    Ok(all)
}

/// Reads the case and its files.
pub fn prepare(job: &Job) -> Result<Work, Failure> {
    let case = if job.yaml { config::load(&job.input, &job.set)? } else { case_for(&job.input, &job.set)? };
    let mark = mark::of(&case, Stage::Exports)?;
    Ok(Work { mark, memory: memory(&case) })
}

/// What a run is likely to stay below, from runs on masks of 600 to 320 000 lumen voxels (45 to 620 MB): the picture a few
/// times over, 6 kB a lumen voxel, more for smaller triangles; a GiB where the picture cannot be read.
fn memory(case: &Case) -> u64 {
    const BASE: f64 = 2e8;
    let Some(path) = &case.input.mask else { return 1 << 30 };
    let Ok(image) = io::image::read(path) else { return 1 << 30 };
    let picture = (image.values.len() * 12) as f64;
    let lumen = mask::select(&image, &Selection::Threshold { lower: Some(f64::MIN_POSITIVE), upper: None }).map_or(0, |m| m.count()) as f64;
    let finer = (1.0 / case.surface.scale.min(1.0)).powi(2);
    (BASE + picture + 6e3 * lumen * finer) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sweep_is_every_combination_under_its_own_name() {
        let all = sweep(&["reconstruction.offset=-0.25, 0".into(), "surface.edge_length=0.5 mm,auto".into()]).expect("fine");
        let names: Vec<&str> = all.iter().map(|v| v.0.as_str()).collect();
        assert_eq!(names, ["_offset-0.25_edge_length0.5_mm", "_offset-0.25_edge_lengthauto", "_offset0_edge_length0.5_mm", "_offset0_edge_lengthauto"]);
        assert_eq!(all[0].1, ["reconstruction.offset=-0.25", "surface.edge_length=0.5 mm"]);
        assert!(sweep(&["surface.scale".into()]).is_err());
    }
}
