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
    /// What was selected is the background.
    #[error("the mask is inverted: {percent:.0} % of the voxels and nearly all of the image's border are selected by {selection}; the image holds {present}: choose the label inside the vessel, such as `input.label=0`")]
    Inverted {
        /// Selected part of all voxels, %.
        percent: f64,
        /// The rule, in words.
        selection: String,
        /// What the picture holds, in words.
        present: String,
    },
    /// The picture has several labels and none was chosen.
    #[error("the image holds labels, and which is the lumen has to be said: {present}; choose one or several, such as `{example}`")]
    Labels {
        /// The labels with voxel counts and names.
        present: String,
        /// How the largest is chosen.
        example: String,
    },
    /// The picture is no mask.
    #[error("this is a grey image and no mask: it holds {present}; give the lowest value of the lumen with `input.threshold`, or the value that is the lumen with `input.label`; of a probability or level map give the value at the wall with `input.probability` and `input.isovalue`; else segment the vessel first")]
    Grey {
        /// What the picture holds, in words.
        present: String,
    },
    /// A label of an interpolated picture.
    #[error("{selection} would be too small: {percent:.0} % of the voxels around it hold values between the labels, as interpolation leaves them; resample the labels by nearest neighbour, or give the lowest value of the lumen with `input.threshold`")]
    Blurred {
        /// The rule, in words.
        selection: String,
        /// Part of the voxels around it, %.
        percent: f64,
    },
    /// A segment that is not there, or more than one.
    #[error("{what}; the image holds {present}: choose one of them with `input.label`")]
    Segment {
        /// What is wrong with the choice.
        what: String,
        /// What the picture holds, in words.
        present: String,
    },
    /// No vessel has this size.
    #[error("the lumen would be {diameter} mm across on average, with voxels of {spacing} mm: no vessel has that size; the numbers of the header are in another unit: set `input.units`, or correct the unit in the header where it states one")]
    Scale {
        /// Mean diameter, mm.
        diameter: String,
        /// Voxel edges, mm.
        spacing: String,
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
