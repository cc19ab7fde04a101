//! Triangulation of a planar polygon by ear clipping with exact predicates.

use robust::{Coord, orient2d};

fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    orient2d(Coord { x: a[0], y: a[1] }, Coord { x: b[0], y: b[1] }, Coord { x: c[0], y: c[1] })
}

/// Triangles of a simple, counter-clockwise polygon, as indices into `polygon`; `None` where it is not simple or
/// not counter-clockwise. The best-shaped ear is clipped first. O(n²) for round polygons.
pub fn triangulate(polygon: &[[f64; 2]]) -> Option<Vec<[usize; 3]>> {
    let mut ring: Vec<usize> = (0..polygon.len()).collect();
    let mut triangles = Vec::with_capacity(polygon.len().saturating_sub(2));
    while ring.len() > 3 {
        let n = ring.len();
        let corner = |i: usize| [ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]];
        let mut best: Option<(f64, usize)> = None;
        for i in 0..n {
            let t = corner(i);
            let [a, b, c] = t.map(|v| polygon[v]);
            let area = turn(a, b, c);
            if area <= 0.0 {
                continue;
            }
            let length = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
            let shape = area / (length(a, b) + length(b, c) + length(c, a));
            if best.is_some_and(|(s, _)| s >= shape) {
                continue;
            }
            let inside = |p: [f64; 2]| turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0;
            if ring.iter().all(|v| t.contains(v) || !inside(polygon[*v])) {
                best = Some((shape, i));
            }
        }
        let (_, i) = best?;
        triangles.push(corner(i));
        ring.remove(i);
    }
    let last: [usize; 3] = ring.try_into().ok()?;
    let [a, b, c] = last.map(|v| polygon[v]);
    if turn(a, b, c) <= 0.0 {
        return None;
    }
    triangles.push(last);
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(p: &[[f64; 2]], t: &[[usize; 3]]) -> f64 {
        t.iter().map(|&[a, b, c]| 0.5 * turn(p[a], p[b], p[c])).sum()
    }

    #[test]
    fn a_bent_polygon_is_covered_exactly_once() {
        let l = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]];
        let t = triangulate(&l).expect("simple");
        assert_eq!(t.len(), 4);
        assert_eq!(area(&l, &t), 5.0);
    }

    #[test]
    fn clockwise_and_crossing_polygons_are_refused() {
        assert!(triangulate(&[[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]).is_none());
        assert!(triangulate(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]).is_none());
    }
}
