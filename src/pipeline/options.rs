//! From the case as written to each stage's own options.

use std::path::Path;

use super::input::Source;
use crate::config::{self, AutoLength, Case, Labels, Length};
use crate::centerline::{Branch, Centerlines, Sample};
use crate::flow::{FlowOptions, Inflow, OutletSplit, Profile, Shares, Viscosity, Waveform};
use crate::geometry::{Aabb, Plane, Vector};
use crate::implicit::Implicit;
use crate::mask::{CleaningOptions, Components, LabelKey, LengthUnit, Mask, Selection};
use crate::mesh::PatchKind;
use crate::mesh::regions::Region;
use crate::openings::{CutDirection, CutOptions, DetectOptions, ExtendError, Extension, Opening, UserOpenings, UserPlane};
use crate::polygonize::PolygonizeOptions;
use crate::quality::SurfaceOptions;
use crate::remesh::angle_repair::RepairOptions;
use crate::remesh::size_field::{EdgeLength, GuidanceOptions, Refinement};
use crate::volume::{BuildOptions, LayerOptions, SizingOptions, VolumeOptions, WorkerOptions};

pub fn selection(case: &Case) -> Selection {
    let key = |l: &config::Label| match l {
        config::Label::Number(n) => LabelKey::Number(*n),
        config::Label::Name(name) => LabelKey::Name(name.clone()),
    };
    match (&case.input.label, case.input.threshold) {
        (_, Some(lower)) => Selection::Threshold { lower: Some(lower), upper: None },
        (Labels::One(l), None) => Selection::Label(vec![key(l)]),
        (Labels::Several(l), None) => Selection::Label(l.iter().map(key).collect()),
        (Labels::Unset, None) => Selection::Mask,
    }
}

pub fn unit(units: config::Units) -> LengthUnit {
    match units {
        config::Units::Mm => LengthUnit::Millimetre,
        config::Units::Cm => LengthUnit::Centimetre,
        config::Units::M => LengthUnit::Metre,
        config::Units::Um => LengthUnit::Micrometre,
    }
}

pub fn cleaning(case: &Case) -> CleaningOptions {
    let c = &case.input.cleaning;
    CleaningOptions {
        components: match case.input.components {
            config::Components::Largest => Components::Largest,
            config::Components::All => Components::All,
        },
        min_island: c.min_island.0,
        max_hole: c.max_hole.0,
        contacts: c.contacts,
        ..CleaningOptions::default()
    }
}

pub fn polygonizer(case: &Case) -> PolygonizeOptions {
    let base = match case.reconstruction.profile {
        config::Profile::Paper => PolygonizeOptions::paper(),
        config::Profile::Cfd => PolygonizeOptions::default(),
    };
    PolygonizeOptions {
        cell: case.reconstruction.cell.unwrap_or(base.cell),
        offset: case.reconstruction.offset.unwrap_or(base.offset),
        ..base
    }
}

pub fn method(case: &Case) -> config::Method {
    case.reconstruction.method.unwrap_or(match case.reconstruction.profile {
        config::Profile::Paper => config::Method::Mpu,
        config::Profile::Cfd => config::Method::Smooth,
    })
}

/// Whether the fit is guarded by the mask's boundary from the start.
pub fn guarded(case: &Case, source: &Source) -> bool {
    let own = !matches!(source, Source::Mask) && case.reconstruction.method.is_none();
    !own && method(case) == config::Method::Mpu
}

pub fn repair(case: &Case) -> RepairOptions {
    RepairOptions {
        target_skewness: case.surface.target_skewness,
        max_skewness: case.surface.max_skewness,
        ..RepairOptions::default()
    }
}

/// The volume stage's options; lengths in voxels are of the smallest edge.
pub fn volume(case: &Case, worker: &Path, voxel: f64) -> BuildOptions {
    let v = &case.volume;
    let mut sizing =
        SizingOptions { growth: v.growth, target_cells: v.target_cells.map(|n| n as u64), ..SizingOptions::default() };
    if let AutoLength::Given(l) = v.edge_length {
        match l.unit {
            // Of the local radius, not of one for the whole case.
            config::Unit::Radius => sizing.radius_fraction = l.value,
            config::Unit::Diameter => sizing.radius_fraction = 2.0 * l.value,
            config::Unit::Millimetre | config::Unit::Voxel => sizing.max_edge = Some(l.to_mm(voxel, f64::NAN)),
        }
    }
    let worker = WorkerOptions {
        executable: Some(worker.to_path_buf()),
        time_limit: v.time_limit,
        memory_limit: (v.memory_limit * f64::from(1u32 << 30)) as u64,
        ..WorkerOptions::default()
    };
    let b = &v.boundary_layers;
    let radii = |l: Length| l.value * if l.unit == config::Unit::Diameter { 2.0 } else { 1.0 };
    let mut total = radii(b.total);
    let first_height = match b.first_height {
        AutoLength::Given(l) if matches!(l.unit, config::Unit::Millimetre | config::Unit::Voxel) => Some(l.to_mm(voxel, f64::NAN)),
        AutoLength::Given(l) => {
            // A part of the local radius: so is the thickness of all layers then.
            let series: f64 = (0..b.count).map(|k| b.growth.powi(k as i32)).sum();
            total = total.min(radii(l) * series);
            None
        }
        AutoLength::Auto => None,
    };
    let layers = (b.count > 0)
        .then(|| LayerOptions { count: b.count, growth: b.growth, total, first_height, ..LayerOptions::default() });
    BuildOptions { layers, fill: VolumeOptions { sizing, worker }, ..BuildOptions::default() }
}

pub fn surface_quality(case: &Case) -> SurfaceOptions {
    SurfaceOptions { limit: case.surface.max_skewness, ..SurfaceOptions::default() }
}

/// Whether the chord error is undone: the paper's profile leaves its vertices on the implicit.
pub fn chord_correction(case: &Case) -> bool {
    case.surface.chord_correction.unwrap_or(case.reconstruction.profile == config::Profile::Cfd)
}

/// Skewness aimed at, of wall and of caps.
pub fn skewness_targets(case: &Case) -> [f64; 2] {
    [case.surface.target_skewness, case.surface.target_skewness + 0.05]
}

pub fn cut(case: &Case) -> CutOptions {
    CutOptions { repair: repair(case), ..CutOptions::default() }
}

/// The guidance field's options; lengths in voxels are of the smallest edge, those in R and D of `radius`.
pub fn guidance(case: &Case, voxel: f64, radius: f64) -> GuidanceOptions {
    let s = &case.surface;
    let mm = |l: Length| l.to_mm(voxel, radius);
    let edge_length = match (s.target_faces, s.edge_length) {
        (Some(n), _) => EdgeLength::TargetFaces(n),
        (None, AutoLength::Auto) => EdgeLength::Auto,
        (None, AutoLength::Given(l)) => EdgeLength::Fixed(mm(l)),
    };
    let refine = s.refine.iter().filter_map(|r| {
        let edge_length = mm(r.edge_length);
        match (&r.sphere, &r.cuboid) {
            (Some(b), _) => Some(Refinement::Sphere { center: b.center.into(), radius: b.radius, edge_length }),
            (None, Some(b)) => Some(Refinement::Box { bounds: Aabb { min: b.min.into(), max: b.max.into() }, edge_length }),
            (None, None) => None,
        }
    });
    GuidanceOptions {
        edge_length,
        edges_per_circumference: s.edges_around,
        min: s.min_edge_length.map(mm),
        max: s.max_edge_length.map(mm),
        scale: s.scale,
        gradation: s.growth,
        refine: refine.collect(),
        ..GuidanceOptions::default()
    }
}

/// Parts of the wall with edge lengths of their own, mm; lengths in voxels are of the smallest edge, those in R and D
/// of `radius`.
pub fn patch_edge_lengths(case: &Case, voxel: f64, radius: f64) -> Vec<(&str, Region, f64)> {
    let lengths = case.surface.patches.iter().filter_map(|p| p.edge_length.map(|l| (p.name.as_str(), l.to_mm(voxel, radius))));
    let region = |name: &str| wall_patches(case).into_iter().find(|p| p.0 == name).map(|p| p.1);
    lengths.filter_map(|(name, h)| Some((name, region(name)?, h))).collect()
}

/// Parts of the wall with names of their own.
pub fn wall_patches(case: &Case) -> Vec<(&str, Region)> {
    let region = |p: &config::WallPatch| match (&p.sphere, &p.plane) {
        (Some(b), _) => Some(Region::Ball { center: b.center.into(), radius: b.radius }),
        (None, Some(q)) => Plane::new(q.center.into(), q.normal.into()).map(Region::Beyond),
        (None, None) => None,
    };
    case.surface.patches.iter().filter_map(|p| Some((p.name.as_str(), region(p)?))).collect()
}

pub fn detection(case: &Case) -> DetectOptions {
    let cut = match case.openings.cut {
        config::CutDirection::Auto => CutDirection::Auto,
        config::CutDirection::Square => CutDirection::Square,
        config::CutDirection::AsCut => CutDirection::AsCut,
    };
    DetectOptions { cut, ..DetectOptions::default() }
}

pub fn user_openings(case: &Case) -> UserOpenings {
    let kind = |k: config::OpeningKind| match k {
        config::OpeningKind::Inlet => PatchKind::Inlet,
        config::OpeningKind::Outlet => PatchKind::Outlet,
    };
    let plane = |p: &config::OpeningPlane| UserPlane {
        name: p.name.clone(),
        center: p.center.into(),
        normal: p.normal.into(),
        kind: p.kind.map(kind),
    };
    let o = &case.openings;
    UserOpenings {
        planes: o.planes.iter().map(plane).collect(),
        drop: o.drop.clone(),
        rename: o.rename.iter().map(|r| (r.from.clone(), r.to.clone())).collect(),
        inlets: o.inlet.0.clone(),
    }
}

/// Tilt of a cap to its vessel from which an extension follows the axis, degrees.
const TILTED: f64 = 10.0;

/// The extensions of these openings.
pub fn extensions(
    case: &Case,
    mask: &Mask,
    wall: &dyn Implicit,
    lines: &Centerlines,
    openings: &[Opening],
) -> Result<Vec<Extension>, ExtendError> {
    let voxel = mask.grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    let all = &case.extensions;
    let mut out = Vec::new();
    for o in openings {
        let own = all.openings.get(&o.name).cloned().unwrap_or_default();
        let (length, blend) = (own.length.unwrap_or(all.length), own.blend.unwrap_or(all.blend));
        if length.value == 0.0 {
            continue;
        }
        let radius = crate::openings::equivalent_radius(wall, o)?;
        let direction = match own.direction.unwrap_or(all.direction) {
            config::ExtensionDirection::Normal => Some(o.support.axis).filter(|_| o.tilt() > TILTED),
            config::ExtensionDirection::Centerline => tangent(lines, o),
        };
        let transition = Some(blend.to_mm(voxel, radius)).filter(|b| *b > 0.0);
        out.push(Extension { opening: o.name.clone(), length: length.to_mm(voxel, radius), transition, direction });
    }
    Ok(out)
}

/// The centerline's tangent at an opening, out of the vessel: the mean over half a radius to either side.
fn tangent(lines: &Centerlines, o: &Opening) -> Option<Vector> {
    let from = |s: &Sample| (s.point - o.plane.origin).norm();
    let nearest = |b: &Branch| b.samples.iter().map(from).fold(f64::INFINITY, f64::min);
    let branch = lines.branches.iter().min_by(|a, b| nearest(a).total_cmp(&nearest(b)))?;
    let near = branch.samples.iter().filter(|s| from(s) <= 0.5 * o.radius.max(2.0 * nearest(branch)));
    let sum: Vector = near.map(|s| s.tangent).sum();
    let outward = if sum.dot(&o.plane.normal) < 0.0 { -sum } else { sum };
    outward.try_normalize(0.0)
}

/// The flow of the case; the waveform is read by the caller.
pub fn flow(case: &Case, waveform: Option<Waveform>) -> FlowOptions {
    let f = &case.flow;
    let inflow = match (f.inlet.reynolds, f.inlet.flow_rate, f.inlet.velocity) {
        (_, Some(q), _) => Inflow::FlowRate(q * 1e-6),
        (_, _, Some(v)) => Inflow::Velocity(v),
        (re, _, _) => Inflow::Reynolds(re.unwrap_or(300.0)),
    };
    let split = match f.outlets.split {
        config::Split::Murray => OutletSplit::Murray,
        config::Split::Area => OutletSplit::Area,
        config::Split::Fractions => OutletSplit::Fractions(shares(&f.outlets.fractions)),
        config::Split::Resistance => OutletSplit::Resistance(shares(&f.outlets.resistances)),
        config::Split::Pressure => OutletSplit::Pressure,
    };
    let profile = match f.inlet.profile {
        config::VelocityProfile::Parabolic => Profile::Parabolic,
        config::VelocityProfile::Flat => Profile::Flat,
    };
    FlowOptions {
        inflow,
        square_areas: Default::default(),
        inlet_fractions: Some(&f.inlet.fractions).filter(|s| !s.is_empty()).map(shares),
        profile,
        split,
        viscosity: viscosity(&f.blood),
        density: f.blood.density,
        waveform,
        cycles: f.cycles,
        max_courant: f.max_courant,
        processes: f.processes,
    }
}

fn shares(given: &config::Shares) -> Shares {
    match given {
        config::Shares::InOrder(list) => Shares::InOrder(list.clone()),
        config::Shares::ByName(map) => Shares::ByName(map.clone()),
    }
}

/// The model with its own defaults where the case says nothing.
fn viscosity(blood: &config::Blood) -> Viscosity {
    let base = match blood.model {
        config::Viscosity::Newtonian => FlowOptions::default().viscosity,
        config::Viscosity::Casson => Viscosity::CASSON,
        config::Viscosity::Carreau => Viscosity::CARREAU,
    };
    match base {
        Viscosity::Newtonian { mu } => Viscosity::Newtonian { mu: blood.viscosity.unwrap_or(mu) },
        Viscosity::Casson { mu_inf, tau0, mu_max } => Viscosity::Casson {
            mu_inf: blood.viscosity.unwrap_or(mu_inf),
            tau0: blood.yield_stress.unwrap_or(tau0),
            mu_max: blood.max_viscosity.unwrap_or(mu_max),
        },
        Viscosity::Carreau { mu0, mu_inf, lambda, n } => Viscosity::Carreau {
            mu0: blood.rest_viscosity.unwrap_or(mu0),
            mu_inf: blood.viscosity.unwrap_or(mu_inf),
            lambda: blood.time_constant.unwrap_or(lambda),
            n: blood.exponent.unwrap_or(n),
        },
    }
}
