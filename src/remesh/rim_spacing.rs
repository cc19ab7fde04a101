//! Rims divided evenly: as many edges as their length holds, all equally long for what is wished.
//!
//! Splits and collapses alone leave a closed curve with too many edges: a collapse doubles its neighbour, so a rim of
//! edges that are all a little short stays as it is. Here each rim is looked at as a whole.

use super::relax::apply;
use super::surface::{Kind, Surface};
use crate::geometry::{Point, Vector};

/// Length of the edges that isotropic remeshing makes, over the wished one: where its splits and collapses balance.
/// Measured on surfaces of one size, with the default thresholds of splitting and collapsing.
pub(crate) const BALANCE: f64 = 0.921;

/// Vertices along one rim; a closed one does not repeat its first vertex.
struct Chain {
    vertices: Vec<u32>,
    closed: bool,
}

/// Gives every rim its number of edges, `factor` times as long as usual, by collapses of its shortest and splits of its
/// longest ones, and spaces them evenly. Returns the collapses and splits.
pub(crate) fn space_rims(s: &mut Surface, factor: f64) -> (usize, usize) {
    let (mut collapses, mut splits) = (0, 0);
    for chain in chains(s) {
        let (fewer, chain) = thin_out(s, chain, factor);
        let (more, chain) = fill_up(s, chain, factor);
        collapses += fewer;
        splits += more;
        distribute(s, &chain);
    }
    (collapses, splits)
}

fn chains(s: &Surface) -> Vec<Chain> {
    let on_rim = |v: u32| s.mesh.has_vertex(v) && matches!(s.kind[v as usize], Kind::Curve(..));
    let mut seen = vec![false; s.mesh.points.len()];
    let mut found = Vec::new();
    for start in 0..s.mesh.points.len() as u32 {
        if seen[start as usize] || !on_rim(start) {
            continue;
        }
        let mut vertices = vec![start];
        seen[start as usize] = true;
        let mut closed = false;
        // Forwards from the start, then backwards, up to a vertex that is held.
        for direction in 0..2 {
            let Some(mut next) = s.feature_neighbours(start).map(|pair| pair[direction]) else { break };
            let mut at = start;
            loop {
                if next == start {
                    closed = true;
                    break;
                }
                vertices.push(next);
                if !on_rim(next) || seen[next as usize] {
                    break;
                }
                seen[next as usize] = true;
                let Some([a, b]) = s.feature_neighbours(next) else { break };
                (at, next) = (next, if a == at { b } else { a });
            }
            if closed {
                break;
            }
            // What was walked becomes the beginning of the chain.
            vertices.reverse();
        }
        found.push(Chain { vertices, closed });
    }
    found
}

impl Chain {
    fn edges(&self) -> usize {
        if self.closed { self.vertices.len() } else { self.vertices.len() - 1 }
    }

    fn edge(&self, i: usize) -> (u32, u32) {
        (self.vertices[i], self.vertices[(i + 1) % self.vertices.len()])
    }

    fn lengths(&self, s: &Surface) -> Vec<f64> {
        (0..self.edges()).map(|i| self.edge(i)).map(|(a, b)| s.relative_length2(a, b).sqrt()).collect()
    }

    /// Edges that its length holds.
    fn wanted(&self, s: &Surface, factor: f64) -> usize {
        let total: f64 = self.lengths(s).iter().sum();
        ((total / (BALANCE * factor)).round() as usize).max(if self.closed { 6 } else { 1 })
    }
}

fn thin_out(s: &mut Surface, mut chain: Chain, factor: f64) -> (usize, Chain) {
    let wanted = chain.wanted(s, factor);
    let mut count = 0;
    while chain.edges() > wanted {
        let lengths = chain.lengths(s);
        let mut order: Vec<usize> = (0..lengths.len()).collect();
        order.sort_by(|&i, &j| lengths[i].total_cmp(&lengths[j]).then(i.cmp(&j)));
        let gone = order.into_iter().find_map(|i| {
            let (a, b) = chain.edge(i);
            [(a, b), (b, a)].into_iter().find(|&(from, to)| {
                let may = matches!(s.kind[from as usize], Kind::Curve(..));
                let h = s.mesh.find(from, to).filter(|&h| may && super::isotropic::collapse_stands(s, h, 4.0 * factor * factor) && s.may_collapse(h));
                h.map(|h| s.collapse(h)).is_some()
            })
        });
        let Some((from, _)) = gone else { break };
        chain.vertices.retain(|&v| v != from);
        count += 1;
    }
    (count, chain)
}

fn fill_up(s: &mut Surface, mut chain: Chain, factor: f64) -> (usize, Chain) {
    let wanted = chain.wanted(s, factor);
    let mut count = 0;
    while chain.edges() < wanted {
        let lengths = chain.lengths(s);
        let longest = (0..lengths.len()).max_by(|&i, &j| lengths[i].total_cmp(&lengths[j]).then(j.cmp(&i)));
        let Some(i) = longest else { break };
        let (a, b) = chain.edge(i);
        let place = s.mesh.find(a, b).and_then(|h| s.place_on_edge(h, 0.5).map(|p| (h, p)));
        let Some((h, place)) = place.filter(|(h, p)| super::isotropic::split_stands(s, *h, &p.0, &p.1)) else { break };
        let v = s.split(h, place);
        chain.vertices.insert(i + 1, v);
        count += 1;
    }
    (count, chain)
}

/// Moves the vertices along the rim to equal edges, as little as that takes on the whole.
fn distribute(s: &mut Surface, chain: &Chain) {
    let lengths = chain.lengths(s);
    let n = lengths.len();
    if n < 2 {
        return;
    }
    let mut at = Vec::with_capacity(n + 1);
    at.push(0.0);
    for l in &lengths {
        at.push(at[at.len() - 1] + l);
    }
    let total = at[n];
    let step = total / n as f64;
    let shift = if chain.closed { (0..n).map(|i| at[i] - i as f64 * step).sum::<f64>() / n as f64 } else { 0.0 };
    let place = |x: f64| {
        let x = if chain.closed { x.rem_euclid(total) } else { x };
        let i = at.partition_point(|y| *y <= x).clamp(1, n) - 1;
        let (a, b) = chain.edge(i);
        let t = if lengths[i] > 0.0 { ((x - at[i]) / lengths[i]).clamp(0.0, 1.0) } else { 0.0 };
        s.point(a) + (s.point(b) - s.point(a)) * t
    };
    let moved: Vec<Option<(Point, Vector)>> = chain
        .vertices
        .iter()
        .enumerate()
        .map(|(i, &v)| {
            let on_rim = matches!(s.kind[v as usize], Kind::Curve(..));
            let p = place(shift + i as f64 * step);
            on_rim.then(|| s.project(v, &p, s.size[v as usize])).flatten()
        })
        .collect();
    apply(s, &chain.vertices, moved);
}

#[cfg(test)]
mod tests {
    use crate::geometry::{Plane, Point, Vector};
    use crate::mesh::topology;
    use crate::remesh::isotropic::{IsotropicOptions, remesh};
    use crate::remesh::testing::{Capsules, cut_and_cap, polygonize};
    use crate::remesh::{Supports, Uniform};

    #[test]
    fn a_rim_has_equal_edges_as_long_as_the_wall_s() {
        let f = Capsules::tube(2.0, 10.0);
        let plane = Plane::new(Point::new(0.1, 0.0, 2.3), Vector::new(0.0, 0.0, 1.0)).unwrap();
        let cut = cut_and_cap(&polygonize(&f, 0.35), &plane, 2);
        let supports = Supports::new(&f).with_plane(2, plane);
        let (m, _) = remesh(&cut, &supports, &Uniform(0.5), &IsotropicOptions::default()).unwrap();
        let r = topology::check(&m);
        assert!(r.is_closed_manifold() && r.euler == 2);
        let (mut rim, mut wall) = (Vec::new(), Vec::new());
        for (t, ids) in m.triangles.iter().enumerate() {
            for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (m.points[ids[i] as usize], m.points[ids[j] as usize])) {
                let on_rim = [a, b].iter().all(|p| plane.signed_distance(p).abs() < 1e-12);
                match (m.patch[t], on_rim) {
                    (2, _) => {}
                    (_, true) => rim.push((b - a).norm()),
                    _ => wall.push((b - a).norm()),
                }
            }
        }
        let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len() as f64;
        let spread = rim.iter().map(|l| (l - mean(&rim)).abs()).fold(0.0, f64::max);
        assert!(spread < 0.05 * mean(&rim), "{spread} {}", mean(&rim));
        assert!((mean(&rim) / mean(&wall) - 1.0).abs() < 0.05, "{} {}", mean(&rim), mean(&wall));
    }
}
