//! Image settings that scene files and the command line share: sample patterns and filters, their limits, and the
//! defaults where neither gives a value.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Default width and height of images in pixels.
pub const DEFAULT_SIZE: [u32; 2] = [1024, 1024];
/// Default number of samples per pixel.
pub const DEFAULT_SPP: u32 = 16;
/// Default number of bounces of reflected and refracted rays.
pub const DEFAULT_DEPTH: u32 = 5;
/// Default number of wavelengths that a path splits into.
pub const DEFAULT_WAVELENGTHS: u32 = 16;

/// Largest number of samples per pixel: 2^16, with which noise is 1/256 of that of one sample.
pub const MAX_SPP: u32 = 1 << 16;
/// Largest number of bounces of secondary rays.
pub const MAX_DEPTH: u32 = 255;
/// Largest number of wavelengths: with more, neighbouring wavelengths would be under a nanometre apart, finer than any
/// index of refraction is known.
pub const MAX_WAVELENGTHS: u32 = 400;
/// Largest exposure in stops: beyond it every f32 would be black or white.
pub const MAX_EXPOSURE: f32 = 100.0;
/// Largest number of pixels of an image; the machine's memory usually sets a lower limit.
pub const MAX_PIXELS: u64 = 1 << 31;
/// Smallest radius of a filter in pixels: that of a tent between neighbouring pixel centres, so that a pixel's own
/// samples never have a weight of zero.
pub const MIN_FILTER_RADIUS: f64 = 1.0;
/// Largest radius of a filter in pixels: beyond it, images are blurred on purpose.
pub const MAX_FILTER_RADIUS: f64 = 4.0;

/// Background at the end of camera rays that go straight into the distance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum VisibleBackground {
    /// Background or environment map of the scene.
    #[default]
    Environment,
    /// One linear RGB radiance; lights, mirrors and refraction keep the background of the scene.
    Color([f32; 3]),
    /// No background: the image gets an alpha channel, by which its colours are premultiplied.
    Transparent,
}

/// Pattern by which the samples of a pixel are spread over it.
///
/// Sobol points are the default, because they reach a given error soonest on most scenes (figures in `whit help
/// sampling`, measured by the benchmark `default_settings`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
#[schemars(
    rename = "SamplePattern",
    description = "How the samples of a pixel are spread over it."
)]
pub enum Pattern {
    /// The middles of a grid's cells, the same in every pixel
    Regular,
    /// A random position in each cell of a grid
    Jittered,
    /// Owen-scrambled Sobol points, scrambled anew in every pixel
    #[default]
    Sobol,
    /// Roberts' R2 sequence, the same in every pixel
    R2,
}

/// Shapes of the pixel filter, each the product of one function across and one down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
#[schemars(rename = "PixelFilter")]
pub enum FilterKind {
    /// The mean over the pixel's own square
    #[default]
    Box,
    /// Falls linearly to zero
    Tent,
    /// A Gaussian with a standard deviation of a third of the radius, lowered to reach zero
    Gaussian,
    /// Mitchell and Netravali's cubic: sharper, with negative lobes
    Mitchell,
}
