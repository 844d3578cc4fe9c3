//! Choice of the exposure of an image: given, or automatic for glTF files with photometric lights.

use whit::batch::request::is_scene_file;
use whit::image::ImageFormat;
use whit::render::Exposure;
use whit::scene::{LightKind, Scene};
use whit::scene_file::Output;

use super::job::{RenderJob, Target};
use super::progress::Progress;

/// Extension whose lights are in candela and lux, so that their radiance is rarely near that of white.
const PUNCTUAL_LIGHTS: &str = "KHR_lights_punctual";

/// Returns the exposure of an image of a loaded scene with its image settings; `None` for that of the settings.
pub(super) fn choose(
    job: &RenderJob,
    target: &Target,
    (scene, output): (&Scene, &Output),
    progress: &Progress,
) -> Option<Exposure> {
    let is_given = job.exposure.is_some() || output.exposure.is_some();
    if is_given || is_scene_file(&target.scene) || !has_photometric_lights(scene) {
        return job.exposure;
    }
    // Keep the exposure of 0 stops where it must be known before the image is finished; radiance has none
    match job.flag_before_exposure() {
        None => Some(Exposure::Automatic),
        Some(_) if target.format != ImageFormat::Png => None,
        Some(flag) => {
            progress.warn(&format!(
                "{}: its lights are in candela and lux, but `{flag}` needs the exposure before the image is finished, so \
                 it is 0 stops: give `--exposure`",
                target.scene.display()
            ));
            None
        }
    }
}

/// Returns whether a glTF file has lights of its own.
fn has_photometric_lights(scene: &Scene) -> bool {
    let states = scene.extensions.iter().any(|used| used.name == PUNCTUAL_LIGHTS);
    let is_punctual = |kind: &LightKind| !matches!(kind, LightKind::Area { .. });
    states && scene.lights.iter().any(|light| is_punctual(&light.kind))
}
