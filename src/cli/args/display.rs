//! Flags of the mapping from radiance to displayed colours.

use clap::Args as ArgGroup;

use whit::image::ToneOperator;

use super::{exposure, or_scene, word};

/// Flags of the mapping from radiance to displayed colours.
#[derive(Clone, Copy, Debug, Default, ArgGroup)]
pub(in crate::cli) struct DisplayArgs {
    /// Stops of exposure for PNG images: radiance is multiplied by 2^EV
    #[arg(long, value_name = "EV", help = or_scene("Stops of exposure for PNG images: radiance is multiplied by 2^EV", 0), value_parser = exposure, allow_hyphen_values = true)]
    pub(in crate::cli) exposure: Option<f32>,

    /// Tone mapping operator of PNG images, after exposure
    #[arg(
        long,
        value_enum,
        help = or_scene("Tone mapping operator of PNG images, after exposure", word(ToneOperator::default()))
    )]
    pub(in crate::cli) tone_map: Option<ToneOperator>,
}
