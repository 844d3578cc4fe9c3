//! Times of replaying a frame's rays through each contestant, and of rendering the frame itself.

use super::job::BenchJob;
use super::seconds::Seconds;
use super::structures::Contestant;
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::progress::Progress;
use crate::cli::replay::{Engine, RayWorkload, replay_seconds, shared_replay_seconds};
use whit::accel::Accel;
use whit::parallel;
use whit::render::{self, Monitor, RenderProfile, RenderSettings};
use whit::report::bench::{FrameTime, Mode, RayKind, Spread};
use whit::scene::{Camera, Scene};

/// Frame whose rays are replayed.
pub(super) struct Frame<'a> {
    pub(super) scene: &'a Scene,
    pub(super) camera: &'a Camera,
    pub(super) settings: RenderSettings,
    pub(super) accel: &'a dyn Accel,
}

impl Frame<'_> {
    /// Returns the frame's own rays and random ones, one set per kind; kinds without rays are left out.
    pub(super) fn ray_sets(&self) -> Vec<RayWorkload> {
        let recorded = render::record(self.scene, self.camera, self.accel, &self.settings);
        let pixel_count = self.settings.width as usize * self.settings.height as usize;
        let mut sets = vec![
            RayWorkload::new(RayKind::Camera, recorded.camera),
            RayWorkload::new(RayKind::Shadow, recorded.shadow),
            RayWorkload::new(RayKind::Reflection, recorded.reflection),
            RayWorkload::random(&self.scene.bounds(), pixel_count),
        ];
        sets.retain(|set| set.ray_count > 0);
        sets
    }

    /// Returns the ledger of one render of the frame on the current thread pool.
    fn ledger(&self, accel: &dyn Accel) -> Result<RenderProfile, Failure> {
        let monitor = Monitor {
            cancel: &interrupt::CANCELLED,
            ..Monitor::default()
        };
        let settings = RenderSettings {
            ledger: true,
            ..self.settings
        };
        let rendering = render::render(self.scene, self.camera, accel, &settings, &monitor)?;
        Ok(rendering.ledger)
    }
}

/// Measured times of all contestants.
pub(super) struct Times {
    /// Seconds of the replays, by ray set, then by contestant.
    pub(super) replays: Vec<Vec<Seconds>>,
    /// Ledgers of rendered frames, by contestant; empty for contestants without frames.
    frames: Vec<Vec<RenderProfile>>,
}

impl Times {
    /// Measures all contestants in turn within each repetition, so that other load on the machine affects all alike.
    pub(super) fn measure(
        contestants: &[Contestant],
        sets: &[RayWorkload],
        frame: &Frame,
        job: &BenchJob,
        progress: &Progress,
    ) -> Result<Times, Failure> {
        // Frames and replays run on one thread, whose times vary least
        let single = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|error| Failure::Work(format!("cannot start a thread: {error}")))?;
        let none = Seconds {
            base: Vec::new(),
            by_threads: vec![Vec::new(); job.scaling.len()],
        };
        let mut times = Times {
            replays: vec![vec![none; contestants.len()]; sets.len()],
            frames: vec![Vec::new(); contestants.len()],
        };
        // Replay each ray set through each contestant, on one thread and on several
        for repetition in 0..job.repeat {
            for (set, of_set) in sets.iter().zip(&mut times.replays) {
                for (contestant, seconds) in contestants.iter().zip(of_set) {
                    interrupt::check()?;
                    // Replay on one thread, then with every thread count
                    let (engine, mode) = (contestant.engine, contestant.mode);
                    seconds.base.push(replay_seconds(engine, set, mode));
                    for (pool, seconds) in job.scaling.iter().zip(&mut seconds.by_threads) {
                        seconds.push(shared_replay_seconds(pool, engine, set, mode));
                    }
                }
            }
            // Render the frame with the contestants that can, on one thread
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

    /// Returns the time of the frame with one contestant, or with the first if it has none, relative to the first
    /// contestant's raw traces of the same rays.
    pub(super) fn frame(
        &self,
        contestants: &[Contestant],
        sets: &[RayWorkload],
        index: usize,
    ) -> Option<FrameTime> {
        // Choose the frames and the raw contestant
        let raw = contestants
            .iter()
            .position(|contestant| contestant.mode == Mode::Raw)?;
        let frames = [index, 0].map(|index| &self.frames[index]);
        let frames = frames.into_iter().find(|frames| !frames.is_empty())?;
        let ledger = frames.first()?;
        // Scale the raw times of each kind to the number of rays in the frame
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
                rays as f64 * Spread::of(&of_set[raw].base).median / set.ray_count as f64
            })
            .sum();
        // Compare the medians
        let median =
            |of: fn(&RenderProfile) -> f64| Spread::of(&frames.iter().map(of).collect::<Vec<_>>()).median;
        let seconds = median(|ledger| ledger.seconds);
        Some(FrameTime {
            seconds,
            rays: ledger.camera_rays() + ledger.shadow_rays() + ledger.reflection_rays(),
            over_raw: seconds / raw_seconds,
            trace_share: median(|ledger| ledger.trace_seconds() / ledger.seconds),
        })
    }
}
