//! Arguments of every subcommand.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::pipeline::Stage;

/// From a binary mask of blood vessels to a mesh that FLUENT or OpenFOAM can run.
#[derive(Debug, Parser)]
#[command(name = "lumenmesh", version, max_term_width = 100, after_help = EXAMPLES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

const EXAMPLES: &str = "\
Examples:
  lumenmesh mesh aneurysm.nrrd -o out             all defaults, no case file
  lumenmesh init aneurysm.nrrd -o case.yaml       a case file to edit, with the ends that were found
  lumenmesh run case.yaml -o out --set \"surface.edge_length=0.3 mm\"
  lumenmesh check out/volume/lumen.vtu            quality of any mesh

Exit codes: 0 all hard gates met; 2 usage or configuration; 3 input; 4 geometry or topology;
5 volume engine; 6 a hard gate missed (files kept); 130 interrupted.";

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a case file: mask in, checked mesh out.
    Run(RunArgs),
    /// Mesh a mask or surface with all defaults, without a case file.
    Mesh(MeshArgs),
    /// Report the quality of any STL, VTP, VTK, OBJ, PLY, VTU, OpenFOAM case or .msh.
    Check(CheckArgs),
    /// Observed order and grid convergence index from the filled table of a series.
    Convergence(ConvergenceArgs),
    /// Write a built-in case with exact truth: mask.nrrd, truth.json, case.yaml.
    Phantom(PhantomArgs),
    /// Run many cases, one folder each, worst first in cohort.html.
    Batch(BatchArgs),
    /// Write a commented case file for a mask or surface: sizes, ends that were found, advice.
    Init(InitArgs),
    /// Check a case file without running it.
    Validate(ValidateArgs),
    /// Print the JSON Schema (draft-07) of case files.
    Schema,
    /// Print the reference of all keys of case files, as Markdown.
    Reference,
    /// Print a completion script.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Print the manual page (roff), or write one for each subcommand.
    Man {
        /// Folder for the pages of all subcommands: lumenmesh.1, lumenmesh-run.1, …
        #[arg(short, long, value_name = "DIR")]
        output: Option<PathBuf>,
        /// Replace pages that are there and differ.
        #[arg(long, requires = "output")]
        force: bool,
    },
}

/// `lumenmesh convergence`
#[derive(Debug, Clone, Args)]
pub struct ConvergenceArgs {
    /// `series/convergence.csv` with a figure of the flow entered for each mesh.
    #[arg(value_name = "TABLE")]
    pub table: PathBuf,
}

/// What `run` and `mesh` share.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Change a key of the case: `--set "surface.edge_length=0.4 mm"`; may be repeated.
    #[arg(long = "set", value_name = "KEY.PATH=VALUE", help_heading = "Case")]
    pub set: Vec<String>,
    /// Stop after a stage and write what there is.
    #[arg(long, value_enum, value_name = "STAGE", help_heading = "Case")]
    pub stop_after: Option<StageArg>,
    /// Move what is in the output folder aside, to DIR.1 or the next free number, whatever it is; nothing is removed.
    #[arg(long, help_heading = "Running")]
    pub keep: bool,
    /// Threads; the files are the same for any number. Default: all cores.
    #[arg(long, value_name = "N", help_heading = "Running")]
    pub threads: Option<usize>,
    /// Print nothing but errors.
    #[arg(short, long, conflicts_with = "verbose", help_heading = "Running")]
    pub quiet: bool,
    /// Explain decisions.
    #[arg(short, long, help_heading = "Running")]
    pub verbose: bool,
    /// Print report.json on standard output.
    #[arg(long, help_heading = "Running")]
    pub json: bool,
}

/// Stages that a run can stop after.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StageArg {
    /// The cleaned mask.
    Mask,
    /// The polygonized implicit surface, before remeshing.
    Reconstruction,
    /// The remeshed surface with its openings.
    Surface,
    /// The volume mesh, without solver cases.
    Volume,
}

impl From<StageArg> for Stage {
    fn from(s: StageArg) -> Stage {
        match s {
            StageArg::Mask => Stage::Mask,
            StageArg::Reconstruction => Stage::Reconstruction,
            StageArg::Surface => Stage::Surface,
            StageArg::Volume => Stage::Volume,
        }
    }
}

/// Arguments of `run`.
#[derive(Debug, Clone, Args)]
#[command(after_help = RUN_EXAMPLES)]
pub struct RunArgs {
    /// Case file (YAML).
    pub case: PathBuf,
    /// Folder for the results. Earlier results there are replaced when the run is done, unless anything was added or changed.
    /// Default: the case file's name.
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Shared options.
    #[command(flatten)]
    pub common: Common,
}

/// Arguments of `mesh`.
#[derive(Debug, Clone, Args)]
#[command(after_help = MESH_EXAMPLES)]
pub struct MeshArgs {
    /// Mask (.nrrd, .nhdr, .mha, .mhd, .nii, .nii.gz, .vti) or surface, closed or open at its ends (.stl, .vtp, .vtk, .obj, .ply).
    pub input: PathBuf,
    /// Folder for the results. Earlier results there are replaced when the run is done, unless anything was added or changed.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Shared options.
    #[command(flatten)]
    pub common: Common,
}

/// Arguments of `check`.
#[derive(Debug, Clone, Args)]
#[command(after_help = CHECK_EXAMPLES)]
pub struct CheckArgs {
    /// Meshes: STL, VTP, PLY, VTU, OpenFOAM case folder, FLUENT or Gmsh .msh.
    #[arg(required = true)]
    pub files: Vec<PathBuf>,
    /// Print the full report as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `phantom`.
#[derive(Debug, Clone, Args)]
pub struct PhantomArgs {
    /// Name of a built-in case, KIND-SEED for a random one of a kind (`cuts-7`), or `list`.
    pub name: String,
    /// Folder for the files.
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Move what is in the output folder aside, to DIR.1 or the next free number, whatever it is; nothing is removed.
    #[arg(long)]
    pub keep: bool,
}

/// Arguments of `batch`.
#[derive(Debug, Clone, Args)]
#[command(after_help = BATCH_EXAMPLES)]
pub struct BatchArgs {
    /// Case files, masks or surfaces.
    #[arg(required = true)]
    pub cases: Vec<PathBuf>,
    /// Folder for the cohort: one folder a case, cohort.html, cohort.csv; NAME.log where a case failed.
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Change a key in every case.
    #[arg(long = "set", value_name = "KEY.PATH=VALUE", help_heading = "Cases")]
    pub set: Vec<String>,
    /// Run every case once for each value; several sweeps give all combinations.
    #[arg(long, value_name = "KEY.PATH=VALUE,VALUE", allow_hyphen_values = true, help_heading = "Cases")]
    pub sweep: Vec<String>,
    /// Run nothing: write cohort.html and cohort.csv from the folders that are there (for cohorts on a cluster).
    #[arg(long, help_heading = "Cases")]
    pub collect: bool,
    /// Move results that are not those asked for aside, to NAME.1 or the next free number; nothing is removed.
    #[arg(long, help_heading = "Running")]
    pub keep: bool,
    /// Cases at a time; the threads are shared among them.
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Running")]
    pub jobs: usize,
    /// Threads in all. Default: all cores.
    #[arg(long, value_name = "N", help_heading = "Running")]
    pub threads: Option<usize>,
    /// Memory that all runs together may take, GiB: a case waits until its likely share is free. Default: 80 % of what is free.
    #[arg(long, value_name = "GIB", help_heading = "Running")]
    pub memory: Option<f64>,
}

const RUN_EXAMPLES: &str = "\
Examples:
  lumenmesh run case.yaml -o out
  lumenmesh run case.yaml --set \"surface.edge_length=0.3 mm\" --set volume.boundary_layers.count=4
  lumenmesh run case.yaml --stop-after surface -v

Lengths carry their unit: mm, cm, m, um, voxels, R (local radius), D (local diameter).
`lumenmesh reference` lists every key.";

const MESH_EXAMPLES: &str = "\
Examples:
  lumenmesh mesh aneurysm.nrrd -o out
  lumenmesh mesh segmentation.nii.gz -o out --set input.label=2
  lumenmesh mesh carotid.mha -o out --set surface.scale=1.5 --set exports=[vtk,openfoam]";

const CHECK_EXAMPLES: &str = "\
Examples:
  lumenmesh check wall.stl volume.vtu
  lumenmesh check openfoam/ --json";

const BATCH_EXAMPLES: &str = "\
Examples:
  lumenmesh batch masks/*.nii.gz -o cohort --jobs 2
  lumenmesh batch cases/*/case.yaml -o cohort        run again after a kill: what is done is kept
  lumenmesh batch aneurysm.nrrd -o sweep --sweep reconstruction.offset=-0.25,0,0.25 --sweep surface.scale=1.4,1

An offset is in voxel diagonals: how the mesh answers to a surface moved by a part of a voxel.
The exit code is that of the worst case.";

/// Arguments of `init`.
#[derive(Debug, Clone, Args)]
pub struct InitArgs {
    /// Mask (.nrrd, .nhdr, .mha, .mhd, .nii, .nii.gz, .vti) or surface, closed or open at its ends (.stl, .vtp, .vtk, .obj, .ply).
    pub input: PathBuf,
    /// File for the case; default: standard output. An existing file is kept.
    #[arg(short, long, value_name = "CASE.yaml")]
    pub output: Option<PathBuf>,
    /// Replace an existing file.
    #[arg(long, requires = "output")]
    pub force: bool,
    /// Move an existing file aside, to CASE.yaml.1 or the next free number.
    #[arg(long, requires = "output", conflicts_with = "force")]
    pub keep: bool,
    /// Change a key of the case first, such as `--set input.label=1`; may be repeated.
    #[arg(long = "set", value_name = "KEY.PATH=VALUE")]
    pub set: Vec<String>,
    /// Explain decisions.
    #[arg(short, long)]
    pub verbose: bool,
}

/// Arguments of `validate`.
#[derive(Debug, Clone, Args)]
pub struct ValidateArgs {
    /// Case file (YAML).
    pub case: PathBuf,
    /// Change a key first.
    #[arg(long = "set", value_name = "KEY.PATH=VALUE")]
    pub set: Vec<String>,
}
