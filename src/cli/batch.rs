//! `lumenmesh batch`: a cohort, one folder and one process a case; failures never stop the rest.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::thread;

use serde_json::Value;

use super::args::BatchArgs;
use super::console::{self, CANCELLED};
use super::exit::{self, Failure};
use super::output;
use crate::report::cohort::{self, Row};

struct Job {
    name: String,
    input: PathBuf,
}

/// The text that tells whether a folder holds the results of this very case and these overrides.
fn fingerprint(job: &Job, args: &BatchArgs) -> Result<String, Failure> {
    use sha2::{Digest, Sha256};
    let mut hash = Sha256::new();
    let bytes = std::fs::read(&job.input).map_err(|e| {
        Failure::new(exit::INPUT, anyhow::anyhow!("{}: {e}: check the path", job.input.display()))
    })?;
    hash.update(&bytes);
    for set in &args.set {
        hash.update(set.as_bytes());
        hash.update([0]);
    }
    hash.update(env!("CARGO_PKG_VERSION"));
    Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
}

fn jobs(args: &BatchArgs) -> Result<Vec<Job>, Failure> {
    let mut jobs: Vec<Job> = Vec::new();
    for input in &args.cases {
        let file = input.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = file.split('.').next().unwrap_or("case").to_string();
        // `a/case.yaml` and `b/case.yaml` are told apart by their folders.
        let folder = input.parent().and_then(Path::file_name).map(|n| n.to_string_lossy().into_owned());
        let mut name = if stem == "case" { folder.unwrap_or(stem) } else { stem };
        let base = name.clone();
        let mut n = 2;
        while jobs.iter().any(|j| j.name == name) {
            name = format!("{base}-{n}");
            n += 1;
        }
        jobs.push(Job { name, input: input.clone() });
    }
    Ok(jobs)
}

fn run_one(job: &Job, args: &BatchArgs, threads: usize) -> Result<Row, Failure> {
    let dir = args.output.join(&job.name);
    let mark = fingerprint(job, args);
    let mark_file = dir.join(".case-sha256");
    if let Ok(mark) = &mark
        && std::fs::read_to_string(&mark_file).is_ok_and(|m| m == *mark)
        && let Some(report) = read_report(&dir)
    {
        return Ok(Row::from_report(&job.name, &report, true));
    }
    let program = std::env::current_exe().map_err(|e| Failure::new(exit::ENGINE, e))?;
    let mut command = Command::new(program);
    let yaml = job.input.extension().is_some_and(|e| e == "yaml" || e == "yml");
    command.arg(if yaml { "run" } else { "mesh" }).arg(&job.input).arg("-o").arg(&dir).arg("--quiet");
    command.arg("--threads").arg(threads.to_string());
    for set in &args.set {
        command.arg("--set").arg(set);
    }
    let out = command
        .stdin(Stdio::null())
        .output()
        .map_err(|e| Failure::new(exit::ENGINE, anyhow::anyhow!("cannot start a run: {e}")))?;
    let code = out.status.code().unwrap_or(-1);
    if let (0 | 6, Ok(mark)) = (code, &mark)
        && let Some(report) = read_report(&dir)
    {
        output::write(&mark_file, mark.as_bytes())?;
        return Ok(Row::from_report(&job.name, &report, false));
    }
    let message = String::from_utf8_lossy(&out.stderr).trim().to_string();
    let message = if message.is_empty() { format!("the run ended with code {code}") } else { message };
    Ok(Row::failed(&job.name, code, message))
}

fn read_report(dir: &Path) -> Option<Value> {
    serde_json::from_str(&std::fs::read_to_string(dir.join("report.json")).ok()?).ok()
}

/// `lumenmesh batch CASES… -o DIR`
pub fn run(args: &BatchArgs) -> Result<u8, Failure> {
    console::catch_interrupt();
    if args.jobs == 0 {
        return Err(Failure::usage("--jobs 0: give at least 1"));
    }
    let jobs = jobs(args)?;
    let total = args.threads.unwrap_or_else(|| thread::available_parallelism().map_or(1, usize::from));
    let threads = (total / args.jobs).max(1);
    let queue = Mutex::new(jobs.iter().enumerate().collect::<VecDeque<_>>());
    let rows = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..args.jobs.min(jobs.len()) {
            scope.spawn(|| {
                loop {
                    if CANCELLED.load(Ordering::Relaxed) {
                        return;
                    }
                    let Some((n, job)) = queue.lock().ok().and_then(|mut q| q.pop_front()) else { return };
                    let row = run_one(job, args, threads)
                        .unwrap_or_else(|e| Row::failed(&job.name, i32::from(e.code()), e.message()));
                    eprintln!("{:<24} {}", job.name, row.line());
                    if let Ok(mut rows) = rows.lock() {
                        rows.push((n, row));
                    }
                }
            });
        }
    });
    if CANCELLED.load(Ordering::Relaxed) {
        return Err(Failure::new(exit::INTERRUPTED, anyhow::anyhow!("interrupted; run the same command again to go on")));
    }
    let mut rows = rows.into_inner().unwrap_or_default();
    rows.sort_by_key(|(n, _)| *n);
    let mut rows: Vec<Row> = rows.into_iter().map(|(_, r)| r).collect();
    cohort::sort_worst_first(&mut rows);
    output::write(&args.output.join("cohort.csv"), cohort::csv(&rows).as_bytes())?;
    output::write(&args.output.join("cohort.html"), cohort::html(&rows).as_bytes())?;
    let worst = rows.iter().map(|r| r.code).find(|c| *c != 0);
    println!("{} of {} cases met all hard gates; open {}", rows.iter().filter(|r| r.code == 0).count(), rows.len(), args.output.join("cohort.html").display());
    Ok(worst.map_or(0, |c| u8::try_from(c).unwrap_or(1)))
}
