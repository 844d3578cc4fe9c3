//! Lights and surroundings.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::value::{At, Color, Vector};
use crate::scene::{Background, Falloff, Light, LightKind};

/// A light without extent.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct LightForm {
    /// What messages call it.
    pub(super) name: Option<At<String>>,
    /// `point`, `directional` or `spot`.
    kind: Kind,
    /// What the intensity is multiplied by.
    #[serde(default = "white")]
    color: Color,
    /// Candela for point and spot lights with physical falloff, lux for directional lights and those without falloff.
    #[serde(default = "intensity")]
    intensity: f64,
    /// Where a point or spot light stands.
    position: Option<Vector>,
    /// The way that the light of a directional or spot light travels; any length.
    direction: Option<Vector>,
    /// What a spot light points at, in place of a direction.
    at: Option<Vector>,
    /// Degrees from the axis of a spot light within which it is full.
    #[schemars(extend("default" = INNER))]
    inner: Option<f64>,
    /// Degrees from the axis of a spot light outside which it is dark; at most 180.
    #[schemars(extend("default" = OUTER))]
    outer: Option<f64>,
    /// How a point or spot light weakens with the distance d: `physical` (1/d²), `none`, or [c, l, q] for
    /// 1/(c + l d + q d²).
    falloff: Option<FalloffForm>,
    /// Distance at which nothing is left of a light with physical falloff.
    range: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Point,
    Directional,
    Spot,
}

fn white() -> Color {
    Color::WHITE
}

fn intensity() -> f64 {
    1.0
}

/// Degrees of a spot light's full cone where a file does not say it; glTF's.
const INNER: f64 = 0.0;
/// Degrees of a spot light's cone where a file does not say it; glTF's.
const OUTER: f64 = 45.0;

#[derive(Clone, Copy, Debug)]
enum FalloffForm {
    Physical,
    None,
    Polynomial([f64; 3]),
}

struct FalloffVisitor;

impl<'de> Visitor<'de> for FalloffVisitor {
    type Value = FalloffForm;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("\"physical\", \"none\" or [constant, linear, quadratic]")
    }

    fn visit_str<E: Error>(self, word: &str) -> Result<FalloffForm, E> {
        match word {
            "physical" => Ok(FalloffForm::Physical),
            "none" => Ok(FalloffForm::None),
            _ => Err(E::unknown_variant(word, &["physical", "none"])),
        }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<FalloffForm, A::Error> {
        <[f64; 3]>::deserialize(SeqAccessDeserializer::new(list)).map(FalloffForm::Polynomial)
    }
}

impl<'de> Deserialize<'de> for FalloffForm {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<FalloffForm, D::Error> {
        deserializer.deserialize_any(FalloffVisitor)
    }
}

impl JsonSchema for FalloffForm {
    fn schema_name() -> Cow<'static, str> {
        "Falloff".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [
                { "enum": ["physical", "none"] },
                { "type": "array", "items": { "type": "number", "minimum": 0 }, "minItems": 3, "maxItems": 3 },
            ],
            "default": "physical",
        })
    }
}

impl LightForm {
    /// The light, called by its number where it has no name.
    pub(super) fn light(&self, number: usize) -> Result<Light, String> {
        self.check_keys()?;
        let name = self
            .name
            .as_ref()
            .map_or_else(|| format!("light {number}"), |n| n.to_string());
        let kind = match self.kind {
            Kind::Directional => LightKind::Directional {
                to_light: -self.aim()?,
            },
            Kind::Point => LightKind::Point {
                position: self.place()?,
                falloff: self.fall()?,
            },
            Kind::Spot => LightKind::Spot {
                position: self.place()?,
                direction: self.aim()?,
                cos_inner: self.inner.unwrap_or(INNER).to_radians().cos(),
                cos_outer: self.outer.unwrap_or(OUTER).to_radians().cos(),
                falloff: self.fall()?,
            },
        };
        let light = Light {
            name,
            intensity: self.color.0.map(|c| (f64::from(c) * self.intensity) as f32),
            kind,
        };
        crate::scene::check_light(&light)?;
        Ok(light)
    }

    /// Refuses keys that mean nothing for the kind of light, and cones that the cosine would hide.
    fn check_keys(&self) -> Result<(), String> {
        let (point, directional, spot) = (Kind::Point, Kind::Directional, Kind::Spot);
        let keys: [(bool, &str, &[Kind]); 7] = [
            (self.position.is_some(), "position", &[point, spot]),
            (self.direction.is_some(), "direction", &[directional, spot]),
            (self.at.is_some(), "at", &[spot]),
            (self.inner.is_some(), "inner", &[spot]),
            (self.outer.is_some(), "outer", &[spot]),
            (self.falloff.is_some(), "falloff", &[point, spot]),
            (self.range.is_some(), "range", &[point, spot]),
        ];
        for (given, key, kinds) in keys {
            if given && !kinds.contains(&self.kind) {
                return Err(format!(
                    "a {:?} light has no `{key}`: take it away or give another `kind`",
                    self.kind
                )
                .to_lowercase());
            }
        }
        let (inner, outer) = (self.inner.unwrap_or(INNER), self.outer.unwrap_or(OUTER));
        if !(0.0 <= inner && inner < outer && outer <= 180.0) {
            return Err(format!(
                "its cone goes from {inner} to {outer} degrees: give 0 <= `inner` < `outer` <= 180"
            ));
        }
        Ok(())
    }

    fn place(&self) -> Result<glam::DVec3, String> {
        self.position
            .map(|p| p.0)
            .ok_or_else(|| "stands nowhere: give its `position`".into())
    }

    fn aim(&self) -> Result<glam::DVec3, String> {
        let direction = match (self.direction, self.at) {
            (Some(_), Some(_)) => {
                return Err("has both `direction` and `at`: give one".into());
            }
            (Some(direction), None) => direction.0,
            (None, Some(at)) => at.0 - self.place()?,
            (None, None) => return Err("points nowhere: give its `direction`".into()),
        };
        direction
            .try_normalize()
            .ok_or_else(|| "has a direction without length: give another".into())
    }

    fn fall(&self) -> Result<Falloff, String> {
        let falloff = match self.falloff.unwrap_or(FalloffForm::Physical) {
            FalloffForm::Physical => return Ok(Falloff::InverseSquare { range: self.range }),
            FalloffForm::None => Falloff::NONE,
            FalloffForm::Polynomial([constant, linear, quadratic]) => Falloff::Polynomial {
                constant,
                linear,
                quadratic,
            },
        };
        if self.range.is_some() {
            return Err(
                "has a `range` that its `falloff` does not know: take it away or make it \"physical\"".into(),
            );
        }
        Ok(falloff)
    }
}

/// One colour from everywhere, or a gradient over the height.
#[derive(Clone, Debug)]
pub(super) enum BackgroundForm {
    Uniform(Color),
    Gradient(Gradient),
}

/// A gradient over the height of the direction.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Gradient {
    /// Level.
    horizon: Color,
    /// Straight up, along +y.
    up: Color,
    /// Straight down; as `horizon` if absent.
    down: Option<Color>,
}

struct BackgroundVisitor;

impl<'de> Visitor<'de> for BackgroundVisitor {
    type Value = BackgroundForm;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a colour or { horizon = ..., up = ..., down = ... }")
    }

    fn visit_f64<E: Error>(self, grey: f64) -> Result<BackgroundForm, E> {
        Color::deserialize(grey.into_deserializer()).map(BackgroundForm::Uniform)
    }

    fn visit_i64<E: Error>(self, grey: i64) -> Result<BackgroundForm, E> {
        Color::deserialize(grey.into_deserializer()).map(BackgroundForm::Uniform)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<BackgroundForm, E> {
        Color::deserialize(text.into_deserializer()).map(BackgroundForm::Uniform)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<BackgroundForm, A::Error> {
        Color::deserialize(SeqAccessDeserializer::new(list)).map(BackgroundForm::Uniform)
    }

    fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<BackgroundForm, A::Error> {
        Gradient::deserialize(MapAccessDeserializer::new(table)).map(BackgroundForm::Gradient)
    }
}

impl<'de> Deserialize<'de> for BackgroundForm {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<BackgroundForm, D::Error> {
        deserializer.deserialize_any(BackgroundVisitor)
    }
}

impl JsonSchema for BackgroundForm {
    fn schema_name() -> Cow<'static, str> {
        "Background".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let color = generator.subschema_for::<Color>();
        let gradient = generator.subschema_for::<Gradient>();
        json_schema!({ "anyOf": [color, gradient] })
    }
}

impl BackgroundForm {
    pub(super) fn background(&self) -> Background {
        match self {
            BackgroundForm::Uniform(color) => Background::Uniform(color.0),
            BackgroundForm::Gradient(gradient) => Background::Gradient {
                horizon: gradient.horizon.0,
                up: gradient.up.0,
                down: gradient.down.unwrap_or(gradient.horizon).0,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(text: &str) -> Result<Light, String> {
        toml::from_str::<LightForm>(text)
            .map_err(|e| e.to_string())?
            .light(0)
    }

    #[test]
    fn a_spot_light_points_at_what_it_is_pointed_at() {
        let spot =
            light("kind = 'spot'\nposition = [0, 4, 0]\nat = [0, 1, 0]\ninner = 0\nouter = 60").unwrap();
        let LightKind::Spot {
            direction, cos_outer, ..
        } = spot.kind
        else {
            unreachable!()
        };
        assert_eq!(direction, glam::DVec3::NEG_Y);
        assert!((cos_outer - 0.5).abs() < f64::EPSILON);
    }

    #[test]
    fn a_light_of_one_kind_has_no_keys_of_another() {
        for (bad, words) in [
            (
                "kind = 'directional'\ndirection = [0, -1, 0]\nposition = [0, 1, 0]",
                "has no `position`",
            ),
            (
                "kind = 'point'\nposition = [0, 1, 0]\ninner = 3",
                "has no `inner`",
            ),
            ("kind = 'point'", "stands nowhere"),
            ("kind = 'directional'\ndirection = [0, 0, 0]", "without length"),
            ("kind = 'point'\nposition = [0, 1, 0]\nintensity = -1", "negative"),
            (
                "kind = 'point'\nposition = [0, 1, 0]\nfalloff = 'none'\nrange = 3",
                "`range`",
            ),
            (
                "kind = 'point'\nposition = [0, 1, 0]\nfalloff = [0, 0, 0]",
                "makes no sense",
            ),
            (
                "kind = 'spot'\nposition = [0, 1, 0]\nat = [0, 0, 0]\ninner = 50",
                "its cone",
            ),
            (
                "kind = 'spot'\nposition = [0, 1, 0]\nat = [0, 0, 0]\nouter = 400",
                "its cone",
            ),
        ] {
            let error = light(bad).unwrap_err();
            assert!(error.contains(words), "{bad}: {error}");
        }
    }
}
