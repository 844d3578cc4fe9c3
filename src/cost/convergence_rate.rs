//! Convergence rate: slope of a least-squares line through errors over times on logarithmic axes.

use super::Interval;

/// Quantiles of Student's t at 97.5 %, for 1, 2, ... degrees of freedom (standard tables); larger ones use the last.
const STUDENT: [f64; 10] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
];

/// Returns the slope of the least-squares line through the logarithms of `points`, with its 95 % confidence interval
/// under normal scatter. `None` for fewer than three positive finite points, or for a single abscissa.
pub fn slope(points: &[(f64, f64)]) -> Option<Interval> {
    // Take logarithms of positive, finite points
    let logs: Vec<(f64, f64)> = points
        .iter()
        .filter(|(x, y)| *x > 0.0 && *y > 0.0 && x.is_finite() && y.is_finite())
        .map(|(x, y)| (x.ln(), y.ln()))
        .collect();
    if logs.len() < 3 {
        return None;
    }
    // Fit the line by least squares
    let count = logs.len() as f64;
    let mean_x = logs.iter().map(|p| p.0).sum::<f64>() / count;
    let mean_y = logs.iter().map(|p| p.1).sum::<f64>() / count;
    let spread = logs.iter().map(|p| (p.0 - mean_x).powi(2)).sum::<f64>();
    if spread == 0.0 {
        return None;
    }
    let value = logs.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum::<f64>() / spread;
    // Bound the slope by Student's t
    let residual = |p: &(f64, f64)| p.1 - mean_y - value * (p.0 - mean_x);
    let squares = logs.iter().map(|p| residual(p).powi(2)).sum::<f64>();
    let freedom = logs.len() - 2;
    let width = STUDENT[freedom.min(STUDENT.len()) - 1] * (squares / freedom as f64 / spread).sqrt();
    Some(Interval {
        value,
        low: value - width,
        high: value + width,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    #[test]
    fn slope_of_a_power_is_its_exponent() {
        let points: Vec<(f64, f64)> = (1..6)
            .map(|i| (f64::from(i), 3.0 * f64::from(i).powf(-0.75)))
            .collect();
        let found = slope(&points).unwrap();
        assert!(
            (found.value + 0.75).abs() < 1e-12 && found.high - found.low < 1e-9,
            "{found:?}"
        );
        assert_eq!(slope(&points[..2]), None);
        assert_eq!(slope(&[(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)]), None);
    }

    #[test]
    fn interval_contains_the_exponent_in_95_percent() {
        let held = (0..2000)
            .filter(|&seed| {
                let mut random = SplitMix64::new(10, seed);
                let mut normal = || (0..12).map(|_| random.unit()).sum::<f64>() - 6.0;
                let points: Vec<(f64, f64)> = (0..6)
                    .map(|i| {
                        let x = 2f64.powi(i);
                        (x, x.powf(-0.5) * (0.1 * normal()).exp())
                    })
                    .collect();
                slope(&points).unwrap().holds(-0.5)
            })
            .count();
        assert!((1870..=1930).contains(&held), "{held} of 2000");
    }
}
