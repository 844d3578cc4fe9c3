//! Forecast of an image's cost for `whit info`, from a probe that takes a fraction of a second.
//!
//! The probe needs an acceleration structure. If building it would delay the output of `whit info` noticeably, the
//! forecast is left out, and the output states so.

use crate::accel::{self, AccelOptions};
use crate::parallel;
use crate::render::{self, Monitor};
use crate::report::forecast::Forecast;
use crate::scene::Scene;
use crate::scene_file::SceneFile;

use super::args::{InfoArgs, WhenToForecast};
use super::failure::Failure;
use super::interrupt;
use super::job::Tracing;
use super::prices::settings_of;

/// Largest number of triangles and objects for an automatic forecast: about a quarter of a second to build on two
/// threads.
const MAX_PRIMITIVES: usize = 1_000_000;
/// Largest number of texels for an automatic forecast: about another quarter of a second to prepare.
const MAX_TEXELS: usize = 16_000_000;

/// Result of the probe, or the reason why there is none.
pub(super) enum Told {
    Forecast(Box<Forecast>),
    LeftOut(String),
}

/// Probes the image that the scene file describes, from the scene's first camera.
pub(super) fn run(args: &InfoArgs, loaded: &SceneFile) -> Result<Told, Failure> {
    let scene = &loaded.scene;
    // Check whether a forecast is possible and wanted
    let Some(camera) = scene.cameras.first() else {
        return Ok(Told::LeftOut("there is no camera".into()));
    };
    if let Some(reason) = reason_against(args.forecast, scene) {
        return Ok(Told::LeftOut(reason));
    }
    // Build the acceleration structure with the requested backend
    let backend = args.prices.backend.unwrap_or_default();
    let settings = settings_of(args, &loaded.output)?;
    let tracing = Tracing::of_threads(args.prices.threads);
    let options = AccelOptions {
        threads: tracing.threads,
        ..AccelOptions::default()
    };
    parallel::install(&tracing.pool()?, || {
        let accel = match accel::build(scene, backend, &options) {
            Ok(accel) => accel,
            // The rest of the information about the scene does not depend on the backend.
            Err(error) => return Ok(Told::LeftOut(error.to_string())),
        };
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &interrupt::CANCELLED,
            tiles: None,
        };
        // Trace the probe and extrapolate
        let Some(probe) = render::probe((scene, camera), &*accel, &settings, &monitor) else {
            return Err(Failure::Interrupted);
        };
        interrupt::check()?;
        let forecast = Forecast::of(&probe, &settings, backend);
        Ok(Told::Forecast(Box::new(forecast)))
    })
}

/// Returns the reason against a forecast, if there is one.
fn reason_against(when: WhenToForecast, scene: &Scene) -> Option<String> {
    let primitives: usize = scene.geometries.iter().map(|g| g.primitive_count()).sum();
    let primitives = primitives + scene.instances.len();
    let texels: usize = scene.images.iter().map(|image| image.texels.len()).sum();
    match when {
        WhenToForecast::Always => None,
        WhenToForecast::Never => Some("not asked for".into()),
        WhenToForecast::Auto if primitives > MAX_PRIMITIVES => Some(format!(
            "{primitives} triangles and objects take long to make ready; `--forecast always` waits for them"
        )),
        WhenToForecast::Auto if texels > MAX_TEXELS => Some(format!(
            "{texels} texels take long to make ready; `--forecast always` waits for them"
        )),
        WhenToForecast::Auto => None,
    }
}
