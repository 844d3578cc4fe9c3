//! Sample statistics of a pixel: mean, variance, noise and extremes.

/// Rec. 709 luminance weights of linear RGB.
pub(in crate::render) const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Number of successive samples whose means are compared, as long as all samples come from a single round.
pub(in crate::render) const RUN: u32 = 4;

/// Sums over the samples of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::render) struct PixelStatistics {
    /// Sum of radiance, linear RGB.
    pub(in crate::render) sum: [f64; 3],
    /// Sum of squared radiance, channels weighted by luminance.
    squares: f64,
    /// Sum of squared sums of [`RUN`] successive samples, channels weighted by luminance.
    squares_of_runs: f64,
    /// Variance between the two halves that were merged last.
    halves: Halves,
    /// Smallest and largest luminance of a sample.
    pub(in crate::render) extremes: [f32; 2],
    /// Number of samples in the sums.
    pub(in crate::render) count: u32,
}

/// Comparison of two estimates with equal numbers of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Halves {
    /// Variance of the means of the halves, channels weighted by luminance.
    variance: f64,
    /// Number of samples in one half; 0 if no halves were merged.
    count: u32,
}

impl PixelStatistics {
    pub(in crate::render) const NONE: PixelStatistics = PixelStatistics {
        sum: [0.0; 3],
        squares: 0.0,
        squares_of_runs: 0.0,
        halves: Halves {
            variance: 0.0,
            count: 0,
        },
        extremes: [f32::INFINITY, f32::NEG_INFINITY],
        count: 0,
    };

    /// Returns an estimate that has only the sums of `count` samples and of their squares.
    pub(in crate::render) fn of_sums(sum: [f64; 3], squares: f64, count: u32) -> PixelStatistics {
        PixelStatistics {
            sum,
            squares,
            count,
            ..PixelStatistics::NONE
        }
    }

    /// Returns the bits of the estimate, for checkpoints.
    pub(in crate::render) fn to_words(self) -> [u32; 16] {
        let [red, green, blue] = self.sum;
        let doubles = [
            red,
            green,
            blue,
            self.squares,
            self.squares_of_runs,
            self.halves.variance,
        ];
        let mut words = [0; 16];
        for (pair, double) in words.chunks_exact_mut(2).zip(doubles) {
            let bits = double.to_bits();
            pair.copy_from_slice(&[(bits >> 32) as u32, bits as u32]);
        }
        let [darkest, brightest] = self.extremes.map(f32::to_bits);
        words[12..].copy_from_slice(&[self.halves.count, darkest, brightest, self.count]);
        words
    }

    /// Returns the estimate with these bits, as made by [`PixelStatistics::to_words`].
    pub(in crate::render) fn of_words(words: [u32; 16]) -> PixelStatistics {
        let double =
            |place: usize| f64::from_bits(u64::from(words[place]) << 32 | u64::from(words[place + 1]));
        PixelStatistics {
            sum: [0, 2, 4].map(double),
            squares: double(6),
            squares_of_runs: double(8),
            halves: Halves {
                variance: double(10),
                count: words[12],
            },
            extremes: [13, 14].map(|place| f32::from_bits(words[place])),
            count: words[15],
        }
    }

    /// Returns the sum of squared radiance of the samples, channels weighted by luminance.
    pub(in crate::render) fn squares(&self) -> f64 {
        self.squares
    }

    /// Adds one sample to the sums.
    #[inline(always)]
    pub(in crate::render) fn add(&mut self, radiance: [f64; 3]) {
        let mut luminance = 0.0;
        for channel in 0..3 {
            let value = radiance[channel];
            self.sum[channel] += value;
            luminance += LUMINANCE[channel] * value;
            self.squares += LUMINANCE[channel] * value * value;
        }
        self.extremes[0] = self.extremes[0].min(luminance as f32);
        self.extremes[1] = self.extremes[1].max(luminance as f32);
        self.count += 1;
    }

    /// Adds the sum of [`RUN`] successive samples, which have been added already.
    #[inline(always)]
    pub(in crate::render) fn note_run(&mut self, sum: [f64; 3]) {
        for channel in 0..3 {
            self.squares_of_runs += LUMINANCE[channel] * sum[channel] * sum[channel];
        }
    }

    /// Adds the samples of `other`, which were taken later.
    pub(in crate::render) fn merge(&mut self, other: &PixelStatistics) {
        if self.count == other.count && self.count > 0 {
            let [mean, other_mean] = [self.mean(), other.mean()];
            // The variance of two values is half of their squared difference.
            let part = |c: usize| 0.5 * LUMINANCE[c] * (mean[c] - other_mean[c]).powi(2);
            self.halves = Halves {
                variance: (0..3).map(part).sum(),
                count: self.count,
            };
        }
        for channel in 0..3 {
            self.sum[channel] += other.sum[channel];
        }
        self.squares += other.squares;
        self.squares_of_runs += other.squares_of_runs;
        self.extremes[0] = self.extremes[0].min(other.extremes[0]);
        self.extremes[1] = self.extremes[1].max(other.extremes[1]);
        self.count += other.count;
    }

    /// Returns the mean luminance of the samples.
    pub(in crate::render) fn luminance(&self) -> f64 {
        (0..3).map(|c| LUMINANCE[c] * self.sum[c]).sum::<f64>() / f64::from(self.count)
    }

    /// Returns the mean radiance, linear RGB.
    pub(in crate::render) fn mean(&self) -> [f64; 3] {
        self.sum.map(|sum| sum / f64::from(self.count))
    }

    /// Returns the variance of the samples (not of their mean), channels weighted by luminance; 0 for a single
    /// sample.
    ///
    /// It is at least the variance of the luminance, and also detects edges between colours of equal luminance. In
    /// f64 the difference of squares loses 2^-53 of the squared mean, so 2^-26 of the mean in standard deviation.
    pub(in crate::render) fn variance(&self) -> f64 {
        if self.count < 2 {
            return 0.0;
        }
        ((self.squares - self.mean_squares()) / f64::from(self.count - 1)).max(0.0)
    }

    /// Returns the part of the variance that is noise; the rest is due to edges. For a single pixel it is uncertain
    /// and may be negative or exceed the variance.
    ///
    /// The mean of r stratified samples has a variance of 1 / r of that of noise, and of 1 / r^1.5 of that of edges.
    /// The variance between means of runs of r samples therefore separates the two. The longest available runs are
    /// used, the halves that were merged last: a variation that looks like noise to few samples may be an edge to
    /// more, and the reverse where a texture is finer than they resolve.
    pub(in crate::render) fn noise_variance(&self) -> f64 {
        let (length, of_means) = if self.halves.count > 0 {
            let length = f64::from(self.halves.count);
            (length, length * self.halves.variance)
        } else if self.count >= 2 * RUN {
            let length = f64::from(RUN);
            let squares = self.squares_of_runs / length - self.mean_squares();
            (length, squares.max(0.0) / f64::from(self.count / RUN - 1))
        } else {
            return 0.0;
        };
        // 1 / √r of the variance of edges remains.
        let of_edges = length.sqrt().recip();
        (of_means - of_edges * self.variance()) / (1.0 - of_edges)
    }

    /// Returns the squared mean of all channels, weighted by luminance, times the number of samples.
    fn mean_squares(&self) -> f64 {
        let mean = self.mean();
        (0..3).map(|c| LUMINANCE[c] * mean[c] * self.sum[c]).sum()
    }
}

impl Default for PixelStatistics {
    fn default() -> PixelStatistics {
        PixelStatistics::NONE
    }
}

/// Returns the estimate of gray samples: of the first sixteen, merged with as many again while there are more.
#[cfg(test)]
pub(in crate::render) fn estimate(samples: &[f64]) -> PixelStatistics {
    const ROUND: usize = 16;
    let (first, later) = samples.split_at(samples.len().min(ROUND));
    let mut estimate = estimate_of_round(first);
    let mut later = later;
    while !later.is_empty() {
        let (round, rest) = later.split_at(later.len().min(estimate.count as usize));
        estimate.merge(&estimate_of_round(round));
        later = rest;
    }
    estimate
}

/// Returns the estimate of gray samples of a single round.
#[cfg(test)]
fn estimate_of_round(samples: &[f64]) -> PixelStatistics {
    let mut estimate = PixelStatistics::NONE;
    for &gray in samples {
        estimate.add([gray; 3]);
    }
    for run in samples.chunks_exact(RUN as usize) {
        estimate.note_run([run.iter().sum(); 3]);
    }
    estimate
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_are_those_of_the_samples() {
        let four = estimate(&[1.0, 2.0, 3.0, 6.0]);
        // Mean 3; squared differences 4 + 1 + 0 + 9, divided by 3.
        assert_eq!(four.mean(), [3.0; 3]);
        assert!((four.variance() - 14.0 / 3.0).abs() < 1e-14);
        assert_eq!(estimate(&[5.0]).variance(), 0.0);
        let mut merged = four;
        merged.merge(&estimate(&[5.0, 0.0, 2.0, 1.0]));
        let eight = estimate(&[1.0, 2.0, 3.0, 6.0, 5.0, 0.0, 2.0, 1.0]);
        assert_eq!((merged.sum, merged.count), (eight.sum, eight.count));
        assert!((merged.variance() - eight.variance()).abs() < 1e-14);
    }

    #[test]
    fn run_means_distinguish_noise_from_edges() {
        // Runs of four that differ: the samples have the variance 8 / 7, the means 2, which is 8 for four samples.
        // Half of 8 / 7 would remain of edges: (8 - 4 / 7) / (1 - 1 / 2).
        let apart = estimate(&[0.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0]);
        assert!((apart.noise_variance() - 104.0 / 7.0).abs() < 1e-13);
        // Runs of four that agree.
        let alike = estimate(&[0.0, 2.0, 0.0, 2.0, 0.0, 2.0, 0.0, 2.0]);
        assert!((alike.noise_variance() + 8.0 / 7.0).abs() < 1e-14);
        assert_eq!(estimate(&[0.0, 2.0, 1.0, 5.0]).noise_variance(), 0.0);
    }

    #[test]
    fn variance_of_halves_is_used_from_two_runs_on() {
        // The samples have the variance 32 / 31, the means of sixteen 2, which is 32 for sixteen samples; a quarter
        // would remain of edges.
        let variance = 32.0 / 31.0;
        let halves = estimate(&[[0.0; 16], [2.0; 16]].concat());
        let expected = (32.0 - 0.25 * variance) / 0.75;
        assert!((halves.noise_variance() - expected).abs() < 1e-12);
        // Halves of 32 that agree; of edges 1 / √32 would remain. An incomplete round does not change the halves.
        let mut agreeing = estimate(&[[0.0; 16], [2.0; 16], [0.0; 16], [2.0; 16]].concat());
        let left = 32.0f64.sqrt().recip();
        let expected = -left * (64.0 / 63.0) / (1.0 - left);
        assert!((agreeing.noise_variance() - expected).abs() < 1e-12);
        agreeing.merge(&estimate(&[1.0; 10]));
        assert_eq!(agreeing.halves.count, 32);
    }

    #[test]
    fn an_edge_between_colours_of_equal_luminance_has_a_variance() {
        let mut edge = PixelStatistics::NONE;
        edge.add([1.0 / LUMINANCE[0], 0.0, 0.0]);
        edge.add([0.0, 1.0 / LUMINANCE[1], 0.0]);
        assert!(edge.extremes[0] > 0.99 && edge.extremes[1] < 1.01);
        assert!(edge.variance() > 1.0);
    }
}
