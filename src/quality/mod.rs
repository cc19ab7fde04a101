//! Every measure of quality, on any mesh, each by its own name.

pub mod curvature;
pub mod fidelity;
mod foam;
pub mod stats;
mod surface;
mod volume;

pub use fidelity::marching_cubes;
pub use foam::{FoamQuality, Place, face_geometry};
pub use surface::{
    AreaRatio, PatchSkewness, Shape, SurfaceOptions, SurfaceQuality, WorstTriangle, angles, equi_angle_skewness, surface,
};
pub use volume::{
    FluentQuality, Skewness, VolumeOptions, VolumeQuality, WorstCell, dihedral_range, equi_volume_skewness, polyhedral,
    volume, volume_of_faces,
};
