//! Lights and backgrounds of scene files.

use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::{IntoDeserializer, Unexpected};

use super::forms::{forms, schema};
use super::value::{Color, Located, Vector};
use crate::scene::{
    AreaShape, Background, DEFAULT_LIGHT_SAMPLES, Falloff, Light, LightKind, MAX_LIGHT_SAMPLES,
};

/// A light: a punctual one, or an area light, whose own surface is invisible.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct LightForm {
    /// Name of the light in messages.
    pub(super) name: Option<Located<String>>,
    /// `point`, `directional` or `spot`; `quad`, `disk` or `sphere` for area lights with soft shadows.
    kind: Kind,
    /// Colour, a factor on the intensity.
    #[serde(default = "white")]
    color: Color,
    /// Candela for point and spot lights with physical falloff, lux for directional lights and those without falloff;
    /// candela per square metre for area lights.
    #[serde(default = "intensity")]
    intensity: f64,
    /// Position of a point or spot light; the centre of a quad, disk or sphere.
    position: Option<Vector>,
    /// Direction in which the light of a directional or spot light travels, or to which a disk emits; any length.
    direction: Option<Vector>,
    /// Point that a spot light or a disk is aimed at, instead of a direction.
    at: Option<Vector>,
    /// Degrees from the axis of a spot light within which the intensity is full.
    #[schemars(extend("default" = INNER))]
    inner: Option<f64>,
    /// Degrees from the axis of a spot light outside which it is dark; at most 180.
    #[schemars(extend("default" = OUTER))]
    outer: Option<f64>,
    /// Attenuation of a point or spot light with the distance d: `physical` (1/d²), `none`, or [c, l, q] for 1/(c + l d
    /// + q d²).
    falloff: Option<FalloffForm>,
    /// Distance at which a light with physical falloff has faded to zero.
    range: Option<f64>,
    /// One side of a quad, which emits to the side of u × v.
    u: Option<Vector>,
    /// The other side of a quad.
    v: Option<Vector>,
    /// Radius of a disk or sphere in metres.
    radius: Option<f64>,
    /// Points on a quad, disk or sphere that every shading point samples, for each sample of a pixel.
    #[schemars(extend("default" = DEFAULT_LIGHT_SAMPLES))]
    samples: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Point,
    Directional,
    Spot,
    Quad,
    Disk,
    Sphere,
}

fn white() -> Color {
    Color::WHITE
}

fn intensity() -> f64 {
    1.0
}

/// Default half angle of the full intensity of a spot light in degrees; glTF's.
const INNER: f64 = 0.0;
/// Default half angle of a spot light's cone in degrees; glTF's.
const OUTER: f64 = 45.0;

/// Number of points of an emissive object that shading points sample; `None` if the object does not light the scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct EmissiveForm(pub(super) Option<u32>);

forms! {
    ['de] EmissiveForm, format_args!("true, false or a number of samples from 1 to {MAX_LIGHT_SAMPLES}");
    boolean is_emissive => Ok(EmissiveForm(is_emissive.then_some(DEFAULT_LIGHT_SAMPLES)));
    integer number => match u32::try_from(number) {
        Ok(samples @ 1..=MAX_LIGHT_SAMPLES) => Ok(EmissiveForm(Some(samples))),
        _ => {
            let allowed = format!("true, false or a number of samples from 1 to {MAX_LIGHT_SAMPLES}");
            Err(E::invalid_value(Unexpected::Signed(number), &allowed.as_str()))
        }
    };
}

schema!([] EmissiveForm, "Lamp", _generator => {
    "anyOf": [
        { "type": "boolean" },
        { "type": "integer", "minimum": 1, "maximum": MAX_LIGHT_SAMPLES },
    ],
    "default": false,
});

#[derive(Clone, Copy, Debug)]
enum FalloffForm {
    Physical,
    None,
    Polynomial([f64; 3]),
}

forms! {
    ['de] FalloffForm, "\"physical\", \"none\" or [constant, linear, quadratic]";
    text word => match word {
        "physical" => Ok(FalloffForm::Physical),
        "none" => Ok(FalloffForm::None),
        _ => Err(E::unknown_variant(word, &["physical", "none"])),
    };
    list list => <[f64; 3]>::deserialize(list).map(FalloffForm::Polynomial);
}

schema!([] FalloffForm, "Falloff", _generator => {
    "anyOf": [
        { "enum": ["physical", "none"] },
        { "type": "array", "items": { "type": "number", "minimum": 0 }, "minItems": 3, "maxItems": 3 },
    ],
    "default": "physical",
});

impl LightForm {
    /// Returns the light, named by its number if it has no name.
    pub(super) fn light(&self, number: usize) -> Result<Light, String> {
        self.check_keys()?;
        let name = self
            .name
            .as_ref()
            .map_or_else(|| format!("light {number}"), |n| n.to_string());
        // Collect the keys that the kind of light needs
        let kind = match self.kind {
            Kind::Directional => LightKind::Directional {
                to_light: -self.unit_direction()?,
            },
            Kind::Point => LightKind::Point {
                position: self.required_position()?,
                falloff: self.make_falloff()?,
            },
            Kind::Spot => LightKind::Spot {
                position: self.required_position()?,
                direction: self.unit_direction()?,
                cos_inner: self.inner.unwrap_or(INNER).to_radians().cos(),
                cos_outer: self.outer.unwrap_or(OUTER).to_radians().cos(),
                falloff: self.make_falloff()?,
            },
            Kind::Quad | Kind::Disk | Kind::Sphere => LightKind::Area {
                shape: self.shape()?,
                samples: self.samples.unwrap_or(DEFAULT_LIGHT_SAMPLES),
            },
        };
        // Check the light with its final intensity
        let light = Light {
            name,
            intensity: self.color.0.map(|c| (f64::from(c) * self.intensity) as f32),
            kind,
        };
        crate::scene::check_light(&light)?;
        Ok(light)
    }

    /// Rejects keys that the kind of light does not have, and cone angles that taking the cosine would hide.
    fn check_keys(&self) -> Result<(), String> {
        let (point, directional, spot) = (Kind::Point, Kind::Directional, Kind::Spot);
        let (quad, disk, sphere) = (Kind::Quad, Kind::Disk, Kind::Sphere);
        // List each key with the kinds that have it
        let keys: [(bool, &str, &[Kind]); 11] = [
            (
                self.position.is_some(),
                "position",
                &[point, spot, quad, disk, sphere],
            ),
            (self.direction.is_some(), "direction", &[directional, spot, disk]),
            (self.at.is_some(), "at", &[spot, disk]),
            (self.inner.is_some(), "inner", &[spot]),
            (self.outer.is_some(), "outer", &[spot]),
            (self.falloff.is_some(), "falloff", &[point, spot]),
            (self.range.is_some(), "range", &[point, spot]),
            (self.u.is_some(), "u", &[quad]),
            (self.v.is_some(), "v", &[quad]),
            (self.radius.is_some(), "radius", &[disk, sphere]),
            (self.samples.is_some(), "samples", &[quad, disk, sphere]),
        ];
        for (given, key, kinds) in keys {
            if given && !kinds.contains(&self.kind) {
                return Err(format!(
                    "a {:?} light has no `{key}`: remove it or give another `kind`",
                    self.kind
                )
                .to_lowercase());
            }
        }
        // Check the cone in degrees, as the cosine is not unique beyond 180
        let (inner, outer) = (self.inner.unwrap_or(INNER), self.outer.unwrap_or(OUTER));
        if !(0.0 <= inner && inner < outer && outer <= 180.0) {
            return Err(format!(
                "its cone goes from {inner} to {outer} degrees: give 0 <= `inner` < `outer` <= 180"
            ));
        }
        Ok(())
    }

    /// Returns the shape of an area light.
    fn shape(&self) -> Result<AreaShape, String> {
        let center = self.required_position()?;
        // A quad by its sides
        if self.kind == Kind::Quad {
            let (Some(u), Some(v)) = (self.u, self.v) else {
                return Err("is a quad without sides: give `u` and `v`".into());
            };
            return Ok(AreaShape::Quad {
                center,
                half_u: 0.5 * u.0,
                half_v: 0.5 * v.0,
            });
        }
        // A disk or a sphere by its radius
        let radius = self
            .radius
            .ok_or("has no size: give its `radius`, or make it a `point`")?;
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(format!("its radius is {radius}: give a positive one, in metres"));
        }
        if self.kind == Kind::Sphere {
            return Ok(AreaShape::Sphere { center, radius });
        }
        // Any orthonormal pair spans the disk; their cross product is its direction
        let (half_u, half_v) = self.unit_direction()?.any_orthonormal_pair();
        Ok(AreaShape::Disk {
            center,
            half_u: radius * half_u,
            half_v: radius * half_v,
        })
    }

    fn required_position(&self) -> Result<glam::DVec3, String> {
        self.position
            .map(|p| p.0)
            .ok_or_else(|| "has no position: give its `position`".into())
    }

    fn unit_direction(&self) -> Result<glam::DVec3, String> {
        let direction = match (self.direction, self.at) {
            (Some(_), Some(_)) => {
                return Err("has both `direction` and `at`: give one".into());
            }
            (Some(direction), None) => direction.0,
            // Aim from the light's position
            (None, Some(at)) => at.0 - self.required_position()?,
            (None, None) => return Err("has no direction: give its `direction`".into()),
        };
        direction
            .try_normalize()
            .ok_or_else(|| "has a direction without length: give another".into())
    }

    fn make_falloff(&self) -> Result<Falloff, String> {
        // Only physical falloff can have a range
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
                "has a `range` that its `falloff` does not support: remove it or make it \"physical\"".into(),
            );
        }
        Ok(falloff)
    }
}

/// A background: one colour for all directions, a gradient over the height, or an environment map.
#[derive(Debug)]
pub(super) enum BackgroundForm {
    Uniform(Color),
    Table(Box<Surroundings>),
}

/// A gradient over the height of the direction (`horizon`, `up`, `down`), or an environment map that lights the scene
/// (`environment` and the keys after it).
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Surroundings {
    /// Radiance of level directions.
    horizon: Option<Color>,
    /// Radiance straight up, along +y.
    up: Option<Color>,
    /// Radiance straight down; as `horizon` if absent.
    down: Option<Color>,
    /// An .hdr or .exr file, relative to this one, twice as wide as high: its top row is up, its middle at -z.
    pub(super) environment: Option<Located<String>>,
    /// Degrees that the image is turned by about +y, counter-clockwise as seen from above.
    #[schemars(extend("default" = 0.0))]
    turn: Option<f64>,
    /// Factor on the image's values.
    #[schemars(extend("default" = 1.0))]
    scale: Option<f64>,
    /// Directions into the environment map that every shading point samples, for each sample of a pixel; with 0 the map is
    /// seen by rays and lights nothing.
    #[schemars(extend("default" = DEFAULT_LIGHT_SAMPLES))]
    samples: Option<u32>,
}

forms! {
    ['de] BackgroundForm, "a colour, { horizon = ..., up = ..., down = ... } or { environment = ... }";
    number grey => Color::deserialize(grey.into_deserializer()).map(BackgroundForm::Uniform);
    text text => Color::deserialize(text.into_deserializer()).map(BackgroundForm::Uniform);
    list list => Color::deserialize(list).map(BackgroundForm::Uniform);
    table table => Box::deserialize(table).map(BackgroundForm::Table);
}

schema!([] BackgroundForm, "Background", generator => {
    "anyOf": [generator.subschema_for::<Color>(), generator.subschema_for::<Surroundings>()],
});

impl BackgroundForm {
    /// Returns the file of the environment map, if there is one.
    pub(super) fn file(&self) -> Option<&Located<String>> {
        match self {
            BackgroundForm::Uniform(_) => None,
            BackgroundForm::Table(table) => table.environment.as_ref(),
        }
    }

    /// Returns the scene's background; an environment map is the scene's image with index `image`.
    pub(super) fn background(&self, image: u32) -> Result<Background, String> {
        match self {
            BackgroundForm::Uniform(color) => Ok(Background::Uniform(color.0)),
            BackgroundForm::Table(table) => table.background(image),
        }
    }
}

impl Surroundings {
    fn background(&self, image: u32) -> Result<Background, String> {
        let (horizon, up) = (self.horizon, self.up);
        // Exactly one group of keys may be given
        let has_gradient = horizon.is_some() || up.is_some() || self.down.is_some();
        let has_environment_keys = self.turn.is_some() || self.scale.is_some() || self.samples.is_some();
        match (&self.environment, horizon, up) {
            (Some(_), ..) if !has_gradient => Ok(Background::Environment {
                image,
                rotation: self.turn.unwrap_or(0.0).to_radians(),
                scale: self.scale.unwrap_or(1.0) as f32,
                samples: self.samples.unwrap_or(DEFAULT_LIGHT_SAMPLES),
            }),
            (None, Some(horizon), Some(up)) if !has_environment_keys => Ok(Background::Gradient {
                horizon: horizon.0,
                up: up.0,
                down: self.down.unwrap_or(horizon).0,
            }),
            _ => Err(
                "the background is ambiguous or incomplete: give `horizon` and `up`, or `environment`".into(),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::node::from_text;
    use super::*;

    fn light(text: &str) -> Result<Light, String> {
        from_text::<LightForm>(text).map_err(|e| e.to_string())?.light(0)
    }

    #[test]
    fn spot_light_points_at_its_target() {
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
    fn flat_lights_emit_towards_their_target() {
        let front = |text: &str| match light(text).unwrap().kind {
            LightKind::Area {
                shape: AreaShape::Quad { half_u, half_v, .. } | AreaShape::Disk { half_u, half_v, .. },
                samples: DEFAULT_LIGHT_SAMPLES,
            } => half_u.cross(half_v),
            other => panic!("{other:?}"),
        };
        // A disk emits toward the point it is aimed at
        let disk = front("kind = 'disk'\nposition = [0, 4, 0]\nat = [0, 1, 0]\nradius = 2");
        assert!(
            (disk - 4.0 * glam::DVec3::NEG_Y).length() < 8.0 * f64::EPSILON,
            "{disk}"
        );
        // u × v of whole sides is four times that of half sides.
        let quad = front("kind = 'quad'\nposition = [0, 4, 0]\nu = [2, 0, 0]\nv = [0, 0, 4]");
        assert_eq!(quad, 2.0 * glam::DVec3::NEG_Y);
    }

    #[test]
    fn background_is_a_gradient_or_an_environment_map() {
        #[derive(Deserialize)]
        struct File {
            b: BackgroundForm,
        }
        let background = |text: &str| from_text::<File>(text).unwrap().b.background(7);
        // An environment map with its keys
        let map = background("b = { environment = 'sky.hdr', turn = 180, scale = 2 }").unwrap();
        assert_eq!(
            map,
            Background::Environment {
                image: 7,
                rotation: 180f64.to_radians(),
                scale: 2.0,
                samples: DEFAULT_LIGHT_SAMPLES
            }
        );
        for bad in [
            "b = { horizon = 1 }",
            "b = { environment = 'sky.hdr', up = 1 }",
            "b = { horizon = 1, up = 1, turn = 3 }",
        ] {
            assert!(
                background(bad).unwrap_err().contains("ambiguous or incomplete"),
                "{bad}"
            );
        }
    }

    #[test]
    fn light_rejects_keys_of_other_kinds() {
        for (bad, words) in [
            (
                "kind = 'directional'\ndirection = [0, -1, 0]\nposition = [0, 1, 0]",
                "has no `position`",
            ),
            (
                "kind = 'point'\nposition = [0, 1, 0]\ninner = 3",
                "has no `inner`",
            ),
            ("kind = 'point'", "has no position"),
            (
                "kind = 'sphere'\nposition = [0, 1, 0]\nu = [1, 0, 0]",
                "has no `u`",
            ),
            ("kind = 'sphere'\nposition = [0, 1, 0]", "has no size"),
            (
                "kind = 'disk'\nposition = [0, 1, 0]\nradius = 0\nat = [0, 0, 0]",
                "its radius is 0",
            ),
            (
                "kind = 'sphere'\nposition = [0, 1, 0]\nradius = 1\nsamples = 0",
                "has 0 samples",
            ),
            (
                "kind = 'quad'\nposition = [0, 1, 0]\nu = [1, 0, 0]\nv = [2, 0, 0]",
                "area is zero",
            ),
            ("kind = 'directional'\ndirection = [0, 0, 0]", "without length"),
            ("kind = 'point'\nposition = [0, 1, 0]\nintensity = -1", "negative"),
            (
                "kind = 'point'\nposition = [0, 1, 0]\nfalloff = 'none'\nrange = 3",
                "`range`",
            ),
            (
                "kind = 'point'\nposition = [0, 1, 0]\nfalloff = [0, 0, 0]",
                "cone is invalid",
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
