//! The case file as written: every key, its default and the reason for it.
//!
//! The doc comments here are the one source of the JSON Schema and of the reference page.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::flow::Flow;
use super::length::{AutoLength, Length};
use super::openings::OpeningsSection;

/// A case: one vessel mask, what to make of it and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// What to read.
    pub input: Input,
    /// From mask to smooth surface.
    #[serde(default)]
    pub reconstruction: Reconstruction,
    /// Triangles: sizes and quality.
    #[serde(default)]
    pub surface: Surface,
    /// Inlets and outlets: found by themselves, or a list of planes.
    #[serde(default)]
    pub openings: OpeningsSection,
    /// Straight pieces added at the openings.
    #[serde(default)]
    pub extensions: Extensions,
    /// Tetrahedra and prisms.
    #[serde(default)]
    pub volume: Volume,
    /// Flow and blood for the solver cases.
    #[serde(default)]
    pub flow: Flow,
    /// Limits that the result is held against. A retry changes the mesh, never a limit.
    #[serde(default)]
    pub gates: Gates,
    /// Files to write.
    #[serde(default = "default_exports")]
    pub exports: Vec<Export>,
}

fn default_exports() -> Vec<Export> {
    vec![Export::Vtk, Export::Stl, Export::Openfoam, Export::Fluent]
}

/// A family of output files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Export {
    /// surface/*.vtp and volume/*.vtu; written always.
    Vtk,
    /// surface/lumen.stl, one solid a patch, and one STL a patch.
    Stl,
    /// surface/lumen.ply
    Ply,
    /// openfoam/: a complete case in metres.
    Openfoam,
    /// fluent/lumen.msh and a journal.
    Fluent,
    /// gmsh/lumen.msh, format 4.1.
    Gmsh,
    /// simvascular/mesh-complete
    Simvascular,
    /// vmtk/lumen.vtu: boundary faces among the cells, `CellEntityIds` 0 inside, 1 wall, openings from 2.
    Vmtk,
}

/// The picture or surface to start from. Give exactly one of `mask`, `probability` and `surface`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Input {
    /// Mask file: .nrrd, .nhdr, .mha, .mhd, .nii, .nii.gz or .vti. Relative paths start at the case file's folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<PathBuf>,
    /// Probability or level map; lumen is where it exceeds `isovalue`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probability: Option<PathBuf>,
    /// Surface: .stl, .vtp, .vtk, .obj or .ply. Its open rims and flat caps are its openings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<PathBuf>,
    /// Voxel edge of the grid that a surface is put on, such as `0.2 mm`. Default: a vessel is eight voxels across.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing: Option<Length>,
    /// Label or segment that is lumen, by number or name, or a list of them. Default: the one value beside 0; where there
    /// are several it has to be given.
    #[serde(skip_serializing_if = "Labels::is_unset")]
    pub label: Labels,
    /// Lumen is from this value up (instead of a label).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// Isovalue of a probability map. Default 0.5.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub isovalue: Option<f64>,
    /// `largest` component only, or `all`; each of all ends as its own closed surface.
    pub components: Components,
    /// Unit of the file's numbers. NIfTI files that name their own unit win.
    pub units: Units,
    /// What may be repaired in the mask before it is meshed; every change is listed in the report.
    pub cleaning: Cleaning,
}

/// One label or several.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Labels {
    /// The mask's one value.
    #[default]
    Unset,
    /// One label.
    One(Label),
    /// Several labels taken together.
    Several(Vec<Label>),
}

impl Labels {
    fn is_unset(&self) -> bool {
        *self == Labels::Unset
    }
}

/// A label by its number, or a segment by the name that a `.seg.nrrd` file gives it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Label {
    /// The value of its voxels.
    Number(i64),
    /// Its name.
    Name(String),
}

/// Which connected parts are meshed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Components {
    /// The largest.
    #[default]
    Largest,
    /// All that are not islands.
    All,
}

/// Unit of the numbers in a file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Units {
    /// Millimetres.
    #[default]
    Mm,
    /// Centimetres.
    Cm,
    /// Metres.
    M,
    /// Micrometres.
    Um,
}

impl Units {
    /// Millimetres in one of the unit.
    pub fn in_mm(self) -> f64 {
        match self {
            Units::Mm => 1.0,
            Units::Cm => 10.0,
            Units::M => 1000.0,
            Units::Um => 1e-3,
        }
    }
}

/// Bounds of the repairs of a mask.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Cleaning {
    /// Tunnels that this many voxels close are noise and are closed. Default 27, as 3 × 3 × 3.
    pub max_hole: VoxelCount,
    /// With `components: all`, parts below this many voxels are dropped as islands. Default 27.
    pub min_island: VoxelCount,
    /// Flip single voxels where two parts touch in an edge or a corner only, so that topology is unambiguous. Default true.
    pub contacts: bool,
}

impl Default for Cleaning {
    fn default() -> Self {
        Cleaning { max_hole: VoxelCount(27), min_island: VoxelCount(27), contacts: true }
    }
}

/// A number of voxels, written `27 voxels` or `27`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[schemars(transparent)]
#[serde(transparent)]
pub struct VoxelCount(#[schemars(schema_with = "voxel_count_schema")] pub usize);

fn voxel_count_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    schemars::json_schema!({ "anyOf": [{ "type": "integer", "minimum": 0 }, { "type": "string", "pattern": r"^\s*[0-9]+(\s*voxels?)?\s*$" }] })
}

impl<'de> Deserialize<'de> for VoxelCount {
    fn deserialize<D: serde::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        let text = super::length::scalar_text(d)?;
        let number = text.trim().trim_end_matches("voxels").trim_end_matches("voxel").trim();
        number
            .parse()
            .map(VoxelCount)
            .map_err(|_| serde::de::Error::custom(format!("`{text}` is not a number of voxels: write `27 voxels`")))
    }
}

/// From mask to smooth surface.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Reconstruction {
    /// `cfd` is most true to the vessel; `paper` is Schumann et al. to the letter.
    pub profile: Profile,
    /// `smooth` fits a C² function between object and background voxels, `mpu` fits MPU implicits to a point cloud.
    /// Default: smooth for `cfd`, mpu for `paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<Method>,
    /// Shift of the surface outwards, in voxel diagonals; negative shifts inwards. Default 0 for `cfd`, 0.05 for `paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -1.0, max = 1.0))]
    pub offset: Option<f64>,
    /// Edges of the polygonizer's cells in voxels. Default 0.5 for `cfd`, 0.7 for `paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.1, max = 2.0))]
    pub cell: Option<f64>,
}

/// A set of reconstruction defaults.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// Best on every measure.
    #[default]
    Cfd,
    /// The paper to the letter.
    Paper,
}

/// How the implicit surface is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Constrained smooth fit between object and background voxels.
    Smooth,
    /// Multi-level partition of unity implicits on the point cloud.
    Mpu,
}

/// Triangles: sizes and quality.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Surface {
    /// How the final triangles are made. `auto` is the better of the first two by measurement.
    pub remesher: Remesher,
    /// Edge length, the same everywhere; `auto` follows curvature, radius and the chord error. A length that cannot hold
    /// (under a fifth of a voxel, or too long for 8 edges round) is refused with the range that can be had.
    pub edge_length: AutoLength,
    /// Factor on the edge length, `auto` included: 2 coarsens, 0.5 refines. Bounded, with a warning, where fewer than 8
    /// edges round or less than a fifth of a voxel would come out.
    #[schemars(range(min = 0.05, max = 20.0))]
    pub scale: f64,
    /// Aim at about this many triangles instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_faces: Option<usize>,
    /// Smallest edge length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_edge_length: Option<Length>,
    /// Largest edge length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_edge_length: Option<Length>,
    /// Edges round the circumference of a vessel, at least, with `edge_length: auto` and `scale: 1`; a scale of 2 halves
    /// the number. Default 28.
    #[schemars(range(min = 6.0, max = 400.0))]
    pub edges_around: f64,
    /// Change of edge length per length, at most. Default 0.15.
    #[schemars(range(min = 0.01, max = 1.0))]
    pub growth: f64,
    /// Places that want smaller triangles.
    pub refine: Vec<Refine>,
    /// Parts of the wall as patches of their own, such as a sac: `[{name: sac, sphere: {center: [1, 2, 3], radius: 4}}]`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub patches: Vec<WallPatch>,
    /// Every triangle must stay below this equi-angle skewness.
    #[schemars(range(min = 0.3, max = 0.95))]
    pub max_skewness: f64,
    /// The equi-angle skewness that angle repair works towards.
    #[schemars(range(min = 0.2, max = 0.95))]
    pub target_skewness: f64,
    /// Whether the vertices of the wall are moved outwards by the mean chord error of their triangles, so that the mesh
    /// encloses what the wall encloses; unset: yes in profile `cfd`, no in profile `paper`. The shift is reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chord_correction: Option<bool>,
}

impl Default for Surface {
    fn default() -> Self {
        Surface {
            remesher: Remesher::Auto,
            edge_length: AutoLength::Auto,
            scale: 1.0,
            target_faces: None,
            min_edge_length: None,
            max_edge_length: None,
            edges_around: 28.0,
            growth: 0.15,
            refine: Vec::new(),
            patches: Vec::new(),
            max_skewness: 0.75,
            target_skewness: 0.45,
            chord_correction: None,
        }
    }
}

/// A part of the wall with its own name: what lies in a sphere, or what a plane cuts off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WallPatch {
    /// Patch name: lower case letters, digits, `_` and `-`, a letter first; no opening's name.
    pub name: String,
    /// Ball; give this or `plane`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sphere: Option<Sphere>,
    /// Plane through the neck; give this or `sphere`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<NeckPlane>,
    /// Edge length on this patch, instead of `edge_length` of the whole surface. `scale` and `growth` act on it too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edge_length: Option<Length>,
}

/// A plane through the neck of a sac.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NeckPlane {
    /// A point on the plane in the neck, LPS mm.
    pub center: [f64; 3],
    /// Direction into the sac; any length.
    pub normal: [f64; 3],
}

/// How the final triangles are made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Remesher {
    /// The better by measurement.
    #[default]
    Auto,
    /// Advancing front on the implicit.
    AdvancingFront,
    /// Split, collapse, flip, relax on the implicit.
    Isotropic,
    /// Polygonizer, then collapses and flips only (the paper's row EC).
    Improve,
}

/// A ball or box with its own edge length.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Refine {
    /// Ball; give this or `box`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sphere: Option<Sphere>,
    /// Box along the world axes; give this or `sphere`.
    #[serde(default, rename = "box", skip_serializing_if = "Option::is_none")]
    pub cuboid: Option<Cuboid>,
    /// Edge length inside.
    pub edge_length: Length,
}

/// A ball in LPS millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Centre, LPS mm.
    pub center: [f64; 3],
    /// Radius, mm.
    pub radius: f64,
}

/// A box in LPS millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// Smallest corner, LPS mm.
    pub min: [f64; 3],
    /// Largest corner, LPS mm.
    pub max: [f64; 3],
}

/// Straight pieces added at the openings. In `D` and `R` the section's own size is meant: the circle of its area.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Extensions {
    /// Length at every opening. Default `0 D`: none.
    pub length: Length,
    /// Length over which the section turns into a circle of equal area; `0 D` keeps the section. Default `0 D`.
    pub blend: Length,
    /// Where the extensions lead. Default normal.
    pub direction: ExtensionDirection,
    /// Openings that want it otherwise, by their names: `{inlet: {length: 10 D}, outlet_2: {length: 0 D}}`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub openings: BTreeMap<String, OneExtension>,
}

impl Default for Extensions {
    fn default() -> Self {
        Extensions {
            length: Length::diameters(0.0),
            blend: Length::diameters(0.0),
            direction: ExtensionDirection::Normal,
            openings: BTreeMap::new(),
        }
    }
}

/// Where an extension leads.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ExtensionDirection {
    /// Along the opening's normal.
    #[default]
    Normal,
    /// Along the centerline's tangent at the opening.
    Centerline,
}

/// What one opening's extension has of its own; keys left out are as for all.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OneExtension {
    /// Length; `0 D` leaves this opening as it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length: Option<Length>,
    /// Length over which the section turns into a circle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blend: Option<Length>,
    /// Where it leads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<ExtensionDirection>,
}

/// Tetrahedra and prisms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Volume {
    /// Largest edge length inside, in mm, voxels or parts of the local radius; `auto` (a third of the radius) grows from the
    /// surface's inwards. The surface's own edges stay.
    pub edge_length: AutoLength,
    /// Growth of the edge length per length inwards. Default 0.2.
    #[schemars(range(min = 0.0, max = 2.0))]
    pub growth: f64,
    /// Aim at about this many cells instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_cells: Option<usize>,
    /// Prism layers on the wall.
    pub boundary_layers: BoundaryLayers,
    /// Number of meshes of one case, from coarse to fine, edge lengths a factor 1.4 apart, in `series/`; 1 makes the one
    /// mesh. 3 gives `coarse`, `medium` (the size asked for) and `fine`.
    pub series: u32,
    /// Seconds that the volume engine may take; it fails after that.
    #[schemars(range(min = 1.0, max = 1e7))]
    pub time_limit: f64,
    /// Memory that the volume engine may take, GiB.
    #[schemars(range(min = 0.1, max = 1e5))]
    pub memory_limit: f64,
}

impl Default for Volume {
    fn default() -> Self {
        Volume {
            edge_length: AutoLength::Auto,
            growth: 0.2,
            target_cells: None,
            boundary_layers: BoundaryLayers::default(),
            series: 1,
            time_limit: 3600.0,
            memory_limit: 16.0,
        }
    }
}

/// Prism layers on the wall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BoundaryLayers {
    /// Number of layers; 0 makes none.
    #[schemars(range(min = 0, max = 50))]
    pub count: u32,
    /// Height of the layer on the wall, never so large that all layers exceed `total`; `auto` follows from total, count
    /// and growth.
    pub first_height: AutoLength,
    /// Height of a layer over that of the one below. Default 1.2.
    #[schemars(range(min = 0.5, max = 3.0))]
    pub growth: f64,
    /// Height of all layers together, a part of the local radius: they grow thinner where space is short. Default `0.25 R`.
    pub total: Length,
}

impl Default for BoundaryLayers {
    fn default() -> Self {
        BoundaryLayers {
            count: 0,
            first_height: AutoLength::Auto,
            growth: 1.2,
            total: Length { value: 0.25, unit: super::length::Unit::Radius },
        }
    }
}

/// Limits that the result is held against.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Gates {
    /// Distance of any surface point to the mask's boundary, voxel diagonals. Hard. Default 1.
    pub max_distance: f64,
    /// Length of vessel that may be missing, part of the centerline. Hard. Default 0.01.
    pub lost_length: f64,
    /// Distance of a cap's vertices from its plane, part of the bounding box. Hard. Default 1e-9.
    pub cap_planarity: f64,
    /// Equi-volume skewness of every tetrahedron. Hard. Default 0.95.
    pub max_volume_skewness: f64,
    /// OpenFOAM's non-orthogonality, degrees. Hard. Default 70.
    pub max_non_orthogonality: f64,
    /// OpenFOAM's skewness. Hard. Default 4.
    pub max_openfoam_skewness: f64,
    /// OpenFOAM's cell determinant. Hard. Default 0.001.
    pub min_determinant: f64,
}

impl Default for Gates {
    fn default() -> Self {
        Gates {
            max_distance: 1.0,
            lost_length: 0.01,
            cap_planarity: 1e-9,
            max_volume_skewness: 0.95,
            max_non_orthogonality: 70.0,
            max_openfoam_skewness: 4.0,
            min_determinant: 0.001,
        }
    }
}

impl Case {
    /// Every file that the case names.
    pub fn files_mut(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let i = &mut self.input;
        [&mut i.mask, &mut i.probability, &mut i.surface, &mut self.flow.waveform].into_iter().flatten()
    }

    /// The same case with paths that hold in any folder.
    #[must_use]
    pub fn with_absolute_paths(&self) -> Case {
        let mut case = self.clone();
        for path in case.files_mut() {
            if let Ok(whole) = std::path::absolute(&*path) {
                *path = whole;
            }
        }
        case
    }

    /// A case for a mask with all defaults.
    pub fn for_mask(mask: PathBuf) -> Case {
        Case {
            input: Input { mask: Some(mask), ..Input::default() },
            reconstruction: Reconstruction::default(),
            surface: Surface::default(),
            openings: OpeningsSection::default(),
            extensions: Extensions::default(),
            volume: Volume::default(),
            flow: Flow::default(),
            gates: Gates::default(),
            exports: default_exports(),
        }
    }

    /// A case for a closed surface with all defaults.
    pub fn for_surface(surface: PathBuf) -> Case {
        let mut case = Case::for_mask(PathBuf::new());
        case.input = Input { surface: Some(surface), ..Input::default() };
        case
    }
}
