//! Diagnostics of scene files: location, item and remedy.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use super::node::{TomlError, from_text};
use super::value::Located;

/// Reason why a scene file could not become a scene: one sentence with the file, the position, the item and the remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneFileError {
    /// A fault of the file as a whole.
    #[error("{}: {fault}", .file.display())]
    File {
        /// Path of the scene file.
        file: PathBuf,
        /// Description of the fault and its remedy.
        fault: String,
    },
    /// A fault of one item in the file.
    #[error("{}:{line}:{column}: {item}: {fault}", .file.display())]
    Item {
        /// Path of the scene file.
        file: PathBuf,
        /// Line of the item, counted from 1.
        line: usize,
        /// Column of the item in characters, counted from 1.
        column: usize,
        /// Keys that lead to the item, as in `material.glass.ior`; elements of lists are counted from 1.
        item: String,
        /// Description of the fault and its remedy.
        fault: String,
    },
}

/// A fault at a position of some file.
#[derive(Clone, Debug)]
pub(crate) struct Diagnostic {
    span: Range<usize>,
    sentence: String,
}

#[cfg(test)]
impl Diagnostic {
    /// Returns the description of the fault and its remedy.
    pub(crate) fn sentence(&self) -> &str {
        &self.sentence
    }
}

impl<T> Located<T> {
    /// Returns a fault at the position of this value.
    pub(crate) fn fault(&self, sentence: impl Into<String>) -> Diagnostic {
        Diagnostic {
            span: self.span.clone(),
            sentence: sentence.into(),
        }
    }
}

/// A file and its text.
#[derive(Debug)]
pub(crate) struct Source {
    pub(crate) path: PathBuf,
    pub(crate) text: String,
}

impl Source {
    /// Returns the error for a fault at its position in this file.
    pub(crate) fn error(&self, fault: Diagnostic) -> SceneFileError {
        self.error_at(fault.span, fault.sentence)
    }

    /// Returns the line of a byte of the text, counted from 1.
    pub(crate) fn line(&self, offset: usize) -> usize {
        let before = self.text.bytes().take(offset);
        before.filter(|&byte| byte == b'\n').count() + 1
    }

    /// Returns an error at a position of this file.
    pub(crate) fn error_at(&self, span: Range<usize>, fault: String) -> SceneFileError {
        let mut start = span.start.min(self.text.len());
        // The span may begin within a character
        while !self.text.is_char_boundary(start) {
            start -= 1;
        }
        let before = &self.text[..start];
        let line_start = before.rfind('\n').map_or(0, |i| i + 1);
        SceneFileError::Item {
            file: self.path.clone(),
            line: self.line(start),
            column: before[line_start..].chars().count() + 1,
            item: item_at(&self.text, start),
            fault,
        }
    }

    /// Parses the text as a `T`.
    pub(crate) fn parse<T: DeserializeOwned>(&self) -> Result<T, SceneFileError> {
        from_text(&self.text).map_err(|error| self.toml_error(&error))
    }

    /// Returns the error for what the parser or serde reported, worded as advice.
    pub(super) fn toml_error(&self, error: &TomlError) -> SceneFileError {
        let span = error.span().unwrap_or(0..0);
        // serde reports faults of the content, the parser those of the syntax
        let is_toml = DeTable::parse(&self.text).is_ok();
        let word = self.text.get(span.clone()).unwrap_or_default();
        let message = one_line(error.message());
        let fault = if is_toml {
            reworded(&message)
        } else if message == "duplicate key" {
            format!("`{word}` is given twice: keep one or rename it")
        } else {
            format!("is not TOML ({message}): correct the line")
        };
        self.error_at(span, fault)
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns an error of the whole file.
pub(crate) fn file_error(path: &Path, fault: impl Into<String>) -> SceneFileError {
    SceneFileError::File {
        file: path.to_owned(),
        fault: fault.into(),
    }
}

/// Rewords serde's message as advice. The program's own messages stay as they are.
fn reworded(message: &str) -> String {
    // A key or a word that does not exist
    if let Some(rest) = message
        .strip_prefix("unknown field ")
        .or_else(|| message.strip_prefix("unknown variant "))
    {
        let mut words = rest.split('`').skip(1).step_by(2);
        let word = words.next().unwrap_or_default();
        let known: Vec<&str> = words.collect();
        return format!("`{word}` is not known here: {}", suggestion(word, &known));
    }
    if let Some(rest) = message.strip_prefix("missing field ") {
        return format!("lacks {rest}: add it");
    }
    // A value of another type
    let expected = message
        .strip_prefix("invalid type: ")
        .or_else(|| message.strip_prefix("invalid value: "))
        .and_then(|rest| rest.rsplit_once(", expected "));
    if let Some((found, wanted)) = expected {
        return format!("is {found}: give {}", in_words(wanted));
    }
    // A list of another length
    let length = message
        .strip_prefix("invalid length ")
        .and_then(|rest| rest.split_once(", expected "));
    if let Some((found, wanted)) = length {
        return format!("has {found} elements: give {}", in_words(wanted));
    }
    if message.starts_with("wanted exactly 1 element") {
        return "is ambiguous or incomplete: give exactly one key".into();
    }
    message.to_owned()
}

/// Returns the everyday name of a Rust type.
fn in_words(wanted: &str) -> &str {
    match wanted {
        "f64" | "f32" => "a number",
        "u32" | "u64" | "usize" => "a whole number of 0 or more",
        "i32" | "i64" => "a whole number",
        "a sequence" => "a list in brackets",
        "a map" => "a table",
        "a boolean" => "true or false",
        "a string" => "a string in quotes",
        _ if wanted.starts_with("struct") || wanted.starts_with("internally") => "a table",
        _ => wanted,
    }
}

/// Returns advice on what may have been meant instead of `word`.
pub(super) fn suggestion(word: &str, known: &[&str]) -> String {
    // With one error per three letters the intended word is still recognisable.
    let max_edits = word.chars().count() / 3 + 1;
    // Find the known word with the fewest edits
    let near = known
        .iter()
        .map(|other| (strsim::damerau_levenshtein(word, other), other))
        .filter(|(edits, _)| *edits <= max_edits)
        .min();
    match (near, known) {
        (Some((_, near)), _) => format!("did you mean `{near}`?"),
        (None, []) => "remove it".into(),
        (None, known) => format!("give one of `{}`", known.join("`, `")),
    }
}

/// Returns the keys that lead to the innermost item at a byte of the text.
fn item_at(text: &str, offset: usize) -> String {
    let Ok(root) = DeTable::parse(text) else {
        return "the file".into();
    };
    let mut path = Vec::new();
    let mut best = Vec::new();
    search_table(root.get_ref(), offset, &mut path, &mut best);
    if best.is_empty() {
        "the file".into()
    } else {
        best.join(".")
    }
}

fn search_table(table: &DeTable, offset: usize, path: &mut Vec<String>, best: &mut Vec<String>) {
    for (key, value) in table {
        path.push(key.get_ref().to_string());
        if is_in(&key.span(), offset) || is_in(&value.span(), offset) {
            keep_longer(path, best);
        }
        search_value(value.get_ref(), offset, path, best);
        path.pop();
    }
}

fn search_value(value: &DeValue, offset: usize, path: &mut Vec<String>, best: &mut Vec<String>) {
    match value {
        DeValue::Table(table) => search_table(table, offset, path, best),
        DeValue::Array(elements) => {
            let name = path.last().cloned().unwrap_or_default();
            for (index, element) in elements.iter().enumerate() {
                // Only elements that are tables are items of their own
                if !matches!(element.get_ref(), DeValue::Table(_)) {
                    continue;
                }
                // Number the element, from 1
                if let Some(last) = path.last_mut() {
                    *last = format!("{name} {}", index + 1);
                }
                if is_in(&element.span(), offset) {
                    keep_longer(path, best);
                }
                search_value(element.get_ref(), offset, path, best);
            }
        }
        _ => {}
    }
}

/// Keeps the longer path. The span of a list includes the headers of its later elements, so of equally long paths the
/// later one is right.
fn keep_longer(path: &[String], best: &mut Vec<String>) {
    if path.len() >= best.len() {
        *best = path.to_vec();
    }
}

fn is_in(span: &Range<usize>, offset: usize) -> bool {
    span.start <= offset && offset < span.end.max(span.start + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn item_is_named_by_its_key_path() {
        let text = "[material.red]\ncolor = 1\n[[object]]\nshape = 'a'\n[[object]]\ntransform = [{ scale = 1 }, { scale = 0 }]\n";
        let item = |word: &str| item_at(text, text.rfind(word).unwrap());
        assert_eq!(item("color"), "material.red.color");
        assert_eq!(item("shape"), "object 1.shape");
        assert_eq!(item("[[object]]"), "object 2");
        assert_eq!(item("scale = 0"), "object 2.transform 2.scale");
        assert_eq!(item_at("a = [", 3), "the file");
    }

    #[test]
    fn similar_words_are_suggested_and_others_are_not() {
        let known = ["color", "intensity", "range"];
        let suggest = |word| suggestion(word, &known);
        assert_eq!(suggest("colour"), "did you mean `color`?");
        assert_eq!(suggest("intesnity"), "did you mean `intensity`?");
        assert_eq!(suggest("x"), "give one of `color`, `intensity`, `range`");
    }

    #[test]
    fn lines_and_columns_count_characters_from_one() {
        let source = Source {
            path: "a.toml".into(),
            text: "# ä\n'ö' = 1".into(),
        };
        let SceneFileError::Item { line, column, .. } = source.error_at(9..10, String::new()) else {
            unreachable!()
        };
        // The second line is ' ö ' blank: byte 5 begins it, 9 is its fourth character.
        assert_eq!((line, column), (2, 4));
    }
}
