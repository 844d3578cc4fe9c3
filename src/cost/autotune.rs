//! Choice of settings for a target: predict, measure, and measure again on images that were not used for the choice.

use super::accumulated_reference::AccumulatedReference;
use super::layout::Layout;
use super::predict::{Prediction, floor, forecasts};
use super::target::{Goal, Target};
use super::tuner::{Search, Trial};
use super::view::area;
use super::workspace::Workspace;
use super::{Choice, Configuration, CostError, ErrorEstimate, ImageSums, Interval, Knob, Point};
use crate::measure::{Blocks, Protocol};
use crate::render::Pattern;

/// Blocks by which settings are compared during the search.
const CHOOSING_BLOCKS: usize = 2;
/// Blocks of the final measurement: the fewest whose extremes enclose a median at 95 %.
const HELD_OUT_BLOCKS: usize = 6;
/// Fraction of the budget that the first settings may take even if the budget is spent.
const FIRST_FRACTION: f64 = 0.1;
/// Random seeds of the images that settings are chosen by, and of the held-out images.
const CHOOSING_SEED: u32 = 10_000;
const HELD_OUT_SEED: u32 = 20_000;

impl Workspace<'_, '_> {
    /// Chooses settings for `target` and returns them with their configuration; `points` and `configurations` are those
    /// of a study, the base first.
    pub(super) fn choose(
        &mut self,
        target: Target,
        measured: (&Layout, &AccumulatedReference),
        (points, configurations): (&[Point], &[Configuration]),
    ) -> Result<(Choice, Configuration), CostError> {
        self.report_step("choose");
        let (base, of_base) = (&configurations[0], &points[0]);
        // Convert the target to the study's units
        let [scale, ready] = self.whole_image_scale(measured.0, of_base);
        let goal = match target {
            Target::Error(most) => Goal::Error(most),
            Target::Seconds(most) => {
                Goal::TimeRatio((most - ready).max(0.0) / (scale * of_base.seconds.value))
            }
        };
        // Predict all combinations of levels
        let offered = forecasts(points, configurations, |configuration| {
            self.may_choose(base, configuration)
        });
        let of_base = &Trial {
            rmse: of_base.rmse,
            seconds: of_base.seconds,
            time_ratio: of_base.time_ratio,
        };
        // Search for settings that reach the goal
        let mut search = Search::new(goal, &offered, of_base);
        // Settings that miss the target are not worth more time than the search for those that reach it.
        let max_time_ratio = self.experiment.budget / (scale * of_base.seconds.value);
        let chosen = self.search(
            (base, of_base.seconds.value, max_time_ratio),
            measured,
            &mut search,
        )?;
        // The base remains where nothing else could be measured; no selection bias affects its measurement.
        let staying = || {
            let forecast = Prediction {
                configuration: *base,
                turns: [0; Knob::ALL.len()],
                mean_square: of_base.rmse.value.powi(2),
                time_ratio: 1.0,
            };
            (forecast, *of_base)
        };
        // Take the chosen settings, or the nearest ones
        let (forecast, trial, reached) = match (chosen, search.nearest(max_time_ratio)) {
            (Some((forecast, trial)), _) => (forecast, trial, true),
            (None, Some((forecast, trial))) => (forecast, trial, false),
            (None, None) => {
                let (forecast, trial) = staying();
                (forecast, trial, trial.reaches(goal))
            }
        };
        // Report the choice with prediction and measurement
        let choice = Choice {
            target,
            reached,
            settings: forecast.configuration.words(),
            foretold_rmse: forecast.mean_square.sqrt(),
            foretold_seconds: ready + scale * of_base.seconds.value * forecast.time_ratio,
            rmse: trial.rmse,
            seconds: trial.seconds,
            whole_seconds: trial.seconds.map(|seconds| ready + scale * seconds),
            tried: search.count(),
            floor: floor(points, &offered).map(|(square, knob)| (square.sqrt(), knob)),
        };
        Ok((choice, forecast.configuration))
    }

    /// Measures candidates that are expected to reach the goal until one does so twice, the second time in held-out
    /// images.
    fn search(
        &mut self,
        (base, base_seconds, max_time_ratio): (&Configuration, f64, f64),
        measured: (&Layout, &AccumulatedReference),
        search: &mut Search,
    ) -> Result<Option<(Prediction, Trial)>, CostError> {
        loop {
            // Measure candidates while the budget lasts
            let budget = self.experiment.budget;
            while let Some((place, forecast)) = search.next(max_time_ratio, |forecast| {
                let block = (1.0 + forecast.time_ratio) * base_seconds;
                let choosing = CHOOSING_BLOCKS as f64 * block;
                let is_first = search.count() == 0 && choosing <= FIRST_FRACTION * budget;
                // The budget includes the second measurement of the chosen settings.
                let all = choosing + HELD_OUT_BLOCKS as f64 * block;
                is_first || self.spent() + all <= budget
            }) {
                self.build(&forecast.configuration)?;
                let turns = (base, &forecast.configuration);
                let trial = self.trial(turns, measured, (CHOOSING_BLOCKS, CHOOSING_SEED))?;
                search.note(place, forecast, trial);
            }
            // Measure the best again on held-out images
            let Some(best) = search.best_expected() else {
                return Ok(None);
            };
            let turns = (base, &best.configuration);
            let again = self.trial(turns, measured, (HELD_OUT_BLOCKS, HELD_OUT_SEED))?;
            if again.reaches(search.goal()) {
                return Ok(Some((best, again)));
            }
            search.mark_best_failed();
        }
    }

    /// Returns whether settings may be chosen: hits are as accurate as the base's, adaptive sampling has a progressive
    /// pattern, and the scene variant exists.
    fn may_choose(&self, base: &Configuration, configuration: &Configuration) -> bool {
        let settings = &configuration.settings;
        configuration.is_as_accurate_as(base)
            && !(settings.adaptive.is_some() && settings.pattern == Pattern::Regular)
            && self.has_scene_variant(&configuration.change)
    }

    /// Returns the ratio of the complete image's pixels to the measured ones, and its setup time in seconds.
    fn whole_image_scale(&self, layout: &Layout, base: &Point) -> [f64; 2] {
        let part = area(self.whole_size()) / area(self.size_of(layout.view));
        [part, base.ready_seconds]
    }

    /// Measures `configuration` against the base in alternation, with random numbers that were not used before.
    fn trial(
        &self,
        (base, configuration): (&Configuration, &Configuration),
        (layout, reference): (&Layout, &AccumulatedReference),
        (count, seed): (usize, u32),
    ) -> Result<Trial, CostError> {
        let mut sums = ImageSums::new(&reference.halves);
        let protocol = Protocol::of_blocks(count, u64::from(seed));
        let blocks = Blocks::measure(2, &protocol, &|_| {}, |who, block| {
            self.report_step("choose");
            let turn = if who == 0 { base } else { configuration };
            let (rendering, time) = self.render_image(turn, layout.view, seed + block as u32)?;
            if who == 1 {
                sums.add(&reference.halves, &self.displayed(&rendering.image, layout.view));
            }
            Ok::<_, CostError>(time)
        })?;
        let error: ErrorEstimate = sums.estimate(&reference.halves, u64::from(seed));
        Ok(Trial {
            rmse: error.rmse(),
            seconds: Interval::of_median(&blocks.seconds(1)),
            time_ratio: Interval::of_median(&blocks.ratios(1, 0)),
        })
    }
}
