//! Scatter plots over a linear axis or, where values span decades, a logarithmic one.

use std::fmt::Write;

use super::elements::escape;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 260.0;
/// Margins for labels in pixels: left, bottom, and a smaller one at the top and right.
const LEFT: f64 = 52.0;
const BELOW: f64 = 42.0;
const BESIDE: f64 = 14.0;
/// Ratio of the largest to the smallest value above which the axis is logarithmic.
const DECADES: f64 = 100.0;
/// Fraction of the limit below which all errors are plotted on a logarithmic axis.
const SMALL: f64 = 1.0 / 32.0;
/// Lower end of a logarithmic error axis as a fraction of the largest error; smaller errors are drawn at the foot.
const DEPTH: f64 = 1.0 / 4096.0;
/// Largest height of a plot relative to its limit; larger errors are drawn at the top.
const MAX_HEIGHT_RATIO: f64 = 4.0;
/// Approximate number of ticks of an axis.
const TICKS: f64 = 6.0;

/// Point of a scatter plot.
#[derive(Clone, Copy, Debug)]
pub struct Mark {
    /// Value on the horizontal axis.
    pub x: f64,
    /// Value on the vertical axis, which starts at 0.
    pub y: f64,
    /// CSS class of the point.
    pub class: &'static str,
}

/// Scatter plot with a limit line.
#[derive(Clone, Debug)]
pub struct Plot<'a> {
    /// Label of the horizontal axis.
    pub x_label: &'a str,
    /// Label of the vertical axis.
    pub y_label: &'a str,
    /// Height of the horizontal limit line.
    pub limit: f64,
    /// Points of the plot.
    pub marks: Vec<Mark>,
}

/// Axis by the values at its ends, or by their decimal logarithms.
enum Axis {
    Even { low: f64, high: f64 },
    Logarithmic { low: f64, high: f64 },
}

impl Axis {
    fn of(values: impl Iterator<Item = f64> + Clone) -> Axis {
        // Ignore values that are not finite
        let finite = values.filter(|x| x.is_finite());
        let low = finite.clone().fold(f64::INFINITY, f64::min);
        let high = finite.fold(f64::NEG_INFINITY, f64::max);
        if low > 0.0 && high > DECADES * low {
            return Axis::Logarithmic {
                low: low.log10(),
                high: high.log10(),
            };
        }
        if low < high {
            Axis::Even { low, high }
        } else {
            // A single value, or none, gets an axis of length 2 around it.
            let middle = if low.is_finite() { low } else { 0.0 };
            Axis::Even {
                low: middle - 1.0,
                high: middle + 1.0,
            }
        }
    }

    /// Returns the position of a value on the axis, from 0 to 1.
    fn place(&self, x: f64) -> f64 {
        match *self {
            Axis::Even { low, high } => (x - low) / (high - low),
            Axis::Logarithmic { low, high } => (x.log10() - low) / (high - low),
        }
    }

    /// Returns the ticks as values with their labels.
    fn ticks(&self) -> Vec<(f64, String)> {
        match *self {
            Axis::Even { low, high } => even_ticks(low, high),
            Axis::Logarithmic { low, high } => {
                // Choose a step in whole powers of ten
                let step = ((high - low) / TICKS).ceil().max(1.0);
                let first = (low / step).ceil() as i32;
                let last = (high / step).floor() as i32;
                let power = |i: i32| i * step as i32;
                (first..=last)
                    .map(|i| (10f64.powi(power(i)), format!("1e{}", power(i))))
                    .collect()
            }
        }
    }
}

/// Returns round numbers between `low` and `high` with their labels.
pub(super) fn even_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    // Choose a step of 1, 2 or 5 times a power of ten
    let rough = (high - low) / TICKS;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|factor| factor * power)
        .find(|&step| step >= rough)
        .unwrap_or(10.0 * power);
    let digits = (-step.log10().floor()).max(0.0) as usize;
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last)
        .map(|i| i as f64 * step)
        .map(|x| (x, format!("{x:.digits$}")))
        .collect()
}

impl Plot<'_> {
    /// Returns the vertical axis: linear from 0, or logarithmic where all errors are far below the limit.
    fn height(&self) -> Axis {
        let highest = self.marks.iter().map(|mark| mark.y).fold(0.0, f64::max);
        if highest > 0.0 && highest < SMALL * self.limit {
            return Axis::Logarithmic {
                low: (DEPTH * highest).log10(),
                high: (2.0 * self.limit).log10(),
            };
        }
        Axis::Even {
            low: 0.0,
            high: 1.1 * highest.clamp(self.limit, MAX_HEIGHT_RATIO * self.limit),
        }
    }

    /// Returns the plot as SVG.
    pub fn svg(&self) -> String {
        // Map values to pixels
        let axis = Axis::of(self.marks.iter().map(|mark| mark.x));
        let height = self.height();
        let across = |x: f64| LEFT + axis.place(x) * (WIDTH - LEFT - BESIDE);
        let up = |y: f64| HEIGHT - BELOW - height.place(y).clamp(0.0, 1.0) * (HEIGHT - BELOW - BESIDE);
        let mut svg = format!(
            "<svg class=\"plot\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{} over {}\">",
            escape(self.y_label),
            escape(self.x_label)
        );
        // Draw the grid of both axes. Writing to a string cannot fail.
        for (x, name) in axis.ticks() {
            let x = across(x);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{x:.1} {BESIDE}V{0:.1}\"/>\
                 <text x=\"{x:.1}\" y=\"{1:.1}\" text-anchor=\"middle\">{name}</text>",
                HEIGHT - BELOW,
                HEIGHT - BELOW + 15.0
            );
        }
        for (y, name) in height.ticks() {
            let y = up(y);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{0:.1}\"/>\
                 <text x=\"{1:.1}\" y=\"{2:.1}\" text-anchor=\"end\">{name}</text>",
                WIDTH - BESIDE,
                LEFT - 6.0,
                y + 4.0
            );
        }
        // Draw the limit
        let _ = write!(
            svg,
            "<path class=\"limit\" d=\"M{LEFT} {0:.1}H{1:.1}\"/>\
             <text class=\"limit\" x=\"{1:.1}\" y=\"{2:.1}\" text-anchor=\"end\">bound</text>",
            up(self.limit),
            WIDTH - BESIDE,
            up(self.limit) - 4.0
        );
        // Draw the points; a NaN error is drawn at the top.
        for mark in self.marks.iter().filter(|mark| mark.x.is_finite()) {
            let y = if mark.y.is_nan() { f64::INFINITY } else { mark.y };
            let _ = write!(
                svg,
                "<circle class=\"{}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.2\"/>",
                mark.class,
                across(mark.x),
                up(y)
            );
        }
        // Write the labels of the axes
        let _ = write!(
            svg,
            "<text class=\"label\" x=\"{0:.1}\" y=\"{1:.1}\" text-anchor=\"middle\">{2}</text>\
             <text class=\"label\" x=\"{3}\" y=\"{4:.1}\" text-anchor=\"middle\" \
             transform=\"rotate(-90 {3} {4:.1})\">{5}</text></svg>",
            0.5 * (LEFT + WIDTH - BESIDE),
            HEIGHT - 6.0,
            escape(self.x_label),
            12,
            0.5 * (HEIGHT - BELOW),
            escape(self.y_label)
        );
        svg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers_within_the_axis() {
        let names =
            |low, high| -> Vec<String> { even_ticks(low, high).into_iter().map(|tick| tick.1).collect() };
        assert_eq!(names(0.0, 1.0), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(names(-3.0, 9.5), ["0", "5"]);
        let powers: Vec<String> = Axis::of([1e-9, 1e3].into_iter())
            .ticks()
            .into_iter()
            .map(|tick| tick.1)
            .collect();
        assert_eq!(powers, ["1e-8", "1e-6", "1e-4", "1e-2", "1e0", "1e2"]);
    }

    #[test]
    fn points_far_above_the_limit_or_not_finite_are_at_the_top() {
        let mark = |y| Mark {
            x: 1.0,
            y,
            class: "wrong",
        };
        let plot = Plot {
            x_label: "a<b",
            y_label: "ulp",
            limit: 4.0,
            marks: vec![mark(1.0), mark(f64::NAN), mark(f64::INFINITY), mark(1e9)],
        };
        let svg = plot.svg();
        assert_eq!(svg.matches("<circle").count(), 4);
        assert_eq!(svg.matches("cy=\"14.0\"").count(), 3, "{svg}");
        assert!(svg.contains("a&lt;b") && !svg.contains("NaN"));
    }

    #[test]
    fn errors_far_below_the_limit_are_separated_by_decade() {
        let mark = |y| Mark {
            x: 1.0,
            y,
            class: "right",
        };
        let plot = Plot {
            x_label: "",
            y_label: "",
            limit: 1.0,
            marks: vec![mark(1e-7), mark(1e-6), mark(0.0)],
        };
        let svg = plot.svg();
        assert!(svg.contains(">1e-6<") && !svg.contains("NaN"), "{svg}");
        let foot = format!("cy=\"{:.1}\"", HEIGHT - BELOW);
        assert_eq!(svg.matches(&foot).count(), 1, "only 0 is at the foot: {svg}");
    }

    #[test]
    fn empty_plot_is_drawn() {
        let plot = Plot {
            x_label: "",
            y_label: "",
            limit: 1.0,
            marks: Vec::new(),
        };
        assert!(!plot.svg().contains("NaN") && !plot.svg().contains("inf"));
    }
}
