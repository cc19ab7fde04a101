//! From a component's mask, map or surface to its implicit wall.

use super::error::Error;
use super::input::{self, Source};
use super::{options, surface};
use crate::config::{Case, Method, Profile};
use crate::implicit::guard::{GuardOptions, Guarded, MaskBoundary};
use crate::implicit::{self, Implicit};
use crate::mask::Mask;
use crate::pointcloud;
use crate::report::Report;

/// Distance of the points that a surface is sampled at, in voxels of its grid: at 0.7 the ends of small vessels came out up to 2.5 % too wide, at
/// this 0.5 %.
const SURFACE_PITCH: f64 = 0.5;

/// How far the fit may lie from them, in voxels: they are exact, facets apart.
const SURFACE_TOLERANCE: f64 = 0.03;

/// The smooth fit once more, with every label kept that the topology might need; `None` where the mask is not noisy or the wall
/// comes from something else.
pub(super) fn strictly(case: &Case, source: &Source, mask: &Mask, report: &mut Report) -> Result<Option<Box<dyn Implicit>>, Error> {
    let by_mask = matches!(source, Source::Mask) || case.reconstruction.method.is_some();
    if !by_mask || !matches!(options::method(case), Method::Smooth) {
        return Ok(None);
    }
    let (f, summary) = implicit::smooth::fit(mask, &implicit::smooth::SmoothOptions { strict: true, ..Default::default() })?;
    if summary.outliers == 0.0 {
        return Ok(None);
    }
    report.put_in("reconstruction", "smooth", &summary);
    Ok(Some(Box::new(f)))
}

/// A component's wall, and whether its mask is noisy.
pub(super) struct Wall {
    pub implicit: Box<dyn Implicit>,
    pub noisy: bool,
}

impl Wall {
    fn new(f: impl Implicit + 'static) -> Wall {
        Wall { implicit: Box::new(f), noisy: false }
    }
}

/// The wall of a component by the method that the case names, or that suits its source.
pub(super) fn reconstruct(case: &Case, source: &Source, mask: &Mask, report: &mut Report) -> Result<Wall, Error> {
    report.put_in("reconstruction", "profile", &case.reconstruction.profile);
    // A method that the case names is used on the mask; by itself a map or surface says more than its mask.
    match source {
        Source::Map { image, isovalue } if case.reconstruction.method.is_none() => {
            report.put_in("reconstruction", "fitted_to", &"probability map");
            return Ok(Wall::new(input::map_on(image, *isovalue, mask)?));
        }
        Source::Surface(given) if case.reconstruction.method.is_none() => {
            let voxel = mask.grid.spacing()[0];
            let points = surface::samples(given, mask, SURFACE_PITCH * voxel)?;
            let fit = implicit::mpu::MpuOptions { tolerance: SURFACE_TOLERANCE * voxel, ..implicit::mpu::MpuOptions::estimate(&mask.grid, &points) };
            let (f, summary) = implicit::mpu::fit(&points, &fit)?;
            report.put_in("reconstruction", "fitted_to", &"surface");
            report.put_in("reconstruction", "mpu", &summary);
            return Ok(Wall::new(f));
        }
        _ => {}
    }
    match options::method(case) {
        Method::Smooth => {
            let (f, summary) = implicit::smooth::fit(mask, &Default::default())?;
            if summary.outliers > 0.0 {
                let share = 100.0 * summary.outliers;
                report.warn("reconstruct", format!("the mask is noisy: about {share:.0} % of the voxels at its boundary look wrong, and {} were passed over", summary.given_up));
            }
            report.put_in("reconstruction", "smooth", &summary);
            Ok(Wall { noisy: summary.outliers > 0.0, ..Wall::new(f) })
        }
        Method::Mpu => {
            let points = match case.reconstruction.profile {
                Profile::Paper => pointcloud::PointCloudOptions::paper(),
                Profile::Cfd => pointcloud::PointCloudOptions::cfd(),
            };
            let boundary = MaskBoundary::new(mask, &GuardOptions::default()).ok_or(Error::EmptyComponent)?;
            let (points, cloud) = pointcloud::extract(mask, &points)?;
            let (f, summary) = implicit::mpu::fit(&points, &implicit::mpu::MpuOptions::estimate(&mask.grid, &points))?;
            report.put_in("reconstruction", "point_cloud", &cloud);
            report.put_in("reconstruction", "mpu", &summary);
            Ok(Wall::new(Guarded::new(f, boundary)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::{crop_pad, interface};
    use crate::{mask, phantom};

    #[test]
    fn the_strict_refit_of_a_noisy_mask_keeps_labels_that_the_first_gave_up_and_a_clean_mask_has_none() {
        let p = phantom::build("kissing").expect("a phantom");
        let exact = p.voxelize(p.spacing, [0.0; 3], nalgebra::Matrix3::identity());
        let mut noisy = exact.clone();
        let mut state = 7u64;
        for (v, _) in interface(&exact) {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let [i, j, k] = v.map(i64::from);
            if let Some(n) = exact.grid.linear(i, j, k).filter(|_| (state >> 33) % 12 == 0) {
                noisy.data[n] ^= 1;
            }
        }
        let (noisy, _) = mask::clean(&noisy, &Default::default()).expect("a mask");
        let (clean, noisy) = (crop_pad(&exact, 4, 4), crop_pad(&noisy, 4, 4));
        let case: Case = serde_saphyr::from_str("input: {mask: none.nrrd}").expect("a case");
        let mut report = Report::default();
        assert!(strictly(&case, &Source::Mask, &clean, &mut report).expect("a fit").is_none());
        let first = reconstruct(&case, &Source::Mask, &noisy, &mut report).expect("a wall");
        assert!(first.noisy);
        let strict = strictly(&case, &Source::Mask, &noisy, &mut report).expect("a fit").expect("another wall");
        let kept = |f: &dyn Implicit, v: &[i32; 3]| {
            let at = noisy.grid.to_world(crate::geometry::Vector::from(v.map(f64::from)));
            (f.value(&at) < 0.0) == noisy.at(v[0].into(), v[1].into(), v[2].into())
        };
        let given_up: Vec<[i32; 3]> = interface(&noisy).into_iter().map(|n| n.0).filter(|v| !kept(first.implicit.as_ref(), v)).collect();
        let regained = given_up.iter().filter(|v| kept(strict.as_ref(), v)).count();
        assert!(given_up.len() > 100 && regained > 10, "{regained} of {}", given_up.len());
    }
}
