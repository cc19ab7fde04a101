//! Exit codes, in one place.

use crate::config::{self, ConfigError};
use crate::pipeline;

/// Usage or configuration.
pub const USAGE: u8 = 2;
/// Input unreadable or unusable.
pub const INPUT: u8 = 3;
/// Geometry or topology.
pub const GEOMETRY: u8 = 4;
/// Volume engine.
pub const ENGINE: u8 = 5;
/// A hard gate is missed; all files are kept.
pub const GATE: u8 = 6;
/// Interrupted.
pub const INTERRUPTED: u8 = 130;

/// A command that failed: what to print and the exit code.
#[derive(Debug)]
pub struct Failure {
    code: u8,
    error: anyhow::Error,
    opening: Option<String>,
    key: Option<&'static str>,
    place: Option<String>,
}

impl Failure {
    /// A failure with its exit code.
    pub fn new(code: u8, error: impl Into<anyhow::Error>) -> Failure {
        Failure { code, error: error.into(), opening: None, key: None, place: None }
    }

    /// A failure of usage or configuration.
    pub fn usage(message: impl std::fmt::Display) -> Failure {
        Failure::new(USAGE, anyhow::anyhow!("{message}"))
    }

    /// The exit code.
    pub fn code(&self) -> u8 {
        self.code
    }

    /// What, where and what to do.
    pub fn message(&self) -> String {
        // Every error here names its cause itself; the chain would say it twice.
        match &self.place {
            Some(place) => format!("{place}: {}", self.error),
            None => self.error.to_string(),
        }
    }

    /// The same with the place in the case file that has the opening at fault, where one is.
    #[must_use]
    pub fn in_case(mut self, file: &std::path::Path) -> Failure {
        let Ok(text) = std::fs::read_to_string(file) else { return self };
        let opening = self.opening.as_ref().and_then(|name| config::place_of_opening(&text, name));
        let at = opening.or_else(|| config::locate(&text, self.key?));
        self.place = at.map(|(line, column)| format!("{}:{line}:{column}", file.display()));
        self
    }
}

impl From<ConfigError> for Failure {
    fn from(e: ConfigError) -> Failure {
        let code = match e {
            ConfigError::Unreadable { .. } | ConfigError::Invalid { .. } => USAGE,
        };
        Failure::new(code, e)
    }
}

impl From<pipeline::Error> for Failure {
    fn from(e: pipeline::Error) -> Failure {
        let code = match e.kind() {
            pipeline::ErrorKind::Configuration => USAGE,
            pipeline::ErrorKind::Input => INPUT,
            pipeline::ErrorKind::Geometry => GEOMETRY,
            pipeline::ErrorKind::Engine => ENGINE,
            pipeline::ErrorKind::Interrupted => INTERRUPTED,
        };
        // Whichever stage it was that stopped, one sentence says so.
        let e = if e.kind() == pipeline::ErrorKind::Interrupted { pipeline::Error::Interrupted } else { e };
        let opening = e.opening().map(str::to_string);
        let key = e.key();
        Failure { opening, key, ..Failure::new(code, e) }
    }
}
