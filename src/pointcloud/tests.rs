//! Each rule on the smallest pattern that shows it (the paper's Figures 3, 4, 6, 7, 8), and the world frame.

use nalgebra::{Matrix3, Rotation3};

use super::*;
use crate::mask::Grid;

fn mask(dims: [usize; 3], lumen: impl Fn([i64; 3]) -> bool) -> Mask {
    let grid = Grid::new(dims, [1.0; 3], Point::origin(), Matrix3::identity()).unwrap();
    mask_on(grid, lumen)
}

fn mask_on(grid: Grid, lumen: impl Fn([i64; 3]) -> bool) -> Mask {
    let data = (0..grid.len()).map(|n| u8::from(lumen(grid.voxel(n).map(|c| c as i64)))).collect();
    Mask::new(grid, data)
}

/// The paper's rules without subvoxels, so that one pattern shows one rule.
fn coarse() -> PointCloudOptions {
    PointCloudOptions { thin: ThinStructures::Ignore, relabel_subvoxels: false, ..PointCloudOptions::paper() }
}

/// Points inside the closed voxel `v`, with normals.
fn in_voxel(cloud: &OrientedPoints, v: [f64; 3]) -> Vec<([f64; 3], [f64; 3])> {
    (0..cloud.len())
        .filter(|&n| (0..3).all(|a| (cloud.points[n][a] - v[a]).abs() <= 0.5))
        .map(|n| (cloud.points[n].into(), cloud.normals[n].into()))
        .collect()
}

#[test]
fn figure_3a_a_flat_wall_has_its_points_on_the_faces() {
    let (cloud, summary) = extract(&mask([9, 9, 6], |[_, _, k]| k < 3), &coarse()).unwrap();
    assert_eq!(in_voxel(&cloud, [4.0, 4.0, 3.0]), vec![([4.0, 4.0, 2.5], [0.0, 0.0, 1.0])]);
    assert_eq!(summary.rules.shared_face, summary.points, "a block shows its faces only");
}

#[test]
fn figures_3b_and_4_a_gap_one_voxel_wide_keeps_two_walls_with_opposite_normals() {
    let (cloud, _) = extract(&mask([9, 9, 9], |[i, _, _]| i != 4), &coarse()).unwrap();
    let found = in_voxel(&cloud, [4.0, 4.0, 4.0]);
    assert_eq!(found, vec![([3.5, 4.0, 4.0], [1.0, 0.0, 0.0]), ([4.5, 4.0, 4.0], [-1.0, 0.0, 0.0])]);
}

#[test]
fn figure_3c_a_shaft_one_voxel_wide_keeps_four_walls() {
    let (cloud, summary) = extract(&mask([7, 7, 7], |[i, j, _]| (i, j) != (3, 3)), &coarse()).unwrap();
    let found = in_voxel(&cloud, [3.0, 3.0, 3.0]);
    assert_eq!(found.len(), 4);
    for (p, n) in found {
        let to_axis = Vector::new(3.0 - p[0], 3.0 - p[1], 0.0) * 2.0;
        assert_eq!(Vector::from(n), to_axis, "out of the lumen is towards the shaft's axis");
    }
    assert_eq!(summary.rules.ring, 7);
}

#[test]
fn figure_3d_a_pit_has_its_point_on_the_ground() {
    let (cloud, summary) = extract(&mask([7, 7, 7], |[i, j, k]| k < 4 && (i, j, k) != (3, 3, 3)), &coarse()).unwrap();
    assert_eq!(in_voxel(&cloud, [3.0, 3.0, 3.0]).iter().find(|(p, _)| p[2] == 2.5), Some(&([3.0, 3.0, 2.5], [0.0, 0.0, 1.0])));
    assert_eq!(summary.rules.cavity, 1);
}

#[test]
fn figure_3e_a_hole_is_ignored() {
    let (cloud, summary) = extract(&mask([5, 5, 5], |v| v != [2, 2, 2]), &coarse()).unwrap();
    assert!(in_voxel(&cloud, [2.0, 2.0, 2.0]).is_empty());
    assert_eq!(summary.rules.hole, 1);
}

#[test]
fn figure_3f_a_stair_has_its_point_in_the_centre_with_a_diagonal_normal() {
    let (cloud, _) = extract(&mask([9, 9, 9], |[i, _, k]| i + k < 8), &coarse()).unwrap();
    let found = in_voxel(&cloud, [4.0, 4.0, 4.0]);
    let s = 0.5f64.sqrt();
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].0, [4.0, 4.0, 4.0]);
    approx::assert_relative_eq!(Vector::from(found[0].1), Vector::new(s, 0.0, s), epsilon = 1e-15);
}

#[test]
fn top_hat_finds_rods_two_wide_and_spares_rods_three_wide() {
    let rod = |w: i64| mask([9, 9, 24], move |[i, j, k]| (3..3 + w).contains(&i) && (3..3 + w).contains(&j) && (2..22).contains(&k));
    let (two, s2) = extract(&rod(2), &PointCloudOptions::paper()).unwrap();
    let (_, s3) = extract(&rod(3), &PointCloudOptions::paper()).unwrap();
    assert_eq!((s2.thin_voxels, s3.thin_voxels), (80, 0));
    assert_eq!(s3.fine_points, 0);
    // A face of a subvoxel is a quarter of a voxel's: four times the points on the sides.
    let side = in_voxel(&two, [2.0, 3.0, 12.0]);
    assert_eq!(side.len(), 4);
    assert!(side.iter().all(|(p, _)| p[0] == 2.5), "{side:?}");
    assert_eq!(s2.fine_points, s2.points);
    assert!(two.pitch.iter().all(|&p| p == 0.5));
}

#[test]
fn vessels_that_leave_the_picture_are_not_thin_at_its_border() {
    let cut = mask([9, 9, 9], |[i, j, _]| (2..6).contains(&i) && (2..6).contains(&j));
    assert_eq!(extract(&cut, &PointCloudOptions::paper()).unwrap().1.thin_voxels, 0);
}

#[test]
fn figure_6_concave_steps_of_a_thin_rod_gain_subvoxels_and_flat_sides_none() {
    let straight = mask([9, 9, 20], |[i, j, k]| (i, j) == (4, 4) && (2..18).contains(&k));
    assert_eq!(extract(&straight, &PointCloudOptions::paper()).unwrap().1.relabelled_subvoxels, 0);
    // The rod steps sideways: voxels (4,4,k<10) and (5,4,k>=9) make two concave corners.
    let step = mask([10, 9, 20], |[i, j, k]| j == 4 && ((i == 4 && (2..10).contains(&k)) || (i == 5 && (9..18).contains(&k))));
    let (cloud, summary) = extract(&step, &PointCloudOptions::paper()).unwrap();
    // In each corner the two subvoxels in its crease are face neighbours of one part and edge neighbours of the other.
    assert!(summary.relabelled_subvoxels >= 4, "{summary:?}");
    let (literal, _) = extract(&step, &PointCloudOptions { relabel_subvoxels: false, ..PointCloudOptions::paper() }).unwrap();
    // The step's crease at x = 3.5..4.5 above (4, 4, 9): no point is left in the crease itself.
    let crease = |c: &OrientedPoints| in_voxel(c, [4.0, 4.0, 10.0]).iter().filter(|(p, _)| p[0] > 4.2 && p[2] < 9.8 && (p[1] - 4.0).abs() < 0.4).count();
    assert!(crease(&literal) > 0 && crease(&cloud) == 0, "{} {}", crease(&literal), crease(&cloud));
}

#[test]
fn figure_7_small_cavities_are_not_filled_by_relabelling() {
    // A slot one voxel wide between two thin plates: a pair of opposite neighbours.
    let slot = mask([9, 9, 9], |[i, _, _]| i == 3 || i == 5);
    let (cloud, summary) = extract(&slot, &PointCloudOptions::paper()).unwrap();
    assert_eq!(summary.relabelled_subvoxels, 0);
    assert!(in_voxel(&cloud, [4.0, 4.0, 4.0]).len() >= 8, "both walls keep four fine points");
}

#[test]
fn a_thin_branch_on_a_thick_trunk_mixes_both_pitches() {
    let tree = mask([16, 9, 20], |[i, j, k]| {
        ((2..7).contains(&i) && (2..7).contains(&j) && (2..18).contains(&k)) || (j == 4 && k == 10 && (7..14).contains(&i))
    });
    let (cloud, summary) = extract(&tree, &PointCloudOptions::paper()).unwrap();
    assert_eq!(summary.thin_voxels, 7);
    assert!(summary.fine_points > 0 && summary.fine_points < summary.points);
    assert!(cloud.points.iter().zip(&cloud.pitch).all(|(p, &h)| h == 1.0 || p.x > 6.0), "fine points stand round the branch only");
}

#[test]
fn oblique_left_handed_and_anisotropic_grids_give_points_and_normals_of_the_world() {
    let rotation = *Rotation3::from_euler_angles(0.4, -0.7, 1.1).matrix();
    let direction = rotation * Matrix3::from_diagonal(&Vector::new(1.0, 1.0, -1.0));
    let spacing = [0.4, 0.5, 1.3];
    let grid = Grid::new([24, 22, 16], spacing, Point::new(-30.0, 12.0, 5.0), direction).unwrap();
    assert!(grid.is_left_handed());
    let (center, r) = (grid.to_world(Vector::new(11.6, 10.2, 7.3)), 3.5);
    let lumen = mask_on(grid.clone(), |v| (grid.to_world(Vector::from(v.map(|c| c as f64))) - center).norm() < r);
    // The gradient of labels knows 26 directions only, so the paper's normals are coarse on such voxels.
    for (options, straightness) in [(PointCloudOptions::paper(), 0.7), (PointCloudOptions::cfd(), 0.97)] {
        let (cloud, _) = extract(&lumen, &options).unwrap();
        assert!(cloud.len() > 300);
        let half_voxel_diagonal = 0.5 * grid.voxel_diagonal();
        let straight = cloud.points.iter().zip(&cloud.normals).map(|(p, n)| n.dot(&(p - center).normalize())).sum::<f64>() / cloud.len() as f64;
        assert!(straight > straightness, "normals point out of the lumen: mean cosine {straight}");
        for (p, n) in cloud.points.iter().zip(&cloud.normals) {
            let off = (p - center).norm() - r;
            assert!(off.abs() < 1.3 * half_voxel_diagonal, "{off}");
            approx::assert_relative_eq!(n.norm(), 1.0, epsilon = 1e-12);
        }
    }
}

#[test]
fn sub_voxel_placement_takes_the_bias_out_of_spheres_and_normals_close_to_true() {
    let center = Point::new(10.3, 9.8, 10.1);
    let r = 5.0;
    let ball = mask([21, 21, 21], |v| (Point::from(v.map(|c| c as f64)) - center).norm() < r);
    let figures = |options| {
        let (cloud, _) = extract(&ball, &options).unwrap();
        let count = cloud.len() as f64;
        let bias = cloud.points.iter().map(|p| (p - center).norm() - r).sum::<f64>() / count;
        let angle = cloud.points.iter().zip(&cloud.normals).map(|(p, n)| n.angle(&(p - center)).to_degrees()).sum::<f64>() / count;
        (bias, angle)
    };
    let (bias, angle) = figures(PointCloudOptions::paper());
    assert!(bias > 0.1, "the paper's points lie outside: {bias}");
    assert!(angle > 10.0, "and its normals know few directions: {angle}");
    let (bias, angle) = figures(PointCloudOptions::cfd());
    assert!(bias.abs() < 0.03, "{bias}");
    assert!(angle < 5.0, "{angle}");
}

#[test]
fn the_cloud_does_not_depend_on_the_number_of_threads() {
    let ball = mask([15, 15, 15], |[i, j, k]| (i - 7).pow(2) + (j - 7).pow(2) + (k - 7).pow(2) < 25);
    let run = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| extract(&ball, &PointCloudOptions::cfd()).unwrap().0)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn an_empty_mask_says_what_to_do() {
    let error = extract(&mask([3, 3, 3], |_| false), &PointCloudOptions::default()).unwrap_err();
    assert!(error.to_string().contains("input.label"));
}
