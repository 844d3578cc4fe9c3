//! The median of repeated measurements with their spread.

use std::fmt;

/// The median and the quartiles of a set of values.
///
/// Printed as `median (low to high)`, with as many digits after the point as the format's precision asks for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Quartiles {
    /// The lower quartile.
    pub(crate) low: f64,
    pub(crate) median: f64,
    /// The upper quartile.
    pub(crate) high: f64,
}

impl Quartiles {
    /// Returns the quartiles of at least one value; of an even number of values the upper one of the two in the middle
    /// is the median.
    pub(crate) fn compute(values: impl IntoIterator<Item = f64>) -> Quartiles {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let count = values.len();
        Quartiles {
            low: values[count / 4],
            median: values[count / 2],
            high: values[count * 3 / 4],
        }
    }
}

impl fmt::Display for Quartiles {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let digits = f.precision().unwrap_or(3);
        let Quartiles { low, median, high } = self;
        write!(f, "{median:.digits$} ({low:.digits$} to {high:.digits$})")
    }
}
