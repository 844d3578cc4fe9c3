//! Forecast of a batch: a list of its frames with their costs, and a script for a cluster.

use std::path::{Path, absolute};

use whit::batch::slurm::{SlurmTask, script};
use whit::batch::{self, BatchObserver, BatchOptions, FrameEvent, PlannedFrame};
use whit::report::batch::BatchForecast;

use super::super::args::BatchArgs;
use super::super::failure::Failure;
use super::super::interrupt;
use super::super::output;
use super::progress;

/// Prints the frames with their forecast time and memory, and the totals, or writes a Slurm script for the batch.
pub(super) fn run(args: &BatchArgs, options: &BatchOptions, plans: &[PlannedFrame]) -> Result<(), Failure> {
    let forecast = forecast(args, options, plans)?;
    match &args.slurm {
        Some(path) => write_script(args, plans, &forecast, path),
        None => output::print(&forecast.to_string()),
    }
}

fn write_script(
    args: &BatchArgs,
    plans: &[PlannedFrame],
    forecast: &BatchForecast,
    path: &Path,
) -> Result<(), Failure> {
    // No shard is empty
    let pieces: usize = plans.iter().map(PlannedFrame::piece_count).sum();
    let shards = args.shards.min(u32::try_from(pieces).unwrap_or(u32::MAX)).max(1);
    // Use absolute paths, as the nodes may have another working directory
    let unknown = |error| Failure::Work(format!("cannot find the path of whit for the script: {error}"));
    let program = std::env::current_exe().map_err(unknown)?;
    let [jobs, folder] = [&args.jobs, &args.out].map(|path| absolute(path).unwrap_or_else(|_| path.clone()));
    let mut arguments = vec!["--checkpoint".to_owned(), args.checkpoint.to_string()];
    if let Some(seconds) = args.time {
        arguments.extend(["--time".to_owned(), seconds.to_string()]);
    }
    // Write the script with the time and the memory of the most expensive shard
    let text = script(&SlurmTask {
        program: &program,
        jobs: &jobs,
        folder: &folder,
        shards,
        threads: rayon::current_num_threads() as u32,
        seconds: forecast.shard_seconds(shards),
        bytes: forecast.max_bytes(),
        arguments: &arguments,
    });
    interrupt::without_interruption(|| output::write_text(path, &text))?;
    if args.quiet {
        return Ok(());
    }
    output::print(&format!(
        "{}: {shards} tasks; submit the script with `sbatch`\n",
        path.display()
    ))
}

/// Probes the scenes of all frames, in the current thread pool.
fn forecast<'p>(
    args: &BatchArgs,
    options: &BatchOptions,
    plans: &'p [PlannedFrame],
) -> Result<BatchForecast<'p>, Failure> {
    let progress = progress(args);
    let event = |plan: &PlannedFrame, event| match event {
        FrameEvent::Begun => progress.phase(&plan.name(), "probe"),
        FrameEvent::Progress(fraction) => progress.fraction(fraction),
        _ => {}
    };
    let observer = BatchObserver {
        warn: &|warning| progress.warn(warning),
        event: &event,
        tiles: None,
        cancel: &interrupt::CANCELLED,
        writes: &interrupt::WRITES,
    };
    let costs = batch::forecast(plans, options, &observer)?;
    progress.clear();
    Ok(BatchForecast {
        plans,
        costs,
        threads: rayon::current_num_threads(),
    })
}
