//! What a label says: the probability of a voxel's sign given the function's value there.
//!
//! p = ε + (1 − 2ε) Φ(z), z the value on the label's side of zero in widths σ, ε the share of labels that are wrong whatever
//! the distance. With ε = 0 a label deep on the wrong side pulls ever harder; with ε > 0 it is given up as an outlier.

/// Φ(z) and φ(z)/Φ(z), the normal distribution and its reversed hazard. Exact to 1e-6 for all z.
fn normal(z: f64) -> (f64, f64) {
    if z > 8.0 {
        return (1.0, 0.0);
    }
    let phi = (-0.5 * z * z).exp() * 0.398_942_280_401_432_7;
    if z < -4.0 {
        // Continued fraction of Mills' ratio.
        let x = -z;
        let r = x + 1.0 / (x + 2.0 / (x + 3.0 / (x + 4.0 / (x + 5.0 / (x + 6.0 / x)))));
        return (phi / r, r);
    }
    // Abramowitz and Stegun 26.2.17.
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let tail = phi * t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let below = if z > 0.0 { 1.0 - tail } else { tail };
    (below, phi / below)
}

/// Probability that a label at `z` is no outlier.
pub(super) fn inlier(z: f64, outliers: f64) -> f64 {
    let (below, _) = normal(z);
    inlier_given(below, outliers)
}

fn inlier_given(below: f64, outliers: f64) -> f64 {
    if outliers <= 0.0 {
        return 1.0;
    }
    let good = (1.0 - 2.0 * outliers) * below;
    good / (good + outliers)
}

/// First derivative of −ln p by z, and the second of the bound that expectation maximisation puts in its place: −ln Φ weighted by
/// [`inlier`], convex, which −ln p is not where there are outliers.
pub(super) fn derivatives(z: f64, outliers: f64) -> (f64, f64) {
    let (below, r) = normal(z);
    let good = inlier_given(below, outliers);
    (-good * r, good * r * (z + r))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(z: f64, outliers: f64) -> f64 {
        -(outliers + (1.0 - 2.0 * outliers) * normal(z).0).ln()
    }

    #[test]
    fn the_slope_is_that_of_the_cost_and_a_label_far_on_the_wrong_side_stops_to_pull() {
        for outliers in [0.0, 0.05] {
            for z in [-3.5, -1.0, 0.2, 2.0] {
                let (slope, curvature) = derivatives(z, outliers);
                approx::assert_relative_eq!(slope, (cost(z + 1e-4, outliers) - cost(z - 1e-4, outliers)) / 2e-4, epsilon = 2e-3);
                assert!(curvature > 0.0, "{z}");
            }
        }
        assert!(derivatives(-6.0, 0.0).0 < -6.0 && derivatives(-6.0, 0.05).0 > -1e-6);
        assert!(inlier(-6.0, 0.05) < 1e-6 && inlier(3.0, 0.05) > 0.94);
        assert_eq!(inlier(-6.0, 0.0), 1.0);
    }
}
