//! Charts of pages in a browser: axes, ticks, labels and odd values.

use std::fs;
use std::sync::LazyLock;

use crate::support::browser::{chromium, is_clean, looked_at};
use serde_json::{Value, json};
use whit::cost::Interval;
use whit::report::page::{
    Bar, BarEntry, Bars, DataPoint, Group, Line, Mark, PageElement, Plot, Row, ScatterChart, Series,
    SeriesStyle, Stack, Stacks, page,
};

const ODD: Interval = Interval {
    value: f64::NAN,
    low: f64::NEG_INFINITY,
    high: f64::INFINITY,
};

/// Places and texts of each chart's SVG.
const PROBE: &str = r##"
  const number = (element, name) => Number(element.getAttribute(name));
  const drawings = [...document.querySelectorAll("main svg[aria-label]")];
  const found = {
    texts: drawings.map((drawing) => [...drawing.querySelectorAll("text:not(.level):not(.label)")].map((text) => text.textContent)),
    levels: drawings.map((drawing) => [...drawing.querySelectorAll("text.level")].map((text) => text.textContent)),
    names: drawings.map((drawing) => [...drawing.querySelectorAll(".point text.label")].map((text) => text.textContent)),
    marks: drawings.map((drawing) => [...drawing.querySelectorAll(".mark")].map((mark) => {
      const box = mark.getBBox();
      return [box.x + 0.5 * box.width, box.y + 0.5 * box.height].map(Math.round);
    })),
    rects: drawings.map((drawing) => [...drawing.querySelectorAll("rect")].map((rect) => ["y", "width", "height"].map((name) => number(rect, name)))),
    whiskers: drawings.map((drawing) => [...drawing.querySelectorAll("path.whisker")].map((path) => path.getAttribute("d"))),
    circles: drawings.map((drawing) => [...drawing.querySelectorAll("circle")].map((circle) => [number(circle, "cx"), number(circle, "cy")])),
    looks: new Set([...document.querySelectorAll(".mark")].map((mark) => mark.getAttribute("class") + mark.getAttribute("d").replace(/^M \S+ \S+/, ""))).size,
    failed: document.querySelectorAll(".failed").length,
    bad: [...document.querySelectorAll("svg *")].filter((mark) => [...mark.attributes].some((a) => /NaN|Infinity|undefined|null/.test(a.value))).length,
    bold: document.querySelectorAll("main b").length,
  };
  return found;
"##;

/// Charts that several tests look at, as the browser draws them; absent without a browser.
type Drawn = LazyLock<Option<Value>>;

fn probed(browser: &str, elements: &[PageElement]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("charts.html");
    fs::write(&path, page("charts", "charts", elements)).unwrap();
    let found = looked_at(browser, &path, PROBE, &["--window-size=1200,900"]);
    is_clean(&found);
    assert_eq!([&found["bad"], &found["bold"]], [0, 0], "{found}");
    found
}

fn point(x: Interval, y: Interval) -> DataPoint {
    DataPoint {
        x,
        y,
        label: "a<b>".to_owned(),
        words: "c<b>".to_owned(),
    }
}

fn scatter(points: Vec<DataPoint>) -> ScatterChart {
    ScatterChart {
        size: [400.0, 300.0],
        x: "x<b>",
        y: "y<b>",
        lines: Vec::new(),
        series: vec![Series {
            name: "all<b>".to_owned(),
            look: SeriesStyle::Number(0),
            points,
        }],
    }
}

fn at(x: f64, y: f64) -> DataPoint {
    point(Interval::exact(x), Interval::exact(y))
}

static POINTS: Drawn = LazyLock::new(|| {
    let zero = scatter(vec![at(1.0, 0.0), at(1.0, 0.1), at(1.0, -1.0)]);
    let mut odd = scatter(vec![point(Interval::exact(1.0), ODD), point(ODD, ODD)]);
    odd.lines.push(Line {
        class: "front",
        look: SeriesStyle::Base,
        corners: vec![[f64::NAN, 1.0], [f64::INFINITY, f64::NAN], [0.0, 0.0]],
    });
    let one = scatter(vec![at(3.0, 0.5)]);
    let charts = [zero, odd.placed(), one, scatter(Vec::new())].map(PageElement::Scatter);
    chromium().map(|browser| probed(browser, &charts))
});

#[test]
fn points_without_error_are_at_the_foot() {
    let Some(found) = &*POINTS else { return };
    // The foot is 44 pixels above the lower edge
    let marks = &found["marks"][0];
    assert_eq!([&marks[0][1], &marks[2][1]], [256, 256], "{found}");
    assert!(marks[1][1].as_f64().unwrap() < 246.0, "{found}");
    assert!(
        found["texts"][0].as_array().unwrap().contains(&json!("0")),
        "{found}"
    );
}

#[test]
fn non_finite_points_are_at_the_top_or_omitted() {
    let Some(found) = &*POINTS else { return };
    // The top is 12 pixels below the upper edge
    let marks = &found["marks"][1];
    assert_eq!(marks.as_array().unwrap().len(), 1, "{found}");
    assert_eq!(marks[0][1], 12, "{found}");
}

#[test]
fn single_point_is_in_the_middle_and_no_point_gives_an_empty_chart() {
    let Some(found) = &*POINTS else { return };
    // The axes reach from 62 to 384 and from 12 to 256
    assert_eq!(found["marks"][2], json!([[223, 134]]), "{found}");
    assert_eq!(found["marks"][3], json!([]), "{found}");
}

static TICKS: Drawn = LazyLock::new(|| {
    let to = |high: f64| PageElement::Scatter(scatter(vec![at(1.0, 1.0), at(high, 1.0)]));
    chromium().map(|browser| probed(browser, &[to(3.0), to(100.0), to(1e9)]))
});

/// Returns the first names below the horizontal axis.
fn ticks(found: &Value, chart: usize, count: usize) -> Vec<&str> {
    let texts = found["texts"][chart].as_array().unwrap();
    texts[..count].iter().filter_map(Value::as_str).collect()
}

#[test]
fn ticks_within_a_decade_have_even_steps() {
    let Some(found) = &*TICKS else { return };
    assert_eq!(ticks(found, 0, 5), ["1.0", "1.5", "2.0", "2.5", "3.0"], "{found}");
}

#[test]
fn ticks_of_two_decades_are_1_2_and_5() {
    let Some(found) = &*TICKS else { return };
    assert_eq!(
        ticks(found, 1, 7),
        ["1", "2", "5", "10", "20", "50", "100"],
        "{found}"
    );
}

#[test]
fn ticks_of_many_decades_are_powers_of_ten() {
    let Some(found) = &*TICKS else { return };
    assert_eq!(ticks(found, 2, 5), ["1", "100", "10000", "1e6", "1e8"], "{found}");
}

#[test]
fn names_of_ticks_do_not_touch() {
    let Some(browser) = chromium() else { return };
    let narrow = ScatterChart {
        size: [345.0, 260.0],
        ..scatter(vec![at(0.0035, 1.0), at(0.0255, 1.0)])
    };
    let found = probed(browser, &[PageElement::Scatter(narrow)]);
    // Five lines fit, 0.005 to 0.025; the names 0.020 and 0.025 would touch
    let names = found["texts"][0].as_array().unwrap();
    let is_named = |name: &str| names.contains(&json!(name));
    assert!(is_named("0.005") && is_named("0.010"), "{found}");
    assert!(!(is_named("0.020") && is_named("0.025")), "{found}");
}

#[test]
fn labels_overlap_neither_points_nor_each_other() {
    let Some(browser) = chromium() else { return };
    let close = scatter((0..9).map(|_| at(1.0, 1.0)).collect());
    let apart = scatter(vec![at(1.0, 1.0), at(100.0, 1.0)]);
    let found = probed(browser, &[close, apart].map(PageElement::Scatter));
    let count = |chart: usize| found["levels"][chart].as_array().unwrap().len();
    assert!((1..=4).contains(&count(0)), "{found}");
    assert_eq!(count(1), 2, "{found}");
}

#[test]
fn twenty_four_series_look_different() {
    let Some(browser) = chromium() else { return };
    let mut chart = scatter(Vec::new());
    chart.series = (0..24)
        .map(|number| Series {
            name: String::new(),
            look: SeriesStyle::Number(number),
            points: vec![at(1.0, 1.0)],
        })
        .collect();
    let found = probed(browser, &[PageElement::Scatter(chart)]);
    assert_eq!(found["looks"], 24, "{found}");
}

#[test]
fn bar_lengths_are_proportional_to_values() {
    let Some(browser) = chromium() else { return };
    let bars = |values: &[Interval]| {
        let bar = |&value: &Interval| BarEntry {
            name: "a<b>".to_owned(),
            look: SeriesStyle::Number(0),
            value,
            label: "c<b>".to_owned(),
            words: "e<b>".to_owned(),
        };
        PageElement::Bars(Bars {
            label: "g<b>",
            groups: vec![Group {
                name: "i<b>".to_owned(),
                bars: values.iter().map(bar).collect(),
            }],
            legend: Vec::new(),
        })
    };
    let ranged = Interval {
        value: 4.0,
        low: 2.0,
        high: 8.0,
    };
    let found = probed(
        browser,
        &[
            bars(&[ranged, Interval::exact(8.0)]),
            bars(&[ODD, Interval::exact(3.0)]),
            bars(&[Interval::exact(0.0)]),
            bars(&[]),
        ],
    );
    // 8 takes the 861 - 235 - 58 = 568 pixels between the names and the labels.
    let widths = [0, 1].map(|bar| &found["rects"][0][bar][1]);
    assert_eq!(widths, [284.0, 568.0], "{found}");
    assert_eq!(found["whiskers"][0][0], "M 377.0 34.0 H 803.0", "{found}");
    assert_eq!(found["rects"][1][0][1], 1.0, "{found}");
}

static STACKS: Drawn = LazyLock::new(|| {
    let stacks = |all: &[&[f64]]| {
        let stack = |parts: &&[f64]| Stack {
            parts: parts.to_vec(),
            is_wrong: parts.is_empty(),
            words: "a<b>".to_owned(),
        };
        PageElement::Stacks(Stacks {
            x_label: "c<b>",
            y_label: "e<b>",
            parts: vec![(SeriesStyle::Number(0), "g<b>"), (SeriesStyle::Number(1), "i")],
            stacks: all.iter().map(stack).collect(),
        })
    };
    let thousand = [&[1.0][..]; 1000];
    let charts = [
        stacks(&[&[1.0, 3.0], &[2.0, 0.0]]),
        stacks(&[&[], &[1.0]]),
        stacks(&[&[f64::NAN, f64::INFINITY], &[0.0, -1.0]]),
        stacks(&thousand),
        stacks(&[]),
    ];
    chromium().map(|browser| probed(browser, &charts))
});

#[test]
fn stacked_parts_reach_the_top_together() {
    let Some(found) = &*STACKS else { return };
    // A height of 4 takes 184 pixels above a foot at 198: 46 for 1, 138 for 3 above it, 92 for 2.
    let rects = found["rects"][0].as_array().unwrap();
    let first = json!([[152, 24, 46], [14, 24, 138], [106, 24, 92]]);
    assert_eq!(json!(rects[..3]), first, "{found}");
}

#[test]
fn failed_columns_are_marked() {
    let Some(found) = &*STACKS else { return };
    assert_eq!(found["failed"], 1, "{found}");
}

#[test]
fn first_column_and_round_numbers_are_labelled() {
    let Some(found) = &*STACKS else { return };
    let numbers = found["texts"][3].as_array().unwrap();
    assert_eq!(
        numbers[numbers.len() - 6..],
        ["1", "200", "400", "600", "800", "1000"],
        "{found}"
    );
}

static TORNADOES: Drawn = LazyLock::new(|| {
    let row = |name, ratios: &[f64]| Row {
        name,
        bars: vec![Bar::of(
            "time",
            ratios.iter().map(|&ratio| (ratio, "1/2 of the scene's")),
        )],
        words: "a<b>".to_owned(),
    };
    let tornado = |rows| PageElement::Tornado { label: "e<b>", rows };
    let odd = [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300];
    let charts = [
        tornado(vec![row("short", &[1.1]), row("long", &[0.1])]),
        tornado(vec![row("odd", &odd)]),
        tornado(vec![row("none", &[])]),
        tornado(Vec::new()),
    ];
    chromium().map(|browser| probed(browser, &charts))
});

#[test]
fn longest_bar_of_a_tornado_is_at_the_top() {
    let Some(found) = &*TORNADOES else { return };
    assert_eq!(found["names"][0], json!(["long", "short"]), "{found}");
}

#[test]
fn ticks_of_a_tornado_are_powers_of_two() {
    let Some(found) = &*TORNADOES else { return };
    let ticks = found["texts"][0].as_array().unwrap();
    for name in ["x1/8", "x1/2", "x1", "x2"] {
        assert!(ticks.contains(&json!(name)), "{name} in {found}");
    }
}

#[test]
fn long_names_of_levels_are_cut() {
    let Some(found) = &*TORNADOES else { return };
    assert_eq!(found["levels"][0][0], "1/2 of the s…", "{found}");
}

#[test]
fn ratios_of_zero_and_infinity_do_not_extend_the_axis() {
    let Some(found) = &*TORNADOES else { return };
    assert_eq!(found["texts"][1], json!(["x1/2", "x1", "x2"]), "{found}");
}

static PLOTS: Drawn = LazyLock::new(|| {
    let plot = |places: &[[f64; 2]]| {
        PageElement::Plot(Plot {
            x_label: "t<b>".to_owned(),
            y_label: "error<b>".to_owned(),
            limit: 1.0,
            marks: places
                .iter()
                .map(|&[x, y]| Mark { x, y, class: "right" })
                .collect(),
        })
    };
    let charts = [
        plot(&[[0.0, 0.5], [10.0, 9.0], [5.0, f64::NAN]]),
        plot(&[[1.0, 1e-6], [1e6, 1e-12]]),
        plot(&[]),
    ];
    chromium().map(|browser| probed(browser, &charts))
});

#[test]
fn errors_far_above_the_limit_or_not_finite_are_at_the_top() {
    let Some(found) = &*PLOTS else { return };
    assert_eq!(
        [&found["circles"][0][1][1], &found["circles"][0][2][1]],
        [14.0; 2],
        "{found}"
    );
}

#[test]
fn errors_far_below_the_limit_are_separated_by_decade() {
    let Some(found) = &*PLOTS else { return };
    // Both axes are logarithmic; the error below 1/4096 of the largest is at its foot
    let texts = found["texts"][1].as_array().unwrap();
    assert!(
        texts.contains(&json!("1e6")) && texts.contains(&json!("1e-6")),
        "{found}"
    );
    assert_eq!(found["circles"][1][1][1], 218.0, "{found}");
}

#[test]
fn empty_plot_has_its_bound() {
    let Some(found) = &*PLOTS else { return };
    assert!(
        found["texts"][2].as_array().unwrap().contains(&json!("bound")),
        "{found}"
    );
}
