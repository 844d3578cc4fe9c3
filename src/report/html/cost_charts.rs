//! Charts of the page of error against render time.

use super::page::{Bar, DataPoint, Line, PageElement, Row, ScatterChart, Series, SeriesStyle};
use crate::cost::{Curve, Knob, Point, Study};
use crate::report::format::{range, significant, times};
use crate::report::knob_name::BASE;
use crate::report::text::cost::error_ratio;

/// Labels of the charts' axes.
const SECONDS: &str = "seconds per image";
const RMSE: &str = "RMSE as displayed (black 0, white 1)";
/// Width and height in pixels, of the chart of all points and of a single curve.
const LARGE: [f64; 2] = [900.0, 460.0];
const SMALL: [f64; 2] = [345.0, 260.0];

/// Returns the chart of all configurations with the staircase of the Pareto front.
pub(super) fn front(study: &Study) -> PageElement {
    // Create a series for each knob and one for the base
    let knobs = Knob::ALL.into_iter().enumerate();
    let mut series: Vec<Series> = knobs
        .map(|(number, knob)| Series {
            name: knob.name().to_owned(),
            look: SeriesStyle::Number(number),
            points: points_of(study, Some(knob))
                .map(|point| spot(point, ""))
                .collect(),
        })
        .filter(|series| !series.points.is_empty())
        .collect();
    series.push(Series {
        name: BASE.to_owned(),
        look: SeriesStyle::Base,
        points: points_of(study, None).map(|point| spot(point, BASE)).collect(),
    });
    // Draw the front first, so that points cover it
    let chart = ScatterChart {
        size: LARGE,
        x: SECONDS,
        y: RMSE,
        lines: vec![Line {
            class: "front",
            look: SeriesStyle::Base,
            corners: pareto_staircase(study),
        }],
        series,
    };
    PageElement::Scatter(chart.placed())
}

/// Returns the corners of the Pareto staircase: the least error that each time allows, horizontal to the next faster
/// point and then down.
fn pareto_staircase(study: &Study) -> Vec<[f64; 2]> {
    let mut front: Vec<[f64; 2]> = study
        .points
        .iter()
        .filter(|point| point.on_front)
        .map(|point| [point.seconds.value, point.rmse.value])
        .collect();
    front.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut least = f64::INFINITY;
    // The front also has points that are not significantly worse than others: only a smaller error than all before
    // makes a step.
    front.retain(|place| {
        let is_closer = place[1] < least;
        least = least.min(place[1]);
        is_closer
    });
    // Insert a corner between neighbouring points
    let mut corners: Vec<[f64; 2]> = Vec::new();
    for place in front {
        if let Some(&[_, error]) = corners.last() {
            corners.push([place[0], error]);
        }
        corners.push(place);
    }
    corners
}

fn points_of(study: &Study, knob: Option<Knob>) -> impl Iterator<Item = &Point> {
    study.points.iter().filter(move |point| point.knob == knob)
}

fn spot(point: &Point, label: &str) -> DataPoint {
    // Describe the point by level, time, error and settings
    let settings = point
        .settings
        .iter()
        .map(|(name, value)| format!("{name} {value}"));
    let name = match point.knob {
        Some(knob) => format!("{knob} {}", point.level),
        None => BASE.to_owned(),
    };
    let words = format!(
        "{name}{}\n{} s ({})\nRMSE {} ({})\n{}",
        if point.on_front { ", on the front" } else { "" },
        significant(point.seconds.value, 3),
        range(point.seconds, 3),
        significant(point.rmse.value, 3),
        range(point.rmse, 3),
        settings.collect::<Vec<_>>().join(", ")
    );
    DataPoint {
        x: point.seconds,
        y: point.rmse,
        label: label.to_owned(),
        words,
    }
}

/// Returns a chart for each knob with several levels, all with equal axes.
pub(super) fn curves(study: &Study) -> PageElement {
    let charts = study.curves.iter().map(|curve| {
        let caption = format!("{}: {}", curve.knob, slope_words(curve));
        (caption, small_chart(study, curve))
    });
    PageElement::Multiples {
        charts: charts.collect(),
    }
}

fn small_chart(study: &Study, curve: &Curve) -> ScatterChart {
    let points: Vec<&Point> = curve.points.iter().filter_map(|&i| study.points.get(i)).collect();
    // Use the look that the knob has in the chart of all points
    let number = Knob::ALL.iter().position(|&knob| knob == curve.knob);
    let look = SeriesStyle::Number(number.unwrap_or_default());
    let corners = points.iter().map(|point| [point.seconds.value, point.rmse.value]);
    // Join the points, and add the fitted line
    let mut lines = vec![Line {
        class: "joined",
        look,
        corners: corners.clone().collect(),
    }];
    lines.extend(fitted(curve, corners).map(|corners| Line {
        class: "fitted",
        look: SeriesStyle::Base,
        corners: corners.to_vec(),
    }));
    let label = |point: &Point| match point.knob {
        // Labels show the number at the start of the level.
        Some(_) => point
            .level
            .split_whitespace()
            .next()
            .unwrap_or_default()
            .to_owned(),
        None => BASE.to_owned(),
    };
    let chart = ScatterChart {
        size: SMALL,
        x: SECONDS,
        y: "RMSE as displayed",
        lines,
        series: vec![Series {
            name: curve.knob.name().to_owned(),
            look,
            points: points.iter().map(|point| spot(point, &label(point))).collect(),
        }],
    };
    chart.placed()
}

/// Returns the ends of the fitted line through the mean of the points in logarithms, clipped to their times and errors.
fn fitted(curve: &Curve, places: impl Iterator<Item = [f64; 2]>) -> Option<[[f64; 2]; 2]> {
    let slope = curve.slope?.value;
    let logs: Vec<[f64; 2]> = places
        .map(|place| place.map(f64::ln))
        .filter(|place| place.iter().all(|x| x.is_finite()))
        .collect();
    // Find the range and the mean of the logarithms
    let of = |axis: usize| logs.iter().map(move |place| place[axis]);
    let least = |axis| of(axis).fold(f64::INFINITY, f64::min);
    let most = |axis| of(axis).fold(f64::NEG_INFINITY, f64::max);
    let [x, y] = [0, 1].map(|axis| of(axis).sum::<f64>() / logs.len() as f64);
    // Extend the line from the mean to both ends
    let end = |x_end: f64| {
        let rise = slope * (x_end - x);
        let room = if rise > 0.0 { most(1) - y } else { least(1) - y };
        // Clip at the range of the errors.
        let part = if rise.abs() > room.abs() { room / rise } else { 1.0 };
        [x + part * (x_end - x), y + part * rise].map(f64::exp)
    };
    let ends = [end(least(0)), end(most(0))];
    ends.iter().flatten().all(|x| x.is_finite()).then_some(ends)
}

fn slope_words(curve: &Curve) -> String {
    match curve.slope {
        Some(slope) => format!(
            "error ∝ time^{} ({})",
            significant(slope.value, 2),
            range(slope, 2)
        ),
        None => "too few points for a slope".to_owned(),
    }
}

/// Returns the tornado chart of each knob's extreme ratios of time and error.
pub(super) fn extremes(study: &Study) -> PageElement {
    // Create a row of two bars for each knob
    let rows = Knob::ALL.into_iter().filter_map(|knob| {
        let points: Vec<&Point> = points_of(study, Some(knob)).collect();
        if points.is_empty() {
            return None;
        }
        let ratios = |of: &dyn Fn(&Point) -> f64| {
            let all = points.iter().map(|point| (of(point), point.level.as_str()));
            all.collect::<Vec<_>>().into_iter()
        };
        let bars = vec![
            Bar::of("time", ratios(&|point| point.time_ratio.value)),
            Bar::of("error", ratios(&|point| error_ratio(study, point))),
        ];
        let words: Vec<String> = bars.iter().map(bar_words).collect();
        Some(Row {
            name: knob.name(),
            bars,
            words: format!("{knob}\n{}", words.join("\n")),
        })
    });
    PageElement::Tornado {
        label: "ratio to the base",
        rows: rows.collect(),
    }
}

fn bar_words(bar: &Bar) -> String {
    let ends = bar.ends.each_ref().map(|end| {
        let level = if end.level.is_empty() { BASE } else { &end.level };
        format!("{} ({level})", times(end.ratio))
    });
    format!("{} {}", bar.class, ends.join(" to "))
}
