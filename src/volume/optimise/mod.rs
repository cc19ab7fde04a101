//! Slivers go: smoothing for the mean, then exchanges worst-first. The surface is frozen.
//!
//! After Klingner & Shewchuk, "Aggressive tetrahedral mesh improvement" (2007), with 1 − equi-volume skewness as the
//! measure and the optimal-Delaunay smoothing of Chen (2004) before. Every exchange raises the worst score of what it
//! touches, so the worst tetrahedron never gets worse. The order of work is fixed: the same mesh gives the same result
//! with any number of threads.

mod cavity;
mod complex;
mod flips;
pub mod quality;
mod restart;
mod smooth;

use rayon::prelude::*;
use serde::Serialize;

use crate::geometry::Point;
use crate::mesh::VolumeMesh;
use complex::{Complex, Exchange};

/// How far the optimiser goes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OptimiseOptions {
    /// Rounds of smoothing over all vertices before the exchanges, and half as many in their middle.
    pub smoothing_rounds: u32,
    /// Tetrahedra with an equi-volume skewness above this are worked on.
    pub work_above: f64,
    /// Above this, vertices are inserted too.
    pub insert_above: f64,
    /// Most passes over the bad tetrahedra, half of them before the second smoothing.
    pub passes: u32,
    /// Above this, neighbourhoods are worked on again from other positions at the end.
    pub restart_above: f64,
    /// Most rounds of that.
    pub restarts: u32,
}

impl Default for OptimiseOptions {
    fn default() -> Self {
        OptimiseOptions { smoothing_rounds: 4, work_above: 0.6, insert_above: 0.75, passes: 8, restart_above: 0.75, restarts: 3 }
    }
}

/// Equi-volume skewness and dihedral angles of a set of tetrahedra.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct TetQuality {
    /// Largest equi-volume skewness.
    pub max: f64,
    /// Its mean.
    pub mean: f64,
    /// Tetrahedra above 0.8.
    pub over_080: usize,
    /// Least dihedral angle, degrees.
    pub min_dihedral: f64,
    /// Largest dihedral angle, degrees.
    pub max_dihedral: f64,
    /// Tetrahedra with two or more faces on the boundary.
    pub two_boundary_faces: usize,
}

/// What the optimiser did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct OptimiseSummary {
    /// Before.
    pub before: TetQuality,
    /// After.
    pub after: TetQuality,
    /// Moves of vertices for the mean.
    pub smoothed: usize,
    /// Moves of vertices for the worst.
    pub relaxed: usize,
    /// Edges removed (3-2, 4-4 and larger rings).
    pub edges_removed: usize,
    /// 2-3 flips.
    pub faces_flipped: usize,
    /// Edges contracted.
    pub contracted: usize,
    /// Vertices inserted.
    pub inserted: usize,
    /// Neighbourhoods that became better from another start.
    pub restarted: usize,
    /// Passes over the bad tetrahedra.
    pub passes: u32,
    /// Seconds.
    #[serde(skip_serializing)]
    pub seconds: f64,
}

/// Improves the tetrahedra of `mesh`; its boundary faces, the points on them and its prisms stay as they are.
///
/// Points on the boundary or of prisms keep their ids and stand first if they did. No tetrahedron ends up worse than
/// the worst at the beginning; one with two faces on the boundary counts as worse than any other, since OpenFOAM's
/// determinant is 0 there. Not guaranteed: that the targets are reached, when the surface does not allow it.
pub fn optimise(mesh: &mut VolumeMesh, options: &OptimiseOptions) -> OptimiseSummary {
    optimise_until(mesh, options, &|| false)
}

/// As [`optimise`]; ends early, with a valid mesh that is not as good, once `stop` says so.
pub(super) fn optimise_until(mesh: &mut VolumeMesh, options: &OptimiseOptions, stop: &dyn Fn() -> bool) -> OptimiseSummary {
    let begin = std::time::Instant::now();
    let boundary = check_free_boundary(mesh);
    let mut c = Complex::new(std::mem::take(&mut mesh.points), std::mem::take(&mut mesh.tets), boundary.into_iter());
    for v in mesh.prisms.iter().flatten() {
        c.frozen[*v as usize] = true;
    }
    let mut s = OptimiseSummary { before: measure(&c), ..OptimiseSummary::default() };
    let work = 1.0 - options.work_above;
    let insert = 1.0 - options.insert_above;
    // Flips first: smoothing is held up by flat tetrahedra.
    let mut effort = Effort::new(work, None, false);
    exchange(&mut c, &mut effort, &mut s);
    for half in 0..2 {
        let mut sweeps = smooth::Sweeps::new(&c);
        for _ in 0..options.smoothing_rounds.div_ceil(1 + half) {
            if stop() {
                break;
            }
            s.smoothed += sweeps.round(&mut c);
        }
        c.rescore();
        effort = Effort::new(work, (half > 0).then_some(insert), true);
        for _ in 0..options.passes.div_ceil(2) {
            s.passes += 1;
            if stop() || exchange(&mut c, &mut effort, &mut s) == 0 {
                break;
            }
        }
    }
    // What is left: first the wedges at any price, then whatever came out poor.
    c.strict = true;
    c.rescore();
    for _ in 0..3 {
        if stop() {
            break;
        }
        let (found, done) = wedges(&mut c, &mut s);
        // Where there are no wedges, what was tried in vain by the passes before fails again.
        effort = if found > 0 { Effort::new(insert, Some(insert), true) } else { Effort { goal: insert, ..effort } };
        for _ in 0..3 {
            exchange(&mut c, &mut effort, &mut s);
        }
        if done == 0 {
            break;
        }
    }
    for round in 0..options.restarts {
        if stop() {
            break;
        }
        // Each round takes twice as long: from the third on they are for what is worse.
        let above = options.restart_above + if round < 2 { 0.0 } else { RELIEF };
        restart::restart(&mut c, 1.0 - above, round, &mut s);
    }
    s.after = measure(&c);
    (mesh.points, mesh.tets) = c.finish();
    s.seconds = begin.elapsed().as_secs_f64();
    s
}

/// The triangles round the tetrahedra: boundary faces and, where there are prisms, the faces towards them.
fn check_free_boundary(mesh: &VolumeMesh) -> Vec<[u32; 3]> {
    if mesh.prisms.is_empty() {
        return mesh.boundary.iter().map(|f| [f.vertices[0], f.vertices[1], f.vertices[2]]).collect();
    }
    super::check::boundary_faces(&mesh.tets)
}

/// What passes do.
struct Effort {
    /// Tetrahedra with a score under this are worked on.
    goal: f64,
    /// Under this, vertices are inserted too.
    insert: Option<f64>,
    /// Whether vertices are moved and edges contracted too.
    thorough: bool,
    /// When a tetrahedron was last tried in vain, one more than the number of changes then.
    tried: Vec<u32>,
}

impl Effort {
    fn new(goal: f64, insert: Option<f64>, thorough: bool) -> Effort {
        Effort { goal, insert, thorough, tried: vec![] }
    }
}

/// What can be done about a tetrahedron.
enum Plan {
    EdgeRemoval(Exchange),
    FaceFlip(Exchange),
    Relaxation(u32, Point),
    Contraction(Exchange),
    Insertion(Exchange),
}

impl Plan {
    /// Whether it can be made as it was planned when [`Complex::now`] was `then`.
    fn holds(&self, c: &Complex, then: u32) -> bool {
        match self {
            Plan::Relaxation(v, _) => c.is_as_at(then, &[*v]),
            Plan::EdgeRemoval(x) | Plan::FaceFlip(x) | Plan::Contraction(x) | Plan::Insertion(x) => {
                x.old.iter().all(|&t| c.is_as_at(then, &c.tets[t as usize]))
            }
        }
    }

    fn make(self, c: &mut Complex, s: &mut OptimiseSummary) {
        match self {
            Plan::EdgeRemoval(x) => {
                s.edges_removed += 1;
                c.make(x);
            }
            Plan::FaceFlip(x) => {
                s.faces_flipped += 1;
                c.make(x);
            }
            Plan::Relaxation(v, p) => {
                s.relaxed += 1;
                c.set_point(v, p);
            }
            Plan::Contraction(x) => {
                s.contracted += 1;
                c.make(x);
            }
            Plan::Insertion(x) => {
                s.inserted += 1;
                c.make(x);
            }
        }
    }
}

/// Tetrahedra planned for at the same time. The number decides which plans come too late: it is the same on every
/// machine.
const TOGETHER: usize = 512;

/// One pass over the tetrahedra with a score under the effort's goal, worst first, without those round which nothing
/// has changed since they were tried. Gives the number of exchanges.
///
/// Plans are made in parallel, carried out one after the other; a plan whose place has changed meanwhile is made anew.
fn exchange(c: &mut Complex, effort: &mut Effort, s: &mut OptimiseSummary) -> usize {
    effort.tried.resize(effort.tried.len().max(c.tets.len()), 0);
    let again = |t: u32| effort.tried[t as usize] == 0 || c.last_change(t) >= effort.tried[t as usize];
    let mut bad: Vec<(f64, u32)> = (0..c.tets.len() as u32)
        .into_par_iter()
        .with_min_len(4096)
        .filter(|&t| c.scores[t as usize] < effort.goal && again(t))
        .map(|t| (c.scores[t as usize], t))
        .collect();
    bad.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut done = 0;
    for some in bad.chunks(TOGETHER) {
        let then = c.now();
        // Gone or better since: the next pass sees what is left.
        let due = |c: &Complex, (score, t): (f64, u32)| c.alive(t) && c.scores[t as usize] == score;
        let plans: Vec<Option<Plan>> =
            some.par_iter().with_min_len(8).map(|&b| if due(c, b) { plan(c, b.1, effort) } else { None }).collect();
        for (&b, mut planned) in some.iter().zip(plans) {
            if !due(c, b) {
                continue;
            }
            let t = b.1;
            if !c.is_as_at(then, &c.tets[t as usize]) || planned.as_ref().is_some_and(|p| !p.holds(c, then)) {
                planned = plan(c, t, effort);
            }
            match planned {
                Some(p) => {
                    p.make(c, s);
                    done += 1;
                }
                None => effort.tried[t as usize] = c.now() + 1,
            }
        }
    }
    done
}

/// By how much more skewed a tetrahedron must be for a third round of restarts.
const RELIEF: f64 = 0.03;

/// Works on the tetrahedra with two faces on the surface alone; of all ways out the best counts. Gives how many there
/// were and how many went.
fn wedges(c: &mut Complex, s: &mut OptimiseSummary) -> (usize, usize) {
    let found: Vec<u32> = (0..c.tets.len() as u32).into_par_iter().filter(|&t| c.alive(t) && c.is_wedge(c.tets[t as usize])).collect();
    let mut done = 0;
    let count = found.len();
    for t in found {
        for floor in [0.45, 0.35, 0.25, 0.15, 0.05, 0.0] {
            if !c.alive(t) || !c.is_wedge(c.tets[t as usize]) {
                break;
            }
            if let Some(p) = flip(c, t, floor).or_else(|| cavity::insert(c, t, floor).map(Plan::Insertion)) {
                p.make(c, s);
                done += 1;
            }
        }
    }
    (count, done)
}

/// Edge removal and 2-3 flips with a worst score above `floor`; the first success counts.
fn flip(c: &Complex, t: u32, floor: f64) -> Option<Plan> {
    let corners = c.tets[t as usize];
    let mut pairs = (0..4).flat_map(|i| (0..i).map(move |j| (corners[i], corners[j])));
    pairs
        .find_map(|(a, b)| flips::remove_edge(c, a, b, floor).map(Plan::EdgeRemoval))
        .or_else(|| (0..4).find_map(|face| flips::flip_23(c, t, face, floor).map(Plan::FaceFlip)))
}

/// What can be done about one tetrahedron; the first success counts.
fn plan(c: &Complex, t: u32, effort: &Effort) -> Option<Plan> {
    let score = c.scores[t as usize];
    let thorough = || {
        // Only a vertex whose star has this tetrahedron as its worst can help it.
        let mut corners = c.tets[t as usize].into_iter().filter(|&v| !c.frozen[v as usize] && c.worst(&c.stars[v as usize]) >= score);
        corners
            .find_map(|v| smooth::relax(c, v).map(|p| Plan::Relaxation(v, p)))
            .or_else(|| cavity::contract(c, t).map(Plan::Contraction))
    };
    flip(c, t, 0.0)
        .or_else(|| if effort.thorough { thorough() } else { None })
        .or_else(|| if effort.insert.is_some_and(|q| score < q) { cavity::insert(c, t, 0.0).map(Plan::Insertion) } else { None })
}

fn measure(c: &Complex) -> TetQuality {
    let each: Vec<(f64, f64, f64, usize)> = c
        .tets
        .par_iter()
        .enumerate()
        .filter(|(t, _)| c.alive(*t as u32))
        .map(|(_, &t)| {
            let p = c.corners(t);
            let (lo, hi) = quality::dihedral_range(&p);
            (1.0 - quality::quality(&p), lo, hi, c.surface_faces(t))
        })
        .collect();
    let n = each.len().max(1) as f64;
    TetQuality {
        max: each.iter().map(|e| e.0).fold(0.0, f64::max),
        mean: each.iter().map(|e| e.0).sum::<f64>() / n,
        over_080: each.iter().filter(|e| e.0 > 0.8).count(),
        min_dihedral: each.iter().map(|e| e.1).fold(180.0, f64::min),
        max_dihedral: each.iter().map(|e| e.2).fold(0.0, f64::max),
        two_boundary_faces: each.iter().filter(|e| e.3 > 1).count(),
    }
}
