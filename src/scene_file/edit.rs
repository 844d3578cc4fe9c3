//! Edits of a scene file's keys before it is parsed, as parameter sweeps make them.

use std::fmt;

use toml::{Table, Value};

use super::fault::suggestion;

/// Largest number of names that a message lists.
const MAX_NAMES: usize = 16;

/// A key of a scene file and its new value.
#[derive(Clone, Debug, PartialEq)]
pub struct Edit {
    /// Words of the key, as in `material.ball.roughness`; in lists of tables a name, or a number from 0.
    pub key: Vec<String>,
    /// New value of the key.
    pub value: Value,
}

impl fmt::Display for Edit {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} = {}", self.key.join("."), self.value)
    }
}

impl Edit {
    /// Splits a key at its dots; quoted parts may contain dots: `material."a.b".ior`.
    pub(crate) fn words(key: &str) -> Result<Vec<String>, String> {
        let mut words = vec![String::new()];
        let mut is_quoted = false;
        for c in key.chars() {
            // Dots separate words unless they are quoted
            match c {
                '"' => is_quoted = !is_quoted,
                '.' if !is_quoted => words.push(String::new()),
                c => {
                    if let Some(word) = words.last_mut() {
                        word.push(c);
                    }
                }
            }
        }
        if is_quoted || words.iter().any(String::is_empty) {
            return Err(format!(
                "`{key}` is no key: give words with points between, as in material.ball.roughness"
            ));
        }
        Ok(words)
    }

    /// Makes the change. The last word may be new; those before it must exist.
    ///
    /// # Errors
    ///
    /// A sentence that says which word does not exist, and which ones do.
    pub fn apply(&self, scene: &mut Table) -> Result<(), String> {
        // A key of one word sets a top-level value
        let Some((first, rest)) = self.key.split_first() else {
            return Ok(());
        };
        let Some((last, between)) = rest.split_last() else {
            scene.insert(first.clone(), self.value.clone());
            return Ok(());
        };
        // Unlike the last word, the first must exist
        if !scene.contains_key(first) {
            let known: Vec<&str> = scene.keys().map(String::as_str).collect();
            return Err(format!("the scene has no `{first}`: {}", advice(first, &known)));
        }
        // Follow the inner words to the table or list that holds the last one
        let mut current = &mut scene[first];
        for (depth, word) in between.iter().enumerate() {
            current = self.step_to(current, (depth + 1, word))?;
        }
        // Insert into a table, replace in a list
        if let Value::Table(table) = current {
            table.insert(last.clone(), self.value.clone());
            return Ok(());
        }
        *self.step_to(current, (self.key.len() - 1, last))? = self.value.clone();
        Ok(())
    }

    /// Returns the value of the next word `word` in `current`, to which the first `depth` words lead.
    fn step_to<'v>(
        &self,
        current: &'v mut Value,
        (depth, word): (usize, &str),
    ) -> Result<&'v mut Value, String> {
        match index(current, word) {
            Some(Index::Key) => Ok(&mut current[word]),
            Some(Index::Number(number)) => Ok(&mut current[number]),
            None => {
                let so_far = self.key[..depth].join(".");
                let advice = advice(word, &names(current));
                Err(format!("`{so_far}` of the scene has no `{word}`: {advice}"))
            }
        }
    }
}

/// Returns advice on which of the known words may have been meant.
fn advice(word: &str, known: &[&str]) -> String {
    let advice = suggestion(word, known);
    // A long list of names helps less than the rule
    match known.len() <= MAX_NAMES || advice.starts_with("did") {
        true if !known.is_empty() => advice,
        _ => "give a key, a name or a number from 0 that is there".into(),
    }
}

/// Returns the keys of a table, or the names in a list of tables.
fn names(current: &Value) -> Vec<&str> {
    match current {
        Value::Table(table) => table.keys().map(String::as_str).collect(),
        Value::Array(list) => list
            .iter()
            .filter_map(|value| value.get("name")?.as_str())
            .collect(),
        _ => Vec::new(),
    }
}

/// Position in a table or a list.
enum Index {
    Key,
    Number(usize),
}

/// Returns the position of `word` in a table or a list; `None` if it is absent.
fn index(current: &Value, word: &str) -> Option<Index> {
    match current {
        Value::Table(table) => table.contains_key(word).then_some(Index::Key),
        Value::Array(list) => {
            let is_called = |value: &Value| value.get("name").and_then(Value::as_str) == Some(word);
            // A name wins over a number
            let number = list.iter().position(is_called).or_else(|| word.parse().ok())?;
            (number < list.len()).then_some(Index::Number(number))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edited(key: &str, value: Value) -> Result<Table, String> {
        let text = "ambient = 0.1\n[material.ball]\nior = 1.5\n[[light]]\nname = \"sun\"\nposition = [1, 2, 3]\n[[light]]\n";
        let mut table: Table = toml::from_str(text).unwrap();
        let edit = Edit {
            key: Edit::words(key)?,
            value,
        };
        edit.apply(&mut table).map(|()| table)
    }

    #[test]
    fn keys_address_tables_names_and_numbers() {
        let value = Value::Integer(7);
        // Keys of top-level values, of tables and of lists
        assert_eq!(edited("ambient", value.clone()).unwrap()["ambient"], value);
        assert_eq!(
            edited("material.ball.ior", value.clone()).unwrap()["material"]["ball"]["ior"],
            value
        );
        assert_eq!(
            edited("material.ball.new", value.clone()).unwrap()["material"]["ball"]["new"],
            value
        );
        assert_eq!(
            edited("light.sun.position.1", value.clone()).unwrap()["light"][0]["position"][1],
            value
        );
        assert_eq!(
            edited("light.1.intensity", value.clone()).unwrap()["light"][1]["intensity"],
            value
        );
        assert_eq!(edited("\"ambient\"", value.clone()).unwrap()["ambient"], value);
    }

    #[test]
    fn keys_that_address_nothing_are_reported() {
        for (key, word) in [
            (
                "light.moon.intensity",
                "`light` of the scene has no `moon`: give one of `sun`",
            ),
            ("light.snu.intensity", "did you mean `sun`?"),
            ("materail.ball.ior", "did you mean `material`?"),
            ("light.5.intensity", "has no `5`"),
            ("lamp.sun.position", "the scene has no `lamp`"),
            ("ambient.red", "`ambient` of the scene has no `red`"),
            ("light.sun.position.9", "has no `9`"),
            ("", "is no key"),
            ("a..b", "is no key"),
            ("\"a", "is no key"),
        ] {
            let message = edited(key, Value::Integer(1)).unwrap_err();
            assert!(message.contains(word), "{key}: {message}");
        }
    }
}
