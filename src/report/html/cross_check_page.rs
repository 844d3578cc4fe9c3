//! HTML page of the cross-check of scenes' own rays by pairs of backends: `whit verify SCENE --html`.

use super::page::{self, Cell, Column, PageElement, Table, View};
use crate::image::{LinearImage, ToneMap};
use crate::report::cpu;
use crate::report::text::cross_check::{CrossCheckReport, PairReport, format_counts};
use crate::report::text::table::group_thousands;
use crate::verify::{BackendComparison, Difference, bits};

/// Largest number of differences whose bits are listed, wrong ones first.
const MAX_SHOWN: usize = 24;

/// Section of the page for one scene.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    /// Cross-check results of the scene.
    pub report: &'a CrossCheckReport,
    /// Image with markers for the differences.
    pub overlay: Option<&'a LinearImage>,
}

/// Returns the page of all scenes; `date` is shown as the user gave it.
pub fn page(scenes: &[Part], date: Option<&str>) -> String {
    // Sum the counts over all scenes
    let sum = |of: fn(&BackendComparison) -> u64| -> u64 {
        scenes
            .iter()
            .flat_map(|part| part.report.all_rays())
            .map(of)
            .sum()
    };
    let wrong = sum(BackendComparison::wrong_count);
    let ties = sum(BackendComparison::tie_count);
    let rays = sum(|rays| rays.rays);
    let tiles = page::numbers(&[
        (scenes.len().to_string(), "scenes", ""),
        (group_thousands(rays), "comparisons", ""),
        (
            wrong.to_string(),
            "wrong",
            if wrong > 0 { "fails" } else { "holds" },
        ),
        (group_thousands(ties), "ties", ""),
    ]);
    // List facts about the run
    let mut facts = vec![
        ("whit", env!("CARGO_PKG_VERSION").to_owned()),
        ("processor", cpu::processor()),
    ];
    if let Some(date) = date {
        facts.push(("date", date.to_owned()));
    }
    // Append a section for each scene
    let mut elements = vec![
        PageElement::text(
            "The rays of each scene’s image were traced through pairs of structures. Where the results differ, the \
             bounds on rounding separate ties from wrong results.",
        ),
        tiles,
        page::facts(&facts),
    ];
    let scenes = scenes.iter().enumerate();
    elements.extend(scenes.map(|(number, part)| section(part, number)));
    page::page(
        "whit verify: scenes’ own rays",
        "Cross-check of the scenes’ own rays",
        &elements,
    )
}

fn section(part: &Part, number: usize) -> PageElement {
    let report = part.report;
    let mut elements = vec![PageElement::heading(&report.scene.display().to_string())];
    elements.extend(part.overlay.and_then(|overlay| overlay_figure(report, overlay)));
    for pair in &report.pairs {
        let [first, second] = &pair.backends;
        elements.extend([
            PageElement::subheading("Rays"),
            page::facts(&[("first", first.clone()), ("second", second.clone())]),
            rays(pair),
        ]);
        elements.extend(differences(pair));
    }
    elements.push(PageElement::subheading("Meshes"));
    elements.extend(meshes(report));
    let warnings = report.warnings.iter();
    elements.extend(warnings.map(|warning| PageElement::text(&format!("Loading: {warning}"))));
    PageElement::Section {
        id: format!("scene{number}"),
        elements,
    }
}

/// Returns the overlay; `None` if it is too large for a PNG, and so for a page.
fn overlay_figure(report: &CrossCheckReport, overlay: &LinearImage) -> Option<PageElement> {
    let [wrong, ties] = report.legend();
    let words = format!("The dimmed image with the rays that differ: red {wrong}; yellow {ties}");
    let view = View {
        name: "",
        words: &words,
        image: overlay,
        tone: ToneMap::default(),
    };
    Some(PageElement::Figure {
        elements: vec![PageElement::Image(view.image(1).ok()?)],
        caption: words.clone(),
    })
}

fn rays(pair: &PairReport) -> PageElement {
    let mut table = Table::new(
        "",
        &[
            Column::Words("rays"),
            Column::Numbers("traced"),
            Column::Numbers("wrong"),
            Column::Words("at"),
            Column::Numbers("ties"),
            Column::Words("at"),
        ],
    );
    for (kind, rays) in pair.comparisons() {
        let verdict = if rays.wrong_count() > 0 { "fails" } else { "holds" };
        let places = |counts| format_counts(counts).trim_matches([' ', '(', ')']).to_owned();
        let cells = [
            Cell::text(kind.word()),
            Cell::count(rays.rays),
            Cell::badge(&rays.wrong_count().to_string(), verdict),
            Cell::wrapped(&places(&rays.wrong)),
            Cell::count(rays.tie_count()),
            Cell::wrapped(&places(&rays.ties)),
        ];
        table.row((verdict, kind.word()), &cells);
    }
    PageElement::Table(table)
}

/// Returns the first differing rays with their bits, so that they can be traced again.
fn differences(pair: &PairReport) -> Vec<PageElement> {
    let mut all: Vec<&Difference> = pair.differences().collect();
    if all.is_empty() {
        return Vec::new();
    }
    // The sort is stable, so that rays keep their order.
    all.sort_by_key(|difference| !difference.is_wrong);
    let lines: Vec<String> = all
        .iter()
        .take(MAX_SHOWN)
        .map(|difference| {
            let verdict = if difference.is_wrong { "wrong" } else { "tie" };
            format!(
                "{} ray, {verdict}, {}: {difference}\n    bits {}",
                difference.kind.word(),
                difference.feature.name(),
                bits(&difference.ray)
            )
        })
        .collect();
    let words = format!("The first {} of {} recorded differences:", lines.len(), all.len());
    let text = lines.join("\n");
    vec![PageElement::text(&words), PageElement::Preformatted { text }]
}

fn meshes(report: &CrossCheckReport) -> Vec<PageElement> {
    let triangles = group_thousands(report.meshes.triangles);
    let advice = report.meshes.advice();
    if advice.is_empty() {
        let state = if report.meshes.triangles > 0 {
            ", closed and clean"
        } else {
            ""
        };
        return vec![PageElement::text(&format!("{triangles} triangles{state}."))];
    }
    let mut table = Table::new(
        "",
        &[
            Column::Numbers("count"),
            Column::Words("defect"),
            Column::Words("remedy"),
        ],
    );
    for (count, what, remedy) in advice {
        let cells = [Cell::count(count), Cell::wrapped(what), Cell::wrapped(remedy)];
        table.row(("", ""), &cells);
    }
    vec![
        PageElement::text(&format!("{triangles} triangles:")),
        PageElement::Table(table),
    ]
}
