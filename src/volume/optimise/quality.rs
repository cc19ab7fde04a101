//! The measure that is optimised: volume over that of the regular tetrahedron with the same circumradius.

use crate::geometry::{Point, Vector};

/// Volume of the regular tetrahedron over the cube of its circumradius: 8√3/27.
const REGULAR: f64 = 0.513_200_239_279_667_3;

/// 1 − equi-volume skewness of a positive tetrahedron: 1 for the regular one, 0 or less for a flat or inverted one.
#[inline]
pub fn quality(p: &[Point; 4]) -> f64 {
    let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
    let bc = b.cross(&c);
    let v: Vector = bc * a.norm_squared() + c.cross(&a) * b.norm_squared() + a.cross(&b) * c.norm_squared();
    quality_of(a.dot(&bc), v.norm_squared())
}

/// [`quality`] from six times the volume V and the square of |v| = 2 R · 6V.
#[inline]
pub(super) fn quality_of(six: f64, n2: f64) -> f64 {
    // V / (REGULAR R³) = (6V)⁴ · 8 / (6 REGULAR |v|³).
    if n2 <= 0.0 {
        return 0.0;
    }
    let s2 = six * six;
    let q = s2 * s2 * (8.0 / (6.0 * REGULAR)) / (n2 * n2.sqrt());
    if !q.is_finite() {
        return 0.0;
    }
    if six > 0.0 { q } else { -q }
}

/// [`shape`] at the limits aimed at: equi-volume skewness 0.8, dihedral angles of 15° and 155°.
pub const AIM: f64 = 0.2;

/// [`quality`], held down where a dihedral angle is sharp or flat: 0.2 at 15° and at 155°, the limits aimed at.
#[inline]
pub fn shape(p: &[Point; 4]) -> f64 {
    held_down(quality(p), p)
}

/// As [`shape`]; where that is not above `floor`, some number that is not.
#[inline]
pub(super) fn shape_above(p: &[Point; 4], floor: f64) -> f64 {
    let q = quality(p);
    if q <= floor { q } else { held_down(q, p) }
}

/// The shape of a tetrahedron with the quality `q`.
#[inline]
fn held_down(q: f64, p: &[Point; 4]) -> f64 {
    if has_poor_angles(q) { q.min(angles(p)) } else { q }
}

/// Whether a tetrahedron with the quality `q` may be held down by its angles: a better one has none that does, and a flat
/// one is bad enough.
#[inline]
pub(super) fn has_poor_angles(q: f64) -> bool {
    q > 0.0 && q < 0.5
}

/// Sine of the dihedral angles over that of 15° (acute) and of 155° (obtuse), the least, times 0.2.
fn angles(p: &[Point; 4]) -> f64 {
    let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
    angles_of(a.cross(&b), b.cross(&c), c.cross(&a))
}

/// [`angles`] from the normals, all inwards, of the three faces at one corner, each twice as long as its face is large.
#[inline]
pub(super) fn angles_of(x: Vector, y: Vector, z: Vector) -> f64 {
    const ACUTE: f64 = 0.2 / 0.258_819_045_102_520_74;
    const OBTUSE: f64 = 0.2 / 0.422_618_261_740_699_4;
    let n = [x, y, z, -(x + y + z)];
    let r = n.map(|v| 1.0 / v.norm_squared());
    let mut least = 1.0f64;
    for i in 0..4 {
        for j in 0..i {
            let d = n[i].dot(&n[j]);
            let sine2 = (1.0 - d * d * (r[i] * r[j])).max(0.0);
            least = least.min(sine2 * if d < 0.0 { ACUTE * ACUTE } else { OBTUSE * OBTUSE });
        }
    }
    least.sqrt()
}

/// Six times the volume.
#[inline]
pub fn volume6(p: &[Point; 4]) -> f64 {
    (p[1] - p[0]).cross(&(p[2] - p[0])).dot(&(p[3] - p[0]))
}

/// Least and largest dihedral angle, degrees.
pub fn dihedral_range(p: &[Point; 4]) -> (f64, f64) {
    let n = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]
        .map(|[a, b, c]: [usize; 3]| (p[b] - p[a]).cross(&(p[c] - p[a])).normalize());
    let (mut lo, mut hi) = (1.0f64, -1.0f64);
    for i in 0..4 {
        for j in 0..i {
            let cosine = -n[i].dot(&n[j]);
            lo = lo.min(cosine);
            hi = hi.max(cosine);
        }
    }
    (hi.min(1.0).acos().to_degrees(), lo.max(-1.0).acos().to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn regular(scale: f64) -> [Point; 4] {
        [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(|p| Point::from(p) * scale)
    }

    #[test]
    fn the_regular_tetrahedron_is_one_at_any_size_and_a_flat_one_nothing() {
        for scale in [1e-6, 1.0, 1e5] {
            let p = regular(scale);
            let p = if volume6(&p) > 0.0 { p } else { [p[0], p[2], p[1], p[3]] };
            assert!((quality(&p) - 1.0).abs() < 1e-12);
            assert!((quality(&[p[1], p[0], p[2], p[3]]) + 1.0).abs() < 1e-12);
            let (lo, hi) = dihedral_range(&p);
            assert!((lo - 70.528_779).abs() < 1e-5 && (hi - lo).abs() < 1e-9);
        }
        let flat = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].map(Point::from);
        assert_eq!(quality(&flat), 0.0);
    }

    #[test]
    fn sharp_and_flat_angles_hold_the_shape_down() {
        // Two equilateral triangles hinged at an edge, opened by an angle.
        let hinge = |degrees: f64| {
            let (s, c) = degrees.to_radians().sin_cos();
            let h = 0.75f64.sqrt();
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, h, 0.0], [0.5, h * c, h * s]].map(Point::from)
        };
        for degrees in [15.0, 155.0] {
            let p = hinge(degrees);
            assert!((angles(&p) - 0.2).abs() < 1e-9 || dihedral_range(&p).0 < 15.0, "{degrees}: {}", angles(&p));
            assert!(shape(&p) <= 0.2 + 1e-9);
        }
        assert_eq!(shape(&hinge(70.528_779)), quality(&hinge(70.528_779)));
        assert!(shape(&hinge(10.0)) < shape(&hinge(20.0)) && shape(&hinge(160.0)) < shape(&hinge(140.0)));
    }

    #[test]
    fn the_corner_of_a_cube_has_its_known_skewness() {
        // V = 1/6, R = √3/2: 1 − S = (1/6) / (8√3/27 · 3√3/8) = 1/2.
        let p = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Point::from);
        assert!((quality(&p) - 0.5).abs() < 1e-12);
    }
}
