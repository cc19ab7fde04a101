//! What of the mask lies on the kept side of the cuts.

use crate::geometry::{Point, Vector};
use crate::mask::Mask;

use super::Cut;

/// Discs of a cut reach this many vessel radii: a vessel that is wider than its inscribed sphere is still cut through.
const DISC: f64 = 2.5;

/// Volume of the mask's voxels that no cut took away, mm³.
///
/// From each cut's far side the lumen is flooded, face by face, without passing back through the disc of a cut; what
/// the flood reaches is gone. A voxel that a plane passes through counts by the share of its extent along the normal
/// that lies on the kept side. A cut whose flood comes round to its own near side, as in a ring, takes away only what
/// lies beyond its plane within its reach of the disc.
pub fn kept_volume(mask: &Mask, cuts: &[Cut]) -> f64 {
    let grid = &mask.grid;
    let mut gone = vec![false; mask.data.len()];
    let center = |n: usize| grid.to_world(Vector::from(grid.voxel(n).map(|v| v as f64)));
    let side = |cut: &Cut, p: &Point| cut.plane.signed_distance(p);
    let in_disc = |cut: &Cut, p: &Point| (cut.plane.project(p) - cut.plane.origin).norm() <= DISC * cut.radius;
    let step = grid.spacing().into_iter().fold(0.0, f64::max);
    for cut in cuts {
        let mut flood: Vec<usize> = near(mask, &cut.plane.origin, DISC * cut.radius + 2.0 * step)
            .filter(|&n| {
                let p = center(n);
                let d = side(cut, &p);
                mask.data[n] != 0 && !gone[n] && d > 0.0 && d <= 1.5 * step && in_disc(cut, &p)
            })
            .collect();
        flood.iter().for_each(|&n| gone[n] = true);
        let mut taken = flood.clone();
        let mut ring = false;
        while let Some(n) = flood.pop() {
            let p = center(n);
            for m in neighbours(mask, n) {
                if mask.data[m] == 0 || gone[m] {
                    continue;
                }
                let q = center(m);
                let passes = |c: &Cut| (side(c, &p) > 0.0) != (side(c, &q) > 0.0) && (in_disc(c, &p) || in_disc(c, &q));
                if cuts.iter().any(passes) {
                    continue;
                }
                let d = side(cut, &q);
                ring |= d <= 0.0 && d > -1.5 * step && (q - cut.plane.origin).norm() <= cut.radius;
                gone[m] = true;
                taken.push(m);
                flood.push(m);
            }
        }
        if ring {
            for n in taken {
                let p = center(n);
                gone[n] = side(cut, &p) > 0.0 && (p - cut.plane.origin).norm() <= DISC * cut.radius;
            }
        }
    }
    // A voxel at the disc of a cut counts by its share on the kept side.
    let mut kept = (0..gone.len()).filter(|&n| mask.data[n] != 0 && !gone[n]).count() as f64;
    for cut in cuts {
        let half = 0.5 * (0..3).map(|a| grid.axes.column(a).dot(&cut.plane.normal).abs()).sum::<f64>();
        for n in near(mask, &cut.plane.origin, DISC * cut.radius + 2.0 * half) {
            let p = center(n);
            let d = side(cut, &p);
            if mask.data[n] != 0 && d.abs() < half && in_disc(cut, &p) && gone[n] == (d > 0.0) {
                let share = 0.5 - 0.5 * d / half;
                kept += if gone[n] { share } else { share - 1.0 };
            }
        }
    }
    kept * grid.voxel_volume()
}

/// Voxels of the index box round a ball.
fn near<'a>(mask: &'a Mask, center: &Point, radius: f64) -> impl Iterator<Item = usize> + 'a {
    let c = mask.grid.to_index(center);
    let s = mask.grid.spacing();
    let range = |a: usize| {
        let r = radius / s[a];
        let last = mask.grid.dims[a] as f64 - 1.0;
        let low = (c[a] - r).ceil().clamp(0.0, last + 1.0) as i64;
        let high = (c[a] + r).floor().clamp(-1.0, last) as i64;
        low..=high
    };
    let (x, y, z) = (range(0), range(1), range(2));
    z.flat_map(move |k| {
        let x = x.clone();
        y.clone().flat_map(move |j| x.clone().map(move |i| (i, j, k)))
    })
    .filter_map(|(i, j, k)| mask.grid.linear(i, j, k))
}

fn neighbours(mask: &Mask, n: usize) -> impl Iterator<Item = usize> {
    let [i, j, k] = mask.grid.voxel(n).map(|v| v as i64);
    [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
        .into_iter()
        .filter_map(move |(a, b, c)| mask.grid.linear(i + a, j + b, k + c))
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::geometry::Plane;
    use crate::mask::Grid;

    fn mask(dims: [usize; 3], f: impl Fn(i64, i64, i64) -> bool) -> Mask {
        let grid = Grid::new(dims, [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
        let data = (0..grid.len()).map(|n| {
            let v = grid.voxel(n).map(|x| x as i64);
            u8::from(f(v[0], v[1], v[2]))
        });
        let data = data.collect();
        Mask::new(grid, data)
    }

    fn cut(origin: [f64; 3], normal: [f64; 3], radius: f64) -> Cut {
        Cut { plane: Plane::new(origin.into(), normal.into()).unwrap(), radius, name: "outlet_1".into(), user: true }
    }

    #[test]
    fn a_bar_keeps_exactly_what_lies_before_the_plane_however_long_the_rest_is() {
        let bar = mask([100, 5, 5], |_, j, k| (1..4).contains(&j) && (1..4).contains(&k));
        assert_eq!(kept_volume(&bar, &[]), 900.0);
        let v = kept_volume(&bar, &[cut([20.2, 2.0, 2.0], [1.0, 0.0, 0.0], 1.5)]);
        assert!((v - 9.0 * 20.7).abs() < 1e-9, "{v}");
        let v = kept_volume(&bar, &[cut([80.0, 2.0, 2.0], [1.0, 0.0, 0.0], 1.5), cut([20.0, 2.0, 2.0], [-1.0, 0.0, 0.0], 1.5)]);
        assert!((v - 9.0 * 60.0).abs() < 1e-9, "{v}");
    }

    #[test]
    fn a_neighbouring_vessel_beyond_the_plane_is_kept() {
        let two = mask([40, 12, 4], |i, j, _| (1..4).contains(&j) || (i < 30 && (8..11).contains(&j)) || (i == 0));
        let v = kept_volume(&two, &[cut([19.5, 2.0, 1.5], [1.0, 0.0, 0.0], 2.0)]);
        assert!((v - (two.count() as f64 - 20.0 * 3.0 * 4.0)).abs() < 1e-9, "{v}");
    }
}
