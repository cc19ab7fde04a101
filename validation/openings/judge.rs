//! The openings found on a sample against its true ends.

use std::f64::consts::PI;

use lumenmesh::geometry::{Plane, Point};
use lumenmesh::mask::Mask;
use lumenmesh::phantom::{Sample, TrueEnd, plane_section};

/// Farthest an opening's middle may lie from the true end, in radii.
const FAR: f64 = 2.5;

/// Radius by the opening's area against that of the section square to the axis.
const SQUARE: [f64; 2] = [0.8, 1.35];

/// The same against the section in the plane of the cut; a square cut of an end tilted by 50 degrees has 0.80.
const CAP: [f64; 2] = [0.76, 1.25];

/// Two ends whose areas differ by less may both be the inlet.
const NEARLY_EQUAL: f64 = 0.9;

/// An opening with less confidence counts as unsure.
const SURE: f64 = 0.5;

/// An opening as the program found it.
pub struct Found {
    pub name: String,
    pub plane: Plane,
    pub inlet: bool,
    /// Its area as the program says, mm².
    pub area: Option<f64>,
    pub confidence: f64,
}

/// What a run gave.
#[derive(Default)]
pub struct Run {
    pub found: Vec<Found>,
    pub error: Option<String>,
    pub missed_checks: Vec<String>,
    pub warnings: Vec<String>,
}

/// A run held against the truth.
pub struct Judged {
    pub run: Run,
    pub ends: usize,
    pub right: usize,
    pub missed: usize,
    pub wrong: usize,
    pub invented: usize,
    pub inlet_wrong: bool,
    /// Openings are wrong though the run passed.
    pub silent: bool,
    /// All openings are right, but the run failed or an opening is unsure.
    pub alarm: bool,
    pub faults: Vec<String>,
}

/// Area of the mask's section just inside a plane.
fn section(mask: &Mask, plane: &Plane, reach: f64) -> Option<f64> {
    let spacing = mask.grid.spacing();
    let (fine, coarse) = (spacing.iter().fold(f64::INFINITY, |a, &b| a.min(b)), spacing.iter().fold(0.0, |a: f64, &b| a.max(b)));
    let at = |p: &Point| {
        let i = mask.grid.to_index(p).map(|c| c.round() as i64);
        mask.at(i.x, i.y, i.z)
    };
    let inside = Plane { origin: plane.origin - plane.normal * (0.5 * coarse), normal: plane.normal };
    Some(plane_section(at, &inside, [reach, coarse, 0.5 * fine])?.area)
}

/// What is wrong with the size of an opening, or nothing.
fn size_fault(mask: &Mask, end: &TrueEnd, found: &Found) -> Option<String> {
    let reach = 5.0 * (end.cap_area / PI).sqrt();
    let measured = section(mask, &found.plane, reach);
    let ratio = |area: f64, of: f64| (area / of).sqrt();
    for (what, area) in [("by the mask", measured), ("as reported", found.area)] {
        let Some(area) = area else {
            if what == "by the mask" {
                return Some("its middle lies outside the vessel".into());
            }
            continue;
        };
        let (square, cap) = (ratio(area, end.area), ratio(area, end.cap_area));
        if !(SQUARE[0]..=SQUARE[1]).contains(&square) || !(CAP[0]..=CAP[1]).contains(&cap) {
            return Some(format!("radius ratio {square:.2} square, {cap:.2} in the cut's plane, {what}"));
        }
    }
    None
}

fn words(end: &TrueEnd) -> String {
    let stub = end.diameters.map_or(String::new(), |d| format!(" stub {d:.1} D"));
    let form = match (end.flat, end.on_border) {
        (_, true) => "border",
        (true, false) => "flat",
        (false, false) => "round",
    };
    let p = end.plane.origin;
    let at = format!("({:.1}, {:.1}, {:.1})", p.x, p.y, p.z);
    format!("{} [{}, {form}, tilt {:.0}{stub}, radius {:.2}] at {at}", end.name, end.kind, end.tilt(), end.radius)
}

/// Pairs ends and openings, nearest in radii first.
fn pairs(sample: &Sample, found: &[Found]) -> Vec<Option<usize>> {
    let mut all = Vec::new();
    for (e, end) in sample.ends.iter().enumerate() {
        for (f, o) in found.iter().enumerate() {
            let away = (o.plane.origin - end.plane.origin).norm() / end.radius;
            if away <= FAR {
                all.push((away, e, f));
            }
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut of = vec![None; sample.ends.len()];
    for (_, e, f) in all {
        if of[e].is_none() && !of.contains(&Some(f)) {
            of[e] = Some(f);
        }
    }
    of
}

/// Holds what a run found against the truth; `checked` where the run came as far as its checks.
pub fn judge(sample: &Sample, run: Run, checked: bool) -> Judged {
    let mut j = Judged {
        ends: sample.ends.len(),
        right: 0,
        missed: 0,
        wrong: 0,
        invented: 0,
        inlet_wrong: false,
        silent: false,
        alarm: false,
        faults: Vec::new(),
        run,
    };
    let of = pairs(sample, &j.run.found);
    for (end, f) in sample.ends.iter().zip(&of) {
        match f.map(|f| (&j.run.found[f], size_fault(&sample.mask, end, &j.run.found[f]))) {
            None => {
                j.missed += 1;
                j.faults.push(format!("missed {}", words(end)));
            }
            Some((o, Some(why))) => {
                j.wrong += 1;
                j.faults.push(format!("wrong {}: {} {why}", words(end), o.name));
            }
            Some((_, None)) => j.right += 1,
        }
    }
    for (f, o) in j.run.found.iter().enumerate().filter(|(f, _)| !of.contains(&Some(*f))) {
        let p = o.plane.origin;
        let near = sample.closed.iter().min_by(|a, b| (a.at - p).norm().total_cmp(&(b.at - p).norm()));
        let why = near.map_or(String::new(), |c| format!("; nearest closed place: {}", c.reason));
        let name = &j.run.found[f].name;
        j.faults.push(format!("invented {name} at ({:.1}, {:.1}, {:.1}), confidence {:.2}{why}", p.x, p.y, p.z, o.confidence));
        j.invented += 1;
    }
    let largest = sample.ends.iter().map(|e| e.area).fold(0.0, f64::max);
    for (f, o) in j.run.found.iter().enumerate().filter(|(_, o)| o.inlet) {
        let end = of.iter().position(|x| *x == Some(f)).map(|e| &sample.ends[e]);
        if end.is_some_and(|e| e.area < NEARLY_EQUAL * largest) {
            j.inlet_wrong = true;
            j.faults.push(format!("the inlet is {}, found as {}", words(&sample.ends[0]), o.name));
        }
    }
    if let Some(e) = &j.run.error {
        j.faults.push(format!("error: {e}"));
    }
    if !j.run.missed_checks.is_empty() {
        j.faults.push(format!("checks missed: {}", j.run.missed_checks.join(", ")));
    }
    let all_right = j.right == j.ends && j.invented == 0 && !j.inlet_wrong;
    let passed = j.run.error.is_none() && j.run.missed_checks.is_empty();
    let unsure: Vec<String> =
        j.run.found.iter().filter(|o| o.confidence < SURE).map(|o| format!("{} has confidence {:.2}", o.name, o.confidence)).collect();
    j.silent = checked && !all_right && passed;
    j.alarm = all_right && (!passed || !unsure.is_empty());
    j.faults.extend(unsure);
    if j.silent {
        j.faults.push(format!("PASSED all the same, with {} warnings", j.run.warnings.len()));
    }
    j
}

/// Counts of a kind.
#[derive(Default)]
pub struct Tally {
    masks: usize,
    clean: usize,
    ends: usize,
    right: usize,
    missed: usize,
    wrong: usize,
    invented: usize,
    inlets: usize,
    silent: usize,
    alarms: usize,
    errors: usize,
}

impl Tally {
    pub const HEAD: &str = "| kind | masks | all right | ends right | % | missed | wrong | invented | wrong inlet | errors | passed though wrong | right but unsure | s |\n|-|-|-|-|-|-|-|-|-|-|-|-|-|";

    pub fn add(&mut self, j: &Judged) {
        self.masks += 1;
        self.clean += usize::from(j.right == j.ends && j.invented == 0 && !j.inlet_wrong && j.run.error.is_none());
        self.ends += j.ends;
        self.right += j.right;
        self.missed += j.missed;
        self.wrong += j.wrong;
        self.invented += j.invented;
        self.inlets += usize::from(j.inlet_wrong);
        self.silent += usize::from(j.silent);
        self.alarms += usize::from(j.alarm);
        self.errors += usize::from(j.run.error.is_some());
    }

    pub fn row(&self, kind: &str, seconds: f64) -> String {
        format!(
            "| {kind} | {} | {} | {}/{} | {:.1} | {} | {} | {} | {} | {} | {} | {} | {seconds:.0} |",
            self.masks,
            self.clean,
            self.right,
            self.ends,
            100.0 * self.right as f64 / self.ends.max(1) as f64,
            self.missed,
            self.wrong,
            self.invented,
            self.inlets,
            self.errors,
            self.silent,
            self.alarms
        )
    }
}
