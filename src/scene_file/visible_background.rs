//! Key `background` of `[output]`: the background that camera rays see which go straight into the distance.

use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::StrDeserializer;

use super::forms::{forms, schema};
use super::value::Color;
use crate::scene::image_settings::VisibleBackground;

const FORMS: &str = "\"environment\", \"transparent\" or a colour";

/// Background as a word or as a colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VisibleBackgroundForm(pub(super) VisibleBackground);

impl From<Color> for VisibleBackgroundForm {
    fn from(color: Color) -> VisibleBackgroundForm {
        VisibleBackgroundForm(VisibleBackground::Color(color.0))
    }
}

forms! {
    ['de] VisibleBackgroundForm, FORMS;
    number grey => Color::deserialize(grey.into_deserializer()).map(VisibleBackgroundForm::from);
    text text => match text {
        "environment" => Ok(VisibleBackgroundForm(VisibleBackground::Environment)),
        "transparent" => Ok(VisibleBackgroundForm(VisibleBackground::Transparent)),
        color if color.starts_with('#') => {
            let text: StrDeserializer<E> = color.into_deserializer();
            Color::deserialize(text).map(VisibleBackgroundForm::from)
        }
        other => Err(E::custom(format!("`{other}` is no background: give {FORMS}"))),
    };
    list list => Color::deserialize(list).map(VisibleBackgroundForm::from);
}

schema!([] VisibleBackgroundForm, "VisibleBackground", generator => {
    "description": "Background that camera rays see: that of the scene, none (an alpha channel), or a colour.",
    "anyOf": [
        { "enum": ["environment", "transparent"] },
        (generator.subschema_for::<Color>())
    ]
});

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct OutputTable {
        background: VisibleBackgroundForm,
    }

    fn read(value: &str) -> Result<VisibleBackground, String> {
        let table: Result<OutputTable, toml::de::Error> = toml::from_str(&format!("background = {value}"));
        table
            .map(|table| table.background.0)
            .map_err(|error| error.message().to_owned())
    }

    #[test]
    fn background_is_a_word_or_a_colour() {
        assert_eq!(read("\"transparent\""), Ok(VisibleBackground::Transparent));
        assert_eq!(read("\"environment\""), Ok(VisibleBackground::Environment));
        assert_eq!(read("[0, 0.5, 2]"), Ok(VisibleBackground::Color([0.0, 0.5, 2.0])));
        assert_eq!(read("0.25"), Ok(VisibleBackground::Color([0.25; 3])));
        assert_eq!(read("\"#ff00ff\""), Ok(VisibleBackground::Color([1.0, 0.0, 1.0])));
        let error = read("\"clear\"").unwrap_err();
        assert!(error.contains("`clear` is no background: give"), "{error}");
        assert!(read("[1, 2]").is_err() && read("-1").is_err());
    }
}
