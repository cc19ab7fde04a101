//! The names that a case gives to openings and patches: which are allowed, and where they must be known.
//!
//! One rule for all places, since a name becomes a patch of OpenFOAM, a zone of FLUENT (which knows no capital letters)
//! and a file.

use super::case::Case;
use super::openings::Detect;

/// The rule in words.
const RULE: &str = "use lower case letters, digits, `_` and `-`, a letter first, 60 characters at most";

/// Longest name: FLUENT's zones and file systems take no much longer ones.
const LONGEST: usize = 60;

/// Names that are in use: the wall, the cells' and inner faces' zones, the file of the whole surface, OpenFOAM's patch
/// for forgotten faces, and devices of Windows.
const RESERVED: [&str; 11] =
    ["wall", "fluid", "interior-fluid", "interior", "lumen", "defaultfaces", "internalmesh", "con", "prn", "aux", "nul"];

/// Key path and sentence.
type Fault = (String, String);

/// What is wrong with a name; `None` where it may be used.
fn fault(name: &str) -> Option<String> {
    let shown = name.escape_debug();
    if name.is_empty() {
        return Some(format!("the name is empty: {RULE}"));
    }
    let letters = name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '_' | '-'));
    if !letters || !name.starts_with(|c: char| c.is_ascii_lowercase()) || name.len() > LONGEST {
        let fitting = fitting(name).filter(|f| fault(f).is_none());
        let hint = fitting.map(|f| format!(", such as `{f}`")).unwrap_or_default();
        return Some(format!("`{shown}` is no patch name: {RULE}{hint}"));
    }
    let device = |stem: &str| name.strip_prefix(stem).is_some_and(|n| n.len() == 1 && n.chars().all(|c| c.is_ascii_digit()));
    if RESERVED.contains(&name) || device("com") || device("lpt") {
        return Some(format!("the name `{shown}` is reserved: choose another; reserved are {} and the like", RESERVED[..5].join(", ")));
    }
    None
}

/// The nearest name that may be used: `ICA left` becomes `ica_left`.
fn fitting(name: &str) -> Option<String> {
    let low = name.to_lowercase();
    let letters: String = low.chars().map(|c| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') { c } else { '_' }).collect();
    let trimmed = letters.trim_start_matches(|c: char| !c.is_ascii_lowercase()).trim_end_matches('_');
    let short: String = trimmed.chars().take(LONGEST).collect();
    Some(short).filter(|s| !s.is_empty())
}

/// Checks every name of the case: those that are given, those that refer to openings, and that none is there twice.
pub(super) fn check(case: &Case) -> Result<(), Fault> {
    planes(case)?;
    let o = &case.openings;
    let planes = o.planes.iter().enumerate().map(|(n, p)| (format!("openings.planes[{n}].name"), &p.name));
    let renamed = o.rename.iter().enumerate().map(|(n, r)| (format!("openings.rename[{n}].to"), &r.to));
    let patches = case.surface.patches.iter().enumerate().map(|(n, p)| (format!("surface.patches[{n}].name"), &p.name));
    let mut known: Vec<(String, &String)> = Vec::new();
    for (key, name) in planes.chain(renamed).chain(patches) {
        if let Some(fault) = fault(name) {
            return Err((key, fault));
        }
        if let Some((first, _)) = known.iter().find(|k| k.1 == name) {
            return Err((key, format!("`{name}` is there twice, first as {first}: give every opening and patch its own name")));
        }
        known.push((key, name));
    }
    references(case)
}

fn planes(case: &Case) -> Result<(), Fault> {
    for (n, p) in case.openings.planes.iter().enumerate() {
        // Also false for what is no number.
        if !(p.normal.iter().map(|x| x * x).sum::<f64>().sqrt() > 0.0) {
            let what = format!("`{}` has the normal {:?}, which has no direction: give the direction out of the vessel", p.name, p.normal);
            return Err((format!("openings.planes[{n}].normal"), what));
        }
    }
    Ok(())
}

/// Names that refer to openings: the key's path, the name, and the list that they stand in.
fn references(case: &Case) -> Result<(), Fault> {
    let o = &case.openings;
    let mut all: Vec<(String, &str, &str)> = Vec::new();
    let drop = o.drop.iter().enumerate().map(|(n, name)| (format!("openings.drop[{n}]"), name.as_str(), "found"));
    all.extend(drop.chain(o.rename.iter().enumerate().map(|(n, r)| (format!("openings.rename[{n}].from"), r.from.as_str(), "found"))));
    let one = o.inlet.0.len() == 1;
    let inlet = |n: usize| if one { "openings.inlet".to_string() } else { format!("openings.inlet[{n}]") };
    all.extend(o.inlet.0.iter().enumerate().map(|(n, name)| (inlet(n), name.as_str(), "inlet")));
    all.extend(case.extensions.openings.keys().map(|k| (format!("extensions.openings.{k}"), k.as_str(), "extensions")));
    for (key, shares) in case.flow.shares() {
        all.extend(shares.names().map(|k| (format!("{key}.{k}"), k, key)));
    }
    for (n, (key, name, list)) in all.iter().enumerate() {
        if let Some(fault) = fault(name) {
            return Err((key.clone(), fault));
        }
        if let Some((first, ..)) = all[..n].iter().find(|(_, other, of)| (other, of) == (name, list)) {
            return Err((key.clone(), format!("`{name}` stands in {first} already: name it once")));
        }
        // Where nothing is looked for, the planes are all there is.
        let planes = o.planes.iter().map(|p| p.name.as_str()).collect::<Vec<_>>();
        if o.detect == Detect::Off && (*list == "found" || !planes.contains(name)) {
            let known = match (*list, planes.is_empty()) {
                ("found", _) => "no end is looked for (`detect: off`): change the plane itself".into(),
                (_, true) => "there are no planes, and no end is looked for (`detect: off`)".into(),
                _ => format!("there are {}", planes.join(", ")),
            };
            return Err((key.clone(), format!("there is no opening `{name}`: {known}")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::from_text;
    use super::*;

    fn error(rest: &str) -> String {
        let text = format!("input: {{mask: a.nrrd}}\n{rest}\n");
        from_text(&text, "case.yaml", &[]).expect_err(rest).to_string()
    }

    #[test]
    fn what_may_be_a_name() {
        for good in ["a", "ica_left", "m1-2", "inlet_2", "wall_2", "com", "com10", &"x".repeat(60)] {
            assert_eq!(fault(good), None);
        }
        let bad = [
            "", "ICA left", "Outlet_1", "2nd", "_a", "a;b", "$x", "a\"b", "a'b", "../up", "a/b", "a.b", "wall", "fluid", "lumen",
            "defaultFaces", "a\nb", "ä", "nul", "com1", &"x".repeat(61),
        ];
        for bad in bad {
            assert!(fault(bad).is_some(), "{bad}");
        }
        assert!(fault("ICA left").is_some_and(|f| f.contains("such as `ica_left`")));
        assert!(fault("2nd").is_some_and(|f| f.contains("such as `nd`")));
    }

    #[test]
    fn a_bad_name_is_refused_in_its_place_wherever_it_is_given() {
        for (rest, place, words) in [
            ("openings: {rename: [{from: outlet_1, to: \"ICA left\"}]}", ":2:38: ", "lower case"),
            ("openings:\n  rename:\n  - {from: a, to: b}\n  - {from: c, to: wall}", ":5:15: ", "reserved"),
            ("openings:\n- {name: Out, center: [0, 0, 0], normal: [0, 0, 1]}", ":3:4: ", "`out`"),
            ("surface: {patches: [{name: \"../up\", sphere: {center: [0, 0, 0], radius: 1}}]}", ":2:22: ", "no patch name"),
            ("openings: {drop: [outlet_1, \"a b\"]}", ":2:29: ", "no patch name"),
            ("openings: {inlet: [a, \"$b\"]}", ":2:23: ", "no patch name"),
            ("extensions: {openings: {Outlet: {length: 2 D}}}", ":2:25: ", "no patch name"),
            ("flow: {outlets: {split: fractions, fractions: {out_1: 0.5, \"2\": 0.5}}}", ":2:60: ", "no patch name"),
        ] {
            let e = error(rest);
            assert!(e.starts_with(&format!("case.yaml{place}")) && e.contains(words), "{rest}: {e}");
        }
    }

    #[test]
    fn no_name_is_there_twice() {
        let sac = "surface: {patches: [{name: sac, sphere: {center: [0, 0, 0], radius: 1}}]}\n";
        for (rest, words) in [
            (format!("{sac}openings: {{rename: [{{from: outlet_1, to: sac}}]}}"), "first as openings.rename[0].to"),
            ("openings: {rename: [{from: a, to: x}, {from: b, to: x}]}".into(), "first as openings.rename[0].to"),
            ("openings: {rename: [{from: a, to: x}, {from: a, to: y}]}".into(), "openings.rename[0].from already"),
            ("openings: {drop: [a], rename: [{from: a, to: x}]}".into(), "openings.drop[0] already"),
            ("openings: {inlet: [a, a]}".into(), "openings.inlet[0] already"),
        ] {
            let e = error(&rest);
            assert!(e.contains(words), "{rest}: {e}");
        }
    }

    #[test]
    fn without_detection_unknown_names_are_refused_at_once() {
        let planes = "openings: {detect: off, planes: [{name: inlet, center: [0, 0, 0], normal: [0, 0, 1]}], inlet: b}";
        assert!(error(planes).contains("there are inlet"), "{}", error(planes));
        let planes = "openings: [{name: inlet, center: [0, 0, 0], normal: [0, 0, 1]}]\nextensions: {openings: {out: {length: 1 D}}}";
        let e = error(planes);
        assert!(e.starts_with("case.yaml:3:25: ") && e.contains("no opening `out`"), "{e}");
    }
}
