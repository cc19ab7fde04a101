//! Random vessel trees.

use serde::Serialize;

use super::cases::closed;
use super::{Phantom, Primitive, Random, Shape, Tip};
use crate::geometry::{Point, Vector};

/// What a random tree looks like.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TreeOptions {
    /// Smallest and largest radius of the root, mm. Default 2.2 to 3.5.
    pub root_radius: [f64; 2],
    /// Branches below this radius do not divide, mm. Default 1.3.
    pub min_radius: f64,
    /// Largest number of divisions on the way to a tip. Default 3.
    pub depth: usize,
    /// How probable a sac at a division is. Default 0.25.
    pub sac_probability: f64,
    /// How probable it is that the image border cuts the root. Default 0.5.
    pub border_probability: f64,
}

impl Default for TreeOptions {
    fn default() -> TreeOptions {
        TreeOptions { root_radius: [2.2, 3.5], min_radius: 1.3, depth: 3, sac_probability: 0.25, border_probability: 0.5 }
    }
}

/// A piece of a branch.
#[derive(Clone, Copy)]
struct Piece {
    a: Point,
    b: Point,
    radii: [f64; 2],
    branch: usize,
    parent: Option<usize>,
}

/// A random tree with bent, tapered branches that obey Murray's law and keep apart from each other.
///
/// The same seed and options give the same tree. Tips end straight, within the picture; the root does so too or is cut
/// by the picture's lower z border. Sacs are no ends.
pub fn random_tree(seed: u64, options: &TreeOptions) -> Phantom {
    let mut grower = Grower { random: Random::new(seed), options, pieces: Vec::new(), primitives: Vec::new(), tips: Vec::new(), branches: 0 };
    let radius = grower.random.uniform(options.root_radius[0], options.root_radius[1]);
    let tilt = Vector::new(grower.random.uniform(-0.3, 0.3), grower.random.uniform(-0.3, 0.3), 1.0).normalize();
    let root = Branch { from: Point::origin(), direction: tilt, radius, depth: 0, parent: None, length: 8.0 * radius, blend: 0.0 };
    if let Some(path) = grower.path(&root) {
        let first = path[0];
        grower.tips.push(Tip { from: first.b, to: first.a, radii: [first.radii[1], first.radii[0]] });
        grower.grow(root, path);
    }
    let cut = grower.random.uniform(0.0, 1.0) < options.border_probability;
    let mut phantom = closed(&format!("a random vessel tree, seed {seed}"), grower.primitives);
    phantom.name = format!("tree-{seed}");
    phantom.spacing = [(0.2 * radius * 10.0).round() / 10.0; 3];
    // Half-way along the first piece, which is straight and longer than it is wide; only where no other branch comes
    // down as far, whose end would leave the picture with it.
    let border = 0.5 * (grower.tips[0].from.z + grower.tips[0].to.z);
    let lowest = grower.pieces[1..].iter().flat_map(|p| [p.a.z - p.radii[0], p.b.z - p.radii[1]]).fold(f64::INFINITY, f64::min);
    if cut && border < lowest {
        phantom.window[2][0] = Some(border);
    }
    phantom.tips = grower.tips;
    phantom
}

struct Branch {
    from: Point,
    direction: Vector,
    radius: f64,
    depth: usize,
    parent: Option<usize>,
    length: f64,
    blend: f64,
}

struct Grower<'a> {
    random: Random,
    options: &'a TreeOptions,
    pieces: Vec<Piece>,
    primitives: Vec<Primitive>,
    tips: Vec<Tip>,
    branches: usize,
}

/// Trials to place a branch apart from the others.
const TRIALS: usize = 40;

impl Grower<'_> {
    /// The pieces of a branch; `None` where every trial meets another branch.
    fn path(&mut self, branch: &Branch) -> Option<Vec<Piece>> {
        const PIECES: usize = 4;
        for _ in 0..TRIALS {
            let mut direction = branch.direction;
            let mut at = branch.from;
            let bow = self.random.direction();
            let taper = self.random.uniform(0.85, 0.97);
            let radius = |n: usize| branch.radius * (1.0 + (taper - 1.0) * n as f64 / PIECES as f64);
            let mut path = Vec::new();
            for n in 0..PIECES {
                // The first and the last piece are longer and straight.
                let share = if n == 0 || n + 1 == PIECES { 0.3 } else { 0.2 };
                let next = at + direction * (branch.length * share);
                path.push(Piece { a: at, b: next, radii: [radius(n), radius(n + 1)], branch: self.branches, parent: branch.parent });
                at = next;
                direction = (direction + bow * 0.22).normalize();
            }
            if path.iter().all(|p| self.is_free(p)) {
                return Some(path);
            }
        }
        None
    }

    /// Whether a piece keeps apart from all branches but its parent and its siblings' beginnings.
    fn is_free(&self, p: &Piece) -> bool {
        self.pieces.iter().all(|q| {
            let kin = Some(q.branch) == p.parent || q.parent == p.parent;
            let gap = segment_distance(p, q) - p.radii[0].max(p.radii[1]) - q.radii[0].max(q.radii[1]);
            gap > 2.0 || kin && self.near_joint(p, q)
        })
    }

    /// Whether two pieces of a parent and its child, or of two siblings, meet where the branches join.
    fn near_joint(&self, p: &Piece, q: &Piece) -> bool {
        let first = |b: usize| self.pieces.iter().find(|x| x.branch == b).map(|x| x.a);
        let joint = if Some(q.branch) == p.parent { self.pieces.iter().rfind(|x| x.branch == q.branch).map(|x| x.b) } else { first(q.branch) };
        let reach = 4.5 * p.radii[0].max(q.radii[0]);
        joint.is_some_and(|j| (p.a - j).norm() < reach && (q.a - j).norm().min((q.b - j).norm()) < reach)
    }

    fn grow(&mut self, branch: Branch, path: Vec<Piece>) {
        let id = self.branches;
        self.branches += 1;
        for (n, p) in path.iter().enumerate() {
            let blend = if n == 0 { branch.blend } else { 0.0 };
            self.primitives.push(Primitive { shape: Shape::Capsule { a: p.a, b: p.b, radii: p.radii }, blend });
        }
        self.pieces.extend_from_slice(&path);
        let last = path[path.len() - 1];
        let radius = last.radii[1];
        let grown = branch.depth < self.options.depth && radius >= self.options.min_radius && self.divide(&branch, &last, id);
        if !grown {
            self.tips.push(Tip { from: last.a, to: last.b, radii: last.radii });
        }
    }

    /// Lets two branches leave the end of a piece; false where there is no room for both.
    fn divide(&mut self, branch: &Branch, last: &Piece, id: usize) -> bool {
        let axis = (last.b - last.a).normalize();
        let radius = last.radii[1];
        for _ in 0..TRIALS {
            // Murray's law: the cubes of the radii add up.
            let ratio = self.random.uniform(0.6, 1.0);
            let large = radius / (1.0f64 + ratio * ratio * ratio).cbrt();
            let small = ratio * large;
            let side = axis.cross(&self.random.direction());
            if side.norm() < 0.2 || small < 0.5 * self.options.min_radius {
                continue;
            }
            let side = side.normalize();
            let angles = [self.random.uniform(0.45, 0.7), -self.random.uniform(0.6, 0.95)];
            let mut placed: Vec<(Branch, Vec<Piece>)> = Vec::new();
            for (r, angle) in [large, small].into_iter().zip(angles) {
                let length = self.random.uniform(9.0, 13.0) * r;
                let direction = axis * angle.cos() + side * angle.sin();
                let child = Branch { from: last.b, direction, radius: r, depth: branch.depth + 1, parent: Some(id), length, blend: 0.5 * r };
                let Some(path) = self.path(&child) else { break };
                placed.push((child, path));
            }
            // Siblings must part soon: their last halves keep apart from each other.
            let apart = placed.len() == 2
                && placed[0].1[1..].iter().all(|p| {
                    placed[1].1[1..].iter().all(|q| segment_distance(p, q) > p.radii[0] + q.radii[0] + 2.0)
                });
            if !apart {
                continue;
            }
            if self.random.uniform(0.0, 1.0) < self.options.sac_probability {
                let size = self.random.uniform(1.7, 2.3) * radius;
                let center = last.b + (axis * 1.0 + self.random.direction() * 0.3).normalize() * (1.1 * size);
                let clear = self.pieces.iter().all(|q| q.branch == id || {
                    let p = Piece { a: center, b: center, radii: [size; 2], branch: id, parent: None };
                    segment_distance(&p, q) > size + q.radii[0] + 2.0
                });
                let ends_clear = placed.iter().all(|(_, path)| {
                    let p = Piece { a: center, b: center, radii: [size; 2], branch: id, parent: None };
                    path[2..].iter().all(|q| segment_distance(&p, q) > size + q.radii[0] + 1.0)
                });
                if clear && ends_clear {
                    self.primitives.push(Primitive { shape: Shape::Sphere { center, radius: size }, blend: 0.4 * radius });
                    // Branches grown later keep away from the sac.
                    self.pieces.push(Piece { a: center, b: center, radii: [size; 2], branch: id, parent: None });
                }
            }
            for (child, path) in placed {
                self.grow(child, path);
            }
            return true;
        }
        false
    }
}

/// Distance between two segments (Ericson 2005, 5.1.9).
fn segment_distance(p: &Piece, q: &Piece) -> f64 {
    let (d1, d2, r) = (p.b - p.a, q.b - q.a, p.a - q.a);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let (mut s, t);
    if a == 0.0 && e == 0.0 {
        return r.norm();
    }
    if a == 0.0 {
        s = 0.0;
        t = (f / e).clamp(0.0, 1.0);
    } else {
        let c = d1.dot(&r);
        if e == 0.0 {
            t = 0.0;
            s = (-c / a).clamp(0.0, 1.0);
        } else {
            let b = d1.dot(&d2);
            let denominator = a * e - b * b;
            s = if denominator > 0.0 { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.0 };
            let free = (b * s + f) / e;
            t = free.clamp(0.0, 1.0);
            if t != free {
                s = ((b * t - c) / a).clamp(0.0, 1.0);
            }
        }
    }
    ((p.a + d1 * s) - (q.a + d2 * t)).norm()
}
