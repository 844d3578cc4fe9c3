//! HTML page of a benchmark of Embree against the BSP: `whit bench --html`.

use std::path::Path;
use std::thread;

use super::bench_charts;
use super::page::{self, Cell, Column, PageElement, Table};
use crate::accel::Backend;
use crate::bench::{BenchRow, Mode};
use crate::cost::Interval;
use crate::report::cpu;
use crate::report::format::{busy_line, percent, range, significant, times};
use crate::report::memory;
use crate::report::text::bench::{BenchTable, build_efficiency, efficiency, seen_before};
use crate::report::text::crossover;
use crate::report::text::table::group_thousands;

/// Facts about the benchmark besides its rows.
#[derive(Clone, Copy, Debug)]
pub struct Facts<'a> {
    /// True if the scenes are sizes of one mesh.
    pub is_sweep: bool,
    /// Number of repetitions that medians are taken over.
    pub repeat: u32,
    /// Date as the user gave it.
    pub date: Option<&'a str>,
}

/// Returns the page of all rows; rows of a scene are grouped.
pub fn page(rows: &[BenchRow], facts: &Facts) -> String {
    let scenes = scenes(rows);
    let mut elements = vec![
        PageElement::text(
            "The same rays, recorded from each scene’s image, are traced by Embree, by whit’s own tree and by bare \
             loops over Embree’s functions.",
        ),
        known(rows, facts),
        numbers(rows, scenes.len()),
    ];
    if facts.is_sweep && scenes.len() > 1 {
        elements.extend(sweep(rows));
    }
    let scenes = scenes.iter().enumerate();
    elements.extend(scenes.map(|(number, of_scene)| section(of_scene, number)));
    elements.push(protocol(rows, facts));
    page::page("whit bench", "Embree against the BSP", &elements)
}

/// Returns the rows grouped by scene.
fn scenes(rows: &[BenchRow]) -> Vec<Vec<&BenchRow>> {
    let mut scenes: Vec<(&Path, Vec<&BenchRow>)> = Vec::new();
    for row in rows {
        match scenes.iter_mut().find(|(scene, _)| *scene == row.scene) {
            Some((_, of_scene)) => of_scene.push(row),
            None => scenes.push((&row.scene, vec![row])),
        }
    }
    scenes.into_iter().map(|(_, of_scene)| of_scene).collect()
}

fn known(rows: &[BenchRow], facts: &Facts) -> PageElement {
    let processors = thread::available_parallelism().map_or(1, usize::from);
    // Start with facts that every benchmark has
    let mut all = vec![
        (
            "processor",
            format!("{}, {processors} available", cpu::processor()),
        ),
        ("whit", env!("CARGO_PKG_VERSION").to_owned()),
    ];
    let mut versions = Vec::new();
    for embree in rows.iter().filter_map(|row| row.embree.as_ref()) {
        seen_before(&mut versions, format!("{}, {}", embree.version, embree.isa));
    }
    if !versions.is_empty() {
        all.push(("Embree", versions.join("; ")));
    }
    if let Some(row) = rows.first() {
        let words = format!(
            "builds on {} threads, rays on one unless stated otherwise",
            row.threads
        );
        all.push(("threads", words));
    }
    all.push(("repetitions", facts.repeat.to_string()));
    all.extend(facts.date.map(|date| ("date", date.to_owned())));
    page::facts(&all)
}

fn numbers(rows: &[BenchRow], scene_count: usize) -> PageElement {
    let sum = |of: fn(&BenchRow) -> u64| rows.iter().map(of).sum::<u64>();
    let wrong = sum(|row| row.mismatches);
    // Count each set of rays once, though several methods trace it
    let mut sets = Vec::new();
    let mut rays = 0;
    for row in rows {
        if !seen_before(&mut sets, (row.scene.as_path(), row.rays)) {
            rays += row.ray_count;
        }
    }
    page::numbers(&[
        (scene_count.to_string(), "scenes", ""),
        (group_thousands(rays), "rays, each traced by every method", ""),
        (
            group_thousands(wrong),
            "results that differ by more than rounding",
            if wrong > 0 { "fails" } else { "holds" },
        ),
        (group_thousands(sum(|row| row.ties)), "ties", ""),
    ])
}

/// Returns the section on speed and crossings over the size of the mesh.
fn sweep(rows: &[BenchRow]) -> Vec<PageElement> {
    let all: Vec<&BenchRow> = rows.iter().collect();
    let mut elements = vec![PageElement::named_heading("size", "Speed over mesh size")];
    // List the crossings of Embree with the other backends
    let method_pairs = crossover::method_pairs(rows);
    if !method_pairs.is_empty() {
        let mut table = Table::new(
            "crossings",
            &[
                Column::Words("what"),
                Column::Words("backend"),
                Column::Words("Embree’s precision"),
                Column::Numbers("backend over Embree"),
                Column::Words("crossings"),
            ],
        );
        for pairing in &method_pairs {
            let cells = [
                Cell::text(&pairing.what),
                Cell::text(&pairing.second.to_string()),
                Cell::text(&pairing.precision.to_string()),
                Cell::text(&pairing.ratios()),
                Cell::wrapped(&pairing.verdict()),
            ];
            table.row(("", &pairing.what), &cells);
        }
        elements.push(PageElement::text(
            "A method is ahead where all of its repetitions were better than all of the other’s. Lines cross where \
             their medians do, joined by straight lines on logarithmic axes.",
        ));
        elements.push(PageElement::Table(table));
    }
    // Append charts over the size
    elements.extend(bench_charts::speeds_over_size(&all));
    elements.extend(bench_charts::builds_over_size(&all));
    elements
}

fn section(rows: &[&BenchRow], number: usize) -> PageElement {
    let mut elements = Vec::new();
    if let Some(first) = rows.first() {
        elements.extend([
            PageElement::heading(&first.scene.display().to_string()),
            page::facts(&[("triangles", group_thousands(first.triangles))]),
            PageElement::subheading("Structures"),
            structures(rows),
            PageElement::subheading("Speed"),
            bench_charts::speeds(rows),
            speeds(rows),
        ]);
        elements.extend(frames(rows));
        if !first.scaling.is_empty() {
            elements.extend([
                PageElement::subheading("Threads"),
                PageElement::text("Dashed: ideal scaling of the speed of one thread."),
                bench_charts::scaling(rows),
            ]);
            elements.extend(scaling(rows));
        }
    }
    PageElement::Section {
        id: format!("scene{number}"),
        elements,
    }
}

/// Returns the first row of each acceleration structure.
fn of_structures<'r>(rows: &[&'r BenchRow]) -> Vec<&'r BenchRow> {
    let mut seen = Vec::new();
    let rows = rows.iter().copied();
    rows.filter(|row| !seen_before(&mut seen, row.structure()))
        .collect()
}

fn structures(rows: &[&BenchRow]) -> PageElement {
    let mut table = Table::new(
        "structures",
        &[
            Column::Words("structure"),
            Column::Words("precision"),
            Column::Numbers("build, s"),
            Column::Numbers("memory"),
            Column::Numbers("bytes per triangle"),
        ],
    );
    for row in of_structures(rows) {
        let name = row.name();
        let bytes = row.bytes_per_triangle();
        let cells = [
            Cell::text(&name),
            Cell::text(&row.precision.to_string()),
            with_range(row.build()),
            Cell::text(&memory::in_words(row.bytes)),
            Cell::text(&bytes.map_or("–".to_owned(), |bytes| significant(bytes, 3))),
        ];
        table.row(("", &name), &cells);
    }
    PageElement::Table(table)
}

fn with_range(value: Interval) -> Cell {
    Cell::with_range(&significant(value.value, 3), &range(value, 3))
}

fn speeds(rows: &[&BenchRow]) -> PageElement {
    let owned: Vec<BenchRow> = rows.iter().copied().cloned().collect();
    let ratios = BenchTable(&owned);
    let mut table = Table::new(
        "speeds",
        &[
            Column::Words("rays"),
            Column::Words("structure"),
            Column::Words("mode"),
            Column::Numbers("Mrays/s"),
            Column::Numbers("relative to Embree"),
            Column::Numbers("rays"),
            Column::Numbers("wrong"),
            Column::Numbers("ties"),
        ],
    );
    for row in rows {
        let verdict = if row.mismatches > 0 { "fails" } else { "holds" };
        let cells = [
            Cell::text(&row.rays.to_string()),
            Cell::text(&row.name()),
            Cell::text(&row.mode.to_string()),
            with_range(row.speed()),
            Cell::text(&ratios.over_embree(row).map_or(String::new(), times)),
            Cell::count(row.ray_count),
            Cell::badge(&row.mismatches.to_string(), verdict),
            Cell::count(row.ties),
        ];
        table.row((verdict, &row.name()), &cells);
    }
    PageElement::Table(table)
}

/// Returns the table of render-loop times, at each precision for which frames were rendered.
fn frames(rows: &[&BenchRow]) -> Option<PageElement> {
    let mut table = Table::new(
        "frames",
        &[
            Column::Words("whole frame, one thread"),
            Column::Numbers("seconds"),
            Column::Numbers("rays"),
            Column::Numbers("relative to bare calls"),
            Column::Numbers("tracing"),
        ],
    );
    let mut seen = Vec::new();
    // Frame times in the BSP's rows repeat those of the first row.
    let own = |row: &&&BenchRow| row.backend == Backend::Embree && row.mode == Mode::Packet;
    for row in rows.iter().filter(own) {
        let Some(frame) = row.frame else { continue };
        if seen_before(&mut seen, row.precision) {
            continue;
        }
        let cells = [
            Cell::text(&row.name()),
            Cell::text(&significant(frame.seconds, 3)),
            Cell::count(frame.rays),
            Cell::text(&times(frame.over_raw)),
            Cell::text(&percent(frame.trace_share)),
        ];
        table.row(("", &row.name()), &cells);
    }
    (!seen.is_empty()).then_some(PageElement::Table(table))
}

/// Returns the table of build times and speeds by number of threads.
fn scaling(rows: &[&BenchRow]) -> [PageElement; 2] {
    // Create a column for each number of threads
    let counts = rows.first().map_or(&[][..], |row| &row.scaling);
    let names: Vec<String> = counts
        .iter()
        .map(|scaled| format!("{} threads", scaled.threads))
        .collect();
    let mut columns = vec![
        Column::Words("what"),
        Column::Words("structure"),
        Column::Words("mode"),
    ];
    columns.extend(names.iter().map(|name| Column::Numbers(name)));
    columns.push(Column::Numbers("efficiency"));
    let mut table = Table::new("scaling dense", &columns);
    let efficiency_cell = |part: Option<f64>| Cell::text(&part.map_or(String::new(), percent));
    // Add the build times of each structure
    for row in of_structures(rows) {
        let mut cells = vec![Cell::text("build, s"), Cell::text(&row.name()), Cell::default()];
        cells.extend(row.build_scaling.iter().map(|build| {
            with_range(Interval {
                value: build.build_seconds,
                low: build.build_seconds_min,
                high: build.build_seconds_max,
            })
        }));
        cells.push(efficiency_cell(build_efficiency(&row.build_scaling)));
        table.row(("", &row.name()), &cells);
    }
    // Add the speeds of each row
    for row in rows {
        let mut cells = vec![
            Cell::text(&format!("{} rays, Mrays/s", row.rays)),
            Cell::text(&row.name()),
            Cell::text(&row.mode.to_string()),
        ];
        cells.extend(row.scaling.iter().map(|scaled| with_range(scaled.speed())));
        cells.push(efficiency_cell(efficiency(&row.scaling)));
        table.row(("", &row.name()), &cells);
    }
    let text =
        "efficiency: the speed on the most threads relative to ideal scaling of one thread.".to_owned();
    [PageElement::Table(table), PageElement::Note { text }]
}

fn protocol(rows: &[BenchRow], facts: &Facts) -> PageElement {
    // Describe rays, modes, times and comparison
    let mut all = vec![
        (
            "rays",
            "Camera, shadow and reflection rays are recorded from a render of the image, in its order; random rays \
             start anywhere within the scene’s bounds. At most 1 048 576 of each kind are kept, in evenly spaced runs."
                .to_owned(),
        ),
        (
            "modes",
            "raw: a bare loop over Embree’s functions for 16 rays; raw-single: for one ray; packet: 16 rays at a time \
             through whit; single: one ray at a time; batch: 64 packets at once."
                .to_owned(),
        ),
        (
            "times",
            format!(
                "Each method runs once in each of {} repetitions. Values are medians, followed by the minimum and the \
                 maximum; bars and crosses show the same range. Speeds of one thread are by processor time, \
                 builds by the clock.",
                facts.repeat
            ),
        ),
        (
            "results",
            "Compared with those of the packets that are listed first, and bare calls with their own; wrong results \
             differ by more than the bound on rounding, ties by less."
                .to_owned(),
        ),
    ];
    // Describe what only some benchmarks have
    let waiting = rows.iter().map(|row| row.waiting).fold(0.0, f64::max);
    all.extend(busy_line(waiting).map(|line| ("load", line)));
    if facts.is_sweep {
        let words = "A closed, displaced, reflective sphere over a plane, lit by a point light; the number of \
                     triangles grows, the image stays the same.";
        all.push(("meshes", words.to_owned()));
    }
    if rows.iter().any(|row| !row.scaling.is_empty()) {
        let words = "The same packets, divided among the threads in parts of at least 64, and builds on as many threads, by the clock.";
        all.push(("several threads", words.to_owned()));
    }
    PageElement::Section {
        id: "protocol".to_owned(),
        elements: vec![PageElement::heading("Measurement protocol"), page::facts(&all)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::EmbreeIdentity;
    use crate::bench::{FrameTime, Scaled, ScaledBuild};
    use crate::report::text::bench::tests::row;

    const FACTS: Facts = Facts {
        is_sweep: true,
        repeat: 3,
        date: Some("<date>"),
    };

    fn rows() -> Vec<BenchRow> {
        let mut all = Vec::new();
        for triangles in [1_000, 10_000] {
            for (backend, mode) in [
                (Backend::Embree, Mode::Packet),
                (Backend::Embree, Mode::RawSingle),
                (Backend::Bsp, Mode::Batch),
            ] {
                all.push(BenchRow {
                    scene: format!("<{triangles}>").into(),
                    triangles,
                    embree: Some(EmbreeIdentity {
                        version: "<4>".to_owned(),
                        isa: "avx2".to_owned(),
                    }),
                    ..row(backend, mode, 12.0)
                });
            }
        }
        all
    }

    #[test]
    fn page_lists_all_rows_and_no_invalid_numbers() {
        // Check a page of valid rows
        let mut rows = rows();
        let html = page(&rows, &FACTS);
        for words in [
            "no method is significantly ahead at any size",
            "raw-single",
            "\\u003c1000>",
            "\\u003cdate>",
        ] {
            assert!(html.contains(words), "{words} in {html}");
        }
        for word in ["<1000>", "<4>", "<date>", "NaN", "several threads"] {
            assert!(!html.contains(word), "{word}");
        }
        // Check a page of rows with invalid numbers
        for row in &mut rows {
            row.mrays_per_s = f64::NAN;
            row.mrays_per_s_max = f64::INFINITY;
            row.build_seconds = 0.0;
            row.triangles = 0;
            row.mismatches = 1;
        }
        let html = page(&rows, &FACTS);
        assert!(!html.contains("NaN"), "{html}");
        assert!(html.contains(r#""results that differ by more than rounding","fails""#));
        assert!(!page(&[], &FACTS).contains("NaN"));
    }

    #[test]
    fn page_lists_frames_and_threads_where_measured() {
        // Add frame times and speeds on several threads
        let mut rows = rows();
        // Only one row has a frame time
        rows[0].frame = Some(FrameTime {
            seconds: 0.5,
            rays: 1000,
            over_raw: 1.25,
            trace_share: 0.75,
        });
        for row in &mut rows {
            row.scaling = vec![
                Scaled {
                    threads: 1,
                    mrays_per_s: 10.0,
                    mrays_per_s_min: 9.0,
                    mrays_per_s_max: 11.0,
                },
                Scaled {
                    threads: 4,
                    mrays_per_s: 30.0,
                    mrays_per_s_min: 29.0,
                    mrays_per_s_max: 31.0,
                },
            ];
            row.build_scaling = vec![ScaledBuild {
                threads: 1,
                build_seconds: 1.0,
                build_seconds_min: 1.0,
                build_seconds_max: 1.0,
            }];
        }
        let html = page(&rows, &FACTS);
        // The efficiency is 30 over 4 times 10.
        for words in [
            "x1.25",
            "75 %",
            "several threads",
            "29.0 to 31.0",
            "camera rays: embree robust, packet",
        ] {
            assert!(html.contains(words), "{words} in {html}");
        }
    }
}
