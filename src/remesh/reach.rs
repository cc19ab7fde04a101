//! Which edge lengths can be had: a length that was asked for holds, or is refused with the range.

use super::Error;
use super::size_field::{EdgeLength, GuidanceOptions, Refinement, Summary, triangle_area};

/// Part of the surface on which a length that was asked for may be shortened: tips, and twigs of a voxel.
const SHORTENED: f64 = 0.02;

/// What bounds edge lengths on a surface.
pub(super) struct Reach<'a> {
    /// Shortest length, mm.
    pub low: f64,
    /// Longest length that the user allows, mm.
    pub most: f64,
    /// Longest length at each vertex that leaves enough edges round, mm.
    pub longest: &'a [f64],
    /// Area at each vertex, mm²; 0 where the surface will be cut off.
    pub area: &'a [f64],
    /// Volume inside, mm³.
    pub volume: f64,
}

impl Reach<'_> {
    /// Longest length that can be had on all of these vertices but [`SHORTENED`] of their area.
    fn high(&self, on: &dyn Fn(usize) -> bool) -> f64 {
        let mut order: Vec<usize> = (0..self.longest.len()).filter(|&v| on(v) && self.area[v] > 0.0).collect();
        order.sort_unstable_by(|&a, &b| self.longest[a].total_cmp(&self.longest[b]).then(a.cmp(&b)));
        let total: f64 = order.iter().map(|&v| self.area[v]).sum();
        let mut seen = 0.0;
        for v in order {
            seen += self.area[v];
            if seen > SHORTENED * total {
                return self.longest[v].min(self.most);
            }
        }
        self.most
    }

    fn holds(&self, name: &'static str, asked: f64, on: &dyn Fn(usize) -> bool) -> Result<(), Error> {
        let (low, high) = (self.low, self.high(on));
        // To rounding: the ends of the range belong to it.
        if (low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(&asked) {
            return Ok(());
        }
        let area: f64 = (0..self.area.len()).filter(|&v| on(v)).map(|v| self.area[v]).sum();
        // A regular tetrahedron of that edge.
        let cells = self.volume * 6.0 * std::f64::consts::SQRT_2 / asked.powi(3);
        Err(Error::OutOfReach { name, asked, low, high, faces: area / triangle_area(asked), cells })
    }
}

/// A number of elements in words.
pub(super) fn about(n: f64) -> String {
    match n {
        n if n < 1.0 => "less than one of the".into(),
        n if n < 1e6 => format!("about {n:.0}"),
        n => format!("about {n:.1e}"),
    }
}

/// Whether every length that was asked for can be had. `own` is the length that a patch gives to a vertex.
pub(super) fn check(reach: &Reach, options: &GuidanceOptions, own: &[Option<f64>]) -> Result<(), Error> {
    if let EdgeLength::Fixed(h) = options.edge_length {
        reach.holds("edge_length", h, &|v| own[v].is_none())?;
    }
    for &(_, h) in &options.patches {
        reach.holds("patches.edge_length", h, &|v| own[v] == Some(h))?;
    }
    for r in &options.refine {
        let (Refinement::Sphere { edge_length, .. } | Refinement::Box { edge_length, .. }) = r;
        // A longer one than the surroundings' shortens nothing.
        if *edge_length < reach.low {
            reach.holds("refine.edge_length", *edge_length, &|_| true)?;
        }
    }
    Ok(())
}

/// What of `auto`, `scale` and `target_faces` could not be had: `held` is the part of the area at a bound, `missed` the
/// number of triangles asked for where it is not met.
pub(super) fn bounded(held: f64, missed: Option<f64>, options: &GuidanceOptions, summary: &Summary) -> Option<String> {
    let range = format!("edges of {:.3} to {:.3} mm", summary.min, summary.max);
    if let Some(wanted) = missed {
        let faces = summary.predicted_faces;
        return Some(format!("target_faces {wanted:.0} is out of reach: about {faces} triangles come out, {range}"));
    }
    if held <= SHORTENED || matches!(options.edge_length, EdgeLength::Fixed(_)) && options.scale == 1.0 {
        return None;
    }
    let what = if options.scale == 1.0 { "edge_length auto".to_string() } else { format!("scale {}", options.scale) };
    Some(format!(
        "{what} is bounded on {:.0} % of the surface, by the shortest length or by {} edges round at least: {range}",
        100.0 * held,
        options.least_edges_per_circumference
    ))
}
