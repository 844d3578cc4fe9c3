//! A serde deserializer over the tree of a TOML text.
//!
//! The `toml` crate has deserializers of different types for documents, values, tables, lists, dates and spans, and
//! every serde type is compiled anew for each of them. This module has one type for all, over the tree that `toml`
//! parses. The accepted input, the messages and their positions are those of `toml`: an error without a position takes
//! that of the innermost value or key around it.

use std::fmt;
use std::ops::Range;
use std::slice;

use serde::de::{
    self, DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess,
    SeqAccess, Unexpected, VariantAccess, Visitor,
};
use toml::Spanned;
use toml::de::{DeFloat, DeInteger, DeString, DeTable, DeValue};
use toml::value::Datetime;

/// Name of a newtype struct that requests a value with its span: a map, of which [`read_span`] reads the first key.
pub(super) const SPANNED: &str = "$whit::Placed";

/// Name of the only key of the map that serde sees for a date; `toml::Value` recognises dates by it.
const DATE_KEY: &str = "$__toml_private_datetime";

/// Reads a `T` from a TOML text.
pub(crate) fn from_text<T: DeserializeOwned>(text: &str) -> Result<T, TomlError> {
    let root = DeTable::parse(text)?;
    let span = root.span();
    let root = Spanned::new(span, DeValue::Table(root.into_inner()));
    T::deserialize(Node::Value(&root))
}

/// Reason why a TOML text could not be read, reported by the parser or by a serde type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub(crate) struct TomlError {
    message: String,
    span: Option<Range<usize>>,
}

impl TomlError {
    /// Returns the message of the parser or of serde.
    pub(crate) fn message(&self) -> &str {
        &self.message
    }

    /// Returns the span of the faulty text in bytes.
    pub(crate) fn span(&self) -> Option<Range<usize>> {
        self.span.clone()
    }

    fn new(message: impl Into<String>, span: Range<usize>) -> TomlError {
        TomlError {
            message: message.into(),
            span: Some(span),
        }
    }
}

impl From<toml::de::Error> for TomlError {
    fn from(error: toml::de::Error) -> TomlError {
        TomlError {
            message: error.message().to_owned(),
            span: error.span(),
        }
    }
}

impl de::Error for TomlError {
    fn custom<T: fmt::Display>(message: T) -> TomlError {
        TomlError {
            message: message.to_string(),
            span: None,
        }
    }
}

/// Returns `result`, its error with the span `span` unless it has one already.
fn with_span<T>(result: Result<T, TomlError>, span: Option<Range<usize>>) -> Result<T, TomlError> {
    match result {
        Err(TomlError { message, span: None }) => Err(TomlError { message, span }),
        result => result,
    }
}

/// A value of the tree, or a string that is not a value of its own.
#[derive(Clone, Copy, Debug)]
enum Node<'n> {
    Value(&'n Spanned<DeValue<'n>>),
    /// A string that is the key of a table.
    Key(&'n str),
    /// The text of a date, as the value of the date's only key.
    Date(&'n Datetime),
}

/// Content of a [`Node`], as it is passed to a serde visitor.
enum Content<'n> {
    Text(&'n str),
    Date(&'n Datetime),
    Integer(i64),
    Natural(u64),
    /// An integer that is too wide for every serde type here, in serde's words.
    Wide(String),
    Float(f64),
    Boolean(bool),
    List(Elements<'n>),
    Map(Entries<'n>),
}

impl<'n> Node<'n> {
    fn content(self) -> Result<Content<'n>, TomlError> {
        let value = match self {
            Node::Value(value) => value.get_ref(),
            Node::Key(key) => return Ok(Content::Text(key)),
            Node::Date(date) => return Ok(Content::Date(date)),
        };
        match value {
            DeValue::String(text) => Ok(Content::Text(text)),
            DeValue::Integer(number) => integer(number),
            DeValue::Float(number) => float(number).map(Content::Float),
            DeValue::Boolean(flag) => Ok(Content::Boolean(*flag)),
            DeValue::Datetime(date) => Ok(Content::Map(Entries::of_date(date))),
            DeValue::Array(elements) => Ok(Content::List(Elements(elements.iter()))),
            DeValue::Table(table) => Ok(Content::Map(Entries::of_table(table))),
        }
    }

    /// Returns the span of a value; `None` for a string that is not a value of its own.
    fn span(self) -> Option<Range<usize>> {
        match self {
            Node::Value(value) => Some(value.span()),
            Node::Key(_) | Node::Date(_) => None,
        }
    }

    /// Returns the enum variant that a string, or a table with one key, names.
    fn variant(self) -> Result<Variant<'n>, TomlError> {
        let value = match self {
            Node::Value(value) => value,
            Node::Key(name) => return Ok(Variant::of_word(name)),
            Node::Date(_) => return Err(de::Error::custom("wanted string or table")),
        };
        // A string is a variant without content, a table with one key a variant with it
        let fault = |message| Err(TomlError::new(message, value.span()));
        match value.get_ref() {
            DeValue::String(name) => Ok(Variant::of_word(name)),
            DeValue::Table(table) => {
                // A table names a variant only if it has exactly one key
                let mut entries = table.iter();
                match (entries.next(), entries.next()) {
                    (None, _) => fault("wanted exactly 1 element, found 0 elements"),
                    (Some((name, content)), None) => Ok(Variant {
                        name: name.get_ref(),
                        name_span: Some(name.span()),
                        content: Some(content),
                    }),
                    _ => fault("wanted exactly 1 element, more than 1 element"),
                }
            }
            _ => fault("wanted string or table"),
        }
    }
}

/// Parses an integer as the first of i64, u64, i128 and u128 that holds it.
fn integer<'n>(number: &DeInteger) -> Result<Content<'n>, TomlError> {
    let (digits, radix) = (number.as_str(), number.radix());
    // The order is that of the `toml` crate, whose messages depend on it
    if let Ok(number) = i64::from_str_radix(digits, radix) {
        Ok(Content::Integer(number))
    } else if let Ok(number) = u64::from_str_radix(digits, radix) {
        Ok(Content::Natural(number))
    } else if let Ok(number) = i128::from_str_radix(digits, radix) {
        Ok(Content::Wide(format!("integer `{number}` as i128")))
    } else if let Ok(number) = u128::from_str_radix(digits, radix) {
        Ok(Content::Wide(format!("integer `{number}` as u128")))
    } else {
        Err(de::Error::custom("integer number overflowed"))
    }
}

/// Parses a float, which may be infinite only if it is written so.
fn float(number: &DeFloat) -> Result<f64, TomlError> {
    let text = number.as_str();
    let number = text.parse().ok();
    number
        .filter(|number: &f64| !number.is_infinite() || text.contains("inf"))
        .ok_or_else(|| de::Error::custom("floating-point number overflowed"))
}

impl<'n> Deserializer<'n> for Node<'n> {
    type Error = TomlError;

    fn deserialize_any<V: Visitor<'n>>(self, visitor: V) -> Result<V::Value, TomlError> {
        let result = match self.content() {
            Ok(Content::Text(text)) => visitor.visit_borrowed_str(text),
            Ok(Content::Date(date)) => visitor.visit_str(&date.to_string()),
            Ok(Content::Integer(number)) => visitor.visit_i64(number),
            Ok(Content::Natural(number)) => visitor.visit_u64(number),
            Ok(Content::Wide(words)) => Err(de::Error::invalid_type(Unexpected::Other(&words), &visitor)),
            Ok(Content::Float(number)) => visitor.visit_f64(number),
            Ok(Content::Boolean(flag)) => visitor.visit_bool(flag),
            Ok(Content::List(elements)) => visitor.visit_seq(elements),
            Ok(Content::Map(entries)) => visitor.visit_map(entries),
            Err(error) => Err(error),
        };
        with_span(result, self.span())
    }

    fn deserialize_option<V: Visitor<'n>>(self, visitor: V) -> Result<V::Value, TomlError> {
        with_span(visitor.visit_some(self), self.span())
    }

    fn deserialize_newtype_struct<V: Visitor<'n>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, TomlError> {
        match self {
            Node::Value(value) if name == SPANNED => visitor.visit_map(SpannedValue(value)),
            Node::Date(date) => {
                let text = date.to_string();
                Err(de::Error::invalid_type(Unexpected::Str(&text), &visitor))
            }
            _ => with_span(visitor.visit_newtype_struct(self), self.span()),
        }
    }

    fn deserialize_enum<V: Visitor<'n>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TomlError> {
        let result = match self.variant() {
            Ok(variant) => visitor.visit_enum(variant),
            Err(error) => Err(error),
        };
        with_span(result, self.span())
    }

    serde::forward_to_deserialize_any! {
        <V: Visitor<'n>>
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct seq tuple
        tuple_struct map struct identifier ignored_any
    }
}

/// Remaining elements of a list.
struct Elements<'n>(slice::Iter<'n, Spanned<DeValue<'n>>>);

impl<'n> SeqAccess<'n> for Elements<'n> {
    type Error = TomlError;

    fn next_element_seed<T: DeserializeSeed<'n>>(&mut self, seed: T) -> Result<Option<T::Value>, TomlError> {
        match self.0.next() {
            Some(value) => seed.deserialize(Node::Value(value)).map(Some),
            None => Ok(None),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.0.len())
    }
}

/// Remaining entries of a table, or of a date.
struct Entries<'n> {
    rest: Rest<'n>,
    /// Value of the key that was returned last.
    value: Option<Node<'n>>,
}

enum Rest<'n> {
    Table(toml::map::Iter<'n, Spanned<DeString<'n>>, Spanned<DeValue<'n>>>),
    Date(Option<&'n Datetime>),
}

impl<'n> Entries<'n> {
    fn of_table(table: &'n DeTable<'n>) -> Entries<'n> {
        Entries {
            rest: Rest::Table(table.iter()),
            value: None,
        }
    }

    fn of_date(date: &'n Datetime) -> Entries<'n> {
        Entries {
            rest: Rest::Date(Some(date)),
            value: None,
        }
    }

    /// Returns the next key and its span; stores its value.
    fn next(&mut self) -> Option<(&'n str, Option<Range<usize>>)> {
        match &mut self.rest {
            Rest::Table(entries) => {
                let (key, value) = entries.next()?;
                self.value = Some(Node::Value(value));
                Some((key.get_ref(), Some(key.span())))
            }
            Rest::Date(date) => {
                self.value = Some(Node::Date(date.take()?));
                Some((DATE_KEY, None))
            }
        }
    }
}

impl<'n> MapAccess<'n> for Entries<'n> {
    type Error = TomlError;

    fn next_key_seed<K: DeserializeSeed<'n>>(&mut self, seed: K) -> Result<Option<K::Value>, TomlError> {
        match self.next() {
            Some((key, span)) => with_span(seed.deserialize(Node::Key(key)).map(Some), span),
            None => Ok(None),
        }
    }

    fn next_value_seed<V: DeserializeSeed<'n>>(&mut self, seed: V) -> Result<V::Value, TomlError> {
        match self.value.take() {
            Some(value) => with_span(seed.deserialize(value), value.span()),
            None => Err(de::Error::custom("a value was read before its key")),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        match &self.rest {
            Rest::Table(entries) => Some(entries.len()),
            Rest::Date(date) => Some(usize::from(date.is_some())),
        }
    }
}

/// A value with its span, as a map: its key is the start and the end of the span, packed into one integer.
struct SpannedValue<'n>(&'n Spanned<DeValue<'n>>);

impl<'n> MapAccess<'n> for SpannedValue<'n> {
    type Error = TomlError;

    fn next_key_seed<K: DeserializeSeed<'n>>(&mut self, seed: K) -> Result<Option<K::Value>, TomlError> {
        let Range { start, end } = self.0.span();
        // Start in the high half, end in the low one
        let packed = (start as u128) << u64::BITS | end as u128;
        seed.deserialize(packed.into_deserializer()).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'n>>(&mut self, seed: V) -> Result<V::Value, TomlError> {
        // A list with such an element sets the position of its errors, so they are left without one here.
        seed.deserialize(Node::Value(self.0))
    }
}

/// Reads the span of a value from the map that [`SPANNED`] requests; the value comes next.
pub(super) fn read_span<'de, A: MapAccess<'de>>(map: &mut A) -> Result<Range<usize>, A::Error> {
    let packed: Option<u128> = map.next_key()?;
    let packed = packed.ok_or_else(|| de::Error::custom("a value has no place"))?;
    Ok((packed >> u64::BITS) as usize..packed as u64 as usize)
}

/// An enum variant by its name, with its content if it is written as a table.
struct Variant<'n> {
    name: &'n str,
    name_span: Option<Range<usize>>,
    content: Option<&'n Spanned<DeValue<'n>>>,
}

impl<'n> Variant<'n> {
    fn of_word(name: &'n str) -> Variant<'n> {
        Variant {
            name,
            name_span: None,
            content: None,
        }
    }
}

impl<'n> EnumAccess<'n> for Variant<'n> {
    type Error = TomlError;
    type Variant = VariantContent<'n>;

    fn variant_seed<V: DeserializeSeed<'n>>(
        self,
        seed: V,
    ) -> Result<(V::Value, VariantContent<'n>), TomlError> {
        let name = with_span(seed.deserialize(Node::Key(self.name)), self.name_span)?;
        Ok((name, VariantContent(self.content)))
    }
}

struct VariantContent<'n>(Option<&'n Spanned<DeValue<'n>>>);

impl<'n> VariantContent<'n> {
    /// Returns the content of a variant that requires some.
    fn node(self, wanted: &'static str) -> Result<Node<'n>, TomlError> {
        match self.0 {
            Some(value) => Ok(Node::Value(value)),
            None => Err(de::Error::invalid_type(Unexpected::UnitVariant, &wanted)),
        }
    }
}

impl<'n> VariantAccess<'n> for VariantContent<'n> {
    type Error = TomlError;

    fn unit_variant(self) -> Result<(), TomlError> {
        let Some(value) = self.0 else { return Ok(()) };
        let message = match value.get_ref() {
            DeValue::Array(elements) if elements.is_empty() => return Ok(()),
            DeValue::Table(table) if table.is_empty() => return Ok(()),
            DeValue::Array(_) => "expected empty array".to_owned(),
            DeValue::Table(_) => "expected empty table".to_owned(),
            other => format!("expected table, found {}", other.type_str()),
        };
        Err(TomlError::new(message, value.span()))
    }

    fn newtype_variant_seed<T: DeserializeSeed<'n>>(self, seed: T) -> Result<T::Value, TomlError> {
        seed.deserialize(self.node("newtype variant")?)
    }

    fn tuple_variant<V: Visitor<'n>>(self, _: usize, visitor: V) -> Result<V::Value, TomlError> {
        self.node("tuple variant")?.deserialize_any(visitor)
    }

    fn struct_variant<V: Visitor<'n>>(
        self,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TomlError> {
        self.node("struct variant")?.deserialize_any(visitor)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Deserialize;

    use super::super::value::{Each, Located};
    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Form {
        #[serde(default)]
        count: u32,
        offset: Option<i32>,
        ratio: Option<f32>,
        size: Option<[f64; 2]>,
        word: Option<String>,
        flag: Option<bool>,
        kind: Option<Kind>,
        #[serde(default)]
        kinds: Vec<Kind>,
        #[serde(default)]
        parts: BTreeMap<String, Part>,
        value: Option<toml::Value>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Kind {
        Plain,
        Whole(Part),
        Half(f64),
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Part {
        x: f64,
    }

    const GOOD: [&str; 10] = [
        "",
        "count = 0xff\noffset = -3\nratio = 2\nword = \"a\\tb\"\nflag = true",
        "ratio = -inf\nsize = [1, 2.5, 3]",
        "kind = 'plain'",
        "kind = { plain = {} }",
        "kind = { plain = [] }\nkinds = ['plain', { whole = { x = 1 } }, { half = 0.5 }]",
        "kind = { whole = [4] }\n[parts]\nb.x = 1\n'a b' = { x = 2 }",
        "[[kinds]]\nwhole.x = 1\n[[kinds]]\nhalf = 2",
        "value = [1, 2.5, true, 'a', 1979-05-27T07:32:00Z, 07:32:00, { x = 1979-05-27, y = [{}] }]",
        "value = 1979-05-27",
    ];

    const BAD: [&str; 40] = [
        "count = ",
        "count = 1\ncount = 2",
        "[count]\n[count]",
        "count = -1",
        "count = 4294967296",
        "count = 18446744073709551615",
        "count = 18446744073709551616",
        "count = 170141183460469231731687303715884105728",
        "count = 999999999999999999999999999999999999999999",
        "count = 1.0",
        "count = 'one'",
        "count = 1979-05-27",
        "count = {}",
        "offset = 2147483648",
        "ratio = 1e999",
        "ratio = true",
        "size = [1]",
        "size = [1, 'a']",
        "size = { x = 1 }",
        "word = 5",
        "word = [\"a\"]",
        "flag = 0",
        "sise = 1",
        "  'a b' = 1",
        "kind = 'plian'",
        "kind = 'whole'",
        "kind = 5",
        "kind = {}",
        "kind = { plain = {}, half = 1 }",
        "kind = { plian = {} }",
        "kind = { plain = { x = 1 } }",
        "kind = { plain = [1] }",
        "kind = { plain = 1 }",
        "kind = { whole = { y = 1 } }",
        "kind = { whole = {} }",
        "kinds = ['plain', 'plian']",
        "kinds = ['plain', { half = 'a' }, 5]",
        "parts.a = 1979-05-27",
        "parts = 1979-05-27",
        "value = 18446744073709551615",
    ];

    #[test]
    fn forms_deserialize_as_with_the_toml_crate() {
        for text in GOOD {
            let expected: Form = toml::from_str(text).unwrap();
            assert_eq!(from_text::<Form>(text), Ok(expected), "{text}");
        }
    }

    /// Values with their spans, either by [`Located`] or by the `toml` crate's own type.
    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Places<V> {
        one: Option<V>,
        list: Option<Vec<V>>,
        table: Option<BTreeMap<String, V>>,
    }

    impl<V> Places<V> {
        fn all(self) -> Vec<V> {
            let table = self.table.unwrap_or_default().into_values();
            let listed = self.list.unwrap_or_default().into_iter();
            self.one.into_iter().chain(listed).chain(table).collect()
        }
    }

    #[test]
    fn value_spans_match_the_toml_crate() {
        let text = "one = 1\nlist = [2, [3, 4]]\n[table]\na = 5\nb = [6, 7]";
        let ours = from_text::<Places<Located<Each<2>>>>(text).unwrap().all();
        let theirs = toml::from_str::<Places<Spanned<Each<2>>>>(text).unwrap().all();
        assert_eq!((ours.len(), theirs.len()), (5, 5));
        for (ours, theirs) in ours.iter().zip(&theirs) {
            assert_eq!((&ours.span, **ours), (&theirs.span(), *theirs.get_ref()));
        }
    }

    #[test]
    fn errors_in_located_values_have_the_spans_of_the_toml_crate() {
        for text in [
            "one = 'a'",
            "one = [1]",
            "one = [1, nan]",
            "one = 1979-05-27",
            "list = [1, [2, 3, 4]]",
            "list = [1, [2, inf]]",
            "list = [1, 'a']",
            "list = 1979-05-27",
            "table = { a = 1, b = [nan, 1] }",
            "[table]\na = {}",
            "table = 1979-05-27",
            "table = [1]",
        ] {
            // Messages and spans must agree with those of the `toml` crate
            let expected = toml::from_str::<Places<Spanned<Each<2>>>>(text).unwrap_err();
            let error = from_text::<Places<Located<Each<2>>>>(text).unwrap_err();
            assert_eq!(error, expected.into(), "{text}");
        }
    }

    #[test]
    fn errors_and_spans_match_the_toml_crate() {
        for text in BAD {
            let expected = toml::from_str::<Form>(text).unwrap_err();
            assert_eq!(from_text::<Form>(text), Err(expected.into()), "{text}");
        }
    }
}
