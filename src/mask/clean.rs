//! Bounded, listed repair of a mask: islands, cavities, holes at the border, noise tunnels, corner contacts.

use serde::Serialize;

use super::components::{Connectivity, label, label_data};
use super::topology::topology_of;
use super::workspace::Workspace;
use super::{Error, Mask, Topology, contacts, noise, tunnels};

/// Which connected parts stay.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Components {
    /// The largest; ties go to the first in scan order.
    #[default]
    Largest,
    /// All that have at least `min_island` voxels.
    All,
}

/// What may be repaired.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CleaningOptions {
    /// Which connected parts stay.
    pub components: Components,
    /// With [`Components::All`], parts below this many voxels are islands and go. Default 27.
    pub min_island: usize,
    /// A tunnel is closed where its narrowest section is at most two voxels wide and has at most this many voxels; a
    /// hole in the lumen's section at the image border is filled up to this many voxels. 0 closes none. Default 27.
    pub max_hole: usize,
    /// Undo contacts of voxels at an edge or corner only. Default true: the surface can be no 2-manifold otherwise.
    pub contacts: bool,
    /// How many changes of each kind are listed with their coordinates; totals always count all. Default 100.
    pub listed: usize,
}

impl Default for CleaningOptions {
    fn default() -> CleaningOptions {
        CleaningOptions {
            components: Components::Largest,
            min_island: 27,
            max_hole: 27,
            contacts: true,
            listed: 100,
        }
    }
}

/// What a change did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// A component was dropped.
    IslandDropped,
    /// A cavity was filled.
    CavityFilled,
    /// A hole in the lumen's section at the image border was filled.
    BorderHoleFilled,
    /// A tunnel was closed.
    TunnelClosed,
    /// A voxel was added where others touched at an edge or corner only.
    ContactFilled,
    /// A voxel was taken away where it touched another at an edge or corner only.
    ContactCut,
}

/// One change.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// What was done.
    pub kind: ChangeKind,
    /// Middle of the voxels concerned, LPS mm.
    pub center: [f64; 3],
    /// How many voxels were flipped.
    pub voxels: usize,
}

/// How much was done of one kind.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Total {
    /// What was done.
    pub kind: ChangeKind,
    /// Number of changes.
    pub changes: usize,
    /// Number of voxels flipped.
    pub voxels: usize,
}

/// What cleaning found and did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CleaningReport {
    /// Topology of the mask as it came.
    pub before: Topology,
    /// Topology of the cleaned mask.
    pub after: Topology,
    /// 2×2×2 blocks with a contact at an edge or corner only, as the mask came and after.
    pub contacts: [usize; 2],
    /// Lumen voxels as the mask came and after.
    pub voxels: [usize; 2],
    /// By kind; kinds of which nothing was done are left out.
    pub totals: Vec<Total>,
    /// The changes with their places, the largest of each kind first, up to the listing bound.
    pub changes: Vec<Change>,
}

/// Rounds of repair: each repair can make work for another.
const ROUNDS: usize = 6;

/// Repairs a mask within the bounds of `options` and lists every change.
///
/// The result is well-composed (no contacts at an edge or corner only) unless `contacts` is off, has no cavity: vessels
/// are not hollow; and its 26-connected parts are those that `components` asks for. Vessels that run side by side one
/// background voxel apart stay apart. Deterministic; O(voxels) of the lumen's bounding box.
///
/// # Errors
/// [`Error::NothingLeft`] where every component is below `min_island` or the mask is empty.
pub fn clean(mask: &Mask, options: &CleaningOptions) -> Result<(Mask, CleaningReport), Error> {
    let mut log = Log { mask, changes: Vec::new() };
    let empty = Error::NothingLeft { min_voxels: options.min_island, largest: 0 };
    let before = super::topology(mask);
    let kept = drop_islands(mask, options, &mut log)?;
    let noisy = noise::estimate(&kept, &super::interface(&kept)) > 0.0;
    let mut work = Workspace::new(&kept).ok_or(empty)?;
    drop(kept);
    let contacts_before = Workspace::new(mask).map_or(0, |w| contacts::count(&w));
    let spacing = mask.grid.spacing();

    let mut after = Topology::default();
    for round in 0..ROUNDS {
        let changes = log.changes.len();
        fill_cavities(&mut work, &mut log);
        if options.max_hole > 0 {
            fill_border_holes(&mut work, options.max_hole, &mut log);
        }
        if options.contacts {
            let flips = contacts::resolve(&mut work, noisy);
            flips.filled.iter().for_each(|&n| log.add(ChangeKind::ContactFilled, &work, &[n]));
            flips.removed.iter().for_each(|&n| log.add(ChangeKind::ContactCut, &work, &[n]));
        }
        after = topology_of(&work.data, work.dims);
        if options.max_hole > 0 && after.tunnels > 0 && round + 1 < ROUNDS {
            for span in tunnels::close(&mut work, spacing, options.max_hole) {
                log.add(ChangeKind::TunnelClosed, &work, &span);
            }
        }
        if log.changes.len() == changes {
            break;
        }
    }
    let contacts_after = contacts::count(&work);
    let cleaned = work.write_back(mask);
    let voxels = [mask.count(), cleaned.count()];
    let (totals, changes) = log.summary(options.listed);
    Ok((cleaned, CleaningReport { before, after, contacts: [contacts_before, contacts_after], voxels, totals, changes }))
}

/// Collects changes.
struct Log<'a> {
    mask: &'a Mask,
    changes: Vec<Change>,
}

impl Log<'_> {
    fn add(&mut self, kind: ChangeKind, work: &Workspace, voxels: &[usize]) {
        let center = work.center(self.mask, voxels.iter().copied()).into();
        self.changes.push(Change { kind, center, voxels: voxels.len() });
    }

    fn summary(mut self, listed: usize) -> (Vec<Total>, Vec<Change>) {
        self.changes.sort_by_key(|c| (c.kind, std::cmp::Reverse(c.voxels)));
        let mut totals = Vec::new();
        let mut changes = Vec::new();
        for same in self.changes.chunk_by(|a, b| a.kind == b.kind) {
            totals.push(Total { kind: same[0].kind, changes: same.len(), voxels: same.iter().map(|c| c.voxels).sum() });
            changes.extend_from_slice(&same[..same.len().min(listed)]);
        }
        (totals, changes)
    }
}

fn drop_islands(mask: &Mask, options: &CleaningOptions, log: &mut Log) -> Result<Mask, Error> {
    let labels = label(mask, true, Connectivity::TwentySix);
    let parts = labels.components();
    let largest = parts.iter().map(|c| c.voxels).max().unwrap_or(0);
    let keep: Vec<bool> = match options.components {
        Components::Largest => {
            let first = parts.iter().position(|c| c.voxels == largest);
            (0..parts.len()).map(|c| Some(c) == first).collect()
        }
        Components::All => parts.iter().map(|c| c.voxels >= options.min_island).collect(),
    };
    if !keep.contains(&true) {
        return Err(Error::NothingLeft { min_voxels: options.min_island, largest });
    }
    let mut out = mask.clone();
    labels.paint(&mut out.data, 0, |l| !keep[l as usize]);
    for (c, part) in parts.iter().enumerate().filter(|(c, _)| !keep[*c]) {
        let mut sum = crate::geometry::Vector::zeros();
        labels.for_each_run(c as u32, |j, k, x0, x1| {
            let n = (x1 - x0) as f64;
            sum += crate::geometry::Vector::new((x0 + x1 - 1) as f64 / 2.0, j as f64, k as f64) * n;
        });
        let center = mask.grid.to_world(sum / part.voxels as f64).into();
        log.changes.push(Change { kind: ChangeKind::IslandDropped, center, voxels: part.voxels });
    }
    Ok(out)
}

fn fill_cavities(work: &mut Workspace, log: &mut Log) {
    let labels = label_data(&work.data, work.dims, false, Connectivity::Six);
    let fill: Vec<bool> = labels.components().iter().map(|c| !c.on_border).collect();
    let [nx, ny, _] = work.dims;
    for c in (0..fill.len()).filter(|&c| fill[c]) {
        let mut voxels = Vec::new();
        labels.for_each_run(c as u32, |j, k, x0, x1| {
            let row = (k * ny + j) * nx;
            voxels.extend(row + x0..row + x1);
        });
        log.add(ChangeKind::CavityFilled, work, &voxels);
    }
    labels.paint(&mut work.data, 1, |l| fill[l as usize]);
}

/// Fills holes of the lumen's section in the picture's border planes: beyond them the vessel goes on, and the hole too.
fn fill_border_holes(work: &mut Workspace, max_hole: usize, log: &mut Log) {
    let [nx, ny, _] = work.dims;
    let strides = [1, nx, nx * ny];
    for axis in 0..3 {
        for side in 0..2 {
            let Some(plane) = work.border_plane(axis, side) else { continue };
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let (nu, nv) = (work.dims[u], work.dims[v]);
            let at = |n: usize| plane * strides[axis] + n % nu * strides[u] + n / nu * strides[v];
            let section: Vec<u8> = (0..nu * nv).map(|n| work.data[at(n)]).collect();
            // A plane is an array of one layer, whose every component is on its border in the third direction.
            let labels = label_data(&section, [nu, nv, 1], false, Connectivity::Six);
            for (c, part) in labels.components().iter().enumerate() {
                let [[u0, u1], [v0, v1], _] = part.bounds;
                let inside = u0 > 0 && v0 > 0 && u1 + 1 < nu && v1 + 1 < nv;
                if inside && part.voxels <= max_hole {
                    let mut voxels = Vec::new();
                    labels.for_each_run(c as u32, |j, _, x0, x1| voxels.extend((x0..x1).map(|x| at(j * nu + x))));
                    voxels.iter().for_each(|&n| work.data[n] = 1);
                    log.add(ChangeKind::BorderHoleFilled, work, &voxels);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
