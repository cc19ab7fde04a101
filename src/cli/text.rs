//! Commands that only print: schema, reference, completions, manual page, validation.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::CommandFactory;

use super::args::{Cli, ValidateArgs};
use super::exit::{Failure, USAGE};
use super::output::{self, Existing, Scratch};
use crate::config;

fn print(text: &[u8]) -> Result<u8, Failure> {
    // A closed pipe (`| head`) is no error.
    match std::io::stdout().lock().write_all(text) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::new(USAGE, e)),
        _ => Ok(0),
    }
}

/// `lumenmesh schema`
pub fn schema() -> Result<u8, Failure> {
    let text = serde_json::to_string_pretty(&config::schema()).map_err(|e| Failure::new(USAGE, e))?;
    print(format!("{text}\n").as_bytes())
}

/// `lumenmesh reference`
pub fn reference() -> Result<u8, Failure> {
    print(config::reference_page().as_bytes())
}

/// `lumenmesh completions SHELL`
pub fn completions(shell: clap_complete::Shell) -> Result<u8, Failure> {
    let mut out = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "lumenmesh", &mut out);
    print(&out)
}

/// `lumenmesh man`
pub fn man(folder: Option<&Path>, force: bool) -> Result<u8, Failure> {
    let Some(folder) = folder else {
        let mut out = Vec::new();
        clap_mangen::Man::new(Cli::command()).render(&mut out).map_err(|e| Failure::new(USAGE, e))?;
        return print(&out);
    };
    let scratch = Scratch::new("lumenmesh-man")?;
    let told = |e| output::failure(scratch.path(), "write the pages", &e);
    clap_mangen::generate_to(Cli::command(), scratch.path()).map_err(told)?;
    let mut pages = vec![];
    for entry in std::fs::read_dir(scratch.path()).map_err(told)? {
        let entry = entry.map_err(told)?;
        pages.push((folder.join(entry.file_name()), std::fs::read(entry.path()).map_err(told)?));
    }
    // All are looked at before one is written.
    let same = |(page, text): &(PathBuf, Vec<u8>)| std::fs::read(page).is_ok_and(|t| t == *text);
    pages.retain(|p| !same(p));
    if let Some((page, _)) = pages.iter().find(|(page, _)| page.exists() && !force) {
        return Err(output::exists(page, DIFFERS));
    }
    for (page, text) in &pages {
        output::place(page, text, if force { Existing::Replace } else { Existing::Refuse(DIFFERS) })?;
    }
    Ok(0)
}

/// The way out where another page is there.
const DIFFERS: &str = "replace it with --force";

/// `lumenmesh validate CASE.yaml`
pub fn validate(args: &ValidateArgs) -> Result<u8, Failure> {
    super::kind::is_case(&args.case)?;
    let case = config::load(&args.case, &args.set)?;
    let input = &case.input;
    for file in [&input.mask, &input.probability, &input.surface, &case.flow.waveform].into_iter().flatten() {
        if !file.is_file() {
            return Err(Failure::new(
                super::exit::INPUT,
                anyhow::anyhow!("{}: there is no such file: correct the path in {} (relative paths start at its folder)", file.display(), args.case.display()),
            ));
        }
    }
    print(format!("{}: valid\n", args.case.display()).as_bytes())
}
