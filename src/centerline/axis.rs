//! From skeleton voxels to smooth, centred, evenly sampled branches.

use rayon::prelude::*;

use super::curve::{arcs, resample_by, smooth};
use super::field::{Field, NONE};
use super::graph::{Edge, Graph};
use super::ring::Rays;
use super::{Branch, CenterlineOptions, Centerlines, EndKind, Sample};
use crate::geometry::{Point, Vector};
use crate::implicit::Implicit;

/// Rounds of centring and smoothing.
const ROUNDS: usize = 3;

/// The branches of the pruned graph; nodes are renumbered in the order of the branches.
pub(super) fn lines(field: &Field, graph: &Graph, options: &CenterlineOptions) -> Centerlines {
    let edges: Vec<&Edge> = graph.edges.iter().flatten().filter(|e| e.path.len() > 1).collect();
    let mut number = vec![NONE; graph.nodes.len()];
    let mut nodes = Vec::new();
    for n in edges.iter().flat_map(|e| e.nodes) {
        if number[n as usize] == NONE {
            number[n as usize] = nodes.len() as u32;
            nodes.push(field.position(graph.nodes[n as usize]));
        }
    }
    let branches: Vec<Branch> = edges
        .par_iter()
        .map(|e| {
            let ends = e.nodes.map(|n| if graph.degree(n) == 1 { EndKind::Free } else { EndKind::Junction });
            let lone_ring = e.nodes[0] == e.nodes[1] && graph.degree(e.nodes[0]) == 2;
            let samples = branch(field, e, ends, lone_ring, options);
            let component = field.component[e.path[0] as usize];
            Branch { samples, nodes: e.nodes.map(|n| number[n as usize]), ends, component }
        })
        .collect();
    for b in &branches {
        for (end, sample) in [b.samples.first(), b.samples.last()].into_iter().enumerate() {
            if let Some(s) = sample {
                nodes[b.nodes[end] as usize] = s.point;
            }
        }
    }
    Centerlines { branches, nodes }
}

fn branch(field: &Field, edge: &Edge, ends: [EndKind; 2], ring: bool, options: &CenterlineOptions) -> Vec<Sample> {
    let s = field.voxel_size;
    let floor = 0.5 * s;
    let mut path = edge.path.clone();
    // Beyond the last full sphere the skeleton turns to some corner of the tip: cut there, and run on straight later.
    for end in 0..2 {
        if ends[end] == EndKind::Free {
            path.reverse();
            let keep = core(field, &path);
            path.truncate(keep + 1);
            path.reverse();
        }
        path.reverse();
    }
    let mut points: Vec<Point> = path.iter().map(|&v| field.position(v)).collect();
    if points.len() < 2 {
        // A ball: a short axis towards the tips.
        points = [edge.path[0], path[0], edge.path[edge.path.len() - 1]].map(|v| field.position(v)).to_vec();
        points.dedup();
    }
    let raw: Vec<f64> = path.iter().map(|&v| field.radius(v).max(floor)).collect();
    let raw_arc = arcs(&points);
    let raw_radius = |t: f64, total: f64| {
        let x = t / total * raw_arc[raw_arc.len() - 1];
        let i = raw_arc.partition_point(|&a| a < x).min(raw.len() - 1);
        raw[i]
    };
    let value = |p: &Point| field.smooth(p);
    let correction = |along: &Vector, r: f64| field.shrinkage(along, r);
    let rays = Rays { value: &value, correction: &correction, step: 0.7 * s, noise: 0.15 * s };
    points = resample_by(&points, s, 5);
    for round in 0..ROUNDS {
        let arc = arcs(&points);
        let total = arc[arc.len() - 1];
        let radius: Vec<f64> = arc.iter().map(|&t| raw_radius(t, total)).collect();
        let window: Vec<f64> = radius.iter().map(|r| (1.2 * r).max(2.5 * s)).collect();
        let smoothed = smooth(&points, &window, ring);
        let node = [radius[0], radius[radius.len() - 1]];
        let n = points.len();
        let moved: Vec<Point> = (0..n)
            .map(|i| {
                let (p, t) = smoothed[i];
                let pinned = |e: usize| ends[e] == EndKind::Junction && !ring;
                if (i == 0 && pinned(0)) || (i + 1 == n && pinned(1)) {
                    return points[i];
                }
                // In a junction's sphere a section runs into the other branches.
                let near = |e: usize, d: f64| ends[e] == EndKind::Junction && !ring && d < 1.1 * node[e];
                if near(0, arc[i]) || near(1, total - arc[i]) || round + 1 == ROUNDS {
                    return p;
                }
                match rays.ring(&p, &t, radius[i]) {
                    Some(r) if r.hits > 16 => p + clamp(r.offset, 0.5 * radius[i]),
                    _ => p,
                }
            })
            .collect();
        points = if round + 1 == ROUNDS { moved } else { resample_by(&moved, s, 5) };
        if ring {
            let n = points.len();
            points[n - 1] = points[0];
        }
    }
    let core_arc = arcs(&points);
    let core_total = core_arc[core_arc.len() - 1];
    let mut lead = [0.0; 2];
    for end in 0..2 {
        points.reverse();
        if ends[end] == EndKind::Free {
            let r = raw_radius(if end == 0 { 0.0 } else { core_total }, core_total);
            lead[end] = extend(field, &mut points, r);
        }
    }
    // Even samples, then radius and tangent where they are.
    let mut middle: Vec<f64> = raw.clone();
    middle.sort_by(f64::total_cmp);
    let step = (options.sample_radii * middle[middle.len() / 2]).max(0.5 * s);
    let points = resample_by(&points, step, 5);
    let arc = arcs(&points);
    let total = arc[arc.len() - 1];
    let core_radius = |t: f64| raw_radius((t - lead[0]).clamp(0.0, core_total), core_total);
    let window: Vec<f64> = arc.iter().map(|&t| (1.2 * core_radius(t)).max(2.5 * s).max(2.5 * total / (points.len() - 1) as f64)).collect();
    let tangent = smooth(&points, &window, ring);
    let node = [raw[0], raw[raw.len() - 1]];
    let mut radius: Vec<f64> = (0..points.len())
        .map(|i| {
            let guess = core_radius(arc[i]);
            let near = |e: usize, d: f64| ends[e] == EndKind::Junction && !ring && d < 1.1 * node[e];
            match rays.ring(&points[i], &tangent[i].1, guess) {
                // The outline of a section is nearer the truth than voxel distances, but may run into a side branch.
                Some(r) if near(0, arc[i]) || near(1, total - arc[i]) => r.radius.clamp(guess.min(r.radius), guess + 0.5 * s),
                Some(r) if r.radius > 0.0 => r.radius.min(1.5 * guess + s),
                _ => guess,
            }
        })
        .collect();
    hold_ends(&mut radius, &arc, lead);
    let radius = average(&radius, &arc, 2.0 * s);
    (0..points.len())
        .map(|i| Sample { point: points[i], radius: radius[i].max(0.25 * s), tangent: tangent[i].1, arc_length: arc[i] })
        .collect()
}

/// Keeps the radius of the last full sphere up to the free end.
fn hold_ends(radius: &mut [f64], arc: &[f64], lead: [f64; 2]) {
    let total = arc[arc.len() - 1];
    let n = radius.len();
    if lead[0] > 0.0 {
        let first = arc.partition_point(|&t| t < lead[0]).min(n - 1);
        let r = radius[first];
        radius[..first].fill(r);
    }
    if lead[1] > 0.0 {
        let last = arc.partition_point(|&t| t <= total - lead[1]).clamp(1, n) - 1;
        let r = radius[last];
        radius[last..].fill(r);
    }
}

/// Averages the radii over half a radius, at least `least` mm, of arc length either way.
fn average(radius: &[f64], arc: &[f64], least: f64) -> Vec<f64> {
    (0..radius.len())
        .map(|i| {
            // As far either way: at an end, where one side is missing, nothing is averaged.
            let w = (0.5 * radius[i]).max(least).min(arc[i]).min(arc[arc.len() - 1] - arc[i]).max(1e-9 * least);
            let near = |d: f64| (1.0 - (d / w).powi(2)).max(0.0);
            let from = arc.partition_point(|&t| t < arc[i] - w);
            let (sum, weight) = (from..radius.len())
                .take_while(|&j| arc[j] <= arc[i] + w)
                .fold((0.0, 0.0), |(s, k), j| (s + near(arc[j] - arc[i]) * radius[j], k + near(arc[j] - arc[i])));
            sum / weight
        })
        .collect()
}

fn clamp(v: Vector, limit: f64) -> Vector {
    let n = v.norm();
    if n > limit { v * (limit / n) } else { v }
}

/// Index of the first voxel from the tip (the path's end) at which a full sphere lies: its radius is nearly the
/// largest within one radius further in.
fn core(field: &Field, path: &[u32]) -> usize {
    let floor = 0.5 * field.voxel_size;
    let radius = |i: usize| field.radius(path[i]).max(floor);
    let n = path.len();
    let mut arc = 0.0;
    for i in (0..n).rev() {
        if i + 1 < n {
            arc += (field.position(path[i]) - field.position(path[i + 1])).norm();
        }
        let r = radius(i);
        let mut best = r;
        let mut ahead = 0.0;
        for j in (0..i).rev() {
            ahead += (field.position(path[j]) - field.position(path[j + 1])).norm();
            if ahead > r.max(3.0 * field.voxel_size) {
                break;
            }
            best = best.max(radius(j));
        }
        if r >= 0.93 * best && arc >= 0.5 * r {
            return i;
        }
    }
    0
}

/// Runs the curve's end straight on to the wall; returns the length added.
fn extend(field: &Field, points: &mut Vec<Point>, radius: f64) -> f64 {
    // The last piece of the skeleton already leans to the tip's corner.
    let tip = points[points.len() - 1];
    while points.len() > 4 && (points[points.len() - 2] - tip).norm() < (0.6 * radius).max(radius.min(2.0 * field.voxel_size)) {
        points.pop();
    }
    let n = points.len();
    let dropped = (points[n - 1] - tip).norm();
    let end = points[n - 1];
    let behind = |from: usize, reach: f64| (0..from).rev().find(|&i| (points[from] - points[i]).norm() > reach).unwrap_or(0);
    let fine = radius > 3.0 * field.voxel_size;
    let reach = if fine { 1.2 } else { 2.0 } * radius;
    let back = behind(n - 1, reach);
    let Some(mut direction) = (end - points[back]).try_normalize(0.0) else { return 0.0 };
    if fine && back > 0 {
        // A bend goes on: turn by what it turned before, from the chord's middle to the end.
        let before = behind(back, reach);
        if (points[back] - points[before]).norm() > 0.8 * reach {
            let turn = direction - (points[back] - points[before]).normalize();
            direction = (direction + turn * 0.6).normalize();
        }
    }
    let step = 0.1 * field.voxel_size;
    let limit = 4.0 * radius + 4.0 * field.voxel_size + dropped;
    let mut length = 0.0;
    while length < limit && field.smooth(&(end + direction * (length + step))) < 0.0 {
        length += step;
    }
    if length > 0.0 {
        points.push(end + direction * length);
    }
    length
}

/// Centres a branch on the implicit and measures its radii.
pub(super) fn refine(branch: &mut Branch, surface: &dyn Implicit) {
    let n = branch.samples.len();
    if n < 3 {
        return;
    }
    let value = |p: &Point| surface.value(p);
    let correction = |_: &Vector, _: f64| 0.0;
    let rays = Rays { value: &value, correction: &correction, step: surface.resolution(), noise: 0.0 };
    let ring = branch.nodes[0] == branch.nodes[1] && branch.samples[0].point == branch.samples[n - 1].point;
    let node = [branch.samples[0].radius, branch.samples[n - 1].radius];
    let total = branch.length();
    let ends = branch.ends;
    let free = |s: &Sample| {
        let near = |e: usize, d: f64| d < if ends[e] == EndKind::Junction { 1.1 } else { 1.5 } * node[e];
        !(near(0, s.arc_length) || near(1, total - s.arc_length))
    };
    for _ in 0..2 {
        let points: Vec<Point> = branch
            .samples
            .iter()
            .map(|s| match rays.ring(&s.point, &s.tangent, s.radius) {
                Some(r) if free(s) && r.hits > 16 => s.point + clamp(r.offset, 0.3 * s.radius),
                _ => s.point,
            })
            .collect();
        let window: Vec<f64> = branch.samples.iter().map(|s| s.radius.max(2.5 * total / (n - 1) as f64)).collect();
        let smoothed = smooth(&points, &window, ring);
        let points: Vec<Point> = (0..n)
            .map(|i| if free(&branch.samples[i]) { smoothed[i].0 } else { points[i] })
            .collect();
        let arc = arcs(&points);
        for (i, s) in branch.samples.iter_mut().enumerate() {
            s.point = points[i];
            s.tangent = smoothed[i].1;
            s.arc_length = arc[i];
        }
    }
    for s in &mut branch.samples {
        if let Some(r) = rays.ring(&s.point, &s.tangent, s.radius).filter(|r| r.radius > 0.0) {
            let near_free = |e: usize, d: f64| ends[e] == EndKind::Free && d < 1.5 * node[e];
            if near_free(0, s.arc_length) || near_free(1, total - s.arc_length) {
                continue;
            }
            s.radius = if free(s) { r.radius } else { r.radius.min(s.radius) };
        }
    }
}
