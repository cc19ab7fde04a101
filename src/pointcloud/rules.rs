//! The six cases of the paper's Figure 3.

use super::SlotEnds;

/// The case that a pattern of lumen voxels among the six face neighbours of an outer boundary voxel falls into.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Rule 1: a single lumen neighbour; the point lies on the shared face.
    SharedFace,
    /// Rule 2: two opposite lumen neighbours; a point on each shared face.
    OppositeFaces,
    /// Rule 3: four lumen neighbours in a plane; a point on each shared face.
    Ring,
    /// Rule 4: five lumen neighbours; the point lies on the ground of the cavity, opposite its opening.
    Cavity,
    /// Rule 5: six lumen neighbours; no point.
    Hole,
    /// Rule 6: all other patterns are stairs; the point lies in the centre.
    Stair,
}

/// Where the points of an outer boundary voxel go. Bit 2a is the face towards −axis a, bit 2a + 1 towards +axis a.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sites {
    /// The case.
    pub rule: Rule,
    /// Faces whose centre carries a point with the face's own normal.
    pub by_face: u8,
    /// Faces whose centre carries a point with the gradient as normal.
    pub by_gradient: u8,
    /// Whether the centre of the voxel carries a point with the gradient as normal.
    pub centre: bool,
}

/// Whether both neighbours along some axis are lumen.
pub(super) fn holds_opposite_pair(n6: u8) -> bool {
    n6 & (n6 >> 1) & 0b01_0101 != 0
}

/// The faces that belong to opposite pairs.
fn opposite_pairs(n6: u8) -> u8 {
    let low = n6 & (n6 >> 1) & 0b01_0101;
    low | low << 1
}

/// Places for the six-neighbour pattern `n6` (bit 2a: lumen towards −axis a, bit 2a + 1: towards +axis a).
///
/// `n6` must not be 0: such a voxel is no outer boundary voxel.
pub fn sites(n6: u8, slots: SlotEnds) -> Sites {
    debug_assert!((1..64).contains(&n6));
    let none = Sites { rule: Rule::Stair, by_face: 0, by_gradient: 0, centre: false };
    let pairs = opposite_pairs(n6);
    match n6.count_ones() {
        1 => Sites { rule: Rule::SharedFace, by_gradient: n6, ..none },
        2 if pairs == n6 => Sites { rule: Rule::OppositeFaces, by_face: n6, ..none },
        4 if pairs == n6 => Sites { rule: Rule::Ring, by_face: n6, ..none },
        5 => {
            let open = !n6 & 0b11_1111;
            let ground = if open & 0b01_0101 != 0 { open << 1 } else { open >> 1 };
            Sites { rule: Rule::Cavity, by_gradient: ground, ..none }
        }
        6 => Sites { rule: Rule::Hole, ..none },
        _ if pairs != 0 && slots == SlotEnds::Faces => Sites { by_face: pairs, by_gradient: n6 & !pairs, ..none },
        _ => Sites { centre: true, ..none },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_63_patterns_fall_into_the_six_cases_in_the_right_numbers() {
        let mut counts = [0; 6];
        for n6 in 1..64 {
            counts[sites(n6, SlotEnds::Centre).rule as usize] += 1;
        }
        // 2 neighbours: 12 adjacent; 3: 8 corners + 12 "U"; 4: 12 out of plane.
        assert_eq!(counts, [6, 3, 3, 6, 1, 44]);
    }

    #[test]
    fn one_neighbour_puts_the_point_on_the_shared_face() {
        assert_eq!(sites(0b00_0010, SlotEnds::Centre), Sites { rule: Rule::SharedFace, by_face: 0, by_gradient: 0b10, centre: false });
    }

    #[test]
    fn opposite_neighbours_give_two_face_points() {
        let s = sites(0b00_1100, SlotEnds::Centre);
        assert_eq!((s.rule, s.by_face, s.by_gradient, s.centre), (Rule::OppositeFaces, 0b00_1100, 0, false));
    }

    #[test]
    fn four_in_a_plane_give_four_face_points_and_four_out_of_plane_are_a_stair() {
        assert_eq!(sites(0b11_0011, SlotEnds::Centre).by_face, 0b11_0011);
        let s = sites(0b01_0111, SlotEnds::Centre);
        assert_eq!((s.rule, s.centre), (Rule::Stair, true));
    }

    #[test]
    fn five_neighbours_put_the_point_on_the_ground_opposite_the_opening() {
        // Open towards +z: the ground is the face towards −z.
        let s = sites(0b01_1111, SlotEnds::Centre);
        assert_eq!((s.rule, s.by_gradient), (Rule::Cavity, 0b01_0000));
        assert_eq!(sites(0b11_1110, SlotEnds::Centre).by_gradient, 0b00_0010);
    }

    #[test]
    fn a_hole_gets_no_point() {
        let s = sites(0b11_1111, SlotEnds::Centre);
        assert_eq!((s.rule, s.by_face | s.by_gradient, s.centre), (Rule::Hole, 0, false));
    }

    #[test]
    fn two_adjacent_neighbours_are_a_stair_with_a_point_in_the_centre() {
        let s = sites(0b00_0101, SlotEnds::Centre);
        assert_eq!((s.rule, s.by_face | s.by_gradient, s.centre), (Rule::Stair, 0, true));
    }

    #[test]
    fn the_end_of_a_slot_keeps_its_walls_apart_when_asked() {
        let s = sites(0b00_0111, SlotEnds::Faces);
        assert_eq!((s.by_face, s.by_gradient, s.centre), (0b00_0011, 0b00_0100, false));
    }
}
