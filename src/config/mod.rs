//! Case files: YAML as written, its schema, its errors.

mod case;
mod explain;
mod flow;
mod length;
mod load;
mod names;
mod openings;
mod place;
mod reference;

pub use case::*;
pub use flow::{Blood, Flow, InletFlow, OutletFlow, Shares, Split, VelocityProfile, Viscosity};
pub use length::{AutoLength, Length, LengthError, Unit};
pub use load::{ConfigError, from_text, load, to_yaml};
pub use openings::{CutDirection, Detect, InletNames, OpeningKind, OpeningPlane, OpeningsSection, Rename};
pub use place::{locate, place_of_opening};
pub use reference::{reference_page, schema};
