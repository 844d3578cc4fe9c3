//! Ablation study: change of time and image without each effect and at each depth (`whit info --prices`).

use std::fmt;

use serde::Serialize;

use crate::accel::Backend;
use crate::image::metrics::Metrics;
use crate::scene::Effect;

use super::bench::Spread;
use crate::report::format::percent;

/// Costs of effects in a scene, measured on a few tiles of its image.
#[derive(Clone, Debug, Serialize)]
pub struct AblationStudy {
    /// Width of the complete image in pixels.
    pub width: u32,
    /// Height of the complete image in pixels.
    pub height: u32,
    /// Number of samples per pixel.
    pub spp: u32,
    /// Maximum depth of reflected and refracted rays.
    pub depth: u32,
    /// Depth after which no ray of the sample remained; null where the search did not find it.
    pub depth_reached: Option<u32>,
    /// Name of the camera.
    pub camera: String,
    /// Intersection backend that found the hits.
    pub backend: Backend,
    /// Number of threads that rendered.
    pub threads: usize,
    /// Number of tiles that were rendered.
    pub tiles: usize,
    /// Number of tiles of the complete image.
    pub tiles_in_all: usize,
    /// Number of timed renders of each variant, in alternation.
    pub runs: usize,
    /// Estimated seconds for the complete image on all threads, if each has a processor of its own.
    pub seconds_forecast: f64,
    /// Relative variation of the unchanged image's own times.
    pub noise: f64,
    /// Changes with their effects on time and image, the most expensive first; changes within the noise are last.
    pub list: Vec<Ablation>,
}

/// Change of time and image when one thing is left out.
#[derive(Clone, Debug, Serialize)]
pub struct Ablation {
    /// Effect that is left out; null for a step of depth.
    pub without: Option<Effect>,
    /// Effects that are implied, as they have no influence without it.
    pub takes_along: Vec<Effect>,
    /// Maximum depth in place of the image's; null for an effect.
    pub depth: Option<u32>,
    /// Change of the render time.
    pub time: TimeChange,
    /// True if any bit of the sample changes.
    pub changes_picture: bool,
    /// Error metrics of the changed image against the complete one, over the sample.
    pub picture: Metrics,
}

/// Relative change of a time: -0.38 for 38 % less.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TimeChange {
    /// Median change over the runs.
    pub median: f64,
    /// Lower end of the interval that contains the true median with a probability of at least 15/16.
    pub low: f64,
    /// Upper end of the interval that contains the true median with a probability of at least 15/16.
    pub high: f64,
    /// True if the change may be zero.
    pub within_noise: bool,
    /// Largest change up or down that is possible if the change is within the noise.
    pub noise: f64,
}

/// Smallest number of runs that bounds a median: all of five lie on one side of it with probability 1/16.
pub const MIN_RUNS: usize = 5;

impl TimeChange {
    /// Returns the change that `runs` show, each relative to the time of its own run; `noise` is the variation without
    /// a change.
    ///
    /// Each run lies above or below the true median with equal probability under any distribution; the k-th lowest and
    /// k-th highest therefore lie on one side of it with the tail probability of a binomial distribution.
    pub fn of(runs: &[f64], noise: f64) -> TimeChange {
        let mut sorted = runs.to_vec();
        sorted.sort_by(f64::total_cmp);
        // Bound the median by order statistics
        let outside = ranks_outside(sorted.len());
        let end = |index: Option<usize>| index.and_then(|i| sorted.get(i)).copied().unwrap_or(0.0);
        let (low, high) = (end(Some(outside)), end(sorted.len().checked_sub(outside + 1)));
        let median = Spread::of(runs).median;
        // The change is noise if the interval contains zero, or if it is no larger than the noise
        let within_noise = low <= 0.0 && high >= 0.0 || median.abs() <= noise;
        TimeChange {
            median,
            low,
            high,
            within_noise,
            noise: noise.max(low.abs()).max(high.abs()),
        }
    }
}

/// Returns the number of lowest, and of highest, sorted runs that lie outside the median's interval, for `count` runs.
fn ranks_outside(count: usize) -> usize {
    const MISS: f64 = 1.0 / 16.0;
    let mut tail = 0.0;
    // Add binomial weights until both tails exceed the permitted probability
    let mut exactly = 0.5f64.powi(count as i32);
    for rank in 0..count / 2 {
        tail += exactly;
        exactly *= (count - rank) as f64 / (rank + 1) as f64;
        // One more rank outside would increase the tail by `exactly`.
        if 2.0 * (tail + exactly) > MISS {
            return rank;
        }
    }
    0
}

impl Ablation {
    /// Returns the estimated fraction of the time that goes into the effect; `None` within the noise.
    pub fn share(&self) -> Option<f64> {
        (!self.time.within_noise).then_some((-self.time.median).max(0.0))
    }
}

impl AblationStudy {
    /// Returns the cost of an effect, if it was left out in the study.
    pub fn of_effect(&self, effect: Effect) -> Option<&Ablation> {
        self.list.iter().find(|price| price.without == Some(effect))
    }

    /// Sorts by cost in descending order, with changes within the noise last; the sort is stable.
    pub fn sort(&mut self) {
        let key = |price: &Ablation| match price.time.within_noise {
            true => f64::INFINITY,
            false => price.time.median,
        };
        self.list.sort_by(|a, b| key(a).total_cmp(&key(b)));
    }

    /// Returns the text that the plan's line of an effect appends about its time.
    pub fn note(&self, effect: Effect) -> String {
        let Some(price) = self.of_effect(effect) else {
            return String::new();
        };
        match price.share() {
            None => format!(" (time within the noise of ±{})", percent(price.time.noise)),
            Some(0.0) => format!(" (saves about {} of the time)", percent(price.time.median)),
            Some(share) => format!(" (about {} of the time)", percent(share)),
        }
    }
}

/// Formats a percentage with its sign.
fn signed(part: f64) -> String {
    let sign = if part < 0.0 { '-' } else { '+' };
    format!("{sign}{}", percent(part))
}

impl fmt::Display for TimeChange {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.within_noise {
            return write!(f, "time within the noise of ±{}", percent(self.noise));
        }
        let (median, low, high) = (signed(self.median), signed(self.low), signed(self.high));
        write!(f, "{median} time ({low} to {high})")
    }
}

impl fmt::Display for Ablation {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match (self.without, self.depth) {
            (Some(effect), _) => write!(f, "{effect}: without it")?,
            (None, depth) => write!(f, "depth: with {}", depth.unwrap_or_default())?,
        }
        if !self.takes_along.is_empty() {
            let names: Vec<&str> = self.takes_along.iter().map(|effect| effect.name()).collect();
            write!(f, " and so without {}", names.join(", "))?;
        }
        write!(f, ": {}, ", self.time)?;
        if !self.changes_picture {
            return write!(f, "no pixel changes");
        }
        let Metrics {
            changed_share, flip, ..
        } = self.picture;
        write!(f, "{} of pixels change, FLIP {flip:.3}", percent(changed_share))
    }
}

/// Text form with a line for the measurement and one for each cost.
impl fmt::Display for AblationStudy {
    // Print the conditions of the measurement
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:<15}by {} of {} tiles of {}x{} pixels, {} samples each, rendered {} times in turn; {}, {} threads; the whole \
             image takes about {:.2} s",
            "prices",
            self.tiles,
            self.tiles_in_all,
            self.width,
            self.height,
            self.spp,
            self.runs,
            self.backend,
            self.threads,
            self.seconds_forecast
        )?;
        // Print the cost of each effect and depth
        self.list
            .iter()
            .try_for_each(|price| writeln!(f, "{:<15}{price}", "price"))?;
        match self.depth_reached.filter(|&reached| reached < self.depth) {
            Some(reached) => writeln!(
                f,
                "{:<15}depth: no sampled ray remains after {reached} steps; from {reached} to {} they cost nothing",
                "price", self.depth
            ),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::metrics::Tally;

    #[test]
    fn interval_of_the_median_excludes_ranks_by_the_binomial() {
        // The tail is 2 · 2^-5 = 1/16 for all of five runs, 2 · 2^-8 (1 + 8) = 0.0703 for all but one of eight, and 2 ·
        // 2^-9 (1 + 9) = 0.039 for nine.
        let outside: Vec<usize> = [1, 5, 8, 9, 12].map(ranks_outside).to_vec();
        assert_eq!(outside, [0, 0, 0, 1, 2]);
    }

    #[test]
    fn change_is_noise_unless_all_runs_agree() {
        let clear = TimeChange::of(&[-0.4, -0.3, -0.35, -0.9, -0.38], 0.02);
        assert_eq!((clear.median, clear.low, clear.high), (-0.38, -0.9, -0.3));
        assert!(!clear.within_noise);
        let torn = TimeChange::of(&[-0.01, 0.02, 0.01, -0.02, 0.03], 0.01);
        assert!(torn.within_noise);
        assert_eq!(torn.to_string(), "time within the noise of ±3.0 %");
        // The change is as small as the variation of the image itself.
        assert!(TimeChange::of(&[-0.01; 5], 0.02).within_noise);
        assert!(TimeChange::of(&[], 0.0).within_noise);
    }

    fn price(without: Effect, runs: &[f64]) -> Ablation {
        Ablation {
            without: Some(without),
            takes_along: vec![],
            depth: None,
            time: TimeChange::of(runs, 0.0),
            changes_picture: false,
            picture: Tally::default().metrics(),
        }
    }

    #[test]
    fn line_shows_the_change_of_time_and_image() {
        let mut price = price(Effect::Refraction, &[-0.38; 5]);
        assert_eq!(
            price.to_string(),
            "refraction: without it: -38 % time (-38 % to -38 %), no pixel changes"
        );
        price.takes_along = vec![Effect::Dispersion, Effect::Absorption];
        price.changes_picture = true;
        price.picture.changed_share = 0.12;
        price.picture.flip = 0.0412;
        assert_eq!(
            price.to_string(),
            "refraction: without it and so without dispersion, absorption: -38 % time (-38 % to -38 %), 12 % of pixels \
             change, FLIP 0.041"
        );
    }

    #[test]
    fn percentages_have_at_most_two_digits() {
        let words = [0.0, 1e-6, 0.0005, 0.0123, 0.0949, 0.0951, 0.5].map(percent);
        assert_eq!(
            words,
            ["0 %", "<0.01 %", "0.05 %", "1.2 %", "9.5 %", "10 %", "50 %"]
        );
    }
}
