//! The octree, level by level.

use rayon::prelude::*;

use super::fit::{self, Fit, Kind};
use super::{Mpu, MpuOptions, Node, Quadric, Summary};
use crate::geometry::{Aabb, Point, Vector};
use crate::pointcloud::OrientedPoints;

/// A cell that waits for its fit, with the points it may use: those of its ball, or the nearest where these are few.
struct Open {
    node: u32,
    ids: Vec<u32>,
    /// How many of `ids`, from the front, lie in the ball itself.
    inside: usize,
    /// Radius that holds them.
    radius: f64,
}

enum Outcome {
    Leaf(Fit, bool),
    Divide(Vec<(Vec<u32>, usize, f64)>),
}

/// No octree is deeper: a cell of the last level is 2⁻³⁰ of the root.
const DEEPEST: usize = 30;

pub(super) fn build(cloud: &OrientedPoints, options: &MpuOptions) -> (Mpu, Summary) {
    let bounds = Aabb::of(&cloud.points);
    let coarsest = cloud.pitch.iter().copied().fold(0.0, f64::max);
    let finest = cloud.pitch.iter().copied().fold(f64::INFINITY, f64::min);
    let edge = (0..3).map(|a| bounds.max[a] - bounds.min[a]).fold(0.0, f64::max) + 8.0 * coarsest;
    let (center, half) = (bounds.center(), 0.5 * edge);
    let mut nodes = vec![Node { center, half, link: 0, leaf: false }];
    let mut quadrics: Vec<Quadric> = Vec::new();
    let mut summary = Summary { points: cloud.len(), smallest_leaf: edge, ..Summary::default() };
    let all: Vec<u32> = (0..cloud.len() as u32).collect();
    let inside = all.len();
    let radius = 2.0 * 3f64.sqrt() * half * options.support;
    let mut open = vec![Open { node: 0, ids: all, inside, radius }];
    for level in 0..=DEEPEST {
        if open.is_empty() {
            break;
        }
        summary.levels = level + 1;
        let outcomes: Vec<Outcome> = open.par_iter().map(|o| settle(cloud, o, &nodes[o.node as usize], options, level == DEEPEST)).collect();
        let mut next = Vec::new();
        for (o, outcome) in open.iter().zip(outcomes) {
            match outcome {
                Outcome::Leaf(fit, over) => {
                    let node = &mut nodes[o.node as usize];
                    (node.leaf, node.link) = (true, quadrics.len() as u32);
                    summary.smallest_leaf = summary.smallest_leaf.min(2.0 * node.half);
                    summary.over_tolerance += usize::from(over);
                    match fit.kind {
                        Kind::Bivariate => summary.bivariate += 1,
                        Kind::General => summary.general += 1,
                    }
                    quadrics.push(fit.quadric);
                }
                Outcome::Divide(children) => {
                    let first = nodes.len() as u32;
                    let parent = &mut nodes[o.node as usize];
                    parent.link = first;
                    let (c, h) = (parent.center, 0.5 * parent.half);
                    for (n, (ids, inside, radius)) in children.into_iter().enumerate() {
                        nodes.push(Node { center: child_center(c, h, n), half: h, link: 0, leaf: false });
                        next.push(Open { node: first + n as u32, ids, inside, radius });
                    }
                }
            }
        }
        open = next;
    }
    summary.leaves = quadrics.len();
    let ratio = 2.0 * 3f64.sqrt() * options.support;
    let support2 = ratio * ratio;
    let mut cells = vec![0u32; quadrics.len()];
    nodes.iter().zip(0..).filter(|(n, _)| n.leaf).for_each(|(n, at)| cells[n.link as usize] = at);
    let ball = |n: &Node| (n.center, support2 * n.half * n.half);
    let balls: Vec<(Point, f64)> = cells.iter().map(|&at| ball(&nodes[at as usize])).collect();
    let lists: Vec<Vec<u32>> = cells.par_iter().map(|&at| reaching(&nodes, &nodes[at as usize], support2)).collect();
    let mut first = Vec::with_capacity(lists.len() + 1);
    let mut near = Vec::with_capacity(lists.iter().map(Vec::len).sum());
    for list in lists {
        first.push(near.len() as u32);
        near.extend(list);
    }
    first.push(near.len() as u32);
    summary.bytes = size_of_val(&nodes[..]) + size_of_val(&quadrics[..]) + size_of_val(&balls[..]) + size_of_val(&near[..]) + size_of_val(&first[..]);
    let root = Aabb { min: center - Vector::repeat(half), max: center + Vector::repeat(half) };
    let mpu = Mpu { nodes, quadrics, balls, near, first, root, points: bounds.inflated(2.0 * coarsest), resolution: 0.5 * finest };
    (mpu, summary)
}

/// The leaves whose balls meet a cell. A node's ball holds those of its children.
fn reaching(nodes: &[Node], cell: &Node, support2: f64) -> Vec<u32> {
    let mut out = Vec::new();
    let mut stack = vec![0u32];
    // Balls that only just miss the cell are taken too: rounding must lose none.
    let half = cell.half * (1.0 + 1e-9);
    while let Some(n) = stack.pop() {
        let node = &nodes[n as usize];
        let away = (node.center - cell.center).map(|d| (d.abs() - half).max(0.0));
        if away.norm_squared() > support2 * node.half * node.half {
            continue;
        }
        if node.leaf {
            out.push(node.link);
        } else {
            stack.extend(node.link..node.link + 8);
        }
    }
    out
}

fn child_center(c: Point, h: f64, n: usize) -> Point {
    let sign = |bit: usize| if n >> bit & 1 != 0 { h } else { -h };
    c + Vector::new(sign(0), sign(1), sign(2))
}

fn settle(cloud: &OrientedPoints, open: &Open, node: &Node, options: &MpuOptions, deepest: bool) -> Outcome {
    let inside = &open.ids[..open.inside];
    // The finest points in the ball say how small cells may get and how near the quadric must come.
    let pitch = inside.iter().map(|&i| cloud.pitch[i as usize]).fold(f64::INFINITY, f64::min);
    let pitch = if pitch.is_finite() { pitch } else { options.reference_pitch };
    let last = deepest || 2.0 * node.half < 2.0 * options.leaf_pitches * pitch;
    if !last && open.inside > options.max_points {
        return divide(cloud, open, node, options);
    }
    let Some(fit) = fit::fit(cloud, &open.ids, node.center, node.half, open.radius, last) else {
        return divide(cloud, open, node, options);
    };
    let tolerance = options.tolerance * pitch / options.reference_pitch;
    let error = inside
        .iter()
        .map(|&i| {
            let y = cloud.points[i as usize] - node.center;
            let (f, g) = (fit.quadric.value(&y).abs(), fit.quadric.gradient(&y).norm());
            if g > 0.0 { f / g } else { f64::INFINITY }
        })
        .fold(0.0, f64::max);
    let over = error > tolerance;
    if over && !last { divide(cloud, open, node, options) } else { Outcome::Leaf(fit, over) }
}

/// Hands every child the points of its ball, or the nearest ones where the ball holds too few.
fn divide(cloud: &OrientedPoints, open: &Open, node: &Node, options: &MpuOptions) -> Outcome {
    let h = 0.5 * node.half;
    let radius = 2.0 * 3f64.sqrt() * h * options.support;
    let children = (0..8).map(|n| {
        let c = child_center(node.center, h, n);
        let d2 = |i: u32| (cloud.points[i as usize] - c).norm_squared();
        let ids: Vec<u32> = open.ids.iter().copied().filter(|&i| d2(i) < radius * radius).collect();
        let inside = ids.len();
        if inside > options.min_points {
            return (ids, inside, radius);
        }
        // The ball grows until it holds enough; the parent's ball holds the child's, so its points suffice.
        let mut near: Vec<(f64, u32)> = open.ids.iter().map(|&i| (d2(i), i)).collect();
        let enough = near.len().min(options.min_points + 1);
        let order = |x: &(f64, u32), y: &(f64, u32)| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1));
        near.select_nth_unstable_by(enough - 1, order);
        near.truncate(enough);
        near.sort_unstable_by(order);
        let farthest = near[enough - 1].0.sqrt();
        // Just beyond the farthest point, so that it has a weight.
        (near.into_iter().map(|(_, i)| i).collect(), inside, (1.1 * farthest).max(radius))
    });
    Outcome::Divide(children.collect())
}
