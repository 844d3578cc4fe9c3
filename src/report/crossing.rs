//! Where the lines of two ways over the size of a mesh cross: `whit bench --sweep`.
//!
//! Of two ways one is ahead at a size if all of its repetitions were better than all of the other's there; elsewhere
//! nobody can tell. Lines cross between two sizes with different ones ahead, at the place where the medians do, which are
//! joined by straight lines over both logarithms.

use std::fmt::Write;

use super::bench::{BenchRow, Mode, RayKind, told_before};
use super::table::in_groups;
use super::words::{significant, times};
use crate::accel::{Backend, Precision};
use crate::cost::Interval;

/// One of two ways.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ahead {
    /// The first.
    First,
    /// The second.
    Second,
}

impl Ahead {
    fn of_both(first: Interval, second: Interval) -> Option<Ahead> {
        if first.low > second.high {
            Some(Ahead::First)
        } else if second.low > first.high {
            Some(Ahead::Second)
        } else {
            None
        }
    }
}

/// Where two lines cross.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Triangles at which medians are equal.
    pub at: f64,
    /// The nearest sizes below and above with a different one ahead each.
    pub between: [u64; 2],
    /// The one that is ahead from there on.
    pub then: Ahead,
}

/// How two ways do over the size; more is better.
#[derive(Clone, Debug, PartialEq)]
pub struct Race {
    /// Triangles, what was measured of the first and what of the second.
    pub places: Vec<(u64, [Interval; 2])>,
}

impl Race {
    /// The way that is ahead at the smallest size where one is.
    pub fn begins(&self) -> Option<Ahead> {
        self.known().next().map(|(_, ahead)| ahead)
    }

    /// Whether one is ahead at every size.
    pub fn is_told(&self) -> bool {
        self.known().count() == self.places.len()
    }

    /// Where the other one goes ahead, from the smallest size on.
    pub fn crossings(&self) -> Vec<Crossing> {
        let known: Vec<(usize, Ahead)> = self.known().collect();
        let changes = known.windows(2).filter(|pair| pair[0].1 != pair[1].1);
        changes
            .map(|pair| Crossing {
                at: self.meeting(pair[0].0, pair[1].0),
                between: [pair[0].0, pair[1].0].map(|place| self.places[place].0),
                then: pair[1].1,
            })
            .collect()
    }

    /// The second's median over the first's, least and greatest.
    pub fn ratios(&self) -> [f64; 2] {
        let ratios = self.places.iter().map(|(_, [a, b])| b.value / a.value);
        ratios.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], ratio| {
            [low.min(ratio), high.max(ratio)]
        })
    }

    fn known(&self) -> impl Iterator<Item = (usize, Ahead)> {
        let places = self.places.iter().enumerate();
        places.filter_map(|(place, (_, [a, b]))| Some((place, Ahead::of_both(*a, *b)?)))
    }

    /// Where medians meet first between two places that differ in whose is greater.
    fn meeting(&self, first: usize, last: usize) -> f64 {
        let log = |place: usize| {
            let (size, [a, b]) = &self.places[place];
            [(*size as f64).ln(), (b.value / a.value).ln()]
        };
        let is_below = |place: usize| log(place)[1] < 0.0;
        let after = (first + 1..last).find(|&place| is_below(place) != is_below(first));
        let after = after.unwrap_or(last);
        let ([x0, y0], [x1, y1]) = (log(after - 1), log(after));
        (x0 + (x1 - x0) * y0 / (y0 - y1)).exp()
    }
}

/// A race of Embree, which is the first, against the BSP.
#[derive(Clone, Debug, PartialEq)]
pub struct Pairing {
    /// What is compared, such as `camera rays, packets`.
    pub what: String,
    /// At which precision of Embree.
    pub precision: Precision,
    /// Over the size.
    pub race: Race,
}

/// All that can be compared in the rows of a sweep.
pub fn pairings(rows: &[BenchRow]) -> Vec<Pairing> {
    let mut kinds: Vec<RayKind> = Vec::new();
    let mut precisions: Vec<Precision> = Vec::new();
    for row in rows {
        told_before(&mut kinds, row.rays);
        if row.backend == Backend::Embree {
            told_before(&mut precisions, row.precision);
        }
    }
    let modes = [
        ("packets", [Mode::Packet, Mode::Packet]),
        ("packets against batches", [Mode::Packet, Mode::Batch]),
        ("single", [Mode::Single, Mode::Single]),
    ];
    let mut all = Vec::new();
    let mut add = |what: String, precision, of: &dyn Fn(&BenchRow, usize) -> Option<Interval>| {
        let race = race(rows, precision, of);
        if race.places.len() > 1 {
            all.push(Pairing {
                what,
                precision,
                race,
            });
        }
    };
    for kind in kinds {
        for (words, asked) in modes {
            for &precision in &precisions {
                add(format!("{kind} rays, {words}"), precision, &|row, side| {
                    (row.rays == kind && row.mode == asked[side]).then(|| repeated(row.speed()))
                });
            }
        }
    }
    let inverse = |interval: Interval| Interval {
        value: 1.0 / interval.value,
        low: 1.0 / interval.high,
        high: 1.0 / interval.low,
    };
    for &precision in &precisions {
        add("builds a second".to_owned(), precision, &|row, _| {
            Some(inverse(repeated(row.build())))
        });
    }
    for &precision in &precisions {
        add("triangles a byte".to_owned(), precision, &|row, _| {
            row.bytes_per_triangle()
                .map(|bytes| inverse(Interval::exact(bytes)))
        });
    }
    all
}

/// A measurement; of one that was made once nobody can tell where it lies.
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

/// What `of` finds for Embree at that precision and for the BSP in the first row of each size that has it.
fn race(rows: &[BenchRow], precision: Precision, of: &dyn Fn(&BenchRow, usize) -> Option<Interval>) -> Race {
    let mut sizes: Vec<u64> = rows.iter().map(|row| row.triangles).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let place = |size: u64| {
        let of_side = |side: usize| {
            let is_it = |row: &&BenchRow| {
                let is_side = match side {
                    0 => row.backend == Backend::Embree && row.precision == precision,
                    _ => row.backend == Backend::Bsp,
                };
                row.triangles == size && is_side
            };
            rows.iter().filter(is_it).find_map(|row| of(row, side))
        };
        Some((size, [of_side(0)?, of_side(1)?]))
    };
    Race {
        places: sizes.into_iter().filter_map(place).collect(),
    }
}

impl Pairing {
    /// Who is ahead up to where.
    pub fn verdict(&self) -> String {
        let name = |ahead| match ahead {
            Ahead::First => "Embree",
            Ahead::Second => "the BSP",
        };
        let Some(first) = self.race.begins() else {
            return "nobody can tell who is ahead at any size".to_owned();
        };
        let crossings = self.race.crossings();
        if crossings.is_empty() {
            return match self.race.is_told() {
                true => format!("{} is ahead at every size", name(first)),
                false => format!("{} is ahead wherever that can be told", name(first)),
            };
        }
        let mut words = format!("{} is ahead", name(first));
        for crossing in crossings {
            let [low, high] = crossing.between.map(in_groups);
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

    /// The BSP over Embree, from the least to the greatest.
    pub fn ratios(&self) -> String {
        let [low, high] = self.race.ratios();
        format!("{} to {}", times(low), times(high))
    }
}

/// A number of triangles to two digits.
fn rounded(triangles: f64) -> String {
    match significant(triangles, 2).parse::<f64>() {
        Ok(rounded) => {
            // Below a million digits that do not count are still written.
            let power = 10f64.powf((rounded.abs().log10().floor() - 1.0).max(0.0));
            in_groups(((rounded / power).round() * power) as u64)
        }
        Err(_) => significant(triangles, 2),
    }
}

/// All pairings of the rows of a sweep for a person, a line each.
pub fn text(rows: &[BenchRow]) -> String {
    let all = pairings(rows);
    if all.is_empty() {
        return String::new();
    }
    let mut text =
        "where the lines cross, Embree against the BSP, which has these times as much\n".to_owned();
    for pairing in all {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {:<42}{:<12}{:<18}{}",
            pairing.what,
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

    fn race(part: f64, places: &[(u64, f64, f64)]) -> Race {
        let place = |&(size, a, b): &(u64, f64, f64)| (size, [around(a, part), around(b, part)]);
        Race {
            places: places.iter().map(place).collect(),
        }
    }

    #[test]
    fn lines_cross_where_medians_meet_over_both_logarithms() {
        // Twice as good, then half as good: in the middle of 10^3 and 10^5, which is 10^4.
        let race = race(0.01, &[(1_000, 2.0, 4.0), (100_000, 2.0, 1.0)]);
        let [crossing] = race.crossings()[..] else {
            panic!("{race:?}")
        };
        assert!((crossing.at / 1e4 - 1.0).abs() < 1e-12, "{crossing:?}");
        assert_eq!(crossing.between, [1_000, 100_000]);
        assert_eq!(crossing.then, Ahead::First);
        assert_eq!(race.begins(), Some(Ahead::Second));
        assert_eq!(race.ratios(), [0.5, 2.0]);
    }

    #[test]
    fn where_repetitions_overlap_nothing_crosses() {
        let noise = race(0.2, &[(1, 1.0, 1.1), (10, 1.1, 1.0), (100, 1.0, 1.1)]);
        assert_eq!((noise.begins(), noise.crossings()), (None, vec![]));
        // Nobody can tell in the middle: between the ends, at the middle's median.
        let wide = race(0.2, &[(1, 1.0, 9.0), (10, 1.0, 1.0), (100, 9.0, 1.0)]);
        let [crossing] = wide.crossings()[..] else {
            panic!("{wide:?}")
        };
        assert_eq!(crossing.between, [1, 100]);
        assert!((crossing.at - 10.0).abs() < 1e-9, "{crossing:?}");
        assert!(!wide.is_told());
    }

    #[test]
    fn every_crossing_is_told_in_words() {
        let pairing = |places: &[(u64, f64, f64)]| Pairing {
            what: String::new(),
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
            "nobody can tell who is ahead at any size"
        );
    }

    #[test]
    fn numbers_of_triangles_have_two_digits() {
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
        let rows = [
            sized(1_000, Backend::Embree, Mode::Packet, 8.0),
            sized(1_000, Backend::Bsp, Mode::Packet, 16.0),
            sized(1_000, Backend::Bsp, Mode::Batch, 4.0),
            sized(100_000, Backend::Embree, Mode::Packet, 4.0),
            sized(100_000, Backend::Bsp, Mode::Packet, 2.0),
            sized(100_000, Backend::Bsp, Mode::Batch, 2.0),
        ];
        let all = pairings(&rows);
        let told: Vec<String> = all
            .iter()
            .map(|p| format!("{}: {}", p.what, p.verdict()))
            .collect();
        assert_eq!(
            told,
            [
                "camera rays, packets: the BSP is ahead up to about 10 000 triangles (between 1 000 and 100 000), then \
                 Embree",
                "camera rays, packets against batches: Embree is ahead at every size",
                "builds a second: nobody can tell who is ahead at any size",
                "triangles a byte: nobody can tell who is ahead at any size",
            ]
        );
        assert_eq!(all[0].ratios(), "x0.50 to x2.00");
        assert_eq!(text(&rows).lines().count(), 5);
        let once = rows.clone().map(|row| BenchRow {
            mrays_per_s_min: row.mrays_per_s,
            ..row
        });
        assert_eq!(
            pairings(&once)[0].verdict(),
            "nobody can tell who is ahead at any size"
        );
        assert_eq!(text(&rows[..3]), "");
    }
}
