//! Command `whit batch`: renders many frames, resumes after interruptions, and merges the pieces of frames.
//!
//! Frames of one scene are rendered concurrently, at least two at a time: while one is written or runs out of tiles,
//! another uses the processors. Small scenes with a single frame overlap in the same way. Finished frames are recorded
//! in a manifest; see [`whit::batch`] for interruptions and several processes.

mod built_scene;
mod dry_run;
mod fingerprint;
mod frame;
mod gallery;
mod image_writer;
mod limits;
mod manifest;
mod plan;
mod preview;
mod process;
mod progress;
mod queue;
mod row_schedule;
mod run;
mod scene_slots;

use std::path::Path;

use whit::batch::request::TracingOptions;
use whit::batch::{ChunkDirectory, Lock, LockError, Manifest, MergeError, Shard};
use whit::parallel;

use super::args::{BatchArgs, MergeArgs};
use super::failure::Failure;
use super::interrupt;
use super::output;
use super::standard_error;
use manifest::{manifest, manifest_error};
use preview::Viewer;
use process::{describe_process, host};
use progress::progress;
use run::Batch;

/// Renders the frames of this process's shard, or lists them, or writes a Slurm script, as the arguments request.
pub(super) fn run(args: &BatchArgs) -> Result<(), Failure> {
    // Parse all frames and report errors before anything is rendered
    let plans = plan::plans(&args.jobs, &args.out, args.threads)?;
    plan::check_division(&plans, args.time)?;
    if let Some(nice) = args.nice {
        lower_priority(nice);
    }
    let pool = TracingOptions::of_threads(args.threads).pool()?;
    // Only forecast for `--slurm` and `--dry-run`
    if let Some(script) = &args.slurm {
        return parallel::install(&pool, || dry_run::write_script(args, script, &plans));
    }
    if args.dry_run {
        return parallel::install(&pool, || dry_run::list(args, &plans));
    }
    // Connect to the viewer and claim the output folder
    let viewer = Viewer::connect(args.watching.tev.as_deref())?;
    let lock = lock(args)?;
    if lock.is_some() && args.shard == Shard::ALL {
        plan::remove_leftovers(&plans, &args.out);
    }
    // Render, and hold the lock until the end
    let manifest = manifest(args)?;
    let result = Batch::new(args, &plans, manifest, viewer).run(&pool);
    drop(lock);
    result
}

/// Merges the frames all of whose pieces are present.
pub(super) fn merge(args: &MergeArgs) -> Result<(), Failure> {
    if !args.out.is_dir() {
        let out = args.out.display();
        return Err(Failure::Input(format!(
            "there is no folder {out}: give the output folder of a batch"
        )));
    }
    // Find all frames with pieces
    let unreadable = |error| Failure::Input(format!("cannot read {}: {error}", args.out.display()));
    let folders = ChunkDirectory::all(&args.out).map_err(unreadable)?;
    if folders.is_empty() {
        return Ok(());
    }
    let mut manifest = Manifest::open(&args.out, Shard::ALL).map_err(unreadable)?;
    let mut failed = 0;
    // Merge each frame; one failure does not stop the others
    for folder in &folders {
        let image = folder.head().image.display();
        match merge_one(&args.out, folder, &mut manifest) {
            Ok(false) => {}
            Ok(true) if args.quiet => {}
            Ok(true) => output::print(&format!("{image}: merged\n"))?,
            Err(failure) => {
                standard_error::emit(&format!("whit: {image}: {failure}"));
                failed += 1;
            }
        }
    }
    // Report how many frames could not be merged
    match failed {
        0 => Ok(()),
        _ => Err(Failure::Work(format!(
            "{failed} of {} frames could not be merged",
            folders.len()
        ))),
    }
}

/// Merges a frame and adds it to the manifest; returns whether it did. Removes the pieces of a frame that is done
/// already.
fn merge_one(out: &Path, folder: &ChunkDirectory, manifest: &mut Manifest) -> Result<bool, Failure> {
    let head = folder.head();
    if manifest.find(&head.image, head.key).is_some() {
        folder.remove();
        return Ok(false);
    }
    // Merge, then record the image in the manifest
    match image_writer::merge(out, folder) {
        Ok(()) => {
            let done = image_writer::done(out, head, f64::from(head.spp), [0.0; 2]);
            let noted = done.and_then(|done| interrupt::without_interruption(|| manifest.add(done)));
            noted.map_err(|error| manifest_error(&head.image, &error))?;
            Ok(true)
        }
        // A process of the batch may have merged the frame meanwhile.
        Err(_) if manifest.read_again().is_ok() && manifest.find(&head.image, head.key).is_some() => {
            Ok(false)
        }
        Err(error @ MergeError::Missing { .. }) => Err(Failure::Work(format!(
            "{error}: render them with `whit batch --resume`, or remove {} if they are not needed any more",
            folder.folder().display()
        ))),
        Err(error) => Err(error.into()),
    }
}

/// Takes the lock that keeps other processes of this machine from rendering the same shard.
fn lock(args: &BatchArgs) -> Result<Option<Lock>, Failure> {
    let BatchArgs { out, shard, .. } = args;
    let name = format!(".whit-batch.{}-of-{}.lock", shard.number, shard.count);
    match Lock::take(&out.join(name), &describe_process()) {
        Ok(lock) => Ok(Some(lock)),
        // On this machine, a batch without shards must not run twice
        Err(LockError::Held(holder))
            if *shard == Shard::ALL && holder.ends_with(&format!(" on {}", host())) =>
        {
            Err(Failure::Work(format!(
                "another whit ({holder}) is rendering into {}: wait for it, or stop it",
                out.display()
            )))
        }
        // The holder may be the leftover of a restarted task and may never end; two processes do no harm.
        Err(LockError::Held(holder)) => {
            progress(args).warn(&format!(
                "another whit ({holder}) renders the same shard: both continue and write the same bytes"
            ));
            Ok(None)
        }
        // Some network file systems do not support locks.
        Err(LockError::Unknown(_)) => Ok(None),
    }
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
