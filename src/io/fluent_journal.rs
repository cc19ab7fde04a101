//! FLUENT's journal: reads and checks the mesh, sets blood and boundary values, solves; with it the inlets' profiles.
//!
//! Text commands in the form that takes named settings (`define/boundary-conditions/set/...`), which does not change
//! with the models that are on. Viscosity models, resistances and pulsatile flow need FLUENT 2020 R1 or newer (named
//! expressions). Written after the text command list of the manual; there is no FLUENT here to run it with.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use crate::flow::{Condition, FlowOptions, FlowPlan, PatchFlow, Profile, Viscosity, poisson_profile};
use crate::mesh::PatchKind;
use crate::mesh::faces::{FaceList, FaceMesh};
use crate::quality::face_geometry;

/// Iterations of a steady run at most; FLUENT stops where its residuals reach 1e-5.
const ITERATIONS: u32 = 1000;

/// Writes `lumen.jou` and one profile an inlet (`<name>.prof`) into `folder`, beside `lumen.msh`.
///
/// # Errors
/// What the system returns; files already written stay.
pub fn write(folder: &Path, faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan) -> io::Result<()> {
    for o in plan.openings.iter().filter(|o| o.condition == Condition::Inflow) {
        if let Some(text) = profile(faces, options, plan, o) {
            fs::write(folder.join(format!("{}.prof", o.name)), text)?;
        }
    }
    fs::write(folder.join("lumen.jou"), journal(options, plan))
}

/// What the journal cannot carry over from the plan, in sentences.
pub fn warnings(options: &FlowOptions) -> Vec<String> {
    let mut out = vec![];
    if options.waveform.is_some() && options.profile == Profile::Parabolic {
        out.push("FLUENT's journal sets the mean velocity of the waveform over the whole inlet: its transient profiles hold no shape; the OpenFOAM case has the parabola".into());
    }
    out
}

/// The inlet's normal velocity at the centre of each face, or over time.
fn profile(faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan, o: &PatchFlow) -> Option<String> {
    let list = |name: &str, values: &mut dyn Iterator<Item = f64>| {
        let mut s = format!("({name}");
        for v in values {
            let _ = write!(s, "\n{v:e}");
        }
        s + ")\n"
    };
    if let Some(w) = &options.waveform {
        let share = o.flow.unwrap_or(0.0) / plan.total / (o.area * 1e-6);
        let times = list("time", &mut w.times.iter().map(|t| t - w.times[0]));
        let speed = list("vmag", &mut w.flow.iter().map(|q| q * share));
        return Some(format!("(({} transient {} 1)\n{times}{speed})\n", o.name, w.times.len()));
    }
    let p = faces.patches.iter().find(|p| p.patch.id == o.id)?;
    if options.profile == Profile::Flat {
        return None;
    }
    let range = p.start..p.start + p.count;
    let centres: Vec<_> = range.clone().map(|f| face_geometry(faces.points, faces.face(f)).0).collect();
    let mut s = format!("(({} point {})\n", o.name, p.count);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        s += &list(name, &mut centres.iter().map(|c| c[axis] * 1e-3));
    }
    s += &list("vmag", &mut poisson_profile(faces, range, o.flow.unwrap_or(0.0)).into_iter());
    Some(s + ")\n")
}

fn journal(options: &FlowOptions, plan: &FlowPlan) -> String {
    let rho = options.density;
    let mut s = String::from(
        "; lumenmesh: reads and checks the mesh, sets blood and boundary values, solves.\n; In this folder: fluent 3ddp -g -i lumen.jou      (SI units; the mesh is in metres)\n\
         /file/set-batch-options no yes yes no\n/file/read-case \"lumen.msh\"\n/mesh/check\n/mesh/quality\n/mesh/size-info\n/define/models/viscous/laminar? yes\n",
    );
    let viscosity = |s: &mut String, mu: &str| {
        let _ = write!(
            s,
            "/define/named-expressions/add \"blood_viscosity\" definition \"{mu}\" quit\n/define/materials/change-create air blood yes constant {rho} no no yes expression \"blood_viscosity\" no no no yes\n"
        );
    };
    s.push_str("; blood: kg/m3 and Pa s\n");
    match options.viscosity {
        Viscosity::Newtonian { mu } => {
            let _ = writeln!(s, "/define/materials/change-create air blood yes constant {rho} no no yes constant {mu} no no no yes");
        }
        Viscosity::Casson { mu_inf, tau0, mu_max } => viscosity(
            &mut s,
            &format!("min({mu_max} [Pa s], (sqrt({mu_inf} [Pa s]) + sqrt({tau0} [Pa] / max(StrainRate, 1e-06 [s^-1])))^2)"),
        ),
        Viscosity::Carreau { mu0, mu_inf, lambda, n } => viscosity(
            &mut s,
            &format!("{mu_inf} [Pa s] + {} [Pa s] * (1 + ({lambda} [s] * StrainRate)^2)^{}", mu0 - mu_inf, (n - 1.0) / 2.0),
        ),
    }
    s.push_str("/define/boundary-conditions/set/fluid fluid () material yes blood quit\n");
    for o in &plan.openings {
        opening(&mut s, options, plan, o);
    }
    s.push_str("; second order everywhere, coupled\n/solve/set/p-v-coupling 24\n/solve/set/gradient-scheme no yes\n/solve/monitors/residual/convergence-criteria 1e-5 1e-5 1e-5 1e-5\n");
    match &options.waveform {
        None => {
            let _ = write!(
                s,
                "/solve/initialize/hyb-initialization\n/solve/iterate {ITERATIONS}\n/file/write-case-data \"lumen-solved.cas.h5\"\n"
            );
        }
        Some(w) => {
            let (beats, steps) = (options.cycles.max(1), 400);
            let _ = write!(
                s,
                "; {steps} steps a beat of {:e} s\n/define/models/unsteady-2nd-order? yes\n/solve/set/time-step {:e}\n/solve/initialize/hyb-initialization\n/solve/dual-time-iterate {} 30\n/file/write-case-data \"lumen-solved.cas.h5\"\n",
                w.period(),
                w.period() / f64::from(steps),
                beats * steps
            );
        }
    }
    s
}

fn opening(s: &mut String, options: &FlowOptions, plan: &FlowPlan, o: &PatchFlow) {
    let name = &o.name;
    let _ = writeln!(s, "; {name}: area {:e} m2, hydraulic diameter {:e} m", o.area * 1e-6, o.hydraulic_diameter * 1e-3);
    let outlets = || plan.openings.iter().filter(|o| o.kind == PatchKind::Outlet);
    // FLUENT's outflow zones share by weights and must not stand beside pressure outlets: all or none.
    let shares = outlets().count() > 1 && outlets().all(|o| o.flow.is_some());
    let _ = match o.condition {
        Condition::Inflow if options.waveform.is_some() || options.profile == Profile::Parabolic => writeln!(
            s,
            "/file/read-profile \"{name}.prof\"\n/define/boundary-conditions/set/velocity-inlet {name} () vmag yes no \"{name}\" \"vmag\" quit"
        ),
        Condition::Inflow => writeln!(s, "/define/boundary-conditions/set/velocity-inlet {name} () vmag no {:e} quit", o.velocity.unwrap_or(0.0)),
        _ if shares => writeln!(
            s,
            "/define/boundary-conditions/zone-type {name} outflow\n/define/boundary-conditions/outflow {name} {:.9}",
            o.flow.unwrap_or(0.0) / plan.total
        ),
        Condition::Resistance(r) => writeln!(
            s,
            "/define/named-expressions/add \"p_{name}\" definition \"-{r:e} [Pa s m^-3] * MassFlow(['{name}']) / {:e} [kg m^-3]\" quit\n/define/boundary-conditions/set/pressure-outlet {name} () gauge-pressure yes \"p_{name}\" quit",
            options.density
        ),
        Condition::Outflow | Condition::Pressure => {
            writeln!(s, "/define/boundary-conditions/set/pressure-outlet {name} () gauge-pressure no 0 quit")
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::testing::cube;
    use crate::flow::{Inflow, OutletSplit, Waveform};

    fn files(options: &FlowOptions) -> (String, Option<String>) {
        let mesh = cube(3.0);
        let faces = FaceList::build(&mesh).expect("conforms");
        let plan = FlowPlan::resolve(options, &faces).expect("a plan");
        let folder = tempfile::tempdir().expect("folder");
        write(folder.path(), &faces, options, &plan).expect("writes");
        let read = |name: &str| fs::read_to_string(folder.path().join(name)).ok();
        (read("lumen.jou").expect("a journal"), read("inlet.prof"))
    }

    #[test]
    fn the_journal_reads_checks_and_sets_blood_and_every_opening() {
        let options = FlowOptions { split: OutletSplit::Fractions(vec![0.25, 0.75].into()), ..FlowOptions::default() };
        let (journal, profile) = files(&options);
        let lines: Vec<&str> = journal.lines().filter(|l| !l.starts_with(';')).collect();
        assert!(lines.iter().all(|l| l.starts_with('/')), "{journal}");
        let order = ["read-case \"lumen.msh\"", "/mesh/check", "constant 1060 no no yes constant 0.003498", "material yes blood", "velocity-inlet inlet", "outflow outlet_1 0.25", "outflow outlet_2 0.75", "iterate"];
        let mut at = 0;
        for word in order {
            at += journal[at..].find(word).unwrap_or_else(|| panic!("no {word} in its place:\n{journal}"));
        }
        // One value a face, in metres; the cube's inlet has two faces.
        let profile = profile.expect("a profile");
        assert!(profile.starts_with("((inlet point 2)\n(x\n0e0\n0e0)\n(y\n"), "{profile}");
        assert_eq!(profile.matches('(').count(), profile.matches(')').count());
    }

    #[test]
    fn resistances_other_fluids_and_beats_are_expressions_and_tables() {
        let wave = Waveform { times: vec![0.0, 0.8], flow: vec![2e-6, 2e-6] };
        let options = FlowOptions {
            split: OutletSplit::Resistance(vec![1e9, 2e9].into()),
            viscosity: Viscosity::CARREAU,
            waveform: Some(wave),
            inflow: Inflow::Reynolds(1.0),
            ..FlowOptions::default()
        };
        let (journal, profile) = files(&options);
        for word in ["StrainRate", "MassFlow(['outlet_2'])", "unsteady-2nd-order", "dual-time-iterate 1200"] {
            assert!(journal.contains(word), "no {word}:\n{journal}");
        }
        assert!(profile.expect("a profile").starts_with("((inlet transient 2 1)\n(time\n0e0\n8e-1)\n(vmag\n"));
        assert_eq!(warnings(&options).len(), 1);
    }
}
