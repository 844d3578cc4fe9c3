//! Flags of `whit compare-stats`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

const COMPARE_STATS_HELP: &str = "\
Both files are of the same kind: written by `whit bench --json`, the report.json of `whit cost`, or an object of names
and counts such as {\"instructions\": 11249172}. A measurement has regressed if it is worse by more than --max-regress
for all values within its interval and the earlier one; if the values are worse but the intervals do not show it, the
result is unclear. The exit code is 1 if any measurement has regressed.

Examples:
  whit compare-stats base.json new.json
  whit compare-stats base.json new.json --max-regress 2% --json changes.json";

/// Flags of `whit compare-stats`.
#[derive(Debug, ArgGroup)]
#[command(after_help = COMPARE_STATS_HELP)]
pub(in crate::cli) struct CompareStatsArgs {
    /// File of the earlier measurements
    #[arg(value_name = "BASE")]
    pub(in crate::cli) base: PathBuf,

    /// File of the later measurements
    #[arg(value_name = "NEW")]
    pub(in crate::cli) new: PathBuf,

    /// Tolerance by which a measurement may be worse
    #[arg(long, value_name = "N%", default_value = "5%", value_parser = share)]
    pub(in crate::cli) max_regress: f64,

    /// Write all measurements with their verdicts as JSON
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) json: Option<PathBuf>,
}

/// Parses a percentage and returns it as a fraction of 1.
fn share(text: &str) -> Result<f64, String> {
    text.strip_suffix('%')
        .and_then(|number| number.trim_end().parse::<f64>().ok())
        .filter(|percent| (0.0..=1000.0).contains(percent))
        .map(|percent| 0.01 * percent)
        .ok_or_else(|| "give a percentage from 0% to 1000%, as in 5%".to_owned())
}
