//! The subcommand `cost-tables`: makes the tables of what accuracy costs, from the reports that `whit cost
//! --out` wrote: the price of halving the error by each knob, and the relative times of the ways to find hits. With
//! `--into FILE` the tables replace what stands there between the lines `<!-- cost tables -->` and `<!-- end of cost
//! tables -->`.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use whit::cost::{Interval, Knob, Study};

const START: &str = "<!-- cost tables -->\n";
const END: &str = "<!-- end of cost tables -->\n";

/// Arguments of `cost-tables`.
#[derive(clap::Args)]
#[command(after_long_help = "\
Example:
  for scene in mirror_room textured; do whit cost scenes/$scene.toml --out costs/$scene; done
  cargo run --release --example tools -- cost-tables costs/*/report.json --into tests/benches/RESULTS.md")]
pub(crate) struct Arguments {
    /// Replace the tables in this file instead of printing them
    #[arg(long, value_name = "FILE")]
    into: Option<PathBuf>,

    /// The files report.json that `whit cost --out` wrote
    #[arg(value_name = "REPORT", required = true)]
    reports: Vec<PathBuf>,
}

/// Prints the tables or puts them into the file.
pub(crate) fn run(arguments: &Arguments) -> Result<(), String> {
    let studies = arguments
        .reports
        .iter()
        .map(|path| Ok((name(path), read(path)?)))
        .collect::<Result<Vec<(String, Study)>, String>>()?;
    let tables = format!("{}\n{}", error_halving_table(&studies), hit_path_table(&studies));
    match &arguments.into {
        None => print!("{tables}"),
        Some(file) => replace_tables(file, &tables)?,
    }
    Ok(())
}

/// Returns the name of a report's folder without the ending `.cost`.
fn name(report: &Path) -> String {
    let folder = report
        .parent()
        .and_then(Path::file_name)
        .unwrap_or(report.as_os_str());
    folder.to_string_lossy().trim_end_matches(".cost").to_owned()
}

/// Reads a report.
fn read(path: &Path) -> Result<Study, String> {
    let sentence = |problem: String| format!("{} {problem}", path.display());
    let text = fs::read_to_string(path).map_err(|error| sentence(format!("cannot be read: {error}")))?;
    serde_json::from_str(&text).map_err(|error| sentence(format!("is not a report of `whit cost`: {error}")))
}

/// Replaces what stands between the lines `START` and `END` of the file.
fn replace_tables(file: &Path, tables: &str) -> Result<(), String> {
    let sentence = |problem: String| format!("{} {problem}", file.display());
    let text = fs::read_to_string(file).map_err(|error| sentence(format!("cannot be read: {error}")))?;
    let parts = text
        .split_once(START)
        .and_then(|(before, rest)| Some((before, rest.split_once(END)?.1)));
    let (before, after) = parts.ok_or_else(|| {
        let [start, end] = [START, END].map(str::trim_end);
        sentence(format!(
            "has no lines `{start}` and `{end}` around the place of the tables"
        ))
    })?;
    fs::write(file, format!("{before}{START}\n{tables}\n{END}{after}"))
        .map_err(|error| sentence(format!("cannot be written: {error}")))
}

/// Formats a number with two significant digits.
fn digits(x: f64) -> String {
    let places = (2 - x.abs().log10().floor() as i32 - 1).clamp(0, 6) as usize;
    format!("{x:.places$}")
}

/// Formats a value with the ends of its interval.
fn with_ends(interval: Interval) -> String {
    let [value, low, high] = [interval.value, interval.low, interval.high].map(digits);
    format!("{value} ({low} to {high})")
}

/// Returns the table of what halving the error costs by each knob that has a price on some scene.
fn error_halving_table(studies: &[(String, Study)]) -> String {
    let price = |study: &Study, knob: Knob| {
        let curve = study.curves.iter().find(|curve| curve.knob == knob)?;
        study.time_factor_of_half_error(curve)
    };
    let has_price = |knob: &Knob| studies.iter().any(|(_, study)| price(study, *knob).is_some());
    let knobs: Vec<Knob> = Knob::ALL.into_iter().filter(has_price).collect();
    let mut table = "| scene | pixels | base: samples, RMSE | seconds |".to_owned();
    for knob in &knobs {
        let _ = write!(table, " by {knob} |");
    }
    table += "\n| --- | --- | --- | --- |";
    table += &" --- |".repeat(knobs.len());
    table.push('\n');
    for (name, study) in studies {
        let base = &study.points[0];
        let [width, height] = study.size;
        let _ = write!(
            table,
            "| {name}{} | {width}x{height} | {}, {} | {} |",
            if study.reference.has_converged() { "" } else { " *" },
            base.settings.get("samples").map_or("", String::as_str),
            digits(base.rmse.value),
            digits(base.seconds.value),
        );
        for &knob in &knobs {
            let cell = price(study, knob).map_or(String::new(), with_ends);
            let _ = write!(table, " {cell} |");
        }
        table.push('\n');
    }
    if studies.iter().any(|(_, study)| !study.reference.has_converged()) {
        table += "\n\\* The reference did not pass all of its checks; see the report.\n";
    }
    table
}

/// Returns the table of times of the other ways to find hits, relative to the base's.
fn hit_path_table(studies: &[(String, Study)]) -> String {
    let mut levels: Vec<&str> = Vec::new();
    for (_, study) in studies {
        for point in study
            .points
            .iter()
            .filter(|point| point.knob == Some(Knob::HitPath))
        {
            if !levels.contains(&point.level.as_str()) {
                levels.push(&point.level);
            }
        }
    }
    let mut table = "| scene | base |".to_owned();
    for level in &levels {
        let _ = write!(table, " {level} |");
    }
    table += "\n| --- | --- |";
    table += &" --- |".repeat(levels.len());
    table.push('\n');
    for (name, study) in studies {
        let base = study.points[0].settings.get("path").map_or("", String::as_str);
        let _ = write!(table, "| {name} | {base} |");
        for level in &levels {
            let is_it = |knob: Option<Knob>, of: &str| knob == Some(Knob::HitPath) && of == *level;
            let point = study.points.iter().find(|point| is_it(point.knob, &point.level));
            let cell = point.map_or(String::new(), |point| with_ends(point.time_ratio));
            let _ = write!(table, " {cell} |");
        }
        table.push('\n');
    }
    table
}
