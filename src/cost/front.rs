//! Which configurations no other beats.

use super::Interval;

/// Where a configuration stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Seconds, or a ratio of them.
    pub time: Interval,
    /// Any error.
    pub error: Interval,
}

/// For each place, whether no other beats it: is known to be both faster and closer.
pub fn front(places: &[Place]) -> Vec<bool> {
    // By the time at which each is over; the least error among all that are over before another begins tells.
    let mut by_end: Vec<&Place> = places.iter().collect();
    by_end.sort_by(|a, b| a.time.high.total_cmp(&b.time.high));
    let mut least = f64::INFINITY;
    let least_errors: Vec<f64> = by_end
        .iter()
        .map(|place| {
            least = least.min(place.error.high);
            least
        })
        .collect();
    places
        .iter()
        .map(|place| {
            let over = by_end.partition_point(|other| other.time.high < place.time.low);
            over == 0 || least_errors[over - 1] >= place.error.low
        })
        .collect()
}

/// The place on the front from which on less error is dear and before which less time is: the farthest below the line
/// between the front's ends, by logarithms. `None` if the front has no three places.
pub fn knee(places: &[Place], on_front: &[bool]) -> Option<usize> {
    let is_plain = |place: &Place| place.time.value > 0.0 && place.error.value > 0.0;
    let mut front: Vec<usize> = (0..places.len())
        .filter(|&i| on_front[i] && is_plain(&places[i]))
        .collect();
    front.sort_by(|&a, &b| places[a].time.value.total_cmp(&places[b].time.value));
    let [first, .., last] = front[..] else {
        return None;
    };
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

    fn beats(one: &Place, other: &Place) -> bool {
        one.time.high < other.time.low && one.error.high < other.error.low
    }

    #[test]
    fn the_front_of_random_places_is_what_brute_force_finds() {
        for seed in 0..200 {
            let mut random = SplitMix64::new(9, seed);
            let count = random.below(40);
            let mut around = |width: f64| {
                // Coarse, so that ends meet.
                let value = (20.0 * random.unit()).round();
                Interval {
                    value,
                    low: value - (width * random.unit()).round(),
                    high: value + (width * random.unit()).round(),
                }
            };
            let places: Vec<Place> = (0..count)
                .map(|_| Place {
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
    fn the_knee_is_where_the_front_bends() {
        let place = |time: f64, error: f64| Place {
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
