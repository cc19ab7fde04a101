//! Case files: YAML as written, its schema, its errors.

mod case;
mod explain;
mod flow;
mod length;
mod load;
mod openings;
mod reference;

pub use case::*;
pub use flow::{Blood, Flow, InletFlow, OutletFlow, Split, VelocityProfile, Viscosity};
pub use length::{AutoLength, Length, LengthError, Unit};
pub use load::{ConfigError, from_text, line_of_opening, load, to_yaml};
pub use openings::{Detect, OpeningKind, OpeningPlane, OpeningsSection, Rename};
pub use reference::{reference_page, schema};
