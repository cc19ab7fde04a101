//! The last bad tetrahedra: their neighbourhoods are worked on again from shaken positions, and the best outcome kept.
//!
//! Every exchange must make things better at once, so the work ends where only two exchanges together would. Other
//! starting positions end elsewhere. Neighbourhoods of one batch have no tetrahedron in common and are worked on at the
//! same time; the shaking is the same in every run.

use rayon::prelude::*;

use super::complex::{Complex, faces, sorted};
use super::{Effort, OptimiseSummary, exchange, smooth};
use crate::geometry::{Point, Vector};

/// Starting positions tried for each neighbourhood, twice as many in each further round.
const TRIALS: u32 = 6;

/// Most tetrahedra of a neighbourhood.
const LARGEST: usize = 600;

/// Most neighbourhoods of a round: so many, and one more for each so many tetrahedra. With more bad tetrahedra than
/// that the surface is at fault, and other positions do not help.
const MOST: (usize, usize) = (40, 2000);

/// A piece of the complex with ids of its own.
struct Piece {
    tets: Vec<u32>,
    /// Global id of each vertex.
    vertices: Vec<u32>,
    complex: Complex,
}

/// Works on the neighbourhoods of the tetrahedra with a score under `goal`; gives how many became better. Rounds
/// begin from other positions each.
pub(super) fn restart(c: &mut Complex, goal: f64, round: u32, s: &mut OptimiseSummary) -> usize {
    let mut bad: Vec<(f64, u32)> =
        (0..c.tets.len() as u32).filter(|&t| c.scores[t as usize] < goal).map(|t| (c.scores[t as usize], t)).collect();
    bad.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    bad.truncate(MOST.0 + c.tets.len() / MOST.1);
    let mut better = 0;
    // What overlaps a neighbourhood of this batch waits for the next.
    while !bad.is_empty() {
        let mut taken = vec![false; c.tets.len()];
        let (mut batch, mut later) = (vec![], vec![]);
        for (score, t) in bad {
            if !c.alive(t) || c.scores[t as usize] != score {
                continue;
            }
            let region = neighbourhood(c, t);
            if region.iter().any(|&r| taken[r as usize]) {
                later.push((score, t));
            } else {
                region.iter().for_each(|&r| taken[r as usize] = true);
                batch.push(region);
            }
        }
        bad = later;
        let done: Vec<Option<Piece>> = batch.into_par_iter().map(|region| work(piece(c, region), goal, round)).collect();
        for p in done.into_iter().flatten() {
            put_back(c, p);
            better += 1;
        }
    }
    s.restarted += better;
    better
}

/// The tetrahedra at the vertices of `t`, and those at their vertices in turn, while they are not too many.
fn neighbourhood(c: &Complex, t: u32) -> Vec<u32> {
    let mut region = vec![t];
    for _ in 0..2 {
        let mut vertices: Vec<u32> = region.iter().flat_map(|&r| c.tets[r as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut wider: Vec<u32> = vertices.iter().flat_map(|&v| c.stars[v as usize].iter().copied()).collect();
        wider.sort_unstable();
        wider.dedup();
        if wider.len() > LARGEST && region.len() > 1 {
            break;
        }
        region = wider;
    }
    region
}

fn piece(c: &Complex, tets: Vec<u32>) -> Piece {
    let mut vertices: Vec<u32> = tets.iter().flat_map(|&t| c.tets[t as usize]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let local = |v: u32| vertices.partition_point(|&w| w < v) as u32;
    let mut outside: Vec<([u32; 3], [u32; 3])> =
        tets.iter().flat_map(|&t| faces(c.tets[t as usize])).map(|f| (sorted(f), f)).collect();
    outside.sort_unstable();
    let outside: Vec<[u32; 3]> = outside.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() == 1).map(|g| g[0].1).collect();
    let surface = outside.iter().filter(|&&f| c.is_surface(f)).map(|f| f.map(local));
    let points = vertices.iter().map(|&v| c.points[v as usize]).collect();
    let local_tets = tets.iter().map(|&t| c.tets[t as usize].map(local)).collect();
    let mut complex = Complex::new(points, local_tets, surface);
    for f in &outside {
        f.iter().for_each(|&v| complex.frozen[local(v) as usize] = true);
    }
    for (i, &v) in vertices.iter().enumerate() {
        complex.frozen[i] |= c.frozen[v as usize];
    }
    complex.strict = c.strict;
    complex.rescore();
    Piece { tets, vertices, complex }
}

/// The best outcome of all starting positions; nothing where none is better than what was there.
fn work(p: Piece, goal: f64, round: u32) -> Option<Piece> {
    let before = deficits(&p.complex, goal);
    let mut best: Option<(Vec<f64>, Complex)> = None;
    let first = TRIALS * ((1 << round) - 1);
    for trial in 0..TRIALS << round {
        let mut c = p.complex.clone();
        // The first round begins where things stand.
        let by = if first + trial == 0 { 0.0 } else { 0.1 * f64::from(1 + trial % 5) };
        shake(&mut c, by, first + trial);
        improve(&mut c, goal, if round < 2 { 0.1 } else { 0.2 });
        let d = deficits(&c, goal);
        if above(&d, best.as_ref().map_or(&before, |b| &b.0)) {
            let met = d.is_empty();
            best = Some((d, c));
            if met {
                break;
            }
        }
    }
    best.map(|(_, complex)| Piece { complex, ..p })
}

/// Works on what is within `wider` of the goal too: more gets out of the way of the worst, and costs more.
fn improve(c: &mut Complex, goal: f64, wider: f64) {
    let mut s = OptimiseSummary::default();
    let mut effort = Effort::new((goal + wider).min(0.6), Some((goal + 0.05).min(0.5)), true);
    for round in 0..6 {
        if exchange(c, &mut effort, &mut s) == 0 {
            break;
        }
        if round == 1 {
            let mut bases = vec![];
            for v in 0..c.points.len() as u32 {
                smooth::improve_mean(c, v, &mut bases);
            }
        }
    }
}

/// Scores under `goal`, worst first.
fn deficits(c: &Complex, goal: f64) -> Vec<f64> {
    let mut d: Vec<f64> = c.scores.iter().copied().filter(|&s| s < goal).collect();
    d.sort_unstable_by(f64::total_cmp);
    d
}

/// Whether `a` is better than `b`: by the worst, then by the next, and so on.
fn above(a: &[f64], b: &[f64]) -> bool {
    for (x, y) in a.iter().zip(b) {
        if (x - y).abs() > 1e-3 {
            return x > y;
        }
    }
    a.len() < b.len()
}

/// Moves the free vertices by up to `by` times their shortest edge, where no tetrahedron comes near to flat.
fn shake(c: &mut Complex, by: f64, seed: u32) {
    if by == 0.0 {
        return;
    }
    let mut state = 0x9E37_79B9_7F4A_7C15u64.wrapping_mul(u64::from(seed) + 1);
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    for v in 0..c.points.len() as u32 {
        let d = Vector::new(random(), random(), random());
        if c.frozen[v as usize] || c.stars[v as usize].is_empty() {
            continue;
        }
        let here = c.points[v as usize];
        let shortest = c.stars[v as usize]
            .iter()
            .flat_map(|&t| c.tets[t as usize])
            .filter(|&w| w != v)
            .map(|w| (c.points[w as usize] - here).norm())
            .fold(f64::INFINITY, f64::min);
        let old = c.worst(&c.stars[v as usize]);
        c.set_point(v, here + d * (by * shortest));
        // Wedges at the vertex stay as bad as they are whatever it does.
        if c.worst(&c.stars[v as usize]) < old.min(0.02) {
            c.set_point(v, here);
        }
    }
}

fn put_back(c: &mut Complex, p: Piece) {
    let Piece { tets, vertices, complex } = p;
    let mut ids = vertices;
    for (i, x) in complex.points.iter().enumerate() {
        if i >= ids.len() {
            let x: Point = *x;
            ids.push(c.add_point(x));
        } else if !complex.frozen[i] {
            c.points[ids[i] as usize] = *x;
        }
    }
    let new: Vec<[u32; 4]> = (0..complex.tets.len() as u32)
        .filter(|&t| complex.alive(t))
        .map(|t| complex.tets[t as usize].map(|v| ids[v as usize]))
        .collect();
    c.replace(&tets, &new);
}
