//! Textures of scene files: images and patterns.

use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::IntoDeserializer;

use super::forms::{forms, schema};
use super::value::{Each, Located, Rgba};
use crate::scene::{Filter, Pattern, Procedural, Sampler, Space, Wrap};

/// A texture: an `image`, or a `pattern`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct TextureForm {
    /// A PNG, JPEG, Radiance HDR or EXR file, relative to the scene file. Values of PNG and JPEG are sRGB for colours
    /// and linear for all else; HDR and EXR are linear, and may exceed 1 for emission.
    pub(super) image: Option<Located<String>>,
    /// Continuation of the image outside [0, 1]: one word, or one for u and one for v.
    #[schemars(extend("default" = "repeat"))]
    wrap: Option<WrapForm>,
    /// Interpolation between the image's pixels.
    #[schemars(extend("default" = "mipmap"))]
    filter: Option<FilterForm>,
    /// A procedural pattern instead of an image.
    pattern: Option<PatternForm>,
    /// The two colours that a pattern chooses from or mixes; black and white if absent.
    colors: Option<[Rgba; 2]>,
    /// Factor on the coordinates of a pattern.
    #[schemars(extend("default" = SCALE))]
    scale: Option<Each<3>>,
    /// Space of a pattern: on the surface (`uv`), or in the solid as if the object were carved from it (`object`).
    #[schemars(extend("default" = "object"))]
    space: Option<SpaceForm>,
    /// Number of octaves of noise and marble, 1 to 16.
    #[schemars(extend("default" = OCTAVES))]
    octaves: Option<u32>,
    /// Amplitude by which noise shifts marble's veins and wood's rings.
    #[schemars(extend("default" = TURBULENCE))]
    turbulence: Option<f64>,
}

/// Default scale of a pattern.
const SCALE: f64 = 1.0;
/// Default number of octaves of a pattern.
const OCTAVES: u32 = 4;
/// Default turbulence of a pattern.
const TURBULENCE: f64 = 1.0;

#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum PatternForm {
    Checker,
    Gradient,
    Noise,
    Marble,
    Wood,
}

#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum SpaceForm {
    Uv,
    Object,
}

#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum FilterForm {
    Nearest,
    Linear,
    Mipmap,
}

#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum WrapWord {
    Repeat,
    Mirror,
    Clamp,
}

/// Wrap mode as one word for both directions, or one for each.
#[derive(Clone, Copy, Debug)]
struct WrapForm([WrapWord; 2]);

forms! {
    ['de] WrapForm, "\"repeat\", \"mirror\" or \"clamp\", or two of them in brackets";
    text word => WrapWord::deserialize(word.into_deserializer()).map(|word| WrapForm([word; 2]));
    list list => <[WrapWord; 2]>::deserialize(list).map(WrapForm);
}

schema!([] WrapForm, "Wrap", generator => {
    "anyOf": [generator.subschema_for::<WrapWord>(), generator.subschema_for::<[WrapWord; 2]>()],
});

impl WrapWord {
    fn wrap(self) -> Wrap {
        match self {
            WrapWord::Repeat => Wrap::Repeat,
            WrapWord::Mirror => Wrap::MirroredRepeat,
            WrapWord::Clamp => Wrap::ClampToEdge,
        }
    }
}

/// Kind of a texture, decided by its keys.
pub(super) enum TextureKind<'f> {
    Image {
        file: &'f Located<String>,
        sampler: Sampler,
    },
    Procedural(Procedural),
}

impl TextureForm {
    /// Returns the kind of the texture, or its fault.
    pub(super) fn kind(&self) -> Result<TextureKind<'_>, String> {
        match (&self.image, self.pattern) {
            (Some(_), Some(_)) => Err("has both `image` and `pattern`: give one".into()),
            (None, None) => Err("shows nothing: give an `image` or a `pattern`".into()),
            (Some(file), None) => {
                // Reject keys of patterns
                let foreign_keys = [
                    (self.colors.is_some(), "colors"),
                    (self.scale.is_some(), "scale"),
                    (self.space.is_some(), "space"),
                    (self.octaves.is_some(), "octaves"),
                    (self.turbulence.is_some(), "turbulence"),
                ];
                refuse(&foreign_keys, "an image")?;
                Ok(TextureKind::Image {
                    file,
                    sampler: self.sampler(),
                })
            }
            (None, Some(pattern)) => {
                // Reject keys of images
                let foreign_keys = [(self.wrap.is_some(), "wrap"), (self.filter.is_some(), "filter")];
                refuse(&foreign_keys, "a pattern")?;
                Ok(TextureKind::Procedural(self.procedural(pattern)?))
            }
        }
    }

    fn sampler(&self) -> Sampler {
        let [wrap_u, wrap_v] = self
            .wrap
            .map_or([Wrap::Repeat; 2], |wrap| wrap.0.map(WrapWord::wrap));
        let filter = match self.filter.unwrap_or(FilterForm::Mipmap) {
            FilterForm::Nearest => Filter::Nearest,
            FilterForm::Linear => Filter::Linear,
            FilterForm::Mipmap => Filter::Mipmap,
        };
        Sampler {
            wrap_u,
            wrap_v,
            filter,
        }
    }

    fn procedural(&self, pattern: PatternForm) -> Result<Procedural, String> {
        // Choose the pattern and reject keys that it does not have
        let octaves = self.octaves.unwrap_or(OCTAVES);
        let turbulence = self.turbulence.unwrap_or(TURBULENCE);
        let (pattern, has_octaves, has_turbulence) = match pattern {
            PatternForm::Checker => (Pattern::Checker, false, false),
            PatternForm::Gradient => (Pattern::Gradient, false, false),
            PatternForm::Noise => (Pattern::Noise { octaves }, true, false),
            PatternForm::Marble => (Pattern::Marble { octaves, turbulence }, true, true),
            PatternForm::Wood => (Pattern::Wood { turbulence }, false, true),
        };
        let foreign_keys = [
            (self.octaves.is_some() && !has_octaves, "octaves"),
            (self.turbulence.is_some() && !has_turbulence, "turbulence"),
        ];
        refuse(&foreign_keys, "this pattern")?;
        // Fill in the defaults
        let colors = self
            .colors
            .map_or([[0.0, 0.0, 0.0, 1.0], [1.0; 4]], |c| c.map(|c| c.0));
        let space = match self.space.unwrap_or(SpaceForm::Object) {
            SpaceForm::Uv => Space::Uv,
            SpaceForm::Object => Space::Object,
        };
        let procedural = Procedural {
            pattern,
            colors,
            space,
            scale: self.scale.map_or([SCALE; 3], |scale| scale.0),
        };
        crate::scene::check_procedural(&procedural)?;
        Ok(procedural)
    }
}

fn refuse(foreign_keys: &[(bool, &str)], whose: &str) -> Result<(), String> {
    match foreign_keys.iter().find(|(given, _)| *given) {
        Some((_, key)) => Err(format!("{whose} has no `{key}`: remove it")),
        None => Ok(()),
    }
}
