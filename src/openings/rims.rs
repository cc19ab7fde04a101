//! Rims and caps after the cuts: remeshed and repaired with the wall round them, each by itself.

use rayon::prelude::*;
use serde::Serialize;

use crate::mesh::{TriMesh, WALL};
use crate::remesh::angle_repair::{Badness, RepairOptions};
use crate::remesh::cutout::{self, Cutout, Fans};
use crate::remesh::last_resort::{Rung, Try, climb, make, score, sound};
use crate::remesh::{Normals, SizeField, Stop, Supports};

/// How rims and caps are remeshed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RimOptions {
    /// Rings of triangles round a cap that may change, one attempt after the other until no triangle is above the
    /// target.
    pub rings: Vec<usize>,
    /// Factors on the wished edge length in the middle of the cap, for the last number of rings.
    pub sizes: Vec<f64>,
}

impl Default for RimOptions {
    fn default() -> Self {
        RimOptions { rings: vec![6, 8], sizes: vec![0.8, 1.2, 0.6] }
    }
}

/// What became of one rim, or of several so near to each other that they were remeshed together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RimSummary {
    /// Patches of the caps.
    pub caps: Vec<u32>,
    /// Attempts made.
    pub attempts: usize,
    /// Rings of the attempt that was kept.
    pub rings: usize,
    /// Factor on the edge length of the attempt that was kept.
    pub size: f64,
    /// Triangles above the target.
    pub above_target: usize,
}

/// Remeshes all caps and what lies round them; then, by themselves, places that are still above the target.
pub(super) fn remesh(
    mesh: &TriMesh,
    supports: &Supports,
    field: &dyn SizeField,
    options: &RimOptions,
    repair: &RepairOptions,
    stop: &Stop,
) -> (TriMesh, Vec<RimSummary>, Vec<Rung>) {
    let caps: Vec<u32> = (0..mesh.triangles.len() as u32).filter(|&t| mesh.patch[t as usize] != WALL).collect();
    let widest = options.rings.iter().copied().max().unwrap_or(4);
    let fans = Fans::new(mesh);
    // Parts that share no vertex even at the widest: so each can take the room that it needs.
    let done: Vec<(Option<(Cutout, TriMesh)>, RimSummary)> = cutout::parts(mesh, &fans, &caps, widest)
        .into_par_iter()
        .map(|part| one(mesh, &fans, &part, supports, field, options, repair))
        .collect();
    let (made, summaries): (Vec<_>, Vec<_>) = done.into_iter().unzip();
    let made: Vec<(Cutout, TriMesh)> = made.into_iter().flatten().collect();
    let mesh = cutout::put_back(mesh, &made);
    // What is left above the target is remeshed by itself, wherever it lies.
    let (mesh, last_resort) = if repair.last_resort { climb(mesh, supports, field, repair, stop) } else { (mesh, Vec::new()) };
    (mesh, summaries, last_resort)
}

fn one(
    mesh: &TriMesh,
    fans: &Fans,
    part: &[u32],
    supports: &Supports,
    field: &dyn SizeField,
    options: &RimOptions,
    repair: &RepairOptions,
) -> (Option<(Cutout, TriMesh)>, RimSummary) {
    let seeds: Vec<u32> = part.iter().copied().filter(|&t| mesh.patch[t as usize] != WALL).collect();
    let mut caps: Vec<u32> = seeds.iter().map(|&t| mesh.patch[t as usize]).collect();
    caps.sort_unstable();
    caps.dedup();
    let badness = Badness::new(repair.target_skewness);
    let attempt = |rings: usize, size: f64, normals: Normals| Try { rings, size, normals, remesh: true };
    let widest = options.rings.iter().copied().max().unwrap_or(4);
    let ladder = options
        .rings
        .iter()
        .map(|&r| attempt(r, 1.0, Normals::Gradient))
        .chain([attempt(widest, 1.0, Normals::Averaged)])
        .chain(options.sizes.iter().map(|&s| attempt(widest, s, Normals::Averaged)));
    let mut best: Option<(Vec<u32>, bool, Cutout, TriMesh, Try)> = None;
    let mut attempts = 0;
    for attempt in ladder {
        attempts += 1;
        let cutout = Cutout::new(mesh, fans, fans.grown(mesh, &seeds, attempt.rings));
        let centers: Vec<_> = caps
            .iter()
            .map(|&id| {
                let corners: Vec<_> = seeds.iter().filter(|&&t| mesh.patch[t as usize] == id).flat_map(|&t| mesh.corners(t as usize)).collect();
                crate::geometry::Aabb::of(&corners).center()
            })
            .collect();
        let Some(new) = make(&cutout, supports, field, repair, attempt, &centers) else { continue };
        let list = score(&cutout, &new, badness);
        let sound = sound(&cutout, &new);
        let good = sound && list.is_empty();
        // Sound before shapely.
        if best.as_ref().is_none_or(|b| (!sound, &list) < (!b.1, &b.0)) {
            best = Some((list, sound, cutout, new, attempt));
        }
        if good {
            break;
        }
    }
    match best {
        Some((list, _, cutout, new, kept)) => {
            let summary = RimSummary { caps, attempts, rings: kept.rings, size: kept.size, above_target: list.len() };
            (Some((cutout, new)), summary)
        }
        None => (None, RimSummary { caps, attempts, rings: 0, size: 1.0, above_target: seeds.len() }),
    }
}
