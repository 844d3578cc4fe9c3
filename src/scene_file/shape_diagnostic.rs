//! Fault of a shape.

use std::ops::Range;

/// Fault of a shape, with its span if it is narrower than that of the shape.
pub(super) struct ShapeDiagnostic {
    pub(super) span: Option<Range<usize>>,
    pub(super) sentence: String,
}

impl From<String> for ShapeDiagnostic {
    fn from(sentence: String) -> ShapeDiagnostic {
        ShapeDiagnostic { span: None, sentence }
    }
}
