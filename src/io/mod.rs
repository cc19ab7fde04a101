//! File formats: one file a format, reading and writing.

mod error;
pub mod image;
pub mod metaimage;
pub mod nifti;
pub mod nrrd;
mod scalars;

pub use error::Error;
