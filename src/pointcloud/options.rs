//! Options of the point cloud.

use serde::Serialize;

use super::Error;

/// Where a point goes once its rule has chosen a place in the voxel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum PointPlacement {
    /// It stays there: the paper. Lies outside a digitised wall by about 0.22 voxel on average.
    Rule,
    /// Along its normal to the wall of the Gaussian-smoothed mask, the shrinkage of the smoothing undone by the wall's
    /// curvature; by `fallback` voxels inwards where there is no wall within `reach`.
    SubVoxel {
        /// Largest shift, voxels.
        reach: f64,
        /// Inward shift where no wall is found, voxels.
        fallback: f64,
    },
}

/// Where normals come from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Normals {
    /// Central differences of the labels over the six face neighbours: the paper's "gradient in the segmentation
    /// result". Only 26 directions are possible; errs by 23° to 30° on average.
    CentralDifferences,
    /// Gradient of the Gaussian-smoothed mask; errs by 3.5° to 5° on average.
    Gaussian {
        /// Standard deviation, voxels.
        sigma: f64,
    },
}

/// Which parts of the lumen are sampled on subvoxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ThinStructures {
    /// None.
    Ignore,
    /// Every voxel that no full block of 3×3×3 lumen voxels covers (top-hat transformation): the paper. Fires on the
    /// stair corners of thick vessels too.
    TopHat,
    /// The same, restricted to voxels farther than two voxels from the middle of every full block: truly thin parts.
    LocalThickness,
}

/// Whether narrow concave places are sampled on subvoxels (the paper's future work).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Concavities {
    /// No.
    Ignore,
    /// Background voxels that no full block of 3×3×3 background voxels covers (top-hat of the inverse).
    TopHatOfInverse,
    /// The same, restricted to voxels farther than two voxels from the middle of every full block: truly narrow places,
    /// not the stairs of a digitised wall.
    LocalWidth,
}

/// What to do with patterns that hold an opposite pair and more: the ends of slots one voxel wide.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SlotEnds {
    /// One point in the centre like every other stair: the paper's "all other cases".
    Centre,
    /// A point on every shared face.
    Faces,
}

/// How the point cloud is made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PointCloudOptions {
    /// Final place of the points.
    pub placement: PointPlacement,
    /// Source of normals.
    pub normals: Normals,
    /// Where subvoxels are used.
    pub thin: ThinStructures,
    /// Whether background subvoxels in concave steps next to thin structures are relabelled as lumen first.
    pub relabel_subvoxels: bool,
    /// Whether concave places use subvoxels.
    pub concavities: Concavities,
    /// Patterns that the paper leaves open.
    pub slot_ends: SlotEnds,
}

impl Default for PointCloudOptions {
    fn default() -> Self {
        PointCloudOptions::cfd()
    }
}

impl PointCloudOptions {
    /// The paper, rule by rule.
    pub fn paper() -> PointCloudOptions {
        PointCloudOptions {
            placement: PointPlacement::Rule,
            normals: Normals::CentralDifferences,
            thin: ThinStructures::TopHat,
            relabel_subvoxels: true,
            concavities: Concavities::Ignore,
            slot_ends: SlotEnds::Centre,
        }
    }

    /// Better on every measure: points on the sub-voxel wall, true normals, subvoxels only where they pay.
    pub fn cfd() -> PointCloudOptions {
        PointCloudOptions {
            placement: PointPlacement::SubVoxel { reach: 0.8, fallback: 0.22 },
            normals: Normals::Gaussian { sigma: 1.4 },
            thin: ThinStructures::LocalThickness,
            relabel_subvoxels: true,
            concavities: Concavities::LocalWidth,
            slot_ends: SlotEnds::Faces,
        }
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        let check = |name, value: f64, low: f64, high: f64, must| {
            if value >= low && value <= high { Ok(()) } else { Err(Error::Option { name, value, must }) }
        };
        if let PointPlacement::SubVoxel { reach, fallback } = self.placement {
            check("the reach of sub-voxel placement (voxels)", reach, 0.1, 2.0, "between 0.1 and 2 voxels")?;
            check("the fallback shift of sub-voxel placement (voxels)", fallback, 0.0, 0.5, "between 0 and 0.5 voxels")?;
        }
        if let Normals::Gaussian { sigma } = self.normals {
            check("the width of the Gaussian for normals (voxels)", sigma, 0.5, 3.0, "between 0.5 and 3 voxels")?;
        }
        Ok(())
    }
}
