//! Reader of VTK's legacy files (.vtk) with PolyData: ASCII and binary, versions 1 to 5.

use super::mesh::{fan, strip};
use crate::geometry::Point;
use crate::mesh::{Patch, TriMesh, WALL};

/// The file's content behind its header.
struct Body<'a> {
    rest: &'a [u8],
    binary: bool,
}

impl<'a> Body<'a> {
    /// The next line without its end; `None` at the end of the file.
    fn line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        self.rest = rest.get(1..).unwrap_or_default();
        Some(line)
    }

    /// `n` numbers of a type as VTK names it.
    fn numbers(&mut self, n: usize, kind: &str) -> Result<Vec<f64>, String> {
        let cut = || format!("the file ends within {n} numbers");
        // The shortest number is one digit and a blank.
        if n > self.rest.len() {
            return Err(cut());
        }
        if !self.binary {
            let mut out = Vec::with_capacity(n);
            for _ in 0..n {
                let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(cut)?;
                let rest = &self.rest[start..];
                let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
                let word = String::from_utf8_lossy(&rest[..length]);
                out.push(word.parse().map_err(|_| format!("`{word}` is no number"))?);
                self.rest = &rest[length..];
            }
            return Ok(out);
        }
        let size = match kind {
            "char" | "unsigned_char" | "vtktypeint8" | "vtktypeuint8" => 1,
            "short" | "unsigned_short" | "vtktypeint16" | "vtktypeuint16" => 2,
            "int" | "unsigned_int" | "float" | "vtktypeint32" | "vtktypeuint32" => 4,
            "long" | "unsigned_long" | "double" | "vtktypeint64" | "vtktypeuint64" | "vtkidtype" => 8,
            other => return Err(format!("numbers of type {other}")),
        };
        let (bytes, rest) = n.checked_mul(size).and_then(|l| self.rest.split_at_checked(l)).ok_or_else(cut)?;
        self.rest = rest;
        let value = |b: &[u8]| {
            let bits = b.iter().fold(0u64, |v, b| v << 8 | u64::from(*b));
            match kind {
                "float" => f64::from(f32::from_bits(bits as u32)),
                "double" => f64::from_bits(bits),
                "char" | "vtktypeint8" => f64::from(bits as i8),
                "short" | "vtktypeint16" => f64::from(bits as i16),
                "int" | "vtktypeint32" => f64::from(bits as i32),
                "long" | "vtktypeint64" | "vtkidtype" => bits as i64 as f64,
                _ => bits as f64,
            }
        };
        Ok(bytes.chunks_exact(size).map(value).collect())
    }

    /// Point ids or offsets, each below `limit`.
    fn ids(&mut self, n: usize, kind: &str, limit: usize) -> Result<Vec<u32>, String> {
        let id = |v: f64| if v >= 0.0 && v < limit as f64 && v.fract() == 0.0 { Ok(v as u32) } else { Err(format!("{v} where a number below {limit} belongs")) };
        self.numbers(n, kind)?.into_iter().map(id).collect()
    }

    /// The cells of a section whose line is `words`: counts and ids in one list, or from version 5 on offsets and ids apart.
    fn cells(&mut self, words: &[&str], points: usize) -> Result<Vec<Vec<u32>>, String> {
        let number = |i: usize| words.get(i).and_then(|w| w.parse::<usize>().ok()).ok_or_else(|| format!("`{}` without two counts", words[0]));
        let (first, second) = (number(1)?, number(2)?);
        let before = Body { rest: self.rest, binary: self.binary };
        let next = String::from_utf8_lossy(self.line().unwrap_or_default()).to_ascii_lowercase();
        if let Some(kind) = next.trim().strip_prefix("offsets ") {
            let offsets = self.ids(first, kind.trim(), second.saturating_add(1))?;
            let heading = loop {
                let line = String::from_utf8_lossy(self.line().ok_or("no CONNECTIVITY")?).to_ascii_lowercase();
                if !line.trim().is_empty() {
                    break line;
                }
            };
            let kind = heading.trim().strip_prefix("connectivity ").ok_or("no CONNECTIVITY behind OFFSETS")?;
            let ids = self.ids(second, kind.trim(), points)?;
            let cell = |w: &[u32]| ids.get(w[0] as usize..w[1] as usize).map(<[u32]>::to_vec).ok_or_else(|| format!("offset {} is out of order", w[1]));
            return offsets.windows(2).map(cell).collect();
        }
        *self = before;
        let list = self.ids(second, "int", points.max(second) + 1)?;
        let (mut cells, mut at) = (Vec::new(), 0);
        for _ in 0..first {
            let n = *list.get(at).ok_or("fewer ids than counted")? as usize;
            let end = at.checked_add(1 + n).ok_or("fewer ids than counted")?;
            cells.push(list.get(at + 1..end).ok_or("fewer ids than counted")?.to_vec());
            at = end;
        }
        Ok(cells)
    }
}

/// Reads a surface: polygons and triangle strips.
pub(super) fn poly_data(bytes: &[u8]) -> Result<TriMesh, String> {
    let mut body = Body { rest: bytes, binary: false };
    let text = |line: Option<&[u8]>| String::from_utf8_lossy(line.unwrap_or_default()).trim().to_string();
    if !text(body.line()).to_ascii_lowercase().starts_with("# vtk datafile") {
        return Err("no legacy VTK file (`# vtk DataFile Version` is missing)".into());
    }
    body.line();
    body.binary = match text(body.line()).to_ascii_lowercase().as_str() {
        "ascii" => false,
        "binary" => true,
        other => return Err(format!("`{other}` where ASCII or BINARY belongs")),
    };
    let mut mesh = TriMesh::default();
    while let Some(line) = body.line() {
        let line = String::from_utf8_lossy(line).to_ascii_lowercase();
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["dataset", "polydata"] => {}
            ["dataset", other, ..] => return Err(format!("a {other} dataset: only PolyData is read; write the surface as PolyData")),
            ["points", n, kind] => {
                let n: usize = n.parse().map_err(|_| format!("`{n}` points"))?;
                let all = body.numbers(n.checked_mul(3).ok_or("too many points")?, kind)?;
                mesh.points = all.chunks_exact(3).map(|c| Point::new(c[0], c[1], c[2])).collect();
            }
            ["polygons" | "triangle_strips", ..] => {
                let n = mesh.points.len();
                for cell in body.cells(&words, n)? {
                    if words[0] == "polygons" { fan(&cell, n, &mut mesh.triangles)? } else { strip(&cell, n, &mut mesh.triangles)? }
                }
            }
            ["vertices" | "lines", ..] => drop(body.cells(&words, mesh.points.len())?),
            // What follows are attributes.
            ["point_data" | "cell_data", ..] => break,
            _ => {}
        }
    }
    mesh.patch = vec![WALL; mesh.triangles.len()];
    mesh.patches = vec![Patch::wall()];
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "# vtk DataFile Version 3.0\na tetrahedron\n";

    fn tetrahedron() -> TriMesh {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]].map(Point::from).to_vec();
        TriMesh::new(points, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    }

    #[test]
    fn polygons_are_read_from_text_and_binary() {
        let text = format!("{HEAD}ASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0\n0 1 0 0 0 1.5\nPOLYGONS 4 16\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\nCELL_DATA 4\n");
        assert_eq!(poly_data(text.as_bytes()), Ok(tetrahedron()));
        let mut bytes = format!("{HEAD}BINARY\nDATASET POLYDATA\nPOINTS 4 double\n").into_bytes();
        tetrahedron().points.iter().flat_map(|p| [p.x, p.y, p.z]).for_each(|c| bytes.extend(c.to_be_bytes()));
        bytes.extend(b"\nPOLYGONS 4 16\n");
        tetrahedron().triangles.iter().flat_map(|t| [3, t[0], t[1], t[2]]).for_each(|i| bytes.extend(i.to_be_bytes()));
        bytes.extend(b"\n");
        assert_eq!(poly_data(&bytes), Ok(tetrahedron()));
    }

    #[test]
    fn version_five_and_strips_are_read() {
        let text = format!("{HEAD}ASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1.5\nTRIANGLE_STRIPS 2 6\nOFFSETS vtktypeint64\n0 6\nCONNECTIVITY vtktypeint64\n0 2 1 3 0 2\n");
        let mesh = poly_data(text.as_bytes()).expect("a surface");
        assert_eq!(mesh.triangles.len(), 4);
        assert!((mesh.volume() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn other_datasets_and_cut_files_are_refused() {
        assert!(poly_data(format!("{HEAD}ASCII\nDATASET UNSTRUCTURED_GRID\n").as_bytes()).expect_err("no surface").contains("PolyData"));
        assert!(poly_data(format!("{HEAD}ASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1").as_bytes()).is_err());
        assert!(poly_data(format!("{HEAD}BINARY\nDATASET POLYDATA\nPOINTS 4000000000 float\n").as_bytes()).is_err());
    }
}
