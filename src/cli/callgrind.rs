//! Instruction counts of every setting of a study by callgrind: a measure of time independent of other load.

use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};

use whit::cost::{Configuration, SettingsFile, StudyResult};
use whit::parallel;

use super::args::CostArgs;
use super::failure::Failure;
use super::interrupt;
use super::progress::Progress;

/// Sizes of the two images whose difference in instructions is due to pixels alone: the counts of loading and building
/// cancel.
const SIZES: [[u32; 2]; 2] = [[16, 12], [48, 36]];

/// Returns an error if callgrind is missing, before anything is measured.
pub(super) fn check() -> Result<(), Failure> {
    let version = Command::new("valgrind").arg("--version").output();
    match version {
        Ok(output) if output.status.success() => Ok(()),
        _ => Err(Failure::Input(
            "`--instructions` requires valgrind, which is not installed: install it or leave out the flag"
                .into(),
        )),
    }
}

/// Counts the instructions per pixel of every setting of a study, in the current rayon pool.
pub(super) fn count(args: &CostArgs, findings: &mut StudyResult, progress: &Progress) -> Result<(), Failure> {
    let folder = tempfile::tempdir()
        .map_err(|error| Failure::Work(format!("cannot create a temporary folder for settings: {error}")))?;
    progress.phase(&args.scene.display().to_string(), "instructions");
    let (done, all) = (AtomicUsize::new(0), findings.configurations.len());
    let configurations = &findings.configurations;
    let counts = parallel::try_map(all, &|number| {
        let file = folder.path().join(format!("{number}.toml"));
        let counted = instructions_per_pixel(args, &configurations[number], &file)?;
        progress.fraction((done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / all as f64);
        Ok::<_, Failure>(counted)
    })?;
    for (point, counted) in findings.study.points.iter_mut().zip(counts) {
        point.instructions = Some(counted);
    }
    Ok(())
}

/// Returns the instructions per pixel; `settings` is the path of a temporary settings file for the counted process.
fn instructions_per_pixel(
    args: &CostArgs,
    configuration: &Configuration,
    settings: &Path,
) -> Result<f64, Failure> {
    let text = SettingsFile {
        settings: configuration.to_settings(),
        measured: None,
    }
    .text();
    std::fs::write(settings, text)
        .map_err(|error| Failure::Work(format!("cannot write {}: {error}", settings.display())))?;
    // Count two sizes and divide the difference by the difference in pixels
    let mut counts = [0.0; 2];
    for (size, counted) in SIZES.into_iter().zip(&mut counts) {
        *counted = count_image(args, size, settings)?;
    }
    let pixels = SIZES.map(|[width, height]| f64::from(width * height));
    Ok((counts[1] - counts[0]) / (pixels[1] - pixels[0]))
}

fn count_image(args: &CostArgs, [width, height]: [u32; 2], settings: &Path) -> Result<f64, Failure> {
    interrupt::check()?;
    let program = std::env::current_exe().map_err(|error| {
        Failure::Work(format!(
            "cannot find the path of whit to count its instructions: {error}"
        ))
    })?;
    let image = settings.with_extension("exr");
    // Run whit under callgrind on one thread
    let mut command = Command::new("valgrind");
    command
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(program)
        .arg("render")
        .arg(&args.scene)
        .arg("-o")
        .arg(&image)
        .arg("--settings")
        .arg(settings)
        .args([
            "--quiet",
            "--threads",
            "1",
            "--size",
            &format!("{width}x{height}"),
        ]);
    if let Some(camera) = &args.camera {
        command.args(["--camera", camera]);
    }
    if let Some(isa) = &args.tracing.isa {
        command.args(["--isa", isa]);
    }
    let output = command
        .output()
        .map_err(|error| Failure::Work(format!("cannot run valgrind: {error}")))?;
    interrupt::check()?;
    // Parse the count from callgrind's output
    let stderr_text = String::from_utf8_lossy(&output.stderr);
    parse_count(&stderr_text)
        .filter(|_| output.status.success())
        .ok_or_else(|| {
            let last = stderr_text.lines().last().unwrap_or_default();
            Failure::Work(format!(
                "valgrind counted no instructions of {}: {last}",
                args.scene.display()
            ))
        })
}

/// Returns the count in the output of callgrind, printed at the end of the counted program.
fn parse_count(stderr_text: &str) -> Option<f64> {
    let line = stderr_text
        .lines()
        .find_map(|line| line.split_once("Collected : "));
    line?.1.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instruction_count_is_parsed_from_callgrind_output() {
        let stderr_text =
            "==7== Events    : Ir\n==7== Collected : 123456789\n==7==\n==7== I   refs:      123,456,789\n";
        assert_eq!(parse_count(stderr_text), Some(123_456_789.0));
        assert_eq!(parse_count("valgrind: whit: command not found"), None);
    }
}
