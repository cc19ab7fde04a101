//! Fast, deterministic text: lines are formatted in parallel blocks and written in order.

use std::fmt::Write as _;
use std::io::{self, Write};

use rayon::prelude::*;

use crate::geometry::Point;

/// Lines formatted as one block.
const BLOCK: usize = 1 << 13;

/// Writes `n` items, each formatted by `put` at the end of a string.
pub(super) fn items(w: &mut dyn Write, n: usize, put: impl Fn(usize, &mut String) + Sync) -> io::Result<()> {
    let blocks = n.div_ceil(BLOCK);
    // A bounded number of blocks at a time keeps memory flat.
    for from in (0..blocks).step_by(64) {
        let text: Vec<String> = (from..blocks.min(from + 64))
            .into_par_iter()
            .map(|b| {
                let mut s = String::with_capacity(BLOCK * 48);
                for i in b * BLOCK..n.min((b + 1) * BLOCK) {
                    put(i, &mut s);
                }
                s
            })
            .collect();
        for t in text {
            w.write_all(t.as_bytes())?;
        }
    }
    Ok(())
}

/// Appends the shortest decimal that reads back to the same number.
pub(super) fn number(s: &mut String, x: f64) {
    let a = x.abs();
    // Writing to a String cannot fail.
    let _ = if a == 0.0 || (1e-3..1e9).contains(&a) { write!(s, "{x}") } else { write!(s, "{x:e}") };
}

/// Appends `x y z`, each divided by `per`: 1000 for metres from millimetres.
pub(super) fn point(s: &mut String, p: &Point, per: f64) {
    for i in 0..3 {
        if i > 0 {
            s.push(' ');
        }
        number(s, p[i] / per);
    }
}

/// Appends a decimal integer.
pub(super) fn integer(s: &mut String, i: impl Into<u64>) {
    let mut buffer = [0u8; 20];
    let (mut at, mut i) = (20, i.into());
    loop {
        at -= 1;
        buffer[at] = b'0' + (i % 10) as u8;
        i /= 10;
        if i == 0 {
            break;
        }
    }
    s.extend(buffer[at..].iter().map(|&b| b as char));
}

/// Appends a hexadecimal integer.
pub(super) fn hex(s: &mut String, i: u64) {
    let _ = write!(s, "{i:x}");
}
