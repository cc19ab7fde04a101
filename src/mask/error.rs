//! What can be wrong with a mask.

/// Why a mask cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// Nothing was selected.
    #[error("the mask is empty: no voxel is selected by {selection}; the image holds {present}: choose a label or threshold that is there")]
    Empty {
        /// The rule, in words.
        selection: String,
        /// What the picture holds, in words.
        present: String,
    },
    /// Everything was selected.
    #[error("the mask has no background: every voxel is selected by {selection}; the image holds {present}: choose a label or threshold that leaves the vessel's surroundings out")]
    Full {
        /// The rule, in words.
        selection: String,
        /// What the picture holds, in words.
        present: String,
    },
    /// Cleaning left nothing.
    #[error("nothing is left of the mask after dropping components below {min_voxels} voxels (the largest has {largest}): lower `input.cleaning.min_island`")]
    NothingLeft {
        /// Smallest component that stays.
        min_voxels: usize,
        /// Size of the largest component.
        largest: usize,
    },
}
