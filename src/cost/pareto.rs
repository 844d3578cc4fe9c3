//! Pareto front of configurations by time and error, and its knee.

use super::Interval;

/// Time and error of a configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParetoPoint {
    /// Render time in seconds, or relative to another.
    pub time: Interval,
    /// Error of the image in any metric.
    pub error: Interval,
}

/// Returns for each configuration whether it is on the Pareto front: no other is significantly both faster and more
/// accurate.
pub fn front(places: &[ParetoPoint]) -> Vec<bool> {
    // Sort by the upper end of the time. The running minimum of the errors then decides: it covers all that end before
    // a given one begins.
    let mut by_end: Vec<&ParetoPoint> = places.iter().collect();
    by_end.sort_by(|a, b| a.time.high.total_cmp(&b.time.high));
    let mut least = f64::INFINITY;
    let least_errors: Vec<f64> = by_end
        .iter()
        .map(|place| {
            least = least.min(place.error.high);
            least
        })
        .collect();
    // Compare each one with the minimum among those that are faster
    places
        .iter()
        .map(|place| {
            let over = by_end.partition_point(|other| other.time.high < place.time.low);
            over == 0 || least_errors[over - 1] >= place.error.low
        })
        .collect()
}

/// Returns the index of the Pareto front's knee, beyond which less error costs much time: the point farthest below the
/// line between the front's ends, in logarithms. `None` if the front has fewer than three points.
pub fn knee(places: &[ParetoPoint], on_front: &[bool]) -> Option<usize> {
    // Sort the front by time, without points that have no logarithm
    let is_plain = |place: &ParetoPoint| place.time.value > 0.0 && place.error.value > 0.0;
    let mut front: Vec<usize> = (0..places.len())
        .filter(|&i| on_front[i] && is_plain(&places[i]))
        .collect();
    front.sort_by(|&a, &b| places[a].time.value.total_cmp(&places[b].time.value));
    let [first, .., last] = front[..] else {
        return None;
    };
    // Measure distances from the line between the front's ends
    let at = |i: usize| (places[i].time.value.ln(), places[i].error.value.ln());
    let ((x0, y0), (x1, y1)) = (at(first), at(last));
    let below = |i: usize| {
        let (x, y) = at(i);
        (x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)
    };
    let inner = &front[1..front.len() - 1];
    inner
        .iter()
        .copied()
        .max_by(|&a, &b| below(a).total_cmp(&below(b)))
        .filter(|&i| below(i) > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    fn beats(one: &ParetoPoint, other: &ParetoPoint) -> bool {
        one.time.high < other.time.low && one.error.high < other.error.low
    }

    #[test]
    fn front_of_random_points_matches_brute_force() {
        for seed in 0..200 {
            let mut random = SplitMix64::new(9, seed);
            let count = random.below(40);
            let mut around = |width: f64| {
                // Coarse rounding makes ends of intervals coincide.
                let value = (20.0 * random.unit()).round();
                Interval {
                    value,
                    low: value - (width * random.unit()).round(),
                    high: value + (width * random.unit()).round(),
                }
            };
            let places: Vec<ParetoPoint> = (0..count)
                .map(|_| ParetoPoint {
                    time: around(3.0),
                    error: around(3.0),
                })
                .collect();
            let brute: Vec<bool> = places
                .iter()
                .map(|place| !places.iter().any(|other| beats(other, place)))
                .collect();
            assert_eq!(front(&places), brute, "{places:?}");
        }
    }

    #[test]
    fn knee_is_at_the_bend_of_the_front() {
        let place = |time: f64, error: f64| ParetoPoint {
            time: Interval::exact(time),
            error: Interval::exact(error),
        };
        let places = [
            place(1.0, 1.0),
            place(2.0, 0.1),
            place(100.0, 0.08),
            place(50.0, 2.0),
        ];
        let on_front = front(&places);
        assert_eq!(on_front, [true, true, true, false]);
        assert_eq!(knee(&places, &on_front), Some(1));
        assert_eq!(knee(&places[..2], &[true, true]), None);
    }
}
