//! `whit batch`: many frames, which get finished whatever happens on the way.
//!
//! Frames of one scene are made one after the other, two at a time: while one is written or runs out of tiles the other
//! has the processors. What is finished is noted in a manifest; see [`crate::batch`] for what may happen meanwhile.

mod dry_run;
mod frame;
mod page;
mod picture;
mod plan;
mod rows;
mod run;
mod stage;
mod viewer;

use std::fs;
use std::path::Path;

use crate::batch::{Lock, LockError, Manifest, MergeError, PieceFolder, Shard};

use super::args::{BatchArgs, MergeArgs};
use super::failure::Failure;
use super::output;
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
        return pool.install(|| dry_run::write_script(args, script, &plans));
    }
    if args.dry_run {
        return pool.install(|| dry_run::list(args, &plans));
    }
    let viewer = Viewer::connect(args.watching.tev.as_deref())?;
    let lock = lock(&args.out, args.shard)?;
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
    let mut failed = 0;
    for folder in &folders {
        let image = folder.head().image.display();
        match picture::merge(&args.out, folder) {
            Ok(()) if args.quiet => {}
            Ok(()) => output::print(&format!("{image}: put together\n"))?,
            Err(error) => {
                let why = match error {
                    MergeError::Missing { .. } => format!("{error}: make them with `whit batch --resume`"),
                    error => error.to_string(),
                };
                output::tell(&format!("whit: {image}: {why}"));
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
fn lock(out: &Path, shard: Shard) -> Result<Option<Lock>, Failure> {
    let host = host();
    let name = format!(".whit-batch.{}-of-{}.lock", shard.number, shard.count);
    let who = format!("process {} on {host}", std::process::id());
    match Lock::take(&out.join(name), &who) {
        Ok(lock) => Ok(Some(lock)),
        Err(LockError::Held(holder)) if holder.ends_with(&format!(" on {host}")) => {
            Err(Failure::Work(format!(
                "{} is being made by another whit ({holder}): wait for it, or end it",
                out.display()
            )))
        }
        // It may be the ghost of a task that was started anew here, and no harm comes of it.
        Err(LockError::Held(_)) => Ok(None),
        // Some network file systems know no locks.
        Err(LockError::Unknown(_)) => Ok(None),
    }
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
