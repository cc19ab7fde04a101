//! The flow that a mesh is made for: how much enters and leaves where, and with what fluid.
//!
//! A room of its own because both solvers' files and the report's hand-over sheet need it. SI units here, lengths of
//! patches in millimetres as everywhere.

mod profile;

use serde::Serialize;

pub use profile::poisson_profile;

use crate::geometry::{Point, Vector};
use crate::mesh::faces::FaceMesh;
use crate::mesh::{PatchId, PatchKind};
use crate::quality::face_geometry;

/// Flow that enters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Inflow {
    /// Reynolds number of mean velocity and hydraulic diameter, at every inlet.
    Reynolds(f64),
    /// Flow rate of all inlets together, m³/s, shared by area.
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
    /// By the cube of the hydraulic diameter (Murray's law).
    #[default]
    Murray,
    /// By area.
    Area,
    /// Shares in the order of the patch ids; they must add up to 1.
    Fractions(Vec<f64>),
    /// Pressure = resistance · flow, Pa s/m³, in the order of the patch ids; the solver finds the flow.
    Resistance(Vec<f64>),
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

/// Flow rate over one heart beat.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Waveform {
    /// Time, s; the first is the start, the last the end of the period.
    pub times: Vec<f64>,
    /// Flow rate of all inlets together, m³/s.
    pub flow: Vec<f64>,
}

impl Waveform {
    /// Reads `time (s), flow rate (ml/s)` rows; `#` starts a comment, one heading line is allowed.
    ///
    /// # Errors
    /// A line that is no pair of numbers, times that do not rise, fewer than two rows.
    pub fn parse_csv(text: &str) -> Result<Waveform, FlowError> {
        let (mut times, mut flow) = (Vec::new(), Vec::new());
        let mut heading = false;
        for (k, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() {
                continue;
            }
            let fields: Vec<Option<f64>> = line
                .split([',', ';', '\t'])
                .map(|f| f.trim().parse().ok().filter(|x: &f64| x.is_finite()))
                .collect();
            match fields[..] {
                [Some(t), Some(q)] => {
                    if times.last().is_some_and(|&l| t <= l) {
                        return Err(FlowError::Waveform { line: k + 1, what: "the time does not rise" });
                    }
                    times.push(t);
                    flow.push(q * 1e-6);
                }
                _ if times.is_empty() && !heading => heading = true,
                _ => return Err(FlowError::Waveform { line: k + 1, what: "not a time and a flow rate" }),
            }
        }
        if times.len() < 2 {
            return Err(FlowError::Waveform { line: text.lines().count(), what: "fewer than two rows of numbers" });
        }
        Ok(Waveform { times, flow })
    }

    /// Length of the period, s.
    pub fn period(&self) -> f64 {
        self.times.last().unwrap_or(&0.0) - self.times.first().unwrap_or(&0.0)
    }

    /// Time mean, m³/s, by the trapezium rule.
    pub fn mean(&self) -> f64 {
        let area: f64 = (1..self.times.len())
            .map(|i| 0.5 * (self.flow[i] + self.flow[i - 1]) * (self.times[i] - self.times[i - 1]))
            .sum();
        area / self.period()
    }

    /// Largest magnitude, m³/s.
    pub fn peak(&self) -> f64 {
        self.flow.iter().fold(0.0, |m, q| q.abs().max(m))
    }
}

/// What flows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowOptions {
    /// Flow that enters; a waveform replaces it.
    pub inflow: Inflow,
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
    /// The number of values is not the number of outlets.
    #[error("{given} {what} are given for {outlets} outlets: give one for each, in the order of the patch ids")]
    Count {
        /// Fractions or resistances.
        what: &'static str,
        /// Number of values.
        given: usize,
        /// Number of outlets.
        outlets: usize,
    },
    /// Fractions that do not share one whole.
    #[error("the outlet fractions add up to {0}: they must be positive and add up to 1")]
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

/// One row of the hand-over sheet.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PatchFlow {
    /// Patch id.
    pub id: PatchId,
    /// Patch name.
    pub name: String,
    /// Inlet or outlet.
    pub kind: PatchKind,
    /// Area, mm².
    pub area: f64,
    /// Four times area by perimeter, mm.
    pub hydraulic_diameter: f64,
    /// Centroid, mm.
    pub center: Point,
    /// Unit normal, out of the vessel.
    pub normal: Vector,
    /// Mean flow rate, m³/s, positive in the patch's own direction; `None` where the solver finds it.
    pub flow: Option<f64>,
    /// Mean velocity, m/s.
    pub velocity: Option<f64>,
    /// Reynolds number of mean velocity and hydraulic diameter.
    pub reynolds: Option<f64>,
    /// Womersley number of the hydraulic radius, where pulsatile.
    pub womersley: Option<f64>,
}

/// Flow of every opening.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowPlan {
    /// Openings in the order of their patch ids.
    pub openings: Vec<PatchFlow>,
    /// Flow rate of all inlets, m³/s.
    pub total: f64,
    /// Kinematic viscosity behind the numbers, m²/s.
    pub nu: f64,
    /// What looks wrong: units, Reynolds numbers beyond laminar flow.
    pub warnings: Vec<String>,
}

impl FlowPlan {
    /// Measures the openings of a mesh in millimetres and shares the flow among them.
    ///
    /// # Errors
    /// See [`FlowError`].
    pub fn resolve(options: &FlowOptions, mesh: &impl FaceMesh) -> Result<FlowPlan, FlowError> {
        let mu = options.viscosity.reference();
        for (what, value) in [("the density", options.density), ("the viscosity", mu), ("the Courant number", options.max_courant)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(FlowError::NotPositive { what, value });
            }
        }
        let nu = mu / options.density;
        let mut openings: Vec<PatchFlow> = vec![];
        for p in mesh.patches().iter().filter(|p| p.patch.kind != PatchKind::Wall) {
            openings.push(measure(mesh, p.start..p.start + p.count, p)?);
        }
        let total = inflow(options, nu, &mut openings)?;
        share(options, total, &mut openings)?;
        let mut warnings = vec![];
        for o in &mut openings {
            let d = o.hydraulic_diameter * 1e-3;
            o.velocity = o.flow.map(|q| q / (o.area * 1e-6));
            o.reynolds = o.velocity.map(|v| v.abs() * d / nu);
            let omega = options.waveform.as_ref().map(|w| std::f64::consts::TAU / w.period());
            o.womersley = omega.map(|w| 0.5 * d * (w / nu).sqrt());
            if o.reynolds.is_some_and(|r| r > 2300.0) {
                warnings.push(format!("{}: Reynolds number {:.0} is beyond laminar flow", o.name, o.reynolds.unwrap_or(0.0)));
            }
            if o.velocity.is_some_and(|v| v > 5.0) {
                warnings.push(format!("{}: mean velocity {:.1} m/s: is the flow rate in ml/s?", o.name, o.velocity.unwrap_or(0.0)));
            }
            if !(0.2..=60.0).contains(&o.hydraulic_diameter) {
                warnings.push(format!("{}: diameter {:.3} mm: is the image's spacing in millimetres?", o.name, o.hydraulic_diameter));
            }
        }
        Ok(FlowPlan { openings, total, nu, warnings })
    }
}

/// Area, perimeter, centre and normal of a cap.
fn measure(
    mesh: &impl FaceMesh,
    faces: std::ops::Range<usize>,
    patch: &crate::mesh::faces::PatchRange,
) -> Result<PatchFlow, FlowError> {
    let (mut area, mut first) = (Vector::zeros(), Vector::zeros());
    let mut edges: Vec<(u32, u32)> = vec![];
    let mut sum = 0.0;
    for f in faces {
        let (c, s) = face_geometry(mesh.points(), mesh.face(f));
        area += s;
        sum += s.norm();
        first += s.norm() * c.coords;
        let v = mesh.face(f);
        edges.extend((0..v.len()).map(|i| (v[i], v[(i + 1) % v.len()])).map(|(a, b)| (a.min(b), a.max(b))));
    }
    if !(sum > 0.0 && area.norm() > 0.0) {
        return Err(FlowError::Empty(patch.patch.name.clone()));
    }
    edges.sort_unstable();
    let perimeter: f64 = edges
        .chunk_by(|a, b| a == b)
        .filter(|e| e.len() == 1)
        .map(|e| (mesh.points()[e[0].0 as usize] - mesh.points()[e[0].1 as usize]).norm())
        .sum();
    let p = &patch.patch;
    Ok(PatchFlow {
        id: p.id,
        name: p.name.clone(),
        kind: p.kind,
        area: area.norm(),
        hydraulic_diameter: 4.0 * area.norm() / perimeter,
        center: Point::from(first / sum),
        normal: area.normalize(),
        flow: None,
        velocity: None,
        reynolds: None,
        womersley: None,
    })
}

fn inflow(options: &FlowOptions, nu: f64, openings: &mut [PatchFlow]) -> Result<f64, FlowError> {
    let all: f64 = openings.iter().filter(|o| o.kind == PatchKind::Inlet).map(|o| o.area).sum();
    if all == 0.0 {
        return Err(FlowError::NoOpening("inlet"));
    }
    let given = match (&options.waveform, options.inflow) {
        (Some(w), _) => Inflow::FlowRate(w.mean()),
        (None, i) => i,
    };
    let (Inflow::Reynolds(value) | Inflow::FlowRate(value) | Inflow::Velocity(value)) = given;
    if !(value > 0.0 && value.is_finite()) {
        return Err(FlowError::NotPositive { what: "the flow at the inlet", value });
    }
    let mut total = 0.0;
    for o in openings.iter_mut().filter(|o| o.kind == PatchKind::Inlet) {
        let area = o.area * 1e-6;
        let q = match given {
            Inflow::Reynolds(re) => re * nu / (o.hydraulic_diameter * 1e-3) * area,
            Inflow::FlowRate(q) => q * o.area / all,
            Inflow::Velocity(v) => v * area,
        };
        o.flow = Some(q);
        total += q;
    }
    Ok(total)
}

fn share(options: &FlowOptions, total: f64, openings: &mut [PatchFlow]) -> Result<(), FlowError> {
    let mut outlets: Vec<&mut PatchFlow> = openings.iter_mut().filter(|o| o.kind == PatchKind::Outlet).collect();
    let n = outlets.len();
    if n == 0 {
        return Err(FlowError::NoOpening("outlet"));
    }
    let count = |what, given: usize| if given == n { Ok(()) } else { Err(FlowError::Count { what, given, outlets: n }) };
    let weights: Vec<f64> = match &options.split {
        OutletSplit::Murray => outlets.iter().map(|o| o.hydraulic_diameter.powi(3)).collect(),
        OutletSplit::Area => outlets.iter().map(|o| o.area).collect(),
        OutletSplit::Fractions(f) => {
            count("fractions", f.len())?;
            let sum: f64 = f.iter().sum();
            if !((sum - 1.0).abs() <= 1e-6) || f.iter().any(|&x| !(x > 0.0)) {
                return Err(FlowError::Fractions(sum));
            }
            f.clone()
        }
        OutletSplit::Resistance(r) => {
            count("resistances", r.len())?;
            return match r.iter().find(|&&x| !(x >= 0.0 && x.is_finite())) {
                Some(&value) => Err(FlowError::NotPositive { what: "an outlet's resistance", value }),
                None => Ok(()),
            };
        }
        OutletSplit::Pressure => return Ok(()),
    };
    let sum: f64 = weights.iter().sum();
    for (o, w) in outlets.iter_mut().zip(&weights) {
        o.flow = Some(total * w / sum);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_waveform_is_read_with_heading_and_comments_and_bad_rows_are_named() {
        let w = Waveform::parse_csv("t,Q\n# a comment\n0, 2\n0.5; 4\n1.0,2\n").unwrap();
        assert_eq!((w.period(), w.times.len()), (1.0, 3));
        assert!((w.mean() - 3e-6).abs() < 1e-18 && (w.peak() - 4e-6).abs() < 1e-18);
        assert!(matches!(Waveform::parse_csv("0,1\n0,2\n"), Err(FlowError::Waveform { line: 2, .. })));
        assert!(matches!(Waveform::parse_csv("0,1\n1,x\n"), Err(FlowError::Waveform { line: 2, .. })));
        assert!(Waveform::parse_csv("").is_err());
    }
}
