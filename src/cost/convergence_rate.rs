//! Convergence rate: slope of a least-squares line through errors over times on logarithmic axes.

use super::Interval;
use super::error::NORMAL;
use crate::measure::bootstrap;

/// Seed of the resampled blocks.
const SEED: u64 = 11;

/// Returns the slope of the least-squares line through the logarithms of errors over those of times, with its 95 %
/// interval. `None` for fewer than three points with positive finite values, or for a single time.
///
/// Each point has its time and the squared error of every block of pixels. The interval is resampled over the blocks,
/// which all points share, so that what makes a block hard for all of them cancels; the intervals of the times add to
/// it. That the errors may not follow a power of the time is not part of it.
pub fn slope(points: &[(Interval, &[f64])]) -> Option<Interval> {
    // Take the points with positive, finite values
    let is_positive = |x: f64| x > 0.0 && x.is_finite();
    let usable: Vec<(Interval, &[f64])> = points
        .iter()
        .copied()
        .filter(|(time, squares)| is_positive(time.value) && is_positive(squares.iter().sum()))
        .collect();
    if usable.len() < 3 {
        return None;
    }
    let count = usable.len() as f64;
    let mean = usable.iter().map(|(time, _)| time.value.ln()).sum::<f64>() / count;
    let offsets: Vec<f64> = usable.iter().map(|(time, _)| time.value.ln() - mean).collect();
    let spread: f64 = offsets.iter().map(|x| x * x).sum();
    if spread == 0.0 {
        return None;
    }
    // Fit the line by least squares, to all blocks and to resampled ones
    let slope_of = |chosen: &[usize]| {
        let log_error = |squares: &[f64]| {
            let square: f64 = chosen.iter().map(|&block| squares[block]).sum();
            0.5 * square.max(f64::MIN_POSITIVE).ln()
        };
        let products = usable.iter().zip(&offsets);
        products
            .map(|((_, squares), x)| x * log_error(squares))
            .sum::<f64>()
            / spread
    };
    let found = bootstrap(usable[0].1.len(), SEED, slope_of);
    // Add the uncertainty of the times
    let squares = usable.iter().zip(&offsets).map(|((time, _), x)| {
        let deviation = 0.5 * (time.high / time.low).ln() / NORMAL;
        (found.value * x / spread * deviation).powi(2)
    });
    let by_times = NORMAL * squares.sum::<f64>().sqrt();
    Some(Interval {
        value: found.value,
        low: found.value - (found.value - found.low).hypot(by_times),
        high: found.value + (found.high - found.value).hypot(by_times),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// Returns the slope through points at these times, each with the squares of its blocks.
    fn slope_at(times: &[f64], squares: &[Vec<f64>]) -> Option<Interval> {
        let points: Vec<(Interval, &[f64])> = times
            .iter()
            .zip(squares)
            .map(|(&time, squares)| (Interval::exact(time), &squares[..]))
            .collect();
        slope(&points)
    }

    #[test]
    fn slope_of_a_power_is_its_exponent() {
        let times: Vec<f64> = (1..6).map(f64::from).collect();
        let squares: Vec<Vec<f64>> = times
            .iter()
            .map(|time| (1..9).map(|block| f64::from(block) * time.powf(-1.5)).collect())
            .collect();
        let found = slope_at(&times, &squares).unwrap();
        assert!(
            (found.value + 0.75).abs() < 1e-12 && found.high - found.low < 1e-9,
            "{found:?}"
        );
        assert_eq!(slope_at(&times[..2], &squares), None);
        assert_eq!(slope_at(&[1.0; 3], &squares), None);
    }

    #[test]
    fn uncertain_times_widen_the_interval() {
        let squares = [1.0, 0.25, 0.0625].map(|square| vec![square; 9]);
        let times = [1.0, 2.0, 4.0].map(|value| Interval {
            value,
            low: value / 1.1,
            high: value * 1.1,
        });
        let points: Vec<(Interval, &[f64])> =
            times.into_iter().zip(squares.iter().map(Vec::as_slice)).collect();
        let found = slope(&points).unwrap();
        // The slope is that of the outer points, whose distance ln 4 is uncertain by the root of two of ln 1.1
        let width = 2f64.sqrt() * 1.1f64.ln() / 4f64.ln();
        assert!((found.value + 1.0).abs() < 1e-12);
        assert!(
            (found.high - found.value - width).abs() < 1e-9,
            "{found:?}, {width}"
        );
    }

    #[test]
    fn interval_contains_the_exponent_in_95_percent() {
        let times: Vec<f64> = (0..5).map(|i| 2f64.powi(i)).collect();
        let held = (0..400)
            .filter(|&seed| {
                let mut random = SplitMix64::new(10, seed);
                // Blocks differ by two orders of magnitude, alike at all times, and by noise of their own
                let hardness: Vec<f64> = (0..60).map(|_| (5.0 * random.unit()).exp()).collect();
                let squares: Vec<Vec<f64>> = times
                    .iter()
                    .map(|time| {
                        hardness
                            .iter()
                            .map(|h| h / time * (0.5 + random.unit()))
                            .collect()
                    })
                    .collect();
                slope_at(&times, &squares).unwrap().holds(-0.5)
            })
            .count();
        assert!((365..=395).contains(&held), "{held} of 400");
    }
}
