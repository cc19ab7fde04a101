use nalgebra::Rotation3;

use super::*;
use crate::geometry::{Point, Vector};
use crate::mask::{Grid, topology};

fn mask(dims: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> Mask {
    let direction = Rotation3::from_euler_angles(0.2, 0.4, -0.9).into_inner();
    let grid = Grid::new(dims, [0.5, 0.5, 1.25], Point::new(10.0, -20.0, 30.0), direction).expect("grid");
    let data = (0..grid.len()).map(|n| u8::from(rule(grid.voxel(n)))).collect();
    Mask::new(grid, data)
}

fn cleaned(mask: &Mask) -> (Mask, CleaningReport) {
    clean(mask, &CleaningOptions::default()).expect("cleans")
}

fn count_of(report: &CleaningReport, kind: ChangeKind) -> [usize; 2] {
    report.totals.iter().find(|t| t.kind == kind).map_or([0, 0], |t| [t.changes, t.voxels])
}

fn within(v: [usize; 3], low: [usize; 3], high: [usize; 3]) -> bool {
    (0..3).all(|a| (low[a]..=high[a]).contains(&v[a]))
}

#[test]
fn a_sound_mask_stays_as_it_is() {
    let ball = mask([20, 20, 12], |v| v.iter().zip([9.5, 9.5, 5.5]).zip([7.0, 7.0, 4.0]).map(|((&i, c), r)| ((i as f64 - c) / r).powi(2)).sum::<f64>() <= 1.0);
    let (out, report) = cleaned(&ball);
    assert_eq!(out, ball);
    assert!(report.changes.is_empty() && report.before == report.after);
}

#[test]
fn islands_go_and_are_listed_with_their_place() {
    let parts = mask([24, 12, 12], |v| within(v, [2, 2, 2], [9, 9, 9]) || within(v, [14, 3, 3], [18, 7, 7]) || v == [22, 10, 4]);
    let (out, report) = cleaned(&parts);
    assert_eq!(out.count(), 512);
    assert_eq!(count_of(&report, ChangeKind::IslandDropped), [2, 126]);
    let all = CleaningOptions { components: Components::All, ..CleaningOptions::default() };
    let (out, report) = clean(&parts, &all).expect("cleans");
    assert_eq!(out.count(), 512 + 125);
    assert_eq!(report.after.components, 2);
    let place = parts.grid.to_world(Vector::new(22.0, 10.0, 4.0));
    assert_eq!(report.changes[0].voxels, 1);
    approx::assert_relative_eq!(Point::from(report.changes[0].center), place, epsilon = 1e-9);
}

#[test]
fn cavities_are_filled_whatever_their_size() {
    let hollow = mask([16, 16, 16], |v| within(v, [2, 2, 2], [13, 13, 13]) && !within(v, [5, 5, 5], [10, 10, 10]) && v != [3, 3, 3]);
    let (out, report) = cleaned(&hollow);
    assert_eq!(out.count(), 12 * 12 * 12);
    assert_eq!(count_of(&report, ChangeKind::CavityFilled), [2, 217]);
    assert_eq!([report.before.cavities, report.after.cavities], [2, 0]);
}

#[test]
fn a_narrow_tunnel_is_closed_and_a_wide_one_stays() {
    let plate = |hole: usize| mask([16, 16, 9], move |v| within(v, [2, 2, 3], [13, 13, 5]) && !within(v, [6, 6, 0], [5 + hole, 5 + hole, 8]));
    for hole in [1, 2] {
        let (out, report) = cleaned(&plate(hole));
        assert_eq!([report.before.tunnels, report.after.tunnels], [1, 0], "hole of {hole}");
        assert_eq!(count_of(&report, ChangeKind::TunnelClosed)[0], 1);
        assert!(out.count() - plate(hole).count() <= 3 * hole * hole);
    }
    let (out, report) = cleaned(&plate(3));
    assert_eq!(report.after.tunnels, 1);
    assert_eq!(out, plate(3));
    // Neither is a narrow slit that is too long for noise.
    let slit = mask([60, 9, 7], |v| within(v, [2, 2, 2], [57, 6, 4]) && !(v[1] == 4 && (5..50).contains(&v[0])));
    assert_eq!(cleaned(&slit).0, slit);
}

#[test]
fn vessels_side_by_side_stay_apart() {
    // A hairpin whose legs run one background voxel apart.
    let hairpin = mask([40, 13, 9], |v| within(v, [2, 2, 2], [37, 10, 6]) && !(v[1] == 6 && v[0] < 33));
    let (out, report) = cleaned(&hairpin);
    assert_eq!(out, hairpin);
    assert!(report.changes.is_empty());
    // A pit with a narrow mouth is no tunnel: shutting it would make a cavity.
    let pit = mask([14, 14, 14], |v| within(v, [2, 2, 2], [11, 11, 11]) && !within(v, [5, 5, 5], [8, 8, 8]) && !(v[0] == 6 && v[1] == 6 && v[2] < 6));
    assert_eq!(cleaned(&pit).0, pit);
}

#[test]
fn a_hole_in_the_section_at_the_image_border_is_filled() {
    let tube = mask([14, 14, 10], |v| within(v, [2, 2, 0], [11, 11, 7]) && !(within(v, [5, 5, 0], [6, 6, 3])));
    let (out, report) = cleaned(&tube);
    assert_eq!(out.count(), 10 * 10 * 8);
    assert_eq!(count_of(&report, ChangeKind::BorderHoleFilled), [1, 4]);
    assert_eq!(count_of(&report, ChangeKind::CavityFilled), [1, 12]);
}

#[test]
fn diagonal_steps_become_well_composed_and_stay_connected() {
    let stairs = mask([14, 14, 14], |v| v[0] == v[1] && v[1] == v[2] && (2..12).contains(&v[0]));
    let all = CleaningOptions { min_island: 1, ..CleaningOptions::default() };
    let (out, report) = clean(&stairs, &all).expect("cleans");
    assert_eq!(report.contacts, [9, 0]);
    assert_eq!(report.after, Topology { components: 1, euler: 1, tunnels: 0, cavities: 0 });
    assert_eq!(label(&out, true, Connectivity::Six).components().len(), 1);
}

#[test]
fn any_noise_becomes_well_composed_and_the_numbers_agree() {
    for (seed, density) in [(1u32, 20), (2, 45), (3, 70), (4, 90)] {
        let noise = mask([17, 15, 13], |[i, j, k]| {
            let mut h = (i + 17 * (j + 15 * k)) as u32 ^ seed.wrapping_mul(0x9e37_79b9);
            for _ in 0..3 {
                h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d) ^ (h >> 12);
            }
            h % 100 < density
        });
        let all = CleaningOptions { components: Components::All, min_island: 5, ..CleaningOptions::default() };
        let (out, report) = clean(&noise, &all).expect("cleans");
        assert_eq!(report.contacts[1], 0, "density {density}");
        assert_eq!(report.after, topology(&out), "density {density}");
        assert_eq!(label(&out, true, Connectivity::Six).components().len(), report.after.components);
        assert_eq!(report.after.cavities, 0);
        assert_eq!(report.voxels, [noise.count(), out.count()]);
        let flipped: usize = report.totals.iter().map(|t| t.voxels).sum();
        let differ = noise.data.iter().zip(&out.data).filter(|(a, b)| a != b).count();
        assert!(flipped >= differ && differ > 0);
        assert_eq!(clean(&noise, &all).expect("cleans"), (out, report));
    }
}

#[test]
fn dropping_everything_is_an_error() {
    let speck = mask([5, 5, 5], |v| v == [2, 2, 2]);
    let all = CleaningOptions { components: Components::All, ..CleaningOptions::default() };
    assert_eq!(clean(&speck, &all).unwrap_err(), Error::NothingLeft { min_voxels: 27, largest: 1 });
}
