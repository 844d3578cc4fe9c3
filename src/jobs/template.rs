//! Patterns of image names with fields in braces, as in `{scene}.{frame:04}.png`.

use std::path::{Component, Path, PathBuf};

/// Largest width of a zero-padded field; u64 has 20 digits, and more is a typing error.
const MAX_DIGITS: usize = 18;

/// Parsed pattern: literal text alternating with fields.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Template(Vec<Segment>);

#[derive(Clone, Debug, PartialEq)]
enum Segment {
    Text(String),
    /// Name of a field and its minimum number of digits.
    Field(String, usize),
}

impl Template {
    /// Parses a pattern, in which only the fields `known` may occur.
    pub(super) fn parse(text: &str, known: &[&str]) -> Result<Template, String> {
        let mut segments = Vec::new();
        let mut rest = text;
        // Split at each `{name:width}`
        while let Some((before, after)) = rest.split_once('{') {
            let (field, after) = after.split_once('}').ok_or("has a `{` without a `}`: close it")?;
            let (name, width) = field.split_once(':').unwrap_or((field, "0"));
            let width: usize = width
                .parse()
                .ok()
                .filter(|&width| width <= MAX_DIGITS)
                .ok_or_else(|| format!("has `{{{field}}}`: give a number of digits, as in {{frame:04}}"))?;
            if !known.contains(&name) {
                let known = known.join("}, {");
                return Err(format!(
                    "has an unknown field `{{{name}}}`: the fields are {{{known}}}"
                ));
            }
            segments.push(Segment::Text(before.to_owned()));
            segments.push(Segment::Field(name.to_owned(), width));
            rest = after;
        }
        segments.push(Segment::Text(rest.to_owned()));
        // Check the path with a harmless value for every field
        let template = Template(segments);
        check_path(&template.name(|_| "x".to_owned()))?;
        Ok(template)
    }

    /// Returns the name with the values of its fields substituted.
    pub(super) fn name(&self, value: impl Fn(&str) -> String) -> PathBuf {
        let mut name = String::new();
        for piece in &self.0 {
            match piece {
                Segment::Text(text) => name.push_str(text),
                Segment::Field(field, width) => name.push_str(&zero_padded(&safe(&value(field)), *width)),
            }
        }
        PathBuf::from(name)
    }
}

/// Returns a value without characters that would create folders or refer to `.` and `..`.
fn safe(value: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "-_+.,=@ ".contains(c);
    let plain: String = value.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    match plain.trim_matches('.') {
        "" => "_".into(),
        _ => plain,
    }
}

/// Returns a number with leading zeros, up to `width` digits; other values unchanged.
fn zero_padded(value: &str, width: usize) -> String {
    match value.parse::<u64>() {
        Ok(number) => format!("{number:0width$}"),
        Err(_) => value.to_owned(),
    }
}

/// Rejects names that lead out of the output folder.
fn check_path(path: &Path) -> Result<(), String> {
    let stays = path.components().all(|part| matches!(part, Component::Normal(_)));
    match stays && path.file_name().is_some() {
        true => Ok(()),
        false => {
            Err("is a path outside the output folder: give one without `..` and without a leading `/`".into())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: [&str; 3] = ["scene", "frame", "rough"];

    #[test]
    fn fields_are_replaced_by_their_values() {
        let template = Template::parse("{scene}/a.{frame:04}.{rough}.png", &KNOWN).unwrap();
        let name = template.name(|field| match field {
            "scene" => "../b c".into(),
            "frame" => "7".into(),
            _ => "0.25".into(),
        });
        assert_eq!(name, Path::new(".._b c/a.0007.0.25.png"));
    }

    #[test]
    fn values_create_no_folders() {
        assert_eq!([".", "..", "a/b", ""].map(safe), ["_", "_", "a_b", "_"]);
        // A number too long for u64 stays unchanged.
        assert_eq!(zero_padded("123456789012345678901", 4), "123456789012345678901");
    }

    #[test]
    fn invalid_patterns_are_rejected() {
        for (bad, word) in [
            ("{scene", "close it"),
            ("{hue}.png", "unknown field `{hue}`"),
            ("{frame:x}.png", "digits"),
            ("{frame:99}.png", "digits"),
            ("../{scene}.png", "outside the output folder"),
            ("/tmp/{scene}.png", "outside the output folder"),
        ] {
            let message = Template::parse(bad, &KNOWN).unwrap_err();
            assert!(message.contains(word), "{bad}: {message}");
        }
    }
}
