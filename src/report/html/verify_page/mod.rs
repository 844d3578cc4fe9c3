//! HTML page of the verification suite of hard cases: `whit verify --html`.

mod figures;

use std::collections::BTreeSet;

use super::page::{self, Cell, Column, Table, escape};
use crate::report::cpu;
use crate::report::text::verify::{VerifyRow, required_of, word};
use crate::verify::{Correctness, Verdict, bits, describe};

/// Largest number of wrong results of a backend configuration that are shown with their bits.
const MAX_SHOWN: usize = 3;

/// Facts about the run besides its rows.
#[derive(Clone, Debug)]
pub struct Run {
    /// Approximate number of rays or arguments of each case on each configuration.
    pub rays: u64,
    /// Date as the user gave it, if any.
    pub date: Option<String>,
}

/// Returns the HTML page of all rows.
pub fn page(rows: &[VerifyRow], run: &Run) -> String {
    // Show the summary and the number of wrong results by case and configuration
    let mut body = summary(rows, run);
    body += "<h2>Cases and paths</h2>\n\
             <p>Number of wrong results. Green: none. Amber: some, on a path without this requirement. Red: some, on a \
             path that must have none.</p>\n";
    body += &overview(rows);
    // Show all checks with a filter
    body += "<h2>All checks</h2>\n";
    body += &page::filter(&[("holds", "holds"), ("measured", "measured"), ("fails", "fails")]);
    body += &checks(rows);
    body += "<h2>Rays and arguments</h2>\n\
             <p class=\"key\">Colours: <i class=\"right\"></i>right <i class=\"tie\"></i>tie: rounding \
             explains the result <i class=\"wrong\"></i>wrong: it does not</p>\n";
    // Show a section for each case
    for of_case in rows.chunk_by(|a, b| a.case.id == b.case.id) {
        body += &section(of_case);
    }
    page::page("whit verify: hard cases with exact results", &body)
}

/// Returns the CSS class of a verdict.
fn class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Holds => "holds",
        Verdict::Measured => "measured",
        Verdict::Fails => "fails",
    }
}

fn summary(rows: &[VerifyRow], run: &Run) -> String {
    // Count verdicts for the tiles
    let count = |verdict| rows.iter().filter(|row| row.outcome.verdict == verdict).count();
    // A tile has a colour only if its count is positive
    let tile = |verdict, words| {
        let class = if count(verdict) > 0 { class(verdict) } else { "" };
        (count(verdict).to_string(), words, class)
    };
    let mut html = "<h1>Hard cases with exact results</h1>\n\
                    <p>Rays and arguments for which rounding decides the result, traced on every intersection path. A \
                    result that differs from the exact one is wrong if the bounds on rounding do not explain it; \
                    otherwise it is a tie.</p>\n"
        .to_owned();
    html += &page::numbers(&[
        (rows.len().to_string(), "checks", ""),
        tile(Verdict::Holds, "hold"),
        tile(Verdict::Measured, "measured without a requirement"),
        tile(Verdict::Fails, "failed"),
    ]);
    // List Embree versions, processor and number of rays
    let embree: BTreeSet<String> = rows
        .iter()
        .filter_map(|row| row.outcome.embree.as_ref())
        .map(|embree| format!("{} on {}", embree.version, embree.isa))
        .collect();
    let embree: Vec<String> = embree.into_iter().collect();
    let mut facts = vec![
        ("whit", env!("CARGO_PKG_VERSION").to_owned()),
        (
            "Embree",
            if embree.is_empty() {
                "none".into()
            } else {
                escape(&embree.join(", "))
            },
        ),
        ("processor", escape(&cpu::processor())),
        ("rays per case and path", run.rays.to_string()),
    ];
    if let Some(date) = &run.date {
        facts.push(("date", escape(date)));
    }
    html + &page::facts(&facts)
}

/// Returns the name of a row's configuration, with the instruction set if Embree ran with several.
fn path_name(row: &VerifyRow, rows: &[VerifyRow]) -> String {
    let isas: BTreeSet<&str> = rows.iter().filter_map(|row| isa(row)).collect();
    match isa(row) {
        Some(isa) if isas.len() > 1 => format!("{} {isa}", row.path),
        _ => row.path.to_owned(),
    }
}

fn isa(row: &VerifyRow) -> Option<&str> {
    row.outcome.embree.as_ref().map(|embree| embree.isa.as_str())
}

/// Returns the table of wrong results with a row for each case and a column for each configuration.
fn overview(rows: &[VerifyRow]) -> String {
    // Collect the configurations as columns
    let mut paths: Vec<String> = Vec::new();
    for row in rows {
        let name = path_name(row, rows);
        if !paths.contains(&name) {
            paths.push(name);
        }
    }
    let mut columns = vec![Column::Words("case"), Column::Words("")];
    columns.extend(paths.iter().map(|path| Column::Numbers(path)));
    let mut table = Table::new(&columns);
    // Add a row for each case
    for of_case in rows.chunk_by(|a, b| a.case.id == b.case.id) {
        let case = &of_case[0].case;
        let mut cells = vec![Cell::link(case.id, case.id), Cell::text(case.title)];
        cells.extend(paths.iter().map(|path| {
            let row = of_case.iter().find(|row| path_name(row, rows) == *path);
            row.map_or(Cell::default(), |row| {
                let wrong = row.outcome.tally.wrong.to_string();
                Cell::badge_link((&wrong, class(row.outcome.verdict)), case.id)
            })
        }));
        table.row(("", case.id), &cells);
    }
    table.html("overview")
}

fn checks(rows: &[VerifyRow]) -> String {
    let mut table = Table::new(&[
        Column::Words("case"),
        Column::Words("path"),
        Column::Words("isa"),
        Column::Words("verdict"),
        Column::Numbers("wrong"),
        Column::Numbers("ties"),
        Column::Numbers("rays"),
        Column::Numbers("worst"),
        Column::Words("bound"),
    ]);
    for row in rows {
        let tally = &row.outcome.tally;
        let class = class(row.outcome.verdict);
        let cells = [
            Cell::link(&format!("{} {}", row.case.id, row.case.title), row.case.id),
            Cell::text(row.path),
            Cell::text(isa(row).unwrap_or_default()),
            Cell::badge(word(row.outcome.verdict), class),
            Cell::count(tally.wrong),
            Cell::count(tally.ties),
            Cell::count(tally.rays),
            Cell::text(&row.worst()),
            Cell::short(row.case.bound),
        ];
        table.row((class, row.case.id), &cells);
    }
    table.html("wide filtered")
}

/// Returns the section of one case: construction, requirement, figures and failures.
fn section(rows: &[VerifyRow]) -> String {
    let case = &rows[0].case;
    let mut html = format!(
        "<section id=\"{0}\" data-item=\"{0}\">\n<h3>{0} {1}</h3>\n",
        escape(case.id),
        escape(case.title)
    );
    html += &page::facts(&[
        ("input", escape(case.construction)),
        ("oracle", escape(case.oracle)),
        ("bound", escape(case.bound)),
        ("required", escape(&required_of(case))),
    ]);
    html += &figures::of(rows);
    for row in rows.iter().filter(|row| row.outcome.tally.wrong > 0) {
        html += &failures(row);
    }
    html + "</section>\n"
}

/// Returns the first wrong results of a configuration with their bits, so that they can be traced again.
fn failures(row: &VerifyRow) -> String {
    let tally = &row.outcome.tally;
    // Describe recorded wrong rays, or the example where none was recorded
    let wrong = tally
        .figure_data
        .traced
        .iter()
        .filter(|traced| traced.correctness == Correctness::Wrong);
    let mut lines: Vec<String> = wrong
        .take(MAX_SHOWN)
        .map(|traced| {
            format!(
                "{}\n    bits {}",
                describe(&traced.ray, traced.hit),
                bits(&traced.ray)
            )
        })
        .collect();
    if lines.is_empty() {
        lines.extend(tally.example.clone());
    }
    // Name the configuration with its instruction set
    let path = match isa(row) {
        Some(isa) => format!("{} on {isa}", row.path),
        None => row.path.to_owned(),
    };
    format!(
        "<p><span class=\"badge {}\">{}</span> {}: {} wrong of {}; the first:</p>\n<pre>{}</pre>\n",
        class(row.outcome.verdict),
        word(row.outcome.verdict),
        escape(&path),
        tally.wrong,
        tally.rays,
        escape(&lines.join("\n"))
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verify::{BackendVariant, Recording, VARIANTS, VerdictCache, cases, check};

    fn row(id: &str, path: &BackendVariant) -> VerifyRow {
        let case = cases().into_iter().find(|case| case.id == id).unwrap();
        VerifyRow::new(
            case,
            path,
            check(
                (case, 300, Recording::Drawings),
                path,
                None,
                &VerdictCache::default(),
            )
            .unwrap(),
        )
    }

    fn bsp() -> &'static BackendVariant {
        VARIANTS.iter().find(|path| path.name == "bsp").unwrap()
    }

    fn formulas() -> &'static BackendVariant {
        VARIANTS.iter().find(|path| path.name == "formulas").unwrap()
    }

    fn run() -> Run {
        Run {
            rays: 300,
            date: Some("<today>".into()),
        }
    }

    #[test]
    fn every_case_has_a_section_with_a_figure_and_linked_rows() {
        let rows = [row("H11", bsp()), row("H35", formulas())];
        let html = page(&rows, &run());
        for id in ["H11", "H35"] {
            assert!(html.contains(&format!("<section id=\"{id}\" data-item=\"{id}\">")));
            assert!(html.contains(&format!("href=\"#{id}\"")));
        }
        let [_, h11, h35] = html.split("<section").collect::<Vec<_>>()[..] else {
            panic!("two sections");
        };
        assert!(h11.contains("<path class=\"right\""), "rays are drawn");
        assert!(h35.contains("class=\"plot\"") && h35.contains("<circle class=\"right\""));
        assert!(html.contains("&lt;today&gt;") && !html.contains("<today>"));
    }

    #[test]
    fn wrong_results_are_listed_with_bits_and_drawn_as_wrong() {
        let mut failed = row("H11", bsp());
        failed.outcome.verdict = Verdict::Fails;
        failed.outcome.tally.wrong = 24;
        for traced in &mut failed.outcome.tally.figure_data.traced {
            traced.correctness = Correctness::Wrong;
        }
        let first = failed.outcome.tally.figure_data.traced[0].ray;
        let html = page(&[failed], &run());
        assert!(html.contains(&format!("bits {}", bits(&first))));
        assert!(html.contains("<path class=\"wrong\""));
        assert!(html.contains("<b>1</b><span>failed</span>"));
        assert!(html.contains("data-verdict=\"fails\""));
    }
}
