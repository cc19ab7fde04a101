//! Meshes of one vessel at several sizes, each in a folder of its own, and the table of a grid-convergence study.

use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::{Context, Error, Outcome, Stage, run, write};
use crate::config::{AutoLength, Case, Length, Unit};
use crate::report::{Gate, Limit, Report, Status};
use crate::volume::series::{self, Member};

/// A mesh of the series in the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// `coarse`, `medium`, `fine`.
    name: String,
    /// Its folder under the results.
    folder: String,
    /// Factor on all edge lengths.
    factor: f64,
    /// Triangles of the surface.
    faces: u64,
    /// Tetrahedra and prisms.
    cells: u64,
    /// Cube root of the mean cell volume, mm.
    size: f64,
    /// `size` over that of the next finer mesh.
    ratio: Option<f64>,
    /// Largest equi-volume skewness.
    sv_max: f64,
    /// Whether all hard gates are met.
    passed: bool,
}

/// Runs `case`, writes everything into `dir` and gives the final report; with `volume.series` above 1 each mesh of the
/// series into `dir/series/NAME` too. The mesh of the size asked for is the case's own result as well.
///
/// All members are meshed from the same mask by the same fit and cut at the same planes, so that their patches are the
/// same; only sizes differ.
///
/// # Errors
/// As [`run`] and [`write`].
pub fn run_and_write(case: &Case, dir: &Path, context: &Context) -> Result<Report, Error> {
    let mut outcome = run(case, context)?;
    if case.volume.series > 1 && context.stop_after >= Stage::Volume {
        let mut rows = Vec::new();
        for member in series::members(case.volume.series) {
            context.progress.explain(&format!("series: {}, edge lengths × {:.3}", member.name, member.factor));
            let own = for_member(case, &member);
            let folder = format!("series/{}", member.name);
            let path = dir.join(&folder);
            let report = if member.factor == 1.0 {
                write(&outcome, &own, &path, context)?
            } else {
                write(&run(&own, context)?, &own, &path, context)?
            };
            rows.push(row(&member, folder, &report));
        }
        for i in 1..rows.len() {
            rows[i - 1].ratio = Some(rows[i - 1].size / rows[i].size);
        }
        note(&mut outcome, &rows);
        let path = dir.join("series/convergence.csv");
        std::fs::write(&path, table(&rows)).map_err(|e| crate::io::Error::write(&path, e))?;
    }
    write(&outcome, case, dir, context)
}

fn row(member: &Member, folder: String, report: &Report) -> Row {
    let section = |name: &str, key: &str| report.sections.get(name).and_then(|s| s.get(key));
    let number = |name: &str, key: &str| section(name, key).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let cells = section("volume", "cells").and_then(Value::as_u64).unwrap_or(0);
    Row {
        name: member.name.clone(),
        folder,
        factor: member.factor,
        faces: section("surface", "faces").and_then(Value::as_u64).unwrap_or(0),
        cells,
        size: series::representative_size(number("volume", "volume"), cells as usize),
        ratio: None,
        sv_max: number("volume", "sv_max"),
        passed: report.status == Status::Passed,
    }
}

/// Enters the series into the report of the whole case.
fn note(outcome: &mut Outcome, rows: &[Row]) {
    let report = &mut outcome.report;
    report.put("series", &rows);
    let missed = rows.iter().filter(|r| !r.passed).count();
    report.gate(Gate::hard("meshes of the series that miss a hard gate", missed as f64, Limit::Exactly(0.0)));
    for r in rows.iter().filter(|r| r.ratio.is_some_and(|x| x < 1.3)) {
        report.warn(
            "series",
            format!(
                "{} is only {:.2} times as coarse as the next mesh; a grid-convergence study asks for 1.3: limits on edge \
                 lengths (min_edge_length, max_edge_length) hold the sizes together",
                r.name,
                r.ratio.unwrap_or(f64::NAN)
            ),
        );
    }
}

/// The table of a grid-convergence study; the last column waits for a figure of the flow.
fn table(rows: &[Row]) -> String {
    let mut out = String::from("mesh,folder,cells,h_mm,ratio,figure\n");
    for r in rows {
        let ratio = r.ratio.map_or(String::new(), |x| format!("{x:.4}"));
        out.push_str(&format!("{},{},{},{:.6},{ratio},\n", r.name, r.folder, r.cells, r.size));
    }
    out
}

/// The case of one mesh: all edge lengths times its factor; as many prism layers as make them so much thinner.
fn for_member(case: &Case, member: &Member) -> Case {
    let f = member.factor;
    let mut c = case.clone();
    c.volume.series = 1;
    if f == 1.0 {
        return c;
    }
    c.surface.scale *= f;
    c.surface.target_faces = c.surface.target_faces.map(|n| (n as f64 / (f * f)).round().max(1.0) as usize);
    c.volume.target_cells = c.volume.target_cells.map(|n| (n as f64 / (f * f * f)).round().max(1.0) as usize);
    let times = |l: AutoLength| match l {
        AutoLength::Given(l) => AutoLength::Given(Length { value: l.value * f, ..l }),
        AutoLength::Auto => AutoLength::Auto,
    };
    c.volume.edge_length = match c.volume.edge_length {
        // A part of the radius bounds the sizes from above and is not reached in narrow vessels: it scales as well.
        AutoLength::Auto => AutoLength::Given(Length { value: f / 3.0, unit: Unit::Radius }),
        given => times(given),
    };
    // Sizes at the same place, not only at the wall and in the middle, are the factor apart then.
    c.volume.growth = (c.volume.growth * f).min(2.0);
    let b = &mut c.volume.boundary_layers;
    if b.count > 0 {
        // The same thickness in all, from layers thinner or thicker by the factor.
        b.count = ((f64::from(b.count) / f).round() as u32).max(1);
        b.growth = b.growth.powf(f);
        b.first_height = times(b.first_height);
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finer_member_has_shorter_edges_more_cells_and_more_layers() {
        let mut case = Case::for_mask("a.nrrd".into());
        case.volume.series = 3;
        case.volume.target_cells = Some(100_000);
        case.volume.edge_length = AutoLength::Given(Length::mm(1.4));
        case.volume.boundary_layers.count = 4;
        let m = series::members(3);
        let (coarse, medium, fine) = (for_member(&case, &m[0]), for_member(&case, &m[1]), for_member(&case, &m[2]));
        assert_eq!((coarse.volume.series, medium.volume.series), (1, 1));
        assert!((fine.surface.scale * 1.4 - 1.0).abs() < 1e-12 && (coarse.surface.scale - 1.4).abs() < 1e-12);
        assert_eq!(fine.volume.target_cells, Some(274_400));
        assert_eq!(fine.volume.edge_length, AutoLength::Given(Length { value: 1.4 * m[2].factor, unit: Unit::Millimetre }));
        assert!((coarse.volume.growth / medium.volume.growth - 1.4).abs() < 1e-12);
        assert_eq!([coarse, medium, fine].map(|c| c.volume.boundary_layers.count), [3, 4, 6]);
    }

    #[test]
    fn the_table_leaves_the_figure_open() {
        let row = |name: &str, size: f64, ratio: Option<f64>| Row {
            name: name.into(),
            folder: format!("series/{name}"),
            factor: 1.0,
            faces: 10,
            cells: 20,
            size,
            ratio,
            sv_max: 0.5,
            passed: true,
        };
        let text = table(&[row("coarse", 0.5, Some(1.25)), row("fine", 0.4, None)]);
        assert_eq!(text, "mesh,folder,cells,h_mm,ratio,figure\ncoarse,series/coarse,20,0.500000,1.2500,\nfine,series/fine,20,0.400000,,\n");
    }
}
