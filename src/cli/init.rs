//! `lumenmesh init`: a commented case file with the ends that were found.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Component, Path, PathBuf};

use serde_json::Value;

use super::args::InitArgs;
use super::console::{self, Console};
use super::exit::{self, Failure};
use super::output::{self, Existing};
use crate::config::Case;
use crate::mesh::PatchKind;
use crate::openings::{BlindReason, FoundBy};
use crate::pipeline::{self, Stage, Survey};

/// Places of one kind that the advice names; the rest are counted.
const LISTED: usize = 5;

/// `lumenmesh init MASK`
pub fn run(args: &InitArgs) -> Result<u8, Failure> {
    let existing = match (args.force, args.keep) {
        (true, _) => Existing::Replace,
        (_, true) => Existing::Keep,
        _ => Existing::Refuse("replace it with --force, or move it aside with --keep"),
    };
    // Told before the work, and again where the file came meanwhile.
    if let (Some(file), Existing::Refuse(way)) = (args.output.as_ref().filter(|f| f.exists()), existing) {
        return Err(output::exists(file, way));
    }
    super::kind::is_input(&args.input, "init")?;
    let case = super::run::case_for(&args.input, &args.set)?;
    console::catch_interrupt(console::PATIENCE);
    let progress = Console::new(false, args.verbose);
    let worker = std::env::current_exe().map_err(|e| Failure::new(exit::ENGINE, e))?;
    let context = pipeline::Context { stop_after: Stage::Reconstruction, progress: &progress, cancel: &console::CANCELLED, worker };
    let survey = pipeline::survey(&case, &context)?;
    let folder = args.output.as_ref().map_or(Path::new("."), |f| f.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")));
    let text = case_file(&case, &survey, &seen_from(folder, &args.input))?;
    // The text must be a case: a bug here must not reach an editor.
    crate::config::from_text(&text, "the new case file", &[])?;
    match &args.output {
        Some(file) => {
            output::tell_kept(output::place(file, text.as_bytes(), existing)?.as_deref());
            say!("{}: {} openings found; edit it, then run: lumenmesh run {}", file.display(), survey.openings.len(), file.display());
        }
        None => {
            if let Err(e) = std::io::stdout().lock().write_all(text.as_bytes())
                && e.kind() != std::io::ErrorKind::BrokenPipe
            {
                return Err(Failure::new(exit::USAGE, e));
            }
        }
    }
    Ok(0)
}

/// `file` as a path from `folder`, which is where relative paths of a case file start.
fn seen_from(folder: &Path, file: &Path) -> PathBuf {
    let (Ok(from), Ok(to)) = (folder.canonicalize(), file.canonicalize()) else { return file.into() };
    let (a, b): (Vec<Component>, Vec<Component>) = (from.components().collect(), to.components().collect());
    let shared = a.iter().zip(&b).take_while(|(x, y)| x == y).count();
    // Nothing in common but the root: the absolute path is plainer.
    if shared <= 1 {
        return to;
    }
    let up = std::iter::repeat_n(Component::ParentDir, a.len() - shared);
    up.chain(b[shared..].iter().copied()).collect()
}

fn case_file(case: &Case, s: &Survey, input: &Path) -> Result<String, Failure> {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = head(&mut out, s, input).and_then(|()| advice(&mut out, s));
    let mut given = changed(case)?;
    let mut source = match given.remove("input") {
        Some(Value::Object(map)) => map,
        _ => serde_json::Map::new(),
    };
    let key = ["mask", "probability", "surface"].into_iter().find(|k| source.remove(*k).is_some()).unwrap_or("mask");
    // Wishes about openings have been met: the planes are their result.
    given.remove("openings");
    let _ = write!(out, "input:\n  {key}: {}\n", scalar(&input.display().to_string()));
    out.push_str(&yaml(&Value::Object(source), 2)?);
    if key != "surface" && !case_has_label(case) {
        out.push_str("  # label: 1              # a picture of labels: the one, or [1, 4], that is lumen\n");
    }
    out.push_str("  # components: all       # every part of the vessel tree that hangs together, not the largest only\n\n");
    let _ = planes(&mut out, s);
    for (section, value) in given {
        let _ = write!(out, "\n{section}:\n");
        out.push_str(&yaml(&value, 2)?);
    }
    let _ = hints(&mut out, case, s);
    Ok(out)
}

fn case_has_label(case: &Case) -> bool {
    case.input.label != crate::config::Labels::Unset || case.input.threshold.is_some()
}

fn head(out: &mut String, s: &Survey, input: &Path) -> std::fmt::Result {
    let name = input.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let [x, y, z] = s.mask.grid.spacing();
    let [nx, ny, nz] = s.mask.grid.dims;
    let edge = x.max(y).max(z);
    writeln!(out, "# Case for {name}, made by `lumenmesh init`. Run it: lumenmesh run THIS_FILE -o out")?;
    writeln!(out, "# All keys: lumenmesh reference. Lengths carry their unit: mm, voxels, R (local radius), D (local diameter).")?;
    writeln!(out, "#")?;
    writeln!(out, "# image     {nx} x {ny} x {nz} voxels of {} x {} x {} mm", short(x), short(y), short(z))?;
    if let Some(values) = s.report.sections.get("input").and_then(|i| i["values"].as_str()) {
        writeln!(out, "# labels    {values}")?;
    }
    let t = &s.cleaning.after;
    writeln!(
        out,
        "# lumen     {} voxels, {:.4} ml; {} component{}, {} ring{}",
        s.mask.count(),
        s.mask.volume() * 1e-3,
        t.components,
        plural(t.components),
        t.tunnels,
        plural(t.tunnels)
    )?;
    let [low, middle, high] = s.radius;
    writeln!(out, "# diameter  {:.2} to {:.2} mm, median {:.2} mm; {:.1} voxels at the narrowest", 2.0 * low, 2.0 * high, 2.0 * middle, 2.0 * low / edge)?;
    writeln!(out, "# surface   edges of {:.3} to {:.3} mm, about {} triangles", s.edge_length[0], s.edge_length[1], s.predicted_faces)
}

/// What a person should know before meshing.
fn advice(out: &mut String, s: &Survey) -> std::fmt::Result {
    let mut lines: Vec<String> = Vec::new();
    for p in s.thin.iter().take(LISTED) {
        lines.push(format!(
            "thin: {:.2} mm ({:.1} voxels) across at {}, over {:.1} mm: its radius is known to about half a voxel; a finer image would help",
            p.diameter,
            p.voxels,
            place(p.at.into()),
            p.length
        ));
    }
    if s.thin.len() > LISTED {
        lines.push(format!("thin: {} more such stretches", s.thin.len() - LISTED));
    }
    for p in s.close.iter().take(LISTED) {
        lines.push(format!(
            "touching: one voxel between two parts of the vessel at {} ({} voxels of gap{}): they stay apart; look whether they should",
            place(p.at.into()),
            p.voxels,
            p.radii_apart.map_or(String::new(), |r| format!(", {r:.0} radii apart along the vessel"))
        ));
    }
    if s.close.len() > LISTED {
        lines.push(format!("touching: {} more such places", s.close.len() - LISTED));
    }
    if s.cleaning.after.tunnels > 0 {
        lines.push(format!(
            "rings: the lumen has {} ring{}; vessels grown together where they touch make rings: separate them in the mask if they are not real",
            s.cleaning.after.tunnels,
            plural(s.cleaning.after.tunnels)
        ));
    }
    for t in &s.cleaning.totals {
        let kind = serde_json::to_value(t.kind).ok().and_then(|v| v.as_str().map(|k| k.replace(['-', '_'], " "))).unwrap_or_default();
        lines.push(format!("cleaned: {kind}, {} time{}, {} voxels; see input.cleaning", t.changes, plural(t.changes), t.voxels));
    }
    lines.extend(s.report.warnings.iter().map(|w| format!("{}: {}", w.stage, w.message)));
    if !lines.is_empty() {
        writeln!(out, "#\n# Advice (coordinates: LPS mm)")?;
        lines.iter().try_for_each(|l| writeln!(out, "# - {l}"))?;
    }
    out.push('\n');
    Ok(())
}

fn planes(out: &mut String, s: &Survey) -> std::fmt::Result {
    writeln!(out, "# The ends that were found, as planes: center on the axis (LPS mm), normal out of the vessel.")?;
    writeln!(out, "# Move, turn, rename, delete or add planes; `openings: {{detect: auto}}` finds them anew in every run.")?;
    writeln!(out, "openings:\n  detect: off")?;
    if s.openings.is_empty() {
        writeln!(out, "  planes: []              # none: add planes such as the one below")?;
        writeln!(out, "  # - {{name: inlet, kind: inlet, center: [0, 0, 0], normal: [0, 0, 1]}}")?;
    } else {
        writeln!(out, "  planes:")?;
    }
    for (o, area) in s.openings.iter().zip(&s.areas) {
        let how = match o.found_by {
            FoundBy::User => "given",
            FoundBy::ImageBorder => "leaves the image",
            FoundBy::FlatFace => "is cut flat",
            FoundBy::BluntEnd => "ends inside the image",
            FoundBy::SurfaceRim => "rim or flat cap of the surface",
        };
        let area = area.map_or(String::new(), |a| format!("; area {a:.3} mm2, diameter {:.3} mm", (4.0 * a / std::f64::consts::PI).sqrt()));
        writeln!(out, "    # {how}{area}; confidence {:.2}", o.confidence)?;
        writeln!(out, "    - name: {}", scalar(&o.name))?;
        writeln!(out, "      kind: {}", if o.kind == PatchKind::Inlet { "inlet" } else { "outlet" })?;
        let (c, n) = (o.plane.origin, o.plane.normal);
        writeln!(out, "      center: [{:.6}, {:.6}, {:.6}]", c.x, c.y, c.z)?;
        writeln!(out, "      normal: [{:.9}, {:.9}, {:.9}]", n.x, n.y, n.z)?;
    }
    for b in &s.blind {
        let why = match b.reason {
            BlindReason::SacWithNeck => "a sac behind a neck",
            BlindReason::WideSac => "a sac wider than its vessel",
            BlindReason::Bump => "shorter than wide",
            BlindReason::NoSection => "no section that a plane could cut",
            BlindReason::SharedOpening => "the opening beside it takes it off too",
            BlindReason::SharedSection => "a cut there would take another vessel off too",
            BlindReason::LargeSection => "its section is far larger than its inscribed circle",
            BlindReason::TakesMore => "a cut there would take off more than its tip",
            BlindReason::GrazesBorder => "the vessel runs along the image's border",
            BlindReason::CroppedSac => "a sac cropped by the image's border",
        };
        writeln!(out, "  # closed: the end at {} ({why}; radius {:.2} mm, length {:.2} mm)", place(b.tip.into()), b.radius, b.length)?;
    }
    Ok(())
}

/// Sections that are often wanted, as comments.
fn hints(out: &mut String, case: &Case, s: &Survey) -> std::fmt::Result {
    let base = Case::for_mask(PathBuf::new());
    writeln!(out)?;
    if case.surface == base.surface {
        writeln!(out, "# surface:")?;
        writeln!(out, "#   edge_length: auto     # or one for all, such as {:.3} mm, or 0.1 R", 0.5 * (s.edge_length[0] + s.edge_length[1]))?;
        writeln!(out, "#   scale: 1              # 2 coarsens, 0.5 refines")?;
    }
    if case.extensions == base.extensions {
        writeln!(out, "# extensions:")?;
        writeln!(out, "#   length: 5 D           # straight pieces at the openings, in their diameters")?;
    }
    if case.volume == base.volume {
        writeln!(out, "# volume:")?;
        writeln!(out, "#   boundary_layers: {{count: 4}}   # prisms on the wall")?;
    }
    if case.flow == base.flow {
        writeln!(out, "# flow:")?;
        writeln!(out, "#   inlet: {{reynolds: 300}}        # or flow_rate (ml/s), or velocity (m/s)")?;
        writeln!(out, "#   outlets: {{split: murray}}")?;
    }
    Ok(())
}

/// The keys of a case that differ from the defaults.
fn changed(case: &Case) -> Result<serde_json::Map<String, Value>, Failure> {
    let json = |c: &Case| serde_json::to_value(c).map_err(|e| Failure::new(exit::USAGE, e));
    let (own, base) = (json(case)?, json(&Case::for_mask(PathBuf::new()))?);
    Ok(match difference(&own, &base) {
        Some(Value::Object(map)) => map,
        _ => serde_json::Map::new(),
    })
}

fn difference(own: &Value, base: &Value) -> Option<Value> {
    match (own, base) {
        (Value::Object(a), Value::Object(b)) => {
            let map: serde_json::Map<String, Value> = a
                .iter()
                .filter_map(|(k, v)| Some((k.clone(), b.get(k).map_or_else(|| Some(v.clone()), |w| difference(v, w))?)))
                .collect();
            (!map.is_empty()).then_some(Value::Object(map))
        }
        _ => (own != base).then(|| own.clone()),
    }
}

fn yaml(value: &Value, indent: usize) -> Result<String, Failure> {
    if value.as_object().is_some_and(serde_json::Map::is_empty) {
        return Ok(String::new());
    }
    let text = serde_saphyr::to_string(value).map_err(|e| Failure::new(exit::USAGE, anyhow::anyhow!("{e}")))?;
    let pad = " ".repeat(indent);
    Ok(text.lines().map(|l| format!("{pad}{l}\n")).collect())
}

/// A text as a YAML scalar, quoted where it needs to be.
fn scalar(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.' | '/');
    let number = text.parse::<f64>().is_ok();
    if text.starts_with(|c: char| c.is_ascii_alphabetic() || matches!(c, '_' | '/' | '.')) && text.chars().all(plain) && !number {
        text.into()
    } else {
        Value::from(text).to_string()
    }
}

fn place(p: [f64; 3]) -> String {
    format!("({:.2}, {:.2}, {:.2})", p[0], p[1], p[2])
}

/// Up to four digits, without zeros at the end.
fn short(x: f64) -> String {
    let text = format!("{x:.4}");
    text.trim_end_matches('0').trim_end_matches('.').into()
}

fn plural(n: usize) -> &'static str {
    if n == 1 { "" } else { "s" }
}
