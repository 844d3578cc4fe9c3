//! Render settings of an image whose scene is open, and checks of them.

use super::error::RequestError;
use crate::batch::memory;
use crate::image::{ToneMap, ToneOperator};
use crate::render::{FilterKind, Pattern, PixelFilter, RenderSettings};
use crate::scene::image_settings::{
    DEFAULT_DEPTH, DEFAULT_SIZE, DEFAULT_SPP, DEFAULT_WAVELENGTHS, VisibleBackground,
};
use crate::scene_file::Output;

/// Render settings and tone mapping of one scene: those of the request, else those of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResolvedSettings {
    /// Render settings that determine the image.
    pub settings: RenderSettings,
    /// Tone mapping of PNG files.
    pub tone: ToneMap,
    /// Tone mapping operator of PNG files.
    pub operator: ToneOperator,
}

/// Returns the render settings for an image, with defaults for what is absent.
///
/// # Errors
///
/// If a box filter has a radius, or the image does not fit into memory.
pub fn render_settings(output: &Output) -> Result<RenderSettings, RequestError> {
    // Fill in the defaults
    let [width, height] = output.size.unwrap_or(DEFAULT_SIZE);
    let settings = RenderSettings {
        width,
        height,
        spp: output.spp.unwrap_or(DEFAULT_SPP),
        pattern: output.pattern.unwrap_or_default(),
        filter: filter(output)?,
        background: output.background.unwrap_or_default(),
        depth: output.depth.unwrap_or(DEFAULT_DEPTH),
        wavelengths: output.wavelengths.unwrap_or(DEFAULT_WAVELENGTHS),
        ..RenderSettings::default()
    };
    check_memory(&settings, 0)?;
    Ok(settings)
}

fn filter(output: &Output) -> Result<PixelFilter, RequestError> {
    let usual = PixelFilter::of_kind(output.filter.unwrap_or_default());
    match output.filter_radius {
        None => Ok(usual),
        Some(_) if usual.kind == FilterKind::Box => Err(RequestError::BoxRadius),
        Some(radius) => Ok(PixelFilter { radius, ..usual }),
    }
}

/// Rejects images that do not fit into the available memory, in a scene with `light_count` lights.
///
/// # Errors
///
/// The memory that the image takes, and that is available.
pub fn check_memory(settings: &RenderSettings, light_count: usize) -> Result<(), RequestError> {
    // Compare the film and the sampling buffers with the free memory
    let (width, height) = (settings.width, settings.height);
    let pixels = u64::from(width) * u64::from(height);
    let needed = memory::film_bytes(width, height) + settings.sampling_bytes_per_pixel(light_count) * pixels;
    match memory::available_bytes().filter(|&available| needed > available) {
        None => Ok(()),
        Some(free) => Err(RequestError::TooLarge {
            width,
            height,
            needed,
            free,
        }),
    }
}

/// Rejects different numbers of samples per pixel with settings that conflict with them.
pub(super) fn check_sample_counts(settings: &RenderSettings) -> Result<(), RequestError> {
    let flag = match (settings.adaptive, settings.edge_contrast) {
        (Some(_), _) => "--adaptive",
        (None, Some(_)) => "--edge-contrast",
        (None, None) => return Ok(()),
    };
    if settings.filter.kind != FilterKind::Box {
        return Err(RequestError::UnequalCountsFilter(flag));
    }
    if settings.background == VisibleBackground::Transparent {
        return Err(RequestError::UnequalCountsAlpha(flag));
    }
    if !(settings.layers.is_empty() && settings.light_layers.is_empty()) {
        return Err(RequestError::UnequalCountsChannels(flag));
    }
    match settings.pattern {
        Pattern::Regular if settings.adaptive.is_some() => Err(RequestError::AdaptivePattern),
        _ => Ok(()),
    }
}

/// Rejects light layers with filters that spread samples over several pixels.
pub(super) fn check_light_layers(settings: &RenderSettings) -> Result<(), RequestError> {
    match settings.light_layers.is_empty() || settings.filter.kind == FilterKind::Box {
        true => Ok(()),
        false => Err(RequestError::FilteredLights),
    }
}
