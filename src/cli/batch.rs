//! Commands `whit batch`, which renders many frames and resumes after interruptions, and `whit merge`, which merges the
//! pieces of frames; see [`whit::batch`].

mod forecast;
mod plan;
mod viewer;

use whit::batch::request::TracingOptions;
use whit::batch::{
    Batch, BatchObserver, BatchOptions, BatchOutcome, FrameEvent, PlannedFrame, check_division, merge_frames,
};
use whit::parallel;
use whit::render::FinishedTile;
use whit::report::batch::BatchSummary;
use whit::report::batch_page;

use super::args::{BatchArgs, MergeArgs};
use super::failure::Failure;
use super::interrupt;
use super::output;
use super::preview;
use super::progress::{Progress, Verbosity};
use super::standard_error;
use viewer::Viewer;

/// Renders the frames of this process's shard, or lists them, or writes a Slurm script, as the arguments request.
pub(super) fn run(args: &BatchArgs) -> Result<(), Failure> {
    // Parse all frames and report errors before anything is rendered
    let plans = plan::plans(&args.jobs, &args.out, args.threads)?;
    check_division(&plans, args.time)?;
    if let Some(nice) = args.nice {
        lower_priority(nice);
    }
    let pool = TracingOptions::of_threads(args.threads).pool()?;
    let options = BatchOptions {
        out: args.out.clone(),
        resume: args.resume,
        shard: args.shard,
        checkpoint: args.checkpoint,
        time: args.time,
        max_memory: args.max_memory,
        keeps_records: args.html.is_some(),
    };
    // Only forecast for `--slurm` and `--dry-run`
    if args.slurm.is_some() || args.dry_run {
        return parallel::install(&pool, || forecast::run(args, &options, &plans));
    }
    // Connect to the viewer and claim the output folder, whose lock is held until the end
    let viewer = Viewer::connect(args.watching.tev.as_deref())?;
    let batch = Batch::open(&plans, &options, &|warning| progress(args).warn(warning))?;
    // Render
    let progress = progress(args);
    let outcome = render(&batch, (&progress, viewer.as_ref()), &pool);
    let result =
        print_summary(args, &batch, &outcome).and(outcome.error.map_or(Ok(()), |error| Err(error.into())));
    preview::finish(viewer.map(|viewer| viewer.tev), &progress);
    result
}

/// Returns the progress display that the arguments request.
fn progress(args: &BatchArgs) -> Progress {
    Progress::of_kind(args.watching.format.progress, Verbosity::of_flag(args.quiet))
}

/// Renders a batch with its progress on standard error, and with a live preview if there is a viewer.
fn render(
    batch: &Batch,
    (progress, viewer): (&Progress, Option<&Viewer>),
    pool: &rayon::ThreadPool,
) -> BatchOutcome {
    let shown = progress.batch(batch.frame_count());
    let event = |plan: &PlannedFrame, event| match event {
        FrameEvent::Skipped => shown.skip(&plan.name()),
        FrameEvent::Begun => shown.begin(plan.number, &plan.name()),
        FrameEvent::Sized(size) => {
            viewer.iter().for_each(|viewer| viewer.begin(&plan.name(), size));
        }
        FrameEvent::Progress(fraction) => shown.fraction(plan.number, fraction),
        FrameEvent::Rendered => preview::warn_if_gone(viewer.map(|viewer| &viewer.tev), progress),
        FrameEvent::Done => shown.end(plan.number, None),
        FrameEvent::Failed(error) => shown.end(plan.number, Some(&error.into())),
        FrameEvent::Interrupted => shown.interrupt(plan.number),
    };
    let show =
        viewer.map(|viewer| move |plan: &PlannedFrame, tile: FinishedTile| viewer.show(&plan.name(), tile));
    let outcome = batch.run(
        pool,
        &BatchObserver {
            warn: &|warning| progress.warn(warning),
            event: &event,
            tiles: show.as_ref().map(|show| show as _),
            cancel: &interrupt::CANCELLED,
            writes: &interrupt::WRITES,
        },
    );
    progress.clear();
    outcome
}

/// Prints the summary, and writes the page if one was requested.
fn print_summary(args: &BatchArgs, batch: &Batch, outcome: &BatchOutcome) -> Result<(), Failure> {
    if outcome.is_disk_full {
        standard_error::emit(&format!(
            "whit: cannot write any more data to {}: free some space and continue with `--resume`",
            args.out.display()
        ));
    }
    if let Some(path) = &args.html {
        let gallery = batch_page::gallery(batch, outcome, args.jobs.display().to_string(), path);
        output::write_text(path, &gallery.page())?;
    }
    match args.quiet {
        true => Ok(()),
        false => output::print(&BatchSummary(outcome).to_string()),
    }
}

/// Merges the frames all of whose pieces are present.
pub(super) fn merge(args: &MergeArgs) -> Result<(), Failure> {
    merge_frames(&args.out, &interrupt::WRITES, |image, merged| {
        let image = image.display();
        match merged {
            Ok(true) if !args.quiet => output::print(&format!("{image}: merged\n"))?,
            Ok(_) => {}
            Err(error) => standard_error::emit(&format!("whit: {image}: {error}")),
        }
        Ok(())
    })
}

/// Lowers the scheduling priority of this process.
fn lower_priority(nice: i32) {
    #[cfg(target_os = "linux")]
    {
        // Lowering the priority is always permitted.
        let _ = rustix::process::nice(nice);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}
