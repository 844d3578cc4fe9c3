//! Charts of the benchmark page of Embree against the BSP.

use super::page::{BarEntry, Bars, DataPoint, Group, Line, PageElement, ScatterChart, Series, SeriesStyle};
use crate::accel::{Backend, Precision};
use crate::bench::{BenchRow, Mode, RayKind, Scaled};
use crate::cost::Interval;
use crate::report::format::{range, significant};
use crate::report::text::bench::seen_before;
use crate::report::text::table::group_thousands;

/// Labels of the charts' axes.
const SPEED: &str = "million rays per second";
const TRIANGLES: &str = "triangles";
const THREADS: &str = "threads";
/// Width and height of a line chart in pixels.
const SIZE: [f64; 2] = [900.0, 360.0];

/// Colours by tracing method: bare Embree calls, Embree, the native tree and the BSP.
const BARE: SeriesStyle = SeriesStyle::Number(2);
const EMBREE: SeriesStyle = SeriesStyle::Number(0);
const NATIVE: SeriesStyle = SeriesStyle::Number(1);
const BSP: SeriesStyle = SeriesStyle::Number(3);

fn look(row: &BenchRow) -> SeriesStyle {
    match (row.backend, row.mode) {
        (Backend::Embree, Mode::Raw | Mode::RawSingle) => BARE,
        (Backend::Embree, _) => EMBREE,
        (Backend::Native | Backend::Auto, _) => NATIVE,
        (Backend::Bsp | Backend::Brute, _) => BSP,
    }
}

/// Returns all kinds of rays, in the order in which they were measured.
pub(super) fn kinds(rows: &[&BenchRow]) -> Vec<RayKind> {
    let mut kinds = Vec::new();
    for row in rows {
        seen_before(&mut kinds, row.rays);
    }
    kinds
}

/// Returns the name of a row's tracing method within its scene and kind of ray.
pub(super) fn method_name(row: &BenchRow) -> String {
    format!("{}, {}", row.name(), row.mode)
}

/// Returns the bar chart of all methods' speeds in one scene, grouped by kind of ray.
pub(super) fn speeds(rows: &[&BenchRow]) -> PageElement {
    let group = |kind: RayKind| Group {
        name: format!("{kind} rays"),
        bars: rows
            .iter()
            .filter(|row| row.rays == kind)
            .map(|row| BarEntry {
                name: method_name(row),
                look: look(row),
                value: row.speed(),
                label: significant(row.mrays_per_s, 3),
                words: speed_words(row, row.speed()),
            })
            .collect(),
    };
    let legend = [(BARE, "Embree, bare calls"), (EMBREE, "Embree"), (BSP, "BSP")];
    PageElement::Bars(Bars {
        label: "million rays per second on one thread",
        groups: kinds(rows).into_iter().map(group).collect(),
        legend: legend
            .into_iter()
            .filter(|(of, _)| rows.iter().any(|row| look(row) == *of))
            .collect(),
    })
}

fn speed_words(row: &BenchRow, speed: Interval) -> String {
    format!(
        "{}, {} rays\n{} million rays per second ({})",
        method_name(row),
        row.rays,
        significant(speed.value, 3),
        range(speed, 3)
    )
}

/// Named line of a chart with its measured points.
struct ChartLine {
    name: String,
    spots: Vec<DataPoint>,
}

/// Returns a line chart over `x` in which each line has its own look.
fn lines(x: &'static str, y: &'static str, chart_lines: &[ChartLine], more: Vec<Line>) -> PageElement {
    // Join the points of each line
    let joined = |(number, chart_line): (usize, &ChartLine)| Line {
        class: "joined",
        look: SeriesStyle::Number(number),
        corners: chart_line
            .spots
            .iter()
            .map(|spot| [spot.x.value, spot.y.value])
            .collect(),
    };
    // Draw additional lines first, below the measured ones
    let chart = ScatterChart {
        size: SIZE,
        x,
        y,
        lines: more
            .into_iter()
            .chain(chart_lines.iter().enumerate().map(joined))
            .collect(),
        series: chart_lines
            .iter()
            .enumerate()
            .map(|(number, chart_line)| Series {
                name: chart_line.name.clone(),
                look: SeriesStyle::Number(number),
                points: chart_line.spots.clone(),
            })
            .collect(),
    };
    PageElement::Scatter(chart.placed())
}

/// Methods whose lines a sweep shows, at each precision.
const OVER_SIZE: [(Backend, Mode); 8] = [
    (Backend::Embree, Mode::Packet),
    (Backend::Embree, Mode::Single),
    (Backend::Embree, Mode::Raw),
    (Backend::Native, Mode::Single),
    (Backend::Native, Mode::Batch),
    (Backend::Bsp, Mode::Packet),
    (Backend::Bsp, Mode::Single),
    (Backend::Bsp, Mode::Batch),
];

/// Returns charts of speed over mesh size, one for each kind of ray.
pub(super) fn speeds_over_size(rows: &[&BenchRow]) -> Vec<PageElement> {
    let chart = |kind: RayKind| {
        let of_kind = || rows.iter().filter(move |row| row.rays == kind);
        let mut chart_lines = Vec::new();
        // Create a line for each method and precision
        for (backend, mode) in OVER_SIZE {
            let mut precisions: Vec<Precision> = Vec::new();
            for row in of_kind().filter(|row| (row.backend, row.mode) == (backend, mode)) {
                seen_before(&mut precisions, row.precision);
            }
            for precision in precisions {
                let is_it =
                    |row: &&&BenchRow| (row.backend, row.mode, row.precision) == (backend, mode, precision);
                let own: Vec<&&BenchRow> = of_kind().filter(is_it).collect();
                chart_lines.extend(chart_line(&own, method_name, &|row| {
                    Some((row.speed(), speed_words(row, row.speed())))
                }));
            }
        }
        let words = format!("{kind} rays");
        [
            PageElement::subheading(&words),
            lines(TRIANGLES, SPEED, &chart_lines, Vec::new()),
        ]
    };
    kinds(rows).into_iter().flat_map(chart).collect()
}

/// Returns charts of build seconds and of bytes per triangle over mesh size.
pub(super) fn builds_over_size(rows: &[&BenchRow]) -> [PageElement; 4] {
    // Find the distinct acceleration structures
    let mut structures = Vec::new();
    for row in rows {
        seen_before(&mut structures, row.structure());
    }
    let chart_lines = |of: &dyn Fn(&BenchRow) -> Option<(Interval, String)>| -> Vec<ChartLine> {
        let course_of = |structure| {
            let own: Vec<&&BenchRow> = rows.iter().filter(|row| row.structure() == structure).collect();
            chart_line(&own, BenchRow::name, of)
        };
        structures.iter().copied().filter_map(course_of).collect()
    };
    // Collect build times and bytes of each structure
    let seconds = chart_lines(&|row| {
        let build = row.build();
        let words = format!(
            "built in {} s ({}) on {} threads",
            significant(build.value, 3),
            range(build, 3),
            row.threads
        );
        Some((build, format!("{}\n{words}", row.name())))
    });
    // Draw both charts
    let bytes = chart_lines(&|row| {
        let bytes = row.bytes_per_triangle()?;
        let words = format!("{}\n{} bytes per triangle", row.name(), significant(bytes, 3));
        Some((Interval::exact(bytes), words))
    });
    [
        PageElement::subheading("Build time"),
        lines(TRIANGLES, "build seconds", &seconds, Vec::new()),
        PageElement::subheading("Memory"),
        lines(TRIANGLES, "bytes per triangle", &bytes, Vec::new()),
    ]
}

/// Returns the line through the first row of each size; `None` without rows.
fn chart_line(
    rows: &[&&BenchRow],
    name: impl Fn(&BenchRow) -> String,
    of: &dyn Fn(&BenchRow) -> Option<(Interval, String)>,
) -> Option<ChartLine> {
    let mut sizes = Vec::new();
    // Keep the first row of each size
    let first: Vec<_> = rows
        .iter()
        .filter(|row| !seen_before(&mut sizes, row.triangles))
        .collect();
    let spot = |row: &&&&BenchRow| {
        let (y, words) = of(row)?;
        Some(DataPoint {
            x: Interval::exact(row.triangles as f64),
            y,
            label: String::new(),
            words: format!("{} triangles\n{words}", group_thousands(row.triangles)),
        })
    };
    Some(ChartLine {
        name: name(first.first()?),
        spots: first.iter().filter_map(spot).collect(),
    })
}

/// Returns the chart of speed over the number of threads: packets of Embree's first structure and of the BSP, by kind
/// of ray. Dashed lines show ideal scaling of one thread's speed.
pub(super) fn scaling(rows: &[&BenchRow]) -> PageElement {
    // Select one structure for each backend and kind of ray
    let mut ways = Vec::new();
    let is_shown = |row: &&&BenchRow| match (row.backend, row.mode) {
        (Backend::Embree, Mode::Packet) | (Backend::Native | Backend::Bsp | Backend::Brute, Mode::Batch) => {
            !seen_before(&mut ways, (row.backend, row.rays))
        }
        _ => false,
    };
    let shown: Vec<&&BenchRow> = rows.iter().filter(is_shown).collect();
    let mut ideal = Vec::new();
    let chart_lines: Vec<ChartLine> = shown
        .iter()
        .map(|row| {
            // Add the ideal line from the smallest to the largest number of threads
            let ends = [row.scaling.first(), row.scaling.last()].map(|end| end.map(|end| end.threads as f64));
            if let (Some(first), [Some(few), Some(many)]) = (row.scaling.first(), ends) {
                let speed = first.mrays_per_s;
                ideal.push(Line {
                    class: "fitted",
                    look: SeriesStyle::Base,
                    corners: vec![[few, speed], [many, speed * many / few]],
                });
            }
            // Add the measured speeds
            let spot = |scaled: &Scaled| {
                let speed = scaled.speed();
                DataPoint {
                    x: Interval::exact(scaled.threads as f64),
                    y: speed,
                    label: String::new(),
                    words: format!("{} threads\n{}", scaled.threads, speed_words(row, speed)),
                }
            };
            ChartLine {
                name: format!("{} rays: {}", row.rays, method_name(row)),
                spots: row.scaling.iter().map(spot).collect(),
            }
        })
        .collect();
    lines(THREADS, SPEED, &chart_lines, ideal)
}
