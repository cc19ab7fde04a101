//! The 3×3×3 neighbourhood as 27 bits, and the simple points of digital topology.
//!
//! Bit (dx+1) + 3(dy+1) + 9(dz+1); the object is 26-connected, the background 6-connected.
//! Source: Bertrand and Malandain 1994.

/// The middle voxel.
const CENTER: u32 = 1 << 13;
const ALL: u32 = (1 << 27) - 1;
const X_LOW: u32 = 0o111_111_111;
const X_HIGH: u32 = X_LOW << 2;
const Y_LOW: u32 = 0b000_000_111_000_000_111_000_000_111;
const Y_HIGH: u32 = Y_LOW << 6;
/// The six that share a face with the middle.
const FACES: u32 = 1 << 4 | 1 << 10 | 1 << 12 | 1 << 14 | 1 << 16 | 1 << 22;
/// The eight that share only a corner with the middle.
const CORNERS: u32 = 1 | 1 << 2 | 1 << 6 | 1 << 8 | 1 << 18 | 1 << 20 | 1 << 24 | 1 << 26;
/// Those that share a face or an edge with the middle.
const EIGHTEEN: u32 = ALL & !CORNERS & !CENTER;

/// Steps of the six face neighbours.
pub(crate) const STEPS_6: [[i64; 3]; 6] = [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]];

/// The neighbourhood of voxel `n` in an array that has a layer of voxels all round `n`; `object` tells what counts.
pub(super) fn gather(data: &[u8], dims: [usize; 3], n: usize, object: impl Fn(u8) -> bool) -> u32 {
    let (row, slab) = (dims[0], dims[0] * dims[1]);
    let mut bits = 0;
    let mut bit = 0;
    for k in [n - slab, n, n + slab] {
        for j in [k - row, k, k + row] {
            for &v in &data[j - 1..=j + 1] {
                bits |= u32::from(object(v)) << bit;
                bit += 1;
            }
        }
    }
    bits
}

fn grow_26(b: u32) -> u32 {
    let x = (b | (b << 1 & !X_LOW) | (b >> 1 & !X_HIGH)) & ALL;
    let y = (x | (x << 3 & !Y_LOW) | (x >> 3 & !Y_HIGH)) & ALL;
    (y | y << 9 | y >> 9) & ALL
}

fn grow_6(b: u32) -> u32 {
    (b | (b << 1 & !X_LOW) | (b >> 1 & !X_HIGH) | (b << 3 & !Y_LOW) | (b >> 3 & !Y_HIGH) | b << 9 | b >> 9) & ALL
}

fn flood(seed: u32, within: u32, grow: impl Fn(u32) -> u32) -> u32 {
    let mut part = seed;
    loop {
        let next = grow(part) & within;
        if next == part {
            return part;
        }
        part = next;
    }
}

/// Whether adding or removing the middle voxel changes no component, tunnel or cavity.
pub(crate) fn is_simple(bits: u32) -> bool {
    let object = bits & !CENTER;
    let background = !bits & EIGHTEEN;
    let open = background & FACES;
    if object == 0 || open == 0 {
        return false;
    }
    let lowest = |b: u32| b & b.wrapping_neg();
    flood(lowest(object), object, grow_26) == object && open & !flood(lowest(open), background, grow_6) == 0
}

/// Number of face neighbours that are object.
pub(super) fn face_neighbors(bits: u32) -> u32 {
    (bits & FACES).count_ones()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mask::topology::topology_of;

    /// Simple points are those whose flip keeps all Betti numbers of the padded 3×3×3 block joined to a frame-free surround.
    #[test]
    fn a_point_is_simple_only_where_its_flip_keeps_the_topology() {
        let mut checked = [0; 2];
        for seed in 0..4000u32 {
            let bits = seed.wrapping_mul(2_654_435_761).rotate_left(seed % 31) & ALL & !CENTER;
            let betti = |b: u32| {
                let mut data = vec![0u8; 125];
                for n in 0..27 {
                    data[(n % 3 + 1) + 5 * (n / 3 % 3 + 1) + 25 * (n / 9 + 1)] = (b >> n & 1) as u8;
                }
                topology_of(&data, [5, 5, 5])
            };
            let simple = is_simple(bits);
            checked[usize::from(simple)] += 1;
            if simple {
                assert_eq!(betti(bits), betti(bits | CENTER), "{bits:027b}");
            } else {
                assert_ne!(betti(bits), betti(bits | CENTER), "{bits:027b}");
            }
        }
        assert!(checked.iter().all(|&n| n > 50), "{checked:?}");
    }
}
