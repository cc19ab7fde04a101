//! Numbers given for openings, by name or in the order of their ids.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{FlowError, FlowOptions, OutletSplit};
use crate::mesh::PatchKind;

/// One number for each opening of a kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Shares {
    /// In the order of the patch ids.
    InOrder(Vec<f64>),
    /// By name.
    ByName(BTreeMap<String, f64>),
}

impl From<Vec<f64>> for Shares {
    fn from(list: Vec<f64>) -> Shares {
        Shares::InOrder(list)
    }
}

impl Shares {
    /// The number of every opening; 0 for those of another kind than `of`. `what` names the numbers in errors.
    pub(super) fn of(&self, what: &'static str, openings: &[(&str, PatchKind)], of: PatchKind) -> Result<Vec<f64>, FlowError> {
        let kind = if of == PatchKind::Inlet { "inlet" } else { "outlet" };
        let own: Vec<&str> = openings.iter().filter(|o| o.1 == of).map(|o| o.0).collect();
        let known = || if own.is_empty() { "none".to_string() } else { own.join(", ") };
        match self {
            Shares::InOrder(list) if list.len() != own.len() => {
                return Err(FlowError::Count { what, given: list.len(), openings: own.len(), kind, known: known() });
            }
            Shares::ByName(map) => {
                if let Some(name) = map.keys().find(|k| !own.contains(&k.as_str())) {
                    return Err(FlowError::Unknown { what, kind, name: name.clone(), known: known() });
                }
                if let Some(name) = own.iter().find(|n| !map.contains_key(**n)) {
                    return Err(FlowError::Missing { what, kind, name: (*name).into() });
                }
            }
            Shares::InOrder(_) => {}
        }
        let mut next = 0;
        let mut value = |&(name, k): &(&str, PatchKind)| {
            if k != of {
                return 0.0;
            }
            next += 1;
            match self {
                Shares::InOrder(list) => list[next - 1],
                Shares::ByName(map) => map.get(name).copied().unwrap_or(0.0),
            }
        };
        Ok(openings.iter().map(&mut value).collect())
    }
}

impl FlowOptions {
    /// Whether the numbers given for openings fit these openings, in the order of their ids.
    ///
    /// # Errors
    /// [`FlowError::Count`], [`FlowError::Unknown`] and [`FlowError::Missing`].
    pub fn fits(&self, openings: &[(&str, PatchKind)]) -> Result<(), FlowError> {
        if let Some(shares) = &self.inlet_fractions {
            shares.of("fractions", openings, PatchKind::Inlet)?;
        }
        match &self.split {
            OutletSplit::Fractions(shares) => shares.of("fractions", openings, PatchKind::Outlet).map(drop),
            OutletSplit::Resistance(shares) => shares.of("resistances", openings, PatchKind::Outlet).map(drop),
            _ => Ok(()),
        }
    }
}
