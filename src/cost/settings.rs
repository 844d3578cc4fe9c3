//! Settings file: output of a study and input of a render.

use serde::{Deserialize, Serialize};

use super::{Configuration, Interval, SceneChange};
use crate::accel::{Backend, BuildQuality, Instancing, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{HitPoint, MIN_ADAPTIVE_ERROR, Pattern};
use crate::scene::image_settings::{MAX_DEPTH, MAX_SPP, MAX_WAVELENGTHS};
use crate::scene::{Effect, MAX_LIGHT_SAMPLES, MAX_ROUGH_RAYS};
use crate::scene_file::node::from_text;

/// Largest factor by which march steps may be longer or shorter than the scene's.
const MAX_STEP_FACTOR: f64 = 1024.0;

/// Settings file in TOML, with optional measurements.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsFile {
    /// Settings that a render takes.
    pub settings: Settings,
    /// Measurements of these settings, as information for the reader.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<Measured>,
}

/// Settings of a render that can be chosen; an absent one keeps the value that the render has without the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Samples per pixel; with `adaptive` the largest number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// Sampling pattern within the pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pattern: Option<Pattern>,
    /// Standard error, in displayed values, that ends the sampling of a pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adaptive: Option<f64>,
    /// Maximum depth: bounces of reflected and refracted rays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<u32>,
    /// Path weight (throughput) below which a ray is not followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cutoff: Option<f32>,
    /// Wavelengths that a path splits into at dispersion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wavelengths: Option<u32>,
    /// Samples per area light and shading point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_samples: Option<u32>,
    /// Rays per shading point into the lobe of a rough surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rough_rays: Option<u32>,
    /// Length of the march steps through volumes, relative to the scene's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub march_step: Option<f64>,
    /// Texture filtering over the ray's footprint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture_filter: Option<bool>,
    /// Intersection backend that finds the hits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend: Option<Backend>,
    /// Precision of triangle hits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<Precision>,
    /// Way in which Embree represents instanced meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instancing: Option<Instancing>,
    /// Build quality of Embree's BVHs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub build_quality: Option<BuildQuality>,
    /// Embree's compact mode, which saves memory rather than time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compact: Option<bool>,
    /// Policy for the origins of rays that leave surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spawn: Option<SpawnPolicy>,
    /// Computation of hit points on surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hit_points: Option<HitPoint>,
}

/// Measured error and time of chosen settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// Name of the scene as the user gave it.
    pub scene: String,
    /// Width and height of the measured images, in pixels.
    pub size: [u32; 2],
    /// Root mean squared error of displayed values.
    pub rmse: Interval,
    /// Seconds for the samples of an image.
    pub seconds: Interval,
    /// Number of threads that rendered.
    pub threads: usize,
    /// Convergence of the reference that errors were taken against.
    pub converged: bool,
}

impl Settings {
    /// Returns all settings of a configuration.
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

    /// Returns the changes of the scene itself.
    pub fn change(&self) -> SceneChange {
        SceneChange {
            light_samples: self.light_samples,
            rough_rays: self.rough_rays,
            step_factor: self.march_step.unwrap_or(1.0),
        }
    }

    /// Returns the name of the first setting that is out of range, with the valid range.
    fn find_out_of_range(&self) -> Option<(&'static str, String)> {
        // List values with their valid ranges
        let counts = [
            ("spp", self.spp, 1, MAX_SPP),
            ("depth", self.depth, 0, MAX_DEPTH),
            ("wavelengths", self.wavelengths, 1, MAX_WAVELENGTHS),
            ("light_samples", self.light_samples, 1, MAX_LIGHT_SAMPLES),
            ("rough_rays", self.rough_rays, 0, MAX_ROUGH_RAYS),
        ];
        // Continuous values have an inclusive range, too
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
        // Find the first value out of its range; NaN is in no range, so that it is rejected
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

/// Table of a settings file that holds the measurements.
#[derive(Serialize)]
struct MeasuredPart<'a> {
    measured: &'a Measured,
}

/// Returns one table of a file as TOML. Serialising the whole file as one document would compile the settings' code
/// once for each position that a table can have in it.
fn toml_text(part: &impl Serialize) -> String {
    // Every value has a TOML form, so that serialisation cannot fail.
    toml::to_string(part).unwrap_or_default()
}

impl SettingsFile {
    /// Returns the file's text in TOML.
    pub fn text(&self) -> String {
        let mut text = format!("[settings]\n{}", toml_text(&self.settings));
        if let Some(measured) = &self.measured {
            text.push('\n');
            text += &toml_text(&MeasuredPart { measured });
        }
        text
    }

    /// Parses a settings file and checks its ranges.
    ///
    /// # Errors
    ///
    /// The fault, as the end of a sentence that begins with the file's name.
    pub fn parse(text: &str) -> Result<SettingsFile, String> {
        // Parse TOML and report the line of a fault
        let file: SettingsFile = from_text(text).map_err(|error| {
            let line = error.span().map_or(String::new(), |span| {
                let before = text.get(..span.start).unwrap_or_default();
                format!(", line {}", before.matches('\n').count() + 1)
            });
            format!("is not a settings file{line}: {}", error.message())
        })?;
        // Check ranges of the values
        match file.settings.find_out_of_range() {
            Some((name, range)) => Err(format!("has a value of `{name}` out of range: give {range}")),
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
    fn written_settings_are_read_back_unchanged() {
        // Write settings that differ from the defaults
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
        // Parse the text again and compare
        let text = file.text();
        assert_eq!(text, toml::to_string(&file).unwrap());
        assert_eq!(SettingsFile::parse(&text), Ok(file.clone()), "{text}");
        assert_eq!(file.settings.change(), configuration.change);
        // Check a file without measurements
        let bare = SettingsFile {
            settings: Settings::default(),
            measured: None,
        };
        assert_eq!(bare.text(), toml::to_string(&bare).unwrap());
    }

    #[test]
    fn errors_name_the_value_or_the_line() {
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
