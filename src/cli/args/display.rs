//! Flags of the mapping from radiance to displayed colours, and of the background.

use clap::Args as ArgGroup;

use whit::image::ToneOperator;
use whit::render::Exposure;
use whit::scene::image_settings::VisibleBackground;

use super::{Ambient, exposure, or_scene, word};

const EXPOSURE_HELP: &str = "Stops of exposure for PNG images: radiance is multiplied by 2^EV; auto: chosen from the \
     image, so that its mean is middle grey and few pixels are brighter than white [default: the scene file's, auto for a \
     glTF file with lights, else 0]";

const BACKGROUND_HELP: &str = "Background that camera rays see which go straight into the distance: that of the scene, \
     none (the image gets an alpha channel), or a radiance as X or R,G,B; lights and mirrors keep that of the scene";

/// Flags of the mapping from radiance to displayed colours, and of the background.
#[derive(Clone, Copy, Debug, Default, ArgGroup)]
pub(in crate::cli) struct DisplayArgs {
    /// Stops of exposure for PNG images: radiance is multiplied by 2^EV; auto: chosen from the image, so that its mean
    /// is middle grey and few pixels are brighter than white
    #[arg(
        long,
        value_name = "EV|auto",
        help = EXPOSURE_HELP,
        value_parser = exposure_or_auto,
        allow_hyphen_values = true
    )]
    pub(in crate::cli) exposure: Option<Exposure>,

    /// Background that camera rays see which go straight into the distance: that of the scene, none (the image gets an
    /// alpha channel), or a radiance as X or R,G,B; lights and mirrors keep that of the scene
    #[arg(
        long,
        value_name = "environment|transparent|RADIANCE",
        help = or_scene(BACKGROUND_HELP, "environment"),
        value_parser = background,
        allow_hyphen_values = true
    )]
    pub(in crate::cli) background: Option<VisibleBackground>,

    /// Tone mapping operator of PNG images, after exposure
    #[arg(
        long,
        value_enum,
        help = or_scene("Tone mapping operator of PNG images, after exposure", word(ToneOperator::default()))
    )]
    pub(in crate::cli) tone_map: Option<ToneOperator>,
}

fn exposure_or_auto(text: &str) -> Result<Exposure, String> {
    match text {
        "auto" => Ok(Exposure::Automatic),
        stops => exposure(stops)
            .map(Exposure::Stops)
            .map_err(|error| format!("{error}, or `auto`")),
    }
}

fn background(text: &str) -> Result<VisibleBackground, String> {
    match text {
        "environment" => Ok(VisibleBackground::Environment),
        "transparent" => Ok(VisibleBackground::Transparent),
        radiance => match radiance.parse() {
            Ok(Ambient(radiance)) => Ok(VisibleBackground::Color(radiance)),
            Err(_) => Err(
                "give `environment`, `transparent`, or one radiance or three of zero or more, as in 0.2 or 0.1,0.2,0.3"
                    .into(),
            ),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_is_a_number_of_stops_or_auto() {
        assert_eq!(exposure_or_auto("auto"), Ok(Exposure::Automatic));
        assert_eq!(exposure_or_auto("-1.5"), Ok(Exposure::Stops(-1.5)));
        assert!(exposure_or_auto("Auto").is_err() && exposure_or_auto("1e3").is_err());
    }

    #[test]
    fn background_is_a_word_or_a_radiance() {
        assert_eq!(background("environment"), Ok(VisibleBackground::Environment));
        assert_eq!(background("transparent"), Ok(VisibleBackground::Transparent));
        assert_eq!(background("0.5"), Ok(VisibleBackground::Color([0.5; 3])));
        assert_eq!(background("0,1,2"), Ok(VisibleBackground::Color([0.0, 1.0, 2.0])));
        for bad in ["", "clear", "-1", "1,2", "nan"] {
            assert!(background(bad).is_err(), "{bad}");
        }
    }
}
