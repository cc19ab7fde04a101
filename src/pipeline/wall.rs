//! A component's wall, polygonized, with the mask's topology: what is done, in turn, where the fit's surface has another.

use super::{Clock, Error, Source, options, reconstruct};
use crate::config::Case;
use crate::implicit::Implicit;
use crate::implicit::guard::{GuardOptions, Guarded, MaskBoundary};
use crate::implicit::mended::Mended;
use crate::mask::{Mask, Topology};
use crate::mesh::{self, TriMesh};
use crate::polygonize::{self, Difference, PolygonizeOptions, PolygonizeSummary};
use crate::remesh::Stop;
use crate::report::Report;

/// Factors on the polygonizer's cells, where the narrowest guard still leaves another topology than the mask's: two sheets
/// nearer than a cell are one where no corner of the lattice lies between them.
const FINER: [f64; 2] = [0.7, 0.5];

/// Voxels round what the guard changes that it acts in too; the second where the first leave another topology.
const ROOM: [i64; 2] = [1, 3];

/// Steps towards the guard's band that are tried, the fewest first: more of them bring the stairs of the voxels.
const STEPS: [usize; 5] = [1, 2, 4, 8, 20];

/// Voxels along an axis from which on a place is not made smaller.
const SMALL: i64 = 6;

/// Surfaces made at most to find where a wall is to be mended.
const SURFACES: usize = 40;

/// A component's wall and its polygons.
pub(super) struct Polygonized {
    pub implicit: Box<dyn Implicit>,
    /// Whether the mask is noisy.
    pub noisy: bool,
    pub polygons: TriMesh,
    pub summary: PolygonizeSummary,
    /// How they were made.
    pub options: PolygonizeOptions,
}

/// The wall of `mask`, with the topology `wanted` as far as the fit kept strictly, ever narrower guards and finer cells bring
/// it there. What was done stands in the report; where all of it fails a gate tells.
pub(super) fn polygonized(case: &Case, source: &Source, clock: &mut Clock, report: &mut Report, mask: &Mask, wanted: &Topology) -> Result<Polygonized, Error> {
    let context = clock.context;
    let mut options = options::polygonizer(case);
    let described = |p: &(TriMesh, PolygonizeSummary)| format!("{} triangles", p.0.triangles.len());
    let reconstruct::Wall { mut implicit, noisy } = clock.run("reconstruct", || reconstruct::reconstruct(case, source, mask, report), |_| String::new())?;
    let (mut polygons, mut summary) = clock.run("polygonize", || polygonize::polygonize(implicit.as_ref(), mask, &options), described)?;
    let as_wanted = |surface: &TriMesh| {
        // Of a closed surface, which has three edges for two triangles, vertices and triangles tell the Euler number: enough
        // to refuse most.
        let euler = surface.points.len() as i64 - surface.triangles.len() as i64 / 2;
        euler == 2 * wanted.euler && {
            let topology = mesh::topology::check(surface);
            (topology.euler, topology.components) == (2 * wanted.euler, wanted.components)
        }
    };
    let unlike = |surface: &TriMesh| {
        let (found, twice) = (mesh::topology::check(surface), 2 * wanted.euler);
        format!("the surface has another topology than the mask (Euler number {} instead of {twice}, {} parts instead of {})", found.euler, found.components, wanted.components)
    };
    // On a noisy mask the fit gives up labels, which can go too far.
    if !as_wanted(&polygons)
        && let Some(f) = clock.run("reconstruct", || reconstruct::strictly(case, source, mask, report), |_| String::new())?
    {
        context.progress.explain(&format!("{}: every label that it might need is kept", unlike(&polygons)));
        implicit = f;
        (polygons, summary) = clock.run("polygonize", || polygonize::polygonize(implicit.as_ref(), mask, &options), described)?;
    }
    // The guard costs smoothness where it acts: it is taken where the fit alone has another topology than the mask, and
    // drawn narrower where its band still lets sheets meet. It shows where the topology is to be mended: there the fit is drawn
    // towards it smoothly, and where that does not do, the guard itself stays there alone.
    let mut guards = GuardOptions::default().narrower().peekable();
    if options::guarded(case, source) {
        guards.next();
    }
    let alone = if as_wanted(&polygons) { TriMesh::default() } else { polygons.clone() };
    while let Some(guard) = guards.next_if(|_| !as_wanted(&polygons)) {
        context.progress.explain(&format!("{}: it is held within {:.2} voxel diagonals of the mask's boundary", unlike(&polygons), guard.band));
        let boundary = MaskBoundary::new(mask, &guard).ok_or(Error::EmptyComponent)?;
        let mut guarded = Guarded::new(implicit, boundary);
        (polygons, summary) = clock.run("polygonize", || polygonize::polygonize(&guarded, mask, &options), described)?;
        report.put_in("reconstruction", "guard", &guard);
        if !as_wanted(&polygons) {
            report.put_in("reconstruction", "guarded", &true);
            // A narrower one is laid on the fit itself.
            implicit = if guards.peek().is_some() { guarded.into_inner() } else { Box::new(guarded) };
            continue;
        }
        if !options::guarded(case, source) {
            let (f, boundary) = guarded.into_parts();
            let mut mender = Mender { boundary: &boundary, mask, options: &options, as_wanted: &as_wanted, stop: &context.stop(), left: SURFACES };
            let found = clock.run("polygonize", || mender.places(&f, &alone, &polygons), |_| String::new())?;
            if let Some((voxels, steps)) = found {
                let mended = Mended::towards(f, &mask.grid, &boundary, &voxels, steps);
                (polygons, summary) = clock.run("polygonize", || polygonize::polygonize(&mended, mask, &options), described)?;
                context.progress.explain(&format!("the fit is drawn smoothly towards it in {} voxels alone, which is enough", voxels.len()));
                report.put_in("reconstruction", "mended", &serde_json::json!({"voxels": voxels.len(), "steps": steps}));
                implicit = Box::new(mended);
                break;
            }
            guarded = Guarded::new(f, boundary);
        }
        report.put_in("reconstruction", "guarded", &true);
        for grow in ROOM {
            let places: Vec<Difference> = polygonize::differences(&alone, &polygons, &mask.grid, grow).into_iter().filter(|d| d.euler != 0).collect();
            // Without places the surface would be the one of the fit alone.
            if places.is_empty() {
                continue;
            }
            guarded = guarded.only_in(places.iter().flat_map(|d| &d.voxels));
            let local = clock.run("polygonize", || polygonize::polygonize(&guarded, mask, &options), described)?;
            if as_wanted(&local.0) {
                context.progress.explain(&format!("it is held there in {} places alone; elsewhere the fit is as good without", places.len()));
                report.put_in("reconstruction", "guarded_places", &places.len());
                (polygons, summary) = local;
                break;
            }
            guarded = guarded.everywhere();
        }
        implicit = Box::new(guarded);
    }
    for factor in FINER {
        if as_wanted(&polygons) {
            break;
        }
        let finer = PolygonizeOptions { cell: factor * options::polygonizer(case).cell, ..options };
        context.progress.explain(&format!("{}: it is polygonized with cells of {:.2} voxels", unlike(&polygons), finer.cell));
        (polygons, summary) = clock.run("polygonize", || polygonize::polygonize(implicit.as_ref(), mask, &finer), described)?;
        report.put_in("reconstruction", "finer_cells", &finer.cell);
        options = finer;
    }
    Ok(Polygonized { implicit, noisy, polygons, summary, options })
}

/// Mends a wall's topology in as few voxels as it takes.
struct Mender<'a> {
    boundary: &'a MaskBoundary,
    mask: &'a Mask,
    options: &'a PolygonizeOptions,
    as_wanted: &'a dyn Fn(&TriMesh) -> bool,
    stop: &'a Stop<'a>,
    /// Surfaces that may still be made.
    left: usize,
}

type Voxels = Vec<[i64; 3]>;

impl Mender<'_> {
    /// The steps that bring the topology where `f` is drawn to the guard's band in `voxels`.
    fn steps(&mut self, f: &dyn Implicit, voxels: &Voxels) -> Result<Option<usize>, Error> {
        for steps in STEPS {
            if self.mends(f, voxels, steps)? {
                return Ok(Some(steps));
            }
        }
        Ok(None)
    }

    fn mends(&mut self, f: &dyn Implicit, voxels: &Voxels, steps: usize) -> Result<bool, Error> {
        if (self.stop)() {
            return Err(Error::Interrupted);
        }
        self.left = self.left.saturating_sub(1);
        let mended = Mended::towards(f, &self.mask.grid, self.boundary, voxels, steps);
        Ok((self.as_wanted)(&polygonize::polygonize(&mended, self.mask, self.options)?.0))
    }

    /// Few of `voxels`, which with those of `kept` mend the topology, that still do: halves of them are left out, as long as
    /// that is possible.
    fn fewest(&mut self, f: &dyn Implicit, voxels: Voxels, kept: &Voxels, steps: usize) -> Result<Voxels, Error> {
        let extent = |v: &Voxels, a: usize| v.iter().map(|v| v[a]).max().unwrap_or(0) - v.iter().map(|v| v[a]).min().unwrap_or(0);
        let axis = (0..3).max_by_key(|&a| extent(&voxels, a)).unwrap_or(0);
        if extent(&voxels, axis) < SMALL || self.left == 0 {
            return Ok(voxels);
        }
        let mut along: Vec<i64> = voxels.iter().map(|v| v[axis]).collect();
        along.sort_unstable();
        let middle = along[along.len() / 2];
        let (low, high): (Voxels, Voxels) = voxels.into_iter().partition(|v| v[axis] < middle);
        for (half, other) in [(&low, &high), (&high, &low)] {
            if !other.is_empty() && self.mends(f, &[half.as_slice(), kept].concat(), steps)? {
                return self.fewest(f, half.clone(), kept, steps);
            }
        }
        if low.is_empty() || high.is_empty() {
            return Ok([low, high].concat());
        }
        let low = self.fewest(f, low, &[high.as_slice(), kept].concat(), steps)?;
        let high = self.fewest(f, high, &[low.as_slice(), kept].concat(), steps)?;
        Ok([low, high].concat())
    }

    /// The voxels in which `f` is to be mended and by how many steps, where that brings the topology.
    fn places(&mut self, f: &dyn Implicit, alone: &TriMesh, guarded: &TriMesh) -> Result<Option<(Voxels, usize)>, Error> {
        let all = polygonize::differences(alone, guarded, &self.mask.grid, ROOM[0]);
        let those: Vec<Difference> = all.iter().filter(|d| d.euler != 0).cloned().collect();
        // Where no place is left out, or none is left, the second is the only one.
        let tries = if those.is_empty() || those.len() == all.len() { vec![all] } else { vec![those, all] };
        for places in tries {
            let voxels: Voxels = places.into_iter().flat_map(|d| d.voxels).collect();
            if let Some(steps) = self.steps(f, &voxels)? {
                return Ok(Some((self.fewest(f, voxels, &Vec::new(), steps)?, steps)));
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Vector};
    use crate::mask::{Grid, clean, crop_pad, split_components, topology};
    use crate::pipeline::{Context, Silent, Stage};

    /// Two tubes that nearly touch, in long voxels.
    fn tubes(seed: u64) -> Mask {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let long = 1.0 + (seed % 6) as f64;
        let spacing = [1.0, 1.0, long];
        let dims = [26, 26, (26.0 / long).ceil() as usize + 3];
        let grid = Grid::new(dims, spacing, Point::origin(), nalgebra::Matrix3::identity()).expect("a grid");
        let mut unit = || Vector::new(next() - 0.5, next() - 0.5, next() - 0.5).normalize();
        let (u, v) = (unit(), unit());
        let w = u.cross(&v).normalize();
        let (r, s, gap) = (1.2 + 2.0 * next(), 1.2 + 2.0 * next(), -0.3 + 1.5 * next());
        let c = Vector::from_fn(|a, _| 0.5 * (dims[a] as f64 - 1.0) * spacing[a]) + Vector::new(next(), next(), next());
        let (p, q) = (c - w * (r + 0.5 * gap), c + w * (s + 0.5 * gap));
        let off = |x: &Vector, axis: &Vector| (x - axis * x.dot(axis)).norm();
        let lumen = |n: usize| {
            let i = grid.voxel(n);
            let x = Vector::from_fn(|a, _| i[a] as f64 * spacing[a]);
            (0..3).all(|a| i[a] > 0 && i[a] + 1 < dims[a]) && (off(&(x - p), &u) < r || off(&(x - q), &v) < s)
        };
        let data = (0..grid.len()).map(|n| u8::from(lumen(n))).collect();
        let (mask, _) = clean(&Mask::new(grid, data), &Default::default()).expect("a mask");
        crop_pad(&split_components(&mask).swap_remove(0), 4, 4)
    }

    fn made(mask: &Mask) -> (Polygonized, serde_json::Value) {
        let case: Case = serde_saphyr::from_str("input: {mask: none.nrrd}").expect("a case");
        let cancel = std::sync::atomic::AtomicBool::new(false);
        let context = Context { stop_after: Stage::Reconstruction, progress: &Silent, cancel: &cancel, worker: Default::default() };
        let mut clock = Clock { context: &context, stages: Vec::new() };
        let mut report = Report::default();
        let wall = polygonized(&case, &Source::Mask, &mut clock, &mut report, mask, &topology(mask)).expect("a wall");
        (wall, serde_json::to_value(&report).expect("a report")["reconstruction"].clone())
    }

    /// Whether a surface has the topology of its mask.
    fn alike(surface: &TriMesh, mask: &Mask) -> bool {
        let (found, wanted) = (mesh::topology::check(surface), topology(mask));
        found.is_closed_manifold() && (found.euler, found.components) == (2 * wanted.euler, wanted.components)
    }

    #[test]
    fn a_fit_with_another_topology_is_mended_in_few_voxels_and_elsewhere_stays_as_it_is() {
        for seed in [41, 82] {
            let mask = tubes(seed);
            let (fit, _) = crate::implicit::smooth::fit(&mask, &Default::default()).expect("a fit");
            let (alone, _) = polygonize::polygonize(&fit, &mask, &Default::default()).expect("a surface");
            assert!(!alike(&alone, &mask), "{seed}: the fit alone is good");
            let (wall, said) = made(&mask);
            assert!(alike(&wall.polygons, &mask), "{seed}: {said}");
            assert!(said["mended"]["voxels"].as_u64().is_some_and(|n| n < 400), "{seed}: {said}");
            let changed = alone.points.iter().filter(|p| fit.value(p) != wall.implicit.value(p)).count();
            assert!(changed > 0 && 3 * changed < alone.points.len(), "{seed}: {changed} of {}", alone.points.len());
        }
    }

    #[test]
    fn where_a_smooth_change_does_not_do_the_guard_stays() {
        let mask = tubes(5);
        let (wall, said) = made(&mask);
        assert!(alike(&wall.polygons, &mask), "{said}");
        assert!(said["guarded_places"].as_u64().is_some_and(|n| n > 0), "{said}");
    }
}
