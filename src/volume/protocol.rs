//! What goes over the pipes between the volume stage and its TetGen worker: little-endian, length first.

use std::io::{self, Read, Write};

use tetgen_sys::{Input, Output, Stage};

const MAGIC: &[u8; 8] = b"LMTETW01";
/// Longest array taken from the other side: a damaged length must not eat the memory.
const MAX_ITEMS: u64 = 1 << 31;

/// What the worker is asked to do.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Request {
    /// Address space of the worker, bytes; 0 leaves it alone.
    pub memory: u64,
    /// TetGen's switches.
    pub switches: String,
    /// The facets and points.
    pub input: Input,
}

/// One message of the worker.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Answer {
    /// TetGen begins a stage.
    Stage(Stage),
    /// TetGen gave up with this code.
    Failed(i32),
    /// The mesh.
    Mesh(Output),
}

fn put_u64(w: &mut impl Write, x: u64) -> io::Result<()> {
    w.write_all(&x.to_le_bytes())
}

fn get_u64(r: &mut impl Read) -> io::Result<u64> {
    let mut b = [0; 8];
    r.read_exact(&mut b)?;
    Ok(u64::from_le_bytes(b))
}

fn bad(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what.to_string())
}

/// Writes `items` as `N`-byte pieces, a chunk at a time.
fn put<T, const N: usize>(w: &mut impl Write, items: &[T], bytes: impl Fn(&T) -> [u8; N]) -> io::Result<()> {
    put_u64(w, items.len() as u64)?;
    let mut buffer = Vec::with_capacity(N * 4096);
    for chunk in items.chunks(4096) {
        buffer.clear();
        for i in chunk {
            buffer.extend_from_slice(&bytes(i));
        }
        w.write_all(&buffer)?;
    }
    Ok(())
}

fn get<T, const N: usize>(r: &mut impl Read, value: impl Fn(&[u8; N]) -> T) -> io::Result<Vec<T>> {
    let n = get_u64(r)?;
    if n > MAX_ITEMS {
        return Err(bad("array too long"));
    }
    let mut left = n as usize;
    let mut items = Vec::new();
    let mut buffer = vec![0u8; N * 4096];
    while left > 0 {
        let k = left.min(4096);
        r.read_exact(&mut buffer[..k * N])?;
        items.extend(buffer[..k * N].as_chunks::<N>().0.iter().map(&value));
        left -= k;
    }
    Ok(items)
}

fn f64x3(p: &[f64; 3]) -> [u8; 24] {
    let mut b = [0; 24];
    for (i, x) in p.iter().enumerate() {
        b[8 * i..8 * i + 8].copy_from_slice(&x.to_le_bytes());
    }
    b
}

fn to_f64(b: &[u8]) -> f64 {
    let mut a = [0; 8];
    a.copy_from_slice(&b[..8]);
    f64::from_le_bytes(a)
}

fn to_f64x3(b: &[u8; 24]) -> [f64; 3] {
    [to_f64(&b[0..]), to_f64(&b[8..]), to_f64(&b[16..])]
}

fn u32s<const K: usize, const N: usize>(v: &[u32; K]) -> [u8; N] {
    let mut b = [0; N];
    for (i, x) in v.iter().enumerate() {
        b[4 * i..4 * i + 4].copy_from_slice(&x.to_le_bytes());
    }
    b
}

fn to_u32s<const K: usize, const N: usize>(b: &[u8; N]) -> [u32; K] {
    std::array::from_fn(|i| u32::from_le_bytes([b[4 * i], b[4 * i + 1], b[4 * i + 2], b[4 * i + 3]]))
}

impl Request {
    pub(super) fn write(&self, w: &mut impl Write) -> io::Result<()> {
        w.write_all(MAGIC)?;
        put_u64(w, self.memory)?;
        put(w, self.switches.as_bytes(), |b| [*b])?;
        put(w, &self.input.points, f64x3)?;
        put(w, &self.input.sizes, |x| x.to_le_bytes())?;
        put(w, &self.input.triangles, u32s::<3, 12>)?;
        put(w, &self.input.markers, |m| m.to_le_bytes())?;
        w.flush()
    }

    /// Reads a request; `limit` hears of the memory limit before the arrays are read.
    pub(super) fn read(r: &mut impl Read, limit: impl FnOnce(u64)) -> io::Result<Request> {
        let mut magic = [0; 8];
        r.read_exact(&mut magic)?;
        if &magic != MAGIC {
            return Err(bad("not a request of this version of lumenmesh"));
        }
        let memory = get_u64(r)?;
        limit(memory);
        let switches = String::from_utf8(get(r, |b: &[u8; 1]| b[0])?).map_err(|_| bad("switches are not text"))?;
        let points = get(r, to_f64x3)?;
        let sizes = get(r, |b: &[u8; 8]| f64::from_le_bytes(*b))?;
        let triangles = get(r, to_u32s::<3, 12>)?;
        let markers = get(r, |b: &[u8; 4]| i32::from_le_bytes(*b))?;
        Ok(Request { memory, switches, input: Input { points, sizes, triangles, markers } })
    }
}

impl Answer {
    pub(super) fn write(&self, w: &mut impl Write) -> io::Result<()> {
        match self {
            Answer::Stage(s) => w.write_all(&[b'S', s.number()])?,
            Answer::Failed(code) => {
                w.write_all(b"E")?;
                w.write_all(&code.to_le_bytes())?;
            }
            Answer::Mesh(m) => {
                w.write_all(b"M")?;
                put(w, &m.points, f64x3)?;
                put(w, &m.tets, u32s::<4, 16>)?;
                put(w, &m.faces, u32s::<3, 12>)?;
                put(w, &m.markers, |m| m.to_le_bytes())?;
            }
        }
        w.flush()
    }

    /// The next message; `None` where the worker has closed its end.
    pub(super) fn read(r: &mut impl Read) -> io::Result<Option<Answer>> {
        let mut tag = [0; 1];
        if r.read(&mut tag)? == 0 {
            return Ok(None);
        }
        Ok(Some(match tag[0] {
            b'S' => {
                r.read_exact(&mut tag)?;
                Answer::Stage(Stage::from_number(tag[0]).ok_or_else(|| bad("unknown stage"))?)
            }
            b'E' => {
                let mut b = [0; 4];
                r.read_exact(&mut b)?;
                Answer::Failed(i32::from_le_bytes(b))
            }
            b'M' => Answer::Mesh(Output {
                points: get(r, to_f64x3)?,
                tets: get(r, to_u32s::<4, 16>)?,
                faces: get(r, to_u32s::<3, 12>)?,
                markers: get(r, |b: &[u8; 4]| i32::from_le_bytes(*b))?,
            }),
            _ => return Err(bad("unknown message")),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> Request {
        Request {
            memory: 7,
            switches: "pYQ".into(),
            input: Input {
                points: (0..5000).map(|i| [f64::from(i), -0.5, 1e-300]).collect(),
                sizes: vec![0.25; 5000],
                triangles: vec![[1, 2, 4999]; 4097],
                markers: vec![-3; 4097],
            },
        }
    }

    #[test]
    fn a_request_arrives_as_it_was_sent() {
        let mut bytes = vec![];
        request().write(&mut bytes).unwrap();
        let mut told = None;
        assert_eq!(Request::read(&mut &bytes[..], |m| told = Some(m)).unwrap(), request());
        assert_eq!(told, Some(7));
    }

    #[test]
    fn damaged_messages_are_refused() {
        let mut bytes = vec![];
        request().write(&mut bytes).unwrap();
        assert!(Request::read(&mut &bytes[..bytes.len() - 1], |_| ()).is_err());
        bytes[16..24].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(Request::read(&mut &bytes[..], |_| ()).is_err());
        assert!(Answer::read(&mut &b"X"[..]).is_err());
        assert!(Answer::read(&mut &b""[..]).unwrap().is_none());
    }
}
