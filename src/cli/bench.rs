//! Command `whit bench`: compares Embree and the BSP on the same recorded rays.

mod job;
mod scenes;
mod sweep;

use std::path::Path;

use serde::Serialize;
use whit::accel::{AccelError, Instancing};
use whit::bench::{BenchRow, measure_backends, measure_bounding_volumes};
use whit::image::check_writable;
use whit::report::bench::BenchTable;
use whit::report::extents::BoundingVolumeTable;
use whit::report::{bench_page, crossover};

use super::accel_options::check_instancing;
use super::args::BenchArgs;
use super::failure::Failure;
use super::interrupt;
use super::output;
use scenes::{Subject, measure_scenes};

/// Measures all scenes or generated meshes of the arguments.
pub(super) fn run(args: &BenchArgs) -> Result<(), Failure> {
    // Check the output files and the flags before anything is measured
    for path in [&args.json, &args.html].into_iter().flatten() {
        check_writable(path)?;
    }
    if args.extents {
        let files = Subject::files(args);
        measure_scenes(args, &files, measure_bounding_volumes, |of_scene, rows| {
            output::print(&BoundingVolumeTable(of_scene).to_string())?;
            write_json(args.json.as_deref(), rows)
        })?;
        return Ok(());
    }
    if args.tracing.instancing != Instancing::Auto && !cfg!(feature = "embree") {
        return Err(AccelError::NoEmbree.into());
    }
    check_instancing(&args.tracing)?;
    // List the scenes, or the generated meshes of a sweep
    let subjects = match args.sweep {
        true => sweep::sizes(args.most_triangles)
            .into_iter()
            .map(Subject::Made)
            .collect(),
        false => Subject::files(args),
    };
    // Measure each, and write the files after each
    let rows = measure_scenes(args, &subjects, measure_backends, |of_scene, rows| {
        output::print(&BenchTable(of_scene).to_string())?;
        write(args, rows)
    })?;
    if args.sweep {
        output::print(&crossover::text(&rows))?;
    }
    Ok(())
}

/// Writes the JSON file and the HTML page that the arguments request.
fn write(args: &BenchArgs, rows: &[BenchRow]) -> Result<(), Failure> {
    write_json(args.json.as_deref(), rows)?;
    let Some(path) = &args.html else { return Ok(()) };
    let facts = bench_page::Facts {
        is_sweep: args.sweep,
        repeat: args.repeat,
        date: args.date.as_deref(),
    };
    interrupt::without_interruption(|| output::write_text(path, &bench_page::page(rows, &facts)))
}

/// Writes all rows as JSON if there is a path.
fn write_json(path: Option<&Path>, rows: &[impl Serialize]) -> Result<(), Failure> {
    match path {
        Some(path) => interrupt::without_interruption(|| output::write_json(path, &rows)),
        None => Ok(()),
    }
}
