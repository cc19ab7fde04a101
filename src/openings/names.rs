//! Names and numbers of openings, the same from run to run and from mesh size to mesh size.
//!
//! Within a component the largest section of the mask is `inlet`; the others are `outlet_1`, `outlet_2`… by falling
//! section area, ties by position. The openings of the second component are `c2_inlet`, `c2_outlet_1`… and so on.
//! Ids: the wall is 1, then all inlets, then all outlets, each by component and then by area.

use std::cmp::Ordering;

use super::Opening;
use crate::mesh::{PatchKind, WALL};

/// An opening with the area of the mask's section in its plane.
pub(super) struct Sized {
    pub opening: Opening,
    pub area: f64,
    /// Named by the user: keeps its name.
    pub fixed: bool,
}

fn order(a: &Sized, b: &Sized) -> Ordering {
    let place = |s: &Sized| {
        let p = s.opening.plane.origin;
        [p.x, p.y, p.z]
    };
    a.opening.component.cmp(&b.opening.component).then(b.area.total_cmp(&a.area)).then_with(|| {
        let (p, q) = (place(a), place(b));
        (0..3).map(|i| p[i].total_cmp(&q[i])).find(|o| o.is_ne()).unwrap_or(Ordering::Equal)
    })
}

/// Makes the largest section of every component that has no inlet its inlet.
pub(super) fn choose_inlets(list: &mut [Sized]) {
    list.sort_by(order);
    let mut n = 0;
    while n < list.len() {
        let component = list[n].opening.component;
        let end = n + list[n..].iter().take_while(|s| s.opening.component == component).count();
        let group = &mut list[n..end];
        if group.iter().all(|s| s.opening.kind != PatchKind::Inlet) {
            // A plane that the user calls an outlet stays one while there is another.
            let first = group.iter().position(|s| !s.fixed).or(None);
            if let Some(first) = first {
                group[first].opening.kind = PatchKind::Inlet;
            }
        }
        n = end;
    }
}

/// Gives every opening its name and id; they come back by id.
pub(super) fn assign(mut list: Vec<Sized>) -> Vec<Opening> {
    list.sort_by(order);
    let taken: Vec<String> = list.iter().filter(|s| s.fixed).map(|s| s.opening.name.clone()).collect();
    let mut out = Vec::with_capacity(list.len());
    let mut id = WALL;
    for kind in [PatchKind::Inlet, PatchKind::Outlet] {
        let mut counter = (u32::MAX, 0);
        for s in list.iter().filter(|s| s.opening.kind == kind) {
            let mut o = s.opening.clone();
            id += 1;
            o.id = id;
            if counter.0 != o.component {
                counter = (o.component, 0);
            }
            if !s.fixed {
                loop {
                    counter.1 += 1;
                    o.name = name(kind, o.component, counter.1);
                    if !taken.contains(&o.name) {
                        break;
                    }
                }
            }
            out.push(o);
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
