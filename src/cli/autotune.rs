//! Search for settings for `whit render --error` and `--max-time`, by rendering parts of the image before all of it.

use std::time::Instant;

use whit::batch::request::{RenderRequest, ResolvedSettings};
use whit::cost::{self, Configuration, Experiment, SceneChange, StudyResult};
use whit::render::RenderSettings;
use whit::scene::{Camera, ValidScene};

use super::failure::Failure;
use super::job::SettingsSearch;
use super::progress::Progress;

/// Searches for settings that reach the target and returns the findings.
pub(super) fn find_settings(
    (request, aim, resolved): (&RenderRequest, SettingsSearch, &ResolvedSettings),
    (scene, camera): (ValidScene, &Camera),
    progress: &Progress,
) -> Result<StudyResult, Failure> {
    let tracing = &request.tracing;
    let experiment = Experiment {
        scene,
        camera,
        // The search starts from the requested settings, without the ledger
        base: Configuration {
            settings: RenderSettings {
                ledger: false,
                ..resolved.settings
            },
            path: tracing.path(),
            change: SceneChange::default(),
            denoises: false,
        },
        tone: resolved.tone,
        size: None,
        target: Some(aim.target),
        budget: aim.seconds,
        start: Instant::now(),
        threads: tracing.threads,
        isa: tracing.isa.clone(),
        denoiser: None,
        unfinished: None,
        keep: None,
    };
    Ok(progress.observe(|observer| cost::run(&experiment, observer))?)
}
