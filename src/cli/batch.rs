//! `whit batch`: many frames, which get finished whatever happens on the way.
//!
//! Frames of one scene are made side by side, two at least: while one is written or runs out of tiles another has the
//! processors; so are small scenes of a frame each. What is finished is noted in a manifest; see [`crate::batch`] for
//! what may happen meanwhile.

mod dry_run;
mod frame;
mod limits;
mod page;
mod picture;
mod place;
mod plan;
mod queue;
mod recipe;
mod rows;
mod run;
mod stage;
mod viewer;

use std::path::Path;
use std::{fs, io};

use crate::batch::{Lock, LockError, Manifest, MergeError, PieceFolder, Shard};
use crate::parallel;

use super::args::{BatchArgs, MergeArgs};
use super::failure::Failure;
use super::interrupt;
use super::output;
use super::progress::{Progress, Verbosity};
use super::tracing::Tracing;
use run::Batch;
use viewer::Viewer;

/// Makes what the arguments ask for.
pub(super) fn run(args: &BatchArgs) -> Result<(), Failure> {
    let plans = plan::plans(&args.jobs, &args.out, args.threads)?;
    plan::check_division(&plans, args.time)?;
    if let Some(nice) = args.nice {
        yield_to_others(nice);
    }
    let pool = Tracing::of_threads(args.threads).pool()?;
    if let Some(script) = &args.slurm {
        return parallel::install(&pool, || dry_run::write_script(args, script, &plans));
    }
    if args.dry_run {
        return parallel::install(&pool, || dry_run::list(args, &plans));
    }
    let viewer = Viewer::connect(args.watching.tev.as_deref())?;
    let lock = lock(args)?;
    if lock.is_some() && args.shard == Shard::ALL {
        plan::sweep_up(&plans, &args.out);
    }
    let manifest = manifest(args)?;
    let result = Batch::new(args, &plans, manifest, viewer).run(&pool);
    drop(lock);
    result
}

/// Puts together the frames all of whose pieces are there.
pub(super) fn merge(args: &MergeArgs) -> Result<(), Failure> {
    if !args.out.is_dir() {
        let out = args.out.display();
        return Err(Failure::Input(format!(
            "there is no folder {out}: name that of a batch"
        )));
    }
    let unreadable = |error| Failure::Input(format!("{} cannot be read: {error}", args.out.display()));
    let folders = PieceFolder::all(&args.out).map_err(unreadable)?;
    if folders.is_empty() {
        return Ok(());
    }
    let mut manifest = Manifest::open(&args.out, Shard::ALL).map_err(unreadable)?;
    let mut failed = 0;
    for folder in &folders {
        let image = folder.head().image.display();
        match merge_one(&args.out, folder, &mut manifest) {
            Ok(false) => {}
            Ok(true) if args.quiet => {}
            Ok(true) => output::print(&format!("{image}: put together\n"))?,
            Err(failure) => {
                output::tell(&format!("whit: {image}: {failure}"));
                failed += 1;
            }
        }
    }
    match failed {
        0 => Ok(()),
        _ => Err(Failure::Work(format!(
            "{failed} of {} frames could not be put together",
            folders.len()
        ))),
    }
}

/// Puts a frame together and notes it. Of one that is done already somebody has left pieces, which go.
fn merge_one(out: &Path, folder: &PieceFolder, manifest: &mut Manifest) -> Result<bool, Failure> {
    let head = folder.head();
    if manifest.find(&head.image, head.key).is_some() {
        folder.remove();
        return Ok(false);
    }
    match picture::merge(out, folder) {
        Ok(()) => {
            let done = picture::done(out, head, f64::from(head.spp), [0.0; 2]);
            let noted = done.and_then(|done| interrupt::finish_first(|| manifest.add(done)));
            noted.map_err(|error| unnoted(&head.image, &error))?;
            Ok(true)
        }
        // A process of the batch may have done it meanwhile.
        Err(_) if manifest.read_again().is_ok() && manifest.find(&head.image, head.key).is_some() => {
            Ok(false)
        }
        Err(error @ MergeError::Missing { .. }) => Err(Failure::Work(format!(
            "{error}: make them with `whit batch --resume`, or remove {} if they are not wanted any more",
            folder.folder().display()
        ))),
        Err(error) => Err(error.into()),
    }
}

/// That a picture stands in its place and nobody will know.
fn unnoted(image: &Path, error: &io::Error) -> Failure {
    Failure::Work(format!(
        "{} cannot be noted in the manifest: {error}",
        image.display()
    ))
}

/// What is done already; a folder with results of an earlier run is refused, unless these are to be kept.
fn manifest(args: &BatchArgs) -> Result<Manifest, Failure> {
    let out = args.out.display();
    let unreadable = |error| Failure::Input(format!("{out} cannot be used: {error}"));
    if !args.resume && args.shard == Shard::ALL && !Manifest::read(&args.out).map_err(unreadable)?.is_empty()
    {
        return Err(Failure::Input(format!(
            "{out} has results of an earlier run: give `--resume` to keep what is done, or another `--out`"
        )));
    }
    Manifest::open(&args.out, args.shard).map_err(unreadable)
}

/// Keeps other processes of this machine from making the same.
fn lock(args: &BatchArgs) -> Result<Option<Lock>, Failure> {
    let BatchArgs { out, shard, .. } = args;
    let name = format!(".whit-batch.{}-of-{}.lock", shard.number, shard.count);
    match Lock::take(&out.join(name), &who()) {
        Ok(lock) => Ok(Some(lock)),
        Err(LockError::Held(holder))
            if *shard == Shard::ALL && holder.ends_with(&format!(" on {}", host())) =>
        {
            Err(Failure::Work(format!(
                "{} is being made by another whit ({holder}): wait for it, or end it",
                out.display()
            )))
        }
        // It may be the ghost of a task that was started anew, which will not end the work: no harm comes of two.
        Err(LockError::Held(holder)) => {
            progress(args).warn(&format!(
                "another whit ({holder}) makes the same part: both go on, to the same bytes"
            ));
            Ok(None)
        }
        // Some network file systems know no locks.
        Err(LockError::Unknown(_)) => Ok(None),
    }
}

/// How the arguments ask for progress to be shown.
fn progress(args: &BatchArgs) -> Progress {
    let verbosity = if args.quiet {
        Verbosity::Quiet
    } else {
        Verbosity::Normal
    };
    Progress::of_kind(args.watching.progress, verbosity)
}

/// What this process calls itself.
fn who() -> String {
    format!("process {} on {}", std::process::id(), host())
}

/// The name of this machine.
fn host() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    name.trim().to_owned()
}

/// Lets others go first.
fn yield_to_others(nice: i32) {
    #[cfg(target_os = "linux")]
    {
        // Only asked for less than there was, which is always granted.
        let _ = rustix::process::nice(nice);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}
