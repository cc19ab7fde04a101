//! Who carries how much: the flow shared among the openings of a mesh.

use serde::Serialize;

use super::{FlowError, FlowOptions, Inflow, OutletSplit};
use crate::geometry::{Point, Vector};
use crate::mesh::faces::FaceMesh;
use crate::mesh::topology::DisjointSets;
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
    /// The same number for the openings of one vessel; vessels apart from each other count from 1 by first opening.
    pub vessel: usize,
    /// Area, mm².
    pub area: f64,
    /// Area of the vessel's section square to its axis, mm²: what sizes the vessel where its cap is tilted.
    pub square_area: f64,
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
    /// Reynolds number of the mean velocity and hydraulic diameter in the section square to the axis.
    pub reynolds: Option<f64>,
    /// Womersley number of the hydraulic radius, where pulsatile.
    pub womersley: Option<f64>,
}

impl PatchFlow {
    /// Hydraulic diameter of the section square to the axis, mm.
    fn square_diameter(&self) -> f64 {
        self.hydraulic_diameter * (self.square_area / self.area).sqrt()
    }
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
            let cap = measure(mesh, p.start..p.start + p.count, p)?;
            let square_area = options.square_areas.get(&cap.name).copied().filter(|a| *a > 0.0).unwrap_or(cap.area);
            openings.push(PatchFlow { square_area, ..cap });
        }
        let total = inflow(options, nu, &mut openings)?;
        if !openings.iter().any(|o| o.kind == PatchKind::Outlet) {
            return Err(FlowError::NoOpening("outlet"));
        }
        let mut warnings = vec![];
        // Vessels apart from each other have nothing to share: each balances its own flow.
        openings.iter_mut().zip(vessels(mesh)).for_each(|(o, v)| o.vessel = v);
        let weights = weights(options, &openings)?;
        for vessel in 1..=openings.iter().map(|o| o.vessel).max().unwrap_or(0) {
            let mut own: Vec<(&mut PatchFlow, f64)> = openings.iter_mut().zip(weights.iter().copied()).filter(|(o, _)| o.vessel == vessel).collect();
            share(options, &mut own)?;
            hold(&mut own);
            for (kind, word) in [(PatchKind::Inlet, "inlet"), (PatchKind::Outlet, "outlet")] {
                if own.iter().all(|(o, _)| o.kind != kind) {
                    let with = &own[0].0.name;
                    warnings.push(format!("the vessel with {with} has no {word} of its own: no flow balances there; give planes under openings.planes, or leave it out (input.components)"));
                }
            }
        }
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
            let d = o.square_diameter() * 1e-3;
            o.velocity = o.flow.map(|q| q / (o.area * 1e-6));
            o.reynolds = o.flow.map(|q| q.abs() / (o.square_area * 1e-6) * d / nu);
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
        vessel: 1,
        area: area.norm(),
        square_area: area.norm(),
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
    let all: f64 = openings.iter().filter(|o| o.kind == PatchKind::Inlet).map(|o| o.square_area).sum();
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
    let shares = match (&options.inlet_fractions, given) {
        (None, _) => openings.iter().map(|o| o.square_area / all).collect(),
        (Some(shares), Inflow::FlowRate(_)) => {
            let f = shares.of("fractions", &names(openings), PatchKind::Inlet)?;
            let sum: f64 = f.iter().sum();
            let positive = openings.iter().zip(&f).all(|(o, x)| o.kind != PatchKind::Inlet || *x > 0.0);
            if !positive || (sum - 1.0).abs() > 1e-6 {
                return Err(FlowError::Fractions(sum));
            }
            f
        }
        (Some(_), _) => return Err(FlowError::NothingToShare),
    };
    let mut total = 0.0;
    for (o, share) in openings.iter_mut().zip(shares).filter(|(o, _)| o.kind == PatchKind::Inlet) {
        let area = o.area * 1e-6;
        let q = match given {
            Inflow::Reynolds(re) => re * nu / (o.square_diameter() * 1e-3) * (o.square_area * 1e-6),
            Inflow::FlowRate(q) => q * share,
            Inflow::Velocity(v) => v * area,
        };
        o.flow = Some(q);
        total += q;
    }
    Ok(total)
}

/// [`PatchFlow::vessel`] of each opening: the cells of a vessel hang together over faces.
fn vessels(mesh: &impl FaceMesh) -> Vec<usize> {
    let mut sets = DisjointSets::new(mesh.cells());
    for (&a, &b) in mesh.owner().iter().zip(mesh.neighbour()) {
        sets.join(a, b);
    }
    let mut known: Vec<u32> = vec![];
    let mut number = |root: u32| match known.iter().position(|&r| r == root) {
        Some(n) => n + 1,
        None => {
            known.push(root);
            known.len()
        }
    };
    mesh.patches().iter().filter(|p| p.patch.kind != PatchKind::Wall).map(|p| number(sets.root(mesh.owner()[p.start]))).collect()
}

/// What the outlets share the flow by, for every opening; 0 at inlets and where the solver finds the flow.
fn weights(options: &FlowOptions, openings: &[PatchFlow]) -> Result<Vec<f64>, FlowError> {
    let names = names(openings);
    let by_outlet = |f: &dyn Fn(&PatchFlow) -> f64| {
        openings.iter().map(|o| if o.kind == PatchKind::Outlet { f(o) } else { 0.0 }).collect()
    };
    let of_outlets = |values: &[f64], fits: &dyn Fn(f64) -> bool| {
        openings.iter().zip(values).find(|(o, v)| o.kind == PatchKind::Outlet && !fits(**v)).map(|(_, v)| *v)
    };
    Ok(match &options.split {
        OutletSplit::Murray => by_outlet(&|o| o.square_diameter().powi(3)),
        OutletSplit::Area => by_outlet(&|o| o.square_area),
        OutletSplit::Fractions(shares) => {
            let f = shares.of("fractions", &names, PatchKind::Outlet)?;
            if let Some(bad) = of_outlets(&f, &|x| x > 0.0) {
                return Err(FlowError::Fractions(bad.min(f.iter().sum())));
            }
            f
        }
        OutletSplit::Resistance(shares) => {
            let r = shares.of("resistances", &names, PatchKind::Outlet)?;
            if let Some(value) = of_outlets(&r, &|x| x >= 0.0 && x.is_finite()) {
                return Err(FlowError::NotPositive { what: "an outlet's resistance", value });
            }
            r
        }
        OutletSplit::Pressure => vec![0.0; openings.len()],
    })
}

fn names(openings: &[PatchFlow]) -> Vec<(&str, PatchKind)> {
    openings.iter().map(|o| (o.name.as_str(), o.kind)).collect()
}

/// Shares what enters a vessel among its outlets, by their weights.
fn share(options: &FlowOptions, own: &mut [(&mut PatchFlow, f64)]) -> Result<(), FlowError> {
    let enters: f64 = own.iter().filter_map(|(o, _)| o.flow).sum();
    let sum: f64 = own.iter().map(|(_, w)| w).sum();
    match &options.split {
        OutletSplit::Pressure => return Ok(()),
        OutletSplit::Resistance(_) => {
            own.iter_mut().filter(|(o, _)| o.kind == PatchKind::Outlet).for_each(|(o, r)| o.condition = Condition::Resistance(*r));
            return Ok(());
        }
        // Fractions of each vessel's own flow.
        OutletSplit::Fractions(_) if sum > 0.0 && (sum - 1.0).abs() > 1e-6 => return Err(FlowError::Fractions(sum)),
        _ => {}
    }
    for (o, w) in own.iter_mut().filter(|(o, _)| o.kind == PatchKind::Outlet) {
        o.flow = Some(enters * *w / sum);
    }
    Ok(())
}

/// The vessel's outlet with the largest flow takes what the others leave, at zero pressure; where no flow is given, all
/// are held by their pressure.
fn hold(own: &mut [(&mut PatchFlow, f64)]) {
    let mut outlets: Vec<&mut PatchFlow> = own.iter_mut().filter(|(o, _)| o.kind == PatchKind::Outlet && o.flow.is_some()).map(|(o, _)| &mut **o).collect();
    // The first of the largest.
    let mut largest = 0;
    for (k, o) in outlets.iter().enumerate() {
        if o.flow > outlets[largest].flow {
            largest = k;
        }
    }
    outlets.iter_mut().enumerate().filter(|(k, _)| *k != largest).for_each(|(_, o)| o.condition = Condition::Outflow);
}

#[cfg(test)]
mod tests {
    use super::super::testing::cube;
    use super::super::{Shares, Viscosity, Waveform};
    use super::*;
    use crate::mesh::faces::FaceList;

    fn plan(options: &FlowOptions, size: f64) -> Result<FlowPlan, FlowError> {
        let mesh = cube(size);
        FlowPlan::resolve(options, &FaceList::build(&mesh).expect("conforms"))
    }

    #[test]
    fn the_largest_outlet_takes_what_the_others_leave() {
        let options = FlowOptions { split: OutletSplit::Fractions(vec![0.25, 0.75].into()), inflow: Inflow::FlowRate(4e-6), ..FlowOptions::default() };
        let p = plan(&options, 3.0).expect("a plan");
        let rows: Vec<_> = p.openings.iter().map(|o| (o.name.as_str(), o.condition, o.flow.unwrap_or(0.0))).collect();
        assert_eq!(rows, [("inlet", Condition::Inflow, 4e-6), ("outlet_1", Condition::Outflow, 1e-6), ("outlet_2", Condition::Pressure, 3e-6)]);
        let o = &p.openings[0];
        assert!((o.area - 9.0).abs() < 1e-12 && (o.hydraulic_diameter - 3.0).abs() < 1e-12 && o.womersley.is_none());
        assert!((o.velocity.unwrap_or(0.0) - 4.0 / 9.0).abs() < 1e-12 && p.warnings.is_empty(), "{p:?}");
    }

    #[test]
    fn vessels_apart_from_each_other_balance_their_own_flow() {
        let (mut both, other) = (cube(3.0), cube(2.0));
        let n = both.points.len() as u32;
        both.points.extend(other.points.iter().map(|p| p + Vector::new(10.0, 0.0, 0.0)));
        both.tets.extend(other.tets.iter().map(|t| t.map(|v| v + n)));
        both.patches.extend(other.patches.iter().filter(|p| p.id > 1).map(|p| crate::mesh::Patch { id: p.id + 3, name: format!("c2_{}", p.name), kind: p.kind }));
        both.boundary.extend(other.boundary.iter().map(|f| crate::mesh::BoundaryFace { vertices: f.vertices.map(|v| v + n), patch: if f.patch > 1 { f.patch + 3 } else { 1 } }));
        let faces = FaceList::build(&both).expect("conforms");
        let p = FlowPlan::resolve(&FlowOptions { inflow: Inflow::Velocity(0.1), ..FlowOptions::default() }, &faces).expect("a plan");
        for names in [["inlet", "outlet_1", "outlet_2"], ["c2_inlet", "c2_outlet_1", "c2_outlet_2"]] {
            let own = names.map(|n| p.openings.iter().find(|o| o.name == n).expect(n));
            let flow = own.map(|o| o.flow.unwrap_or(f64::NAN));
            assert!(own.iter().all(|o| o.vessel == if names[0] == "inlet" { 1 } else { 2 }));
            assert!((flow[0] - flow[1] - flow[2]).abs() < 1e-12 * flow[0] && flow[0] > 0.0, "{flow:?}");
            assert_eq!(own.iter().filter(|o| o.condition == Condition::Pressure).count(), 1, "each vessel needs one pressure to start from");
        }
        // Fractions are of each vessel's own flow.
        let split = |f: Vec<f64>| FlowPlan::resolve(&FlowOptions { split: OutletSplit::Fractions(f.into()), ..FlowOptions::default() }, &faces);
        assert!(split(vec![0.25, 0.75, 0.5, 0.5]).is_ok() && split(vec![0.25, 0.25, 0.25, 0.25]).is_err());
    }

    #[test]
    fn a_resistance_or_fraction_for_every_outlet_is_wanted() {
        for split in [OutletSplit::Resistance(vec![1e9].into()), OutletSplit::Fractions(vec![1.0].into())] {
            let e = plan(&FlowOptions { split, ..FlowOptions::default() }, 3.0).expect_err("one number for two outlets").to_string();
            assert!(e.contains("for 2 outlets"), "{e}");
        }
    }

    #[test]
    fn inlets_share_a_flow_rate_by_area_or_as_given() {
        let mut mesh = cube(3.0);
        mesh.patches[2] = crate::mesh::Patch { id: 3, name: "inlet_right".into(), kind: PatchKind::Inlet };
        let faces = FaceList::build(&mesh).expect("conforms");
        let by = |pairs: &[(&str, f64)]| Shares::ByName(pairs.iter().map(|(n, v)| (n.to_string(), *v)).collect());
        let plan = |shares, inflow| {
            let options = FlowOptions { inlet_fractions: shares, inflow, ..FlowOptions::default() };
            let flows = |p: FlowPlan| p.openings.iter().map(|o| o.flow.unwrap_or(0.0) * 1e6).collect::<Vec<_>>();
            FlowPlan::resolve(&options, &faces).map(flows)
        };
        let rate = Inflow::FlowRate(3e-6);
        let near = |a: Result<Vec<f64>, FlowError>, b: [f64; 3]| {
            let a = a.expect("a plan");
            assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-9), "{a:?} {b:?}");
        };
        near(plan(None, rate), [1.5, 1.5, 3.0]);
        near(plan(Some(by(&[("inlet_right", 0.2), ("inlet", 0.8)])), rate), [2.4, 0.6, 3.0]);
        near(plan(Some(vec![0.25, 0.75].into()), rate), [0.75, 2.25, 3.0]);
        let e = plan(Some(by(&[("inlet", 0.5), ("left", 0.5)])), rate).expect_err("unknown").to_string();
        assert!(e.contains("no inlet `left`: there are inlet, inlet_right"), "{e}");
        assert!(matches!(plan(Some(by(&[("inlet", 1.0)])), rate), Err(FlowError::Missing { .. })));
        assert!(matches!(plan(Some(vec![0.5, 0.6].into()), rate), Err(FlowError::Fractions(_))));
        assert_eq!(plan(Some(vec![0.5, 0.5].into()), Inflow::Velocity(0.1)), Err(FlowError::NothingToShare));
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
