//! Command `whit compare-stats`: compares measurements with earlier ones and detects regressions.

use std::fs;
use std::path::Path;

use whit::image::check_writable;
use whit::report::regression::{Changes, Measurement, RegressionVerdict, measures};

use super::args::CompareStatsArgs;
use super::failure::Failure;
use super::interrupt;
use super::output;

/// Largest size of a file of measurements in bytes; larger files are of another kind.
const MAX_BYTES: u64 = 1 << 28;

/// Compares two files of measurements; returns an error if any has regressed.
pub(super) fn run(args: &CompareStatsArgs) -> Result<(), Failure> {
    if let Some(path) = &args.json {
        check_writable(path)?;
    }
    // Read both files and match their measurements
    let (base, new) = (read(&args.base)?, read(&args.new)?);
    let changes = Changes::new(&base, &new, args.max_regress);
    if changes.changes.is_empty() {
        return Err(Failure::Input(format!(
            "{} and {} have no measurements in common: give two files of the same kind and of the same scenes",
            args.base.display(),
            args.new.display()
        )));
    }
    output::print(&changes.to_string())?;
    if let Some(path) = &args.json {
        interrupt::without_interruption(|| output::write_json(path, &changes))?;
    }
    // Regressions are failures
    match changes.count(RegressionVerdict::Regressed) {
        0 => Ok(()),
        count => Err(Failure::Work(format!(
            "{count} of {} measurements have regressed",
            changes.changes.len()
        ))),
    }
}

fn read(path: &Path) -> Result<Vec<Measurement>, Failure> {
    let unreadable = |error| Failure::Input(format!("cannot read {}: {error}", path.display()));
    if fs::metadata(path).map_err(unreadable)?.len() > MAX_BYTES {
        return Err(Failure::Input(format!(
            "{} is too large for a file of measurements: give a file of `whit bench --json` or `whit cost`",
            path.display()
        )));
    }
    let text = fs::read_to_string(path).map_err(unreadable)?;
    measures(&text).map_err(|error| Failure::Input(format!("{} {error}", path.display())))
}
