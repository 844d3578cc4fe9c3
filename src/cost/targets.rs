//! Settings for a target: foretold, measured, and measured again on pictures that had no part in the choice.

use std::time::{Duration, Instant};

use super::blocks::{Blocks, Protocol};
use super::choose::{Forecast, Goal, Target, candidates, floor, forecasts};
use super::experiment::{Layout, area};
use super::reference::Halved;
use super::stage::Stage;
use super::{Choice, Configuration, CostError, ErrorEstimate, Interval, Pictures, Point};
use crate::accel::{Backend, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{HitPoint, Pattern};

/// Parts of the target that foretold settings keep to spare, round by round.
const MARGINS: [f64; 4] = [0.1, 0.25, 0.4, 0.6];
/// Settings that are measured in a round.
const A_ROUND: usize = 3;
/// Blocks of a measurement: the fewest whose extremes hold a median.
const BLOCKS: usize = 6;
/// Part of the budget that the first settings may take even if it is spent.
const FIRST_PART: f64 = 0.05;
/// Seeds of the pictures that settings are chosen by, and of those that had no part in it.
const CHOOSING_SEED: u32 = 10_000;
const HELD_OUT_SEED: u32 = 20_000;

/// What was measured of settings.
#[derive(Clone, Copy)]
struct Trial {
    rmse: Interval,
    seconds: Interval,
    time_ratio: Interval,
}

impl Trial {
    fn reaches(&self, goal: Goal) -> bool {
        match goal {
            Goal::Error(most) => self.rmse.high <= most,
            Goal::TimeRatio(most) => self.time_ratio.high <= most,
        }
    }

    /// What there should be little of among those that reach a target.
    fn price(&self, goal: Goal) -> f64 {
        match goal {
            Goal::Error(_) => self.time_ratio.value,
            Goal::TimeRatio(_) => self.rmse.high,
        }
    }

    /// By how much a target is missed.
    fn miss(&self, goal: Goal) -> f64 {
        match goal {
            Goal::Error(_) => self.rmse.high,
            Goal::TimeRatio(_) => self.time_ratio.high,
        }
    }
}

/// Everything that was measured on the way to a target.
#[derive(Default)]
struct Search {
    tried: Vec<(Forecast, Trial)>,
    /// Those that did not reach it a second time.
    failed: Vec<Configuration>,
}

impl Search {
    fn knows(&self, configuration: &Configuration) -> bool {
        let mut tried = self.tried.iter();
        tried.any(|(forecast, _)| forecast.configuration == *configuration)
    }

    /// The cheapest of those that reached the goal and did not fail since.
    fn best(&self, goal: Goal) -> Option<Forecast> {
        let reaching = self.tried.iter().filter(|(forecast, trial)| {
            trial.reaches(goal) && !self.failed.contains(&forecast.configuration)
        });
        let best = reaching.min_by(|a, b| a.1.price(goal).total_cmp(&b.1.price(goal)));
        best.map(|(forecast, _)| forecast.clone())
    }

    /// The one that misses the goal least.
    fn nearest(&self, goal: Goal) -> Option<(Forecast, Trial)> {
        let all = self.tried.iter();
        all.min_by(|a, b| a.1.miss(goal).total_cmp(&b.1.miss(goal)))
            .cloned()
    }
}

impl Stage<'_, '_> {
    /// Settings for `target`, and their configuration; `points` and `configurations` are those of a study, the base first.
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
            Target::Seconds(most) => Goal::TimeRatio((most - ready) / (scale * of_base.seconds.value)),
        };
        let offered = forecasts(points, configurations, |configuration| {
            self.offers(base, configuration)
        });
        let mut search = Search::default();
        let chosen = self.search(
            goal,
            &offered,
            (base, of_base.seconds.value),
            measured,
            &mut search,
        )?;
        // Where nothing else could be measured that was foretold to come near, it is the base; nobody chose it by how it
        // did.
        let staying = || {
            let forecast = Forecast {
                configuration: *base,
                mean_square: of_base.mean_square(),
                time_ratio: 1.0,
            };
            let trial = Trial {
                rmse: of_base.rmse,
                seconds: of_base.seconds,
                time_ratio: of_base.time_ratio,
            };
            (forecast, trial)
        };
        let (forecast, trial, reached) = match (chosen, search.nearest(goal)) {
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
            tried: search.tried.len(),
            floor: floor(points, &offered).map(|(square, knob)| (square.sqrt(), knob)),
        };
        Ok((choice, forecast.configuration))
    }

    /// Measures what is foretold to reach the goal, with more and more of it to spare, until something does so twice.
    fn search(
        &mut self,
        goal: Goal,
        offered: &[Forecast],
        (base, base_seconds): (&Configuration, f64),
        measured: (&Layout, &Halved),
        search: &mut Search,
    ) -> Result<Option<(Forecast, Trial)>, CostError> {
        for margin in MARGINS {
            let mut fitting = candidates(offered, goal, margin).into_iter();
            for _ in 0..A_ROUND {
                // Twice, as what is chosen is measured again.
                let affordable = |forecast: &Forecast| {
                    let seconds = 2.0 * BLOCKS as f64 * (1.0 + forecast.time_ratio) * base_seconds;
                    let is_first = search.tried.is_empty() && seconds <= FIRST_PART * self.experiment.budget;
                    is_first || self.spent() + seconds <= self.experiment.budget
                };
                let next = fitting
                    .find(|forecast| !search.knows(&forecast.configuration) && affordable(forecast))
                    .cloned();
                let Some(forecast) = next else {
                    break;
                };
                self.build(&forecast.configuration)?;
                let trial = self.trial(base, &forecast.configuration, measured, CHOOSING_SEED)?;
                search.tried.push((forecast, trial));
            }
            while let Some(best) = search.best(goal) {
                let again = self.trial(base, &best.configuration, measured, HELD_OUT_SEED)?;
                if again.reaches(goal) {
                    return Ok(Some((best, again)));
                }
                search.failed.push(best.configuration);
            }
        }
        Ok(None)
    }

    /// Whether settings may be chosen: hits are trusted no less than in the base, adaptive sampling has a pattern that
    /// goes on, and the scene is there.
    fn offers(&self, base: &Configuration, configuration: &Configuration) -> bool {
        let trust = |configuration: &Configuration| match configuration.path.backend {
            Backend::Embree => Precision::ALL
                .iter()
                .position(|&p| p == configuration.path.precision),
            Backend::Bsp if configuration.path.precision == Precision::Fast => Some(0),
            Backend::Bsp | Backend::Brute => Some(Precision::ALL.len()),
        };
        let settings = &configuration.settings;
        let keeps_spawn = [base.settings.spawn, SpawnPolicy::Bounded].contains(&settings.spawn);
        trust(configuration) >= trust(base)
            && keeps_spawn
            && [base.settings.hit_points, HitPoint::Refined].contains(&settings.hit_points)
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
        base: &Configuration,
        configuration: &Configuration,
        (layout, reference): (&Layout, &Halved),
        seed: u32,
    ) -> Result<Trial, CostError> {
        let mut pictures = Pictures::new(&reference.halves);
        let protocol = Protocol {
            least: BLOCKS,
            most: BLOCKS,
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
