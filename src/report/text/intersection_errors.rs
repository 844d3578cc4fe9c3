//! Geometric errors as text: leaks, false hits and false shadows.

use crate::cost::{GeometricErrors, Point, Study};
use crate::report::knob_name::BASE;

/// Returns the points for which geometric errors were counted.
pub(in crate::report) fn counted(study: &Study) -> impl Iterator<Item = (&Point, &GeometricErrors)> {
    let points = study.points.iter();
    points.filter_map(|point| Some((point, point.geometry.as_ref()?)))
}

pub(in crate::report) fn kinds(errors: &GeometricErrors) -> String {
    format!(
        "{} leaks, {} false hits, {} false shadows, {} light leaks",
        errors.leaks, errors.false_hits, errors.false_shadows, errors.light_leaks
    )
}

/// Returns a line for each configuration with wrong results, or a single line that none was wrong; empty where no
/// errors were counted.
pub(in crate::report) fn lines(study: &Study) -> Vec<String> {
    let wrong = counted(study).filter(|(_, errors)| errors.count() > 0);
    let mut lines: Vec<String> = wrong
        .map(|(point, errors)| {
            let name = match point.knob {
                Some(knob) => format!("{knob} {}", point.level),
                None => BASE.to_owned(),
            };
            format!("geometry: {name}: {} of {} rays", kinds(errors), errors.rays())
        })
        .collect();
    // State that no result was wrong, with the largest number of rays
    if lines.is_empty()
        && let Some((_, errors)) = counted(study).max_by_key(|(_, errors)| errors.rays())
    {
        lines.push(format!(
            "geometry: none of up to {} rays has a wrong result on any path",
            errors.rays()
        ));
    }
    lines
}
