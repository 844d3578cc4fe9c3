//! Comparison of measurements with earlier ones: `whit compare-stats`.
//!
//! Inputs are the JSON files of `whit bench` and `whit cost`, and flat objects of counts, such as instruction counts. A
//! measurement has regressed if it is worse by more than the tolerance for all values within its interval and the
//! earlier one's; if only the central values are worse by more, the verdict is unclear.

use std::collections::{HashMap, HashSet};
use std::fmt;

use serde::Serialize;
use serde_json::{Map, Value};

use crate::cost::{Interval, Study};
use crate::report::format::percent;

/// Direction in which a measurement improves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Smaller is better: seconds, bytes, errors, counts.
    Less,
    /// Larger is better: rays per second.
    More,
}

/// Named measurement with its interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Measured quantity and the object that it belongs to.
    pub name: String,
    /// Measured value; no value is below 0.
    pub value: Interval,
    /// Direction in which the value improves.
    pub better: Direction,
}

/// Verdict on the change of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RegressionVerdict {
    /// Not worse by more than the tolerance.
    Holds,
    /// Better by more than the tolerance, significantly.
    Improved,
    /// Worse by more than the tolerance, but within the intervals.
    Unclear,
    /// Worse by more than the tolerance, significantly.
    Regressed,
}

impl fmt::Display for RegressionVerdict {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            RegressionVerdict::Holds => "holds",
            RegressionVerdict::Improved => "improved",
            RegressionVerdict::Unclear => "unclear",
            RegressionVerdict::Regressed => "regressed",
        })
    }
}

/// Measurement compared with its earlier value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MetricChange {
    /// Name of the measurement.
    pub name: String,
    /// Direction in which the value improves.
    pub better: Direction,
    /// Value of the earlier measurement.
    pub base: Interval,
    /// Value of the new measurement.
    pub new: Interval,
    /// Relative change for the worse; negative if the value improved.
    pub worse_by: f64,
    /// Verdict under the tolerance.
    pub verdict: RegressionVerdict,
}

/// Comparison of two sets of measurements.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Changes {
    /// Tolerance: largest relative change for the worse that is accepted.
    pub may_be_worse_by: f64,
    /// All measurements in both sets, in the order of the earlier set.
    pub changes: Vec<MetricChange>,
    /// Names of measurements in the earlier set only.
    pub missing: Vec<String>,
    /// Names of measurements in the new set only.
    pub added: Vec<String>,
}

/// Reads the measurements from the text of a JSON file.
///
/// # Errors
///
/// The fault of the text, as the end of a sentence that begins with the file's name.
pub fn measures(text: &str) -> Result<Vec<Measurement>, String> {
    let value: Value = serde_json::from_str(text).map_err(|error| format!("is not JSON: {error}"))?;
    let measures = match &value {
        Value::Array(rows) => bench(rows),
        Value::Object(object) if object.contains_key("points") => {
            let study: Study = serde_json::from_value(value.clone())
                .map_err(|error| format!("is not a report of `whit cost`: {error}"))?;
            Some(cost(&study))
        }
        Value::Object(object) => counts(object),
        _ => None,
    };
    measures.filter(|measures| !measures.is_empty()).ok_or_else(|| {
        "holds no measurements: give a file of `whit bench --json`, the report.json of `whit cost`, or an object of names \
         and counts"
            .to_owned()
    })
}

/// Reads rows of `whit bench`; time and memory of a build are listed once for all rays, as their names repeat.
fn bench(rows: &[Value]) -> Option<Vec<Measurement>> {
    let mut measures: Vec<Measurement> = Vec::new();
    let mut known = HashSet::new();
    for row in rows {
        // Name the row by scene, backend, precision and instancing
        let word = |key: &str| row.get(key).and_then(Value::as_str);
        let mut of = format!("{} {} {}", word("scene")?, word("backend")?, word("precision")?);
        if let Some(instancing) = word("instancing") {
            of += &format!(" {instancing}");
        }
        let mut add = |name: String, value: Interval, better| {
            if known.insert(name.clone()) {
                measures.push(Measurement { name, value, better });
            }
        };
        // Add speed, build time and memory
        let replayed = format!("{of} {} {}", word("rays")?, word("mode")?);
        let (speed, build) = ("mrays_per_s", "build_seconds");
        add(
            format!("{replayed}: Mrays/s"),
            spread(row, speed)?,
            Direction::More,
        );
        add(
            format!("{of}: build seconds"),
            spread(row, build)?,
            Direction::Less,
        );
        let bytes = row.get("bytes").and_then(Value::as_f64)?;
        add(format!("{of}: bytes"), Interval::exact(bytes), Direction::Less);
        // Add values on several threads
        for scaled in list(row, "scaling") {
            let name = format!("{replayed} on {} threads: Mrays/s", scaled.get("threads")?);
            add(name, spread(scaled, speed)?, Direction::More);
        }
        for scaled in list(row, "build_scaling") {
            let name = format!("{of} on {} threads: build seconds", scaled.get("threads")?);
            add(name, spread(scaled, build)?, Direction::Less);
        }
    }
    Some(measures)
}

/// Reads a median with its extremes.
fn spread(object: &Value, key: &str) -> Option<Interval> {
    let number = |key: &str| object.get(key).and_then(Value::as_f64);
    Some(Interval {
        value: number(key)?,
        low: number(&format!("{key}_min"))?,
        high: number(&format!("{key}_max"))?,
    })
}

/// Reads the values of a list; empty where the key is absent.
fn list<'v>(object: &'v Value, key: &str) -> &'v [Value] {
    object.get(key).and_then(Value::as_array).map_or(&[], |list| list)
}

/// Returns times and errors of a study. Times are relative to the base's except for the base itself, so that the
/// machine's speed cancels.
fn cost(study: &Study) -> Vec<Measurement> {
    let points = study.points.iter().flat_map(|point| {
        let name = point
            .knob
            .map_or_else(|| point.level.clone(), |knob| format!("{knob} {}", point.level));
        let (what, time) = match point.knob {
            None => ("seconds", point.seconds),
            Some(_) => ("time over the base's", point.time_ratio),
        };
        let measure = |what: &str, value| Measurement {
            name: format!("{name}: {what}"),
            value,
            better: Direction::Less,
        };
        [measure(what, time), measure("RMSE", point.rmse)]
    });
    points.collect()
}

fn counts(object: &Map<String, Value>) -> Option<Vec<Measurement>> {
    let count = |(name, value): (&String, &Value)| {
        let value = value.as_f64().filter(|&value| value >= 0.0)?;
        Some(Measurement {
            name: name.clone(),
            value: Interval::exact(value),
            better: Direction::Less,
        })
    };
    object.iter().map(count).collect()
}

impl Changes {
    /// Compares `new` with `base`; `may_be_worse_by` is the accepted relative change for the worse.
    pub fn new(base: &[Measurement], new: &[Measurement], may_be_worse_by: f64) -> Changes {
        let by_name: HashMap<&str, &Measurement> =
            new.iter().map(|measure| (&*measure.name, measure)).collect();
        let mut changes = Changes {
            may_be_worse_by,
            changes: Vec::new(),
            missing: Vec::new(),
            added: Vec::new(),
        };
        // Match measurements by name
        let known: HashSet<&str> = base.iter().map(|measure| &*measure.name).collect();
        for measure in base {
            match by_name.get(&*measure.name) {
                Some(new) => changes
                    .changes
                    .push(MetricChange::new(measure, new, may_be_worse_by)),
                None => changes.missing.push(measure.name.clone()),
            }
        }
        let added = new.iter().filter(|measure| !known.contains(&*measure.name));
        changes.added = added.map(|measure| measure.name.clone()).collect();
        changes
    }

    /// Returns the number of measurements with this verdict.
    pub fn count(&self, verdict: RegressionVerdict) -> usize {
        self.changes
            .iter()
            .filter(|change| change.verdict == verdict)
            .count()
    }
}

impl MetricChange {
    fn new(base: &Measurement, new: &Measurement, may_be: f64) -> MetricChange {
        // Compare times: a rate where larger is better is inverted.
        let times = |interval: Interval| match base.better {
            Direction::Less => interval,
            Direction::More => Interval {
                value: 1.0 / interval.value,
                low: 1.0 / interval.high,
                high: 1.0 / interval.low,
            },
        };
        let (before, now) = (times(base.value), times(new.value));
        // Test significance by the ends of the intervals, first for the worse, then for the better
        let limit = 1.0 + may_be;
        let verdict = if now.low > limit * before.high {
            RegressionVerdict::Regressed
        } else if now.value > limit * before.value {
            RegressionVerdict::Unclear
        } else if limit * now.high < before.low {
            RegressionVerdict::Improved
        } else {
            RegressionVerdict::Holds
        };
        MetricChange {
            name: base.name.clone(),
            better: base.better,
            base: base.value,
            new: new.value,
            // Two zeros are equal; their ratio would be NaN.
            worse_by: if now.value == before.value {
                0.0
            } else {
                now.value / before.value - 1.0
            },
            verdict,
        }
    }
}

impl fmt::Display for Changes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        // Print all changes but those that hold
        let is_listed = |change: &&MetricChange| change.verdict != RegressionVerdict::Holds;
        for change in self.changes.iter().filter(is_listed) {
            writeln!(
                f,
                "{:<9} {}: {} -> {} ({})",
                change.verdict.to_string(),
                change.name,
                with_ends(&change.base),
                with_ends(&change.new),
                if change.worse_by > 0.0 {
                    format!("{} worse", percent(change.worse_by))
                } else {
                    format!("{} better", percent(-change.worse_by))
                }
            )?;
        }
        // Print the number of each verdict
        writeln!(
            f,
            "{} measurements: {} regressed by more than {}, {} unclear, {} improved, {} hold",
            self.changes.len(),
            self.count(RegressionVerdict::Regressed),
            percent(self.may_be_worse_by),
            self.count(RegressionVerdict::Unclear),
            self.count(RegressionVerdict::Improved),
            self.count(RegressionVerdict::Holds)
        )?;
        // Print measurements without a counterpart
        for (names, when) in [(&self.missing, "before"), (&self.added, "now")] {
            if let [first, rest @ ..] = &names[..] {
                let more = match rest.len() {
                    0 => String::new(),
                    count => format!(" and {count} more"),
                };
                writeln!(f, "measured only {when}: {first}{more}")?;
            }
        }
        Ok(())
    }
}

/// Formats a value with the ends of its interval, if these differ.
fn with_ends(interval: &Interval) -> String {
    let Interval { value, low, high } = interval;
    if low == high {
        format!("{value:.4}")
    } else {
        format!("{value:.4} ({low:.4} to {high:.4})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measure(value: f64, width: f64, better: Direction) -> Measurement {
        Measurement {
            name: "a".to_owned(),
            value: Interval {
                value,
                low: value - width,
                high: value + width,
            },
            better,
        }
    }

    fn verdict(base: &Measurement, new: &Measurement) -> RegressionVerdict {
        MetricChange::new(base, new, 0.05).verdict
    }

    #[test]
    fn only_significant_changes_for_the_worse_are_regressions() {
        let less = |value, width| measure(value, width, Direction::Less);
        assert_eq!(
            verdict(&less(1.0, 0.0), &less(1.05, 0.0)),
            RegressionVerdict::Holds
        );
        assert_eq!(
            verdict(&less(1.0, 0.0), &less(1.051, 0.0)),
            RegressionVerdict::Regressed
        );
        assert_eq!(
            verdict(&less(1.0, 0.1), &less(1.1, 0.0)),
            RegressionVerdict::Unclear
        );
        assert_eq!(
            verdict(&less(1.0, 0.01), &less(1.2, 0.01)),
            RegressionVerdict::Regressed
        );
        assert_eq!(
            verdict(&less(1.0, 0.01), &less(0.8, 0.01)),
            RegressionVerdict::Improved
        );
        assert_eq!(
            verdict(&less(0.0, 0.0), &less(0.0, 0.0)),
            RegressionVerdict::Holds
        );
        assert_eq!(
            verdict(&less(0.0, 0.0), &less(1.0, 0.0)),
            RegressionVerdict::Regressed
        );
    }

    #[test]
    fn fewer_rays_per_second_are_worse() {
        let more = |value, width| measure(value, width, Direction::More);
        assert_eq!(
            verdict(&more(10.0, 0.1), &more(8.0, 0.1)),
            RegressionVerdict::Regressed
        );
        assert_eq!(
            verdict(&more(10.0, 0.1), &more(12.0, 0.1)),
            RegressionVerdict::Improved
        );
        assert_eq!(
            verdict(&more(10.0, 3.0), &more(8.0, 0.1)),
            RegressionVerdict::Unclear
        );
    }

    #[test]
    fn text_without_measurements_is_an_error() {
        for (text, word) in [
            ("{", "not JSON"),
            ("3", "no measurements"),
            ("{}", "no measurements"),
            ("[]", "no measurements"),
            ("[{\"scene\": 3}]", "no measurements"),
            ("{\"a\": -1}", "no measurements"),
            ("{\"points\": 3}", "whit cost"),
        ] {
            let error = measures(text).unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
        let counts = measures("{\"dark\": 100, \"bright\": 200}").unwrap();
        assert_eq!(counts.len(), 2);
    }

    #[test]
    fn values_on_several_threads_are_separate_measurements() {
        let text = r#"[{"scene": "a", "backend": "bsp", "precision": "watertight", "rays": "camera", "mode": "packet",
            "mrays_per_s": 5, "mrays_per_s_min": 4, "mrays_per_s_max": 6, "bytes": 7,
            "build_seconds": 1, "build_seconds_min": 1, "build_seconds_max": 2,
            "scaling": [{"threads": 4, "mrays_per_s": 15, "mrays_per_s_min": 14, "mrays_per_s_max": 16}],
            "build_scaling": [{"threads": 4, "build_seconds": 0.5, "build_seconds_min": 0.5, "build_seconds_max": 1}]}]"#;
        let read: Vec<(String, f64)> = measures(text)
            .unwrap()
            .into_iter()
            .map(|measure| (measure.name, measure.value.high))
            .collect();
        let expected = [
            ("a bsp watertight camera packet: Mrays/s", 6.0),
            ("a bsp watertight: build seconds", 2.0),
            ("a bsp watertight: bytes", 7.0),
            ("a bsp watertight camera packet on 4 threads: Mrays/s", 16.0),
            ("a bsp watertight on 4 threads: build seconds", 1.0),
        ];
        assert_eq!(read, expected.map(|(name, high)| (name.to_owned(), high)));
    }

    #[test]
    fn measurements_without_a_counterpart_are_named() {
        let named = |name: &str| Measurement {
            name: name.to_owned(),
            ..measure(1.0, 0.0, Direction::Less)
        };
        let changes = Changes::new(&[named("a"), named("b")], &[named("b"), named("c")], 0.05);
        assert_eq!(changes.changes.len(), 1);
        assert_eq!(
            (&changes.missing[..], &changes.added[..]),
            (&["a".to_owned()][..], &["c".to_owned()][..])
        );
        let text = changes.to_string();
        assert!(
            text.contains("only before: a") && text.contains("only now: c"),
            "{text}"
        );
    }
}
