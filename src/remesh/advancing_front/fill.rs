//! Closing of the loops that the front leaves: the best triangulation without new vertices.

use super::grow::shape;
use super::state::Front;

/// Loops with more edges are not filled.
const LONGEST: usize = 96;

/// Fills the loop of front nodes; false, with nothing changed, where it is too long or has no triangulation whose
/// inner edges are new to the mesh. Dynamic programming over all triangulations (Barequet and Sharir 1995), O(n³).
pub(super) fn fill(front: &mut Front, nodes: &[u32]) -> bool {
    let n = nodes.len();
    if !(3..=LONGEST).contains(&n) {
        return false;
    }
    let v: Vec<u32> = nodes.iter().map(|&i| front.node(i).vertex).collect();
    let cost = |i: usize, k: usize, j: usize| {
        let [a, b, c] = [v[i], v[k], v[j]];
        if a == b || b == c || c == a {
            return f64::INFINITY;
        }
        let [p, q, r] = [a, b, c].map(|x| front.points[x as usize]);
        let normal = (q - p).cross(&(r - p));
        let faces = [a, b, c].iter().map(|&x| normal.dot(&front.normals[x as usize])).fold(f64::INFINITY, f64::min);
        let cosine = if normal.norm() > 0.0 { faces / normal.norm() } else { -1.0 };
        // A triangle that turns away costs more than any number of flat ones.
        let fold = if cosine < 0.3 { 1e3 * (1.0 - cosine) } else { 0.0 };
        let size = front.sizes[a as usize];
        fold + (1.0 - shape(&p, &q, &r)).powi(2) + 0.05 * normal.norm() / (size * size)
    };
    let allowed = |i: usize, j: usize| j - i == 1 || (i == 0 && j == n - 1) || !front.has_edge(v[i], v[j]);
    let mut best = vec![0.0; n * n];
    let mut choice = vec![0usize; n * n];
    for span in 2..n {
        for i in 0..n - span {
            let j = i + span;
            best[i * n + j] = f64::INFINITY;
            if !allowed(i, j) {
                continue;
            }
            for k in i + 1..j {
                let sides = best[i * n + k] + best[k * n + j];
                if sides.is_finite() {
                    let c = sides + cost(i, k, j);
                    if c < best[i * n + j] {
                        (best[i * n + j], choice[i * n + j]) = (c, k);
                    }
                }
            }
        }
    }
    if !best[n - 1].is_finite() {
        return false;
    }
    let mut triangles = Vec::with_capacity(n - 2);
    let mut inner = Vec::new();
    let mut stack = vec![(0, n - 1)];
    while let Some((i, j)) = stack.pop() {
        if j - i < 2 {
            continue;
        }
        let k = choice[i * n + j];
        triangles.push([v[i], v[k], v[j]]);
        if (i, j) != (0, n - 1) {
            inner.push((v[i].min(v[j]), v[i].max(v[j])));
        }
        stack.extend([(i, k), (k, j)]);
    }
    // A loop that passes a vertex twice could name the same edge twice.
    inner.sort_unstable();
    if inner.windows(2).any(|w| w[0] == w[1]) {
        return false;
    }
    front.kill_all(nodes);
    triangles.into_iter().for_each(|t| front.add_triangle(t));
    true
}
