//! From a binary mask of blood vessels to a mesh that FLUENT or OpenFOAM can run.
//!
//! Data flows one way: `mask` → `pointcloud` → `implicit` → `polygonize` → `centerline` →
//! `remesh` → `openings` → `volume` → `io`, and [`pipeline`] is the only place that knows the order.
//! All coordinates are LPS world coordinates in millimetres; all ids are `u32`.

pub mod centerline;
#[cfg(feature = "cli")]
pub mod cli;
pub mod config;
pub mod flow;
pub mod geometry;
pub mod implicit;
pub mod io;
pub mod mask;
pub mod mesh;
pub mod openings;
pub mod phantom;
pub mod pipeline;
pub mod polygonize;
pub mod quality;
pub mod pointcloud;
pub mod remesh;
pub mod report;
pub mod volume;
