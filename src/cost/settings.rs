//! Settings file: output of a study and input of a render.

use serde::{Deserialize, Serialize};

use super::{Interval, Settings};
use crate::scene_file::node::from_text;

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
    use crate::cost::{Configuration, HitPath, SceneChange};
    use crate::render::{Pattern, RenderSettings};

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
            denoises: true,
        };
        let file = SettingsFile {
            settings: configuration.to_settings(),
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
