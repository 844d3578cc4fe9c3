//! HTML pages of measurements: self-contained files without external resources.
//!
//! A page is a description in JSON, which its script draws. It adapts to dark and light screens, to narrow screens and
//! to paper. Its content security policy permits only its own script and style and embedded images, so that a page
//! never accesses a network.

mod chart;
mod document;
mod element;
mod line_drawing;
mod table;

pub use chart::{
    Bar, BarEntry, Bars, DataPoint, End, Group, Line, Mark, Plot, Row, ScatterChart, Series, SeriesStyle,
    Stack, Stacks,
};
pub use document::page;
pub use element::{Card, EffectPart, PageElement, PngImage, View, facts, filter, numbers};
pub use line_drawing::{Drawing, Region};
pub use table::{Cell, Column, Table};
