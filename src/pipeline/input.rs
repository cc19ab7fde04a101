//! What a case starts from: a mask, a probability map or a surface.

use std::path::Path;

use super::surface::{self, GivenSurface};
use super::{Error, options, results};
use crate::config::Case;
use crate::geometry::Vector;
use crate::implicit::probability::Probability;
use crate::io;
use crate::mask::{self, Content, Grid, Image, LabelKey, Mask, Selection};
use crate::report::{Report, rounded};

/// What the wall is fitted to besides the mask.
pub enum Source {
    /// Nothing: the mask is all there is.
    Mask,
    /// A map that crosses an isovalue at the wall.
    Map {
        /// The map.
        image: Image,
        /// Lumen is from this value up.
        isovalue: f64,
    },
    /// A surface.
    Surface(Box<GivenSurface>),
}

/// Isovalue of a probability map.
const ISOVALUE: f64 = 0.5;

/// Reads what the case names, and the mask that goes with it.
pub fn read(case: &Case, report: &mut Report) -> Result<(Mask, Source), Error> {
    let input = &case.input;
    match (&input.mask, &input.probability, &input.surface) {
        (Some(path), ..) => {
            let image = picture(case, path)?;
            let selection = options::selection(case);
            let soft = half_way(&image, &selection);
            // A label of a soft mask is its upper level.
            let rule = if soft.is_some() { &Selection::Mask } else { &selection };
            let mask = mask::select(&image, rule).map_err(|source| Error::Selection { path: path.clone(), source })?;
            plausible(&image, &mask, report).map_err(|source| Error::Selection { path: path.clone(), source })?;
            report.put("input", &results::provenance(path, &image, &mask));
            report.put_in("input", "values", &mask::inventory(&image));
            let Some((isovalue, said)) = soft else { return Ok((mask, Source::Mask)) };
            report.put_in("input", "isovalue", &isovalue);
            report.warn("input", said);
            Ok((mask, Source::Map { image, isovalue }))
        }
        (None, Some(path), _) => {
            let image = picture(case, path)?;
            let isovalue = input.isovalue.unwrap_or(ISOVALUE);
            let selection = Selection::Threshold { lower: Some(isovalue), upper: None };
            let mask = mask::select(&image, &selection).map_err(|source| Error::Selection { path: path.clone(), source })?;
            report.put("input", &results::provenance(path, &image, &mask));
            report.put_in("input", "isovalue", &isovalue);
            Ok((mask, Source::Map { image, isovalue }))
        }
        (None, None, Some(path)) => surface::read(case, path, report).map(|(mask, given)| (mask, Source::Surface(Box::new(given)))),
        (None, None, None) => Err(Error::Configuration("input names no file: give `input: {mask: FILE}`".into())),
    }
}

/// Mean diameters of a lumen, mm, beyond which there is no vessel, and beyond which few are.
const NO_VESSEL: [f64; 2] = [0.005, 300.0];
const FEW_VESSELS: [f64; 2] = [0.1, 80.0];

/// Width of a picture, voxels, from which its scanner's matrix shows.
const MATRIX: usize = 256;

/// Tells what is doubtful about the header's numbers; refuses a size that no vessel has.
fn plausible(image: &Image, mask: &Mask, report: &mut Report) -> Result<(), mask::Error> {
    image.doubts.iter().for_each(|d| report.warn("input", d.clone()));
    let ([x, y, z], [nx, ny, _]) = (image.grid.spacing(), image.grid.dims);
    let (spacing, diameter) = ([x, y, z].map(rounded).join(" x "), mask.mean_diameter());
    let beyond = |[least, most]: [f64; 2]| diameter.is_finite() && !(least..=most).contains(&diameter);
    if beyond(NO_VESSEL) {
        return Err(mask::Error::Scale { diameter: rounded(diameter), spacing });
    }
    if beyond(FEW_VESSELS) {
        report.warn("input", format!("the lumen is {} mm across on average, with voxels of {spacing} mm: few vessels are; look whether the unit is right (input.units)", rounded(diameter)));
    }
    let matrix = nx == ny && nx >= MATRIX && nx % 64 == 0;
    if [x, y, z] == [1.0; 3] && image.doubts.is_empty() && (matrix || image.grid.origin.coords.norm() == 0.0) {
        let why = if matrix { format!("{nx} x {ny} voxels are a scanner's matrix, which is seldom {nx} mm wide") } else { "the image stands at the origin".into() };
        report.warn("input", format!("the voxels are exactly 1 x 1 x 1 mm and {why}: programs write this where they have lost the voxel size; look whether it is right"));
    }
    Ok(())
}

/// Refuses a mask that has no inside.
pub fn thick_enough(mask: &Mask) -> Result<(), Error> {
    let slices = mask.grid.dims.iter().any(|&n| n < 3);
    if mask.has_inside() && !slices { Ok(()) } else { Err(Error::Thin) }
}

/// The value half-way between the levels of a soft mask of which all is asked for or its upper level, and what to say.
fn half_way(image: &Image, selection: &Selection) -> Option<(f64, String)> {
    if matches!(selection, Selection::Threshold { .. }) || !image.segments.is_empty() {
        return None;
    }
    let Content::Soft { low, high, between } = mask::content(image) else { return None };
    let upper = |key: &LabelKey| matches!(key, LabelKey::Number(n) if (*n as f64 - high).abs() <= 0.05 * (high - low));
    if let Selection::Label(keys) = selection
        && !keys.iter().all(upper)
    {
        return None;
    }
    let isovalue = 0.5 * (low + high);
    let [low, high, half] = [low, high, isovalue].map(rounded);
    let said = format!(
        "{between} voxels at the boundary hold values between {low} and {high}: it is taken as an interpolated mask or a probability map, with the wall at the half-way value {half}; input.threshold takes whole voxels from another value up"
    );
    Some((isovalue, said))
}

fn picture(case: &Case, path: &Path) -> Result<Image, Error> {
    let image = io::image::read(path)?;
    // A file that names its own unit is believed.
    Ok(if image.stated_unit.is_none() { image.with_unit(options::unit(case.input.units)) } else { image })
}

/// The map's wall on the grid of a component's mask.
///
/// Where cleaning changed the mask, and beyond the picture, the map follows the mask: half of its range above the
/// isovalue inside and as much below outside.
pub fn map_on(image: &Image, isovalue: f64, mask: &Mask) -> Result<Probability, Error> {
    let [low, high] = image.values.range().unwrap_or([isovalue, isovalue]);
    let (inside, outside) = (0.5 * (isovalue + high), 0.5 * (isovalue + low));
    let own = |grid: &Grid, n: usize| {
        let at = image.grid.to_index(&grid.to_world(Vector::from(grid.voxel(n).map(|c| c as f64))));
        let clamped = [0, 1, 2].map(|a| at[a].round().clamp(0.0, (image.grid.dims[a] - 1) as f64) as usize);
        let value = image.values.get(clamped[0] + image.grid.dims[0] * (clamped[1] + image.grid.dims[1] * clamped[2]));
        // A vessel that leaves the picture goes on to the last voxel of the grid: there the wall closes, or it never would.
        let last = grid.voxel(n).iter().zip(grid.dims).any(|(&i, n)| i == 0 || i + 1 == n);
        match (mask.data[n] != 0, value >= isovalue) {
            (true, _) if last => outside,
            (true, false) => inside,
            (false, true) => outside,
            // A border value just below the isovalue would go on for ever as all but wall.
            (false, false) if (0..3).any(|a| at[a] < -0.5 || at[a] > image.grid.dims[a] as f64 - 0.5) => value.min(outside),
            // Not a number is background.
            _ if value.is_nan() => outside,
            _ => value,
        }
    };
    let values: Vec<f64> = (0..mask.grid.len()).map(|n| own(&mask.grid, n)).collect();
    Ok(Probability::new(&mask.grid, &values, isovalue)?)
}
