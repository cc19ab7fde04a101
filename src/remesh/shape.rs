//! Shape of a triangle, by its smallest angle.
//!
//! Equi-angle skewness S = max((α−60°)/120°, 1−β/60°) with largest angle α and smallest β; since α ≤ 180°−2β it is
//! always 1−β/60°. The cosine of the smallest angle orders triangles the same way and needs no trigonometry.

use crate::geometry::Point;

/// Cosine of the smallest angle: 0.5 for the equilateral triangle, 1 for a degenerate one. NaN never.
#[inline]
pub fn worst_cosine(a: &Point, b: &Point, c: &Point) -> f64 {
    let (u, v, w) = (b - a, c - b, a - c);
    let (uu, vv, ww) = (u.norm_squared(), v.norm_squared(), w.norm_squared());
    // The smallest angle lies across from the shortest edge.
    let (o, p, q) = if uu <= vv && uu <= ww {
        (uu, vv, ww)
    } else if vv <= ww {
        (vv, uu, ww)
    } else {
        (ww, uu, vv)
    };
    let pq = (p * q).sqrt();
    if pq > 0.0 { ((p + q - o) / (2.0 * pq)).clamp(0.5, 1.0) } else { 1.0 }
}

/// Equi-angle skewness of a triangle: 0 equilateral, 1 degenerate.
pub fn skewness(a: &Point, b: &Point, c: &Point) -> f64 {
    skewness_of_cosine(worst_cosine(a, b, c))
}

/// Equi-angle skewness of a triangle whose smallest angle has this cosine.
pub fn skewness_of_cosine(cosine: f64) -> f64 {
    1.0 - cosine.clamp(-1.0, 1.0).acos() / std::f64::consts::FRAC_PI_3
}

/// Cosine of the smallest angle of a triangle with skewness `s`.
pub fn cosine_of_skewness(s: f64) -> f64 {
    ((1.0 - s) * std::f64::consts::FRAC_PI_3).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_triangles() {
        let p = Point::new;
        let s = |a, b, c| skewness(&a, &b, &c);
        assert!(s(p(0., 0., 0.), p(1., 0., 0.), p(0.5, 0.75f64.sqrt(), 0.)).abs() < 1e-7);
        assert!((s(p(0., 0., 0.), p(1., 0., 0.), p(0., 1., 0.)) - 0.25).abs() < 1e-12);
        assert_eq!(s(p(0., 0., 0.), p(1., 0., 0.), p(2., 0., 0.)), 1.0);
        assert_eq!(s(p(0., 0., 0.), p(0., 0., 0.), p(2., 0., 0.)), 1.0);
        // 120° at the middle: both formulas give the same.
        let t = s(p(0., 0., 0.), p(1., 0., 0.), p(1.5, 0.75f64.sqrt(), 0.));
        assert!((t - 0.5).abs() < 1e-12);
        assert!((skewness_of_cosine(cosine_of_skewness(0.45)) - 0.45).abs() < 1e-12);
    }
}
