//! What `whit info` says of a picture's cost without being asked: a probe of a fraction of a second.
//!
//! The probe needs the structure that finds hits. Where building that would take longer than a person waits for a list,
//! it is left out, and the list says so.

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

/// Triangles and objects of a structure that is built without being asked for: about a quarter of a second of two
/// threads.
const MAX_PRIMITIVES: usize = 1_000_000;
/// Texels of images that are made ready without being asked for: as long again.
const MAX_TEXELS: usize = 16_000_000;

/// What the probe says, or why there was none.
pub(super) enum Told {
    Forecast(Box<Forecast>),
    LeftOut(String),
}

/// Probes the picture that the scene asks for, seen by its first camera.
pub(super) fn run(args: &InfoArgs, loaded: &SceneFile) -> Result<Told, Failure> {
    let scene = &loaded.scene;
    let Some(camera) = scene.cameras.first() else {
        return Ok(Told::LeftOut("there is no camera".into()));
    };
    if let Some(reason) = reason_against(args.forecast, scene) {
        return Ok(Told::LeftOut(reason));
    }
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
            // The scene can be told all the same.
            Err(error) => return Ok(Told::LeftOut(error.to_string())),
        };
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &interrupt::CANCELLED,
            tiles: None,
        };
        let Some(probe) = render::probe((scene, camera), &*accel, &settings, &monitor) else {
            return Err(Failure::Interrupted);
        };
        interrupt::check()?;
        let forecast = Forecast::of(&probe, &settings, backend);
        Ok(Told::Forecast(Box::new(forecast)))
    })
}

/// Why there is to be no forecast.
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
