//! Voxel data as picture files store it: scalar types, byte orders, encodings.
//!
//! The size a header announces is checked against the file's length before anything is allocated.

use std::io::{BufRead, ErrorKind, Read};
use std::path::Path;

use bzip2::bufread::MultiBzDecoder;
use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use super::Error;
use crate::mask::Values;

/// Type of a stored scalar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ScalarType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl ScalarType {
    pub(super) fn size(self) -> usize {
        match self {
            ScalarType::U8 | ScalarType::I8 => 1,
            ScalarType::U16 | ScalarType::I16 => 2,
            ScalarType::U32 | ScalarType::I32 | ScalarType::F32 => 4,
            ScalarType::U64 | ScalarType::I64 | ScalarType::F64 => 8,
        }
    }
}

/// Order of the bytes of a stored scalar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ByteOrder {
    Little,
    Big,
}

/// How the scalars are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Raw,
    Gzip,
    Zlib,
    Bzip2,
    Text,
    Hex,
}

impl Encoding {
    /// The most bytes that one stored byte can stand for.
    fn expansion(self) -> u64 {
        match self {
            Encoding::Raw => 1,
            // Deflate codes at most 258 bytes in 2 bits.
            Encoding::Gzip | Encoding::Zlib => 1032,
            // A block of 900 000 bytes in about 40, each five of which stand for 259 equal ones.
            Encoding::Bzip2 => 1_250_000,
            Encoding::Text | Encoding::Hex => 8,
        }
    }
}

/// What is stored and how.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub(super) scalar: ScalarType,
    pub(super) order: ByteOrder,
    pub(super) encoding: Encoding,
    /// Bytes to leave out before the first scalar, counted after decompression.
    pub(super) skip: u64,
    /// Number of scalars.
    pub(super) count: usize,
}

const AGAIN: &str = "the file is cut short or its header is wrong: copy or export it again";

/// Reads `layout.count` scalars from `source`, which stands at the first stored byte with `stored` bytes left in the file.
pub(super) fn read_values(path: &Path, source: impl BufRead, stored: u64, layout: &Layout) -> Result<Values, Error> {
    let needed = (layout.count as u64)
        .checked_mul(layout.scalar.size() as u64)
        .and_then(|n| n.checked_add(layout.skip))
        .ok_or_else(|| Error::malformed(path, "the header announces more voxels than any file holds", AGAIN))?;
    if stored.saturating_mul(layout.encoding.expansion()) < needed {
        let what = match layout.encoding {
            Encoding::Raw => format!("the header announces {needed} bytes of voxels, the file holds {stored}"),
            _ => format!("the header announces {needed} bytes of voxels, more than the file's {stored} encoded bytes can hold"),
        };
        return Err(Error::malformed(path, what, AGAIN));
    }
    match layout.encoding {
        Encoding::Raw => decode(path, source, layout),
        Encoding::Gzip => decode(path, MultiGzDecoder::new(source), layout),
        Encoding::Zlib => decode(path, ZlibDecoder::new(source), layout),
        Encoding::Bzip2 => decode(path, MultiBzDecoder::new(source), layout),
        Encoding::Hex => decode(path, Hex { source }, layout),
        Encoding::Text => parse(path, source, layout),
    }
}

/// Pairs of hexadecimal digits as bytes; white space between them does not count.
struct Hex<R> {
    source: R,
}

impl<R: BufRead> Hex<R> {
    fn digit(&mut self) -> std::io::Result<Option<u8>> {
        let mut one = [0u8];
        while self.source.read(&mut one)? == 1 {
            if one[0].is_ascii_whitespace() {
                continue;
            }
            let d = (one[0] as char).to_digit(16);
            return d.map(|d| Some(d as u8)).ok_or_else(|| std::io::Error::new(ErrorKind::InvalidData, "a character is no hexadecimal digit"));
        }
        Ok(None)
    }
}

impl<R: BufRead> Read for Hex<R> {
    fn read(&mut self, buf: &mut [u8]) -> std::io::Result<usize> {
        for (n, slot) in buf.iter_mut().enumerate() {
            let (Some(high), Some(low)) = (self.digit()?, self.digit()?) else { return Ok(n) };
            *slot = 16 * high + low;
        }
        Ok(buf.len())
    }
}

fn decode(path: &Path, mut source: impl Read, layout: &Layout) -> Result<Values, Error> {
    // A decompressor may also stand in front of `source`; its errors have kinds that a file's own do not have.
    let broken = |e: std::io::Error, got: u64| match e.kind() {
        ErrorKind::UnexpectedEof => Error::malformed(path, format!("the compressed voxels end early, after {got} bytes"), AGAIN),
        ErrorKind::InvalidInput | ErrorKind::InvalidData => {
            Error::malformed(path, format!("the voxel data are damaged after {got} bytes ({e})"), AGAIN)
        }
        _ => Error::read(path, e),
    };
    let skipped = std::io::copy(&mut (&mut source).take(layout.skip), &mut std::io::sink()).map_err(|e| broken(e, 0))?;
    let mut reader = Scalars { path, source: &mut source, layout, broken: &broken };
    if skipped < layout.skip {
        return Err(reader.short(skipped));
    }
    let values = match layout.scalar {
        ScalarType::U8 => Values::U8(reader.bytes()?),
        ScalarType::I8 => Values::I8(reader.all(|[a], _| a as i8)?),
        ScalarType::U16 => Values::U16(reader.all(|b, l| if l { u16::from_le_bytes(b) } else { u16::from_be_bytes(b) })?),
        ScalarType::I16 => Values::I16(reader.all(|b, l| if l { i16::from_le_bytes(b) } else { i16::from_be_bytes(b) })?),
        ScalarType::U32 => Values::U32(reader.all(|b, l| if l { u32::from_le_bytes(b) } else { u32::from_be_bytes(b) })?),
        ScalarType::I32 => Values::I32(reader.all(|b, l| if l { i32::from_le_bytes(b) } else { i32::from_be_bytes(b) })?),
        ScalarType::U64 => Values::U64(reader.all(|b, l| if l { u64::from_le_bytes(b) } else { u64::from_be_bytes(b) })?),
        ScalarType::I64 => Values::I64(reader.all(|b, l| if l { i64::from_le_bytes(b) } else { i64::from_be_bytes(b) })?),
        ScalarType::F32 => Values::F32(reader.all(|b, l| if l { f32::from_le_bytes(b) } else { f32::from_be_bytes(b) })?),
        ScalarType::F64 => Values::F64(reader.all(|b, l| if l { f64::from_le_bytes(b) } else { f64::from_be_bytes(b) })?),
    };
    // A checksum stands behind the last byte: reading on makes a decompressor compare it. What else may follow does not matter.
    match source.read(&mut [0]) {
        Err(e) if !e.to_string().contains("header") => Err(broken(e, (layout.count * layout.scalar.size()) as u64)),
        _ => Ok(values),
    }
}

/// Takes scalars from a stream of bytes.
struct Scalars<'a, R, B> {
    path: &'a Path,
    source: &'a mut R,
    layout: &'a Layout,
    broken: &'a B,
}

impl<R: Read, B: Fn(std::io::Error, u64) -> Error> Scalars<'_, R, B> {
    fn short(&self, got: u64) -> Error {
        let needed = self.layout.skip + (self.layout.count * self.layout.scalar.size()) as u64;
        Error::malformed(self.path, format!("the header announces {needed} bytes of voxels, the data end after {got}"), AGAIN)
    }

    fn reserve<T>(&self) -> Result<Vec<T>, Error> {
        let mut out = Vec::new();
        // An encoding that may expand without much of a bound is taken at its word only as data arrive.
        let n = if self.layout.encoding == Encoding::Bzip2 { 0 } else { self.layout.count };
        out.try_reserve_exact(n).map_err(|_| {
            Error::unsupported(self.path, format!("an image of {n} voxels"), "crop it: it does not fit in this machine's memory")
        })?;
        Ok(out)
    }

    fn bytes(&mut self) -> Result<Vec<u8>, Error> {
        let mut out = self.reserve()?;
        let result = (&mut *self.source).take(self.layout.count as u64).read_to_end(&mut out);
        result.map_err(|e| (self.broken)(e, out.len() as u64))?;
        if out.len() < self.layout.count {
            return Err(self.short(out.len() as u64));
        }
        Ok(out)
    }

    fn all<const N: usize, T>(&mut self, from: impl Fn([u8; N], bool) -> T) -> Result<Vec<T>, Error> {
        let little = self.layout.order == ByteOrder::Little;
        let mut out = self.reserve()?;
        let mut block = Vec::with_capacity((1 << 16) * N);
        while out.len() < self.layout.count {
            let want = (self.layout.count - out.len()).min(1 << 16) * N;
            block.clear();
            let result = (&mut *self.source).take(want as u64).read_to_end(&mut block);
            let got = (out.len() * N + block.len()) as u64;
            result.map_err(|e| (self.broken)(e, got))?;
            if block.len() < want {
                return Err(self.short(got));
            }
            let (chunks, _) = block.as_chunks::<N>();
            out.extend(chunks.iter().map(|b| from(*b, little)));
        }
        Ok(out)
    }
}

fn parse(path: &Path, mut source: impl BufRead, layout: &Layout) -> Result<Values, Error> {
    let mut text = String::new();
    source.read_to_string(&mut text).map_err(|e| Error::read(path, e))?;
    let words = text.split(|c: char| c.is_ascii_whitespace() || c == ',').filter(|w| !w.is_empty());
    macro_rules! numbers {
        ($variant:ident, $t:ty) => {{
            let mut out: Vec<$t> = Vec::new();
            for w in words.take(layout.count) {
                let bad = || Error::malformed(path, format!("voxel {} is \"{w}\", no {}", out.len(), stringify!($t)), AGAIN);
                out.push(w.parse().map_err(|_| bad())?);
            }
            if out.len() < layout.count {
                let what = format!("the header announces {} voxels, the text holds {}", layout.count, out.len());
                return Err(Error::malformed(path, what, AGAIN));
            }
            Values::$variant(out)
        }};
    }
    Ok(match layout.scalar {
        ScalarType::U8 => numbers!(U8, u8),
        ScalarType::I8 => numbers!(I8, i8),
        ScalarType::U16 => numbers!(U16, u16),
        ScalarType::I16 => numbers!(I16, i16),
        ScalarType::U32 => numbers!(U32, u32),
        ScalarType::I32 => numbers!(I32, i32),
        ScalarType::U64 => numbers!(U64, u64),
        ScalarType::I64 => numbers!(I64, i64),
        ScalarType::F32 => numbers!(F32, f32),
        ScalarType::F64 => numbers!(F64, f64),
    })
}
