//! Centerlines with the radius of the largest inscribed sphere.

use crate::geometry::{Point, Vector};

/// A sample of a centerline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Position on the axis, mm.
    pub point: Point,
    /// Radius of the largest inscribed sphere there, mm.
    pub radius: f64,
    /// Unit tangent in the direction of the branch's samples.
    pub tangent: Vector,
    /// Arc length from the branch's first sample, mm.
    pub arc_length: f64,
}

/// What a branch ends in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndKind {
    /// A node shared with other branches.
    Junction,
    /// A free end: a tip of the vessel.
    Free,
}

/// A piece of vessel between two nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Samples from the first node to the last, evenly spaced in arc length.
    pub samples: Vec<Sample>,
    /// Node ids of the first and the last sample.
    pub nodes: [u32; 2],
    /// What the two ends are.
    pub ends: [EndKind; 2],
    /// Connected component of the mask.
    pub component: u32,
}

/// All centerlines of a mask.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Centerlines {
    /// Branches; a loop is a branch or a chain of branches that returns to its node.
    pub branches: Vec<Branch>,
    /// Positions of the nodes.
    pub nodes: Vec<Point>,
}
