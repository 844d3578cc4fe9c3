//! Forecast of an image's cost for `whit info`, from a probe that takes a fraction of a second.
//!
//! The probe needs an acceleration structure. If building it would delay the output of `whit info` noticeably, the
//! forecast is left out, and the output states so.

use whit::accel::{self, AccelOptions};
use whit::batch::request::TracingOptions;
use whit::parallel;
use whit::render::{self, Monitor};
use whit::report::forecast::Forecast;
use whit::scene::Scene;
use whit::scene_file::SceneFile;

use super::ablation::settings_of;
use super::args::{ForecastMode, InfoArgs};
use super::failure::Failure;
use super::interrupt;

/// Largest number of triangles and objects for an automatic forecast: about a quarter of a second to build on two
/// threads.
const MAX_PRIMITIVES: usize = 1_000_000;
/// Largest number of texels for an automatic forecast: about another quarter of a second to prepare.
const MAX_TEXELS: usize = 16_000_000;

/// Result of the probe, or the reason why there is none.
pub(super) enum ForecastResult {
    Forecast(Box<Forecast>),
    Unavailable(String),
}

/// Probes the image that the scene file describes, from the scene's first camera.
pub(super) fn run(args: &InfoArgs, loaded: &SceneFile) -> Result<ForecastResult, Failure> {
    let scene = &loaded.scene;
    // Check whether a forecast is possible and wanted
    let Some(camera) = scene.cameras.first() else {
        return Ok(ForecastResult::Unavailable("the scene has no camera".into()));
    };
    if let Some(reason) = reason_against(args.forecast, scene) {
        return Ok(ForecastResult::Unavailable(reason));
    }
    // Build the acceleration structure with the requested backend
    let scene = scene.validate()?;
    let backend = args.ablation.backend.unwrap_or_default();
    let settings = settings_of(args, &loaded.output)?;
    let tracing = TracingOptions::of_threads(args.ablation.threads);
    let options = AccelOptions {
        threads: tracing.threads,
        ..AccelOptions::default()
    };
    parallel::install(&tracing.pool()?, || {
        let accel = match accel::build(scene, backend, &options) {
            Ok(accel) => accel,
            // The rest of the information about the scene does not depend on the backend.
            Err(error) => return Ok(ForecastResult::Unavailable(error.to_string())),
        };
        let monitor = Monitor {
            cancel: &interrupt::CANCELLED,
            ..Monitor::default()
        };
        // Trace the probe and extrapolate
        let probe = render::probe((scene, camera), &*accel, &settings, &monitor)?;
        interrupt::check()?;
        let forecast = Forecast::of(&probe, &settings, backend);
        Ok(ForecastResult::Forecast(Box::new(forecast)))
    })
}

/// Returns the reason against a forecast, if there is one.
fn reason_against(when: ForecastMode, scene: &Scene) -> Option<String> {
    let primitives: usize = scene.geometries.iter().map(|g| g.primitive_count()).sum();
    let primitives = primitives + scene.instances.len();
    let texels: usize = scene.images.iter().map(|image| image.texels.len()).sum();
    match when {
        ForecastMode::Always => None,
        ForecastMode::Never => Some("not requested".into()),
        ForecastMode::Auto if primitives > MAX_PRIMITIVES => Some(format!(
            "building a tree of {primitives} triangles and objects takes long; request it with `--forecast always`"
        )),
        ForecastMode::Auto if texels > MAX_TEXELS => Some(format!(
            "preparing {texels} texels takes long; request it with `--forecast always`"
        )),
        ForecastMode::Auto => None,
    }
}
