//! The flow that a mesh is made for: how much enters and leaves where, and with what fluid.
//!
//! A room of its own because both solvers' files and the report's hand-over sheet need it. SI units here, lengths of
//! patches in millimetres as everywhere.

mod plan;
mod profile;
mod shares;
mod waveform;

use serde::Serialize;

pub use plan::{Condition, FlowPlan, PatchFlow};
pub use profile::poisson_profile;
pub use shares::Shares;
pub use waveform::Waveform;

/// Flow that enters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Inflow {
    /// Reynolds number of mean velocity and hydraulic diameter, at every inlet.
    Reynolds(f64),
    /// Flow rate of all inlets together, m³/s; see [`FlowOptions::inlet_fractions`].
    FlowRate(f64),
    /// Mean velocity at every inlet, m/s.
    Velocity(f64),
}

/// Velocity profile at inlets.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// Developed laminar flow through a straight duct of the cap's own shape; a paraboloid on a circle.
    #[default]
    Parabolic,
    /// The same velocity everywhere; adds the pressure loss of the developing boundary layer.
    Flat,
}

/// How outlets share the flow.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutletSplit {
    /// By the cube of the hydraulic diameter of the section square to the axis (Murray's law).
    #[default]
    Murray,
    /// By area.
    Area,
    /// Shares of each vessel's flow; they must add up to 1.
    Fractions(Shares),
    /// Pressure = resistance · flow, Pa s/m³; the solver finds the flow.
    Resistance(Shares),
    /// Zero pressure at all outlets; the solver finds the flow.
    Pressure,
}

/// Viscosity of blood.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Viscosity {
    /// Constant dynamic viscosity, Pa s.
    Newtonian {
        /// Dynamic viscosity.
        mu: f64,
    },
    /// Casson: √μ = √μ∞ + √(τ₀/γ̇), bounded above.
    Casson {
        /// Viscosity at infinite shear rate, Pa s.
        mu_inf: f64,
        /// Yield stress, Pa.
        tau0: f64,
        /// Upper bound, Pa s.
        mu_max: f64,
    },
    /// Carreau: μ = μ∞ + (μ₀ − μ∞)(1 + (λγ̇)²)^((n−1)/2).
    Carreau {
        /// Viscosity at rest, Pa s.
        mu0: f64,
        /// Viscosity at infinite shear rate, Pa s.
        mu_inf: f64,
        /// Time constant λ, s.
        lambda: f64,
        /// Exponent n.
        n: f64,
    },
}

impl Viscosity {
    /// Human blood at 37 °C as a Casson fluid: 3.5 mPa s, yield stress 4 mPa (values used for arteries in CFD).
    pub const CASSON: Viscosity = Viscosity::Casson { mu_inf: 3.5e-3, tau0: 4e-3, mu_max: 0.1 };
    /// Human blood as a Carreau fluid (Cho and Kensey 1991): 56 and 3.45 mPa s, λ 3.313 s, n 0.3568.
    pub const CARREAU: Viscosity = Viscosity::Carreau { mu0: 0.056, mu_inf: 3.45e-3, lambda: 3.313, n: 0.3568 };

    /// The viscosity that Reynolds and Womersley numbers are built with, Pa s: at high shear rate.
    pub fn reference(&self) -> f64 {
        match *self {
            Viscosity::Newtonian { mu } => mu,
            Viscosity::Casson { mu_inf, .. } | Viscosity::Carreau { mu_inf, .. } => mu_inf,
        }
    }
}

/// What flows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowOptions {
    /// Flow that enters; a waveform replaces it.
    pub inflow: Inflow,
    /// Shares of the inlets in a flow rate; by area where `None`.
    pub inlet_fractions: Option<Shares>,
    /// Areas of the sections square to the vessels' axes by opening, mm²; where one is missing the cap's own is taken.
    pub square_areas: std::collections::BTreeMap<String, f64>,
    /// Velocity profile at inlets.
    pub profile: Profile,
    /// How outlets share the flow.
    pub split: OutletSplit,
    /// Viscosity.
    pub viscosity: Viscosity,
    /// Density, kg/m³.
    pub density: f64,
    /// Makes the case pulsatile.
    pub waveform: Option<Waveform>,
    /// Heart beats to run where pulsatile.
    pub cycles: u32,
    /// Largest Courant number where pulsatile.
    pub max_courant: f64,
    /// Parts for a parallel run.
    pub processes: u32,
}

impl Default for FlowOptions {
    /// Reynolds number 300, blood of 1060 kg/m³ and ν = 3.3e-6 m²/s.
    fn default() -> Self {
        FlowOptions {
            inflow: Inflow::Reynolds(300.0),
            inlet_fractions: None,
            square_areas: Default::default(),
            profile: Profile::Parabolic,
            split: OutletSplit::Murray,
            viscosity: Viscosity::Newtonian { mu: 3.498e-3 },
            density: 1060.0,
            waveform: None,
            cycles: 3,
            max_courant: 2.0,
            processes: 2,
        }
    }
}

/// Why no flow can be planned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlowError {
    /// Nothing enters or nothing leaves.
    #[error("the mesh has no {0}: flow needs at least one inlet and one outlet; give openings in the case file")]
    NoOpening(&'static str),
    /// The number of values is not the number of openings.
    #[error("{given} {what} are given for {openings} {kind}s: give one for each, in the order of the patch ids ({known})")]
    Count {
        /// Fractions or resistances.
        what: &'static str,
        /// Number of values.
        given: usize,
        /// Number of openings of that kind.
        openings: usize,
        /// Inlet or outlet.
        kind: &'static str,
        /// Their names.
        known: String,
    },
    /// A value for an opening that there is not.
    #[error("{what}: there is no {kind} `{name}`: there are {known}")]
    Unknown {
        /// Fractions or resistances.
        what: &'static str,
        /// Inlet or outlet.
        kind: &'static str,
        /// As given.
        name: String,
        /// Names of that kind.
        known: String,
    },
    /// An opening without a value.
    #[error("{what}: there is none for the {kind} `{name}`: give one for each")]
    Missing {
        /// Fractions or resistances.
        what: &'static str,
        /// Inlet or outlet.
        kind: &'static str,
        /// The opening.
        name: String,
    },
    /// Shares of inlets without a flow rate to share.
    #[error("fractions of the inlets share a flow rate, and none is given: give a flow rate or a waveform")]
    NothingToShare,
    /// Fractions that do not share one whole.
    #[error("the fractions of a vessel's outlets, or of all inlets, add up to {0}: they must be positive and add up to 1")]
    Fractions(f64),
    /// A number out of its range.
    #[error("{what} is {value}: it must be positive")]
    NotPositive {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A cap without area.
    #[error("patch {0} has no area: its opening cannot carry flow")]
    Empty(String),
    /// An unusable waveform.
    #[error("waveform, line {line}: {what}; rows are: time (s), flow rate (ml/s)")]
    Waveform {
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        what: &'static str,
    },
}

impl FlowError {
    /// Name of the opening at fault, as the case gives it.
    pub fn opening(&self) -> Option<&str> {
        match self {
            FlowError::Unknown { name, .. } => Some(name),
            _ => None,
        }
    }
}

#[cfg(test)]
pub(crate) mod testing {
    use crate::geometry::Point;
    use crate::mesh::{BoundaryFace, Patch, PatchKind, VolumeMesh};

    /// A cube of six tetrahedra with edges of `size` mm: inlet at x = 0, outlets at x = 1 and y = 1.
    pub fn cube(size: f64) -> VolumeMesh {
        let corner = |i: u32| Point::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * size;
        let tets = vec![[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];
        let mut m = VolumeMesh { points: (0..8).map(corner).collect(), tets, ..VolumeMesh::default() };
        let patch = |id, name: &str, kind| Patch { id, name: name.into(), kind };
        m.patches = vec![
            Patch::wall(),
            patch(2, "inlet", PatchKind::Inlet),
            patch(3, "outlet_1", PatchKind::Outlet),
            patch(4, "outlet_2", PatchKind::Outlet),
        ];
        let outer = m.outer_faces().expect("the cube conforms");
        let side = |v: &[u32; 4], bit: u32, on: u32| v.iter().all(|i| i >> bit & 1 == on);
        let of = |v: &[u32; 4]| if side(v, 0, 0) { 2 } else if side(v, 0, 1) { 3 } else if side(v, 1, 1) { 4 } else { 1 };
        m.boundary = outer.into_iter().map(|vertices| BoundaryFace { vertices, patch: of(&vertices) }).collect();
        m
    }
}
