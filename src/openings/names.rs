//! Names and numbers of openings, the same from run to run and from mesh size to mesh size.
//!
//! Within a component the vessel with the largest section square to its axis is `inlet`; the others are `outlet_1`,
//! `outlet_2`… by falling section. Sections that differ by less than a tenth count as equal for the inlet, by less than
//! a hundredth for the order: then the end farther towards the feet comes first, then the one farther to the back, then the
//! one farther to the left, so that resolution, reflection and the order of the axes change nothing. The openings of the
//! second component are `c2_inlet`, `c2_outlet_1`… and so on.
//! A name that the user did not touch stays with its vessel, whatever becomes of the others: numbers are not closed up.
//! Ids: the wall is 1, then all inlets, then all outlets, each by component and then by area.

use std::cmp::Ordering;

use super::Opening;
use crate::mesh::{PatchKind, WALL};

/// An opening on its way to its name.
pub(super) struct Sized {
    pub opening: Opening,
    /// Named by the user: keeps its name.
    pub fixed: bool,
}

impl Sized {
    fn area(&self) -> f64 {
        self.opening.support.square_area
    }
}

/// Sections that differ by less count as equal where the inlet is chosen.
const CLOSE: f64 = 0.1;
/// The same in the order of names.
const EQUAL: f64 = 0.01;
/// Positions that differ by less than this many radii count as equal.
const BESIDE: f64 = 0.25;

/// Which of two ends comes first by position: farther down, then back, then left, in the patient's own axes (LPS).
fn by_position(a: &Opening, b: &Opening) -> Ordering {
    let (p, q) = (a.plane.origin, b.plane.origin);
    let near = BESIDE * a.radius.min(b.radius);
    let steps = [p.z - q.z, q.y - p.y, q.x - p.x];
    let first = steps.into_iter().find(|d| d.abs() > near).unwrap_or(0.0);
    first.total_cmp(&0.0)
}

/// Components in turn, each by falling section; ends of equal sections by position.
fn sort(list: &mut [Sized]) {
    let exact = |s: &Sized| {
        let p = s.opening.plane.origin;
        [p.z, p.y, p.x]
    };
    let place = |a: &Sized, b: &Sized| exact(a).iter().zip(exact(b)).map(|(p, q)| p.total_cmp(&q)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal);
    list.sort_by(|a, b| a.opening.component.cmp(&b.opening.component).then(b.area().total_cmp(&a.area())).then_with(|| place(a, b)));
    // Neighbours in the order whose sections are equal: a group is all within the tolerance of its first.
    let mut n = 0;
    while n < list.len() {
        let first = (list[n].opening.component, list[n].area());
        let alike = |s: &&Sized| s.opening.component == first.0 && s.area() > (1.0 - EQUAL) * first.1;
        let end = n + list[n..].iter().take_while(alike).count().max(1);
        // One after the other: an order with a tolerance is none that can be sorted by.
        for at in n..end {
            let first = (at..end).min_by(|&i, &j| by_position(&list[i].opening, &list[j].opening)).unwrap_or(at);
            list[at..=first].rotate_right(1);
        }
        n = end;
    }
}

/// Makes the largest vessel of every component that has no inlet its inlet; says where that was a close choice.
pub(super) fn choose_inlets(list: &mut [Sized]) -> Vec<String> {
    sort(list);
    let mut notes = Vec::new();
    let mut n = 0;
    while n < list.len() {
        let component = list[n].opening.component;
        let end = n + list[n..].iter().take_while(|s| s.opening.component == component).count();
        let group = &mut list[n..end];
        n = end;
        if group.iter().any(|s| s.opening.kind == PatchKind::Inlet) {
            continue;
        }
        // A plane that the user calls an outlet stays one while there is another.
        let free: Vec<usize> = (0..group.len()).filter(|&i| !group[i].fixed).collect();
        let largest = free.iter().map(|&i| group[i].area()).fold(0.0, f64::max);
        let close: Vec<usize> = free.into_iter().filter(|&i| group[i].area() > (1.0 - CLOSE) * largest).collect();
        let Some(&chosen) = close.iter().min_by(|&&a, &&b| by_position(&group[a].opening, &group[b].opening)) else { continue };
        group[chosen].opening.kind = PatchKind::Inlet;
        if close.len() > 1 {
            let at = |s: &Sized| {
                let p = s.opening.plane.origin;
                format!("({:.1}, {:.1}, {:.1}) of {:.2} mm2", p.x, p.y, p.z, s.area())
            };
            let others: Vec<String> = close.iter().filter(|&&i| i != chosen).map(|&i| at(&group[i])).collect();
            notes.push(format!(
                "the inlet was a close choice: {} was taken as the end farthest towards the feet, beside {}; openings.inlet names another",
                at(&group[chosen]),
                others.join(", ")
            ));
        }
    }
    notes
}

/// Inlet or outlet, where a name says so: `inlet…`, `outlet…`, with or without the component's `c2_`.
pub(super) fn kind_of(name: &str) -> Option<PatchKind> {
    let component = name.strip_prefix('c').and_then(|n| n.split_once('_')).filter(|(n, _)| n.bytes().all(|b| b.is_ascii_digit()));
    let own = component.map_or(name, |(_, own)| own);
    match own {
        n if n.starts_with("inlet") => Some(PatchKind::Inlet),
        n if n.starts_with("outlet") => Some(PatchKind::Outlet),
        _ => None,
    }
}

/// Gives found openings their names and ids; they come back by id.
pub(super) fn assign(mut list: Vec<Sized>) -> Vec<Opening> {
    sort(&mut list);
    let mut taken: Vec<String> = list.iter().filter(|s| s.fixed).map(|s| s.opening.name.clone()).collect();
    for s in list.iter_mut().filter(|s| !s.fixed) {
        s.opening.name = free(s.opening.kind, s.opening.component, &taken);
        taken.push(s.opening.name.clone());
    }
    numbered(list)
}

/// Ids for openings that have their names; only names that contradict what the opening has become are replaced: by
/// one that is free and that no opening of `found` had.
pub(super) fn keep(mut list: Vec<Sized>, found: &[String]) -> Vec<Opening> {
    sort(&mut list);
    let contradicts = |s: &Sized| !s.fixed && kind_of(&s.opening.name).is_some_and(|kind| kind != s.opening.kind);
    let mut taken: Vec<String> = list.iter().filter(|s| !contradicts(s)).map(|s| s.opening.name.clone()).collect();
    for s in list.iter_mut().filter(|s| contradicts(s)) {
        let new = match s.opening.kind {
            // Who makes an end the inlet wants it called so.
            PatchKind::Inlet => free(s.opening.kind, s.opening.component, &taken),
            _ => free(s.opening.kind, s.opening.component, &[&taken[..], found].concat()),
        };
        taken.push(new.clone());
        s.opening.name = new;
    }
    numbered(list)
}

/// The first name of its kind that is not taken.
fn free(kind: PatchKind, component: u32, taken: &[String]) -> String {
    let mut number = 1;
    loop {
        let name = name(kind, component, number);
        if !taken.contains(&name) {
            return name;
        }
        number += 1;
    }
}

/// The openings of an ordered list with their ids: inlets, then outlets.
fn numbered(list: Vec<Sized>) -> Vec<Opening> {
    let mut out = Vec::with_capacity(list.len());
    let mut id = WALL;
    for kind in [PatchKind::Inlet, PatchKind::Outlet] {
        for s in list.iter().filter(|s| s.opening.kind == kind) {
            id += 1;
            out.push(Opening { id, ..s.opening.clone() });
        }
    }
    out
}

fn name(kind: PatchKind, component: u32, number: u32) -> String {
    let prefix = if component == 0 { String::new() } else { format!("c{}_", component + 1) };
    match kind {
        PatchKind::Inlet if number == 1 => format!("{prefix}inlet"),
        PatchKind::Inlet => format!("{prefix}inlet_{number}"),
        _ => format!("{prefix}outlet_{number}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Plane;
    use crate::openings::FoundBy;

    fn found(component: u32, areas: &[f64]) -> Vec<Sized> {
        let one = |(n, area): (usize, &f64)| {
            let plane = Plane::new([n as f64, 0.0, 0.0].into(), [0.0, 0.0, 1.0].into()).expect("a plane");
            let opening = Opening {
                id: 0,
                name: String::new(),
                kind: PatchKind::Outlet,
                plane,
                radius: 1.0,
                support: crate::openings::Support { square_area: *area, ..crate::openings::Support::round(&plane, 1.0) },
                found_by: FoundBy::BluntEnd,
                confidence: 1.0,
                component,
            };
            Sized { opening, fixed: false }
        };
        areas.iter().enumerate().map(one).collect()
    }

    fn names(openings: &[Opening]) -> Vec<(&str, u32)> {
        openings.iter().map(|o| (o.name.as_str(), o.id)).collect()
    }

    #[test]
    fn found_openings_are_named_by_falling_area_within_their_component() {
        let mut list = found(0, &[3.0, 9.0, 5.0]);
        list.extend(found(1, &[1.0, 2.0]));
        choose_inlets(&mut list);
        let expected = [("inlet", 2), ("c2_inlet", 3), ("outlet_1", 4), ("outlet_2", 5), ("c2_outlet_1", 6)];
        assert_eq!(names(&assign(list)), expected);
    }

    #[test]
    fn a_name_says_what_an_opening_is() {
        let kinds = ["inlet", "inlet_left", "c12_inlet", "c2_outlet_1", "outlet", "carotid_inlet", "va"].map(kind_of);
        let (i, o) = (Some(PatchKind::Inlet), Some(PatchKind::Outlet));
        assert_eq!(kinds, [i, i, i, o, o, None, None]);
    }

    #[test]
    fn only_what_contradicts_its_name_is_named_anew() {
        let mut list = found(0, &[9.0, 5.0, 4.0, 3.0]);
        for (s, name) in list.iter_mut().zip(["inlet", "outlet_1", "outlet_2", "outlet_3"]) {
            s.opening.name = name.into();
        }
        let before: Vec<String> = list.iter().map(|s| s.opening.name.clone()).collect();
        list.remove(2);
        // outlet_1 has become the inlet.
        list[1].opening.kind = PatchKind::Inlet;
        assert_eq!(names(&keep(list, &before)), [("inlet", 2), ("outlet_4", 3), ("outlet_3", 4)]);
    }
}
