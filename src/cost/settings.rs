//! Settings as a file: what a study chooses and a render takes.

use serde::{Deserialize, Serialize};

use super::{Configuration, Interval, SceneChange};
use crate::accel::{Backend, BuildQuality, Instancing, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{HitPoint, MIN_ADAPTIVE_ERROR, Pattern};
use crate::scene::image_settings::{MAX_DEPTH, MAX_SPP, MAX_WAVELENGTHS};
use crate::scene::{Effect, MAX_LIGHT_SAMPLES, MAX_ROUGH_RAYS};
use crate::scene_file::node::from_text;

/// Steps through volumes may be so many times as long as the scene's, or as short.
const MAX_STEP_FACTOR: f64 = 1024.0;

/// A file of settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsFile {
    /// What a render takes.
    pub settings: Settings,
    /// What was measured of it, for whoever reads the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<Measured>,
}

/// What may be chosen of a render; what is absent is as it would be without the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Samples a pixel; with `adaptive` the most.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// How they lie in the pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pattern: Option<Pattern>,
    /// The standard error as displayed that ends the sampling of a pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adaptive: Option<f64>,
    /// Generations of reflected and refracted rays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<u32>,
    /// The weight under which a ray is not followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cutoff: Option<f32>,
    /// Wavelengths that a path splits into.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wavelengths: Option<u32>,
    /// Points of each extended light that a surface asks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_samples: Option<u32>,
    /// Rays into the lobe of a rough surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rough_rays: Option<u32>,
    /// Length of the steps through volumes, over the scene's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub march_step: Option<f64>,
    /// Whether textures are averaged over what a ray covers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture_filter: Option<bool>,
    /// What finds the hits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend: Option<Backend>,
    /// How far triangle hits may be trusted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<Precision>,
    /// How Embree is given placed meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instancing: Option<Instancing>,
    /// How much work Embree puts into its trees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub build_quality: Option<BuildQuality>,
    /// Whether Embree saves memory rather than time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compact: Option<bool>,
    /// Where rays start that leave surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spawn: Option<SpawnPolicy>,
    /// Where on surfaces hits lie.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hit_points: Option<HitPoint>,
}

/// What was measured of settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// The scene, as it was named.
    pub scene: String,
    /// Width and height of the pictures.
    pub size: [u32; 2],
    /// Root of the mean squared error as displayed.
    pub rmse: Interval,
    /// Seconds of a picture's samples.
    pub seconds: Interval,
    /// Threads that rendered.
    pub threads: usize,
    /// Whether the reference had converged.
    pub converged: bool,
}

impl Settings {
    /// All of a configuration.
    pub fn of(configuration: &Configuration) -> Settings {
        let settings = &configuration.settings;
        let SceneChange {
            light_samples,
            rough_rays,
            step_factor,
        } = configuration.change;
        Settings {
            spp: Some(settings.spp),
            pattern: Some(settings.pattern),
            adaptive: settings.adaptive.map(|adaptive| adaptive.error),
            depth: Some(settings.depth),
            cutoff: Some(settings.weight_cutoff),
            wavelengths: Some(settings.wavelengths),
            light_samples,
            rough_rays,
            march_step: (step_factor != 1.0).then_some(step_factor),
            texture_filter: settings
                .effects
                .removed
                .has(Effect::TextureFilter)
                .then_some(false),
            backend: Some(configuration.path.backend),
            precision: Some(configuration.path.precision),
            instancing: Some(configuration.path.instancing),
            build_quality: Some(configuration.path.build_quality),
            compact: configuration.path.compact.then_some(true),
            spawn: Some(settings.spawn),
            hit_points: Some(settings.hit_points),
        }
    }

    /// What they change of the scene itself.
    pub fn change(&self) -> SceneChange {
        SceneChange {
            light_samples: self.light_samples,
            rough_rays: self.rough_rays,
            step_factor: self.march_step.unwrap_or(1.0),
        }
    }

    /// The first that is out of its range: its name and what to give.
    fn fault(&self) -> Option<(&'static str, String)> {
        let counts = [
            ("spp", self.spp, 1, MAX_SPP),
            ("depth", self.depth, 0, MAX_DEPTH),
            ("wavelengths", self.wavelengths, 1, MAX_WAVELENGTHS),
            ("light_samples", self.light_samples, 1, MAX_LIGHT_SAMPLES),
            ("rough_rays", self.rough_rays, 0, MAX_ROUGH_RAYS),
        ];
        let sizes = [
            ("adaptive", self.adaptive, MIN_ADAPTIVE_ERROR, 1.0),
            ("cutoff", self.cutoff.map(f64::from), 0.0, 1.0),
            (
                "march_step",
                self.march_step,
                1.0 / MAX_STEP_FACTOR,
                MAX_STEP_FACTOR,
            ),
        ];
        let counts = counts.into_iter().map(|(name, value, low, high)| {
            let is_wrong = value.is_some_and(|value| !(low..=high).contains(&value));
            (is_wrong, name, format!("{low} to {high}"))
        });
        let sizes = sizes.into_iter().map(|(name, value, low, high)| {
            let is_wrong = value.is_some_and(|value| !(low..=high).contains(&value));
            (is_wrong, name, format!("{low} to {high}"))
        });
        let mut all = counts.chain(sizes);
        all.find(|(is_wrong, _, _)| *is_wrong)
            .map(|(_, name, range)| (name, range))
    }
}

/// The part of a file that tells what was measured.
#[derive(Serialize)]
struct MeasuredPart<'a> {
    measured: &'a Measured,
}

/// A part of a file as TOML. As one document the settings would be compiled for every place that a table can have in
/// it.
fn toml_text(part: &impl Serialize) -> String {
    // Nothing in it has no form in TOML.
    toml::to_string(part).unwrap_or_default()
}

impl SettingsFile {
    /// The file as TOML.
    pub fn text(&self) -> String {
        let mut text = format!("[settings]\n{}", toml_text(&self.settings));
        if let Some(measured) = &self.measured {
            text.push('\n');
            text += &toml_text(&MeasuredPart { measured });
        }
        text
    }

    /// What a file holds.
    ///
    /// # Errors
    ///
    /// What is wrong with it, as the end of a sentence that begins with the file's name.
    pub fn parse(text: &str) -> Result<SettingsFile, String> {
        let file: SettingsFile = from_text(text).map_err(|error| {
            let line = error.span().map_or(String::new(), |span| {
                let before = text.get(..span.start).unwrap_or_default();
                format!(", line {}", before.matches('\n').count() + 1)
            });
            format!("is no file of settings{line}: {}", error.message())
        })?;
        match file.settings.fault() {
            Some((name, range)) => Err(format!("says a `{name}` that cannot be: give {range}")),
            None => Ok(file),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::HitPath;
    use crate::render::RenderSettings;

    #[test]
    fn what_is_written_is_read_again() {
        let configuration = Configuration {
            settings: RenderSettings {
                spp: 8,
                pattern: Pattern::Sobol,
                ..RenderSettings::default()
            },
            path: HitPath::BSP,
            change: SceneChange {
                rough_rays: Some(2),
                step_factor: 0.5,
                ..SceneChange::default()
            },
        };
        let file = SettingsFile {
            settings: Settings::of(&configuration),
            measured: Some(Measured {
                scene: "scenes/\"a\".toml".to_owned(),
                size: [64, 48],
                rmse: Interval::exact(0.01),
                seconds: Interval::exact(1.5),
                threads: 2,
                converged: true,
            }),
        };
        let text = file.text();
        assert_eq!(text, toml::to_string(&file).unwrap());
        assert_eq!(SettingsFile::parse(&text), Ok(file.clone()), "{text}");
        assert_eq!(file.settings.change(), configuration.change);
        let bare = SettingsFile {
            settings: Settings::default(),
            measured: None,
        };
        assert_eq!(bare.text(), toml::to_string(&bare).unwrap());
    }

    #[test]
    fn faults_are_told_with_their_place() {
        for (text, word) in [
            ("[settings]\nspp = 0\n", "`spp`"),
            ("[settings]\nmarch_step = 0.0\n", "`march_step`"),
            ("[settings]\ncutoff = nan\n", "`cutoff`"),
            ("[settings]\n\nsampels = 3\n", "line 3"),
            ("[settings]\npattern = \"spiral\"\n", "line 2"),
            ("", "settings"),
            ("[settings]\nspawn = \"fixed:2\"\n", "fixed:0.0001"),
            ("{", "line 1"),
        ] {
            let error = SettingsFile::parse(text).unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }
}
