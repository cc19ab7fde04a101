//! The YAML reader's errors in the words of a person who writes a case file.

/// The file's first line, where the whole file is to blame.
pub(super) const SMALLEST: &str = "the smallest case is `input: {mask: vessel.nrrd}`";

/// What is wrong at `column` (from 1) of `line`, what is expected there, and the nearest valid key.
pub(super) fn explain(message: &str, line: &str, column: usize) -> String {
    let key = key_before(line, column);
    let value = word_at(line, column);
    let of = |sentence: String| match &key {
        Some(k) => format!("`{k}`: {sentence}"),
        None => sentence,
    };
    if let Some(name) = message.strip_prefix("duplicate mapping key: ") {
        let name = name.split(',').next().unwrap_or(name);
        return format!("`{name}` is given a second time in this section: keep one of the two");
    }
    if message.starts_with("unknown field `fill_cavities`") {
        return "unknown key `fill_cavities`: enclosed cavities are always filled, since a lumen has none; take the key out".into();
    }
    if let Some(rest) = message.strip_prefix("unknown field ") {
        return unknown("key", rest);
    }
    if let Some(rest) = message.strip_prefix("unknown variant ") {
        return of(unknown("value", rest));
    }
    if let Some(name) = message.strip_prefix("missing field ") {
        let example = if name == "`input`" { format!(": {SMALLEST}") } else { String::new() };
        return format!("the key {name} is missing{example}");
    }
    if let Some(rest) = message.strip_prefix("invalid length ") {
        return of(match rest.split_once(", expected an array of length ") {
            Some((is, wanted)) => format!("{is} values where {wanted} belong"),
            None => message.into(),
        });
    }
    if let Some(rest) = message.strip_prefix("invalid type: ").or(message.strip_prefix("invalid value: ")) {
        return of(mistyped(rest));
    }
    match message {
        "unexpected end of input" => format!("the file is empty: {SMALLEST}"),
        "expected mapping start" | "expected mapping" => match &key {
            Some(k) => format!("`{k}` is a section with keys of its own: write `{k}: {{key: value}}`; `lumenmesh reference` lists its keys"),
            None => format!("a case file consists of keys and values: {SMALLEST}"),
        },
        "expected sequence start" | "expected sequence" => of("takes a list: write `[first, second]`".into()),
        m if m.starts_with("invalid") && (m.contains("integer") || is_integer(m)) => of(format!("`{value}` is not a whole number in range")),
        m if m.starts_with("invalid") && (m.contains("floating point") || m.contains("number")) => of(format!("`{value}` is not a number")),
        m if m.starts_with("invalid") && m.contains("bool") => of(format!("`{value}` is neither `true` nor `false`")),
        m if m.starts_with("data did not match any variant") => of("takes one value or a list, such as `1` or `[1, 4]`".into()),
        m if m.starts_with("tabs disallowed") => "this line is indented with a tab: YAML wants spaces".into(),
        m if m.contains("did not find expected") => {
            format!("the YAML breaks off here ({m}): look for a bracket that is not closed, a comma or a colon, here or on the line before")
        }
        m => of(m.into()).trim_start_matches("``: ").to_string(),
    }
}

/// Whether the message ends in the name of an integer type, as in `invalid u32`.
fn is_integer(message: &str) -> bool {
    let word = message.rsplit(' ').next().unwrap_or_default();
    matches!(word.trim_start_matches(['u', 'i']), "8" | "16" | "32" | "64" | "128" | "size")
}

/// `string "big", expected f64` in words.
fn mistyped(rest: &str) -> String {
    let (is, wanted) = rest.rsplit_once(", expected ").unwrap_or((rest, "something else"));
    let wanted = match wanted {
        "f64" | "f32" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0 up",
        "i64" => "a whole number",
        "a boolean" => "`true` or `false`",
        w if w.starts_with("struct") => "a section with keys of its own",
        w => w,
    };
    let is = is.split_once(' ').map_or(is, |(kind, value)| if value.contains(['"', '`']) { value } else { kind });
    let is = is.trim_start_matches("point ");
    format!("{} is given where {wanted} belongs", is.replace('"', "`"))
}

/// `serde`'s list of what is expected, after the wrong name.
fn unknown(what: &str, rest: &str) -> String {
    let (wrong, tail) = rest.split_once(", expected ").unwrap_or((rest, ""));
    let wrong = wrong.trim_matches('`');
    let separators = |c: char| !(c.is_alphanumeric() || matches!(c, '_' | '-'));
    let valid: Vec<&str> = tail.trim_start_matches("one of").split(separators).filter(|v| !v.is_empty()).collect();
    let hint = match nearest(wrong, &valid) {
        Some(n) => format!("; did you mean `{n}`?"),
        None => String::new(),
    };
    format!("unknown {what} `{wrong}`{hint} Valid here: {}", valid.join(", ")).replacen("` Valid", "`. Valid", 1)
}

/// The valid name that `wrong` is most likely meant to be.
pub(super) fn nearest<'a>(wrong: &str, valid: &[&'a str]) -> Option<&'a str> {
    let wrong = wrong.to_lowercase();
    let begins = |v: &&&str| wrong.len() >= 3 && (v.starts_with(&wrong) || wrong.starts_with(**v));
    let closest = valid.iter().min_by_key(|v| edit_distance(&wrong, v)).copied();
    closest.filter(|n| edit_distance(&wrong, n) <= 1 + wrong.len() / 3).or(valid.iter().find(begins).copied())
}

fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let next = (diagonal + usize::from(ca != *cb)).min(row[j] + 1).min(row[j + 1] + 1);
            diagonal = row[j + 1];
            row[j + 1] = next;
        }
    }
    row[b.len()]
}

fn head(line: &str, column: usize) -> String {
    line.chars().take(column.saturating_sub(1)).collect()
}

/// The key whose value stands at the column.
fn key_before(line: &str, column: usize) -> Option<String> {
    let here: String = line.chars().skip(column.saturating_sub(1)).take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    let head = head(line, column);
    // The place may be the key itself.
    if !here.is_empty() && line[head.len() + here.len()..].starts_with(':') {
        return Some(here);
    }
    let before = head.trim_end().trim_end_matches(['[', '{', '"', '\'', ' ']);
    let before = match before.rfind('[') {
        // Inside a list: its key stands before the bracket.
        Some(at) if !before[at..].contains(':') => before[..at].trim_end(),
        _ => before,
    };
    let name = before.trim_end().strip_suffix(':')?;
    let start = name.rfind(|c: char| !(c.is_alphanumeric() || matches!(c, '_' | '-'))).map_or(0, |i| i + 1);
    Some(name[start..].to_string()).filter(|n| !n.is_empty())
}

/// The word that begins at the column.
fn word_at(line: &str, column: usize) -> String {
    let rest: String = line.chars().skip(column.saturating_sub(1)).collect();
    rest.split([',', '}', ']', '#']).next().unwrap_or_default().trim().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beginning_is_enough_to_guess_a_value() {
        assert_eq!(nearest("advancing", &["auto", "advancing-front"]), Some("advancing-front"));
        assert_eq!(nearest("edge_lenght", &["edges_around", "edge_length"]), Some("edge_length"));
        assert_eq!(nearest("xyz", &["auto", "off"]), None);
    }
}
