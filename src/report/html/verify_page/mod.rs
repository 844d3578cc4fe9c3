//! HTML page of the verification suite of hard cases: `whit verify --html`.

mod figures;

use std::collections::BTreeSet;

use super::page::{self, Cell, Column, PageElement, Table};
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
    let mut elements = summary(rows, run);
    elements.extend([
        PageElement::heading("Cases and paths"),
        PageElement::text(
            "Number of wrong results. Green: none. Amber: some, on a path without this requirement. Red: some, on a \
             path that must have none.",
        ),
        overview(rows),
        // Show all checks with a filter
        PageElement::heading("All checks"),
        page::filter(&[("holds", "holds"), ("measured", "measured"), ("fails", "fails")]),
        checks(rows),
        PageElement::heading("Rays and arguments"),
        PageElement::Key {
            colors: vec![
                ("right", "right"),
                ("tie", "tie: rounding explains the result"),
                ("wrong", "wrong: it does not"),
            ],
        },
    ]);
    // Show a section for each case
    elements.extend(rows.chunk_by(|a, b| a.case.id == b.case.id).map(section));
    page::page(
        "whit verify: hard cases with exact results",
        "Hard cases with exact results",
        &elements,
    )
}

/// Returns the CSS class of a verdict.
fn class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Holds => "holds",
        Verdict::Measured => "measured",
        Verdict::Fails => "fails",
    }
}

fn summary(rows: &[VerifyRow], run: &Run) -> Vec<PageElement> {
    // Count verdicts for the tiles
    let count = |verdict| rows.iter().filter(|row| row.outcome.verdict == verdict).count();
    // A tile has a colour only if its count is positive
    let tile = |verdict, words| {
        let class = if count(verdict) > 0 { class(verdict) } else { "" };
        (count(verdict).to_string(), words, class)
    };
    let text = PageElement::text(
        "Rays and arguments for which rounding decides the result, traced on every intersection path. A result that \
         differs from the exact one is wrong if the bounds on rounding do not explain it; otherwise it is a tie.",
    );
    let tiles = page::numbers(&[
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
                embree.join(", ")
            },
        ),
        ("processor", cpu::processor()),
        ("rays per case and path", run.rays.to_string()),
    ];
    if let Some(date) = &run.date {
        facts.push(("date", date.clone()));
    }
    vec![text, tiles, page::facts(&facts)]
}

/// Returns the name of a row's configuration, with the instruction set if there are several.
fn path_name(row: &VerifyRow, rows: &[VerifyRow]) -> String {
    let isas: BTreeSet<&str> = rows.iter().filter_map(|row| row.isa.as_deref()).collect();
    match &row.isa {
        Some(isa) if isas.len() > 1 => format!("{} {isa}", row.path),
        _ => row.path.to_owned(),
    }
}

/// Returns the table of wrong results with a row for each case and a column for each configuration.
fn overview(rows: &[VerifyRow]) -> PageElement {
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
    let mut table = Table::new("overview", &columns);
    // Add a row for each case
    for of_case in rows.chunk_by(|a, b| a.case.id == b.case.id) {
        let case = &of_case[0].case;
        let mut cells = vec![Cell::link(case.id, case.id), Cell::text(case.title)];
        cells.extend(paths.iter().map(|path| {
            let row = of_case.iter().find(|row| path_name(row, rows) == *path);
            row.map_or(Cell::default(), |row| {
                let wrong = row.outcome.tally.wrong.to_string();
                Cell::badge_link(&wrong, class(row.outcome.verdict), case.id)
            })
        }));
        table.row(("", case.id), &cells);
    }
    PageElement::Table(table)
}

fn checks(rows: &[VerifyRow]) -> PageElement {
    let mut table = Table::new(
        "wide filtered",
        &[
            Column::Words("case"),
            Column::Words("path"),
            Column::Words("isa"),
            Column::Words("verdict"),
            Column::Numbers("wrong"),
            Column::Numbers("ties"),
            Column::Numbers("rays"),
            Column::Numbers("worst"),
            Column::Words("bound"),
        ],
    );
    for row in rows {
        let tally = &row.outcome.tally;
        let class = class(row.outcome.verdict);
        let cells = [
            Cell::link(&format!("{} {}", row.case.id, row.case.title), row.case.id),
            Cell::text(row.path),
            Cell::text(row.isa.as_deref().unwrap_or_default()),
            Cell::badge(word(row.outcome.verdict), class),
            Cell::count(tally.wrong),
            Cell::count(tally.ties),
            Cell::count(tally.rays),
            Cell::text(&row.worst()),
            Cell::short(row.case.bound),
        ];
        table.row((class, row.case.id), &cells);
    }
    PageElement::Table(table)
}

/// Returns the section of one case: construction, requirement, figures and failures.
fn section(rows: &[VerifyRow]) -> PageElement {
    let case = &rows[0].case;
    let mut elements = vec![
        PageElement::subheading(&format!("{} {}", case.id, case.title)),
        page::facts(&[
            ("input", case.construction.to_owned()),
            ("oracle", case.oracle.to_owned()),
            ("bound", case.bound.to_owned()),
            ("required", required_of(case)),
        ]),
    ];
    elements.extend(figures::of(rows));
    let wrong = rows.iter().filter(|row| row.outcome.tally.wrong > 0);
    elements.extend(wrong.flat_map(failures));
    PageElement::Section {
        id: case.id.to_owned(),
        elements,
    }
}

/// Returns the first wrong results of a configuration with their bits, so that they can be traced again.
fn failures(row: &VerifyRow) -> [PageElement; 2] {
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
    let path = match &row.isa {
        Some(isa) => format!("{} on {isa}", row.path),
        None => row.path.to_owned(),
    };
    let words = format!(" {path}: {} wrong of {}; the first:", tally.wrong, tally.rays);
    let badge = Cell::badge(word(row.outcome.verdict), class(row.outcome.verdict));
    [
        PageElement::Paragraph {
            parts: vec![badge, Cell::text(&words)],
        },
        PageElement::Preformatted {
            text: lines.join("\n"),
        },
    ]
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
            None,
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
            assert!(html.contains(&format!(r#""to":"{id}""#)), "{id}");
        }
        // The name of a section follows its elements.
        let [h11, h35, _] = html.split(r#""id":"H"#).collect::<Vec<_>>()[..] else {
            panic!("two sections");
        };
        assert!(h11.contains(r#""right":"M"#), "rays are drawn");
        assert!(h35.contains(r#""kind":"plot""#) && h35.contains(r#""class":"right""#));
        assert!(html.contains("\\u003ctoday>") && !html.contains("<today>"));
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
        assert!(html.contains(r#""wrong":"M"#));
        assert!(html.contains(r#"["1","failed","fails"]"#));
        assert!(html.contains(r#""verdict":"fails""#));
    }
}
