//! Groups of horizontal bars over a linear axis from 0, each with the range of its value.

use std::fmt::Write;

use super::chart::SeriesStyle;
use super::elements::escape;
use super::plot::even_ticks;
use crate::cost::Interval;

const WIDTH: f64 = 861.0;
/// Space for names at the left, and for labels behind a bar, in pixels.
const NAMES: f64 = 235.0;
const BEHIND: f64 = 58.0;
/// Margins above and below, and height of a group's heading, in pixels.
const ABOVE: f64 = 4.0;
const BELOW: f64 = 42.0;
const HEADING: f64 = 22.0;
/// Height of a bar with the space to the next, in pixels.
const BAR: f64 = 16.0;

/// Horizontal bar with its range.
#[derive(Clone, Debug)]
pub struct BarEntry {
    /// Name at the left of the bar.
    pub name: String,
    /// Colour of the bar.
    pub look: SeriesStyle,
    /// Length of the bar and its range.
    pub value: Interval,
    /// Label behind the bar.
    pub label: String,
    /// Text of the tooltip.
    pub words: String,
}

/// Bars below a common heading.
#[derive(Clone, Debug)]
pub struct Group {
    /// Heading of the group.
    pub name: String,
    /// Bars from top to bottom.
    pub bars: Vec<BarEntry>,
}

/// Returns a chart as HTML with a legend of its colours below.
pub(super) fn with_legend(svg: &str, colors: &[(SeriesStyle, &str)]) -> String {
    let legend = colors.iter().map(|(look, name)| {
        format!(
            "<span><svg viewBox=\"0 0 16 16\" width=\"16\" height=\"16\" aria-hidden=\"true\">\
             <rect class=\"bar {}\" x=\"1\" y=\"4\" width=\"14\" height=\"8\"/></svg>{}</span>\n",
            look.class(),
            escape(name)
        )
    });
    format!(
        "<div class=\"chart\"><div class=\"scroll\">{svg}</div><p class=\"legend\">{}</p></div>\n",
        legend.collect::<String>()
    )
}

/// Groups of bars with a common axis; a value that is not finite has no length.
#[derive(Clone, Debug)]
pub struct Bars<'a> {
    /// Label of the axis, with the unit.
    pub label: &'a str,
    /// Groups from top to bottom.
    pub groups: Vec<Group>,
    /// Meanings of the colours.
    pub legend: Vec<(SeriesStyle, &'a str)>,
}

impl Bars<'_> {
    /// Returns the chart as HTML, with a legend below.
    pub fn html(&self) -> String {
        with_legend(&self.svg(), &self.legend)
    }

    /// Returns the largest end of all ranges; 1 if there is none.
    fn most(&self) -> f64 {
        let bars = self.groups.iter().flat_map(|group| &group.bars);
        // Ignore ends that are not finite
        let ends = bars.flat_map(|bar| [bar.value.value, bar.value.high]);
        let most = ends.filter(|end| end.is_finite()).fold(0.0, f64::max);
        if most > 0.0 { most } else { 1.0 }
    }

    fn svg(&self) -> String {
        let most = self.most();
        // Map values to pixels
        let across = |value: f64| {
            let part = if value.is_finite() {
                (value / most).clamp(0.0, 1.0)
            } else {
                0.0
            };
            NAMES + part * (WIDTH - NAMES - BEHIND)
        };
        // Draw the bars of each group below its heading
        let mut rows = String::new();
        let mut y = ABOVE;
        for group in &self.groups {
            // Writing to a string cannot fail.
            let _ = write!(
                rows,
                "<text class=\"label\" x=\"4\" y=\"{:.1}\">{}</text>",
                y + HEADING - 7.0,
                escape(&group.name)
            );
            y += HEADING;
            for bar in &group.bars {
                rows += &row(bar, y, across);
                y += BAR;
            }
        }
        // Draw the grid, whose height is known after the rows
        let mut grid = String::new();
        for (value, name) in even_ticks(0.0, most) {
            let x = across(value);
            let _ = write!(
                grid,
                "<path class=\"grid\" d=\"M{x:.1} {ABOVE}V{y:.1}\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{name}</text>",
                y + 15.0
            );
        }
        format!(
            "<svg style=\"width:{WIDTH}px\" viewBox=\"0 0 {WIDTH} {height}\" role=\"group\" aria-label=\"{label}\">\
             {grid}{rows}<text class=\"label\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text></svg>",
            0.5 * (NAMES + WIDTH - BEHIND),
            y + BELOW - 8.0,
            height = y + BELOW,
            label = escape(self.label)
        )
    }
}

fn row(bar: &BarEntry, top: f64, across: impl Fn(f64) -> f64) -> String {
    let Interval { value, low, high } = bar.value;
    // Draw the bar from 0 to the value, and a line over its range
    let [left, end, low, high] = [0.0, value, low, high].map(across);
    let middle = top + 0.5 * BAR;
    format!(
        "<g class=\"point\" role=\"img\"><title>{}</title>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>\
         <rect class=\"bar {}\" x=\"{left:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>\
         <path class=\"met\" d=\"M{low:.1} {middle:.1}H{high:.1}\"/>\
         <text class=\"level\" x=\"{:.1}\" y=\"{:.1}\">{}</text></g>",
        escape(&bar.words),
        left - 6.0,
        middle + 4.0,
        escape(&bar.name),
        bar.look.class(),
        top + 1.5,
        (end - left).max(1.0),
        BAR - 3.0,
        high.max(end) + 5.0,
        middle + 4.0,
        escape(&bar.label)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bars(values: &[Interval]) -> String {
        let bar = |&value: &Interval| BarEntry {
            name: "a<b".to_owned(),
            look: SeriesStyle::Number(0),
            value,
            label: "c<d".to_owned(),
            words: "e<f".to_owned(),
        };
        Bars {
            label: "g<h",
            groups: vec![Group {
                name: "i<j".to_owned(),
                bars: values.iter().map(bar).collect(),
            }],
            legend: vec![(SeriesStyle::Base, "k<l")],
        }
        .html()
    }

    #[test]
    fn bar_lengths_are_proportional_to_values() {
        let html = bars(&[
            Interval {
                value: 4.0,
                low: 2.0,
                high: 8.0,
            },
            Interval::exact(8.0),
        ]);
        let room = WIDTH - NAMES - BEHIND;
        for width in [0.5 * room, room] {
            assert!(
                html.contains(&format!("width=\"{width:.1}\"")),
                "{width} in {html}"
            );
        }
        for place in ["M377.0 34.0H803.0", ">0<", ">8<"] {
            assert!(html.contains(place), "{place} in {html}");
        }
    }

    #[test]
    fn non_finite_values_and_empty_charts_are_drawn() {
        let odd = Interval {
            value: f64::NAN,
            low: f64::NEG_INFINITY,
            high: f64::INFINITY,
        };
        for values in [
            &[][..],
            &[odd],
            &[Interval::exact(0.0)],
            &[odd, Interval::exact(3.0)],
        ] {
            let html = bars(values);
            assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
            for text in ["a<b", "c<d", "e<f", "g<h", "i<j", "k<l"] {
                assert!(!html.contains(text), "{text} in {html}");
            }
        }
    }
}
