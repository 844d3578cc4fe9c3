//! Scheduling of a batch: scenes one after another, and the frames of each scene concurrently.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use whit::batch::{ChunkDirectory, Fingerprint, Manifest};
use whit::parallel;
use whit::render::{FinishedTile, Monitor};
use whit::report::gallery::FrameStatus;

use super::super::args::BatchArgs;
use super::super::failure::Failure;
use super::super::interrupt;
use super::super::output;
use super::super::progress::{Batch as Shown, Progress};
use super::super::standard_error;
use super::built_scene::{BuiltScene, LoadedScene, SceneCaches};
use super::frame::{FrameResult, make};
use super::gallery::{Page, Record};
use super::image_writer;
use super::limits::Limits;
use super::manifest::manifest_error;
use super::plan::Plan;
use super::preview::Viewer;
use super::progress::progress;
use super::queue::{Queue, Task};
use super::scene_slots::SceneSlots;

/// Number of scenes processed concurrently: one is rendered while the other is loaded or written.
const SCENES_AT_ONCE: usize = 2;

/// State of a running batch, shared by its threads.
pub(super) struct Batch<'a> {
    args: &'a BatchArgs,
    plans: &'a [Plan],
    progress: Progress,
    viewer: Option<Viewer>,
    manifest: Mutex<Manifest>,
    page: Mutex<Page<'a>>,
    failed: AtomicUsize,
    /// Keys of the images that this process has considered so far, by path.
    keys: Mutex<HashMap<PathBuf, Fingerprint>>,
    /// Set when the output folder accepts no more data.
    is_disk_full: AtomicBool,
    saved: Mutex<SharingSavings>,
    kept: SceneCaches,
    place: SceneSlots,
}

/// Time saved by sharing scenes and acceleration structures among frames.
#[derive(Default)]
struct SharingSavings {
    seconds: f64,
    frames: usize,
}

impl<'a> Batch<'a> {
    pub(super) fn new(
        args: &'a BatchArgs,
        plans: &'a [Plan],
        manifest: Manifest,
        viewer: Option<Viewer>,
    ) -> Batch<'a> {
        Batch {
            args,
            plans,
            progress: progress(args),
            viewer,
            manifest: Mutex::new(manifest),
            page: Mutex::new(Page::new(args, plans)),
            failed: AtomicUsize::new(0),
            keys: Mutex::default(),
            is_disk_full: AtomicBool::new(false),
            saved: Mutex::default(),
            kept: SceneCaches::for_frames(plans),
            place: SceneSlots::default(),
        }
    }

    /// Renders all frames of this process's shard.
    pub(super) fn run(mut self, pool: &rayon::ThreadPool) -> Result<(), Failure> {
        let result = self.render_shard(pool);
        if let Some(viewer) = self.viewer.take() {
            viewer.finish(&self.progress);
        }
        result
    }

    fn render_shard(&self, pool: &rayon::ThreadPool) -> Result<(), Failure> {
        let start = Instant::now();
        // Queue the shard's frames, in the order of their scenes
        let queue = Queue::new(self.plans, self.args.shard);
        let total = queue.len();
        let shown = self.progress.batch(total);
        let queue = Mutex::new(queue);
        let skipped = AtomicUsize::new(0);
        // Render scene after scene on a few threads
        let result = run_on_threads(SCENES_AT_ONCE, || {
            while self.should_continue()? {
                let tasks = self.next_scene(&queue, &shown, &skipped);
                if tasks.is_empty() {
                    break;
                }
                self.render_scene_frames(&tasks, &shown, pool)?;
            }
            Ok(())
        });
        // Remove stale pieces, then print the summary and write the page
        drop(shown);
        self.progress.clear();
        self.remove_leftovers();
        let skipped = skipped.into_inner();
        self.print_summary(total, skipped, start.elapsed().as_secs_f64())?;
        result?;
        match self.failed.load(Ordering::Relaxed) {
            0 => Ok(()),
            failed => Err(Failure::Work(format!("{failed} of {total} frames failed"))),
        }
    }

    /// Returns the tasks for the frames of the next scene that are not done yet.
    fn next_scene(&self, queue: &Mutex<Queue<'a>>, shown: &Shown, skipped: &AtomicUsize) -> Vec<Task<'a>> {
        let mut queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
        queue.next_scene(|plan, recipe| {
            let recipe = recipe.map_err(|failure| self.fail(plan, shown, &failure)).ok()?;
            let (image, key) = (plan.frame.image.clone(), recipe.key);
            self.keys
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .insert(image, key);
            if self.is_done(plan, key) {
                // Another process that rendered the same frame may have left pieces.
                ChunkDirectory::remove_of(&self.args.out, key);
                shown.skip(&plan.name());
                skipped.fetch_add(1, Ordering::Relaxed);
                return None;
            }
            Some(recipe)
        })
    }

    /// Removes pieces whose key is outdated because their scene or settings have changed.
    fn remove_leftovers(&self) {
        let keys = self.keys.lock().unwrap_or_else(PoisonError::into_inner);
        for folder in ChunkDirectory::all(&self.args.out).unwrap_or_default() {
            let head = folder.head();
            if keys.get(&head.image).is_some_and(|key| *key != head.key) {
                folder.remove();
            }
        }
    }

    /// Returns whether rendering continues; an error if it was interrupted.
    fn should_continue(&self) -> Result<bool, Failure> {
        interrupt::check()?;
        Ok(!self.is_disk_full.load(Ordering::Relaxed))
    }

    fn is_done(&self, plan: &Plan, key: Fingerprint) -> bool {
        if !self.args.resume {
            return false;
        }
        let manifest = self.manifest.lock().unwrap_or_else(PoisonError::into_inner);
        let done = manifest.find(&plan.frame.image, key);
        // A frame that ran out of time is done only for runs with a time limit.
        done.is_some_and(|done| done.samples >= f64::from(done.spp) || self.args.time.is_some())
    }

    /// Renders frames that share one scene.
    fn render_scene_frames(
        &self,
        tasks: &[Task],
        shown: &Shown,
        pool: &rayon::ThreadPool,
    ) -> Result<(), Failure> {
        let Some(Task { plan, .. }) = tasks.first() else {
            return Ok(());
        };
        // This thread is not part of the pool, whose threads may take up other work while they wait.
        let place = self.place.enter(tasks.len() > 1 || self.args.time.is_some());
        // Load the scene
        let loaded = parallel::install(pool, || LoadedScene::new(plan, &self.kept, &self.progress));
        let loaded = match loaded {
            Ok(loaded) => loaded,
            Err(failure) => return self.fail_all(tasks, shown, failure),
        };
        // The claim outlives the acceleration structure, which is declared later and dropped first.
        let _place = match loaded.is_large(&plan.request) {
            true => self.place.clear(place),
            false => place,
        };
        // Build the acceleration structure if at least one frame fits into memory
        let threads = pool.current_num_threads();
        let at_once = self.limits().frames_at_once(plan, (&loaded, &self.kept), threads);
        let stage = at_once.and_then(|at_once| {
            let stage = parallel::install(pool, || BuiltScene::new(plan, &loaded, &self.kept))?;
            Ok((at_once, stage))
        });
        let (at_once, stage) = match stage {
            Ok(stage) => stage,
            Err(failure) => return self.fail_all(tasks, shown, failure),
        };
        // Account for the time that sharing the scene has saved
        self.saved
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .add(tasks.len() - 1, loaded.seconds + stage.build_seconds);
        // Render the frames concurrently
        let next = AtomicUsize::new(0);
        run_on_threads(at_once.min(tasks.len()), || {
            while self.should_continue()? {
                let Some(task) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) else {
                    break;
                };
                parallel::install(pool, || self.render_one_frame(task, &stage, shown))?;
            }
            Ok(())
        })
    }

    fn limits(&self) -> Limits<'a> {
        Limits {
            out: &self.args.out,
            checkpoint: self.args.checkpoint,
            time: self.args.time,
            max_memory: self.args.max_memory,
        }
    }

    fn render_one_frame(&self, task: &Task, stage: &BuiltScene, shown: &Shown) -> Result<(), Failure> {
        let plan = task.plan;
        // Connect the progress bar, the live preview and the cancellation flag
        let bar = shown.begin(&plan.name());
        let progress = |fraction: f64| bar.fraction(fraction);
        let name = plan.name();
        let live = self.viewer.as_ref().and_then(|viewer| {
            let resolved = plan.request.resolved(&stage.loaded.file.output).ok()?;
            Some(viewer.begin(&name, [resolved.settings.width, resolved.settings.height]))
        });
        let show = live.map(|live| move |tile: FinishedTile| live.show(tile));
        let monitor = Monitor {
            progress: &progress,
            cancel: &interrupt::CANCELLED,
            tiles: show.as_ref().map(|show| show as _),
        };
        // Render the frame and add it to the manifest
        let made = make(task, stage, self.limits(), monitor);
        if let Some(viewer) = &self.viewer {
            viewer.warn_if_gone(&self.progress);
        }
        match made.and_then(|made| self.note(&made).map(|()| made)) {
            Ok(made) => {
                self.warn_if_out_of_time(plan, &made);
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
                // On failure, check whether the disk is full: then no further frame can succeed
                bar.fail(&failure);
                self.failed.fetch_add(1, Ordering::Relaxed);
                if !self.can_write() {
                    self.is_disk_full.store(true, Ordering::Relaxed);
                }
                Ok(())
            }
        }
    }

    /// Warns that a frame has fewer samples than requested.
    fn warn_if_out_of_time(&self, plan: &Plan, made: &FrameResult) {
        if self.args.time.is_some() && made.samples < f64::from(made.head.spp) {
            self.progress.warn(&format!(
                "{}: the time limit was reached after {:.0} of {} samples per pixel",
                plan.name(),
                made.samples,
                made.head.spp
            ));
        }
    }

    /// Adds a complete image to the manifest.
    fn note(&self, made: &FrameResult) -> Result<(), Failure> {
        if !made.is_whole {
            return Ok(());
        }
        let out = &self.args.out;
        let seconds = [made.render_seconds, made.write_seconds];
        let done = image_writer::done(out, &made.head, made.samples, seconds);
        let mut manifest = self.manifest.lock().unwrap_or_else(PoisonError::into_inner);
        let noted = done.and_then(|done| interrupt::without_interruption(|| manifest.add(done)));
        noted.map_err(|error| manifest_error(&made.head.image, &error))
    }

    /// Returns whether the output folder still accepts data, so that no frame is rendered in vain.
    fn can_write(&self) -> bool {
        /// Size of the probe file in bytes, below that of any image.
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

    /// Records that none of the frames of a scene can be rendered.
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
                    let again = Failure::Work(format!(
                        "{}: its scene {scene} failed, see above",
                        task.plan.name()
                    ));
                    self.fail(task.plan, shown, &again);
                }
            }
        }
        Ok(())
    }

    fn record(&self, plan: &Plan, record: Record) {
        let mut page = self.page.lock().unwrap_or_else(PoisonError::into_inner);
        page.record(plan.number, record);
    }

    /// Prints the summary, and writes the page if one was requested.
    fn print_summary(&self, total: usize, skipped: usize, seconds: f64) -> Result<(), Failure> {
        if self.is_disk_full.load(Ordering::Relaxed) {
            standard_error::emit(&format!(
                "whit: cannot write any more data to {}: free some space and continue with `--resume`",
                self.args.out.display()
            ));
        }
        // Write the page of thumbnails
        if let Some(path) = &self.args.html {
            let manifest = self.manifest.lock().unwrap_or_else(PoisonError::into_inner);
            let page = self.page.lock().unwrap_or_else(PoisonError::into_inner);
            page.write(path, &manifest, seconds)?;
        }
        if self.args.quiet {
            return Ok(());
        }
        // Print the counts and the time saved
        let failed = self.failed.load(Ordering::Relaxed);
        let saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
        let mut line =
            format!("{total} frames in {seconds:.1} s: {skipped} existed already, {failed} failed\n");
        if saved.frames > 0 {
            line += &format!(
                "{} frames reused a loaded scene and its acceleration structure, which saved {:.1} s\n",
                saved.frames, saved.seconds
            );
        }
        line += &self.kept.emit();
        output::print(&line)
    }
}

impl SharingSavings {
    fn add(&mut self, frames: usize, seconds: f64) {
        self.frames += frames;
        self.seconds += frames as f64 * seconds;
    }
}

/// Runs `work` on several threads to completion; returns the first failure, if there is one.
fn run_on_threads(threads: usize, work: impl Fn() -> Result<(), Failure> + Sync) -> Result<(), Failure> {
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(&work)).collect();
        let ends = threads.into_iter().map(|thread| thread.join());
        ends.map(|end| end.unwrap_or_else(|_| Err(Failure::Work("a render thread panicked".into()))))
            .fold(Ok(()), Result::and)
    })
}
