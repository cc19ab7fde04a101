//! What a case starts from: a mask, a probability map or a surface.

use std::path::Path;

use super::surface::{self, GivenSurface};
use super::{Error, options, results};
use crate::config::Case;
use crate::geometry::Vector;
use crate::implicit::probability::Probability;
use crate::io;
use crate::mask::{self, Grid, Image, Mask, Selection};
use crate::report::Report;

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
            let mask = mask::select(&image, &options::selection(case)).map_err(|source| Error::Selection { path: path.clone(), source })?;
            report.put("input", &results::provenance(path, &image, &mask));
            Ok((mask, Source::Mask))
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
        match (mask.data[n] != 0, value >= isovalue) {
            (true, false) => inside,
            (false, true) => outside,
            // Not a number is background.
            _ if value.is_nan() => outside,
            _ => value,
        }
    };
    let values: Vec<f64> = (0..mask.grid.len()).map(|n| own(&mask.grid, n)).collect();
    Ok(Probability::new(&mask.grid, &values, isovalue)?)
}
