//! Charts of measured points with their intervals, over two logarithmic axes.

use std::fmt::Write;

use super::axis::LogAxis;
use super::elements::escape;
use crate::cost::Interval;

/// Margins for labels in pixels: left, bottom, top and right.
const LEFT: f64 = 62.0;
const BELOW: f64 = 44.0;
const ABOVE: f64 = 12.0;
const BESIDE: f64 = 16.0;
/// Smallest distance of ticks in pixels, horizontally and vertically.
const ACROSS_TICK: f64 = 46.0;
const UP_TICK: f64 = 24.0;
/// Half the width of a mark, in pixels.
const MARK: f64 = 4.2;
/// Approximate width and height of a label's letter, in pixels.
const LETTER: [f64; 2] = [6.4, 11.0];
/// Number of colours in the style sheet.
const COLORS: usize = 6;

/// Colour and shape of a series: twenty-four numbers have distinct looks, and no two of one colour share a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeriesStyle {
    /// Base of the comparison, drawn as a ring.
    Base,
    /// Numbered series with a colour and shape by its number.
    Number(usize),
}

impl SeriesStyle {
    /// Returns the CSS class of the colour.
    pub fn class(self) -> String {
        match self {
            SeriesStyle::Base => "base".to_owned(),
            SeriesStyle::Number(number) => format!("look{}", number % COLORS),
        }
    }

    /// Returns the mark's shape around a position, as an SVG path.
    fn path(self, x: f64, y: f64) -> String {
        let r = MARK;
        match self {
            SeriesStyle::Base => circle(x, y, 1.6 * r),
            SeriesStyle::Number(number) => match (number + number / 12) % 4 {
                0 => circle(x, y, r),
                1 => format!(
                    "M{:.1} {:.1}h{w:.1}v{w:.1}h-{w:.1}z",
                    x - 0.9 * r,
                    y - 0.9 * r,
                    w = 1.8 * r
                ),
                2 => format!(
                    "M{x:.1} {:.1}l{:.1} {h:.1}h-{:.1}z",
                    y - 1.2 * r,
                    1.2 * r,
                    2.4 * r,
                    h = 2.1 * r
                ),
                _ => format!(
                    "M{x:.1} {:.1}l{d:.1} {d:.1}l-{d:.1} {d:.1}l-{d:.1} -{d:.1}z",
                    y - 1.3 * r,
                    d = 1.3 * r
                ),
            },
        }
    }
}

fn circle(x: f64, y: f64, r: f64) -> String {
    format!(
        "M{:.1} {y:.1}a{r:.1} {r:.1} 0 1 0 {d:.1} 0a{r:.1} {r:.1} 0 1 0 -{d:.1} 0z",
        x - r,
        d = 2.0 * r
    )
}

/// Measured point with intervals in both directions.
#[derive(Clone, Debug)]
pub struct DataPoint {
    /// Value on the horizontal axis.
    pub x: Interval,
    /// Value on the vertical axis.
    pub y: Interval,
    /// Label beside the point, drawn where there is room.
    pub label: String,
    /// Text of the tooltip.
    pub words: String,
}

/// Series of points with a common look.
#[derive(Clone, Debug)]
pub struct Series<'a> {
    /// Name of the series in the legend.
    pub name: &'a str,
    /// Colour and shape of the points.
    pub look: SeriesStyle,
    /// Measured points of the series.
    pub spots: Vec<DataPoint>,
}

/// Polyline in the chart.
#[derive(Clone, Debug)]
pub struct Line {
    /// CSS class of the line.
    pub class: String,
    /// Vertices as values of both axes.
    pub corners: Vec<[f64; 2]>,
}

/// Chart of points and lines. A y value that is NaN is drawn at the top, and a point whose x value is NaN is left out;
/// values of at most 0 are drawn at the foot.
#[derive(Clone, Debug)]
pub struct Chart<'a> {
    /// Width and height in pixels.
    pub size: [f64; 2],
    /// Logarithmic axis of the x values.
    pub x: LogAxis<'a>,
    /// Logarithmic axis of the y values.
    pub y: LogAxis<'a>,
    /// Lines, which are drawn below the points.
    pub lines: Vec<Line>,
    /// Series of points, drawn in order.
    pub series: Vec<Series<'a>>,
}

impl Chart<'_> {
    /// Returns the chart as HTML, with a legend below if there are several series.
    pub fn html(&self) -> String {
        let legend = if self.series.len() > 1 {
            self.legend()
        } else {
            String::new()
        };
        format!(
            "<div class=\"chart\"><div class=\"scroll\">{}</div>{legend}</div>\n",
            self.svg()
        )
    }

    /// Returns the chart as SVG.
    pub fn svg(&self) -> String {
        let [width, height] = self.size;
        let series = self.series.iter().enumerate();
        format!(
            "<svg style=\"width:{width}px\" viewBox=\"0 0 {width} {height}\" role=\"group\" \
             aria-label=\"{} over {}\">{}{}{}{}{}</svg>",
            escape(self.y.label),
            escape(self.x.label),
            self.grid(),
            self.lines.iter().map(|line| self.line(line)).collect::<String>(),
            series
                .map(|(number, series)| self.marks(number, series))
                .collect::<String>(),
            self.labels(),
            self.names(),
        )
    }

    fn legend(&self) -> String {
        // Show each series by its mark
        let entries = self.series.iter().enumerate().map(|(number, series)| {
            format!(
                "<span data-series=\"{number}\"><svg viewBox=\"0 0 16 16\" width=\"16\" height=\"16\" aria-hidden=\"true\">\
                 <path class=\"mark {}\" d=\"{}\"/></svg>{}</span>\n",
                series.look.class(),
                series.look.path(8.0, 8.0),
                escape(series.name)
            )
        });
        format!("<p class=\"legend\">{}</p>", entries.collect::<String>())
    }

    fn foot(&self) -> f64 {
        self.size[1] - BELOW
    }

    fn across(&self, x: f64) -> f64 {
        LEFT + self.x.place(x) * (self.size[0] - LEFT - BESIDE)
    }

    fn up(&self, y: f64) -> f64 {
        self.foot() - self.y.place(y) * (self.foot() - ABOVE)
    }

    fn grid(&self) -> String {
        // Draw vertical grid lines with labels, then horizontal ones
        let [width, _] = self.size;
        let foot = self.foot();
        let mut svg = String::new();
        // Writing to a string cannot fail.
        for (x, name) in self.x.ticks((width - LEFT - BESIDE) / ACROSS_TICK) {
            let x = self.across(x);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{x:.1} {ABOVE}V{foot:.1}\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{name}</text>",
                foot + 15.0
            );
        }
        for (y, name) in self.y.ticks((foot - ABOVE) / UP_TICK) {
            let y = self.up(y);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{:.1}\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{name}</text>",
                width - BESIDE,
                LEFT - 6.0,
                y + 4.0
            );
        }
        svg
    }

    fn names(&self) -> String {
        let [width, height] = self.size;
        let (x, y) = (0.5 * (LEFT + width - BESIDE), 0.5 * (ABOVE + self.foot()));
        format!(
            "<text class=\"label\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
             <text class=\"label\" x=\"12\" y=\"{y:.1}\" text-anchor=\"middle\" \
             transform=\"rotate(-90 12 {y:.1})\">{}</text>",
            height - 6.0,
            escape(self.x.label),
            escape(self.y.label)
        )
    }

    fn line(&self, line: &Line) -> String {
        let corners = line.corners.iter().filter(|[x, _]| !x.is_nan());
        let places = corners.map(|&[x, y]| format!("{:.1} {:.1}", self.across(x), self.up(y)));
        let path = places.collect::<Vec<_>>().join("L");
        if path.is_empty() {
            return path;
        }
        format!("<path class=\"{}\" d=\"M{path}\"/>", escape(&line.class))
    }

    /// Returns a point's position in pixels; `None` if its x value is NaN.
    fn place(&self, spot: &DataPoint) -> Option<[f64; 2]> {
        let [x, y] = [spot.x.value, spot.y.value];
        (!x.is_nan()).then(|| [self.across(x), self.up(y)])
    }

    fn marks(&self, number: usize, series: &Series) -> String {
        let class = series.look.class();
        let mut svg = format!("<g class=\"series\" data-series=\"{number}\">");
        for spot in &series.spots {
            let Some([x, y]) = self.place(spot) else { continue };
            // Draw the interval as a cross, and the mark above it
            let [left, right] = ends(spot.x).map(|x| self.across(x));
            let [low, high] = ends(spot.y).map(|y| self.up(y));
            let _ = write!(
                svg,
                "<g class=\"point\" role=\"img\"><title>{}</title>\
                 <path class=\"interval {class}\" d=\"M{left:.1} {y:.1}H{right:.1}M{x:.1} {low:.1}V{high:.1}\"/>\
                 <path class=\"mark {class}\" d=\"{}\"/></g>",
                escape(&spot.words),
                series.look.path(x, y)
            );
        }
        svg + "</g>"
    }

    /// Returns labels that overlap neither points nor each other; others are left out.
    fn labels(&self) -> String {
        // Reserve the area of every mark
        let spots = || self.series.iter().flat_map(|series| &series.spots);
        let mut taken: Vec<Area> = spots()
            .filter_map(|spot| self.place(spot))
            .map(|[x, y]| Area([x - MARK, y - MARK], [x + MARK, y + MARK]))
            .collect();
        let whole = Area([LEFT, ABOVE], [self.size[0] - BESIDE, self.foot()]);
        let mut svg = String::new();
        // Try four positions around each point
        for spot in spots().filter(|spot| !spot.label.is_empty()) {
            let Some([x, y]) = self.place(spot) else { continue };
            let width = LETTER[0] * spot.label.chars().count() as f64;
            let free = [
                [5.0, -5.0],
                [-5.0 - width, -5.0],
                [5.0, 14.0],
                [-5.0 - width, 14.0],
            ]
            .map(|[right, down]| [x + right, y + down])
            .map(|[x, y]| Area([x, y - LETTER[1]], [x + width, y]))
            .into_iter()
            .find(|area| area.is_within(&whole) && !taken.iter().any(|other| area.overlaps(other)));
            // Write the label and reserve its area
            let Some(area) = free else { continue };
            let _ = write!(
                svg,
                "<text class=\"level\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                area.0[0],
                area.1[1] - 1.5,
                escape(&spot.label)
            );
            taken.push(area);
        }
        svg
    }
}

/// Returns the ends of an interval, with its value in place of a NaN end.
fn ends(interval: Interval) -> [f64; 2] {
    [interval.low, interval.high].map(|end| if end.is_nan() { interval.value } else { end })
}

/// Rectangle by its upper left and lower right corners, in pixels.
struct Area([f64; 2], [f64; 2]);

impl Area {
    fn overlaps(&self, other: &Area) -> bool {
        (0..2).all(|axis| self.0[axis] < other.1[axis] && other.0[axis] < self.1[axis])
    }

    fn is_within(&self, other: &Area) -> bool {
        (0..2).all(|axis| self.0[axis] >= other.0[axis] && self.1[axis] <= other.1[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(x: Interval, y: Interval) -> DataPoint {
        DataPoint {
            x,
            y,
            label: "a<b".to_owned(),
            words: "c<d".to_owned(),
        }
    }

    fn chart(spots: Vec<DataPoint>) -> Chart<'static> {
        let intervals = |of: fn(&DataPoint) -> Interval| spots.iter().map(of).collect::<Vec<_>>();
        Chart {
            size: [400.0, 300.0],
            x: LogAxis::around("seconds", &intervals(|spot| spot.x)),
            y: LogAxis::around("RMSE", &intervals(|spot| spot.y)),
            lines: Vec::new(),
            series: vec![Series {
                name: "all",
                look: SeriesStyle::Number(0),
                spots,
            }],
        }
    }

    fn is_sound(svg: &str) {
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert!(!svg.contains("a<b") && !svg.contains("c<d"), "{svg}");
    }

    #[test]
    fn interval_reaching_zero_ends_at_the_foot() {
        let low = Interval {
            value: 0.1,
            low: -0.2,
            high: 0.3,
        };
        let svg = chart(vec![spot(Interval::exact(1.0), low)]).svg();
        is_sound(&svg);
        // The vertical line starts at the foot of the chart.
        assert!(svg.contains(&format!(" {:.1}V", 300.0 - BELOW)), "{svg}");
    }

    #[test]
    fn point_without_error_is_at_the_foot() {
        let at = |y| spot(Interval::exact(1.0), Interval::exact(y));
        let chart = chart(vec![at(0.0), at(0.1), at(-1.0)]);
        is_sound(&chart.svg());
        let heights: Vec<f64> = chart.series[0]
            .spots
            .iter()
            .map(|spot| chart.place(spot).unwrap()[1])
            .collect();
        assert_eq!([heights[0], heights[2]], [300.0 - BELOW; 2]);
        assert!(heights[1] < heights[0] - 10.0);
        assert!(chart.svg().contains(">0</text>"));
    }

    #[test]
    fn non_finite_points_are_at_the_top_or_omitted() {
        let odd = |value| Interval {
            value,
            low: f64::NAN,
            high: f64::INFINITY,
        };
        let spots = vec![
            spot(odd(1.0), odd(f64::NAN)),
            spot(odd(1.0), odd(f64::INFINITY)),
            spot(odd(f64::NAN), odd(1.0)),
        ];
        let mut chart = chart(spots);
        chart.lines.push(Line {
            class: "front".to_owned(),
            corners: vec![[f64::NAN, 1.0], [f64::INFINITY, f64::NAN], [0.0, 0.0]],
        });
        let svg = chart.svg();
        is_sound(&svg);
        assert_eq!(svg.matches("class=\"point\"").count(), 2);
        assert_eq!(chart.place(&chart.series[0].spots[0]).unwrap()[1], ABOVE);
    }

    #[test]
    fn charts_of_no_point_and_one_point_are_drawn() {
        is_sound(&chart(Vec::new()).html());
        let one = chart(vec![spot(Interval::exact(3.0), Interval::exact(0.5))]);
        is_sound(&one.html());
        let [x, y] = one.place(&one.series[0].spots[0]).unwrap();
        assert!((x - 0.5 * (LEFT + 400.0 - BESIDE)).abs() < 1e-9, "{x}");
        assert!((y - 0.5 * (ABOVE + 300.0 - BELOW)).abs() < 1e-9, "{y}");
    }

    #[test]
    fn labels_do_not_overlap() {
        let at = |x| spot(Interval::exact(x), Interval::exact(1.0));
        let svg = chart(vec![at(1.0); 9]).svg();
        assert!((1..=4).contains(&svg.matches("class=\"level\"").count()), "{svg}");
        let svg = chart(vec![at(1.0), at(100.0)]).svg();
        assert_eq!(svg.matches("class=\"level\"").count(), 2, "{svg}");
    }

    #[test]
    fn twenty_four_series_look_different() {
        let looks: Vec<_> = (0..24)
            .map(SeriesStyle::Number)
            .map(|look| (look.class(), look.path(0.0, 0.0)))
            .collect();
        for (number, look) in looks.iter().enumerate() {
            assert!(!looks[..number].contains(look), "{number}");
        }
    }
}
