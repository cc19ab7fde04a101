//! What the user says of the names of openings: which to drop, other names, which are inlets.

use super::names::{self, Sized};
use super::user::{UserError, UserOpenings};
use super::Opening;
use crate::mesh::PatchKind;

fn unknown(name: &str, wish: &'static str, list: &[Sized]) -> UserError {
    let names: Vec<&str> = list.iter().map(|s| s.opening.name.as_str()).collect();
    let known = if names.is_empty() { "none was found".into() } else { format!("there are {}", names.join(", ")) };
    UserError::UnknownName { name: name.into(), wish, known }
}

fn position(list: &[Sized], name: &str, wish: &'static str) -> Result<usize, UserError> {
    list.iter().position(|s| s.opening.name == name).ok_or_else(|| unknown(name, wish, list))
}

/// Takes out what is to be dropped, and gives the others the names that the user has for them, all at once.
pub(super) fn drop_and_rename(list: &mut Vec<Sized>, user: &UserOpenings) -> Result<(), UserError> {
    for name in &user.drop {
        let n = position(list, name, "drop")?;
        list.remove(n);
    }
    let places: Result<Vec<usize>, _> = user.rename.iter().map(|(from, _)| position(list, from, "rename")).collect();
    for (n, (_, to)) in places?.into_iter().zip(&user.rename) {
        let s = &mut list[n];
        s.opening.kind = names::kind_of(to).unwrap_or(s.opening.kind);
        s.opening.name = to.clone();
        s.fixed = true;
    }
    Ok(())
}

/// Names of the openings whose kind the user's name gives.
pub(super) fn given(list: &[Sized]) -> Vec<String> {
    let said = list.iter().filter(|s| s.fixed && names::kind_of(&s.opening.name).is_some());
    said.map(|s| s.opening.name.clone()).collect()
}

/// The inlets that the user names displace those that were guessed in their components; a component without any gets
/// its largest opening. `given` names the openings whose kind the user gave.
pub(super) fn settle_inlets(
    list: &mut [Sized],
    user: &UserOpenings,
    given: &[String],
    warnings: &mut Vec<String>,
) -> Result<(), UserError> {
    let named: Result<Vec<usize>, _> = user.inlets.iter().map(|name| position(list, name, "make the inlet")).collect();
    let mut inlets = named?;
    let is_given = |s: &Sized| given.contains(&s.opening.name);
    let displaces: Vec<u32> = inlets.iter().map(|&n| list[n].opening.component).collect();
    // Where the inlets are listed, the list is all there is.
    let by_name = |s: &Sized| s.opening.kind == PatchKind::Inlet && is_given(s) && !displaces.contains(&s.opening.component);
    inlets.extend(list.iter().enumerate().filter(|(_, s)| by_name(s)).map(|(n, _)| n));
    let components: Vec<u32> = inlets.iter().map(|&n| list[n].opening.component).collect();
    for (n, s) in list.iter_mut().enumerate().filter(|(_, s)| components.contains(&s.opening.component)) {
        let inlet = inlets.contains(&n);
        if s.fixed && !inlet && s.opening.kind == PatchKind::Inlet {
            warnings.push(format!(
                "opening `{}` is an outlet, since other inlets are given: name it under openings.inlet too where it is one",
                s.opening.name
            ));
        }
        s.opening.kind = if inlet { PatchKind::Inlet } else { PatchKind::Outlet };
    }
    warnings.extend(names::choose_inlets(list));
    Ok(())
}

/// The openings, all of different names.
pub(super) fn distinct(openings: Vec<Opening>) -> Result<Vec<Opening>, UserError> {
    for (n, o) in openings.iter().enumerate() {
        if let Some(other) = openings[..n].iter().find(|p| p.name == o.name) {
            let places = [other.plane.origin.into(), o.plane.origin.into()];
            return Err(UserError::SameName { name: o.name.clone(), places });
        }
    }
    Ok(openings)
}
