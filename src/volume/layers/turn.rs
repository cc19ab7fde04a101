//! Where layers are in trouble, directions turn and caps even out before thickness is taken back.

use super::{LEAST_JACOBIAN, LayerOptions, Wall, scaled_jacobian, skewness};
use crate::geometry::{Point, Vector};
use crate::mesh::{TriMesh, WALL};

/// Triangles of a cap above this skewness are evened out.
const EVEN_ABOVE: f64 = 0.5;

/// Turns the directions of these vertices to where the worst prism and inner triangle at each is better. Gives how many.
pub(super) fn turn(wall: &mut Wall, s: &TriMesh, t: &[f64], steps: &[f64], o: &LayerOptions, vertices: &[u32]) -> usize {
    let mut stars = vec![vec![]; vertices.len()];
    for &tri in &wall.triangles {
        for v in s.triangles[tri] {
            if let Ok(i) = vertices.binary_search(&v) {
                stars[i].push(tri);
            }
        }
    }
    let mut turned = 0;
    for (&v, star) in vertices.iter().zip(&stars) {
        let i = v as usize;
        let worst = |wall: &Wall| star.iter().map(|&tri| want(wall, s, t, steps, o, tri)).fold(0.0, f64::max);
        let mut now = worst(wall);
        let mut better = false;
        for step in [0.3, 0.15, 0.07] {
            for k in 0..8 {
                let (d, stretch) = (wall.direction[i], wall.stretch[i]);
                let (u, w) = across(&d);
                let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_4).sin_cos();
                let mut new = d + (u * cos + w * sin) * step;
                if let Some(n) = wall.rim[i] {
                    new -= n * n.dot(&new);
                }
                let Some(new) = new.try_normalize(1e-9) else { continue };
                wall.direction[i] = new;
                wall.stretch[i] = 1.0 / (-new.dot(&wall.normal[i])).max(0.5);
                let w = worst(wall);
                if w < now - 1e-3 {
                    (now, better) = (w, true);
                } else {
                    (wall.direction[i], wall.stretch[i]) = (d, stretch);
                }
            }
        }
        turned += usize::from(better);
    }
    turned
}

/// How far the prisms on a triangle of the wall are from what is wanted: above 1 where they miss it.
fn want(wall: &Wall, s: &TriMesh, t: &[f64], steps: &[f64], o: &LayerOptions, tri: usize) -> f64 {
    let c = s.triangles[tri];
    let at = |f: f64| c.map(|v| wall.level(s, t, v, f));
    let inner = skewness(&at(1.0)) / o.max_inner_skewness.max(skewness(&s.corners(tri)) + 0.05);
    let prism = |w: &[f64]| {
        let ([a, b, c], [d, e, f]) = (at(w[0]), at(w[1]));
        scaled_jacobian(&[a, b, c, d, e, f])
    };
    let least = steps.windows(2).map(prism).fold(f64::INFINITY, f64::min);
    // Below nothing too, less bad must count as better.
    inner.max(1.0 + (LEAST_JACOBIAN - least))
}

/// Two unit vectors at right angles to `d` and to each other.
fn across(d: &Vector) -> (Vector, Vector) {
    let axis = if d.x.abs() < 0.6 { Vector::x() } else { Vector::y() };
    let u = d.cross(&axis).normalize();
    (u, d.cross(&u))
}

/// Moves the points within the caps, in their planes, where a triangle has become skewed as the rim moved in.
pub(super) fn even_caps(s: &TriMesh, on_wall: &[bool], points: &mut [Point]) {
    let skewed = |points: &[Point], t: usize| {
        let p = s.triangles[t].map(|v| points[v as usize]);
        // Turned over is worse than flat.
        let n = (p[1] - p[0]).cross(&(p[2] - p[0]));
        if n.dot(&s.area_vector2(t)) > 0.0 { skewness(&p) } else { 2.0 }
    };
    let caps: Vec<usize> = (0..s.triangles.len()).filter(|&t| s.patch[t] != WALL).collect();
    if caps.iter().all(|&t| skewed(points, t) <= EVEN_ABOVE) {
        return;
    }
    let mut stars = vec![vec![]; s.points.len()];
    for &t in &caps {
        s.triangles[t].iter().filter(|&&v| !on_wall[v as usize]).for_each(|&v| stars[v as usize].push(t));
    }
    for _ in 0..20 {
        let mut moved = false;
        for v in 0..points.len() {
            let Some(&first) = stars[v].first() else { continue };
            let worst = |points: &[Point]| stars[v].iter().map(|&t| skewed(points, t)).fold(0.0, f64::max);
            let mut now = worst(points);
            if now <= EVEN_ABOVE {
                continue;
            }
            // In the plane to rounding: the axes are edges of the cap.
            let [a, b, c] = s.corners(first);
            let (u, w) = ((b - a).normalize(), (c - a).normalize());
            let length = stars[v].iter().map(|&t| s.area_vector2(t).norm().sqrt()).fold(f64::INFINITY, f64::min);
            for step in [0.2, 0.07, 0.02] {
                for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (0.7, 0.7), (-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7)] {
                    let here = points[v];
                    points[v] = here + (u * x + w * y) * (step * length);
                    let new = worst(points);
                    if new < now - 1e-4 {
                        (now, moved) = (new, true);
                    } else {
                        points[v] = here;
                    }
                }
            }
        }
        if !moved {
            break;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_points_of_a_cap_even_out_in_their_plane() {
        // A hexagon's middle, drawn to one side; a wall triangle hangs on its rim.
        let mut points: Vec<Point> = (0..6)
            .map(|k| f64::from(k) * std::f64::consts::FRAC_PI_3)
            .map(|a| Point::new(a.cos(), a.sin(), 0.5))
            .collect();
        points.push(Point::new(0.0, 0.0, 0.5));
        let triangles: Vec<[u32; 3]> = (0..6).map(|k| [6, k, (k + 1) % 6]).collect();
        let s = TriMesh { patch: vec![2; 6], ..TriMesh::new(points.clone(), triangles) };
        let on_wall = [vec![true; 6], vec![false]].concat();
        let mut moved = points.clone();
        moved[6] = Point::new(0.75, 0.0, 0.5);
        even_caps(&s, &on_wall, &mut moved);
        let worst = (0..6).map(|t| skewness(&s.triangles[t].map(|v| moved[v as usize]))).fold(0.0, f64::max);
        assert!(worst < 0.51, "{worst}");
        assert_eq!(moved[..6], points[..6]);
        assert_eq!(moved[6].z, 0.5);
    }
}
