//! TetGen 1.5 (Debian's `libtet1.5-dev`) behind a small safe interface.
//!
//! The shim calls TetGen's stages by itself, so that an error comes back as a value where TetGen's own
//! `tetrahedralize()` dies of a double free. What it cannot do: Debian builds TetGen with its asserts
//! on, so some inputs (NaN, a flat set of points) still abort the process, and refinement can run
//! without end. Call it from a process that may die, after a check of the input.
//!
//! Licence: TetGen is AGPL-3 (or commercial), hence so is this crate and what links it.

use std::ffi::{CString, c_char, c_int, c_void};
use std::sync::{Mutex, PoisonError};

/// A piecewise linear complex of triangles and free points, all ids zero-based.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Input {
    /// Positions; points that no triangle uses become vertices of the mesh too where they lie inside.
    pub points: Vec<[f64; 3]>,
    /// Wished edge length at each point (switch `m`); as long as `points`, or empty for none.
    pub sizes: Vec<f64>,
    /// Facets.
    pub triangles: Vec<[u32; 3]>,
    /// A number a facet, given back with the faces; as long as `triangles`.
    pub markers: Vec<i32>,
}

/// A mesh of tetrahedra.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Output {
    /// Positions; with switch `Y` the input points come first, bit-equal.
    pub points: Vec<[f64; 3]>,
    /// (p1−p0)×(p2−p0)·(p3−p0) > 0.
    pub tets: Vec<[u32; 4]>,
    /// Faces on the input facets; their normals point inwards.
    pub faces: Vec<[u32; 3]>,
    /// Marker of the facet of each face.
    pub markers: Vec<i32>,
}

/// What TetGen is busy with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Delaunay tetrahedra of all points.
    Delaunay,
    /// Triangulation of the facets.
    Surface,
    /// Facets and edges are made to appear among the tetrahedra.
    Recovery,
    /// Tetrahedra outside are removed.
    Exterior,
    /// Points added during recovery are removed.
    Suppression,
    /// Given points are inserted.
    Insertion,
    /// Points are added for quality and size.
    Refinement,
    /// Flips and smoothing.
    Optimisation,
    /// The mesh is copied out.
    Output,
}

impl Stage {
    /// The stage with this number, as [`Stage::number`] gives it.
    pub fn from_number(n: u8) -> Option<Stage> {
        use Stage::*;
        [Delaunay, Surface, Recovery, Exterior, Suppression, Insertion, Refinement, Optimisation, Output]
            .get((n as usize).checked_sub(1)?)
            .copied()
    }

    /// A number from 1.
    pub fn number(self) -> u8 {
        self as u8 + 1
    }

    /// A name for messages.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Delaunay => "Delaunay triangulation",
            Stage::Surface => "facet triangulation",
            Stage::Recovery => "boundary recovery",
            Stage::Exterior => "removal of the exterior",
            Stage::Suppression => "removal of recovery points",
            Stage::Insertion => "point insertion",
            Stage::Refinement => "refinement",
            Stage::Optimisation => "optimisation",
            Stage::Output => "output",
        }
    }
}

/// Why TetGen gave up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// Out of memory.
    Memory,
    /// TetGen calls it a bug.
    Internal,
    /// Two facets cross, or the points are trivial.
    SelfIntersection,
    /// A feature smaller than TetGen's tolerance.
    TinyFeature,
    /// Two facets nearly coincide.
    NearOverlap,
    /// Bad input or switches, arrays of wrong length and ids out of range included.
    Input,
    /// Anything else, with TetGen's number.
    Other(i32),
}

impl Failure {
    /// The failure for one of TetGen's codes.
    pub fn from_code(code: i32) -> Failure {
        match code {
            1 => Failure::Memory,
            2 => Failure::Internal,
            3 => Failure::SelfIntersection,
            4 => Failure::TinyFeature,
            5 => Failure::NearOverlap,
            10 => Failure::Input,
            other => Failure::Other(other),
        }
    }

    /// TetGen's code.
    pub fn code(self) -> i32 {
        match self {
            Failure::Memory => 1,
            Failure::Internal => 2,
            Failure::SelfIntersection => 3,
            Failure::TinyFeature => 4,
            Failure::NearOverlap => 5,
            Failure::Input => 10,
            Failure::Other(n) => n,
        }
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Failure::Memory => write!(f, "out of memory"),
            Failure::Internal => write!(f, "internal error"),
            Failure::SelfIntersection => write!(f, "facets cross each other"),
            Failure::TinyFeature => write!(f, "a feature is smaller than the tolerance"),
            Failure::NearOverlap => write!(f, "two facets nearly coincide"),
            Failure::Input => write!(f, "unusable input or switches"),
            Failure::Other(n) => write!(f, "error code {n}"),
        }
    }
}

impl std::error::Error for Failure {}

#[repr(C)]
struct RawInput {
    points: *const f64,
    sizes: *const f64,
    point_count: usize,
    triangles: *const c_int,
    markers: *const c_int,
    triangle_count: usize,
}

#[repr(C)]
struct RawOutput {
    owner: *mut c_void,
    points: *const f64,
    point_count: usize,
    tets: *const c_int,
    tet_count: usize,
    faces: *const c_int,
    markers: *const c_int,
    face_count: usize,
}

type StageCallback = extern "C" fn(c_int, *mut c_void);

unsafe extern "C" {
    fn lm_tetgen_run(
        switches: *const c_char,
        input: *const RawInput,
        at: StageCallback,
        context: *mut c_void,
        output: *mut RawOutput,
    ) -> c_int;
    fn lm_tetgen_free(output: *mut RawOutput);
    fn lm_limit_memory(bytes: u64) -> c_int;
    fn lm_stdout_to_stderr() -> c_int;
}

/// TetGen keeps file-static state: two calls at once hang.
static LOCK: Mutex<()> = Mutex::new(());

struct Callback<'a>(&'a mut dyn FnMut(Stage));

extern "C" fn at_stage(stage: c_int, context: *mut c_void) {
    // SAFETY: `context` is the `Callback` that `tetrahedralize` keeps alive and unaliased during the call.
    let callback = unsafe { &mut *context.cast::<Callback<'_>>() };
    if let Some(s) = u8::try_from(stage).ok().and_then(Stage::from_number) {
        (callback.0)(s);
    }
}

/// Runs TetGen with its own `switches` (always with `z`, zero-based ids, whatever they say).
///
/// `at` hears of each stage before it begins. Blocks while another thread is inside.
/// Not guaranteed: an end. See the crate's documentation for what can still abort the process.
pub fn tetrahedralize(input: &Input, switches: &str, mut at: impl FnMut(Stage)) -> Result<Output, Failure> {
    let n = input.points.len();
    let fits = n > 0
        && i32::try_from(n).is_ok()
        && i32::try_from(input.triangles.len()).is_ok()
        && input.markers.len() == input.triangles.len()
        && (input.sizes.is_empty() || input.sizes.len() == n)
        && input.triangles.iter().flatten().all(|&v| (v as usize) < n)
        && input.points.iter().flatten().all(|x| x.is_finite());
    let switches = CString::new(format!("z{switches}")).map_err(|_| Failure::Input)?;
    if !fits || switches.as_bytes().len() > 500 {
        return Err(Failure::Input);
    }
    let raw = RawInput {
        points: input.points.as_ptr().cast(),
        sizes: if input.sizes.is_empty() { std::ptr::null() } else { input.sizes.as_ptr() },
        point_count: n,
        triangles: input.triangles.as_ptr().cast(),
        markers: input.markers.as_ptr(),
        triangle_count: input.triangles.len(),
    };
    let mut out = RawOutput {
        owner: std::ptr::null_mut(),
        points: std::ptr::null(),
        point_count: 0,
        tets: std::ptr::null(),
        tet_count: 0,
        faces: std::ptr::null(),
        markers: std::ptr::null(),
        face_count: 0,
    };
    let mut callback = Callback(&mut at);
    let _one_at_a_time = LOCK.lock().unwrap_or_else(PoisonError::into_inner);
    // SAFETY: the pointers of `raw` and `switches` outlive the call and have the lengths they say (checked
    // above; u32 ids below i32::MAX have the layout of int); the shim copies them. `callback` is alive and
    // used by nobody else. No other call is inside: `LOCK`.
    let code = unsafe {
        lm_tetgen_run(switches.as_ptr(), &raw, at_stage, (&raw mut callback).cast::<c_void>(), &mut out)
    };
    if code != 0 {
        return Err(Failure::from_code(code));
    }
    // SAFETY: the shim filled `out` with arrays of these lengths that live until `lm_tetgen_free`, and a
    // null pointer only with a length of 0 (`copy` looks).
    let result = unsafe {
        Output {
            points: copy(out.points.cast(), out.point_count),
            tets: copy(out.tets.cast::<[u32; 4]>(), out.tet_count),
            faces: copy(out.faces.cast::<[u32; 3]>(), out.face_count),
            markers: copy(out.markers, if out.markers.is_null() { 0 } else { out.face_count }),
        }
    };
    // SAFETY: `out` came from `lm_tetgen_run` and is freed once.
    unsafe { lm_tetgen_free(&mut out) };
    Ok(result)
}

/// # Safety
/// `p` is null or points to `n` initialised values.
unsafe fn copy<T: Copy>(p: *const T, n: usize) -> Vec<T> {
    if p.is_null() || n == 0 {
        return Vec::new();
    }
    // SAFETY: as this function's own contract.
    unsafe { std::slice::from_raw_parts(p, n) }.to_vec()
}

/// Limits the address space of this process, for good; `false` where the system refuses.
pub fn limit_memory(bytes: u64) -> bool {
    // SAFETY: a system call without pointers.
    unsafe { lm_limit_memory(bytes) == 0 }
}

/// Sends what this process prints to its standard output to its standard error, for good: TetGen prints
/// error lines even when told to be quiet.
pub fn stdout_to_stderr() -> bool {
    // SAFETY: a system call without pointers.
    unsafe { lm_stdout_to_stderr() == 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube() -> Input {
        let points = (0..8).map(|i| [f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)]).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles: Vec<_> = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        Input { points, sizes: vec![], markers: (0..12).collect(), triangles }
    }

    fn volume(o: &Output) -> f64 {
        o.tets
            .iter()
            .map(|t| {
                let p = t.map(|v| o.points[v as usize]);
                let d = |i: usize| [0, 1, 2].map(|k| p[i][k] - p[0][k]);
                let (a, b, c) = (d(1), d(2), d(3));
                (a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
                    + a[2] * (b[0] * c[1] - b[1] * c[0]))
                    / 6.0
            })
            .sum()
    }

    #[test]
    fn a_cube_is_filled_and_keeps_its_facets_and_markers() {
        let input = cube();
        let mut stages = vec![];
        let out = tetrahedralize(&input, "pYq1.4a0.01Q", |s| stages.push(s)).unwrap();
        assert!(out.tets.len() >= 5);
        assert!((volume(&out) - 1.0).abs() < 1e-12);
        assert_eq!(out.points[..8], input.points[..]);
        assert_eq!(out.markers, input.markers);
        assert_eq!(stages.first(), Some(&Stage::Delaunay));
        assert_eq!(stages.last(), Some(&Stage::Output));
    }

    #[test]
    fn crossing_facets_fail_again_and_again_without_harm() {
        let mut bad = cube();
        let n = bad.points.len() as u32;
        bad.points.extend([[0.5, 0.5, -1.0], [0.6, 0.5, 0.5], [0.5, 0.6, 0.5]]);
        bad.triangles.push([n, n + 1, n + 2]);
        bad.markers.push(99);
        for _ in 0..50 {
            assert_eq!(tetrahedralize(&bad, "pYQ", |_| {}), Err(Failure::SelfIntersection));
        }
        assert!(tetrahedralize(&cube(), "pYQ", |_| {}).is_ok());
    }

    #[test]
    fn arrays_that_do_not_fit_are_refused() {
        let mut i = cube();
        i.triangles[0][0] = 8;
        assert_eq!(tetrahedralize(&i, "pYQ", |_| {}), Err(Failure::Input));
        let mut i = cube();
        i.points[0][0] = f64::NAN;
        assert_eq!(tetrahedralize(&i, "pYQ", |_| {}), Err(Failure::Input));
    }
}
