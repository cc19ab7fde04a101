//! The command line: arguments, exit codes, progress, output folders.

mod args;
mod batch;
mod check;
mod console;
mod exit;
mod output;
mod phantom;
mod run;
mod text;

use std::process::ExitCode;

use clap::Parser;

pub use args::{Cli, Command};
pub use exit::Failure;

/// Parses the arguments and runs the command; the exit code is as in the contract.
pub fn main() -> ExitCode {
    // The volume engine's worker is this binary too; it talks over its pipes and takes no arguments of ours.
    if std::env::args().nth(1).as_deref() == Some(crate::volume::worker::ARGUMENT) {
        let code = crate::volume::worker::serve();
        return ExitCode::from(u8::try_from(code).unwrap_or(1));
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

/// Runs a parsed command and gives its exit code.
pub fn run(cli: &Cli) -> Result<u8, Failure> {
    match &cli.command {
        Command::Run(a) => run::run(a),
        Command::Mesh(a) => run::mesh(a),
        Command::Check(a) => check::run(a),
        Command::Phantom(a) => phantom::run(a),
        Command::Batch(a) => batch::run(a),
        Command::Validate(a) => text::validate(a),
        Command::Schema => text::schema(),
        Command::Reference => text::reference(),
        Command::Completions { shell } => text::completions(*shell),
        Command::Man => text::man(),
    }
}
