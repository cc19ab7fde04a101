//! TetGen in a process of its own: it may crash, hang or eat the memory without harm.
//!
//! The worker is this same program with the argument [`ARGUMENT`]; [`serve`] is all it does then.
//! Request and answer go over its standard input and output. The parent keeps the worker's standard
//! input open while it waits: when the parent dies, the worker sees the end of input and ends too.

use std::io::{BufReader, BufWriter, Read};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use serde::Serialize;
use tetgen_sys::{Failure, Input, Output, Stage};

use super::protocol::{Answer, Request};

/// The hidden subcommand that makes the program a worker.
pub const ARGUMENT: &str = "tetgen-worker";

/// Where the worker is found and what it may use.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorkerOptions {
    /// The program that calls [`serve`] when its first argument is [`ARGUMENT`]; by default the running one.
    pub executable: Option<PathBuf>,
    /// Wall-clock time of one attempt, seconds. Only fails, never changes a mesh.
    pub time_limit: f64,
    /// Address space of the worker, bytes.
    pub memory_limit: u64,
    /// Points that TetGen may add in one attempt; by default four for each given one, and at least 100,000.
    pub steiner_budget: Option<u64>,
}

impl Default for WorkerOptions {
    fn default() -> Self {
        WorkerOptions { executable: None, time_limit: 1800.0, memory_limit: 16 << 30, steiner_budget: None }
    }
}

/// Why a worker brought no mesh.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The program could not be started.
    #[error("the TetGen worker {path} could not be started: {source}; give the path of the lumenmesh program")]
    Start {
        /// What was tried.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// TetGen said no.
    #[error("TetGen failed during {stage}: {failure}{said}")]
    Failed {
        /// Where it was.
        stage: String,
        /// Its reason.
        failure: Failure,
        /// What it printed, empty or starting with a separator.
        said: String,
    },
    /// The process ended without an answer.
    #[error("TetGen crashed during {stage} ({how}){said}")]
    Crashed {
        /// Where it was.
        stage: String,
        /// Signal or exit code.
        how: String,
        /// What it printed, empty or starting with a separator.
        said: String,
    },
    /// Killed at the time limit.
    #[error("TetGen was stopped during {stage} after {seconds:.0} s, its time limit")]
    TimeLimit {
        /// Where it was.
        stage: String,
        /// The limit.
        seconds: f64,
    },
    /// Killed on request.
    #[error("cancelled")]
    Cancelled,
}

/// The worker's side: reads one request from standard input, runs TetGen, writes the answer. Gives the exit code.
///
/// Changes the process for good (memory limit, standard output): call it only from a `main` that then exits.
pub fn serve() -> i32 {
    // What TetGen prints must not mix with the answer: keep the pipe, send descriptor 1 to 2.
    use std::os::fd::AsFd;
    let Ok(pipe) = std::io::stdout().as_fd().try_clone_to_owned() else { return 2 };
    if !tetgen_sys::stdout_to_stderr() {
        return 2;
    }
    let mut stdin = BufReader::new(std::io::stdin());
    let request = Request::read(&mut stdin, |bytes| {
        if bytes > 0 {
            tetgen_sys::limit_memory(bytes);
        }
    });
    let request = match request {
        Ok(r) => r,
        Err(e) => {
            eprintln!("{ARGUMENT}: {e}; this subcommand is called by lumenmesh itself");
            return 2;
        }
    };
    std::thread::spawn(move || {
        let mut byte = [0];
        while matches!(stdin.read(&mut byte), Ok(n) if n > 0) {}
        std::process::exit(3);
    });
    let mut out = BufWriter::new(std::fs::File::from(pipe));
    let result = tetgen_sys::tetrahedralize(&request.input, &request.switches, |stage| {
        // The other side may be gone; the reading thread sees to that.
        let _ = Answer::Stage(stage).write(&mut out);
    });
    let answer = match result {
        Ok(mesh) => Answer::Mesh(mesh),
        Err(f) => Answer::Failed(f.code()),
    };
    if answer.write(&mut out).is_err() { 3 } else { 0 }
}

/// A child that is killed and reaped whatever happens.
struct Guard(Child);

impl Drop for Guard {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs TetGen on `input` with `switches` in a worker. `cancel` is looked at every few milliseconds.
pub(super) fn run(
    input: Input,
    switches: &str,
    options: &WorkerOptions,
    cancel: Option<&AtomicBool>,
) -> Result<Output, WorkerError> {
    let path = match &options.executable {
        Some(p) => p.clone(),
        None => std::env::current_exe()
            .map_err(|source| WorkerError::Start { path: "(the running program)".into(), source })?,
    };
    let start_error = |source| WorkerError::Start { path: path.clone(), source };
    let mut child = Command::new(&path)
        .arg(ARGUMENT)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(start_error)?;
    let missing = || start_error(std::io::Error::other("no pipe"));
    let stdin = child.stdin.take().ok_or_else(missing)?;
    let stdout = child.stdout.take().ok_or_else(missing)?;
    let stderr = child.stderr.take().ok_or_else(missing)?;
    let mut guard = Guard(child);

    let request = Request { memory: options.memory_limit, switches: switches.into(), input };
    let writer = std::thread::spawn(move || {
        // A worker that dies early closes the pipe: its exit says more than this error.
        let mut w = BufWriter::new(stdin);
        let _ = request.write(&mut w);
        w.into_inner().ok()
    });
    let printed = std::thread::spawn(move || {
        let mut text = Vec::new();
        let mut stderr = stderr;
        let mut buffer = [0; 4096];
        while let Ok(n) = stderr.read(&mut buffer) {
            if n == 0 {
                break;
            }
            if text.len() < 16 << 10 {
                text.extend_from_slice(&buffer[..n]);
            }
        }
        String::from_utf8_lossy(&text).trim().to_string()
    });
    let (send, receive) = channel();
    let reader = std::thread::spawn(move || {
        let mut r = BufReader::with_capacity(1 << 16, stdout);
        while let Ok(Some(a)) = Answer::read(&mut r) {
            if send.send(a).is_err() {
                break;
            }
        }
    });

    let begin = Instant::now();
    let mut stage: Option<Stage> = None;
    let mut result: Option<Result<Output, i32>> = None;
    let name = |s: Option<Stage>| s.map_or("start".to_string(), |s| s.name().to_string());
    let ended_by = loop {
        if cancel.is_some_and(|c| c.load(Ordering::Relaxed)) {
            break Some(WorkerError::Cancelled);
        }
        if begin.elapsed().as_secs_f64() > options.time_limit {
            break Some(WorkerError::TimeLimit { stage: name(stage), seconds: options.time_limit });
        }
        match receive.recv_timeout(Duration::from_millis(20)) {
            Ok(Answer::Stage(s)) => stage = Some(s),
            Ok(Answer::Failed(code)) => result = Some(Err(code)),
            Ok(Answer::Mesh(m)) => result = Some(Ok(m)),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break None,
        }
        if result.is_some() {
            break None;
        }
    };
    let status = if ended_by.is_none() && result.is_none() {
        // Its output is closed: give it a moment to die by itself, so that its own status can be told.
        let patience = Instant::now();
        let mut status = None;
        while status.is_none() && patience.elapsed() < Duration::from_secs(5) {
            status = guard.0.try_wait().ok().flatten();
            std::thread::sleep(Duration::from_millis(2));
        }
        status
    } else {
        None
    };
    drop(guard);
    // Ctrl-C on a terminal reaches the worker too, and may end it before the flag is seen here.
    let asked = || cancel.is_some_and(|c| c.load(Ordering::Relaxed));
    let ended_by = ended_by.or_else(|| (result.is_none() && (interrupted(status) || asked())).then_some(WorkerError::Cancelled));
    if let Some(e) = ended_by {
        // The threads end with the pipes; something the worker started may hold those open a while longer.
        return Err(e);
    }
    let _ = writer.join();
    let _ = reader.join();
    let said = printed.join().unwrap_or_default();
    let said = if said.is_empty() { said } else { format!("; it said: {}", last_lines(&said)) };
    match result {
        Some(Ok(m)) => Ok(m),
        Some(Err(code)) => {
            Err(WorkerError::Failed { stage: name(stage), failure: Failure::from_code(code), said })
        }
        None => Err(WorkerError::Crashed {
            stage: name(stage),
            how: status.map_or("no exit status".into(), |s| s.to_string()),
            said,
        }),
    }
}

/// Whether a person's Ctrl-C ended a process.
fn interrupted(status: Option<std::process::ExitStatus>) -> bool {
    use std::os::unix::process::ExitStatusExt;
    const SIGINT: i32 = 2;
    status.and_then(|s| s.signal()) == Some(SIGINT)
}

/// The last few lines on one line.
fn last_lines(text: &str) -> String {
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|l| !l.is_empty()).collect();
    lines[lines.len().saturating_sub(3)..].join(" | ")
}
