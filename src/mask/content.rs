//! What a picture's values are: a mask, labels, a soft mask, or grey values.
//!
//! A mask that was interpolated and a probability map have two flat levels with a ramp between them; labels are whole
//! numbers in few regions; a grey image varies everywhere. The three are told apart by where the values in between lie.

use rayon::prelude::*;

use super::{Image, Scalar, with_values};

/// What a picture's values are.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// One value everywhere, or none that is a number.
    Uniform,
    /// Background 0 (or NaN) and one other value, above it.
    Mask,
    /// Whole values in few regions with sharp steps, or two values of which none is the background plainly.
    Labels,
    /// Two levels, and values between them along the boundary: an interpolated mask or a probability map.
    Soft {
        /// Background.
        low: f64,
        /// Lumen.
        high: f64,
        /// Voxels between a tenth and nine tenths of the way.
        between: usize,
    },
    /// Anything else.
    Grey,
}

/// Most values that count as labels.
const MOST_LABELS: usize = 256;

/// Whole values up to this many are labels even where they lie between others: the wall of a vessel does so too.
const FEW: usize = 8;

/// What the values of the picture's first layer are. O(voxels).
pub fn content(image: &Image) -> Content {
    with_values!(&image.values, v => judge(v, image.grid.dims))
}

fn judge<T: Scalar>(values: &[T], dims: [usize; 3]) -> Content {
    let nan = values.par_iter().any(|x| x.to_f64().is_nan());
    let distinct = distinct(values, MOST_LABELS);
    if let Some(all) = &distinct {
        match all.as_slice() {
            [] => return Content::Uniform,
            [(one, _)] => return if nan && *one > 0.0 { Content::Mask } else { Content::Uniform },
            [(a, _), (b, _)] => return if *a == 0.0 && *b > 0.0 && !nan { Content::Mask } else { Content::Labels },
            _ => {}
        }
    }
    let whole = distinct.as_ref().is_some_and(|d| d.iter().all(|(v, _)| v.fract() == 0.0));
    let few = whole && distinct.as_ref().is_some_and(|d| d.len() <= FEW);
    let field = Field { values, dims };
    match field.soft() {
        Some(soft) if !few => soft,
        Some(_) => Content::Labels,
        None if whole && field.settled(distinct.as_deref().unwrap_or_default()) => Content::Labels,
        None => Content::Grey,
    }
}

/// The values and their voxels in rising order, NaN left out; `None` where there are more than `most`.
pub(super) fn distinct<T: Scalar>(values: &[T], most: usize) -> Option<Vec<(f64, usize)>> {
    let add = |mut all: Vec<(f64, usize)>, value: f64, n: usize| {
        match all.binary_search_by(|p| p.0.total_cmp(&value)) {
            Ok(at) => all[at].1 += n,
            Err(at) if all.len() < most => all.insert(at, (value, n)),
            Err(_) => return None,
        }
        Some(all)
    };
    let key = |x: T| x.label().map_or_else(|| x.to_f64(), |l| l as f64);
    values
        .par_chunks(1 << 16)
        .map(|chunk| {
            let mut all = Vec::new();
            // Neighbours in a row mostly are the same.
            for same in chunk.chunk_by(|a, b| a.to_f64() == b.to_f64()) {
                if !same[0].to_f64().is_nan() {
                    all = add(all, key(same[0]), same.len())?;
                }
            }
            Some(all)
        })
        .try_reduce(Vec::new, |a, b| b.into_iter().try_fold(a, |all, (v, n)| add(all, v, n)))
}

/// Values on a grid of voxels.
struct Field<'a, T> {
    values: &'a [T],
    dims: [usize; 3],
}

/// What is counted over all voxels to tell a soft mask.
#[derive(Default, Clone, Copy)]
struct Tally {
    /// Voxels between a tenth and nine tenths, below and above the half-way value.
    between: [usize; 2],
    /// Those with the boundary within [`REACH`].
    near: usize,
    /// Voxels off both levels, and those above or below all their neighbours.
    off: usize,
    extreme: usize,
    /// Pairs of neighbours across the boundary, and those of which one lies between the levels.
    pairs: usize,
    ramps: usize,
    /// Voxels two or more from the boundary outside and inside, and those of them on their level.
    deep: [usize; 2],
    flat: [usize; 2],
}

impl Tally {
    fn plus(self, o: Tally) -> Tally {
        let both = |a: [usize; 2], b: [usize; 2]| [a[0] + b[0], a[1] + b[1]];
        Tally {
            between: both(self.between, o.between),
            near: self.near + o.near,
            off: self.off + o.off,
            extreme: self.extreme + o.extreme,
            pairs: self.pairs + o.pairs,
            ramps: self.ramps + o.ramps,
            deep: both(self.deep, o.deep),
            flat: both(self.flat, o.flat),
        }
    }
}

/// How far from the boundary a value between the levels may lie, in voxels: slices of four times the new thickness.
const REACH: usize = 4;

impl<T: Scalar> Field<'_, T> {
    fn at(&self, n: usize) -> f64 {
        self.values[n].to_f64()
    }

    /// Neighbours of `n` up to `reach` voxels away along the axes, nearest first.
    fn around(&self, n: usize, reach: usize) -> impl Iterator<Item = f64> {
        let [nx, ny, nz] = self.dims;
        let index = [n % nx, n / nx % ny, n / (nx * ny)];
        let steps = [(1, nx), (nx, ny), (nx * ny, nz)];
        (1..=reach).flat_map(move |d| {
            (0..3).flat_map(move |a| {
                let (step, size) = steps[a];
                let low = (index[a] >= d).then(|| self.at(n - d * step));
                let high = (index[a] + d < size).then(|| self.at(n + d * step));
                low.into_iter().chain(high)
            })
        })
    }

    /// The two levels: medians of what lies two or more voxels from the half-way value's boundary on either side.
    fn levels(&self) -> Option<[f64; 2]> {
        let finite = |x: &f64| x.is_finite();
        let mut levels = self.values.par_iter().map(|x| x.to_f64()).filter(finite).map(|x| [x, x]).reduce_with(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
        for _ in 0..2 {
            let half = 0.5 * (levels[0] + levels[1]);
            for (side, level) in levels.iter_mut().enumerate() {
                let inside = side == 1;
                let own: Vec<usize> = (0..self.values.len()).into_par_iter().filter(|&n| (self.at(n) >= half) == inside).collect();
                let mut deep: Vec<f64> = own.par_iter().filter(|&&n| self.around(n, 2).all(|x| (x >= half) == inside)).map(|&n| self.at(n)).filter(finite).collect();
                // A vessel too thin to have an inside of its own: its brightest voxels.
                let quantile = if deep.is_empty() { 0.95 } else { 0.5 };
                if deep.is_empty() {
                    deep = own.par_iter().map(|&n| self.at(n)).filter(finite).collect();
                }
                let at = ((deep.len().max(1) - 1) as f64 * quantile) as usize;
                if deep.is_empty() {
                    return None;
                }
                *level = *deep.select_nth_unstable_by(at, f64::total_cmp).1;
            }
        }
        (levels[0] < levels[1]).then_some(levels)
    }

    /// The levels where the picture is a soft mask.
    fn soft(&self) -> Option<Content> {
        let [low, high] = self.levels()?;
        let tally = (0..self.values.len()).into_par_iter().fold(Tally::default, |t, n| t.plus(self.tally(n, low, high))).reduce(Tally::default, Tally::plus);
        let between = tally.between[0] + tally.between[1];
        let share = |part: usize, whole: usize, least: f64| part as f64 >= least * whole as f64;
        let soft = between > 0
            && share(tally.near, between, 0.95)
            && share(tally.between[0].min(tally.between[1]), between, 0.1)
            && share(tally.ramps, tally.pairs, 0.2)
            && !share(tally.extreme, tally.off, 0.05)
            && share(tally.flat[0], tally.deep[0], 0.99)
            && share(tally.flat[1], tally.deep[1], 0.9);
        soft.then_some(Content::Soft { low, high, between })
    }

    fn tally(&self, n: usize, low: f64, high: f64) -> Tally {
        let part = |x: f64| if x.is_nan() { 0.0 } else { (x - low) / (high - low) };
        let t = part(self.at(n));
        let inside = t >= 0.5;
        let mut tally = Tally::default();
        let off = |t: f64| t > 0.05 && t < 0.95;
        let across = |x: f64| (part(x) >= 0.5) != inside;
        if t > 0.1 && t < 0.9 {
            tally.between[usize::from(inside)] = 1;
            tally.near = usize::from(self.around(n, REACH).any(across));
        }
        if off(t) {
            tally.off = 1;
            let (above, below) = self.around(n, 1).fold((true, true), |(a, b), x| (a && t > part(x), b && t < part(x)));
            tally.extreme = usize::from(above || below);
        }
        for x in self.around(n, 1).filter(|&x| across(x)) {
            tally.pairs += 1;
            tally.ramps += usize::from(off(t) || off(part(x)));
        }
        if !self.around(n, 2).any(across) {
            tally.deep[usize::from(inside)] = 1;
            let level = if inside { 1.0 } else { 0.0 };
            tally.flat[usize::from(inside)] = usize::from((t - level).abs() < 0.1);
        }
        tally
    }

    /// Whether most voxels off the commonest value lie among their like: regions, and not noise.
    fn settled(&self, distinct: &[(f64, usize)]) -> bool {
        let Some(background) = distinct.iter().max_by_key(|d| d.1).map(|d| d.0) else { return false };
        let key = |x: T| x.label().map(|l| l as f64);
        let [all, settled] = (0..self.values.len())
            .into_par_iter()
            .filter(|&n| key(self.values[n]) != Some(background))
            .map(|n| {
                let alike = self.around(n, 1).filter(|x| (x - self.at(n)).abs() < 0.5).count();
                [1, usize::from(2 * alike >= self.around(n, 1).count())]
            })
            .reduce(|| [0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
        2 * settled >= all
    }
}

#[cfg(test)]
#[path = "content_tests.rs"]
mod tests;
