//! Every measure of quality, on any mesh.

pub mod fidelity;

pub use fidelity::marching_cubes;
