//! Text and CSV forms of a study of error against render time: `whit cost`.

use std::fmt;
use std::fmt::Write;

use super::intersection_errors;
use crate::cost::{Choice, Curve, Interval, Point, Study, Target};
use crate::report::format::{busy_line, range, significant, times};
use crate::report::knob_name::knob_name;

/// Column names of [`points_csv`].
const COLUMNS: &str = "id,knob,level,build,ready,t_med,t_lo,t_hi,ratio,ratio_lo,ratio_hi,rmse,rmse_lo,rmse_hi,bias2,var,rel_mse,flip,max,\
                       changed,non_finite,rays,front,build_bytes,camera_rays,shadow_rays,leaks,false_hits,false_shadows,light_leaks,ties,instructions";

/// Text form of a study for the terminal.
#[derive(Clone, Copy, Debug)]
pub struct CostText<'a>(pub &'a Study);

/// Prints every configuration on a line, then the cost of half the error by each knob, then the failed checks of the
/// reference.
impl fmt::Display for CostText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let study = self.0;
        // Align the columns
        let rows: Vec<[String; 5]> = study.points.iter().map(row).collect();
        let head = ["parameter", "level", "time", "RMSE", ""].map(str::to_owned);
        let widths: [usize; 5] = std::array::from_fn(|column| {
            let cells = rows.iter().chain([&head]);
            cells
                .map(|row| row[column].chars().count())
                .max()
                .unwrap_or_default()
        });
        // Print a line for each configuration
        for [knob, level, time, rmse, front] in [&head].into_iter().chain(&rows) {
            let [a, b, c, d, _] = widths;
            let line = format!("{knob:<a$}  {level:<b$}  {time:>c$}  {rmse:>d$}  {front}");
            writeln!(f, "{}", line.trim_end())?;
        }
        if let Some(base) = study.points.first() {
            let seconds = significant(base.seconds.value, 3);
            writeln!(
                f,
                "times are ratios to the {seconds} s of the base; * no other configuration is known to be both \
                 faster and more accurate"
            )?;
        }
        if let Some(line) = busy_line(study.timing.waiting) {
            writeln!(f, "{line}")?;
        }
        // Print the cost of half the error, geometric errors and the choice
        for curve in &study.curves {
            writeln!(f, "{}", time_factor_line(study, curve))?;
        }
        for line in intersection_errors::lines(study) {
            writeln!(f, "{line}")?;
        }
        if let Some(choice) = &study.choice {
            for line in choice_lines(choice) {
                writeln!(f, "{line}")?;
            }
        }
        write_failed_checks(study, f)
    }
}

fn row(point: &Point) -> [String; 5] {
    let front = if point.on_front { "*" } else { "" };
    [
        knob_name(point).to_owned(),
        point.level.clone(),
        times(point.time_ratio.value),
        significant(point.rmse.value, 3),
        front.to_owned(),
    ]
}

/// Returns the ratio of a point's error to the base's.
pub(in crate::report) fn error_ratio(study: &Study, point: &Point) -> f64 {
    let base = study.points.first().map_or(f64::NAN, |base| base.rmse.value);
    point.rmse.value / base
}

fn time_factor_line(study: &Study, curve: &Curve) -> String {
    match study.time_factor_of_half_error(curve) {
        Some(factor) => format!(
            "half the error with {}: {} the time",
            curve.knob,
            format_time_factor(factor)
        ),
        None => format!(
            "half the error with {}: {}",
            curve.knob,
            missing_factor_reason(curve)
        ),
    }
}

/// Formats a cost factor with its interval.
pub(in crate::report) fn format_time_factor(price: Interval) -> String {
    format!("x{} ({})", significant(price.value, 2), range(price, 2))
}

/// Returns the reason for which a curve has no cost of half the error.
pub(in crate::report) fn missing_factor_reason(curve: &Curve) -> &'static str {
    match curve.slope {
        None => "too few points to fit the cost",
        Some(_) => "the error does not fall significantly with time",
    }
}

/// Returns the description of the chosen settings, line by line.
pub(in crate::report) fn choice_lines(choice: &Choice) -> Vec<String> {
    // Describe the target and the settings
    let target = match choice.target {
        Target::Error(most) => format!("an error of at most {}", significant(most, 3)),
        Target::Seconds(most) => format!("at most {} s per image", significant(most, 3)),
    };
    let settings: Vec<String> = choice
        .settings
        .iter()
        .map(|(name, value)| format!("{name} {value}"))
        .collect();
    let measured = |of: Interval| format!("{} ({})", significant(of.value, 3), range(of, 3));
    // Compare the measurements with the prediction
    let mut lines = vec![
        format!(
            "{} {target}: {}",
            if choice.reached { "for" } else { "nearest to" },
            settings.join(", ")
        ),
        format!(
            "  {}: RMSE {}, {} s for the whole image; predicted {} and {} s",
            if choice.reached {
                "measured on images that were not used for the choice"
            } else {
                "measured"
            },
            measured(choice.rmse),
            measured(choice.whole_seconds),
            significant(choice.foretold_rmse, 3),
            significant(choice.foretold_seconds, 3)
        ),
    ];
    // Name the knob that limits the error
    if !choice.reached
        && let Some((floor, knob)) = choice.floor
    {
        lines.push(format!(
            "  the smallest predicted error of any settings is {}; a wider range of {knob} would lower it most",
            significant(floor, 3)
        ));
    }
    lines
}

/// Text about an image that was rendered with chosen settings.
#[derive(Clone, Copy, Debug)]
pub struct AimText<'a> {
    /// Study that chose the settings.
    pub study: &'a Study,
    /// Error of the image, if it was measured.
    pub rmse: Option<Interval>,
    /// Seconds from the build of the acceleration structure to the last sample.
    pub seconds: f64,
}

/// Prints the choice, the settings that differ from the base, and the measured image.
impl fmt::Display for AimText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Some(choice) = &self.study.choice else {
            return Ok(());
        };
        for line in choice_lines(choice) {
            writeln!(f, "{line}")?;
        }
        // List settings that differ from the base
        let before = self.study.points.first().map(|base| &base.settings);
        let changed: Vec<String> = choice
            .settings
            .iter()
            .filter_map(|(name, now)| {
                let before = before?.get(name).map_or("none", String::as_str);
                (before != now).then(|| format!("{name} from {before} to {now}"))
            })
            .collect();
        if !changed.is_empty() {
            writeln!(f, "  changed: {}", changed.join(", "))?;
        }
        // Print error and time of the image
        let rmse = self.rmse.map_or("not measured".to_owned(), |rmse| {
            format!("{} ({})", significant(rmse.value, 3), range(rmse, 3))
        });
        writeln!(f, "  this image: RMSE {rmse}, {} s", significant(self.seconds, 3))?;
        write_failed_checks(self.study, f)
    }
}

fn write_failed_checks(study: &Study, f: &mut fmt::Formatter) -> fmt::Result {
    if study.reference.has_converged() {
        return Ok(());
    }
    writeln!(f, "REFERENCE NOT CONVERGED: the errors are not reliable")?;
    for check in study.reference.checks.iter().filter(|check| !check.holds) {
        writeln!(f, "  {}: {}", check.name, check.words)?;
    }
    Ok(())
}

/// Returns every configuration as comma-separated values below a header line; `id` is the index in [`Study::points`],
/// and a value that is not finite is empty.
pub fn points_csv(study: &Study) -> String {
    let mut text = format!("{COLUMNS}\n");
    for (id, point) in study.points.iter().enumerate() {
        let intervals = [point.seconds, point.time_ratio, point.rmse].into_iter();
        let numbers = [point.build_seconds, point.ready_seconds]
            .into_iter()
            .chain(intervals.flat_map(|interval| [interval.value, interval.low, interval.high]))
            .chain([point.bias_squared.value, point.variance])
            .chain([point.rel_mse, point.flip, point.max, point.changed_share]);
        let numbers: Vec<String> = numbers.map(number).collect();
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{id},{},{},{},{},{},{},{},{},{}",
            quoted(knob_name(point)),
            quoted(&point.level),
            numbers.join(","),
            point.non_finite,
            point.rays,
            point.on_front,
            point.build_bytes,
            geometry(point).join(","),
            point.instructions.map_or(String::new(), number)
        );
    }
    text
}

/// Returns the counts of rays and geometric errors, empty where they were not counted.
fn geometry(point: &Point) -> [String; 7] {
    let Some(errors) = &point.geometry else {
        return Default::default();
    };
    let counts = [
        errors.camera_rays,
        errors.shadow_rays,
        errors.leaks,
        errors.false_hits,
        errors.false_shadows,
        errors.light_leaks,
        errors.ties,
    ];
    counts.map(|count| count.to_string())
}

/// Formats a number with all digits; empty if it is not finite.
fn number(value: f64) -> String {
    if value.is_finite() {
        value.to_string()
    } else {
        String::new()
    }
}

/// Quotes a CSV field as RFC 4180 requires.
fn quoted(word: &str) -> String {
    if word.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", word.replace('"', "\"\""))
    } else {
        word.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::html::cost_page::tests::study;

    #[test]
    fn text_lists_ratios_cost_factors_and_failed_checks() {
        let mut study = study();
        let text = CostText(&study).to_string();
        for words in [
            "samples    16     x4.00  0.0100  *",
            "half the error with samples: x4.0 (3.2 to 5.0) the time",
            "half the error with depth: too few points to fit the cost",
        ] {
            assert!(text.contains(words), "{words} in\n{text}");
        }
        assert!(!text.contains("NOT CONVERGED"), "{text}");
        study.reference.checks[0].holds = false;
        let text = CostText(&study).to_string();
        assert!(
            text.ends_with("the errors are not reliable\n  noise: 0.1 of 0.2\n"),
            "{text}"
        );
    }

    #[test]
    fn csv_rows_have_all_columns_and_quote_commas() {
        let mut study = study();
        study.points[1].level = "a,\"b\"".to_owned();
        study.points[1].flip = f64::NAN;
        let csv = points_csv(&study);
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines.len(), 1 + study.points.len());
        assert_eq!(lines[0].split(',').count(), 32);
        assert_eq!(lines[1].split(',').count(), 32, "{}", lines[1]);
        assert!(
            lines[1].starts_with("0,base,base,0.1,0,1,0.9,1.1,1,1,1,0.02,"),
            "{}",
            lines[1]
        );
        assert!(lines[2].starts_with("1,samples,\"a,\"\"b\"\"\","), "{}", lines[2]);
        assert!(!csv.contains("NaN") && lines[2].contains(",,"), "{}", lines[2]);
        assert!(lines[1].ends_with(",1000,true,5000,,,,,,,,"), "{}", lines[1]);
    }
}
