//! Stacked column charts over a linear axis from 0.

use std::fmt::Write;

use super::bars::with_legend;
use super::chart::SeriesStyle;
use super::elements::escape;
use super::plot::even_ticks;

const WIDTH: f64 = 861.0;
const HEIGHT: f64 = 240.0;
/// Margins for labels in pixels: left, bottom, and a smaller one at the top and right.
const LEFT: f64 = 52.0;
const BELOW: f64 = 42.0;
const BESIDE: f64 = 14.0;
/// Largest fraction of its space that a column fills, and the largest width in pixels.
const FILLED: f64 = 0.85;
const WIDEST: f64 = 24.0;
/// Height in pixels of the mark of a failed column.
const FOOT: f64 = 7.0;

/// Column of a stacked chart.
#[derive(Clone, Debug)]
pub struct Stack {
    /// Heights of the parts, from bottom to top.
    pub parts: Vec<f64>,
    /// True if the column is marked as failed.
    pub is_wrong: bool,
    /// Text of the tooltip.
    pub words: String,
}

/// Stacked columns in order, numbered from 1.
#[derive(Clone, Debug)]
pub struct Stacks<'a> {
    /// Label of the horizontal axis.
    pub x_label: &'a str,
    /// Label of the vertical axis.
    pub y_label: &'a str,
    /// Colours and names of the parts, from bottom to top.
    pub parts: Vec<(SeriesStyle, &'a str)>,
    /// Columns from left to right.
    pub stacks: Vec<Stack>,
}

impl Stacks<'_> {
    /// Returns the chart as HTML, with a legend below.
    pub fn html(&self) -> String {
        with_legend(&self.svg(), &self.parts)
    }

    fn svg(&self) -> String {
        // Scale the highest column to the plot's height
        let height = |stack: &Stack| stack.parts.iter().map(|&part| finite_or_zero(part)).sum::<f64>();
        let most = self.stacks.iter().map(height).fold(0.0, f64::max);
        let most = if most > 0.0 { most } else { 1.0 };
        let place = (WIDTH - LEFT - BESIDE) / self.stacks.len().max(1) as f64;
        let up = |value: f64| HEIGHT - BELOW - value / most * (HEIGHT - BELOW - BESIDE);
        let mut svg = format!(
            "<svg style=\"width:{WIDTH}px\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"group\" aria-label=\"{} over {}\">",
            escape(self.y_label),
            escape(self.x_label)
        );
        // Draw the grid of the vertical axis and the column numbers. Writing to a string cannot fail.
        for (value, name) in even_ticks(0.0, most) {
            let y = up(value);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{:.1}\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{name}</text>",
                WIDTH - BESIDE,
                LEFT - 6.0,
                y + 4.0
            );
        }
        for number in ticks(self.stacks.len()) {
            let _ = write!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{number}</text>",
                LEFT + (number as f64 - 0.5) * place,
                HEIGHT - BELOW + 15.0
            );
        }
        // Draw the columns
        for (number, stack) in self.stacks.iter().enumerate() {
            svg += &self.column(stack, [LEFT + number as f64 * place, place], up);
        }
        let _ = write!(
            svg,
            "<text class=\"label\" x=\"{0:.1}\" y=\"{1:.1}\" text-anchor=\"middle\">{2}</text>\
             <text class=\"label\" x=\"12\" y=\"{3:.1}\" text-anchor=\"middle\" \
             transform=\"rotate(-90 12 {3:.1})\">{4}</text></svg>",
            0.5 * (LEFT + WIDTH - BESIDE),
            HEIGHT - 6.0,
            escape(self.x_label),
            0.5 * (HEIGHT - BELOW),
            escape(self.y_label)
        );
        svg
    }

    /// Returns a column within its space, given by left edge and width.
    fn column(&self, stack: &Stack, [left, room]: [f64; 2], up: impl Fn(f64) -> f64) -> String {
        let width = (FILLED * room).min(WIDEST);
        let left = left + 0.5 * (room - width);
        let mut html = format!(
            "<g class=\"point\" role=\"img\"><title>{}</title>",
            escape(&stack.words)
        );
        // Stack the parts from bottom to top
        let mut below = 0.0;
        for (&part, (look, _)) in stack.parts.iter().zip(&self.parts) {
            let above = below + finite_or_zero(part);
            // Writing to a string cannot fail.
            let _ = write!(
                html,
                "<rect class=\"bar {}\" x=\"{left:.2}\" y=\"{:.1}\" width=\"{width:.2}\" height=\"{:.1}\"/>",
                look.class(),
                up(above),
                up(below) - up(above)
            );
            below = above;
        }
        // Mark a failed column at its foot
        if stack.is_wrong {
            let foot = up(0.0);
            let _ = write!(
                html,
                "<rect class=\"failed\" x=\"{left:.2}\" y=\"{:.1}\" width=\"{width:.2}\" height=\"{FOOT}\"/>",
                foot - FOOT
            );
        }
        html + "</g>"
    }
}

/// Returns the height, or 0 if it is negative or not finite.
fn finite_or_zero(part: f64) -> f64 {
    if part.is_finite() { part.max(0.0) } else { 0.0 }
}

/// Returns the column numbers that are written below the axis: the first, and round ones.
fn ticks(count: usize) -> Vec<usize> {
    let step = match even_ticks(0.0, count.max(1) as f64)[..] {
        [_, (step, _), ..] => (step as usize).max(1),
        _ => 1,
    };
    let round = (1..=count).filter(|&number| number.is_multiple_of(step));
    let first = (count > 0 && step > 1).then_some(1);
    first.into_iter().chain(round).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn html(all: &[&[f64]]) -> String {
        let stack = |parts: &&[f64]| Stack {
            parts: parts.to_vec(),
            is_wrong: parts.is_empty(),
            words: "a<b".to_owned(),
        };
        Stacks {
            x_label: "c<d",
            y_label: "e<f",
            parts: vec![(SeriesStyle::Number(0), "g<h"), (SeriesStyle::Number(1), "i")],
            stacks: all.iter().map(stack).collect(),
        }
        .html()
    }

    #[test]
    fn parts_are_stacked_and_the_highest_stack_reaches_the_top() {
        let html = html(&[&[1.0, 3.0], &[2.0, 0.0]]);
        // A height of 4 takes 184 pixels above a foot at 198: 46 for 1, 138 for 3 above it, 92 for 2.
        for part in [
            "y=\"152.0\" width=\"24.00\" height=\"46.0\"",
            "y=\"14.0\" width=\"24.00\" height=\"138.0\"",
            "y=\"106.0\" width=\"24.00\" height=\"92.0\"",
        ] {
            assert!(html.contains(part), "{part} in {html}");
        }
        assert!(html.contains("a&lt;b") && html.contains("c&lt;d") && html.contains("g&lt;h"));
    }

    #[test]
    fn stacks_without_height_are_drawn() {
        for all in [
            &[][..],
            &[&[f64::NAN, f64::INFINITY][..]],
            &[&[]],
            &[&[0.0, -1.0]],
        ] {
            let html = html(all);
            assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
        }
        assert_eq!(html(&[&[], &[1.0]]).matches("class=\"failed\"").count(), 1);
    }

    #[test]
    fn first_column_and_round_numbers_are_labelled() {
        assert_eq!(ticks(4), [1, 2, 3, 4]);
        assert_eq!(ticks(1000), [1, 200, 400, 600, 800, 1000]);
        assert!(ticks(0).is_empty());
    }
}
