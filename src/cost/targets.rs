//! Settings for a target: foretold, measured, and measured again on pictures that had no part in the choice.

use std::time::{Duration, Instant};

use super::blocks::{Blocks, Protocol};
use super::choose::{Forecast, Goal, Target, floor, forecasts};
use super::layout::{Layout, area};
use super::reference::Halved;
use super::search::{Search, Trial};
use super::stage::Stage;
use super::{Choice, Configuration, CostError, ErrorEstimate, Knob, Pictures, Point};
use crate::render::Pattern;

/// Blocks by which settings are chosen.
const CHOOSING_BLOCKS: usize = 2;
/// Blocks by which what was chosen is measured: the fewest whose extremes hold a median.
const HELD_OUT_BLOCKS: usize = 6;
/// Part of the budget that the first settings may take even if it is spent.
const FIRST_PART: f64 = 0.1;
/// Seeds of the pictures that settings are chosen by, and of those that had no part in it.
const CHOOSING_SEED: u32 = 10_000;
const HELD_OUT_SEED: u32 = 20_000;

impl Stage<'_, '_> {
    /// Settings for `target`, and their configuration; `points` and `configurations` are those of a study, the base
    /// first.
    pub(super) fn choose(
        &mut self,
        target: Target,
        measured: (&Layout, &Halved),
        (points, configurations): (&[Point], &[Configuration]),
    ) -> Result<(Choice, Configuration), CostError> {
        self.say("choose");
        let (base, of_base) = (&configurations[0], &points[0]);
        let [scale, ready] = self.whole_picture(measured.0, of_base);
        let goal = match target {
            Target::Error(most) => Goal::Error(most),
            Target::Seconds(most) => {
                Goal::TimeRatio((most - ready).max(0.0) / (scale * of_base.seconds.value))
            }
        };
        let offered = forecasts(points, configurations, |configuration| {
            self.offers(base, configuration)
        });
        let of_base = &Trial {
            rmse: of_base.rmse,
            seconds: of_base.seconds,
            time_ratio: of_base.time_ratio,
        };
        let mut search = Search::new(goal, &offered, of_base);
        // What does not reach the target is not worth more time than looking for what does.
        let bearable = self.experiment.budget / (scale * of_base.seconds.value);
        let chosen = self.search((base, of_base.seconds.value, bearable), measured, &mut search)?;
        // Where nothing else could be measured it is the base; nobody chose it by how it did.
        let staying = || {
            let forecast = Forecast {
                configuration: *base,
                turns: [0; Knob::ALL.len()],
                mean_square: of_base.rmse.value.powi(2),
                time_ratio: 1.0,
            };
            (forecast, *of_base)
        };
        let (forecast, trial, reached) = match (chosen, search.nearest(bearable)) {
            (Some((forecast, trial)), _) => (forecast, trial, true),
            (None, Some((forecast, trial))) => (forecast, trial, false),
            (None, None) => {
                let (forecast, trial) = staying();
                (forecast, trial, trial.reaches(goal))
            }
        };
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

    /// Measures what is expected to reach the goal until something does so twice, the second time in pictures that had no
    /// part in the choice.
    fn search(
        &mut self,
        (base, base_seconds, bearable): (&Configuration, f64, f64),
        measured: (&Layout, &Halved),
        search: &mut Search,
    ) -> Result<Option<(Forecast, Trial)>, CostError> {
        loop {
            let budget = self.experiment.budget;
            while let Some((place, forecast)) = search.next(bearable, |forecast| {
                let block = (1.0 + forecast.time_ratio) * base_seconds;
                let choosing = CHOOSING_BLOCKS as f64 * block;
                let is_first = search.count() == 0 && choosing <= FIRST_PART * budget;
                // What is chosen is measured again.
                let all = choosing + HELD_OUT_BLOCKS as f64 * block;
                is_first || self.spent() + all <= budget
            }) {
                self.build(&forecast.configuration)?;
                let turns = (base, &forecast.configuration);
                let trial = self.trial(turns, measured, (CHOOSING_BLOCKS, CHOOSING_SEED))?;
                search.note((place, forecast), trial);
            }
            let Some(best) = search.best_expected() else {
                return Ok(None);
            };
            let turns = (base, &best.configuration);
            let again = self.trial(turns, measured, (HELD_OUT_BLOCKS, HELD_OUT_SEED))?;
            if again.reaches(search.goal()) {
                return Ok(Some((best, again)));
            }
            search.fail_best();
        }
    }

    /// Whether settings may be chosen: hits are trusted no less than in the base, adaptive sampling has a pattern that
    /// goes on, and the scene is there.
    fn offers(&self, base: &Configuration, configuration: &Configuration) -> bool {
        let settings = &configuration.settings;
        configuration.is_trusted_like(base)
            && !(settings.adaptive.is_some() && settings.pattern == Pattern::Regular)
            && self.has_scene(&configuration.change)
    }

    /// By how much more pixels the whole picture has than those that were measured, and the seconds that it takes to make
    /// ready.
    fn whole_picture(&self, layout: &Layout, base: &Point) -> [f64; 2] {
        let part = area(self.whole_size()) / area(self.size_of(layout.view));
        [part, base.ready_seconds]
    }

    /// Pictures of the base and of `configuration` in turns, of other random numbers than any before.
    fn trial(
        &self,
        (base, configuration): (&Configuration, &Configuration),
        (layout, reference): (&Layout, &Halved),
        (count, seed): (usize, u32),
    ) -> Result<Trial, CostError> {
        let mut pictures = Pictures::new(&reference.halves);
        let protocol = Protocol {
            least: count,
            most: count,
            deadline: Instant::now() + Duration::from_secs(1),
            seed: u64::from(seed),
        };
        let blocks = Blocks::measure(2, &protocol, |who, block| {
            self.say("choose");
            let turn = if who == 0 { base } else { configuration };
            let (rendering, seconds) = self.picture(turn, layout.view, seed + block as u32)?;
            if who == 1 {
                pictures.add(&reference.halves, &self.displayed(&rendering.image, layout.view));
            }
            Ok::<f64, CostError>(seconds)
        })?;
        let error: ErrorEstimate = pictures.estimate(&reference.halves, u64::from(seed));
        Ok(Trial {
            rmse: error.rmse(),
            seconds: blocks.seconds(1),
            time_ratio: blocks.ratio(1, 0),
        })
    }
}
