//! Curves in arc length: resampling and local quadratic smoothing.

use crate::geometry::{Point, Vector};

/// Arc length at each point.
pub(super) fn arcs(points: &[Point]) -> Vec<f64> {
    let mut s = Vec::with_capacity(points.len());
    let mut total = 0.0;
    for (n, p) in points.iter().enumerate() {
        if n > 0 {
            total += (p - points[n - 1]).norm();
        }
        s.push(total);
    }
    s
}

/// The same curve with `count ≥ 2` points evenly spaced in arc length.
pub(super) fn resample(points: &[Point], count: usize) -> Vec<Point> {
    let s = arcs(points);
    let total = s[s.len() - 1];
    let mut seg = 0;
    (0..count)
        .map(|n| {
            let t = total * n as f64 / (count - 1) as f64;
            while seg + 2 < s.len() && s[seg + 1] < t {
                seg += 1;
            }
            if s.len() < 2 {
                return points[0];
            }
            let w = s[seg + 1] - s[seg];
            let f = if w > 0.0 { ((t - s[seg]) / w).clamp(0.0, 1.0) } else { 0.0 };
            points[seg] + (points[seg + 1] - points[seg]) * f
        })
        .collect()
}

/// The same curve with points at most `step` apart and at least `least` of them.
pub(super) fn resample_by(points: &[Point], step: f64, least: usize) -> Vec<Point> {
    let total = arcs(points).last().copied().unwrap_or(0.0);
    resample(points, ((total / step).ceil() as usize + 1).max(least))
}

/// Value and derivative at each point of a quadratic fitted to the points within `window` of arc length.
/// Unlike an average it leaves an even bend where it is. `closed` joins the ends.
pub(super) fn smooth(points: &[Point], window: &[f64], closed: bool) -> Vec<(Point, Vector)> {
    let s = arcs(points);
    let n = points.len();
    let total = s[n - 1];
    (0..n)
        .map(|i| {
            let w = window[i];
            // Moments of the weights and of the displacements from this point.
            let mut m = [0.0; 5];
            let mut b = [Vector::zeros(); 3];
            let mut add = |j: usize, t: f64| {
                let k = (1.0 - (t / w).powi(2)).max(0.0).powi(2);
                let d = points[j] - points[i];
                let mut p = k;
                for e in 0..5 {
                    m[e] += p;
                    if e < 3 {
                        b[e] += d * p;
                    }
                    p *= t / w;
                }
            };
            let from = s.partition_point(|&x| x < s[i] - w);
            (from..n).take_while(|&j| s[j] <= s[i] + w).for_each(|j| add(j, s[j] - s[i]));
            if closed {
                (1..n).take_while(|&j| s[j] - s[i] + total <= w).for_each(|j| add(j, s[j] - s[i] + total));
                (0..n - 1).rev().take_while(|&j| s[j] - s[i] - total >= -w).for_each(|j| add(j, s[j] - s[i] - total));
            }
            let a = nalgebra::Matrix3::new(m[0], m[1], m[2], m[1], m[2], m[3], m[2], m[3], m[4]);
            match a.try_inverse().filter(|_| a.determinant() > 1e-9 * m[0].powi(3)) {
                Some(inv) => {
                    let at = b[0] * inv[(0, 0)] + b[1] * inv[(0, 1)] + b[2] * inv[(0, 2)];
                    let slope = b[0] * inv[(1, 0)] + b[1] * inv[(1, 1)] + b[2] * inv[(1, 2)];
                    (points[i] + at, direction(slope, points, i))
                }
                None => (points[i], direction(Vector::zeros(), points, i)),
            }
        })
        .collect()
}

fn direction(slope: Vector, points: &[Point], i: usize) -> Vector {
    let chord = points[(i + 1).min(points.len() - 1)] - points[i.saturating_sub(1)];
    let d = if slope.norm() > 0.0 { slope } else { chord };
    d.try_normalize(0.0).unwrap_or_else(Vector::z)
}
