//! The command line: arguments, exit codes, progress, output folders.

/// Prints a line on standard output; a reader that has gone (`| head`) is no error.
macro_rules! say {
    ($($text:tt)*) => {{
        let _ = std::io::Write::write_fmt(&mut std::io::stdout().lock(), format_args!("{}\n", format_args!($($text)*)));
    }};
}

mod args;
mod batch;
mod check;
mod console;
mod convergence;
mod exit;
mod init;
mod kind;
mod mark;
mod output;
mod phantom;
mod run;
pub mod slicer;
mod summary;
mod text;

use std::process::ExitCode;

use clap::Parser;

pub use args::{Cli, Command};
pub use exit::Failure;

/// Parses the arguments and runs the command; the exit code is as in the contract.
pub fn main() -> ExitCode {
    if let Some(code) = worker() {
        return code;
    }
    if std::env::var_os(batch::WITH_PARENT).is_some() {
        end_with_parent();
    }
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => {
            let _ = e.print();
            return ExitCode::from(if e.use_stderr() { exit::USAGE } else { 0 });
        }
    };
    match run(&cli) {
        Ok(code) => ExitCode::from(code),
        Err(e) => {
            if !e.message().is_empty() {
                eprintln!("error: {}", e.message());
            }
            ExitCode::from(e.code())
        }
    }
}

/// Serves as the volume engine's worker where this process was started as that: the worker is this binary too, it talks
/// over its pipes and takes no arguments of ours.
fn worker() -> Option<ExitCode> {
    (std::env::args().nth(1).as_deref() == Some(crate::volume::worker::ARGUMENT))
        .then(|| ExitCode::from(u8::try_from(crate::volume::worker::serve()).unwrap_or(1)))
}

/// Has the system interrupt this process when its parent ends, so that no work goes on that nobody waits for.
fn end_with_parent() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM));
}

/// Runs a parsed command and gives its exit code.
pub fn run(cli: &Cli) -> Result<u8, Failure> {
    match &cli.command {
        Command::Run(a) => run::run(a),
        Command::Mesh(a) => run::mesh(a),
        Command::Check(a) => check::run(a),
        Command::Convergence(a) => convergence::run(a),
        Command::Phantom(a) => phantom::run(a),
        Command::Batch(a) => batch::run(a),
        Command::Init(a) => init::run(a),
        Command::Validate(a) => text::validate(a),
        Command::Schema => text::schema(),
        Command::Reference => text::reference(),
        Command::Completions { shell } => text::completions(*shell),
        Command::Man { output, force } => text::man(output.as_deref(), *force),
    }
}
