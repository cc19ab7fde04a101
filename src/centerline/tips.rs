//! The tips of the vessels: geodesically farthest voxels, after the path to each has claimed its surroundings.
//!
//! TEASAR (Sato et al. 2000), used for its ends alone: paths follow the centre by a cost of 1/R² per length.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use super::field::{Field, NONE};

/// The voxels (by lumen number) where the vessels end, for every component of at least `min_voxels`.
pub(super) fn find(field: &Field, min_voxels: usize) -> Vec<u32> {
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); field.components];
    for (v, &c) in field.component.iter().enumerate() {
        members[c as usize].push(v as u32);
    }
    let n = field.voxel.len();
    let mut state = State { claimed: vec![false; n], seen: vec![0; n], stamp: 0, on_path: vec![false; n] };
    let mut tips = Vec::new();
    for m in members.iter().filter(|m| m.len() >= min_voxels.max(2)) {
        component(field, m, &mut state, &mut tips);
    }
    tips
}

struct State {
    claimed: Vec<bool>,
    seen: Vec<u32>,
    stamp: u32,
    on_path: Vec<bool>,
}

fn component(field: &Field, members: &[u32], state: &mut State, tips: &mut Vec<u32>) {
    let Some(&core) = members.iter().max_by(|a, b| {
        let d = |v: u32| field.distance[v as usize];
        d(**a).total_cmp(&d(**b)).then(b.cmp(a))
    }) else {
        return;
    };
    let farthest = |cost: &[f64]| {
        members.iter().copied().max_by(|&a, &b| cost[a as usize].total_cmp(&cost[b as usize]).then(b.cmp(&a)))
    };
    let (from_core, _) = dijkstra(field, core, |_, len| len);
    let Some(root) = farthest(&from_core) else { return };
    let (length, _) = dijkstra(field, root, |_, len| len);
    let (_, parent) = dijkstra(field, root, |w, len| len / f64::from(field.distance[w as usize]).powi(2));
    let mut order = members.to_vec();
    order.sort_by(|&a, &b| length[b as usize].total_cmp(&length[a as usize]).then(a.cmp(&b)));
    tips.push(root);
    let mut first = true;
    for tip in order {
        if state.claimed[tip as usize] || (tip == root && !first) {
            continue;
        }
        tips.push(tip);
        let mut path = vec![tip];
        while let Some(&v) = path.last() {
            let p = parent[v as usize];
            if p == NONE || state.on_path[v as usize] {
                break;
            }
            path.push(p);
        }
        claim(field, &path, state, first);
        path.iter().for_each(|&v| state.on_path[v as usize] = true);
        first = false;
    }
}

/// Marks what lies round the path, so that no further tip is looked for there.
fn claim(field: &Field, path: &[u32], state: &mut State, both_ends: bool) {
    let radius = |v: u32| field.radius(v).max(0.5 * field.voxel_size);
    let mut arc = vec![0.0];
    for w in path.windows(2) {
        let step = (field.position(w[1]) - field.position(w[0])).norm();
        arc.push(arc[arc.len() - 1] + step);
    }
    // The first full sphere behind a tip claims the whole end: its corners are no tips of their own.
    let settled = |indices: &mut dyn Iterator<Item = usize>, start: f64| {
        let list: Vec<usize> = indices.collect();
        list.iter().copied().find(|&i| {
            let r = radius(path[i]);
            let ahead = list.iter().copied().filter(|&j| {
                let d = (arc[j] - start).abs() - (arc[i] - start).abs();
                (0.0..=r.max(3.0 * field.voxel_size)).contains(&d)
            });
            r >= 0.93 * ahead.map(|j| radius(path[j])).fold(0.0, f64::max)
        })
    };
    let total = arc[arc.len() - 1];
    let head = settled(&mut (0..path.len()), 0.0);
    let tail = if both_ends { settled(&mut (0..path.len()).rev(), total) } else { None };
    let mut next = 0.0;
    for (i, &v) in path.iter().enumerate() {
        let end = Some(i) == head || Some(i) == tail;
        if arc[i] < next && !end && i + 1 < path.len() {
            continue;
        }
        let r = radius(v);
        next = arc[i] + 0.3 * r;
        let reach = if end { 1.7 * r } else { 1.3 * r } + 2.0 * field.voxel_size;
        claim_ball(field, v, reach, state);
    }
}

/// Marks what a walk inside the ball can reach: a neighbouring vessel behind a gap stays free.
fn claim_ball(field: &Field, center: u32, reach: f64, state: &mut State) {
    state.stamp += 1;
    let c = field.position(center);
    let mut queue = VecDeque::from([center]);
    state.seen[center as usize] = state.stamp;
    while let Some(v) = queue.pop_front() {
        state.claimed[v as usize] = true;
        for (w, _) in field.neighbors(v) {
            if state.seen[w as usize] != state.stamp && (field.position(w) - c).norm_squared() <= reach * reach {
                state.seen[w as usize] = state.stamp;
                queue.push_back(w);
            }
        }
    }
}

fn dijkstra(field: &Field, source: u32, cost: impl Fn(u32, f64) -> f64) -> (Vec<f64>, Vec<u32>) {
    let n = field.voxel.len();
    let mut best = vec![f64::INFINITY; n];
    let mut parent = vec![NONE; n];
    best[source as usize] = 0.0;
    // Costs are not negative, so their bits sort as they do.
    let mut queue = BinaryHeap::from([Reverse((0u64, source))]);
    while let Some(Reverse((bits, v))) = queue.pop() {
        let d = f64::from_bits(bits);
        if d > best[v as usize] {
            continue;
        }
        for (w, len) in field.neighbors(v) {
            let c = d + cost(w, len);
            if c < best[w as usize] {
                best[w as usize] = c;
                parent[w as usize] = v;
                queue.push(Reverse((c.to_bits(), w)));
            }
        }
    }
    (best, parent)
}
