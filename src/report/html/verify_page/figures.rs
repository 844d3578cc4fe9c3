//! Figures of verification cases: rays with the objects that they hit, close-ups, and errors over arguments.

use glam::{DVec2, DVec3};

use crate::report::html::page::{Drawing, Mark, PageElement, Plot, Region};
use crate::report::text::verify::VerifyRow;
use crate::verify::{CloseUp, Correctness, FigureAxis, FigureData, TracedRay, view};

/// Side of the figure of all rays, in pixels.
const LARGE: u32 = 360;
/// Side of a close-up in pixels.
const SMALL: u32 = 148;
/// Largest ratio of an object's size to its hit region at which the whole object is shown.
const WHOLE: f64 = 4.0;

/// Returns the CSS class of a result.
fn class(correctness: Correctness) -> &'static str {
    match correctness {
        Correctness::Right => "right",
        Correctness::Tie => "tie",
        Correctness::Wrong => "wrong",
    }
}

/// Returns the figures of one case from its rows: of the configuration with the most wrong results, or of the first.
pub(super) fn of(rows: &[VerifyRow]) -> Option<PageElement> {
    let badness = |row: &&VerifyRow| (row.outcome.tally.wrong, row.outcome.tally.ties);
    let row = rows.iter().rev().max_by_key(badness)?;
    let figure_data = &row.outcome.tally.figure_data;
    let mut elements = Vec::new();
    if let Some(axis) = figure_data.axis {
        elements.push(errors(figure_data, axis, row.case.unit));
    }
    elements.extend(whole(figure_data, row.path));
    if !figure_data.close_ups.is_empty() {
        let views = figure_data.close_ups.iter();
        elements.push(PageElement::SideBySide {
            class: "small",
            elements: views.map(|view| close_up(figure_data, view)).collect(),
        });
    }
    (!elements.is_empty()).then_some(PageElement::SideBySide {
        class: "pictures",
        elements,
    })
}

fn errors(figure_data: &FigureData, axis: FigureAxis, unit: &str) -> PageElement {
    let marks: Vec<Mark> = figure_data
        .shown_errors()
        .filter(|error| error.at.is_finite())
        .map(|error| Mark {
            x: error.at,
            y: error.off,
            class: class(error.correctness),
        })
        .collect();
    let caption = format!("{} of the tested arguments, including the worst", marks.len());
    let plot = Plot {
        x_label: axis.label.to_owned(),
        y_label: format!("error, {unit}"),
        limit: axis.bound,
        marks,
    };
    PageElement::Figure {
        elements: vec![PageElement::Plot(plot)],
        caption,
    }
}

/// Returns a point's projection into the plane of the figure.
fn seen(p: DVec3) -> DVec2 {
    let [right, up, _] = view();
    DVec2::new(p.dot(right), p.dot(up))
}

/// Returns the reported hit point of a ray; `None` for a miss.
fn end(traced: &TracedRay) -> Option<DVec3> {
    let hit = traced.hit.filter(|_| traced.ray.is_traceable())?;
    Some(traced.ray.at(hit.t.into())).filter(|p| p.is_finite())
}

/// Returns the figure of all recorded rays with the outline of the objects.
fn whole(figure_data: &FigureData, path: &str) -> Option<PageElement> {
    let wireframe = figure_data.wireframe.as_ref()?;
    // Choose the visible region: the whole object unless it is too large
    let ends: Vec<DVec2> = figure_data.traced.iter().filter_map(end).map(seen).collect();
    let lines: Vec<[DVec2; 2]> = wireframe.lines.iter().map(|line| line.map(seen)).collect();
    let target: Vec<DVec2> = wireframe.target.iter().flatten().map(|&p| seen(p)).collect();
    let region = match (Region::around(&ends), Region::holding(&target)) {
        (Some(ends), Some(target)) if target.half <= WHOLE * ends.half => Some(target),
        (Some(ends), _) => Some(ends),
        (None, target) => target,
    }?;
    // Draw the outline and the hit primitives
    let mut drawing = Drawing::new(region, LARGE);
    for &line in &lines {
        drawing.line("outline", line);
    }
    for line in &wireframe.hit_triangles {
        drawing.line("met", line.map(seen));
    }
    // This distance is beyond any corner of the view.
    let far = 4.0 * (region.half + region.center.length());
    for traced in figure_data
        .traced
        .iter()
        .filter(|traced| traced.ray.is_traceable())
    {
        let start = traced.ray.origin.as_dvec3();
        let way = traced.ray.direction.as_dvec3().normalize_or_zero();
        let stop = end(traced).unwrap_or(start + (far + start.length()) * way);
        drawing.line(class(traced.correctness), [seen(start), seen(stop)]);
    }
    // Draw hit points above the rays
    for traced in &figure_data.traced {
        if let Some(p) = end(traced) {
            drawing.dot(class(traced.correctness), seen(p));
        }
    }
    // Describe the figure in words
    let count = |correctness| {
        let of_kind = figure_data
            .traced
            .iter()
            .filter(|traced| traced.correctness == correctness);
        of_kind.count()
    };
    let words = format!(
        "The first rays on {path}: {} right, {} ties, {} wrong. A dot marks a reported hit. \
         The view is {} wide.",
        count(Correctness::Right),
        count(Correctness::Tie),
        count(Correctness::Wrong),
        length(2.0 * region.half)
    );
    Some(drawn(drawing, words))
}

/// Returns the close-up of the triangles around one ray, in the direction of the ray.
fn close_up(figure_data: &FigureData, view: &CloseUp) -> PageElement {
    let traced = &figure_data.traced[view.traced];
    let region = Region {
        center: DVec2::ZERO,
        half: 1.0,
    };
    let mut drawing = Drawing::new(region, SMALL);
    for &triangle in &view.triangles {
        drawing.triangle("outline", triangle);
    }
    drawing.dot(class(traced.correctness), DVec2::ZERO);
    let result = match (traced.correctness, traced.hit) {
        (Correctness::Right, _) => "right",
        (Correctness::Tie, _) => "tie",
        (Correctness::Wrong, None) => "wrong: miss",
        (Correctness::Wrong, Some(_)) => "wrong",
    };
    let words = format!("along a ray, {result}; {} wide", length(2.0 * view.size));
    drawn(drawing, words)
}

/// Returns the figure of a drawing with its description as caption.
fn drawn(drawing: Drawing, caption: String) -> PageElement {
    PageElement::Figure {
        elements: vec![PageElement::Drawing(drawing.described(&caption))],
        caption,
    }
}

/// Formats a length with three significant digits.
fn length(x: f64) -> String {
    // Between 0.01 and 10000, positional notation is easier to read than powers of ten.
    if (0.01..1e4).contains(&x) {
        let digits = (2.0 - x.log10().floor()).max(0.0) as usize;
        format!("{x:.digits$}")
    } else {
        format!("{x:.2e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_have_three_digits() {
        let words = [0.01234, 1.5, 4023.4, 12_345.0, 1.5e-9].map(length);
        assert_eq!(words, ["0.0123", "1.50", "4023", "1.23e4", "1.50e-9"]);
    }
}
