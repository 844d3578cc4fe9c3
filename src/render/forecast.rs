//! Whether the next round of adaptive sampling is worth it: the picture's error after it, against that of as many
//! samples shared out evenly.
//!
//! Let v be the estimated squared error of a pixel's mean, n its samples now and m after the round. The pixels' errors
//! will come to Σ v (n/m)^1.5, as evenly spread samples have it. Were all samples Σ m shared out evenly, M to each
//! pixel, they would come to Σ v (n/M)^1.5. To either comes the error of what no sample has met yet.

/// The sums of a forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Forecast {
    pixel_count: f64,
    /// Σ m.
    samples: f64,
    /// Σ v.
    squares_now: f64,
    /// Σ v (n/m)^1.5.
    squares: f64,
    /// Σ v n^1.5.
    scaled_squares: f64,
}

/// How many times more of the squared error a round must take away than its samples shared out evenly: errors are
/// estimates themselves.
const LEAST_ADVANTAGE: f64 = 1.1;

impl Forecast {
    /// Counts a pixel of this squared error, which has `count` samples and will have `next`.
    pub(super) fn add(&mut self, square: f64, count: u32, next: u32) {
        self.pixel_count += 1.0;
        self.samples += f64::from(next);
        self.squares_now += square;
        self.squares += square * power(count.into()) / power(next.into());
        self.scaled_squares += square * power(count.into());
    }

    /// Counts the squared error of what pixels with `count` samples missed, which get no more of them.
    pub(super) fn add_missed(&mut self, square: f64, count: u32) {
        self.squares_now += square;
        self.squares += square;
        self.scaled_squares += square * power(count.into());
    }

    /// Counts the pixels of `other` too.
    pub(super) fn merge(&mut self, other: &Forecast) {
        self.pixel_count += other.pixel_count;
        self.samples += other.samples;
        self.squares_now += other.squares_now;
        self.squares += other.squares;
        self.scaled_squares += other.scaled_squares;
    }

    /// The least number of samples a pixel, up to `most`, that come to no greater error when shared out evenly.
    pub(super) fn even_count(&self, most: u32) -> u32 {
        // Looked for by n^1.5, as a root of it would be anybody's `pow`.
        let (mut low, mut high) = (0, most);
        while low < high {
            let middle = low + (high - low) / 2;
            if power(middle.into()) * self.squares >= self.scaled_squares {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        low
    }

    /// Whether the round does more than its samples, and all earlier ones, shared out evenly.
    pub(super) fn is_worth_it(&self) -> bool {
        let evenly = self.scaled_squares / power(self.samples / self.pixel_count);
        self.squares_now - self.squares >= LEAST_ADVANTAGE * (self.squares_now - evenly)
    }
}

/// n^1.5, by roots that are rounded alike on every machine.
fn power(count: f64) -> f64 {
    count * count.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_the_power_law() {
        let mut forecast = Forecast::default();
        forecast.add(2.0, 16, 64);
        let mut other = Forecast::default();
        other.add(3.0, 16, 16);
        other.add_missed(1.0, 16);
        forecast.merge(&other);
        // 16^1.5 = 64, (16/64)^1.5 = 1/8: 2/8 + 3 + 1 against 64 (2 + 3 + 1).
        let expected = Forecast {
            pixel_count: 2.0,
            samples: 80.0,
            squares_now: 6.0,
            squares: 4.25,
            scaled_squares: 384.0,
        };
        assert_eq!(forecast, expected);
    }

    #[test]
    fn a_round_for_the_few_uncertain_pixels_is_worth_it_and_one_for_some_of_many_like_them_is_not() {
        // One pixel of ten is doubled, which takes away 1 - 2^-1.5 = 0.65; a tenth more samples for all take away
        // 1 - 1.1^-1.5 = 0.13 of everything, which is 1 or 10.
        let forecast = |certain: f64| {
            let mut forecast = Forecast::default();
            forecast.add(1.0, 16, 32);
            (0..9).for_each(|_| forecast.add(certain, 16, 16));
            forecast
        };
        assert!(forecast(0.0).is_worth_it());
        assert!(!forecast(1.0).is_worth_it());
    }

    #[test]
    fn a_round_that_leaves_out_where_most_was_missed_is_not_worth_it() {
        let mut forecast = Forecast::default();
        forecast.add(1.0, 16, 32);
        forecast.add(0.0, 16, 16);
        // It takes away 0.65, against 1 - 1.5^-1.5 = 0.46; with 1 missed that is 0.91.
        assert!(forecast.is_worth_it());
        forecast.add_missed(1.0, 16);
        assert!(!forecast.is_worth_it());
    }
}
