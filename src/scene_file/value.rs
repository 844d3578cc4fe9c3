//! Values in scene files: colours, vectors, and parameters with or without a texture, each with its span in the file.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, Range};

use glam::DVec3;
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::{Error, IntoDeserializer, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::forms::{forms, schema};
use super::node::{SPANNED, read_span};
use crate::image::linear_from_srgb;

/// A value and the span of the file that it was read from, in bytes.
#[derive(Clone, Debug)]
pub(crate) struct Located<T> {
    value: T,
    pub(crate) span: Range<usize>,
}

impl<T> Located<T> {
    /// Returns a value without a span in the file.
    pub(super) fn without_span(value: T) -> Located<T> {
        Located { value, span: 0..0 }
    }
}

impl<T> Deref for Located<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Located<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Located<T>, D::Error> {
        deserializer.deserialize_newtype_struct(SPANNED, AtVisitor(PhantomData))
    }
}

struct AtVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for AtVisitor<T> {
    type Value = Located<T>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a spanned value")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Located<T>, A::Error> {
        let span = read_span(&mut map)?;
        let value = map.next_value()?;
        Ok(Located { value, span })
    }
}

impl<T: JsonSchema> JsonSchema for Located<T> {
    fn schema_name() -> Cow<'static, str> {
        T::schema_name()
    }

    fn inline_schema() -> bool {
        T::inline_schema()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        T::json_schema(generator)
    }
}

/// Linear RGB without negative values: one number for a grey, three, or "#rrggbb" by the sRGB curve.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "Channels<3>")]
pub(super) struct Color(pub(super) [f32; 3]);

impl Color {
    pub(super) const WHITE: Color = Color([1.0; 3]);

    /// Returns the value that all channels share; `None` for a colour that is not grey.
    pub(super) fn grey(self) -> Option<f32> {
        let [r, g, b] = self.0;
        (r == g && g == b).then_some(r)
    }
}

/// A [`Color`] with coverage as an optional fourth number, or "#rrggbbaa".
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "Channels<4>")]
pub(super) struct Rgba(pub(super) [f32; 4]);

const COLOR_FORMS: &str = "a number, [red, green, blue] or \"#rrggbb\"";
const RGBA_FORMS: &str =
    "a number, [red, green, blue], [red, green, blue, alpha], \"#rrggbb\" or \"#rrggbbaa\"";

/// Channels of a colour, of which the last of four is optional, as is any number of them until it is checked.
struct Channels<const MAX: usize>(Vec<f32>);

impl<const MAX: usize> Channels<MAX> {
    const FORMS: &str = if MAX == 3 { COLOR_FORMS } else { RGBA_FORMS };

    fn wrong_count(&self) -> String {
        format!("a colour has {} channels: give {}", self.0.len(), Self::FORMS)
    }
}

forms! {
    ['de, const MAX: usize] Channels<MAX>, Channels::<MAX>::FORMS;
    number grey => channels([grey; 3]).map(Channels);
    text text => hex_channels(text)
        .map(Channels)
        .ok_or_else(|| E::custom(format!("`{text}` is not a colour: give {}", Channels::<MAX>::FORMS)));
    list list => channels(Vec::<f64>::deserialize(list)?).map(Channels);
}

fn channels<E: Error>(numbers: impl IntoIterator<Item = f64>) -> Result<Vec<f32>, E> {
    // The comparison also rejects NaN, and values that overflow f32
    let numbers: Vec<f32> = numbers.into_iter().map(|x| x as f32).collect();
    if numbers.iter().all(|x| (0.0..f32::INFINITY).contains(x)) {
        Ok(numbers)
    } else {
        Err(E::custom(
            "a colour is negative or not finite: give numbers of 0 or more",
        ))
    }
}

/// Returns the linear channels of "#rrggbb" or "#rrggbbaa".
fn hex_channels(text: &str) -> Option<Vec<f32>> {
    let digits = text.strip_prefix('#')?;
    // ASCII digits only, so that slicing by bytes is safe
    let is_color = matches!(digits.len(), 6 | 8) && digits.bytes().all(|b| b.is_ascii_hexdigit());
    if !is_color {
        return None;
    }
    let byte = |i: usize| u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).ok();
    (0..digits.len() / 2)
        .map(|i| {
            let encoded = f64::from(byte(i)?) / 255.0;
            // Coverage is linear
            Some(if i < 3 { linear_from_srgb(encoded) } else { encoded } as f32)
        })
        .collect()
}

impl TryFrom<Channels<3>> for Color {
    type Error = String;

    fn try_from(channels: Channels<3>) -> Result<Color, String> {
        match channels.0[..] {
            [r, g, b] => Ok(Color([r, g, b])),
            _ => Err(channels.wrong_count()),
        }
    }
}

impl TryFrom<Channels<4>> for Rgba {
    type Error = String;

    fn try_from(channels: Channels<4>) -> Result<Rgba, String> {
        match channels.0[..] {
            [r, g, b] => Ok(Rgba([r, g, b, 1.0])),
            [r, g, b, a] => Ok(Rgba([r, g, b, a])),
            _ => Err(channels.wrong_count()),
        }
    }
}

schema!([] Color, "Color", _generator => {
    "description": "Linear RGB as one number for a grey or [red, green, blue], or sRGB as \"#rrggbb\".",
    "anyOf": [
        { "type": "number", "minimum": 0 },
        { "type": "array", "items": { "type": "number", "minimum": 0 }, "minItems": 3, "maxItems": 3 },
        { "type": "string", "pattern": "^#[0-9a-fA-F]{6}$" },
    ],
});

schema!([] Rgba, "Rgba", _generator => {
    "description": "Linear RGB as one number for a grey, [red, green, blue] or [red, green, blue, alpha], or \
                    sRGB as \"#rrggbb\" or \"#rrggbbaa\".",
    "anyOf": [
        { "type": "number", "minimum": 0 },
        { "type": "array", "items": { "type": "number", "minimum": 0 }, "minItems": 3, "maxItems": 4 },
        { "type": "string", "pattern": "^#([0-9a-fA-F]{6}|[0-9a-fA-F]{8})$" },
    ],
});

/// A vector of three finite numbers.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "[f64; 3]", into = "[f64; 3]")]
pub(super) struct Vector(pub(super) DVec3);

impl TryFrom<[f64; 3]> for Vector {
    type Error = &'static str;

    fn try_from(v: [f64; 3]) -> Result<Vector, &'static str> {
        let v = DVec3::from_array(v);
        v.is_finite()
            .then_some(Vector(v))
            .ok_or("a coordinate is not finite: correct it")
    }
}

impl From<Vector> for [f64; 3] {
    fn from(v: Vector) -> [f64; 3] {
        v.0.to_array()
    }
}

impl JsonSchema for Vector {
    fn schema_name() -> Cow<'static, str> {
        "Vector".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        <[f64; 3]>::json_schema(generator)
    }
}

/// One number for all N elements, or N numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Each<const N: usize>(pub(super) [f64; N]);

impl<const N: usize> Each<N> {
    fn finite<E: Error>(numbers: [f64; N]) -> Result<Each<N>, E> {
        numbers
            .iter()
            .all(|x| x.is_finite())
            .then_some(Each(numbers))
            .ok_or_else(|| E::custom("a number is not finite: correct it"))
    }
}

forms! {
    ['de, const N: usize] Each<N>, format_args!("a number or {N} numbers in brackets");
    number x => Each::finite([x; N]);
    list list => {
        // A list must have exactly N numbers
        let numbers = Vec::<f64>::deserialize(list)?;
        let count = numbers.len();
        let numbers = numbers
            .try_into()
            .map_err(|_| A::Error::custom(format!("has {count} numbers: give one or {N}")))?;
        Each::finite(numbers)
    };
}

schema!([const N: usize] Each<N>, format!("NumberOr{N}"), _generator => {
    "anyOf": [
        { "type": "number" },
        { "type": "array", "items": { "type": "number" }, "minItems": N, "maxItems": N },
    ],
});

/// A parameter of a material: a value, or a texture with a value that it multiplies.
#[derive(Clone, Debug)]
pub(super) enum Param<T> {
    Value(T),
    Textured(Textured<T>),
}

/// A texture on a parameter.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Textured<T> {
    /// Name of a texture.
    pub(super) texture: Located<String>,
    /// Value that the texture multiplies; 1 if absent.
    pub(super) value: Option<T>,
    /// Number of the mesh's texture coordinate set.
    #[serde(default)]
    pub(super) set: u32,
    /// Factors on u and v, applied first: the numbers of repetitions.
    pub(super) scale: Option<Each<2>>,
    /// Degrees by which (u, v) are rotated next, from u towards v.
    #[serde(default)]
    pub(super) rotate: f32,
    /// Offset of (u, v), added last.
    #[serde(default)]
    pub(super) offset: [f32; 2],
    /// Scale of a normal map, strength of an occlusion map, height in metres of white in a bump map.
    #[serde(default = "one")]
    pub(super) strength: f32,
}

fn one() -> f32 {
    1.0
}

/// Type of a parameter's value, with its description for messages and its neutral value.
pub(super) trait Value: Sized {
    const FORMS: &str;
    const ONE: Self;
}

impl Value for Color {
    const FORMS: &str = "a colour or { texture = \"NAME\" }";
    const ONE: Color = Color::WHITE;
}

impl Value for Rgba {
    const FORMS: &str = "a colour or { texture = \"NAME\" }";
    const ONE: Rgba = Rgba([1.0; 4]);
}

impl Value for f32 {
    const FORMS: &str = "a number or { texture = \"NAME\" }";
    const ONE: f32 = 1.0;
}

forms! {
    ['de, T: Value + Deserialize<'de>] Param<T>, T::FORMS;
    number x => T::deserialize(x.into_deserializer()).map(Param::Value);
    text text => T::deserialize(text.into_deserializer()).map(Param::Value);
    list list => T::deserialize(list).map(Param::Value);
    table table => Textured::deserialize(table).map(Param::Textured);
}

schema!([T: JsonSchema] Param<T>, format!("ParameterOf{}", T::schema_name()), generator => {
    "anyOf": [generator.subschema_for::<T>(), generator.subschema_for::<Textured<T>>()],
});

impl<T: Value + Copy> Param<T> {
    /// Returns the value without the texture.
    pub(super) fn value(&self) -> T {
        match self {
            Param::Value(value) => *value,
            Param::Textured(textured) => textured.value.unwrap_or(T::ONE),
        }
    }
}

/// Uninhabited value type of a parameter that must have a texture.
#[derive(Clone, Copy, Debug)]
pub(super) enum NoValue {}

impl<'de> Deserialize<'de> for NoValue {
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<NoValue, D::Error> {
        Err(D::Error::custom(
            "cannot have a value besides its texture: remove the value",
        ))
    }
}

schema!([] NoValue, "NoValue", _generator => { "not": {}, "description": "Not allowed here." });

/// One table, or a list of tables.
#[derive(Debug)]
pub(super) struct OneOrMany<T>(pub(super) Vec<Located<T>>);

impl<T> Default for OneOrMany<T> {
    fn default() -> Self {
        OneOrMany(Vec::new())
    }
}

/// Content of a [`OneOrMany`]; inside a [`Located`], so that a single table has its span.
enum Content<T> {
    One(T),
    Many(Vec<Located<T>>),
}

forms! {
    ['de, T: Deserialize<'de>] Content<T>, "a table or several";
    table table => T::deserialize(table).map(Content::One);
    list list => Vec::deserialize(list).map(Content::Many);
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for OneOrMany<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<OneOrMany<T>, D::Error> {
        let read = Located::<Content<T>>::deserialize(deserializer)?;
        Ok(OneOrMany(match read.value {
            // A single table has the span of the whole value
            Content::One(value) => vec![Located {
                value,
                span: read.span,
            }],
            Content::Many(several) => several,
        }))
    }
}

schema!([T: JsonSchema] OneOrMany<T>, format!("OneOrMany{}", T::schema_name()), generator => {
    "anyOf": [
        generator.subschema_for::<T>(),
        { "type": "array", "items": generator.subschema_for::<T>() },
    ],
});

#[cfg(test)]
mod tests {
    use serde::de::DeserializeOwned;

    use super::super::node::{TomlError, from_text};
    use super::*;

    #[derive(Debug, Deserialize)]
    struct Holder<T> {
        x: T,
    }

    fn read<T: DeserializeOwned>(text: &str) -> Result<T, TomlError> {
        from_text::<Holder<T>>(text).map(|holder| holder.x)
    }

    #[test]
    fn colour_accepts_a_grey_three_numbers_or_srgb() {
        assert_eq!(read::<Color>("x = 2").unwrap(), Color([2.0; 3]));
        assert_eq!(read::<Color>("x = [0, 0.5, 1]").unwrap(), Color([0.0, 0.5, 1.0]));
        // sRGB 0.5019608 is linear 0.2158605.
        let Color([r, g, b]) = read("x = \"#ff8000\"").unwrap();
        assert_eq!((r, b), (1.0, 0.0));
        assert!((g - 0.215_860_5).abs() < f32::EPSILON);
        assert_eq!(
            read::<Rgba>("x = \"#ffffff00\"").unwrap(),
            Rgba([1.0, 1.0, 1.0, 0.0])
        );
    }

    #[test]
    fn invalid_colour_is_reported_at_its_position() {
        for bad in [
            "x = -1",
            "x = [0, 1]",
            "x = \"red\"",
            "x = [0, inf, 0]",
            "x = \"#ff\"",
            "x = \"#é1234\"",
        ] {
            let error = read::<Color>(bad).unwrap_err();
            assert_eq!(error.span().unwrap().start, 4, "{bad}: {error}");
        }
    }

    #[test]
    fn parameter_accepts_a_value_or_a_texture() {
        assert_eq!(read::<Param<f32>>("x = 1").unwrap().value(), 1.0);
        let textured: Param<Color> = read("x = { texture = \"wood\", value = 0.5 }").unwrap();
        assert_eq!(textured.value(), Color([0.5; 3]));
        let Param::Textured(textured) = textured else {
            unreachable!()
        };
        assert_eq!((&**textured.texture, textured.texture.span.start), ("wood", 16));
    }
}
