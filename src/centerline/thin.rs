//! Homotopic thinning in the order of the distance to the wall, with the tips held.
//!
//! What remains has the mask's topology (26-connected lumen, 6-connected background): one point thick, with
//! every loop, and with no free end but at the tips. Simple points after Bertrand and Malandain 1994.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::field::{Field, NONE};

/// The 26 neighbours.
pub(super) const STEPS: [[i64; 3]; 26] = steps();

const fn steps() -> [[i64; 3]; 26] {
    let mut s = [[0; 3]; 26];
    let mut n = 0;
    let mut c = 0;
    while c < 27 {
        if c != 13 {
            s[n] = [c % 3 - 1, c / 3 % 3 - 1, c / 9 - 1];
            n += 1;
        }
        c += 1;
    }
    s
}

/// For each neighbour, which of the other neighbours touch it: by 26 and by 6 neighbours.
const fn touching(six: bool) -> [u32; 26] {
    let mut t = [0; 26];
    let mut a = 0;
    while a < 26 {
        let mut b = 0;
        while b < 26 {
            let (mut far, mut sum, mut c) = (0, 0, 0);
            while c < 3 {
                let d = (STEPS[a][c] - STEPS[b][c]).abs();
                far = if d > far { d } else { far };
                sum += d;
                c += 1;
            }
            if a != b && (if six { sum == 1 } else { far == 1 }) {
                t[a] |= 1 << b;
            }
            b += 1;
        }
        a += 1;
    }
    t
}

/// Neighbours at most `limit` steps of six away.
const fn within(limit: i64) -> u32 {
    let mut m = 0;
    let mut a = 0;
    while a < 26 {
        if STEPS[a][0].abs() + STEPS[a][1].abs() + STEPS[a][2].abs() <= limit {
            m |= 1 << a;
        }
        a += 1;
    }
    m
}

const TOUCH_26: [u32; 26] = touching(false);
const TOUCH_6: [u32; 26] = touching(true);
const N6: u32 = within(1);
const N18: u32 = within(2);

fn flood(seed: u32, set: u32, touch: &[u32; 26]) -> u32 {
    let mut reached = seed;
    let mut front = seed;
    while front != 0 {
        let mut next = 0;
        while front != 0 {
            next |= touch[front.trailing_zeros() as usize];
            front &= front - 1;
        }
        front = next & set & !reached;
        reached |= front;
    }
    reached
}

/// Whether the centre can go without a change of topology. `lumen` has a bit for each neighbour in the lumen.
pub(super) fn is_simple(lumen: u32) -> bool {
    if lumen == 0 || flood(lumen & lumen.wrapping_neg(), lumen, &TOUCH_26) != lumen {
        return false;
    }
    let open = !lumen & N18;
    let faces = open & N6;
    faces != 0 && flood(faces & faces.wrapping_neg(), open, &TOUCH_6) & N6 == faces
}

/// Thins the lumen; returns which lumen voxels remain. `held` are never removed.
pub(super) fn thin(field: &Field, held: &[u32]) -> Vec<bool> {
    let n = field.voxel.len();
    let mut kept = vec![true; n];
    let mut fixed = vec![false; n];
    held.iter().for_each(|&v| fixed[v as usize] = true);
    let mut queued = vec![false; n];
    let key = |v: u32| Reverse((field.distance[v as usize].to_bits(), v));
    let mut queue = BinaryHeap::new();
    for v in 0..n as u32 {
        let at = i64::from(field.voxel[v as usize]);
        let inner = (0..26).all(|s| N6 >> s & 1 == 0 || field.id[(at + field.offsets[s]) as usize] != NONE);
        if !inner && !fixed[v as usize] {
            queued[v as usize] = true;
            queue.push(key(v));
        }
    }
    while let Some(Reverse((_, v))) = queue.pop() {
        queued[v as usize] = false;
        let at = i64::from(field.voxel[v as usize]);
        let mut lumen = 0u32;
        for s in 0..26 {
            let w = field.id[(at + field.offsets[s]) as usize];
            lumen |= u32::from(w != NONE && kept[w as usize]) << s;
        }
        if !is_simple(lumen) {
            continue;
        }
        kept[v as usize] = false;
        for s in (0..26).filter(|s| lumen >> s & 1 != 0) {
            let w = field.id[(at + field.offsets[s]) as usize];
            if !queued[w as usize] && !fixed[w as usize] {
                queued[w as usize] = true;
                queue.push(key(w));
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(set: &[[i64; 3]]) -> u32 {
        set.iter().map(|d| 1 << STEPS.iter().position(|s| s == d).unwrap()).sum()
    }

    #[test]
    fn points_that_join_or_plug_are_not_simple() {
        assert!(!is_simple(0), "an isolated point");
        assert!(is_simple(bits(&[[1, 0, 0]])), "an end");
        assert!(!is_simple(bits(&[[1, 0, 0], [-1, 0, 0]])), "a bridge");
        assert!(is_simple(bits(&[[1, 0, 0], [1, 1, 0], [0, 1, 0]])), "a corner");
        let plate: Vec<[i64; 3]> = STEPS.iter().copied().filter(|s| s[2] == 0).collect();
        assert!(!is_simple(bits(&plate)), "taking it makes a hole in a plate");
        assert!(!is_simple((1 << 26) - 1), "taking it makes a cavity");
    }
}
