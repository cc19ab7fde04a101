//! `lumenmesh convergence`: what the filled table of a series tells about the error of the flow's figures.

use super::args::ConvergenceArgs;
use super::exit::{self, Failure};
use crate::io::Error;
use crate::volume::series::convergence;

/// `lumenmesh convergence series/convergence.csv`
pub fn run(args: &ConvergenceArgs) -> Result<u8, Failure> {
    let path = &args.table;
    let text = std::fs::read_to_string(path).map_err(|e| Failure::new(exit::INPUT, Error::read(path, e)))?;
    let lines = evaluate(&text).map_err(|what| Failure::new(exit::INPUT, anyhow::anyhow!("{}: {what}", path.display())))?;
    lines.iter().for_each(|l| println!("{l}"));
    Ok(0)
}

/// A line for each column of figures: observed order, value at edge length 0, grid convergence index.
fn evaluate(text: &str) -> Result<Vec<String>, String> {
    let mut rows = text.lines().filter(|l| !l.trim().is_empty()).map(|l| l.split(',').map(str::trim).collect::<Vec<_>>());
    let head = rows.next().ok_or("the table is empty: take series/convergence.csv of a run with volume.series 3")?;
    let rows: Vec<Vec<&str>> = rows.collect();
    let size = head.iter().position(|h| *h == "h_mm").ok_or("there is no column h_mm: keep the columns of the table")?;
    let known = ["mesh", "folder", "cells", "h_mm", "ratio"];
    let mut out = vec![];
    for (k, name) in head.iter().enumerate().filter(|(_, h)| !known.contains(h)) {
        let number = |row: &Vec<&str>, k: usize| row.get(k).and_then(|x| x.parse::<f64>().ok());
        let mut filled: Vec<(f64, f64)> = rows.iter().filter_map(|r| Some((number(r, size)?, number(r, k)?))).collect();
        filled.sort_by(|a, b| a.0.total_cmp(&b.0));
        let [a, b, c] = *filled.first_chunk::<3>().ok_or(format!(
            "column {name} holds {} numbers: enter the figure of each of three meshes (pressure drop, wall shear stress)",
            filled.len()
        ))?;
        let found = convergence([a.0, b.0, c.0], [a.1, b.1, c.1])
            .ok_or(format!("column {name}: the sizes h_mm must rise from mesh to mesh"))?;
        let text = |x: Option<f64>| x.map_or("–".into(), |x| format!("{x:.4}"));
        let percent = found.gci_fine.map_or("–".into(), |g| format!("{:.2} %", 100.0 * g));
        out.push(format!(
            "{name}: fine mesh {}, observed order {}{}, at edge length 0 {}, grid convergence index {percent}",
            a.1,
            text(found.order),
            if found.oscillatory { " (the figure swings between the meshes)" } else { "" },
            text(found.extrapolated)
        ));
    }
    if out.is_empty() {
        return Err("there is no column of figures: add one after the column ratio".into());
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filled_table_gives_order_and_error() {
        let figure = |h: f64| 3.0 + 0.7 * h * h;
        let rows: String = [("coarse", 1.0), ("medium", 0.7), ("fine", 0.5)]
            .iter()
            .map(|(n, h)| format!("{n},series/{n},100,{h},1.4,{}\n", figure(*h)))
            .collect();
        let said = evaluate(&format!("mesh,folder,cells,h_mm,ratio,drop_Pa\n{rows}")).unwrap();
        assert!(said[0].starts_with("drop_Pa: fine mesh 3.175, observed order 2.0000, at edge length 0 3.0000"), "{said:?}");
    }

    #[test]
    fn an_empty_column_says_what_to_enter() {
        let e = evaluate("mesh,folder,cells,h_mm,ratio,figure\ncoarse,a,10,0.5,1.4,\nfine,b,20,0.4,,\n").unwrap_err();
        assert!(e.contains("column figure holds 0 numbers") && e.contains("three meshes"), "{e}");
    }
}
