//! File formats: one file a format, reading and writing.

mod cells;
mod dicom;
mod error;
mod foam_reader;
pub mod fluent;
pub mod fluent_journal;
pub mod gmsh;
pub mod image;
pub mod mesh;
pub mod metaimage;
mod msh_reader;
pub mod nifti;
pub mod nrrd;
pub mod openfoam;
pub mod ply;
mod scalars;
mod segments;
pub mod simvascular;
pub mod stl;
mod surface_reader;
mod text;
pub mod vti;
mod vtk_legacy;
mod vtk_reader;
pub mod vtk_xml;
mod vtk_xml_reader;
pub mod vtp;
pub mod vtu;

pub use error::Error;
pub(crate) use error::reason;
#[cfg(feature = "cli")]
pub(crate) use error::writing;
