//! How long every way of asking takes for the rays of a frame, and the frame itself.

use super::BenchJob;
use super::structures::Contestant;
use crate::accel::Accel;
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::progress::Progress;
use crate::cli::replay::{Engine, RaySet, replay_seconds, shared_replay_seconds};
use crate::parallel;
use crate::render::{self, Ledger, Monitor, RenderSettings};
use crate::report::bench::{FrameTime, Mode, RayKind, Spread};
use crate::scene::{Camera, Scene};

/// Seconds of every repetition.
#[derive(Clone, Default)]
pub(super) struct Seconds {
    /// Of builds with as many threads as were asked for, of replays with one.
    pub(super) usual: Vec<f64>,
    /// With each number of threads whose speed is wanted.
    pub(super) by_threads: Vec<Vec<f64>>,
}

impl Seconds {
    /// Of one repetition so far.
    pub(super) fn of(usual: f64) -> Seconds {
        Seconds {
            usual: vec![usual],
            by_threads: Vec::new(),
        }
    }
}

/// The picture whose rays are replayed.
pub(super) struct Frame<'a> {
    pub(super) scene: &'a Scene,
    pub(super) camera: &'a Camera,
    pub(super) settings: RenderSettings,
    pub(super) accel: &'a dyn Accel,
}

impl Frame<'_> {
    /// The frame's own rays and random ones, a set each; kinds without rays are left out.
    pub(super) fn ray_sets(&self) -> Vec<RaySet> {
        let recorded = render::record(self.scene, self.camera, self.accel, &self.settings);
        let pixel_count = self.settings.width as usize * self.settings.height as usize;
        let mut sets = vec![
            RaySet::new(RayKind::Camera, recorded.camera),
            RaySet::new(RayKind::Shadow, recorded.shadow),
            RaySet::new(RayKind::Reflection, recorded.reflection),
            RaySet::random(&self.scene.bounds(), pixel_count),
        ];
        sets.retain(|set| set.ray_count > 0);
        sets
    }

    /// What one render of the frame takes, on the current thread pool.
    fn ledger(&self, accel: &dyn Accel) -> Result<Ledger, Failure> {
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &interrupt::CANCELLED,
            tiles: None,
        };
        let settings = RenderSettings {
            ledger: true,
            ..self.settings
        };
        render::render(self.scene, self.camera, accel, &settings, &monitor)
            .map(|rendering| rendering.ledger)
            .ok_or(Failure::Interrupted)
    }
}

/// What every way of asking took.
pub(super) struct Times {
    /// By set, then by contestant.
    pub(super) replays: Vec<Vec<Seconds>>,
    /// By contestant; empty for those without frames.
    frames: Vec<Vec<Ledger>>,
}

impl Times {
    /// Times everything in turn within each repetition, so that whatever else the machine does hits all alike.
    pub(super) fn measure(
        contestants: &[Contestant],
        sets: &[RaySet],
        frame: &Frame,
        job: &BenchJob,
        progress: &Progress,
    ) -> Result<Times, Failure> {
        let single = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|error| Failure::Work(format!("could not start a thread: {error}")))?;
        let none = Seconds {
            usual: Vec::new(),
            by_threads: vec![Vec::new(); job.scaling.len()],
        };
        let mut times = Times {
            replays: vec![vec![none; contestants.len()]; sets.len()],
            frames: vec![Vec::new(); contestants.len()],
        };
        for repetition in 0..job.repeat {
            for (set, of_set) in sets.iter().zip(&mut times.replays) {
                for (contestant, seconds) in contestants.iter().zip(of_set) {
                    interrupt::check()?;
                    let (engine, mode) = (contestant.engine, contestant.mode);
                    seconds.usual.push(replay_seconds(engine, set, mode));
                    for (pool, seconds) in job.scaling.iter().zip(&mut seconds.by_threads) {
                        seconds.push(shared_replay_seconds(pool, engine, set, mode));
                    }
                }
            }
            for (contestant, ledgers) in contestants.iter().zip(&mut times.frames) {
                if let Engine::Accel(accel) = contestant.engine
                    && contestant.has_frames(contestants)
                {
                    ledgers.push(parallel::install(&single, || frame.ledger(accel))?);
                }
            }
            progress.fraction(f64::from(repetition + 1) / f64::from(job.repeat));
        }
        Ok(times)
    }

    /// The render loop with one contestant, or with the first if it has no frames, against the first one's raw traces of
    /// the same rays.
    pub(super) fn frame(
        &self,
        contestants: &[Contestant],
        sets: &[RaySet],
        index: usize,
    ) -> Option<FrameTime> {
        let raw = contestants
            .iter()
            .position(|contestant| contestant.mode == Mode::Raw)?;
        let frames = [index, 0].map(|index| &self.frames[index]);
        let frames = frames.into_iter().find(|frames| !frames.is_empty())?;
        let ledger = frames.first()?;
        let raw_seconds: f64 = sets
            .iter()
            .zip(&self.replays)
            .map(|(set, of_set)| {
                let rays = match set.kind {
                    RayKind::Camera => ledger.camera_rays(),
                    RayKind::Shadow => ledger.shadow_rays(),
                    RayKind::Reflection => ledger.reflection_rays(),
                    RayKind::Random => 0,
                };
                rays as f64 * Spread::of(&of_set[raw].usual).median / set.ray_count as f64
            })
            .sum();
        let median = |of: fn(&Ledger) -> f64| Spread::of(&frames.iter().map(of).collect::<Vec<_>>()).median;
        let seconds = median(|ledger| ledger.seconds);
        Some(FrameTime {
            seconds,
            rays: ledger.camera_rays() + ledger.shadow_rays() + ledger.reflection_rays(),
            over_raw: seconds / raw_seconds,
            trace_share: median(|ledger| ledger.trace_seconds() / ledger.seconds),
        })
    }
}
