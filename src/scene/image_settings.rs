//! How a picture of a scene is taken: the words for it that scene files and the command line share, their limits, and
//! what holds where neither says anything.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Width and height in pixels where nobody says it.
pub const DEFAULT_SIZE: [u32; 2] = [1024, 1024];
/// Samples a pixel where nobody says it.
pub const DEFAULT_SPP: u32 = 16;
/// Generations of reflected and refracted rays where nobody says it.
pub const DEFAULT_DEPTH: u32 = 5;
/// Wavelengths that a path splits into where nobody says it.
pub const DEFAULT_WAVELENGTHS: u32 = 16;

/// Most samples a pixel: 2^16, where noise is 1/256 of that of one sample.
pub const MAX_SPP: u32 = 1 << 16;
/// Most generations of secondary rays.
pub const MAX_DEPTH: u32 = 255;
/// Beyond it neighbouring wavelengths are under a nanometre apart, finer than any index of refraction is known.
pub const MAX_WAVELENGTHS: u32 = 400;
/// Beyond this many stops every f32 would be black or white.
pub const MAX_EXPOSURE: f32 = 100.0;
/// Most pixels of an image; the machine's memory usually sets a lower limit.
pub const MAX_PIXELS: u64 = 1 << 31;
/// Least radius of a filter in pixels: that of a tent between neighbouring middles. A pixel's own samples then never
/// weigh nothing.
pub const MIN_FILTER_RADIUS: f64 = 1.0;
/// Greatest radius of a filter in pixels: beyond it pictures are blurred on purpose.
pub const MAX_FILTER_RADIUS: f64 = 4.0;

/// How the samples of a pixel are spread over it.
///
/// Sobol points have the least error a sample (figures in the README, measured by `tests/it/image/sampling.rs`); R2 is
/// the default for the sake of pictures that were made with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(
    rename = "SamplePattern",
    description = "How the samples of a pixel are spread over it."
)]
pub enum Pattern {
    /// The middles of a grid's cells, the same in every pixel
    Regular,
    /// A random place in each cell of a grid
    Jittered,
    /// Owen-scrambled Sobol points, scrambled anew in every pixel
    Sobol,
    /// Roberts' R2 sequence, the same in every pixel
    #[default]
    R2,
}

/// Shapes of filter, each the product of one function across and down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(rename = "PixelFilter")]
pub enum FilterKind {
    /// The mean over the pixel's own square
    #[default]
    Box,
    /// Falls linearly to zero
    Tent,
    /// A bell of a third of the radius, lowered to reach zero
    Gaussian,
    /// Mitchell and Netravali's cubic: sharper, with negative lobes
    Mitchell,
}
