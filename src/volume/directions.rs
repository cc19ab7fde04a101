//! Directions in which layers grow from the wall: each sees all its triangles from behind, and neighbours' are alike.

use rayon::prelude::*;

use crate::geometry::Vector;

/// Least cosine to the triangles' normals that evening out may leave, where the wall allows it.
const SEEN: f64 = 0.5;

/// What a vertex of the wall knows of its neighbourhood.
#[derive(Clone, Default)]
pub(super) struct Corner {
    /// Unit outward normals of its wall triangles.
    pub faces: Vec<Vector>,
    /// Their sum weighted by angles, of unit length.
    pub normal: Vector,
    /// Wall vertices next to it.
    pub neighbours: Vec<u32>,
    /// Unit normal of the cap whose plane it must stay in.
    pub rim: Option<Vector>,
}

impl Corner {
    fn into_plane(&self, d: Vector) -> Vector {
        match self.rim {
            Some(n) => (d - n * n.dot(&d)).try_normalize(1e-9).unwrap_or(d),
            None => d.try_normalize(0.0).unwrap_or(d),
        }
    }

    /// The least cosine between `d` and the triangles' inward normals, and the triangle it belongs to.
    fn seen(&self, d: &Vector) -> (f64, usize) {
        let each = self.faces.iter().enumerate().map(|(i, n)| (-n.dot(d), i));
        each.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((1.0, 0))
    }

    /// The inward normal; where a triangle is hardly seen from it, the direction from which the worst is seen best
    /// (steps towards the worst of falling length, as for the smallest ball round points).
    fn start(&self) -> Vector {
        let mut d = self.into_plane(-self.normal);
        let (mut best, mut value) = (d, self.seen(&d).0);
        if value >= SEEN {
            return best;
        }
        for k in 1..200 {
            let (_, i) = self.seen(&d);
            d = self.into_plane(d - self.faces[i] / f64::from(k + 1));
            let v = self.seen(&d).0;
            if v > value {
                (best, value) = (d, v);
            }
        }
        best
    }
}

/// The direction of each vertex, of unit length; off the wall anything.
pub(super) fn directions(corners: &[Corner]) -> Vec<Vector> {
    let mut d: Vec<Vector> = corners.par_iter().map(Corner::start).collect();
    let least: Vec<f64> = corners.iter().zip(&d).map(|(c, d)| c.seen(d).0.min(SEEN)).collect();
    for _ in 0..5 {
        d = corners
            .par_iter()
            .enumerate()
            .map(|(v, c)| {
                let sum: Vector = c.neighbours.iter().map(|&w| d[w as usize]).sum();
                let even = c.into_plane(d[v] + sum / c.neighbours.len().max(1) as f64);
                // Never so far that a triangle turns its back.
                if c.seen(&even).0 >= least[v] { even } else { d[v] }
            })
            .collect();
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ridge of a roof: many triangles on one side, one on the other.
    fn ridge(half_angle: f64) -> Corner {
        let (s, c) = half_angle.to_radians().sin_cos();
        let (left, right) = (Vector::new(-c, 0.0, s), Vector::new(c, 0.0, s));
        let faces = vec![left, left, left, left, right];
        let normal = (left * 0.9 + right * 0.1).normalize();
        Corner { faces, normal, neighbours: vec![], rim: None }
    }

    #[test]
    fn on_a_sharp_ridge_both_sides_are_seen_alike() {
        // Half of 36°: both sides are seen at best under the sine of 18°.
        let d = directions(&[ridge(18.0)])[0];
        let seen = ridge(18.0).seen(&d).0;
        assert!((seen - 18f64.to_radians().sin()).abs() < 0.02, "{d:?} {seen}");
        // The mean normal would not see the other side at all.
        assert!(ridge(18.0).seen(&-ridge(18.0).normal).0 < 0.0);
    }

    #[test]
    fn at_a_rim_layers_grow_in_the_plane_of_the_cap() {
        let mut c = ridge(40.0);
        c.rim = Some(Vector::new(0.0, 1.0, 0.1).normalize());
        let d = directions(std::slice::from_ref(&c))[0];
        assert!(d.dot(&Vector::new(0.0, 1.0, 0.1)).abs() < 1e-12 && (d.norm() - 1.0).abs() < 1e-12 && c.seen(&d).0 > 0.5);
    }

    #[test]
    fn evening_out_leaves_every_triangle_seen() {
        let mut a = ridge(18.0);
        a.neighbours = vec![1];
        let flat = Corner { faces: vec![Vector::x()], normal: Vector::x(), neighbours: vec![0], rim: None };
        let d = directions(&[a.clone(), flat.clone()]);
        assert!(a.seen(&d[0]).0 > 0.28 && flat.seen(&d[1]).0 >= 0.5);
    }
}
