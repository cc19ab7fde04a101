//! What a person sees while a run goes on: a line a stage, on a terminal with the time that is left.

use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

use super::exit::INTERRUPTED;
use super::output;
use crate::pipeline::Progress;

/// Set by Ctrl-C; every run looks at it.
pub static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Time after which a run that has not stopped by itself is ended.
pub const PATIENCE: Duration = Duration::from_secs(2);

/// Lets Ctrl-C and a termination signal set [`CANCELLED`]. A stage that does not look at it within `patience`, or a
/// second signal, ends the process; what is half-written goes first.
pub fn catch_interrupt(patience: Duration) {
    // A second handler in the same process is no error: the first one stays.
    let _ = ctrlc::set_handler(move || {
        if CANCELLED.swap(true, Ordering::Relaxed) {
            end();
        }
        thread::spawn(move || {
            thread::sleep(patience);
            end();
        });
    });
}

fn end() -> ! {
    let _no_more_results = output::remove_unfinished();
    eprintln!("error: {}", crate::pipeline::Error::Interrupted);
    std::process::exit(i32::from(INTERRUPTED))
}

/// Shares of the stages in the time of a whole run, in per cent, taken from runs on shared masks; they only serve to
/// guess how long it still takes.
const SHARES: [(&str, f64); 12] = [
    ("read", 1.0),
    ("clean", 1.0),
    ("reconstruct", 15.0),
    ("polygonize", 4.0),
    ("centerlines", 2.0),
    ("guidance field", 5.0),
    ("remesh", 18.0),
    ("openings", 4.0),
    ("quality", 1.0),
    ("fidelity", 8.0),
    ("volume", 38.0),
    ("volume quality", 3.0),
];

/// Progress on standard error.
pub struct Console {
    bar: Mutex<Option<ProgressBar>>,
    /// Seconds and shares of the stages that are done.
    done: Mutex<(f64, f64)>,
    terminal: bool,
    quiet: bool,
    verbose: bool,
}

impl Console {
    /// Progress for a person, unless `quiet`.
    pub fn new(quiet: bool, verbose: bool) -> Console {
        Console {
            bar: Mutex::new(None),
            done: Mutex::new((0.0, 0.0)),
            terminal: !quiet && std::io::stderr().is_terminal(),
            quiet,
            verbose: verbose && !quiet,
        }
    }

    fn finish(&self) {
        if let Some(bar) = self.bar.lock().ok().and_then(|mut b| b.take()) {
            bar.finish_and_clear();
        }
    }
}

/// Share of a stage in the whole work, per cent.
pub fn share(stage: &str) -> f64 {
    SHARES.iter().find(|(name, _)| *name == stage).map_or(1.0, |(_, s)| *s)
}

/// Seconds that are left where `seconds` went to `share` per cent of the work; `None` while there is too little to tell.
fn left(seconds: f64, share: f64) -> Option<f64> {
    (share >= 10.0 && seconds >= 2.0).then(|| seconds * (100.0 / share - 1.0).max(0.0))
}

/// `about 40 s left`, in round numbers.
fn in_words(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => "almost done".into(),
        s if s < 20.0 => format!("about {s:.0} s left"),
        s if s < 90.0 => format!("about {:.0} s left", (s / 10.0).round() * 10.0),
        s => format!("about {:.0} min left", s / 60.0),
    }
}

impl Progress for Console {
    fn begin(&self, stage: &str) {
        if !self.terminal {
            return;
        }
        self.finish();
        let (seconds, done) = self.done.lock().map_or((0.0, 0.0), |d| *d);
        let (start, guess, total) = (Instant::now(), left(seconds, done), done + share(stage));
        let remaining = move |_: &ProgressState, out: &mut dyn Write| {
            let now = start.elapsed().as_secs_f64();
            // Within the stage the guess runs down, and stands still where the stage takes longer than guessed.
            let least = (seconds + now) * (100.0 / total - 1.0).max(0.0);
            if let Some(g) = guess {
                let _ = write!(out, "{}", in_words((g - now).max(least.min(g))));
            }
        };
        let bar = ProgressBar::new_spinner();
        let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}  {left}").unwrap_or_else(|_| ProgressStyle::default_spinner());
        bar.set_style(style.with_key("left", remaining));
        bar.set_message(stage.to_string());
        bar.enable_steady_tick(Duration::from_millis(120));
        if let Ok(mut slot) = self.bar.lock() {
            *slot = Some(bar);
        }
    }

    fn end(&self, stage: &str, seconds: f64, result: &str) {
        self.finish();
        if let Ok(mut done) = self.done.lock() {
            *done = (done.0 + seconds, (done.1 + share(stage)).min(100.0));
        }
        if !self.quiet {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_told_once_there_is_something_to_judge_by() {
        assert_eq!(left(0.5, 50.0), None);
        assert_eq!(left(30.0, 3.0), None);
        assert_eq!(left(30.0, 50.0), Some(30.0));
        assert_eq!(left(30.0, 100.0), Some(0.0));
        assert_eq!(in_words(47.0), "about 50 s left");
        assert_eq!(in_words(150.0), "about 2 min left");
    }
}
