//! What can end a run, by kind: the command line turns kinds into exit codes.

use std::path::PathBuf;

use crate::{centerline, implicit, io, mask, openings, pointcloud, polygonize, quality, remesh, volume};

/// Kinds of failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// The case asks for something that cannot be.
    Configuration,
    /// The input cannot be read or used.
    Input,
    /// Geometry or topology.
    Geometry,
    /// The volume engine.
    Engine,
    /// The user asked to stop.
    Interrupted,
}

/// Why a run ended without a mesh.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] io::Error),
    /// The file's mask is unusable.
    #[error("{}: {source}", path.display())]
    Selection {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong.
        source: mask::Error,
    },
    /// The mask is unusable.
    #[error(transparent)]
    Mask(#[from] mask::Error),
    /// The point cloud cannot be made.
    #[error(transparent)]
    PointCloud(#[from] pointcloud::Error),
    /// No implicit surface.
    #[error(transparent)]
    Smooth(#[from] implicit::smooth::SmoothError),
    /// No MPU implicit.
    #[error(transparent)]
    Mpu(#[from] implicit::mpu::MpuError),
    /// The implicit surface cannot be polygonized.
    #[error(transparent)]
    Polygonize(#[from] polygonize::PolygonizeError),
    /// No centerlines.
    #[error(transparent)]
    Centerline(#[from] centerline::Error),
    /// The surface cannot be remeshed.
    #[error(transparent)]
    Remesh(#[from] remesh::Error),
    /// The advancing front failed.
    #[error(transparent)]
    Front(#[from] remesh::advancing_front::AdvancingFrontError),
    /// An opening cannot be made.
    #[error(transparent)]
    Openings(#[from] openings::Error),
    /// The user's openings cannot be made.
    #[error(transparent)]
    UserOpenings(#[from] openings::UserError),
    /// An extension cannot be made.
    #[error(transparent)]
    Extension(#[from] openings::ExtendError),
    /// A surface cannot be the wall of a lumen.
    #[error("{file}: {what}", file = file.display())]
    Surface {
        /// The file.
        file: PathBuf,
        /// What is wrong, where, and what to do.
        what: String,
    },
    /// A part of the wall cannot be a patch of its own.
    #[error(transparent)]
    Region(#[from] crate::mesh::regions::RegionError),
    /// A surface cannot be sampled.
    #[error(transparent)]
    Samples(#[from] pointcloud::SurfaceError),
    /// A probability map has no wall.
    #[error("the probability map: {0}")]
    Probability(#[from] implicit::probability::ProbabilityError),
    /// No flow can be planned.
    #[error(transparent)]
    Flow(#[from] crate::flow::FlowError),
    /// Fidelity cannot be measured.
    #[error(transparent)]
    Fidelity(#[from] quality::fidelity::FidelityError),
    /// No volume mesh.
    #[error(transparent)]
    Volume(#[from] volume::Error),
    /// The mask is nowhere thick enough to be a lumen.
    #[error("the mask is nowhere more than two voxels thick: it is the label of a wall, a single slice, or a vessel too thin for its voxels; choose the lumen's label with `input.label`, or segment the vessel at a finer spacing")]
    Thin,
    /// A component has no voxel.
    #[error("a component of the mask has no lumen voxel: check the label or threshold that selects the lumen")]
    EmptyComponent,
    /// The volume mesh does not hang together.
    #[error("the volume mesh cannot be exported: {0}")]
    Faces(#[from] crate::mesh::faces::FaceError),
    /// The case contradicts itself or the picture.
    #[error("{0}")]
    Configuration(String),
    /// Ctrl-C or a termination signal.
    #[error("interrupted; nothing was written")]
    Interrupted,
}

impl Error {
    /// The opening that is at fault, by the name that the case has for it.
    pub fn opening(&self) -> Option<&str> {
        match self {
            Error::Openings(e) => Some(e.opening()),
            Error::UserOpenings(e) => Some(e.opening()),
            Error::Extension(e) => Some(e.opening()),
            Error::Flow(e) => e.opening(),
            Error::Region(crate::mesh::regions::RegionError::SameName(name)) => Some(name),
            _ => None,
        }
    }

    /// The key of the case that is at fault.
    pub fn key(&self) -> Option<&'static str> {
        match self {
            Error::Remesh(remesh::Error::OutOfReach { name: "edge_length", .. }) => Some("surface.edge_length"),
            Error::Remesh(remesh::Error::OutOfReach { name: "patches.edge_length", .. }) => Some("surface.patches"),
            Error::Remesh(remesh::Error::OutOfReach { .. }) => Some("surface.refine"),
            _ => None,
        }
    }

    /// The kind of failure.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Error::File(io::Error::Write { .. }) => ErrorKind::Configuration,
            Error::File(_) | Error::Mask(_) | Error::Selection { .. } | Error::Surface { .. } | Error::Probability(_) => ErrorKind::Input,
            Error::Configuration(_) | Error::Flow(_) => ErrorKind::Configuration,
            Error::Remesh(remesh::Error::OutOfReach { .. }) => ErrorKind::Configuration,
            Error::Extension(openings::ExtendError::Unknown { .. }) => ErrorKind::Configuration,
            Error::UserOpenings(openings::UserError::UnknownName { .. } | openings::UserError::SameName { .. }) => ErrorKind::Configuration,
            Error::Region(crate::mesh::regions::RegionError::SameName(_)) => ErrorKind::Configuration,
            Error::Interrupted | Error::Volume(volume::Error::Cancelled) => ErrorKind::Interrupted,
            Error::Volume(volume::Error::Surface(_)) => ErrorKind::Geometry,
            Error::Volume(_) => ErrorKind::Engine,
            _ => ErrorKind::Geometry,
        }
    }
}
