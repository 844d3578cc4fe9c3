//! What a number of samples tell of their pixel: mean, variance, extremes.

/// Rec. 709 luminance of linear RGB.
pub(super) const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// What the samples of a pixel tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Estimate {
    /// Of radiance, linear RGB.
    pub(super) sum: [f64; 3],
    /// Sum of squared radiance, channels weighted by luminance.
    squares: f64,
    /// Least and greatest luminance of a sample.
    pub(super) extremes: [f32; 2],
    /// Samples.
    pub(super) count: u32,
}

impl Estimate {
    pub(super) const NONE: Estimate = Estimate {
        sum: [0.0; 3],
        squares: 0.0,
        extremes: [f32::INFINITY, f32::NEG_INFINITY],
        count: 0,
    };

    /// Counts one more sample.
    #[inline(always)]
    pub(super) fn add(&mut self, radiance: [f64; 3]) {
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

    /// Counts the samples of `other` too.
    pub(super) fn merge(&mut self, other: &Estimate) {
        for channel in 0..3 {
            self.sum[channel] += other.sum[channel];
        }
        self.squares += other.squares;
        self.extremes[0] = self.extremes[0].min(other.extremes[0]);
        self.extremes[1] = self.extremes[1].max(other.extremes[1]);
        self.count += other.count;
    }

    /// Mean luminance.
    pub(super) fn luminance(&self) -> f64 {
        (0..3).map(|c| LUMINANCE[c] * self.sum[c]).sum::<f64>() / f64::from(self.count)
    }

    /// Mean radiance.
    pub(super) fn mean(&self) -> [f64; 3] {
        self.sum.map(|sum| sum / f64::from(self.count))
    }

    /// Variance of the samples (not of their mean), channels weighted by luminance; 0 for a single one.
    ///
    /// It is at least that of the luminance, and sees edges between colours of equal luminance as well. In f64 the
    /// difference of squares loses 2^-53 of the squared mean, so 2^-26 of the mean in standard deviation.
    pub(super) fn variance(&self) -> f64 {
        if self.count < 2 {
            return 0.0;
        }
        let mean = self.mean();
        let mean_squares: f64 = (0..3).map(|c| LUMINANCE[c] * mean[c] * self.sum[c]).sum();
        ((self.squares - mean_squares) / f64::from(self.count - 1)).max(0.0)
    }
}

impl Default for Estimate {
    fn default() -> Estimate {
        Estimate::NONE
    }
}

/// That of these gray samples.
#[cfg(test)]
pub(super) fn estimate(samples: &[f64]) -> Estimate {
    let mut estimate = Estimate::NONE;
    for &gray in samples {
        estimate.add([gray; 3]);
    }
    estimate
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_are_those_of_the_samples() {
        let four = estimate(&[1.0, 2.0, 3.0, 6.0]);
        // Mean 3; squared differences 4 + 1 + 0 + 9 over 3.
        assert_eq!(four.mean(), [3.0; 3]);
        assert!((four.variance() - 14.0 / 3.0).abs() < 1e-14);
        assert_eq!(estimate(&[5.0]).variance(), 0.0);
        let mut merged = estimate(&[1.0, 2.0]);
        merged.merge(&estimate(&[3.0, 6.0]));
        assert_eq!(merged, four);
    }

    #[test]
    fn an_edge_between_colours_of_equal_luminance_has_a_variance() {
        let mut edge = Estimate::NONE;
        edge.add([1.0 / LUMINANCE[0], 0.0, 0.0]);
        edge.add([0.0, 1.0 / LUMINANCE[1], 0.0]);
        assert!(edge.extremes[0] > 0.99 && edge.extremes[1] < 1.01);
        assert!(edge.variance() > 1.0);
    }
}
