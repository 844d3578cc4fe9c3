//! Forecast of a batch: a probe of each scene, without rendering.

use super::built_scene::{BuiltScene, LoadedScene, SceneCaches};
use super::observer::{BatchObserver, FrameEvent};
use super::row_schedule::film_bytes;
use crate::accel::Backend;
use crate::batch::error::BatchError;
use crate::batch::options::BatchOptions;
use crate::batch::plan::PlannedFrame;
use crate::render::{self, Monitor, Probe, RenderSettings};

/// Probe of a frame, with what else the frame costs.
#[derive(Clone, Debug)]
pub struct FrameCost {
    /// Samples of the frame, which its time is extrapolated from.
    pub probe: Probe,
    /// Render settings of the frame.
    pub settings: RenderSettings,
    /// Backend that finds the hits.
    pub backend: Backend,
    /// Additional seconds of the first frame of a scene, for loading and building.
    pub setup_seconds: f64,
    /// Bytes of the frame and its scene.
    pub bytes: u64,
}

/// Returns the costs of all frames, in the current thread pool; of frames that share a scene only the first is probed.
///
/// # Errors
///
/// If a scene cannot be loaded or built, and on cancellation.
pub fn forecast(
    plans: &[PlannedFrame],
    options: &BatchOptions,
    observer: &BatchObserver,
) -> Result<Vec<FrameCost>, BatchError> {
    let kept = SceneCaches::for_frames(plans);
    let mut costs: Vec<FrameCost> = Vec::with_capacity(plans.len());
    for (index, plan) in plans.iter().enumerate() {
        let before = index.checked_sub(1).and_then(|before| plans.get(before));
        // Frames of the same scene have the cost of the first, without loading and building
        let same = before.filter(|before| before.shares_scene_with(plan));
        let cost = match same.and(costs.last()) {
            Some(cost) => FrameCost {
                setup_seconds: 0.0,
                ..cost.clone()
            },
            None => probe_frame(plan, &kept, (options, observer))?,
        };
        costs.push(cost);
        let fraction = index as f64 / plans.len() as f64;
        (observer.event)(plan, FrameEvent::Progress(fraction));
    }
    Ok(costs)
}

fn probe_frame(
    plan: &PlannedFrame,
    kept: &SceneCaches,
    (options, observer): (&BatchOptions, &BatchObserver),
) -> Result<FrameCost, BatchError> {
    // Load and build the scene as for rendering, then probe a few pixels
    (observer.event)(plan, FrameEvent::Begun);
    let loaded = LoadedScene::new(plan, kept, observer)?;
    let stage = BuiltScene::new(plan, (&loaded, kept), observer)?;
    let settings = plan.request.resolved(&loaded.file.output)?.settings;
    let camera = loaded.camera(plan)?;
    let monitor = Monitor {
        cancel: observer.cancel,
        ..Monitor::default()
    };
    let probe = render::probe((stage.scene, &camera), &*stage.accel, &settings, &monitor)?;
    let bytes = loaded.forecast(&plan.request);
    let film = film_bytes(&loaded.film(&settings), options.time);
    Ok(FrameCost {
        probe,
        settings,
        backend: plan.request.for_output(&loaded.file.output).backend(),
        setup_seconds: loaded.seconds + stage.build_seconds,
        bytes: kept.bytes() + bytes.loaded + bytes.to_come + film,
    })
}
