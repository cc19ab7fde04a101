//! Debian's OpenFOAM, where it is installed.

use std::path::Path;
use std::process::Command;

/// Runs a tool in a case; `None`, said aloud, where it is not installed.
pub fn run(case: &Path, tool: &str, arguments: &[&str]) -> Option<(bool, String)> {
    let root = std::env::var("WM_PROJECT_DIR").unwrap_or_else(|_| "/usr/share/openfoam".into());
    let output = Command::new(tool).args(arguments).current_dir(case).env("WM_PROJECT_DIR", root).output();
    match output {
        Ok(o) => Some((o.status.success(), String::from_utf8_lossy(&o.stdout).into_owned() + &String::from_utf8_lossy(&o.stderr))),
        Err(_) => {
            eprintln!("SKIPPED: {tool} is not installed (Debian package openfoam)");
            None
        }
    }
}

/// What follows `key` in a log, up to white space, `,` or `)`.
pub fn printed<'a>(log: &'a str, key: &str) -> &'a str {
    let Some(at) = log.find(key) else { panic!("no {key:?} in the log:\n{log}") };
    let rest = log[at + key.len()..].trim_start();
    rest.split(|c: char| c.is_whitespace() || c == ',' || c == ')').next().unwrap_or("").trim_end_matches('.')
}

// Not every test that runs OpenFOAM compares digits.
#[allow(dead_code)]
/// Whether `value` prints as `text` in six significant digits, C++'s default.
pub fn same_digits(value: f64, text: &str) -> bool {
    let Ok(x) = text.parse::<f64>() else { return false };
    if x == 0.0 {
        return value.abs() < 1e-300;
    }
    // Half a unit in the last of six digits, and one part in 1e9 for the order of summation.
    let unit = 10f64.powi(x.abs().log10().floor() as i32 - 5);
    (value - x).abs() <= 0.5 * unit * (1.0 + 1e-6) + 1e-9 * x.abs()
}
