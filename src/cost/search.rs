//! The order in which settings are measured for a target.
//!
//! What is foretold of settings is set right by what was measured of those that are turned most like them. The cheapest
//! that are then expected to reach the target are measured next, until nothing is expected to do so for less than what
//! did. Then, and where nothing is, knobs that were never turned that far are believed to do as well as was foretold.

use super::Interval;
use super::choose::{Forecast, Goal};

/// What is expected to save less of the price than this is not measured.
const WORTH: f64 = 0.95;
/// Settings that are measured for the mere hope that they do better than what reached the target.
const CURIOUS: usize = 8;
/// The part of what is expected of its squared error that is hoped of what differs from the best in samples alone.
const HOPED: f64 = 0.6;
/// By how much wider intervals are taken for each settings that did not reach the target a second time.
const CAUTION: f64 = 1.05;

/// What was measured of settings.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial {
    pub(super) rmse: Interval,
    pub(super) seconds: Interval,
    pub(super) time_ratio: Interval,
}

impl Trial {
    /// The mean squared error, where noise takes it to 0 what it may be.
    fn mean_square(&self) -> f64 {
        self.rmse.value.max(0.5 * self.rmse.high).powi(2)
    }

    pub(super) fn reaches(&self, goal: Goal) -> bool {
        match goal {
            Goal::Error(most) => self.rmse.high <= most,
            Goal::TimeRatio(most) => self.time_ratio.high <= most,
        }
    }

    /// What there should be little of among those that reach a target.
    fn price(&self, goal: Goal) -> f64 {
        match goal {
            Goal::Error(_) => self.time_ratio.value,
            Goal::TimeRatio(_) => self.rmse.value,
        }
    }

    /// What a target limits.
    fn limited(&self, goal: Goal) -> Interval {
        match goal {
            Goal::Error(_) => self.rmse,
            Goal::TimeRatio(_) => self.time_ratio,
        }
    }
}

/// Settings that were measured.
struct Tried {
    /// Where they are among those offered.
    place: usize,
    /// As expected before.
    expected: Forecast,
    trial: Trial,
    /// Whether they did not reach the target a second time.
    failed: bool,
}

/// Everything that was measured on the way to a target.
pub(super) struct Search<'f> {
    goal: Goal,
    offered: &'f [Forecast],
    /// Upper ends of intervals over their values, in the base.
    spread: f64,
    tried: Vec<Tried>,
}

/// The upper end of an interval over its value.
fn spread_of(interval: Interval) -> f64 {
    if interval.value > 0.0 {
        (interval.high / interval.value).max(1.0)
    } else {
        1.0
    }
}

impl<'f> Search<'f> {
    /// One that has measured nothing but the base.
    pub(super) fn new(goal: Goal, offered: &'f [Forecast], base: &Trial) -> Search<'f> {
        Search {
            goal,
            offered,
            spread: spread_of(base.limited(goal)),
            tried: Vec::new(),
        }
    }

    /// What is looked for.
    pub(super) fn goal(&self) -> Goal {
        self.goal
    }

    /// How many settings were measured.
    pub(super) fn count(&self) -> usize {
        self.tried.len()
    }

    /// What is expected of settings by now, and the upper end of what the target limits over its value. The `hopeful` set
    /// right no knob that was never turned so far, and expect more of other samples of the best.
    fn expected(&self, place: usize, hopeful: bool) -> (Forecast, f64) {
        let forecast = &self.offered[place];
        let distance = |tried: &Tried| {
            let other = &self.offered[tried.place];
            let turned = forecast
                .turns
                .iter()
                .zip(&other.turns)
                .filter(|(a, b)| a != b)
                .count();
            turned as f64 + (other.time_ratio / forecast.time_ratio).log2().abs()
        };
        let nearest = self.tried.iter().map(|tried| (distance(tried), tried));
        let nearest = nearest.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, tried)| tried);
        let [mut square, time] = nearest.map_or([1.0; 2], |tried| {
            let was = &self.offered[tried.place];
            let square = tried.trial.mean_square() / was.mean_square;
            [square, tried.trial.time_ratio.value / was.time_ratio]
        });
        if hopeful && self.is_novel(forecast) {
            square = square.min(1.0);
        }
        let mut mean_square = self.by_line(forecast).unwrap_or(forecast.mean_square * square);
        // Few samples of which some number lies well may do better than more, and noise grows no faster than they get
        // fewer.
        let best = self.best().filter(|_| hopeful);
        if let Some(best) = best.filter(|best| self.offered[best.place].turns == forecast.turns) {
            let fewer = self.offered[best.place].time_ratio / forecast.time_ratio;
            mean_square = (HOPED * mean_square).min(fewer * best.trial.mean_square());
        }
        let spread = nearest.map_or(self.spread, |tried| spread_of(tried.trial.limited(self.goal)));
        let failed = self.tried.iter().filter(|tried| tried.failed).count();
        let expected = Forecast {
            mean_square,
            time_ratio: forecast.time_ratio * time,
            ..forecast.clone()
        };
        (expected, spread * CAUTION.powi(failed as i32))
    }

    /// The squared error of settings of which two that differ from them in sampling alone were measured: on the line
    /// through both, so that what samples do not lower is seen.
    fn by_line(&self, forecast: &Forecast) -> Option<f64> {
        let is_like = |tried: &&Tried| self.offered[tried.place].turns == forecast.turns;
        let place = |tried: &Tried| (self.offered[tried.place].mean_square, tried.trial.mean_square());
        let like: Vec<(f64, f64)> = self.tried.iter().filter(is_like).map(place).collect();
        let first = like.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let last = like.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let slope = (last.1 - first.1) / (last.0 - first.0);
        let on_line = first.1 + slope.max(0.0) * (forecast.mean_square - first.0);
        // A part of what was measured is left always.
        slope.is_finite().then_some(on_line.max(0.0625 * first.1))
    }

    /// Whether a knob is turned to where it never was.
    fn is_novel(&self, forecast: &Forecast) -> bool {
        let mut knobs = forecast.turns.iter().enumerate();
        knobs.any(|(knob, turn)| {
            let mut tried = self.tried.iter();
            tried.all(|tried| self.offered[tried.place].turns[knob] != *turn)
        })
    }

    /// Which settings to measure next, of those that are `affordable`: the cheapest that are expected to reach the target
    /// for less than any did; while none did and none is expected to, those of at most `bearable` times the base's time
    /// that are expected to come much nearer than any before.
    pub(super) fn next(
        &self,
        bearable: f64,
        affordable: impl Fn(&Forecast) -> bool,
    ) -> Option<(usize, Forecast)> {
        let price = |expected: &Forecast| match self.goal {
            Goal::Error(_) => expected.time_ratio,
            Goal::TimeRatio(_) => expected.mean_square.sqrt(),
        };
        let miss = |expected: &Forecast, spread: f64| match self.goal {
            Goal::Error(most) => expected.mean_square.sqrt() * spread / most,
            Goal::TimeRatio(most) => expected.time_ratio * spread / most,
        };
        let best = self.best().map(|best| best.trial.price(self.goal));
        let nearest = self.nearest_tried(bearable).map(|tried| self.miss(tried));
        let mut closest: Option<(f64, usize, Forecast)> = None;
        for hopeful in [false, true] {
            if hopeful && best.is_some() && !self.is_curious() {
                continue;
            }
            let mut cheapest: Option<(usize, Forecast)> = None;
            for place in 0..self.offered.len() {
                if self.tried.iter().any(|tried| tried.place == place) {
                    continue;
                }
                let (expected, spread) = self.expected(place, hopeful);
                if !affordable(&expected) {
                    continue;
                }
                let miss = miss(&expected, spread);
                let is_cheaper = cheapest
                    .as_ref()
                    .is_none_or(|(_, least)| price(&expected) < price(least));
                if miss <= 1.0 && best.is_none_or(|best| price(&expected) < WORTH * best) && is_cheaper {
                    cheapest = Some((place, expected));
                } else if best.is_none()
                    && expected.time_ratio <= bearable
                    && nearest.is_none_or(|nearest| miss < WORTH * nearest)
                    && closest.as_ref().is_none_or(|(least, _, _)| miss < *least)
                {
                    closest = Some((miss, place, expected));
                }
            }
            if cheapest.is_some() {
                return cheapest;
            }
        }
        closest.map(|(_, place, expected)| (place, expected))
    }

    /// Takes down what was measured of what [`Search::next`] told.
    pub(super) fn note(&mut self, (place, expected): (usize, Forecast), trial: Trial) {
        self.tried.push(Tried {
            place,
            expected,
            trial,
            failed: false,
        });
    }

    /// Has the best of those that reached the target reach it no more.
    pub(super) fn fail_best(&mut self) {
        if let Some(place) = self.best().map(|best| best.place) {
            let mut tried = self.tried.iter_mut();
            if let Some(tried) = tried.find(|tried| tried.place == place) {
                tried.failed = true;
            }
        }
    }

    /// Whether others may be measured because they might do better than what reached the target.
    fn is_curious(&self) -> bool {
        let first = self.tried.iter().position(|tried| tried.trial.reaches(self.goal));
        first.is_some_and(|first| self.tried.len() - first <= CURIOUS)
    }

    fn best(&self) -> Option<&Tried> {
        let reaching = self
            .tried
            .iter()
            .filter(|tried| tried.trial.reaches(self.goal) && !tried.failed);
        reaching.min_by(|a, b| a.trial.price(self.goal).total_cmp(&b.trial.price(self.goal)))
    }

    /// The cheapest of those that reached the target and did not fail since, as they were expected to do.
    pub(super) fn best_expected(&self) -> Option<Forecast> {
        self.best().map(|best| best.expected.clone())
    }

    fn miss(&self, tried: &Tried) -> f64 {
        let (Goal::Error(most) | Goal::TimeRatio(most)) = self.goal;
        tried.trial.limited(self.goal).high / most
    }

    fn nearest_tried(&self, bearable: f64) -> Option<&Tried> {
        let bearable = |tried: &&Tried| tried.trial.time_ratio.value <= bearable;
        let tried = self.tried.iter().filter(bearable);
        tried.min_by(|a, b| self.miss(a).total_cmp(&self.miss(b)))
    }

    /// The one that misses the target least, of those of at most `bearable` times the base's time.
    pub(super) fn nearest(&self, bearable: f64) -> Option<(Forecast, Trial)> {
        self.nearest_tried(bearable)
            .map(|tried| (tried.expected.clone(), tried.trial))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::{Configuration, HitPath, Knob, SceneChange};
    use crate::render::RenderSettings;

    /// Families of settings, the time of one sample in each and its squared error beside what is left of it.
    const FAMILIES: [(f64, f64, f64); 4] = [
        (1.0, 4e-2, 0.0),
        (0.5, 4e-2, 3e-5),
        (1.5, 1e-2, 1e-5),
        (0.4, 4e-2, 1e-3),
    ];
    /// What was foretold of the squared errors, over the truth: some knobs do not go together.
    const FORETOLD: [f64; 4] = [1.0, 0.3, 1.5, 0.05];

    fn truth(family: usize, spp: u32) -> (f64, f64) {
        let (time, noise, left) = FAMILIES[family];
        (noise / f64::from(spp) + left, time * f64::from(spp))
    }

    fn offered() -> Vec<Forecast> {
        let settings = |spp| RenderSettings {
            spp,
            ..RenderSettings::default()
        };
        let families = 0..FAMILIES.len();
        let all = families.flat_map(|family| {
            (0..11).map(move |power| {
                let spp = 1 << power;
                let (square, time) = truth(family, spp);
                Forecast {
                    configuration: Configuration {
                        settings: settings(spp),
                        path: HitPath::BSP,
                        change: SceneChange::default(),
                    },
                    turns: {
                        let mut turns = [0; Knob::ALL.len()];
                        turns[0] = family as u8;
                        turns
                    },
                    mean_square: FORETOLD[family] * square,
                    time_ratio: time,
                }
            })
        });
        all.collect()
    }

    fn trial(family: usize, spp: u32) -> Trial {
        let (square, time) = truth(family, spp);
        let interval = |value: f64| Interval {
            value,
            low: 0.97 * value,
            high: 1.03 * value,
        };
        Trial {
            rmse: interval(square.sqrt()),
            seconds: interval(time),
            time_ratio: interval(time),
        }
    }

    /// What a search comes to, and how many settings it measured.
    fn search(goal: Goal) -> (Option<(f64, f64)>, usize) {
        let offered = offered();
        let mut search = Search::new(goal, &offered, &trial(0, 4));
        while let Some((place, expected)) = search.next(f64::INFINITY, |_| true) {
            let measured = trial(
                usize::from(offered[place].turns[0]),
                offered[place].configuration.settings.spp,
            );
            search.note((place, expected), measured);
        }
        let best = search.best().map(|best| {
            let forecast = &offered[best.place];
            truth(
                usize::from(forecast.turns[0]),
                forecast.configuration.settings.spp,
            )
        });
        (best, search.count())
    }

    #[test]
    fn wrong_forecasts_are_set_right_and_the_best_is_found_by_few_measurements() {
        let all: Vec<(f64, f64)> = (0..FAMILIES.len())
            .flat_map(|family| (0..11).map(move |power| truth(family, 1 << power)))
            .collect();
        for most in [0.1, 0.05, 0.02, 0.01, 0.0075, 0.0065] {
            let (found, count) = search(Goal::Error(most));
            let reaching = all.iter().filter(|(square, _)| square.sqrt() * 1.03 <= most);
            let least = reaching.map(|(_, time)| *time).fold(f64::INFINITY, f64::min);
            let (square, time) = found.unwrap();
            assert!(square.sqrt() <= most, "{most}");
            assert!(
                time <= 1.5 * least && count <= 14,
                "{most}: {time}, {least}, {count}"
            );
        }
        for most in [2.0, 10.0, 100.0] {
            let (found, count) = search(Goal::TimeRatio(most));
            let affordable = all.iter().filter(|(_, time)| time * 1.03 <= most);
            let least = affordable
                .map(|(square, _)| *square)
                .fold(f64::INFINITY, f64::min);
            let (square, time) = found.unwrap();
            assert!(
                time <= most && square <= 1.5 * least && count <= 14,
                "{most}: {square}, {least}, {count}"
            );
        }
    }

    #[test]
    fn what_cannot_be_reached_is_come_near() {
        let (found, count) = search(Goal::Error(1e-4));
        assert!(found.is_none() && count > 0);
        let offered = offered();
        let goal = Goal::Error(1e-4);
        let mut search = Search::new(goal, &offered, &trial(0, 4));
        while let Some((place, expected)) = search.next(300.0, |_| true) {
            let measured = trial(
                usize::from(offered[place].turns[0]),
                offered[place].configuration.settings.spp,
            );
            search.note((place, expected), measured);
        }
        let (nearest, _) = search.nearest(300.0).unwrap();
        assert!(
            nearest.time_ratio > 100.0 && nearest.time_ratio < 300.0,
            "{nearest:?}"
        );
    }

    #[test]
    fn what_fails_a_second_time_is_best_no_more() {
        let offered = offered();
        let mut search = Search::new(Goal::Error(0.1), &offered, &trial(0, 4));
        while let Some((place, expected)) = search.next(f64::INFINITY, |_| true) {
            let measured = trial(
                usize::from(offered[place].turns[0]),
                offered[place].configuration.settings.spp,
            );
            search.note((place, expected), measured);
        }
        let first = search.best_expected().unwrap();
        search.fail_best();
        assert_ne!(search.best_expected(), Some(first));
    }
}
