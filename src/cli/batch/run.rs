//! The running of a batch: scene after scene, frame after frame.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use crate::batch::{Done, Key, Manifest, Sources};
use crate::render::{FinishedTile, Monitor};
use crate::report::gallery::FrameStatus;

use super::super::args::BatchArgs;
use super::super::failure::Failure;
use super::super::interrupt;
use super::super::output;
use super::super::progress::{Batch as Shown, Progress, Verbosity};
use super::frame::{Limits, Made, make};
use super::page::{Page, Record};
use super::plan::Plan;
use super::stage::{Kept, Loaded, Stage, key};
use super::viewer::Viewer;

/// Frames of one scene that are made at the same time: one has the processors while the other is written.
const AT_ONCE: usize = 2;
/// Frames of more pixels than this are made one after the other, so that memory holds only one.
const MANY_PIXELS: u64 = 1 << 24;

/// A batch that is being made.
pub(super) struct Batch<'a> {
    args: &'a BatchArgs,
    plans: &'a [Plan],
    progress: Progress,
    viewer: Option<Viewer>,
    manifest: Mutex<Manifest>,
    page: Mutex<Page<'a>>,
    failed: AtomicUsize,
    /// Set when nothing more can be written.
    is_full: AtomicBool,
    saved: Mutex<Saved>,
    kept: Kept,
}

/// What keeping scenes and structures has spared.
#[derive(Default)]
struct Saved {
    seconds: f64,
    frames: usize,
}

/// A frame and the pieces of it that are to be made.
#[derive(Clone)]
struct Task<'a> {
    plan: &'a Plan,
    key: Key,
    pieces: Range<usize>,
}

impl<'a> Batch<'a> {
    pub(super) fn new(
        args: &'a BatchArgs,
        plans: &'a [Plan],
        manifest: Manifest,
        viewer: Option<Viewer>,
    ) -> Batch<'a> {
        let verbosity = if args.quiet {
            Verbosity::Quiet
        } else {
            Verbosity::Normal
        };
        Batch {
            args,
            plans,
            progress: Progress::of_kind(args.watching.progress, verbosity),
            viewer,
            manifest: Mutex::new(manifest),
            page: Mutex::new(Page::new(args, plans)),
            failed: AtomicUsize::new(0),
            is_full: AtomicBool::new(false),
            saved: Mutex::default(),
            kept: Kept::for_frames(plans),
        }
    }

    /// Makes all that is this process's to make.
    pub(super) fn run(mut self, pool: &rayon::ThreadPool) -> Result<(), Failure> {
        let result = self.make_mine(pool);
        if let Some(viewer) = self.viewer.take() {
            viewer.finish(&self.progress);
        }
        result
    }

    fn make_mine(&self, pool: &rayon::ThreadPool) -> Result<(), Failure> {
        let start = Instant::now();
        let mine = self.tasks();
        let shown = self.progress.batch(mine.len());
        let mut sources = Sources::default();
        let mut waiting: Vec<Task> = Vec::new();
        let mut skipped = 0;
        for (plan, pieces) in &mine {
            let key = match key(plan, &mut sources) {
                Ok(key) => key,
                Err(failure) => {
                    self.fail(plan, &shown, &failure);
                    continue;
                }
            };
            if self.is_done(plan, key) {
                shown.skip(&plan.name());
                skipped += 1;
                continue;
            }
            if waiting
                .first()
                .is_some_and(|first| !first.plan.shares_scene_with(plan))
            {
                self.make_all(std::mem::take(&mut waiting), &shown, pool)?;
            }
            waiting.push(Task {
                plan,
                key,
                pieces: pieces.clone(),
            });
        }
        let result = self.make_all(waiting, &shown, pool);
        drop(shown);
        self.progress.clear();
        self.conclude((mine.len(), skipped), start.elapsed().as_secs_f64())?;
        result?;
        match self.failed.load(Ordering::Relaxed) {
            0 => Ok(()),
            failed => Err(Failure::Work(format!("{failed} of {} frames failed", mine.len()))),
        }
    }

    /// The frames that this process has pieces of, with these.
    fn tasks(&self) -> Vec<(&'a Plan, Range<usize>)> {
        let total = self.plans.iter().map(Plan::piece_count).sum();
        let mine = self.args.shard.of(total);
        let mut first = 0;
        let mut tasks = Vec::new();
        for plan in self.plans {
            let end = first + plan.piece_count();
            let pieces = mine.start.max(first)..mine.end.min(end);
            if !pieces.is_empty() {
                tasks.push((plan, pieces.start - first..pieces.end - first));
            }
            first = end;
        }
        tasks
    }

    fn is_done(&self, plan: &Plan, key: Key) -> bool {
        if !self.args.resume {
            return false;
        }
        let manifest = self
            .manifest
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        let done = manifest.find(&plan.frame.image, key);
        // One that ran out of time is only done for who gives it no more.
        done.is_some_and(|done| done.samples >= f64::from(done.spp) || self.args.time.is_some())
    }

    /// Makes frames of one scene.
    fn make_all(&self, tasks: Vec<Task>, shown: &Shown, pool: &rayon::ThreadPool) -> Result<(), Failure> {
        let Some(first) = tasks.first() else {
            return Ok(());
        };
        interrupt::check()?;
        if self.is_full.load(Ordering::Relaxed) {
            return Ok(());
        }
        let loaded = pool.install(|| Loaded::new(first.plan, &self.kept, &self.progress));
        let loaded = match loaded {
            Ok(loaded) => loaded,
            Err(failure) => return self.fail_all(&tasks, shown, failure),
        };
        let stage = match pool.install(|| Stage::new(first.plan, &loaded, &self.kept, &self.progress)) {
            Ok(stage) => stage,
            Err(failure) => return self.fail_all(&tasks, shown, failure),
        };
        {
            let mut saved = self
                .saved
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner);
            saved.frames += tasks.len() - 1;
            saved.seconds += (tasks.len() - 1) as f64 * (loaded.seconds + stage.build_seconds);
        }
        let next = AtomicUsize::new(0);
        let work = |_: usize| -> Result<(), Failure> {
            while let Some(task) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
                interrupt::check()?;
                if self.is_full.load(Ordering::Relaxed) {
                    return Ok(());
                }
                pool.install(|| self.make_one(task, &stage, shown))?;
            }
            Ok(())
        };
        let at_once = self.at_once(&tasks, &loaded);
        std::thread::scope(|scope| {
            let drivers: Vec<_> = (0..at_once)
                .map(|number| scope.spawn(move || work(number)))
                .collect();
            let ends = drivers.into_iter().map(|driver| driver.join());
            ends.map(|end| end.unwrap_or_else(|_| Err(Failure::Work("a frame came to a sudden end".into()))))
                .fold(Ok(()), Result::and)
        })
    }

    /// How many frames are made at the same time.
    fn at_once(&self, tasks: &[Task], loaded: &Loaded) -> usize {
        let shot = tasks
            .first()
            .and_then(|task| task.plan.job.shot(&loaded.file.output).ok());
        let pixels = shot.map_or(0, |shot| {
            u64::from(shot.settings.width) * u64::from(shot.settings.height)
        });
        if pixels > MANY_PIXELS || self.args.time.is_some() {
            return 1;
        }
        AT_ONCE.min(tasks.len())
    }

    fn make_one(&self, task: &Task, stage: &Stage, shown: &Shown) -> Result<(), Failure> {
        let plan = task.plan;
        let bar = shown.begin(&plan.name());
        let progress = |fraction: f64| bar.fraction(fraction);
        let name = plan.name();
        let live = self.viewer.as_ref().and_then(|viewer| {
            let shot = plan.job.shot(&stage.loaded.file.output).ok()?;
            Some(viewer.begin(&name, [shot.settings.width, shot.settings.height]))
        });
        let show = live.map(|live| move |tile: FinishedTile| live.show(tile));
        let monitor = Monitor {
            progress: &progress,
            cancel: &interrupt::CANCELLED,
            tiles: show.as_ref().map(|show| show as _),
        };
        let limits = Limits {
            out: &self.args.out,
            checkpoint: self.args.checkpoint,
            time: self.args.time,
            max_memory: self
                .args
                .max_memory
                .or_else(crate::report::memory::available_bytes),
        };
        let made = make((plan, task.key), stage, task.pieces.clone(), limits, monitor);
        if let Some(viewer) = &self.viewer {
            viewer.warn_if_gone(&self.progress);
        }
        match made.and_then(|made| self.note(task, &made).map(|()| made)) {
            Ok(made) => {
                self.tell_time(plan, &made);
                let status = if made.is_whole {
                    FrameStatus::Done
                } else {
                    FrameStatus::Missing
                };
                self.record(plan, Record::of(&made, stage, status));
                bar.finish();
                Ok(())
            }
            Err(Failure::Interrupted) => Err(Failure::Interrupted),
            Err(failure) => {
                self.record(plan, Record::failed(&failure));
                bar.fail(&failure);
                self.failed.fetch_add(1, Ordering::Relaxed);
                if !self.can_write() {
                    self.is_full.store(true, Ordering::Relaxed);
                }
                Ok(())
            }
        }
    }

    /// Says that a frame has fewer samples than it was to have.
    fn tell_time(&self, plan: &Plan, made: &Made) {
        if self.args.time.is_some() && made.samples < f64::from(made.spp) {
            self.progress.warn(&format!(
                "{}: its time was up after {:.0} of {} samples a pixel",
                plan.name(),
                made.samples,
                made.spp
            ));
        }
    }

    /// Notes a picture that stands in its place.
    fn note(&self, task: &Task, made: &Made) -> Result<(), Failure> {
        if !made.is_whole {
            return Ok(());
        }
        let image = &task.plan.frame.image;
        let unknown = |error| {
            Failure::Work(format!(
                "{} cannot be noted in the manifest: {error}",
                image.display()
            ))
        };
        let bytes = std::fs::metadata(self.args.out.join(image))
            .map_err(unknown)?
            .len();
        let done = Done {
            frame: task.plan.number,
            image: image.clone(),
            key: task.key,
            bytes,
            seconds: made.render_seconds + made.write_seconds,
            samples: made.samples,
            spp: made.spp,
            by: format!("process {} on {}", std::process::id(), super::host()),
        };
        let mut manifest = self
            .manifest
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        interrupt::finish_first(|| manifest.add(done)).map_err(unknown)
    }

    /// Whether the folder of results takes any more: frames are not rendered for nothing.
    fn can_write(&self) -> bool {
        /// A picture has more.
        const BYTES: usize = 1 << 14;
        let probe = self.args.out.join(format!(".whit-{}.probe", std::process::id()));
        let written = std::fs::write(&probe, [0; BYTES]);
        let _ = std::fs::remove_file(&probe);
        written.is_ok()
    }

    fn fail(&self, plan: &Plan, shown: &Shown, failure: &Failure) {
        self.record(plan, Record::failed(failure));
        shown.begin(&plan.name()).fail(failure);
        self.failed.fetch_add(1, Ordering::Relaxed);
    }

    /// None of the frames of a scene can be made.
    fn fail_all(&self, tasks: &[Task], shown: &Shown, failure: Failure) -> Result<(), Failure> {
        if matches!(failure, Failure::Interrupted) {
            return Err(failure);
        }
        let scene = tasks
            .first()
            .map(|task| task.plan.frame.scene.display().to_string());
        for (number, task) in tasks.iter().enumerate() {
            match number {
                0 => self.fail(task.plan, shown, &failure),
                _ => {
                    let scene = scene.as_deref().unwrap_or_default();
                    let again = Failure::Work(format!("{}: {scene} failed, see above", task.plan.name()));
                    self.fail(task.plan, shown, &again);
                }
            }
        }
        Ok(())
    }

    fn record(&self, plan: &Plan, record: Record) {
        let mut page = self
            .page
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        page.record(plan.number, record);
    }

    /// What is told at the end.
    fn conclude(&self, (total, skipped): (usize, usize), seconds: f64) -> Result<(), Failure> {
        if self.is_full.load(Ordering::Relaxed) {
            output::tell(&format!(
                "whit: nothing more can be written to {}: make room and go on with `--resume`",
                self.args.out.display()
            ));
        }
        if let Some(path) = &self.args.html {
            let manifest = self
                .manifest
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner);
            let page = self
                .page
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner);
            page.write(path, &manifest, seconds)?;
        }
        if self.args.quiet {
            return Ok(());
        }
        let failed = self.failed.load(Ordering::Relaxed);
        let saved = self
            .saved
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut line =
            format!("{total} frames in {seconds:.1} s: {skipped} were there already, {failed} failed\n");
        if saved.frames > 0 {
            line += &format!(
                "{} frames found their scene loaded and its structure built, which spared {:.1} s\n",
                saved.frames, saved.seconds
            );
        }
        line += &self.kept.tell();
        output::print(&line)
    }
}

/// Frames by the numbers of their plans.
pub(super) type ByNumber<T> = HashMap<usize, T>;
