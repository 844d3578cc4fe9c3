//! HTML page of the cross-check of scenes' own rays by two backends: `whit verify SCENE --html`.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::page::{self, Cell, Column, Table, escape, figure};
use crate::image::{LinearImage, ToneMap, png_bytes};
use crate::report::cpu;
use crate::report::text::cross_check::{CrossCheckReport, format_counts};
use crate::report::text::table::group_thousands;
use crate::verify::{Difference, bits};

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
    let mut body = "<h1>Cross-check of the scenes’ own rays</h1>\n\
                    <p>The rays of each scene’s image were traced through two structures. Where the results differ, \
                    the bounds on rounding separate ties from wrong results.</p>\n"
        .to_owned();
    // Sum the counts over all scenes
    let sum = |of: fn(&CrossCheckReport) -> u64| scenes.iter().map(|part| of(part.report)).sum::<u64>();
    let wrong = sum(|report| report.rays.values().map(|rays| rays.wrong_count()).sum());
    let ties = sum(|report| report.rays.values().map(|rays| rays.tie_count()).sum());
    let rays = sum(|report| report.rays.values().map(|rays| rays.rays).sum());
    body += &page::numbers(&[
        (scenes.len().to_string(), "scenes", ""),
        (group_thousands(rays), "rays", ""),
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
        ("processor", escape(&cpu::processor())),
    ];
    if let Some(date) = date {
        facts.push(("date", escape(date)));
    }
    body += &page::facts(&facts);
    // Append a section for each scene
    for (number, part) in scenes.iter().enumerate() {
        body += &section(part, number);
    }
    page::page("whit verify: scenes’ own rays", &body)
}

fn section(part: &Part, number: usize) -> String {
    let report = part.report;
    let mut html = format!(
        "<section id=\"scene{number}\">\n<h2>{}</h2>\n",
        escape(&report.scene.display().to_string())
    );
    let [first, second] = &report.backends;
    html += &page::facts(&[("first", escape(first)), ("second", escape(second))]);
    if let Some(overlay) = part.overlay {
        html += &overlay_figure(report, overlay);
    }
    html += "<h3>Rays</h3>\n";
    html += &rays(report);
    html += &differences(report);
    html += "<h3>Meshes</h3>\n";
    html += &meshes(report);
    for warning in &report.warnings {
        html += &format!("<p>Loading: {}</p>\n", escape(warning));
    }
    html + "</section>\n"
}

fn overlay_figure(report: &CrossCheckReport, overlay: &LinearImage) -> String {
    // An image too large for a PNG is too large for a page.
    let Ok(png) = png_bytes(overlay, ToneMap::default()) else {
        return String::new();
    };
    let [wrong, ties] = report.legend();
    let words = format!("The dimmed image with the rays that differ: red {wrong}; yellow {ties}");
    let words = escape(&words);
    let image = format!(
        "<img width=\"{}\" height=\"{}\" alt=\"{words}\" src=\"data:image/png;base64,{}\">",
        overlay.width,
        overlay.height,
        STANDARD.encode(png)
    );
    figure(&image, &words)
}

fn rays(report: &CrossCheckReport) -> String {
    let mut table = Table::new(&[
        Column::Words("rays"),
        Column::Numbers("traced"),
        Column::Numbers("wrong"),
        Column::Words("at"),
        Column::Numbers("ties"),
        Column::Words("at"),
    ]);
    for (kind, rays) in report.comparisons() {
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
    table.html("")
}

/// Returns the first differing rays with their bits, so that they can be traced again.
fn differences(report: &CrossCheckReport) -> String {
    let mut all: Vec<&Difference> = report.differences().collect();
    if all.is_empty() {
        return String::new();
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
    format!(
        "<p>The first {} of {} recorded differences:</p>\n<pre>{}</pre>\n",
        lines.len(),
        all.len(),
        escape(&lines.join("\n"))
    )
}

fn meshes(report: &CrossCheckReport) -> String {
    let triangles = group_thousands(report.meshes.triangles);
    let advice = report.meshes.advice();
    if advice.is_empty() {
        let state = if report.meshes.triangles > 0 {
            ", closed and clean"
        } else {
            ""
        };
        return format!("<p>{triangles} triangles{state}.</p>\n");
    }
    let mut table = Table::new(&[
        Column::Numbers("count"),
        Column::Words("defect"),
        Column::Words("remedy"),
    ]);
    for (count, what, remedy) in advice {
        let cells = [Cell::count(count), Cell::wrapped(what), Cell::wrapped(remedy)];
        table.row(("", ""), &cells);
    }
    format!("<p>{triangles} triangles:</p>\n{}", table.html(""))
}
