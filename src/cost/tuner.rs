//! Sequential search for settings that reach a target: the order of measurements.
//!
//! Predictions are corrected by the measurements of the most similar settings. The cheapest settings that are then
//! expected to reach the target are measured next, until none is expected to reach it for less than the best so far.
//! After that, and where none is expected to reach it, levels that the search never measured are assumed to do as well
//! as predicted.

use super::Interval;
use super::predict::Prediction;
use super::target::Goal;

/// Largest ratio of expected to best price at which settings are worth a measurement.
const MAX_PRICE_RATIO: f64 = 0.95;
/// Number of exploratory measurements, in the hope of beating settings that reached the target.
const MAX_EXPLORATION: usize = 8;
/// Fraction of the expected squared error that is assumed optimistically for settings that differ from the best in
/// samples alone.
const OPTIMISM: f64 = 0.6;
/// Factor by which intervals are widened for each settings that missed the target the second time.
const INTERVAL_WIDENING: f64 = 1.05;

/// Measured error and time of settings.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial {
    pub(super) rmse: Interval,
    pub(super) seconds: Interval,
    pub(super) time_ratio: Interval,
}

impl Trial {
    /// Returns the mean squared error; where noise brings it near 0, the square of half the upper end of the root mean
    /// squared error.
    fn mean_square(&self) -> f64 {
        self.rmse.value.max(0.5 * self.rmse.high).powi(2)
    }

    pub(super) fn reaches(&self, goal: Goal) -> bool {
        match goal {
            Goal::Error(most) => self.rmse.high <= most,
            Goal::TimeRatio(most) => self.time_ratio.high <= most,
        }
    }

    /// Returns the quantity that is minimised among settings that reach the goal.
    fn price(&self, goal: Goal) -> f64 {
        match goal {
            Goal::Error(_) => self.time_ratio.value,
            Goal::TimeRatio(_) => self.rmse.value,
        }
    }

    /// Returns the quantity that the goal limits.
    fn limited(&self, goal: Goal) -> Interval {
        match goal {
            Goal::Error(_) => self.rmse,
            Goal::TimeRatio(_) => self.time_ratio,
        }
    }
}

/// Settings that were measured, with prediction and result.
struct TrialRecord {
    /// Index of the settings in `Search::offered`.
    place: usize,
    /// Error and time as expected before the measurement.
    expected: Prediction,
    trial: Trial,
    /// True if the settings missed the target in the second measurement.
    failed: bool,
}

/// State of the search for settings that reach a target.
pub(super) struct Search<'f> {
    goal: Goal,
    offered: &'f [Prediction],
    /// Ratio of the upper end of the limited quantity's interval to its value, in the base.
    spread: f64,
    tried: Vec<TrialRecord>,
}

/// Returns the ratio of an interval's upper end to its value, at least 1.
fn spread_of(interval: Interval) -> f64 {
    if interval.value > 0.0 {
        (interval.high / interval.value).max(1.0)
    } else {
        1.0
    }
}

impl<'f> Search<'f> {
    /// Returns a search in which only the base is measured.
    pub(super) fn new(goal: Goal, offered: &'f [Prediction], base: &Trial) -> Search<'f> {
        Search {
            goal,
            offered,
            spread: spread_of(base.limited(goal)),
            tried: Vec::new(),
        }
    }

    /// Returns the goal that settings must reach.
    pub(super) fn goal(&self) -> Goal {
        self.goal
    }

    /// Returns the number of settings that were measured.
    pub(super) fn count(&self) -> usize {
        self.tried.len()
    }

    /// Returns the corrected prediction for settings, and the ratio of the limited quantity's upper bound to its value.
    /// With `hopeful`, predictions are not corrected upwards for levels that were never measured, and other sample
    /// counts of the best settings are expected to do better.
    fn expected(&self, place: usize, hopeful: bool) -> (Prediction, f64) {
        let forecast = &self.offered[place];
        // Find the most similar measured settings
        let distance = |tried: &TrialRecord| {
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
        // Correct the prediction by that measurement's ratio to its own prediction
        let [mut square, time] = nearest.map_or([1.0; 2], |tried| {
            let was = &self.offered[tried.place];
            let square = tried.trial.mean_square() / was.mean_square;
            [square, tried.trial.time_ratio.value / was.time_ratio]
        });
        if hopeful && self.has_unmeasured_level(forecast) {
            square = square.min(1.0);
        }
        let mut mean_square = self
            .interpolate_squared_error(forecast)
            .unwrap_or(forecast.mean_square * square);
        // A few samples with a fortunate pattern may beat more, and noise grows at most in proportion as samples
        // decrease.
        let best = self.best().filter(|_| hopeful);
        if let Some(best) = best.filter(|best| self.offered[best.place].turns == forecast.turns) {
            let fewer = self.offered[best.place].time_ratio / forecast.time_ratio;
            mean_square = (OPTIMISM * mean_square).min(fewer * best.trial.mean_square());
        }
        // Widen the interval for every failed settings
        let spread = nearest.map_or(self.spread, |tried| spread_of(tried.trial.limited(self.goal)));
        let failed = self.tried.iter().filter(|tried| tried.failed).count();
        let expected = Prediction {
            mean_square,
            time_ratio: forecast.time_ratio * time,
            ..forecast.clone()
        };
        (expected, spread * INTERVAL_WIDENING.powi(failed as i32))
    }

    /// Returns the squared error interpolated on a line through two measured settings that differ in sampling alone, so
    /// that an error floor independent of samples is included. `None` if there are no two such settings.
    fn interpolate_squared_error(&self, forecast: &Prediction) -> Option<f64> {
        let is_like = |tried: &&TrialRecord| self.offered[tried.place].turns == forecast.turns;
        let place = |tried: &TrialRecord| (self.offered[tried.place].mean_square, tried.trial.mean_square());
        let like: Vec<(f64, f64)> = self.tried.iter().filter(is_like).map(place).collect();
        let first = like.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let last = like.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let slope = (last.1 - first.1) / (last.0 - first.0);
        let on_line = first.1 + slope.max(0.0) * (forecast.mean_square - first.0);
        // Bound the result from below by 1/16 of the smallest predicted one's measured squared error.
        slope.is_finite().then_some(on_line.max(0.0625 * first.1))
    }

    /// Returns whether a knob has a level that was never measured in this search.
    fn has_unmeasured_level(&self, forecast: &Prediction) -> bool {
        let mut knobs = forecast.turns.iter().enumerate();
        knobs.any(|(knob, turn)| {
            let mut tried = self.tried.iter();
            tried.all(|tried| self.offered[tried.place].turns[knob] != *turn)
        })
    }

    /// Returns the settings to measure next among those that are `affordable`: the cheapest that are expected to reach
    /// the target for less than any did. While none did and none is expected to, returns settings of at most `max_time_ratio`
    /// times the base's time that are expected to come much nearer than any before.
    pub(super) fn next(
        &self,
        max_time_ratio: f64,
        affordable: impl Fn(&Prediction) -> bool,
    ) -> Option<(usize, Prediction)> {
        // Define price and miss of an expectation for the goal
        let price = |expected: &Prediction| match self.goal {
            Goal::Error(_) => expected.time_ratio,
            Goal::TimeRatio(_) => expected.mean_square.sqrt(),
        };
        let miss = |expected: &Prediction, spread: f64| match self.goal {
            Goal::Error(most) => expected.mean_square.sqrt() * spread / most,
            Goal::TimeRatio(most) => expected.time_ratio * spread / most,
        };
        let best = self.best().map(|best| best.trial.price(self.goal));
        let nearest = self.nearest_tried(max_time_ratio).map(|tried| self.miss(tried));
        let mut closest: Option<(f64, usize, Prediction)> = None;
        // Use corrected predictions first, optimistic ones second
        for hopeful in [false, true] {
            if hopeful && best.is_some() && !self.may_explore() {
                continue;
            }
            let mut cheapest: Option<(usize, Prediction)> = None;
            for place in 0..self.offered.len() {
                if self.tried.iter().any(|tried| tried.place == place) {
                    continue;
                }
                // Predict settings that were not measured yet
                let (expected, spread) = self.expected(place, hopeful);
                if !affordable(&expected) {
                    continue;
                }
                let miss = miss(&expected, spread);
                let is_cheaper = cheapest
                    .as_ref()
                    .is_none_or(|(_, least)| price(&expected) < price(least));
                // Keep the cheapest that reaches the target, or the closest one
                if miss <= 1.0
                    && best.is_none_or(|best| price(&expected) < MAX_PRICE_RATIO * best)
                    && is_cheaper
                {
                    cheapest = Some((place, expected));
                } else if best.is_none()
                    && expected.time_ratio <= max_time_ratio
                    && nearest.is_none_or(|nearest| miss < MAX_PRICE_RATIO * nearest)
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

    /// Records the measurement of settings that [`Search::next`] returned.
    pub(super) fn note(&mut self, place: usize, expected: Prediction, trial: Trial) {
        self.tried.push(TrialRecord {
            place,
            expected,
            trial,
            failed: false,
        });
    }

    /// Marks the best settings that reached the target as failed.
    pub(super) fn mark_best_failed(&mut self) {
        if let Some(place) = self.best().map(|best| best.place) {
            let mut tried = self.tried.iter_mut();
            if let Some(tried) = tried.find(|tried| tried.place == place) {
                tried.failed = true;
            }
        }
    }

    /// Returns whether further settings may be measured in the hope that they beat those that reached the target.
    fn may_explore(&self) -> bool {
        let first = self.tried.iter().position(|tried| tried.trial.reaches(self.goal));
        first.is_some_and(|first| self.tried.len() - first <= MAX_EXPLORATION)
    }

    fn best(&self) -> Option<&TrialRecord> {
        let reaching = self
            .tried
            .iter()
            .filter(|tried| tried.trial.reaches(self.goal) && !tried.failed);
        reaching.min_by(|a, b| a.trial.price(self.goal).total_cmp(&b.trial.price(self.goal)))
    }

    /// Returns the expectation for the cheapest settings that reached the target and did not fail later.
    pub(super) fn best_expected(&self) -> Option<Prediction> {
        self.best().map(|best| best.expected.clone())
    }

    fn miss(&self, tried: &TrialRecord) -> f64 {
        let (Goal::Error(most) | Goal::TimeRatio(most)) = self.goal;
        tried.trial.limited(self.goal).high / most
    }

    fn nearest_tried(&self, max_time_ratio: f64) -> Option<&TrialRecord> {
        let max_time_ratio = |tried: &&TrialRecord| tried.trial.time_ratio.value <= max_time_ratio;
        let tried = self.tried.iter().filter(max_time_ratio);
        tried.min_by(|a, b| self.miss(a).total_cmp(&self.miss(b)))
    }

    /// Returns the settings nearest to the target among those of at most `max_time_ratio` times the base's time.
    pub(super) fn nearest(&self, max_time_ratio: f64) -> Option<(Prediction, Trial)> {
        self.nearest_tried(max_time_ratio)
            .map(|tried| (tried.expected.clone(), tried.trial))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::{Configuration, HitPath, Knob, SceneChange};
    use crate::render::RenderSettings;

    /// Families of settings: time per sample, squared error of one sample, and remaining squared error.
    const FAMILIES: [(f64, f64, f64); 4] = [
        (1.0, 4e-2, 0.0),
        (0.5, 4e-2, 3e-5),
        (1.5, 1e-2, 1e-5),
        (0.4, 4e-2, 1e-3),
    ];
    /// Ratios of predicted to true squared errors: some knobs do not combine well.
    const PREDICTED_RATIOS: [f64; 4] = [1.0, 0.3, 1.5, 0.05];

    fn truth(family: usize, spp: u32) -> (f64, f64) {
        let (time, noise, left) = FAMILIES[family];
        (noise / f64::from(spp) + left, time * f64::from(spp))
    }

    fn offered() -> Vec<Prediction> {
        let settings = |spp| RenderSettings {
            spp,
            ..RenderSettings::default()
        };
        let families = 0..FAMILIES.len();
        let all = families.flat_map(|family| {
            (0..11).map(move |power| {
                let spp = 1 << power;
                let (square, time) = truth(family, spp);
                Prediction {
                    configuration: Configuration {
                        settings: settings(spp),
                        path: HitPath::BSP,
                        change: SceneChange::default(),
                        denoises: false,
                    },
                    turns: {
                        let mut turns = [0; Knob::ALL.len()];
                        turns[0] = family as u8;
                        turns
                    },
                    mean_square: PREDICTED_RATIOS[family] * square,
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

    /// Returns error and time of the settings that a search finds, and the number of measurements.
    fn search(goal: Goal) -> (Option<(f64, f64)>, usize) {
        let offered = offered();
        let mut search = Search::new(goal, &offered, &trial(0, 4));
        while let Some((place, expected)) = search.next(f64::INFINITY, |_| true) {
            let measured = trial(
                usize::from(offered[place].turns[0]),
                offered[place].configuration.settings.spp,
            );
            search.note(place, expected, measured);
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
    fn search_corrects_predictions_and_finds_the_best_in_few_measurements() {
        // List the true errors and times of all settings
        let all: Vec<(f64, f64)> = (0..FAMILIES.len())
            .flat_map(|family| (0..11).map(move |power| truth(family, 1 << power)))
            .collect();
        // Search for the least time at a given error
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
        // Search for the least error within a given time
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
    fn unreachable_target_yields_the_nearest_settings() {
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
            search.note(place, expected, measured);
        }
        let (nearest, _) = search.nearest(300.0).unwrap();
        assert!(
            nearest.time_ratio > 100.0 && nearest.time_ratio < 300.0,
            "{nearest:?}"
        );
    }

    #[test]
    fn settings_that_fail_a_second_measurement_are_rejected() {
        let offered = offered();
        let mut search = Search::new(Goal::Error(0.1), &offered, &trial(0, 4));
        while let Some((place, expected)) = search.next(f64::INFINITY, |_| true) {
            let measured = trial(
                usize::from(offered[place].turns[0]),
                offered[place].configuration.settings.spp,
            );
            search.note(place, expected, measured);
        }
        let first = search.best_expected().unwrap();
        search.mark_best_failed();
        assert_ne!(search.best_expected(), Some(first));
    }
}
