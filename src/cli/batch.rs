//! `lumenmesh batch`: a cohort, one folder and one process a case; failures never stop the rest.

mod folder;
mod jobs;
mod names;
mod room;

use std::collections::VecDeque;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;

use self::folder::Folder;
use self::jobs::Job;
use self::room::Room;
use super::args::BatchArgs;
use super::console::{self, CANCELLED};
use super::exit::{self, Failure};
use super::output::manifest::Manifest;
use crate::report::cohort::{self, Row};

/// Set for the runs of a cohort: they end when the cohort is killed.
pub const WITH_PARENT: &str = "LUMENMESH_ENDS_WITH_PARENT";
/// Time that an interrupted run gets before it is killed.
const GRACE: Duration = Duration::from_secs(6);

/// `lumenmesh batch CASES… -o DIR`
pub fn run(args: &BatchArgs) -> Result<u8, Failure> {
    console::catch_interrupt(2 * GRACE);
    if args.jobs == 0 {
        return Err(Failure::usage("--jobs 0: give at least 1"));
    }
    if args.memory.is_some_and(|m| !m.is_finite() || m <= 0.0) {
        return Err(Failure::usage("--memory: give the GiB that all runs together may take, such as --memory 12"));
    }
    let jobs = jobs::list(args)?;
    let folder = Folder::open(&args.output, args.keep)?;
    let rows = if args.collect { jobs.iter().map(|j| collected(j, args)).collect() } else { run_all(&jobs, args, &folder)? };
    write(rows, args, &folder)
}

/// Runs what is not there yet.
fn run_all(jobs: &[Job], args: &BatchArgs, folder: &Folder) -> Result<Vec<Row>, Failure> {
    let total = args.threads.unwrap_or_else(|| thread::available_parallelism().map_or(1, usize::from));
    let threads = (total / args.jobs).max(1);
    let room = Room::new(args.memory);
    let queue = Mutex::new(jobs.iter().enumerate().collect::<VecDeque<_>>());
    let rows = Mutex::new(Vec::new());
    let start = Instant::now();
    thread::scope(|scope| {
        for _ in 0..args.jobs.min(jobs.len()) {
            scope.spawn(|| {
                while !CANCELLED.load(Ordering::Relaxed) {
                    let Some((n, job)) = queue.lock().ok().and_then(|mut q| q.pop_front()) else { return };
                    let row = run_one(job, args, threads, &room, folder)
                        .unwrap_or_else(|e| Row::failed(&job.name, i32::from(e.code()), e.message()));
                    if CANCELLED.load(Ordering::Relaxed) {
                        return;
                    }
                    if let Ok(mut rows) = rows.lock() {
                        let seconds = start.elapsed().as_secs_f64();
                        eprintln!("[{:>3}/{}] {:>6.0} s  {:<28} {}", rows.len() + 1, jobs.len(), seconds, job.name, row.line());
                        rows.push((n, row));
                    }
                }
            });
        }
    });
    if CANCELLED.load(Ordering::Relaxed) {
        return Err(Failure::new(exit::INTERRUPTED, anyhow::anyhow!("interrupted; run the same command again to go on where it stopped")));
    }
    let mut rows = rows.into_inner().unwrap_or_default();
    rows.sort_by_key(|(n, _)| *n);
    Ok(rows.into_iter().map(|(_, r)| r).collect())
}

fn run_one(job: &Job, args: &BatchArgs, threads: usize, room: &Room, folder: &Folder) -> Result<Row, Failure> {
    let dir = args.output.join(&job.name);
    let log = format!("{}.log", job.name);
    let work = match jobs::prepare(job) {
        Ok(work) => work,
        Err(e) => {
            folder.put(&log, e.message().as_bytes())?;
            return Err(e);
        }
    };
    if Manifest::read(&dir).ok().flatten().is_some_and(|m| m.case.as_ref() == Some(&work.mark))
        && let Some(row) = finished(job, &dir, true)
    {
        return Ok(row);
    }
    let _place = room.take(work.memory);
    let program = std::env::current_exe().map_err(|e| Failure::new(exit::ENGINE, e))?;
    let mut command = Command::new(program);
    command.arg(if job.yaml { "run" } else { "mesh" }).arg(&job.input).arg("-o").arg(&dir).arg("--quiet");
    command.arg("--threads").arg(threads.to_string()).env(WITH_PARENT, "1");
    if args.keep {
        command.arg("--keep");
    }
    for set in &job.set {
        command.arg("--set").arg(set);
    }
    let child = command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| Failure::new(exit::ENGINE, anyhow::anyhow!("cannot start a run: {e}")))?;
    let (status, message) = watch(child)?;
    let code = status.code().unwrap_or(-1);
    if matches!(code, 0 | 6)
        && let Some(row) = finished(job, &dir, false)
    {
        folder.remove(&log)?;
        // Where earlier results went is told, although all is well.
        for line in message.lines().filter(|l| l.starts_with("warning: ") || l.starts_with("note: ")) {
            eprintln!("{}: {line}", job.name);
        }
        return Ok(row);
    }
    let message = match message.trim() {
        "" => format!("the run ended without a word ({status}): run it by itself to see more"),
        m => m.to_string(),
    };
    folder.put(&log, message.as_bytes())?;
    Ok(Row::failed(&job.name, code, message))
}

/// Waits for a run; passes an interruption on, and kills what does not end then.
fn watch(mut child: Child) -> Result<(ExitStatus, String), Failure> {
    let failed = |e| Failure::new(exit::ENGINE, anyhow::anyhow!("cannot wait for a run: {e}"));
    let mut errors = child.stderr.take();
    thread::scope(|scope| {
        let text = scope.spawn(move || {
            let mut bytes = Vec::new();
            let _ = errors.as_mut().map(|e| e.read_to_end(&mut bytes));
            String::from_utf8_lossy(&bytes).into_owned()
        });
        let mut told: Option<Instant> = None;
        let status = loop {
            if let Some(status) = child.try_wait().map_err(failed)? {
                break status;
            }
            if CANCELLED.load(Ordering::Relaxed) {
                match told {
                    None => {
                        terminate(&child);
                        told = Some(Instant::now());
                    }
                    Some(since) if since.elapsed() > GRACE => {
                        let _ = child.kill();
                    }
                    Some(_) => {}
                }
            }
            thread::sleep(Duration::from_millis(30));
        };
        Ok((status, text.join().unwrap_or_default()))
    })
}

fn terminate(child: &Child) {
    let id = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw);
    if let Some(id) = id {
        let _ = rustix::process::kill_process(id, rustix::process::Signal::TERM);
    }
}

/// The row of a case whose results are there.
fn finished(job: &Job, dir: &Path, kept: bool) -> Option<Row> {
    let report: Value = serde_json::from_str(&std::fs::read_to_string(dir.join("report.json")).ok()?).ok()?;
    Some(Row::from_report(&job.name, &report, kept).with_picture(std::fs::read(dir.join("thumbnail.png")).ok()))
}

/// The row of a case that something else ran: its folder, or `NAME.exit` and `NAME.log` beside it.
fn collected(job: &Job, args: &BatchArgs) -> Row {
    let beside = |ending: &str| std::fs::read_to_string(args.output.join(format!("{}.{ending}", job.name)));
    let code = beside("exit").ok().and_then(|c| c.trim().parse::<i32>().ok());
    // Earlier results stay in the folder where a later run failed.
    let failed = code.is_some_and(|c| c != 0 && c != 6);
    if !failed && let Some(row) = finished(job, &args.output.join(&job.name), true) {
        return row;
    }
    let message = beside("log").unwrap_or_default();
    let error = message.lines().skip_while(|l| !l.starts_with("error: ")).collect::<Vec<_>>().join("\n");
    let message = match (error.is_empty(), code) {
        (false, _) => error,
        (true, Some(c)) => format!("the run ended with code {c}"),
        (true, None) => "there are no results: run it first".into(),
    };
    Row::failed(&job.name, code.unwrap_or(-1), message)
}

/// Writes cohort.csv and cohort.html; the exit code is that of the worst case.
fn write(mut rows: Vec<Row>, args: &BatchArgs, folder: &Folder) -> Result<u8, Failure> {
    cohort::sort_worst_first(&mut rows);
    folder.put("cohort.csv", cohort::csv(&rows).as_bytes())?;
    folder.put("cohort.html", cohort::html(&rows).as_bytes())?;
    let worst = rows.iter().map(|r| r.code).find(|c| *c != 0);
    say!("{}; open {}", cohort::verdict(&rows), args.output.join("cohort.html").display());
    Ok(worst.map_or(0, |c| u8::try_from(c).unwrap_or(1)))
}
