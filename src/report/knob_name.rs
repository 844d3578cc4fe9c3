//! Name of the knob that a point differs in from the base.

use crate::cost::Point;

/// Text in the parameter column for the base.
pub(super) const BASE: &str = "base";

/// Returns the name of the knob that differs from the base, or [`BASE`].
pub(super) fn knob_name(point: &Point) -> &'static str {
    point.knob.map_or(BASE, |knob| knob.name())
}
