//! Who carries how much: the flow shared among the openings of a mesh.

use serde::Serialize;

use super::{FlowError, FlowOptions, Inflow, OutletSplit};
use crate::geometry::{Point, Vector};
use crate::mesh::faces::FaceMesh;
use crate::mesh::{PatchId, PatchKind};
use crate::quality::face_geometry;

/// What a solver holds at an opening.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// The flow rate that enters, with its profile.
    Inflow,
    /// The flow rate that leaves: nothing flows back.
    Outflow,
    /// Zero pressure; what flows back brings no momentum.
    Pressure,
    /// Pressure = this resistance (Pa s/m³) · flow; what flows back brings no momentum.
    Resistance(f64),
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
    /// What a solver holds here.
    pub condition: Condition,
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
        hold(options, &mut openings);
        let mut warnings = vec![];
        if let Some(w) = &options.waveform {
            let (first, last) = (w.flow[0], w.flow[w.flow.len() - 1]);
            if (first - last).abs() > 0.01 * w.peak() {
                warnings.push(format!(
                    "the waveform starts with {:.3} ml/s and ends with {:.3} ml/s: its last row is the start of the next beat, the flow jumps there",
                    first * 1e6,
                    last * 1e6
                ));
            }
        }
        for o in &mut openings {
            let d = o.hydraulic_diameter * 1e-3;
            o.velocity = o.flow.map(|q| q / (o.area * 1e-6));
            o.reynolds = o.velocity.map(|v| v.abs() * d / nu);
            let omega = options.waveform.as_ref().map(|w| std::f64::consts::TAU / w.period());
            o.womersley = omega.map(|w| 0.5 * d * (w / nu).sqrt());
            warnings.extend(doubts(o));
        }
        Ok(FlowPlan { openings, total, nu, warnings })
    }
}

/// Numbers of an opening that no vessel has: most often a wrong unit.
fn doubts(o: &PatchFlow) -> Vec<String> {
    let mut out = vec![];
    let d = o.hydraulic_diameter;
    if !PLAUSIBLE_DIAMETER.contains(&d) {
        let unit = if d > 60.0 { "um, or the voxel spacing is wrong" } else { "m or cm, or the voxel spacing is wrong" };
        out.push(format!("{}: a diameter of {d:.4} mm is no vessel's: is the unit of the input {unit}? see input.units", o.name));
    }
    if let (Some(re), Some(v)) = (o.reynolds, o.velocity.map(f64::abs)) {
        if re > 2300.0 {
            out.push(format!("{}: Reynolds number {re:.0} is beyond laminar flow, which the solver cases assume", o.name));
        }
        if v > 5.0 {
            out.push(format!("{}: a mean velocity of {v:.1} m/s is no artery's: flow.inlet.flow_rate and the waveform are in ml/s, velocity in m/s", o.name));
        }
        if re < 1.0 {
            out.push(format!("{}: Reynolds number {re:.2e} is no artery's: flow.inlet.flow_rate and the waveform are in ml/s, velocity in m/s", o.name));
        }
    }
    out
}

/// Diameters that are believed without a question, mm: from an arteriole to an aortic aneurysm.
const PLAUSIBLE_DIAMETER: std::ops::RangeInclusive<f64> = 0.2..=60.0;

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
        condition: if p.kind == PatchKind::Inlet { Condition::Inflow } else { Condition::Pressure },
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

/// The outlet with the largest flow takes what the others leave, at zero pressure; where no flow is given, all are held
/// by their pressure.
fn hold(options: &FlowOptions, openings: &mut [PatchFlow]) {
    let mut outlets: Vec<&mut PatchFlow> = openings.iter_mut().filter(|o| o.kind == PatchKind::Outlet).collect();
    if let OutletSplit::Resistance(r) = &options.split {
        outlets.iter_mut().zip(r).for_each(|(o, r)| o.condition = Condition::Resistance(*r));
        return;
    }
    // The first of the largest.
    let mut largest = 0;
    for (k, o) in outlets.iter().enumerate() {
        if o.flow > outlets[largest].flow {
            largest = k;
        }
    }
    for (_, o) in outlets.iter_mut().enumerate().filter(|(k, o)| *k != largest && o.flow.is_some()) {
        o.condition = Condition::Outflow;
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::cube;
    use super::super::{Viscosity, Waveform};
    use super::*;
    use crate::mesh::faces::FaceList;

    fn plan(options: &FlowOptions, size: f64) -> Result<FlowPlan, FlowError> {
        let mesh = cube(size);
        FlowPlan::resolve(options, &FaceList::build(&mesh).expect("conforms"))
    }

    #[test]
    fn the_largest_outlet_takes_what_the_others_leave() {
        let options = FlowOptions { split: OutletSplit::Fractions(vec![0.25, 0.75]), inflow: Inflow::FlowRate(4e-6), ..FlowOptions::default() };
        let p = plan(&options, 3.0).expect("a plan");
        let rows: Vec<_> = p.openings.iter().map(|o| (o.name.as_str(), o.condition, o.flow.unwrap_or(0.0))).collect();
        assert_eq!(rows, [("inlet", Condition::Inflow, 4e-6), ("outlet_1", Condition::Outflow, 1e-6), ("outlet_2", Condition::Pressure, 3e-6)]);
        let o = &p.openings[0];
        assert!((o.area - 9.0).abs() < 1e-12 && (o.hydraulic_diameter - 3.0).abs() < 1e-12 && o.womersley.is_none());
        assert!((o.velocity.unwrap_or(0.0) - 4.0 / 9.0).abs() < 1e-12 && p.warnings.is_empty(), "{p:?}");
    }

    #[test]
    fn a_resistance_or_fraction_for_every_outlet_is_wanted() {
        for split in [OutletSplit::Resistance(vec![1e9]), OutletSplit::Fractions(vec![1.0])] {
            let e = plan(&FlowOptions { split, ..FlowOptions::default() }, 3.0).expect_err("one number for two outlets").to_string();
            assert!(e.contains("for 2 outlets"), "{e}");
        }
    }

    #[test]
    fn a_vessel_of_three_metres_or_three_micrometres_is_asked_about() {
        for (size, word) in [(3000.0, "um"), (0.003, "m or cm")] {
            let p = plan(&FlowOptions::default(), size).expect("a plan");
            assert!(p.warnings.iter().any(|w| w.contains("diameter") && w.contains(word)), "{:?}", p.warnings);
        }
        // Litres per minute taken for ml/s are no artery's flow.
        let p = plan(&FlowOptions { inflow: Inflow::FlowRate(300e-6), ..FlowOptions::default() }, 3.0).expect("a plan");
        assert!(p.warnings.iter().any(|w| w.contains("m/s")), "{:?}", p.warnings);
    }

    #[test]
    fn a_pulsatile_plan_has_womersley_numbers_and_tells_a_beat_that_does_not_close() {
        let wave = Waveform { times: vec![0.0, 0.4, 0.8], flow: vec![2e-6, 4e-6, 3e-6] };
        let options = FlowOptions { waveform: Some(wave), viscosity: Viscosity::CASSON, ..FlowOptions::default() };
        let p = plan(&options, 4.0).expect("a plan");
        let nu = 3.5e-3 / 1060.0;
        let expected = 2e-3 * (std::f64::consts::TAU / 0.8 / nu).sqrt();
        assert!((p.openings[0].womersley.unwrap_or(0.0) / expected - 1.0).abs() < 1e-12);
        assert!(p.warnings[0].contains("jumps"), "{:?}", p.warnings);
    }
}
