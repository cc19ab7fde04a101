//! A complete OpenFOAM case: mesh, fields, fluid, schemes, function objects, scripts.
//!
//! Schemes: on tetrahedra `pointCellsLeastSquares` gradients bring the pressure drop of a tube within a few percent,
//! where `Gauss linear` is 11 % off; the face-corrected viscous term halves what is left (validation/results/flow).

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use super::{header, write_poly_mesh};
use crate::flow::{Condition, FlowOptions, FlowPlan, PatchFlow, Profile, Viscosity, Waveform, poisson_profile};
use crate::mesh::PatchKind;
use crate::mesh::faces::{FaceList, PatchRange};

/// Writes the case into `folder` (made if missing): `./Allrun` meshes nothing, checks the mesh and solves;
/// `./Allrun parallel` does so in `options.processes` parts. Works with Debian's `openfoam` package.
///
/// Pressure in OpenFOAM's incompressible solvers is divided by the density, wall shear stress too.
///
/// # Errors
/// What the system returns; files already written stay.
pub fn write_case(folder: &Path, faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan) -> io::Result<()> {
    write_poly_mesh(folder, faces)?;
    let put = |name: &str, text: String| -> io::Result<()> {
        let path = folder.join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        fs::write(path, text)
    };
    let steady = options.waveform.is_none();
    put("0/U", velocity(faces, options, plan))?;
    put("0/p", pressure(faces, options, plan))?;
    put("constant/transportProperties", transport(options))?;
    put("constant/turbulenceProperties", header("dictionary", "constant", "turbulenceProperties", "") + "simulationType  laminar;\n")?;
    put("system/controlDict", control(faces, options, plan))?;
    put("system/fvSchemes", schemes(steady))?;
    put("system/fvSolution", solution(steady))?;
    put("system/decomposeParDict", decompose(faces, options.processes))?;
    let solver = if steady { "simpleFoam" } else { "pimpleFoam" };
    for (name, text) in [("Allrun", allrun(solver, options.processes)), ("Allclean", ALLCLEAN.into())] {
        put(name, text)?;
        executable(&folder.join(name))?;
    }
    Ok(())
}

#[cfg(unix)]
fn executable(path: &Path) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(path, fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn executable(_: &Path) -> io::Result<()> {
    Ok(())
}

/// `constant x`, or a repeating table of the waveform scaled to mean `x` times `unit`.
fn over_time(waveform: Option<&Waveform>, name: &str, x: f64) -> String {
    let Some(w) = waveform else { return format!("{name} constant {x:e};") };
    let (start, mean) = (w.times[0], w.mean());
    let mut s = format!("{name} table; {name}Coeffs {{ outOfBounds repeat; values (");
    for (t, q) in w.times.iter().zip(&w.flow) {
        let _ = write!(s, " ({:e} {:e})", t - start, x * q / mean);
    }
    s + " ); }"
}

/// The waveform over its mean, beat after beat: the boundary condition that scales a profile cannot repeat a table.
fn scale_over_beats(w: &Waveform, beats: u32) -> String {
    let mut s = String::from("scale table (");
    for beat in 0..beats.max(1) {
        // Where a beat starts, the last one's end stands already.
        for (t, q) in w.times.iter().zip(&w.flow).skip(usize::from(beat > 0)) {
            let _ = write!(s, " ({:e} {:e})", t - w.times[0] + f64::from(beat) * w.period(), q / w.mean());
        }
    }
    s + " );"
}

fn opening<'a>(plan: &'a FlowPlan, p: &PatchRange) -> Option<&'a PatchFlow> {
    plan.openings.iter().find(|o| o.id == p.patch.id)
}

fn velocity(faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan) -> String {
    let wave = options.waveform.as_ref();
    let mut s = header("volVectorField", "0", "U", "");
    s.push_str("dimensions      [0 1 -1 0 0 0 0];\ninternalField   uniform (0 0 0);\nboundaryField\n{\n");
    for p in &faces.patches {
        let _ = write!(s, "    {}\n    {{\n", p.patch.name);
        match (p.patch.kind, opening(plan, p)) {
            (PatchKind::Wall, _) | (_, None) => s.push_str("        type noSlip;\n"),
            (PatchKind::Inlet, Some(o)) => inlet(&mut s, faces, p, o, options, wave),
            (PatchKind::Outlet, Some(o)) => match o.condition {
                Condition::Inflow | Condition::Outflow => {
                    let q = over_time(wave, "volumetricFlowRate", o.flow.unwrap_or(0.0));
                    let _ = write!(s, "        type flowRateOutletVelocity;\n        {q}\n        value uniform (0 0 0);\n");
                }
                Condition::Pressure | Condition::Resistance(_) => {
                    s.push_str("        // what flows back brings no momentum\n        type inletOutlet;\n        inletValue uniform (0 0 0);\n        value uniform (0 0 0);\n");
                }
            },
        }
        s.push_str("    }\n");
    }
    s + "}\n"
}

fn inlet(s: &mut String, faces: &FaceList<'_>, p: &PatchRange, o: &PatchFlow, options: &FlowOptions, wave: Option<&Waveform>) {
    let q = o.flow.unwrap_or(0.0);
    if options.profile == Profile::Flat {
        let q = over_time(wave, "volumetricFlowRate", q);
        let _ = write!(s, "        type flowRateInletVelocity;\n        {q}\n        extrapolateProfile false;\n        value uniform (0 0 0);\n");
        return;
    }
    let speed = poisson_profile(faces, p.start..p.start + p.count, q);
    let mut list = format!("nonuniform List<vector>\n{}\n(\n", speed.len());
    for u in speed {
        let v = -o.normal * u;
        let _ = writeln!(list, "({:e} {:e} {:e})", v.x, v.y, v.z);
    }
    list.push_str(");\n");
    let _ = match wave {
        None => write!(s, "        // developed laminar profile, flow rate {q:e} m3/s\n        type fixedValue;\n        value {list}"),
        Some(wave) => write!(
            s,
            "        // developed profile of the mean flow rate {q:e} m3/s, scaled over time\n        type scaledFixedValue;\n        {}\n        refValue\n        {{\n            type fixedValue;\n            value {list}        }}\n",
            scale_over_beats(wave, options.cycles)
        ),
    };
}

fn pressure(faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan) -> String {
    let mut s = header("volScalarField", "0", "p", "");
    s.push_str("// pressure divided by the density: Pa = value * rho\ndimensions      [0 2 -2 0 0 0 0];\ninternalField   uniform 0;\nboundaryField\n{\n");
    for p in &faces.patches {
        let text = match opening(plan, p).map(|o| o.condition) {
            Some(Condition::Pressure) => "type fixedValue; value uniform 0;".into(),
            Some(Condition::Resistance(r)) => {
                let part = opening(plan, p).map_or(0.5, |o| relaxation(faces, options, plan, o, r));
                format!(
                    "type exprFixedValue; value uniform 0; valueExpr \"{:e}*p+{:e}*sum(phi)\";",
                    1.0 - part,
                    part * r / options.density
                )
            }
            _ => "type zeroGradient;".into(),
        };
        let _ = writeln!(s, "    {} {{ {text} }}", p.patch.name);
    }
    s + "}\n"
}

/// The part of the new pressure that a resistance takes at a time.
///
/// Pressure follows flow and flow follows pressure: the loop is stable where this part stays below what the vessel's own
/// resistance (and, over a time step, its inertia) is of the outlet's. Too small a part only takes longer.
fn relaxation(faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan, o: &PatchFlow, resistance: f64) -> f64 {
    let inlet = plan.openings.iter().find(|i| i.kind == PatchKind::Inlet);
    let length = inlet.map_or(0.0, |i| (i.center - o.center).norm() * 1e-3);
    let own = 128.0 * options.viscosity.reference() * length / (std::f64::consts::PI * (o.hydraulic_diameter * 1e-3).powi(4));
    let inertia = options.waveform.as_ref().map_or(0.0, |w| options.density * length / (o.area * 1e-6) / time_step(faces, options, plan, w));
    if resistance > 0.0 { (2.0 * (own + inertia) / resistance).clamp(1e-3, 0.5) } else { 0.5 }
}

fn transport(options: &FlowOptions) -> String {
    let rho = options.density;
    let mut s = header("dictionary", "constant", "transportProperties", "");
    let _ = match options.viscosity {
        Viscosity::Newtonian { mu } => {
            writeln!(s, "transportModel  Newtonian;\nnu              {:e};      // m2/s; {mu:e} Pa s at {rho} kg/m3", mu / rho)
        }
        Viscosity::Casson { mu_inf, tau0, mu_max } => writeln!(
            s,
            "transportModel  Casson;\nCassonCoeffs\n{{\n    m {:e};      // m2/s\n    tau0 {:e};      // m2/s2\n    nuMin {:e};\n    nuMax {:e};\n}}",
            mu_inf / rho,
            tau0 / rho,
            mu_inf / rho,
            mu_max / rho
        ),
        Viscosity::Carreau { mu0, mu_inf, lambda, n } => writeln!(
            s,
            "transportModel  BirdCarreau;\nBirdCarreauCoeffs\n{{\n    nu0 {:e};\n    nuInf {:e};\n    k {lambda:e};\n    n {n:e};\n}}",
            mu0 / rho,
            mu_inf / rho
        ),
    };
    s
}

fn control(faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan) -> String {
    let mut s = header("dictionary", "system", "controlDict", "");
    let names = |kind: PatchKind| {
        let of = faces.patches.iter().filter(|p| p.patch.kind == kind && p.count > 0);
        of.map(|p| p.patch.name.as_str()).collect::<Vec<_>>()
    };
    match &options.waveform {
        None => s.push_str(
            "application     simpleFoam;\nstartFrom       startTime;\nstartTime       0;\nstopAt          endTime;\nendTime         2000;\ndeltaT          1;\nwriteControl    timeStep;\nwriteInterval   2000;\npurgeWrite      1;\n",
        ),
        Some(w) => {
            let period = w.period();
            let dt = time_step(faces, options, plan, w);
            let _ = write!(
                s,
                "application     pimpleFoam;\nstartFrom       startTime;\nstartTime       0;\nstopAt          endTime;\nendTime         {:e};\n// twice the mean velocity at peak flow over the mean cell size at Courant number {}\ndeltaT          {dt:e};\nadjustTimeStep  yes;\nmaxCo           {};\nmaxDeltaT       {:e};\nwriteControl    adjustableRunTime;\nwriteInterval   {:e};\npurgeWrite      0;\n",
                period * f64::from(options.cycles.max(1)),
                options.max_courant,
                options.max_courant,
                period / 100.0,
                period / 20.0
            );
        }
    }
    s.push_str("writeFormat     ascii;\nwritePrecision  10;\nrunTimeModifiable false;\nfunctions\n{\n");
    let _ = writeln!(
        s,
        "    // wall shear stress divided by the density: Pa = value * {}\n    wallShearStress {{ type wallShearStress; libs (fieldFunctionObjects); patches ({}); writeControl writeTime; }}",
        options.density,
        names(PatchKind::Wall).join(" ")
    );
    // Its magnitude as numbers: mean and largest over each wall.
    s.push_str("    wallShearStressMagnitude { type mag; libs (fieldFunctionObjects); field wallShearStress; result wallShearStressMagnitude; log false; writeControl writeTime; }\n");
    for wall in names(PatchKind::Wall) {
        for (what, operation) in [("mean", "areaAverage"), ("max", "max")] {
            let _ = writeln!(
                s,
                "    wallShearStress_{what}_{wall} {{ type surfaceFieldValue; libs (fieldFunctionObjects); fields (wallShearStressMagnitude); operation {operation}; regionType patch; name {wall}; writeFields false; log false; writeControl writeTime; }}"
            );
        }
    }
    let openings: Vec<&str> = [names(PatchKind::Inlet), names(PatchKind::Outlet)].concat();
    for name in &openings {
        for (field, operation) in [("p", "areaAverage"), ("phi", "sum")] {
            let _ = writeln!(
                s,
                "    {field}_{name} {{ type surfaceFieldValue; libs (fieldFunctionObjects); fields ({field}); operation {operation}; regionType patch; name {name}; writeFields false; log false; writeControl timeStep; writeInterval 1; }}"
            );
        }
    }
    for outlet in plan.openings.iter().filter(|o| o.kind == PatchKind::Outlet) {
        // From the vessel's first inlet.
        if let Some(inlet) = plan.openings.iter().find(|o| o.kind == PatchKind::Inlet && o.vessel == outlet.vessel) {
            let (inlet, outlet) = (&inlet.name, &outlet.name);
            let _ = writeln!(
                s,
                "    pressureDrop_{inlet}_{outlet}\n    {{\n        type fieldValueDelta; libs (fieldFunctionObjects); operation subtract; log false; writeControl timeStep; writeInterval 1;\n        region1 {{ type surfaceFieldValue; libs (fieldFunctionObjects); fields (p); operation areaAverage; regionType patch; name {inlet}; writeFields false; log false; }}\n        region2 {{ type surfaceFieldValue; libs (fieldFunctionObjects); fields (p); operation areaAverage; regionType patch; name {outlet}; writeFields false; log false; }}\n    }}"
            );
        }
    }
    s + "}\n"
}

/// First time step: the Courant number at peak flow with the mean cell size; the solver adjusts it.
fn time_step(faces: &FaceList<'_>, options: &FlowOptions, plan: &FlowPlan, w: &Waveform) -> f64 {
    let peak = if w.mean() > 0.0 { w.peak() / w.mean() } else { 1.0 };
    let speed = plan.openings.iter().filter_map(|o| o.velocity).fold(0.0, f64::max) * 2.0 * peak;
    let sample: Vec<f64> = faces.vertices.iter().step_by(1 + faces.vertices.len() / 10_000).map(|v| {
        (faces.points[v[0] as usize] - faces.points[v[1] as usize]).norm() * 1e-3
    }).collect();
    let size = crate::quality::stats::mean(&sample);
    if speed > 0.0 { (options.max_courant * size / speed).min(w.period() / 100.0) } else { w.period() / 100.0 }
}

fn schemes(steady: bool) -> String {
    let (ddt, bounded) = if steady { ("steadyState", "bounded ") } else { ("backward", "") };
    header("dictionary", "system", "fvSchemes", "")
        + &format!(
            "ddtSchemes           {{ default {ddt}; }}\n// vertex-neighbour least squares: pressure drop of a tube of tetrahedra within a few percent; Gauss linear: 11 % off\n// of the velocity by the points' values: one percent nearer on tetrahedra\ngradSchemes          {{ default pointCellsLeastSquares; grad(U) Gauss pointLinear; }}\ndivSchemes\n{{\n    default          none;\n    div(phi,U)       {bounded}Gauss linearUpwind grad(U);\n    div((nuEff*dev2(T(grad(U))))) Gauss linear;\n}}\n// face-corrected: the wall shear stress of a tube of prisms within 0.5 %, twice as near as corrected\nlaplacianSchemes     {{ default Gauss linear corrected; laplacian(nuEff,U) Gauss linear faceCorrected; }}\ninterpolationSchemes {{ default linear; }}\nsnGradSchemes        {{ default corrected; }}\nwallDist             {{ method meshWave; }}\n"
        )
}

fn solution(steady: bool) -> String {
    let linear = "    p { solver GAMG; smoother DICGaussSeidel; tolerance 1e-9; relTol 0.05; }\n    pFinal { $p; relTol 0; }\n    U { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-10; relTol 0.1; }\n    UFinal { $U; relTol 0; }\n";
    let rest = if steady {
        "SIMPLE\n{\n    nNonOrthogonalCorrectors 1;\n    consistent yes;\n    residualControl { p 1e-5; U 1e-6; }\n}\nrelaxationFactors { equations { U 0.9; } }\n"
    } else {
        "PIMPLE\n{\n    nOuterCorrectors 2;\n    nCorrectors 2;\n    nNonOrthogonalCorrectors 1;\n}\nrelaxationFactors { equations { \".*\" 1; } }\n"
    };
    header("dictionary", "system", "fvSolution", "") + "solvers\n{\n" + linear + "}\n" + rest
}

/// Slices across the longest side of the mesh: hierarchical needs no library that Debian leaves out.
fn decompose(faces: &FaceList<'_>, processes: u32) -> String {
    let b = crate::geometry::Aabb::of(faces.points);
    let size = b.max - b.min;
    let axis = if faces.points.is_empty() { 0 } else { size.imax() };
    let n = [0, 1, 2].map(|i| if i == axis { processes.max(1) } else { 1 });
    header("dictionary", "system", "decomposeParDict", "")
        + &format!(
            "numberOfSubdomains {};\nmethod hierarchical;      // Debian's package has no scotch\nhierarchicalCoeffs {{ n ({} {} {}); delta 0.001; order xyz; }}\n",
            processes.max(1),
            n[0],
            n[1],
            n[2]
        )
}

fn allrun(solver: &str, processes: u32) -> String {
    let steady = solver == "simpleFoam";
    format!(
        r#"#!/bin/sh
# ./Allrun            check the mesh and solve
# ./Allrun parallel   the same in {n} parts
cd "${{0%/*}}" || exit 1
case "$PWD" in *[[:space:]]*) echo "$PWD: OpenFOAM cannot work in a folder whose path has spaces: move the case" >&2; exit 1 ;; esac
# Debian's package sets no environment.
[ -n "$WM_PROJECT_DIR" ] || export WM_PROJECT_DIR=/usr/share/openfoam
set -e
checkMesh > log.checkMesh 2>&1
if [ "$1" = parallel ]; then
    # In containers Open MPI would refuse root and more parts than cores.
    [ "$(id -u)" != 0 ] || export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
    export OMPI_MCA_rmaps_base_oversubscribe=1
    decomposePar -force > log.decomposePar 2>&1
    mpirun -np {n} {solver} -parallel > log.{solver} 2>&1
    reconstructPar > log.reconstructPar 2>&1
else
    {solver} > log.{solver} 2>&1
fi
tail -n 3 log.{solver}
{verdict}"#,
        verdict = if steady { CONVERGED } else { "" },
        n = processes.max(1)
    )
}

/// What a steady run says at its end.
const CONVERGED: &str = r#"grep -h 'solution converged' log.simpleFoam || {
    echo "NOT CONVERGED: simpleFoam stopped at the endTime of system/controlDict with residuals above system/fvSolution's" >&2
    echo "residualControl (see the end of log.simpleFoam). Raise endTime, set startFrom latestTime and run simpleFoam to go on." >&2
    exit 1
}
"#;

const ALLCLEAN: &str = r#"#!/bin/sh
# Removes what Allrun made: its logs, postProcessing, processor folders and times; nothing else that lies here.
cd "${0%/*}" && [ -f Allclean ] && [ -d constant/polyMesh ] || exit 1
for log in checkMesh decomposePar simpleFoam pimpleFoam reconstructPar; do rm -f "log.$log"; done
rm -rf postProcessing
for made in processor[0-9]* [0-9]*; do
    number=${made#processor}
    # Small times have an exponent: 1e-05.
    case "${number%e-[0-9]*}" in
    0) [ "$made" = processor0 ] || continue ;;
    *[!0-9.]*) continue ;;
    esac
    [ ! -d "$made" ] || rm -rf "$made"
done
"#;
