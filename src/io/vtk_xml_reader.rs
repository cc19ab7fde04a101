//! VTK's XML files as such: tags, and arrays in ASCII, inline base64 and appended (raw or base64), plain, zlib or LZ4.

use std::borrow::Cow;
use std::io::Read;

/// How blocks are packed.
#[derive(Clone, Copy, PartialEq)]
enum Packing {
    None,
    Zlib,
    Lz4,
}

/// One tag: name, attributes, and where its content starts.
pub(super) struct Tag<'a> {
    pub name: &'a str,
    pub text: &'a str,
    pub end: usize,
}

pub(super) fn attribute<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let mut rest = text;
    loop {
        let at = rest.find(name)?;
        let after = rest[at + name.len()..].trim_start();
        let before = rest[..at].chars().last().is_some_and(char::is_whitespace);
        if before && let Some(v) = after.strip_prefix('=') {
            let v = v.trim_start();
            let quote = v.chars().next().filter(|c| *c == '"' || *c == '\'')?;
            return v[1..].split(quote).next();
        }
        rest = &rest[at + name.len()..];
    }
}

pub(super) struct File<'a> {
    pub bytes: &'a [u8],
    pub tags: Vec<Tag<'a>>,
    wide: bool,
    packing: Packing,
    /// The appended bytes, already decoded from base64 where `None`.
    appended: Option<(&'a [u8], bool)>,
}

impl<'a> File<'a> {
    pub fn parse(bytes: &'a [u8]) -> Result<File<'a>, String> {
        // The XML ends where raw data starts.
        let mark = b"<AppendedData";
        let xml_end = bytes.windows(mark.len()).position(|w| w == mark);
        let xml = std::str::from_utf8(&bytes[..xml_end.unwrap_or(bytes.len())]).map_err(|_| "the XML is not UTF-8")?;
        let mut tags = vec![];
        let mut at = 0;
        while let Some(open) = xml[at..].find('<') {
            let start = at + open + 1;
            if xml[start..].starts_with("!--") {
                at = xml[start..].find("-->").map(|i| start + i + 3).ok_or("a comment without end")?;
                continue;
            }
            let close = xml[start..].find('>').ok_or("a tag without end")?;
            let text = &xml[start..start + close];
            let name = text.split(|c: char| c.is_whitespace() || c == '/').next().unwrap_or_default();
            tags.push(Tag { name, text, end: start + close + 1 });
            at = start + close + 1;
        }
        let root = tags.iter().find(|t| t.name == "VTKFile").ok_or("no VTKFile element: not a VTK XML file")?;
        if attribute(root.text, "byte_order") == Some("BigEndian") {
            return Err("big-endian data".into());
        }
        let packing = match attribute(root.text, "compressor").unwrap_or_default() {
            "" => Packing::None,
            "vtkZLibDataCompressor" => Packing::Zlib,
            "vtkLZ4DataCompressor" => Packing::Lz4,
            other => return Err(format!("compressor {other}, which is not read: write with ZLib, LZ4 or none")),
        };
        let wide = attribute(root.text, "header_type") == Some("UInt64");
        let mut appended = None;
        if let Some(e) = xml_end {
            let rest = &bytes[e..];
            let close = rest.iter().position(|&b| b == b'>').ok_or("AppendedData is cut off")?;
            let raw = rest[..close].windows(3).any(|w| w == b"raw");
            let from = rest[close..].iter().position(|&b| b == b'_').ok_or("no _ before the appended data")?;
            appended = Some((&rest[close + from + 1..], raw));
        }
        Ok(File { bytes, tags, wide, packing, appended })
    }

    pub fn count(&self, name: &str) -> Result<usize, String> {
        let pieces: Vec<&Tag> = self.tags.iter().filter(|t| t.name == "Piece").collect();
        let [piece] = pieces[..] else { return Err(format!("{} pieces; exactly one is read", pieces.len())) };
        let n = attribute(piece.text, name).unwrap_or("0").trim().parse().map_err(|_| format!("{name} is no number"))?;
        // Even compressed, a point or cell costs more than a thousandth of a byte.
        if n / 1024 > self.bytes.len() { Err(format!("{name} = {n} cannot be in {} bytes", self.bytes.len())) } else { Ok(n) }
    }

    /// Hands every value of the array `name` (any, where `None`) inside `section` to `put`; `false` where it is not there.
    pub fn each(&self, section: &str, name: Option<&str>, put: impl FnMut(f64) -> Result<(), String>) -> Result<bool, String> {
        let Some(from) = self.tags.iter().position(|t| t.name == section) else { return Ok(false) };
        let tag = self.tags[from + 1..]
            .iter()
            .take_while(|t| !t.name.is_empty() || t.text.trim_start_matches('/') != section)
            .find(|t| t.name == "DataArray" && name.is_none_or(|n| attribute(t.text, "Name") == Some(n)));
        let Some(tag) = tag else { return Ok(false) };
        self.values(tag, put).map_err(|e| format!("array {} of {section}: {e}", attribute(tag.text, "Name").unwrap_or("")))?;
        Ok(true)
    }

    /// All values of an array as numbers.
    pub fn array(&self, section: &str, name: Option<&str>) -> Result<Option<Vec<f64>>, String> {
        let mut out = vec![];
        let found = self.each(section, name, |x| {
            out.push(x);
            Ok(())
        })?;
        Ok(found.then_some(out))
    }

    /// All values of an array as ids below `end`.
    pub fn ids(&self, section: &str, name: &str, end: usize) -> Result<Vec<u32>, String> {
        let mut out = vec![];
        let found = self.each(section, Some(name), |x| {
            if !(x >= 0.0 && x < end as f64) {
                return Err(format!("entry {} is {x}, it must be below {end}", out.len()));
            }
            out.push(x as u32);
            Ok(())
        })?;
        if found { Ok(out) } else { Err(format!("{section} has no {name}")) }
    }

    /// Hands every value of one array to `put`.
    pub fn values(&self, tag: &Tag, mut put: impl FnMut(f64) -> Result<(), String>) -> Result<(), String> {
        let kind = attribute(tag.text, "type").ok_or("no type")?;
        let inline = || {
            let rest = &self.bytes[tag.end..];
            &rest[..rest.iter().position(|&b| b == b'<').unwrap_or(rest.len())]
        };
        let bytes = match attribute(tag.text, "format").unwrap_or("ascii") {
            "ascii" => {
                let text = std::str::from_utf8(inline()).map_err(|_| "not text")?;
                return text.split_whitespace().try_for_each(|w| put(w.parse().map_err(|_| format!("`{w}` is no number"))?));
            }
            "binary" => {
                let text: Vec<u8> = inline().iter().copied().filter(|b| !b.is_ascii_whitespace()).collect();
                Cow::Owned(self.block(&text, false)?.into_owned())
            }
            "appended" => {
                let (data, raw) = self.appended.ok_or("no appended data")?;
                let offset: usize = attribute(tag.text, "offset").and_then(|o| o.parse().ok()).ok_or("no offset")?;
                self.block(data.get(offset..).ok_or("its offset lies beyond the file's end")?, raw)?
            }
            other => return Err(format!("format {other}")),
        };
        fn go<const N: usize>(b: &[u8], read: impl Fn([u8; N]) -> f64, put: &mut impl FnMut(f64) -> Result<(), String>) -> Result<(), String> {
            b.chunks_exact(N).try_for_each(|c| put(read(std::array::from_fn(|i| c[i]))))
        }
        match kind {
            "Float64" => go(&bytes, f64::from_le_bytes, &mut put),
            "Float32" => go(&bytes, |b| f64::from(f32::from_le_bytes(b)), &mut put),
            "Int64" => go(&bytes, |b| i64::from_le_bytes(b) as f64, &mut put),
            "UInt64" => go(&bytes, |b| u64::from_le_bytes(b) as f64, &mut put),
            "Int32" => go(&bytes, |b| f64::from(i32::from_le_bytes(b)), &mut put),
            "UInt32" => go(&bytes, |b| f64::from(u32::from_le_bytes(b)), &mut put),
            "Int16" => go(&bytes, |b| f64::from(i16::from_le_bytes(b)), &mut put),
            "UInt16" => go(&bytes, |b| f64::from(u16::from_le_bytes(b)), &mut put),
            "Int8" => go(&bytes, |b: [u8; 1]| f64::from(b[0] as i8), &mut put),
            "UInt8" => go(&bytes, |b: [u8; 1]| f64::from(b[0]), &mut put),
            other => Err(format!("type {other}")),
        }
    }

    /// One block of data with its header.
    fn block<'b>(&self, data: &'b [u8], raw: bool) -> Result<Cow<'b, [u8]>, String> {
        let word = if self.wide { 8 } else { 4 };
        let cut = "the data is cut off";
        let number = |b: &[u8], i: usize| -> Result<usize, String> {
            let b = b.get(i * word..(i + 1) * word).ok_or(cut)?;
            Ok(b.iter().rev().fold(0u64, |n, &x| n << 8 | u64::from(x)) as usize)
        };
        // Base64 holds the header and the data as separate runs where compressed, together where not.
        let decode = |from: usize, n: usize| -> Result<Cow<'b, [u8]>, String> {
            if raw {
                return Ok(Cow::Borrowed(data.get(from..from.checked_add(n).ok_or(cut)?).ok_or(cut)?));
            }
            let chars = n.div_ceil(3).checked_mul(4).ok_or(cut)?;
            let mut out = base64(data.get(from..from.checked_add(chars).ok_or(cut)?).ok_or(cut)?)?;
            out.truncate(n);
            if out.len() == n { Ok(Cow::Owned(out)) } else { Err(cut.into()) }
        };
        let length = |n: usize| if raw { n } else { n.div_ceil(3) * 4 };
        if self.packing == Packing::None {
            let n = number(&decode(0, word)?, 0)?;
            return Ok(match decode(0, n.checked_add(word).ok_or(cut)?)? {
                Cow::Borrowed(all) => Cow::Borrowed(&all[word..]),
                Cow::Owned(mut all) => Cow::Owned(all.split_off(word)),
            });
        }
        let blocks = number(&decode(0, word)?, 0)?;
        if blocks > data.len() {
            return Err(cut.into());
        }
        let head = decode(0, word * (3 + blocks))?;
        let sizes: Vec<usize> = (0..blocks).map(|i| number(&head, 3 + i)).collect::<Result<_, _>>()?;
        let total = sizes.iter().try_fold(0usize, |a, &b| a.checked_add(b)).ok_or(cut)?;
        let packed = decode(length(head.len()), total)?;
        // All blocks unpack to the same size but the last, which may be smaller.
        let (full, last) = (number(&head, 1)?, number(&head, 2)?);
        let (mut out, mut at) = (vec![], 0);
        for (i, n) in sizes.into_iter().enumerate() {
            let before = out.len();
            let part = packed.get(at..at + n).ok_or(cut)?;
            let limit = if i + 1 == blocks && last > 0 { last } else { full };
            // LZ4 packs at most 255 to 1: more is a lie, and would take the memory.
            if self.packing == Packing::Lz4 && limit / 256 > part.len() {
                return Err("a compressed block is larger than it can be".into());
            }
            match self.packing {
                Packing::Lz4 => out.extend(lz4_flex::block::decompress(part, limit).map_err(|e| format!("lz4: {e}"))?),
                // One byte more than allowed tells a block that lies about its size.
                _ => {
                    let mut source = flate2::read::ZlibDecoder::new(part).take(limit as u64 + 1);
                    source.read_to_end(&mut out).map_err(|e| format!("zlib: {e}"))?;
                }
            }
            if out.len() - before > limit {
                return Err("a compressed block is larger than it says".into());
            }
            at += n;
        }
        Ok(Cow::Owned(out))
    }
}

fn base64(text: &[u8]) -> Result<Vec<u8>, String> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => Some(c - b'A'),
        b'a'..=b'z' => Some(c - b'a' + 26),
        b'0'..=b'9' => Some(c - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    for group in text.chunks(4) {
        let digits = group.iter().take_while(|&&c| c != b'=').count();
        let mut n = 0u32;
        for &c in &group[..digits] {
            n = n << 6 | u32::from(value(c).ok_or("not base64")?);
        }
        n <<= 6 * (4 - digits);
        out.extend_from_slice(&n.to_be_bytes()[1..digits.max(1)]);
    }
    Ok(out)
}
