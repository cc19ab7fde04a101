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

use crate::mesh::VolumeMesh;
use complex::Complex;

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
        OptimiseOptions { smoothing_rounds: 5, work_above: 0.55, insert_above: 0.68, passes: 8, restart_above: 0.75, restarts: 3 }
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
    exchange(&mut c, &mut Effort::new(work, None, false), &mut s);
    for half in 0..2 {
        let colours = smooth::colours(&c);
        for _ in 0..options.smoothing_rounds.div_ceil(1 + half) {
            if stop() {
                break;
            }
            s.smoothed += smooth::sweep(&mut c, &colours);
        }
        c.rescore();
        let mut effort = Effort::new(work, (half > 0).then_some(insert), true);
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
        let done = wedges(&mut c, &mut s);
        let mut effort = Effort::new(insert, Some(insert), true);
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
        restart::restart(&mut c, 1.0 - options.restart_above, round, &mut s);
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

/// One pass over the tetrahedra with a score under the effort's goal, worst first, without those round which nothing
/// has changed since they were tried. Gives the number of exchanges.
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
    for (score, t) in bad {
        // Gone or better since: the next pass sees what is left.
        if !c.alive(t) || c.scores[t as usize] != score {
            continue;
        }
        if improve(c, t, effort, s) {
            done += 1;
        } else {
            effort.tried[t as usize] = c.now() + 1;
        }
    }
    done
}

/// Works on the tetrahedra with two faces on the surface alone; of all ways out the best counts. Gives how many went.
fn wedges(c: &mut Complex, s: &mut OptimiseSummary) -> usize {
    let found: Vec<u32> = (0..c.tets.len() as u32).into_par_iter().filter(|&t| c.alive(t) && c.is_wedge(c.tets[t as usize])).collect();
    let mut done = 0;
    for t in found {
        for floor in [0.45, 0.35, 0.25, 0.15, 0.05, 0.0] {
            if !c.alive(t) || !c.is_wedge(c.tets[t as usize]) {
                break;
            }
            if flip(c, t, floor, s) {
                done += 1;
            } else if cavity::insert(c, t, floor) {
                s.inserted += 1;
                done += 1;
            }
        }
    }
    done
}

/// Edge removal and 2-3 flips with a worst score above `floor`; the first success counts.
fn flip(c: &mut Complex, t: u32, floor: f64, s: &mut OptimiseSummary) -> bool {
    let corners = c.tets[t as usize];
    for i in 0..4 {
        for j in 0..i {
            if flips::remove_edge(c, corners[i], corners[j], floor) {
                s.edges_removed += 1;
                return true;
            }
        }
    }
    for face in 0..4 {
        if flips::flip_23(c, t, face, floor) {
            s.faces_flipped += 1;
            return true;
        }
    }
    false
}

/// Tries everything on one tetrahedron; the first success counts.
fn improve(c: &mut Complex, t: u32, effort: &Effort, s: &mut OptimiseSummary) -> bool {
    let corners = c.tets[t as usize];
    let score = c.scores[t as usize];
    if flip(c, t, 0.0, s) {
        return true;
    }
    if effort.thorough {
        for v in corners {
            // Only a vertex whose star has this tetrahedron as its worst can help it.
            if !c.frozen[v as usize] && c.worst(&c.stars[v as usize]) >= score && smooth::relax(c, v) {
                s.relaxed += 1;
                if !c.alive(t) || c.scores[t as usize] != score {
                    return true;
                }
            }
        }
        if cavity::contract(c, t) {
            s.contracted += 1;
            return true;
        }
    }
    if effort.insert.is_some_and(|q| score < q) && cavity::insert(c, t, 0.0) {
        s.inserted += 1;
        return true;
    }
    false
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
