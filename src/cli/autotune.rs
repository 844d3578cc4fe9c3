//! Search for settings for `whit render --error` and `--max-time`, by rendering parts of the image before all of it.

use std::time::Instant;

use whit::cost::{self, Configuration, CostError, Experiment, Keep, Observer, SceneChange, StudyResult};
use whit::render::RenderSettings;
use whit::scene::{Camera, Scene};

use super::failure::Failure;
use super::interrupt;
use super::job::{RenderJob, ResolvedSettings, SettingsSearch};
use super::progress::Progress;

/// Searches for settings that reach the job's target and returns the findings.
pub(super) fn find_settings(
    (job, aim, resolved): (&RenderJob, SettingsSearch, &ResolvedSettings),
    (scene, camera): (&Scene, &Camera),
    progress: &Progress,
) -> Result<StudyResult, Failure> {
    let tracing = &job.tracing;
    let experiment = Experiment {
        scene,
        camera,
        // The search starts from the job's settings, without the ledger
        base: Configuration {
            settings: RenderSettings {
                ledger: false,
                ..resolved.settings
            },
            path: tracing.path(job.backend),
            change: SceneChange::default(),
        },
        tone: resolved.tone,
        size: None,
        target: Some(aim.target),
        budget: aim.seconds,
        start: Instant::now(),
        threads: tracing.threads,
        isa: tracing.isa.clone(),
        unfinished: None,
    };
    run(&experiment, progress, None)
}

/// Runs an experiment and displays its progress; `keep` gets the state from which the experiment could be resumed.
pub(super) fn run(
    experiment: &Experiment,
    progress: &Progress,
    keep: Option<Keep<'_>>,
) -> Result<StudyResult, Failure> {
    // Connect the progress display and the cancellation flag
    let watcher = Observer {
        progress: &|what, fraction| {
            progress.show_activity(what);
            progress.fraction(fraction);
        },
        cancel: &interrupt::CANCELLED,
        keep,
    };
    // Translate errors to those of commands
    cost::run(experiment, &watcher).map_err(|error| match error {
        CostError::Cancelled(_) => Failure::Interrupted,
        CostError::Accel(error) => error.into(),
        other => Failure::Input(other.to_string()),
    })
}
