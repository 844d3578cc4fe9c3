//! What each effect and each step of depth costs, and what the picture lacks without it: `whit info --prices`.

use std::fmt;

use serde::Serialize;

use crate::accel::Backend;
use crate::image::metrics::Metrics;
use crate::scene::Effect;

use super::bench::Spread;
use super::words::percent;

/// What things cost in a scene, by a few tiles of its picture.
#[derive(Clone, Debug, Serialize)]
pub struct PriceList {
    /// Pixels a row of the whole picture.
    pub width: u32,
    /// Its rows.
    pub height: u32,
    /// Samples a pixel.
    pub spp: u32,
    /// Steps that rays are followed at most.
    pub depth: u32,
    /// Steps after which no ray of the sample was left, where the search for it found them.
    pub depth_reached: Option<u32>,
    /// Through which the scene is seen.
    pub camera: String,
    /// What found the hits.
    pub backend: Backend,
    /// Threads that rendered.
    pub threads: usize,
    /// Tiles that were rendered.
    pub tiles: usize,
    /// Tiles of the whole picture.
    pub tiles_in_all: usize,
    /// Times that each picture was rendered for its time, all in turn.
    pub runs: usize,
    /// Seconds that the whole picture is expected to take on all threads, if they have a processor each.
    pub seconds_forecast: f64,
    /// By this part the times of the picture itself were off from each other.
    pub noise: f64,
    /// What was changed and what that changes, the dearest first; what is within the noise last.
    pub list: Vec<Price>,
}

/// What becomes of time and picture if one thing is left out.
#[derive(Clone, Debug, Serialize)]
pub struct Price {
    /// The effect that is left out; null for a step of depth.
    pub without: Option<Effect>,
    /// Effects that it takes along, as they do nothing without it.
    pub takes_along: Vec<Effect>,
    /// The depth in place of the picture's; null for an effect.
    pub depth: Option<u32>,
    /// How the time changes.
    pub time: TimeChange,
    /// Whether any bit of the sample changes.
    pub changes_picture: bool,
    /// How far the picture is from the whole one, over the sample.
    pub picture: Metrics,
}

/// The change of a time as a part of it: -0.38 for 38 % less.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TimeChange {
    /// The median over the runs.
    pub median: f64,
    /// The median of endless runs is between this
    pub low: f64,
    /// and this, with a probability of 15/16 at least.
    pub high: f64,
    /// Whether it may as well be none.
    pub within_noise: bool,
    /// If so, how large it may be, up or down.
    pub noise: f64,
}

/// Least runs that tell where a median lies: all of five are on one side of it once in sixteen times.
pub const MIN_RUNS: usize = 5;

impl TimeChange {
    /// The change that `runs` show, each as a part of the time of its own run; `noise` is that of no change.
    ///
    /// Each run is above or below the true median by even chances, whatever the times are distributed like; so the k-th
    /// lowest and the k-th highest are on one side of it by the tail of a binomial distribution.
    pub fn of(runs: &[f64], noise: f64) -> TimeChange {
        let mut sorted = runs.to_vec();
        sorted.sort_by(f64::total_cmp);
        let outside = ranks_outside(sorted.len());
        let end = |index: Option<usize>| index.and_then(|i| sorted.get(i)).copied().unwrap_or(0.0);
        let (low, high) = (end(Some(outside)), end(sorted.len().checked_sub(outside + 1)));
        let median = Spread::of(runs).median;
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

/// How many of the lowest of `count` sorted runs, and of the highest, may be left out of the range of the median.
fn ranks_outside(count: usize) -> usize {
    const MISS: f64 = 1.0 / 16.0;
    let mut tail = 0.0;
    let mut exactly = 0.5f64.powi(count as i32);
    for rank in 0..count / 2 {
        tail += exactly;
        exactly *= (count - rank) as f64 / (rank + 1) as f64;
        // With another rank outside, the tail grows by `exactly`.
        if 2.0 * (tail + exactly) > MISS {
            return rank;
        }
    }
    0
}

impl Price {
    /// Forecast of the part of the time that goes into it; `None` within the noise.
    pub fn share(&self) -> Option<f64> {
        (!self.time.within_noise).then_some((-self.time.median).max(0.0))
    }
}

impl PriceList {
    /// What an effect costs, where it was left out.
    pub fn of_effect(&self, effect: Effect) -> Option<&Price> {
        self.list.iter().find(|price| price.without == Some(effect))
    }

    /// Puts the dearest first and what is within the noise last; equal ones stay as they are.
    pub fn sort(&mut self) {
        let key = |price: &Price| match price.time.within_noise {
            true => f64::INFINITY,
            false => price.time.median,
        };
        self.list.sort_by(|a, b| key(a).total_cmp(&key(b)));
    }

    /// What the plan's line of an effect says of its time.
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

/// With its sign.
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

impl fmt::Display for Price {
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

/// A line for the measurement and one for each price.
impl fmt::Display for PriceList {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{:<15}by {} of {} tiles of {}x{} pixels, {} samples each, rendered {} times in turn; {}, {} threads; the whole \
             picture takes about {:.2} s",
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
        self.list
            .iter()
            .try_for_each(|price| writeln!(f, "{:<15}{price}", "price"))?;
        match self.depth_reached.filter(|&reached| reached < self.depth) {
            Some(reached) => writeln!(
                f,
                "{:<15}depth: no ray of the sample is left after {reached} steps; from {reached} to {} they cost nothing",
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
    fn the_range_of_a_median_leaves_out_as_many_runs_as_the_binomial_allows() {
        // 2 · 2^-5 = 1/16 for all of five; 2 · 2^-8 (1 + 8) = 0.0703 for all but one of eight, 2 · 2^-9 (1 + 9) = 0.039
        // of nine.
        let outside: Vec<usize> = [1, 5, 8, 9, 12].map(ranks_outside).to_vec();
        assert_eq!(outside, [0, 0, 0, 1, 2]);
    }

    #[test]
    fn a_change_that_all_runs_agree_on_is_told_and_others_are_noise() {
        let clear = TimeChange::of(&[-0.4, -0.3, -0.35, -0.9, -0.38], 0.02);
        assert_eq!((clear.median, clear.low, clear.high), (-0.38, -0.9, -0.3));
        assert!(!clear.within_noise);
        let torn = TimeChange::of(&[-0.01, 0.02, 0.01, -0.02, 0.03], 0.01);
        assert!(torn.within_noise);
        assert_eq!(torn.to_string(), "time within the noise of ±3.0 %");
        // As small as what the picture itself shows.
        assert!(TimeChange::of(&[-0.01; 5], 0.02).within_noise);
        assert!(TimeChange::of(&[], 0.0).within_noise);
    }

    fn price(without: Effect, runs: &[f64]) -> Price {
        Price {
            without: Some(without),
            takes_along: vec![],
            depth: None,
            time: TimeChange::of(runs, 0.0),
            changes_picture: false,
            picture: Tally::default().metrics(),
        }
    }

    #[test]
    fn a_line_says_what_time_and_picture_lose() {
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
    fn shares_are_digits_that_a_person_reads() {
        let words = [0.0, 1e-6, 0.0005, 0.0123, 0.0949, 0.0951, 0.5].map(percent);
        assert_eq!(
            words,
            ["0 %", "<0.01 %", "0.05 %", "1.2 %", "9.5 %", "10 %", "50 %"]
        );
    }
}
