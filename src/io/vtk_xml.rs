//! VTK's XML files with raw appended data: headers in UInt64, little endian, points in Float64.
//!
//! The crate `vtkio` writes inline base64 only, about ten times slower and a third larger, and no string arrays:
//! this writer is here for raw appended data and for the patch names.

use std::io::{self, Write};

/// Values of a data array.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Float64.
    F64(Vec<f64>),
    /// Int32.
    I32(Vec<i32>),
    /// Int64.
    I64(Vec<i64>),
    /// UInt8.
    U8(Vec<u8>),
}

impl Values {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Values::F64(v) => v.len(),
            Values::I32(v) => v.len(),
            Values::I64(v) => v.len(),
            Values::U8(v) => v.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn kind(&self) -> (&'static str, usize) {
        match self {
            Values::F64(_) => ("Float64", 8),
            Values::I32(_) => ("Int32", 4),
            Values::I64(_) => ("Int64", 8),
            Values::U8(_) => ("UInt8", 1),
        }
    }

    /// The values in digits.
    fn ascii(&self) -> String {
        fn join<T: ToString>(v: &[T]) -> String {
            v.iter().map(T::to_string).collect::<Vec<_>>().join(" ")
        }
        match self {
            Values::F64(v) => join(v),
            Values::I32(v) => join(v),
            Values::I64(v) => join(v),
            Values::U8(v) => join(v),
        }
    }

    fn write(&self, w: &mut dyn Write) -> io::Result<()> {
        fn put<T: Copy, const N: usize>(w: &mut dyn Write, v: &[T], f: impl Fn(T) -> [u8; N]) -> io::Result<()> {
            let mut buffer = Vec::with_capacity(N * v.len().min(1 << 16));
            for block in v.chunks(1 << 16) {
                buffer.clear();
                block.iter().for_each(|&x| buffer.extend_from_slice(&f(x)));
                w.write_all(&buffer)?;
            }
            Ok(())
        }
        let (_, size) = self.kind();
        w.write_all(&((self.len() * size) as u64).to_le_bytes())?;
        match self {
            Values::F64(v) => put(w, v, f64::to_le_bytes),
            Values::I32(v) => put(w, v, i32::to_le_bytes),
            Values::I64(v) => put(w, v, i64::to_le_bytes),
            Values::U8(v) => w.write_all(v),
        }
    }
}

/// A named array of tuples.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Name as ParaView shows it.
    pub name: String,
    /// Values a tuple.
    pub components: usize,
    /// The values, tuple by tuple.
    pub values: Values,
}

impl Array {
    /// An array of scalars.
    pub fn scalars(name: &str, values: Values) -> Array {
        Array { name: name.into(), components: 1, values }
    }

    /// Type, name and components as attributes. Scalars say no number of components: meshio makes columns of them then.
    fn head(&self) -> String {
        let (kind, _) = self.values.kind();
        let components = if self.components == 1 { String::new() } else { format!(" NumberOfComponents=\"{}\"", self.components) };
        format!("type=\"{kind}\" Name=\"{}\"{components}", escape(&self.name))
    }

    /// An array of vectors.
    pub fn vectors(name: &str, values: Vec<f64>) -> Array {
        Array { name: name.into(), components: 3, values: Values::F64(values) }
    }
}

/// Arrays beside the mesh itself.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Extra {
    /// One tuple a point.
    pub point: Vec<Array>,
    /// One tuple a cell.
    pub cell: Vec<Array>,
    /// Field data in numbers. Every reader takes it; some, such as meshio's, stop at texts.
    pub field: Vec<Array>,
    /// Field data in texts: for PolyData only.
    pub text: Vec<(String, Vec<String>)>,
}

/// Field data that says units and frame in numbers: `MetresPerUnit` 0.001, `CoordinatesLPS` 1.
pub(super) fn millimetres() -> Vec<Array> {
    vec![Array::scalars("MetresPerUnit", Values::F64(vec![0.001])), Array::scalars("CoordinatesLPS", Values::I32(vec![1]))]
}

pub(super) fn escape(s: &str) -> String {
    s.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Where an array stands in the file.
#[derive(Clone, Copy)]
pub(super) enum Section {
    /// Values at points.
    PointData,
    /// Values at cells.
    CellData,
    /// The points.
    Points,
    /// Connectivity and the like, under this name.
    Topology(&'static str),
}

/// One piece of a file.
pub(super) struct Piece<'a> {
    /// `PolyData` or `UnstructuredGrid`.
    pub kind: &'static str,
    /// Attributes of the piece: number of points and so on.
    pub counts: Vec<(&'static str, usize)>,
    /// Field data in numbers, written in the XML itself.
    pub field: &'a [Array],
    /// Field data in texts.
    pub text: &'a [(String, Vec<String>)],
    /// Sections in VTK's order with their arrays.
    pub sections: Vec<(Section, Vec<&'a Array>)>,
}

impl Piece<'_> {
    /// Writes the file.
    pub fn write(&self, w: &mut dyn Write) -> io::Result<()> {
        let kind = self.kind;
        writeln!(w, "<?xml version=\"1.0\"?>")?;
        writeln!(w, "<VTKFile type=\"{kind}\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">")?;
        writeln!(w, "<{kind}>")?;
        if !(self.text.is_empty() && self.field.is_empty()) {
            writeln!(w, "<FieldData>")?;
            for a in self.field {
                let tuples = a.values.len() / a.components.max(1);
                writeln!(w, "<DataArray {} NumberOfTuples=\"{tuples}\" format=\"ascii\">", a.head())?;
                writeln!(w, "{}\n</DataArray>", a.values.ascii())?;
            }
            for (name, texts) in self.text {
                writeln!(w, "<Array type=\"String\" Name=\"{}\" NumberOfTuples=\"{}\" format=\"ascii\">", escape(name), texts.len())?;
                for t in texts {
                    for b in t.bytes() {
                        write!(w, "{b} ")?;
                    }
                    writeln!(w, "0")?;
                }
                writeln!(w, "</Array>")?;
            }
            writeln!(w, "</FieldData>")?;
        }
        write!(w, "<Piece")?;
        for (name, n) in &self.counts {
            write!(w, " {name}=\"{n}\"")?;
        }
        writeln!(w, ">")?;
        let mut offset = 0;
        for (section, arrays) in &self.sections {
            let name = match section {
                Section::PointData => "PointData",
                Section::CellData => "CellData",
                Section::Points => "Points",
                Section::Topology(name) => name,
            };
            writeln!(w, "<{name}>")?;
            for a in arrays {
                writeln!(w, "<DataArray {} format=\"appended\" offset=\"{offset}\"/>", a.head())?;
                offset += 8 + a.values.len() * a.values.kind().1;
            }
            writeln!(w, "</{name}>")?;
        }
        writeln!(w, "</Piece>\n</{kind}>\n<AppendedData encoding=\"raw\">")?;
        w.write_all(b"_")?;
        for (_, arrays) in &self.sections {
            for a in arrays {
                a.values.write(w)?;
            }
        }
        writeln!(w, "\n</AppendedData>\n</VTKFile>")
    }
}

/// Coordinates as an array, each times `scale`.
pub(super) fn points_array(points: &[crate::geometry::Point], scale: f64) -> Array {
    Array::vectors("Points", points.iter().flat_map(|p| [p.x * scale, p.y * scale, p.z * scale]).collect())
}

/// Connectivity and offsets of `cells`.
pub(super) fn connectivity<'a>(cells: impl Iterator<Item = &'a [u32]>) -> [Array; 2] {
    let (mut ids, mut offsets) = (Vec::new(), Vec::new());
    for c in cells {
        ids.extend(c.iter().map(|&v| i64::from(v)));
        offsets.push(ids.len() as i64);
    }
    [Array::scalars("connectivity", Values::I64(ids)), Array::scalars("offsets", Values::I64(offsets))]
}
