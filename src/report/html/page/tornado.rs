//! Tornado charts: bars from the smallest to the largest ratio of each change, on a binary logarithmic axis around 1.

use std::fmt::Write;

use super::elements::escape;

const WIDTH: f64 = 820.0;
/// Space for names at the left, and beyond either end of the axis for levels, in pixels.
const NAMES: f64 = 110.0;
const END_MARGIN: f64 = 92.0;
/// Margins above and below, in pixels.
const ABOVE: f64 = 8.0;
const BELOW: f64 = 42.0;
/// Height of a bar, and space between two rows of bars, in pixels.
const BAR: f64 = 13.0;
const BETWEEN: f64 = 12.0;
/// Largest power of two that is shown on either side.
const MAX_POWER: f64 = 40.0;
/// Approximate largest number of ticks of the axis.
const TICKS: f64 = 9.0;
/// Largest number of letters of a level; the tooltip has the complete text.
const MAX_LETTERS: usize = 13;

/// End of a bar with the level that causes it.
#[derive(Clone, Debug, PartialEq)]
pub struct End {
    /// Ratio to the unchanged value; 0 is drawn at the end of the axis.
    pub ratio: f64,
    /// Level that has this ratio; empty if no level has.
    pub level: String,
}

/// Bar between two ratios, which are neither NaN nor negative.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Changed quantity, as CSS class and legend text.
    pub class: &'static str,
    /// Ends with the smallest and the largest ratio.
    pub ends: [End; 2],
}

impl Bar {
    /// Returns the bar from the smallest to the largest ratio, with 1 included; NaN ratios are ignored.
    pub fn of<'a>(class: &'static str, ratios: impl Iterator<Item = (f64, &'a str)>) -> Bar {
        let none = End {
            ratio: 1.0,
            level: String::new(),
        };
        let mut ends = [none.clone(), none];
        for (ratio, level) in ratios {
            let end = || End {
                ratio: ratio.max(0.0),
                level: level.to_owned(),
            };
            if ratio < ends[0].ratio {
                ends[0] = end();
            }
            if ratio > ends[1].ratio {
                ends[1] = end();
            }
        }
        Bar { class, ends }
    }

    /// Returns the number of powers of two that the bar spans, as far as they are shown.
    pub fn span(&self) -> f64 {
        let [low, high] = self.powers();
        high - low
    }

    fn powers(&self) -> [f64; 2] {
        [0, 1].map(|i| self.ends[i].ratio.log2().clamp(-MAX_POWER, MAX_POWER))
    }
}

/// Bars of one change, with a common name.
#[derive(Clone, Debug)]
pub struct Row<'a> {
    /// Name of the change.
    pub name: &'a str,
    /// Bars from top to bottom.
    pub bars: Vec<Bar>,
    /// Text of the tooltip.
    pub words: String,
}

/// Tornado chart, with the row of the longest bar at the top.
#[derive(Clone, Debug)]
pub struct Tornado<'a> {
    rows: Vec<Row<'a>>,
    /// Powers of two at the ends of the axis.
    ends: [f64; 2],
}

impl<'a> Tornado<'a> {
    /// Returns the chart of rows in any order.
    pub fn new(mut rows: Vec<Row<'a>>) -> Tornado<'a> {
        // Sort by the longest bar
        let longest = |row: &Row| row.bars.iter().map(Bar::span).fold(0.0, f64::max);
        rows.sort_by(|a, b| longest(b).total_cmp(&longest(a)));
        let powers = || {
            let bars = rows.iter().flat_map(|row| &row.bars);
            // A ratio of 0 must not extend the axis to the largest power.
            bars.flat_map(|bar| bar.powers()).filter(|p| p.abs() < MAX_POWER)
        };
        let ends = [
            powers().fold(-1.0, f64::min).floor(),
            powers().fold(1.0, f64::max).ceil(),
        ];
        Tornado { rows, ends }
    }

    fn across(&self, power: f64) -> f64 {
        let [low, high] = self.ends;
        let place = ((power - low) / (high - low)).clamp(0.0, 1.0);
        NAMES + END_MARGIN + place * (WIDTH - NAMES - 2.0 * END_MARGIN)
    }

    /// Returns the chart as HTML; `x_label` is the label of the axis.
    pub fn html(&self, x_label: &str) -> String {
        // All rows have equal kinds of bars, so that the first one gives the legend.
        let classes = self.rows.first().map_or(&[][..], |row| &row.bars);
        let legend = classes.iter().map(|bar| {
            format!(
                "<span><svg viewBox=\"0 0 16 16\" width=\"16\" height=\"16\" aria-hidden=\"true\">\
                 <rect class=\"{0}\" x=\"1\" y=\"4\" width=\"14\" height=\"8\"/></svg>{0}</span>\n",
                bar.class
            )
        });
        format!(
            "<div class=\"chart\"><div class=\"scroll\">{}</div><p class=\"legend\">{}</p></div>\n",
            self.svg(x_label),
            legend.collect::<String>()
        )
    }

    fn svg(&self, x_label: &str) -> String {
        // Stack the rows, then draw the grid over their height
        let mut rows = String::new();
        let mut y = ABOVE;
        for row in &self.rows {
            y += 0.5 * BETWEEN;
            rows += &self.row(row, y);
            y += row.bars.len() as f64 * BAR + 0.5 * BETWEEN;
        }
        let height = y + BELOW;
        format!(
            "<svg style=\"width:{WIDTH}px\" viewBox=\"0 0 {WIDTH} {height}\" role=\"group\" aria-label=\"{label}\">{}{rows}\
             <text class=\"label\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text></svg>",
            self.grid(y),
            self.across(0.5 * (self.ends[0] + self.ends[1])),
            height - 8.0,
            label = escape(x_label)
        )
    }

    fn grid(&self, foot: f64) -> String {
        // Draw grid lines at whole powers of two
        let [low, high] = self.ends;
        let step = ((high - low) / TICKS).ceil().max(1.0) as i32;
        let mut svg = String::new();
        for power in (low as i32..=high as i32).filter(|power| power % step == 0) {
            let x = self.across(f64::from(power));
            let class = if power == 0 { "zero" } else { "grid" };
            // Writing to a string cannot fail.
            let _ = write!(
                svg,
                "<path class=\"{class}\" d=\"M{x:.1} {ABOVE}V{foot:.1}\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                foot + 15.0,
                tick(power)
            );
        }
        svg
    }

    fn row(&self, row: &Row, top: f64) -> String {
        // Write the name at the middle of the row
        let middle = top + 0.5 * BAR * row.bars.len() as f64;
        let mut svg = format!(
            "<g class=\"point\" role=\"img\"><title>{}</title>\
             <text class=\"label\" x=\"4\" y=\"{:.1}\">{}</text>",
            escape(&row.words),
            middle + 4.0,
            escape(row.name)
        );
        // Draw each bar with the levels at its ends
        for (number, bar) in row.bars.iter().enumerate() {
            let y = top + number as f64 * BAR;
            let [left, right] = bar.powers().map(|power| self.across(power));
            let _ = write!(
                svg,
                "<rect class=\"{}\" x=\"{left:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
                bar.class,
                y + 1.0,
                (right - left).max(1.0),
                BAR - 2.0
            );
            // Write the levels beside both ends
            for (end, x, anchor) in [
                (&bar.ends[0], left - 4.0, "end"),
                (&bar.ends[1], right + 4.0, "start"),
            ] {
                let _ = write!(
                    svg,
                    "<text class=\"level\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>",
                    y + BAR - 3.0,
                    escape(&shortened(&end.level))
                );
            }
        }
        svg + "</g>"
    }
}

/// Formats a power of two as a ratio.
fn tick(power: i32) -> String {
    let ratio = 1u64 << power.unsigned_abs().min(63);
    if power < 0 {
        format!("x1/{ratio}")
    } else {
        format!("x{ratio}")
    }
}

fn shortened(level: &str) -> String {
    if level.chars().count() <= MAX_LETTERS {
        return level.to_owned();
    }
    let kept: String = level.chars().take(MAX_LETTERS - 1).collect();
    format!("{}…", kept.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(ratios: &[f64]) -> Bar {
        Bar::of("time", ratios.iter().map(|&ratio| (ratio, "<level>")))
    }

    fn row(name: &'static str, ratios: &[f64]) -> Row<'static> {
        Row {
            name,
            bars: vec![bar(ratios)],
            words: "a<b".to_owned(),
        }
    }

    #[test]
    fn bar_spans_all_ratios_and_includes_one() {
        assert_eq!(bar(&[0.5, 4.0]).span(), 3.0);
        assert_eq!(bar(&[2.0, 4.0]).span(), 2.0);
        assert_eq!(bar(&[2.0, 4.0]).ends[0].level, "");
        assert_eq!(bar(&[]).span(), 0.0);
        assert_eq!(bar(&[f64::NAN]).span(), 0.0);
    }

    #[test]
    fn longest_bar_comes_first() {
        let tornado = Tornado::new(vec![row("short", &[1.1]), row("long", &[0.1])]);
        let svg = tornado.svg("time");
        assert!(svg.find("long").unwrap() < svg.find("short").unwrap(), "{svg}");
        for name in ["x1/8", "x1/2", "x1<", "x2"] {
            assert!(svg.contains(name), "{name} in {svg}");
        }
    }

    #[test]
    fn invalid_ratios_are_drawn_within_the_axis() {
        let odd = [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300];
        for rows in [vec![row("odd", &odd)], vec![row("none", &[])], Vec::new()] {
            let html = Tornado::new(rows).html("a<b");
            assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
            assert!(!html.contains("a<b") && !html.contains("<level>"), "{html}");
        }
        assert_eq!(Tornado::new(vec![row("odd", &odd)]).ends, [-1.0, 1.0]);
    }

    #[test]
    fn long_level_names_are_truncated() {
        assert_eq!(shortened("1/4096"), "1/4096");
        assert_eq!(shortened("1/2 of the scene's"), "1/2 of the s…");
    }
}
