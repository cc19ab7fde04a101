//! Names of the case held against the openings that there are, before anything is meshed.

use super::error::Error;
use crate::config::Case;
use crate::mesh::regions::RegionError;
use crate::openings::{ExtendError, Opening};

/// Every opening that extensions and flow name is there, and no part of the wall bears an opening's name.
pub(super) fn check(case: &Case, found: &[Opening]) -> Result<(), Error> {
    if let Some(name) = case.extensions.openings.keys().find(|k| found.iter().all(|o| o.name != **k)) {
        let known = found.iter().map(|o| o.name.as_str()).collect::<Vec<_>>().join(", ");
        return Err(ExtendError::Unknown { name: name.clone(), known }.into());
    }
    if let Some(patch) = case.surface.patches.iter().find(|p| found.iter().any(|o| o.name == p.name)) {
        return Err(RegionError::SameName(patch.name.clone()).into());
    }
    let names: Vec<_> = found.iter().map(|o| (o.name.as_str(), o.kind)).collect();
    Ok(super::options::flow(case, None).fits(&names)?)
}
