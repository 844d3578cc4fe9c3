//! HTML page of error against render time: `whit cost SCENE --out`.

use std::path::Path;

use super::compare_page::viewer;
use super::page::{self, Cell, Column, PageElement, Table, View};
use super::{cost_charts, intersection_errors};
use crate::cost::{Interval, Point, Study};
use crate::image::ToneMap;
use crate::report::cpu;
use crate::report::format::{busy_line, percent, range, significant, times};
use crate::report::image::worst_tiles::{ErrorTile, crop, worst};
use crate::report::knob_name::knob_name;
use crate::report::text::cost::{choice_lines, error_ratio, format_time_factor, missing_factor_reason};

pub use super::compare_page::ComparedImages;

/// Largest number of enlarged tiles, and their scale.
const MAX_TILES: usize = 8;
const ENLARGED: u32 = 4;

/// Facts about a study besides its measurements.
#[derive(Clone, Debug)]
pub struct Facts<'a> {
    /// Path of the scene that was measured.
    pub scene: &'a Path,
    /// Version of Embree, where it found hits.
    pub embree: Option<String>,
    /// Tone mapping of the images on the page.
    pub tone: ToneMap,
    /// Date as the user gave it.
    pub date: Option<&'a str>,
}

/// Returns the page of a study; `images` belong to the base.
///
/// # Errors
///
/// Returns an error if an image has more pixels than a PNG can store.
pub fn page(study: &Study, facts: &Facts, images: &ComparedImages) -> std::io::Result<String> {
    // Show facts, main numbers and checks of the reference
    let mut elements = vec![known(study, facts), numbers(study)];
    elements.extend(checks(study));
    // Show the choice for a target
    if let Some(choice) = &study.choice {
        elements.push(PageElement::named_heading("choice", "Chosen settings"));
        let lines = choice_lines(choice);
        elements.extend(lines.iter().map(|line| PageElement::text(line.trim())));
    }
    // Show charts of error over time
    elements.extend([
        PageElement::named_heading("front", "Error over time"),
        PageElement::text(
            "All measured configurations; each changes one parameter of the base. Crosses are 95 % confidence \
             intervals. No configuration is known to lie below the line. The error of a point at the foot does not \
             differ significantly from 0.",
        ),
        cost_charts::front(study),
    ]);
    if !study.curves.is_empty() {
        elements.extend([
            PageElement::named_heading("curves", "Error over time for each parameter"),
            PageElement::text("Dashed: the fitted slope, through the mean of the points."),
            cost_charts::curves(study),
        ]);
    }
    if study.points.iter().any(|point| point.knob.is_some()) {
        elements.extend([
            PageElement::named_heading("extremes", "Range of each parameter"),
            PageElement::text(
                "Smallest and largest time and error among a parameter’s levels, relative to the base.",
            ),
            cost_charts::extremes(study),
            PageElement::named_heading("prices", "Cost of half the error"),
        ]);
        elements.extend(time_factors(study));
    }
    // Show geometric errors and images of the base
    elements.extend(intersection_errors::section(study));
    elements.push(PageElement::named_heading("pictures", "Images of the base"));
    elements.push(viewer(images, facts.tone)?);
    elements.extend(worst_tiles(images, facts.tone)?);
    // Show all configurations and the protocol
    elements.push(PageElement::named_heading("points", "All configurations"));
    elements.extend(points(study));
    elements.push(protocol(study));
    Ok(page::page("whit cost", "Error against render time", &elements))
}

fn known(study: &Study, facts: &Facts) -> PageElement {
    let reference = &study.reference;
    // List scene, image size and reference
    let [width, height] = study.size;
    let mut all = vec![
        ("scene", facts.scene.display().to_string()),
        (
            "images",
            match study.pieces_of {
                None => format!("{width}x{height} pixels on {} threads", study.threads),
                Some([all, high]) => format!(
                    "{width}x{height} pixels, patches of an image of {all}x{high}, on {} threads",
                    study.threads
                ),
            },
        ),
        (
            "reference",
            format!(
                "two halves of {} samples per pixel, by {}; the error of their mean is {} (RMS as displayed)",
                reference.spp,
                reference.paths.join(" and "),
                significant(reference.noise, 2)
            ),
        ),
        // Identify the machine and the program
        ("processor", cpu::processor()),
        ("whit", env!("CARGO_PKG_VERSION").to_owned()),
    ];
    all.extend(study.points.first().map(|base| {
        let words = format!(
            "{} s per scene and {} s per image, which the times below exclude",
            significant(base.build_seconds, 2),
            significant(base.ready_seconds, 2)
        );
        ("setup", words)
    }));
    // Add facts that may be absent
    all.extend(facts.embree.as_ref().map(|version| ("Embree", version.clone())));
    all.extend(facts.date.map(|date| ("date", date.to_owned())));
    page::facts(&all)
}

fn numbers(study: &Study) -> PageElement {
    let of_base = |of: fn(&Point) -> f64| study.points.first().map_or(f64::NAN, of);
    // Show the base's time and error first
    let seconds = significant(of_base(|base| base.seconds.value), 3);
    page::numbers(&[
        (format!("{seconds} s"), "per image of the base", ""),
        (
            significant(of_base(|base| base.rmse.value), 3),
            "RMSE of the base",
            "",
        ),
        (study.points.len().to_string(), "configurations", ""),
        (study.timing.blocks.to_string(), "timed blocks", ""),
    ])
}

/// Returns the table of the reference's checks, with a warning on top if any failed.
fn checks(study: &Study) -> Vec<PageElement> {
    let reference = &study.reference;
    let mut elements = Vec::new();
    // Warn about failed checks
    if !reference.has_converged() {
        let failed = reference.checks.iter().filter(|check| !check.holds);
        elements.push(PageElement::Alert {
            title: "REFERENCE NOT CONVERGED",
            items: failed
                .map(|check| format!("{}: {}", check.name, check.words))
                .collect(),
            text: "The errors on this page are not reliable.",
        });
    }
    // List all checks
    let mut table = Table::new(
        "checks",
        &[
            Column::Words("check of the reference"),
            Column::Words(""),
            Column::Words("measured"),
        ],
    );
    for check in &reference.checks {
        let verdict = if check.holds { "holds" } else { "fails" };
        let cells = [
            Cell::text(&check.name),
            Cell::badge(verdict, verdict),
            Cell::wrapped(&check.words),
        ];
        table.row((verdict, &check.name), &cells);
    }
    elements.push(PageElement::Table(table));
    elements
}

/// Returns tables of the cost of half the error by graded knobs, and of the levels of other knobs.
fn time_factors(study: &Study) -> Vec<PageElement> {
    let mut halves = Table::new("prices", &[Column::Words("parameter"), Column::Words("cost")]);
    for curve in &study.curves {
        let words = match study.time_factor_of_half_error(curve) {
            Some(factor) => format!("half the error takes {} the time", format_time_factor(factor)),
            None => format!("half the error: {}", missing_factor_reason(curve)),
        };
        let name = curve.knob.name();
        halves.row(("", name), &[Cell::text(name), Cell::wrapped(&words)]);
    }
    let mut elements = Vec::new();
    if !study.curves.is_empty() {
        elements.push(PageElement::Table(halves));
    }
    elements.extend(levels(study));
    elements
}

/// Returns the table of time and error of knobs without an order.
fn levels(study: &Study) -> Vec<PageElement> {
    let has_no_order = |point: &&Point| point.knob.is_some_and(|knob| !knob.is_graded());
    let others: Vec<&Point> = study.points.iter().filter(has_no_order).collect();
    if others.is_empty() {
        return Vec::new();
    }
    let mut table = Table::new(
        "levels",
        &[
            Column::Words("parameter"),
            Column::Words("level"),
            Column::Numbers("time"),
            Column::Numbers("error"),
        ],
    );
    for point in others {
        let cells = [
            Cell::text(knob_name(point)),
            Cell::text(&point.level),
            Cell::with_range(&times(point.time_ratio.value), &range(point.time_ratio, 3)),
            Cell::text(&times(error_ratio(study, point))),
        ];
        table.row(("", knob_name(point)), &cells);
    }
    vec![
        PageElement::text("Parameters without an order, relative to the base:"),
        PageElement::Table(table),
    ]
}

/// Returns the tiles where the base differs most from the reference, beside the reference.
fn worst_tiles(images: &ComparedImages, tone: ToneMap) -> std::io::Result<Vec<PageElement>> {
    let tiles = worst(images.reference, images.image, tone, MAX_TILES);
    if tiles.is_empty() {
        return Ok(Vec::new());
    }
    let figures = tiles.iter().map(|tile| enlarged(images, tile, tone));
    Ok(vec![
        PageElement::subheading("Largest differences of the base from the reference"),
        PageElement::text(&format!(
            "Enlarged {ENLARGED} times: the image at the left, the reference at the right."
        )),
        PageElement::SideBySide {
            class: "pictures crops",
            elements: figures.collect::<std::io::Result<_>>()?,
        },
    ])
}

fn enlarged(images: &ComparedImages, tile: &ErrorTile, tone: ToneMap) -> std::io::Result<PageElement> {
    // Show the image at the left and the reference at the right
    let mut pair = Vec::new();
    for (image, words) in [(images.image, "The image"), (images.reference, "The reference")] {
        let view = View {
            name: "",
            words,
            image: &crop(image, tile.at, tile.size),
            tone,
        };
        pair.push(PageElement::Image(view.image(ENLARGED)?));
    }
    let caption = format!(
        "column {}, row {}: RMSE {}",
        tile.at[0],
        tile.at[1],
        significant(tile.mse.sqrt(), 2)
    );
    Ok(PageElement::Figure {
        elements: vec![PageElement::SideBySide {
            class: "pair",
            elements: pair,
        }],
        caption,
    })
}

fn points(study: &Study) -> [PageElement; 2] {
    // Choose the columns
    let mut columns = vec![
        Column::Words("parameter"),
        Column::Words("level"),
        Column::Words("front"),
        Column::Numbers("seconds"),
        Column::Numbers("time"),
        Column::Numbers("RMSE"),
        Column::Numbers("bias"),
        Column::Numbers("deviation"),
        Column::Numbers("relMSE"),
        Column::Numbers("FLIP"),
        Column::Numbers("changed"),
        Column::Numbers("rays"),
    ];
    let has_instructions = study.points.iter().any(|point| point.instructions.is_some());
    if has_instructions {
        columns.push(Column::Numbers("instructions"));
    }
    // This column comes last, so that the header without it matches the rows.
    if study.points.iter().any(|point| point.non_finite > 0) {
        columns.push(Column::Numbers("not finite"));
    }
    let mut table = Table::new("wide dense", &columns);
    // Add a row for each configuration
    for point in &study.points {
        let mut cells = cells(point).to_vec();
        if has_instructions {
            let counted = point
                .instructions
                .map_or(Cell::default(), |count| Cell::count(count as u64));
            cells.push(counted);
        }
        cells.push(Cell::count(point.non_finite));
        table.row(("", knob_name(point)), &cells);
    }
    let text = "time: relative to the base. RMSE as displayed, black 0 and white 1: bias is the part \
         that remains however many images are averaged, deviation the part that differs between images. changed: \
         pixels off by more than 1/255. instructions: per pixel, where counted. Behind a value: its 95 % confidence \
         interval."
        .to_owned();
    [PageElement::Table(table), PageElement::Note { text }]
}

fn cells(point: &Point) -> [Cell; 12] {
    let number = |value: f64| Cell::text(&significant(value, 3));
    let interval = |of: Interval| Cell::with_range(&significant(of.value, 3), &range(of, 3));
    let front = if point.on_front {
        Cell::badge("front", "holds")
    } else {
        Cell::default()
    };
    [
        Cell::text(knob_name(point)),
        Cell::text(&point.level),
        front,
        interval(point.seconds),
        Cell::text(&times(point.time_ratio.value)),
        interval(point.rmse),
        number(point.bias_squared.value.max(0.0).sqrt()),
        number(point.variance.max(0.0).sqrt()),
        number(point.rel_mse),
        number(point.flip),
        Cell::text(&percent(point.changed_share)),
        Cell::count(point.rays),
    ]
}

fn protocol(study: &Study) -> PageElement {
    // Describe the measurement as pairs of term and text
    let timing = &study.timing;
    let facts = page::facts(&[
        (
            "times",
            "In each block every configuration runs once; a ratio is the median of the blocks’ ratios of processor time to \
             the base. Seconds are by the clock."
                .to_owned(),
        ),
        (
            "blocks",
            format!(
                "{} count, {} do not, because the same work took longer or shorter in them",
                timing.blocks, timing.dropped
            ),
        ),
        (
            "load",
            busy_line(timing.waiting).unwrap_or_else(|| "no other program delayed the measurement".to_owned()),
        ),
        (
            "calibration",
            format!(
                "the time of the same work varied by up to {} in the blocks that count",
                percent(timing.calibration_spread)
            ),
        ),
        (
            "errors",
            "Computed from two independent halves of the reference, so that its own noise does not count.".to_owned(),
        ),
        (
            "spent",
            format!(
                "{} s of a budget of {} s",
                significant(timing.spent, 3),
                significant(timing.budget, 3)
            ),
        ),
    ]);
    PageElement::Section {
        id: "protocol".to_owned(),
        elements: vec![PageElement::heading("Measurement protocol"), facts],
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::cost::{Check, Curve, Knob, Reference, Timing};
    use crate::image::LinearImage;

    fn point(knob: Option<Knob>, level: &str, ratio: f64, rmse: f64) -> Point {
        Point {
            level: level.to_owned(),
            settings: BTreeMap::from([("samples".to_owned(), "<4>".to_owned())]),
            build_seconds: 0.1,
            build_bytes: 5000,
            seconds: Interval {
                value: ratio,
                low: 0.9 * ratio,
                high: 1.1 * ratio,
            },
            bias_squared: Interval::exact(-1e-9),
            rel_mse: 0.1,
            flip: 0.05,
            max: 0.5,
            changed_share: 0.25,
            rays: 1000,
            on_front: true,
            ..Point::plain(knob, ratio, rmse)
        }
    }

    /// Returns a study of four points: the base, more samples, less depth, and another pattern.
    // Fix a slope with its interval for the samples curve
    pub(in crate::report) fn study() -> Study {
        let slope = Interval {
            value: -0.5,
            low: -0.6,
            high: -0.43,
        };
        // Two curves: one with a slope, one without
        Study {
            size: [64, 48],
            pieces_of: None,
            threads: 2,
            reference: Reference {
                spp: 1024,
                paths: ["robust".to_owned(), "<bsp>".to_owned()],
                noise: 1e-4,
                checks: vec![Check {
                    name: "noise".to_owned(),
                    holds: true,
                    words: "0.1 of 0.2".to_owned(),
                }],
            },
            timing: Timing {
                blocks: 7,
                dropped: 1,
                calibration_spread: 0.01,
                waiting: 0.0,
                spent: 50.0,
                budget: 60.0,
            },
            points: vec![
                point(None, "base", 1.0, 0.02),
                point(Some(Knob::Samples), "16", 4.0, 0.01),
                point(Some(Knob::Depth), "0", 0.5, 0.3),
                point(Some(Knob::Pattern), "r2", 1.0, 0.019),
            ],
            choice: None,
            curves: vec![
                Curve {
                    knob: Knob::Samples,
                    points: vec![0, 1],
                    slope: Some(slope),
                },
                Curve {
                    knob: Knob::Depth,
                    points: vec![2, 0],
                    slope: None,
                },
            ],
        }
    }

    fn page_of(study: &Study) -> String {
        let image = LinearImage::black(4, 3);
        let mut other = image.clone();
        other.pixels[5] = [1.0; 3];
        let images = ComparedImages {
            reference: &image,
            image: &other,
            difference: &image,
            flip: &image,
        };
        let facts = Facts {
            scene: Path::new("<scene>.gltf"),
            embree: Some("<4>".to_owned()),
            tone: ToneMap::default(),
            date: Some("<date>"),
        };
        page(study, &facts, &images).unwrap()
    }

    #[test]
    fn page_lists_cost_factors_and_no_invalid_numbers() {
        let mut study = study();
        let html = page_of(&study);
        for words in [
            "half the error takes x4.0 (3.2 to 5.0) the time",
            "samples: error ∝ time^-0.50 (-0.60 to -0.43)",
            "column 0, row 0: RMSE 0.29",
            "two halves of 1024 samples per pixel, by robust and \\u003cbsp>",
        ] {
            assert!(html.contains(words), "{words} in {html}");
        }
        for word in ["<scene>", "<bsp>", "<4>", "<date>", "NOT CONVERGED", "NaN"] {
            assert!(!html.contains(word), "{word}");
        }
        for point in &mut study.points {
            point.rmse = Interval::exact(f64::NAN);
            point.time_ratio = Interval::exact(f64::INFINITY);
            point.seconds = Interval::exact(0.0);
        }
        let html = page_of(&study);
        assert!(!html.contains("NaN"), "{html}");
    }

    #[test]
    fn page_warns_of_a_reference_that_has_not_converged() {
        let mut study = study();
        study.reference.checks[0].holds = false;
        let html = page_of(&study);
        assert!(html.contains("REFERENCE NOT CONVERGED"));
        assert!(html.contains(r#""items":["noise: 0.1 of 0.2"]"#), "{html}");
    }

    #[test]
    fn studies_of_one_and_of_no_point_have_pages() {
        let mut study = study();
        study.curves.clear();
        study.points.truncate(1);
        assert_eq!(page_of(&study).matches(r#""x":["#).count(), 1);
        study.points.clear();
        assert!(!page_of(&study).contains("NaN"));
    }
}
