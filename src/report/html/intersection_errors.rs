//! Geometric errors on the page of error against render time: leaks, false hits and false shadows.

use super::page::{Cell, Column, DataPoint, PageElement, ScatterChart, Series, SeriesStyle, Table};
use crate::cost::{GeometricErrors, Interval, Knob, Point, Study};
use crate::report::format::{range, significant, times};
use crate::report::knob_name::{BASE, knob_name};
use crate::report::memory;
use crate::report::text::intersection_errors::{counted, kinds};

/// Labels of the chart's axes.
const SECONDS: &str = "seconds per image";
const WRONG: &str = "wrong results per million rays";
/// Width and height of the chart in pixels.
const SIZE: [f64; 2] = [700.0, 300.0];

/// Returns the section of the page; empty where no errors were counted.
pub(super) fn section(study: &Study) -> Vec<PageElement> {
    if counted(study).next().is_none() {
        return Vec::new();
    }
    vec![
        PageElement::named_heading("geometry", "Geometric errors"),
        PageElement::text(
            "The rays of the scene’s own image, traced on every intersection path and compared with the BSP, which \
         decides in f64 where f32 cannot. A result is wrong if no ray within rounding in f32 of it has that result; \
         otherwise it is a tie, as at an outline. Crosses are 95 % confidence intervals of the share. \
         At the foot no result was wrong.",
        ),
        chart(study),
        table(study),
    ]
}

fn chart(study: &Study) -> PageElement {
    // Collect the points of each knob
    let of_knob = |knob: Option<Knob>| {
        let points = counted(study).filter(move |(point, _)| point.knob == knob);
        points.map(|(point, errors)| spot(point, errors)).collect()
    };
    // Create a series for each knob and one for the base, with the looks of the chart of all points
    let turned = Knob::ALL.into_iter().enumerate().map(|(number, knob)| Series {
        name: knob.name().to_owned(),
        look: SeriesStyle::Number(number),
        points: of_knob(Some(knob)),
    });
    let base = Series {
        name: BASE.to_owned(),
        look: SeriesStyle::Base,
        points: of_knob(None),
    };
    let chart = ScatterChart {
        size: SIZE,
        x: SECONDS,
        y: WRONG,
        lines: Vec::new(),
        series: turned
            .chain([base])
            .filter(|series| !series.points.is_empty())
            .collect(),
    };
    PageElement::Scatter(chart.placed())
}

fn a_million(errors: &GeometricErrors) -> Interval {
    errors.share().map(|share| 1e6 * share)
}

fn spot(point: &Point, errors: &GeometricErrors) -> DataPoint {
    // Show wrong results per million rays, as shares are small
    let wrong = a_million(errors);
    let name = match point.knob {
        Some(knob) => format!("{knob} {}", point.level),
        None => BASE.to_owned(),
    };
    let words = format!(
        "{name}\n{} s\n{} of {} rays are wrong, {} per million ({})\n{}",
        significant(point.seconds.value, 3),
        errors.count(),
        errors.rays(),
        significant(wrong.value, 3),
        range(wrong, 3),
        kinds(errors)
    );
    DataPoint {
        x: point.seconds,
        y: wrong,
        label: point.level.clone(),
        words,
    }
}

fn table(study: &Study) -> PageElement {
    // Give time, build and memory beside the counts, as accuracy costs these
    let mut table = Table::new(
        "wide dense geometry",
        &[
            Column::Words("parameter"),
            Column::Words("level"),
            Column::Numbers("time"),
            Column::Numbers("build"),
            Column::Numbers("memory"),
            Column::Numbers("camera rays"),
            Column::Numbers("leaks"),
            Column::Numbers("false hits"),
            Column::Numbers("shadow rays"),
            Column::Numbers("false shadows"),
            Column::Numbers("light leaks"),
            Column::Numbers("ties"),
        ],
    );
    // Add a row for each point with counted errors
    for (point, errors) in counted(study) {
        let cells = [
            Cell::text(knob_name(point)),
            Cell::text(&point.level),
            Cell::text(&times(point.time_ratio.value)),
            Cell::text(&format!("{} s", significant(point.build_seconds, 2))),
            Cell::text(&memory::in_words(point.build_bytes)),
            Cell::count(errors.camera_rays),
            Cell::count(errors.leaks),
            Cell::count(errors.false_hits),
            Cell::count(errors.shadow_rays),
            Cell::count(errors.false_shadows),
            Cell::count(errors.light_leaks),
            Cell::count(errors.ties),
        ];
        table.row(("", knob_name(point)), &cells);
    }
    PageElement::Table(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::html::cost_page::tests::study;
    use crate::report::text::intersection_errors::lines;

    #[test]
    fn errors_are_listed_only_where_counted() {
        let mut study = study();
        assert_eq!((section(&study).len(), lines(&study).len()), (0, 0));
        // Count no errors for the base
        let none = GeometricErrors {
            camera_rays: 600,
            shadow_rays: 400,
            ..GeometricErrors::default()
        };
        study.points[0].geometry = Some(none);
        assert_eq!(
            lines(&study),
            ["geometry: none of up to 1000 rays has a wrong result on any path"]
        );
        // Count errors for another configuration
        study.points[1].geometry = Some(GeometricErrors {
            leaks: 3,
            false_shadows: 7,
            ..none
        });
        assert_eq!(
            lines(&study),
            ["geometry: samples 16: 3 leaks, 0 false hits, 7 false shadows, 0 light leaks of 1000 rays"]
        );
        let json = serde_json::to_string(&section(&study)).unwrap();
        // 10 of 1000 rays are wrong.
        assert!(
            json.contains("1.00e4 per million") || json.contains("10000 per million"),
            "{json}"
        );
        assert!(
            json.contains(r#""id":"geometry""#) && !json.contains("NaN"),
            "{json}"
        );
        assert_eq!(json.matches(r#""x":["#).count(), 2, "{json}");
    }
}
