//! The tables of the README that tell what accuracy costs, from the reports that `whit cost --out` wrote: prices of half the
//! error by knob, and prices of the ways to find hits. With `--into FILE` they replace what stands there between the lines
//! `<!-- cost tables -->` and `<!-- end of cost tables -->`.
//!
//! ```text
//! for scene in mirror_room textured; do whit cost scenes/$scene.toml --out costs/$scene; done
//! cargo run --release --example cost-tables -- costs/*/report.json --into README.md
//! ```

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use whit::cost::{Interval, Knob, Study};

const START: &str = "<!-- cost tables -->\n";
const END: &str = "<!-- end of cost tables -->\n";

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            eprintln!("cost-tables: {fault}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<(), String> {
    let mut reports = Vec::new();
    let mut into = None;
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        if word == "--into" {
            into = Some(PathBuf::from(words.next().ok_or("`--into` wants a file")?));
        } else {
            reports.push(PathBuf::from(word));
        }
    }
    if reports.is_empty() {
        return Err("name report.json files that `whit cost --out` wrote".to_owned());
    }
    let studies = reports
        .iter()
        .map(|path| Ok((name(path), read(path)?)))
        .collect::<Result<Vec<(String, Study)>, String>>()?;
    let tables = format!("{}\n{}", halves(&studies), paths(&studies));
    match into {
        None => print!("{tables}"),
        Some(file) => put(&file, &tables)?,
    }
    Ok(())
}

/// A report's folder, without the ending that tells what it is.
fn name(report: &Path) -> String {
    let folder = report
        .parent()
        .and_then(Path::file_name)
        .unwrap_or(report.as_os_str());
    folder.to_string_lossy().trim_end_matches(".cost").to_owned()
}

fn read(path: &Path) -> Result<Study, String> {
    let fault = |words: String| format!("{} {words}", path.display());
    let text = fs::read_to_string(path).map_err(|error| fault(format!("cannot be read: {error}")))?;
    serde_json::from_str(&text).map_err(|error| fault(format!("is no report of `whit cost`: {error}")))
}

/// Replaces what stands between the lines of the file.
fn put(file: &Path, tables: &str) -> Result<(), String> {
    let fault = |words: String| format!("{} {words}", file.display());
    let text = fs::read_to_string(file).map_err(|error| fault(format!("cannot be read: {error}")))?;
    let parts = text
        .split_once(START)
        .and_then(|(before, rest)| Some((before, rest.split_once(END)?.1)));
    let (before, after) = parts.ok_or_else(|| fault("has no lines to put the tables between".to_owned()))?;
    fs::write(file, format!("{before}{START}\n{tables}\n{END}{after}"))
        .map_err(|error| fault(format!("cannot be written: {error}")))
}

fn digits(x: f64) -> String {
    let places = (2 - x.abs().log10().floor() as i32 - 1).clamp(0, 6) as usize;
    format!("{x:.places$}")
}

fn with_ends(of: Interval) -> String {
    format!("{} ({} to {})", digits(of.value), digits(of.low), digits(of.high))
}

/// What half the error costs by each knob that has a price on some scene.
fn halves(studies: &[(String, Study)]) -> String {
    let price = |study: &Study, knob: Knob| {
        let curve = study.curves.iter().find(|curve| curve.knob == knob)?;
        study.price_of_half(curve)
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

/// Times of the other ways to find hits over the base's.
fn paths(studies: &[(String, Study)]) -> String {
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
