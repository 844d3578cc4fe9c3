//! Times of replaying a frame's rays through each contestant, and of rendering the frame itself.

use super::error::BenchError;
use super::options::{BenchOptions, MeasuredScene};
use super::ray_workload::{RayKind, RayWorkload};
use super::replay::{Mode, PARTS, ReplayPart, replay_time, shared_replay_time};
use super::rows::FrameTime;
use super::structures::{Contestant, Structure};
use crate::accel::Backend;
use crate::measure::{Blocks, Interval, Stopwatch, TurnTime};
use crate::parallel;
use crate::render::{RenderProfile, RenderSettings, render};

/// Measured times of all contestants.
pub(super) struct Times<'m> {
    sets: &'m [RayWorkload],
    contestants: &'m [Contestant<'m>],
    /// Number of ways to replay a set: on one thread, and with each pool of the scaling measurement.
    ways: usize,
    /// Replays ordered by set, contestant and way, and then the frames.
    blocks: Blocks,
    /// Contestants that render the frame, with the profile of each repetition.
    frames: Vec<(usize, Vec<RenderProfile>)>,
}

impl<'m> Times<'m> {
    /// Measures all contestants with all sets of rays, and the frame.
    pub(super) fn measure(
        measured: &MeasuredScene,
        sets: &'m [RayWorkload],
        structures: &[Structure],
        contestants: &'m [Contestant<'m>],
        options: &BenchOptions,
    ) -> Result<Times<'m>, BenchError> {
        // Frames and replays run on one thread, whose times vary least
        let single = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        let settings = RenderSettings {
            ledger: true,
            ..measured.settings
        };
        let ways = 1 + options.scaling.len();
        let replay_count = sets.len() * contestants.len() * ways;
        // Render the frame with the first contestant, and with Embree at each other precision
        let first = structures[0].precision();
        let renders_frame = |&index: &usize| {
            let Contestant { structure, mode, .. } = &contestants[index];
            let structure = &structures[*structure];
            let is_other_precision = structure.backend == Backend::Embree && structure.precision() != first;
            index == 0 || *mode == Mode::Packet && is_other_precision
        };
        let mut frames: Vec<(usize, Vec<RenderProfile>)> = (0..contestants.len())
            .filter(renders_frame)
            .map(|index| (index, Vec::new()))
            .collect();
        let blocks = options.blocks(
            "replay",
            (replay_count + frames.len(), PARTS),
            |candidate, part| {
                // Render a frame, undivided
                if let Some(frame) = candidate.checked_sub(replay_count) {
                    if part > 0 {
                        return Ok(TurnTime::of_seconds(0.0));
                    }
                    let (contestant, profiles) = &mut frames[frame];
                    let accel = structures[contestants[*contestant].structure].accel();
                    let monitor = options.observer.monitor();
                    let render = || render(measured.scene, measured.camera, accel, &settings, &monitor);
                    let watch = Stopwatch::start();
                    let profile = parallel::install(&single, render)?.ledger;
                    let whole = watch.time();
                    let time = whole.without(whole.elapsed - profile.seconds);
                    profiles.push(profile);
                    return Ok(time);
                }
                // Replay a part of a ray set on one thread or on several
                let Contestant { engine, mode, .. } = contestants[candidate / ways % contestants.len()];
                let part = ReplayPart::of(&sets[candidate / (ways * contestants.len())], part);
                Ok(match (candidate % ways).checked_sub(1) {
                    None => replay_time(engine, part, mode),
                    Some(pool) => shared_replay_time(&options.scaling[pool], engine, part, mode),
                })
            },
        )?;
        Ok(Times {
            sets,
            contestants,
            ways,
            blocks,
            frames,
        })
    }

    /// Returns million rays per second of a set through a contestant, with the slowest and the fastest repetition:
    /// `way` 0 is one thread by its processor time, the others are the pools of the scaling measurement by the clock.
    pub(super) fn speed(&self, set: usize, contestant: usize, way: usize) -> Interval {
        let candidate = (set * self.contestants.len() + contestant) * self.ways + way;
        let ray_count = self.sets[set].ray_count as f64;
        // The longest time is the smallest speed, and the median of an even count is that of the times
        let speed = |seconds: f64| ray_count * 1e-6 / seconds;
        let seconds = Interval::of_extremes(&match way {
            0 => self.blocks.processor_seconds(candidate),
            _ => self.blocks.seconds(candidate),
        });
        Interval {
            value: speed(seconds.value),
            low: speed(seconds.high),
            high: speed(seconds.low),
        }
    }

    /// Returns the fraction of its time in which the calibration kernel waited for a processor.
    pub(super) fn waiting(&self) -> f64 {
        self.blocks.timing(0.0, 0.0).waiting
    }

    /// Returns the time of the frame with one contestant, or with the first if it has none, relative to the first
    /// contestant's raw traces of the same rays.
    pub(super) fn frame(&self, contestant: usize) -> Option<FrameTime> {
        // Choose the frames and the raw contestant
        let raw = self
            .contestants
            .iter()
            .position(|contestant| contestant.mode == Mode::Raw)?;
        let of_contestant = self.frames.iter().position(|(index, _)| *index == contestant);
        let frame = of_contestant.unwrap_or(0);
        let profiles = &self.frames[frame].1;
        let profile = profiles.first()?;
        // Scale the raw times of each kind to the number of rays in the frame
        let raw_seconds: f64 = (0..self.sets.len())
            .map(|set| {
                let rays = match self.sets[set].kind {
                    RayKind::Camera => profile.camera_rays(),
                    RayKind::Shadow => profile.shadow_rays(),
                    RayKind::Reflection => profile.reflection_rays(),
                    RayKind::Random => 0,
                };
                rays as f64 * 1e-6 / self.speed(set, raw, 0).value
            })
            .sum();
        // Compare the medians
        let replay_count = self.sets.len() * self.contestants.len() * self.ways;
        let seconds = Interval::of_extremes(&self.blocks.processor_seconds(replay_count + frame)).value;
        let trace_shares: Vec<f64> = profiles
            .iter()
            .map(|profile| profile.trace_seconds() / profile.seconds)
            .collect();
        Some(FrameTime {
            seconds,
            rays: profile.camera_rays() + profile.shadow_rays() + profile.reflection_rays(),
            over_raw: seconds / raw_seconds,
            trace_share: Interval::of_extremes(&trace_shares).value,
        })
    }
}
