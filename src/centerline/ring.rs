//! The section round a point of the axis, by rays: where its middle is and how wide it is.

use crate::geometry::{Plane, Point, Vector};

/// Number of rays of a section.
const RAYS: usize = 24;
/// Highest harmonic of the outline that is kept: voxel stairs are higher ones.
const HARMONICS: usize = 3;

/// The outline of a section as seen from a point.
pub(super) struct Ring {
    /// From the point to the middle of the section.
    pub offset: Vector,
    /// Radius of the largest circle round the middle, mm.
    pub radius: f64,
    /// Rays that met the wall.
    pub hits: usize,
}

/// How rays find the wall.
pub(super) struct Rays<'a> {
    /// Negative inside.
    pub value: &'a dyn Fn(&Point) -> f64,
    /// Correction added to a ray's length: from its tangential direction and its length.
    pub correction: &'a dyn Fn(&Vector, f64) -> f64,
    /// Step length, mm.
    pub step: f64,
    /// Amplitude of a harmonic that the wall's roughness alone brings about, mm.
    pub noise: f64,
}

impl Rays<'_> {
    /// Sections the vessel at `center` across `axis`; `guess` is a radius of the right size. `None` outside it.
    pub fn ring(&self, center: &Point, axis: &Vector, guess: f64) -> Option<Ring> {
        let (u, v) = Plane::new(*center, *axis)?.basis();
        if (self.value)(center) >= 0.0 {
            return None;
        }
        let cap = 1.8 * guess + 2.0 * self.step;
        let mut length = [0.0; RAYS];
        let mut hits = 0;
        for (n, l) in length.iter_mut().enumerate() {
            let (s, c) = angle(n).sin_cos();
            let d = u * c + v * s;
            match self.cast(center, &d, 0.5 * guess, cap) {
                Some(r) => {
                    *l = r + (self.correction)(&(v * c - u * s), r);
                    hits += 1;
                }
                None => *l = cap,
            }
        }
        let mut sorted = length;
        sorted.sort_by(f64::total_cmp);
        let median = 0.5 * (sorted[RAYS / 2 - 1] + sorted[RAYS / 2]);
        length.iter_mut().for_each(|l| *l = l.min(1.5 * median));
        let mut cosine = [0.0; HARMONICS + 1];
        let mut sine = [0.0; HARMONICS + 1];
        for (n, l) in length.iter().enumerate() {
            for k in 0..=HARMONICS {
                let (s, c) = (k as f64 * angle(n)).sin_cos();
                cosine[k] += l * c * 2.0 / RAYS as f64;
                sine[k] += l * s * 2.0 / RAYS as f64;
            }
        }
        for k in 2..=HARMONICS {
            let a = cosine[k].hypot(sine[k]);
            let keep = if a > self.noise { (1.0 - (self.noise / a).powi(2)).sqrt() } else { 0.0 };
            cosine[k] *= keep;
            sine[k] *= keep;
        }
        let outline = |a: f64| {
            0.5 * cosine[0] + (2..=HARMONICS).map(|k| cosine[k] * (k as f64 * a).cos() + sine[k] * (k as f64 * a).sin()).sum::<f64>()
        };
        let radius = (0..2 * RAYS).map(|n| outline(0.5 * angle(n))).fold(f64::INFINITY, f64::min);
        Some(Ring { offset: u * cosine[1] + v * sine[1], radius, hits })
    }

    fn cast(&self, from: &Point, direction: &Vector, start: f64, cap: f64) -> Option<f64> {
        let value = |t: f64| (self.value)(&(from + direction * t));
        let mut low = start;
        let mut f_low = value(low);
        while f_low >= 0.0 && low > 0.0 {
            low = (low - self.step).max(0.0);
            f_low = value(low);
            if f_low < 0.0 {
                break;
            }
        }
        let mut high = low;
        let mut f_high = f_low;
        while f_high < 0.0 {
            (low, f_low) = (high, f_high);
            high += self.step;
            if high > cap {
                return None;
            }
            f_high = value(high);
        }
        // Illinois' variant of the false position.
        let mut side = 0;
        let mut t = high;
        for _ in 0..8 {
            t = (low * f_high - high * f_low) / (f_high - f_low);
            let f = value(t);
            if f.abs() == 0.0 || high - low < 1e-4 * self.step {
                break;
            }
            if f < 0.0 {
                (low, f_low) = (t, f);
                f_high *= if side == 1 { 0.5 } else { 1.0 };
                side = 1;
            } else {
                (high, f_high) = (t, f);
                f_low *= if side == 2 { 0.5 } else { 1.0 };
                side = 2;
            }
        }
        Some(t)
    }
}

fn angle(n: usize) -> f64 {
    std::f64::consts::TAU * n as f64 / RAYS as f64
}
