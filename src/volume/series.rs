//! Meshes of one vessel at several sizes, and what they tell about the error of a flow figure.
//!
//! After Celik et al., "Procedure for estimation and reporting of uncertainty due to discretization in CFD
//! applications", J. Fluids Eng. 130 (2008) 078001.

use serde::Serialize;

/// One mesh of a series.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Member {
    /// `coarse`, `medium`, `fine`; with another number of members `size_1` (the coarsest) and so on.
    pub name: String,
    /// Factor on all edge lengths of the surface and the volume.
    pub factor: f64,
}

/// Ratio of the edge lengths of neighbouring members; Celik et al. ask for more than 1.3.
pub const RATIO: f64 = 1.4;

/// The members of a series of `count`, coarsest first. The middle one (the finer of the two for an even count) has
/// the size asked for.
pub fn members(count: u32) -> Vec<Member> {
    let middle = count / 2;
    (0..count)
        .map(|i| Member {
            name: match (count, i) {
                (3, 0) => "coarse".into(),
                (3, 1) => "medium".into(),
                (3, 2) => "fine".into(),
                _ => format!("size_{}", i + 1),
            },
            factor: RATIO.powi(middle as i32 - i as i32),
        })
        .collect()
}

/// Representative edge length of a mesh: the cube root of the mean cell volume, mm.
pub fn representative_size(volume: f64, cells: usize) -> f64 {
    (volume / cells.max(1) as f64).cbrt()
}

/// What three meshes tell about a figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Convergence {
    /// Observed order; nothing where the differences vanish.
    pub order: Option<f64>,
    /// Whether the figure swings between the meshes.
    pub oscillatory: bool,
    /// The figure at edge length 0 by Richardson's extrapolation.
    pub extrapolated: Option<f64>,
    /// Grid convergence index of the fine mesh, relative, with the safety factor 1.25.
    pub gci_fine: Option<f64>,
}

/// Observed order and grid convergence index from a figure on three meshes, fine to coarse; `sizes` rise.
///
/// `None` where the sizes do not rise or a number is not finite.
pub fn convergence(sizes: [f64; 3], figures: [f64; 3]) -> Option<Convergence> {
    let finite = sizes.iter().chain(&figures).all(|x| x.is_finite());
    if !finite || !(sizes[0] > 0.0 && sizes[0] < sizes[1] && sizes[1] < sizes[2]) {
        return None;
    }
    let (r21, r32) = (sizes[1] / sizes[0], sizes[2] / sizes[1]);
    let (e21, e32) = (figures[1] - figures[0], figures[2] - figures[1]);
    let unknown = Convergence { order: None, oscillatory: false, extrapolated: None, gci_fine: None };
    if e21 == 0.0 || e32 == 0.0 {
        return Some(unknown);
    }
    let s = (e32 / e21).signum();
    let mut p = 1.0f64;
    for _ in 0..200 {
        let q = ((r21.powf(p) - s) / (r32.powf(p) - s)).ln();
        let next = ((e32 / e21).abs().ln() + q).abs() / r21.ln();
        if !next.is_finite() {
            return Some(Convergence { oscillatory: s < 0.0, ..unknown });
        }
        let step = next - p;
        p += 0.5 * step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    let f = r21.powf(p) - 1.0;
    if !(f > 0.0) {
        return Some(Convergence { oscillatory: s < 0.0, ..unknown });
    }
    Some(Convergence {
        order: Some(p),
        oscillatory: s < 0.0,
        extrapolated: Some(figures[0] - e21 / f),
        gci_fine: (figures[0] != 0.0).then(|| 1.25 * (e21 / figures[0]).abs() / f),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_members_stand_round_the_size_asked_for() {
        let m = members(3);
        assert_eq!(m.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["coarse", "medium", "fine"]);
        assert_eq!(m[1].factor, 1.0);
        assert!((m[0].factor * m[2].factor - 1.0).abs() < 1e-15 && m[0].factor > 1.3);
        assert_eq!(members(1), vec![Member { name: "size_1".into(), factor: 1.0 }]);
    }

    #[test]
    fn a_second_order_figure_is_recognised_with_its_limit() {
        let f = |h: f64| 3.0 + 0.7 * h * h;
        let c = convergence([0.5, 0.7, 1.0], [f(0.5), f(0.7), f(1.0)]).unwrap();
        assert!((c.order.unwrap() - 2.0).abs() < 1e-6 && !c.oscillatory);
        assert!((c.extrapolated.unwrap() - 3.0).abs() < 1e-6);
        assert!((c.gci_fine.unwrap() - 1.25 * (f(0.5) - 3.0) / f(0.5)).abs() < 1e-6);
        assert!(convergence([0.7, 0.5, 1.0], [1.0, 2.0, 3.0]).is_none());
        assert_eq!(convergence([0.5, 0.7, 1.0], [1.0; 3]).unwrap().order, None);
    }
}
