//! Forecast of the error after the next round of adaptive sampling, compared with the same number of samples
//! distributed uniformly.
//!
//! Let v be the estimated squared error of a pixel's mean, a fraction u of it noise and the rest due to edges; n the
//! number of its samples now and m that after the round. The errors of the pixels are then expected to be
//! Σ v (u n/m + (1 - u) (n/m)^1.5), as for stratified samples. If all Σ m samples were distributed uniformly, each
//! pixel would have their mean number M instead of m. Both sums are increased by the error of features that no sample
//! has hit yet.

/// Sums over the pixels of a forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PassForecast {
    pixel_count: f64,
    /// Number of samples after the round, Σ m.
    samples: f64,
    /// Squared error before the round, Σ v.
    squares_now: f64,
    /// Squared error after the round, Σ v (u n/m + (1 - u) (n/m)^1.5).
    squares: f64,
    /// Noise part scaled by samples, Σ v u n.
    scaled_noise: f64,
    /// Edge part scaled by samples, Σ v (1 - u) n^1.5.
    scaled_edges: f64,
}

/// Smallest factor by which a round must reduce the squared error more than its samples distributed uniformly,
/// because the errors are estimates themselves.
const MIN_ADVANTAGE: f64 = 1.1;

impl PassForecast {
    /// Adds a pixel with a squared error, of which the fraction `noise` is noise; it has `count` samples and will
    /// have `next`.
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

    /// Adds the squared error of features missed by pixels with `count` samples, which get no more samples.
    pub(super) fn add_missed(&mut self, square: f64, count: u32) {
        self.squares_now += square;
        self.squares += square;
        self.scaled_edges += square * power(count.into());
    }

    /// Adds the pixels of `other`.
    pub(super) fn merge(&mut self, other: &PassForecast) {
        self.pixel_count += other.pixel_count;
        self.samples += other.samples;
        self.squares_now += other.squares_now;
        self.squares += other.squares;
        self.scaled_noise += other.scaled_noise;
        self.scaled_edges += other.scaled_edges;
    }

    /// Returns the smallest number of samples per pixel, up to `limit`, whose error is not larger when they are
    /// distributed uniformly.
    pub(super) fn even_count(&self, limit: u32) -> u32 {
        // Bisection instead of a root, which would depend on the implementation of `pow`.
        let (mut low, mut high) = (1, limit);
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

    /// Returns the squared error with `count` samples for every pixel.
    fn evenly(&self, count: f64) -> f64 {
        self.scaled_noise / count + self.scaled_edges / power(count)
    }

    /// Returns whether the round reduces the error more than its samples and all earlier ones distributed uniformly.
    pub(super) fn is_worth_it(&self) -> bool {
        let evenly = self.evenly(self.samples / self.pixel_count);
        self.squares_now - self.squares >= MIN_ADVANTAGE * (self.squares_now - evenly)
    }
}

/// Returns n^1.5 from a square root, which is rounded identically on every machine.
fn power(count: f64) -> f64 {
    count * count.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_equal_the_power_law() {
        let mut forecast = PassForecast::default();
        forecast.add(2.0, 0.0, 16, 64);
        let mut other = PassForecast::default();
        other.add(3.0, 0.0, 16, 16);
        other.add_missed(1.0, 16);
        forecast.merge(&other);
        // 16^1.5 = 64, (16/64)^1.5 = 1/8: 2/8 + 3 + 1 against 64 (2 + 3 + 1).
        let expected = PassForecast {
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
        let mut forecast = PassForecast::default();
        forecast.add(4.0, 0.75, 16, 64);
        // The noise 3 is divided by four, the edges 1 by eight.
        assert!((forecast.squares - 0.875).abs() < 1e-15);
        assert_eq!(forecast.even_count(1000), 64);
        // All of it noise: a pixel with error 1 at 64 samples and one with error 1 at 16 need 2 / (1/4 + 1) times 16
        // each, 25.6.
        let mut noise = PassForecast::default();
        noise.add(1.0, 1.0, 16, 64);
        noise.add(1.0, 1.0, 16, 16);
        assert_eq!(noise.even_count(1000), 26);
        assert_eq!(noise.even_count(20), 20);
    }

    #[test]
    fn round_pays_for_few_uncertain_pixels_only() {
        // One of ten pixels is doubled, which removes 1 - 2^-1.5 = 0.65; a tenth more samples for all removes 1 -
        // 1.1^-1.5 = 0.13 of the total, which is 1 or 10.
        let forecast = |certain: f64| {
            let mut forecast = PassForecast::default();
            forecast.add(1.0, 0.0, 16, 32);
            (0..9).for_each(|_| forecast.add(certain, 0.0, 16, 16));
            forecast
        };
        assert!(forecast(0.0).is_worth_it());
        assert!(!forecast(1.0).is_worth_it());
    }

    #[test]
    fn round_without_the_worst_pixels_does_not_pay() {
        let mut forecast = PassForecast::default();
        forecast.add(1.0, 0.0, 16, 32);
        forecast.add(0.0, 0.0, 16, 16);
        // It removes 0.65, against 1 - 1.5^-1.5 = 0.46; with a missed error of 1 that is 0.91.
        assert!(forecast.is_worth_it());
        forecast.add_missed(1.0, 16);
        assert!(!forecast.is_worth_it());
    }
}
