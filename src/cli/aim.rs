//! `whit render --error` and `--max-time`: settings are looked for by pieces of the picture before all of it is made.

use std::time::Instant;

use crate::cost::{self, Configuration, CostError, Experiment, Findings, Keep, SceneChange, Watcher};
use crate::render::RenderSettings;
use crate::scene::{Camera, Scene};

use super::failure::Failure;
use super::interrupt;
use super::job::{Aim, RenderJob, Shot};
use super::progress::Progress;

/// What was found for the aim of a job.
pub(super) fn look(
    (job, aim, shot): (&RenderJob, Aim, &Shot),
    (scene, camera): (&Scene, &Camera),
    progress: &Progress,
) -> Result<Findings, Failure> {
    let tracing = &job.tracing;
    let experiment = Experiment {
        scene,
        camera,
        base: Configuration {
            settings: RenderSettings {
                ledger: false,
                ..shot.settings
            },
            path: tracing.path(job.backend),
            change: SceneChange::default(),
        },
        tone: shot.tone,
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

/// Runs an experiment, and shows how far it is; `keep` is given what it would go on with.
pub(super) fn run(
    experiment: &Experiment,
    progress: &Progress,
    keep: Option<Keep<'_>>,
) -> Result<Findings, Failure> {
    let watcher = Watcher {
        progress: &|what, fraction| {
            progress.say(what);
            progress.fraction(fraction);
        },
        cancel: &interrupt::CANCELLED,
        keep,
    };
    cost::run(experiment, &watcher).map_err(|error| match error {
        CostError::Cancelled => Failure::Interrupted,
        CostError::Accel(error) => error.into(),
        other => Failure::Input(other.to_string()),
    })
}
