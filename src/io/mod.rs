//! File formats: one file a format, reading and writing.

mod error;
pub mod fluent;
pub mod gmsh;
pub mod image;
pub mod metaimage;
pub mod nifti;
pub mod nrrd;
pub mod openfoam;
pub mod ply;
mod scalars;
pub mod simvascular;
pub mod stl;
mod text;
pub mod vti;
pub mod vtk_xml;
pub mod vtp;
pub mod vtu;

pub use error::Error;
