//! Whether the next round of adaptive sampling is worth it: the picture's error after it, against that of as many
//! samples shared out evenly.
//!
//! Let v be the estimated squared error of a pixel's mean, a part u of it noise and the rest that of edges; n its samples
//! now and m after the round. The pixels' errors will come to Σ v (u n/m + (1 - u) (n/m)^1.5), as evenly spread samples
//! have it. Were all samples Σ m shared out evenly, each pixel would have their mean number M in the place of m. To
//! either comes the error of what no sample has met yet.

/// The sums of a forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Forecast {
    pixel_count: f64,
    /// Σ m.
    samples: f64,
    /// Σ v.
    squares_now: f64,
    /// Σ v (u n/m + (1 - u) (n/m)^1.5).
    squares: f64,
    /// Σ v u n.
    scaled_noise: f64,
    /// Σ v (1 - u) n^1.5.
    scaled_edges: f64,
}

/// How many times more of the squared error a round must take away than its samples shared out evenly: errors are
/// estimates themselves.
const MIN_ADVANTAGE: f64 = 1.1;

impl Forecast {
    /// Counts a pixel of this squared error, so much of which is noise; it has `count` samples and will have `next`.
    pub(super) fn add(&mut self, square: f64, noise: f64, count: u32, next: u32) {
        let [noise, edges] = [noise * square, (1.0 - noise) * square];
        let [count, next] = [count, next].map(f64::from);
        self.pixel_count += 1.0;
        self.samples += next;
        self.squares_now += square;
        self.squares += noise * count / next + edges * power(count) / power(next);
        self.scaled_noise += noise * count;
        self.scaled_edges += edges * power(count);
    }

    /// Counts the squared error of what pixels with `count` samples missed, which get no more of them.
    pub(super) fn add_missed(&mut self, square: f64, count: u32) {
        self.squares_now += square;
        self.squares += square;
        self.scaled_edges += square * power(count.into());
    }

    /// Counts the pixels of `other` too.
    pub(super) fn merge(&mut self, other: &Forecast) {
        self.pixel_count += other.pixel_count;
        self.samples += other.samples;
        self.squares_now += other.squares_now;
        self.squares += other.squares;
        self.scaled_noise += other.scaled_noise;
        self.scaled_edges += other.scaled_edges;
    }

    /// The least number of samples a pixel, up to `most`, that come to no greater error when shared out evenly.
    pub(super) fn even_count(&self, most: u32) -> u32 {
        // Looked for, as a root were anybody's `pow`.
        let (mut low, mut high) = (1, most);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.evenly(middle.into()) <= self.squares {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        low
    }

    /// The squared error with so many samples for every pixel.
    fn evenly(&self, count: f64) -> f64 {
        self.scaled_noise / count + self.scaled_edges / power(count)
    }

    /// Whether the round does more than its samples, and all earlier ones, shared out evenly.
    pub(super) fn is_worth_it(&self) -> bool {
        let evenly = self.evenly(self.samples / self.pixel_count);
        self.squares_now - self.squares >= MIN_ADVANTAGE * (self.squares_now - evenly)
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
        forecast.add(2.0, 0.0, 16, 64);
        let mut other = Forecast::default();
        other.add(3.0, 0.0, 16, 16);
        other.add_missed(1.0, 16);
        forecast.merge(&other);
        // 16^1.5 = 64, (16/64)^1.5 = 1/8: 2/8 + 3 + 1 against 64 (2 + 3 + 1).
        let expected = Forecast {
            pixel_count: 2.0,
            samples: 80.0,
            squares_now: 6.0,
            squares: 4.25,
            scaled_noise: 0.0,
            scaled_edges: 384.0,
        };
        assert_eq!(forecast, expected);
    }

    #[test]
    fn noise_falls_with_the_number_of_samples_and_edges_faster() {
        let mut forecast = Forecast::default();
        forecast.add(4.0, 0.75, 16, 64);
        // Three over four, and one over eight.
        assert!((forecast.squares - 0.875).abs() < 1e-15);
        assert_eq!(forecast.even_count(1000), 64);
        // All of it noise: a pixel of error 1 at 64 and one of 1 at 16 are as 2 / (1/4 + 1) times 16 for both, 25.6.
        let mut noise = Forecast::default();
        noise.add(1.0, 1.0, 16, 64);
        noise.add(1.0, 1.0, 16, 16);
        assert_eq!(noise.even_count(1000), 26);
        assert_eq!(noise.even_count(20), 20);
    }

    #[test]
    fn a_round_for_the_few_uncertain_pixels_is_worth_it_and_one_for_some_of_many_like_them_is_not() {
        // One pixel of ten is doubled, which takes away 1 - 2^-1.5 = 0.65; a tenth more samples for all take away
        // 1 - 1.1^-1.5 = 0.13 of everything, which is 1 or 10.
        let forecast = |certain: f64| {
            let mut forecast = Forecast::default();
            forecast.add(1.0, 0.0, 16, 32);
            (0..9).for_each(|_| forecast.add(certain, 0.0, 16, 16));
            forecast
        };
        assert!(forecast(0.0).is_worth_it());
        assert!(!forecast(1.0).is_worth_it());
    }

    #[test]
    fn a_round_that_leaves_out_where_most_was_missed_is_not_worth_it() {
        let mut forecast = Forecast::default();
        forecast.add(1.0, 0.0, 16, 32);
        forecast.add(0.0, 0.0, 16, 16);
        // It takes away 0.65, against 1 - 1.5^-1.5 = 0.46; with 1 missed that is 0.91.
        assert!(forecast.is_worth_it());
        forecast.add_missed(1.0, 16);
        assert!(!forecast.is_worth_it());
    }
}
