//! Crossing points of two methods' speeds over the size of a mesh: `whit bench --sweep`.
//!
//! One method is ahead at a size if all of its repetitions were better than all of the other's there; otherwise the
//! order is undecided. Lines cross between two sizes with different methods ahead, where the medians do; medians are
//! joined by straight lines over both logarithms.

use std::fmt::Write;

use super::bench::seen_before;
use super::table::group_thousands;
use crate::accel::{Backend, Precision};
use crate::bench::{BenchRow, Mode, RayKind};
use crate::measure::Interval;
use crate::report::format::{significant, times};

/// Method that is ahead at a size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leader {
    /// First method of the pair.
    First,
    /// Second method of the pair.
    Second,
}

impl Leader {
    fn of_both(first: Interval, second: Interval) -> Option<Leader> {
        if first.low > second.high {
            Some(Leader::First)
        } else if second.low > first.high {
            Some(Leader::Second)
        } else {
            None
        }
    }
}

/// Crossing of two lines over the size of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Number of triangles at which the medians are equal.
    pub at: f64,
    /// Nearest sizes below and above at which a different method is ahead.
    pub between: [u64; 2],
    /// Method that is ahead beyond the crossing.
    pub then: Leader,
}

/// Comparison of two methods over the size; larger values are better.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodComparison {
    /// Number of triangles with the measurements of the first and the second method.
    pub places: Vec<(u64, [Interval; 2])>,
}

impl MethodComparison {
    /// Returns the method that is ahead at the smallest decided size.
    pub fn begins(&self) -> Option<Leader> {
        self.known().next().map(|(_, ahead)| ahead)
    }

    /// Returns whether one method is ahead at every size.
    pub fn is_decided(&self) -> bool {
        self.known().count() == self.places.len()
    }

    /// Returns the crossings at which the lead changes, in ascending order of size.
    pub fn crossings(&self) -> Vec<Crossing> {
        let known: Vec<(usize, Leader)> = self.known().collect();
        // Find neighbouring decided sizes with different leads
        let changes = known.windows(2).filter(|pair| pair[0].1 != pair[1].1);
        changes
            .map(|pair| Crossing {
                at: self.crossing_size(pair[0].0, pair[1].0),
                between: [pair[0].0, pair[1].0].map(|place| self.places[place].0),
                then: pair[1].1,
            })
            .collect()
    }

    /// Returns the smallest and the largest ratio of the second method's median to the first's.
    pub fn ratios(&self) -> [f64; 2] {
        let ratios = self.places.iter().map(|(_, [a, b])| b.value / a.value);
        ratios.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], ratio| {
            [low.min(ratio), high.max(ratio)]
        })
    }

    fn known(&self) -> impl Iterator<Item = (usize, Leader)> {
        let places = self.places.iter().enumerate();
        places.filter_map(|(place, (_, [a, b]))| Some((place, Leader::of_both(*a, *b)?)))
    }

    /// Returns the size at which medians first become equal between two places with different signs of the log ratio.
    fn crossing_size(&self, first: usize, last: usize) -> f64 {
        let log = |place: usize| {
            let (size, [a, b]) = &self.places[place];
            [(*size as f64).ln(), (b.value / a.value).ln()]
        };
        let is_below = |place: usize| log(place)[1] < 0.0;
        // Find the first sign change, then interpolate linearly in the logarithms
        let after = (first + 1..last).find(|&place| is_below(place) != is_below(first));
        let after = after.unwrap_or(last);
        let ([x0, y0], [x1, y1]) = (log(after - 1), log(after));
        (x0 + (x1 - x0) * y0 / (y0 - y1)).exp()
    }
}

/// Comparison of Embree, the first method, with a structure of our own.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodPair {
    /// Compared quantity, such as `camera rays, single`.
    pub what: String,
    /// Backend of the second method.
    pub second: Backend,
    /// Precision of Embree's triangle hits.
    pub precision: Precision,
    /// Measurements of both methods over the size.
    pub race: MethodComparison,
}

/// Returns all comparisons that the rows of a sweep allow.
pub fn method_pairs(rows: &[BenchRow]) -> Vec<MethodPair> {
    // Collect the kinds of rays and the precisions
    let mut kinds: Vec<RayKind> = Vec::new();
    let mut precisions: Vec<Precision> = Vec::new();
    for row in rows {
        seen_before(&mut kinds, row.rays);
        if row.backend == Backend::Embree {
            seen_before(&mut precisions, row.precision);
        }
    }
    let modes = [
        ("packets against batches", [Mode::Packet, Mode::Batch]),
        ("single", [Mode::Single, Mode::Single]),
    ];
    let mut all = Vec::new();
    let mut add = |what: String, precision, of: &dyn Fn(&BenchRow, usize) -> Option<Interval>| {
        for second in [Backend::Native, Backend::Bsp] {
            let race = race(rows, (precision, second), of);
            if race.places.len() > 1 {
                all.push(MethodPair {
                    what: what.clone(),
                    second,
                    precision,
                    race,
                });
            }
        }
    };
    // Compare speeds in each combination of modes
    for kind in kinds {
        for (words, mode_pair) in modes {
            for &precision in &precisions {
                add(format!("{kind} rays, {words}"), precision, &|row, side| {
                    (row.rays == kind && row.mode == mode_pair[side]).then(|| repeated(row.speed()))
                });
            }
        }
    }
    // Compare builds and memory, inverted so that larger values are better
    let inverse = |interval: Interval| Interval {
        value: 1.0 / interval.value,
        low: 1.0 / interval.high,
        high: 1.0 / interval.low,
    };
    for &precision in &precisions {
        add("builds per second".to_owned(), precision, &|row, _| {
            Some(inverse(repeated(row.build())))
        });
    }
    for &precision in &precisions {
        add("triangles per byte".to_owned(), precision, &|row, _| {
            row.bytes_per_triangle()
                .map(|bytes| inverse(Interval::exact(bytes)))
        });
    }
    all
}

/// Returns the measurement; if it was made once, its interval is unbounded so that no order is decided.
fn repeated(measured: Interval) -> Interval {
    if measured.low < measured.high {
        return measured;
    }
    Interval {
        low: 0.0,
        high: f64::INFINITY,
        ..measured
    }
}

/// Returns the comparison over the size by `of`, for Embree at `precision` and for the backend `second`: each from the
/// first row of a size that has a value.
fn race(
    rows: &[BenchRow],
    (precision, second): (Precision, Backend),
    of: &dyn Fn(&BenchRow, usize) -> Option<Interval>,
) -> MethodComparison {
    let mut sizes: Vec<u64> = rows.iter().map(|row| row.triangles).collect();
    sizes.sort_unstable();
    sizes.dedup();
    // Find the values of both methods at a size
    let place = |size: u64| {
        let of_side = |side: usize| {
            let is_it = |row: &&BenchRow| {
                let is_side = match side {
                    0 => row.backend == Backend::Embree && row.precision == precision,
                    _ => row.backend == second,
                };
                row.triangles == size && is_side
            };
            rows.iter().filter(is_it).find_map(|row| of(row, side))
        };
        Some((size, [of_side(0)?, of_side(1)?]))
    };
    MethodComparison {
        places: sizes.into_iter().filter_map(place).collect(),
    }
}

impl MethodPair {
    /// Returns the lead of the methods over the size in words.
    pub fn verdict(&self) -> String {
        let name = |ahead| match (ahead, self.second) {
            (Leader::First, _) => "Embree",
            (Leader::Second, Backend::Bsp) => "the BSP",
            (Leader::Second, _) => "the native tree",
        };
        let Some(first) = self.race.begins() else {
            return "no method is significantly ahead at any size".to_owned();
        };
        // Describe a race without crossings
        let crossings = self.race.crossings();
        if crossings.is_empty() {
            return match self.race.is_decided() {
                true => format!("{} is ahead at every size", name(first)),
                false => format!(
                    "{} is ahead at every size with a significant difference",
                    name(first)
                ),
            };
        }
        // Describe each crossing in order
        let mut words = format!("{} is ahead", name(first));
        for crossing in crossings {
            let [low, high] = crossing.between.map(group_thousands);
            // Writing to a string cannot fail.
            let _ = write!(
                words,
                " up to about {} triangles (between {low} and {high}), then {}",
                rounded(crossing.at),
                name(crossing.then)
            );
        }
        words
    }

    /// Returns the ratio of the second method to Embree, from the smallest to the largest.
    pub fn ratios(&self) -> String {
        let [low, high] = self.race.ratios();
        format!("{} to {}", times(low), times(high))
    }
}

/// Formats a number of triangles with two significant digits.
fn rounded(triangles: f64) -> String {
    match significant(triangles, 2).parse::<f64>() {
        Ok(rounded) => {
            // Below a million, `significant` writes all digits, so that the rest is rounded here.
            let power = 10f64.powf((rounded.abs().log10().floor() - 1.0).max(0.0));
            group_thousands(((rounded / power).round() * power) as u64)
        }
        Err(_) => significant(triangles, 2),
    }
}

/// Returns all comparisons of a sweep as text, one line each.
pub fn text(rows: &[BenchRow]) -> String {
    let all = method_pairs(rows);
    if all.is_empty() {
        return String::new();
    }
    let mut text =
        "crossings of Embree with the native tree and the BSP over mesh size, with the ratios to Embree\n"
            .to_owned();
    for pairing in all {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {:<42}{:<8}{:<12}{:<18}{}",
            pairing.what,
            pairing.second.to_string(),
            pairing.precision.to_string(),
            pairing.ratios(),
            pairing.verdict()
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::bench::tests::row;
    use super::*;

    fn around(value: f64, part: f64) -> Interval {
        Interval {
            value,
            low: value * (1.0 - part),
            high: value * (1.0 + part),
        }
    }

    fn race(part: f64, places: &[(u64, f64, f64)]) -> MethodComparison {
        let place = |&(size, a, b): &(u64, f64, f64)| (size, [around(a, part), around(b, part)]);
        MethodComparison {
            places: places.iter().map(place).collect(),
        }
    }

    #[test]
    fn lines_cross_where_medians_are_equal_in_logarithms() {
        // A ratio of 2 and then of 1/2 crosses in the middle of 10^3 and 10^5, which is 10^4.
        let race = race(0.01, &[(1_000, 2.0, 4.0), (100_000, 2.0, 1.0)]);
        let [crossing] = race.crossings()[..] else {
            panic!("{race:?}")
        };
        assert!((crossing.at / 1e4 - 1.0).abs() < 1e-12, "{crossing:?}");
        assert_eq!(crossing.between, [1_000, 100_000]);
        assert_eq!(crossing.then, Leader::First);
        assert_eq!(race.begins(), Some(Leader::Second));
        assert_eq!(race.ratios(), [0.5, 2.0]);
    }

    #[test]
    fn overlapping_repetitions_give_no_crossing() {
        let noise = race(0.2, &[(1, 1.0, 1.1), (10, 1.1, 1.0), (100, 1.0, 1.1)]);
        assert_eq!((noise.begins(), noise.crossings()), (None, vec![]));
        // The middle is undecided: the crossing lies between the ends, at the middle's median.
        let wide = race(0.2, &[(1, 1.0, 9.0), (10, 1.0, 1.0), (100, 9.0, 1.0)]);
        let [crossing] = wide.crossings()[..] else {
            panic!("{wide:?}")
        };
        assert_eq!(crossing.between, [1, 100]);
        assert!((crossing.at - 10.0).abs() < 1e-9, "{crossing:?}");
        assert!(!wide.is_decided());
    }

    #[test]
    fn verdict_describes_every_crossing() {
        let pairing = |places: &[(u64, f64, f64)]| MethodPair {
            what: String::new(),
            second: Backend::Bsp,
            precision: Precision::Robust,
            race: race(0.01, places),
        };
        let twice = pairing(&[(1_000, 2.0, 1.0), (4_000, 1.0, 2.0), (16_000, 2.0, 1.0)]);
        assert_eq!(
            twice.verdict(),
            "Embree is ahead up to about 2 000 triangles (between 1 000 and 4 000), then the BSP up to about 8 000 \
             triangles (between 4 000 and 16 000), then Embree"
        );
        let never = pairing(&[(1_000, 2.0, 1.0), (4_000, 2.0, 1.0)]);
        assert_eq!(never.verdict(), "Embree is ahead at every size");
        assert_eq!(
            pairing(&[(1, 1.0, 1.0)]).verdict(),
            "no method is significantly ahead at any size"
        );
    }

    #[test]
    fn triangle_counts_are_rounded_to_two_digits() {
        let words = [999.0, 1234.0, 29_499.0, 1_260_000.0, 9_960_000.0].map(rounded);
        assert_eq!(words, ["1 000", "1 200", "29 000", "1 300 000", "10 000 000"]);
    }

    #[test]
    fn rows_of_two_sizes_are_paired_by_rays_and_precision() {
        let sized = |triangles, backend, mode, speed| BenchRow {
            triangles,
            bytes: 100 * triangles,
            mrays_per_s_min: 0.99 * speed,
            ..row(backend, mode, speed)
        };
        // The native tree leads at the smaller size and Embree at the larger one.
        let rows = [
            sized(1_000, Backend::Embree, Mode::Packet, 8.0),
            sized(1_000, Backend::Native, Mode::Batch, 16.0),
            sized(1_000, Backend::Bsp, Mode::Batch, 4.0),
            sized(100_000, Backend::Embree, Mode::Packet, 4.0),
            sized(100_000, Backend::Native, Mode::Batch, 2.0),
            sized(100_000, Backend::Bsp, Mode::Batch, 2.0),
        ];
        let all = method_pairs(&rows);
        // Compare the verdict of every pair
        let verdicts: Vec<String> = all
            .iter()
            .map(|p| format!("{}, {}: {}", p.what, p.second, p.verdict()))
            .collect();
        assert_eq!(
            verdicts,
            [
                "camera rays, packets against batches, native: the native tree is ahead up to about 10 000 triangles \
                 (between 1 000 and 100 000), then Embree",
                "camera rays, packets against batches, bsp: Embree is ahead at every size",
                "builds per second, native: no method is significantly ahead at any size",
                "builds per second, bsp: no method is significantly ahead at any size",
                "triangles per byte, native: no method is significantly ahead at any size",
                "triangles per byte, bsp: no method is significantly ahead at any size",
            ]
        );
        assert_eq!(all[0].ratios(), "x0.50 to x2.00");
        assert_eq!(text(&rows).lines().count(), 7);
        // Single measurements decide no order
        let once = rows.clone().map(|row| BenchRow {
            mrays_per_s_min: row.mrays_per_s,
            ..row
        });
        assert_eq!(
            method_pairs(&once)[0].verdict(),
            "no method is significantly ahead at any size"
        );
        assert_eq!(text(&rows[..3]), "");
    }
}
