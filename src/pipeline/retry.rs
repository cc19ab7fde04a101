//! What is done where a surface misses a hard gate: it is made again, in a bounded number of other ways.
//!
//! The limits stay what they are. Each attempt changes the mesh: shorter edges round what was wrong, then the other
//! remesher, then shorter edges everywhere. The first that holds every gate is kept; where none does, the one that
//! misses least, and the gates tell. Every attempt stands in the report.

use serde::Serialize;

use crate::config::Remesher;
use crate::geometry::Point;
use crate::mesh::{TriMesh, intersect, topology};
use crate::openings;
use crate::remesh::{Stop, shape};

/// One way of making a surface again.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Attempt {
    /// Whether the remesher is the other one than the first time.
    pub other_remesher: bool,
    /// Factor on the wished edge length.
    pub factor: f64,
    /// Whether the factor acts round what was wrong only.
    pub local: bool,
}

impl Attempt {
    /// As the case has it.
    pub const FIRST: Attempt = Attempt { other_remesher: false, factor: 1.0, local: false };

    /// The remesher of this attempt, where the case wishes `wished`.
    pub fn remesher(self, wished: Remesher) -> Remesher {
        match (self.other_remesher, wished) {
            (false, r) | (true, r @ Remesher::Improve) => r,
            (true, Remesher::AdvancingFront) => Remesher::Isotropic,
            (true, Remesher::Auto | Remesher::Isotropic) => Remesher::AdvancingFront,
        }
    }
}

const LADDER: [Attempt; 5] = [
    Attempt { other_remesher: false, factor: 0.7, local: true },
    Attempt { other_remesher: true, factor: 1.0, local: false },
    Attempt { other_remesher: false, factor: 0.45, local: true },
    Attempt { other_remesher: false, factor: 0.75, local: false },
    Attempt { other_remesher: true, factor: 0.75, local: false },
];

/// How a surface misses its gates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Faults {
    /// Why there is no surface at all.
    pub refused: Option<String>,
    /// The topology is not that of the polygonized surface, or the surface is not closed.
    pub topology: bool,
    /// Pairs of triangles that cross.
    pub self_intersections: usize,
    /// Triangles at or above the limit of skewness.
    pub above_limit: usize,
    /// Largest skewness.
    pub s_max: f64,
    /// Where, mm; at most a hundred places.
    pub at: Vec<Point>,
}

impl Faults {
    fn none(&self) -> bool {
        self.refused.is_none() && !self.topology && self.self_intersections == 0 && self.above_limit == 0
    }

    /// Less is better.
    fn key(&self) -> (bool, bool, usize, usize) {
        (self.refused.is_some(), self.topology, self.self_intersections, self.above_limit)
    }

    /// Holds `mesh` against the gates; `like` has the topology that it must have.
    fn of(mesh: &TriMesh, like: &topology::TopologyReport, max_skewness: f64) -> Faults {
        let found = topology::check(mesh);
        let crossings = intersect::self_intersections(mesh);
        let s: Vec<f64> = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                shape::skewness(&a, &b, &c)
            })
            .collect();
        let bad: Vec<u32> = (0..s.len() as u32).filter(|&t| s[t as usize] >= max_skewness).collect();
        let center = |t: u32| {
            let [a, b, c] = mesh.corners(t as usize);
            Point::from((a.coords + b.coords + c.coords) / 3.0)
        };
        let at = crossings.iter().flat_map(|&(t, u)| [t, u]).chain(bad.iter().copied()).map(center);
        Faults {
            refused: None,
            topology: !found.is_closed_manifold() || (found.euler, found.components) != (like.euler, like.components),
            self_intersections: crossings.len(),
            above_limit: bad.len(),
            s_max: s.iter().copied().fold(0.0, f64::max),
            at: at.chain(found.first_fault(mesh)).take(100).collect(),
        }
    }
}

/// An attempt and what was still wrong after it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tried {
    /// What was done.
    pub attempt: Attempt,
    /// What was wrong.
    pub faults: Faults,
}

/// Makes a surface with `make` and again until it holds the gates or the ladder ends. `polygons` has the topology
/// that it must have. Gives the best surface and, where the first attempt was not good, all attempts. `stop` is asked
/// before each of them.
///
/// # Errors
/// Where no attempt gives a surface, two meshes in turn have no simple section in an opening's plane, or `stop` said so.
pub fn surface<T>(
    polygons: &TriMesh,
    max_skewness: f64,
    wished: Remesher,
    stop: &Stop,
    make: impl Fn(Attempt, &[Point]) -> Result<(TriMesh, T), super::Error>,
) -> Result<(TriMesh, T, Vec<Tried>), super::Error> {
    let like = topology::check(polygons);
    let mut tried: Vec<Tried> = Vec::new();
    let mut best: Option<(TriMesh, T, Faults)> = None;
    let mut first_error = None;
    // The paper's mesh improvement is what was asked for as it is.
    let more = if wished == Remesher::Improve { &LADDER[..0] } else { &LADDER[..] };
    let mut places: Vec<Point> = Vec::new();
    for attempt in std::iter::once(Attempt::FIRST).chain(more.iter().copied()) {
        if stop() {
            return Err(super::Error::Interrupted);
        }
        let faults = match make(attempt, &places) {
            Ok((mesh, rest)) => {
                let faults = Faults::of(&mesh, &like, max_skewness);
                if best.as_ref().is_none_or(|b| faults.key() < b.2.key()) {
                    best = Some((mesh, rest, faults.clone()));
                }
                faults
            }
            // Another mesh may be cut where this one cannot.
            Err(super::Error::Openings(e @ openings::Error::NotSimple { .. })) => {
                let openings::Error::NotSimple { at, .. } = e else { return Err(e.into()) };
                if first_error.is_some() {
                    // Not the mesh but the section is at fault: another plane is wanted.
                    return Err(super::Error::Openings(e));
                }
                let text = e.to_string();
                first_error = Some(super::Error::Openings(e));
                Faults { refused: Some(text), topology: false, self_intersections: 0, above_limit: 0, s_max: 1.0, at: vec![at] }
            }
            Err(e) => return Err(e),
        };
        let good = faults.none();
        if !faults.at.is_empty() {
            places.clone_from(&faults.at);
        }
        tried.push(Tried { attempt, faults });
        if good {
            break;
        }
    }
    match (best, first_error) {
        (Some((mesh, rest, _)), _) => Ok((mesh, rest, if tried.len() > 1 { tried } else { Vec::new() })),
        (None, Some(e)) => Err(e),
        (None, None) => Err(super::Error::EmptyComponent),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_shapes::sphere;

    fn ball() -> TriMesh {
        sphere(Point::origin(), 1.0, 3)
    }

    /// A closed surface with one triangle of skewness above 0.75.
    fn with_a_sliver() -> TriMesh {
        let mut m = ball();
        m.points[0] = m.points[1] + (m.points[0] - m.points[1]) * 0.05;
        m
    }

    #[test]
    fn a_missed_gate_is_retried_and_reported_and_the_limit_stays() {
        let good = ball();
        let calls = std::cell::RefCell::new(Vec::new());
        let (mesh, (), tried) = surface(&good, 0.75, Remesher::Auto, &|| false, |a, places| {
            calls.borrow_mut().push((a, places.len()));
            Ok((if a.factor < 0.5 { ball() } else { with_a_sliver() }, ()))
        })
        .expect("a surface");
        assert_eq!(mesh, good);
        assert_eq!(tried.len(), 4, "{tried:?}");
        assert!(tried[..3].iter().all(|t| t.faults.above_limit > 0) && tried[3].faults.none());
        // Later attempts know where it was bad.
        assert!(calls.borrow()[0].1 == 0 && calls.borrow()[1].1 > 0);
        assert_eq!(calls.borrow()[2].0.remesher(Remesher::Auto), Remesher::AdvancingFront);
    }

    #[test]
    fn where_nothing_helps_the_best_is_kept_and_the_ladder_ends() {
        let calls = std::cell::Cell::new(0);
        let (mesh, (), tried) = surface(&ball(), 0.75, Remesher::Isotropic, &|| false, |_, _| {
            calls.set(calls.get() + 1);
            Ok((with_a_sliver(), ()))
        })
        .expect("a surface");
        assert_eq!(mesh, with_a_sliver());
        assert_eq!((calls.get(), tried.len()), (1 + LADDER.len(), 1 + LADDER.len()));
    }

    #[test]
    fn an_interrupt_ends_the_ladder_before_its_next_attempt() {
        let calls = std::cell::Cell::new(0);
        let stopped = std::sync::atomic::AtomicBool::new(false);
        let made = surface(&ball(), 0.75, Remesher::Auto, &|| stopped.load(std::sync::atomic::Ordering::Relaxed), |_, _| {
            calls.set(calls.get() + 1);
            stopped.store(calls.get() == 2, std::sync::atomic::Ordering::Relaxed);
            Ok((with_a_sliver(), ()))
        });
        assert!(matches!(made, Err(crate::pipeline::Error::Interrupted)));
        assert_eq!(calls.get(), 2);
    }

    #[test]
    fn a_sound_surface_is_made_once() {
        let (_, (), tried) = surface(&ball(), 0.75, Remesher::Auto, &|| false, |_, _| Ok((ball(), ()))).expect("a surface");
        assert!(tried.is_empty());
    }
}
