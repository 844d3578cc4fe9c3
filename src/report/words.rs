//! Numbers as words.

/// A part of a whole: two digits are more than measurements of time give.
pub(super) fn percent(part: f64) -> String {
    let percent = 100.0 * part.abs();
    match percent {
        0.0 => "0 %".into(),
        p if p < 0.01 => "<0.01 %".into(),
        p if p < 0.095 => format!("{p:.2} %"),
        p if p < 9.5 => format!("{p:.1} %"),
        p => format!("{p:.0} %"),
    }
}
