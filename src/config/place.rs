//! Where things stand in a case file: the YAML as a tree of values with their lines and columns.

use std::fmt;

use serde::{Deserialize, Deserializer, de};
use serde_saphyr::Spanned;

/// A value and where it begins.
type Node = Spanned<Kind>;

/// A value of a case file.
enum Kind {
    /// A text, number or truth value as text.
    Leaf(String),
    /// A list.
    List(Vec<Node>),
    /// Keys and values in the order of the file.
    Map(Vec<(Spanned<String>, Node)>),
}

impl<'de> Deserialize<'de> for Kind {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Any;
        impl<'de> de::Visitor<'de> for Any {
            type Value = Kind;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("any value")
            }
            fn visit_bool<E: de::Error>(self, v: bool) -> Result<Kind, E> {
                Ok(Kind::Leaf(v.to_string()))
            }
            fn visit_i64<E: de::Error>(self, v: i64) -> Result<Kind, E> {
                Ok(Kind::Leaf(v.to_string()))
            }
            fn visit_u64<E: de::Error>(self, v: u64) -> Result<Kind, E> {
                Ok(Kind::Leaf(v.to_string()))
            }
            fn visit_f64<E: de::Error>(self, v: f64) -> Result<Kind, E> {
                Ok(Kind::Leaf(v.to_string()))
            }
            fn visit_str<E: de::Error>(self, v: &str) -> Result<Kind, E> {
                Ok(Kind::Leaf(v.into()))
            }
            fn visit_unit<E: de::Error>(self) -> Result<Kind, E> {
                Ok(Kind::Leaf(String::new()))
            }
            fn visit_none<E: de::Error>(self) -> Result<Kind, E> {
                Ok(Kind::Leaf(String::new()))
            }
            fn visit_some<D: Deserializer<'de>>(self, d: D) -> Result<Kind, D::Error> {
                Kind::deserialize(d)
            }
            fn visit_seq<A: de::SeqAccess<'de>>(self, mut seq: A) -> Result<Kind, A::Error> {
                let mut list = Vec::new();
                while let Some(node) = seq.next_element()? {
                    list.push(node);
                }
                Ok(Kind::List(list))
            }
            fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<Kind, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Kind::Map(entries))
            }
        }
        d.deserialize_any(Any)
    }
}

/// Line and column, from 1.
fn place<T>(node: &Spanned<T>) -> Option<(usize, usize)> {
    let at = &node.referenced;
    (at.line() > 0).then(|| (at.line() as usize, at.column() as usize))
}

/// Line and column (from 1) of what `path` (`surface.refine[1].box`) ends in: a key, or an entry of a list.
pub fn locate(text: &str, path: &str) -> Option<(usize, usize)> {
    let root: Node = serde_saphyr::from_str(text).ok()?;
    find(&root, path)
}

fn find(node: &Node, path: &str) -> Option<(usize, usize)> {
    match &node.value {
        Kind::Leaf(_) => None,
        Kind::List(list) => {
            let (index, rest) = path.strip_prefix('[')?.split_once(']')?;
            let entry = list.get(index.parse::<usize>().ok()?)?;
            if rest.is_empty() { place(entry) } else { find(entry, rest.trim_start_matches('.')) }
        }
        // Keys may hold dots and brackets: the one that fits the path is meant.
        Kind::Map(entries) => entries.iter().find_map(|(key, value)| {
            let rest = path.strip_prefix(key.value.as_str())?;
            match rest.chars().next() {
                None => place(key),
                Some('.') => find(value, &rest[1..]),
                Some('[') => find(value, rest),
                Some(_) => None,
            }
        }),
    }
}

/// Line and column (from 1) where a case file names an opening or a part of the wall.
pub fn place_of_opening(text: &str, name: &str) -> Option<(usize, usize)> {
    let root: Node = serde_saphyr::from_str(text).ok()?;
    let Kind::Map(sections) = &root.value else { return None };
    let sections = sections.iter().filter(|(key, _)| matches!(key.value.as_str(), "openings" | "extensions" | "flow" | "surface"));
    sections.filter_map(|(_, section)| named(section, name, false)).next()
}

/// `keys_are_names`: the keys of this mapping are names of openings, as under `extensions.openings`.
fn named(node: &Node, name: &str, keys_are_names: bool) -> Option<(usize, usize)> {
    match &node.value {
        Kind::Leaf(text) => place(node).filter(|_| text == name),
        Kind::List(list) => list.iter().find_map(|n| named(n, name, false)),
        Kind::Map(entries) => entries.iter().find_map(|(key, value)| {
            let own = key.value == name && keys_are_names;
            let below = matches!(key.value.as_str(), "openings" | "fractions" | "resistances");
            place(key).filter(|_| own).or_else(|| named(value, name, below))
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_one_inside_the_other() {
        let text = "input: {mask: a.nrrd}\n# surface: no\nvolume:\n  growth: 2\nsurface:\n  growth: 9 # growth: 1\n";
        assert_eq!(locate(text, "volume.growth"), Some((4, 3)));
        assert_eq!(locate(text, "surface.growth"), Some((6, 3)));
        assert_eq!(locate("surface: {scale: 9}", "surface.scale"), Some((1, 11)));
        assert_eq!(locate(text, "gates.max_distance"), None);
        let list = "openings:\n- {name: a}\n- {name: b}\n";
        assert_eq!(locate(list, "openings[1]"), Some((3, 3)));
        assert_eq!(locate(list, "openings[1].name"), Some((3, 4)));
    }

    #[test]
    fn entries_of_lists_are_found_in_every_spelling() {
        let flow = "openings: {rename: [{from: a, to: b}, {from: c, to: d}], drop: [e, f]}\n";
        assert_eq!(locate(flow, "openings.rename[1].to"), Some((1, 49)));
        assert_eq!(locate(flow, "openings.drop[1]"), Some((1, 68)));
        let keys = "extensions:\n  openings:\n    \"a.b c\": {length: 1 D}\n";
        assert_eq!(locate(keys, "extensions.openings.a.b c"), Some((3, 5)));
    }

    #[test]
    fn the_place_of_an_opening_is_found_in_every_spelling() {
        let text = "input: {mask: inlet.nrrd}\nopenings:\n- name: inlet # the outlet\n  center: [1, 2, 3]\n\
            - {name: \"outlet\", center: [0, 0, 0]}\nextensions:\n  openings: {side: {length: 3 D}}\n\
            flow: {outlets: {fractions: {far: 1}}}\n";
        let places = ["inlet", "outlet", "side", "far", "let"].map(|name| place_of_opening(text, name));
        assert_eq!(places, [Some((3, 9)), Some((5, 10)), Some((7, 14)), Some((8, 30)), None]);
        let keys = "openings: {drop: [x]}\nextensions: {openings: {inlet: {length: 3 D}}}\n";
        assert_eq!(place_of_opening(keys, "inlet"), Some((2, 25)));
    }
}
