//! What a person sees while a run goes on: a line a stage on a terminal, nothing when piped.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::pipeline::Progress;

/// Set by Ctrl-C; every run looks at it.
pub static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Lets Ctrl-C and a termination signal set [`CANCELLED`].
pub fn catch_interrupt() {
    // A second handler in the same process is no error: the first one stays.
    let _ = ctrlc::set_handler(|| CANCELLED.store(true, std::sync::atomic::Ordering::Relaxed));
}

/// Progress on standard error.
pub struct Console {
    bar: Mutex<Option<ProgressBar>>,
    terminal: bool,
    verbose: bool,
}

impl Console {
    /// Progress for a person, unless `quiet`.
    pub fn new(quiet: bool, verbose: bool) -> Console {
        Console { bar: Mutex::new(None), terminal: !quiet && std::io::stderr().is_terminal(), verbose: verbose && !quiet }
    }

    fn finish(&self) {
        if let Some(bar) = self.bar.lock().ok().and_then(|mut b| b.take()) {
            bar.finish_and_clear();
        }
    }
}

impl Progress for Console {
    fn begin(&self, stage: &str) {
        if !self.terminal {
            return;
        }
        self.finish();
        let bar = ProgressBar::new_spinner();
        bar.set_style(ProgressStyle::with_template("{spinner} {msg} {elapsed}").unwrap_or_else(|_| ProgressStyle::default_spinner()));
        bar.set_message(stage.to_string());
        bar.enable_steady_tick(Duration::from_millis(120));
        if let Ok(mut slot) = self.bar.lock() {
            *slot = Some(bar);
        }
    }

    fn end(&self, stage: &str, seconds: f64, result: &str) {
        self.finish();
        if self.terminal || self.verbose {
            eprintln!("{stage:<16}{seconds:>8.2} s  {result}");
        }
    }

    fn explain(&self, text: &str) {
        if self.verbose {
            eprintln!("    {text}");
        }
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        self.finish();
    }
}
