//! HTML pages of measurements: self-contained files without external resources.
//!
//! A page adapts to dark and light screens, to narrow screens and to paper. Its content security policy permits only
//! its own script and style and embedded images, so that a page never accesses a network.

mod axis;
mod bars;
mod chart;
mod document;
mod elements;
mod line_drawing;
mod plot;
mod stacked_bars;
mod table;
mod tornado;
mod viewer;

pub use axis::LogAxis;
pub use bars::{BarEntry, Bars, Group};
pub use chart::{Chart, DataPoint, Line, Series, SeriesStyle};
pub use document::page;
pub use elements::{escape, facts, figure, filter, numbers};
pub use line_drawing::{Drawing, Region};
pub use plot::{Mark, Plot};
pub use stacked_bars::{Stack, Stacks};
pub use table::{Cell, Column, Table};
pub use tornado::{Bar, End, Row, Tornado};
pub use viewer::{View, embedded_image, viewer};
