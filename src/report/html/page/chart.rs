//! Charts as data; the page's script chooses axes, ticks and places of labels.

use serde::{Serialize, Serializer};

use crate::cost::Interval;

/// Colour and shape of a series: twenty-four numbers have distinct looks, and no two of one colour share a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum SeriesStyle {
    /// Base of the comparison, drawn as a ring.
    Base,
    /// Numbered series with a colour and shape by its number.
    Number(usize),
}

/// Writes value, low and high end, with the value in place of a NaN end. JSON has null for infinity and NaN, which are
/// drawn at the end of an axis.
fn drawn<S: Serializer>(interval: &Interval, serializer: S) -> Result<S::Ok, S::Error> {
    let Interval { value, low, high } = *interval;
    let [low, high] = [low, high].map(|end| if end.is_nan() { value } else { end });
    [value, low.max(0.0), high].serialize(serializer)
}

/// Measured point with intervals in both directions.
#[derive(Clone, Debug, Serialize)]
pub struct DataPoint {
    /// Value on the horizontal axis.
    #[serde(serialize_with = "drawn")]
    pub x: Interval,
    /// Value on the vertical axis.
    #[serde(serialize_with = "drawn")]
    pub y: Interval,
    /// Label beside the point, drawn where there is room.
    pub label: String,
    /// Text of the tooltip.
    pub words: String,
}

/// Series of points with a common look.
#[derive(Clone, Debug, Serialize)]
pub struct Series {
    /// Name of the series in the legend.
    pub name: String,
    /// Colour and shape of the points.
    pub look: SeriesStyle,
    /// Measured points of the series.
    pub points: Vec<DataPoint>,
}

/// Polyline in the chart.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// CSS class of the line.
    pub class: &'static str,
    /// Colour of the line.
    pub look: SeriesStyle,
    /// Vertices as values of both axes.
    pub corners: Vec<[f64; 2]>,
}

/// Chart of points and lines over two logarithmic axes. A y value that is NaN is drawn at the top; values of at most 0
/// are drawn at the foot.
#[derive(Clone, Debug, Serialize)]
pub struct ScatterChart {
    /// Width and height in pixels.
    pub size: [f64; 2],
    /// Label of the horizontal axis.
    pub x: &'static str,
    /// Label of the vertical axis.
    pub y: &'static str,
    /// Lines, which are drawn below the points.
    pub lines: Vec<Line>,
    /// Series of points, drawn in order.
    pub series: Vec<Series>,
}

impl ScatterChart {
    /// Returns the chart without points and corners whose x value is NaN.
    #[must_use]
    pub fn placed(mut self) -> ScatterChart {
        for line in &mut self.lines {
            line.corners.retain(|[x, _]| !x.is_nan());
        }
        for series in &mut self.series {
            series.points.retain(|point| !point.x.value.is_nan());
        }
        self
    }
}

/// Horizontal bar with its range.
#[derive(Clone, Debug, Serialize)]
pub struct BarEntry {
    /// Name at the left of the bar.
    pub name: String,
    /// Colour of the bar.
    pub look: SeriesStyle,
    /// Length of the bar and its range.
    #[serde(serialize_with = "drawn")]
    pub value: Interval,
    /// Label behind the bar.
    pub label: String,
    /// Text of the tooltip.
    pub words: String,
}

/// Bars below a common heading.
#[derive(Clone, Debug, Serialize)]
pub struct Group {
    /// Heading of the group.
    pub name: String,
    /// Bars from top to bottom.
    pub bars: Vec<BarEntry>,
}

/// Groups of bars with a common axis from 0; a value that is not finite has no length.
#[derive(Clone, Debug, Serialize)]
pub struct Bars {
    /// Label of the axis, with the unit.
    pub label: &'static str,
    /// Groups from top to bottom.
    pub groups: Vec<Group>,
    /// Meanings of the colours.
    pub legend: Vec<(SeriesStyle, &'static str)>,
}

/// Column of a stacked chart.
#[derive(Clone, Debug, Serialize)]
pub struct Stack {
    /// Heights of the parts, from bottom to top.
    pub parts: Vec<f64>,
    /// True if the column is marked as failed.
    pub is_wrong: bool,
    /// Text of the tooltip.
    pub words: String,
}

/// Stacked columns in order, numbered from 1.
#[derive(Clone, Debug, Serialize)]
pub struct Stacks {
    /// Label of the horizontal axis.
    pub x_label: &'static str,
    /// Label of the vertical axis.
    pub y_label: &'static str,
    /// Colours and names of the parts, from bottom to top.
    pub parts: Vec<(SeriesStyle, &'static str)>,
    /// Columns from left to right.
    pub stacks: Vec<Stack>,
}

/// End of a bar with the level that causes it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct End {
    /// Ratio to the unchanged value; 0 is drawn at the end of the axis.
    pub ratio: f64,
    /// Level that has this ratio; empty if no level has.
    pub level: String,
}

/// Bar between two ratios, which are neither NaN nor negative.
#[derive(Clone, Debug, PartialEq, Serialize)]
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
}

/// Bars of one change, with a common name.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the change.
    pub name: &'static str,
    /// Bars from top to bottom.
    pub bars: Vec<Bar>,
    /// Text of the tooltip.
    pub words: String,
}

/// Point of a scatter plot.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Mark {
    /// Value on the horizontal axis; finite.
    pub x: f64,
    /// Value on the vertical axis, which starts at 0; NaN is drawn at the top.
    pub y: f64,
    /// CSS class of the point.
    pub class: &'static str,
}

/// Scatter plot with a limit line.
#[derive(Clone, Debug, Serialize)]
pub struct Plot {
    /// Label of the horizontal axis.
    pub x_label: String,
    /// Label of the vertical axis.
    pub y_label: String,
    /// Height of the horizontal limit line.
    pub limit: f64,
    /// Points of the plot.
    pub marks: Vec<Mark>,
}
